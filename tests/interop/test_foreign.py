"""A python-canopen `LocalNode`, a device that nobody here wrote, on a bus with one of ours: `omnibus` finds and configures
both the same way."""

import os
import struct
import subprocess

import canopen

from robot import EDS, NODE, PATIENCE, Robot

FOREIGN = 9


class Foreign(Robot):
    def setUp(self):
        super().setUp()
        # A connection of its own: another place on the bus.
        self.elsewhere = canopen.Network()
        self.elsewhere.connect(interface="slcan", channel=self.channel, sleep_after_open=0)
        self.addCleanup(self.elsewhere.disconnect)
        self.foreign = self.elsewhere.create_node(FOREIGN, str(EDS))

    def omnibus(self, *arguments):
        bus = self.channel.replace("socket://", "slcan-tcp://")
        command = [os.environ["OMNIBUS"], *map(str, arguments), "--bus", bus, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
        return done.returncode, done.stdout + done.stderr

    def test_a_foreign_device_is_configured_like_one_of_ours(self):
        for number, node in enumerate([NODE, FOREIGN]):
            value = 0.25 + 0.125 * number
            code, text = self.omnibus("param", "set", "2010:1", value, "--node", node)
            self.assertEqual(code, 0, text)
            code, text = self.omnibus("param", "get", "2010:1", "--node", node)
            self.assertEqual(code, 0, text)
            self.assertIn(str(value), text)
        self.assertEqual(struct.unpack("<f", self.foreign.get_data(0x2010, 1)), (0.375,))
        self.assertEqual(self.node.sdo[0x2010][1].raw, 0.25)

    def test_what_a_foreign_device_refuses_is_told_with_its_code(self):
        self.foreign.add_write_callback(self.refuse)
        code, text = self.omnibus("param", "set", "2010:1", 0.5, "--node", FOREIGN)
        self.assertNotEqual(code, 0)
        self.assertIn("08000022", text.replace("0x", "").upper())

    def refuse(self, **_):
        raise canopen.SdoAbortedError(0x08000022)
