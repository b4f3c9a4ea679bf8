"""Another physics engine: a robot whose wheels have rollers in MuJoCo (`examples/mujoco_plant.py`).

Nobody told it about roller phases. What is expected of it without them is closed form, `sin(pi/n)/(pi/n) - 1` of the
sideways way and that times the share of the wheelbase of the turn; with the phases that `omnibus calibrate --phase`
finds there, most of it has to be gone.
"""

import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
PATIENCE = 600
# Half wheelbase over its sum with the half track, of the robot of groups/single.toml.
SHARE = 0.350 / (0.350 + 0.370)
CURVES = ["lateral", "oblique", "turn"]


class MuJoCo(unittest.TestCase):
    def plant(self, rollers, seed):
        """A plant with a group file that has its robot there."""
        program = [sys.executable, str(ROOT / "examples/mujoco_plant.py"), "--port", "0"]
        program += ["--rollers", str(rollers), "--seed", str(seed)]
        plant = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
        self.addCleanup(plant.stdout.close)
        self.addCleanup(plant.wait)
        self.addCleanup(plant.kill)
        port = int(plant.stdout.readline().split()[-1])
        text = (ROOT / "groups/single.toml").read_text()
        place = f'plant = "external"\naddress = "127.0.0.1:{port}"\n'
        before, _, after = text.partition('plant = "table"\n')
        text = before + place + after.partition("\n")[2]
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        file = pathlib.Path(folder.name) / "single.toml"
        file.write_text(text)
        return file

    def omnibus(self, file, *arguments):
        command = [os.environ["OMNIBUS"], *arguments, "--bus", f"sim:{file}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def drive(self, file, curve):
        text = self.omnibus(file, "follow", curve, "--compensation", "off", "--json")
        return json.loads(text)["runs"][0]

    def check(self, rollers, seed, *source):
        file = self.plant(rollers, seed)
        without = {curve: self.drive(file, curve) for curve in CURVES}
        lost = 100 * (math.sin(math.pi / rollers) / (math.pi / rollers) - 1)
        # Contacts slip, and balls are no barrel: within half a point of closed form.
        self.assertAlmostEqual(without["lateral"]["aside_percent"], lost, delta=0.5)
        self.assertAlmostEqual(without["turn"]["turn_percent"], lost * SHARE, delta=0.5)

        text = self.omnibus(file, "calibrate", "--phase", "--rollers", str(rollers), *source, "--json")
        phases = json.loads(text)["robots"][0]["phases_deg"]
        entry = f"rollers = {{ count = {rollers}, phases_deg = {phases} }}"
        file.write_text(file.read_text().replace("node = 2\n", f"node = 2\n{entry}\n"))
        phase = {curve: self.drive(file, curve) for curve in CURVES}
        for curve in CURVES:
            for name, run in [("without", without), ("phase", phase)]:
                figures = {key: value for key, value in run[curve].items() if isinstance(value, float)}
                print(f"{rollers} rollers, {curve}, {name}: {figures}")
        # Some slip is left, which is compensation's.
        self.assertLess(abs(phase["lateral"]["aside_percent"]), 0.5)
        self.assertLess(abs(phase["turn"]["turn_percent"]), 0.3)
        self.assertLess(phase["lateral"]["ripple_percent"], 0.6)
        self.assertLess(phase["lateral"]["ripple_percent"], without["lateral"]["ripple_percent"] / 2)
        for curve in ["lateral", "oblique"]:
            self.assertLess(phase[curve]["rms_mm"], without[curve]["rms_mm"] / 3)

    def test_eight_rollers_by_gyro(self):
        self.check(8, 3, "--gyro", "sim")

    def test_ten_rollers_by_poses(self):
        self.check(10, 11)
