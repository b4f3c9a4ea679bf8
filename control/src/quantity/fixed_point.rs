//! Quantities in 32-bit fixed point: an integer and a number of fractional bits that is a constant.
//!
//! Products are exact in 64 bits, rounded to the nearest once, and saturated once. With 32
//! fractional bits less than both factors together, the result is the upper word of the product and
//! always fits: the quantities of this crate are scaled so that most products are of this kind.

mod steps;

use core::ops::{Add, AddAssign, Neg, Sub, SubAssign};

use fixed::types::I16F16;

use super::root::reciprocal;
use super::{Angle, AngleGain, Duration, PerSecond, Ratio, Time, Voltage};

pub use steps::{Steps, polar};

/// A number with that many fractional bits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
#[repr(transparent)]
pub struct Quantity<const FRACTION: u32>(i32);

impl<const FRACTION: u32> Quantity<FRACTION> {
    /// How many fractional bits it has in fixed point.
    pub const FRACTION: u32 = FRACTION;
    /// Nothing.
    pub const ZERO: Self = Self(0);
    /// The largest.
    pub const MAX: Self = Self(i32::MAX);
    /// The smallest.
    pub const MIN: Self = Self(i32::MIN);

    /// Whether this value is within the range.
    #[must_use]
    pub const fn holds(value: f32) -> bool {
        value.abs() * const { (1_u64 << FRACTION) as f32 } < const { (1_u32 << 31) as f32 }
    }

    /// The nearest to a float; the ends for what lies beyond, zero for a NaN.
    #[must_use]
    pub const fn new(value: f32) -> Self {
        Self(nearest(value, const { FRACTION as i32 }))
    }

    /// As a float, to the 24 bits that it has.
    #[must_use]
    pub const fn to_f32(self) -> f32 {
        // The division by a power of two is a subtraction from the exponent.
        let bits = (self.0 as f32).to_bits();
        f32::from_bits(if self.0 == 0 {
            0
        } else {
            bits.wrapping_sub(const { FRACTION << 23 })
        })
    }

    /// The integer.
    pub(crate) const fn to_bits(self) -> i32 {
        self.0
    }

    /// From the integer.
    pub(crate) const fn from_bits(bits: i32) -> Self {
        Self(bits)
    }

    /// From an integer with so many fractional bits, to the nearest.
    #[inline]
    pub(crate) const fn resampled(bits: i32, fraction: u32) -> Self {
        if fraction > FRACTION {
            let shift = fraction - FRACTION;
            // A number that is shifted has room for half a step.
            let half = (bits >> (shift - 1)) & 1;
            return Self((bits >> shift) + half);
        }
        let shift = FRACTION - fraction;
        let (most, least) = (i32::MAX >> shift, i32::MIN >> shift);
        if bits > most {
            Self(i32::MAX)
        } else if bits < least {
            Self(i32::MIN)
        } else {
            Self(bits << shift)
        }
    }

    /// The number as the kinematics take it. They are linear and leave its scale as it is.
    #[must_use]
    #[inline(always)]
    pub const fn scalar(self) -> I16F16 {
        I16F16::from_bits(self.0)
    }

    /// The number as the kinematics give it.
    #[must_use]
    #[inline(always)]
    pub const fn from_scalar(value: I16F16) -> Self {
        Self(value.to_bits())
    }

    /// The magnitude.
    #[must_use]
    #[inline(always)]
    pub const fn abs(self) -> Self {
        // That of the least does not fit and comes out negative: one less is the largest.
        let magnitude = self.0.wrapping_abs();
        Self(magnitude.wrapping_sub((magnitude.cast_unsigned() >> 31).cast_signed()))
    }

    /// Half of it.
    #[must_use]
    #[inline(always)]
    pub const fn half(self) -> Self {
        Self(self.0 >> 1)
    }

    /// The larger one.
    #[must_use]
    #[inline(always)]
    pub const fn max(self, other: Self) -> Self {
        Self(if self.0 > other.0 { self.0 } else { other.0 })
    }

    /// The smaller one.
    #[must_use]
    #[inline(always)]
    pub const fn min(self, other: Self) -> Self {
        Self(if self.0 < other.0 { self.0 } else { other.0 })
    }

    /// The value, or zero where it is negative.
    #[must_use]
    #[inline(always)]
    pub const fn not_below_zero(self) -> Self {
        Self(self.0 & !(self.0 >> 31))
    }

