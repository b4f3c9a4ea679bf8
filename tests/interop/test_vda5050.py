"""`omnibus vda5050` under Siemens' vda-5050-lib, over mosquitto. Every message that the vehicles send is checked
against the schemas of 2.0 that the library brings; 2.1 against those of the package vda5050-sdk."""

import importlib.metadata
import json
import math
import os
import pathlib
import signal
import subprocess
import tempfile
import threading
import time

import jsonschema

from fleet import (
    MOSQUITTO, PATIENCE, QUARTER, ROOT, Broker, Fleet, Proxy, Vehicles, free_port, idle, order, remaining, wait_for_port,
)
from real_time import drives_in_real_time

SERIAL = "tcc-3"


def position(state):
    return state["agvPosition"]


class OneVehicle(Vehicles):
    GROUP, OPTIONS = "tcc-3.toml", ["--visualization-interval", "0.1"]

    def setUp(self):
        self.broker = Broker(self)
        self.fleet = Fleet(self, self.broker)
        self.process = self.simulated(self.broker, self.GROUP, *self.OPTIONS, serial=SERIAL)
        self.fleet.message(SERIAL, "connection", lambda m: m["connectionState"] == "ONLINE")
        self.fleet.state(SERIAL, lambda s: s["agvPosition"]["positionInitialized"])

    def near(self, state, x, y, theta=None, within=0.03):
        at = position(state)
        self.assertLess(math.hypot(at["x"] - x, at["y"] - y), within, at)
        if theta is not None:
            self.assertLess(abs(math.remainder(at["theta"] - theta, math.tau)), within, at)

    def test_three_robots_drive_a_curve_with_the_front_ahead(self):
        curve = order("curve", [(0, 0), (1.5, 1.5), (1.5, 2.5)])
        curve["edges"][0] |= {"trajectory": QUARTER, "orientation": 0.0, "orientationType": "TANGENTIAL"}
        self.fleet.order(SERIAL, curve)
        traversed = [self.fleet.wait("node")["node"] for _ in range(3)]
        self.assertEqual(traversed, ["n0", "n1", "n2"])
        done = self.fleet.wait("processed")
        self.assertEqual((done["error"], done["cancelled"], done["active"]), (None, False, False))
        self.near(self.fleet.state(SERIAL, idle), 1.5, 2.5, math.pi / 2)
        # On the way, by the positions that were sent: on the circle, and turned along it.
        shown = [e["message"]["agvPosition"] for e in self.fleet.seen
                 if e["event"] == "raw" and e["topic"] == "visualization"]
        on_curve = [at for at in shown if at["y"] < 1.5 and at["x"] > 0.05]
        self.assertGreater(len(on_curve), 5)
        for at in on_curve:
            self.assertLess(abs(math.hypot(at["x"], at["y"] - 1.5) - 1.5), 0.03, at)
            self.assertLess(abs(at["theta"] - math.atan2(at["x"], 1.5 - at["y"])), 0.05, at)
        # The first node was never ahead, and the others left one by one.
        ahead = [remaining(s) for s in self.fleet.states(SERIAL) if s["orderId"] == "curve"]
        steps = [nodes for nodes, before in zip(ahead, [None, *ahead]) if nodes != before]
        self.assertEqual(steps, [["n1", "n2"], ["n2"], []])

    def test_pause_update_and_the_same_update_twice(self):
        self.fleet.order(SERIAL, order("long", [(0, 0), (2, 0), (4, 0)], released=2, maxSpeed=0.5))
        self.fleet.state(SERIAL, lambda s: s["driving"])
        self.fleet.instant(SERIAL, "startPause", "p")
        paused = self.fleet.finished(SERIAL, "p")
        self.assertTrue(paused["paused"] and not paused["driving"])
        self.assertLess(position(paused)["x"], 1.9)
        self.fleet.instant(SERIAL, "stopPause", "q")
        self.fleet.finished(SERIAL, "q")
        # The end of the base, with a horizon: the vehicle waits there for more.
        waiting = self.fleet.state(SERIAL, lambda s: not s["driving"] and remaining(s) == ["n2"])
        self.near(waiting, 2, 0)
        self.assertTrue(waiting["newBaseRequest"])
        update = order("long", [(2, 0), (4, 0)], update=1, first=1)
        self.fleet.send(SERIAL, "order", update)
        taken = self.fleet.state(SERIAL, lambda s: s["orderUpdateId"] == 1)
        self.assertEqual(taken["errors"], [])
        self.fleet.send(SERIAL, "order", update)
        self.near(self.fleet.state(SERIAL, idle), 4, 0)
        self.assertEqual(self.fleet.states(SERIAL)[-1]["errors"], [], "the same update twice is no error")

    def test_cancel_with_a_horizon_then_an_order_from_where_it_stands(self):
        self.fleet.order(SERIAL, order("a", [(0, 0), (3, 0), (5, 0)], released=2, maxSpeed=0.5))
        self.fleet.state(SERIAL, lambda s: s["driving"] and position(s)["x"] > 0.0)
        self.fleet.instant(SERIAL, "cancelOrder", "c")
        stands = self.fleet.finished(SERIAL, "c")
        self.assertEqual((stands["nodeStates"], stands["edgeStates"]), ([], []))
        self.assertFalse(stands["driving"])
        x = position(stands)["x"]
        self.assertLess(x, 2.9)
        self.fleet.instant(SERIAL, "cancelOrder", "again")
        refused = self.fleet.state(SERIAL, lambda s: s["errors"])
        self.assertEqual(refused["errors"][0]["errorType"], "noOrderToCancel")
        self.fleet.send(SERIAL, "order", order("a", [(3, 0), (5, 0)], update=1, first=1))
        self.fleet.state(SERIAL, lambda s: any(e["errorType"] == "orderUpdateError" for e in s["errors"]))
        self.fleet.order(SERIAL, order("b", [(x, 0), (x, 1)]))
        self.near(self.fleet.state(SERIAL, lambda s: s["orderId"] == "b" and idle(s)), x, 1)

    def test_a_broker_that_goes_and_comes_back(self):
        self.fleet.order(SERIAL, order("on", [(0, 0), (1, 0), (2, 0), (3, 0)], released=3, maxSpeed=0.5))
        self.fleet.state(SERIAL, lambda s: s["driving"])
        self.broker.kill()
        self.broker.start()
        online = lambda m: m["connectionState"] == "ONLINE"
        self.fleet.message(SERIAL, "connection", online)
        # It went on to the last released node, and not beyond.
        end = self.fleet.state(SERIAL, lambda s: not s["driving"] and remaining(s) == ["n3"])
        self.near(end, 2, 0)
        ahead = [remaining(s) for s in self.fleet.states(SERIAL) if s["orderId"] == "on"]
        steps = [nodes for nodes, before in zip(ahead, [None, *ahead]) if nodes != before]
        self.assertEqual(steps[-1], ["n3"])
        self.assertIn(["n2", "n3"], steps, "the state of each node arrived")
        self.fleet.send(SERIAL, "order", order("on", [(2, 0), (3, 0)], update=1, first=2))
        self.near(self.fleet.state(SERIAL, idle), 3, 0)

    def test_a_killed_vehicle_is_reported_by_its_last_will(self):
        self.process.kill()
        self.process.wait(PATIENCE)
        self.process.returncode = 0
        will = self.fleet.message(SERIAL, "connection", lambda m: m["connectionState"] != "ONLINE")
        self.assertEqual(will["connectionState"], "CONNECTIONBROKEN")

    def test_an_end_on_purpose_is_offline(self):
        self.end_vehicle(self.process)
        will = self.fleet.message(SERIAL, "connection", lambda m: m["connectionState"] != "ONLINE")
        self.assertEqual(will["connectionState"], "OFFLINE")

    def test_orders_that_cannot_be_done_are_refused_and_nothing_moves(self):
        far = order("far", [(9, 9), (10, 9)])
        self.fleet.order(SERIAL, far)
        self.assertEqual(self.fleet.wait("processed")["error"]["errorType"], "noRouteError")
        lift = order("lift", [(0, 0), (1, 0)])
        lift["nodes"][1]["actions"] = [{"actionId": "l", "actionType": "pick", "blockingType": "HARD"}]
        self.fleet.order(SERIAL, lift)
        error = self.fleet.wait("processed")["error"]
        self.assertEqual(error["errorType"], "orderError")
        self.assertIn("pick", error["errorDescription"])
        self.fleet.send(SERIAL, "order", {"orderId": "bad"})
        state = self.fleet.state(SERIAL, lambda s: any(e["errorType"] == "validationError" for e in s["errors"]))
        self.assertIn("orderUpdateId", json.dumps(state["errors"]))
        # What a broker keeps from another day moves nothing.
        self.fleet.send(SERIAL, "order", order("old", [(0, 0), (1, 0)]), retain=True, qos=1)
        self.assertTrue(all(not s["driving"] for s in self.fleet.states(SERIAL)))

    def test_init_position_moves_the_map_and_factsheet_and_state_come_when_asked(self):
        self.fleet.instant(SERIAL, "initPosition", "i", x=10.0, y=-2.0, theta=math.pi / 2, mapId="hall", lastNodeId="dock")
        self.fleet.finished(SERIAL, "i")
        self.near(self.fleet.state(SERIAL, lambda s: s["lastNodeId"] == "dock"), 10, -2, math.pi / 2)
        self.fleet.order(SERIAL, order("up", [(10, -2), (10, -1)]))
        self.near(self.fleet.state(SERIAL, lambda s: s["orderId"] == "up" and idle(s)), 10, -1, math.pi / 2)
        self.fleet.instant(SERIAL, "factsheetRequest", "f")
        sheet = self.fleet.message(SERIAL, "factsheet")
        self.assertEqual(sheet["typeSpecification"]["agvKinematic"], "OMNI")
        self.assertEqual(len(sheet["agvGeometry"]["wheelDefinitions"]), 12)
        self.fleet.instant(SERIAL, "stateRequest", "s")
        self.fleet.finished(SERIAL, "s")


    def test_a_turn_on_the_spot_is_an_edge_between_two_nodes_of_one_place(self):
        # And one where nothing is to be done, which is a node to be reported all the same.
        turn = order("turn", [(0, 0), (0, 0), (0, 0), (0, 1)])
        turn["nodes"][1]["nodePosition"]["theta"] = math.pi / 2
        self.fleet.order(SERIAL, turn)
        self.assertEqual([self.fleet.wait("node")["node"] for _ in range(4)], ["n0", "n1", "n2", "n3"])
        done = self.fleet.wait("processed")
        self.assertEqual((done["error"], done["cancelled"], done["active"]), (None, False, False))
        self.near(self.fleet.state(SERIAL, idle), 0, 1, math.pi / 2)
        # What was turned in place did not leave it.
        shown = [e["message"]["agvPosition"] for e in self.fleet.seen
                 if e["event"] == "raw" and e["topic"] == "visualization"]
        turning = [at for at in shown if 0.1 < at["theta"] < 1.4]
        self.assertGreater(len(turning), 2)
        for at in turning:
            self.assertLess(math.hypot(at["x"], at["y"]), 0.03, at)


