//! Detects an encoder that has stopped counting, by comparison with the other three wheels.
//!
//! # Theory of operation
//!
//! Four wheels measure three degrees of freedom. The redundant fourth, the slip residual, gives the
//! angle by which a wheel must have turned if the other three are right (the *implied* angle); this
//! needs no model of the motor, the load or the slope. Half of the commanded angle, less the counts
//! in that direction, accumulates to a *missed* angle that never falls below zero, and half of the
//! implied angle accumulates to a second one; the smaller of the two is used. An encoder that
//! counts more than half of either angle does not miss anything for long. A kerb that stops all
//! four wheels implies no motion.
//!
//! | missed (at the commanded rate w) | counted in that time | result |
//! |---|---|---|
//! | 10 ms w and three counts | next to nothing | *suspected*: the loop stops trusting the encoder |
//! | 15 ms w and 0.05 rad | next to nothing | *dead*: a fault; the wheel gets its feedforward alone |
//! | either | more | not silent: [`crate::watch`] decides whether the wheel is blocked |
//!
//! In time: 28 ms at 4 rad/s, 40 ms at 2 rad/s, 167 ms at 0.33 rad/s. *Next to nothing* is the net
//! of four counts and twenty a second, which an open input beside motor leads may collect; so few
//! counts do not clear an encoder. Nor do counts by chance, which come when one of two channels is
//! open and follows its neighbour: they go back and forth, and little is left of them.
//!
//! # Limits
//!
//! It cannot distinguish a dead encoder from a wheel that is held fast while the other
//! three continue, which has the same reaction. It does not detect two wheels whose errors cancel
//! in the residual, or four encoders that stop together; [`crate::watch`] and the torque bound
//! cover these.
//!
//! Cost: 31 instructions a wheel.

use crate::quantity::{Angle, Duration, Half, Rate, Time};

/// A suspicion takes this time at the expected rate, s,
const SUSPECTED_TIME: Time = Time::new(0.010);
/// and as many counts.
const SUSPECTED_COUNTS: f32 = 3.0;
/// Certainty takes this time at the expected rate, s,
const DEAD_TIME: Time = Time::new(0.015);
/// and this angle, rad: more than the play between motor and wheel,
const DEAD_ANGLE: f32 = 0.05;
/// and at least as many counts.
const DEAD_COUNTS: f32 = 8.0;

/// Counts that come in a bunch on an open input,
const STRAY_COUNTS: Duration = Duration::new(4.0);
/// and a second.
pub(crate) const STRAY_COUNTS_PER_SECOND: f32 = 20.0;
const STRAY: Duration = Duration::new(STRAY_COUNTS_PER_SECOND);

/// Counts are by chance when they have changed their direction so often, and their net is less than
/// half of their sum without signs.
const CHANCE: u8 = 6;

/// A wheel that is expected to be slower counts as at rest, rad/s.
const STANDS: Rate = Rate::new(0.02);

/// State of an encoder.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Trust {
    /// It counts.
    Full,
    /// It has counted far too little for a short time.
    Suspected,
    /// It is dead.
    None,
}

/// Checks one encoder.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Silence {
    /// rad a count.
    step: Angle,
    /// Half of what the counts and the angle above are, rad.
    suspected_angle: Angle,
    dead_angle: Angle,
    /// What is missed of the angle asked for is compared with it: the first of the two, or less
    /// than anything once the encoder is dead, which saves a test of the flag.
    alarm: Angle,
    /// Of half the angle asked for, and of half the angle implied, rad.
    missed_asked: Angle,
    missed_implied: Angle,
    /// Net of the counts since the suspicion, rad, and how long that is, s.
    counted: Angle,
    lasted: Duration,
    /// Their sum without signs, rad; whether it counted ahead last, and how often that has changed.
    back_and_forth: Angle,
    ahead: bool,
    changes: u8,
    /// Latched until [`Silence::reset`].
    dead: bool,
}

impl Silence {
    /// For an encoder whose count is `step` rad, positive. A disabled check never suspects the
    /// encoder.
    pub(crate) fn new(step: f32, listens: bool) -> Self {
        let counts = DEAD_COUNTS * step;
        let suspected_angle = if listens {
            Angle::new(0.5 * SUSPECTED_COUNTS * step)
        } else {
            Angle::MAX
        };
        Self {
            step: Angle::new(step),
            suspected_angle,
            alarm: suspected_angle,
            dead_angle: Angle::new(0.5 * counts.max(DEAD_ANGLE)),
            missed_asked: Angle::ZERO,
            missed_implied: Angle::ZERO,
            counted: Angle::ZERO,
            lasted: Duration::ZERO,
            back_and_forth: Angle::ZERO,
            ahead: true,
            changes: 0,
            dead: false,
        }
    }

