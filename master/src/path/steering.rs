//! Following a curve with feedback: the curve's own velocity, and a correction towards where it
//! should be.
//!
//! ```text
//! twist = curve's velocity at the time it will be reached            (feedforward)
//!       + what the floor takes beside what was calibrated            (learnt, bounded)
//!       + gain * (where the curve was - where the group was seen)    (P law, limited)
//! ```
//!
//! What is learnt is in [`super::adaptation`].
//!
//! The error is taken at the time of the sighting, not of the setpoint, so a late sighting does not
//! look like an error. With a gain of 2 1/s and the way of a setpoint through the group (a
//! SYNC period, the agreement and the age of the sighting, about 30 ms at 100 Hz) gain times delay
//! is 0.06: far below the 0.5
//! beyond which such a loop rings. The correction is limited, so that a jump of the pose source
//! cannot throw the group about, and the sum is kept within the group's limits. A sighting older
//! than 0.2 s is not used; one older than 1 s ends the drive.

use std::cell::Cell;
use std::rc::Rc;

use canopen::Micros;
use group::Limits;
use kinematics::{Pose, Twist};

use super::adaptation::Adaptation;
use crate::monitor::average::counted_on;
use crate::monitor::odometry::relative_to;
use crate::monitor::rows::Row;
use crate::source::pose::PoseStream;

/// Older than this a sighting is not used, in µs.
const STALE_US: u64 = 200_000;
/// Older than this the drive ends, in µs.
const LOST_US: u64 = 1_000_000;

/// The P law's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Velocity per distance, 1/s.
    pub gain: f32,
    /// Yaw rate per angle, 1/s.
    pub yaw_gain: f32,
    /// Largest correction, m/s.
    pub limit: f32,
    /// Largest correction of the yaw rate, rad/s.
    pub yaw_limit: f32,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            gain: 2.0,
            yaw_gain: 2.0,
            limit: 0.2,
            yaw_limit: 0.3,
        }
    }
}

impl Law {
    /// The correction for a group seen at `seen` that should have been at `wanted`, both in one
    /// frame; velocity in that frame.
    #[must_use]
    pub fn correction(&self, wanted: Pose, seen: Pose) -> Twist {
        let (dx, dy) = (wanted.x - seen.x, wanted.y - seen.y);
        let (vx, vy) = (self.gain * dx, self.gain * dy);
        let share = (self.limit / vx.hypot(vy)).min(1.0);
        let (sin, cos) = (wanted.heading - seen.heading).sin_cos();
        let omega = self.yaw_gain * sin.atan2(cos);
        Twist::new(
            vx * share,
            vy * share,
            omega.clamp(-self.yaw_limit, self.yaw_limit),
        )
    }
}

impl std::fmt::Display for Law {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "feedforward + P: {} 1/s up to {} m/s, {} 1/s up to {} rad/s",
            self.gain, self.limit, self.yaw_gain, self.yaw_limit
        )
    }
}

/// Where sightings come from.
pub enum PoseInput {
    /// What the robots work out from their wheels.
    Odometry,
    /// An observer in this process, who leaves time and pose here: a simulated world's truth.
    Observer(Rc<Cell<Option<(Micros, Pose)>>>),
    /// A program that sends poses.
    Stream(PoseStream),
}

impl PoseInput {
    fn look(&self, now: Micros, began: Micros, rows: &[Row]) -> Option<(Micros, Pose)> {
        match self {
            Self::Odometry => rows.iter().rev().take(100).find_map(|row| {
                let at = Micros((began.0 as f64 + row.t * 1e6).max(0.0).round() as u64);
                Some((at, row.pose()?))
            }),
            Self::Observer(seen) => seen.get(),
            Self::Stream(stream) => stream.latest(now),
        }
    }
}

/// Where the group was at one time of the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Time along the curve, in s.
    pub t: f64,
    /// Pose in the curve's frame.
    pub pose: Pose,
}

/// Why the feedback gave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost;

/// The feedback of one drive.
pub struct Steering {
    /// The law.
    pub law: Law,
    /// Everything that was seen.
    pub sightings: Vec<Sighting>,
    /// What has been learnt of the floor.
    pub adaptation: Adaptation,
    /// Time of the sighting from which that was last learnt, s along the curve.
    learnt: f64,
    input: PoseInput,
    /// What is first seen is where the curve begins.
    first: Option<Pose>,
    start: Pose,
    last: Option<Micros>,
    began: Micros,
    /// Whether sightings correct anything, or are only kept.
    pub corrects: bool,
}

impl Steering {
    /// Feedback for a curve that begins at `start`. Without `corrects` it only looks.
    #[must_use]
    pub fn new(law: Law, input: PoseInput, start: Pose, corrects: bool) -> Self {
        Self {
            law,
            sightings: Vec::new(),
            adaptation: Adaptation::default(),
            learnt: 0.0,
            input,
            first: None,
            start,
            last: None,
            began: Micros(0),
            corrects,
        }
    }

    /// The curve begins at this time of the link's clock.
    pub(crate) fn begin(&mut self, at: Micros) {
        (self.began, self.last) = (at, Some(at));
    }

