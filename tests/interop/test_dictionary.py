"""Every object of docs/omnibus.eds, read from a robot and compared; every limit tried from both sides."""

import math
import pathlib
import struct
import subprocess
import sys
import unittest

import canopen
from canopen.objectdictionary import ODArray
from canopen.objectdictionary import datatypes as t

from robot import (
    DEVICE_STATE,
    EDS,
    NODE,
    READ_ONLY,
    Robot,
    compensation_set,
    eds_sections,
    section,
    variables,
    WRITE_ONLY,
)

TOO_HIGH, TOO_LOW, NOT_A_NUMBER = 0x06090031, 0x06090032, 0x06090030
NOT_STORED = 0x08000020
TOO_LONG, TOO_SHORT, LENGTH = 0x06070012, 0x06070013, 0x06070010
CHALLENGE, RESPONSE, KEY = (0x2004, 2), (0x2004, 3), (0x2004, 4)
OFF = {(0x1804, 3), (0x1804, 6), (0x1A04, 0)}
BYTES = {
    t.UNSIGNED8: 1,
    t.UNSIGNED16: 2,
    t.UNSIGNED32: 4,
    t.INTEGER16: 2,
    t.INTEGER24: 3,
    t.REAL32: 4,
}


def number(text):
    """A number of the EDS as an integer or a 32-bit float."""
    return int(text.replace("$NODEID+", ""), 0) + (NODE if "$NODEID" in text else 0)


def real(text):
    return struct.unpack("<f", struct.pack("<f", float(text)))[0]


def encode(variable, value):
    if variable.data_type == t.REAL32:
        return struct.pack("<f", value)
    return value.to_bytes(BYTES[variable.data_type], "little")


def beyond(variable, value, step):
    """The next value that the type can hold, or nothing."""
    if variable.data_type != t.REAL32:
        return value + step if 0 <= value + step < 1 << (8 * BYTES[variable.data_type]) else None
    if value == 0.0:
        return step * 2.0**-149
    bits = struct.unpack("<i", struct.pack("<f", value))[0]
    return struct.unpack("<f", struct.pack("<i", bits + (step if value > 0 else -step)))[0]


