//! The device's time: microseconds since an arbitrary start, monotonic, provided by the caller.
//!
//! A duration is a `Micros` too. Sums and differences saturate: 2^64 us are 584 000 years.

use core::ops::{Add, Sub};

/// A point in monotonic local time, or a span of it, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Micros(pub u64);

impl Micros {
    /// The start of time, or no time at all.
    pub const ZERO: Self = Self(0);
    /// The end of time: a deadline that never comes.
    pub const MAX: Self = Self(u64::MAX);

    /// A span of whole milliseconds.
    #[must_use]
    pub const fn from_millis(millis: u64) -> Self {
        Self(millis.saturating_mul(1_000))
    }

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

/// A moment at which something is due, or never.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Timer(Micros);

impl Timer {
    pub const OFF: Self = Self(Micros::MAX);

    pub const fn at(moment: Micros) -> Self {
        Self(moment)
    }

    /// `millis` after `now`, or never if that is zero: how CiA 301 writes its timers.
    #[inline(never)]
    pub fn after_millis(now: Micros, millis: u16) -> Self {
        match millis {
            0 => Self::OFF,
            _ => Self(now + Micros::from_millis(u64::from(millis))),
        }
    }

    pub fn is_on(self) -> bool {
        self != Self::OFF
    }

    pub fn due(self, now: Micros) -> bool {
        // `OFF` is later than any time there is.
        self.0 <= now
    }

    pub const fn moment(self) -> Micros {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates() {
        assert_eq!(Micros(1) - Micros(2), Micros::ZERO);
        assert_eq!(Micros(u64::MAX) + Micros(1), Micros::MAX);
        assert_eq!(Micros::from_millis(10).since(Micros(4_000)), Micros(6_000));
    }

    #[test]
    fn a_timer_of_zero_milliseconds_never_fires() {
        assert!(!Timer::after_millis(Micros(5), 0).due(Micros(u64::MAX - 1)));
        assert!(Timer::after_millis(Micros(5), 1).due(Micros(1_005)));
        assert!(!Timer::after_millis(Micros(5), 1).due(Micros(1_004)));
    }
}
