//! Members agree on what they are about to do, not only on which setpoint it was; and on what SYNC
//! and its counter say.

use kinematics::Twist;
use protocol::address as at;
use protocol::{Fault, Value, cob};

use super::world::{GROUP, World};
use crate::state::State;

const FORWARD: Twist = Twist::new(0.5, 0.0, 0.0);

/// An SDO write of a communication object; the abort code if it was refused.
fn write(
    world: &mut World,
    node: u8,
    (index, sub, value, len): (u16, u8, u32, u8),
) -> Result<(), u32> {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = value.to_le_bytes();
    let before = world.log.len();
    let data = [0x23 | (4 - len) << 2, low, high, sub, a, b, c, d];
    world.send(1, cob::sdo_request(node), &data);
    let answers = world.log[before..].iter();
    let mut answers = answers.filter(|(_, frame)| frame.id() == cob::sdo_response(node));
    let answer = answers.next().expect("an answer").1;
    match answer.data()[0] {
        0x60 => Ok(()),
        _ => Err(u32::from_le_bytes(answer.data()[4..].try_into().unwrap())),
    }
}

/// vx and vy of the group twist change places.
const SWAPPED: [(u16, u8, u32, u8); 6] = [
    (0x1400, 1, 0x8000_0181, 4),
    (0x1600, 0, 0, 1),
    (0x1600, 1, 0x2100_0210, 4),
    (0x1600, 2, 0x2100_0110, 4),
    (0x1600, 0, 5, 1),
    (0x1400, 1, 0x181, 4),
];

/// Starts a group of three, asks for standstill and then for a speed: nothing moves, all name the
/// same cause.
fn is_refused(mut world: World, what: &str) {
    world.start();
    world.run(30);
    world.until(20, |world| world.now % 10_000 == 1_000);
    world.twist = Some(Twist::ZERO);
    // Latched at the first SYNC, found out at the second.
    let took = world.until(500, |world| {
        let faults = world.robots.iter().map(|robot| robot.bus.state().fault());
        faults.eq([Some(Fault::PlanMismatch); 3])
    });
    assert!(took <= 20, "{what}: {took} ms");
    world.twist = Some(FORWARD);
    for _ in 0..500 {
        world.step();
        for robot in &world.robots {
            assert_eq!(robot.control.report().twist_ref(), Twist::ZERO);
        }
    }
    assert_eq!(world.emergencies(2), [0xFF1B]);
}

#[test]
fn a_member_that_decodes_setpoints_otherwise_stops_the_group() {
    let mut world = World::new(&[2, 3, 4]);
    world.configure();
    for object in SWAPPED {
        write(&mut world, 4, object).unwrap();
    }
    is_refused(world, "");
}

#[test]
fn a_member_with_other_limits_stops_the_group() {
    let mut world = World::new(&[2, 3, 4]);
    world.configure();
    world.write(3, at::ACCELERATION, Value::F32(0.3)).unwrap();
    is_refused(world, "");
}

/// It would begin to follow later than the others.
#[test]
fn a_member_that_waits_longer_for_its_brake_stops_the_group() {
    let mut world = World::new(&[2, 3, 4]);
    world.configure();
    world.write(3, at::BRAKE_RELEASE, Value::U16(80)).unwrap();
    is_refused(world, "");
}

#[test]
fn a_member_that_communicates_otherwise_stops_the_group() {
    for object in [
        (0x1007, 0, 30_000, 4),
        (0x1006, 0, 20_000, 4),
        (0x1014, 0, 0x8000_0083, 4),
        (0x1400, 5, 100, 2),
        (0x1800, 5, 100, 2),
        (0x1801, 2, 2, 1),
    ] {
        let mut world = World::new(&[2, 3, 4]);
        world.configure();
        write(&mut world, 3, object).unwrap();
        is_refused(world, "");
    }
}

/// What another node writes to a member while all move: the others see it in its vote.
#[test]
fn a_member_that_understood_another_twist_stops_the_group() {
    let mut world = World::started(&[2, 3, 4]);
    world.drive(FORWARD, 500);
    // Robot 4 alone hears 0.5 m/s aside, with the same sequence.
    world.until(20, |world| world.now % 10_000 == 9_000);
    world.robots[2].deaf = true;
    let twist = |twist, sequence| {
        let group = super::world::GROUP;
        protocol::GroupTwist {
            twist,
            sequence,
            group,
        }
        .encode()
    };
    world.sequence = world.sequence.wrapping_add(1);
    world.send(1, cob::GROUP_TWIST, &twist(FORWARD, world.sequence));
    world.robots[2].deaf = false;
    world.passes = |_, to| to == 4;
    world.send(
        1,
        cob::GROUP_TWIST,
        &twist(Twist::new(0.0, 0.5, 0.0), world.sequence),
    );
    world.passes = |_, _| true;
    world.twist = None;
    world.run(13);
    for robot in &world.robots {
        assert_eq!(robot.bus.state().fault(), Some(Fault::PlanMismatch));
        assert!(robot.control.report().twist_ref().vy.abs() < 1e-6);
    }
}

