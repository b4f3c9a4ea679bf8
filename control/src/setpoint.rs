//! From one target per SYNC to one input per tick.
//!
//! A target every 10 ms would be a staircase for a loop that runs every millisecond. Each target is
//! therefore reached by a straight line over one SYNC period, starting at an instant all members
//! agree on. The line is a function of time since that instant, not of ticks, so members whose
//! ticks fall at different times still follow the same line. Its slope is passed on as the expected
//! acceleration.

use kinematics::Twist;

use crate::quantity::{Acceleration, Part, PerSecond, Velocity};
use crate::time::Micros;
use crate::twist::{quantities, scaled};

/// A straight line from the last target to this one.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Interpolator {
    from: Twist<Velocity>,
    to: Twist<Velocity>,
    slope: Twist<Acceleration>,
    begin: Micros,
    update: u16,
    period_us: u32,
    part: Part,
    per_second: PerSecond,
}

/// Input of the limiter.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Input {
    /// m/s, m/s, rad/s, group frame.
    pub twist: Twist<Velocity>,
    /// Its change per second.
    pub slope: Twist<Acceleration>,
}

impl Interpolator {
    /// For SYNCs every `period_us` microseconds.
    #[must_use]
    pub fn new(period_us: u32) -> Self {
        Self {
            period_us,
            part: Part::of(period_us),
            per_second: PerSecond::of_micros(period_us),
            ..Self::default()
        }
    }

    /// Starts over from this twist: the next target is reached from here.
    pub fn restart(&mut self, twist: Twist<Velocity>, update: u16) {
        self.from = twist;
        self.to = twist;
        self.slope = Twist::default();
        self.update = update;
    }

    /// The input at `now`, with target number `update` to take effect at `begin`: until then the
    /// previous line continues.
    #[inline]
    pub fn at(&mut self, now: Micros, target: Twist, update: u16, begin: Micros) -> Input {
        if update != self.update {
            self.renew(now, target, update, begin);
        }
        self.input(now)
    }

    /// Starts the line to the target when its time has come, once per SYNC. Not inlined, so that
    /// the other ticks do not wait for a comparison of times.
    #[inline(never)]
    fn renew(&mut self, now: Micros, target: Twist, update: u16, begin: Micros) {
        if now >= begin {
            self.from = self.input(begin).twist;
            self.to = quantities(target);
            self.slope = scaled(self.to - self.from, self.per_second);
            self.begin = begin;
            self.update = update;
        }
    }

    #[inline]
    fn input(&self, now: Micros) -> Input {
        let elapsed = u32::try_from(now.since(self.begin).0).unwrap_or(u32::MAX);
        if elapsed >= self.period_us {
            return Input {
                twist: self.to,
                slope: Twist::default(),
            };
        }
        Input {
            twist: self.from + scaled(self.to - self.from, self.part.at(elapsed)),
            slope: self.slope,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_US: u32 = 10_000;

    fn vx(input: Input) -> f32 {
        input.twist.vx.to_f32()
    }

    #[test]
    fn passes_from_target_to_target_in_one_period() {
        let mut line = Interpolator::new(PERIOD_US);
        let target = Twist::new(1.0, 0.0, -2.0);
        let begin = Micros(50_000);
        let input = line.at(Micros(50_000), target, 1, begin);
        assert_eq!((vx(input), input.slope.vx.to_f32()), (0.0, 100.0));
        let input = line.at(Micros(52_500), target, 1, begin);
        assert!((vx(input) - 0.25).abs() < 1e-6);
        assert!((input.twist.omega.to_f32() + 0.5).abs() < 1e-6);
        assert!((input.slope.omega.to_f32() + 200.0).abs() < 1e-4);
        let input = line.at(Micros(60_000), target, 1, begin);
        assert_eq!((vx(input), input.slope.vx.to_f32()), (1.0, 0.0));
    }

    #[test]
    fn a_hundred_hertz_ramp_makes_no_steps() {
        // Targets of a straight ramp, 2 m/s^2: every tick must add exactly 2 mm/s.
        let mut line = Interpolator::new(PERIOD_US);
        let mut last = 0.0;
        for tick in 0..200_u16 {
            let now = Micros(u64::from(tick) * 1000 + 300);
            let update = tick / 10 + 1;
            let begin = Micros(u64::from(tick / 10) * 10_000);
            let target = Twist::new(0.02 * f32::from(update), 0.0, 0.0);
            let value = vx(line.at(now, target, update, begin));
            if tick > 0 {
                assert!((value - last - 0.002).abs() < 1e-6, "step at tick {tick}");
            }
            last = value;
        }
    }

    #[test]
    fn an_early_sync_makes_no_jump() {
        let mut line = Interpolator::new(PERIOD_US);
        line.at(Micros(0), Twist::new(1.0, 0.0, 0.0), 1, Micros(0));
        let before = vx(line.at(Micros(8_000), Twist::new(1.0, 0.0, 0.0), 1, Micros(0)));
        let after = vx(line.at(Micros(8_000), Twist::new(2.0, 0.0, 0.0), 2, Micros(8_000)));
        assert_eq!(before, after);
    }

    #[test]
    fn a_target_waits_for_its_instant() {
        let mut line = Interpolator::new(PERIOD_US);
        let (first, second) = (Twist::new(1.0, 0.0, 0.0), Twist::new(3.0, 0.0, 0.0));
        line.at(Micros(0), first, 1, Micros(0));
        // Known at 8 ms, in force at 10 ms.
        assert!((vx(line.at(Micros(8_500), second, 2, Micros(10_000))) - 0.85).abs() < 1e-6);
        assert!((vx(line.at(Micros(10_500), second, 2, Micros(10_000))) - 1.1).abs() < 1e-6);
    }

    #[test]
    fn the_line_does_not_depend_on_where_the_ticks_lie() {
        let walk = |phase: u64| {
            let mut line = Interpolator::new(PERIOD_US);
            let mut value = 0.0;
            for tick in 0..55_u64 {
                let now = Micros(tick * 1_000 + phase);
                let update = (now.0 / 10_000) as u16 + 1;
                let begin = Micros(u64::from(update - 1) * 10_000);
                let target = Twist::new(0.1 * f32::from(update * update), 0.0, 0.0);
                value = vx(line.at(now, target, update, begin));
            }
            value
        };
        // At 54.3 and 54.4 ms: a tenth of a millisecond on a slope of 1.1 in 10 ms.
        assert!((walk(400) - walk(300) - 0.011).abs() < 1e-5);
    }

    #[test]
    fn a_missing_target_holds_the_last() {
        let mut line = Interpolator::new(PERIOD_US);
        let target = Twist::new(1.0, 0.0, 0.0);
        line.at(Micros(0), target, 1, Micros(0));
        let input = line.at(Micros(u64::MAX), target, 1, Micros(0));
        assert_eq!((vx(input), input.slope.vx.to_f32()), (1.0, 0.0));
    }
}
