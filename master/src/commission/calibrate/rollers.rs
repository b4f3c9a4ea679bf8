//! The roller phases of every robot of a group: the motions, and the fit of each robot.

use group::GroupFile;
use kinematics::{FourWheelGeometry, Rollers, VelocityCompensation};
use roller_phase::Phases;

use super::CalibrateError;
use super::journal::Journal;
use super::manoeuvre::Settings;
use super::recorded_motions::{self, LASTS, Source};
use crate::bus::link::Link;
use crate::session::Group;

/// What was found of one robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotPhases {
    /// Its node.
    pub node: u8,
    /// Rollers of each of its wheels.
    pub count: u8,
    /// Its phases.
    pub found: Phases,
}

/// The group with rollers at phase 0 and no compensation: wheels have to be followed without either
/// while the phases are looked for. `count` is for robots whose file does not say.
///
/// # Errors
/// When bolted robots hide each other's ripple.
pub fn without_phases(file: &GroupFile, count: u8) -> Result<GroupFile, CalibrateError> {
    if is_bolted(file) {
        return Err(CalibrateError::Bolted(file.name.clone()));
    }
    let mut out = file.clone();
    for robot in &mut out.robots {
        let known = robot.rollers;
        robot.rollers = Some(group::Rollers {
            count: known.map_or(count, |rollers| rollers.count),
            phases: [0.0; 4],
            index_tolerance: known.and_then(|rollers| rollers.index_tolerance),
            compensation: VelocityCompensation::NONE,
        });
    }
    Ok(out)
}

/// Whether robots are bolted to one load, which hides the ripple of each behind the others'.
#[must_use]
pub fn is_bolted(file: &GroupFile) -> bool {
    file.simulation.rigid && file.robots.len() > 1
}

/// Finds the phases of a connected group and has it go by them from now on, rounded as its file
/// will have them.
///
/// # Errors
/// As [`find`], and when its robots are bolted together.
pub fn learn<L: Link>(
    group: &mut Group<L>,
    settings: &Settings,
    source: &mut Source<'_, L>,
    journal: &mut Journal<'_>,
) -> Result<Vec<RobotPhases>, CalibrateError> {
    group.set_config(without_phases(group.config(), settings.rollers)?);
    let phases = find(group, settings.repeats, source, journal)?;
    group.set_config(with_phases(group.config(), &phases)?);
    Ok(phases)
}

/// Finds the phases of a connected group whose file is [`without_phases`].
///
/// # Errors
/// When driving or measuring fails, and when the data do not determine the phases.
pub fn find<L: Link>(
    group: &mut Group<L>,
    repeats: u32,
    source: &mut Source<'_, L>,
    journal: &mut Journal<'_>,
) -> Result<Vec<RobotPhases>, CalibrateError> {
    let file = group.config().clone();
    let geometries: Vec<_> = file
        .robots
        .iter()
        .map(|robot| {
            let g = robot.geometry;
            FourWheelGeometry::new(
                f64::from(g.half_track()),
                f64::from(g.half_wheelbase()),
                f64::from(g.wheel_radius()),
                f64::from(g.roller_angle()),
            )
            .map_err(|error| CalibrateError::Unusable(error.to_string()))
        })
        .collect::<Result<_, _>>()?;
    let twists = geometries.first().map_or_else(Vec::new, |first| {
        recorded_motions::motions(first, &file.limits, repeats)
    });
    group.configure(false)?;
    source.waits(group)?;
    group.find_rollers(&mut |search| journal.announce(search))?;
    journal.ahead(twists.iter().map(|_| LASTS));
    let motions = recorded_motions::record(group, &twists, source, journal)?;
    let mut out = Vec::new();
    for ((robot, geometry), motions) in file.robots.iter().zip(&geometries).zip(&motions) {
        let node = robot.node;
        let count = robot.rollers.map_or(0, |rollers| rollers.count);
        let rollers = Rollers::new(u16::from(count))
            .map_err(|error| CalibrateError::Unusable(error.to_string()))?;
        let found = roller_phase::estimate(geometry, rollers, motions)
            .map_err(|reason| CalibrateError::Phases { node, reason })?;
        out.push(RobotPhases { node, count, found });
    }
    Ok(out)
}

/// The group with these phases, as its file will have them.
///
/// # Errors
/// When a number of the group cannot be rounded for its file.
pub fn with_phases(file: &GroupFile, found: &[RobotPhases]) -> Result<GroupFile, CalibrateError> {
    let mut out = file.clone();
    for (robot, found) in out.robots.iter_mut().zip(found) {
        if let Some(rollers) = &mut robot.rollers {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a robot holds an angle as f32"
            )]
            let phases = found.found.phases.map(|phase| phase as f32);
            rollers.phases = phases;
        }
    }
    super::group_file::rounded(out)
}
