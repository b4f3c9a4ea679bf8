//! The slow motions that show the roller phases, and the samples recorded in them.
//!
//! [`motions`] combine sideways motion with a little forward motion and turn, so that the four
//! wheels turn at four rates and each ripples at its own frequency. A gyro measures one axis only
//! and needs this to separate the wheels; poses would need less. The motions go there and back, and
//! again with slow and fast wheels exchanged. Every second repetition turns the other way, so in
//! two of them each wheel turns at each of the four rates once. The errors of the robot's model
//! depend on the rates, so repeating the same motion would repeat its error.
//!
//! Wheel angles are read from the robots at rest before and after a motion; between, their measured
//! wheel rates are summed up and fitted to these. The caller provides the samples at every SYNC,
//! except for gyros on the robots' boards, whose turn is in the heading that the robots report.

use std::f64::consts::TAU;

use kinematics::{FourWheelGeometry, Twist};
use protocol::{GyroState, Kind, address};
use roller_phase::{Motion, Samples};

use super::journal::Journal;
use super::{CalibrateError, attempt};
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::session::Group;
use crate::source::gyro::RateSample;

/// How long the group waits at rest before and after each motion, s.
const REST: f64 = 0.3;
/// How long gyros on boards may take at rest for their bias, s: they need a second of it, and their
/// first begins late after power-on.
const BIAS: u32 = 3;
/// How long each motion lasts, s.
pub const SECONDS: f64 = 10.0;
/// Speed of the slowest wheel's rim, m/s: slow enough that slip and loop lag are small, and the
/// fastest wheel's ripple is no more than some hertz.
const RIM: f64 = 0.12;
/// How long one of them takes with the rest before and after, s.
pub(super) const LASTS: f64 = SECONDS + 2.0 * REST;
/// Shares of that speed which go forward, sideways and into the turn: the rims of front left, front
/// right, rear left and rear right get -1.9, 2.3, 1.4 and -1.0 of it, and with the signs of forward
/// and turn changed each of the others in turn. As much forward as turn here and the other way
/// round would have the same rates; in a multi-body simulation phases were off by half as much
/// again then.
const SHARES: [f64; 3] = [0.2, 1.65, 0.45];
/// Signs of forward and turn: two pairs of motions, one a repetition.
const SIGNS: [[[f64; 2]; 2]; 2] = [[[1.0, 1.0], [-1.0, -1.0]], [[1.0, -1.0], [-1.0, 1.0]]];

/// Poses of the robots in the order of the group file, now: m, m, rad, heading unwrapped.
pub type Poses<'a, L> = &'a mut dyn FnMut(&mut L) -> Result<Vec<[f64; 3]>, MasterError>;
/// Yaw rates of the robots in the order of the group file: those that have come since the last
/// call.
pub type YawRates<'a, L> = &'a mut dyn FnMut(&mut L) -> Result<Vec<Vec<RateSample>>, MasterError>;

/// Who sees the robots.
pub enum Source<'a, L> {
    /// An observer outside.
    Poses(Poses<'a, L>),
    /// A gyro on every robot.
    Gyro(YawRates<'a, L>),
    /// The gyro on every robot's board.
    Board,
}

impl<L: Link> Source<'_, L> {
    /// Refuses gyros on boards that are not there or have failed; the first robot whose gyro waits
    /// for rest.
    ///
    /// # Errors
    /// [`MasterError::BoardGyro`], and when a robot does not answer.
    pub(super) fn waits(&self, group: &mut Group<L>) -> Result<Option<u8>, MasterError> {
        let mut waits = None;
        if !matches!(self, Self::Board) {
            return Ok(waits);
        }
        let nodes: Vec<u8> = group.config().robots.iter().map(|r| r.node).collect();
        for node in nodes {
            let state = group.wire().read(node, address::GYRO_STATE, Kind::U8)?;
            let [number, ..] = state.to_bits().to_le_bytes();
            match GyroState::from_number(number).unwrap_or_default() {
                GyroState::InUse => {}
                GyroState::Starting => waits = waits.or(Some(node)),
                state => return Err(MasterError::BoardGyro { node, state }),
            }
        }
        Ok(waits)
    }

    /// Has a started group stand until the bias of every gyro on a board is known.
    fn rest(&self, group: &mut Group<L>) -> Result<(), MasterError> {
        let second = 1_000_000_u64.div_ceil(group.period_us());
        for _ in 0..BIAS {
            if self.waits(group)?.is_none() {
                return Ok(());
            }
            for _ in 0..second {
                group.cycle(Twist::ZERO)?;
            }
        }
        self.is_used(group)
    }

    /// Refuses a gyro on a board that is not used.
    fn is_used(&self, group: &mut Group<L>) -> Result<(), MasterError> {
        self.waits(group)?.map_or(Ok(()), |node| {
            let state = GyroState::Starting;
            Err(MasterError::BoardGyro { node, state })
        })
    }
}

