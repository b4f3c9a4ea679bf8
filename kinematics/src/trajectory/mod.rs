//! Curves for a body to follow: pose, velocity and acceleration in the world frame at time t.
//!
//! The paper's curves (its Table 2) translate with a fixed heading; [`MotionMode`] has all eleven
//! of its motions. They start at full speed, which is impossible for a robot; [`Ramped`] scales
//! time at both ends.

mod curves;
mod modes;
mod ramp;

pub use curves::{Circle, FigureEight, Harmonic, Heading, Line, Turn};
pub use modes::{MotionMode, PaperMotion};
pub use ramp::{Ramped, step};

use crate::arithmetic::Real;
use crate::frame::{Pose, Twist};

/// Acceleration of a body in the plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Acceleration<S = f32> {
    /// Along x, m/s^2.
    pub ax: S,
    /// Along y, m/s^2.
    pub ay: S,
    /// Angular, counter-clockwise positive, rad/s^2.
    pub alpha: S,
}

impl<S: Real> Acceleration<S> {
    /// From its components.
    #[must_use]
    pub const fn new(ax: S, ay: S, alpha: S) -> Self {
        Self { ax, ay, alpha }
    }
}

/// A moment of a motion, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample<S = f32> {
    /// Where the body is.
    pub pose: Pose<S>,
    /// How fast it moves, world frame.
    pub twist: Twist<S>,
    /// How fast that changes, world frame.
    pub acceleration: Acceleration<S>,
}

impl<S: Real> Sample<S> {
    /// The velocity in the body's own frame: what its kinematics take.
    #[must_use]
    pub fn body_twist(&self) -> Twist<S> {
        self.twist.to_body(self.pose.heading)
    }

    /// The acceleration along the body's own axes (what an accelerometer at its origin feels).
    #[must_use]
    pub fn body_acceleration(&self) -> Acceleration<S> {
        let Acceleration { ax, ay, alpha } = self.acceleration;
        let turned = Twist::new(ax, ay, alpha).to_body(self.pose.heading);
        Acceleration::new(turned.vx, turned.vy, turned.omega)
    }
}

/// A motion over a limited time.
///
/// ```
/// use mecanum_kinematics::trajectory::{FigureEight, Ramped, Trajectory};
///
/// let eight = Ramped::new(FigureEight::<f32>::paper(), 2.0);
/// assert!((eight.duration() - 22.0).abs() < 1e-5);
/// let middle = eight.sample(6.0); // 5 s along the curve, at the crossing
/// assert!((middle.twist.vy - 1.5708).abs() < 1e-4);
/// ```
pub trait Trajectory<S: Real = f32> {
    /// Pose and twist at `time` s, both in the world frame.
    fn at(&self, time: S) -> (Pose<S>, Twist<S>);

    /// How long the motion takes, s.
    fn duration(&self) -> S;

    /// Acceleration at `time` s, world frame.
    ///
    /// Where a trajectory does not say better, a difference over 2 ms: right to about 1e-6 of the
    /// third derivative.
    fn acceleration(&self, time: S) -> Acceleration<S> {
        let half = S::constant(1e-3);
        let (_, before) = self.at(time - half);
        let (_, after) = self.at(time + half);
        let change = (after - before) * (S::constant(0.5) / half);
        Acceleration::new(change.vx, change.vy, change.omega)
    }

    /// Pose, twist and acceleration at `time` s, world frame.
    fn sample(&self, time: S) -> Sample<S> {
        let (pose, twist) = self.at(time);
        Sample {
            pose,
            twist,
            acceleration: self.acceleration(time),
        }
    }

    /// Length of the way of the body's origin, m, by Simpson's rule over 2000 steps.
    fn arc_length(&self) -> S {
        let step = self.duration() / S::constant(2000.0);
        let speed = |time: S| {
            let (_, twist) = self.at(time);
            (twist.vx * twist.vx + twist.vy * twist.vy).root()
        };
        let mut sum = S::ZERO;
        let mut time = S::ZERO;
        for _ in 0..1000 {
            let next = time + step;
            let last = next + step;
            sum += speed(time) + S::constant(4.0) * speed(next) + speed(last);
            time = last;
        }
        sum * step / S::constant(3.0)
    }
}