    /// Drops a suspicion, but no fault.
    pub(crate) fn forgive(&mut self) {
        self.missed_asked = Angle::ZERO;
    }

    /// Clears its state.
    pub(crate) fn reset(&mut self) {
        self.dead = false;
        self.alarm = self.suspected_angle;
        self.missed_asked = Angle::ZERO;
    }

    /// Evaluates one tick of `dt` s: the reference rate, rad/s, the angle that the other three
    /// wheels imply, and the angle of the encoder, rad.
    #[inline(always)]
    pub(crate) fn update(
        &mut self,
        rate_ref: Rate,
        implied: Angle,
        turned: Angle,
        dt: Time,
    ) -> Trust {
        // Along the reference everything is positive. Half of a difference costs less than the
        // difference of halves.
        let half = Half::along(rate_ref);
        let twice = turned + turned;
        let missed = self.missed_implied + half.of(implied - twice);
        self.missed_implied = missed.not_below_zero();
        let before = self.missed_asked;
        let asked: Angle = rate_ref.times(dt);
        let missed = before + half.of(asked - twice);
        self.missed_asked = missed.not_below_zero();
        if missed > self.alarm {
            if before <= self.suspected_angle {
                // Not the counts of this tick, in which the encoder may have stopped. Counts
                // against the reference come from a live encoder.
                self.counted = -half.of(twice).not_below_zero();
                self.lasted = Duration::ZERO;
                (self.back_and_forth, self.changes) = (Angle::ZERO, 0);
            }
            return self.suspect(rate_ref.abs(), half.of(twice), dt);
        }
        Trust::Full
    }

