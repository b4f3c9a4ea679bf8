"""`omnibus ros` against CycloneDDS and the message definitions of rosbags."""

import contextlib
import json
import math
import os
import pathlib
import random
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
from xml.etree import ElementTree

import mcap.reader
import numpy
import ruamel.yaml
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from page import Client
from real_time import drives_in_real_time
from ros_peer import (
    ROOT, STORE, Domain, Node, Peer, Repeated, RosTest, Watcher, new, stamped, taken, twist, udp_ports, until,
)

STAMPED = "geometry_msgs/msg/TwistStamped"
PLAIN = "geometry_msgs/msg/Twist"
WHEELS = ["front_left", "front_right", "rear_left", "rear_right"]


class Drive(RosTest):
    def test_it_strafes_one_metre_stops_resumes_and_obeys_the_emergency_stop(self):
        node, peer, watcher = self.started()
        latched = peer.reader("e_stop", "std_msgs/msg/Bool", latched=True)
        until("no emergency stop", lambda: [one for one in taken(latched) if not one.data])
        writer = peer.writer("cmd_vel", STAMPED)
        with Repeated(writer, lambda: stamped(vy=0.3)):
            until("one metre to the left", lambda: watcher.place[1] >= 1.0)
        # The publisher is silent now: after the timeout the group stands, and not far from there.
        watcher.stands()
        x, y = watcher.place
        self.assertLess(y, 1.0 + 0.3 * 1.0)
        self.assertLess(abs(x), 0.02)
        # Commands again, with stamps that say nothing.
        with Repeated(writer, lambda: stamped(vx=0.3, at=0)):
            until("motion after the timeout", lambda: watcher.place[0] > x + 0.2)
            joints = watcher.newest["joints"]
            names = [f"robot_{robot}_{wheel}_wheel_joint" for robot in (2, 3) for wheel in WHEELS]
            self.assertEqual(list(joints.name), names)
            self.assertEqual((len(joints.position), len(joints.velocity)), (8, 8))
            # 0.3 m/s ahead, and the compensation of the group file by which wheels turn faster: 1.002.
            until("every wheel at its rate", lambda: all(
                abs(rate - 0.3 * 1.002 / 0.1524) < 0.05 for rate in watcher.look().newest["joints"].velocity))
            answer = peer.service("e_stop_trigger")()
            self.assertTrue(answer.success, answer.message)
            until("the emergency stop is told", lambda: [one for one in taken(latched) if one.data])
            watcher.stands()
            watcher.says("tcc-2", "emergency stop")
            watcher.says("cmd_vel", "emergency stop is latched")
            place = watcher.place
            reset = peer.service("e_stop_reset")
            until("refused while someone commands motion",
                  lambda: "has to send zero" in (answer := reset()).message and not answer.success)
            self.assertFalse(peer.service("start")().success)
        # A reader that comes later hears it, too.
        late = Peer().reader("e_stop", "std_msgs/msg/Bool", latched=True)
        until("the emergency stop for a late reader", lambda: [one for one in taken(late) if one.data])
        until("reset", lambda: reset().success)
        until("no emergency stop any more", lambda: [one for one in taken(latched) if not one.data])
        watcher.says("tcc-2", "following")
        self.assertLess(math.dist(place, watcher.place), 0.01, "nothing moved by the reset")
        with Repeated(writer, lambda: stamped(vx=-0.3)):
            until("motion after the reset", lambda: watcher.place[0] < place[0] - 0.1)
        enable = peer.service("enable", "SetBool")
        self.assertTrue(enable(False).success)
        watcher.says("tcc-2", "switched off")
        self.assertTrue(enable(True).success)
        watcher.says("tcc-2", "following")
        for robot in (2, 3):
            self.assertTrue(watcher.status(f"robot {robot}").message)
        self.assertEqual(node.end(), 0)

    def test_odometry_says_how_well_it_knows_and_what_tf_says(self):
        _, peer, watcher = self.started("--namespace", "left", namespace="/left")
        transforms = peer.reader("tf", "tf2_msgs/msg/TFMessage")
        with Repeated(peer.writer("cmd_vel", STAMPED), lambda: stamped(vx=0.3, vy=0.2, frame="left/base_link")):
            until("a way", lambda: watcher.place[0] > 0.5)
        watcher.stands()
        odom = watcher.look().newest["odom"]
        self.assertEqual((odom.header.frame_id, odom.child_frame_id), ("left/odom", "left/base_link"))
        for matrix in (odom.pose.covariance, odom.twist.covariance):
            self.assertTrue(all(matrix[7 * axis] > 0 for axis in range(6)))
        # A standing group knows its velocity better than its place.
        self.assertLess(odom.twist.covariance[0], odom.pose.covariance[0])
        newest = until("tf", lambda: [one for one in taken(transforms)])[-1].transforms[0]
        self.assertEqual((newest.header.frame_id, newest.child_frame_id), ("left/odom", "left/base_link"))
        self.assertAlmostEqual(newest.transform.translation.x, odom.pose.pose.position.x, delta=0.01)
        self.assertLess(abs(time.time() - newest.header.stamp.sec), 120)


