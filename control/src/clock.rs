//! The members' common clock: a phase lock on SYNC.
//!
//! SYNC reaches all members at the same instant, but it comes from a PC and jitters, and each
//! member's crystal runs a little fast or slow. A second-order tracking loop estimates, in this
//! member's own time, when SYNC would have arrived without the jitter. An eighth of the bandwidth
//! of SYNC itself would still follow the jitter, so the gains are a 32nd and a 4096th. The
//! remaining jitter is the same in every member, because all filter the same instants in the same
//! way. The integral part removes the difference between the crystals. Until as many SYNCs have
//! come as such gains remember, the estimate is the straight line of least squares through all so
//! far, whose gains fall from one to those: with fixed gains the crystals' difference would be
//! learnt in seconds, and ticks of members 100 ppm apart be 22 us from each other meanwhile. A test
//! shows that they coincide within a few microseconds.
//!
//! # Ticks
//!
//! The control tick follows that estimate: [`TickSchedule`] moves each tick by at most
//! [`MAX_SHIFT_US`] towards half a tick after the grid, far from the moment at which SYNC frames
//! arrive. The grid is as fast as SYNC, not as this member's crystal: an estimate is followed until
//! some ms after the next SYNC, 8 ms on average, in which crystals 100 ppm apart move ticks by 0.8
//! us from each other. It begins to follow a new estimate not when SYNC arrives, which one member
//! may process before a tick and another after it, but a fixed time after the estimate, with the
//! same tick in all. A target takes effect [`protocol::timing::agreement_delay_us`] after the
//! estimated SYNC, when the members have agreed on it, and 200 us before a tick, so that no member
//! is a tick ahead of another.

use crate::time::{Micros, TICK_US};

/// Part of the phase error that is corrected at once when many SYNCs have come, as a shift: a 32nd.
const PHASE_SHIFT: u32 = 5;

/// Part of the phase error that goes into the period, as a shift: critically damped, a quarter of
/// the square of the other, a 4096th.
const PERIOD_SHIFT: u32 = 2 * PHASE_SHIFT + 2;

/// Fractional bits of a microsecond in the loop: 1e-6 us. A core without a floating-point unit
/// needs a fifth of the time for whole numbers.
const FRACTION: u32 = 20;

/// Largest deviation of the period that is accepted, in a microsecond: 500 ppm.
const MAX_DRIFT: i64 = (1 << FRACTION) / 2_000;

/// The same while the gains fall, a quarter: jitter of the first SYNCs looks like a period of their
/// own, in all members alike. Cut off, it would take the crystals' difference with it.
const MAX_FIRST_DRIFT: i64 = (1 << FRACTION) / 4;

/// SYNCs after which no gain falls any more: `6 / (n (n + 1))` is less than a 4096th.
const SETTLED: u32 = 157;

/// Missing SYNCs that are bridged.
const MAX_GAP: u32 = 8;

/// Longest period for which the drift fits, us. The protocol's longest is 100 ms.
const MAX_PERIOD_US: u32 = 200_000;

/// Largest shift of one tick, us: 2 % of the tick, but some.
pub const MAX_SHIFT_US: u32 = if TICK_US < 50 { 1 } else { TICK_US / 50 };

/// Position of the ticks between two grid points, us.
const TICK_PHASE: u32 = TICK_US / 2;

/// Longest time from the estimated SYNC until the ticks follow it, us: when even a SYNC that is
/// 2 ms late has been received, and in the middle between two ticks, so that all members begin with
/// the same tick.
const FOLLOW_US: u32 = 3_000;

/// Estimates when SYNC comes.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct SyncClock {
    /// The last SYNC as estimated, whole microseconds.
    at: Micros,
    /// And the rest, 0 to 1 us, in steps of 2^-20 us.
    rest: i32,
    /// Period minus nominal period in this member's time, in the same steps.
    drift: i32,
    /// SYNCs since the lock, at most [`SETTLED`]; 0 for none.
    count: u32,
}

