//! [`super::PhaseMember`] in 32-bit fixed point, with `f32` in and out.
//!
//! Every product keeps only its upper word ([`crate::arithmetic::high_word`]), so numbers are
//! scaled for their multiplier:
//!
//! | | fractional bits | |
//! |---|---|---|
//! | twist asked for | 25 | ends at ±64 m/s and rad/s |
//! | secant | 29 | below 4 |
//! | sideways parts (front, rear) | 14 or more | as the robot's matrix leaves room for, see [`Folded`] |
//! | wheel rates out | 3 less | a product with a secant has that many less |
//! | wheel rates in and their sums | 16 | saturate at ±32768 rad/s |
//! | a pair's secants with k | 27 | below 16 |
//! | determinant | 22 | 4 to 105, as each secant is at least 1 |
//! | its reciprocal | 32 | |
//! | what a pair's rates are multiplied with | 32 | below a half |
//! | twist found | as the robot's matrix leaves room for | |
//!
//! Results of the forward direction saturate where a sum of rates can leave its range, and never
//! wrap.
//!
//! # Error
//!
//! Rates: two and a half of their steps, which are at most 2^-21 of the largest rate that all axes
//! at one unit ask for, and 2^-25 of input times the row. For wheels of 0.15 m that is 1e-5 rad/s
//! on the robot itself.
//!
//! Twist: half a step of 2^-16 rad/s for each rate and each sum, 2^-14 rad/s for what leans, times
//! what a rate means on that axis; three halves of its own step, which is at most 2^-15 of the sum
//! of the longest row; and 2^-24 of itself from the reciprocal and the determinant. The
//! reciprocal's seed is good to 2^-13 (16 bits of the determinant, 14 of the quotient) and its one
//! Newton step squares that.

use super::angle::RollerAngle;
use super::member::PhaseMember;
use super::secant::Secant;
use crate::arithmetic::high_word::{dot, minus_product, plus_product, product};
use crate::arithmetic::{Real, Scalar, steps};
use crate::compensation::VelocityCompensation;
use crate::error::GeometryError;
use crate::fixed_member::{BELOW_HALF, FINE};
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::Twist;
use crate::kinematics::AtPhase;
use crate::mount::Mount;

/// Fractional bits, as in the table above.
const TWIST: u32 = 25;
const RATE: u32 = 16;
const SUM: u32 = 27;
/// Of the higher coefficients of a secant's polynomial, which at three rollers pass 16.
const POWERS: u32 = 26;
/// What a product with a secant has less.
const LEAN: u32 = 32 - FixedSecant::FRACTION;
/// Left over by the reciprocal, so that what is multiplied with it has 32 fractional bits.
const SOLVE: u32 = 5;

/// Largest secant, with room for what the polynomial is off by at three rollers.
const SECANT_MAX: f64 = 2.01;
/// What [`PhaseMember`] calls k: large enough for a pair's own part to stay below a half, small
/// enough to fit beside the secants of a pair.
const HALF_TRACK_MIN: f64 = 1e-3;
const HALF_TRACK_MAX: f64 = 11.0;
/// Fewest fractional bits of a wheel rate. The wheel is so small then that a step is some 1e-5 m/s
/// at its rim.
const RATE_MIN: u32 = 11;

/// [`Secant`] in fixed point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FixedSecant {
    powers: [i32; 4],
    unknown: i32,
}

impl FixedSecant {
    /// Fractional bits of a secant.
    pub const FRACTION: u32 = 29;

    /// The same rollers in fixed point.
    ///
    /// # Errors
    ///
    /// [`GeometryError::Range`] when a coefficient does not fit, which no wheel of three rollers or
    /// more causes.
    pub fn new<S: Real>(secant: &Secant<S>) -> Result<Self, GeometryError> {
        let [k0, k1, k2, k3] = secant.powers().map(Scalar::widen);
        let higher = |value| scaled(value, POWERS);
        Ok(Self {
            powers: [
                scaled(k0, Self::FRACTION)?,
                higher(k1)?,
                higher(k2)?,
                higher(k3)?,
            ],
            unknown: scaled(secant.unknown().widen(), Self::FRACTION)?,
        })
    }