class Refusals(RosTest):
    def test_what_cannot_be_followed_moves_nothing_and_is_named(self):
        _, peer, watcher = self.started()
        writer = peer.writer("cmd_vel", STAMPED)
        sideways = stamped(vx=0.1)
        sideways.twist.angular.x = 0.2
        bad = [
            (lambda: stamped(vx=math.nan), "not a finite number"),
            (lambda: stamped(vx=0.1, frame="map"), 'frame_id is "map"'),
            (lambda: stamped(vx=0.1, at=time.time() - 5), "stamp is .* old"),
            (lambda: stamped(vx=0.1, at=time.time() + 5), "stamp is .* ahead"),
            (lambda: stamped(vx=300.0), "10 times the limits"),
            (lambda: stamped(omega=-11.0), "10 times the limits"),
            (lambda: sideways, "angular.x|stamp is"),
        ]
        for make, words in bad:
            with self.subTest(words), Repeated(writer, make):
                watcher.says("cmd_vel", words)
        watcher.stands()
        self.assertLess(math.hypot(*watcher.place), 1e-3)
        # More than the limits (2 m/s) is slowed down and said.
        with Repeated(writer, lambda: stamped(vx=4.0)):
            watcher.says("cmd_vel", "slowed down to 50 %")
            until("the limit", lambda: abs(watcher.speed - 2.0) < 0.05)

    def test_a_publisher_of_the_other_type_is_named(self):
        _, peer, watcher = self.started()
        writer = peer.writer("cmd_vel", PLAIN)
        with Repeated(writer, lambda: twist(vx=0.2)):
            watcher.says("cmd_vel", "publishes geometry_msgs/msg/Twist on cmd_vel; see --stamped")
        self.assertLess(math.hypot(*watcher.place), 1e-3)

    def test_one_publisher_drives_at_a_time(self):
        _, peer, watcher = self.started("--stamped", "false")
        first, second = peer.writer("cmd_vel", PLAIN), Peer().writer("cmd_vel", PLAIN)
        with Repeated(first, lambda: twist(vx=0.2)):
            until("motion", lambda: watcher.speed > 0.1)
            with Repeated(second, lambda: twist(vx=-0.2)):
                watcher.says("cmd_vel", "drives already; only one publisher may drive at a time")
                self.assertGreater(watcher.look().newest["odom"].twist.twist.linear.x, 0)
        watcher.stands()
        with Repeated(second, lambda: twist(vx=-0.2)):
            until("the other direction", lambda: watcher.look().newest["odom"].twist.twist.linear.x < -0.1)


class OldCalls(RosTest):
    """A caller keeps what it calls while it believes that a node that was killed still runs, and gives it to the next
    node. What starts robots is refused then, what stops them is followed."""

    def phases(self, watcher):
        """The phase of the group in two reports, which are a second apart."""
        found = []

        def reported():
            found.extend(value.value for report in watcher.news("diagnostics") for status in report.status
                         if status.name == "omnibus: tcc-2" for value in status.values if value.key == "phase")
            return len(found) >= 2

        until("two reports", reported)
        return set(found)

    def test_what_was_called_before_a_node_began_stops_robots_but_starts_none(self):
        killed, peer = Node(self), Peer()
        start, enable = peer.service("start"), peer.service("enable", "SetBool")
        for service in (start, enable):
            until("the service", service.is_there)
        killed.process.kill()
        killed.process.wait()
        start.ask()
        enable.ask(True)
        node, watcher = Node(self), Watcher(peer)
        self.assertEqual(self.phases(watcher), {"idle"})
        # Calls of one caller come in their order, so the old one has come when this is answered.
        self.assertTrue(enable(False).success)
        self.assertEqual(self.phases(watcher), {"idle"})
        answer = start()
        self.assertTrue(answer.success, answer.message)
        watcher.says("tcc-2", "following")
        # A caller's clock that is an hour behind cannot be told from a call an hour ago.
        hour_ago = time.time() - 3600
        trigger, reset = peer.service("e_stop_trigger"), peer.service("e_stop_reset")
        self.assertTrue(trigger(at=hour_ago).success)
        watcher.says("tcc-2", "emergency stop")
        words = "a call of e_stop_reset .* s older than this node, or its caller's clock is behind"
        answer = reset(at=hour_ago)
        self.assertFalse(answer.success)
        self.assertRegex(answer.message, words)
        watcher.says("cmd_vel", f"refused: {words}")
        until("reset", lambda: reset().success)
        watcher.says("tcc-2", "following")
        self.assertTrue(enable(False, at=hour_ago).success)
        watcher.says("tcc-2", "switched off")
        answer = enable(True, at=hour_ago)
        self.assertFalse(answer.success)
        self.assertIn("a call of enable", answer.message)
        self.assertEqual(node.end(), 0)


