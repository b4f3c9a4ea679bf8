"""How many messages a fleet of groups sends, and what it costs: twenty groups of one native robot each on one broker,
each with an order of its own, for so many seconds of the clock on the wall.

    OMNIBUS=target/release/omnibus python3 tests/interop/fleet_load.py [GROUPS [SECONDS]]

Not a test: `cargo xtask bench --fleet` runs it. Figures depend on the machine (docs/performance.md has one run):
messages and states a second of all groups, processor (per cent of a core) and memory (MB) of one group with its
simulated robot, and the broker's share of a core."""

import json
import os
import pathlib
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
GROUPS = int(sys.argv[1]) if len(sys.argv) > 1 else 20
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 30.0


def order(serial):
    """There and back between two places, slowly enough for the whole run."""
    nodes, edges = [], []
    for n in range(200):
        nodes.append({"nodeId": f"n{n}", "sequenceId": 2 * n, "released": True, "actions": [],
                      "nodePosition": {"x": n % 2, "y": 0, "mapId": "map"}})
    for n in range(199):
        edges.append({"edgeId": f"e{n}", "sequenceId": 2 * n + 1, "released": True, "actions": [],
                      "startNodeId": f"n{n}", "endNodeId": f"n{n + 1}"})
    return {"headerId": 1, "timestamp": "2026-11-23T12:00:00.000Z", "version": "2.0.0", "manufacturer": "Omnibus",
            "serialNumber": serial, "orderId": "load", "orderUpdateId": 0, "nodes": nodes, "edges": edges}


def cpu(process):
    """Processor time of a process so far, s."""
    fields = pathlib.Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(process):
    """Resident memory of a process, MB."""
    return int(pathlib.Path(f"/proc/{process.pid}/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def main():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        conf = pathlib.Path(folder) / "conf"
        conf.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
        broker = subprocess.Popen(["/usr/sbin/mosquitto", "-c", conf], stderr=subprocess.DEVNULL)
        time.sleep(1)
        vehicles = [subprocess.Popen(
            [os.environ["OMNIBUS"], "vda5050", "--broker", f"mqtt://127.0.0.1:{port}", "--serial", f"g{n}",
             "--at", "0,0", "--bus", f"sim:{ROOT / 'groups' / 'single.toml'}"],
            stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) for n in range(GROUPS)]
        heard = subprocess.Popen(["mosquitto_sub", "-p", str(port), "-t", "uagv/#", "-F", "%t"],
                                 stdout=subprocess.PIPE, text=True)
        time.sleep(5)
        for n in range(GROUPS):
            message = pathlib.Path(folder) / "order"
            message.write_text(json.dumps(order(f"g{n}")))
            subprocess.run(["mosquitto_pub", "-p", str(port), "-t", f"uagv/v2/Omnibus/g{n}/order", "-f", message])
        time.sleep(3)
        began, before = time.monotonic(), [cpu(v) for v in vehicles]
        broker_before = cpu(broker)
        os.set_blocking(heard.stdout.fileno(), False)
        heard.stdout.read()
        time.sleep(SECONDS)
        passed = time.monotonic() - began
        lines = (heard.stdout.read() or "").splitlines()
        spent = sum(cpu(v) - b for v, b in zip(vehicles, before))
        print(json.dumps({
            "messages": len(lines) / passed, "states": sum(line.endswith("/state") for line in lines) / passed,
            "processor": 100 * spent / passed / GROUPS, "memory": sum(map(memory, vehicles)) / GROUPS,
            "broker": 100 * (cpu(broker) - broker_before) / passed}))
        for process in [*vehicles, heard, broker]:
            process.send_signal(signal.SIGINT)
        for process in [*vehicles, heard, broker]:
            process.wait()


main()