    /// `sec(sweep)`, with [`FixedSecant::FRACTION`] fractional bits.
    #[must_use]
    #[inline]
    pub const fn at(&self, angle: RollerAngle) -> i32 {
        let x = angle.to_bits();
        // At most 2^30: a quarter, with 32 fractional bits.
        let z = product(x, x);
        let [k0, k1, k2, k3] = self.powers;
        let sum = plus_product(k1, z, plus_product(k2, z, k3));
        k0.wrapping_add(product(z, sum) << (Self::FRACTION - POWERS))
    }

    /// What stands for the secant of a wheel whose angle is not known, with as many fractional
    /// bits.
    #[must_use]
    pub const fn unknown(&self) -> i32 {
        self.unknown
    }
}

/// A number as an integer with that many fractional bits.
fn scaled(value: f64, fraction: u32) -> Result<i32, GeometryError> {
    steps(value, fraction)
        .and_then(|wide| i32::try_from(wide).ok())
        .filter(|bits| bits.unsigned_abs() < i32::MAX.unsigned_abs())
        .ok_or(GeometryError::Range)
}

/// Rows of a matrix with as many fractional bits as leave room for their products.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Folded<const M: usize> {
    rows: [[i32; 3]; M],
    /// A step of the result, a power of two.
    step: f32,
}

/// The most fractional bits with which nothing of this size reaches 2^32; `None` below `least`.
#[inline(never)]
fn fraction<S: Scalar>(size: S, least: u32) -> Option<u32> {
    // Magnitudes in the order of their bits; a NaN is above all of them.
    let size = size.widen().to_bits();
    (least..=40)
        .rev()
        .find(|bits| size < u64::from(1023 + 32 - bits) << 52)
}

/// The size of what a row gives when no input exceeds 2^31, over 2^31; and of its largest
/// coefficient, which has to fit an `i32`.
#[inline(never)]
fn size<S: Real>(row: &[S; 3]) -> S {
    let [a, b, c] = row.map(|entry| if entry < S::ZERO { -entry } else { entry });
    let most = larger(larger(a, b), c);
    larger(a + b + c, most + most)
}

/// The larger of two magnitudes.
fn larger<S: Scalar>(a: S, b: S) -> S {
    if a < b { b } else { a }
}

/// [`PhaseMember`] in 32-bit fixed point, with `f32` in and out.
///
/// ```
/// use mecanum_kinematics::{
///     FixedPhaseMember, FixedSecant, FourWheelGeometry, Mount, RollerAngle, Rollers, Secant,
///     Twist,
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
    /// Left, right, front, rear: X - B, X + B, Y + W, Y - W.
    to_wheels: Folded<4>,
    /// vx, vy, omega for a unit of 4 X, F, R.
    to_group: Folded<3>,
    /// B for a unit of W, with [`SUM`] fractional bits.
    half_track: i32,
    /// Its square with the opposite sign, as a product of two sums.
    minus_square: i32,
}

impl FixedPhaseMember {
    /// Fractional bits of the twist that [`FixedPhaseMember::inverse_bits`] takes.
    pub const TWIST_FRACTION: u32 = TWIST;
    /// Fractional bits of the rates that [`FixedPhaseMember::measure_bits`] takes.
    pub const RATE_FRACTION: u32 = RATE;

