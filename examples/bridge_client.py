"""Drives a group through `omnibus bridge`: a metre ahead, then a stop. Needs Python only.

    omnibus-sim serve groups/tcc-2.toml --slcan-tcp 127.0.0.1:7701
    omnibus bridge --listen tcp://127.0.0.1:7710 --bus slcan-tcp://127.0.0.1:7701 --group groups/tcc-2.toml
    python examples/bridge_client.py 127.0.0.1:7710
"""

import json
import socket
import sys

if len(sys.argv) != 2 or ":" not in sys.argv[1]:
    sys.exit(__doc__)
host, port = sys.argv[1].rsplit(":", 1)
connection = socket.create_connection((host, int(port)), timeout=10)
lines = connection.makefile("r", encoding="utf-8")


def say(kind, **fields):
    connection.sendall((json.dumps({"type": kind, **fields}) + "\n").encode())


say("start")
begin = now = None
for message in map(json.loads, lines):
    if message["type"] == "refused":
        sys.exit(f"refused: {message['reason']}")
    if message["type"] != "state":
        continue
    now = message["group"].get("pose")
    if message["running"] and now:
        begin = begin or now
        # Every state is answered, so the robots stop when states or answers stay away.
        if now["x"] - begin["x"] < 1.0:
            say("twist", vx=0.25, timeout=0.2)
        else:
            say("stop")
    elif begin:
        break  # they have stopped
print(f"{now['x'] - begin['x']:.3f} m")