    /// Whether both are positive or both negative.
    #[must_use]
    #[inline(always)]
    pub const fn agrees<const OTHER: u32>(self, other: Quantity<OTHER>) -> bool {
        self.0 != 0 && other.0 != 0 && (self.0 ^ other.0) >= 0
    }

    /// The product, to the nearest.
    #[must_use]
    #[inline(always)]
    pub const fn times<const OTHER: u32, const RESULT: u32>(
        self,
        other: Quantity<OTHER>,
    ) -> Quantity<RESULT> {
        let shift = const { FRACTION + OTHER - RESULT };
        Quantity(narrow(self.0 as i64 * other.0 as i64, shift))
    }

    /// One over it; it is above zero. Ends at 16.
    #[must_use]
    #[inline(always)]
    pub const fn inverse(self) -> Ratio {
        // Bits of the result by bits of the number have as many fractional ones.
        let fraction = const { FRACTION + Ratio::FRACTION };
        let (mantissa, shift) = reciprocal(self.0.cast_unsigned());
        let bits = if shift < fraction {
            u32::MAX
        } else {
            mantissa >> (shift - fraction)
        };
        Quantity(if bits > i32::MAX as u32 {
            i32::MAX
        } else {
            bits.cast_signed()
        })
    }

    /// As far from this number to another as a share says, 0 to 2; neither is negative.
    #[must_use]
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "at most twice the difference"
    )]
    pub const fn toward(self, other: Self, share: Ratio) -> Self {
        let way = other.0.wrapping_sub(self.0) as i64 * share.0 as i64;
        Self(self.0.wrapping_add((way >> Ratio::FRACTION) as i32))
    }

    /// So many of it.
    #[must_use]
    #[inline(always)]
    pub const fn many(self, count: u16) -> Self {
        Self(self.0.saturating_mul(count as i32))
    }

    /// The same in another resolution.
    #[must_use]
    #[inline(always)]
    pub const fn to<const RESULT: u32>(self) -> Quantity<RESULT> {
        if const { RESULT > FRACTION } {
            let shift = const { RESULT.saturating_sub(FRACTION) };
            let (most, least) = (i32::MAX >> shift, i32::MIN >> shift);
            let within = if self.0 > most {
                most
            } else if self.0 < least {
                least
            } else {
                self.0
            };
            Quantity(within << shift)
        } else {
            Quantity(self.0 >> const { FRACTION.saturating_sub(RESULT) })
        }
    }
}

/// The nearest number of steps of `2^-fraction` to a float, from the bits of the float: without a
/// floating-point unit that takes a tenth of a multiplication, an addition and a conversion. Not
/// inlined: a configuration converts some hundred numbers.
#[expect(
    clippy::cast_possible_wrap,
    reason = "less than 2^24, or shifted to less than 2^31"
)]
#[inline(never)]
const fn nearest(value: f32, fraction: i32) -> i32 {
    /// Exponent of a float whose digits are whole steps of 1.
    const WHOLE: i32 = 127 + 23;
    let bits = value.to_bits();
    let exponent = ((bits >> 23) & 0xFF) as i32;
    let digits = (bits & 0x007F_FFFF) | 0x0080_0000;
    let shift = exponent.wrapping_sub(WHOLE - fraction);
    let steps = if shift >= 8 {
        if value.is_nan() {
            return 0;
        }
        return if value < 0.0 { i32::MIN } else { i32::MAX };
    } else if shift >= 0 {
        digits << shift
    } else if shift >= -24 {
        let half = 1 << (-shift - 1);
        (digits + half) >> -shift
    } else {
        0
    };
    let sign = bits.cast_signed() >> 31;
    (steps as i32 ^ sign).wrapping_sub(sign)
}

/// A product with `shift` fractional bits less, 1 to 62, to the nearest.
///
/// What does not fit is saturated by its upper word, which a Cortex-M does in one instruction; the
/// lower one is left as it is, so a saturated number lies within `2^(32 - shift)` steps of the end.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the halves of a word, or known to fit"
)]
#[inline(always)]
const fn narrow(product: i64, shift: u32) -> i32 {
    // The magnitude of a product is at most 2^62.
    let rounded = product.wrapping_add(1 << (shift - 1));
    if shift >= 32 {
        return (rounded >> shift) as i32;
    }
    let most = (1_i32 << (shift - 1)) - 1;
    let high = (rounded >> 32) as i32;
    let high = if high > most {
        most
    } else if high < -most - 1 {
        -most - 1
    } else {
        high
    };
    let low = (rounded as u32) >> shift;
    (high << (32 - shift)) | low.cast_signed()
}