    /// Folds geometry, mount and compensation in floating point and keeps the result in fixed
    /// point.
    ///
    /// # Errors
    ///
    /// As [`PhaseMember::new`], and [`GeometryError::Range`] when steps of a wheel rate would be
    /// coarser than 2^-11 rad/s, which takes some 2000 rad/s of one wheel for 1 m/s or 1 rad/s of
    /// the group; or for a track that is out of all proportion to the wheelbase: more than eleven
    /// times as wide at 45 degrees, or less than a thousandth.
    pub fn new<S: Real>(
        geometry: &FourWheelGeometry<S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        let member = PhaseMember::new(geometry, mount, compensation)?;
        let half_track = member.half_track();
        if !(S::constant(HALF_TRACK_MIN)..=S::constant(HALF_TRACK_MAX)).contains(&half_track) {
            return Err(GeometryError::Range);
        }
        let half_track = scaled(half_track.widen(), SUM)?;
        Ok(Self {
            to_wheels: to_wheels(&member)?,
            to_group: to_group(&member)?,
            half_track,
            minus_square: minus_product(0, half_track, half_track),
        })
    }

    /// This member while its wheels have these secants ([`FixedSecant::FRACTION`] fractional bits),
    /// front left to rear right, as a [`Kinematics`](crate::Kinematics).
    #[must_use]
    pub const fn at(&self, secants: [i32; 4]) -> AtPhase<'_, Self, i32> {
        AtPhase {
            member: self,
            secants,
        }
    }

    /// Wheel rates (rad/s) that make the group move with this twist (group frame; each component
    /// within ±64) while the wheels have these secants ([`FixedSecant::FRACTION`] fractional bits).
    #[must_use]
    #[inline]
    pub fn inverse(&self, group: Twist, secants: &[i32; 4]) -> WheelRates {
        const STEPS: f32 = (1 << TWIST) as f32;
        let twist = [group.vx, group.vy, group.omega].map(|value| cut(value, STEPS));
        let step = self.to_wheels.step;
        let rates = self.inverse_bits(twist, secants);
        rates.map(|rate| single(rate, step)).into()
    }

    /// [`FixedPhaseMember::inverse`] in whole numbers: a twist with
    /// [`FixedPhaseMember::TWIST_FRACTION`] fractional bits, and rates with
    /// [`FixedPhaseMember::rates_fraction`].
    #[must_use]
    #[inline]
    pub fn inverse_bits(&self, twist: [i32; 3], secants: &[i32; 4]) -> [i32; 4] {
        let [left, right, front, rear] = &self.to_wheels.rows;
        let (left, right) = (dot(left, &twist), dot(right, &twist));
        let (front, rear) = (dot(front, &twist), dot(rear, &twist));
        let [fl, fr, rl, rr] = *secants;
        [
            minus_product(left, fl, front),
            plus_product(right, fr, front),
            plus_product(left, rl, rear),
            minus_product(right, rr, rear),
        ]
    }

    /// Fractional bits of the rates that [`FixedPhaseMember::inverse_bits`] gives.
    #[must_use]
    #[inline]
    pub const fn rates_fraction(&self) -> u32 {
        fraction_of(self.to_wheels.step)
    }

    /// Fractional bits of the twist that [`FixedPhaseMember::measure_bits`] gives.
    #[must_use]
    #[inline]
    pub const fn twist_fraction(&self) -> u32 {
        fraction_of(self.to_group.step)
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean with these secants, and the
    /// slip residual, as [`PhaseMember::measure`].
    #[must_use]
    #[inline]
    pub fn measure(&self, rates: &WheelRates, secants: &[i32; 4]) -> (Twist, f32) {
        const STEPS: f32 = (1 << RATE) as f32;
        let rates = <[f32; 4]>::from(*rates).map(|rate| nearest(rate, STEPS));
        let ([vx, vy, omega], residual) = self.measure_bits(rates, secants);
        let step = self.to_group.step;
        let twist = Twist {
            vx: single(vx, step),
            vy: single(vy, step),
            omega: single(omega, step),
        };
        (twist, single(residual, 0.5 / STEPS))
    }

    /// [`FixedPhaseMember::measure`] in whole numbers: rates with
    /// [`FixedPhaseMember::RATE_FRACTION`] fractional bits, a twist with
    /// [`FixedPhaseMember::twist_fraction`], and the residual with one more than the rates. With
    /// more bits of the rates, or of angles, both results have as many more.
    #[must_use]
    #[inline]
    pub fn measure_bits(&self, rates: [i32; 4], secants: &[i32; 4]) -> ([i32; 3], i32) {
        let [fl, fr, rl, rr] = rates;
        let [s_fl, s_fr, s_rl, s_rr] = *secants;
        // Two secants fill 31 bits, and at three rollers a little more.
        let pair = |a: i32, b: i32| {
            let sum = a.cast_unsigned().wrapping_add(b.cast_unsigned());
            let sum = sum >> (FixedSecant::FRACTION - SUM);
            self.half_track.wrapping_add(sum.cast_signed())
        };
        let (a, b) = (pair(s_fl, s_fr), pair(s_rl, s_rr));
        let inverse = reciprocal(plus_product(self.minus_square, a, b));
        let [own_front, own_rear, other] =
            [b, a, self.half_track].map(|entry| product(entry, inverse) << SOLVE);
        let (front, rear) = (fr.saturating_sub(fl), rl.saturating_sub(rr));
        let front_side = plus_product(product(front, own_front), rear, other);
        let rear_side = plus_product(product(rear, own_rear), front, other);
        // Both are at most half of the rates' range, so what uneven secants make of them does not
        // overflow.
        let lean = |secants: i32, side: i32| product(secants, side) << LEAN;
        let lean_front = lean(s_fr.wrapping_sub(s_fl), front_side);
        let lean_rear = lean(s_rl.wrapping_sub(s_rr), rear_side);
        let ahead = fl.saturating_add(fr).saturating_sub(lean_front);
        let behind = rl.saturating_add(rr).saturating_sub(lean_rear);
        let unknowns = [ahead.saturating_add(behind), front_side, rear_side];
        let [vx, vy, omega] = &self.to_group.rows;
        let twist = [
            dot(vx, &unknowns),
            dot(vy, &unknowns),
            dot(omega, &unknowns),
        ];
        (twist, ahead.saturating_sub(behind))
    }

    /// The twist alone.
    #[must_use]
    #[inline]
    pub fn forward(&self, rates: &WheelRates, secants: &[i32; 4]) -> Twist {
        self.measure(rates, secants).0
    }

    /// The displacement of the group (group frame; m, m, rad) that these wheel-angle increments
    /// (rad) mean, with the secants at their middle; finer than [`FixedPhaseMember::forward`], for
    /// increments of up to ±8 rad.
    #[must_use]
    #[inline]
    pub fn displacement(&self, increments: &WheelRates, secants: &[i32; 4]) -> Twist {
        const STEPS: f32 = FINE * (1 << RATE) as f32;
        let increments = <[f32; 4]>::from(*increments).map(|angle| nearest(angle, STEPS));
        let ([vx, vy, omega], _) = self.measure_bits(increments, secants);
        let step = self.to_group.step * (1.0 / FINE);
        Twist {
            vx: single(vx, step),
            vy: single(vy, step),
            omega: single(omega, step),
        }
    }
}

