"""The example of a master in Python, as its head says to run it."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

from robot import ROOT, Robot

sys.path.insert(0, str(ROOT / "examples"))
import python_master  # noqa: E402


def patient(group):
    """The group with the longest timeouts there are: Python on a busy machine may stand still for longer than 50 ms."""
    longest = {"2041:2": 1000, "2041:3": 5000}
    for entry in group["robots"][0]["parameters"]:
        entry["value"] = longest.get(entry["object"], entry["value"])
    return group


class Master(Robot):
    def test_the_robot_comes_as_far_as_it_was_told(self):
        command = [os.environ["OMNIBUS"], "group", "show", ROOT / "groups" / "single.toml", "--json"]
        shown = subprocess.run(command, check=True, capture_output=True).stdout
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "single.json"
            path.write_text(json.dumps(patient(json.loads(shown))))
            os.chdir(ROOT)
            way = python_master.main(self.channel, path)
        # 1 s at 0.2 m/s is 200 mm. Of the time on a busy machine only the order of magnitude is certain.
        self.assertGreater(way, 50.0)
        self.assertLess(way, 250.0)


if __name__ == "__main__":
    unittest.main()
