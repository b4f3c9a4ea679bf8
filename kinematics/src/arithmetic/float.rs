//! `f32` and `f64` as scalars: coefficients are plain numbers, nothing saturates.

use super::{Chord, Real, Scalar, TURN_UNITS, sin_cos, square_root};

/// 2^61.
const UNITS: f64 = 2_305_843_009_213_693_952.0;

/// A product and sum in the order a compiler can turn into straight multiply-adds.
#[inline]
fn dot<
    S: Copy + Default + core::ops::Mul<Output = S> + core::ops::Add<Output = S>,
    const N: usize,
>(
    row: &[S; N],
    vector: &[S; N],
) -> S {
    let mut products = row.iter().zip(vector).map(|(a, b)| *a * *b);
    // Starting from the first product, not from zero, saves an addition that floating point may not
    // drop.
    let first = products.next().unwrap_or_default();
    products.fold(first, |sum, product| sum + product)
}

/// [`Scalar::limit`] for `f32`, comparing magnitudes by their bits: for numbers that are not
/// negative the order is the same, infinity and NaN come last, and an integer comparison costs half
/// as much as a float's.
#[inline]
fn limit_single<const N: usize>(values: [f32; N], limit: f32) -> ([f32; N], f32) {
    const INFINITE: u32 = f32::INFINITY.to_bits();
    let fastest = values.iter().fold(0, |most: u32, v| {
        let magnitude = v.to_bits() & 0x7fff_ffff;
        if magnitude > most { magnitude } else { most }
    });
    // A negative limit has its top bit set and so is beyond infinity too.
    let most = limit.to_bits();
    if fastest >= INFINITE || most > INFINITE {
        ([0.0; N], 0.0)
    } else if fastest <= most {
        (values, 1.0)
    } else {
        let fastest = f32::from_bits(fastest);
        let scale = limit / fastest;
        // Rounding may leave the fastest a unit in the last place above the limit; with the next
        // smaller scale, which is below the exact quotient, it cannot. Others are no faster.
        let over = (fastest * scale).to_bits() > most;
        let scale = f32::from_bits(scale.to_bits().wrapping_sub(u32::from(over)));
        (values.map(|v| v * scale), scale)
    }
}

/// [`Scalar::limit`] for `f64`.
fn limit_double<const N: usize>(values: [f64; N], limit: f64) -> ([f64; N], f64) {
    let finite = values.iter().all(|v| v.is_finite());
    let fastest = values.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    if !finite || limit.is_nan() || limit < 0.0 {
        ([0.0; N], 0.0)
    } else if fastest <= limit {
        (values, 1.0)
    } else {
        let scale = limit / fastest;
        // As in single precision.
        let scale = if fastest * scale > limit {
            scale.next_down()
        } else {
            scale
        };
        (values.map(|v| v * scale), scale)
    }
}

macro_rules! float_scalar {
    ($float:ty, $limit:ident) => {
        impl Scalar for $float {
            type Coefficient = Self;
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const RESOLUTION: f64 = 0.0;

            fn row<const SHIFT: u32, const N: usize>(entries: [f64; N]) -> Option<[Self; N]> {
                let row = entries.map(<Self as Scalar>::constant);
                row.iter().all(|entry| entry.is_finite()).then_some(row)
            }

            fn coefficient_step<const SHIFT: u32>() -> f64 {
                0.0
            }

            #[inline]
            fn dot<const SHIFT: u32, const ROUND: bool, const N: usize>(
                row: &[Self; N],
                vector: &[Self; N],
            ) -> Self {
                dot(row, vector)
            }

            #[inline]
            fn is_saturated(self) -> bool {
                !self.is_finite()
            }

            #[inline]
            fn limit<const N: usize>(values: [Self; N], limit: Self) -> ([Self; N], Self) {
                $limit(values, limit)
            }

            #[expect(
                clippy::allow_attributes,
                reason = "for f64 there is nothing to truncate"
            )]
            #[allow(
                clippy::cast_possible_truncation,
                reason = "rounding to the nearest is the point"
            )]
            fn constant(value: f64) -> Self {
                value as Self
            }

            fn widen(self) -> f64 {
                self.into()
            }
        }
    };
}

float_scalar!(f32, limit_single);
float_scalar!(f64, limit_double);

impl Real for f32 {
    #[inline]
    fn sine_cosine(self) -> (Self, Self) {
        sin_cos(self)
    }

    #[inline]
    fn root(self) -> Self {
        square_root(self)
    }

    #[inline]
    fn heading_sine_cosine(self) -> (Self, Self) {
        super::trig::sin_cos_within(self)
    }

