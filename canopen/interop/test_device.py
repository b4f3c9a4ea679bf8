"""python-canopen as the master of the `interop` example, over slcan on TCP.

`cargo xtask interop` runs it. By hand:

    cargo build -p omnibus-canopen --example interop
    python3 -m venv .venv && .venv/bin/pip install -r tests/interop/requirements.txt
    .venv/bin/python canopen/interop/test_device.py target/debug/examples/interop

Every test starts its own device. Nobody sleeps for synchronisation: tests wait for frames, and the
few that wait for silence wait longer than the device could take. On a busy machine a test takes longer; it does
not fail.
"""

import os
import queue
import socket
import subprocess
import sys
import tempfile
import time
import unittest

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, datatypes as t

NODE = 5
PATIENCE = 30
"""Seconds to wait for what must come."""
BINARY = "target/debug/examples/interop"


def dictionary():
    od = canopen.ObjectDictionary()

    def var(index, name, kind):
        v = ODVariable(name, index)
        v.data_type = kind
        od.add_object(v)

    def record(kind, index, name, members):
        r = kind(name, index)
        for sub, (member, data_type) in members.items():
            v = ODVariable(member, index, sub)
            v.data_type = data_type
            r.add_member(v)
        od.add_object(r)

    for index, name, kind in [
        (0x1000, "Device type", t.UNSIGNED32),
        (0x1001, "Error register", t.UNSIGNED8),
        (0x1005, "COB-ID SYNC", t.UNSIGNED32),
        (0x1006, "SYNC period", t.UNSIGNED32),
        (0x1007, "SYNC window", t.UNSIGNED32),
        (0x1008, "Name", t.VISIBLE_STRING),
        (0x1009, "Hardware version", t.VISIBLE_STRING),
        (0x100A, "Software version", t.VISIBLE_STRING),
        (0x1014, "COB-ID EMCY", t.UNSIGNED32),
        (0x1015, "EMCY inhibit time", t.UNSIGNED16),
        (0x1017, "Heartbeat", t.UNSIGNED16),
        (0x1019, "SYNC counter", t.UNSIGNED8),
        (0x1F80, "NMT start-up", t.UNSIGNED32),
        (0x2000, "Setpoint", t.UNSIGNED16),
        (0x2001, "Limited", t.UNSIGNED32),
        (0x2002, "Applied", t.UNSIGNED16),
        (0x2003, "Text", t.VISIBLE_STRING),
        (0x2004, "Bytes", t.DOMAIN),
        (0x2005, "Write only", t.UNSIGNED8),
    ]:
        var(index, name, kind)
    u8, u16, u32 = t.UNSIGNED8, t.UNSIGNED16, t.UNSIGNED32
    record(ODArray, 0x1003, "Errors", {0: ("n", u8), 1: ("1", u32), 2: ("2", u32)})
    record(ODArray, 0x1010, "Store", {0: ("n", u8), 1: ("1", u32), 2: ("2", u32)})
    record(ODArray, 0x1011, "Restore", {0: ("n", u8), 1: ("1", u32), 2: ("2", u32)})
    record(ODArray, 0x1016, "Consumers", {0: ("n", u8), 1: ("1", u32), 2: ("2", u32)})
    identity = {0: ("n", u8), 1: ("v", u32), 2: ("p", u32), 3: ("r", u32), 4: ("s", u32)}
    record(ODRecord, 0x1018, "Identity", identity)
    record(ODRecord, 0x1029, "Error behaviour", {0: ("n", u8), 1: ("Communication", u8)})
    for base, kind in [(0x1400, "R"), (0x1800, "T")]:
        for n in range(2):
            members = {0: ("n", u8), 1: ("id", u32), 2: ("type", u8), 3: ("inhibit", u16)}
            members |= {5: ("event", u16), 6: ("start", u8)}
            record(ODRecord, base + n, f"{kind}PDO {n + 1}", members)
            mapping = {0: ("n", u8)} | {sub: (str(sub), u32) for sub in range(1, 9)}
            # A record: of an array python-canopen would write as many entries as there are now.
            record(ODRecord, base + 0x200 + n, f"{kind}PDO {n + 1} mapping", mapping)
    return od


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def wait_for_port(port):
    for _ in range(100 * PATIENCE):
        with socket.socket() as s:
            if s.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.01)
    raise TimeoutError(f"nobody listens on port {port}")