class Relocated(Vehicles):
    """A vehicle that is told where it is: at once, and on a node, as behind the door of a lift."""

    PLACE = {"x": 10.0, "y": -2.0, "theta": math.pi / 2, "mapId": "hall", "lastNodeId": "dock"}
    CELLAR = {"x": 1.0, "y": 5.0, "theta": 0.0, "mapId": "cellar"}

    def setUp(self):
        self.broker = Broker(self)
        self.fleet = Fleet(self, self.broker)
        # Without --at wheels know no place.
        bus = [f"sim:{ROOT / 'groups' / 'tcc-2.toml'}", "--visualization-interval", "0.1"]
        self.vehicle(self.broker, bus, serial=SERIAL)

    def lift(self, name, theta=0.0):
        """Up in the hall to (10, -1), there the door, and on in the cellar from (1, 5) to (2, 5)."""
        through = order(name, [(10, -2), (10, -1), (2, 5)])
        through["nodes"][2]["nodePosition"]["mapId"] = "cellar"
        listed = [{"key": key, "value": value} for key, value in (self.CELLAR | {"theta": theta}).items()]
        through["nodes"][1]["actions"] = [
            {"actionId": f"{name}-door", "actionType": "initPosition", "blockingType": "HARD", "actionParameters": listed}]
        return through

    def test_at_once_and_then_on_a_node_of_an_order(self):
        fleet = self.fleet
        lost = fleet.message(SERIAL, "state")
        self.assertFalse(lost.get("agvPosition", {}).get("positionInitialized", False))
        fleet.order(SERIAL, order("early", [(0, 0), (1, 0)]))
        error = fleet.wait("processed")["error"]
        self.assertEqual(error["errorType"], "noRouteError")
        self.assertIn("send initPosition", error["errorDescription"])
        # What is no place is refused by the parameter's name.
        fleet.instant(SERIAL, "initPosition", "half", x=10.0, y=-2.0, mapId="hall")
        half = fleet.state(SERIAL, lambda s: any(a["actionId"] == "half" for a in s["actionStates"]))
        self.assertEqual(half["actionStates"][-1]["actionStatus"], "FAILED")
        self.assertIn("theta", json.dumps(half["errors"]))
        fleet.instant(SERIAL, "initPosition", "here", **self.PLACE)
        placed = fleet.finished(SERIAL, "here")
        at = position(placed)
        self.assertEqual((at["mapId"], placed["lastNodeId"], at["positionInitialized"]), ("hall", "dock", True))
        self.assertLess(math.hypot(at["x"] - 10, at["y"] + 2), 1e-6, at)
        # An order through the door: the fleet control sees its action wait and end.
        fleet.order(SERIAL, self.lift("lift"))
        fleet.wait("action", lambda e: (e["id"], e["status"]) == ("lift-door", "WAITING"))
        fleet.wait("action", lambda e: (e["id"], e["status"]) == ("lift-door", "FINISHED"))
        done = fleet.wait("processed")
        self.assertEqual((done["error"], done["cancelled"], done["active"]), (None, False, False))
        end = fleet.state(SERIAL, lambda s: s["orderId"] == "lift" and idle(s))
        at = position(end)
        self.assertEqual((at["mapId"], end["lastNodeId"], end["errors"]), ("cellar", "n2", []))
        self.assertLess(math.hypot(at["x"] - 2, at["y"] - 5), 0.03, at)
        self.assertLess(abs(at["theta"]), 0.03, at)
        # It stood at the door on the one map and on the other, and drove a metre ahead on each.
        shown = [e["message"] for e in fleet.seen if e["event"] == "raw" and e["topic"] == "visualization"]
        for name, along, across, start in [("hall", "y", "x", -2), ("cellar", "x", "y", 1)]:
            moving = [m for m in shown if m["agvPosition"]["mapId"] == name and m.get("velocity", {}).get("vx", 0) > 0.05]
            self.assertGreater(len(moving), 2, name)
            for message in moving:
                at = message["agvPosition"]
                self.assertLess(abs(at[across] - {"hall": 10, "cellar": 5}[name]), 0.03, at)
                self.assertTrue(start - 0.03 < at[along] < start + 1.03, at)
                self.assertLess(abs(message["velocity"]["vy"]), 0.05, message)
        # Nodes in the hall are on another map now, and while an order is executed the place is not changed.
        fleet.order(SERIAL, order("back", [(10, -1), (10, -2)]))
        self.assertIn("hall", fleet.wait("processed")["error"]["errorDescription"])
        away = order("away", [(2, 5), (4, 5)], maxSpeed=0.3)
        for node in away["nodes"]:
            node["nodePosition"]["mapId"] = "cellar"
        fleet.order(SERIAL, away)
        fleet.state(SERIAL, lambda s: s["driving"])
        fleet.instant(SERIAL, "initPosition", "no", **self.PLACE)
        refused = fleet.state(SERIAL, lambda s: any(a["actionId"] == "no" for a in s["actionStates"]))
        self.assertIn("cancel it first", json.dumps(refused["errors"]))
        self.assertEqual(position(refused)["mapId"], "cellar")
        fleet.instant(SERIAL, "cancelOrder", "c")
        fleet.finished(SERIAL, "c")

    def test_a_door_that_is_never_reached_fails_with_its_order_and_an_unusable_one_is_refused(self):
        fleet = self.fleet
        fleet.message(SERIAL, "state")
        fleet.instant(SERIAL, "initPosition", "here", **self.PLACE)
        fleet.finished(SERIAL, "here")
        fleet.order(SERIAL, self.lift("turned", theta=7.0))
        error = fleet.wait("processed")["error"]
        self.assertEqual(error["errorType"], "orderError")
        self.assertIn("between -pi and pi", error["errorDescription"])
        fleet.order(SERIAL, self.lift("lift"))
        fleet.state(SERIAL, lambda s: s["driving"])
        fleet.instant(SERIAL, "cancelOrder", "c")
        stands = fleet.finished(SERIAL, "c")
        doors = [a for a in stands["actionStates"] if a["actionId"] == "lift-door"]
        self.assertEqual([a["actionStatus"] for a in doors], ["FAILED"])
        self.assertEqual(position(stands)["mapId"], "hall")


