"""`omnibus ros` against Fast DDS, by fast_peer.cpp: topics, and services as rmw_fastrtps maps them."""

import itertools
import math
import os
import socket
import subprocess
import threading

from ros_peer import STORE, Domain, Node, Peer, Repeated, RosTest, Watcher, dds_name, udp_ports, until

ODOMETRY = "nav_msgs/msg/Odometry"
STAMPED = "geometry_msgs/msg/TwistStamped"


def velocity(vx=0.0, vy=0.0):
    """A stamped velocity in CDR; the stamp 0 is not said."""
    made = STORE.types
    vector, time = made["geometry_msgs/msg/Vector3"], made["builtin_interfaces/msg/Time"]
    twist = made["geometry_msgs/msg/Twist"](vector(vx, vy, 0.0), vector(0.0, 0.0, 0.0))
    header = made["std_msgs/msg/Header"](time(0, 0), "base_link")
    return bytes(STORE.serialize_cdr(made[STAMPED](header, twist), STAMPED))


class FastPeer:
    """One participant of Fast DDS, in a process."""

    def __init__(self, test):
        # This computer alone; its shared memory needs more than a container may have.
        variables = {**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
        self.process = subprocess.Popen([os.environ["OMNIBUS_FAST_PEER"], str(Domain.now)], env=variables,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.heard, self.changed = {}, threading.Condition()
        threading.Thread(target=self.read, daemon=True).start()
        test.addCleanup(self.end)

    def read(self):
        for line in self.process.stdout:
            name, text = line.split()
            with self.changed:
                self.heard.setdefault(name, []).append(text)

    def end(self):
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()

    def tell(self, *words):
        self.process.stdin.write(" ".join(words) + "\n")
        self.process.stdin.flush()

    def taken(self, name):
        with self.changed:
            return self.heard.pop(name, [])

    def reader(self, name, topic, of):
        self.tell("reader", name, f"rt/{topic}", dds_name(of))
        return lambda: [STORE.deserialize_cdr(bytes.fromhex(text), of) for text in self.taken(name)]

    def writer(self, name, topic, of):
        self.tell("writer", name, f"rt/{topic}", dds_name(of))
        peer = self

        class Writer:
            def write(self, data):
                peer.tell("write", name, data.hex())

        return Writer()

    def client(self, name, of="Trigger"):
        self.tell("client", name, name, f"std_srvs::srv::dds_::{of}")
        peer = self

        class Client:
            def write(self, data):
                peer.tell("call", name, bytes([0, 1, 0, 0, data]).hex())

        return Client()

    def service(self, name, of="Trigger"):
        asks = self.client(name, of)

        def matched():
            self.tell("matched", name)
            return any(int(count) > 0 for count in until("a number", lambda: self.taken(name)))

        def call(data=0):
            until(f"the service {name}", matched)
            # Replies are not kept for readers that the server has not found yet: ask again.
            for _ in range(20):
                asks.write(data)
                try:
                    answer = bytes.fromhex(until("an answer", lambda: self.taken(name), 3)[-1])
                except AssertionError:
                    continue
                # CDR: four bytes of encapsulation, the truth value, the length of a text with its zero, the text.
                return bool(answer[4]), answer[12:].split(b"\0")[0].decode()
            raise AssertionError(f"no answer of {name}")

        return call


class FastDds(RosTest):
    def test_it_drives_by_topics_and_services(self):
        node = Node(self, RMW_IMPLEMENTATION="rmw_fastrtps_cpp")
        peer = FastPeer(self)
        odom = peer.reader("odom", "odom", ODOMETRY)
        newest = []

        def place():
            newest[:] = odom()[-1:] or newest
            return newest[-1].pose.pose.position if newest else None

        until("odom", place)
        self.assertEqual((newest[-1].header.frame_id, newest[-1].child_frame_id), ("odom", "base_link"))
        command = peer.writer("cmd", "cmd_vel", STAMPED)
        done, why = peer.service("start")()
        self.assertTrue(done, why)
        said = peer.reader("said", "diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        until("the group follows", lambda: any(
            status.name == "omnibus: tcc-2" and "following" in status.message
            for message in said() for status in message.status))
        with Repeated(command, lambda: velocity(vy=0.3)):
            until("half a metre to the left", lambda: place().y > 0.5)
            done, why = peer.service("e_stop_trigger")()
            self.assertTrue(done, why)
            until("standstill", lambda: place() and abs(newest[-1].twist.twist.linear.y) < 1e-3)
        self.assertLess(abs(place().x), 0.02)
        reset = peer.service("e_stop_reset")
        until("reset", lambda: reset()[0])
        done, why = peer.service("enable", "SetBool")(0)
        self.assertTrue(done, why)
        self.assertEqual(node.end(), 0)

    def test_joints_transforms_and_diagnostics_are_read(self):
        Node(self)
        peer = FastPeer(self)
        for topic, of in [("joint_states", "sensor_msgs/msg/JointState"), ("tf", "tf2_msgs/msg/TFMessage"),
                          ("diagnostics", "diagnostic_msgs/msg/DiagnosticArray")]:
            reader = peer.reader(topic, topic, of)
            message = until(topic, reader)[-1]
            if topic == "joint_states":
                self.assertEqual(len(message.name), 8)
            elif topic == "tf":
                self.assertTrue(math.isfinite(message.transforms[0].transform.rotation.w))
            else:
                self.assertTrue(any(status.name == "omnibus: tcc-2" for status in message.status))


class TakenPorts(RosTest):
    """The port for data of a participant is taken, that for discovery beside it is free: what participants that start
    together can leave to each other."""

    def is_free(self, port):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("0.0.0.0", port))
            except OSError:
                return False
        return True

    def test_the_node_takes_ports_that_belong_together(self):
        # Participants of other tests may still have some.
        ports = (7400 + 250 * Domain.now + 10 + 2 * participant for participant in itertools.count())
        free = (port for port in ports if self.is_free(port) and self.is_free(port + 1))
        for discovery in itertools.islice(free, 2):
            taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.addCleanup(taken.close)
            taken.bind(("0.0.0.0", discovery + 1))
        discovery = next(free)
        pair = {discovery, discovery + 1}
        node = Node(self)
        until("the first ports of which both are free", lambda: pair <= udp_ports(node.process.pid))
        until("odom", FastPeer(self).reader("odom", "odom", ODOMETRY))


class OtherMiddleware(RosTest):
    """Calls in the form of a middleware that the node was not told of: refused by name, and nothing is done. In them
    stands who asks where the truth value is looked for."""

    def refuses(self, watcher, service):
        watcher.says("cmd_vel", f"a call of {service}, as another middleware makes it")
        watcher.says("tcc-2", "switched off; call start")

    def test_of_cyclonedds_where_fast_dds_was_named(self):
        Node(self, RMW_IMPLEMENTATION="rmw_fastrtps_cpp")
        peer = Peer()
        watcher = Watcher(peer)
        for service, of in (("start", "Trigger"), ("enable", "SetBool")):
            # What stands in front of the message begins with a 1 here.
            ask = peer.request(service, of, guid=1)
            with Repeated(ask, lambda ask=ask: ask.make(True)):
                self.refuses(watcher, service)

    def test_of_fast_dds_where_cyclonedds_was_named(self):
        Node(self, RMW_IMPLEMENTATION="rmw_cyclonedds_cpp")
        watcher, peer = Watcher(Peer()), FastPeer(self)
        for service, of in (("start", "Trigger"), ("enable", "SetBool")):
            ask = peer.client(service, of)
            with Repeated(ask, lambda: 1):
                self.refuses(watcher, service)
