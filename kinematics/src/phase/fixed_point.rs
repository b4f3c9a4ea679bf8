//! [`super::PhaseMember`] in 32-bit fixed point, with `f32` in and out.
//!
//! Values are `I16F16` as in [`FixedMember`](crate::FixedMember); secants have 26 fractional bits. The one division
//! of the way back is a 32-bit one for the upper half of the digits and a Newton step for the lower, so no 64-bit
//! division is called.

use fixed::types::I16F16;

use super::angle::RollerAngle;
use super::member::PhaseMember;
use super::secant::Secant;
use crate::arithmetic::{Real, Scalar};
use crate::compensation::VelocityCompensation;
use crate::error::GeometryError;
use crate::fixed_member::{FINE, fixed_rates, fixed_twist, single, single_rates};
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::Twist;
use crate::mount::Mount;

/// Fractional bits of a secant and of its polynomial.
const SECANT: u32 = 26;
/// Of sums of secants.
const SUM: u32 = 24;
/// Of what a pair's rates are multiplied with on the way back.
const SOLVE: u32 = 30;
/// Of the matrix to the wheels and of the one back, as in [`crate::WheelKinematics`].
const TO_WHEELS: u32 = 20;
const TO_GROUP: u32 = 28;

/// [`Secant`] in fixed point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FixedSecant {
    powers: [i32; 4],
    unknown: i32,
}

impl FixedSecant {
    /// The same rollers in fixed point.
    ///
    /// # Errors
    ///
    /// [`GeometryError::Range`] when a coefficient does not fit, which no wheel of three rollers or more causes.
    pub fn new<S: Real>(secant: &Secant<S>) -> Result<Self, GeometryError> {
        let [k0, k1, k2, k3] = secant.powers().map(Scalar::widen);
        Ok(Self {
            powers: [bits(k0)?, bits(k1)?, bits(k2)?, bits(k3)?],
            unknown: bits(secant.unknown().widen())?,
        })
    }

    /// `sec(sweep)`, with 26 fractional bits.
    #[must_use]
    #[inline]
    pub const fn at(&self, angle: RollerAngle) -> i32 {
        let x = angle.to_bits() as i64;
        // At most 2^30: a quarter, with 32 fractional bits.
        let z = high(x * x);
        let [k0, k1, k2, k3] = self.powers;
        let sum = k2 + high(z as i64 * k3 as i64);
        let sum = k1 + high(z as i64 * sum as i64);
        k0 + high(z as i64 * sum as i64)
    }

    /// What stands for the secant of a wheel whose angle is not known, with 26 fractional bits.
    #[must_use]
    pub const fn unknown(&self) -> i32 {
        self.unknown
    }
}

/// The upper word.
const fn high(wide: i64) -> i32 {
    (wide >> 32) as i32
}

/// A number as an integer with [`SECANT`] fractional bits.
fn bits(value: f64) -> Result<i32, GeometryError> {
    scaled::<SECANT>(value)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "checked to be within the range"
)]
fn scaled<const SHIFT: u32>(value: f64) -> Result<i32, GeometryError> {
    let wide = libm::round(value * f64::from(1_u32 << SHIFT));
    if wide.abs() < f64::from(i32::MAX) {
        Ok(wide as i32)
    } else {
        Err(GeometryError::Range)
    }
}

/// [`PhaseMember`] in `I16F16`, with `f32` in and out.
///
/// ```
/// use mecanum_kinematics::{
///     FixedPhaseMember, FixedSecant, FourWheelGeometry, Mount, RollerAngle, Rollers, Secant, Twist,
///     VelocityCompensation,
/// };
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let kinematics = FixedPhaseMember::new(&robot, &Mount::IDENTITY, &VelocityCompensation::NONE)?;
/// let secant = FixedSecant::new(&Secant::new(Some(&Rollers::<f64>::new(8)?)))?;
/// let secants = [secant.at(RollerAngle::from_bits(0)); 4];
/// let rates = kinematics.inverse(Twist::new(0.0, 0.5, 0.0), &secants);
/// assert!((rates.front_right - 0.5 / 0.1524).abs() < 6e-5);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedPhaseMember {
    to_wheels: [[i32; 3]; 4],
    to_group: [[i32; 3]; 3],
    /// With [`SUM`] fractional bits.
    spread: i32,
}

impl FixedPhaseMember {
    /// Folds geometry, mount and compensation in floating point and keeps the result in fixed point.
    ///
    /// # Errors
    ///
    /// [`GeometryError::Range`] when the matrices do not fit, as [`FixedMember::new`](crate::FixedMember::new), or
    /// for a track of more than some dozens of wheelbases.
    pub fn new<S: Real>(
        geometry: &FourWheelGeometry<S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        let member = PhaseMember::new(geometry, mount, compensation);
        let (x, y, w, turn) = member.rows();
        let to = |row: [S; 3]| {
            I16F16::row::<TO_WHEELS, 3>(row.map(Scalar::widen)).ok_or(GeometryError::Range)
        };
        let from = |row: [S; 3]| {
            I16F16::row::<TO_GROUP, 3>(row.map(Scalar::widen)).ok_or(GeometryError::Range)
        };
        let [vx, vy, omega] = *member.rows_back();
        let spread = member.spread().widen();
        // Sums of secants of up to 16 have to fit beside it.
        if spread > 100.0 {
            return Err(GeometryError::Range);
        }
        Ok(Self {
            to_wheels: [to(x)?, to(y)?, to(w)?, to(turn)?],
            to_group: [from(vx)?, from(vy)?, from(omega)?],
            spread: scaled::<SUM>(spread)?,
        })
    }

