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
pub const HALTED_STOP: &str = "processor halted";

/// What is done about a cause.
#[derive(Clone, Copy)]
pub enum Trial {
    /// It appears at a word.
    Now(fn(&mut Rig)),
    /// It takes some time to bring about, and appears when this is done.
    After(fn(&mut Rig) -> Result<(), SimError>),
    /// It is not tried, for this reason.
    NotCovered(&'static str),
}

impl Trial {
    /// Makes the cause appear. It returns at the moment from which time counts.
    pub fn begin(self, rig: &mut Rig) -> Result<(), SimError> {
        match self {
            Self::Now(appear) => appear(rig),
            Self::After(appear) => appear(rig)?,
            Self::NotCovered(_) => {}
        }
        Ok(())
    }
}

/// The causes by their numbers in `docs/safety.md`, each with the way in which it is brought about where that is not
/// all that could be meant.
pub const TRIALS: &[(u8, &str, Trial)] = &[
    (1, "", Trial::Now(|rig| rig.heartbeat = false)),
    (2, "", Trial::Now(|rig| rig.sync = false)),
    (3, "", Trial::Now(|rig| rig.twist = None)),
    (
        4,
        "",
        Trial::Now(|rig| rig.world.set_connected(OTHER, false)),
    ),
    (
        5,
        "",
        Trial::Now(|rig| rig.world.set_emergency_stop(OTHER, true)),
    ),
    (
        6,
        "",
        Trial::Now(|rig| rig.world.set_misses(OTHER, Some(cob::GROUP_TWIST))),
    ),
    (7, "", Trial::Now(|rig| rig.second = true)),
    (
        8,
        "NaN",
        Trial::Now(|rig| rig.twist = Some(Twist::new(f32::NAN, 0.0, 0.0))),
    ),
    (9, "", Trial::After(bus_off)),
    (10, "", Trial::Now(|rig| rig.world.overrun(WATCHED))),
    (
        11,
        "",
        Trial::Now(|rig| rig.world.set_encoder(WATCHED, WHEEL, EncoderState::Dead)),
    ),
    (
        12,
        "",
        Trial::Now(|rig| {
            rig.world
                .set_encoder(WATCHED, WHEEL, EncoderState::Reversed)
        }),
    ),
    (
        13,
        "turns hardly",
        Trial::Now(|rig| rig.world.set_wheel_drag(WATCHED, WHEEL, DRAG)),
    ),
    (
        14,
        "",
        Trial::Now(|rig| rig.world.set_driver_fault(WATCHED, true)),
    ),
    (
        15,
        "",
        Trial::Now(|rig| rig.world.set_emergency_stop(WATCHED, true)),
    ),
    (
        15,
        HALTED_STOP,
        Trial::Now(|rig| {
            rig.world.halt(WATCHED, true);
            rig.world.set_emergency_stop(WATCHED, true);
        }),
    ),
    (
        16,
        "",
        Trial::NotCovered("the reference board does not measure its supply"),
    ),
    (17, "", Trial::After(late)),
    (
        18,
        "",
        Trial::NotCovered("the watchdog resets the robot after 50 ms, before the 100 ms are over"),
    ),
    (
        19,
        "HardFault",
        Trial::Now(|rig| _ = rig.world.crash(WATCHED)),
    ),
    (
        20,
        "halted",
        Trial::Now(|rig| _ = rig.world.halt(WATCHED, true)),
    ),
    (
        21,
        "",
        Trial::NotCovered("not tried in the emulated group yet"),
    ),
    (
        22,
        "",
        Trial::NotCovered("not tried in the emulated group yet"),
    ),
];

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
