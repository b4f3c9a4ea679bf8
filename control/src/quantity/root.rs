//! Reciprocals and square roots of whole numbers, on a core that multiplies 32 by 32 bits and
//! divides 32 by 32.
//!
//! Both normalize the number and improve a first guess by Newton's method. The reciprocal takes its
//! guess from a division of 16 bits and needs one step; the inverse root takes its guess from a
//! straight line and needs three.

/// One over a number that is not zero: a mantissa of 2^30 to 2^31 and a shift, so that it is
/// `mantissa / 2^shift`, to 2^-29 of it. The shift is 31 to 62.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "between 2^30 and 2^31"
)]
pub const fn reciprocal(number: u32) -> (u32, u32) {
    let zeros = number.leading_zeros();
    let normal = number << (zeros & 31);
    // Of 2^48, to 2^-15 of it.
    let guess = u32::MAX / (normal >> 16);
    let excess = (guess as i64)
        .wrapping_mul(normal as i64)
        .wrapping_sub(1 << 48);
    let correction = (guess as i64).wrapping_mul((excess >> 8) as i32 as i64) >> 26;
    (
        (guess << 14).wrapping_sub(correction as u32),
        62_u32.wrapping_sub(zeros),
    )
}

/// One over the square root of a number, and what the root is made of.
#[derive(Clone, Copy)]
pub struct InverseRoot {
    /// The number without its even number of leading zeros, over 2^32: a quarter to 1.
    normal: u32,
    /// One over the root of that: 1 to 2, with 30 fractional bits.
    pub mantissa: u32,
    /// Half of the leading zeros.
    pub half: u32,
}

impl InverseRoot {
    /// Of a number that is not zero. Not inlined: a tick has six of them.
    #[inline(never)]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the upper words, and products of numbers scaled to fit"
    )]
    pub const fn of(number: u64) -> Self {
        /// The line 2.13 - 1.21 x, within 9 % of the inverse root, which three steps make 7e-8.
        const LINE: (u32, u32) = (2_287_070_085, 1_299_227_607);
        let half = number.leading_zeros() >> 1;
        let normal = ((number << ((half << 1) & 63)) >> 32) as u32;
        let mut mantissa = LINE
            .0
            .wrapping_sub(((normal as u64).wrapping_mul(LINE.1 as u64) >> 32) as u32);
        let mut step = 0;
        while step < 3 {
            let square = ((mantissa as u64).wrapping_mul(mantissa as u64) >> 32) as u32;
            let one = ((normal as u64).wrapping_mul(square as u64) >> 32) as u32;
            let factor = (3_u32 << 28).wrapping_sub(one);
            mantissa = ((mantissa as u64).wrapping_mul(factor as u64) >> 29) as u32;
            step += 1;
        }
        Self {
            normal,
            mantissa,
            half,
        }
    }

    /// The root itself, cut to a whole number.
    #[expect(clippy::cast_possible_truncation, reason = "below 2^32")]
    pub const fn root(self) -> u32 {
        let root = (self.normal as u64).wrapping_mul(self.mantissa as u64) >> 32;
        ((root << 2) >> self.half) as u32
    }

    /// The share of a part in the number, with 28 fractional bits.
    pub const fn share(self, part: u64) -> u32 {
        let part = (part << ((self.half << 1) & 63)) >> 32;
        let mantissa = self.mantissa as u64;
        let square = mantissa.wrapping_mul(mantissa) >> 32;
        (part.wrapping_mul(square) >> 32) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers over the whole range, with all their bits in use.
    fn spread() -> impl Iterator<Item = u64> {
        (0..64).flat_map(|bits| {
            let one = 1_u64 << bits;
            [
                one,
                one | (one >> 1),
                one | (0x5A5A_1234_9E37_79B9 & (one - 1)),
                one + (one - 1),
            ]
        })
    }

    #[test]
    fn reciprocals_keep_their_bound() {
        for number in spread().filter_map(|number| u32::try_from(number).ok()) {
            let (mantissa, shift) = reciprocal(number);
            let found = f64::from(mantissa) * 2.0_f64.powi(-i32::try_from(shift).unwrap());
            let off = found * f64::from(number) - 1.0;
            assert!(off.abs() <= 2.0_f64.powi(-29), "{number}: {off:e}");
            assert!((31..=62).contains(&shift), "{number}: {shift}");
        }
    }

    #[test]
    fn roots_keep_their_bound() {
        for number in spread() {
            let found = InverseRoot::of(number);
            let exact = (number as f64).sqrt();
            let one = f64::from(found.mantissa) * 2.0_f64.powi(i32::try_from(found.half).unwrap());
            let off = one * exact / 2.0_f64.powi(62) - 1.0;
            assert!(off.abs() < 1e-7, "{number}: {off:e}");
            let root = f64::from(found.root());
            assert!(
                (root - exact).abs() <= 1.0 + 1e-7 * exact,
                "{number}: {root}"
            );
        }
    }
}
