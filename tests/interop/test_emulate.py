"""`omnibus-sim emulate` with software that nobody here wrote: gdb-multiarch at its port, and its trace read by pyvcd.

The robot of the trace is driven by a recorded master, so every number in it can be worked out beforehand.
"""

import math
import os
import pathlib
import re
import signal
import subprocess
import tempfile
import tomllib
import unittest

from vcd.reader import TokenKind, tokenize

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIM, ELF, OMNIBUS = (os.environ[name] for name in ("OMNIBUS_SIM", "OMNIBUS_ELF", "OMNIBUS"))
SINGLE = ROOT / "groups" / "single.toml"
PATIENCE = 300
SPEED = 0.2
"""m/s"""


class Gdb(unittest.TestCase):
    def test_a_session(self):
        process = subprocess.Popen([SIM, "emulate", ELF, "--gdb", "0"], stdout=subprocess.PIPE, text=True)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        address = process.stdout.readline().removeprefix("gdb ").strip()
        commands = [
            "set confirm off", "set pagination off", "set language c",
            f"target remote {address}",
            "info registers sp pc", "x/2xw 0x08000000",
            "break main", "continue", "backtrace", "step", "info breakpoints", "delete",
            "set {int}0x20000200 = 0x12345678", "x/xw 0x20000200", "x/xw 0x40023800",
            "print $pc", "stepi", "print $pc",
            "watch *(unsigned int *)((char *)&_SEGGER_RTT + 36)", "continue", "backtrace", "delete",
            "monitor time", "monitor reset", "maintenance flush register-cache", "info registers pc", "detach",
        ]  # fmt: skip
        script = [word for command in commands for word in ("-ex", command)]
        gdb = subprocess.run(
            ["gdb-multiarch", "-nx", "-batch", *script, ELF],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=PATIENCE,
        )  # fmt: skip
        said = gdb.stdout
        self.assertEqual(gdb.returncode, 0, said)
        for wanted in (
            # Registers and memory at the first instruction: what the vector table says.
            # That is the boot code's.
            r"sp +0x([0-9a-f]+) [^$]*?pc +0x[0-9a-f]+ +0x[0-9a-f]+ <\S*boot_code\S*>[^$]*?0x8000000[^\t]*\t0x\1\t",
            # A breakpoint by name, with its source line, and what called it.
            r"Breakpoint 1, .*main.* at src/main\.rs:\d+\n",
            r"\n#0 +.*main.* at src/main\.rs:\d+\n",
            r"breakpoint already hit 1 time\n",
            r"0x20000200\S*\t0x12345678\n",
            # RCC_CR with HSI on, ready, trimmed to 16 (RM0390 6.3.1).
            r"0x40023800:\t0x0000..83\n",
            # A variable's change, found where defmt writes its first message, perhaps in a piece
            # of it that the linker shares between functions.
            r"Hardware watchpoint 2: [^$]*?Old value = 0\nNew value = \d+\n[^$]*?\n#[01] .*defmt",
            r"\n0\.00\d+ s\n",
            r"\nreset\n[^$]*?pc +0x[0-9a-f]+ +0x[0-9a-f]+ <\S*boot_code\S*>",
        ):
            self.assertRegex(said, wanted)
        before, after = (int(at, 16) for at in re.findall(r"\$\d = .*?(0x[0-9a-f]+) <", said))
        self.assertNotEqual(before, after)
        # The debugger has left: the robot goes on, and boots.
        while "reset: " not in (line := process.stdout.readline()):
            self.assertNotEqual(line, "", "the robot has ended")
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        self.assertEqual(process.wait(PATIENCE), 0)


