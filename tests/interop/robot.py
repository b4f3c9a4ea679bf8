"""One simulated robot on a bus of its own, and python-canopen as its master.

Every test starts its own world and ends it with the log complete. The environment says which: OMNIBUS_SIM is the
simulator, OMNIBUS_BACKEND what the robot is (native, emulator), OMNIBUS_ELF the release image, OMNIBUS_LOGS where
the candump logs go. With OMNIBUS_CABLE the master is at the emulated robot's own serial port instead of an adapter
on its bus. `cargo xtask interop` sets them.

The simulated time never runs faster than the clock on the wall, and on a busy machine slower. So nobody here measures
time: a test waits for a frame, long, or proves silence by a later answer on the same bus.
"""

import configparser
import os
import pathlib
import queue
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import zlib

import canopen

ROOT = pathlib.Path(__file__).resolve().parents[2]
EDS = ROOT / "docs" / "omnibus.eds"
BACKEND = os.environ.get("OMNIBUS_BACKEND", "native")
CABLE = "OMNIBUS_CABLE" in os.environ
NODE = 2
GROUP = 1
PATIENCE = 30.0
"""Seconds to wait for what must come."""

WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
DEVICE_STATE = 0x08000022


def eds():
    """The sections of the EDS, for what python-canopen does not keep; with limits and defaults of the reals, which
    are comments in it."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str
    parser.read_string(EDS.read_text().replace("\n;", "\n"))
    return parser


def section(variable):
    """The EDS section of a python-canopen variable."""
    whole = f"{variable.index:04X}"
    sub = f"{whole}sub{variable.subindex:X}"
    return sub if eds_sections.has_section(sub) else whole


eds_sections = eds()


def variables(od):
    """Every variable of an object dictionary, sub-indices and all, without the dummies of the data types."""
    for entry in (entry for entry in od.values() if entry.index >= 0x1000):
        yield from [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else entry.values()


class Robot(unittest.TestCase):
    def setUp(self):
        kind = "cable" if CABLE else BACKEND
        log = pathlib.Path(os.environ["OMNIBUS_LOGS"]) / f"{kind}-{self.id()}.log"
        arguments = [os.environ["OMNIBUS_SIM"], "serve", ROOT / "groups" / "single.toml"]
        arguments += ["--backend", BACKEND, "--slcan-tcp", "127.0.0.1:0", "--log", log]
        if BACKEND == "emulator":
            arguments += ["--elf", os.environ["OMNIBUS_ELF"]]
        if CABLE:
            folder = tempfile.TemporaryDirectory()
            self.addCleanup(folder.cleanup)
            cable = os.path.join(folder.name, "cable")
            arguments += ["--cable", cable]
        # What happens to the robot from outside comes as lines on its standard input.
        arguments += ["--fault", "-"]
        self.notes = tempfile.TemporaryFile("w+")
        self.process = subprocess.Popen(
            arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.notes, text=True
        )
        self.addCleanup(self.end)
        name, address = self.process.stdout.readline().split()
        self.assertEqual(name, "slcan-tcp")
        self.network = canopen.Network()
        self.channel = f"socket://{address}"
        if CABLE:
            while not os.path.exists(cable):
                self.process.stdout.readline()
            self.channel = cable
        self.network.connect(interface="slcan", channel=self.channel, sleep_after_open=0)
        self.addCleanup(self.network.disconnect)
        self.node = self.network.add_node(NODE, str(EDS))
        self.node.sdo.RESPONSE_TIMEOUT = PATIENCE
        # Of the library; with 0 a request that is never answered is repeated for ever.
        self.node.sdo.MAX_RETRIES = 1
        if CABLE:
            self.open_cable(self.frames(0x700 + NODE))
        self.node.nmt.wait_for_heartbeat(PATIENCE)

    def open_cable(self, heartbeats):
        """Opens the channel of a robot that may not have booted yet, until it is heard."""
        for _ in range(int(PATIENCE / 0.1)):
            self.network.bus.open()
            try:
                while heartbeats.get(timeout=0.1) != b"\x7f":
                    pass
                return
            except queue.Empty:
                pass
        self.fail("no heartbeat at the cable")

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.stdout.close()
        self.process.stdin.close()
        self.assertEqual(self.process.wait(PATIENCE), 0)
        sys.stderr.write(self.said())
        self.notes.close()

    def said(self):
        """What the simulator has written to its standard error."""
        return os.pread(self.notes.fileno(), 1 << 20, 0).decode()

    def frames(self, cob_id):
        """A queue of what comes under an identifier from now on."""
        received = queue.Queue()
        self.network.subscribe(cob_id, lambda _id, data, _time: received.put(bytes(data)))
        return received

    def barrier(self):
        """What the robot sent in answer to anything before is here when this returns."""
        self.node.sdo.upload(0x1000, 0)

    def enter(self, state):
        """Brings the robot into an NMT state and waits until it says so."""
        heartbeats = self.frames(0x700 + NODE)
        self.node.nmt.state = state
        code = {"STOPPED": 4, "OPERATIONAL": 5, "PRE-OPERATIONAL": 127}[state]
        while heartbeats.get(timeout=PATIENCE) != bytes([code]):
            pass

    def power_cycle(self, node=NODE):
        """Takes the robot its power and gives it back; it boots as this node."""
        cycles, deadline = self.said().count("power-cycle"), time.monotonic() + PATIENCE
        heartbeats = self.frames(0x700 + node)
        self.process.stdin.write(f"node={NODE}:power-cycle\n")
        self.process.stdin.flush()
        if CABLE:
            # The adapter is switched off, too, so its channel is opened after that, and the boot-up is not for us.
            while self.said().count("power-cycle") == cycles:
                self.assertLess(time.monotonic(), deadline, "no power cycle")
                time.sleep(0.001)
            return self.open_cable(self.frames(0x700 + node))
        while heartbeats.get(timeout=PATIENCE) != b"\0":
            pass
        self.assertEqual(heartbeats.get(timeout=PATIENCE), b"\x7f")

    def refused(self, code, action, *arguments):
        with self.assertRaises(canopen.SdoAbortedError) as raised:
            action(*arguments)
        self.assertEqual(f"{raised.exception.code:08X}", f"{code:08X}")

    def emergency(self, code):
        """The next emergency message with this code, be it here already or not."""
        # The library's own `wait` takes only what comes after it was called.
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            while self.node.emcy.log:
                if self.node.emcy.log.pop(0).code == code:
                    return
            time.sleep(0.001)
        self.fail(f"no emergency 0x{code:04X}")

    def configure(self):
        """Writes every parameter: the default of the EDS, but for the group and the loops' gains."""
        for variable in variables(self.node.object_dictionary):
            if 0x2010 <= variable.index <= 0x204F and variable.writable:
                if variable.data_type == canopen.objectdictionary.datatypes.DOMAIN:
                    continue
                value = eds_sections[section(variable)]["DefaultValue"]
                is_real = variable.data_type == canopen.objectdictionary.datatypes.REAL32
                data = variable.encode_raw(float(value) if is_real else int(value, 0))
                self.node.sdo.download(variable.index, variable.subindex, data)
        # Without gains nothing turns a wheel, and the robot refuses that.
        for wheel in range(0x2021, 0x2025):
            self.node.sdo[wheel][2].raw = 1.2  # V s/rad
            self.node.sdo[wheel][4].raw = 2.0  # V s/rad
        self.node.sdo[0x2040][1].raw = GROUP
        self.assertEqual(f"{self.node.sdo[0x2002][1].raw:08X}", "00000000")


def compensation_set(version, longitudinal=(), lateral=(), oblique=(), yaw=()):
    """The bytes of object 0x2013:1; rows of speed in m/s or rad/s and one coefficient, two where oblique."""
    tables = (longitudinal, lateral, oblique, yaw)
    content = version.to_bytes(4, "little") + bytes([1, *map(len, tables)])
    for speed, *coefficients in (row for table in tables for row in table):
        content += round(speed * 10_000).to_bytes(2, "little")
        for coefficient in coefficients:
            content += round(coefficient * 32_768).to_bytes(2, "little")
    return zlib.crc32(content).to_bytes(4, "little") + content


def twist(sequence, vx=0, vy=0, omega=0):
    """A group twist; velocities in 0.0001 m/s and rad/s."""
    fields = [value.to_bytes(2, "little", signed=True) for value in (vx, vy, omega)]
    return b"".join(fields) + bytes([sequence & 0xFF, GROUP])
