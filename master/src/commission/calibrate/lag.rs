//! The lag of the contacts: by how much time the group trails the motion of its wheels, because its
//! contacts creep.
//!
//! The group drives straight ahead, sideways and turns, each there and back, with its slip already
//! compensated, and its pose is measured at every SYNC. The lag of an axis is the time by which the
//! measured motion trails the commanded one, fitted independently of gain and start
//! ([`crate::monitor::metrics`]).
//!
//! A source of poses that is late adds its delay to all three lags. Geometry separates the two:
//! creeping contacts make turns trail by a known share of the lag of translation
//! ([`turning_share`]), so the lag of turns beyond that share is the source's. If the load reaches
//! further out than its wheels, a part of the contacts' lag is attributed to the source.

use std::f64::consts::{PI, TAU};

use group::{ContactLag, GroupFile};
use kinematics::Pose;

use super::journal::Journal;
use super::manoeuvre::{Manoeuvre, Settings, Way, straight, turns};
use super::measure::{Body, Instrument, Poses};
use super::{CalibrateError, attempt};
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::monitor::metrics::{PathPoint, evenness};
use crate::session::Group;

/// Longest lag that a group file takes, s.
const LONGEST: f64 = 0.1;

/// The motions that show it.
pub fn motions(file: &GroupFile, settings: &Settings) -> Vec<Manoeuvre> {
    let fastest = |all: &[f64]| all.last().copied().into_iter().collect();
    let few = Settings {
        speeds: fastest(&settings.speeds),
        rates: fastest(&settings.rates),
        repeats: 1,
        ..settings.clone()
    };
    let mut out = straight(file, &few);
    out.retain(|motion| motion.way != Way::Oblique);
    out.extend(turns(file, &few));
    out
}

/// Drives the motions and works out the lag; nothing where a tape measures.
pub fn find<L: Link>(
    group: &mut Group<L>,
    bodies: &[Body],
    motions: &[Manoeuvre],
    instrument: &mut Instrument<'_, L>,
    journal: &mut Journal<'_>,
) -> Result<Option<ContactLag>, CalibrateError> {
    let Instrument::Poses(poses) = instrument else {
        return Ok(None);
    };
    let heading = bodies.first().map_or(0.0, Body::heading);
    // The file's axes are the group's, the motions go along the robots'.
    let across = usize::from(heading.sin().abs() > heading.cos().abs());
    let mut found: [Vec<f64>; 3] = Default::default();
    let mut started = false;
    let all = motions.iter().try_for_each(|motion| {
        let name = format!(
            "lag {} at {} {}",
            motion.way.name(),
            motion.speed,
            motion.way.unit()
        );
        let lags: Option<Vec<f64>> = journal.motion(&name, &mut || {
            attempt(group, &mut started, |group, _| {
                observe(group, bodies, motion, poses)
            })
        })?;
        let axis = match motion.way {
            Way::Ahead => across,
            Way::Aside | Way::Oblique => 1 - across,
            Way::Turn => 2,
        };
        found[axis].extend(lags.unwrap_or_default());
        Ok::<_, CalibrateError>(())
    });
    if started {
        group.stop()?;
    }
    all?;
    #[expect(clippy::cast_possible_truncation, reason = "a group file holds f32")]
    let mean = |lags: &[f64]| {
        let sum: f64 = lags.iter().sum();
        (sum / lags.len().max(1) as f64).clamp(0.0, LONGEST) as f32
    };
    let [longitudinal, lateral, yaw] = found.each_ref().map(|lags| mean(lags));
    let share = turning_share(group.config());
    let [longitudinal, lateral, yaw] = without_delay([longitudinal, lateral, yaw], share);
    Ok(Some(ContactLag {
        longitudinal,
        lateral,
        yaw,
    }))
}

/// The lag of turning over that of translation, for masses spread evenly over the robots' wheels:
/// inertia over mass, over the squared lever at which the contacts hold. Bolted robots turn about
/// their middle, others each about its own.
#[expect(clippy::cast_possible_truncation, reason = "a group file holds f32")]
fn turning_share(file: &GroupFile) -> f32 {
    let count = file.robots.len().max(1) as f64;
    let place = |robot: &group::Robot| [robot.mount.x, robot.mount.y].map(f64::from);
    let centre = file.robots.iter().map(place).fold([0.0; 2], |sum, at| {
        [sum[0] + at[0] / count, sum[1] + at[1] / count]
    });
    let (mut inertia, mut hold) = (0.0, 0.0);
    for robot in &file.robots {
        let g = robot.geometry;
        let [w, h] = [g.half_track(), g.half_wheelbase()].map(f64::from);
        let (sin, cos) = f64::from(g.roller_angle()).sin_cos();
        let [x, y] = place(robot);
        let away = if file.simulation.rigid {
            (x - centre[0]).powi(2) + (y - centre[1]).powi(2)
        } else {
            0.0
        };
        inertia += (w * w + h * h) / 3.0 + away;
        hold += 2.0 * (w * sin + h * cos).powi(2) + away;
    }
    if hold > 0.0 {
        (inertia / hold) as f32
    } else {
        0.0
    }
}

