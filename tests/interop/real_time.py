"""Drives in real time, on a machine that may not have the time for them.

A virtual machine that is given its processors back 20 ms late has lost two SYNCs: robots stop then, and are right to. So
a process on each processor measures how late it is itself, which no product has a part in, and a test that failed
while the machine was late is made once more. One that fails while the machine is in time has failed.
"""

import contextlib
import functools
import os
import subprocess
import sys
import tempfile
import time

LATE = 0.004
"""Seconds; a setpoint has less than this until its SYNC."""
ATTEMPTS = 4

# A line is one write: the processes of all processors share the file, and `print` may write its parts one by one.
WATCH = r"""
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
parent, last = os.getppid(), time.monotonic()
while os.getppid() == parent:
    time.sleep(0.001)
    now = time.monotonic()
    if now - last > float(sys.argv[2]):
        os.write(1, b"%f %f\n" % (now, now - last))
    last = now
"""


@functools.cache
def watched():
    """The file in which every lateness of every processor is written from now on."""
    file = tempfile.NamedTemporaryFile("w+", prefix="omnibus-late-")
    watch(file, LATE)
    return file


def watch(file, limit):
    """Has a process on each processor write into a file when it is late by more than so many seconds."""
    return [
        subprocess.Popen([sys.executable, "-c", WATCH, str(processor), str(limit)], stdout=file, close_fds=True)
        for processor in os.sched_getaffinity(0)
    ]


def worst_since(began):
    """How late a processor was at worst since then, s; 0 where none was."""
    with open(watched().name) as lines:
        late = [tuple(map(float, line.split())) for line in lines if line.endswith("\n")]
    return max((duration for at, duration in late if at >= began), default=0.0)


def in_real_time(attempt, name, clear):
    """Makes an attempt, and others where it failed on a machine that was late; `clear` makes room for the next."""
    watched()
    for _ in range(ATTEMPTS - 1):
        began = time.monotonic()
        try:
            return attempt()
        except Exception as error:
            late = worst_since(began)
            if not late:
                raise
            print(f"{name}: once more, because this machine was {late * 1e3:.0f} ms late: {error}", file=sys.stderr)
            clear()
    return attempt()


def drives_in_real_time(case):
    """Makes every test of a class with [in_real_time]."""
    def made(test):
        @functools.wraps(test)
        def run(self):
            def clear():
                # Not doCleanups(), which would count what is wrong at the end of an attempt as the test's.
                while self._cleanups:
                    function, arguments, named = self._cleanups.pop()
                    with contextlib.suppress(Exception):
                        function(*arguments, **named)
                self.setUp()

            in_real_time(functools.partial(test, self), self.id(), clear)

        return run

    for name in [name for name in dir(case) if name.startswith("test_")]:
        setattr(case, name, made(getattr(case, name)))
    return case
