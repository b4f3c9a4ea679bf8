"""A client of CiA 302-3 that knows nothing of Omnibus updates an emulated robot.

The order of its requests is that of Zephyr's `west flash --runner canopen`: flash status and identification,
PRE-OPERATIONAL, stop, clear, the download, start, the boot-up message, confirm. Between them it asks for the flash
status, without a pause, until that is 0. Its timeouts are those of the simulated time (`lockstep.py`).

OMNIBUS_IMAGE is the image file; what the robot is sent lies beside it.
"""

import os
import pathlib
import unittest

from lockstep import OneRobot

STOP, START, CLEAR, CONFIRM = 0, 1, 3, 0x80
ON_TRIAL = 0x80
PRE_OPERATIONAL = 127
WAIT = 30.0
"""Simulated seconds for what is not an answer."""


class Update(OneRobot):
    def control(self, value):
        self.node.sdo[0x1F51][1].raw = value

    def status(self):
        return self.node.sdo[0x1F57][1].raw

    def identification(self):
        return self.node.sdo[0x1F56][1].raw

    def wait_for_status(self):
        end = self.network.now + WAIT * 1e6
        polls = 1
        while (status := self.status()) != 0:
            self.assertEqual(status, 1, "busy, and no error")
            self.assertLess(self.network.now, end)
            polls += 1
        return polls

    def wait_for(self, heartbeat):
        while self.heartbeats.empty() or self.heartbeats.get() != heartbeat:
            self.assertTrue(self.network.wait(lambda: not self.heartbeats.empty(), WAIT))

    def update(self, timeout, block):
        self.node.sdo.RESPONSE_TIMEOUT = timeout
        self.assertEqual(self.status(), 0)
        old = self.identification()
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.control(STOP)
        self.control(CLEAR)
        self.wait_for_status()
        slot = {1: "slot-a", 2: "slot-b"}[self.node.sdo[0x2003][2].raw]
        image = pathlib.Path(f"{os.environ['OMNIBUS_IMAGE']}.{slot}").read_bytes()
        program = self.node.sdo[0x1F50][1].open(
            "wb", buffering=1024, size=len(image), block_transfer=block
        )
        with program:
            program.write(image)
        self.wait_for_status()
        new = self.identification()
        self.assertNotEqual(new, old)
        while not self.heartbeats.empty():
            self.heartbeats.get()
        self.control(START)
        self.wait_for(b"\0")
        self.assertEqual(self.identification(), new)
        self.assertEqual(self.node.sdo[0x1F51][1].raw, ON_TRIAL)
        self.control(CONFIRM)
        self.wait_for_status()
        self.assertEqual(self.node.sdo[0x1F51][1].raw, START)
        self.assertEqual(f"slot-{'-ab'[self.node.sdo[0x2003][1].raw]}", slot)

    def test_segmented(self):
        self.update(3.0, block=False)

    def test_in_blocks(self):
        self.update(3.0, block=True)

    def test_segmented_with_the_time_out_of_west(self):
        self.update(1.0, block=False)

    def test_in_blocks_with_the_time_out_of_west(self):
        self.update(1.0, block=True)

    def test_in_blocks_with_the_default_time_out_of_python_canopen(self):
        self.update(0.3, block=True)

    def test_segmented_with_the_default_time_out_of_python_canopen(self):
        self.update(0.3, block=False)


if __name__ == "__main__":
    unittest.main()
