//! Limits on a twist's change in fixed point.
//!
//! Magnitudes are roots of 64-bit sums of squares, with a relative error of 7e-8 ([`InverseRoot`]).
//! Only squares are compared with limits, so a comparison needs no root.

use kinematics::Twist;

use super::{Approach, Step};
use crate::quantity::root::{InverseRoot, reciprocal};
use crate::quantity::{Acceleration, Change, Jerk, PerSecond, Quantity, Ratio, Velocity};

/// Limits on a twist's change.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ChangeLimits {
    acceleration: Change,
    acceleration_yaw: Change,
    jerk: Jerk,
    jerk_yaw: Jerk,
    jerk_inverse: Ratio,
    jerk_yaw_inverse: Ratio,
}

impl ChangeLimits {
    /// Limits in m/s^2, rad/s^2, m/s^3, rad/s^3; all above zero.
    #[must_use]
    pub fn new(acceleration: f32, acceleration_yaw: f32, jerk: f32, jerk_yaw: f32) -> Self {
        Self {
            acceleration: Change::new(acceleration),
            acceleration_yaw: Change::new(acceleration_yaw),
            jerk: Jerk::new(jerk),
            jerk_yaw: Jerk::new(jerk_yaw),
            jerk_inverse: Ratio::new(1.0 / jerk),
            jerk_yaw_inverse: Ratio::new(1.0 / jerk_yaw),
        }
    }

    /// How fast to make the rest of the way.
    #[inline]
    pub(super) fn approach(&self, behind: Twist<Velocity>, per_second: PerSecond) -> Approach {
        /// Of one step of jerk.
        const ONE: u64 = 1 << 32;
        let ahead = InverseRoot::of(square(behind.vx, behind.vy).max(1)).root();
        let about = behind.omega.abs().to_bits().cast_unsigned();
        // With 54 fractional bits, s^2; at most 13 m/s over the least jerk, 0.1 m/s^3, is 2^61.
        let left = product(ahead, self.jerk_inverse).max(product(about, self.jerk_yaw_inverse));
        // Each 1/s with 18 fractional bits; the square has 8.
        let per = u64::from(per_second.to_bits().cast_unsigned());
        let grid = upper(per.wrapping_mul(per) << 4);
        // In steps of jerk, with 32 fractional bits: what is little keeps more of its own bits.
        let steps = if left >> 48 == 0 {
            times(left >> 16, grid) >> 14
        } else {
            times(left >> 30, grid)
        };
        if steps <= ONE {
            return Approach {
                per_second,
                is_far: false,
            };
        }
        // The root of 1 + 8 m, and 1 more, with 14 fractional bits.
        let root = InverseRoot::of((steps + (ONE >> 3)) >> 1).root();
        let (mantissa, shift) = reciprocal(root.saturating_add(1 << 14));
        // Four over it, with 31 fractional bits.
        let share = mantissa >> shift.saturating_sub(47);
        let gain = upper(per.wrapping_mul(u64::from(share)) << 1);
        Approach {
            per_second: PerSecond::from_bits(gain.cast_signed()),
            is_far: true,
        }
    }

    /// The share of a change in one step that the jerk leaves.
    #[inline]
    pub(super) fn jerk_share(&self, change: Twist<Acceleration>, step: Step) -> Option<Ratio> {
        share(
            change,
            self.jerk.times(step.dt),
            self.jerk_yaw.times(step.dt),
        )
    }

    /// The share of an acceleration that is within its limit.
    #[inline]
    pub(super) fn acceleration_share(&self, acceleration: Twist<Change>) -> Option<Ratio> {
        share(acceleration, self.acceleration, self.acceleration_yaw)
    }
}

/// The share of a twist that two limits leave.
#[inline]
fn share<const FRACTION: u32>(
    twist: Twist<Quantity<FRACTION>>,
    linear: Change,
    angular: Change,
) -> Option<Ratio> {
    let along = square(twist.vx, twist.vy);
    let about = square(twist.omega, Quantity::ZERO);
    if along <= bound::<FRACTION>(linear) && about <= bound::<FRACTION>(angular) {
        return None;
    }
    Some(part::<FRACTION>(linear, along).min(part::<FRACTION>(angular, about)))
}

/// The square of a limit, as [`square`] of numbers with so many fractional bits.
#[inline]
const fn bound<const FRACTION: u32>(limit: Change) -> u64 {
    let limit = limit.to_bits().cast_unsigned() as u64;
    limit.wrapping_mul(limit) >> const { 2 * (Change::FRACTION - FRACTION) }
}

/// A limit over the root of such a square, at most 1.
#[inline(never)]
#[expect(clippy::cast_possible_truncation, reason = "at most 2^27")]
fn part<const FRACTION: u32>(limit: Change, square: u64) -> Ratio {
    if square <= bound::<FRACTION>(limit) {
        return const { Ratio::new(1.0) };
    }
    let root = InverseRoot::of(square);
    let limit = u64::from(limit.to_bits().cast_unsigned());
    let product = limit.wrapping_mul(u64::from(root.mantissa));
    // 24 bits of the limit, 30 of the mantissa and 32 of the square's place above the result.
    let shift = const { 59 - FRACTION }.wrapping_sub(root.half);
    Ratio::from_bits((product >> (shift & 63)) as i32)
}

/// The sum of two squares: below 2^63.
#[inline]
const fn square<const FRACTION: u32>(a: Quantity<FRACTION>, b: Quantity<FRACTION>) -> u64 {
    let (a, b) = (a.abs().to_bits() as i64, b.abs().to_bits() as i64);
    a.wrapping_mul(a)
        .wrapping_add(b.wrapping_mul(b))
        .cast_unsigned()
}

#[inline]
const fn product(a: u32, b: Ratio) -> u64 {
    (a as u64).wrapping_mul(b.to_bits().cast_unsigned() as u64)
}

/// The product with the lower word of the first.
#[inline]
const fn times(a: u64, b: u32) -> u64 {
    (a & 0xFFFF_FFFF).wrapping_mul(b as u64)
}

#[inline]
const fn upper(wide: u64) -> u32 {
    (wide >> 32) as u32
}
