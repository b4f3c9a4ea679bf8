"""A ROS 2 peer made of CycloneDDS and rosbags: neither knows anything of our code.

`rosbags` knows the messages of ROS 2 distributions; from its definitions the types for CycloneDDS are made, so names,
order and layout of fields are those of others. CycloneDDS carries them. Names of topics and types are mangled as ROS
does (`rt/`, `rq/`, `rr/`, `dds_`). Nothing here measures time: a test waits long for what must come.
"""

import itertools
import os
import pathlib
import re
import signal
import subprocess
import threading
import time
import unittest

# Before the library is loaded: this computer alone, without multicast.
os.environ["CYCLONEDDS_URI"] = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>11</MaxAutoParticipantIndex>"
    "<Peers><Peer Address='127.0.0.1'/></Peers></Discovery>"
    # It reports every malformed datagram.
    "<Tracing><OutputFile>/dev/null</OutputFile></Tracing></Domain></CycloneDDS>"
)

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import make_idl_struct, types  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
PATIENCE = 60.0
"""Seconds to wait for what must come."""

STORE = get_typestore(Stores.ROS2_JAZZY)
BASES = {
    "bool": bool, "byte": types.uint8, "uint8": types.uint8, "int32": types.int32, "uint32": types.uint32,
    "float32": types.float32, "float64": types.float64, "string": str,
}
_made = {}


def dds_name(name):
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def of_description(description):
    kind, detail = description[0].name, description[1]
    if kind == "BASE":
        return BASES[detail[0]]
    if kind == "NAME":
        return message(detail)
    inner = of_description(detail[0])
    return types.sequence[inner] if kind == "SEQUENCE" else types.array[inner, detail[1]]


def message(name):
    """The type of a message, such as `nav_msgs/msg/Odometry`, for CycloneDDS."""
    if name not in _made:
        fields = {field: of_description(what) for field, what in STORE.fielddefs[name][1]}
        _made[name] = make_idl_struct(name.split("/")[-1], dds_name(name), fields)
    return _made[name]


def struct(name, **fields):
    """A type of which there is no message: requests and replies."""
    if name not in _made:
        _made[name] = make_idl_struct(name.split("/")[-1], dds_name(name), fields)
    return _made[name]


def new(name, **values):
    """A message with zeros where nothing is given."""
    fields = {}
    for field, (kind, detail) in STORE.fielddefs[name][1]:
        if field in values:
            fields[field] = values.pop(field)
        elif kind.name == "NAME":
            fields[field] = new(detail)
        elif kind.name == "BASE":
            fields[field] = {"string": "", "bool": False, "float64": 0.0, "float32": 0.0}.get(detail[0], 0)
        else:
            fields[field] = []
    assert not values, values
    return message(name)(**fields)


def qos(reliable=True, latched=False, depth=10):
    reliability = Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort
    durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
    return Qos(reliability, durability, Policy.History.KeepLast(depth))


def twist(vx=0.0, vy=0.0, omega=0.0):
    linear = new("geometry_msgs/msg/Vector3", x=vx, y=vy)
    return new("geometry_msgs/msg/Twist", linear=linear, angular=new("geometry_msgs/msg/Vector3", z=omega))


def stamp(seconds):
    return new("builtin_interfaces/msg/Time", sec=int(seconds), nanosec=int(seconds % 1 * 1e9))


def stamped(vx=0.0, vy=0.0, omega=0.0, frame="", at=None):
    """Stamped with now, unless another time is given; 0 is not said."""
    header = new("std_msgs/msg/Header", stamp=stamp(time.time() if at is None else at), frame_id=frame)
    return new("geometry_msgs/msg/TwistStamped", header=header, twist=twist(vx, vy, omega))


HEADER = {"guid": types.uint64, "sequence": types.int64}
"""What goes before requests and replies in the form of rmw_cyclonedds."""