class Links(RosTest):
    def test_every_pairing_of_qualities_of_service(self):
        _, peer, watcher = self.started()
        for reliable in (True, False):
            for latched in (True, False):
                with self.subTest(command=(reliable, latched)):
                    writer = Peer().writer("cmd_vel", STAMPED, reliable=reliable, latched=latched)
                    watcher.stands()
                    with Repeated(writer, lambda: stamped(omega=0.3)):
                        until("a turn", lambda: watcher.look().newest["odom"].twist.twist.angular.z > 0.2)
        for reliable in (True, False):
            with self.subTest(reader=reliable):
                reader = Peer().reader("odom", "nav_msgs/msg/Odometry", reliable=reliable)
                until("odom", lambda: taken(reader))
        # A reader that wants what is not offered is not matched: volatile topics keep nothing.
        reader = Peer().reader("odom", "nav_msgs/msg/Odometry", latched=True)
        other = Peer().reader("odom", "nav_msgs/msg/Odometry")
        until("odom beside it", lambda: taken(other))
        self.assertFalse(taken(reader))

    def test_a_peer_killed_and_back(self):
        _, _, watcher = self.started()
        code = (f"import ros_peer, time; writer = ros_peer.Peer(domain={Domain.now}).writer('cmd_vel', "
                f"'{STAMPED}')\nwhile True: writer.write(ros_peer.stamped(vx=0.2)); time.sleep(0.05)")
        for _ in range(2):
            far = watcher.place[0]
            driver = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT / "tests" / "interop")
            try:
                until("motion", lambda: watcher.place[0] > far + 0.1)
            finally:
                driver.kill()
                driver.wait()
            watcher.stands()

    def test_a_node_that_was_stopped_and_continued(self):
        node, peer, watcher = self.started()
        # As by Ctrl-Z and `fg`, a debugger, or a computer that slept: the kernel ends waits for the network early.
        for _ in range(2):
            node.process.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            node.process.send_signal(signal.SIGCONT)
            # What was on its way is not counted.
            time.sleep(0.3)
            watcher.look().newest.clear()
            until("odom", lambda: "odom" in watcher.look().newest)
            latched = peer.reader("e_stop", "std_msgs/msg/Bool", latched=True)
            until("no emergency stop", lambda: [one for one in taken(latched) if not one.data])
            answer = peer.service("start")()
            self.assertTrue(answer.success, answer.message)
            watcher.says("tcc-2", "following")
            far = watcher.place[0]
            with Repeated(peer.writer("cmd_vel", STAMPED), lambda: stamped(vx=0.2)):
                until("motion", lambda: watcher.place[0] > far + 0.1)
        self.assertEqual(node.end(), 0)

    def test_two_groups_on_one_domain(self):
        groups = [self.started("--namespace", name, namespace=f"/{name}", group=group)
                  for name, group in (("left", "tcc-2"), ("right", "tcc-3"))]
        (_, left, left_seen), (_, _, right_seen) = groups
        with Repeated(left.writer("cmd_vel", STAMPED), lambda: stamped(vx=0.2)):
            until("motion of the left group", lambda: left_seen.place[0] > 0.2)
        self.assertLess(math.hypot(*right_seen.place), 1e-3)
        self.assertEqual(right_seen.look().newest["odom"].child_frame_id, "right/base_link")
        self.assertEqual(len(right_seen.newest["joints"].name), 12)

    def test_domains_are_apart_and_tf_and_its_names_can_be_left_to_others(self):
        _, _, watcher = self.started()
        Domain.another()
        Node(self, "--start", "--no-tf", "--frame-prefix", "robot_")
        peer = Peer()
        seen, transforms = Watcher(peer), peer.reader("tf", "tf2_msgs/msg/TFMessage")
        seen.says("tcc-2", "following")
        with Repeated(peer.writer("cmd_vel", STAMPED), lambda: stamped(vx=0.2, frame="robot_base_link")):
            until("motion in the other domain", lambda: seen.place[0] > 0.2)
        odom = seen.newest["odom"]
        self.assertEqual((odom.header.frame_id, odom.child_frame_id), ("robot_odom", "robot_base_link"))
        self.assertFalse(taken(transforms))
        self.assertLess(math.hypot(*watcher.place), 1e-3)

    def test_a_hundred_thousand_mutated_datagrams(self):
        node, peer, watcher = self.started()
        # Those that are the node's alone: CycloneDDS, in this process, does not survive every datagram, and of one
        # sent to a port that participants share only one of them gets it.
        ports = sorted(udp_ports(node.process.pid) - udp_ports(os.getpid()))
        self.assertGreaterEqual(len(ports), 2)
        dice = random.Random(1)
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.addCleanup(sender.close)
        # What participants say to each other, as seeds: submessages of our own making, and all that another peer says
        # to the node. Not what the driver says: whoever can send in its name may command.
        header = b"RTPS\x02\x05\x01\x10" + dice.randbytes(12)
        seeds = [header + bytes([kind, 1, len(body), 0]) + body
                 for kind in (0x06, 0x07, 0x08, 0x09, 0x0C, 0x0E, 0x12, 0x13, 0x15, 0x16)
                 for body in (dice.randbytes(24), bytes(40), dice.randbytes(120))]
        if os.geteuid() == 0 or "CI" in os.environ:
            seeds += self.said_by_another(ports)
        reports = peer.reader("diagnostics", "diagnostic_msgs/msg/DiagnosticArray")

        def followed():
            """Velocities that were taken since the last time, by what each report says."""
            said = [{one.key: one.value for one in status.values} for report in taken(reports)
                    for status in report.status if status.name == "omnibus: cmd_vel"]
            return sum(int(values["taken"]) for values in said), len(said)

        with Repeated(peer.writer("cmd_vel", STAMPED), lambda: stamped(omega=0.3)) as commands:
            until("a turn", lambda: watcher.look().newest["odom"].twist.twist.angular.z > 0.2)
            until("a report", lambda: followed()[1])
            watcher.look()
            written, followed_by, odom = commands.count, [], []
            for number in range(100_000):
                datagram = bytearray(dice.choice(seeds))
                for _ in range(dice.randrange(1, 8)):
                    datagram[dice.randrange(len(datagram))] = dice.randrange(256)
                if dice.random() < 0.1:
                    del datagram[dice.randrange(len(datagram)):]
                sender.sendto(datagram, ("127.0.0.1", dice.choice(ports)))
                if number % 500 == 0:
                    odom += watcher.news("odom")
                    followed_by.append(followed()[0])
                    time.sleep(0.005)
            # None of them expired, and odometry came all the time.
            self.assertTrue(all(one.twist.twist.angular.z > 0.2 for one in odom))
            times = [one.header.stamp.sec + one.header.stamp.nanosec * 1e-9 for one in odom]
            self.assertLess(max(after - before for before, after in zip(times, times[1:])), 0.25)
            count = watcher.look().count["odom"]
            until("odom goes on", lambda: watcher.look().count["odom"] > count + 20)
            until("it still turns", lambda: watcher.look().newest["odom"].twist.twist.angular.z > 0.2)
        # A busy node may have some still before it; it reports of them when it has taken them.
        until("every velocity has arrived", lambda: followed_by.append(followed()[0])
              or sum(followed_by) >= commands.count - written - 2)
        self.assertIsNone(node.process.poll())
        watcher.stands()
        self.assertEqual(node.end(), 0)

    def said_by_another(self, ports):
        """All datagrams by which a peer in another process gets to know the node, listens to it and may command it."""
        code = (f"import ros_peer, time\npeer = ros_peer.Peer(domain={Domain.now})\n"
                f"writer, watcher = peer.writer('cmd_vel', '{STAMPED}'), ros_peer.Watcher(peer)\n"
                "while True: time.sleep(1)")
        others = []
        self.addCleanup(lambda: [(other.kill(), other.wait()) for other in others])
        known = {datagram[8:20] for datagram in heard(ports, lambda: None)}
        found = heard(ports, lambda: others.append(
            subprocess.Popen([sys.executable, "-c", code], cwd=ROOT / "tests" / "interop")), 6)
        found = [datagram for datagram in found if datagram[8:20] not in known]
        self.assertGreater(len(found), 20)
        return found

    def test_a_damaged_heartbeat_is_kept_away_or_ends_the_node(self):
        """RustDDS 0.15.1 lists every message that a writer says to have and that has not come."""
        if os.geteuid() != 0 and "CI" not in os.environ:
            self.skipTest("only root hears what is said to others")
        node, peer, watcher = self.started()
        ports = udp_ports(node.process.pid) - udp_ports(os.getpid())
        # A heartbeat: reader and writer, the first and the last message (each high, low), and its own number.
        beats = [(datagram, at) for datagram in self.said_by_another(ports)
                 for at in submessages(datagram) if datagram[at] == 0x07]
        self.assertTrue(beats)
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.addCleanup(sender.close)

        def damaged(behind):
            for datagram, at in beats:
                order = "little" if datagram[at + 1] & 1 else "big"
                changed = bytearray(datagram)
                changed[at + 20:at + 24] = (1 << 8).to_bytes(4, order)
                changed[at + 28:at + 32] = (1 << 30).to_bytes(4, order)
                for port in ports:
                    sender.sendto(changed[:20] + behind + changed[20:], ("127.0.0.1", port))

        with Repeated(peer.writer("cmd_vel", STAMPED), lambda: stamped(omega=0.3)):
            until("a turn", lambda: watcher.look().newest["odom"].twist.twist.angular.z > 0.2)
            damaged(b"")
            count = watcher.look().count["odom"]
            until("odom goes on", lambda: watcher.look().count["odom"] > count + 200)
            self.assertGreater(watcher.newest["odom"].twist.twist.angular.z, 0.2)
            # Behind more submessages than the kernel looks at.
            damaged(bytes([0x01, 0x01, 0, 0]) * 40)
            until("the end", lambda: node.process.poll() is not None, 20)
        self.assertEqual(node.end(), 1)
        self.assertIn("the robots were ramped down and switched off", node.said[1])