class Trace(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with tempfile.TemporaryDirectory() as folder:
            recording, log, master, trace, frames = (
                os.path.join(folder, name) for name in ("run.mcap", "run.log", "master.log", "run.vcd", "frames.log")
            )
            quiet = {"check": True, "stdout": subprocess.DEVNULL, "timeout": PATIENCE}
            drive = ["drive", "-q", "--bus", f"sim:{SINGLE}", "--backend", "emulator", "--elf", ELF]
            subprocess.run([OMNIBUS, *drive, "--vx", str(SPEED), "--for", "0.8", "--record", recording], **quiet)
            subprocess.run([OMNIBUS, "convert", "-q", recording, "--to", "candump", "--output", log], **quiet)
            robots = {f"{base + 2:03X}" for base in (0x80, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)}
            with open(log) as lines, open(master, "w") as kept:
                # A log is played from its first frame on, which here is to be at power-on.
                kept.write("(0.000000) can0 7FF#\n")
                kept.writelines(line for line in lines if line.split()[2][:3] not in robots)
            play = ["--replay", master, "--trace", trace, "--log", frames]
            subprocess.run([SIM, "emulate", ELF, *play, "--speed", "max", "--duration", "1.1"], **quiet)
            cls.frames = [line.split() for line in pathlib.Path(frames).read_text().splitlines()]
            cls.signals, names, now = {}, {}, 0
            with open(trace, "rb") as file:
                for token in tokenize(file):
                    match token.kind:
                        case TokenKind.TIMESCALE:
                            cls.scale = (token.timescale.magnitude, token.timescale.unit.value)
                        case TokenKind.VAR:
                            names[token.var.id_code] = token.var.reference
                            cls.signals[token.var.reference] = []
                        case TokenKind.CHANGE_TIME:
                            now = token.time_change
                        case TokenKind.CHANGE_SCALAR | TokenKind.CHANGE_VECTOR | TokenKind.CHANGE_REAL | TokenKind.CHANGE_STRING:
                            change = token.data
                            cls.signals[names[change.id_code]].append((now, change.value))
        robot = tomllib.loads(SINGLE.read_text())["robot"]
        cls.counts = robot["encoder"]["counts_per_revolution"]
        # What compensation adds is what the table plant takes away, in the mean (groups/single.toml).
        cls.rate = SPEED / robot["wheel_radius"] * robot["compensation"]["longitudinal"]
        motor = robot["motor"]
        ampere = (motor["friction"] + motor["viscous"] * cls.rate) / motor["constant"]
        cls.duty = (motor["constant"] * cls.rate + motor["resistance"] * ampere) / motor["supply"]

    def at(self, name, time_ns):
        """What a signal is at a time."""
        return [value for at, value in self.signals[name] if at <= time_ns][-1]

    def mean(self, name, begin_ns, end_ns):
        times = [begin_ns, *(at for at, _ in self.signals[name] if begin_ns < at < end_ns), end_ns]
        spans = zip(times, times[1:])
        return sum((end - begin) * self.at(name, begin) for begin, end in spans) / (end_ns - begin_ns)

    def test_wheels_turn_and_are_driven_as_a_steady_motor_is(self):
        """From 0.6 to 1.0 s the speed is constant: counts by the wheel's radius, duty by the motor's equation."""
        self.assertEqual(self.scale, (1, "ns"))
        for wheel in ("front_left", "front_right", "rear_left", "rear_right"):
            counts = self.at(f"encoder_{wheel}", 10**9) - self.at(f"encoder_{wheel}", 6 * 10**8)
            # A count at either end.
            self.assertAlmostEqual(counts, 0.4 * self.rate / math.tau * self.counts, delta=2 + counts * 1e-3)
            self.assertEqual(self.at(f"pwm_{wheel}_driven", 8 * 10**8), "1")
            # The duty's steps are one in 4500, and the loop goes to and fro between two of them.
            self.assertAlmostEqual(self.mean(f"pwm_{wheel}_duty", 6 * 10**8, 10**9), self.duty, delta=1 / 4500)
            self.assertEqual(self.at(f"direction_{wheel}", 8 * 10**8), "1")
            self.assertEqual(self.at(f"pwm_{wheel}_duty", 15 * 10**7), 0)

    def test_pins_of_the_drivers(self):
        """Low from the first instructions on; then they follow the state of the robot, which the master has operational
        from 0.18 s on."""
        for pin in ("driver_enable", "brake_release"):
            values = [self.at(pin, ms * 10**6) for ms in (1, 100, 500, 900)]
            self.assertEqual(values, ["0", "0", "1", "1"], pin)

    def test_frames_are_those_of_the_bus(self):
        """Every frame of the bus, in its order: sent ones a mailbox earlier than on the wire, others as they arrive."""
        is_sent = lambda frame: frame[:3] != "7FF" and int(frame[:3], 16) & 0x7F == 2 and frame[:3] != "602"
        bus = [frame for _, _, frame in self.frames]
        sent = [value for _, value in self.signals["can_sent"] if value != "-"]
        arrived = [(at, value) for at, value in self.signals["can_arrived"] if value != "-"]
        self.assertEqual(sorted(sent)[: len(bus)], sorted(filter(is_sent, bus)))
        self.assertEqual([value for _, value in arrived], [frame for frame in bus if not is_sent(frame)])
        ends = [float(time.strip("()")) for time, _, frame in self.frames if not is_sent(frame)]
        for (at, frame), end in zip(arrived, ends):
            self.assertAlmostEqual(at * 1e-9, end, delta=20e-6, msg=frame)

    def test_the_program(self):
        """The tick is an interrupt of the executor's vector (TIM7, 16 + 55) a thousand times a second."""
        ticks = [at for at, value in self.signals["exception"] if value == 71 and at > 5 * 10**8]
        self.assertGreater(len(ticks), 590)
        tasks = {value for _, value in self.signals["task"]}
        self.assertTrue({"bus", "control"} <= tasks, tasks)


if __name__ == "__main__":
    unittest.main()
