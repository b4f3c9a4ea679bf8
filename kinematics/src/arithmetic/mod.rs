//! The scalars of this crate and the few functions it needs of them.
//!
//! Two traits, both sealed. [`Scalar`] is what the control loop needs: a dot product with
//! coefficients that were prepared beforehand, and scaling to a limit. `f32`, `f64` and the
//! fixed-point `I16F16` are scalars. [`Real`] is what building the coefficients needs: roots,
//! sines, matrix inverses. Only `f32` and `f64` are real; fixed-point kinematics are built in one
//! of them and converted.
//!
//! Of the functions a control loop might call, `libm`'s cost too much on a Cortex-M4F and
//! `micromath`'s are too coarse; [`sin_cos`] and [`square_root`] are used instead, each with its
//! bound.

mod fixed_point;
mod float;
pub(crate) mod high_word;
mod root;
mod trig;

use core::fmt::Debug;

use nalgebra::RealField;

pub use root::square_root;
pub use trig::{SIN_COS_RANGE, sin_cos};

/// The nearest number of steps of `2^-fraction` to a float; halves go away from zero.
/// `None` for 2^62 steps or more, and for a NaN.
///
/// From the bits, in whole numbers: a core without double precision takes a multiplication, a
/// rounding and a comparison in software otherwise, and the image their routines. Not inlined: a
/// robot converts some forty numbers.
#[inline(never)]
pub(crate) const fn steps(value: f64, fraction: u32) -> Option<i64> {
    const MANTISSA: u32 = 52;
    /// Exponent, as it is stored, of a float whose mantissa counts ones.
    const ONES: u32 = 1023 + MANTISSA;
    let bits = value.to_bits();
    let stored = (bits >> MANTISSA & 0x7FF) as u32;
    let digits = (bits & ((1 << MANTISSA) - 1) | 1 << MANTISSA).cast_signed();
    let size = if stored == 0x7FF || stored + fraction >= ONES + 10 {
        return None;
    } else if stored + fraction >= ONES {
        digits << (stored + fraction - ONES)
    } else if stored + fraction + MANTISSA + 1 >= ONES {
        let shift = ONES - stored - fraction;
        (digits + (1 << (shift - 1))) >> shift
    } else {
        0
    };
    Some(if value.is_sign_negative() {
        -size
    } else {
        size
    })
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
    impl Sealed for fixed::types::I16F16 {}
}

/// A number the control loop computes with: `f32`, `f64` or `fixed::types::I16F16`. Sealed.
pub trait Scalar: Copy + PartialEq + PartialOrd + Debug + Default + sealed::Sealed {
    /// How an entry of a prepared matrix is kept.
    type Coefficient: Copy + PartialEq + Debug;

    /// Zero.
    const ZERO: Self;

    /// One.
    const ONE: Self;

    /// Prepares a matrix row; for fixed point with `SHIFT` fractional bits.
    ///
    /// `None` when the row does not fit: when the magnitudes of its entries sum to more than
    /// `2^(31 - SHIFT)`. That limit is what keeps [`Scalar::dot`] from overflowing on any input.
    #[must_use]
    fn row<const SHIFT: u32, const N: usize>(entries: [f64; N]) -> Option<[Self::Coefficient; N]>;

    /// The smallest step between two values; 0 for floating point, whose steps are relative.
    const RESOLUTION: f64;

    /// The smallest step between two prepared entries; 0 for floating point.
    #[must_use]
    fn coefficient_step<const SHIFT: u32>() -> f64;

    /// A prepared row times a vector. Fixed point cuts the result to its resolution once, to the
    /// nearest value with `ROUND` and downwards without (which is cheaper), and saturates.
    #[must_use]
    fn dot<const SHIFT: u32, const ROUND: bool, const N: usize>(
        row: &[Self::Coefficient; N],
        vector: &[Self; N],
    ) -> Self;

    /// Prepared rows times a vector, as [`Scalar::dot`] for each.
    #[must_use]
    #[inline]
    fn product<const SHIFT: u32, const ROUND: bool, const N: usize, const M: usize>(
        rows: &[[Self::Coefficient; N]; M],
        vector: &[Self; N],
    ) -> [Self; M] {
        let mut results = [Self::ZERO; M];
        for (result, row) in results.iter_mut().zip(rows) {
            *result = Self::dot::<SHIFT, ROUND, N>(row, vector);
        }
        results
    }