class Case(unittest.TestCase):
    node_id = NODE

    def setUp(self):
        self.memory = tempfile.NamedTemporaryFile(suffix=".bin", delete=False)
        self.memory.close()
        self.start()

    def start(self):
        port = free_port()
        node = "" if self.node_id is None else str(self.node_id)
        self.process = subprocess.Popen([BINARY, f"127.0.0.1:{port}", node, self.memory.name])
        wait_for_port(port)
        self.network = canopen.Network()
        channel = f"socket://127.0.0.1:{port}"
        self.network.connect(interface="slcan", channel=channel, sleep_after_open=0)
        self.node = self.network.add_node(NODE, dictionary())
        self.node.sdo.RESPONSE_TIMEOUT = PATIENCE

    def stop(self):
        self.network.disconnect()
        self.process.kill()
        self.process.wait()

    def power_cycle(self):
        self.stop()
        self.start()

    def tearDown(self):
        self.stop()
        os.unlink(self.memory.name)

    def emergency(self, code):
        """The next emergency message with this code, be it here already or not."""
        for _ in range(100 * PATIENCE):
            while self.node.emcy.log:
                emergency = self.node.emcy.log.pop(0)
                if emergency.code == code:
                    return emergency
            time.sleep(0.01)
        self.fail(f"no emergency 0x{code:04X}")

    def refused(self, code, action):
        with self.assertRaises(canopen.SdoAbortedError) as raised:
            action()
        self.assertEqual(f"{raised.exception.code:08X}", f"{code:08X}")


class Network(Case):
    def test_boot_up_and_every_nmt_state(self):
        nmt = self.node.nmt
        frames = []
        self.network.subscribe(0x700 + NODE, lambda _id, data, _t: frames.append(bytes(data)))
        self.network.nmt.send_command(0x82)
        while b"\0" not in frames:
            nmt.wait_for_heartbeat(PATIENCE)
        for state in ["OPERATIONAL", "STOPPED", "PRE-OPERATIONAL", "OPERATIONAL"]:
            nmt.state = state
            nmt.wait_for_heartbeat(PATIENCE)
            nmt.wait_for_heartbeat(PATIENCE)
            self.assertEqual(nmt.state, state)

    def test_nothing_but_heartbeat_when_stopped(self):
        self.node.nmt.state = "STOPPED"
        self.node.sdo.RESPONSE_TIMEOUT = 0.3
        with self.assertRaises(canopen.SdoCommunicationError):
            self.node.sdo[0x1000].raw

    def test_a_heartbeat_consumer_sends_emergencies(self):
        self.node.sdo[0x1016][1].raw = 0x7F << 16 | 100
        self.network.send_message(0x77F, [5])
        emergency = self.emergency(0x8130)
        self.assertEqual((emergency.register, emergency.data[0]), (0x11, 0x7F))
        self.assertEqual(self.node.sdo[0x1001].raw, 0x11)
        self.assertEqual(self.node.sdo[0x1003][1].raw & 0xFFFF, 0x8130)
        self.network.send_message(0x77F, [5])
        self.assertEqual(self.emergency(0).register, 0)
        self.node.sdo[0x1016][1].raw = 0
        self.node.sdo[0x1003][0].raw = 0
        self.assertEqual(self.node.sdo[0x1003][0].raw, 0)

    def test_a_lost_heartbeat_ends_operational(self):
        self.node.sdo[0x1016][1].raw = 0x7F << 16 | 100
        self.node.nmt.state = "OPERATIONAL"
        self.network.send_message(0x77F, [5])
        self.emergency(0x8130)
        self.node.nmt.wait_for_heartbeat(PATIENCE)
        self.assertEqual(self.node.nmt.state, "PRE-OPERATIONAL")