class Request:
    """Writes requests of a service."""

    def __init__(self, writer, of, guid):
        self.writer, self.of, self.guid = writer, of, guid

    def make(self, data, sequence=1):
        return self.of(self.guid, sequence, data)

    def write(self, request, at=None):
        """Stamped with now, unless another time is given."""
        self.writer.write(request, None if at is None else int(at * 1e9))


class Service:
    """A caller of a service as rmw_cyclonedds makes one: who asks, and the how manieth time, go before."""

    def __init__(self, name, asks, hears):
        self.name, self.asks, self.hears, self.sequence = name, asks, hears, 0

    def is_there(self):
        return self.asks.writer.get_matched_subscriptions() and self.hears.get_matched_publications()

    def ask(self, data=0, at=None):
        """Calls it once and waits for nothing."""
        self.sequence += 1
        self.asks.write(self.asks.make(data, self.sequence), at)

    def __call__(self, data=0, at=None):
        """Calls it and returns the answer."""
        until("the service", self.is_there)
        before = self.sequence
        # The server may not have found the reader of replies yet, and replies are not kept: ask again.
        for _ in range(20):
            self.ask(data, at)
            answers = []
            try:
                until("an answer", lambda: answers.extend(
                    one for one in taken(self.hears)
                    if one.guid == self.asks.guid and one.sequence > before) or answers, PATIENCE / 20)
            except AssertionError:
                continue
            return answers[-1]
        raise AssertionError(f"no answer of {self.name}")


class Domain:
    """The domain of each attempt of a test: of its own, because a node that was killed is believed alive for most of a
    minute, and until then callers keep for it, and give to every later node, what they have called."""

    # From 1 to 100, whose ports are below those that the kernel gives to others.
    numbers = (1 + number % 100 for number in itertools.count(os.getpid()))
    now = next(numbers)

    @classmethod
    def another(cls):
        cls.now = next(cls.numbers)


class Peer:
    """One participant."""

    def __init__(self, namespace="", domain=None):
        self.participant = DomainParticipant(Domain.now if domain is None else domain)
        self.namespace = namespace
        self.counter = 0

    def topic(self, name, of, prefix="rt"):
        return Topic(self.participant, f"{prefix}{self.namespace}/{name}", of)

    def reader(self, name, of, **settings):
        return DataReader(self.participant, self.topic(name, message(of)), qos=qos(**settings))

    def writer(self, name, of, **settings):
        return DataWriter(self.participant, self.topic(name, message(of)), qos=qos(**settings))

    def request(self, name, of, guid):
        """What writes requests of a service."""
        body = {"data": bool} if of == "SetBool" else {"structure_needs_at_least_one_member": types.uint8}
        made = struct(f"std_srvs/srv/{of}_Request", **HEADER, **body)
        return Request(DataWriter(self.participant, self.topic(name + "Request", made, "rq"), qos=qos()), made, guid)

    def service(self, name, of="Trigger"):
        guid = (os.getpid() << 20) + self.counter
        self.counter += 1
        reply = struct(f"std_srvs/srv/{of}_Response", **HEADER, success=bool, message=str)
        hears = DataReader(self.participant, self.topic(name + "Reply", reply, "rr"), qos=qos())
        return Service(name, self.request(name, of, guid), hears)


def taken(reader):
    """What has come, without the notes that someone has gone."""
    return [one for one in reader.take(200) if not isinstance(one, type(None)) and hasattr(one, "__idl__")
            and one.sample_info.valid_data]


