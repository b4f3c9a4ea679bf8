//! Groups for trials on the contact plant: rollers of random phase, with and without being told of them, and with the
//! compensation that a calibration on the same plant gives.
//!
//! What a robot is told of its rollers is what a calibration would have found, taken from the plant. Compensation
//! coefficients are measured: one longitudinal, one lateral and one turning run on native robots, asked over achieved.
//! The same runs show by how much the group trails its wheels.

use group::{ContactLag, GroupFile, Plant, Rollers};
use kinematics::VelocityCompensation;

use crate::abort::Abort;
use crate::course::Course;
use crate::curve::Curve;
use crate::drive::{Drive, DriveError, simulated};
use crate::report::Run;

/// The group on the contact plant with this many rollers a wheel, each wheel at a phase of its own, told nothing.
#[must_use]
pub fn on_contact(group: &GroupFile, rollers: u8) -> GroupFile {
    let mut out = group.clone();
    out.simulation.plant = Plant::Contact { rollers };
    out.simulation.contact.scattered = true;
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
/// When a run fails, or loses so much that no coefficient can mend it.
pub fn calibrated(group: &GroupFile, abort: &Abort) -> Result<GroupFile, DriveError> {
    let run = |curve| -> Result<Run, DriveError> {
        let drive = Drive {
            group,
            course: Course::of(curve),
            feedback: None,
            compensation: false,
            elf: None,
            candump: None,
            log: None,
            abort: abort.clone(),
            record: None,
        };
        simulated(&drive, &mut |_, _| {})
    };
    let (ahead, aside, about) = (
        run(Curve::Forward)?,
        run(Curve::Lateral)?,
        run(Curve::Turn)?,
    );
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a robot holds a coefficient as f32"
    )]
    let coefficient = |percent: f64| (1.0 / (1.0 + percent / 100.0)) as f32;
    let compensation = VelocityCompensation::new(
        coefficient(ahead.errors.y_percent),
        coefficient(aside.errors.x_percent),
        coefficient(about.evenness.turn_percent),
    )
    .unwrap_or(VelocityCompensation::NONE);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a group file holds a time as f32"
    )]
    let seconds = |run: &Run| (run.evenness.lag_ms.max(0.0) * 1e-3) as f32;
    let mut out = group.clone();
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