/// The motions for robots like this one within the limits of their group, each given number of
/// times there and back.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "setpoints are f32")]
pub fn motions(
    geometry: &FourWheelGeometry<f64>,
    limits: &group::Limits,
    repeats: u32,
) -> Vec<Twist> {
    let lean = 1.0 / geometry.roller_angle().tan();
    let lever = geometry.half_track() + geometry.half_wheelbase() * lean;
    let [ahead, aside, turn] = SHARES;
    let (aside, turn) = (aside / lean, turn / lever);
    let rim = RIM
        .min(f64::from(limits.linear_speed) / ahead.hypot(aside))
        .min(f64::from(limits.yaw_rate) / turn);
    let there_and_back = |[forward, round]: &[f64; 2]| {
        let [x, y, w] = [forward * ahead, aside, round * turn].map(|v| (v * rim) as f32);
        [Twist::new(x, y, w), Twist::new(-x, -y, -w)]
    };
    let signs = SIGNS.iter().cycle().take(repeats as usize).flatten();
    signs.flat_map(there_and_back).collect()
}

/// Drives a group through motions and records every robot: one list of motions a robot. The group
/// is stopped afterwards, whatever happened.
///
/// # Errors
/// When driving fails, or the source does.
pub fn record<L: Link>(
    group: &mut Group<L>,
    twists: &[Twist],
    source: &mut Source<'_, L>,
    journal: &mut Journal<'_>,
) -> Result<Vec<Vec<Motion>>, CalibrateError> {
    let mut out = vec![Vec::new(); group.config().robots.len()];
    let mut started = false;
    let driven = twists.iter().try_for_each(|twist| {
        let motion = journal.motion("roller phases", &mut || {
            attempt(group, &mut started, |group, first| {
                if first {
                    source.rest(group)?;
                }
                record_one(group, *twist, source)
            })
        })?;
        for (all, motion) in out.iter_mut().zip(motion.unwrap_or_default()) {
            all.push(motion);
        }
        Ok(())
    });
    if started {
        group.stop()?;
    }
    driven.map(|()| out)
}

fn record_one<L: Link>(
    group: &mut Group<L>,
    twist: Twist,
    source: &mut Source<'_, L>,
) -> Result<Vec<Motion>, MasterError> {
    let period = group.period_us() as f64 * 1e-6;
    let robots = &group.config().robots;
    let nodes: Vec<u8> = robots.iter().map(|robot| robot.node).collect();
    let rollers = robots.iter().map(|robot| robot.rollers.map(|r| r.count));
    let pitches: Vec<f64> = rollers
        .map(|count| TAU / f64::from(count.unwrap_or(8)))
        .collect();
    let before = angles(group, &nodes)?;
    let mut poses = vec![Vec::new(); nodes.len()];
    let mut rates = vec![Vec::new(); nodes.len()];
    if let Source::Gyro(gyro) = source {
        // What came while the group stood is nothing of this motion.
        gyro(group.link())?;
    }
    let first_row = group.recorder().rows().len();
    let cycles = |seconds: f64| (seconds / period).ceil() as u32;
    let (rest, moving) = (cycles(REST), cycles(SECONDS));
    for k in 0..rest + moving + rest {
        let moves = (rest..rest + moving).contains(&k);
        group.cycle(if moves { twist } else { Twist::ZERO })?;
        let now = group.wire().now().0 as f64 * 1e-6;
        match source {
            Source::Poses(source) => {
                for (all, pose) in poses.iter_mut().zip(source(group.link())?) {
                    all.push((now, pose));
                }
            }
            Source::Gyro(source) => {
                for (all, come) in rates.iter_mut().zip(source(group.link())?) {
                    all.extend(come);
                }
            }
            Source::Board => {}
        }
    }
    let began = group.rows_began().0 as f64 * 1e-6;
    // The row of the last SYNC is being filled still.
    let rows = &group.recorder().rows()[first_row..];
    let rows = rows.split_last().map_or(rows, |(_, complete)| complete);
    let tracks: Vec<_> = (0..nodes.len())
        .map(|robot| {
            let measured = rows.iter().map(|row| {
                let rates = row.members[robot].wheel_rates;
                (began + row.t, rates.map(<[f32; 4]>::from))
            });
            let poses = rows.iter().filter_map(|row| {
                let heading = row.members[robot].pose?.heading;
                Some((began + row.t, f64::from(heading)))
            });
            (sum_up(before[robot], measured), turns(poses))
        })
        .collect();
    let after = angles(group, &nodes)?;
    source.is_used(group)?;
    let robots = tracks.into_iter().enumerate();
    Ok(robots
        .map(|(robot, ((times, mut angles), turns))| {
            fit(&mut angles, &after[robot], pitches[robot]);
            let seen = match source {
                Source::Poses(_) => Samples::Poses(std::mem::take(&mut poses[robot])),
                Source::Gyro(_) => Samples::YawRates(aligned(&rates[robot])),
                Source::Board => Samples::YawRates(turns),
            };
            Motion {
                times,
                angles,
                seen,
            }
        })
        .collect())
}

