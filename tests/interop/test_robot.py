"""python-canopen as the master of a robot: NMT, heartbeat, SDO, PDO, emergencies, LSS."""

import unittest

import canopen

from robot import DEVICE_STATE, NODE, PATIENCE, READ_ONLY, Robot, compensation_set, twist

# As docs/can-protocol.md has it.
WIRE_VERSION = 6
IDENTITY = (0, 0x4F4D4E49, WIRE_VERSION << 16)
"""Vendor, product, revision."""


class Network(Robot):
    def test_every_nmt_state(self):
        for state in ["OPERATIONAL", "STOPPED", "PRE-OPERATIONAL", "OPERATIONAL", "PRE-OPERATIONAL"]:
            self.enter(state)

    def test_both_resets_boot_again_and_restore(self):
        for command, half_track in [(0x82, 0.25), (0x81, 0.2)]:
            self.node.sdo[0x1017].raw = 50
            self.node.sdo[0x2010][1].raw = 0.25
            heartbeats = self.frames(0x700 + NODE)
            self.network.nmt.send_command(command)
            while heartbeats.get(timeout=PATIENCE) != b"\0":
                pass
            self.assertEqual(heartbeats.get(timeout=PATIENCE), b"\x7f")
            self.assertEqual(self.node.sdo[0x1017].raw, 100)
            # Reset communication leaves the application's objects alone.
            self.assertAlmostEqual(self.node.sdo[0x2010][1].raw, half_track, delta=1e-7)

    def test_nothing_but_heartbeat_when_stopped(self):
        self.enter("STOPPED")
        answers, statuses = self.frames(0x580 + NODE), self.frames(0x180 + NODE)
        heartbeats = self.frames(0x700 + NODE)
        self.network.send_message(0x600 + NODE, b"\x40\0\x10\0\0\0\0\0")
        self.network.sync.transmit(1)
        # A hundred milliseconds of the robot's time apart, so the answers would be here.
        for _ in range(3):
            self.assertEqual(heartbeats.get(timeout=PATIENCE), b"\4")
        self.assertTrue(answers.empty() and statuses.empty())
        self.enter("PRE-OPERATIONAL")
        self.barrier()

    def test_no_process_data_before_operational(self):
        statuses = self.frames(0x180 + NODE)
        self.network.sync.transmit(1)
        self.barrier()
        self.assertTrue(statuses.empty())
        self.node.nmt.state = "OPERATIONAL"
        self.network.sync.transmit(2)
        self.assertEqual(len(statuses.get(timeout=PATIENCE)), 8)

    def test_a_start_without_configuration_is_an_emergency(self):
        self.node.nmt.state = "OPERATIONAL"
        self.emergency(0xFF17)
        self.assertEqual(self.node.sdo[0x2122][1].raw, 0xFF17)
        self.assertEqual(self.node.sdo[0x1003][1].raw & 0xFFFF, 0xFF17)
        self.assertEqual(self.node.sdo[0x1001].raw & 1, 1)

    def test_a_configured_robot_arms(self):
        self.configure()
        self.node.nmt.state = "OPERATIONAL"
        statuses = self.frames(0x180 + NODE)
        for n in range(5000):
            self.network.send_message(0x701, [5])
            self.network.sync.transmit(n % 240 + 1)
            if statuses.get(timeout=PATIENCE)[0] == 2:
                return
        self.fail("not armed")


