//! What stops one robot, and what keeps it at rest.

use canopen::NmtCommand;
use control::time::Micros;
use kinematics::Twist;
use protocol::address::{self as at, history};
use protocol::{Fault, MemberState, StoredFault, Value, cob};

use super::world::{SUPPLY, World};
use crate::state::State;
use control::interface::Outputs;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

fn moving(nodes: &[u8]) -> World {
    let mut world = World::started(nodes);
    world.drive(FORWARD, 1000);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world
}

fn faulted(world: &World) -> Option<Fault> {
    match world.robots[0].bus.state() {
        State::Faulted(fault) => Some(fault),
        _ => None,
    }
}

#[test]
fn emergency_stop_cuts_in_one_tick() {
    let mut world = moving(&[2]);
    world.robots[0].inputs.emergency_stop = true;
    world.step();
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    world.run(5);
    assert_eq!(faulted(&world), Some(Fault::EmergencyStop));
    assert_eq!(world.emergencies(2), [Fault::EmergencyStop.code()]);
}

#[test]
fn releasing_the_emergency_stop_starts_nothing() {
    let mut world = moving(&[2]);
    world.robots[0].inputs.emergency_stop = true;
    world.run(50);
    world.robots[0].inputs.emergency_stop = false;
    world.run(1000);
    assert_eq!(faulted(&world), Some(Fault::EmergencyStop));
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
}

#[test]
fn start_is_refused_while_the_emergency_stop_is_pressed() {
    let mut world = moving(&[2]);
    world.robots[0].inputs.emergency_stop = true;
    world.run(50);
    world.start();
    for _ in 0..100 {
        world.step();
        assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    }
    assert_eq!(faulted(&world), Some(Fault::EmergencyStop));
    world.robots[0].inputs.emergency_stop = false;
    world.run(5);
    world.start();
    world.drive(FORWARD, 100);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
}

#[test]
fn driver_fault_cuts_in_one_tick() {
    let mut world = moving(&[2]);
    world.robots[0].inputs.drive_fault = Some(Fault::DriverFault);
    world.step();
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    world.run(5);
    assert_eq!(faulted(&world), Some(Fault::DriverFault));
}

#[test]
fn brake_is_released_only_while_enabled_and_engages_after_standstill() {
    let mut world = World::new(&[2]);
    world.configure();
    world.run(50);
    assert!(!world.robots[0].outputs.brake_released);
    world.start();
    world.run(30);
    assert!(world.robots[0].outputs.brake_released);
    world.drive(FORWARD, 1000);
    world.sync = false;
    for _ in 0..1500 {
        world.step();
        let robot = &world.robots[0];
        assert_eq!(robot.outputs.brake_released, robot.outputs.drivers_enabled);
        if !robot.outputs.brake_released {
            let fastest = robot.rates.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert_eq!(fastest, 0.0, "braked while turning");
        }
    }
    assert!(!world.robots[0].outputs.brake_released);
}

#[test]
fn invalid_setpoints_are_ignored_then_stop() {
    let mut world = moving(&[2]);
    world.twist = Some(Twist::new(f32::NAN, 0.0, 0.0));
    world.run(50);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    assert!((world.robots[0].moves().vx - 0.6).abs() < 0.01);
    world.run(1500);
    assert_eq!(faulted(&world), Some(Fault::SetpointInvalid));
    assert!(world.read(2, at::IGNORED_SETPOINTS).unwrap() >= 10);
}

#[test]
fn a_stale_sequence_is_not_followed() {
    let mut world = moving(&[2]);
    let frame = protocol::GroupTwist {
        twist: Twist::new(-0.6, 0.0, 0.0),
        sequence: world.sequence.wrapping_sub(3),
        group: super::world::GROUP,
    };
    world.twist = None;
    world.send(1, cob::GROUP_TWIST, &frame.encode());
    world.run(30);
    assert!((world.robots[0].moves().vx - 0.6).abs() < 0.01);
    assert_eq!(world.read(2, at::IGNORED_SETPOINTS), Ok(1));
}

