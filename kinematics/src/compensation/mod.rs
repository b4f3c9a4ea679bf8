//! Compensation: how much faster the wheels must turn than geometry gives, and its inverse.
//!
//! Three forms, one trait. [`VelocityCompensation`] is the paper's constant diagonal `C`.
//! [`SpeedCompensation`] has a table over speed for each axis. [`DirectionalCompensation`] adds the
//! direction of motion between the axes, because the loss of a robot that moves obliquely is
//! neither its longitudinal nor its lateral loss.
//!
//! All map the desired velocity to the one that the wheels are commanded to, and all are
//! invertible: a table that is not is refused when it is built. Forward kinematics uses the inverse
//! of the same object.

mod constant;
mod directional;
pub mod estimate;
mod table;

pub use constant::VelocityCompensation;
pub use directional::DirectionalCompensation;
pub use table::{AxisTable, SpeedCompensation};

use crate::arithmetic::Real;
use crate::frame::Twist;

/// A relation between the velocity a robot achieves and the one its wheels are asked for, both in
/// its own frame.
pub trait Compensation<S = f32> {
    /// The velocity to ask of the wheels so that the robot achieves `desired`.
    fn apply(&self, desired: Twist<S>) -> Twist<S>;

    /// The velocity the robot achieves when its wheels are asked for `asked`.
    fn remove(&self, asked: Twist<S>) -> Twist<S>;
}

/// How much a coefficient may change, relative to itself, over a change of speed or direction of
/// the same relative size. It bounds the error that each round of [`invert`] leaves of the one
/// before.
const STEEPEST: f64 = 0.5;

/// Solves `asked = desired * coefficients(desired)` by `desired <- asked / coefficients(desired)`.
///
/// Tables are refused unless each round at least halves the error; those of real robots divide it
/// by 20 or more, so four or five rounds reach the last digit of an `f32`.
fn invert<S: Real>(asked: Twist<S>, coefficients: impl Fn(Twist<S>) -> [S; 3]) -> Twist<S> {
    let mut desired = asked;
    for _ in 0..60 {
        let [x, y, w] = coefficients(desired);
        let next = Twist::new(asked.vx / x, asked.vy / y, asked.omega / w);
        let change = (next.vx - desired.vx).abs()
            + (next.vy - desired.vy).abs()
            + (next.omega - desired.omega).abs();
        let size = next.vx.abs() + next.vy.abs() + next.omega.abs();
        desired = next;
        if change <= S::default_epsilon() * size {
            break;
        }
    }
    desired
}