class Line(Vehicles):
    def test_what_waits_while_the_connection_is_cut_arrives_in_its_order(self):
        broker = Broker(self)
        fleet, line = Fleet(self, broker), Proxy(self, broker)
        self.simulated(line, "tcc-2.toml", serial=SERIAL)
        fleet.state(SERIAL, lambda s: s["agvPosition"]["positionInitialized"])
        fleet.order(SERIAL, order("on", [(0, 0), (1, 0), (2, 0), (3, 0)], maxSpeed=0.8))
        fleet.state(SERIAL, lambda s: s["driving"])
        line.cut()
        fleet.message(SERIAL, "connection", lambda m: m["connectionState"] == "CONNECTIONBROKEN")
        # With quality 1 the broker keeps it for the vehicle.
        asked = {"actionId": "away", "actionType": "stateRequest", "blockingType": "NONE", "actionParameters": []}
        fleet.send(SERIAL, "instantActions", {"actions": [asked]}, qos=1)
        # Time for some nodes; where it does not suffice, fewer states wait.
        time.sleep(6)
        line.mend()
        fleet.message(SERIAL, "connection", lambda m: m["connectionState"] == "ONLINE")
        fleet.state(SERIAL, lambda s: any(a["actionId"] == "away" for a in s["actionStates"]))
        if not idle(fleet.states(SERIAL)[-1]):
            fleet.state(SERIAL, idle)
        states = fleet.states(SERIAL)
        numbers = [s["headerId"] for s in states]
        self.assertEqual(numbers, list(range(numbers[0], numbers[0] + len(numbers))), "none is missing")
        ahead = [remaining(s) for s in states if s["orderId"] == "on"]
        steps = [nodes for nodes, before in zip(ahead, [None, *ahead]) if nodes != before]
        self.assertEqual(steps, [["n1", "n2", "n3"], ["n2", "n3"], ["n3"], []])


