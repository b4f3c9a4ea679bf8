//! What else is on the bus: a second robot with the same node number, another group, and what must
//! not be changed by a master while robots move.

use canopen::NmtCommand;
use kinematics::Twist;
use protocol::address as at;
use protocol::{Fault, GroupTwist, Value, cob};

use super::world::{GROUP, World};
use crate::state::State;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);
/// A node of the tests that no robot is.
const STRANGER: u8 = 9;

fn moving(nodes: &[u8]) -> World {
    let mut world = World::started(nodes);
    world.drive(FORWARD, 1000);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world
}

/// Every identifier under which a robot sends, from another node.
fn own_frames(node: u8) -> [(u16, [u8; 8], usize); 7] {
    let data = [0; 8];
    [
        (cob::heartbeat(node), [127, 0, 0, 0, 0, 0, 0, 0], 1),
        (cob::emergency(node), data, 8),
        (cob::member_status(node), data, 8),
        (cob::measured_twist(node), data, 8),
        (cob::pose(node), data, 8),
        (cob::wheel_rates(node), data, 8),
        (cob::sdo_response(node), data, 8),
    ]
}

#[test]
fn a_frame_with_an_identifier_of_its_own_is_a_second_robot_with_its_node() {
    for (id, data, length) in own_frames(2) {
        let mut world = moving(&[2, 3]);
        world.send(STRANGER, id, &data[..length]);
        let duplicate = Fault::DuplicateNode;
        assert_eq!(
            world.robots[0].bus.state().fault(),
            Some(duplicate),
            "{id:#x}"
        );
        assert!(matches!(world.robots[0].bus.state(), State::Ramping(_)));
        assert_eq!(world.emergencies(2).last(), Some(&0xFF1C));
        // The others stop with it, and none of them takes itself for the double.
        world.run(1500);
        assert_eq!(world.robots[0].bus.state(), State::Faulted(duplicate));
        let state = world.robots[1].bus.state();
        assert!(matches!(state, State::Faulted(_)), "{state:?}");
        assert_ne!(state.fault(), Some(duplicate));
    }
}

#[test]
fn no_start_while_a_second_robot_with_its_node_is_heard() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    world.send(STRANGER, cob::heartbeat(2), &[0]);
    assert_eq!(world.emergencies(2), [0xFF1C], "its boot-up is answered");
    for _ in 0..20 {
        world.send(STRANGER, cob::heartbeat(2), &[127]);
        world.run(100);
    }
    assert_eq!(world.emergencies(2), [0xFF1C], "announced once");
    world.start();
    let refused = State::Faulted(Fault::DuplicateNode);
    assert_eq!(world.robots[0].bus.state(), refused);
    world.drive(FORWARD, 500);
    assert_eq!(world.robots[0].rates, [0.0; 4]);
    // It has gone: a second later a start is a start.
    world.twist = None;
    world.run(1100);
    world.start();
    assert_eq!(world.robots[0].bus.state(), State::Armed);
}

/// A double that is switched on in the same instant sends the same boot-up frame in the same bits.
/// Its first heartbeat, which its serial number sets apart, comes within 100 ms.
#[test]
fn nothing_moves_before_a_double_had_time_to_be_heard() {
    let mut world = World::new(&[2]);
    world.configure();
    world.run(300);
    world.nmt(NmtCommand::ResetCommunication, 2);
    world.start();
    world.twist = Some(Twist::ZERO);
    let took = world.until(500, |world| world.robots[0].bus.state() == State::Moving);
    assert!(took >= 100, "moves after {took} ms");
}

/// Sends a twist for each of two groups in every period, the second after the first; standstill for
/// the first 10.
fn drive_two_groups(world: &mut World, groups: [u8; 2], sequences: &mut [u8; 2], period: u32) {
    for (group, sequence) in groups.into_iter().zip(sequences) {
        *sequence = sequence.wrapping_add(1);
        let speed = if group == GROUP { 0.3 } else { -0.2 };
        let twist = Twist::new(if period < 10 { 0.0 } else { speed }, 0.0, 0.0);
        let frame = GroupTwist {
            twist,
            sequence: *sequence,
            group,
        };
        world.send(1, cob::GROUP_TWIST, &frame.encode());
    }
    world.run(10);
}

