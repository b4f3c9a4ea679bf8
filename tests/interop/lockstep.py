"""python-canopen on a bus whose time waits for it: `omnibus-sim serve --lockstep`.

The timeouts of python-canopen are those of the clock on the wall. Here they are those of the simulated bus: whoever
waits for an answer lets the world go on until it comes or the time is over. So a test may have the timeouts of a
real client, and its result does not depend on how busy the machine is.
"""

import os
import pathlib
import queue
import signal
import socket
import subprocess
import unittest

import canopen
from canopen.sdo import SdoClient, SdoCommunicationError
from robot import BACKEND, EDS, NODE, PATIENCE, ROOT


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


class OneRobot(unittest.TestCase):
    """One simulated robot on such a bus, and a node of python-canopen for it."""

    def setUp(self):
        log = pathlib.Path(os.environ["OMNIBUS_LOGS"]) / f"{self.id()}.{BACKEND}.log"
        command = [os.environ["OMNIBUS_SIM"], "serve", ROOT / "groups" / "single.toml"]
        if BACKEND == "emulator":
            command += ["--backend", "emulator", "--elf", os.environ["OMNIBUS_ELF"]]
        command += ["--lockstep", "127.0.0.1:0", "--log", log]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.end)
        name, address = self.process.stdout.readline().split()
        self.assertEqual(name, "lockstep")
        self.network = Network(address)
        self.addCleanup(self.network.disconnect)
        self.node = Node(NODE, str(EDS))
        self.network.add_node(self.node)
        self.heartbeats = self.node.frames(0x700 + NODE)

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.stdout.close()
        self.assertEqual(self.process.wait(PATIENCE), 0)

    def pass_time(self, seconds):
        """Lets so many simulated seconds go by."""
        self.network.wait(lambda: False, seconds)
