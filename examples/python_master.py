"""A master in sixty lines: python-canopen configures one robot, starts it, moves it and stops it.

    omnibus-sim serve groups/single.toml --slcan-tcp 127.0.0.1:7701
    omnibus group show groups/single.toml --json > single.json
    python examples/python_master.py socket://127.0.0.1:7701 single.json

It needs `pip install canopen pyserial`. Robots are plain CANopen devices; for real work use
`omnibus`, which checks more.
"""

import json
import struct
import sys
import time
from pathlib import Path

import canopen

EDS = str(Path(__file__).parent.parent / "docs" / "omnibus.eds")
PERIOD = 0.01  # s, the group file's sync_period_ms
TYPES = {0x05: "<B", 0x06: "<H", 0x07: "<I", 0x08: "<f"}  # CiA 301, table 44


def configure(node, parameters):
    """Writes what the group file says; the EDS knows the types."""
    for entry in parameters:
        index, sub = (int(part, 16) for part in entry["object"].split(":"))
        kind = node.object_dictionary.get_variable(index, sub).data_type
        number = float(entry["value"]) if kind == 0x08 else int(entry["value"])
        node.sdo.download(index, sub, struct.pack(TYPES[kind], number))
    status = struct.unpack("<I", node.sdo.upload(0x2002, 1))[0]
    assert status == 0, f"the robot objects to {status:08X}"


def main(channel, shown):
    with open(shown, encoding="utf-8") as file:
        robot = json.load(file)["robots"][0]
    network = canopen.Network()
    network.connect(interface="slcan", channel=channel, sleep_after_open=0)
    node = network.add_node(robot["node"], EDS)
    network.send_periodic(0x701, [5], 0.1)  # the master's heartbeat
    node.nmt.state = "PRE-OPERATIONAL"
    configure(node, robot["parameters"])
    group = int(next(e["value"] for e in robot["parameters"] if e["object"] == "2040:1"))
    due = time.monotonic()
    # 1 s at standstill, without which no robot would follow after its start; 1 s ahead at 0.2 m/s; 1 s to stop.
    for k in range(300):
        if k == 20:
            node.nmt.state = "OPERATIONAL"
        speed = 2000 if 100 <= k < 200 else 0  # 0.1 mm/s
        network.send_message(0x181, struct.pack("<hhhBB", speed, 0, 0, k % 256, group))
        due += PERIOD
        time.sleep(max(0.0, due - time.monotonic()))
        network.send_message(0x080, [k % 240 + 1])
    time.sleep(0.1)
    way = int.from_bytes(node.sdo.upload(0x2112, 1), "little", signed=True) * 0.1  # mm
    node.nmt.state = "PRE-OPERATIONAL"
    print(f"by its wheels, node {robot['node']} came {way:.1f} mm forward")
    network.disconnect()
    return way


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:3])