impl<const FRACTION: u32> Add for Quantity<FRACTION> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl<const FRACTION: u32> Sub for Quantity<FRACTION> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl<const FRACTION: u32> Neg for Quantity<FRACTION> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl<const FRACTION: u32> AddAssign for Quantity<FRACTION> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const FRACTION: u32> SubAssign for Quantity<FRACTION> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl Time {
    /// So many microseconds, at most 31 250.
    #[must_use]
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "compared before")]
    pub const fn from_micros(micros: u32) -> Self {
        /// Steps of a microsecond, with 16 more fractional bits.
        const STEPS: u64 = (1 << (36 + 16)) / 1_000_000;
        if micros >= 31_250 {
            return Self::MAX;
        }
        Self(((micros as u64 * STEPS) >> 16) as i32)
    }
}

impl Duration {
    /// So many microseconds, at most half an hour.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        /// Steps of a microsecond, with 32 more fractional bits.
        const STEPS: u64 = (1 << (20 + 32)) / 1_000_000;
        let micros = if micros < 1_800_000_000 {
            micros
        } else {
            1_800_000_000
        };
        Self((micros.wrapping_mul(STEPS) >> 32) as i32)
    }
}

impl PerSecond {
    /// One over so many microseconds, at least 123.
    #[must_use]
    #[inline(always)]
    pub const fn of_micros(micros: u32) -> Self {
        // 1e6 with 18 fractional bits takes 38; a division of 32 bits leaves a remainder for the
        // last six.
        let whole = (1_000_000 << 12) / micros;
        let rest = (1_000_000 << 12) % micros;
        let bits = (whole << 6) | ((rest << 6) / micros);
        Self(if bits > i32::MAX as u32 {
            i32::MAX
        } else {
            bits.cast_signed()
        })
    }
}

/// The parts of a span of time.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Part {
    /// One over it, with 31 significant bits.
    mantissa: u32,
    shift: u32,
}

impl Part {
    /// Of so many microseconds.
    #[must_use]
    pub const fn of(micros: u32) -> Self {
        let (mantissa, shift) = reciprocal(micros);
        Self { mantissa, shift }
    }

    /// Which part so many microseconds of them are.
    #[must_use]
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "at most 2^27")]
    pub const fn at(self, micros: u32) -> Ratio {
        let product = micros as u64 * self.mantissa as u64;
        Quantity((product >> (self.shift - Ratio::FRACTION)) as i32)
    }
}

/// Whether any of some numbers is at an end of its range, where what does not fit stays: in the
/// last thousandth of it, because a saturated product may lie that far from the end.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Ends(u32);

impl Ends {
    /// No number yet.
    pub const NONE: Self = Self(0);

    /// A 1024th of the range, which carries a magnitude at the end into the sign.
    const MARGIN: u32 = 1 << 21;

    /// Looks at one more number, in three instructions.
    #[inline(always)]
    pub const fn note<const FRACTION: u32>(&mut self, value: Quantity<FRACTION>) {
        let magnitude = (value.0 ^ (value.0 >> 31)).cast_unsigned();
        self.0 |= magnitude.wrapping_add(Self::MARGIN);
    }

    /// Whether one was there.
    #[must_use]
    #[inline(always)]
    pub const fn reached(self) -> bool {
        self.0 >> 31 == 1
    }
}

/// A sign, and nothing else of a number.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Sign(i32);

impl Sign {
    /// That of a number which is not zero.
    #[must_use]
    pub const fn new(value: f32) -> Self {
        Self(if value < 0.0 { -1 } else { 0 })
    }

    /// A number with its own sign times this one.
    #[must_use]
    #[inline(always)]
    pub const fn times<const FRACTION: u32>(self, value: Quantity<FRACTION>) -> Quantity<FRACTION> {
        // The least of all is never reached: a voltage's own bound is far below.
        Quantity((value.0 ^ self.0).wrapping_sub(self.0))
    }
}

/// Half of a number, with the sign of another.
#[derive(Clone, Copy)]
pub struct Half(i32);

impl Half {
    /// Positive along this number.
    #[must_use]
    #[inline(always)]
    pub const fn along<const FRACTION: u32>(direction: Quantity<FRACTION>) -> Self {
        Self(direction.0 >> 31)
    }