fn to_wheels<S: Real>(member: &PhaseMember<S>) -> Result<Folded<4>, GeometryError> {
    let (x, y, w, turn) = member.rows();
    let sum = |[a, b, c]: [S; 3], [d, e, f]: [S; 3]| [a + d, b + e, c + f];
    let (left, right) = (sum(x, turn.map(|entry| -entry)), sum(x, turn));
    let (front, rear) = (sum(y, w), sum(y, w.map(|entry| -entry)));
    // What turns with the wheel has `LEAN` bits less, in which the whole rate has to fit.
    let sideways = larger(size(&front), size(&rear));
    let rate = larger(size(&left), size(&right)) + S::constant(SECANT_MAX) * sideways;
    let part = rate * S::constant(const { 1.0 / (1 << LEAN) as f64 });
    let least = 32 + LEAN + RATE_MIN - TWIST;
    let bits = fraction(larger(sideways, part), least).ok_or(GeometryError::Range)?;
    let row = |row: [S; 3], bits: u32| {
        let [a, b, c] = row.map(Scalar::widen);
        Ok([scaled(a, bits)?, scaled(b, bits)?, scaled(c, bits)?])
    };
    Ok(Folded {
        rows: [
            row(left, bits - LEAN)?,
            row(right, bits - LEAN)?,
            row(front, bits)?,
            row(rear, bits)?,
        ],
        step: step(bits + TWIST - 32 - LEAN),
    })
}

