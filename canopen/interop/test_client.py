"""A python-canopen LocalNode as the foreign slave that our master's side boots, configures and watches, over slcan on TCP.

`cargo xtask interop` runs it. By hand:

    cargo build -p omnibus-canopen --example sdo
    .venv/bin/python canopen/interop/test_client.py target/debug/examples/sdo

The node of python-canopen has no block transfers; that it refuses them is part of the test.
"""

import signal
import socket
import subprocess
import sys
import unittest

import canopen

from test_device import NODE, dictionary, free_port, wait_for_port

BINARY = "target/debug/examples/sdo"


class Client(unittest.TestCase):
    def setUp(self):
        port = free_port()
        self.start(port)
        wait_for_port(port)
        self.network = canopen.Network()
        channel = f"socket://127.0.0.1:{port}"
        self.network.connect(interface="slcan", channel=channel, sleep_after_open=0)
        self.node = self.network.create_node(NODE, dictionary())
        self.node.sdo[0x1018][1].raw = 0x11
        # No heartbeat until the master asks for one; python-canopen wants to read it when it boots.
        self.node.sdo[0x1017].raw = 0

    def start(self, port):
        self.process = subprocess.Popen(
            [BINARY, f"127.0.0.1:{port}", str(NODE)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.addCleanup(self.end, self.process)

    def end(self, process):
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()

    def tearDown(self):
        self.network.disconnect()

    def say(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def hear(self):
        return self.process.stdout.readline().strip()

    def ask(self, line):
        self.say(line)
        return self.hear()

    def test_expedited(self):
        self.assertEqual(self.ask("write 2000 0 3412"), "ok")
        self.assertEqual(self.node.sdo[0x2000].raw, 0x1234)
        self.assertEqual(self.ask("read 2000 0"), "3412")

    def test_segmented(self):
        for length in [5, 7, 8, 14, 100, 1022]:
            data = bytes((3 * i + length) & 0xFF for i in range(length))
            self.assertEqual(self.ask(f"write 2004 0 {data.hex()}"), "ok")
            self.assertEqual(bytes(self.node.sdo[0x2004].raw), data)
            self.assertEqual(self.ask("read 2004 0"), data.hex())

    def test_refusals(self):
        missing = "refused: 0x06020000 (object does not exist)"
        self.assertEqual(self.ask("read 2fff 0"), missing)
        self.assertEqual(self.ask("write 2fff 0 00"), missing)
        self.assertIn("refused: 0x0609", self.ask("read 1018 9"))

    def test_block_transfers_are_refused_and_the_next_transfer_is_not(self):
        self.assertIn("refused: 0x", self.ask("write-block 2004 0 " + "55" * 20))
        self.assertIn("refused: 0x", self.ask("read-block 2004 0"))
        self.assertEqual(self.ask("write 2000 0 0100"), "ok")

    def test_boot_configure_start_and_watch(self):
        # The slave is switched on: boot-up, then PRE-OPERATIONAL.
        self.say("state")
        self.node.nmt.send_command(129)
        self.node.nmt.send_command(128)
        self.assertEqual(self.hear(), "boot-up")
        # Who is it, and what must it know.
        self.assertEqual(self.ask("read 1018 1"), "11000000")
        self.assertEqual(self.ask("write 1017 0 6400"), "ok")
        self.assertEqual(self.ask("write 2000 0 3412"), "ok")
        blob = bytes(range(40))
        self.assertEqual(self.ask(f"write 2004 0 {blob.hex()}"), "ok")
        self.assertEqual(self.node.sdo[0x2000].raw, 0x1234)
        self.assertEqual(bytes(self.node.sdo[0x2004].raw), blob)
        self.assertEqual(self.ask("state"), "pre-operational")
        for command, state in [
            ("start", "operational"),
            ("stop", "stopped"),
            ("pre-operational", "pre-operational"),
            ("start", "operational"),
        ]:
            self.assertEqual(self.ask(f"nmt {command}"), "ok")
            # A heartbeat from before may still be on its way.
            said = next(filter(state.__eq__, (self.ask("state") for _ in range(20))), None)
            self.assertEqual(said, state)
        self.assertEqual(self.node.nmt.state, "OPERATIONAL")
        self.node.nmt.stop_heartbeat()
        said = next(filter("silent".__eq__, (self.ask("state") for _ in range(20))), None)
        self.assertEqual(said, "silent")

    def test_what_came_before_the_program_looked_is_heard(self):
        self.network.disconnect()
        self.process.kill()
        self.process.wait()
        port = free_port()
        self.start(port)
        wait_for_port(port)
        self.process.send_signal(signal.SIGSTOP)
        # A client that goes again, and one that sends a boot-up and stays.
        socket.create_connection(("127.0.0.1", port)).close()
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.sendall(f"t{0x700 + NODE:03X}100\r".encode())
            self.process.send_signal(signal.SIGCONT)
            self.assertEqual(self.ask("state"), "boot-up")

    def test_silence(self):
        self.network.disconnect()
        self.assertEqual(self.ask("read 1000 0"), "no answer in time")


if __name__ == "__main__":
    if len(sys.argv) > 1 and not sys.argv[1].startswith("-"):
        BINARY = sys.argv.pop(1)
    unittest.main()
