//! Configuration and start.

use canopen::{NmtCommand, NmtState};
use kinematics::Twist;
use protocol::address as at;
use protocol::{Address, Code, Fault, MemberState, Value, cob};

use super::world::{GROUP, World, configuration};
use crate::Hardware;
use crate::state::State;

const READ_ONLY: u32 = 0x0601_0002;
const NO_OBJECT: u32 = 0x0602_0000;
const TOO_LONG: u32 = 0x0607_0012;
const NO_SUB_INDEX: u32 = 0x0609_0011;
const INVALID: u32 = 0x0609_0030;
const TOO_HIGH: u32 = 0x0609_0031;
const TOO_LOW: u32 = 0x0609_0032;
const DEVICE_STATE: u32 = 0x0800_0022;

const FORWARD: Twist = Twist::new(0.5, 0.0, 0.0);

#[test]
fn configured_and_started_robots_reach_the_commanded_twist() {
    let mut world = World::started(&[2, 3, 4]);
    let twist = Twist::new(0.4, -0.2, 0.1);
    world.drive(twist, 1500);
    for robot in &world.robots {
        assert_eq!(robot.bus.state(), State::Moving);
        let error = robot.moves() - twist;
        // 0.5 % of the speed, 0.447 m/s: an observer's ripple at this rate.
        assert!(
            error.vx.abs() < 2.2e-3 && error.vy.abs() < 2.2e-3,
            "{error:?}"
        );
        assert!(error.omega.abs() < 2e-3, "{error:?}");
        assert!(robot.outputs.drivers_enabled && robot.outputs.brake_released);
    }
}

/// Before any start, and without SYNC: who reads the state sees that it is ready, and that it is no
/// longer once a parameter contradicts the others.
#[test]
fn the_state_that_is_read_knows_whether_the_parameters_are_complete() {
    let mut world = World::new(&[2]);
    let read = |world: &mut World| world.read(2, at::STATE).unwrap();
    assert_eq!(read(&mut world), MemberState::Unconfigured as u32);
    for (address, value) in configuration(0, 0b100) {
        world.write(2, address, value).unwrap();
    }
    assert_eq!(read(&mut world), MemberState::Ready as u32);
    world.write(2, at::MEMBERS, Value::U32(0b1000)).unwrap();
    assert_ne!(world.read(2, at::CONFIGURATION_STATUS), Ok(0));
    assert_eq!(read(&mut world), MemberState::Unconfigured as u32);
}

#[test]
fn drivers_stay_off_until_the_configuration_is_complete() {
    let all = configuration(0, 0b100);
    for (left_out, _) in &all {
        let mut world = World::new(&[2]);
        for (address, value) in all.iter().filter(|(address, _)| address != left_out) {
            world.write(2, *address, *value).unwrap();
        }
        let status = world.read(2, at::CONFIGURATION_STATUS).unwrap();
        assert_eq!(status, left_out.packed() << 8 | 1, "names what is missing");
        world.start();
        world.drive(FORWARD, 40);
        assert_eq!(
            world.robots[0].bus.state(),
            State::Faulted(Fault::Unconfigured)
        );
        assert!(!world.robots[0].outputs.drivers_enabled);
        assert_eq!(world.emergencies(2), [Fault::Unconfigured.code()]);
    }
}

#[test]
fn a_robot_that_is_no_member_of_its_own_group_is_refused() {
    let mut world = World::new(&[2]);
    world.configure();
    world.write(2, at::MEMBERS, Value::U32(0b1000)).unwrap();
    let status = world.read(2, at::CONFIGURATION_STATUS).unwrap();
    assert_eq!(status, at::MEMBERS.packed() << 8 | 2);
    world.start();
    world.run(20);
    assert_eq!(
        world.robots[0].bus.state(),
        State::Faulted(Fault::Unconfigured)
    );
}

/// 477 000 counts a second at most. RM0390 18.4.7 at 90 MHz: filter 13 takes levels of 160 clocks,
/// 562 500 a second, filter 14 of 192, 468 750 a second.
#[test]
fn counts_that_come_too_fast_for_the_filter_are_refused() {
    for (filter, fits) in [(0, true), (3, true), (13, true), (14, false), (15, false)] {
        let mut world = World::new(&[2]);
        world.configure();
        for (address, value) in [
            (at::GEAR_RATIO, Value::F32(1.0)),
            (at::WHEEL_RATE_MAX, Value::F32(10.0)),
            (at::ENCODER_COUNTS, Value::F32(300_000.0)),
            (at::ENCODER_FILTER, Value::U8(filter)),
        ] {
            world.write(2, address, value).unwrap();
        }
        let status = world.read(2, at::CONFIGURATION_STATUS).unwrap();
        let refused = at::ENCODER_FILTER.packed() << 8 | 2;
        assert_eq!(status, if fits { 0 } else { refused }, "filter {filter}");
    }
}

