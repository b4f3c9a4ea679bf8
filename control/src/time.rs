//! Time as the control side sees it, and the period of its tick.
//!
//! Microseconds since some start, monotonic, passed in by the caller; a duration is a `Micros` too.
//! Sums and differences saturate: 2^64 us are 584 000 years.

use core::ops::{Add, Sub};

/// Nominal period of the tick, us: a millisecond, unless a build asks for another with the variable
/// `OMNIBUS_TICK_US`, as `cargo xtask bench` does to find out how fast it may be.
pub const TICK_US: u32 = match option_env!("OMNIBUS_TICK_US") {
    None => 1_000,
    Some(text) => match u32::from_str_radix(text, 10) {
        Ok(period) if period >= 10 && period <= 1_000 => period,
        _ => panic!("OMNIBUS_TICK_US is not a number of microseconds from 10 to 1000"),
    },
};

/// A point in monotonic local time, or a span of it, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Micros(pub u64);

impl Micros {
    /// The start of time, or no time at all.
    pub const ZERO: Self = Self(0);
    /// The end of time: a deadline that never comes.
    pub const MAX: Self = Self(u64::MAX);

    /// The span since an earlier point; zero if `earlier` is in fact later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Self {
        Self(self.0.saturating_sub(earlier.0))
    }
}

impl Add for Micros {
    type Output = Self;

    fn add(self, span: Self) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

impl Sub for Micros {
    type Output = Self;

    fn sub(self, span: Self) -> Self {
        Self(self.0.saturating_sub(span.0))
    }
}