@drives_in_real_time
class Fault(Vehicles):
    def test_a_robot_that_fails_in_the_middle_and_poses_from_outside(self):
        broker = Broker(self)
        fleet = Fleet(self, broker)
        world, places = self.world("tcc-3.toml", "--pose-tcp", "127.0.0.1:0")
        group = ROOT / "groups" / "tcc-3.toml"
        bus = [f"slcan-tcp://{places['slcan-tcp']}", "--group", str(group)]
        self.vehicle(broker, bus, "--pose", f"tcp://{places['pose-tcp']}", "--at", "5,5,90", serial=SERIAL)
        start = fleet.state(SERIAL, lambda s: s["agvPosition"]["positionInitialized"])["agvPosition"]
        # The world's origin is at (5, 5) on the map, turned to the left.
        self.assertLess(math.hypot(start["x"] - 5, start["y"] - 5), 0.02, start)
        self.assertLess(abs(start["theta"] - math.pi / 2), 0.02)
        fleet.order(SERIAL, order("x", [(5, 5), (5, 9)], maxSpeed=0.4))
        fleet.state(SERIAL, lambda s: s["driving"])
        world.stdin.write("node=3:driver-fault\n")
        world.stdin.flush()
        broken = fleet.state(SERIAL, lambda s: not s["driving"] and s["errors"])
        self.assertTrue(any(e["errorLevel"] == "FATAL" for e in broken["errors"]), broken["errors"])
        self.assertIn("3", json.dumps(broken["errors"]), "the node is named")
        self.assertEqual(remaining(broken), ["n1"], "the order is kept until it is cancelled")
        fleet.instant(SERIAL, "cancelOrder", "c")
        fleet.finished(SERIAL, "c")


    def test_a_bus_that_is_gone_ends_the_program_with_its_own_exit_code_and_the_will_says_so(self):
        broker = Broker(self)
        fleet = Fleet(self, broker)
        world, places = self.world("single.toml")
        bus = [f"slcan-tcp://{places['slcan-tcp']}", "--group", str(ROOT / "groups" / "single.toml"), "--at", "0,0"]
        process = self.vehicle(broker, bus, serial=SERIAL, ends=3)
        fleet.state(SERIAL, lambda s: s["agvPosition"]["positionInitialized"])
        fleet.order(SERIAL, order("x", [(0, 0), (4, 0)], maxSpeed=0.4))
        fleet.state(SERIAL, lambda s: s["driving"])
        world.kill()
        fleet.message(SERIAL, "connection", lambda m: m["connectionState"] in ("OFFLINE", "CONNECTIONBROKEN"))
        self.assertEqual(process.wait(PATIENCE), 3)