#[test]
fn two_masters_stop_the_group() {
    let mut world = moving(&[2]);
    world.run(500);
    assert_eq!(world.robots[0].bus.state(), State::Moving, "one is orderly");
    for foreign in 100..112 {
        let frame = protocol::GroupTwist {
            twist: FORWARD,
            sequence: foreign,
            group: super::world::GROUP,
        };
        world.send(1, cob::GROUP_TWIST, &frame.encode());
        world.run(10);
    }
    world.run(1000);
    assert_eq!(faulted(&world), Some(Fault::TwoMasters));
}

#[test]
fn a_dead_encoder_ramps_down() {
    let mut world = moving(&[2]);
    world.robots[0].encoder_sign[1] = 0.0;
    world.run(2500);
    assert_eq!(faulted(&world), Some(Fault::EncoderDead));
}

#[test]
fn an_inverted_encoder_cuts() {
    let mut world = World::started(&[2]);
    world.release();
    world.robots[0].encoder_sign[2] = -1.0;
    world.twist = Some(FORWARD);
    let mut fastest = 0.0_f64;
    for _ in 0..1000 {
        world.step();
        fastest = fastest.max(world.robots[0].rates[2].abs());
    }
    assert_eq!(faulted(&world), Some(Fault::EncoderInverted));
    // It ran away, but not far.
    assert!(fastest < 8.0, "up to {fastest} rad/s");
}

#[test]
fn a_blocked_wheel_ramps_down() {
    let mut world = moving(&[2]);
    world.robots[0].blocked[0] = true;
    world.run(2500);
    let fault = faulted(&world).unwrap();
    assert!(matches!(fault, Fault::WheelBlocked | Fault::EncoderDead));
}

#[test]
fn a_low_supply_ramps_down() {
    let mut world = World::new(&[2]);
    world.configure();
    world
        .write(2, at::SUPPLY_MINIMUM, Value::F32(18.0))
        .unwrap();
    world.robots[0].set_supply(24.0);
    world.start();
    world.run(30);
    world.drive(FORWARD, 1000);
    world.robots[0].set_supply(17.0);
    world.run(90);
    assert_eq!(
        world.robots[0].bus.state(),
        State::Moving,
        "a dip is forgiven"
    );
    world.run(1500);
    assert_eq!(faulted(&world), Some(Fault::SupplyLow));
}

#[test]
fn a_starved_bus_side_ramps_down() {
    let mut world = moving(&[2]);
    world.robots[0].bus_runs = false;
    world.run(90);
    assert!(world.robots[0].outputs.drivers_enabled);
    world.run(1200);
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    assert_eq!(world.robots[0].rates, [0.0; 4]);
}

#[test]
fn late_control_ticks_ramp_down() {
    let mut world = moving(&[2]);
    world.robots[0].ticking = false;
    world.run(25);
    world.robots[0].ticking = true;
    world.run(1500);
    assert_eq!(faulted(&world), Some(Fault::ControlLate));
    assert_eq!(world.read(2, at::LATE_TICKS), Ok(1));
}

#[test]
fn history_keeps_the_faults_with_their_times() {
    let mut world = moving(&[2]);
    world.robots[0].inputs.emergency_stop = true;
    world.run(20);
    world.robots[0].inputs.emergency_stop = false;
    // Until the wheels are measured to stand.
    world.run(200);
    world.start();
    world.drive(FORWARD, 300);
    world.sync = false;
    world.run(1500);
    let newest = world.read(2, history::code(1));
    assert_eq!(newest, Ok(u32::from(Fault::SyncLost.code())));
    let second = world.read(2, history::code(2));
    assert_eq!(second, Ok(u32::from(Fault::EmergencyStop.code())));
    let times = (
        world.read(2, history::time(1)).unwrap(),
        world.read(2, history::time(2)).unwrap(),
    );
    assert!(times.0 > times.1 + 300);
    assert_eq!(world.read(2, at::STOPS), Ok(2));
    assert_eq!(
        world.emergencies(2),
        [Fault::EmergencyStop.code(), 0, Fault::SyncLost.code()]
    );
}