class Store(Robot):
    def reset(self):
        heartbeats = self.frames(0x700 + NODE)
        self.network.nmt.send_command(0x81)
        while heartbeats.get(timeout=PATIENCE) != b"\0":
            pass
        self.assertEqual(heartbeats.get(timeout=PATIENCE), b"\x7f")

    def half_track(self):
        return self.node.sdo[0x2010][1].raw

    def test_what_is_saved_outlives_a_reset_until_it_is_restored(self):
        self.configure()
        self.node.sdo[0x2010][1].raw = 0.25
        self.node.store()
        self.node.sdo[0x2010][1].raw = 0.5
        self.reset()
        self.assertAlmostEqual(self.half_track(), 0.25, delta=1e-7)
        self.node.restore()
        self.reset()
        self.assertAlmostEqual(self.half_track(), 0.2, delta=1e-7)

    def test_what_is_saved_outlives_a_power_cycle(self):
        self.configure()
        self.node.sdo[0x2010][1].raw = 0.25
        set_ = compensation_set(20261121, lateral=[(0.1, 1.141), (0.5, 1.157)])
        self.node.sdo.download(0x2013, 1, set_)
        self.node.store()
        self.node.sdo[0x2010][1].raw = 0.5
        self.node.sdo[0x2011][1].raw = 3.0
        self.power_cycle()
        self.assertAlmostEqual(self.half_track(), 0.25, delta=1e-7)
        self.assertEqual(self.node.sdo[0x2011][1].raw, 0.0)
        self.assertEqual(self.node.sdo.upload(0x2013, 1), set_)
        self.assertEqual(self.node.sdo[0x2013][2].raw, 20261121)
        self.assertEqual(self.node.sdo[0x2002][1].raw, 0)
        self.assertEqual(self.node.sdo[0x2126][1].raw, 1)
        self.assertEqual(self.node.sdo[0x2126][3].raw, 0)

    def test_nothing_is_saved_without_the_signature(self):
        for index, signature in [(0x1010, b"evas"), (0x1011, b"daol")]:
            self.refused(0x08000020, self.node.sdo.download, index, 1, signature)

    def test_nothing_is_saved_while_operational(self):
        self.configure()
        self.enter("OPERATIONAL")
        self.refused(DEVICE_STATE, self.node.store)


class Compensation(Robot):
    def test_a_set_is_taken_whole_or_not_at_all(self):
        sdo = self.node.sdo
        good = compensation_set(7, lateral=[(0.1, 1.141), (0.5, 1.157)], oblique=[(0.3, 1.017, 1.14)])
        sdo.download(0x2013, 1, good)
        zero = compensation_set(8, lateral=[(0.1, 0.0)])
        falling = compensation_set(8, yaw=[(0.5, 1.0), (0.4, 1.0)])
        steep = compensation_set(8, lateral=[(0.3, 0.6), (0.31, 1.9)])
        for code, data in [
            (0x06090030, good[:-1] + b"\xff"),
            (0x06090032, zero),
            (0x06090030, falling),
            (0x06040043, steep),
            # Sideways and at 45 degrees too far apart: two motions might ask for the same wheels.
            (0x06040043, compensation_set(8, lateral=[(0.3, 1.3)], oblique=[(0.3, 1.0, 1.0)])),
            (0x06070013, b"\0" * 5),
            (0x06070012, good + b"\0" * 200),
        ]:
            self.refused(code, sdo.download, 0x2013, 1, data)
            self.assertEqual(sdo.upload(0x2013, 1), good)
        self.assertEqual([sdo[0x2013][sub].raw for sub in (2, 3)], [7, int.from_bytes(good[:4], "little")])

    def test_a_set_by_block_transfer(self):
        good = compensation_set(9, longitudinal=[(0.1 * n, 1.0 + 0.01 * n) for n in range(1, 9)])
        with self.node.sdo.open(
            0x2013, 1, "wb", size=len(good), block_transfer=True, request_crc_support=True
        ) as f:
            f.write(good)
        self.assertEqual(self.node.sdo.upload(0x2013, 1), good)


