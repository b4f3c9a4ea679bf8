//! Limits on a twist's change in single precision.

use kinematics::Twist;

use super::{Approach, Step};
use crate::math::{inverse_sqrt, sqrt};
use crate::quantity::{Acceleration, Change, PerSecond, Quantity, Ratio, Velocity};

/// Limits on a twist's change.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ChangeLimits {
    acceleration_inverse: f32,
    acceleration_yaw_inverse: f32,
    jerk_inverse: f32,
    jerk_yaw_inverse: f32,
}

impl ChangeLimits {
    /// Limits in m/s^2, rad/s^2, m/s^3, rad/s^3; all above zero.
    #[must_use]
    pub fn new(acceleration: f32, acceleration_yaw: f32, jerk: f32, jerk_yaw: f32) -> Self {
        Self {
            acceleration_inverse: 1.0 / acceleration,
            acceleration_yaw_inverse: 1.0 / acceleration_yaw,
            jerk_inverse: 1.0 / jerk,
            jerk_yaw_inverse: 1.0 / jerk_yaw,
        }
    }

    /// How fast to make the rest of the way.
    #[inline]
    pub(super) fn approach(&self, behind: Twist<Velocity>, per_second: PerSecond) -> Approach {
        let per_dt = per_second.to_f32();
        // The remaining distance in steps of jerk: m squared.
        let grid = per_dt * per_dt;
        let m_squared = size_squared(
            behind,
            self.jerk_inverse * grid,
            self.jerk_yaw_inverse * grid,
        );
        if m_squared <= 1.0 {
            return Approach {
                per_second,
                is_far: false,
            };
        }
        // n / m, with m = n (n + 1) / 2.
        let share = 4.0 / (sqrt(1.0 + 8.0 * sqrt(m_squared)) + 1.0);
        Approach {
            per_second: PerSecond::new(per_dt * share),
            is_far: true,
        }
    }

    /// The share of a change in one step that the jerk leaves.
    #[inline]
    pub(super) fn jerk_share(&self, change: Twist<Acceleration>, step: Step) -> Option<Ratio> {
        let per_dt = step.per_second.to_f32();
        share(size_squared(
            change,
            self.jerk_inverse * per_dt,
            self.jerk_yaw_inverse * per_dt,
        ))
    }

    /// The share of an acceleration that is within its limit.
    #[inline]
    pub(super) fn acceleration_share(&self, acceleration: Twist<Change>) -> Option<Ratio> {
        share(size_squared(
            acceleration,
            self.acceleration_inverse,
            self.acceleration_yaw_inverse,
        ))
    }
}

/// What makes a size 1 of one that is more.
#[inline]
fn share(size_squared: f32) -> Option<Ratio> {
    (size_squared > 1.0).then(|| Ratio::new(inverse_sqrt(size_squared)))
}

/// The square of a twist's size when one unit is `1 / linear` and `1 / angular`.
#[inline]
fn size_squared<const FRACTION: u32>(
    twist: Twist<Quantity<FRACTION>>,
    linear: f32,
    angular: f32,
) -> f32 {
    let (vx, vy) = (twist.vx.to_f32(), twist.vy.to_f32());
    let along = (vx * vx + vy * vy) * (linear * linear);
    let about = twist.omega.to_f32() * angular;
    let about = about * about;
    if along > about { along } else { about }
}
