//! How long each reaction takes, measured, against the promise in `docs/safety.md`.
//!
//! Measured from the moment the cause appears to the tick in which the reference begins to fall (ramp) or
//! the outputs are off (cut), in a group of three that drives at 0.6 m/s. The causes appear at the worst
//! moment of the SYNC period: just after a SYNC.

use canopen::Micros;
use kinematics::Twist;
use protocol::address as at;
use protocol::{Fault, Reaction, Value, cob};

use super::world::{GROUP, World};

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

/// Cause, the fault robot 2 must show, and the promise in ms.
type Case = (fn(&mut World), Fault, u32);

/// What keeps happening while the cause lasts, called once a millisecond.
fn keep(world: &mut World, fault: Fault) {
    if fault == Fault::TwoMasters && world.now % 10_000 == 5_000 {
        let frame = protocol::GroupTwist {
            twist: FORWARD,
            sequence: world.sequence.wrapping_add(100),
            group: GROUP,
        };
        world.send(1, cob::GROUP_TWIST, &frame.encode());
    }
}

const CASES: &[Case] = &[
    (|world| world.heartbeat = false, Fault::MasterSilent, 501),
    (|world| world.sync = false, Fault::SyncLost, 51),
    (|world| world.twist = None, Fault::SetpointOverdue, 101),
    (|world| world.robots[2].mute = true, Fault::MemberSilent, 21),
    (
        |world| world.robots[2].inputs.emergency_stop = true,
        Fault::MemberStopped,
        21,
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
        300,
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
        |world| world.robots[0].inputs.driver_fault = true,
        Fault::DriverFault,
        1,
    ),
    (
        |world| world.robots[0].inputs.emergency_stop = true,
        Fault::EmergencyStop,
        1,
    ),
    (
        |world| world.robots[0].inputs.supply = Some(17.0),
        Fault::SupplyLow,
        101,
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
        101,
    ),
];

fn measure((cause, fault, _): &Case) -> u32 {
    let mut world = World::new(&[2, 3, 4]);
    world.configure();
    world
        .write(2, at::SUPPLY_MINIMUM, Value::F32(18.0))
        .unwrap();
    world.robots[0].inputs.supply = Some(24.0);
    world.start();
    world.run(30);
    world.drive(FORWARD, 1000);
    world.until(20, |world| world.now % 10_000 == 1_000);
    cause(&mut world);
    let before = world.robots[0].control.report().reference.vx;
    for millis in 0..1000 {
        let robot = &world.robots[0];
        let reacted = match fault.reaction() {
            Reaction::Cut => !robot.outputs.drivers_enabled,
            Reaction::Ramp => robot.control.report().reference.vx < before - 1e-6,
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
        let promised = std::format!("| {promise} ms |");
        assert!(line.contains(&promised), "{line} does not say {promise} ms");
    }
}