#[test]
fn two_groups_share_a_bus_and_its_sync() {
    const OTHER: u8 = GROUP + 4;
    for (first, second) in [(GROUP, OTHER), (OTHER, GROUP)] {
        let mut world = World::new(&[2, 3, 4, 5]);
        world.configure();
        for node in [2, 3, 4, 5] {
            let (group, members) = match node {
                2 | 3 => (GROUP, 0b00_1100_u32),
                _ => (OTHER, 0b11_0000),
            };
            world.write(node, at::GROUP_ID, Value::U8(group)).unwrap();
            world.write(node, at::MEMBERS, Value::U32(members)).unwrap();
        }
        world.start();
        world.run(150);
        // The sequences of the two have nothing to do with each other.
        let mut sequences = [7, 200];
        let groups = [first, second];
        for period in 0..100 {
            drive_two_groups(&mut world, groups, &mut sequences, period);
        }
        for period in 100..1100 {
            drive_two_groups(&mut world, groups, &mut sequences, period);
            for robot in &world.robots {
                let state = robot.bus.state();
                assert_eq!(state, State::Moving, "node {} period {period}", robot.node);
            }
        }
        for (robot, vx) in world.robots.iter().zip([0.3, 0.3, -0.2, -0.2]) {
            assert!((robot.moves().vx - vx).abs() < 5e-3, "{:?}", robot.moves());
        }
        // A fault in one group is none of the other's.
        world.robots[3].inputs.drive_fault = Some(Fault::DriverFault);
        for period in 100..200 {
            drive_two_groups(&mut world, groups, &mut sequences, period);
        }
        let states: std::vec::Vec<State> =
            world.robots.iter().map(|robot| robot.bus.state()).collect();
        assert_eq!(states[..2], [State::Moving; 2]);
        assert!(
            states[2..].iter().all(|state| state.fault().is_some()),
            "{states:?}"
        );
    }
}

/// A commissioning twist for node 2, as fast as a hand on a lever could ask for.
pub fn ask_alone(world: &mut World, twist: Twist, periods: u32, sequence: &mut u8) {
    for _ in 0..periods {
        *sequence = sequence.wrapping_add(1);
        let frame = GroupTwist {
            twist,
            sequence: *sequence,
            group: GROUP,
        };
        world.send(1, cob::commissioning_twist(2), &frame.encode());
        world.run(10);
    }
}

#[test]
fn a_member_of_a_group_may_not_move_alone() {
    const INCOMPATIBLE: u32 = 0x0604_0043;
    let mut world = World::started(&[2, 3]);
    let refused = world.write(2, at::COMMISSIONING, Value::U8(1));
    assert_eq!(refused, Err(INCOMPATIBLE));
    ask_alone(&mut world, Twist::new(0.0, 1.0, 0.0), 60, &mut 0);
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    assert_eq!(world.robots[0].rates, [0.0; 4]);
    assert!(world.emergencies(2).is_empty());
    // Taking a permission back is always right.
    world.write(2, at::COMMISSIONING, Value::U8(0)).unwrap();
}

/// Two members, and robot 2 is to be tested by itself.
fn declared() -> World {
    let mut world = World::new(&[2, 3]);
    world.configure();
    world.write(2, at::ALONE_FOR_NOW, Value::U8(1)).unwrap();
    world
}

