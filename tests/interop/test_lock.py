"""A client that has only the EDS and Python's own HMAC locks and unlocks a robot (object 0x2004).

The response is what docs/security.md says: HMAC-SHA-512 (RFC 2104) under the key of the challenge and one byte with the
node-ID. Times are those of the simulated bus (`lockstep.py`).
"""

import hashlib
import hmac
import unittest

import canopen
from lockstep import OneRobot
from robot import DEVICE_STATE, NODE

NO_KEY, LOCKED, UNLOCKED = 0, 1, 2
KEY = bytes(range(32))
REFUSED_BY_LOCK = 0x08000021
WRONG_RESPONSE = 0x06090030
NO_DATA = 0x08000024
HALF_TRACK = 0.25


class Lock(OneRobot):
    def setUp(self):
        super().setUp()
        self.node.sdo.RESPONSE_TIMEOUT = 3.0
        # No challenge is given in the first second after a start.
        self.pass_time(2.5)

    def state(self):
        return self.node.sdo[0x2004][1].raw

    def challenge(self):
        return self.node.sdo.upload(0x2004, 2)

    def respond(self, challenge, key=KEY, node=NODE):
        code = hmac.new(key, challenge + bytes([node]), hashlib.sha512).digest()
        self.node.sdo.download(0x2004, 3, code)

    def set_key(self, key):
        self.node.sdo.download(0x2004, 4, key)

    def refused(self, code, function, *arguments, **named):
        with self.assertRaises(canopen.SdoAbortedError) as context:
            function(*arguments, **named)
        self.assertEqual(context.exception.code, code, f"{context.exception}")

    def write(self):
        self.node.sdo[0x2010][1].raw = HALF_TRACK

    def lock(self):
        self.node.sdo[0x2004][1].raw = 1
        self.assertEqual(self.state(), LOCKED)

    def test_without_a_key_everything_may_be_written(self):
        self.assertEqual(self.state(), NO_KEY)
        self.refused(NO_DATA, self.challenge)
        self.write()
        self.assertEqual(self.node.sdo[0x2010][1].raw, HALF_TRACK)

    def test_parameters_store_and_update_are_guarded(self):
        self.set_key(KEY)
        self.assertEqual(self.state(), UNLOCKED)
        self.lock()
        before = self.node.sdo[0x2010][1].raw
        self.refused(REFUSED_BY_LOCK, self.write)
        self.refused(REFUSED_BY_LOCK, self.node.store)
        self.refused(REFUSED_BY_LOCK, self.set_key, bytes(32))
        for order in (0, 3, 1, 0x80):
            self.refused(REFUSED_BY_LOCK, self.node.sdo.download, 0x1F51, 1, bytes([order]))
        self.assertEqual(self.node.sdo[0x2010][1].raw, before)
        self.respond(self.challenge())
        self.assertEqual(self.state(), UNLOCKED)
        self.write()
        self.assertEqual(self.node.sdo[0x2010][1].raw, HALF_TRACK)

    def test_wrong_responses_bar_for_longer_each_time(self):
        self.set_key(KEY)
        self.lock()
        used = self.challenge()
        self.refused(WRONG_RESPONSE, self.respond, used, key=bytes(31) + b"\1")
        self.refused(DEVICE_STATE, self.respond, self.challenge())
        # A second, and at most one more that has begun.
        self.pass_time(2.2)
        self.refused(WRONG_RESPONSE, self.respond, used)
        self.pass_time(1.8)
        self.refused(DEVICE_STATE, self.respond, self.challenge())
        self.pass_time(1.4)
        self.refused(WRONG_RESPONSE, self.respond, self.challenge(), node=NODE + 1)
        self.pass_time(5.3)
        self.respond(self.challenge())
        self.assertEqual(self.state(), UNLOCKED)

    def test_a_reset_locks_and_a_key_of_zeros_ends_it(self):
        self.set_key(KEY)
        self.assertEqual(self.state(), UNLOCKED)
        while not self.heartbeats.empty():
            self.heartbeats.get()
        self.node.nmt.state = "RESET"
        self.assertTrue(self.network.wait(lambda: b"\0" in self.heartbeats.queue, 5.0))
        self.assertEqual(self.state(), LOCKED)
        self.refused(REFUSED_BY_LOCK, self.write)
        self.pass_time(2.5)
        self.respond(self.challenge())
        self.set_key(bytes(32))
        self.assertEqual(self.state(), NO_KEY)
        self.write()


if __name__ == "__main__":
    unittest.main()
