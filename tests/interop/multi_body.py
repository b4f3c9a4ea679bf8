#!/usr/bin/env python3
"""How many of the intervals of 95 % that `omnibus calibrate` gives hold in `examples/mujoco_plant.py`.

Every robot stands in a world of its own: friction, mass, softness of the contacts, length of the rollers (both make the
footprint), their radius, density and drag are drawn from its number, each evenly in its logarithm. `cargo xtask coverage
--multi-body` asks; `test_mujoco.py` asks a few.
"""

import argparse
import concurrent.futures
import json
import math
import os
import pathlib
import random
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
PATIENCE = 1200
ROLLERS = 8
RANGES = {
    "--friction": (0.2, 0.6),
    "--mass": (30.0, 150.0),
    "--roller-radius": (0.025, 0.042),
    "--roller-density": (700.0, 3000.0),
    "--roller-damping": (3e-5, 1e-3),
    "--overlap": (1.01, 1.1),
    "--contact-time": (0.003, 0.008),
}
# For the truth of a coefficient: passages of a roller with even wheels, over which the ripple is nothing.
PASSAGES = 50
DT = 0.01
# Numbers of the oblique motions between those at 0.25 and 0.5 m/s, which the coefficients asked for do without.
OBLIQUE = ",".join(str(n) for n in [*range(9, 25), *range(33, 49)])
# Sizes of the robot in groups/single.toml.
ROBOT = {"half_track": 0.370, "half_wheelbase": 0.350, "wheel_radius": 0.1524, "roller_angle": math.pi / 4}


def index_angles(seed):
    """Where the simulator puts the indexes of its first robot: SplitMix64, as in `sim/src/world/index.rs`."""
    state, mask, out = seed ^ 0x0049_4E44_4558, (1 << 64) - 1, []
    for _ in range(4):
        state = (state + 0x9E37_79B9_7F4A_7C15) & mask
        z = ((state ^ state >> 30) * 0xBF58_476D_1CE4_E5B9) & mask
        z = ((z ^ z >> 27) * 0x94D0_49BB_1331_11EB) & mask
        out.append(math.tau * ((z ^ z >> 31) >> 11) / (1 << 53))
    return out


def variation(seed):
    """Options of the plant of one robot."""
    # Not the stream from which the plant draws its phases.
    draw = random.Random(f"world {seed}")
    between = {name: low * (high / low) ** draw.random() for name, (low, high) in RANGES.items()}
    return ["--seed", str(seed)] + [word for name, value in between.items() for word in (name, f"{value:.6g}")]


