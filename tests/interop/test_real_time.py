"""The measure of how late a machine is, by which a test in real time is made once more."""

import os
import tempfile
import time
import unittest
import unittest.mock

import real_time


class Lateness(unittest.TestCase):
    def test_the_lines_of_processes_that_are_late_together_are_whole(self):
        with (
            tempfile.NamedTemporaryFile("w+") as file,
            unittest.mock.patch.dict(os.environ, PYTHONUNBUFFERED="1"),
        ):
            began = time.monotonic()
            # Always late, so each writes every millisecond.
            processes = [process for _ in range(8) for process in real_time.watch(file, 0)]
            time.sleep(2)
            for process in processes:
                process.kill()
                process.wait()
            with open(file.name) as read:
                lines = [list(map(float, line.split())) for line in read]
        self.assertGreater(len(lines), 1_000)
        for at, late in lines:
            self.assertGreater(at, began)
            self.assertGreater(late, 0)


if __name__ == "__main__":
    unittest.main()
