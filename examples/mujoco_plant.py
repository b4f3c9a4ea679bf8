#!/usr/bin/env python3
"""A plant for Omnibus in MuJoCo: every roller of every wheel is a body that turns on its own axle.

    pip install mujoco
    python3 examples/mujoco_plant.py --port 7700 --rollers 8 --seed 1 &
    omnibus-sim serve GROUP.toml --plant tcp://127.0.0.1:7700

The wheels are turned as the motors say; everything else is MuJoCo's contact dynamics in three dimensions. Robots of one
rigid group are one body. A roller meets the floor as a row of balls on its axle, each as large as reaches the wheel's
circle; its mass and inertia are those of the solid of revolution that the balls stand for, because the balls overlap.
Wheels begin at roller phases of their own, drawn from the seed. Each connection begins a new world.
"""
import argparse
import json
import math
import random
import socket

import mujoco

# Wheels in the protocol's order: ahead, left, and the sign of the roller axle's lateral part on the ground.
CORNERS = ((1, 1, -1), (1, -1, 1), (-1, 1, 1), (-1, -1, -1))
CLEARANCE = 1e-4  # m, above the floor at the beginning
SLICES = 200  # of a roller, for its mass and inertia


def parse(arguments=None):
    """Options from the command line, or from a list."""
    parser = argparse.ArgumentParser(description="A plant for Omnibus in MuJoCo.")
    parser.add_argument("--port", type=int, default=7700, help="0 takes a free one; it is printed")
    parser.add_argument("--rollers", type=int, default=8, help="of a wheel")
    parser.add_argument("--roller-radius", type=float, default=0.0335, help="at its middle, m")
    parser.add_argument("--balls", type=int, default=25, help="that make up a roller")
    parser.add_argument("--roller-angle", type=float, help="degrees; by default what the robot takes it for")
    parser.add_argument("--roller-density", type=float, default=1100.0, help="rubber, kg/m3")
    parser.add_argument("--roller-damping", type=float, default=1e-4, help="of their own turning, N m s")
    parser.add_argument("--overlap", type=float, default=1.05, help="length of a roller over its share of the wheel")
    parser.add_argument("--contact-time", type=float, default=0.004, help="in which a dent is gone, s: softness")
    parser.add_argument("--mass", type=float, default=60.0, help="of a robot without its wheels, kg")
    parser.add_argument("--friction", type=float, default=0.35, help="between rollers and floor")
    parser.add_argument("--seed", type=int, default=1, help="of the rollers' phases")
    parser.add_argument("--step", type=float, default=1e-3, help="longest step of the physics, s")
    return parser.parse_args(arguments)


def solid(density, hub, radius, ahead, reach):
    """Mass of a roller (kg) and its moments of inertia across and along its axle (kg m2)."""
    width = 2 * reach / SLICES
    mass = across = along = 0.0
    for k in range(SLICES):
        place = reach * ((2 * k + 1) / SLICES - 1)
        size = radius - math.hypot(hub, place * ahead)
        slice_mass = density * math.pi * size**2 * width
        mass += slice_mass
        along += slice_mass * size**2 / 2
        across += slice_mass * (size**2 / 4 + place**2)
    return mass, across, along


def roller(options, robot, side, psi):
    """One roller as XML: `psi` is its place on the wheel, rad, 0 at the bottom and growing as the wheel rolls ahead."""
    radius, angle = robot["wheel_radius"], robot["roller_angle"]
    if options.roller_angle is not None:
        angle = math.radians(options.roller_angle)
    hub = radius - options.roller_radius
    ahead, across = math.sin(angle), side * math.cos(angle)
    reach = options.overlap * hub * math.tan(math.pi / options.rollers) / ahead
    mass, slow, quick = solid(options.roller_density, hub, radius, ahead, reach)
    balls = ""
    for k in range(options.balls):
        along = reach * (2 * k / (options.balls - 1) - 1)
        size = radius - math.hypot(hub, along * ahead)
        balls += f'<geom pos="{along * ahead} {along * across} 0" size="{size}"/>'
    place = f"{-hub * math.sin(psi)} 0 {-hub * math.cos(psi)}"
    return (
        f'<body pos="{place}" euler="0 {psi} 0"><joint type="hinge" axis="{ahead} {across} 0" '
        f'damping="{options.roller_damping}" armature="1e-5"/><inertial pos="0 0 0" zaxis="{ahead} {across} 0" mass="{mass}" '
        f'diaginertia="{slow} {slow} {quick}"/>{balls}</body>'
    )


