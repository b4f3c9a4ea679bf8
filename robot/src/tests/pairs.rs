//! Two causes, one shortly after the other: one often brings the other. A bridge that is shorted
//! pulls the supply down *and* reports a fault; a blocked wheel trips the driver's current limit.
//!
//! A cause that cuts has to cut within its own promise, whatever else is latched, and has to be
//! named.

use control::time::Micros;
use protocol::{Fault, Reaction};

use super::reaction::{CASES, Case, driving, keep};
use super::world::World;
use crate::state::State;
use control::interface::Outputs;

/// When the second cause appears, ms after the first.
const DELAYS: [u32; 3] = [0, 20, 200];

/// What cuts, on a wheel that no other cause touches, with its promise in ms.
const CUTS: &[Case] = &[
    (
        |world| world.robots[0].encoder_sign[3] = -1.0,
        Fault::EncoderInverted,
        60,
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
];

/// Runs on while the first cause lasts.
fn run(world: &mut World, first: Fault, millis: u32) {
    for _ in 0..millis {
        keep(world, first);
        world.step();
    }
}

#[test]
fn a_cause_that_cuts_does_so_whatever_is_latched_already() {
    for (first, latched, _) in CASES {
        for (second, cut, promise) in CUTS {
            for delay in DELAYS {
                let pair = std::format!("{latched:?}, {delay} ms later {cut:?}");
                let mut world = driving();
                first(&mut world);
                run(&mut world, *latched, delay);
                // A wheel that is cut already cannot turn against its drive.
                let driven = world.robots[0].outputs.drivers_enabled;
                second(&mut world);
                run(&mut world, *latched, *promise);
                assert_eq!(world.robots[0].outputs, Outputs::SAFE, "{pair}");
                run(&mut world, *latched, 10);
                if !driven || latched.reaction() == Reaction::Cut {
                    continue;
                }
                let robot = &world.robots[0];
                assert_eq!(robot.control.report().fault, Some(*cut), "{pair}");
                if !robot.bus_runs {
                    continue;
                }
                assert_eq!(robot.bus.state(), State::Faulted(*cut), "{pair}");
                if *latched == Fault::BusOff {
                    // It has to be back on the bus to tell.
                    let now = Micros(world.now + world.robots[0].offset);
                    world.robots[0].bus.on_bus_recovered(now);
                    world.run(10);
                }
                assert!(world.emergencies(2).contains(&cut.code()), "{pair}");
                let newest = world.read(2, protocol::address::history::code(1));
                assert_eq!(newest, Ok(u32::from(cut.code())), "{pair}");
            }
        }
    }
}

#[test]
fn two_causes_that_ramp_end_at_rest() {
    let ramps = |case: &&Case| case.1.reaction() == Reaction::Ramp;
    for (first, latched, _) in CASES.iter().filter(ramps) {
        for (second, other, _) in CASES.iter().filter(ramps) {
            for delay in DELAYS {
                let pair = std::format!("{latched:?}, {delay} ms later {other:?}");
                let mut world = driving();
                first(&mut world);
                run(&mut world, *latched, delay);
                second(&mut world);
                for _ in 0..1_500 {
                    keep(&mut world, *latched);
                    if other != latched {
                        keep(&mut world, *other);
                    }
                    world.step();
                }
                let robot = &world.robots[0];
                assert_eq!(robot.outputs, Outputs::SAFE, "{pair}");
                assert_eq!(robot.rates, [0.0; 4], "{pair}");
                // Together they may look like a third cause: two masters without one's setpoints
                // are stale setpoints.
                let seen = robot.bus.state().fault().or(robot.control.report().fault);
                assert!(seen.is_some(), "{pair}");
            }
        }
    }
}
