//! How long each reaction takes, measured, against the promise in `docs/safety.md`.
//!
//! Measured from the moment the cause appears to the tick in which the reference begins to fall
//! (ramp) or the outputs are off (cut), in a group of three that drives at 0.6 m/s. The causes
//! appear at the worst moment of the SYNC period: just after a SYNC.

use control::time::Micros;
use kinematics::Twist;
use protocol::address as at;
use protocol::{Fault, GroupTwist, Reaction, Value, cob};

use super::world::{COUNTS, GROUP, World};
use crate::state::State;
use control::interface::Outputs;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

/// Cause, the fault robot 2 must show, and the promise in ms.
pub(super) type Case = (fn(&mut World), Fault, u32);

/// What keeps happening while the cause lasts, called once a millisecond.
pub(super) fn keep(world: &mut World, fault: Fault) {
    if fault == Fault::TwoMasters && world.now % 10_000 == 5_000 {
        let frame = protocol::GroupTwist {
            twist: FORWARD,
            sequence: world.sequence.wrapping_add(100),
            group: GROUP,
        };
        world.send(1, cob::GROUP_TWIST, &frame.encode());
    }
}

pub(super) const CASES: &[Case] = &[
    (|world| world.heartbeat = false, Fault::MasterSilent, 501),
    (|world| world.sync = false, Fault::SyncLost, 24),
    (|world| world.twist = None, Fault::SetpointOverdue, 101),
    (|world| world.robots[2].mute = true, Fault::MemberSilent, 21),
    (
        |world| world.robots[2].inputs.emergency_stop = true,
        Fault::MemberStopped,
        3,
    ),
    (
        |world| {
            // Robot 4 misses the next setpoint.
            world.robots[2].deaf = true;
            world.sequence = world.sequence.wrapping_add(1);
            let frame = protocol::GroupTwist {
                twist: FORWARD,
                sequence: world.sequence,
                group: GROUP,
            };
            world.send(1, cob::GROUP_TWIST, &frame.encode());
            world.robots[2].deaf = false;
            world.twist = None;
        },
        Fault::SequenceMismatch,
        21,
    ),
    (
        |world| {
            // Robot 4 hears another twist with the same sequence.
            let frame = |twist, sequence| GroupTwist {
                twist,
                sequence,
                group: GROUP,
            };
            world.sequence = world.sequence.wrapping_add(1);
            world.passes = |_, to| to != 4;
            world.send(
                1,
                cob::GROUP_TWIST,
                &frame(FORWARD, world.sequence).encode(),
            );
            world.passes = |_, to| to == 4;
            world.send(
                1,
                cob::GROUP_TWIST,
                &frame(Twist::ZERO, world.sequence).encode(),
            );
            world.passes = |_, _| true;
            world.twist = None;
        },
        Fault::PlanMismatch,
        21,
    ),
    (|_| (), Fault::TwoMasters, 61),
    (
        |world| world.twist = Some(Twist::new(f32::NAN, 0.0, 0.0)),
        Fault::SetpointInvalid,
        101,
    ),
    (
        |world| {
            let now = Micros(world.now + world.robots[0].offset);
            world.robots[0].bus.on_bus_off(now);
        },
        Fault::BusOff,
        1,
    ),
    (
        |world| {
            let now = Micros(world.now + world.robots[0].offset);
            world.robots[0].bus.on_fault(now, Fault::ReceiveOverrun);
        },
        Fault::ReceiveOverrun,
        1,
    ),
    (
        |world| world.robots[0].encoder_sign = [0.0, 1.0, 1.0, 1.0],
        Fault::EncoderDead,
        50,
    ),
    (
        |world| world.robots[0].encoder_sign = [-1.0, 1.0, 1.0, 1.0],
        Fault::EncoderInverted,
        60,
    ),
    (
        |world| world.robots[0].drag[0] = true,
        Fault::WheelBlocked,
        300,
    ),
    (
        |world| world.robots[0].inputs.drive_fault = Some(Fault::DriverFault),
        Fault::DriverFault,
        1,
    ),
    (
        |world| world.robots[0].inputs.emergency_stop = true,
        Fault::EmergencyStop,
        1,
    ),
    (
        |world| world.robots[0].inputs.protective_stop = true,
        Fault::ProtectiveStop,
        1,
    ),
    (
        |world| world.robots[0].set_supply(17.0),
        Fault::SupplyLow,
        104,
    ),
    (
        |world| world.robots[0].set_supply(31.0),
        Fault::SupplyHigh,
        12,
    ),
    (
        |world| world.robots[0].inputs.current_inputs = Some([3.3, 0.0, 0.0]),
        Fault::OverCurrent,
        22,
    ),
    (
        |world| {
            world.robots[0].ticking = false;
            world.run(21);
            world.robots[0].ticking = true;
        },
        Fault::ControlLate,
        1,
    ),
    (
        |world| world.robots[0].bus_runs = false,
        Fault::BusStarved,
        26,
    ),
    (
        |world| world.send(9, cob::heartbeat(2), &[5]),
        Fault::DuplicateNode,
        1,
    ),
];