/// Those 477 465 counts a second get through filter 13 at 90 MHz. At the 72 MHz of the kit's timers
/// (RM0008 7.2) it lets 450 000 through.
#[test]
fn a_filter_lets_fewer_counts_through_where_its_timer_is_slower() {
    let kit = Hardware {
        output_stages: Hardware::NUCLEO_F446RE.output_stages,
        ..Hardware::KIT_F103RC
    };
    let refused = at::ENCODER_FILTER.packed() << 8 | 2;
    for (hardware, status) in [(Hardware::NUCLEO_F446RE, 0), (kit, refused)] {
        let mut world = World::on(hardware, &[2]);
        world.configure();
        for (address, value) in [
            (at::GEAR_RATIO, Value::F32(1.0)),
            (at::WHEEL_RATE_MAX, Value::F32(10.0)),
            (at::ENCODER_COUNTS, Value::F32(300_000.0)),
            (at::ENCODER_FILTER, Value::U8(13)),
        ] {
            world.write(2, address, value).unwrap();
        }
        assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(status));
    }
}

#[test]
fn a_configuration_written_later_mends_a_refused_start() {
    let mut world = World::new(&[2]);
    world.start();
    world.run(20);
    world.nmt(NmtCommand::EnterPreOperational, 2);
    world.configure();
    world.start();
    world.run(20);
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    assert_eq!(world.emergencies(2), [Fault::Unconfigured.code(), 0]);
}

#[test]
fn geometry_is_refused_while_operational() {
    let mut world = World::started(&[2]);
    let result = world.write(2, at::HALF_TRACK, Value::F32(0.4));
    assert_eq!(result, Err(DEVICE_STATE));
    assert_eq!(
        world.read(2, at::HALF_TRACK),
        Ok(0.37_f32.to_bits()),
        "nothing changed"
    );
    assert_eq!(world.read(2, at::REFUSED_WRITES), Ok(1));
}

#[test]
fn values_out_of_their_limits_are_refused_and_change_nothing() {
    let mut world = World::new(&[2]);
    world.configure();
    let mut refuse = |address, value, abort| {
        let before = world.read(2, address);
        assert_eq!(world.write(2, address, value), Err(abort));
        assert_eq!(world.read(2, address), before);
    };
    refuse(at::WHEEL_RADIUS, Value::F32(0.0), TOO_LOW);
    refuse(at::WHEEL_RADIUS, Value::F32(1.1), TOO_HIGH);
    refuse(at::WHEEL_RADIUS, Value::F32(f32::NAN), INVALID);
    refuse(at::COMPENSATION_YAW, Value::F32(0.0), TOO_LOW);
    refuse(at::ENCODER_REVERSED, Value::U8(16), TOO_HIGH);
    refuse(at::ENCODER_REVERSED, Value::U16(1), TOO_LONG);
    refuse(at::WIRE_VERSION, Value::U16(9), READ_ONLY);
    refuse(at::STATE, Value::U8(3), READ_ONLY);
}

#[test]
fn objects_that_do_not_exist_are_named_as_such() {
    let mut world = World::new(&[2]);
    let address = protocol::Address::new;
    assert_eq!(world.read(2, address(0x200F, 0)), Err(NO_OBJECT));
    assert_eq!(world.read(2, address(0x2010, 6)), Err(NO_SUB_INDEX));
    assert_eq!(world.read(2, address(0x2010, 0)), Ok(5), "sub-indices");
    assert_eq!(
        world.write(2, address(0x2010, 0), Value::U8(9)),
        Err(READ_ONLY)
    );
}

#[test]
fn identity_and_wire_version_can_be_read_before_anything_else() {
    let mut world = World::new(&[7]);
    assert_eq!(
        world.read(7, at::WIRE_VERSION),
        Ok(u32::from(protocol::WIRE_VERSION))
    );
    assert_eq!(world.read(7, at::SERIAL_NUMBER), Ok(7000));
}