fn to_group<S: Real>(member: &PhaseMember<S>) -> Result<Folded<3>, GeometryError> {
    let rows = member.rows_back();
    let largest = rows.iter().map(size).fold(S::ZERO, larger);
    let bits = fraction(largest, 32 - RATE).ok_or(GeometryError::Range)?;
    let [vx, vy, omega] = rows;
    let row = |row: &[S; 3]| {
        let [a, b, c] = row.map(Scalar::widen);
        Ok([scaled(a, bits)?, scaled(b, bits)?, scaled(c, bits)?])
    };
    Ok(Folded {
        rows: [row(vx)?, row(vy)?, row(omega)?],
        step: step(bits + RATE - 32),
    })
}

/// A step of a number with that many fractional bits, at most 126.
const fn step(bits: u32) -> f32 {
    f32::from_bits(127_u32.wrapping_sub(bits) << 23)
}

/// The fractional bits of a number with that step.
const fn fraction_of(step: f32) -> u32 {
    127_u32.wrapping_sub(step.to_bits() >> 23)
}

/// Whole steps, towards zero; the ends for what lies beyond, zero for a NaN.
#[expect(clippy::cast_possible_truncation, reason = "the cast saturates")]
#[inline]
fn cut(value: f32, steps: f32) -> i32 {
    (value * steps) as i32
}

/// The nearest step, halves away from zero; the ends for what lies beyond, zero for a NaN.
#[inline]
fn nearest(value: f32, steps: f32) -> i32 {
    cut(value * steps + BELOW_HALF.copysign(value), 1.0)
}

#[expect(
    clippy::cast_precision_loss,
    reason = "rounded to the 24 bits an f32 has"
)]
#[inline]
fn single(value: i32, step: f32) -> f32 {
    value as f32 * step
}

/// `2^54` over a determinant of 2^24 to 2^29.
#[inline]
const fn reciprocal(determinant: i32) -> i32 {
    // The lowest bit is set: half a step on average, and never zero.
    let divisor = determinant.cast_unsigned() >> 10 | 1;
    let quotient = (u32::MAX / divisor).cast_signed();
    // Of `determinant quotient = 2^42 (1 - error)` the lower word is all that is not known
    // beforehand: the error is below 2^-11.
    let error = determinant.wrapping_mul(quotient);
    let guess = quotient << 12;
    guess.wrapping_sub(product(guess, error) >> 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Halves away from zero, and whole numbers as they are: from 2^23 on there are no others.
    #[test]
    fn the_nearest_step_is_the_nearest() {
        let below_half = f32::from_bits(0.5_f32.to_bits() - 1);
        for (value, wanted) in [
            (below_half, 0),
            (0.5, 1),
            (1.5, 2),
            (8_388_607.5, 8_388_608),
            (8_388_609.0, 8_388_609),
            (16_777_215.0, 16_777_215),
        ] {
            assert_eq!(nearest(value / 1024.0, 1024.0), wanted, "{value}");
            assert_eq!(nearest(-value / 1024.0, 1024.0), -wanted, "-{value}");
        }
    }

    /// 2^-26 of itself, and half a step.
    #[test]
    fn reciprocal_is_as_good_as_it_says() {
        for step in 0..100_000 {
            // 4 to 105, evenly on a logarithmic scale.
            let determinant = scaled(4.0 * 26.25_f64.powf(f64::from(step) / 1e5), 22).unwrap();
            let exact = 18_014_398_509_481_984.0 / f64::from(determinant);
            let error = f64::from(reciprocal(determinant)) - exact;
            assert!(
                error.abs() < exact / 67_108_864.0 + 0.5,
                "{determinant}: {error}"
            );
        }
    }
}
