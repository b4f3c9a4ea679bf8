//! Quantities in single precision: every operation is the processor's own.

use core::cmp::Ordering;
use core::ops::{Add, AddAssign, Neg, Sub, SubAssign};

use kinematics::arithmetic::Real as _;

use super::{Angle, AngleGain, Duration, PerSecond, Rate, Ratio, Time, Voltage};

/// A number whose fractional bits single precision has no need of.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
#[repr(transparent)]
pub struct Quantity<const FRACTION: u32>(f32);

impl<const FRACTION: u32> Quantity<FRACTION> {
    /// How many fractional bits it has in fixed point.
    pub const FRACTION: u32 = FRACTION;
    /// Nothing.
    pub const ZERO: Self = Self(0.0);
    /// More than any.
    pub const MAX: Self = Self(f32::INFINITY);
    /// Less than any.
    pub const MIN: Self = Self(f32::NEG_INFINITY);

    /// Whether this value is within the range: single precision has room for every parameter.
    #[must_use]
    pub const fn holds(_: f32) -> bool {
        true
    }

    /// From a float.
    #[must_use]
    #[inline(always)]
    pub const fn new(value: f32) -> Self {
        Self(value)
    }

    /// As a float.
    #[must_use]
    #[inline(always)]
    pub const fn to_f32(self) -> f32 {
        self.0
    }

    /// The number as the kinematics take it.
    #[must_use]
    #[inline(always)]
    pub const fn scalar(self) -> f32 {
        self.0
    }

    /// The number as the kinematics give it.
    #[must_use]
    #[inline(always)]
    pub const fn from_scalar(value: f32) -> Self {
        Self(value)
    }

    /// The magnitude.
    #[must_use]
    #[inline(always)]
    pub const fn abs(self) -> Self {
        Self(self.0.abs())
    }

    /// Half of it.
    #[must_use]
    #[inline(always)]
    pub const fn half(self) -> Self {
        Self(0.5 * self.0)
    }

    /// The larger one.
    #[must_use]
    #[inline(always)]
    pub const fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0))
    }

    /// The smaller one.
    #[must_use]
    #[inline(always)]
    pub const fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0))
    }

    /// The value, or zero where it is negative: three instructions, a comparison of floats takes
    /// six.
    #[must_use]
    #[inline(always)]
    pub const fn not_below_zero(self) -> Self {
        let bits = self.0.to_bits().cast_signed();
        Self(f32::from_bits((bits & !(bits >> 31)).cast_unsigned()))
    }

    /// Whether both are positive or both negative.
    #[must_use]
    #[inline(always)]
    pub fn agrees<const OTHER: u32>(self, other: Quantity<OTHER>) -> bool {
        self.0 * other.0 > 0.0
    }

    /// The product.
    #[must_use]
    #[inline(always)]
    pub const fn times<const OTHER: u32, const RESULT: u32>(
        self,
        other: Quantity<OTHER>,
    ) -> Quantity<RESULT> {
        Quantity(self.0 * other.0)
    }

    /// One over it; it is above zero.
    #[must_use]
    #[inline(always)]
    pub const fn inverse(self) -> Ratio {
        Quantity(1.0 / self.0)
    }

    /// As far from this number to another as a share says, 0 to 2; neither is negative.
    #[must_use]
    #[inline(always)]
    pub const fn toward(self, other: Self, share: Ratio) -> Self {
        Self(self.0 + (other.0 - self.0) * share.0)
    }

    /// So many of it.
    #[must_use]
    #[inline(always)]
    pub const fn many(self, count: u16) -> Self {
        Self(self.0 * count as f32)
    }

    /// The same in another resolution.
    #[must_use]
    #[inline(always)]
    pub const fn to<const RESULT: u32>(self) -> Quantity<RESULT> {
        Quantity(self.0)
    }
}

/// The float's own comparisons: what `derive` makes asks for an order first, which for a float is a
/// second comparison.
impl<const FRACTION: u32> PartialOrd for Quantity<FRACTION> {
    #[inline(always)]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.0.partial_cmp(&other.0)
    }
    #[inline(always)]
    fn lt(&self, other: &Self) -> bool {
        self.0 < other.0
    }
    #[inline(always)]
    fn le(&self, other: &Self) -> bool {
        self.0 <= other.0
    }
    #[inline(always)]
    fn gt(&self, other: &Self) -> bool {
        self.0 > other.0
    }
    #[inline(always)]
    fn ge(&self, other: &Self) -> bool {
        self.0 >= other.0
    }
}

impl<const FRACTION: u32> Add for Quantity<FRACTION> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
}

impl<const FRACTION: u32> Sub for Quantity<FRACTION> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0)
    }
}

impl<const FRACTION: u32> Neg for Quantity<FRACTION> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl<const FRACTION: u32> AddAssign for Quantity<FRACTION> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.0 += other.0;
    }
}

impl<const FRACTION: u32> SubAssign for Quantity<FRACTION> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        self.0 -= other.0;
    }
}