    #[cold]
    #[inline(never)]
    fn suspect(&mut self, asked: Rate, counted: Angle, dt: Time) -> Trust {
        if self.dead {
            return Trust::None;
        }
        if asked < STANDS {
            self.missed_asked = Angle::ZERO;
            return Trust::Full;
        }
        self.counted += counted;
        self.lasted += dt.to();
        self.back_and_forth += counted.abs();
        if self.ahead && counted < Angle::ZERO || !self.ahead && counted > Angle::ZERO {
            self.ahead = !self.ahead;
            self.changes = self.changes.saturating_add(1);
        }
        let missed = self.missed_asked.min(self.missed_implied);
        let half = asked.half();
        if missed <= self.suspected_angle + half.times(SUSPECTED_TIME) {
            return Trust::Full;
        }
        // In counts.
        let stray = STRAY_COUNTS + self.lasted.times(STRAY);
        let net = self.counted.abs();
        let by_chance = self.changes >= CHANCE && net + net < self.back_and_forth;
        if net > self.step.times(stray) && !by_chance {
            // The encoder is alive but the wheel does not follow: this is not a fault of the
            // encoder.
            return Trust::Full;
        }
        self.dead = missed > self.dead_angle + half.times(DEAD_TIME);
        if self.dead {
            self.alarm = Angle::MIN;
            Trust::None
        } else {
            Trust::Suspected
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 1e-3;
    /// 4096 counts a turn.
    const STEP: f32 = core::f32::consts::TAU / 4096.0;

    /// One tick, in rad/s, rad and s.
    fn update(silence: &mut Silence, rate: f32, implied: f32, turned: f32, dt: f32) -> Trust {
        silence.update(
            Rate::new(rate),
            Angle::new(implied),
            Angle::new(turned),
            Time::new(dt),
        )
    }

    /// Milliseconds until an encoder is known dead that counts `turned(ms)` rad while `rate` is
    /// expected.
    fn dead_after(rate: f32, turned: impl Fn(u32) -> f32) -> Option<u32> {
        let mut silence = Silence::new(STEP, true);
        (1..=5_000)
            .find(|tick| update(&mut silence, rate, rate * DT, turned(*tick), DT) == Trust::None)
    }

    /// What a wheel that turns at `rate` counts in the tick that ends at `ms`, rad.
    fn counts(rate: f32, ms: u32) -> f32 {
        let at = |ms: u32| (f64::from(rate) * f64::from(ms) * 1e-3 / f64::from(STEP)).floor();
        (at(ms) - at(ms - 1)) as f32 * STEP
    }

    /// `15 ms + 0.05 rad / w`, by the table above.
    #[test]
    fn silence_is_certain_after_the_time_of_the_closed_form() {
        for rate in [0.131, 0.33, 0.66, 1.97, 3.94, -3.94, 15.0_f32] {
            let want = 1e3 * (DEAD_TIME.to_f32() + DEAD_ANGLE / rate.abs());
            let took = dead_after(rate, |_| 0.0).unwrap();
            assert!((took as f32 - want).abs() <= 1.5, "{took} ms, not {want}");
        }
    }

    /// 40 000 counts a turn are 25 in a tick at 3.94 rad/s: a fifth of a tick is more than stray
    /// counts.
    #[test]
    fn the_counts_of_the_tick_in_which_it_falls_silent_acquit_nobody() {
        const FINE: f32 = core::f32::consts::TAU / 40_000.0;
        let (rate, dt) = (3.94, DT);
        for share in [0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.9] {
            let mut silence = Silence::new(FINE, true);
            update(&mut silence, rate, rate * dt, share * rate * dt, dt);
            let wanted = (1..=1_000)
                .find(|_| update(&mut silence, rate, rate * dt, 0.0, dt) == Trust::None)
                .unwrap();
            assert!(wanted <= 29, "{share}: {wanted} ms");
        }
    }

    #[test]
    fn stray_counts_acquit_nobody() {
        // Three in a bunch every 150 ms, always forward: 20 a second.
        let bunches = |ms: u32| {
            if ms.is_multiple_of(150) {
                3.0 * STEP
            } else {
                0.0
            }
        };
        let evenly = |ms: u32| if ms.is_multiple_of(50) { STEP } else { 0.0 };
        for rate in [0.33, 0.66, 1.97] {
            for stray in [bunches, evenly] {
                let quiet = dead_after(rate, |_| 0.0).unwrap();
                let noisy = dead_after(rate, stray).unwrap();
                assert!(
                    noisy <= quiet + quiet / 3 + 1,
                    "{noisy} ms, {quiet} without"
                );
            }
        }
    }

    /// Forward or back by the bits of a number, at every edge of one channel.
    #[test]
    fn counts_by_chance_acquit_nobody() {
        for rate in [0.66, 1.97, 3.94] {
            for seed in [0xB7E1_5162, 0x9E37_79B9, 0x6A09_E667_u32] {
                let by_chance = |ms: u32| {
                    let forward = seed.rotate_left(ms * 7 % 31) & 1 == 1;
                    let sign = if forward { 1.0 } else { -1.0 };
                    sign * counts(rate / 2.0, ms)
                };
                let quiet = dead_after(rate, |_| 0.0).unwrap();
                let noisy = dead_after(rate, by_chance).unwrap();
                assert!(noisy <= 2 * quiet, "{noisy} ms, {quiet} without");
            }
        }
    }

    /// A quarter of what is asked, with a count back and one forward again in every third tick.
    #[test]
    fn a_wheel_that_rattles_and_turns_is_not_silent() {
        let rattles = |ms: u32| match ms % 3 {
            0 => -STEP,
            1 => STEP,
            _ => 0.0,
        };
        assert_eq!(
            dead_after(3.94, |ms| counts(3.94 / 4.0, ms) + rattles(ms)),
            None
        );
    }

    #[test]
    fn a_wheel_that_counts_most_of_it_is_well_at_any_rate() {
        for rate in [0.021, 0.077, 0.131, 0.66, 3.94, 15.0] {
            for share in [0.55, 0.8, 1.0, 1.5] {
                assert_eq!(
                    dead_after(rate, |ms| counts(rate * share, ms)),
                    None,
                    "{rate}"
                );
            }
        }
    }

    #[test]
    fn a_wheel_that_turns_slowly_is_not_silent() {
        // A quarter of what is asked, 160 counts a second; an eighth of four times as much.
        assert_eq!(dead_after(0.98, |ms| counts(0.98 / 4.0, ms)), None);
        assert_eq!(dead_after(3.94, |ms| counts(3.94 / 8.0, ms)), None);
    }

    #[test]
    fn nothing_is_expected_of_a_wheel_whose_neighbours_stand() {
        let mut silence = Silence::new(STEP, true);
        for _ in 0..5_000 {
            assert_eq!(update(&mut silence, 2.0, 0.0, 0.0, DT), Trust::Full);
        }
    }

    /// A processor that stood still for 22 ms sees all of it in one tick: what counted backwards
    /// meanwhile is alive.
    #[test]
    fn a_long_tick_against_the_reference_is_not_silent() {
        let mut silence = Silence::new(STEP, true);
        let (rate, long) = (4.0, 0.022);
        for _ in 0..100 {
            let trust = update(&mut silence, rate, rate * DT, rate * DT, DT);
            assert_eq!(trust, Trust::Full);
        }
        let trust = update(&mut silence, rate, rate * long, -rate * long, long);
        assert_eq!(trust, Trust::Full);
        for _ in 0..20 {
            let trust = update(&mut silence, rate, rate * DT, -rate * DT, DT);
            assert_eq!(trust, Trust::Full);
        }
    }
}
