//! Groups for trials on the contact plant: rollers of random phase, with and without being told of
//! them, and with the compensation that a calibration on the same plant gives.
//!
//! A robot's configured rollers are those that a calibration would have found, taken from the
//! plant. Compensation coefficients are measured: one longitudinal, one lateral and one turning run
//! on native robots, asked over achieved. The same runs show by how much the group trails its
//! wheels. With the rollers known a second lateral run, half as fast, tells what is lost by their
//! hand-over, which grows with speed, from what is not.

use group::{ContactLag, GroupFile, Plant, Rollers};
use kinematics::VelocityCompensation;

use crate::abort::Abort;
use crate::path::course::Course;
use crate::path::curve::Curve;
use crate::report::Run;
use crate::run::{Drive, DriveError};
use crate::simulation::run::simulated;

/// Speed of [`Curve::Lateral`], m/s.
const LATERAL_SPEED: f32 = 0.5;

/// The group on the contact plant with this many rollers a wheel, each wheel at a phase of its own,
/// told nothing.
#[must_use]
pub fn on_contact(group: &GroupFile, rollers: u8) -> GroupFile {
    let mut out = group.clone();
    out.simulation.plant = Plant::Contact { rollers };
    out.simulation.contact.scattered = true;
    out.hand_over_loss = 0.0;
    for robot in &mut out.robots {
        robot.rollers = None;
        robot.compensation = VelocityCompensation::NONE;
        robot.compensation_table = group::CompensationTable::default();
    }
    out
}

/// The same group with every robot told of its rollers; as it is where the plant has none.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "a robot holds an angle as f32"
)]
pub fn with_phases(group: &GroupFile) -> GroupFile {
    let mut out = group.clone();
    let Plant::Contact { rollers } = group.simulation.plant else {
        return out;
    };
    let phases = sim::index::roller_phases(group).unwrap_or_default();
    for (robot, phases) in out.robots.iter_mut().zip(phases) {
        robot.rollers = Some(Rollers {
            count: rollers,
            phases: phases.map(|phase| phase as f32),
            index_tolerance: None,
            compensation: VelocityCompensation::NONE,
        });
    }
    out
}

/// The same group with the compensation its robots need on its plant, one for all of them.
///
/// # Errors
/// When a run fails, or loses so much that no coefficient can correct it.
pub fn calibrated(group: &GroupFile, abort: &Abort) -> Result<GroupFile, DriveError> {
    let run = |curve, speed| -> Result<Run, DriveError> {
        let drive = Drive {
            group,
            course: Course {
                speed,
                ..Course::of(curve)
            },
            feedback: None,
            compensation: false,
            elf: None,
            candump: None,
            log: None,
            abort: abort.clone(),
            record: None,
            index_search: Some(&|_| {}),
        };
        simulated(&drive, &mut |_, _| {})
    };
    let (ahead, aside, about) = (
        run(Curve::Forward, 1.0)?,
        run(Curve::Lateral, 1.0)?,
        run(Curve::Turn, 1.0)?,
    );
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a robot holds a coefficient as f32"
    )]
    let coefficient = |percent: f64| (1.0 / (1.0 + percent / 100.0)) as f32;
    let mut lateral = coefficient(aside.errors.x_percent);
    let mut out = group.clone();
    if group.robots.iter().any(|robot| robot.rollers.is_some()) {
        let slow = coefficient(run(Curve::Lateral, 0.5)?.errors.x_percent);
        let slower = 0.5 * LATERAL_SPEED;
        out.hand_over_loss = ((lateral - slow) / slower).max(0.0);
        lateral -= out.hand_over_loss * LATERAL_SPEED;
    }
    let compensation = VelocityCompensation::new(
        coefficient(ahead.errors.y_percent),
        lateral,
        coefficient(about.evenness.turn_percent),
    )
    .unwrap_or(VelocityCompensation::NONE);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a group file holds a time as f32"
    )]
    let seconds = |run: &Run| (run.evenness.lag_ms.max(0.0) * 1e-3) as f32;
    out.contact_lag = ContactLag {
        longitudinal: seconds(&ahead),
        lateral: seconds(&aside),
        yaw: seconds(&about),
    };
    for robot in &mut out.robots {
        match &mut robot.rollers {
            Some(rollers) => rollers.compensation = compensation,
            None => robot.compensation = compensation,
        }
    }
    Ok(out)
}