/// Never while the robot moves or ramps, and with what it was like when the fault appeared.
#[test]
fn faults_are_written_at_the_next_rest() {
    let mut world = World::new(&[2]);
    world.configure();
    let minimum = Value::F32(18.0);
    world.write(2, at::SUPPLY_MINIMUM, minimum).unwrap();
    world.robots[0].set_supply(SUPPLY);
    world.run(20);
    world.start();
    world.drive(FORWARD, 2_500);
    let due = |world: &World| {
        let robot = &world.robots[0];
        let now = Micros(world.now + robot.offset);
        robot.bus.to_remember(now).is_some()
    };
    assert!(!due(&world), "not even the start, while it moves");
    world.sync = false;
    world.run(60);
    let mut off_ms = 0;
    for _ in 0..3_000 {
        world.run(1);
        off_ms = if world.robots[0].outputs.drivers_enabled {
            0
        } else {
            off_ms + 1
        };
        if due(&world) {
            break;
        }
    }
    assert!((500..=510).contains(&off_ms), "outputs off for {off_ms} ms");
    let bytes = world.read_block(2, at::STORED_FAULTS).unwrap();
    let (faults, _) = bytes.as_chunks();
    let [fault] = faults else {
        panic!("{bytes:?}");
    };
    let fault = StoredFault::decode(fault);
    assert_eq!(fault.code, Fault::SyncLost.code());
    assert_eq!(Ok(fault.time_ms), world.read(2, history::time(1)));
    let supply = fault.supply.unwrap();
    assert!((supply - SUPPLY).abs() < 0.1, "{fault:?}");
    // At the speed it was asked for, straight ahead.
    let rate = fault.rates[0];
    assert!(rate > 0.5, "{fault:?}");
    assert!(
        fault
            .rates
            .iter()
            .all(|one| (one - rate).abs() < 0.1 * rate)
    );
    // A start takes precedence: nothing is due once it is accepted.
    world.sync = true;
    world.run(50);
    world.start();
    world.run(20);
    assert!(!due(&world));
}

#[test]
fn any_frame_at_any_time_never_panics() {
    let mut world = World::started(&[2, 3]);
    let mut word = 0x1234_5678_9ABC_DEF1_u64;
    for _ in 0..50_000 {
        word = word
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let bytes = (word >> 3).to_le_bytes();
        let length = (word >> 60) as usize % 9;
        let id = (word >> 40) as u16 & 0x7FF;
        world.send(1, id, &bytes[..length]);
        if word >> 56 & 3 == 0 {
            world.step();
        }
        world.log.clear();
    }
}

/// Two members whose wheels disagree: one has slipped its load.
fn disagreeing(limit: f32, fault: f32) -> World {
    let mut world = World::new(&[2, 3]);
    world.configure();
    for node in [2, 3] {
        world
            .write(node, at::STRAIN_LIMIT, Value::F32(limit))
            .unwrap();
        world
            .write(node, at::STRAIN_FAULT, Value::F32(fault))
            .unwrap();
    }
    world.start();
    world.run(30);
    world
}

/// A frame in every period as robot 3 would send it if its wheels moved it ahead like that, m/s.
fn slipping(world: &mut World, vx: f32, millis: u32) {
    for _ in 0..millis / 10 {
        let frame = protocol::MeasuredTwist {
            twist: Twist::new(vx, 0.0, 0.0),
            sequence: world.sequence,
            group: super::world::GROUP,
        };
        world.until(10, |world| world.now % 10_000 == 5_000);
        world.send(3, cob::measured_twist(3), &frame.encode());
        world.step();
    }
}

#[test]
fn members_that_disagree_report_strain_then_stop() {
    let mut world = disagreeing(0.05, 0.2);
    world.drive(FORWARD, 1000);
    assert_eq!(world.status(2).code, protocol::Code::None);
    // It has lost a sixth of the speed.
    slipping(&mut world, 0.5, 50);
    assert_eq!(
        world.status(2).code,
        protocol::Code::Limit(protocol::Limit::Strain)
    );
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    slipping(&mut world, 0.3, 400);
    world.run(1200);
    assert_eq!(faulted(&world), Some(Fault::StrainExcess));
}

/// Strain stops a group that was told nothing about it: 0.3 m/s by default, and so does slip.
#[test]
fn strain_and_slip_are_faults_by_default() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    for object in [at::STRAIN_FAULT, at::SLIP_FAULT] {
        let value = f32::from_bits(world.read(2, object).unwrap());
        assert!(value > 0.0, "{object:?}");
    }
    world.start();
    world.run(30);
    world.drive(FORWARD, 1000);
    slipping(&mut world, 0.6 - 0.35, 400);
    world.run(1200);
    assert_eq!(faulted(&world), Some(Fault::StrainExcess));
}