impl SyncClock {
    /// No SYNC has been received.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            at: Micros(0),
            rest: 0,
            drift: 0,
            count: 0,
        }
    }

    /// A SYNC was received at `at`; they are meant to come every `period_us`, at most
    /// [`MAX_PERIOD_US`].
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "at most nine periods, of which the error is half of one"
    )]
    pub fn on_sync(&mut self, at: Micros, period_us: u32) {
        let period_us = period_us.min(MAX_PERIOD_US);
        let elapsed_us = u32::try_from(at.since(self.at).0).unwrap_or(u32::MAX);
        if self.count == 0 || elapsed_us > MAX_GAP * period_us {
            self.at = at;
            self.rest = 0;
            self.count = 1;
            return;
        }
        if 2 * elapsed_us <= period_us {
            // Twice in one period: the bus side decides whether there is a second master.
            return;
        }
        let periods = (elapsed_us + period_us / 2) / period_us;
        let nominal_us = periods * period_us;
        // What the estimate moves by beyond the nominal time.
        let expected = i64::from(self.rest) + i64::from(periods) * i64::from(self.drift);
        let off_us = elapsed_us as i32 - nominal_us as i32;
        let error = (i64::from(off_us) << FRACTION) - expected;
        self.count = (self.count + 1).min(SETTLED);
        let count = i64::from(self.count);
        let largest = if self.count < SETTLED {
            MAX_FIRST_DRIFT
        } else {
            MAX_DRIFT
        };
        let most = (i64::from(period_us) * largest).min(i32::MAX.into());
        let drift = i64::from(self.drift) + part(error, 6, count, PERIOD_SHIFT);
        self.drift = drift.clamp(-most, most) as i32;
        let moved = expected + part(error, 4 * count - 2, count, PHASE_SHIFT);
        self.rest = moved as i32 & ((1 << FRACTION) - 1);
        let moved_us = (moved >> FRACTION) as i32;
        self.at = self.at + Micros(u64::from(nominal_us.wrapping_add_signed(moved_us)));
    }

    /// Time of the last SYNC without jitter; `None` before the first.
    #[must_use]
    pub fn estimate(&self) -> Option<Micros> {
        (self.count > 0).then_some(self.at)
    }

    /// Apparent excess of SYNC's period over nominal, us: the crystals' difference.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "some hundred us in 24 bits")]
    pub const fn drift_us(&self) -> f32 {
        self.drift as f32 / (1 << FRACTION) as f32
    }
}

/// The part of an error that a straight line of least squares takes from the last of `count` SYNCs,
/// `numerator / (count (count + 1))`, but no less than the shift leaves.
const fn part(error: i64, numerator: i64, count: i64, shift: u32) -> i64 {
    let denominator = count * (count + 1);
    if numerator << shift > denominator {
        error * numerator / denominator
    } else {
        error >> shift
    }
}

/// The grid that the ticks follow: a point of it, which moves on by the crystal's error.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct Grid {
    /// The lower half of its time, whole microseconds.
    at: u32,
    /// And the rest, 0 to 1 us, in steps of 2^-20 us.
    rest: i32,
    /// A tick in this member's time minus its nominal length, in the same steps.
    drift: i32,
}

impl Grid {
    /// The grid of a clock that has an estimate, as of `due`; `ticks` are a period of SYNC.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        reason = "at most nine periods; the time wraps"
    )]
    fn new(clock: &SyncClock, due: Micros, ticks: u32) -> Self {
        let drift = clock.drift / ticks.max(1) as i32;
        let since = u32::try_from(due.since(clock.at).0).unwrap_or(0) / TICK_US;
        let moved = i64::from(clock.rest) + i64::from(drift) * i64::from(since);
        Self {
            at: low(clock.at).wrapping_add((moved >> FRACTION) as u32),
            rest: moved as i32 & ((1 << FRACTION) - 1),
            drift,
        }
    }

    /// The same a tick later.
    #[expect(clippy::cast_sign_loss, reason = "the time wraps")]
    fn next(self) -> Self {
        let moved = self.rest + self.drift;
        Self {
            at: self.at.wrapping_add((moved >> FRACTION) as u32),
            rest: moved & ((1 << FRACTION) - 1),
            ..self
        }
    }
}

/// Decides when the next control tick begins, so that all members tick together.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct TickSchedule {
    clock: SyncClock,
    period_us: u32,
    last_sync: Micros,
    grid: Option<Grid>,
    /// The ticks follow the clock's estimate from here on; `None` when they do already.
    follows_at: Option<Micros>,
}

impl TickSchedule {
    /// Ticks that run free.
    #[must_use]
    pub const fn new() -> Self {
        Self::with_period(0)
    }

    /// Ticks in step with a SYNC of this period. They run free until the first SYNC, and for good
    /// when the period is not a whole number of ticks.
    #[must_use]
    pub const fn with_period(period_us: u32) -> Self {
        Self {
            clock: SyncClock::new(),
            period_us,
            last_sync: Micros(0),
            grid: None,
            follows_at: None,
        }
    }

