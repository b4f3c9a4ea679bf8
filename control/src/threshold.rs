//! A threshold with hysteresis, and one that must be exceeded for a time.

use crate::quantity::{Rate, Ratio};
use crate::time::Micros;

/// Below this part of its threshold a limit is over.
const RELEASE: Ratio = Ratio::new(0.8);

/// A limit that comes at its threshold and goes at four fifths of it.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Hysteresis {
    /// Whether it has come and not gone.
    pub active: bool,
}

impl Hysteresis {
    /// Looks at a value (its magnitude); a threshold of 0 is never reached.
    #[inline]
    pub fn update(&mut self, value: Rate, threshold: Rate) -> bool {
        let bound = if self.active {
            threshold.times(RELEASE)
        } else {
            threshold
        };
        self.active = threshold > Rate::ZERO && value > bound;
        self.active
    }

    /// Whether it has come and not gone.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        self.active
    }
}

/// A condition that counts once it has held without a break for long enough.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Lasting {
    since: Option<Micros>,
}

impl Lasting {
    /// One that does not hold.
    #[must_use]
    pub const fn new() -> Self {
        Self { since: None }
    }

    /// Whether `condition` has held for `span_us` by `now`.
    #[inline]
    pub fn update(&mut self, condition: bool, now: Micros, span_us: u64) -> bool {
        if !condition {
            self.since = None;
            return false;
        }
        now.since(*self.since.get_or_insert(now)).0 >= span_us
    }

    /// Restarts the time.
    pub fn reset(&mut self) {
        self.since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_comes_at_its_threshold_and_goes_at_four_fifths() {
        let mut limit = Hysteresis::default();
        let mut update = |value, threshold| limit.update(Rate::new(value), Rate::new(threshold));
        assert!(!update(1.0, 1.0));
        assert!(update(1.01, 1.0));
        assert!(update(0.81, 1.0));
        assert!(!update(0.799, 1.0));
        assert!(!update(0.9, 1.0), "off again, until the threshold");
        assert!(!update(9.0, 0.0), "zero is off");
    }

    #[test]
    fn a_break_starts_the_time_anew() {
        let mut lasting = Lasting::new();
        assert!(!lasting.update(true, Micros(0), 100));
        assert!(!lasting.update(true, Micros(99), 100));
        assert!(!lasting.update(false, Micros(100), 100));
        assert!(!lasting.update(true, Micros(150), 100));
        assert!(lasting.update(true, Micros(250), 100));
    }
}