    /// Wheel rates (rad/s) that make the group move with this twist (group frame) while the wheels have these
    /// secants (26 fractional bits).
    #[must_use]
    #[inline]
    pub fn inverse(&self, group: Twist, secants: &[i32; 4]) -> WheelRates {
        let group = fixed_twist(group);
        let twist = [group.vx, group.vy, group.omega];
        let [x, y, w, turn] = I16F16::product::<TO_WHEELS, false, 3, 4>(&self.to_wheels, &twist);
        let (front, rear) = (y.saturating_add(w), y.saturating_sub(w));
        let [fl, fr, rl, rr] = *secants;
        let (left, right) = (x.saturating_sub(turn), x.saturating_add(turn));
        single_rates(WheelRates {
            front_left: left.saturating_sub(leaning(fl, front)),
            front_right: right.saturating_add(leaning(fr, front)),
            rear_left: left.saturating_add(leaning(rl, rear)),
            rear_right: right.saturating_sub(leaning(rr, rear)),
        })
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean with these secants, and the slip residual, as
    /// [`PhaseMember::measure`].
    #[must_use]
    #[inline]
    pub fn measure(&self, rates: &WheelRates, secants: &[i32; 4]) -> (Twist, f32) {
        let WheelRates {
            front_left: fl,
            front_right: fr,
            rear_left: rl,
            rear_right: rr,
        } = fixed_rates(rates);
        let [s_fl, s_fr, s_rl, s_rr] = *secants;
        // Secants are at most 2 in 28 bits: no sum of four overflows once it is cut to SUM.
        let cut = SECANT - SUM;
        let (a, b) = ((s_fl + s_fr) >> cut, (s_rl + s_rr) >> cut);
        let (sum, difference) = (a + b, a - b);
        let wide = self.spread + sum;
        let product = |a: i32, b: i32| i64::from(a).wrapping_mul(i64::from(b));
        let determinant = product(sum, wide).wrapping_sub(product(difference, difference));
        let solve = Reciprocal::new(determinant);
        let (along, across, about) = (solve.times(wide), solve.times(difference), solve.times(sum));
        let front = fr.saturating_sub(fl);
        let rear = rl.saturating_sub(rr);
        let pairs = [front.saturating_add(rear), front.saturating_sub(rear)];
        let y = I16F16::dot::<SOLVE, true, 2>(&[along, -across], &pairs);
        let w = I16F16::dot::<SOLVE, true, 2>(&[-across, about], &pairs);
        let lean_front = leaning(s_fr - s_fl, y.saturating_add(w));
        let lean_rear = leaning(s_rl - s_rr, y.saturating_sub(w));
        let ahead = fl.saturating_add(fr).saturating_sub(lean_front);
        let behind = rl.saturating_add(rr).saturating_sub(lean_rear);
        let unknowns = [ahead.saturating_add(behind), y, w];
        let [vx, vy, omega] = I16F16::product::<TO_GROUP, true, 3, 3>(&self.to_group, &unknowns);
        (
            Twist {
                vx: single(vx),
                vy: single(vy),
                omega: single(omega),
            },
            0.5 * single(ahead.saturating_sub(behind)),
        )
    }

    /// The twist alone.
    #[must_use]
    #[inline]
    pub fn forward(&self, rates: &WheelRates, secants: &[i32; 4]) -> Twist {
        self.measure(rates, secants).0
    }

    /// The displacement of the group (group frame; m, m, rad) that these wheel-angle increments (rad) mean, with the
    /// secants at their middle; finer than [`FixedPhaseMember::forward`], for increments of up to ±8 rad.
    #[must_use]
    #[inline]
    pub fn displacement(&self, increments: &WheelRates, secants: &[i32; 4]) -> Twist {
        let scaled = <[f32; 4]>::from(*increments).map(|angle| angle * FINE);
        self.forward(&WheelRates::from(scaled), secants) * (1.0 / FINE)
    }
}

/// A value times a secant or a difference of two, to the nearest step.
#[inline]
fn leaning(secant: i32, value: I16F16) -> I16F16 {
    I16F16::dot::<SECANT, true, 1>(&[secant], &[value])
}

/// The reciprocal of a determinant.
#[derive(Clone, Copy)]
struct Reciprocal {
    /// `2^63 / determinant` once that is shifted left until its top bit is bit 31.
    value: u32,
    shift: u32,
}

impl Reciprocal {
    /// Of a number above zero with twice [`SUM`] fractional bits.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "what is cast fits by construction, as the comments say"
    )]
    #[inline]
    fn new(determinant: i64) -> Self {
        // A determinant is at least 16 (four secants of 1) and at most some thousands.
        let word = (determinant >> (2 * SUM - 20)) as u32;
        let lead = word.leading_zeros();
        let norm = word.wrapping_shl(lead) | 1;
        // Sixteen bits by division, the rest by one Newton step; from 2^31 to 2^32 - 1.
        let guess = u64::from(u32::MAX / (norm >> 16).wrapping_add(1)) << 15;
        let error = (1_u64 << 63).wrapping_sub(guess.wrapping_mul(u64::from(norm)));
        let value = guess.wrapping_add(guess.wrapping_mul(error >> 31) >> 32);
        Self {
            value: value.min(u64::from(u32::MAX)) as u32,
            shift: lead,
        }
    }

    /// A number with [`SUM`] fractional bits over the determinant, with [`SOLVE`].
    #[expect(
        clippy::cast_possible_truncation,
        reason = "at most a quarter: a sum of secants over the other sum's product with it"
    )]
    #[inline]
    fn times(self, number: i32) -> i32 {
        // 1 / determinant = 2^(20 + lead) value / 2^63.
        let product = i64::from(number).wrapping_mul(i64::from(self.value));
        (product >> (SUM + 63 - 20 - SOLVE - self.shift)) as i32
    }
}
