//! How each cause is brought about, or why it is not.
//!
//! A cause happens at or around the robot, never inside its program, which is the image that ships. Robots by their
//! place: number 0 is watched; where a cause lies with another member, that is number 2.

use kinematics::Twist;
use protocol::cob;
use sim::rig::Rig;
use sim::{EncoderState, SimError};

/// The robot that is watched.
pub const WATCHED: usize = 0;
/// The member that lets the others down.
const OTHER: usize = 2;
/// The wheel that fails.
const WHEEL: usize = 0;

/// What drags at a blocked wheel, N·m: half of the motor's torque at rest. One that is held fast cannot be told
/// from a dead encoder.
const DRAG: f64 = 32.0;

/// How the emergency stop is tried without a processor: the timer's break input has to cut alone.
pub const HALTED_STOP: &str = "processor halted: break input alone";

/// Makes a cause appear. It returns at the moment from which time counts.
pub type Begin = fn(&mut Rig) -> Result<(), SimError>;

/// What is done about a cause.
pub enum Trial {
    /// It is brought about, in one way or several; the words tell them apart.
    Tried(&'static [(&'static str, Begin)]),
    /// It is not, for this reason.
    NotCovered(&'static str),
}

/// The causes by their numbers in `docs/safety.md`.
pub const TRIALS: &[(u8, Trial)] = &[
    (1, Trial::Tried(&[("", |rig| done(rig.heartbeat = false))])),
    (2, Trial::Tried(&[("", |rig| done(rig.sync = false))])),
    (3, Trial::Tried(&[("", |rig| done(rig.twist = None))])),
    (
        4,
        Trial::Tried(&[("", |rig| done(rig.world.set_connected(OTHER, false)))]),
    ),
    (
        5,
        Trial::Tried(&[("", |rig| done(rig.world.set_emergency_stop(OTHER, true)))]),
    ),
    (
        6,
        Trial::Tried(&[("", |rig| {
            done(rig.world.set_misses(OTHER, Some(cob::GROUP_TWIST)))
        })]),
    ),
    (7, Trial::Tried(&[("", |rig| done(rig.second = true))])),
    (
        8,
        Trial::Tried(&[("not a number", |rig| {
            done(rig.twist = Some(Twist::new(f32::NAN, 0.0, 0.0)))
        })]),
    ),
    (9, Trial::Tried(&[("", bus_off)])),
    (
        10,
        Trial::Tried(&[("", |rig| done(rig.world.overrun(WATCHED)))]),
    ),
    (
        11,
        Trial::Tried(&[("", |rig| {
            done(rig.world.set_encoder(WATCHED, WHEEL, EncoderState::Dead))
        })]),
    ),
    (
        12,
        Trial::Tried(&[("", |rig| {
            done(
                rig.world
                    .set_encoder(WATCHED, WHEEL, EncoderState::Reversed),
            )
        })]),
    ),
    (
        13,
        Trial::Tried(&[("turns hardly", |rig| {
            done(rig.world.set_wheel_drag(WATCHED, WHEEL, DRAG))
        })]),
    ),
    (
        14,
        Trial::Tried(&[("", |rig| done(rig.world.set_driver_fault(WATCHED, true)))]),
    ),
    (
        15,
        Trial::Tried(&[
            ("", |rig| done(rig.world.set_emergency_stop(WATCHED, true))),
            (HALTED_STOP, |rig| {
                rig.world.halt(WATCHED, true);
                done(rig.world.set_emergency_stop(WATCHED, true))
            }),
        ]),
    ),
    (
        16,
        Trial::NotCovered("the reference board does not measure its supply"),
    ),
    (17, Trial::Tried(&[("", late)])),
    (
        18,
        Trial::NotCovered(
            "the watchdog resets after 50 ms, before the 100 ms are over; nothing outside starves thread mode alone",
        ),
    ),
    (
        19,
        Trial::Tried(&[("", |rig| {
            rig.world.crash(WATCHED);
            Ok(())
        })]),
    ),
    (
        20,
        Trial::Tried(&[("processor halted", |rig| {
            rig.world.halt(WATCHED, true);
            Ok(())
        })]),
    ),
    (21, Trial::NotCovered("parameters are not stored yet")),
    (22, Trial::NotCovered("parameters are not stored yet")),
];

fn done((): ()) -> Result<(), SimError> {
    Ok(())
}

/// A robot goes off the bus with its next frame.
fn bus_off(rig: &mut Rig) -> Result<(), SimError> {
    while !rig.world.force_bus_off(WATCHED) {
        let soon = canopen::Micros(rig.world.now().0 + 10);
        rig.world.run_until(soon)?;
    }
    Ok(())
}

/// The processor stands still a little longer than a control tick may be late; the time counts from its going on.
fn late(rig: &mut Rig) -> Result<(), SimError> {
    const STANDS_MS: u64 = 22;
    rig.world.halt(WATCHED, true);
    rig.run(STANDS_MS)?;
    rig.world.halt(WATCHED, false);
    Ok(())
}