    /// Half of this number along the other.
    #[must_use]
    #[inline(always)]
    pub const fn of<const FRACTION: u32>(self, value: Quantity<FRACTION>) -> Quantity<FRACTION> {
        // The half fits with either sign.
        Quantity(((value.0 >> 1) ^ self.0).wrapping_sub(self.0))
    }
}

/// The angle of an encoder's count, rad, with its sign: 31 bits, however small it is, because an
/// error here is one of the scale of all distances.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Count {
    mantissa: i32,
    /// Fractional bits of the mantissa beyond those of an [`Angle`].
    shift: u32,
}

impl Count {
    /// For this angle, rad: at least 2^-30, and less than the 16 that an [`Angle`] can hold.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the cast saturates")]
    pub fn new(step: f32) -> Self {
        let mut steps = step * const { (1_u64 << 27) as f32 };
        let mut shift = 0;
        while steps.abs() < const { (1_u64 << 30) as f32 } && shift < 30 {
            steps *= 2.0;
            shift += 1;
        }
        Self {
            mantissa: steps as i32,
            shift,
        }
    }

    /// The angle of so many counts, to the nearest.
    #[must_use]
    #[inline(always)]
    pub fn turned(self, counts: i16) -> Angle {
        let wide = i64::from(self.mantissa).wrapping_mul(i64::from(counts));
        let rounded = wide.wrapping_add((1 << self.shift) >> 1) >> self.shift;
        Quantity(saturate(rounded))
    }
}

#[inline(always)]
fn saturate(wide: i64) -> i32 {
    i32::try_from(wide).unwrap_or(if wide < 0 { i32::MIN } else { i32::MAX })
}

/// A voltage that grows by a gain times the angle by which a wheel is behind.
///
/// It keeps the whole products, so that nothing is lost of the smallest error.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Integral(i64);

impl Integral {
    /// Nothing.
    pub const ZERO: Self = Self(0);

    /// The voltage: the upper word.
    #[must_use]
    #[inline(always)]
    pub const fn voltage(self) -> Voltage {
        Quantity((self.0 >> 32) as i32)
    }

    /// Adds a gain times an angle.
    #[inline(always)]
    pub const fn add(&mut self, gain: AngleGain, angle: Angle) {
        self.0 = self.0.saturating_add(gain.0 as i64 * angle.0 as i64);
    }

    /// Subtracts a part of a voltage: `share` is between 0 and 1.
    #[inline(always)]
    pub const fn unwind(&mut self, excess: Voltage, share: super::Ratio) {
        // 15 and 27 fractional bits, of 47.
        let part = excess.0 as i64 * share.0 as i64;
        self.0 = self.0.saturating_sub(part.saturating_mul(1 << 5));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn converts<const FRACTION: u32>() {
        let scale = f64::from(2.0_f32.powi(FRACTION as i32));
        // Each exponent, each sign, and digits that end in halves, below and above.
        for high in 0..0x200_u32 {
            for low in [0, 1, 0x1000, 0x2A_AAAA, 0x3F_FFFF, 0x40_0000, 0x7F_FFFF] {
                let value = f32::from_bits((high << 23) | low);
                // The cast saturates, and takes NaN for zero.
                let nearest = (f64::from(value) * scale).round() as i32;
                let found = Quantity::<FRACTION>::new(value);
                assert_eq!(found.0, nearest, "{value:e}");
            }
        }
        for steps in [
            0,
            1,
            -1,
            3,
            0x00FF_FFFF,
            0x0100_0001,
            i32::MAX,
            i32::MIN,
            -5_555_555,
        ] {
            let nearest = (f64::from(steps) / scale) as f32;
            assert_eq!(Quantity::<FRACTION>(steps).to_f32(), nearest, "{steps}");
        }
    }

    #[test]
    fn a_float_is_converted_to_the_nearest_step_and_back_to_the_nearest_float() {
        converts::<10>();
        converts::<15>();
        converts::<23>();
        converts::<27>();
        converts::<36>();
    }

    #[test]
    fn an_integral_has_the_bits_of_its_products() {
        let mut integral = Integral::ZERO;
        integral.add(Quantity::new(1.0), Quantity::new(1.0));
        assert_eq!(integral.0, 1 << 47);
        assert_eq!(integral.voltage(), Quantity::new(1.0));
        integral.unwind(Quantity::new(2.0), Quantity::new(0.25));
        assert_eq!(integral.voltage(), Quantity::new(0.5));
    }
}