class Sdo(Robot):
    def test_expedited(self):
        self.assertEqual(self.node.sdo[0x2000].raw, WIRE_VERSION)
        self.assertEqual(self.node.sdo[0x1018][2].raw, 0x4F4D4E49)
        self.node.sdo[0x2011][1].raw = -1.5
        self.assertEqual(self.node.sdo[0x2011][1].raw, -1.5)

    def test_segmented(self):
        self.assertEqual(self.node.sdo[0x1008].raw, "Omnibus robot")
        # A value of four bytes may come in segments, too.
        with self.node.sdo.open(0x2011, 2, "wb", size=4, force_segment=True) as f:
            f.write(b"\0\0\x80\x3f")
        self.assertEqual(self.node.sdo[0x2011][2].raw, 1.0)

    def test_block(self):
        with self.node.sdo[0x1008].open("rb", block_transfer=True) as f:
            self.assertEqual(f.read(), b"Omnibus robot")
        for crc, value in [(False, b"\0\0\0\x40"), (True, b"\0\0\x80\xbf")]:
            with self.node.sdo.open(
                0x2011, 3, "wb", size=4, block_transfer=True, request_crc_support=crc
            ) as f:
                f.write(value)
            self.assertEqual(self.node.sdo.upload(0x2011, 3), value)

    def test_refusals(self):
        sdo = self.node.sdo
        for code, index, sub, data in [
            (0x06020000, 0x2FFF, 0, b"\0"),
            (0x06090011, 0x2010, 9, b"\0\0\0\0"),
            (READ_ONLY, 0x2000, 0, b"\1\0"),
            (READ_ONLY, 0x2010, 0, b"\4"),
            (READ_ONLY, 0x1008, 0, b"another name"),
            (0x06070012, 0x2020, 2, b"\0\0\0\0"),
            (0x06070013, 0x2010, 1, b"\0"),
            (0x06090030, 0x2010, 1, b"\0\0\xc0\x7f"),
        ]:
            self.refused(code, sdo.download, index, sub, data)
        self.refused(0x06020000, sdo.upload, 0x2FFF, 0)
        self.refused(0x06090011, sdo.upload, 0x2010, 9)
        self.assertEqual(sdo[0x2010][0].raw, 5)

    def test_a_second_client_is_refused_while_the_first_goes_on(self):
        with self.node.sdo[0x1008].open("rb", buffering=0) as f:
            first = f.read(7)
            self.refused(0x060A0023, self.node.sdo.upload, 0x1000, 0)
            self.assertEqual(first + f.read(7), b"Omnibus robot")


class Pdo(Robot):
    def test_setpoint_sync_setpoint_latches_the_first(self):
        self.configure()
        self.node.nmt.state = "OPERATIONAL"
        statuses = self.frames(0x180 + NODE)
        # Back to back. The second setpoint waits for the next SYNC, and is latched there.
        for n in range(0, 400, 2):
            self.network.send_message(0x181, twist(n + 1))
            self.network.sync.transmit(n % 240 + 1)
            self.network.send_message(0x181, twist(n + 2))
            self.assertEqual(statuses.get(timeout=PATIENCE)[1], (n + 1) & 0xFF)
            self.network.sync.transmit(n % 240 + 2)
            self.assertEqual(statuses.get(timeout=PATIENCE)[1], (n + 2) & 0xFF)
        self.assertEqual(self.node.sdo[0x2121][3].raw, 0)

    def test_the_pdos_are_those_of_the_eds(self):
        self.node.rpdo.read()
        self.node.tpdo.read()
        self.assertEqual([self.node.rpdo[n].cob_id for n in (1, 2)], [0x181, 0x202])
        tpdos = [self.node.tpdo[n] for n in (1, 2, 3, 4)]
        self.assertEqual([pdo.cob_id for pdo in tpdos], [0x182, 0x282, 0x382, 0x482])
        self.assertEqual([len(pdo) for pdo in tpdos], [6, 5, 3, 4])
        self.assertTrue(all(pdo.trans_type == 1 and pdo.enabled for pdo in tpdos))

    def test_a_tpdo_mapped_anew(self):
        self.configure()
        self.node.tpdo.read()
        pdo = self.node.tpdo[1]
        pdo.clear()
        for index, sub in [(0x2110, 2), (0x2110, 1), (0x2112, 1)]:
            pdo.add_variable(index, sub)
        pdo.cob_id, pdo.trans_type = 0x1A2, 2
        pdo.save()
        pdo.read()
        self.assertEqual([(v.index, v.subindex) for v in pdo], [(0x2110, 2), (0x2110, 1), (0x2112, 1)])
        old, new, others = self.frames(0x182), self.frames(0x1A2), self.frames(0x282)
        self.node.nmt.state = "OPERATIONAL"
        for n in range(1, 5):
            self.network.send_message(0x181, twist(n))
            self.network.sync.transmit(n)
            self.assertEqual(len(others.get(timeout=PATIENCE)), 8)
        # Every second SYNC, five bytes, the echoed sequence first.
        received = [new.get(timeout=PATIENCE) for _ in range(2)]
        self.barrier()
        self.assertTrue(new.empty() and old.empty())
        self.assertEqual([(len(data), data[0]) for data in received], [(5, 2), (5, 4)])

    def test_an_rpdo_mapped_anew(self):
        self.configure()
        self.node.rpdo.read()
        pdo = self.node.rpdo[1]
        pdo.clear()
        for sub in [5, 4, 3, 2, 1]:
            pdo.add_variable(0x2100, sub)
        pdo.save()
        statuses = self.frames(0x182)
        self.node.nmt.state = "OPERATIONAL"
        for n in range(7, 10):
            self.network.send_message(0x181, bytes([1, n, 0, 0, 0, 0, 0, 0]))
            self.network.sync.transmit(n)
            self.assertEqual(statuses.get(timeout=PATIENCE)[1], n)

    def test_mapping_rules(self):
        sdo = self.node.sdo
        on, off = 0x182, 0x80000182
        self.refused(0x06010000, sdo.download, 0x1A00, 0, b"\0")
        sdo[0x1800][1].raw = off
        sdo[0x1A00][0].raw = 0
        self.refused(0x06040041, sdo.download, 0x1A00, 1, b"\x20\1\x10\x20")
        self.refused(0x06020000, sdo.download, 0x1A00, 1, b"\x20\1\xff\x2f")
        for sub in range(1, 6):
            sdo[0x1A00][sub].raw = 0x21120118
        self.refused(0x06040042, sdo.download, 0x1A00, 0, b"\5")
        sdo[0x1A00][0].raw = 2
        sdo[0x1800][1].raw = on


