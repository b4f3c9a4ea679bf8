"""A broker, vehicles and a fleet control, for test_vda5050.py.

The broker is mosquitto, the fleet control Siemens' vda-5050-lib in Node.js (fleet.js), the vehicles are `omnibus
vda5050`. Nothing measures time: a test waits for an event, long. Messages of all are kept, so a test can look back."""

import json
import math
import os
import pathlib
import queue
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
HERE = pathlib.Path(__file__).resolve().parent
# Debian has it where only root looks.
MOSQUITTO = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
PATIENCE = 120.0
"""Seconds to wait for what must come."""


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for_port(port):
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port), 1).close()
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


class Broker:
    """mosquitto on a port of its own."""

    def __init__(self, case, *lines, port=None):
        folder = tempfile.TemporaryDirectory()
        case.addCleanup(folder.cleanup)
        self.port = port or free_port()
        self.file = pathlib.Path(folder.name) / "mosquitto.conf"
        lines = lines or ("allow_anonymous true",)
        self.file.write_text("\n".join([f"listener {self.port} 127.0.0.1", "user root", *lines, ""]))
        self.process = None
        self.start()
        case.addCleanup(self.kill)

    def start(self):
        self.process = subprocess.Popen(
            [MOSQUITTO, "-c", self.file], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_for_port(self.port)

    def kill(self):
        self.process.kill()
        self.process.wait()


class Proxy:
    """A line to a broker that can be cut and mended; its port stays."""

    def __init__(self, case, broker):
        self.broker, self.open, self.lines = broker, threading.Event(), []
        self.open.set()
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()
        case.addCleanup(self.server.close)
        case.addCleanup(self.cut)

    def accept(self):
        while True:
            try:
                near, _ = self.server.accept()
            except OSError:
                return
            if not self.open.is_set():
                near.close()
                continue
            far = socket.create_connection(("127.0.0.1", self.broker.port))
            self.lines.append((near, far))
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self.carry, args=(one, other), daemon=True).start()

    @staticmethod
    def carry(one, other):
        try:
            while data := one.recv(65536):
                other.sendall(data)
        except OSError:
            pass
        for end in (one, other):
            end.close()

    def cut(self):
        self.open.clear()
        for end in (end for line in self.lines for end in line):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
        self.lines.clear()

    def mend(self):
        self.open.set()


