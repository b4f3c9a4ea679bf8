#!/usr/bin/env python3
"""A plant for Omnibus in forty lines: wheels roll without slip, bolted robots are one body.

    python3 examples/plant.py 7700 &
    omnibus-sim serve groups/tcc-3.toml --plant tcp://127.0.0.1:7700
"""
import json
import math
import socket
import sys

server = socket.create_server(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 7700))
print("listening on port", server.getsockname()[1], flush=True)
lines = server.accept()[0].makefile("rw")
robots = json.loads(lines.readline())["robots"]
angle = [[0.0] * 4 for _ in robots]
pose = [[r["x"], r["y"], r["heading"]] for r in robots]
bodies = {}
for n, r in enumerate(robots):
    bodies.setdefault(r["rigid_group"], []).append(n)

for line in lines:
    step = json.loads(line)
    dt, world = step["dt"], []
    for n, (r, (fl, fr, rl, rr)) in enumerate(zip(robots, step["wheel_rate"])):
        angle[n] = [a + w * dt for a, w in zip(angle[n], (fl, fr, rl, rr))]
        t, q = math.tan(r["roller_angle"]), r["wheel_radius"] / 4
        vx, vy = q * (fl + fr + rl + rr), q * t * (fr + rl - fl - rr)
        w = q * (fr + rr - fl - rl) / (r["half_track"] + r["half_wheelbase"] / t)
        c, s = math.cos(pose[n][2] + w * dt / 2), math.sin(pose[n][2] + w * dt / 2)
        world.append((c * vx - s * vy, s * vx + c * vy, w))
    for members in bodies.values():
        m = len(members)
        cx, cy = (sum(pose[n][k] for n in members) / m for k in (0, 1))
        vx, vy, w = (sum(world[n][k] for n in members) / m for k in (0, 1, 2))
        c, s = math.cos(w * dt), math.sin(w * dt)
        for n in members:
            x, y = pose[n][0] - cx, pose[n][1] - cy
            pose[n] = [cx + c * x - s * y + vx * dt, cy + s * x + c * y + vy * dt, pose[n][2] + w * dt]
    print(json.dumps({"wheel_angle": angle, "pose": pose}), file=lines, flush=True)