    /// Whether this value stands at the end of its range (in fixed point: in the last sixteenth of
    /// a unit of it), so that the true one may lie beyond it. For floating point: whether it is
    /// infinite or NaN.
    #[must_use]
    fn is_saturated(self) -> bool;

    /// Scales all values by one factor in 0 to 1 so that none exceeds `limit` in magnitude; returns
    /// that factor. A limit that is not positive, or a NaN anywhere, yields zeros and the factor 0.
    #[must_use]
    fn limit<const N: usize>(values: [Self; N], limit: Self) -> ([Self; N], Self);

    /// The nearest value to an `f64`; fixed point saturates.
    #[must_use]
    fn constant(value: f64) -> Self;

    /// The value as an `f64`, exactly.
    #[must_use]
    fn widen(self) -> f64;
}

/// A whole turn in units of 2^-61 rad.
pub const TURN_UNITS: u64 = 14_488_038_916_154_245_684;

/// Turns below this take [`Real::small_chord`], rad.
pub const SMALL_TURN: f64 = 0.125;

/// Chord of an arc over the arc's length, for a turn of a.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chord<S> {
    /// Along the initial direction: (sin a)/a.
    pub along: S,
    /// To its left: (1 - cos a)/a.
    pub across: S,
}

/// A floating-point scalar, `f32` or `f64`. Sealed.
pub trait Real: Scalar<Coefficient = Self> + RealField {
    /// Sine and cosine of an angle in rad.
    ///
    /// For `f32` this is [`sin_cos`], with its bound and its range.
    #[must_use]
    fn sine_cosine(self) -> (Self, Self);

    /// Square root; zero for what is negative. For `f32` this is [`square_root`].
    #[must_use]
    fn root(self) -> Self;

    /// Sine and cosine of an angle that is known to lie within ±8 rad.
    #[must_use]
    fn heading_sine_cosine(self) -> (Self, Self);

    /// Chord of an arc with this turn, which is less than [`SMALL_TURN`], as far as the scalar has
    /// digits.
    #[must_use]
    fn small_chord(self) -> Chord<Self>;

    /// Whole units of 2^-61 (an exact conversion for magnitudes below 4, as far as the bits go).
    #[must_use]
    fn to_units(self) -> i64;

    /// What an angle of any size is beyond whole turns, 0 to 2 pi, in units of 2^-61; 0 for what is
    /// no number.
    #[must_use]
    fn turn_units(self) -> u64;

    /// The nearest value to a number of units of 2^-61, to 2^-29 for `f32`.
    #[must_use]
    fn from_units(units: i64) -> Self;

    /// A number of steps of 2^-32, so within ± a half.
    #[must_use]
    fn from_fraction(steps: i32) -> Self;

    /// What a number is beyond the nearest whole one, in steps of 2^-32; a half may come out as
    /// either end. 0 for what is no number.
    #[must_use]
    fn to_fraction(self) -> i32;
}

#[cfg(test)]
mod tests {
    use super::steps;

    /// Every exponent, mantissas that end in halves, each sign: as a multiplication and a rounding.
    #[test]
    fn steps_are_the_nearest() {
        for exponent in 0..0x7FF_u64 {
            for digits in [
                0,
                1,
                0x8_0000_0000_0000,
                0xF_FFFF_FFFF_FFFF,
                0xA_BCDE_F012_3456,
            ] {
                for fraction in [0, 1, 20, 28, 29, 40] {
                    let value = f64::from_bits(exponent << 52 | digits);
                    let wanted = libm::round(value * f64::from(2.0_f32.powi(fraction)));
                    let found = steps(value, fraction.cast_unsigned());
                    if wanted < 4_611_686_018_427_387_904.0 {
                        assert_eq!(found, Some(wanted as i64), "{value} {fraction}");
                        assert_eq!(
                            steps(-value, fraction.cast_unsigned()),
                            Some(-wanted as i64)
                        );
                    } else {
                        assert_eq!(found, None, "{value} {fraction}");
                    }
                }
            }
        }
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(steps(value, 20), None);
        }
    }
}
