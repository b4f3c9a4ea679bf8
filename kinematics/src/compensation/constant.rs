//! Constant compensation: the paper's `C`, equation (18).
//!
//! A robot that is commanded to move at 500 mm/s sideways and reaches 483 has a lateral coefficient
//! of 1.035. The inverse of the same numbers converts measured wheel rates into the actual velocity
//! of the robot.

use super::Compensation;
use crate::arithmetic::Real;
use crate::error::CompensationError;
use crate::frame::Twist;

/// Commanded over achieved velocity, per axis of the robot's own frame.
///
/// Larger than 1 on a robot that loses velocity by slip; 1 is no compensation.
///
/// ```
/// use mecanum_kinematics::{Twist, VelocityCompensation};
///
/// let compensation = VelocityCompensation::new(1.002, 1.033, 1.0195)?;
/// let asked = compensation.apply(Twist::new(0.0, 0.5, 0.0));
/// assert!((asked.vy - 0.5165_f32).abs() < 1e-6); // 3.3 % more sideways
/// assert!(VelocityCompensation::new(1.0, 1.0, 0.0_f32).is_err());
/// # Ok::<(), mecanum_kinematics::CompensationError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VelocityCompensation<S = f32> {
    longitudinal: S,
    lateral: S,
    yaw: S,
}

impl VelocityCompensation {
    /// No compensation: the wheels do exactly what geometry says.
    pub const NONE: Self = Self {
        longitudinal: 1.0,
        lateral: 1.0,
        yaw: 1.0,
    };
}

impl<S: Real> VelocityCompensation<S> {
    /// [`VelocityCompensation::NONE`] for any scalar.
    #[must_use]
    pub const fn none() -> Self {
        Self {
            longitudinal: S::ONE,
            lateral: S::ONE,
            yaw: S::ONE,
        }
    }

    /// Coefficients along x, along y, and about z; each a plain factor near 1.
    ///
    /// # Errors
    ///
    /// [`CompensationError`] naming the coefficient that is zero, negative, NaN or infinite. (The
    /// paper prints 0 for an axis that is not used; taken literally that deletes every rotation.
    /// Use 1.)
    pub fn new(longitudinal: S, lateral: S, yaw: S) -> Result<Self, CompensationError> {
        for (value, field) in [
            (longitudinal, "longitudinal"),
            (lateral, "lateral"),
            (yaw, "yaw"),
        ] {
            if !value.is_finite() {
                return Err(CompensationError::NotFinite(field));
            }
            if value <= S::zero() {
                return Err(CompensationError::NotPositive(field));
            }
        }
        Ok(Self {
            longitudinal,
            lateral,
            yaw,
        })
    }

    /// Coefficient along x.
    #[must_use]
    pub const fn longitudinal(&self) -> S {
        self.longitudinal
    }

    /// Coefficient along y.
    #[must_use]
    pub const fn lateral(&self) -> S {
        self.lateral
    }

    /// Coefficient about z.
    #[must_use]
    pub const fn yaw(&self) -> S {
        self.yaw
    }

    /// The velocity to ask of the wheels so that the robot achieves `desired` (robot frame).
    #[must_use]
    pub fn apply(&self, desired: Twist<S>) -> Twist<S> {
        Twist {
            vx: desired.vx * self.longitudinal,
            vy: desired.vy * self.lateral,
            omega: desired.omega * self.yaw,
        }
    }

    /// The velocity the robot achieves when its wheels are asked for `asked` (robot frame).
    #[must_use]
    pub fn remove(&self, asked: Twist<S>) -> Twist<S> {
        Twist {
            vx: asked.vx / self.longitudinal,
            vy: asked.vy / self.lateral,
            omega: asked.omega / self.yaw,
        }
    }
}

impl<S: Real> Compensation<S> for VelocityCompensation<S> {
    fn apply(&self, desired: Twist<S>) -> Twist<S> {
        Self::apply(self, desired)
    }

    fn remove(&self, asked: Twist<S>) -> Twist<S> {
        Self::remove(self, asked)
    }
}