    /// The first terms left out are 8e-10 and 4e-8 of the arc at the largest turn.
    #[inline]
    fn small_chord(self) -> Chord<Self> {
        let square = self * self;
        Chord {
            along: 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0)),
            across: self * (0.5 - square * (1.0 / 24.0)),
        }
    }

    /// In two steps of 29 and 32 bits, each exact, because the conversion to 64 bits is a library
    /// call on a Cortex-M4F and the one to 32 bits is an instruction.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the integer part is taken, the rest is what the second step is for"
    )]
    #[inline]
    fn to_units(self) -> i64 {
        const HIGH: f32 = 536_870_912.0; // 2^29
        const LOW: f32 = 2_147_483_648.0; // 2^31: signed, one bit short of the 32
        let scaled = self * HIGH;
        let high = scaled as i32;
        let low = ((scaled - high as Self) * LOW) as i32;
        (i64::from(high) << 32).wrapping_add(i64::from(low) << 1)
    }

    /// In whole numbers: exact, and without the double precision that a Cortex-M4F has only in
    /// software.
    fn turn_units(self) -> u64 {
        const MANTISSA: u32 = 23;
        const BIAS: u32 = 127;
        /// Bits from a step of the mantissa of a number from 1 to 2 to a unit.
        const TO_UNITS: u32 = 61 - MANTISSA;
        let bits = self.to_bits();
        let exponent = (bits >> MANTISSA) & 0xFF;
        if exponent < BIAS {
            return unsigned(self.to_units());
        }
        if exponent == 0xFF {
            return 0;
        }
        let mantissa = u64::from((bits & 0x007F_FFFF) | 0x0080_0000);
        let mut units = mantissa << TO_UNITS;
        for _ in BIAS..exponent {
            // Twice as much, less a turn if that is one. A turn has 64 bits, so twice may have 65.
            let room = TURN_UNITS.wrapping_sub(units);
            units = if units >= room {
                units.wrapping_sub(room)
            } else {
                units.wrapping_mul(2)
            };
        }
        if self < 0.0 && units != 0 {
            TURN_UNITS.wrapping_sub(units)
        } else {
            units
        }
    }

    #[expect(
        clippy::cast_precision_loss,
        reason = "an angle to 2e-9 rad is finer than what follows from it"
    )]
    #[inline]
    fn from_units(units: i64) -> Self {
        const HIGH: f32 = 1.0 / 536_870_912.0; // 2^-29
        ((units >> 32) as i32) as Self * HIGH
    }

    #[expect(
        clippy::cast_precision_loss,
        reason = "rounded to 24 bits, 3e-8 at most"
    )]
    #[inline]
    fn from_fraction(steps: i32) -> Self {
        const STEP: f32 = 1.0 / 4_294_967_296.0; // 2^-32
        steps as Self * STEP
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "within half a step of ± 2^31; the upper end wraps, as it should"
    )]
    fn to_fraction(self) -> i32 {
        ((self - libm::roundf(self)) * 4_294_967_296.0) as i64 as i32
    }
}

impl Real for f64 {
    fn sine_cosine(self) -> (Self, Self) {
        libm::sincos(self)
    }

    fn root(self) -> Self {
        libm::sqrt(if self > 0.0 { self } else { 0.0 })
    }

    fn heading_sine_cosine(self) -> (Self, Self) {
        libm::sincos(self)
    }

    /// The first terms left out are 1e-18 and 5e-20 of the arc at the largest turn.
    fn small_chord(self) -> Chord<Self> {
        let z = self * self;
        Chord {
            along: 1.0
                - z / 6.0
                    * (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0 * (1.0 - z / 110.0)))),
            across: self / 2.0
                * (1.0
                    - z / 12.0
                        * (1.0
                            - z / 30.0 * (1.0 - z / 56.0 * (1.0 - z / 90.0 * (1.0 - z / 132.0))))),
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "saturates, and magnitudes below 4 fit"
    )]
    fn to_units(self) -> i64 {
        (self * UNITS) as i64
    }

    fn turn_units(self) -> u64 {
        let whole = libm::floor(self / core::f64::consts::TAU + 0.5) * core::f64::consts::TAU;
        unsigned((self - whole).to_units())
    }

    #[expect(clippy::cast_precision_loss, reason = "rounded to the nearest f64")]
    fn from_units(units: i64) -> Self {
        units as Self / UNITS
    }

    fn from_fraction(steps: i32) -> Self {
        Self::from(steps) / 4_294_967_296.0
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "within half a step of ± 2^31; the upper end wraps, as it should"
    )]
    fn to_fraction(self) -> i32 {
        ((self - libm::round(self)) * 4_294_967_296.0) as i64 as i32
    }
}

/// An angle within half a turn either way, as one from 0 to a turn.
fn unsigned(units: i64) -> u64 {
    if units < 0 {
        TURN_UNITS.wrapping_add_signed(units)
    } else {
        units.unsigned_abs()
    }
}