impl Time {
    /// So many microseconds.
    #[must_use]
    #[inline(always)]
    pub const fn from_micros(micros: u32) -> Self {
        Self(micros as f32 * 1e-6)
    }
}

impl Duration {
    /// So many microseconds.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros as f32 * 1e-6)
    }
}

impl PerSecond {
    /// One over so many microseconds.
    #[must_use]
    #[inline(always)]
    pub const fn of_micros(micros: u32) -> Self {
        Self(1e6 / micros as f32)
    }
}

/// The parts of a span of time.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Part(f32);

impl Part {
    /// Of so many microseconds.
    #[must_use]
    pub const fn of(micros: u32) -> Self {
        Self(1.0 / micros as f32)
    }

    /// Which part so many microseconds of them are.
    #[must_use]
    #[inline(always)]
    pub const fn at(self, micros: u32) -> Ratio {
        Quantity(micros as f32 * self.0)
    }
}

/// Equal steps of a rate, from zero to an end.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Steps<const COUNT: usize>(f32);

impl<const COUNT: usize> Steps<COUNT> {
    /// Up to this rate, which is above zero.
    #[must_use]
    pub const fn new(end: f32) -> Self {
        Self(const { COUNT as f32 } / end)
    }

    /// The number of the step in which the magnitude of a rate is, and which part of the step is
    /// below it. Beyond the end it is all of the last step.
    #[must_use]
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small number"
    )]
    pub fn at(self, rate: Rate) -> (usize, Ratio) {
        let most = const { COUNT as f32 };
        let place = rate.0.abs() * self.0;
        let place = if place > most { most } else { place };
        let step = (place as usize).min(COUNT - 1);
        (step, Quantity(place - step as f32))
    }
}

/// The size of a vector, and twice the share of its second component in the square of it; `None`
/// below 1e-6, where a direction means nothing.
#[must_use]
#[inline(always)]
pub fn polar(x: Rate, y: Rate) -> Option<(Rate, Ratio)> {
    let across = y.0 * y.0;
    let square = x.0 * x.0 + across;
    (square >= 1e-12).then(|| (Quantity(square.root()), Quantity(2.0 * across / square)))
}

/// Whether any of some numbers is at an end of its range: a float has none.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Ends;

impl Ends {
    /// No number yet.
    pub const NONE: Self = Self;

    /// Looks at one more number.
    #[inline(always)]
    pub const fn note<const FRACTION: u32>(&mut self, _: Quantity<FRACTION>) {}

    /// Whether one was there.
    #[must_use]
    #[inline(always)]
    pub const fn reached(self) -> bool {
        false
    }
}

/// A sign, and nothing else of a number.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Sign(f32);

impl Sign {
    /// That of a number which is not zero.
    #[must_use]
    pub const fn new(value: f32) -> Self {
        Self(1.0_f32.copysign(value))
    }

    /// A number with its own sign times this one.
    #[must_use]
    #[inline(always)]
    pub const fn times<const FRACTION: u32>(self, value: Quantity<FRACTION>) -> Quantity<FRACTION> {
        Quantity(self.0 * value.0)
    }
}

/// Half of a number, with the sign of another.
#[derive(Clone, Copy)]
pub struct Half(f32);

impl Half {
    /// Positive along this number.
    #[must_use]
    #[inline(always)]
    pub const fn along<const FRACTION: u32>(direction: Quantity<FRACTION>) -> Self {
        Self(if direction.0 < 0.0 { -0.5 } else { 0.5 })
    }

    /// Half of this number along the other.
    #[must_use]
    #[inline(always)]
    pub const fn of<const FRACTION: u32>(self, value: Quantity<FRACTION>) -> Quantity<FRACTION> {
        Quantity(self.0 * value.0)
    }
}

/// The angle of an encoder's count, rad, with its sign.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Count(f32);

impl Count {
    /// For this angle, rad.
    #[must_use]
    pub const fn new(step: f32) -> Self {
        Self(step)
    }

    /// The angle of so many counts.
    #[must_use]
    #[inline(always)]
    pub fn turned(self, counts: i16) -> Angle {
        Quantity(f32::from(counts) * self.0)
    }
}

/// A voltage that grows by a gain times the angle by which a wheel is behind.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Integral(f32);

impl Integral {
    /// Nothing.
    pub const ZERO: Self = Self(0.0);

    /// The voltage.
    #[must_use]
    #[inline(always)]
    pub const fn voltage(self) -> Voltage {
        Quantity(self.0)
    }

    /// Adds a gain times an angle.
    #[inline(always)]
    pub const fn add(&mut self, gain: AngleGain, angle: Angle) {
        self.0 += gain.0 * angle.0;
    }

    /// Subtracts a part of a voltage: `share` is between 0 and 1.
    #[inline(always)]
    pub const fn unwind(&mut self, excess: Voltage, share: super::Ratio) {
        self.0 -= share.0 * excess.0;
    }
}
