//! A member computed in fixed point behind a single-precision interface.
//!
//! It is for a controller whose setpoints and measurements are `f32` and whose kinematics must not
//! depend on a floating-point unit. It has the same methods as [`MemberKinematics`], so that one
//! can replace the other. Each value is converted at the edge, with one multiplication and one
//! conversion instruction on a Cortex-M4F.

use fixed::types::I16F16;

use crate::arithmetic::Real;
use crate::compensation::VelocityCompensation;
use crate::error::GeometryError;
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::Twist;
use crate::member::MemberKinematics;
use crate::mount::Mount;
use crate::wheel::Wheel;

/// 2^16: steps of an `I16F16` in a unit.
const STEPS: f32 = 65_536.0;

/// How many times finer displacements are computed than velocities.
pub(crate) const FINE: f32 = 1024.0;

/// [`MemberKinematics`] in `I16F16`, with `f32` in and out.
///
/// ```
/// use mecanum_kinematics::{FixedMember, FourWheelGeometry, Mount, Twist, VelocityCompensation};
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let kinematics = FixedMember::new(&robot, &Mount::IDENTITY, &VelocityCompensation::NONE)?;
/// let rates = kinematics.inverse(Twist::new(0.5, 0.0, 0.0));
/// assert!((rates.rear_right - 0.5 / 0.1524).abs() < 4e-5);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedMember {
    member: MemberKinematics<I16F16>,
}

impl FixedMember {
    /// Folds geometry, mount and compensation in floating point and keeps the result in fixed
    /// point.
    ///
    /// # Errors
    ///
    /// As [`MemberKinematics::new`], and [`GeometryError::Range`] when the matrices do not fit:
    /// wheels of less than about a millimetre per metre of lever, or levers of tens of metres.
    pub fn new<S: Real>(
        geometry: &FourWheelGeometry<S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        Self::from_wheels(&geometry.wheels()?, mount, compensation)
    }

    /// The same from four wheels of any kind, front left to rear right.
    ///
    /// # Errors
    ///
    /// As [`FixedMember::new`].
    pub fn from_wheels<S: Real>(
        wheels: &[Wheel<S>; 4],
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        MemberKinematics::from_wheels(wheels, mount, compensation)?
            .convert()
            .map(|member| Self { member })
            .map_err(|_| GeometryError::Range)
    }

    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    ///
    /// Beyond ±32768 they stay there; a NaN counts as zero.
    #[must_use]
    #[inline]
    pub fn inverse(&self, group: Twist) -> WheelRates {
        single_rates(self.member.inverse(fixed_twist(group)))
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean, by least squares.
    #[must_use]
    #[inline]
    pub fn forward(&self, rates: &WheelRates) -> Twist {
        let twist = self.member.forward(&fixed_rates(rates));
        Twist {
            vx: single(twist.vx),
            vy: single(twist.vy),
            omega: single(twist.omega),
        }
    }

    /// The displacement of the group (group frame; m, m, rad) that these wheel-angle increments
    /// (rad) mean.
    ///
    /// As [`FixedMember::forward`], but in steps of 1.5e-8 instead of 1.5e-5, which a control
    /// tick's few tenths of a millimetre need; in exchange the increments end at ±32 rad.
    #[must_use]
    #[inline]
    pub fn displacement(&self, increments: &WheelRates) -> Twist {
        let scaled = <[f32; 4]>::from(*increments).map(|angle| angle * FINE);
        self.forward(&WheelRates::from(scaled)) * (1.0 / FINE)
    }

    /// What no rigid motion explains in these wheel rates, rad/s, as
    /// [`MemberKinematics::slip_residual`].
    #[must_use]
    #[inline]
    pub fn slip_residual(&self, rates: &WheelRates) -> f32 {
        single(self.member.slip_residual(&fixed_rates(rates)))
    }

    /// Whether a value computed here stands at the end of the range, so that the true one may lie
    /// beyond.
    #[must_use]
    pub fn is_saturated(value: f32) -> bool {
        value.abs() >= 32_767.937
    }

    /// The kinematics behind, for those who have fixed-point values already.
    #[must_use]
    pub const fn member(&self) -> &MemberKinematics<I16F16> {
        &self.member
    }
}

/// The largest number below a half. Added to a number it makes truncation round to the nearest,
/// halves away from zero, for every `f32`: the sum passes the next whole number only if the number
/// is half a step from it or less. A half itself would round up what is just below it, and from
/// 2^23 on, where there are whole numbers only, every odd one.
pub(crate) const BELOW_HALF: f32 = f32::from_bits(0.5_f32.to_bits() - 1);

/// The nearest step; the ends for what lies beyond, zero for a NaN.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the cast saturates, and a float has no more digits than the step once it is that \
        large"
)]
#[inline]
fn fixed(value: f32) -> I16F16 {
    I16F16::from_bits((value * STEPS + BELOW_HALF.copysign(value)) as i32)
}

#[expect(
    clippy::cast_precision_loss,
    reason = "rounded to the 24 bits an f32 has"
)]
#[inline]
pub(crate) const fn single(value: I16F16) -> f32 {
    value.to_bits() as f32 / STEPS
}

#[inline]
pub(crate) fn fixed_twist(twist: Twist) -> Twist<I16F16> {
    Twist {
        vx: fixed(twist.vx),
        vy: fixed(twist.vy),
        omega: fixed(twist.omega),
    }
}

#[inline]
pub(crate) fn fixed_rates(rates: &WheelRates) -> WheelRates<I16F16> {
    WheelRates {
        front_left: fixed(rates.front_left),
        front_right: fixed(rates.front_right),
        rear_left: fixed(rates.rear_left),
        rear_right: fixed(rates.rear_right),
    }
}

#[inline]
pub(crate) fn single_rates(rates: WheelRates<I16F16>) -> WheelRates {
    WheelRates {
        front_left: single(rates.front_left),
        front_right: single(rates.front_right),
        rear_left: single(rates.rear_left),
        rear_right: single(rates.rear_right),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number of steps with a fraction of one, as far as an `f32` has one: halves away from zero.
    #[test]
    fn the_nearest_step_is_the_nearest() {
        let below_half = f32::from_bits(0.5_f32.to_bits() - 1);
        for (steps, nearest) in [
            (below_half, 0),
            (0.5, 1),
            (1.499_999_9, 1),
            (1.5, 2),
            (4_194_303.5, 4_194_304),
            (8_388_607.5, 8_388_608),
            // From 2^23 on there are whole numbers only.
            (8_388_609.0, 8_388_609),
            (12_345_679.0, 12_345_679),
            (16_777_215.0, 16_777_215),
            (2_147_483_520.0, 2_147_483_520),
        ] {
            assert_eq!(fixed(steps / STEPS).to_bits(), nearest, "{steps}");
            assert_eq!(fixed(-steps / STEPS).to_bits(), -nearest, "-{steps}");
        }
        assert_eq!(fixed(f32::INFINITY), I16F16::MAX);
        assert_eq!(fixed(f32::NEG_INFINITY), I16F16::MIN);
        assert_eq!(fixed(f32::NAN), I16F16::ZERO);
    }
}