class Fleet:
    """The fleet control, and everything that was said on the broker."""

    def __init__(self, case, broker, scheme="mqtt", options=None, environment=None):
        self.case, self.events, self.seen = case, queue.Queue(), []
        self.process = subprocess.Popen(
            ["node", HERE / "fleet.js", f"{scheme}://localhost:{broker.port}", "uagv"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"FLEET_OPTIONS": json.dumps(options or {})} | (environment or {}),
        )
        threading.Thread(target=self.read, daemon=True).start()
        case.addCleanup(self.end)
        self.wait("ready")

    def read(self):
        for line in self.process.stdout:
            self.events.put(json.loads(line))

    def end(self):
        self.process.stdin.close()
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        wrong = [event for event in self.seen if event.get("wrong")]
        self.case.assertEqual(wrong, [], "messages against the schemas of 2.0")

    def tell(self, serial, **what):
        self.process.stdin.write(json.dumps({"serial": serial, **what}) + "\n")
        self.process.stdin.flush()

    def order(self, serial, order):
        self.tell(serial, order=order)

    def instant(self, serial, kind, name, **parameters):
        listed = [{"key": key, "value": value} for key, value in parameters.items()]
        self.tell(serial, instant=[
            {"actionId": name, "actionType": kind, "blockingType": "NONE", "actionParameters": listed}])

    def send(self, serial, topic, message, version="v2", number="2.0.0", **options):
        header = {"headerId": 1, "timestamp": "2026-11-23T12:00:00.000Z", "version": number,
                  "manufacturer": "Omnibus", "serialNumber": serial}
        self.tell(serial, send={"topic": f"uagv/{version}/Omnibus/{serial}/{topic}",
                                "message": header | message, **options})

    def wait(self, name, found=lambda event: True):
        """The next event of this name that is the one; what comes before it has been seen."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                event = self.events.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                self.case.fail(f"no {name}; last: {[e for e in self.seen if e['event'] != 'raw'][-5:]} "
                               f"{self.seen[-2:]}")
            self.seen.append(event)
            if event["event"] == "failed":
                self.case.fail(event["error"])
            if event["event"] == name and found(event):
                return event

    def state(self, serial, found):
        """The next state of a vehicle that is the one."""
        return self.message(serial, "state", found)

    def finished(self, serial, name):
        """The first state from now on in which an instant action is finished; the library has noticed it, too."""
        done = lambda a: a["actionId"] == name and a["actionStatus"] == "FINISHED"
        state = self.state(serial, lambda s: any(done(action) for action in s["actionStates"]))
        noticed = lambda e: e["event"] == "action" and e["id"] == name and e["status"] == "FINISHED"
        if not any(noticed(event) for event in self.seen):
            self.wait("action", noticed)
        return state

    def message(self, serial, topic, found=lambda message: True):
        wanted = lambda e: e["serial"] == serial and e["topic"] == topic and found(e["message"])
        return self.wait("raw", wanted)["message"]

    def states(self, serial):
        """The states of a vehicle so far, oldest first."""
        return [e["message"] for e in self.seen
                if e["event"] == "raw" and e["serial"] == serial and e["topic"] == "state"]


class Vehicles(unittest.TestCase):
    def vehicle(self, broker, bus, *options, serial, protocol="2.0", scheme="mqtt", ends=0):
        """A group as a vehicle; ends with the test, with that exit code."""
        command = [os.environ["OMNIBUS"], "vda5050", "--broker", f"{scheme}://localhost:{broker.port}"]
        command += ["--serial", serial, "--protocol", protocol, "--map-id", "hall", "--bus", *bus, *options]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(self.end_vehicle, process, ends)
        return process

    def end_vehicle(self, process, wanted=0):
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        self.assertEqual(process.wait(PATIENCE), wanted)

    def simulated(self, broker, group, *options, serial, **more):
        bus = [f"sim:{ROOT / 'groups' / group}", "--at", "0,0"]
        return self.vehicle(broker, bus, *options, serial=serial, **more)

    def world(self, group, *options):
        """A simulated world in a process of its own: its addresses, and its standard input for faults."""
        log = pathlib.Path(os.environ["OMNIBUS_LOGS"]) / f"native-{self.id()}.log"
        process = subprocess.Popen(
            [os.environ["OMNIBUS_SIM"], "serve", ROOT / "groups" / group, "--slcan-tcp", "127.0.0.1:0",
             "--log", log, "--fault", "-", *options],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.end_world, process)
        wanted = 1 + sum(option.endswith("-tcp") for option in options)
        return process, dict(process.stdout.readline().split() for _ in range(wanted))

    def end_world(self, process):
        process.send_signal(signal.SIGINT)
        process.stdin.close()
        process.stdout.close()
        process.wait(PATIENCE)


def node(name, sequence, x, y, released=True, **position):
    return {"nodeId": name, "sequenceId": sequence, "released": released, "actions": [],
            "nodePosition": {"x": x, "y": y, "mapId": "hall", **position}}


def edge(name, sequence, start, end, released=True, **extra):
    return {"edgeId": name, "sequenceId": sequence, "released": released, "startNodeId": start,
            "endNodeId": end, "actions": [], **extra}


def order(name, places, released=None, update=0, first=0, **extra):
    """An order along places (x, y), named n0, n1, ... from `first` on; the first `released` of them released."""
    released = len(places) if released is None else released
    count = range(first, first + len(places))
    nodes = [node(f"n{n}", 2 * n, x, y, n - first < released) for n, (x, y) in zip(count, places)]
    edges = [edge(f"e{n}", 2 * n + 1, f"n{n}", f"n{n + 1}", n + 1 - first < released, **extra)
             for n in list(count)[:-1]]
    return {"orderId": name, "orderUpdateId": update, "nodes": nodes, "edges": edges}


QUARTER = {"degree": 2, "knotVector": [0, 0, 0, 1, 1, 1], "controlPoints": [
    {"x": 0, "y": 0, "weight": 1}, {"x": 1.5, "y": 0, "weight": math.sqrt(0.5)}, {"x": 1.5, "y": 1.5, "weight": 1}]}
"""A quarter of a circle of 1.5 m about (0, 1.5), from the origin to (1.5, 1.5)."""


def remaining(state):
    return [node["nodeId"] for node in state["nodeStates"]]


def idle(state):
    return not state["nodeStates"] and not state["driving"]
