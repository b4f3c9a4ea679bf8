//! The curves the master knows by name, with their ramps, checked against the group's limits.
//!
//! The shapes are `kinematics::trajectory`'s; this file only chooses their parameters, ramps both
//! ends and asks beforehand whether a group may go that fast: a curve that would be slowed down on
//! the way is refused before anything moves, because then the group would no longer be where the
//! curve says. Evaluated in f64, since time runs to minutes; handed out as the f32 that robots use.

use group::Limits;
use kinematics::trajectory::{Line, MotionMode, PaperMotion, Ramped, Trajectory, Turn};
use kinematics::{Pose, Twist};

use crate::error::MasterError;

/// Time over which a curve is entered and left, in s. The paper's 0.6 s would need more
/// acceleration on its figure-eight than the wheels' friction gives.
pub const RAMP: f64 = 2.0;
/// The same for going there and back, which begins at rest.
const ENTRY: f64 = 0.3;
/// How much of a curve is driven in a quick run, in s.
const QUICK: f64 = 6.0;
/// Step at which a curve is checked against limits, in s.
const CHECK_STEP: f64 = 0.01;

/// Speed along the lateral and oblique lines, in m/s.
const LINE_SPEED: f64 = 0.5;
/// Yaw rate of the turn, in rad/s.
const TURN_RATE: f64 = 0.5;
/// How long lines and the turn last, in s.
const STEADY: f64 = 8.0;

/// A curve by name. Lateral, oblique and turn last 8 s, to see how evenly wheels move a group; the
/// others have the parameters of the source paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Curve {
    /// A figure-eight of 2500 mm, pi/10 rad/s (20 s).
    FigureEight,
    /// A circle of 2500 mm, pi/10 rad/s (20 s).
    Circle,
    /// A harmonic curve: 300 mm/s to the right, 1000 mm and pi/5 rad/s forward and back (20 s).
    Harmonic,
    /// Straight ahead at 500 mm/s (10 s).
    Forward,
    /// Sideways to the left at 500 mm/s (8 s).
    Lateral,
    /// At 45 degrees ahead and to the left, 353.6 mm/s an axis (8 s).
    Oblique,
    /// Turning on the spot at 0.5 rad/s (8 s).
    Turn,
    /// A circle of 1350 mm, pi/5 rad/s (10 s), the front always outwards.
    Centripetal,
}

impl Curve {
    /// The motion, without ramps.
    #[must_use]
    pub fn motion(self) -> PaperMotion<f64> {
        let line = |vx, vy| {
            PaperMotion::Line(Line {
                vx,
                vy,
                duration: STEADY,
            })
        };
        let part = LINE_SPEED * std::f64::consts::FRAC_1_SQRT_2;
        match self {
            Self::FigureEight => MotionMode::FigureEight,
            Self::Circle => MotionMode::Circle,
            Self::Harmonic => MotionMode::Harmonic,
            Self::Forward => MotionMode::Longitudinal,
            Self::Lateral => return line(0.0, LINE_SPEED),
            Self::Oblique => return line(part, part),
            Self::Turn => {
                return PaperMotion::Turn(Turn {
                    omega: TURN_RATE,
                    duration: STEADY,
                });
            }
            Self::Centripetal => MotionMode::Centripetal,
        }
        .motion()
    }

    /// The name used on the command line and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::FigureEight => "figure-eight",
            Self::Circle => "circle",
            Self::Harmonic => "harmonic",
            Self::Forward => "forward",
            Self::Lateral => "lateral",
            Self::Oblique => "oblique",
            Self::Turn => "turn",
            Self::Centripetal => "centripetal",
        }
    }

    /// The curve as it will be driven. `quick` drives its first seconds only.
    #[must_use]
    pub fn plan(self, quick: bool) -> Plan {
        let motion = Motion(Box::new(self.motion()));
        let motion = if quick {
            Motion(Box::new(Beginning(motion)))
        } else {
            motion
        };
        Plan::new(self.name().into(), motion, RAMP)
    }
}