/// What a wheel does to the load is announced after what is wrong with the wheel.
#[test]
fn a_longer_wheel_fault_time_makes_strain_wait() {
    let mut world = disagreeing(0.05, 0.2);
    for node in [2, 3] {
        let time = Value::U16(800);
        world.nmt(NmtCommand::EnterPreOperational, 0);
        world.write(node, at::WHEEL_FAULT_TIME, time).unwrap();
    }
    world.start();
    world.run(30);
    world.drive(FORWARD, 1000);
    slipping(&mut world, 0.3, 1_150);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    slipping(&mut world, 0.3, 100);
    let fault = world.robots[0].bus.state().fault();
    assert_eq!(fault, Some(Fault::StrainExcess));
}

#[test]
fn a_robot_that_was_reset_by_its_watchdog_remembers_it_and_stays_off() {
    let mut world = World::new(&[2]);
    let now = control::time::Micros(world.robots[0].offset);
    world.robots[0].bus.on_fault(now, Fault::WatchdogReset);
    world.run(200);
    assert_eq!(
        world.read(2, history::code(1)),
        Ok(u32::from(Fault::WatchdogReset.code()))
    );
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    assert_eq!(world.emergencies(2), [Fault::WatchdogReset.code()]);
    let error_register = protocol::Address::new(0x1001, 0);
    assert_ne!(world.read(2, error_register), Ok(0));
    world.configure();
    world.start();
    world.run(30);
    assert_eq!(world.read(2, error_register), Ok(0), "the start clears it");
    assert_eq!(world.robots[0].bus.state(), State::Armed);
}

#[test]
fn bus_off_ramps_down() {
    let mut world = moving(&[2]);
    let now = control::time::Micros(world.now + world.robots[0].offset);
    world.robots[0].bus.on_fault(now, Fault::BusOff);
    world.run(50);
    assert!(world.robots[0].outputs.drivers_enabled, "braking");
    world.run(1200);
    assert_eq!(faulted(&world), Some(Fault::BusOff));
}

#[test]
fn a_fault_from_before_the_boot_up_is_announced_after_it() {
    let mut bus = crate::BusSide::new(crate::Identity::new(canopen::NodeId::new(2).unwrap(), 1));
    bus.on_fault(control::time::Micros(10), Fault::Crash);
    bus.poll(control::time::Micros(20));
    let frames: std::vec::Vec<_> = core::iter::from_fn(|| bus.pop_frame()).collect();
    assert_eq!(frames[0].id(), cob::heartbeat(2));
    let [low, high] = Fault::Crash.code().to_le_bytes();
    let emergency = frames.iter().find(|frame| frame.id() == cob::emergency(2));
    assert_eq!(emergency.unwrap().data()[..2], [low, high]);
}

#[test]
fn after_bus_off_nothing_is_sent_until_the_bus_is_back() {
    let mut world = moving(&[2]);
    let offset = world.robots[0].offset;
    let bus = &mut world.robots[0].bus;
    bus.on_bus_off(control::time::Micros(world.now + offset));
    let before = world.log.len();
    world.run(60);
    let own = |frame: &canopen::Frame| frame.id() == cob::member_status(2);
    assert!(!world.log[before..].iter().any(|(_, frame)| own(frame)));
    world.run(1200);
    assert_eq!(faulted(&world), Some(Fault::BusOff));
    let now = control::time::Micros(world.now + offset);
    assert!(world.events.contains(&(2, crate::Event::RecoverBus)));
    world.robots[0].bus.on_bus_recovered(now);
    world.run(10);
    world.start();
    world.run(50);
    assert!(world.log.iter().rev().take(50).any(|(_, frame)| own(frame)));
}

#[test]
fn wheels_that_disagree_report_slip_then_stop() {
    let mut world = World::new(&[2]);
    world.configure();
    for (address, value) in [
        (at::SLIP_LIMIT, 0.2),
        (at::SLIP_FAULT, 1.0),
        // The wheel watch would be first.
        (at::BLOCKED_RATE, 0.0),
    ] {
        world.write(2, address, Value::F32(value)).unwrap();
    }
    world.start();
    world.run(30);
    world.drive(Twist::new(0.15, 0.0, 0.0), 1000);
    assert_eq!(world.status(2).code, protocol::Code::None);
    // 0.98 rad/s asked, 0.5 given: half of the difference, 0.24 rad/s, is slip.
    world.robots[0].drag[0] = true;
    world.run(40);
    world.until(300, |world| {
        world.status(2).code == protocol::Code::Limit(protocol::Limit::Slip)
            || matches!(world.robots[0].bus.state(), State::Faulted(_))
    });
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world.drive(FORWARD, 2000);
    assert_eq!(faulted(&world), Some(Fault::SlipExcess));
}