def until(what, question, patience=PATIENCE):
    """Waits until the answer is true; returns it."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        answer = question()
        if answer:
            return answer
        time.sleep(0.005)
    raise AssertionError(f"not within {patience} s: {what}")


class Repeated:
    """Publishes at 20 Hz until it is left; `twist` may change meanwhile."""

    def __init__(self, writer, make):
        self.writer, self.make, self.count = writer, make, 0
        self.over = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def run(self):
        while not self.over.wait(0.05):
            self.writer.write(self.make())
            self.count += 1

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()


def udp_ports(pid):
    """The ports on which a process listens."""
    with open(f"/proc/{pid}/net/udp") as table:
        rows = [line.split() for line in table.readlines()[1:]]
    ports = {row[9]: int(row[1].rpartition(":")[2], 16) for row in rows}
    found = set()
    for descriptor in os.listdir(f"/proc/{pid}/fd"):
        try:
            target = os.readlink(f"/proc/{pid}/fd/{descriptor}")
        except FileNotFoundError:
            continue
        found.add(ports.get(target.removeprefix("socket:[").removesuffix("]")))
    return found - {None}


class Node:
    """`omnibus ros` in a process."""

    def __init__(self, test, *arguments, group="tcc-2", bus=None, domain=None, within=None, **environment):
        variables = {
            **os.environ, "ROS_DOMAIN_ID": str(Domain.now if domain is None else domain), "ROS_LOCALHOST_ONLY": "1",
            "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", **environment,
        }
        file = ROOT / "groups" / f"{group}.toml"
        where = ["--bus", bus, "--group", file] if bus else ["--bus", f"sim:{file}"]
        # In a network namespace, where one is named.
        inside = ["ip", "netns", "exec", within] if within else []
        command = [*inside, os.environ["OMNIBUS"], "ros", *where, *arguments]
        self.process = subprocess.Popen(command, env=variables,
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        test.addCleanup(self.end)

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            self.said = self.process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode


class Watcher:
    """The newest of what a node tells."""

    def __init__(self, peer):
        self.peer = peer
        self.readers = {
            "odom": peer.reader("odom", "nav_msgs/msg/Odometry"),
            "diagnostics": peer.reader("diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
            "joints": peer.reader("joint_states", "sensor_msgs/msg/JointState"),
        }
        self.newest = {}
        self.count = dict.fromkeys(self.readers, 0)

    def news(self, name):
        """What has come on a topic since the last look."""
        news = taken(self.readers[name])
        for one in news:
            self.newest[name] = one
            self.count[name] += 1
        return news

    def look(self):
        for name in self.readers:
            self.news(name)
        return self

    @property
    def place(self):
        position = self.look().newest["odom"].pose.pose.position
        return position.x, position.y

    @property
    def speed(self):
        linear = self.look().newest["odom"].twist.twist.linear
        return (linear.x ** 2 + linear.y ** 2) ** 0.5

    def status(self, name):
        array = self.look().newest.get("diagnostics")
        found = [one for one in array.status if one.name == f"omnibus: {name}"] if array else []
        return found[0] if found else None

    def says(self, name, pattern):
        """Waits until the status of that name says so; returns it."""
        def found():
            status = self.status(name)
            return status if status and re.search(pattern, status.message) else None
        try:
            return until(f"{name}: {pattern}", found)
        except AssertionError as error:
            raise AssertionError(f"{error}; it says {self.status(name)}") from None

    def stands(self):
        """Waits for standstill that is measured anew."""
        self.look().newest.pop("odom", None)
        until("standstill", lambda: "odom" in self.look().newest and self.speed < 1e-3)


class RosTest(unittest.TestCase):
    def setUp(self):
        Domain.another()

    def started(self, *arguments, namespace="", **settings):
        """A node whose robots are started, and who watches it."""
        node = Node(self, *arguments, **settings)
        peer = Peer(namespace)
        watcher = Watcher(peer)
        try:
            until("odom", lambda: "odom" in watcher.look().newest)
        except AssertionError as error:
            ended = node.process.poll()
            node.end()
            raise AssertionError(f"{error}; the node had ended with {ended} and wrote {node.said}") from None
        answer = peer.service("start")()
        self.assertTrue(answer.success, answer.message)
        name = settings.get("group", "tcc-2")
        watcher.says(name, "following")
        return node, peer, watcher
