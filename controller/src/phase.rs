//! When the control tick begins: in step with SYNC, so that all members change speed together.
//!
//! Every member receives the same SYNC at the same moment, but counts time with a crystal of its own. Each keeps, in
//! its own time, a *grid*: when it expects the SYNCs. At every SYNC the grid moves a sixteenth of the way towards the
//! time at which it came, and learns how much longer or shorter than nominal a period is by its own clock. The ticks lie
//! on the grid and whole milliseconds after it.
//!
//! SYNC may jitter by more than a tick. It is therefore compared with the nearest expected *SYNC*, half a period away
//! at most, never with the nearest tick: all members see the same jitter and move their grids alike, and what differs
//! between them, the clock and the moment they joined, fades away. A tick follows the grid by at most 20 us at a time,
//! so no tick is much shorter or longer than a millisecond.
//!
//! Cost: two 32-bit divisions at a SYNC, one in a tick.

use canopen::Micros;

use crate::control::TICK_US;

/// Nominal period of the tick, us.
const TICK: u32 = 1_000;
const _: () = assert!(TICK as u64 == TICK_US);

/// By how much a tick may be shorter or longer than nominal, us.
pub const SLEW_US: i32 = 20;

/// The grid takes over one part in this many of each difference.
const SMOOTHING: i32 = 16;

/// The period takes over one part in this many. Four times the square of [`SMOOTHING`]: critically damped.
const DRIFT_SMOOTHING: i32 = 4 * SMOOTHING * SMOOTHING;

/// Fractions of a microsecond in which the grid is kept.
const FRACTION: i32 = 256;

/// Fractions of a microsecond in which the length of a period is kept.
const DRIFT_FRACTION: i32 = 65_536;

/// Largest difference between two clocks that is believed, in the length of a 10 ms period: 200 ppm.
const DRIFT_MAX: i32 = 2 * DRIFT_FRACTION;

/// After this long without SYNC the grid begins anew, us.
const FORGET_US: u64 = 1_000_000;

/// Decides when the next tick begins.
#[derive(Clone, Copy, Debug, Default)]
pub struct TickPhase {
    period_us: u32,
    grid: Option<Grid>,
    last_sync: Micros,
}

/// The SYNC that was expected last.
#[derive(Clone, Copy, Debug)]
struct Grid {
    /// Low 32 bits of its time.
    at_us: u32,
    /// 1/256 us on top of that.
    fraction: i32,
    /// By how much a period is longer than nominal, 1/65536 us.
    drift: i32,
}

impl TickPhase {
    /// Ticks that run free.
    #[must_use]
    pub const fn new() -> Self {
        Self::with_period(0)
    }

    /// Ticks in step with a SYNC of this period. They run free until the first SYNC, and for good when the period is not
    /// a whole number of milliseconds.
    #[must_use]
    pub const fn with_period(period_us: u32) -> Self {
        Self {
            period_us,
            grid: None,
            last_sync: Micros(0),
        }
    }

    /// Takes note of the latest SYNC, received at `at`; may be called each tick, the same SYNC counts once.
    pub fn on_sync(&mut self, at: Micros) {
        let period = self.period_us;
        if at == self.last_sync || period == 0 || !period.is_multiple_of(TICK) {
            return;
        }
        let since = at.since(self.last_sync).0;
        self.last_sync = at;
        let at_us = low(at);
        let Some(grid) = self.grid.filter(|_| since < FORGET_US) else {
            self.grid = Some(Grid {
                at_us,
                fraction: 0,
                drift: 0,
            });
            return;
        };
        // Half a period early or late still belongs to the nearest expected SYNC.
        let half = period / 2;
        let past = at_us.wrapping_sub(grid.at_us).wrapping_add(half) % period;
        let late_us = past.cast_signed() - half.cast_signed();
        let error = late_us * FRACTION - grid.fraction;
        let drift = grid.drift + error * (DRIFT_FRACTION / FRACTION) / DRIFT_SMOOTHING;
        let drift = drift.clamp(-DRIFT_MAX, DRIFT_MAX);
        let fraction = grid.fraction + error / SMOOTHING + drift / (DRIFT_FRACTION / FRACTION);
        let expected = at_us.wrapping_sub(late_us.cast_unsigned());
        self.grid = Some(Grid {
            at_us: expected.wrapping_add(fraction.div_euclid(FRACTION).cast_unsigned()),
            fraction: fraction.rem_euclid(FRACTION),
            drift,
        });
    }

    /// When the tick after the one at `due` begins.
    #[must_use]
    pub fn next(&self, due: Micros) -> Micros {
        let step = self.grid.map_or(0, |grid| {
            let half = TICK / 2;
            let past = low(due).wrapping_sub(grid.at_us).wrapping_add(half) % TICK;
            let late_us = past.cast_signed() - half.cast_signed();
            late_us.clamp(-SLEW_US, SLEW_US)
        });
        Micros(
            due.0
                .saturating_add(TICK_US)
                .saturating_sub_signed(i64::from(step)),
        )
    }
}