/// A wheel that drags makes the robot slip. However long the wheel watch may take, it names the
/// cause before the consequence is announced.
#[test]
fn a_longer_wheel_fault_time_still_names_the_wheel_before_the_slip() {
    for fault_ms in [200, 500, 2_000_u16] {
        let mut world = World::new(&[2]);
        world.configure();
        for (address, value) in [
            (at::SLIP_LIMIT, Value::F32(0.2)),
            (at::SLIP_FAULT, Value::F32(0.5)),
            (at::BLOCKED_RATE, Value::F32(1.0)),
            (at::WHEEL_FAULT_TIME, Value::U16(fault_ms)),
        ] {
            world.write(2, address, value).unwrap();
        }
        world.start();
        world.run(30);
        // 1.97 rad/s asked, 0.5 turned: more than the wheel watch allows, and 0.73 rad/s of slip.
        world.drive(Twist::new(0.3, 0.0, 0.0), 1000);
        world.robots[0].drag[0] = true;
        let took = world.until(4_000, |world| world.robots[0].bus.state() != State::Moving);
        let fault = world.robots[0].bus.state().fault();
        assert_eq!(fault, Some(Fault::WheelBlocked), "{fault_ms} ms");
        // The wheel takes a while to slow down.
        assert!(took >= u32::from(fault_ms) && took <= u32::from(fault_ms) + 100);
    }
}

#[test]
fn a_dead_encoder_is_noticed_at_a_crawl() {
    let mut world = World::started(&[2]);
    world.drive(Twist::new(0.02, 0.0, 0.0), 2000);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world.robots[0].encoder_sign[3] = 0.0;
    let took = world.until(4000, |world| world.robots[0].bus.state() != State::Moving);
    std::println!("dead encoder at 20 mm/s noticed after {took} ms");
    assert!(took <= 1500, "{took} ms");
    let fault = world.robots[0].bus.state().fault();
    assert_eq!(fault, Some(Fault::EncoderDead));
}

#[test]
fn a_sticky_start_is_not_a_fault() {
    let mut world = World::new(&[2]);
    world.configure();
    for wheel in 0..4 {
        // Half of what the motors really need.
        let friction = Value::F32(super::world::STATIC_FRICTION * 0.5);
        world
            .write(2, at::motor::static_friction(wheel), friction)
            .unwrap();
    }
    world.start();
    world.run(30);
    world.drive(Twist::new(0.02, 0.0, 0.0), 3000);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
}

/// What a robot answers to SDO is what is, also without SYNC.
#[test]
fn what_is_read_is_not_older_than_the_request() {
    let mut world = World::started(&[2, 3]);
    let configured = |world: &mut World| world.read(2, at::STATE).unwrap();
    world.drive(Twist::new(0.3, 0.0, 0.0), 500);
    assert_eq!(configured(&mut world), MemberState::Moving as u32);
    // The master falls silent: no SYNC, no heartbeat.
    (world.sync, world.heartbeat, world.twist) = (false, false, None);
    world.run(3_000);
    assert_eq!(configured(&mut world), MemberState::Faulted as u32);
    let code = world.read(2, at::STATUS_CODE).unwrap();
    assert_eq!(
        code,
        u32::from(world.robots[0].bus.state().fault().unwrap().code())
    );

    let mut world = World::new(&[2]);
    world.configure();
    world.robots[0].inputs.emergency_stop = true;
    world.run(10);
    let code = world.read(2, at::STATUS_CODE).unwrap();
    assert_eq!(
        code,
        u32::from(Fault::EmergencyStop.code()),
        "pressed while idle"
    );
    world.robots[0].inputs.emergency_stop = false;
    world.run(10);
    let code = world.read(2, at::STATUS_CODE).unwrap();
    assert_ne!(code, u32::from(Fault::EmergencyStop.code()), "released");
}