class TwoVehicles(Vehicles):
    def test_two_groups_on_one_broker_are_kept_apart(self):
        broker = Broker(self)
        fleet = Fleet(self, broker)
        for serial in ["west", "east"]:
            self.simulated(broker, "tcc-2.toml", serial=serial)
            fleet.state(serial, lambda s: s["agvPosition"]["positionInitialized"])
        fleet.order("west", order("same", [(0, 0), (1, 0)]))
        west = fleet.state("west", lambda s: s["orderId"] == "same" and idle(s))
        self.assertLess(abs(west["agvPosition"]["x"] - 1), 0.03)
        fleet.instant("east", "stateRequest", "s")
        east = fleet.state("east", lambda s: s["actionStates"])
        self.assertEqual((east["orderId"], east["agvPosition"]["x"]), ("", 0.0))
        fleet.order("east", order("same", [(0, 0), (0, 1)]))
        east = fleet.state("east", lambda s: s["orderId"] == "same" and idle(s))
        self.assertLess(abs(east["agvPosition"]["y"] - 1), 0.03)


class OtherVersions(Vehicles):
    def drive(self, protocol, version, number):
        broker = Broker(self)
        fleet = Fleet(self, broker)
        self.simulated(broker, "tcc-2.toml", serial=SERIAL, protocol=protocol)
        fleet.message(SERIAL, "state")
        fleet.send(SERIAL, "order", order("a", [(0, 0), (1, 0)]), version=version, number=number)
        fleet.state(SERIAL, lambda s: s["orderId"] == "a" and idle(s))
        fleet.send(SERIAL, "order", order("b", [(7, 0), (8, 0)]), version=version, number=number)
        fleet.state(SERIAL, lambda s: s["errors"])
        return [e for e in fleet.seen if e["event"] == "raw" and e["topic"] not in ("order", "instantActions")]

    def test_2_1_by_its_schemas(self):
        files = importlib.metadata.files("vda5050-sdk")
        schemas = {file.stem: json.loads(file.read_text()) for file in files if file.parent.name == "schemas"
                   and file.suffix == ".json"}
        messages = self.drive("2.1", "v2", "2.1.0")
        self.assertEqual({m["topic"] for m in messages}, {"connection", "state", "factsheet", "visualization"})
        for message in messages:
            self.assertEqual(message["message"]["version"], "2.1.0")
            jsonschema.validate(message["message"], schemas[message["topic"]])

    def test_3_0_by_its_names(self):
        messages = self.drive("3.0", "v3", "3.0.0")
        self.assertEqual({m["version"] for m in messages}, {"v3"})
        state = [m["message"] for m in messages if m["topic"] == "state"][-1]
        self.assertEqual(state["errors"][0]["errorType"], "START_NODE_OUT_OF_RANGE")
        self.assertTrue(state["mobileRobotPosition"]["localized"])
        self.assertLess(abs(state["mobileRobotPosition"]["x"] - 1), 0.03)
        self.assertIn("powerSupply", state)
        self.assertEqual(state["safetyState"]["activeEmergencyStop"], "NONE")