class Lss(Robot):
    def setUp(self):
        super().setUp()
        self.network.lss.RESPONSE_TIMEOUT = PATIENCE

    def test_selective_and_inquire(self):
        lss = self.network.lss
        serial = self.node.sdo[0x1018][4].raw
        self.assertTrue(lss.send_switch_state_selective(*IDENTITY, serial))
        answers = [lss.inquire_lss_address(what) for what in (0x5A, 0x5B, 0x5C, 0x5D)]
        self.assertEqual(answers, [*IDENTITY, serial])
        self.assertEqual(lss.inquire_node_id(), NODE)
        lss.send_switch_state_global(lss.WAITING_STATE)
        self.barrier()

    def test_a_node_number_is_stored_and_comes_back_after_a_power_cycle(self):
        lss = self.network.lss
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        lss.configure_node_id(9)
        lss.store_configuration()
        lss.send_switch_state_global(lss.WAITING_STATE)
        # Not before a reset.
        self.barrier()
        self.power_cycle(node=9)
        moved = self.network.add_node(9, self.node.object_dictionary)
        moved.sdo.RESPONSE_TIMEOUT = PATIENCE
        self.assertEqual([moved.sdo[0x2001][sub].raw for sub in (4, 5)], [NODE, 9])
        # 255 forgets it: the switches count again.
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        lss.configure_node_id(255)
        lss.store_configuration()
        self.power_cycle()
        self.assertEqual([self.node.sdo[0x2001][sub].raw for sub in (4, 5)], [NODE, 0])

    def test_fastscan_finds_a_robot_that_has_no_node(self):
        lss = self.network.lss
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        lss.configure_node_id(255)
        lss.send_switch_state_global(lss.WAITING_STATE)
        self.network.nmt.send_command(0x82)
        # Every bit that is set is one answer that does not come, so here it must not be waited for long; and an
        # answer that comes later than that reads as a bit that is set. How long is long enough depends on this
        # machine: a scan that fails is done again with four times the timeout. A machine that stands still now and
        # then for seconds disturbs the long scans most, so the short ones come several times. None can succeed by
        # mistake, because the robot has to confirm its whole identity.
        for lss.RESPONSE_TIMEOUT in 3 * (0.1, 0.4, 1.6) + (6.4,):
            found, identity = lss.fast_scan()
            if found:
                break
        lss.RESPONSE_TIMEOUT = PATIENCE
        self.assertTrue(found)
        self.assertEqual(tuple(identity[:3]), IDENTITY)
        lss.configure_node_id(NODE)
        heartbeats = self.frames(0x700 + NODE)
        lss.send_switch_state_global(lss.WAITING_STATE)
        self.assertEqual(heartbeats.get(timeout=PATIENCE), b"\0")

    def test_a_node_number_out_of_range_is_refused(self):
        lss = self.network.lss
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        with self.assertRaises(canopen.lss.LssError):
            lss.configure_node_id(128)
        lss.send_switch_state_global(lss.WAITING_STATE)
        self.assertEqual(self.node.sdo[0x2000].raw, WIRE_VERSION)


if __name__ == "__main__":
    unittest.main()