@drives_in_real_time
class Bus(RosTest):
    """A bus that others reach, too: the simulated world in a process of its own."""

    def world(self, *options):
        world = subprocess.Popen(
            [os.environ["OMNIBUS_SIM"], "serve", ROOT / "groups" / "tcc-2.toml", "--slcan-tcp", "127.0.0.1:0",
             "--fault", "-", *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.addCleanup(world.wait)
        self.addCleanup(world.stdout.close)
        self.addCleanup(world.stdin.close)
        self.addCleanup(world.kill)
        return world, f"slcan-tcp://{world.stdout.readline().split()[1]}"

    @contextlib.contextmanager
    def turning(self, peer, watcher):
        """Turns the group. A machine that was too busy for SYNC stops the robots: then once more."""
        writer, start = peer.writer("cmd_vel", STAMPED), peer.service("start")
        for last in (False, False, False, True):
            with Repeated(writer, lambda: stamped(omega=0.3)):
                try:
                    until("a turn", lambda: watcher.look().newest["odom"].twist.twist.angular.z > 0.2, 15)
                except AssertionError:
                    if last:
                        raise
                else:
                    yield
                    return
            until("started again", lambda: start().success)
            watcher.says("tcc-2", "following")

    def test_the_lowest_supply_is_the_battery_and_late_readers_get_the_model(self):
        world, bus = self.world()
        # A robot without a minimum has nothing that measures.
        for node in ("2", "3"):
            subprocess.run([os.environ["OMNIBUS"], "param", "set", "2025:2", "18", "--node", node, "--bus", bus],
                           check=True, stdout=subprocess.DEVNULL)
        _, peer, watcher = self.started(bus=bus)
        reader, start = peer.reader("battery_state", "sensor_msgs/msg/BatteryState"), peer.service("start")
        world.stdin.write("node=2:supply=24\nnode=3:supply=22.5\n")
        world.stdin.flush()

        def seen():
            # A machine that was too busy for SYNC has stopped the robots.
            if "following" not in watcher.look().status("tcc-2").message:
                start()
            return [one for one in taken(reader) if abs(one.voltage - 22.5) < 0.1]

        newest = until("the supply of the third robot", seen)[-1]
        self.assertEqual((newest.location, newest.present), ("robot_3", True))
        self.assertTrue(math.isnan(newest.current) and math.isnan(newest.percentage))
        late = Peer().reader("robot_description", "std_msgs/msg/String", latched=True)
        model = until("the model", lambda: taken(late))[-1].data
        self.assertEqual(ElementTree.fromstring(model).get("name"), "tcc-2")

    def test_another_master_is_refused_and_told_and_where_it_is_forced_the_driver_here_is_told(self):
        _, bus = self.world()
        _, peer, watcher = self.started(bus=bus)
        drive = [os.environ["OMNIBUS"], "drive", "--vx", "0.1", "--for", "1", "--bus", bus, "--group",
                 ROOT / "groups" / "tcc-2.toml"]
        with self.turning(peer, watcher):
            refused = subprocess.run(drive, capture_output=True, text=True)
            self.assertNotEqual(refused.returncode, 0)
            self.assertIn("another master", refused.stderr)
            watcher.says("tcc-2", "following")
            # A machine that was too busy for SYNC ends this drive, too: then once more.
            drive[drive.index("--for") + 1] = "3"

            def told():
                forced = subprocess.Popen([*drive, "--force"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
                self.addCleanup(forced.communicate)
                until("another master, or the end of its drive", lambda: forced.poll() is not None or is_told())
                return is_told()

            def is_told():
                return "another master" in watcher.look().status("tcc-2").message

            until("told of another master", told)


    def test_a_node_that_is_killed_leaves_a_group_that_stands(self):
        world, bus = self.world("--pose-tcp", "127.0.0.1:0")
        host, port = world.stdout.readline().split()[1].split(":")
        node, peer, watcher = self.started(bus=bus)
        with self.turning(peer, watcher), socket.create_connection((host, int(port))) as line:
            poses = line.makefile()

            def heading():
                return json.loads(poses.readline())["group"]["heading"]

            before = heading()
            until("a true turn", lambda: heading() > before + 0.05)
            node.process.kill()
            # The commands go on, and nobody is there to follow them.
            latest = [heading()]
            until("the same heading a hundred times", lambda: latest.append(heading()) or (
                len(latest) > 100 and max(latest[-100:]) - min(latest[-100:]) < 1e-6))
            poses.close()
        self.assertEqual(node.end(), -signal.SIGKILL)

    def test_a_bus_that_is_gone_ends_the_program_with_its_own_exit_code(self):
        world, bus = self.world()
        node, peer, watcher = self.started(bus=bus)
        with self.turning(peer, watcher):
            world.kill()
            until("the end", lambda: node.process.poll() is not None)
        self.assertEqual(node.end(), 3, node.said)

    def test_a_page_on_the_same_bus_takes_nothing_away_and_each_side_is_told_of_the_other(self):
        _, bus = self.world()
        group = ["--bus", bus, "--group", ROOT / "groups" / "tcc-2.toml"]
        node, peer, watcher = self.started(bus=bus)
        served = subprocess.Popen([os.environ["OMNIBUS"], "serve", "--http", "127.0.0.1:0", "--json", *group],
                                  stdout=subprocess.PIPE, text=True)
        self.addCleanup(served.communicate)
        self.addCleanup(served.send_signal, signal.SIGINT)
        place = json.loads(served.stdout.readline())
        page = Client(place["url"].split("/")[2], place["token"])
        self.addCleanup(page.socket.close)
        # The page wants the robots that a ROS driver has.
        with self.turning(peer, watcher):
            page.until("the other master", lambda: page.states and page.states[-1]["foreign"])
            page.say(type="take")
            page.say(type="start")
            page.until("why not", lambda: any("another master" in event for event in page.events))
            self.assertEqual(page.states[-1]["phase"], "idle")
            watcher.says("tcc-2", "following")
            until("it still turns", lambda: watcher.look().newest["odom"].twist.twist.angular.z > 0.2)
        self.assertEqual(node.end(), 0)
        # A ROS driver wants the robots that the page has.
        page.until("no other master", lambda: not page.states[-1]["foreign"])
        page.start()
        node = Node(self, bus=bus)
        peer = Peer()
        watcher = Watcher(peer)
        watcher.says("tcc-2", "another master commands the robots")
        for service in ("start", "e_stop_trigger", "e_stop_reset"):
            answer = peer.service(service)()
            self.assertFalse(answer.success, service)
            self.assertIn("another master", answer.message)
        self.assertEqual(watcher.status("tcc-2").level, 2)
        self.assertEqual(node.end(), 0)
        page.hear(0.5)
        self.assertEqual(page.states[-1]["phase"], "running")
        # Taken by force, the robots are lost to the page, which is told.
        taken_away = subprocess.Popen([os.environ["OMNIBUS"], "drive", "--vx", "0.1", "--for", "1", "--force", *group],
                                      stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(taken_away.wait)
        page.until("told", lambda: any("took the robots" in event for event in page.events))


class Network(RosTest):
    def test_static_peers_find_each_other_without_multicast(self):
        """Two computers as two network namespaces; the peer neither sends nor hears multicast."""
        if os.geteuid() != 0 and "CI" not in os.environ:
            self.skipTest("only root makes network namespaces")
        here, there = (f"omnibus-{name}-{os.getpid()}" for name in ("here", "there"))
        for name in (here, there):
            self.ip("netns", "add", name)
            self.addCleanup(self.ip, "netns", "delete", name)
        self.ip("link", "add", "door", "netns", here, "type", "veth", "peer", "name", "door", "netns", there)
        for name, address in ((here, "10.77.0.1/24"), (there, "10.77.0.2/24")):
            self.ip("-n", name, "addr", "add", address, "dev", "door")
            for link in ("lo", "door"):
                self.ip("-n", name, "link", "set", link, "up")
        code = ("import os, ros_peer\n"
                "os.environ['CYCLONEDDS_URI'] = ('<CycloneDDS><Domain><General><Interfaces><NetworkInterface "
                "address=\"10.77.0.2\"/></Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
                "<ParticipantIndex>0</ParticipantIndex></Discovery></Domain></CycloneDDS>')\n"
                "reader = ros_peer.Peer(domain={}).reader('odom', 'nav_msgs/msg/Odometry')\n"
                "ros_peer.until('odom', lambda: ros_peer.taken(reader), 20)")
        cases = (("", "0", False), ("10.77.0.2", "0", True), ("10.77.0.2", "1", False))
        begun = []
        for domain, (peers, only, found) in enumerate(cases, start=7):
            node = Node(self, within=here, domain=domain, ROS_LOCALHOST_ONLY=only, ROS_STATIC_PEERS=peers)
            peer = subprocess.Popen(
                ["ip", "netns", "exec", there, sys.executable, "-B", "-c", code.replace("{}", str(domain))],
                cwd=ROOT / "tests" / "interop", stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            self.addCleanup(peer.kill)
            begun.append((node, peer))
        for (node, peer), (peers, only, found) in zip(begun, cases):
            with self.subTest(peers=peers, only=only):
                _, words = peer.communicate()
                self.assertEqual(peer.returncode == 0, found, words)
                self.assertEqual(node.end(), 0, node.said)

    def ip(self, *arguments):
        subprocess.run(["ip", *arguments], check=True)


class Files(unittest.TestCase):
    """What is written for ROS 2, read by others."""

    def omnibus(self, *arguments):
        done = subprocess.run([os.environ["OMNIBUS"], *arguments], cwd=ROOT, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_every_message_has_the_fields_the_layout_and_the_hash_of_rosbags(self):
        program = subprocess.Popen([pathlib.Path(os.environ["OMNIBUS_EXAMPLES"]) / "messages"],
                                   stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.addCleanup(program.wait)
        self.addCleanup(program.stdout.close)
        self.addCleanup(program.stdin.close)
        dice = random.Random(22)
        names = {"std_msgs/msg/Bool", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState",
                 "sensor_msgs/msg/BatteryState", "diagnostic_msgs/msg/DiagnosticArray", PLAIN, STAMPED}
        found = {}
        for _ in names:
            name, definition = program.stdout.readline().split("\t")
            found[name] = json.loads(definition)
        self.assertEqual(set(found), names)
        for name, definition in found.items():
            with self.subTest(name):
                self.assert_same_hash(name, definition)
                for _ in range(100):
                    data = bytes(STORE.serialize_cdr(at_random(name, dice), name)).hex()
                    program.stdin.write(f"{name}\t{data}\n")
                    program.stdin.flush()
                    self.assertEqual(program.stdout.readline().strip(), data)

    def assert_same_hash(self, name, definition):
        read = get_typestore(Stores.EMPTY)
        read.register(get_types_from_msg(definition, name))
        for inner in read.fielddefs:
            self.assertEqual(read.hash_rihs01(inner), STORE.hash_rihs01(inner), inner)

    def test_a_recording_converted_is_read_by_rosbags_and_says_the_same(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        recording, bag = pathlib.Path(folder.name) / "drive.mcap", pathlib.Path(folder.name) / "ros2.mcap"
        self.omnibus("drive", "--vx", "0.1", "--vy", "0.2", "--omega", "0.3", "--for", "3", "--bus",
                     "sim:groups/tcc-2.toml", "--record", recording)
        self.omnibus("convert", recording, "--to", "ros2", "--output", bag)
        told = {}
        with open(recording, "rb") as file:
            for _, channel, message in mcap.reader.make_reader(file).iter_messages():
                told.setdefault(channel.topic, {})[message.log_time] = json.loads(message.data)
        heard = {}
        with Reader(bag) as reader:
            for connection in reader.connections:
                self.assert_same_hash(connection.msgtype, connection.msgdef.data)
            for connection, time_ns, data in reader.messages():
                message = STORE.deserialize_cdr(data, connection.msgtype)
                heard.setdefault(connection.topic, {})[time_ns] = message
                first = message.transforms[0] if connection.topic == "/tf" else message
                stamp = first.header.stamp
                self.assertEqual(stamp.sec * 10**9 + stamp.nanosec, time_ns)
        self.assertEqual(set(heard), {"/odom", "/tf", "/joint_states"})
        self.assertGreater(len(told["/group"]), 300)
        for messages in heard.values():
            self.assertEqual(list(messages), list(told["/group"]), "one message for each SYNC, at its time")
        places, angles = 0, {}
        before = None
        for at, group in told["/group"].items():
            odom, tf, joints = (heard[topic][at] for topic in ("/odom", "/tf", "/joint_states"))
            twist = odom.twist.twist
            measured = group.get("measured", {"vx": 0, "vy": 0, "omega": 0})
            for is_, wanted in [(twist.linear.x, "vx"), (twist.linear.y, "vy"), (twist.angular.z, "omega")]:
                self.assertAlmostEqual(is_, measured[wanted], delta=1e-6)
            if "pose" in group:
                places += 1
                pose, shown = odom.pose.pose, tf.transforms[0].transform
                for is_, wanted in [(pose.position.x, "x"), (pose.position.y, "y"),
                                    (2 * math.atan2(pose.orientation.z, pose.orientation.w), "heading")]:
                    self.assertAlmostEqual(is_, group["pose"][wanted], delta=2e-6)
                self.assertEqual((shown.translation.x, shown.rotation.z), (pose.position.x, pose.orientation.z))
            # Angles are the sum of rates over time.
            rates = dict(zip(joints.name, joints.velocity))
            for node in (2, 3):
                said = told[f"/robot/{node}"].get(at, {}).get("wheel_rates")
                for wheel in WHEELS:
                    name = f"robot_{node}_{wheel}_wheel_joint"
                    wanted = said[wheel] if said else 0.0
                    self.assertAlmostEqual(rates[name], wanted, delta=1e-5)
                    dt = 0.0 if before is None else (at - before) * 1e-9
                    angles[name] = angles.get(name, 0.0) + wanted * dt
            before = at
        self.assertGreater(places, 300)
        for name, angle in zip(joints.name, joints.position):
            self.assertAlmostEqual(angle, angles[name], delta=1e-3)
        # 0.1 and 0.2 m/s in a group that turns by 0.3 rad/s for 3 s, and ramps at both ends.
        self.assertAlmostEqual(2 * math.atan2(pose.orientation.z, pose.orientation.w), 0.9, delta=0.05)

    def test_the_model_has_the_joints_and_the_places_of_the_robots(self):
        model = ElementTree.fromstring(self.omnibus("group", "urdf", "groups/tcc-2.toml"))
        joints = {joint.get("name"): joint for joint in model.findall("joint")}
        links = {link.get("name") for link in model.findall("link")}
        self.assertEqual([name for name, joint in joints.items() if joint.get("type") == "continuous"],
                         [f"robot_{robot}_{wheel}_wheel_joint" for robot in (2, 3) for wheel in WHEELS])
        for joint in joints.values():
            self.assertIn(joint.find("parent").get("link"), links)
            self.assertIn(joint.find("child").get("link"), links)
        place = joints["robot_3_joint"].find("origin").get("xyz").split()
        self.assertEqual([float(number) for number in place], [-0.6, 0, 0])
        wheel = joints["robot_2_rear_right_wheel_joint"].find("origin").get("xyz").split()
        self.assertEqual([float(number) for number in wheel], [-0.35, -0.37, 0.1524])

    def test_the_parameter_files_are_yaml_with_the_limits_of_the_group(self):
        yaml = ruamel.yaml.YAML(typ="safe")
        nav2 = yaml.load(self.omnibus("group", "nav2", "groups/tcc-2.toml", "--frame-prefix", "a/"))
        follow = nav2["controller_server"]["ros__parameters"]["FollowPath"]
        self.assertEqual(follow["motion_model"], "Omni")
        # 80 per cent of 2 m/s and 1 rad/s.
        self.assertAlmostEqual(follow["vy_max"], 1.6, places=6)
        smoother = nav2["velocity_smoother"]["ros__parameters"]
        self.assertEqual([round(number, 6) for number in smoother["max_velocity"]], [1.6, 1.6, 0.8])
        self.assertTrue(all(isinstance(number, float) for number in smoother["max_accel"]))
        costmap = nav2["local_costmap"]["local_costmap"]["ros__parameters"]
        self.assertEqual(costmap["robot_base_frame"], "a/base_link")
        # Two robots in tandem: a rectangle of half 0.6 + 0.35 + 0.1524 m by 0.37 + 0.1524 m.
        corners = {(round(x, 3), round(y, 3)) for x, y in yaml.load(costmap["footprint"])}
        self.assertEqual(corners, {(x, y) for x in (1.102, -1.102) for y in (0.522, -0.522)})
        filtered = yaml.load(self.omnibus("group", "localization", "groups/tcc-2.toml"))
        self.assertEqual(len(filtered["ekf_filter_node"]["ros__parameters"]["odom0_config"]), 15)


@drives_in_real_time
class Documented(RosTest):
    """docs/ros.md, typed in its order. There is no ROS here: a line that begins with `ros2 service call` or `ros2 topic
    pub` is understood by what stands in it, and sent by CycloneDDS. The other lines of `ros2` are not run."""

    def setUp(self):
        super().setUp()
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        (self.folder / "groups").symlink_to(ROOT / "groups")
        (self.folder / "my-group.toml").symlink_to(ROOT / "groups" / "tcc-2.toml")
        programs = self.folder / "programs"
        programs.mkdir()
        (programs / "omnibus").symlink_to(os.environ["OMNIBUS"])
        (programs / "omnibus-sim").symlink_to(os.environ["OMNIBUS_SIM"])
        self.variables = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "ROS_DOMAIN_ID": str(Domain.now),
                          "ROS_LOCALHOST_ONLY": "1", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}

    def type(self, line):
        process = subprocess.Popen(["bash", "-c", f"exec {line}"], cwd=self.folder, env=self.variables,
                                   stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.addCleanup(process.communicate)
        self.addCleanup(process.send_signal, signal.SIGINT)
        return process

    def call(self, peer, line):
        _, _, _, name, of = shlex.split(line)
        answer = peer.service(name.removeprefix("/"), of.removeprefix("std_srvs/srv/"))()
        self.assertTrue(answer.success, answer.message)

    def publish(self, peer, line):
        program, topic, publish, _, rate, name, of, values = shlex.split(line)
        self.assertEqual((program, topic, publish, rate), ("ros2", "topic", "pub", "20"))
        message = filled(of, ruamel.yaml.YAML(typ="safe").load(values))
        return Repeated(peer.writer(name.removeprefix("/"), of), lambda: message)

    def test_the_commands_of_the_page_in_their_order(self):
        page = (ROOT / "docs" / "ros.md").read_text()
        blocks = [block.split("```")[0].splitlines() for block in page.split("```sh\n")[1:]]
        build, (start, call, publish), (world, on_bus), nav2 = blocks
        self.assertEqual(build[0], "cargo install --profile dev --locked --path master --features ros")
        self.assertEqual(build[1].split("#")[0].strip(), start)
        node, peer = self.type(start), Peer()
        watcher = Watcher(peer)
        until("odom", lambda: "odom" in watcher.look().newest)
        self.call(peer, call)
        watcher.says("tcc-2", "following")
        with self.publish(peer, publish):
            until("to the left", lambda: watcher.place[1] > 0.2)
        watcher.stands()
        self.assertLess(abs(watcher.place[0]), 0.02)
        node.send_signal(signal.SIGINT)
        self.assertEqual(node.wait(60), 0)
        # The port of the page may be taken here.
        served = self.type(world.replace("7701", "0"))
        address = served.stdout.readline().split()[1]
        self.type(on_bus.replace("127.0.0.1:7701", address))
        watcher = Watcher(peer)
        until("odom of the other node", lambda: "odom" in watcher.look().newest)
        self.call(peer, call)
        watcher.says("tcc-2", "following")
        # Files for Nav2: made here, and those that the lines of ROS name are there then.
        ours = [line for line in nav2 if line.startswith("omnibus ")]
        for line in ours:
            subprocess.run(["bash", "-c", line], cwd=self.folder, env=self.variables, check=True)
        self.assertEqual([line.split()[:2] for line in nav2[len(ours):]], [["ros2", "run"], ["ros2", "launch"]])
        for line in nav2[len(ours):]:
            file = self.folder / shlex.split(line)[-1].removeprefix("params_file:=")
            if file.suffix == ".urdf":
                self.assertEqual(ElementTree.parse(file).getroot().tag, "robot")
            else:
                self.assertIn("controller_server", ruamel.yaml.YAML(typ="safe").load(file.read_text()))


def submessages(datagram):
    """Where the submessages of a datagram of RTPS begin."""
    at = 20
    while at + 4 <= len(datagram):
        yield at
        length = int.from_bytes(datagram[at + 2:at + 4], "little" if datagram[at + 1] & 1 else "big")
        at = at + 4 + length if length else len(datagram)


def heard(ports, happens, seconds=2.0):
    """What is said to these ports on this computer while that happens and some time after it."""
    found, end = [], time.monotonic() + seconds
    with socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800)) as tap:
        tap.bind(("lo", 0))
        tap.settimeout(0.1)
        happens()
        while time.monotonic() < end:
            try:
                packet = tap.recv(65536)
            except TimeoutError:
                continue
            udp = packet[4 * (packet[0] & 15):]
            if packet[9] == socket.IPPROTO_UDP and int.from_bytes(udp[2:4]) in ports and udp[8:12] == b"RTPS":
                found.append(udp[8:])
    return found


def filled(name, values):
    """A message of that type with these values, and zeros where nothing is given."""
    kinds = dict(STORE.fielddefs[name][1])
    return new(name, **{field: filled(kinds[field][1], value) if isinstance(value, dict) else value
                        for field, value in values.items()})


def at_random(name, dice):
    """A message of that type with fields by chance."""

    def number(kind):
        return {
            "bool": lambda: dice.random() < 0.5, "float32": lambda: float(numpy.float32(dice.gauss(0, 1e3))),
            "float64": lambda: dice.gauss(0, 1e6), "string": lambda: "x" * dice.randrange(9),
            "int32": lambda: dice.randrange(-2**31, 2**31), "uint32": lambda: dice.randrange(2**32),
            # The level of a diagnostic status, one of four.
            "octet": lambda: dice.randrange(4), "byte": lambda: dice.randrange(4),
        }.get(kind, lambda: dice.randrange(256))()

    def value(kind, detail):
        if kind == "BASE":
            return number(detail[0])
        if kind == "NAME":
            return at_random(detail, dice)
        (inner, what), count = detail
        values = [value(inner.name, what) for _ in range(count if kind == "ARRAY" else dice.randrange(4))]
        is_text = inner.name != "BASE" or what[0] == "string"
        return values if is_text else numpy.array(values, dtype=what[0])

    fields = {field: value(kind.name, detail) for field, (kind, detail) in STORE.fielddefs[name][1]}
    return STORE.types[name](**fields)