    /// Processes the latest SYNC, received at `at`; may be called each tick, because one SYNC
    /// counts once.
    pub fn on_sync(&mut self, at: Micros) {
        let fits = self.period_us != 0 && self.period_us.is_multiple_of(TICK_US);
        if fits && at != self.last_sync {
            self.last_sync = at;
            self.clock.on_sync(at, self.period_us);
            let half = self.period_us / 2 / TICK_US * TICK_US;
            let later = Micros(half.min(FOLLOW_US).into());
            self.follows_at = self.clock.estimate().map(|sync| sync + later);
        }
    }

    /// When the tick after the one at `due` begins: a period later, moved by at most
    /// [`MAX_SHIFT_US`] towards the common grid.
    #[must_use]
    pub fn next(&mut self, due: Micros) -> Micros {
        let next = due + Micros(TICK_US.into());
        if let Some(at) = self.follows_at
            && (self.grid.is_none() || due >= at)
        {
            self.follows_at = None;
            self.grid = Some(Grid::new(&self.clock, due, self.period_us / TICK_US));
        }
        let Some(grid) = &mut self.grid else {
            return next;
        };
        *grid = grid.next();
        // Distance past the last grid point. The low halves suffice for an hour's difference, and a
        // 64-bit remainder is slow on a 32-bit machine. A second is added first, because the grid
        // may lie a little ahead.
        let since_grid = low(next)
            .wrapping_sub(grid.at)
            .wrapping_add(1_000 * TICK_US);
        let past = since_grid.wrapping_sub(TICK_PHASE) % TICK_US;
        if past < TICK_US / 2 {
            next - Micros(u64::from(past.min(MAX_SHIFT_US)))
        } else {
            next + Micros(u64::from((TICK_US - past).min(MAX_SHIFT_US)))
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "that is the point")]
const fn low(at: Micros) -> u32 {
    at.0 as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const PERIOD_NS: i64 = 10_000_000;

    /// A member with its own crystal and its own idea of when time began.
    struct Member {
        rate: f64,
        offset_us: f64,
        phase: TickSchedule,
        scheduled: Option<Micros>,
        /// True times of its ticks, ns.
        ticks: Vec<i64>,
    }

    impl Member {
        fn new(ppm: f64, offset_us: f64) -> Self {
            Self {
                rate: 1.0 + ppm * 1e-6,
                offset_us,
                phase: TickSchedule::with_period(10_000),
                scheduled: None,
                ticks: Vec::new(),
            }
        }

        fn local(&self, true_ns: i64) -> Micros {
            Micros((true_ns as f64 * 1e-3 * self.rate + self.offset_us) as u64)
        }

        fn to_true(&self, local: Micros) -> i64 {
            ((local.0 as f64 - self.offset_us) / self.rate * 1e3) as i64
        }

        fn run_ticks_until(&mut self, true_ns: i64) {
            let mut scheduled = self.scheduled.unwrap_or(self.local(0));
            while self.to_true(scheduled) < true_ns {
                self.ticks.push(self.to_true(scheduled));
                scheduled = self.phase.next(scheduled);
            }
            self.scheduled = Some(scheduled);
        }

        fn sync(&mut self, true_ns: i64) {
            let at = self.local(true_ns);
            self.phase.on_sync(at);
        }
    }

    /// Uniform in -1..1, the same every time.
    struct Noise(u64);

    impl Noise {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }
    }

    /// Worst distance between a tick of one member and the nearest of the other, us, from `from_s`
    /// on.
    fn worst_skew(jitter_ns: f64, joins_later: i64, from_s: i64) -> f64 {
        let mut a = Member::new(50.0, 1_000.0);
        let mut b = Member::new(-50.0, 777_333.0);
        let mut noise = Noise(42);
        for k in 1..6_000_i64 {
            let at = k * PERIOD_NS + (noise.next() * jitter_ns) as i64;
            a.run_ticks_until(at);
            b.run_ticks_until(at);
            a.sync(at);
            if k > joins_later {
                b.sync(at);
            }
        }
        let start = from_s * 1_000_000_000;
        let mut worst = 0_i64;
        let mut other = b.ticks.iter().copied().peekable();
        for tick in a.ticks.iter().copied().filter(|tick| *tick > start) {
            let mut nearest = i64::MAX;
            while let Some(candidate) = other.peek().copied() {
                nearest = nearest.min((candidate - tick).abs());
                if candidate > tick {
                    break;
                }
                other.next();
            }
            if nearest < i64::MAX && other.peek().is_some() {
                worst = worst.max(nearest);
            }
        }
        worst as f64 * 1e-3
    }