/// Any motion.
pub(crate) struct Motion(pub Box<dyn Trajectory<f64> + Send + Sync>);

impl Trajectory<f64> for Motion {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        self.0.at(time)
    }

    fn duration(&self) -> f64 {
        self.0.duration()
    }
}

/// What the curve asks for at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant {
    /// Time since the start of the curve, in s.
    pub t: f64,
    /// Place of this SYNC's row in the recorder.
    pub row: usize,
    /// Duration of the curve, in s.
    pub duration: f64,
    /// Pose asked for, world frame of the curve.
    pub pose: Pose,
    /// Twist asked for, world frame of the curve.
    pub twist: Twist,
}

impl std::fmt::Display for Curve {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The first [`QUICK`] seconds of a curve.
pub(crate) struct Beginning<T>(pub T);

impl<T: Trajectory<f64>> Trajectory<f64> for Beginning<T> {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        self.0.at(time)
    }

    fn duration(&self) -> f64 {
        self.0.duration().min(QUICK)
    }
}

/// Ahead and back: `distance / 2 (1 - cos)`.
struct ThereAndBack {
    distance: f64,
    duration: f64,
}

impl Trajectory<f64> for ThereAndBack {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let rate = std::f64::consts::TAU / self.duration;
        let (sin, cos) = libm::sincos(rate * time);
        (
            Pose::new(0.5 * self.distance * (1.0 - cos), 0.0, 0.0),
            Twist::translation(0.5 * self.distance * rate * sin, 0.0),
        )
    }

    fn duration(&self) -> f64 {
        self.duration
    }
}

/// A curve ready to be driven: from rest to rest.
pub struct Plan {
    name: String,
    motion: Ramped<Motion, f64>,
}

impl std::fmt::Debug for Plan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} of {:.2} s", self.name, self.duration())
    }
}

impl Plan {
    /// A motion with ramps of so many seconds at both ends.
    pub(crate) fn new(name: String, motion: Motion, ramp: f64) -> Self {
        let motion = Ramped::new(motion, ramp);
        Self { name, motion }
    }

    /// A motion that begins and ends at rest by itself.
    pub(crate) fn from_rest(name: &str, motion: Motion) -> Self {
        Self::new(name.into(), motion, 0.0)
    }

    /// Straight ahead by a distance (m) and back, as a cosine: at `speed` (m/s) at most, and within
    /// the group's limits with some room.
    #[must_use]
    pub fn there_and_back(distance: f64, speed: f64, limits: &Limits) -> Self {
        let speed = speed.min(0.7 * f64::from(limits.linear_speed));
        let acceleration = 0.7 * f64::from(limits.linear_acceleration);
        let pi = std::f64::consts::PI;
        let by_speed = pi * distance / speed;
        let by_acceleration = pi * (2.0 * distance / acceleration).sqrt();
        let motion = ThereAndBack {
            distance,
            duration: by_speed.max(by_acceleration),
        };
        Self::new("there and back".into(), Motion(Box::new(motion)), ENTRY)
    }