/// Nothing about communication changes while a robot is OPERATIONAL; parameters do not either.
#[test]
fn communication_objects_change_in_pre_operational_only() {
    let list = [
        (0x1005, 0, 0x100, 4),
        (0x1005, 0, 0x4000_0080, 4),
        (0x1006, 0, 1000, 4),
        (0x1007, 0, 1, 4),
        (0x1014, 0, 0x8000_0082, 4),
        (0x1015, 0, 0, 2),
        (0x1016, 1, 0x0001_0064, 4),
        (0x1017, 0, 0, 2),
        (0x1029, 1, 1, 1),
        (0x1400, 1, 0x8000_0181, 4),
        (0x1400, 2, 255, 1),
        (0x1600, 0, 0, 1),
        (0x1800, 1, 0x8000_0182, 4),
        (0x1800, 2, 255, 1),
        (0x1A00, 0, 0, 1),
        (0x1F80, 0, 0, 4),
    ];
    for object in list {
        let mut world = World::started(&[2, 3]);
        world.drive(FORWARD, 300);
        let refused = Err(0x0800_0022);
        assert_eq!(write(&mut world, 2, object), refused, "{object:04x?}");
        world.run(100);
        assert_eq!(world.robots[0].bus.state(), State::Moving, "{object:04x?}");
    }
}

/// Members that leave it to messages cut when one comes: none may hold its own back.
#[test]
fn emergency_messages_cannot_be_held_back() {
    let mut world = World::new(&[2]);
    let too_high = Err(0x0609_0031);
    assert_eq!(write(&mut world, 2, (0x1015, 0, 1, 2)), too_high);
    assert_eq!(write(&mut world, 2, (0x1015, 0, 0, 2)), Ok(()));
}

/// Group and sequence first, then omega, vy, vx: all members are mapped so, and the master sends
/// so.
#[test]
fn a_group_twist_is_for_the_group_that_its_mapping_names() {
    let reversed = [
        (0x1400, 1, 0x8000_0181, 4),
        (0x1600, 0, 0, 1),
        (0x1600, 1, 0x2100_0508, 4),
        (0x1600, 2, 0x2100_0408, 4),
        (0x1600, 3, 0x2100_0310, 4),
        (0x1600, 4, 0x2100_0210, 4),
        (0x1600, 5, 0x2100_0110, 4),
        (0x1600, 0, 5, 1),
        (0x1400, 1, 0x181, 4),
    ];
    let mut world = World::new(&[2]);
    world.configure();
    for object in reversed {
        write(&mut world, 2, object).unwrap();
    }
    world.start();
    for (group, echoed) in [(GROUP, 7), (GROUP + 1, 7), (GROUP, 9)] {
        let sequence = if group == GROUP { echoed } else { 8 };
        world.send(1, cob::GROUP_TWIST, &[group, sequence, 0, 0, 0, 0, 0, 0]);
        world.run(20);
        assert_eq!(world.status(2).sequence, echoed);
    }
}

/// RPDO1 listens where a master told it to; what is counted, and what is for another group, goes by
/// that and not by the identifier it has by default.
#[test]
fn group_twists_are_counted_at_the_identifier_that_carries_them() {
    const ELSEWHERE: u16 = 0x1F1;
    let mut world = World::new(&[2]);
    world.configure();
    for cob_id in [0x8000_0181, u32::from(ELSEWHERE)] {
        write(&mut world, 2, (0x1400, 1, cob_id, 4)).unwrap();
    }
    world.start();
    world.twist = None;
    let send = |world: &mut World, sequence, group| {
        let twist = Twist::ZERO;
        let frame = protocol::GroupTwist {
            twist,
            sequence,
            group,
        };
        world.send(1, ELSEWHERE, &frame.encode());
    };
    for sequence in 1..20 {
        send(&mut world, sequence, GROUP);
        send(&mut world, sequence, GROUP + 1);
        world.run(10);
    }
    assert_eq!(world.robots[0].bus.state().fault(), None, "one master each");
    for sequence in 20..40 {
        send(&mut world, sequence, GROUP);
        send(&mut world, sequence, GROUP);
        world.run(10);
    }
    let fault = world.robots[0].bus.state().fault();
    assert_eq!(fault, Some(Fault::TwoMasters));
}