class Locked(Vehicles):
    def test_tls_with_a_password(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        at = pathlib.Path(folder.name)

        def openssl(*arguments):
            subprocess.run(["openssl", *arguments], cwd=at, check=True, capture_output=True)

        openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                "-subj", "/CN=test authority", "-keyout", "ca.key", "-out", "ca.pem")
        openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", "/CN=localhost",
                "-keyout", "broker.key", "-out", "broker.csr")
        (at / "names").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
        openssl("x509", "-req", "-in", "broker.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial",
                "-days", "2", "-extfile", "names", "-out", "broker.pem")
        subprocess.run(["mosquitto_passwd", "-c", "-b", at / "users", "group", "right horse"], check=True)
        for file in at.iterdir():
            file.chmod(0o644)
        (at / "secret").write_text("right horse\n")
        (at / "wrong").write_text("wrong horse\n")
        broker = Broker(self, "allow_anonymous false", f"password_file {at / 'users'}", f"cafile {at / 'ca.pem'}",
                        f"certfile {at / 'broker.pem'}", f"keyfile {at / 'broker.key'}")
        fleet = Fleet(self, broker, "mqtts", {"username": "group", "password": "right horse"},
                      {"NODE_EXTRA_CA_CERTS": str(at / "ca.pem")})
        locked = ["--ca", str(at / "ca.pem"), "--user", "group", "--password-file"]
        self.simulated(broker, "single.toml", *locked, str(at / "secret"), serial="right", scheme="mqtts")
        fleet.state("right", lambda s: s["agvPosition"]["positionInitialized"])
        # A wrong password, another authority, no encryption: said in words, and nothing is published.
        openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                "-subj", "/CN=another authority", "-keyout", "other.key", "-out", "other.pem")
        wrong, right = (["--user", "group", "--password-file", at / name] for name in ("wrong", "secret"))
        for scheme, options, word in [("mqtts", ["--ca", at / "ca.pem", *wrong], "efused"),
                                      ("mqtts", ["--ca", at / "other.pem", *right], "ertificate"),
                                      ("mqtt", wrong, "unencrypted")]:
            command = [os.environ["OMNIBUS"], "vda5050", "--broker", f"{scheme}://localhost:{broker.port}", "--serial",
                       "wrong", "--bus", "sim:" + str(ROOT / "groups" / "single.toml"), *options]
            process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
            limit = threading.Timer(PATIENCE, process.kill)
            limit.start()
            said = ""
            while word not in said:
                line = process.stderr.readline()
                self.assertTrue(line, said)
                said += line
            limit.cancel()
            process.send_signal(signal.SIGINT)
            process.stderr.close()
            self.assertEqual(process.wait(PATIENCE), 0)
        self.assertFalse(any(e.get("serial") == "wrong" for e in fleet.seen))


