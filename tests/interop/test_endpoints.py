"""Every endpoint of `omnibus-sim serve` with software that nobody here wrote: python-can and python-canopen over slcan
on a TCP socket, slcan on a pseudo terminal, an emulated robot's own serial port, and socketcand; canplayer's format in and out; true poses.

SocketCAN itself needs a kernel that has it: see `tests/socketcan`.
"""

import json
import os
import pathlib
import queue
import signal
import socket
import subprocess
import tempfile
import time
import unittest

import can
import canopen

from robot import BACKEND, EDS, NODE, PATIENCE, ROOT

LOGS = pathlib.Path(os.environ["OMNIBUS_LOGS"])


class Served(unittest.TestCase):
    """One simulator with every endpoint; each test is one more program on its bus."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.pty = os.path.join(cls.folder.name, "can")
        arguments = [os.environ["OMNIBUS_SIM"], "serve", ROOT / "groups" / "single.toml", "--backend", BACKEND]
        arguments += ["--elf", os.environ["OMNIBUS_ELF"]] if BACKEND == "emulator" else []
        arguments += ["--slcan-tcp", "127.0.0.1:0", "--socketcand", "127.0.0.1:0", "--pty", cls.pty]
        cls.cable = os.path.join(cls.folder.name, "cable") if BACKEND == "emulator" else None
        arguments += ["--cable", cls.cable] if cls.cable else []
        arguments += ["--pose-tcp", "127.0.0.1:0", "--log", LOGS / f"{BACKEND}-endpoints.log"]
        cls.process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
        cls.at = {}
        while (line := cls.process.stdout.readline().split())[0] != "serving":
            cls.at[line[0]] = line[1]

    @classmethod
    def tearDownClass(cls):
        cls.process.send_signal(signal.SIGINT)
        cls.process.stdout.close()
        code = cls.process.wait(PATIENCE)
        left = os.listdir(cls.folder.name)
        cls.folder.cleanup()
        assert (code, left) == (0, []), (code, left)

    def buses(self):
        """How python-can is told of each endpoint."""
        host, port = self.at["socketcand"].split(":")
        cable = {"interface": "slcan", "channel": self.cable, "sleep_after_open": 0}
        return ({"cable": cable} if self.cable else {}) | {
            "slcan-tcp": {"interface": "slcan", "channel": f"socket://{self.at['slcan-tcp']}", "sleep_after_open": 0},
            "pty": {"interface": "slcan", "channel": self.pty, "sleep_after_open": 0},
            "socketcand": {"interface": "socketcand", "channel": "can0", "host": host, "port": int(port)},
        }

    def test_python_canopen(self):
        for name, bus in self.buses().items():
            with self.subTest(name):
                network = canopen.Network()
                network.connect(**bus)
                try:
                    node = network.add_node(NODE, str(EDS))
                    node.sdo.RESPONSE_TIMEOUT = PATIENCE
                    node.nmt.wait_for_heartbeat(PATIENCE)
                    self.assertEqual(node.sdo[0x1008].raw, "Omnibus robot")
                    node.sdo[0x2011][1].raw = -1.5
                    self.assertEqual(node.sdo[0x2011][1].raw, -1.5)
                    # `wait_for_bootup` forgets a message that came before it.
                    states = queue.SimpleQueue()
                    node.nmt.add_heartbeat_callback(states.put)
                    node.nmt.send_command(0x82)
                    while states.get(timeout=PATIENCE) != 0:
                        pass
                finally:
                    network.disconnect()

    def test_everybody_hears_everybody_but_himself(self):
        buses = {name: can.Bus(**bus) for name, bus in self.buses().items()}
        try:
            # What a robot is told by its port before it has booted is lost, so it is told again.
            if self.cable:
                until = time.monotonic() + PATIENCE
                while buses["cable"].recv(0.2) is None:
                    self.assertLess(time.monotonic(), until, "nothing comes over the cable")
                    buses["cable"].open()
            # socketcand's first frames wait a moment, so that the handshake is over.
            for n, bus in enumerate(buses.values()):
                bus.send(can.Message(arbitration_id=0x7E0 + n, data=range(n + 1), is_extended_id=False))
            for n, (name, bus) in enumerate(buses.items()):
                heard, until = {}, time.monotonic() + PATIENCE
                while len(heard) < len(buses) - 1 and time.monotonic() < until:
                    frame = bus.recv(PATIENCE)
                    if frame is not None and frame.arbitration_id >= 0x7E0:
                        heard[frame.arbitration_id] = bytes(frame.data)
                others = [m for m in range(len(buses)) if m != n]
                self.assertEqual(heard, {0x7E0 + m: bytes(range(m + 1)) for m in others}, name)
        finally:
            for bus in buses.values():
                bus.shutdown()

    def test_poses(self):
        with socket.create_connection(self.at["pose-tcp"].split(":"), PATIENCE) as stream:
            lines = stream.makefile()
            first, second = json.loads(lines.readline()), json.loads(lines.readline())
        self.assertAlmostEqual(second["t"] - first["t"], 0.01, delta=1e-9)
        self.assertEqual([robot["node"] for robot in first["robots"]], [NODE])
        self.assertEqual(set(first["group"]), {"x", "y", "heading"})


class Log(unittest.TestCase):
    def test_python_can_writes_what_is_replayed_and_reads_what_is_logged(self):
        """A log by python-can goes onto the bus; what the simulator logs, python-can reads: the same frames at the
        same times, each later by the time it takes on the wire. Error frames are in the log as candump has them."""
        with tempfile.TemporaryDirectory() as folder:
            played, logged = (pathlib.Path(folder) / name for name in ("played.log", "logged.log"))
            with can.CanutilsLogWriter(played) as writer:
                for n in range(20):
                    data = bytes([n] * (n % 9))
                    writer.on_message_received(
                        can.Message(1e9 + n / 100, arbitration_id=0x400 + n, data=data, is_extended_id=False, channel="can0")
                    )
            arguments = ["--speed", "max", "--duration", "0.3", "--replay", played, "--log", logged]
            arguments += ["--fault", "node=2:power-off", "--fault", "corrupt=1:id=0x405:t=0.0495:for=0.0007"]
            command = [os.environ["OMNIBUS_SIM"], "serve", ROOT / "groups" / "single.toml", *arguments]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            frames = list(can.CanutilsLogReader(logged))
        errors = [frame for frame in frames if frame.is_error_frame]
        frames = [frame for frame in frames if not frame.is_error_frame]
        self.assertEqual([f.arbitration_id for f in frames], list(range(0x400, 0x414)))
        self.assertEqual([bytes(f.data) for f in frames], [bytes([n] * (n % 9)) for n in range(20)])
        for n, frame in enumerate(frames):
            # 47 bits at least, 135 at most; frame 5 had to be sent again.
            late = frame.timestamp - n / 100
            self.assertLess(late, 0.0015 if n == 5 else 0.000136)
            self.assertGreater(late, 0.000043)
        self.assertGreater(len(errors), 0)
        self.assertTrue(all(0.0499 < frame.timestamp < 0.0505 for frame in errors))


if __name__ == "__main__":
    unittest.main()