/// The checksum as the protocol page says, by hand: FNV-1a over the group CRC, the communication
/// CRC and the setpoint, and the finish of MurmurHash3.
#[test]
fn the_checksum_is_what_the_page_says() {
    let mut world = World::started(&[2, 3]);
    world.drive(Twist::new(0.3, -0.1, 0.05), 300);
    let group = world.read(3, at::GROUP_CRC).unwrap();
    // 0x1005 to 0x1007, 0x1014, 0x1400, 0x1600, 0x1800, 0x1A00, 0x1801, 0x1A01, node taken off.
    let words: [u32; 36] = [
        0x80,
        0,
        0,
        0x80,
        0x181,
        1,
        0,
        5,
        0x2100_0110,
        0x2100_0210,
        0x2100_0310,
        0x2100_0408,
        0x2100_0508,
        0x180,
        1,
        0,
        0,
        0,
        6,
        0x2110_0108,
        0x2110_0208,
        0x2110_0310,
        0x2110_0408,
        0x2110_0510,
        0x2110_0608,
        0x280,
        1,
        0,
        0,
        0,
        5,
        0x2111_0110,
        0x2111_0210,
        0x2111_0310,
        0x2111_0408,
        0x2111_0508,
    ];
    let communication = protocol::crc32(words.into_iter().flat_map(u32::to_le_bytes));
    let status = world.status(3);
    let setpoint = protocol::GroupTwist {
        twist: Twist::new(0.3, -0.1, 0.05),
        sequence: status.sequence,
        group: super::world::GROUP,
    };
    let mut hash = 0x811C_9DC5_u32;
    let bytes = [group.to_le_bytes(), communication.to_le_bytes()].concat();
    for byte in bytes.into_iter().chain(setpoint.encode()) {
        hash = (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    }
    hash = (hash ^ hash >> 16).wrapping_mul(0x85EB_CA6B);
    hash = (hash ^ hash >> 13).wrapping_mul(0xC2B2_AE35);
    hash ^= hash >> 16;
    assert_eq!(u32::from(status.plan), hash >> 24);
    assert_eq!(world.status(2).plan, status.plan);
    assert_eq!(world.read(3, at::STATUS_PLAN), Ok(u32::from(status.plan)));
}

/// SYNCs that are lost on the way, by the master's counter and by time, are never taken for a
/// second master.
#[test]
fn lost_syncs_are_never_two_masters() {
    // A linear congruential generator, the same every time.
    let mut word = 0x1234_5678_u32;
    let mut random = move || {
        word = word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        word >> 16 & 0xFF
    };
    let patterns: [&mut dyn FnMut(u32) -> bool; 4] = [
        &mut |k| k % 2 == 1,
        &mut |k| k % 4 >= 2,
        &mut |k| k % 5 == 0,
        &mut |_| random() < 77,
    ];
    let mut driven_on = 0;
    for (number, lost) in patterns.into_iter().enumerate() {
        let mut world = World::started(&[2, 3]);
        world.drive(FORWARD, 500);
        for k in 0..300 {
            world.until(10, |world| world.now.is_multiple_of(10_000));
            world.sync = !lost(k);
            if !world.sync {
                world.counter = world.counter % 240 + 1;
            }
            world.step();
            world.sync = true;
        }
        for robot in &world.robots {
            let fault = robot.bus.state().fault();
            assert!(
                matches!(fault, None | Some(Fault::SyncLost)),
                "{number}: {fault:?}"
            );
        }
        driven_on += u32::from(world.robots[0].bus.state() == State::Moving);
    }
    // One at a time is forgiven.
    assert!(driven_on >= 2, "{driven_on}");
}

/// Two masters, each with a SYNC of its own, are found out within six SYNCs whatever their counters
/// are.
#[test]
fn two_masters_with_a_sync_each_are_named() {
    for (offset, phase) in [(100_u8, 5_u64), (1, 3), (239, 7), (0, 5), (120, 1)] {
        let mut world = World::started(&[2, 3]);
        world.drive(FORWARD, 500);
        world.until(20, |world| world.now % 10_000 == 1_000);
        let mut syncs = 0;
        while world.robots[0].bus.state() == State::Moving {
            if world.now % 10_000 == phase * 1_000 {
                let setpoint = protocol::GroupTwist {
                    twist: FORWARD,
                    sequence: world.sequence.wrapping_add(90),
                    group: super::world::GROUP,
                };
                world.send(1, cob::GROUP_TWIST, &setpoint.encode());
                let counter = world.counter.wrapping_sub(1).wrapping_add(offset) % 240 + 1;
                world.send(1, cob::SYNC, &[counter]);
                syncs += 1;
            }
            syncs += u32::from(world.now.is_multiple_of(10_000));
            world.step();
            assert!(syncs <= 6, "offset {offset}");
        }
        let fault = world.robots[0].bus.state().fault();
        assert_eq!(fault, Some(Fault::TwoMasters), "offset {offset}");
    }
}
