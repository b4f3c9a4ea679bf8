"""Recordings are read by Foxglove's own Python reader; what is in them is what was on the bus."""

import json
import os
import pathlib
import signal
import subprocess
import tempfile
import time
import unittest

import cantools
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from real_time import drives_in_real_time, in_real_time

ROOT = pathlib.Path(__file__).resolve().parents[2]
GROUP = ROOT / "groups" / "tcc-2.toml"
OMNIBUS = os.environ["OMNIBUS"]
PATIENCE = 60.0
# A drive of 2 s has this many SYNCs at 100 Hz, and more on the way there and back, where the master gets its turns.
SYNCS = 205


class Failed(AssertionError):
    """A command that did not do what it was told."""


def run(*arguments):
    """What a command prints."""
    done = subprocess.run([OMNIBUS, *map(str, arguments)], capture_output=True, text=True, timeout=PATIENCE)
    if done.returncode != 0:
        raise Failed(f"{arguments}: {done.stderr}")
    return done.stdout


def start(test, *command):
    """A program that ends with the test, however that ends."""
    process = subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, text=True)

    def end():
        process.kill()
        process.wait(PATIENCE)
        process.stdout.close()

    (test.addClassCleanup if isinstance(test, type) else test.addCleanup)(end)
    return process


def frames_of_log(path):
    frames = []
    for line in path.read_text().splitlines():
        identifier, data = line.split()[2].split("#")
        frames.append((int(identifier, 16), data))
    return frames


def messages(path, topic=None, in_file_order=False):
    """Every message of a recording, by time unless told otherwise."""
    with open(path, "rb") as file:
        found = make_reader(file).iter_messages(topics=[topic] if topic else None, log_time_order=not in_file_order)
        return [(channel.topic, schema, message, json.loads(message.data)) for schema, channel, message in found]


def frames(path):
    return [(value["id"], value["data"]) for *_, value in messages(path, "/can")]