#[test]
fn a_member_that_is_alone_for_now_moves_alone_and_keeps_the_group_at_rest() {
    const WRONG_STATE: u32 = 0x0800_0022;
    let mut world = declared();
    world.start();
    world.run(30);
    // The group's twist moves neither of them: the one is no member, the other has its vote.
    world.twist = Some(Twist::ZERO);
    world.run(200);
    world.twist = Some(Twist::new(0.5, 0.0, 0.0));
    world.run(500);
    for robot in &world.robots {
        assert_eq!((robot.bus.state(), robot.rates), (State::Armed, [0.0; 4]));
    }
    let alone = protocol::Code::Limit(protocol::Limit::Alone);
    assert_eq!(world.status(2).code, alone);
    world.twist = None;
    world.write(2, at::COMMISSIONING, Value::U8(1)).unwrap();
    let mut sequence = 0;
    ask_alone(&mut world, Twist::ZERO, 4, &mut sequence);
    ask_alone(&mut world, Twist::new(0.2, 0.0, 0.0), 60, &mut sequence);
    assert_eq!(world.robots[0].bus.state(), State::Alone);
    assert!((world.robots[0].moves().vx - 0.2).abs() < 5e-3);
    assert_eq!(world.robots[1].rates, [0.0; 4]);
    // A started robot stays what it is; out of OPERATIONAL it is a member again.
    let refused = world.write(2, at::ALONE_FOR_NOW, Value::U8(0));
    assert_eq!(refused, Err(WRONG_STATE));
    world.nmt(NmtCommand::EnterPreOperational, 2);
    assert_eq!(world.read(2, at::ALONE_FOR_NOW).unwrap() & 1, 0);
    assert_eq!(world.read(2, at::MEMBERS), Ok(1 << 2 | 1 << 3));
    world.run(500);
    assert_eq!(world.robots[0].bus.state(), State::Ready);
    assert_eq!(world.read(2, at::STATUS_CODE), Ok(0), "no limit is left");
}

/// A master that dies in the midst of a test takes nothing away from the group.
#[test]
fn alone_for_now_ends_with_its_master() {
    for started in [false, true] {
        for boots in [false, true] {
            let mut world = declared();
            if started {
                world.start();
                world.run(200);
            }
            world.run(2_000);
            assert_eq!(world.read(2, at::ALONE_FOR_NOW).unwrap() & 1, 1);
            world.heartbeat = false;
            if boots {
                world.send(1, cob::MASTER_HEARTBEAT, &[0]);
            } else {
                // The last heartbeat is up to 100 ms old, the timeout is 500 ms.
                world.run(390);
                assert_eq!(world.read(2, at::ALONE_FOR_NOW).unwrap() & 1, 1);
                world.run(115);
            }
            assert_eq!(world.read(2, at::ALONE_FOR_NOW).unwrap() & 1, 0);
            world.heartbeat = true;
            world.start();
            world.run(30);
            world.drive(Twist::new(0.3, 0.0, 0.0), 1_000);
            let states = world.robots.iter().map(|robot| robot.bus.state());
            assert!(states.eq([State::Moving; 2]));
        }
    }
}

#[test]
fn alone_it_is_slow_and_not_for_long() {
    let mut world = World::started(&[2]);
    world.run(150);
    world.write(2, at::COMMISSIONING, Value::U8(1)).unwrap();
    let mut sequence = 0;
    ask_alone(&mut world, Twist::ZERO, 4, &mut sequence);
    let mut fastest = 0.0_f32;
    for _ in 0..100 {
        ask_alone(&mut world, Twist::new(0.0, 1.0, 0.0), 1, &mut sequence);
        fastest = fastest.max(world.robots[0].control.report().twist_ref().vy);
    }
    assert_eq!(world.robots[0].bus.state(), State::Alone);
    // 250 mm/s, and the least step of the scale it is brought down by.
    assert!((fastest - 0.25).abs() < 1e-3, "{fastest} m/s");
    // A minute after the permission it comes to rest, whatever it is asked for.
    ask_alone(&mut world, Twist::new(0.0, 1.0, 0.0), 6_000, &mut sequence);
    assert_eq!(world.robots[0].bus.state(), State::Ready);
    assert_eq!(world.robots[0].rates, [0.0; 4]);
}

/// The error byte of the answer to an LSS command; `None` without one.
fn lss(world: &mut World, request: [u8; 8]) -> std::vec::Vec<[u8; 2]> {
    let before = world.log.len();
    world.send(1, 0x7E5, &request);
    let answers = world.log[before..]
        .iter()
        .filter(|(_, frame)| frame.id() == 0x7E4);
    answers
        .map(|(_, frame)| [frame.data()[0], frame.data()[1]])
        .collect()
}

