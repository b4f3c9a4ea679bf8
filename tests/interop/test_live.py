"""`omnibus watch` and `omnibus teleop` in a pseudo terminal of 80 columns by 24 lines, by keyboard.

A terminal as simple as the programs need stands at the other end: it places text, clears, and passes over colours.
Times that matter are the simulated bus's; nothing depends on how fast this machine is."""

import fcntl
import json
import os
import pathlib
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
COLUMNS, LINES = 80, 24
PATIENCE = 30.0
CONTROL = re.compile(rb"\x1b\[([?>=<]?)([0-9;]*)([A-Za-z])|\x1b[()=>78][0-9A-B]?|\x1b\][^\x07]*\x07")


class Terminal:
    def __init__(self, *arguments):
        self.cells = [[" "] * COLUMNS for _ in range(LINES)]
        self.row = self.column = 0
        self.rest = b""
        self.modes = set()
        self.process, self.end = pty.fork()
        if self.process == 0:
            os.chdir(ROOT)
            os.environ["TERM"] = "xterm-256color"
            os.execv(os.environ["OMNIBUS"], ["omnibus", *arguments])
        fcntl.ioctl(self.end, termios.TIOCSWINSZ, struct.pack("HHHH", LINES, COLUMNS, 0, 0))

    def screen(self):
        return "\n".join("".join(line).rstrip() for line in self.cells)

    def press(self, keys):
        os.write(self.end, keys)

    def listen(self, seconds=0.05):
        """Takes in what comes within this time; False once the program has gone."""
        if not select.select([self.end], [], [], seconds)[0]:
            return True
        try:
            data = os.read(self.end, 65536)
        except OSError:
            return False
        self.show(self.rest + data)
        return bool(data)

    def until(self, what, question):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if question(self.screen()):
                return self.screen()
            if not self.listen():
                break
        raise AssertionError(f"not within {PATIENCE} s: {what}\n{self.screen()}")

    def close(self):
        """What the program ended with."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and self.listen():
            pass
        os.close(self.end)
        return os.waitstatus_to_exitcode(os.waitpid(self.process, 0)[1])

    def hang_up(self):
        """What the program ends with when its terminal is closed."""
        os.close(self.end)
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            process, status = os.waitpid(self.process, os.WNOHANG)
            if process:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
        raise AssertionError(f"it runs on after {PATIENCE} s")

    def show(self, data):
        at = 0
        while at < len(data):
            if data[at:at + 1] == b"\x1b":
                found = CONTROL.match(data, at)
                if not found:
                    if len(data) - at < 32:
                        break
                    raise AssertionError(f"a control nobody expected: {data[at:at + 20]!r}")
                self.obey(*(found.group(n) or b"" for n in (1, 2, 3)))
                at = found.end()
                continue
            size = 1 + sum(data[at] >= first for first in (0xC0, 0xE0, 0xF0))
            if len(data) - at < size:
                break
            self.put(data[at:at + size].decode())
            at += size
        self.rest = data[at:]

    def obey(self, mark, numbers, letter):
        values = [int(n) for n in numbers.split(b";") if n]
        if letter == b"H":
            self.row, self.column = (values + [1, 1])[0] - 1, (values + [1, 1])[1] - 1
        elif letter == b"J":
            self.cells = [[" "] * COLUMNS for _ in range(LINES)]
        elif letter == b"n" and values == [6]:
            self.press(f"\x1b[{self.row + 1};{self.column + 1}R".encode())
        elif letter == b"c":
            self.press(b"\x1b[?62c")
        elif letter == b"h" and mark == b"?":
            self.modes |= set(values)
        elif letter == b"l" and mark == b"?":
            self.modes -= set(values)

    def put(self, letter):
        if letter == "\r":
            self.column = 0
        elif letter == "\n":
            self.row = min(self.row + 1, LINES - 1)
        elif letter >= " ":
            assert self.row < LINES and self.column < COLUMNS, f"{letter!r} at {self.row}, {self.column}"
            self.cells[self.row][self.column] = letter
            self.column += 1


def place(screen):
    """How far the group has come, m."""
    found = re.search(r"^x +([-+][0-9.]+) m", screen, re.MULTILINE)
    return float(found.group(1)) if found else None


def speed(screen):
    found = re.search(r"^moves +([-+][0-9.]+)", screen, re.MULTILINE)
    return abs(float(found.group(1))) if found else None


class Live(unittest.TestCase):
    def open(self, command, *bus):
        terminal = Terminal(command, "--bus", *(bus or ["sim:groups/tcc-3.toml"]))
        self.addCleanup(lambda: self.kill(terminal))
        return terminal

    def kill(self, terminal):
        try:
            os.kill(terminal.process, signal.SIGKILL)
            os.waitpid(terminal.process, 0)
        except (ProcessLookupError, ChildProcessError):
            pass

    def hold_up(self, terminal, until):
        """Holds the key "up", which repeats, until the screen is as asked."""
        end = time.monotonic() + PATIENCE
        while not until(terminal.screen()) and time.monotonic() < end:
            terminal.press(b"\x1b[A")
            terminal.listen()
        self.assertTrue(until(terminal.screen()), terminal.screen())

    def test_watch_only_listens_until_it_is_told_to_start(self):
        terminal = self.open("watch")
        shown = terminal.until("three robots", lambda s: all(f"\n   {n} PRE-OP" in s for n in (2, 3, 4)))
        self.assertIn("idle", shown)
        self.assertIn("tcc-3 on sim:groups/tcc-3.toml", shown)
        self.assertIn("s start  x stop", shown)
        terminal.press(b"s")
        shown = terminal.until("running", lambda s: "running" in s and "   4 OP " in s)
        self.assertIn("scale 100 %", shown)
        terminal.press(b"x")
        terminal.until("stopped", lambda s: "idle" in s and "   4 PRE-OP" in s)
        terminal.press(b"q")
        self.assertEqual(terminal.close(), 0)
        # The terminal is as it was: no alternate screen, a cursor.
        self.assertNotIn(1049, terminal.modes)

    def test_teleop_moves_while_a_key_repeats_and_ramps_down_when_it_does_not(self):
        terminal = self.open("teleop")
        terminal.until("running", lambda s: "running" in s and "   4 OP " in s)
        self.hold_up(terminal, until=lambda s: (place(s) or 0.0) >= 0.1)
        self.assertAlmostEqual(speed(terminal.screen()), 0.2, delta=0.01)
        # Nobody presses any more.
        terminal.until("at rest", lambda s: speed(s) == 0.0)
        self.assertIn("running", terminal.screen())
        terminal.press(b"+")
        terminal.until("a tenth faster", lambda s: "hand: 0.22 m/s" in s)
        terminal.press(b"q")
        self.assertEqual(terminal.close(), 0)

    def test_a_signal_and_a_closed_terminal_end_it_as_a_key_does(self):
        """The robots ramp down, are stopped, and have no fault. In this world time waits for its master, so what a
        master leaves behind stays as it is."""
        for name, end in (("SIGTERM", lambda it: os.kill(it.process, signal.SIGTERM)),
                          ("SIGHUP", lambda it: os.kill(it.process, signal.SIGHUP)),
                          ("closed", lambda it: None)):
            with self.subTest(name):
                command = [os.environ["OMNIBUS_SIM"], "serve", "groups/tcc-2.toml", "--lockstep", "127.0.0.1:0"]
                world = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
                self.addCleanup(world.stdout.close)
                self.addCleanup(world.wait)
                self.addCleanup(world.kill)
                bus = "lockstep://" + world.stdout.readline().split()[1]
                terminal = self.open("teleop", bus, "--group", "groups/tcc-2.toml")
                terminal.until("running", lambda s: "running" in s and "   3 OP " in s)
                self.hold_up(terminal, until=lambda s: (speed(s) or 0.0) >= 0.1)
                end(terminal)
                self.assertEqual(terminal.close() if name != "closed" else terminal.hang_up(), 0)
                if name != "closed":
                    self.assertNotIn(1049, terminal.modes)
                status = [os.environ["OMNIBUS"], "status", "--json", "--bus", bus, "--group", "groups/tcc-2.toml"]
                done = subprocess.run(status, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
                for robot in json.loads(done.stdout)["robots"]:
                    self.assertEqual((robot["nmt"], robot["state"], robot["code"]), ("PreOperational", "Ready", 0))


if __name__ == "__main__":
    unittest.main()
