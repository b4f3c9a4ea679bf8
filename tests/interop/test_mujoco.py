"""Another physics engine: a robot whose wheels have rollers in MuJoCo (`examples/mujoco_plant.py`).

Nobody told it about roller phases. What is expected of it without them is closed form, `sin(pi/n)/(pi/n) - 1` of the
sideways way and that times the share of the wheelbase of the turn; with the phases that `omnibus calibrate --phase`
finds there, most of it has to be gone.
"""

import argparse
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
# Of 24 independent intervals of 95 % fewer hold once in 160 times.
HOLD = 20


def index_angles(seed):
    """Where the simulator puts the indexes of its first robot: SplitMix64, as in `sim/src/world/index.rs`."""
    state, mask, out = seed ^ 0x0049_4E44_4558, (1 << 64) - 1, []
    for _ in range(4):
        state = (state + 0x9E37_79B9_7F4A_7C15) & mask
        z = ((state ^ state >> 30) * 0xBF58_476D_1CE4_E5B9) & mask
        z = ((z ^ z >> 27) * 0x94D0_49BB_1331_11EB) & mask
        out.append(math.tau * ((z ^ z >> 31) >> 11) / (1 << 53))
    return out


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
        self.said = plant.stdout
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

    def test_intervals_hold(self):
        """Phases of six robots by poses: nearly all of the intervals of 95 % hold the truth."""
        held = 0
        for seed in range(1, 7):
            file = self.plant(8, seed)
            text = self.omnibus(file, "calibrate", "--phase", "--rollers", "8", "--json")
            robot = json.loads(text)["robots"][0]
            true = json.loads(self.said.readline().split(":")[-1])[0]
            at = index_angles(1)  # the group file's seed
            errors = [
                math.remainder(found - math.degrees(phase + index), 45)
                for found, phase, index in zip(robot["phases_deg"], true, at)
            ]
            print(f"seed {seed}: off by {errors}, ± {robot['confidence_deg']}")
            held += sum(abs(error) <= sure for error, sure in zip(errors, robot["confidence_deg"]))
        self.assertGreaterEqual(held, HOLD)

    def test_rollers_that_turn_on_lose_nothing_by_speed(self):
        """With even wheels at 0.25 and 1 m/s sideways. A hand-over loss of 0.0013 s/m would be 0.1 points."""
        sys.path.insert(0, str(ROOT / "examples"))
        import mujoco_plant

        robot = {"rigid_group": 0, "x": 0.0, "y": 0.0, "heading": 0.0}
        robot |= {"half_track": 0.370, "half_wheelbase": 0.350, "wheel_radius": 0.1524, "roller_angle": math.pi / 4}
        options = argparse.Namespace(
            rollers=8, roller_radius=0.0335, balls=81, mass=60.0, friction=0.35, seed=3, step=1e-3
        )
        lost = []
        for speed in [0.25, 1.0]:
            world, rate = mujoco_plant.World(options, [robot]), speed / robot["wheel_radius"]
            # A ramp of a second, a turn of the wheels, then whole turns of them.
            turn = math.tau / rate
            parts, poses = [(1.0, 0.5), (turn, 1.0), (2 * turn, 1.0)], []
            for seconds, share in parts:
                steps = math.ceil(seconds / 0.01)
                for k in range(steps):
                    now = rate * (k / steps if share < 1 else 1)
                    pose = world.step(seconds / steps, [[-now, now, now, -now]])["pose"][0]
                poses.append(pose)
            (x, y, _), (to_x, to_y, _) = poses[1:]
            lost.append(100 * (1 - math.hypot(to_x - x, to_y - y) / (2 * turn * speed)))
        print(f"sideways, even wheels: {lost} % lost at 0.25 and 1 m/s")
        self.assertAlmostEqual(lost[0], lost[1], delta=0.06)

    def test_ten_rollers_by_poses(self):
        self.check(10, 11)