#[test]
fn lss_changes_nothing_while_a_robot_is_operational() {
    let mut world = moving(&[2, 3]);
    lss(&mut world, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    assert!(lss(&mut world, [0x11, 5, 0, 0, 0, 0, 0, 0]).is_empty());
    lss(&mut world, [0x04, 0, 0, 0, 0, 0, 0, 0]);
    // Selected by its identity it answers, and refuses.
    select(&mut world, 2);
    assert_eq!(lss(&mut world, [0x11, 5, 0, 0, 0, 0, 0, 0]), [[0x11, 0xFF]]);
    assert_eq!(lss(&mut world, [0x17, 0, 0, 0, 0, 0, 0, 0]), [[0x17, 0xFF]]);
    lss(&mut world, [0x04, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world.nmt(NmtCommand::ResetCommunication, 0);
    world.run(1500);
    nodes_are(&mut world, &[2, 3]);
}

fn select(world: &mut World, node: u8) {
    let serial = (u32::from(node) * 1000).to_le_bytes();
    let identity = [
        [0, 0, 0, 0],
        0x4F4D_4E49_u32.to_le_bytes(),
        (u32::from(protocol::WIRE_VERSION) << 16).to_le_bytes(),
        serial,
    ];
    for (command, [a, b, c, d]) in (0x40..).zip(identity) {
        lss(world, [command, a, b, c, d, 0, 0, 0]);
    }
}

fn nodes_are(world: &mut World, nodes: &[u8]) {
    let before = world.log.len();
    world.run(120);
    let mut found: std::vec::Vec<u8> = world.log[before..]
        .iter()
        .filter(|(_, frame)| frame.id() & 0x780 == 0x700 && frame.id() != cob::MASTER_HEARTBEAT)
        .map(|(_, frame)| frame.id() as u8 & 0x7F)
        .collect();
    found.sort_unstable();
    found.dedup();
    assert_eq!(found, nodes);
}

/// A robot that is not OPERATIONAL takes a node-ID from a master that selects it; while there are
/// others it takes none from a switch that selects all.
#[test]
fn several_robots_do_not_become_one_node() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    world.run(200);
    lss(&mut world, [0x04, 1, 0, 0, 0, 0, 0, 0]);
    let answers = lss(&mut world, [0x11, 5, 0, 0, 0, 0, 0, 0]);
    assert_eq!(answers, [[0x11, 0xFF]; 2]);
    lss(&mut world, [0x04, 0, 0, 0, 0, 0, 0, 0]);
    world.nmt(NmtCommand::ResetCommunication, 0);
    world.run(200);
    nodes_are(&mut world, &[2, 3]);
    // The master's own number, and what is no robot's.
    select(&mut world, 2);
    for node in [1, 18, 127] {
        assert_eq!(
            lss(&mut world, [0x11, node, 0, 0, 0, 0, 0, 0]),
            [[0x11, 1]],
            "{node}"
        );
    }
    assert_eq!(lss(&mut world, [0x11, 5, 0, 0, 0, 0, 0, 0]), [[0x11, 0]]);
}

/// Whatever NMT command comes: the group comes down in its ramp, or has been cut, and is who it
/// was.
#[test]
fn an_nmt_reset_in_motion_is_a_ramp() {
    for command in [NmtCommand::ResetNode, NmtCommand::ResetCommunication] {
        for target in [0, 2] {
            let mut world = moving(&[2, 3]);
            world.nmt(command, target);
            let (mut last, mut steepest) = (0.6_f32, 0.0_f32);
            for _ in 0..1500 {
                world.step();
                let vx = world.robots[0].control.report().twist_ref().vx;
                steepest = steepest.max((last - vx) / 1e-3);
                last = vx;
            }
            // DECELERATION of the tests, 1 m/s2, and rounding.
            assert!(steepest < 1.001, "{command:?}: {steepest} m/s2");
            assert!(world.robots.iter().all(|robot| robot.rates == [0.0; 4]));
            nodes_are(&mut world, &[2, 3]);
        }
    }
}

/// CiA 301 7.3.2.2.1: reset node sets the application's objects to their power-on values; those of
/// 0x2100 are 0. A reset of the communication leaves them.
#[test]
fn a_node_reset_forgets_the_last_setpoint() {
    let mut world = moving(&[2, 3]);
    let vx = protocol::Address::new(0x2100, 1);
    let sequence = protocol::Address::new(0x2100, 4);
    assert_ne!(world.read(2, vx), Ok(0));
    world.nmt(NmtCommand::ResetCommunication, 2);
    world.run(1500);
    assert_ne!(world.read(2, vx), Ok(0));
    world.nmt(NmtCommand::ResetNode, 2);
    world.run(1500);
    assert_eq!(world.read(2, vx), Ok(0));
    assert_eq!(world.read(2, sequence), Ok(0));
    assert_ne!(world.read(3, vx), Ok(0));
}

/// Error passive is told once each time, by emergency message and limit, and taken back once it is
/// over.
#[test]
fn an_error_passive_controller_is_announced_and_taken_back() {
    let mut world = moving(&[2, 3]);
    let report_errors = |world: &mut World, transmit, receive, last| {
        let errors = crate::CanErrors {
            transmit,
            receive,
            last,
        };
        let now = control::time::Micros(world.now + world.robots[0].offset);
        world.robots[0].bus.on_can_errors(now, &errors);
        world.run(10);
    };
    let limit = |world: &World| world.status(2).code;
    let bus_errors = protocol::Code::Limit(protocol::Limit::BusErrors);
    for round in 1..=3 {
        report_errors(&mut world, 127, 0, 3);
        assert_eq!(limit(&world), protocol::Code::None);
        // Around the border, and long after it.
        for transmit in [128, 127, 136, 100, 128, 96] {
            report_errors(&mut world, transmit, 0, 0);
            assert_eq!(limit(&world), bus_errors);
        }
        assert_eq!(world.emergencies(2).last(), Some(&0x8120));
        report_errors(&mut world, 0, 95, 0);
        world.run(10);
        assert_eq!(limit(&world), protocol::Code::None);
        // Announced and taken back, once each.
        assert_eq!(world.emergencies(2).len(), 2 * round);
        assert_eq!(world.emergencies(2).last(), Some(&0));
        let passives = u32::try_from(round).unwrap();
        assert_eq!(world.read(2, at::CAN_PASSIVES), Ok(passives));
    }
    assert_eq!(
        world
            .read(2, at::CAN_RECEIVE_ERRORS)
            .map(|word| word & 0xFF),
        Ok(95)
    );
    assert_eq!(
        world.read(2, at::CAN_LAST_ERROR).map(|word| word & 0xFF),
        Ok(3)
    );
    let all_move = world
        .robots
        .iter()
        .all(|robot| robot.bus.state() == State::Moving);
    assert!(all_move, "it stops nobody");
}

/// A controller comes back from bus-off with counters at zero, which it may show before it says
/// that it is back. What is told first is that it was off the bus, and only then that it is error
/// passive no more.
#[test]
fn bus_off_is_announced_before_error_passive_is_taken_back() {
    let mut world = moving(&[2, 3]);
    let offset = world.robots[0].offset;
    let errors = |transmit| crate::CanErrors {
        transmit,
        receive: 0,
        last: 0,
    };
    let now = control::time::Micros(world.now + offset);
    let bus = &mut world.robots[0].bus;
    bus.on_can_errors(now, &errors(255));
    bus.on_bus_off(now);
    world.run(200);
    let now = control::time::Micros(world.now + offset);
    let bus = &mut world.robots[0].bus;
    bus.on_can_errors(now, &errors(0));
    bus.on_bus_recovered(now);
    bus.on_can_errors(now, &errors(0));
    world.run(20);
    assert_eq!(world.emergencies(2), [0x8140, 0]);
}