#[test]
fn every_object_of_the_table_can_be_read() {
    let mut world = World::new(&[2]);
    for object in protocol::OBJECTS {
        let value = world.read_block(2, object.address);
        if object.access == protocol::Access::WriteOnly {
            assert_eq!(value, Err(0x0601_0001), "{:?}", object.address);
            continue;
        }
        if object.address == at::LOCK_CHALLENGE {
            assert_eq!(value, Err(0x0800_0022), "none before the start is kept");
            continue;
        }
        assert!(value.is_ok(), "{:?} {}", object.address, object.name);
    }
}

#[test]
fn crc_is_the_same_for_the_same_configuration() {
    let mut world = World::new(&[2, 3]);
    for (address, value) in configuration(0, 0b1100) {
        world.write(2, address, value).unwrap();
        world.write(3, address, value).unwrap();
    }
    let first = world.read(2, at::CONFIGURATION_CRC);
    assert_eq!(first, world.read(3, at::CONFIGURATION_CRC));
    world.write(3, at::MOUNT_X, Value::F32(0.5)).unwrap();
    assert_ne!(first, world.read(3, at::CONFIGURATION_CRC));
}

#[test]
fn nmt_start_alone_moves_nothing() {
    let mut world = World::started(&[2, 3]);
    world.run(200);
    for robot in &world.robots {
        assert_eq!(robot.bus.state(), State::Armed);
        assert_eq!(robot.rates, [0.0; 4]);
        assert!(robot.outputs.drivers_enabled);
    }
    assert_eq!(world.status(2).state, MemberState::Armed);
    assert_eq!(world.status(2).code, Code::None);
}

#[test]
fn a_setpoint_before_the_start_moves_nothing_after_it() {
    let mut world = World::new(&[2]);
    world.configure();
    world.drive(FORWARD, 100);
    world.twist = None;
    world.start();
    world.run(200);
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    assert_eq!(world.robots[0].bus.nmt_state(), NmtState::Operational);
}

#[test]
fn another_groups_setpoint_moves_nothing() {
    let mut world = World::started(&[2]);
    let frame = protocol::GroupTwist {
        twist: FORWARD,
        sequence: 1,
        group: GROUP + 1,
    };
    for _ in 0..10 {
        world.send(1, protocol::cob::GROUP_TWIST, &frame.encode());
        world.run(10);
    }
    assert_eq!(world.robots[0].bus.state(), State::Armed);
}

#[test]
fn commissioning_twist_moves_one_robot_alone_if_permitted() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    world.write(2, at::MEMBERS, Value::U32(1 << 2)).unwrap();
    world.start();
    world.run(150);
    let send = |world: &mut World, vx, sequence| {
        let frame = protocol::GroupTwist {
            twist: Twist::new(vx, 0.0, 0.0),
            sequence,
            group: GROUP,
        };
        world.send(1, protocol::cob::commissioning_twist(2), &frame.encode());
        world.run(10);
    };
    let both = |world: &mut World, from: u8| {
        (from..from + 5).for_each(|sequence| send(world, 0.0, sequence));
        (from + 5..from + 60).for_each(|sequence| send(world, 0.2, sequence));
    };
    both(&mut world, 1);
    assert_eq!(world.robots[0].bus.state(), State::Armed, "not permitted");
    world.write(2, at::COMMISSIONING, Value::U8(1)).unwrap();
    both(&mut world, 61);
    assert_eq!(world.robots[0].bus.state(), State::Alone);
    assert!((world.robots[0].moves().vx - 0.2).abs() < 2e-3);
    assert_eq!(world.robots[1].rates, [0.0; 4]);
    // And it stops when nobody asks any more.
    world.run(1000);
    assert_eq!(
        world.robots[0].bus.state(),
        State::Faulted(Fault::SetpointOverdue)
    );
}