    /// Name of the curve.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How long the motion takes, in s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.motion.duration()
    }

    /// The largest speed of the motion, m/s.
    #[must_use]
    pub fn fastest(&self) -> f64 {
        let steps = (self.duration() / CHECK_STEP).ceil() as u32;
        let twists = (0..=steps).map(|step| self.motion.at(f64::from(step) * CHECK_STEP).1);
        twists.map(|v| v.vx.hypot(v.vy)).fold(0.0, f64::max)
    }

    /// Where the curve begins.
    #[must_use]
    pub fn start(&self) -> Pose<f64> {
        self.motion.at(0.0).0
    }

    /// Pose and twist asked for `t` seconds after the start, both in the world frame of the curve.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "robots use f32; 2.5 m has steps of 0.2 um there"
    )]
    pub fn at(&self, t: f64) -> (Pose, Twist) {
        let (pose, twist) = self.motion.at(t);
        (
            Pose {
                x: pose.x as f32,
                y: pose.y as f32,
                heading: pose.heading as f32,
            },
            Twist {
                vx: twist.vx as f32,
                vy: twist.vy as f32,
                omega: twist.omega as f32,
            },
        )
    }

    /// The setpoint for `t`: the twist in the frame of a group that has the pose the curve asks
    /// for.
    #[must_use]
    pub fn setpoint(&self, t: f64) -> Twist {
        let (pose, twist) = self.at(t);
        twist.to_body(pose.heading)
    }

    /// Checks speed and acceleration of the whole curve against the limits of a group.
    ///
    /// # Errors
    /// [`MasterError::TooFast`], naming the limit.
    pub fn check(&self, limits: &Limits) -> Result<(), MasterError> {
        let mut largest = [0.0_f32; 4];
        let steps = (self.duration() / CHECK_STEP).ceil();
        let mut before = self.setpoint(0.0);
        let mut t = 0.0;
        while t <= steps * CHECK_STEP {
            let now = self.setpoint(t);
            #[expect(clippy::cast_possible_truncation, reason = "a constant")]
            let step = CHECK_STEP as f32;
            let found = [
                now.vx.hypot(now.vy),
                now.omega.abs(),
                (now.vx - before.vx).hypot(now.vy - before.vy) / step,
                (now.omega - before.omega).abs() / step,
            ];
            for (largest, found) in largest.iter_mut().zip(found) {
                *largest = largest.max(found);
            }
            before = now;
            t += CHECK_STEP;
        }
        let allowed = [
            ("limits.linear_speed", "m/s", limits.linear_speed),
            ("limits.yaw_rate", "rad/s", limits.yaw_rate),
            (
                "limits.linear_acceleration",
                "m/s2",
                limits.linear_acceleration,
            ),
            ("limits.yaw_acceleration", "rad/s2", limits.yaw_acceleration),
        ];
        for (asked, (limit_name, unit, limit)) in largest.into_iter().zip(allowed) {
            if asked > limit {
                return Err(MasterError::TooFast {
                    trajectory: self.name.clone(),
                    is_curve: true,
                    asked,
                    unit,
                    limit_name,
                    limit,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        linear_speed: 2.0,
        yaw_rate: 1.0,
        linear_acceleration: 2.4,
        yaw_acceleration: 2.0,
        linear_jerk: 100.0,
        yaw_jerk: 80.0,
        command_timeout_us: 100_000,
        sync_timeout_us: 0,
    };

    #[test]
    fn every_curve_starts_and_ends_at_rest_within_the_papers_limits() {
        for curve in <Curve as clap::ValueEnum>::value_variants() {
            let curve = *curve;
            for quick in [false, true] {
                let plan = curve.plan(quick);
                plan.check(&LIMITS).unwrap();
                for t in [-1.0, 0.0, plan.duration(), plan.duration() + 1.0] {
                    let v = plan.setpoint(t);
                    assert!(v.vx.hypot(v.vy) < 1e-6, "{curve} at {t}: {v:?}");
                }
            }
        }
    }

    #[test]
    fn a_curve_too_fast_for_the_group_is_refused_by_the_limits_name() {
        // The figure-eight is fastest where it crosses itself: l w sqrt(1 + 4) = 1.756 m/s.
        let slow = Limits {
            linear_speed: 1.7,
            ..LIMITS
        };
        let error = Curve::FigureEight.plan(false).check(&slow).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("limits.linear_speed"), "{text}");
        assert!(text.contains("1.756"), "{text}");
    }

    #[test]
    fn quick_is_the_beginning_of_the_same_curve() {
        let (whole, quick) = (
            Curve::FigureEight.plan(false),
            Curve::FigureEight.plan(true),
        );
        assert_eq!(quick.duration(), QUICK + RAMP);
        assert_eq!(whole.at(5.0), quick.at(5.0));
    }
}
