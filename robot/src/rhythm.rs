//! Judges the times and counters of SYNC: lost SYNCs, those of another master, another period.
//!
//! A counter that goes on by more than one has lost SYNCs behind it if their time has passed, too;
//! one that runs backwards, stands still or jumps ahead of the clock belongs to a second master.
//! Without counters the clock alone is left.

use control::time::Micros;

use protocol::timing::SYNC_OVERFLOW;

/// So many SYNCs in a row at another period are one.
const OFF_PERIOD: u8 = 3;

/// What one SYNC said.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Beat {
    /// Periods since the last one, at least 1: so many setpoints may have come.
    pub periods: u8,
    /// Its counter does not follow from the last one.
    pub disorder: bool,
    /// It came less than half or more than one and a half periods after the one before it.
    pub off_period: bool,
}

/// The SYNCs so far.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Rhythm {
    last: Option<(Micros, Option<u8>)>,
    off: u8,
}

impl Rhythm {
    /// None yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { last: None, off: 0 }
    }

    /// A SYNC at `at`, expected every `period_us`.
    pub fn on_sync(&mut self, at: Micros, counter: Option<u8>, period_us: u32) -> Beat {
        let Some((before, last)) = self.last.replace((at, counter)) else {
            return Beat {
                periods: 1,
                disorder: false,
                off_period: false,
            };
        };
        // An hour without SYNC is as good as any longer time.
        let elapsed = u32::try_from(at.since(before).0).unwrap_or(u32::MAX);
        let periods = (elapsed / period_us.max(1)).min(200)
            + u32::from(elapsed % period_us.max(1) * 2 >= period_us);
        let periods = periods.max(1);
        let steps = last.zip(counter).map(|(last, counter)| {
            let overflow = i32::from(SYNC_OVERFLOW);
            (i32::from(counter) - i32::from(last)).rem_euclid(overflow)
        });
        let disorder = steps.is_some_and(|steps| steps == 0 || steps.cast_unsigned() > periods + 1);
        // Of SYNCs that are lost nothing is said about the period.
        let alone = steps.is_none_or(|steps| steps == 1);
        let off_period = alone && (elapsed < period_us / 2 || elapsed > period_us + period_us / 2);
        self.off = if off_period {
            self.off.saturating_add(1)
        } else {
            0
        };
        Beat {
            periods: u8::try_from(periods).unwrap_or(u8::MAX),
            disorder,
            off_period,
        }
    }

    /// Whether SYNC has another period than it should.
    pub const fn is_off(&self) -> bool {
        self.off >= OFF_PERIOD
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u32 = 10_000;

    /// The last of these SYNCs, times in us.
    fn last(syncs: &[(u64, u8)]) -> Beat {
        let mut rhythm = Rhythm::new();
        let beats = syncs.iter();
        let beats = beats.map(|(at, counter)| rhythm.on_sync(Micros(*at), Some(*counter), PERIOD));
        beats.last().unwrap()
    }

    #[test]
    fn one_after_the_other_is_in_order_and_wraps() {
        let fine = Beat {
            periods: 1,
            disorder: false,
            off_period: false,
        };
        assert_eq!(last(&[(0, 7)]), fine);
        assert_eq!(last(&[(0, 7), (10_000, 8)]), fine);
        assert_eq!(last(&[(0, 240), (10_000, 1)]), fine);
        // Late or early by less than half a period.
        assert_eq!(last(&[(0, 1), (14_900, 2)]), fine);
        assert_eq!(last(&[(0, 1), (5_100, 2)]), fine);
    }

    #[test]
    fn a_gap_whose_time_has_passed_is_lost_syncs() {
        for lost in 1..100_u8 {
            let beat = last(&[
                (0, 200),
                (
                    10_000 * (u64::from(lost) + 1),
                    ((200 + u16::from(lost)) % 240 + 1) as u8,
                ),
            ]);
            assert!(!beat.disorder && !beat.off_period, "{lost} {beat:?}");
            assert_eq!(beat.periods, lost + 1);
        }
    }

    #[test]
    fn a_counter_that_stands_runs_back_or_ahead_is_disorder() {
        for counter in [7, 6, 1, 240, 10, 127] {
            assert!(last(&[(0, 7), (10_000, counter)]).disorder, "{counter}");
        }
    }

    #[test]
    fn another_period_is_seen_after_three() {
        for (period, off) in [(2_000, true), (4_900, true), (9_000, false), (15_100, true)] {
            let mut rhythm = Rhythm::new();
            for k in 0..4_u8 {
                assert!(!rhythm.is_off());
                rhythm.on_sync(Micros(u64::from(k) * period), Some(k + 1), PERIOD);
            }
            assert_eq!(rhythm.is_off(), off, "{period}");
        }
    }

    #[test]
    fn without_counters_the_clock_is_left() {
        let mut rhythm = Rhythm::new();
        rhythm.on_sync(Micros(0), None, PERIOD);
        let beat = rhythm.on_sync(Micros(30_000), None, PERIOD);
        assert_eq!((beat.periods, beat.disorder), (3, false));
    }
}