/// A group of three that drives, 1 ms after a SYNC.
pub(super) fn driving() -> World {
    let mut world = World::new(&[2, 3, 4]);
    world.configure();
    world
        .write(2, at::SUPPLY_MINIMUM, Value::F32(18.0))
        .unwrap();
    world
        .write(2, at::SUPPLY_MAXIMUM, Value::F32(30.0))
        .unwrap();
    world.write(2, at::PROTECTIVE_STOP, Value::U8(1)).unwrap();
    for (address, value) in [
        (at::WINDING_RESISTANCE, 0.3),
        (at::CURRENT_MAX, 20.0),
        (at::CURRENT_SCALE, 40.0),
    ] {
        world.write(2, address, Value::F32(value)).unwrap();
    }
    world.robots[0].inputs.current_inputs = Some([0.0; 3]);
    world.robots[0].set_supply(24.0);
    world.start();
    world.run(30);
    world.drive(FORWARD, 1000);
    world.until(20, |world| world.now % 10_000 == 1_000);
    world
}

fn measure((cause, fault, _): &Case) -> u32 {
    let mut world = driving();
    cause(&mut world);
    let before = world.robots[0].control.report().twist_ref().vx;
    for millis in 0..1000 {
        let robot = &world.robots[0];
        let reacted = match fault.reaction() {
            Reaction::Cut => !robot.outputs.drivers_enabled,
            Reaction::Ramp => robot.control.report().twist_ref().vx < before - 1e-6,
        };
        if reacted {
            let seen = robot.bus.state().fault().or(robot.control.report().fault);
            assert_eq!(seen, Some(*fault));
            return millis;
        }
        keep(&mut world, *fault);
        world.step();
    }
    panic!("no reaction to {fault:?}");
}

#[test]
fn every_reaction_is_as_fast_as_promised() {
    let page = include_str!("../../../docs/safety.md");
    for case in CASES {
        let (_, fault, promise) = case;
        let took = measure(case);
        std::println!("{:18} {took:4} ms of {promise:4} ms", fault.name());
        assert!(took <= *promise, "{fault:?} took {took} ms of {promise} ms");
        let row = std::format!("| 0x{:04X} {} |", fault.code(), fault.name());
        let line = page.lines().find(|line| line.contains(&row));
        let line = line.unwrap_or_else(|| panic!("no row for {row} in docs/safety.md"));
        let cells = line.split(['|', ';']).map(str::trim);
        let promised = std::format!("{promise} ms");
        let says = cells.into_iter().any(|cell| cell == promised);
        assert!(says, "{line} does not say {promised}");
    }
}

/// Everything that a cause has changed is well again.
fn clear(world: &mut World, fault: Fault) {
    world.heartbeat = true;
    world.sync = true;
    for robot in &mut world.robots {
        robot.deaf = false;
        robot.mute = false;
        robot.encoder_sign = [1.0; 4];
        robot.drag = [false; 4];
        robot.ticking = true;
        robot.bus_runs = true;
        robot.inputs.emergency_stop = false;
        robot.inputs.drive_fault = None;
        robot.inputs.protective_stop = false;
        robot.inputs.current_inputs = Some([0.0; 3]);
    }
    world.robots[0].set_supply(24.0);
    if fault == Fault::BusOff {
        let now = Micros(world.now + world.robots[0].offset);
        world.robots[0].bus.on_bus_recovered(now);
    }
}

/// ISO 3691-4:2023, 4.1.14: after whatever stop, nothing but an NMT start and then a new sequence
/// moves a robot.
#[test]
fn after_any_stop_only_a_start_and_a_new_sequence_move_it_again() {
    for (cause, fault, _) in CASES {
        let mut world = driving();
        cause(&mut world);
        for _ in 0..1_200 {
            keep(&mut world, *fault);
            world.step();
        }
        let at_rest = |world: &World, when: &str| {
            let robot = &world.robots[0];
            assert_eq!(robot.outputs, Outputs::SAFE, "{fault:?}, {when}");
            assert_eq!(robot.rates, [0.0; 4], "{fault:?}, {when}");
        };
        at_rest(&world, "after the stop");
        // The cause goes away, and the master drives on as if nothing had been.
        clear(&mut world, *fault);
        world.drive(FORWARD, 1_000);
        at_rest(&world, "when the cause is gone");
        // A start, and the sequence from before it.
        world.twist = None;
        world.start();
        let old = GroupTwist {
            twist: FORWARD,
            sequence: world.sequence,
            group: GROUP,
        };
        for _ in 0..300 {
            if world.now.is_multiple_of(10_000) {
                world.send(1, cob::GROUP_TWIST, &old.encode());
            }
            world.step();
            // The loops hold the wheels where they stand: in these 0.3 s none turns by half a
            // count.
            let rates = world.robots[0].rates;
            let still = 0.5 * core::f64::consts::TAU / f64::from(COUNTS) / 0.3;
            let moves = rates.iter().any(|rate| rate.abs() > still);
            assert!(!moves, "{fault:?}, started, old sequence: {rates:?}");
        }
        world.drive(FORWARD, 300);
        let state = world.robots[0].bus.state();
        assert_eq!(state, State::Moving, "{fault:?}, started, new sequence");
    }
}
