//! Kinematics that use the angle of each wheel's ground roller.
//!
//! # Theory of operation
//!
//! When the wheel has turned by `sweep` past the middle of its ground roller, the roller's axle
//! seen from above is at `tan(gamma') = tan(gamma) cos(sweep)`. In the wheel's row of `J` only `cot
//! gamma` becomes `cot gamma sec(sweep)`: the row is a *straight* part that does not depend on the
//! rollers plus `sec(sweep)` times an *across* part
//! ([`Wheel::jacobian_parts`](crate::Wheel::jacobian_parts)). Only one number per wheel changes
//! while it turns, its secant, and the functions of this module take it as an argument:
//!
//! ```text
//! encoder counts -> RollerTrack -> RollerAngle -> Secant::at -> PhaseMember::inverse, ::measure
//! ```
//!
//! A wheel whose angle is unknown has the secant [`Secant::unknown`], the reciprocal of the mean
//! lateral ratio `sin(pi/n)/(pi/n)`; a wheel of infinitely many rollers has the secant 1, and all
//! results are then those of [`MemberKinematics`](crate::MemberKinematics).
//!
//! # Interface
//!
//! | type | for | cost on a Cortex-M4F |
//! |---|---|---|
//! | [`PhaseMember`] | the usual four wheels, `f32` and `f64` | `docs/kinematics.md` has the counts |
//! | [`FixedPhaseMember`] | the same in 32-bit fixed point, `f32` in and out | |
//! | [`PhasePlatform`] | any wheels, weighted least squares, covariance | not for the control loop |
//!
//! # Limits
//!
//! The point of contact wanders along the wheel's axle by `(r - r_roller) tan(sweep)
//! cot(gamma)`, which changes the lever arm of a turn; its mean over a roller is zero.
//! [`Wheel::swept`](crate::Wheel::swept) has it.

mod angle;
mod fixed_point;
mod member;
mod platform;
mod secant;

pub use angle::{RollerAngle, RollerTrack};
pub use fixed_point::{FixedPhaseMember, FixedSecant};
pub use member::PhaseMember;
pub use platform::{PhasePlatform, SecantEstimate};
pub use secant::Secant;