/// Index, sub-index, type, access and default of every object in an EDS.
fn eds_objects() -> std::vec::Vec<(u16, u8, u8, std::string::String, std::string::String)> {
    let mut text = std::string::String::new();
    let mut identity = crate::Identity::new(canopen::NodeId::MIN, 0);
    identity.storage = true;
    let communication = |out: &mut _| {
        canopen::eds::communication_objects(
            out,
            &identity.device(),
            &protocol::table::PROFILE_OBJECTS,
        )
    };
    protocol::generate::eds(&mut text, communication).unwrap();
    let mut objects = std::vec::Vec::new();
    for section in text.split("\n[").skip(1) {
        let (name, body) = section.split_once(']').unwrap();
        let (index, sub) = name.split_once("sub").unwrap_or((name, "0"));
        // Defaults of reals are comments.
        let field = |key: &str| {
            body.lines()
                .map(|line| line.trim_start_matches(';'))
                .find_map(|line| line.strip_prefix(key)?.strip_prefix('='))
                .map(std::borrow::ToOwned::to_owned)
        };
        if let (Ok(index), Some(kind)) = (u16::from_str_radix(index, 16), field("DataType")) {
            let sub = u8::from_str_radix(sub, 16).unwrap();
            let kind = u8::from_str_radix(kind.trim_start_matches("0x"), 16).unwrap();
            let access = field("AccessType").unwrap();
            objects.push((index, sub, kind, access, field("DefaultValue").unwrap()));
        }
    }
    objects
}

#[test]
fn every_object_of_the_eds_exists_with_its_type_and_default() {
    let mut world = World::new(&[5]);
    let objects = eds_objects();
    assert!(objects.len() > protocol::OBJECTS.len() + 60);
    for (index, sub, kind, _, default) in objects {
        // Text and blocks are longer than an expedited transfer; an empty history has no entries.
        if kind == 9 || kind == 15 || index == 0x1003 && sub > 0 {
            continue;
        }
        let value = world.read(5, protocol::Address::new(index, sub));
        let Ok(value) = value else {
            panic!("{index:04X}:{sub} {value:08X?}");
        };
        let node = default.starts_with("$NODEID+");
        let number = default.trim_start_matches("$NODEID+");
        let want = match (kind, number) {
            (_, "") => continue,
            (8, real) => real.parse::<f32>().unwrap().to_bits(),
            (_, hexadecimal) if hexadecimal.starts_with("0x") => {
                u32::from_str_radix(&hexadecimal[2..], 16).unwrap()
            }
            (_, decimal) => decimal.parse::<i64>().unwrap() as u32,
        };
        let want = if node { want + 5 } else { want };
        assert_eq!(value, want, "{index:04X}:{sub}");
    }
}

#[test]
fn every_limit_is_tried_from_both_sides() {
    let mut world = World::new(&[5]);
    let parameters = protocol::OBJECTS
        .iter()
        .filter(|object| object.access == protocol::Access::Parameter)
        .filter(|object| object.kind != protocol::Kind::Domain);
    for object in parameters {
        let beyond = |value: Value, up: bool| match value {
            Value::U8(value) if up => value.checked_add(1).map(Value::U8),
            Value::U8(value) => value.checked_sub(1).map(Value::U8),
            Value::U16(value) if up => value.checked_add(1).map(Value::U16),
            Value::U16(value) => value.checked_sub(1).map(Value::U16),
            Value::U32(value) if up => value.checked_add(1).map(Value::U32),
            Value::U32(value) => value.checked_sub(1).map(Value::U32),
            Value::F32(value) if up => Some(Value::F32(value.next_up())),
            Value::F32(value) => Some(Value::F32(value.next_down())),
            Value::I16(_) | Value::I24(_) | Value::Domain => None,
        };
        for (limit, up, abort) in [(object.min, false, TOO_LOW), (object.max, true, TOO_HIGH)] {
            assert_eq!(world.write(5, object.address, limit), Ok(()));
            if let Some(beyond) = beyond(limit, up) {
                let name = object.name;
                assert_eq!(world.write(5, object.address, beyond), Err(abort), "{name}");
                assert_eq!(world.read(5, object.address), Ok(limit.to_bits()), "{name}");
            }
        }
    }
}

/// In 300 ms there are 30 SYNCs, and a timer of 50 ms runs out five times after the pose that
/// follows the start.
#[test]
fn the_pose_is_sent_as_its_transmission_type_says() {
    const TYPE: Address = Address::new(0x1802, 2);
    const TIMER: Address = Address::new(0x1802, 5);
    for (kind, timer_ms, sent) in [(0, 0, 0), (1, 0, 30), (3, 0, 10), (254, 0, 1), (255, 50, 6)] {
        let mut world = World::new(&[2]);
        world.configure();
        world.write(2, TYPE, Value::U8(kind)).unwrap();
        world.write(2, TIMER, Value::U16(timer_ms)).unwrap();
        let before = world.log.len();
        world.start();
        world.run(300);
        let since = world.log.iter().skip(before);
        let poses = since.filter(|(_, frame)| frame.id() == cob::pose(2));
        assert_eq!(poses.count(), sent, "type {kind}");
    }
}