def model(options, robots, phases):
    """The world as XML, and the robots of each body."""
    groups = {}
    for index, robot in enumerate(robots):
        groups.setdefault(robot["rigid_group"], []).append(index)
    bodies = ""
    for number, members in groups.items():
        first = robots[members[0]]
        parts = ""
        for index in members:
            robot = robots[index]
            dx, dy = robot["x"] - first["x"], robot["y"] - first["y"]
            c, s = math.cos(first["heading"]), math.sin(first["heading"])
            heading = robot["heading"] - first["heading"]
            wheels = ""
            for wheel, (ahead, left, side) in enumerate(CORNERS):
                pitch = 2 * math.pi / options.rollers
                rollers = "".join(
                    roller(options, robot, side, k * pitch + phases[index][wheel]) for k in range(options.rollers)
                )
                place = f'{ahead * robot["half_wheelbase"]} {left * robot["half_track"]} 0'
                # So heavy that only what is written into its velocity turns it.
                wheels += (
                    f'<body pos="{place}"><joint name="wheel_{index}_{wheel}" type="hinge" axis="0 1 0" '
                    f'armature="1e6"/><inertial pos="0 0 0" mass="0.5" diaginertia="0.005 0.005 0.005"/>{rollers}</body>'
                )
            size = f'{robot["half_wheelbase"]} {robot["half_track"]} 0.05'
            parts += (
                f'<body pos="{c * dx + s * dy} {c * dy - s * dx} 0" euler="0 0 {heading}"><geom type="box" '
                f'size="{size}" mass="{options.mass}" contype="0" conaffinity="0"/>{wheels}</body>'
            )
        height = max(robots[index]["wheel_radius"] for index in members) + CLEARANCE
        bodies += (
            f'<body name="group_{number}" pos="{first["x"]} {first["y"]} {height}" euler="0 0 {first["heading"]}">'
            f"<freejoint/>{parts}</body>"
        )
    return f"""
    <mujoco>
      <compiler angle="radian" autolimits="true"/>
      <option timestep="{options.step}" cone="elliptic" impratio="20" integrator="implicitfast" jacobian="sparse">
        <!-- Its trees of boxes save nothing where all that touches is a floor. -->
        <flag midphase="disable"/>
      </option>
      <default><geom type="sphere" friction="{options.friction} 0 0" condim="3" contype="1"
        conaffinity="2" solref="{options.contact_time} 1"/></default>
      <worldbody>
        <geom type="plane" size="0 0 1" contype="2" conaffinity="1"/>
        {bodies}
      </worldbody>
    </mujoco>"""


class World:
    def __init__(self, options, robots):
        draw = random.Random(options.seed)
        pitch = 2 * math.pi / options.rollers
        self.phases = [[(draw.random() - 0.5) * pitch for _ in CORNERS] for _ in robots]
        self.robots = robots
        self.model = mujoco.MjModel.from_xml_string(model(options, robots, self.phases))
        self.data = mujoco.MjData(self.model)
        # Views, which stay the data's.
        self.speeds, self.angles = self.data.qvel, self.data.qpos
        self.places, self.frames = self.data.xpos, self.data.xmat
        self.longest = options.step
        joints = [[self.model.joint(f"wheel_{r}_{w}") for w in range(4)] for r in range(len(robots))]
        self.speed = [[int(joint.dofadr[0]) for joint in four] for four in joints]
        self.angle = [[int(joint.qposadr[0]) for joint in four] for four in joints]
        # Chassis of a robot: the parent of its wheels.
        self.chassis = [int(self.model.body_parentid[self.model.jnt_bodyid[four[0].id]]) for four in joints]
        self.heading = [robot["heading"] for robot in robots]
        self.set_rates([[0.0] * 4 for _ in robots])
        # It settles on its wheels before the first step.
        for _ in range(int(0.2 / options.step)):
            mujoco.mj_step(self.model, self.data)
        self.before = [[self.angles.item(a) for a in four] for four in self.angle]

    def set_rates(self, rates):
        for addresses, four in zip(self.speed, rates):
            for address, rate in zip(addresses, four):
                self.speeds[address] = rate

    def step(self, dt, rates):
        count = max(1, math.ceil(dt / self.longest - 1e-9))
        self.model.opt.timestep = dt / count
        for _ in range(count):
            self.set_rates(rates)
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        poses = []
        for index, body in enumerate(self.chassis):
            yaw = math.atan2(self.frames.item(body, 3), self.frames.item(body, 0))
            turned = math.remainder(yaw - self.heading[index], math.tau)
            self.heading[index] += turned
            poses.append([self.places.item(body, 0), self.places.item(body, 1), self.heading[index]])
        angles = [
            [self.angles.item(a) - b for a, b in zip(four, zero)] for four, zero in zip(self.angle, self.before)
        ]
        return {"wheel_angle": angles, "pose": poses}


def serve(options):
    server = socket.create_server(("127.0.0.1", options.port))
    print("listening on port", server.getsockname()[1], flush=True)
    while True:
        lines = server.accept()[0].makefile("rw")
        hello = lines.readline()
        if not hello:
            continue
        world = World(options, json.loads(hello)["robots"])
        print("roller phases, rad:", json.dumps(world.phases), flush=True)
        try:
            for line in lines:
                step = json.loads(line)
                print(json.dumps(world.step(step["dt"], step["wheel_rate"])), file=lines, flush=True)
        except ConnectionError:
            pass


if __name__ == "__main__":
    serve(parse())
