//! `I16F16` as a scalar: 16 integer and 16 fractional bits, ±32768 in steps of 1.5e-5.
//!
//! Matrix entries are kept as 32-bit integers with 20 fractional bits on the way to the wheels and
//! 28 on the way back; products are summed in 64 bits, cut to 16 fractional bits once and saturated
//! once. So a result is off by at most one step (half a step on the way back, which is rounded)
//! plus half a coefficient step for each unit of input, and the sum cannot overflow before the
//! saturation sees it.
//!
//! A saturated result is recognised by its value: it is in the last sixteenth of a unit at either
//! end of the range.

use fixed::types::I16F16;

use super::{Scalar, steps};

/// Magnitudes of a row's entries sum to at most this, so that with inputs of up to 2^31 the sum
/// stays below 2^62.
const ROW_LIMIT: i64 = 1 << 31;

/// 2^12 steps, 1/16: a saturated result of [`Scalar::dot`] lies within this of the end, and any
/// value there counts as saturated. (20 fractional bits of a coefficient leave 12 of the lower
/// word's 32 in the result.)
const MARGIN: I16F16 = I16F16::from_bits((1 << 12) - 1);

impl Scalar for I16F16 {
    type Coefficient = i32;
    const ZERO: Self = Self::ZERO;
    const ONE: Self = Self::ONE;
    const RESOLUTION: f64 = 1.0 / 65_536.0;

    #[expect(
        clippy::cast_possible_truncation,
        reason = "what does not fit is not returned"
    )]
    fn row<const SHIFT: u32, const N: usize>(entries: [f64; N]) -> Option<[i32; N]> {
        let mut row = [0; N];
        let mut sum = 0_i64;
        for (to, entry) in row.iter_mut().zip(entries) {
            let wide = steps(entry, SHIFT)?;
            sum = sum.saturating_add(wide.abs());
            // The limit leaves out i32's ends, so that each entry fits too.
            *to = wide as i32;
        }
        (sum < ROW_LIMIT).then_some(row)
    }

    fn coefficient_step<const SHIFT: u32>() -> f64 {
        1.0 / f64::from(1_u32 << SHIFT)
    }

    #[inline]
    fn dot<const SHIFT: u32, const ROUND: bool, const N: usize>(
        row: &[i32; N],
        vector: &[Self; N],
    ) -> Self {
        let half = if ROUND { 1 << (SHIFT - 1) } else { 0 };
        narrow::<SHIFT>(sum(row, vector).wrapping_add(half))
    }

    #[inline]
    fn is_saturated(self) -> bool {
        self >= Self::MAX - MARGIN || self <= Self::MIN + MARGIN
    }

    #[inline]
    fn limit<const N: usize>(values: [Self; N], limit: Self) -> ([Self; N], Self) {
        let fastest = values
            .iter()
            .fold(0, |most: u32, v| most.max(v.to_bits().unsigned_abs()));
        if limit < Self::ZERO {
            return ([Self::ZERO; N], Self::ZERO);
        }
        let most = limit.to_bits().unsigned_abs();
        if fastest <= most {
            return (values, Self::ONE);
        }
        // The factor with 32 fractional bits, rounded down, so that the product never exceeds the
        // limit.
        let factor = (u64::from(most) << 32) / u64::from(fastest);
        let scale = saturate(i64::try_from(factor >> 16).unwrap_or(i64::MAX));
        let scaled = values.map(|v| {
            let magnitude = (u64::from(v.to_bits().unsigned_abs()) * factor) >> 32;
            let magnitude = i64::try_from(magnitude).unwrap_or(i64::MAX);
            saturate(if v < Self::ZERO {
                -magnitude
            } else {
                magnitude
            })
        });
        (scaled, scale)
    }

    fn constant(value: f64) -> Self {
        if value.is_nan() {
            Self::ZERO
        } else {
            Self::saturating_from_num(value)
        }
    }

    fn widen(self) -> f64 {
        self.to_num()
    }
}

/// A row times a vector, exact, with `16 + SHIFT` fractional bits.
#[inline]
fn sum<const N: usize>(row: &[i32; N], vector: &[I16F16; N]) -> i64 {
    // Wrapping operators only to keep overflow checks out: ROW_LIMIT bounds the sum.
    let mut products = row
        .iter()
        .zip(vector)
        .map(|(a, b)| i64::from(*a).wrapping_mul(i64::from(b.to_bits())));
    let first = products.next().unwrap_or_default();
    products.fold(first, i64::wrapping_add)
}

/// The sum with `SHIFT` fractional bits less, saturated into the last [`MARGIN`] of the range.
///
/// Written on its two halves: the high one is saturated to the bits it has left, which a Cortex-M
/// does in one instruction. The low one is left as it is: making it all ones or all zeros would
/// cost a quarter more.
#[inline]
fn narrow<const SHIFT: u32>(sum: i64) -> I16F16 {
    let most = (1_i32 << (SHIFT - 1)) - 1;
    let high = high_word(sum).clamp(-most - 1, most);
    let low = low_word(sum).cast_unsigned();
    I16F16::from_bits((high << (32 - SHIFT)) | (low >> SHIFT).cast_signed())
}

#[inline]
const fn high_word(wide: i64) -> i32 {
    (wide >> 32) as i32
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the lower half is what is asked for"
)]
#[inline]
const fn low_word(wide: i64) -> i32 {
    wide as i32
}

#[inline]
fn saturate(bits: i64) -> I16F16 {
    I16F16::from_bits(i32::try_from(bits).unwrap_or(if bits < 0 { i32::MIN } else { i32::MAX }))
}