class Dictionary(Robot):
    def setUp(self):
        super().setUp()
        self.all = [(v, eds_sections[section(v)]) for v in variables(self.node.object_dictionary)]
        self.parameters = [(v, s) for v, s in self.all if "LowLimit" in s]
        # A dictionary that lost half of its objects would pass all the rest.
        self.assertGreater(len(self.all), 250)
        self.assertGreater(len(self.parameters), 50)

    def upload(self, variable):
        return self.node.sdo.upload(variable.index, variable.subindex)

    def download(self, variable, data):
        self.node.sdo.download(variable.index, variable.subindex, data)

    def test_type_and_default(self):
        for variable, entry in self.all:
            with self.subTest(section=entry.name):
                if variable.index == 0x1003 and variable.subindex > 0:
                    # CiA 301: an entry of the error history that is not there.
                    self.refused(0x08000024, self.upload, variable)
                    continue
                if entry["AccessType"] == "wo":
                    self.refused(WRITE_ONLY, self.upload, variable)
                    continue
                if (variable.index, variable.subindex) == CHALLENGE:
                    self.has_no_challenge(self.upload, variable)
                    continue
                data = self.upload(variable)
                default = entry["DefaultValue"]
                if variable.data_type == t.DOMAIN:
                    # The compensation set, and the stored faults, of which there are none.
                    self.assertEqual(data, compensation_set(0) if variable.index == 0x2013 else b"")
                    continue
                if variable.data_type == t.VISIBLE_STRING:
                    self.assertEqual(data.decode(), default)
                    continue
                self.assertEqual(len(data), BYTES[variable.data_type])
                if default and variable.data_type == t.REAL32:
                    self.assertEqual(struct.unpack("<f", data)[0], real(default))
                elif default:
                    self.assertEqual(int.from_bytes(data, "little"), number(default))

    def has_no_challenge(self, action, *arguments):
        """A robot without a key; in its first second it does not say which."""
        with self.assertRaises(canopen.SdoAbortedError) as raised:
            action(*arguments)
        self.assertIn(raised.exception.code, (DEVICE_STATE, 0x08000024))

    def test_identity(self):
        device = eds_sections["DeviceInfo"]
        identity = [device[name] for name in ("VendorNumber", "ProductNumber", "RevisionNumber")]
        of_robot = [self.node.sdo[0x1018][sub].raw for sub in (1, 2, 3)]
        self.assertEqual([number(text) for text in identity], of_robot)

    def test_access(self):
        for variable, entry in self.all:
            with self.subTest(section=entry.name):
                if variable.index == 0x1003 and variable.subindex > 0:
                    self.refused(READ_ONLY, self.download, variable, bytes(4))
                    continue
                if (variable.index, variable.subindex) == RESPONSE:
                    self.has_no_challenge(self.download, variable, bytes(64))
                    continue
                if (variable.index, variable.subindex) == KEY:
                    self.refused(LENGTH, self.download, variable, bytes(4))
                    continue
                if entry["AccessType"] == "wo":
                    # The image of an update, which nobody has prepared.
                    self.refused(DEVICE_STATE, self.download, variable, bytes(4))
                    continue
                if (variable.index, variable.subindex) == CHALLENGE:
                    self.refused(READ_ONLY, self.download, variable, bytes(64))
                    continue
                data = self.upload(variable)
                if entry["AccessType"] in ("ro", "const"):
                    self.refused(READ_ONLY, self.download, variable, data)
                elif (variable.index, variable.subindex) in OFF:
                    # TPDO5 is switched off where there is no gyro.
                    self.download(variable, data)
                elif 0x1600 <= variable.index < 0x1800 or 0x1A00 <= variable.index < 0x1C00:
                    # Writable, but only while the PDO is switched off: `test_robot.py`.
                    self.refused(0x06010000, self.download, variable, data)
                elif 0x1800 <= variable.index < 0x1A00 and variable.subindex in (3, 6):
                    # Inhibit time and SYNC start value, the same.
                    self.refused(DEVICE_STATE, self.download, variable, data)
                elif variable.index in (0x1010, 0x1011):
                    # Reads as what it can do; takes the signature only: `test_robot.py`.
                    self.refused(NOT_STORED, self.download, variable, data)
                elif variable.index == 0x2004:
                    # The lock, which takes only 1.
                    self.refused(NOT_A_NUMBER, self.download, variable, data)
                elif variable.index in (0x2100, 0x2101):
                    # A setpoint: written, not kept.
                    self.download(variable, data)
                else:
                    self.download(variable, data)
                    self.assertEqual(self.upload(variable), data)

    def test_limits_from_both_sides(self):
        for variable, entry in self.parameters:
            with self.subTest(section=entry.name):
                convert = real if variable.data_type == t.REAL32 else number
                before = self.upload(variable)
                low, high = entry["LowLimit"], entry["HighLimit"]
                for text, step, code in [(low, -1, TOO_LOW), (high, 1, TOO_HIGH)]:
                    limit = convert(text)
                    self.download(variable, encode(variable, limit))
                    self.assertEqual(self.upload(variable), encode(variable, limit))
                    outside = beyond(variable, limit, step)
                    if outside is not None:
                        self.refused(code, self.download, variable, encode(variable, outside))
                        self.assertEqual(self.upload(variable), encode(variable, limit))
                self.download(variable, before)
                if variable.data_type == t.REAL32:
                    for value in [math.nan, math.inf, -math.inf]:
                        data = struct.pack("<f", value)
                        self.refused(NOT_A_NUMBER, self.download, variable, data)
                self.refused(TOO_LONG, self.download, variable, before + b"\0")
                if len(before) > 1:
                    self.refused(TOO_SHORT, self.download, variable, before[:-1])
                self.assertEqual(self.upload(variable), before)

    def test_parameters_are_refused_while_operational(self):
        self.configure()
        self.enter("OPERATIONAL")
        for variable, entry in self.parameters:
            with self.subTest(section=entry.name):
                data = self.upload(variable)
                self.refused(DEVICE_STATE, self.download, variable, data)

    def test_arrays_of_the_standard_are_arrays(self):
        for index in (0x1003, 0x1010, 0x1011, 0x1016, 0x1029):
            kind = type(self.node.object_dictionary[index])
            self.assertIs(kind, ODArray, f"{index:04X}")

    def test_strict_readers_find_nothing(self):
        """Lely's checker, whose readers take a REAL32 as the integer with the same bits."""
        checker = pathlib.Path(sys.executable).with_name("dcfchk")
        done = subprocess.run([checker, "-n", str(NODE), EDS], capture_output=True, text=True)
        self.assertEqual((done.returncode, done.stdout + done.stderr), (0, ""))

    def test_the_eds_names_all_there_is(self):
        named = set(self.node.object_dictionary)
        for first, last in [
            (0x1000, 0x1030),
            (0x1200, 0x1210),
            (0x1280, 0x1290),
            (0x1400, 0x1410),
            (0x1600, 0x1610),
            (0x1800, 0x1810),
            (0x1A00, 0x1A10),
            (0x1F50, 0x1F90),
            (0x2000, 0x2200),
        ]:
            for index in sorted(set(range(first, last)) - named):
                with self.subTest(index=f"{index:04X}"):
                    self.refused(0x06020000, self.node.sdo.upload, index, 0)


if __name__ == "__main__":
    unittest.main()