/// Wheel angles from the rates at every SYNC; a rate that did not come is the one before.
fn sum_up(
    start: [f64; 4],
    measured: impl Iterator<Item = (f64, Option<[f32; 4]>)>,
) -> (Vec<f64>, Vec<[f64; 4]>) {
    let (mut times, mut angles) = (Vec::<f64>::new(), Vec::<[f64; 4]>::new());
    let mut before = [0.0; 4];
    for (t, rates) in measured {
        let rates = rates.map_or(before, |rates| rates.map(f64::from));
        let angle = match (times.last(), angles.last()) {
            (Some(last), Some(angle)) => {
                std::array::from_fn(|n| angle[n] + 0.5 * (before[n] + rates[n]) * (t - last))
            }
            _ => start,
        };
        times.push(t);
        angles.push(angle);
        before = rates;
    }
    (times, angles)
}

/// A gyro's samples on the clock of the link: its own times, moved by what the promptest sample
/// took. (What that took too is the same for all and comes out as a delay.)
fn aligned(samples: &[RateSample]) -> Vec<(f64, f64)> {
    let late = samples.iter().map(|sample| sample.arrived - sample.t);
    let least = late.fold(f64::INFINITY, f64::min);
    let moved = samples.iter().map(|s| (s.t + least, s.yaw_rate));
    moved.collect()
}

/// Mean yaw rates since the heading before, from headings within half a turn; the first is 0. A
/// robot adds up every sample of its gyro in its heading, while a yaw rate would be one of five.
fn turns(headings: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut before = None;
    let rate = |(t, heading): (f64, f64)| {
        let rate = before.map_or(0.0, |(since, from): (f64, f64)| {
            let turn = heading - from;
            (turn - (turn / TAU).round() * TAU) / (t - since)
        });
        before = Some((t, heading));
        (t, rate)
    };
    headings.map(rate).collect()
}

/// Roller angles of all robots at rest.
fn angles<L: Link>(group: &mut Group<L>, nodes: &[u8]) -> Result<Vec<[f64; 4]>, MasterError> {
    nodes
        .iter()
        .map(|node| {
            let angles: [f32; 4] = group.roller_angles(*node)?.into();
            Ok(angles.map(f64::from))
        })
        .collect()
}

/// Spreads over a motion what its end is off from the angles read there, which are known but for
/// whole pitches.
fn fit(angles: &mut [[f64; 4]], end: &[f64; 4], pitch: f64) {
    let (Some(first), Some(last)) = (angles.first().copied(), angles.last().copied()) else {
        return;
    };
    for wheel in 0..4 {
        let off = end[wheel] - last[wheel];
        let off = off - (off / pitch).round() * pitch;
        let way = last[wheel] - first[wheel];
        for angle in angles.iter_mut() {
            if way.abs() > pitch {
                angle[wheel] += (angle[wheel] - first[wheel]) / way * off;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rims at 1.0 : 1.4 : 1.9 : 2.3, whatever the robot; and slower where the limits are low.
    #[test]
    fn every_wheel_has_a_rate_of_its_own() {
        let limits = group::GroupFile::load(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../groups/single.toml"
        ))
        .unwrap()
        .limits;
        let slow = group::Limits {
            linear_speed: 0.1,
            ..limits
        };
        for (degrees, limits, least) in [
            (45_f64, limits, 0.119),
            (52.0, limits, 0.119),
            (45.0, slow, 0.03),
        ] {
            let robot = FourWheelGeometry::new(0.37, 0.35, 0.1524, degrees.to_radians()).unwrap();
            let motions = motions(&robot, &limits, 2);
            assert_eq!(motions.len(), 8);
            for twist in motions {
                let twist = [twist.vx, twist.vy, twist.omega].map(f64::from);
                let mut rims = robot.wheels().unwrap().map(|w| {
                    let row = w.jacobian_row();
                    let rate: f64 = row.iter().zip(twist).map(|(row, v)| row * v).sum();
                    rate.abs() * 0.1524
                });
                rims.sort_by(f64::total_cmp);
                assert!(rims[0] > least && rims[0] < 0.1201, "{rims:?}");
                for (rim, share) in rims.iter().zip([1.0, 1.4, 1.9, 2.3]) {
                    assert!((rim / rims[0] - share).abs() < 1e-3, "{rims:?}");
                }
            }
        }
    }

    /// A robot turns over the end of the range, and one heading does not come.
    #[test]
    fn a_turn_goes_on_where_headings_begin_again() {
        let found = turns([(0.0, 3.08), (0.01, 3.12), (0.03, 3.20 - TAU)].into_iter());
        for ((_, rate), expected) in found.iter().zip([0.0, 4.0, 4.0]) {
            assert!((rate - expected).abs() < 1e-9, "{found:?}");
        }
    }

    /// The promptest sample takes 3 ms between clocks that are 5 s apart; the others are late,
    /// their times are not.
    #[test]
    fn a_late_line_does_not_move_its_sample() {
        let sample = |t: f64, late: f64| RateSample {
            arrived: t - 5.0 + late,
            t,
            yaw_rate: t,
        };
        let found = aligned(&[sample(5.0, 0.01), sample(5.1, 0.003), sample(5.2, 0.05)]);
        for ((t, _), expected) in found.iter().zip([0.003, 0.103, 0.203]) {
            assert!((t - expected).abs() < 1e-12, "{found:?}");
        }
    }
}