@drives_in_real_time
class Recording(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        in_real_time(cls.record, "the recorded drive", cls.doClassCleanups)

    @classmethod
    def record(cls):
        """A group on a bus, a recorder that listens, one that is killed, and a master that records its drive."""
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.log = cls.folder / "bus.log"
        world = start(cls, os.environ["OMNIBUS_SIM"], "serve", GROUP, "--slcan-tcp", "127.0.0.1:0", "--log", cls.log)
        bus = ["--bus", f"slcan-tcp://{world.stdout.readline().split()[1]}", "--group", GROUP]
        listeners = [
            start(cls, OMNIBUS, "record", cls.folder / f"{name}.mcap", *bus, "--json") for name in ["heard", "killed"]
        ]
        time.sleep(0.5)
        run("drive", "--vx", 0.2, "--omega", 0.1, "--for", 2, *bus, "--record", cls.folder / "driven.mcap")
        listeners[1].kill()
        listeners[1].wait(PATIENCE)
        listeners[0].send_signal(signal.SIGINT)
        cls.summary = json.loads(listeners[0].communicate(timeout=PATIENCE)[0])
        world.send_signal(signal.SIGINT)
        world.communicate(timeout=PATIENCE)
        syncs = sum(identifier == 0x80 for identifier, _ in frames_of_log(cls.log))
        if syncs < SYNCS:
            raise Failed(f"the machine was too busy: {syncs} SYNCs in more than two seconds")

    def find(self, part, whole):
        """The place of a list in another, as a whole."""
        for at in range(len(whole) - len(part) + 1):
            if whole[at] == part[0] and whole[at : at + len(part)] == part:
                return at
        self.fail("these frames were not on the bus in this order")

    def test_every_frame_on_the_bus_is_there_once(self):
        heard = frames(self.folder / "heard.mcap")
        self.assertEqual(len(heard), self.summary["frames"])
        self.assertGreater(len(heard), 2000)
        self.find(heard, frames_of_log(self.log))

    def test_the_master_records_what_it_sends(self):
        driven = messages(self.folder / "driven.mcap", "/can")
        sent = [(v["id"], v["data"]) for *_, v in driven if v["sent"]]
        on_the_bus = [f for f in frames_of_log(self.log) if f[0] in (0, 0x80, 0x181, 0x701) or 0x601 <= f[0] <= 0x67F]
        self.assertEqual(len(sent), len(on_the_bus))
        self.assertEqual(sorted(sent), sorted(on_the_bus))

    def test_times_are_of_today_and_in_order(self):
        times = [message.log_time for _, _, message, _ in messages(self.folder / "heard.mcap", "/can")]
        self.assertLess(abs(times[-1] / 1e9 - time.time()), 600)
        self.assertEqual(times, sorted(times))

    def test_messages_fit_their_schemas(self):
        seen = set()
        for topic, schema, _, value in messages(self.folder / "heard.mcap"):
            self.assertEqual(schema.encoding, "jsonschema")
            self.fits(json.loads(schema.data), value, topic)
            seen.add((topic, schema.name))
        self.assertLessEqual(
            {
                ("/can", "omnibus.CanFrame"),
                ("/group", "omnibus.Group"),
                ("/robot/2", "omnibus.Robot"),
                ("/robot/3", "omnibus.Robot"),
                ("/events", "foxglove.Log"),
                ("/tf", "foxglove.FrameTransforms"),
            },
            seen,
        )

    def fits(self, schema, value, path):
        kinds = {"object": dict, "array": list, "string": str, "integer": int, "boolean": bool, "number": (int, float)}
        self.assertIsInstance(value, kinds[schema["type"]], path)
        if schema["type"] == "object":
            for name, inner in value.items():
                self.assertIn(name, schema["properties"], path)
                self.fits(schema["properties"][name], inner, f"{path}.{name}")
        elif schema["type"] == "array":
            for inner in value:
                self.fits(schema["items"], inner, path)

    def test_values_are_those_of_the_frames(self):
        """cantools decodes the raw frames with the DBC; what a robot's channel says of a SYNC period is what the last
        of its frames in that period said."""
        database = cantools.database.load_file(ROOT / "docs" / "omnibus.dbc")
        said, decoded = {}, {}
        period = None
        for topic, _, message, value in messages(self.folder / "heard.mcap", in_file_order=True):
            if topic == "/robot/3":
                said[message.log_time] = value.get("wheel_rates", {}).get("front_left")
            elif topic == "/can" and value["id"] == 0x80:
                period = message.log_time
                decoded[period] = None
            elif topic == "/can" and value["id"] == 0x483 and period is not None:
                signals = database.decode_message(0x483, bytes.fromhex(value["data"]))
                decoded[period] = next(iter(signals.values()))
        # The last period had not ended when the recorder did.
        del decoded[period]
        self.assertEqual(said.keys(), decoded.keys())
        known = [time for time, rate in decoded.items() if rate is not None]
        self.assertGreater(len(known), 100)
        self.assertGreater(max(decoded[time] for time in known), 1.0)
        for time, rate in decoded.items():
            if rate is None:
                self.assertIsNone(said[time])
            else:
                self.assertAlmostEqual(said[time], rate, delta=1e-4)

    def test_a_killed_recorder_leaves_a_file_up_to_its_last_second(self):
        # It gets its name when it is complete.
        path = self.folder / "killed.mcap.part"
        channels, read = {}, []
        with open(path, "rb") as file:
            try:
                for record in StreamReader(file).records:
                    if isinstance(record, Channel):
                        channels[record.id] = record.topic
                    elif isinstance(record, Message) and channels[record.channel_id] == "/can":
                        value = json.loads(record.data)
                        read.append((value["id"], value["data"]))
            except McapError:
                pass
        heard = frames(self.folder / "heard.mcap")
        self.assertGreater(len(read), len(heard) // 3)
        self.find(read, frames_of_log(self.log))
        # Ours reads as much, and says that there is an end missing.
        done = subprocess.run([OMNIBUS, "convert", path, "--to", "candump"], capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 0)
        self.assertIn("cut off", done.stderr)
        self.assertGreaterEqual(len(done.stdout.splitlines()), len(read))

    def test_converted_and_back(self):
        heard = self.folder / "heard.mcap"
        log = self.folder / "heard.log"
        run("convert", heard, "--to", "candump", "--output", log)
        self.assertEqual(frames_of_log(log), frames(heard))
        again = self.folder / "again.mcap"
        run("convert", log, "--to", "mcap", "--output", again, "--group", GROUP)
        self.assertEqual(frames(again), frames(heard))
        table = run("convert", again, "--to", "csv").splitlines()
        names = table[0].split(",")
        self.assertIn("node3.front_left", names)
        self.assertTrue(all(len(row.split(",")) == len(names) for row in table))
        # One row for every SYNC that was answered by another.
        syncs = sum(identifier == 0x80 for identifier, _ in frames(heard))
        self.assertEqual(len(table) - 1, syncs - 1)

    def test_a_replay_only_moves_robots_when_it_is_told_to(self):
        driven = self.folder / "driven.mcap"
        log = self.folder / "replay.log"
        world = start(self, os.environ["OMNIBUS_SIM"], "serve", GROUP, "--slcan-tcp", "127.0.0.1:0", "--log", log)
        bus = ["--bus", f"slcan-tcp://{world.stdout.readline().split()[1]}"]
        shown = json.loads(run("replay", driven, *bus, "--json"))
        self.assertEqual(shown["sent"], 0)
        sent = json.loads(run("replay", driven, *bus, "--json", "--drive"))
        self.assertEqual(sent["sent"], shown["frames"])
        world.send_signal(signal.SIGINT)
        world.communicate(timeout=PATIENCE)
        ours = [(v["id"], v["data"]) for *_, v in messages(driven, "/can") if v["sent"]]
        on_the_bus = [f for f in frames_of_log(log) if f in set(ours)]
        self.assertGreaterEqual(len(on_the_bus), len(ours))
        # The robots did move: a measured forward velocity of more than 0.1 m/s.
        fastest = max(int.from_bytes(bytes.fromhex(d)[:2], "little", signed=True) for i, d in frames_of_log(log) if i == 0x282)
        self.assertGreater(fastest, 1000)

    def test_pictures_and_the_page_of_a_recording(self):
        heard = self.folder / "heard.mcap"
        made = json.loads(run("plot", heard, "--json"))
        png = (self.folder / "heard.png").read_bytes()
        self.assertEqual(png[:8], b"\x89PNG\r\n\x1a\n")
        self.assertEqual(int.from_bytes(png[16:20], "big"), 2 * made["width"])
        self.assertIn("<svg", (self.folder / "heard.svg").read_text())
        figures = json.loads(run("report", heard, "--json"))
        self.assertEqual(figures["frames"], self.summary["frames"])
        self.assertEqual(figures["nodes"], [2, 3])
        self.assertEqual(figures["faults"], 0)
        # 0.2 m/s for 2 s, less one ramp up and one down of some 0.1 s together.
        self.assertAlmostEqual(figures["path_m"], 0.4, delta=0.05)
        page = (self.folder / "heard.html").read_text()
        self.assertNotIn("<script src", page)
        self.assertGreaterEqual(page.count("<svg"), 9)


if __name__ == "__main__":
    unittest.main()
