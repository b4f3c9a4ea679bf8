"""python-canopen on a bus whose time waits for it: `omnibus-sim serve --lockstep`.

The time-outs of python-canopen are those of the clock on the wall. Here they are those of the simulated bus: whoever
waits for an answer lets the world go on until it comes or the time is over. So a test may have the time-outs of a
real client, and its result does not depend on how busy the machine is.
"""

import queue
import socket

import canopen
from canopen.sdo import SdoClient, SdoCommunicationError


class Network(canopen.Network):
    """A bus without a thread: frames come while somebody waits."""

    def __init__(self, address):
        super().__init__()
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.lines = self.socket.makefile("rb")
        if self.lines.readline() != b"omnibus-lockstep 1\n":
            raise ConnectionError("no lockstep bus")
        self.now = int(self.lines.readline()[1:])
        self.unsent = b""

    def send_message(self, can_id, data, remote=False):
        data = bytes(data)
        self.unsent += b"t%03X%d%s\n" % (can_id, len(data), data.hex().upper().encode())

    def wait(self, is_there, seconds):
        """Lets time go on until `is_there`, or so many simulated seconds; whether it was in time."""
        end = self.now + round(seconds * 1e6)
        while not is_there():
            if self.now >= end:
                return False
            self.advance(end)
        return True

    def advance(self, until):
        """To this time, or to the next frame."""
        self.socket.sendall(self.unsent + b"w%d\n" % until)
        self.unsent = b""
        while (line := self.lines.readline())[:1] == b"f":
            at, text = line[1:].split()
            identifier, data = int(text[1:4], 16), bytes.fromhex(text[5:].decode())
            self.notify(identifier, bytearray(data), int(at) / 1e6)
        self.now = int(line[1:])

    def disconnect(self):
        self.lines.close()
        self.socket.close()


class Sdo(SdoClient):
    """An SDO client that waits in the time of the bus."""

    def read_response(self):
        if not self.network.wait(lambda: not self.responses.empty(), self.RESPONSE_TIMEOUT):
            raise SdoCommunicationError("No SDO response received")
        return super().read_response()


class Node(canopen.RemoteNode):
    def add_sdo(self, rx_cobid, tx_cobid):
        client = Sdo(rx_cobid, tx_cobid, self.object_dictionary)
        self.sdo_channels.append(client)
        return client

    def frames(self, cob_id):
        """A queue of what comes under an identifier from now on."""
        received = queue.Queue()
        self.network.subscribe(cob_id, lambda _id, data, _time: received.put(bytes(data)))
        return received