/// The lags, longitudinal, lateral and of turning, without a delay that all three have.
fn without_delay(lags: [f32; 3], share: f32) -> [f32; 3] {
    let [longitudinal, lateral, yaw] = lags;
    let delay = (yaw - share * 0.5 * (longitudinal + lateral)) / (1.0 - share);
    lags.map(|lag| (lag - delay.max(0.0)).max(0.0))
}

/// One motion: the lag of every subject, s.
fn observe<L: Link>(
    group: &mut Group<L>,
    bodies: &[Body],
    motion: &Manoeuvre,
    poses: Poses<'_, L>,
) -> Result<Vec<f64>, MasterError> {
    let heading = bodies.first().map_or(0.0, Body::heading);
    let plan = motion.plan(heading);
    let mut paths: Vec<Vec<PathPoint>> = vec![Vec::new(); bodies.len()];
    let mut first: Vec<[f64; 3]> = Vec::new();
    let mut failed = None;
    group.drive(&plan, None, &mut |link, instant| match poses(link) {
        Err(error) => failed = Some(error),
        Ok(seen) => {
            if first.is_empty() {
                first.clone_from(&seen);
            }
            for (path, (from, to)) in paths.iter_mut().zip(first.iter().zip(seen)) {
                path.push(PathPoint {
                    t: instant.t,
                    theory: instant.pose,
                    actual: moved(*from, to, heading, instant.pose.heading),
                });
            }
        }
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    // A subject that was never seen to move has no lag; the checks say so.
    let lags = paths
        .iter()
        .map(|path| evenness(path).map_or(0.0, |e| e.lag_ms * 1e-3));
    Ok(lags.collect())
}

/// The way from one pose to another, in the frame of a group in which the body faces `heading`;
/// `turned` is about how far it has turned.
fn moved(from: [f64; 3], to: [f64; 3], heading: f64, turned: f32) -> Pose {
    let (sin, cos) = (heading - from[2]).sin_cos();
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let turned = f64::from(turned);
    let turn = turned + (to[2] - from[2] - turned + PI).rem_euclid(TAU) - PI;
    #[expect(clippy::cast_possible_truncation, reason = "metrics go by f32")]
    let [x, y, turn] = [cos * dx - sin * dy, sin * dx + cos * dy, turn].map(|v| v as f32);
    Pose::new(x, y, turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str) -> GroupFile {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/");
        GroupFile::load(format!("{folder}{name}.toml")).unwrap()
    }

    /// By hand: wheels at (0.35, 0.37) m; `docs/kinematics.md` has 1.55 of 9.32 ms for one robot.
    /// Two of them 1.2 m apart, side by side, and bolted together.
    #[test]
    fn turning_trails_by_a_share_that_geometry_gives() {
        let squares = (0.35_f32.powi(2) + 0.37_f32.powi(2)) / 3.0;
        let lever = 0.72_f32.powi(2);
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} {b}");
        near(turning_share(&file("single")), squares / lever);
        let bolted = (squares + 0.36) / (lever + 0.36);
        near(turning_share(&file("scc-2")), bolted);
        let mut apart = file("scc-2");
        apart.simulation.rigid = false;
        near(turning_share(&apart), squares / lever);
    }

    /// Contacts that trail by 9 ms, seen 8 ms late; a perfect floor seen so; and no delay.
    #[test]
    fn a_late_source_is_not_taken_for_contacts() {
        let share = 0.2;
        let near = |found: [f32; 3], expected: [f32; 3]| {
            for (a, b) in found.into_iter().zip(expected) {
                assert!((a - b).abs() < 1e-6, "{found:?} {expected:?}");
            }
        };
        let contacts = [9e-3, 9e-3, share * 9e-3];
        near(
            without_delay(contacts.map(|lag| lag + 8e-3), share),
            contacts,
        );
        near(without_delay([8e-3; 3], share), [0.0; 3]);
        near(without_delay(contacts, share), contacts);
        // Less than the share of turning: a load near the middle, and no delay.
        near(without_delay([9e-3, 9e-3, 0.0], share), [9e-3, 9e-3, 0.0]);
    }
}