class Plant:
    """A plant as a process, and a group file with a robot in it."""

    def __init__(self, options, seed=1):
        program = [sys.executable, str(ROOT / "examples/mujoco_plant.py"), "--port", "0", *options]
        self.process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
        port = int(self.process.stdout.readline().split()[-1])
        text = (ROOT / "groups/single.toml").read_text()
        text = text.replace('plant = "table"\n', f'plant = "external"\naddress = "127.0.0.1:{port}"\n')
        text = text.replace("\nseed = 1\n", f"\nseed = {seed}\n")
        self.folder = tempfile.TemporaryDirectory()
        self.file = pathlib.Path(self.folder.name) / "single.toml"
        self.file.write_text(text)

    def phases(self):
        """Of the world that has begun: what the plant drew, rad."""
        return json.loads(self.process.stdout.readline().split(":")[-1])[0]

    def omnibus(self, *arguments):
        """Runs the tool on it and returns what it printed."""
        command = [os.environ["OMNIBUS"], *arguments, "--bus", f"sim:{self.file}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        if done.returncode != 0:
            raise AssertionError(done.stdout + done.stderr)
        return done.stdout

    def close(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self.folder.cleanup()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def phases(seed):
    """Errors and half intervals of a robot's four phases, degrees."""
    with Plant(variation(seed), seed) as plant:
        robot = json.loads(plant.omnibus("calibrate", "--phase", "--rollers", str(ROLLERS), "--json"))["robots"][0]
        true, at = plant.phases(), index_angles(seed)
    found = zip(robot["phases_deg"], true, at)
    off = [math.remainder(found - math.degrees(phase + index), 360 / ROLLERS) for found, phase, index in found]
    return list(zip(off, robot["confidence_deg"]))


def world(options):
    """A robot in a world of its own, in this process."""
    sys.path.insert(0, str(ROOT / "examples"))
    import mujoco_plant

    robot = ROBOT | {"rigid_group": 0, "x": 0.0, "y": 0.0, "heading": 0.0}
    return mujoco_plant.World(mujoco_plant.parse(options), [robot])


def even_rates(twist):
    """Of ideal wheels for m/s, m/s, rad/s."""
    x, y, turn = twist
    turn_rim = (ROBOT["half_track"] + ROBOT["half_wheelbase"]) * turn
    rims = [x - y - turn_rim, x + y + turn_rim, x + y - turn_rim, x - y + turn_rim]
    return [rim / ROBOT["wheel_radius"] for rim in rims]


def travelled(world, twist):
    """What share of a twist (m/s, m/s, rad/s) the plant makes of it with even wheels."""
    (x, y, turn), rates = twist, even_rates(twist)
    for k in range(round(1 / DT)):
        pose = world.step(DT, [[rate * k * DT for rate in rates]])["pose"][0]
    reached, steps = 0.0, round(PASSAGES * math.tau / ROLLERS / abs(rates[0]) / DT)
    for _ in range(steps):
        before, pose = pose, world.step(DT, [rates])["pose"][0]
        dx, dy, turned = (now - then for now, then in zip(pose, before))
        heading = 0.5 * (before[2] + pose[2])
        ahead = math.cos(heading) * dx + math.sin(heading) * dy
        left = math.cos(heading) * dy - math.sin(heading) * dx
        reached += ahead * x + left * y + turned * turn
    return reached / (steps * DT * (x * x + y * y + turn * turn))


def coefficients(seed):
    """Errors and half intervals of a robot's five coefficients, per cent: as `master/tests/coverage.rs` asks for."""
    options = variation(seed)
    with Plant(options, seed) as plant:
        slip = ["--speeds", "0.25,0.5", "--rates", "0.5", "--without", OBLIQUE]
        found = json.loads(plant.omnibus("calibrate", *slip, "--json"))["outcomes"][0]["coefficients"]
    out = []
    for row in found:
        axis = ["ahead", "sideways", "turning"].index(row["motion"])
        twist = [row["speed"] if n == axis else 0.0 for n in range(3)]
        truth = 1 / travelled(world(options), twist)
        out.append((100 * (row["coefficient"] - truth), 50 * (row["high"] - row["low"])))
    return out


def report(seed, pairs, digits, missed):
    print(f"{seed}:", ", ".join(f"{off:+.{digits}f} ± {sure:.{digits}f}" for off, sure in pairs), missed, flush=True)


def ask(seeds, one, digits):
    """How many of all intervals hold, and of how many. Each processor has a robot of its own at a time."""
    held = count = 0
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for seed, pairs in zip(seeds, pool.map(one, seeds)):
            mine = sum(abs(off) <= sure for off, sure in pairs)
            held, count = held + mine, count + len(pairs)
            report(seed, pairs, digits, "" if mine == len(pairs) else f"{len(pairs) - mine} missed")
    return held, count


WHAT = {"phases": (phases, 3), "coefficients": (coefficients, 3)}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--what", choices=WHAT, default="phases")
    parser.add_argument("--first", type=int, default=1, help="robot")
    parser.add_argument("--robots", type=int, default=25)
    options = parser.parse_args()
    held, count = ask(range(options.first, options.first + options.robots), *WHAT[options.what])
    print(f"{options.what}: {held} of {count} intervals hold")


if __name__ == "__main__":
    main()