class Documented(Vehicles):
    def test_the_commands_of_the_page_lead_from_zero_to_an_order(self):
        page = (ROOT / "docs" / "vda5050.md").read_text()
        section = page.split("## From zero to an order")[1].split("\n## ")[0]
        blocks = [block.split("```")[0].splitlines() for block in section.split("```sh\n")[1:]]
        build, (start, drive), (watch,), (send,), (pause, resume) = blocks
        self.assertEqual(build, ["cargo install --profile dev --locked --path master --features vda5050"])
        port = str(free_port())

        programs = tempfile.TemporaryDirectory()
        self.addCleanup(programs.cleanup)
        for name, program in (("omnibus", os.environ["OMNIBUS"]), ("mosquitto", MOSQUITTO)):
            pathlib.Path(programs.name, name).symlink_to(program)
        variables = os.environ | {"PATH": f"{programs.name}:{os.environ['PATH']}"}

        def run(line):
            line = line.replace("1883", port)
            process = subprocess.Popen(["bash", "-c", line if "|" in line else f"exec {line}"], cwd=ROOT, env=variables,
                                       stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self.addCleanup(process.stdout.close)
            self.addCleanup(process.stderr.close)
            self.addCleanup(process.wait, PATIENCE)
            self.addCleanup(process.send_signal, signal.SIGINT)
            return process

        run(start)
        wait_for_port(int(port))
        run(drive)
        watched = run(watch)
        states = (json.loads(line.split(" ", 1)[1]) for line in watched.stdout)
        next(state for state in states if state["agvPosition"]["positionInitialized"])
        self.assertEqual(run(send).wait(PATIENCE), 0)
        next(state for state in states if state["driving"])
        self.assertEqual(run(pause).wait(PATIENCE), 0)
        next(state for state in states if state["paused"] and not state["driving"])
        self.assertEqual(run(resume).wait(PATIENCE), 0)
        ahead, last = [["corner", "dock"]], None
        while last is None or not (last["lastNodeId"] == "dock" and idle(last)):
            last = next(states)
            if last["orderId"] == "first" and (not ahead or ahead[-1] != remaining(last)):
                ahead.append(remaining(last))
        self.assertEqual(ahead, [["corner", "dock"], ["dock"], []])
        at = last["agvPosition"]
        self.assertLess(math.hypot(at["x"] - 1.5, at["y"] - 2.5), 0.03, at)