    /// Each estimate, and each tick, is rounded to 1 us in both; the rest is what the jitter leaves
    /// of the crystals' difference.
    #[test]
    fn members_100_ppm_apart_tick_within_2_us_under_jitter_of_1_5_ms() {
        let skew = worst_skew(1.5e6, 0, 5);
        std::println!("worst skew over 60 s with 1.5 ms of SYNC jitter: {skew:.1} us");
        assert!(skew < 2.0, "{skew} us");
    }

    /// From a second on. The crystals differ by 1 us in a period, which fixed gains would let grow
    /// to 22 us before they have learnt it.
    #[test]
    fn the_first_seconds_are_as_good() {
        let skew = worst_skew(1.5e6, 0, 1).max(worst_skew(0.0, 0, 1));
        std::println!("worst skew from a second on: {skew:.1} us");
        assert!(skew < 2.0, "{skew} us");
    }

    #[test]
    fn without_jitter_they_tick_within_3_us() {
        // Rounding of reception time, estimate and tick to 1 us each. The loop's time constant is
        // 64 SYNCs; the 0.5 us a period of either crystal are learnt to 1 % after seven of them.
        let skew = worst_skew(0.0, 0, 5);
        assert!(skew < 3.0, "{skew} us");
    }

    /// The ticks of a member whose crystal is off by 100 ppm keep the period of SYNC, not that of
    /// the crystal, for 100 ms after the last one: no more than a step of either is lost.
    #[test]
    fn between_two_syncs_ticks_are_as_fast_as_sync() {
        let mut member = Member::new(100.0, 0.0);
        for k in 1..3_000 {
            member.run_ticks_until(k * PERIOD_NS);
            member.sync(k * PERIOD_NS);
        }
        member.run_ticks_until(3_010 * PERIOD_NS);
        for tick in &member.ticks[25_000..] {
            let off_us = (tick % 1_000_000 - 500_000) as f64 * 1e-3;
            assert!(off_us.abs() < 2.0, "{off_us} us at {tick} ns");
        }
    }

    #[test]
    fn a_member_that_joins_later_comes_into_step() {
        let skew = worst_skew(1.5e6, 1000, 15);
        assert!(skew < 50.0, "{skew} us");
    }

    #[test]
    fn the_crystal_is_measured() {
        let mut member = Member::new(50.0, 0.0);
        for k in 1..3000 {
            member.sync(k * PERIOD_NS);
        }
        // 50 ppm of 10 ms.
        assert!((member.phase.clock.drift_us() - 0.5).abs() < 0.02);
    }

    #[test]
    fn a_missing_sync_is_bridged() {
        let mut clock = SyncClock::new();
        for k in 1..=100_u64 {
            if k % 7 != 0 {
                clock.on_sync(Micros(k * 10_000), 10_000);
            }
        }
        assert_eq!(clock.estimate(), Some(Micros(1_000_000)));
    }

    #[test]
    fn a_long_pause_starts_over() {
        let mut clock = SyncClock::new();
        clock.on_sync(Micros(10_000), 10_000);
        clock.on_sync(Micros(5_003_333), 10_000);
        assert_eq!(clock.estimate(), Some(Micros(5_003_333)));
    }

    #[test]
    fn a_tick_moves_by_two_percent_at_most() {
        let mut phase = TickSchedule::with_period(10_000);
        phase.on_sync(Micros(10_000));
        for due in 20_000..22_000_u64 {
            let length = phase.next(Micros(due)).0 - due;
            assert!((980..=1020).contains(&length));
        }
        // On the grid it stays there.
        assert_eq!(phase.next(Micros(20_500)), Micros(21_500));
        assert_eq!(phase.next(Micros(20_510)), Micros(21_500));
        assert_eq!(phase.next(Micros(20_490)), Micros(21_500));
    }

    #[test]
    fn a_grid_ahead_of_the_tick_is_as_good() {
        let mut phase = TickSchedule::with_period(10_000);
        phase.on_sync(Micros(10_000));
        for due in (500..10_000).step_by(1_000) {
            assert_eq!(phase.next(Micros(due)), Micros(due + 1_000));
        }
    }

    #[test]
    fn ticks_run_free_without_sync_or_with_a_period_they_cannot_divide() {
        assert_eq!(TickSchedule::new().next(Micros(123)), Micros(1_123));
        let mut phase = TickSchedule::with_period(2_500);
        phase.on_sync(Micros(10_000));
        assert_eq!(phase.next(Micros(123)), Micros(1_123));
    }
}