/// The low half: differences of times within half an hour need no more.
#[expect(clippy::cast_possible_truncation, reason = "that is the point")]
const fn low(at: Micros) -> u32 {
    at.0 as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const PERIOD_US: u32 = 10_000;

    /// A member with a crystal of its own.
    struct Member {
        ppm: f64,
        begin_us: f64,
        phase: TickPhase,
        due: Micros,
        ticks: Vec<f64>,
    }

    impl Member {
        fn new(ppm: f64, begin_us: f64) -> Self {
            Self {
                ppm,
                begin_us,
                phase: TickPhase::with_period(PERIOD_US),
                due: Micros(0),
                ticks: Vec::new(),
            }
        }

        /// What its clock shows at true time `t`.
        fn local(&self, t: f64) -> f64 {
            (t - self.begin_us) * (1.0 + self.ppm * 1e-6)
        }

        fn sync(&mut self, t: f64) {
            if t < self.begin_us {
                return;
            }
            while (self.due.0 as f64) < self.local(t) {
                let at = self.due.0 as f64 / (1.0 + self.ppm * 1e-6) + self.begin_us;
                self.ticks.push(at);
                self.due = self.phase.next(self.due);
            }
            self.phase.on_sync(Micros(self.local(t) as u64));
        }
    }

    /// Largest distance of a tick of `b` from the nearest of `a`, for ticks after `from`.
    fn apart(a: &Member, b: &Member, from: f64) -> f64 {
        let mut nearest = 0;
        let mut worst = 0.0_f64;
        for tick in b.ticks.iter().filter(|tick| **tick > from) {
            while nearest + 1 < a.ticks.len()
                && (a.ticks[nearest + 1] - tick).abs() < (a.ticks[nearest] - tick).abs()
            {
                nearest += 1;
            }
            worst = worst.max((a.ticks[nearest] - tick).abs());
        }
        worst
    }

    fn drive(jitter_us: i64, members: &mut [Member]) {
        let mut seed = 1_u64;
        for k in 1..6_000_i64 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let jitter = (seed >> 33) as i64 % (2 * jitter_us + 1) - jitter_us;
            for member in members.iter_mut() {
                member.sync((k * i64::from(PERIOD_US) + jitter) as f64);
            }
        }
    }

    /// Crystals 100 ppm apart, a minute, the second member 5 s late: after two seconds together they tick together.
    fn worst_apart(jitter_us: i64) -> f64 {
        let mut members = [Member::new(50.0, 1_234.0), Member::new(-50.0, 5_000_777.0)];
        drive(jitter_us, &mut members);
        apart(&members[0], &members[1], 7.0e6)
    }

    #[test]
    fn ticks_together_under_a_steady_sync() {
        // Both count whole microseconds, and so do their receive times.
        assert!(worst_apart(0) <= 3.0, "{}", worst_apart(0));
    }

    #[test]
    fn ticks_together_within_50_us_under_a_sync_that_jitters_by_1500_us() {
        // One step of the slew, when a SYNC falls between the two ticks, and what the grids still differ by.
        assert!(worst_apart(1_500) <= 40.0, "{}", worst_apart(1_500));
    }

    #[test]
    fn no_tick_is_shorter_or_longer_than_the_slew_allows() {
        let mut members = [Member::new(50.0, 0.0)];
        drive(3_000, &mut members);
        for pair in members[0].ticks.windows(2) {
            let length = pair[1] - pair[0];
            assert!(
                (length - 1_000.0).abs() < f64::from(SLEW_US) + 0.1,
                "{length}"
            );
        }
    }

    #[test]
    fn runs_free_without_sync_or_with_a_period_it_cannot_divide() {
        let mut phase = TickPhase::new();
        phase.on_sync(Micros(12_345));
        assert_eq!(phase.next(Micros(100)), Micros(1_100));
        let mut phase = TickPhase::with_period(2_500);
        phase.on_sync(Micros(12_345));
        assert_eq!(phase.next(Micros(100)), Micros(1_100));
    }

    #[test]
    fn a_lost_sync_changes_nothing_and_a_long_silence_begins_anew() {
        let mut phase = TickPhase::with_period(PERIOD_US);
        phase.on_sync(Micros(10_000));
        phase.on_sync(Micros(40_000));
        assert_eq!(phase.next(Micros(41_000)), Micros(42_000));
        phase.on_sync(Micros(2_000_300));
        assert_eq!(phase.next(Micros(2_001_290)), Micros(2_002_300));
    }
}
