//! Where a rate is in a table, and the size and direction of two of them, in fixed point.
//!
//! The end of a table is normalized to 31 bits when the table is made. A place in it is then one
//! shift and the upper word of one product, as precise for a table up to a millimetre a second as
//! for one up to 6.5 m/s.

use super::super::root::{InverseRoot, reciprocal};
use super::super::{Rate, Ratio};
use super::Quantity;

/// Equal steps of a rate, from zero to an end: a power of two of them, at least 8.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Steps<const COUNT: usize> {
    end: i32,
    /// What makes the end a number of 31 bits.
    shift: u32,
    /// Less than one over that, with 62 fractional bits, so that the end is in the last step.
    per_end: u32,
}

impl<const COUNT: usize> Steps<COUNT> {
    /// Fractional bits of the number of a step: with the bits of the largest they are 30.
    const FRACTION: u32 = 30 - COUNT.ilog2();

    /// Up to this rate, which is above zero.
    #[must_use]
    pub const fn new(end: f32) -> Self {
        let end = Rate::new(end).max(Quantity(1)).0;
        let shift = end.leading_zeros() - 1;
        let (mantissa, _) = reciprocal(end.cast_unsigned() << shift);
        Self {
            end,
            shift,
            // 8 is what the reciprocal is off by at most.
            per_end: mantissa.saturating_mul(2) - 16,
        }
    }

    /// The number of the step in which the magnitude of a rate is, and which part of the step is
    /// below it. Beyond the end it is all of the last step.
    #[must_use]
    #[inline(always)]
    pub fn at(self, rate: Rate) -> (usize, Ratio) {
        let within = rate.abs().0.min(self.end).cast_unsigned();
        let within = within.wrapping_shl(self.shift);
        let place = (u64::from(within).wrapping_mul(u64::from(self.per_end)) >> 32) as u32;
        let part = place & const { (1 << Self::FRACTION) - 1 };
        let part = part << const { Ratio::FRACTION - Self::FRACTION };
        let step = (place >> Self::FRACTION) as usize & const { COUNT - 1 };
        (step, Quantity(part.cast_signed()))
    }
}

/// The size of a vector, and twice the share of its second component in the square of it; `None`
/// below 1e-6, where a direction means nothing.
#[must_use]
#[inline(always)]
pub fn polar(x: Rate, y: Rate) -> Option<(Rate, Ratio)> {
    /// 1e-6 squared, with the 46 fractional bits of a square.
    const STANDING: u64 = 70;
    let square = |one: Rate| {
        let one = u64::from(one.0.unsigned_abs());
        one.wrapping_mul(one)
    };
    let across = square(y);
    let whole = square(x).wrapping_add(across);
    if whole < STANDING {
        return None;
    }
    let root = InverseRoot::of(whole);
    let size = root.root();
    let size = if size > i32::MAX as u32 {
        i32::MAX
    } else {
        size.cast_signed()
    };
    // 28 fractional bits of the share are 27 of twice the share.
    Some((Quantity(size), Quantity(root.share(across).cast_signed())))
}