    /// Learns from a sighting that the law corrects by this twist (of the curve's frame), where the
    /// curve has this velocity and acceleration in the group's own; nothing from one that has
    /// already been learnt from, or that is so far off that the law is at its limit.
    pub(crate) fn learn(
        &mut self,
        seen: &Sighting,
        correction: Twist,
        velocity: Twist,
        acceleration: Twist,
    ) {
        let Law {
            gain,
            yaw_gain,
            limit,
            yaw_limit,
        } = self.law;
        let held = correction.vx.hypot(correction.vy) >= 0.99 * limit
            || correction.omega.abs() >= 0.99 * yaw_limit;
        let passed = seen.t - std::mem::replace(&mut self.learnt, seen.t);
        if held || passed <= 0.0 || gain <= 0.0 || yaw_gain <= 0.0 {
            return;
        }
        let Twist { vx, vy, omega } = correction.to_body(seen.pose.heading);
        #[expect(clippy::cast_possible_truncation, reason = "some ms")]
        self.adaptation.learn(
            [vx / gain, vy / gain, omega / yaw_gain],
            velocity,
            acceleration,
            passed as f32,
        );
    }

    /// Takes the newest sighting, if there is a new one. `rows_began` is the time of the rows'
    /// zero.
    ///
    /// # Errors
    /// When there has been none for too long.
    pub(crate) fn look(
        &mut self,
        now: Micros,
        rows_began: Micros,
        rows: &[Row],
    ) -> Result<Option<Sighting>, Lost> {
        let seen = self.input.look(now, rows_began, rows);
        if let Some((at, pose)) = seen {
            let first = *self.first.get_or_insert(pose);
            let before = self.sightings.last().map_or(self.start, |last| last.pose);
            let here = self.start.compose(relative_to(first, pose));
            let sighting = Sighting {
                t: at.0 as f64 * 1e-6 - self.began.0 as f64 * 1e-6,
                pose: counted_on(before.heading, here),
            };
            if self.last.is_none_or(|last| at > last) {
                self.last = Some(at);
                self.sightings.push(sighting);
            }
            if now.0 < at.0 + STALE_US {
                return Ok(Some(sighting));
            }
        }
        if self.last.is_some_and(|last| now.0 > last.0 + LOST_US) {
            return Err(Lost);
        }
        Ok(None)
    }
}

/// `twist` slowed down in its direction to what a group may do.
#[must_use]
pub fn limited(twist: Twist, limits: &Limits) -> Twist {
    let excess = (twist.vx.hypot(twist.vy) / limits.linear_speed)
        .max(twist.omega.abs() / limits.yaw_rate)
        .max(1.0);
    Twist::new(twist.vx / excess, twist.vy / excess, twist.omega / excess)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_correction_is_the_gain_times_the_error_up_to_its_limit() {
        let law = Law::default();
        let wanted = Pose::new(1.0, 2.0, 0.1);
        let small = law.correction(wanted, Pose::new(0.97, 2.04, 0.0));
        assert!((small.vx - 0.06).abs() < 1e-6 && (small.vy + 0.08).abs() < 1e-6);
        assert!((small.omega - 0.2).abs() < 1e-6);
        let far = law.correction(wanted, Pose::new(-2.0, 6.0, -3.0));
        assert!((far.vx.hypot(far.vy) - 0.2).abs() < 1e-6);
        // 3 to -4: the direction is kept.
        assert!((far.vy / far.vx + 4.0 / 3.0).abs() < 1e-5);
        assert_eq!(far.omega, 0.3);
    }

    #[test]
    fn headings_turn_the_short_way() {
        let law = Law::default();
        let turn = law.correction(Pose::new(0.0, 0.0, 3.1), Pose::new(0.0, 0.0, -3.1));
        assert!((turn.omega + 2.0 * (std::f32::consts::TAU - 6.2)).abs() < 1e-5);
    }

    #[test]
    fn nothing_wrong_is_no_correction() {
        let pose = Pose::new(1.0, 2.0, 3.0);
        assert_eq!(Law::default().correction(pose, pose), Twist::default());
    }

    #[test]
    fn what_is_first_seen_is_where_the_curve_begins_and_old_sightings_do_not_count() {
        let seen = Rc::new(Cell::new(Some((Micros(0), Pose::new(10.0, 0.0, 0.5)))));
        let start = Pose::new(2.5, 0.0, 0.0);
        let input = PoseInput::Observer(Rc::clone(&seen));
        let mut steering = Steering::new(Law::default(), input, start, true);
        steering.begin(Micros(0));
        let first = steering.look(Micros(1), Micros(0), &[]).unwrap().unwrap();
        assert_eq!(first.pose, start);
        // One metre ahead of where it stood, in its own direction.
        let (sin, cos) = 0.5_f32.sin_cos();
        seen.set(Some((Micros(100_000), Pose::new(10.0 + cos, sin, 0.5))));
        let next = steering
            .look(Micros(110_000), Micros(0), &[])
            .unwrap()
            .unwrap();
        assert!((next.pose.x - 3.5).abs() < 1e-6 && next.pose.y.abs() < 1e-6);
        assert!((next.t - 0.1).abs() < 1e-9);
        assert_eq!(steering.look(Micros(400_000), Micros(0), &[]), Ok(None));
        assert_eq!(steering.look(Micros(1_200_000), Micros(0), &[]), Err(Lost));
    }
}