class Sdo(Case):
    def test_expedited(self):
        self.assertEqual(self.node.sdo[0x1000].raw, 0x00010203)
        self.assertEqual(self.node.sdo[0x1018][4].raw, 0x8899AABB)
        self.node.sdo[0x2000].raw = 0x1234
        self.assertEqual(self.node.sdo[0x2000].raw, 0x1234)

    def test_texts_come_in_segments(self):
        self.assertEqual(self.node.sdo[0x1008].raw, "Interop device")
        self.assertEqual(self.node.sdo[0x2003].raw, "a value that is longer than four bytes")

    def test_segments_and_blocks_of_every_length(self):
        for length in [1, 4, 5, 6, 7, 8, 14, 15, 223, 224, 225, 448, 511]:
            for block in [False, True]:
                data = bytes((7 * i + length) & 0xFF for i in range(length))
                with self.node.sdo[0x2004].open(
                    "wb", size=length, block_transfer=block, buffering=1024
                ) as f:
                    f.write(data)
                for block in [False, True]:
                    with self.node.sdo[0x2004].open("rb", block_transfer=block) as f:
                        self.assertEqual(f.read(), data, f"{length} {block}")

    def test_refusals(self):
        sdo = self.node.sdo
        for code, index, sub, data in [
            (0x06020000, 0x2FFF, 0, b"\0"),
            (0x06090011, 0x2000, 1, b"\0"),
            (0x06010002, 0x2003, 0, b"\0"),
            (0x06070012, 0x2000, 0, b"\0\0\0"),
            (0x06070013, 0x2000, 0, b"\0"),
            (0x06090031, 0x2001, 0, b"\xe9\3\0\0"),
            (0x05040005, 0x2004, 0, bytes(512)),
        ]:
            self.refused(code, lambda: sdo.download(index, sub, data))
        self.refused(0x06010001, lambda: sdo.upload(0x2005, 0))
        self.refused(0x06020000, lambda: sdo.upload(0x2FFF, 0))
        self.refused(0x08000024, lambda: sdo.upload(0x1003, 1))
        self.node.nmt.state = "OPERATIONAL"
        self.refused(0x08000022, lambda: sdo.download(0x2001, 0, bytes(4)))

    def test_a_second_client_is_refused_while_the_first_goes_on(self):
        first = self.node.sdo
        data = bytes(range(40))
        with first[0x2004].open("wb", size=len(data), buffering=0) as f:
            f.write(data[:7])
            self.refused(0x060A0023, lambda: self.node.sdo.upload(0x1000, 0))
            for at in range(7, len(data), 7):
                f.write(data[at : at + 7])
        with first[0x2004].open("rb") as f:
            self.assertEqual(f.read(), data)


