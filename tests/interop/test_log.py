"""Recorded sessions: cantools decodes them with docs/omnibus.dbc, tshark as CANopen.

One is a whole drive of three robots by the `omnibus` command (OMNIBUS), in virtual time. The others are what the
other tests here said on the bus; so this file comes last.
"""

import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import unittest

import cantools

from robot import ROOT

LINE = re.compile(r"\((\d+\.\d{6})\) can0 ([0-9A-F]{3})#((?:[0-9A-F]{2}){0,8})$")
LOGS = pathlib.Path(os.environ["OMNIBUS_LOGS"])
DRIVE = LOGS / "drive.log"
TSHARK_MISSING = "tshark is missing; Debian and Ubuntu: apt-get install tshark"


def frames(path):
    for line in path.read_text().splitlines():
        time, identifier, data = LINE.match(line).groups()
        yield float(time), int(identifier, 16), bytes.fromhex(data)


def setUpModule():
    follow = [os.environ["OMNIBUS"], "follow", "figure-eight", "--quick"]
    bus = ["--bus", f"sim:{ROOT / 'groups' / 'tcc-3.toml'}", "--candump", DRIVE]
    subprocess.run(follow + bus, check=True, stdout=subprocess.DEVNULL)


class Dbc(unittest.TestCase):
    def test_decodes_every_frame_of_a_drive_but_sdo_and_nmt(self):
        database = cantools.database.load_file(ROOT / "docs" / "omnibus.dbc")
        count, states = {}, set()
        for _, identifier, data in frames(DRIVE):
            if identifier == 0 or 0x580 <= identifier < 0x700:
                continue
            message = database.get_message_by_frame_id(identifier)
            self.assertEqual(message.length, len(data))
            values = message.decode(data)
            raw = message.decode(data, decode_choices=False, scaling=False)
            self.assertEqual(message.encode(raw, scaling=False), data)
            if "State" in values:
                states.add(str(values["State"]))
            count[identifier] = count.get(identifier, 0) + 1
        self.assertEqual(
            sorted(count),
            [0x080, 0x181, *(base + node for base in (0x180, 0x280, 0x380, 0x480) for node in (2, 3, 4))]
            + [0x701, 0x702, 0x703, 0x704],
        )
        self.assertLessEqual({"Armed", "Moving"}, states)
        print(f"cantools: {sum(count.values())} frames of {len(count)} identifiers decoded")

    def test_an_emergency_message_names_its_fault(self):
        database = cantools.database.load_file(ROOT / "docs" / "omnibus.dbc")
        message = database.get_message_by_frame_id(0x082)
        values = message.decode(bytes.fromhex("02FF810000000000"))
        self.assertEqual((str(values["Code"]), values["Error_register"]), ("SyncLost", 0x81))

    def test_a_twist_means_what_it_says(self):
        database = cantools.database.load_file(ROOT / "docs" / "omnibus.dbc")
        message = database.get_message_by_frame_id(0x181)
        values = message.decode(bytes.fromhex("E80318FC 3200 07 01".replace(" ", "")))
        self.assertAlmostEqual(values["vx"], 0.1)
        self.assertAlmostEqual(values["vy"], -0.1)
        self.assertAlmostEqual(values["omega"], 0.005)
        self.assertEqual((values["sequence"], values["group"]), (7, 1))

    def test_what_no_field_holds_is_refused_and_invalid_has_a_name(self):
        path = ROOT / "docs" / "omnibus.dbc"
        message = cantools.database.load_file(path, strict=True).get_message_by_frame_id(0x181)
        twist = {"vx": 3.2767, "vy": -3.2767, "omega": 0, "sequence": 7, "group": 1}
        encoded = message.encode(twist, strict=True)
        self.assertEqual(encoded, bytes.fromhex("FF7F 0180 0000 07 01".replace(" ", "")))
        with self.assertRaises(cantools.database.errors.EncodeError):
            message.encode(twist | {"vy": -3.3}, strict=True)
        self.assertEqual(message.decode(bytes.fromhex("0080000000000701"))["vx"], "Invalid")


@unittest.skipUnless(shutil.which("tshark"), TSHARK_MISSING)
class Tshark(unittest.TestCase):
    def test_no_frame_is_malformed(self):
        logs = sorted(LOGS.glob("*.log"))
        self.assertGreater(len(logs), 10)
        with tempfile.NamedTemporaryFile(mode="w", suffix=".log") as everything:
            sent = 0
            for log in logs:
                text = log.read_text()
                sent += text.count("\n")
                everything.write(text)
            everything.flush()
            tshark = ["tshark", "-r", everything.name, "-d", "can.subdissector,canopen", "-T", "fields"]
            fields = ["-e", "frame.number", "-e", "frame.protocols", "-e", "_ws.malformed", "-e", "can.id"]
            done = subprocess.run(tshark + fields, check=True, capture_output=True, text=True)
        rows = [line.split("\t") for line in done.stdout.splitlines()]
        self.assertEqual(len(rows), sent)
        self.assertEqual([row for row in rows if row[2] or "canopen" not in row[1]], [])
        print(f"tshark: {sent} frames of {len(logs)} sessions, none malformed")


if __name__ == "__main__":
    unittest.main()