class Pdo(Case):
    def test_setpoint_sync_setpoint_applies_the_first(self):
        self.node.nmt.state = "OPERATIONAL"
        self.node.nmt.wait_for_heartbeat(PATIENCE)
        self.node.tpdo.read()
        received = queue.Queue()
        self.node.tpdo[1].add_callback(lambda tpdo: received.put(tpdo[0].raw))
        for value in range(200):
            self.network.send_message(0x205, (2 * value).to_bytes(2, "little"))
            self.network.sync.transmit()
            self.network.send_message(0x205, (2 * value + 1).to_bytes(2, "little"))
            self.assertEqual(received.get(timeout=PATIENCE), 2 * value)

    def test_a_master_can_map_anew(self):
        self.node.tpdo.read()
        tpdo = self.node.tpdo[1]
        tpdo.clear()
        tpdo.add_variable(0x2000)
        tpdo.add_variable(0x2002)
        tpdo.cob_id = 0x1A5
        tpdo.trans_type = 2
        tpdo.save()
        self.node.tpdo.read()
        self.assertEqual([v.index for v in self.node.tpdo[1]], [0x2000, 0x2002])
        self.node.sdo[0x2000].raw = 0x0102
        self.node.nmt.state = "OPERATIONAL"
        received = []
        self.network.subscribe(0x1A5, lambda _id, data, _t: received.append(bytes(data)))
        for counter in range(4):
            self.network.sync.transmit(counter + 1)
        self.node.sdo[0x1000].raw  # The TPDOs are out when this has been answered.
        self.assertEqual(received, [b"\2\1\2\1"] * 2)

    def test_mapping_rules(self):
        sdo = self.node.sdo
        on, off = 0x185, 0x80000185
        self.refused(0x06010000, lambda: sdo.download(0x1A00, 0, b"\0"))
        self.refused(0x06090030, lambda: sdo.download(0x1800, 1, b"\x86\1\0\0"))
        sdo[0x1800][1].raw = off
        sdo[0x1A00][0].raw = 0
        self.refused(0x06090030, lambda: sdo.download(0x1800, 1, on.to_bytes(4, "little")))
        self.refused(0x06040041, lambda: sdo.download(0x1A00, 1, b"\x20\0\1\x20"))
        self.refused(0x06020000, lambda: sdo.download(0x1A00, 1, b"\x20\0\1\x30"))
        for sub in range(1, 6):
            sdo[0x1A00][sub].raw = 0x20020010
        self.refused(0x06040042, lambda: sdo.download(0x1A00, 0, b"\5"))
        self.refused(0x06090030, lambda: sdo.download(0x1800, 2, b"\xfc"))
        sdo[0x1A00][0].raw = 4
        sdo[0x1800][1].raw = on

    def test_an_event_driven_tpdo_with_its_timers(self):
        tpdo = self.node.tpdo[2]
        tpdo.read()
        tpdo.cob_id, tpdo.enabled, tpdo.event_timer = 0x285, True, 50
        tpdo.save()
        self.node.nmt.state = "OPERATIONAL"
        for _ in range(5):
            self.assertIsNotNone(tpdo.wait_for_reception(PATIENCE))
        self.node.sdo[0x1800 + 1][5].raw = 0
        self.node.sdo[0x2000].raw = 0x4321
        for _ in range(10 * PATIENCE):
            if tpdo[0].raw != 0x4321:
                tpdo.wait_for_reception(0.1)
        self.assertEqual(tpdo[0].raw, 0x4321)

    def test_an_rpdo_too_short_and_one_too_late(self):
        self.node.nmt.state = "OPERATIONAL"
        self.network.send_message(0x205, [1])
        self.assertEqual(self.emergency(0x8210).data[:1], b"\1")
        self.network.send_message(0x205, [1, 0])
        self.assertEqual(self.emergency(0).register, 0)
        self.node.sdo[0x1400][5].raw = 50
        self.network.send_message(0x205, [1, 0])
        self.assertEqual(self.emergency(0x8250).data[:1], b"\1")


class Store(Case):
    def test_parameters_survive_a_power_cycle_and_can_be_restored(self):
        sdo = self.node.sdo
        sdo[0x2001].raw = 77
        sdo[0x1017].raw = 50
        self.refused(0x08000020, lambda: sdo.download(0x1010, 1, b"evas"))
        self.node.store()
        self.power_cycle()
        self.assertEqual(self.node.sdo[0x2001].raw, 77)
        self.assertEqual(self.node.sdo[0x1017].raw, 50)
        self.node.restore()
        self.assertEqual(self.node.sdo[0x1017].raw, 50)
        self.power_cycle()
        self.assertEqual(self.node.sdo[0x2001].raw, 0)
        self.assertEqual(self.node.sdo[0x1017].raw, 100)


class Lss(Case):
    node_id = None

    def test_fastscan_node_id_store(self):
        lss = self.network.lss
        found, identity = lss.fast_scan()
        self.assertTrue(found)
        self.assertEqual(identity, [0x00112233, 0x44556677, 0x00010002, 0x8899AABB])
        self.assertEqual(lss.inquire_node_id(), 0xFF)
        lss.configure_node_id(NODE)
        lss.store_configuration()
        lss.send_switch_state_global(lss.WAITING_STATE)
        self.node.nmt.wait_for_heartbeat(PATIENCE)
        self.power_cycle()
        self.assertEqual(self.node.sdo[0x1018][1].raw, 0x00112233)

    def test_selective(self):
        lss = self.network.lss
        identity = (0x00112233, 0x44556677, 0x00010002, 0x8899AABB)
        self.assertTrue(lss.send_switch_state_selective(*identity))
        self.assertEqual(lss.inquire_lss_address(0x5A), 0x00112233)


if __name__ == "__main__":
    if len(sys.argv) > 1 and not sys.argv[1].startswith("-"):
        BINARY = sys.argv.pop(1)
    unittest.main()
