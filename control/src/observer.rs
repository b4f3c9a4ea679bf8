//! Wheel rate from a wrapping encoder counter.
//!
//! Counting edges per millisecond does not work at crawling speed: a wheel with 40 counts a second
//! reads 0 for 24 ticks and 1000 counts a second for one. Instead a model of the wheel turns with
//! the estimated rate, and the counter corrects it. The counter does not give the position of the
//! wheel, but an interval one count wide in which it lies: a deviation from the middle counts half
//! within the interval and in full beyond it. As a second-order loop the observer has no lag at
//! constant speed; the reference acceleration is fed in, so it has none under planned acceleration
//! either.
//!
//! The bandwidth is limited to half of the rate of edges, because there is no information between
//! two edges. Both choices were made by simulating the closed wheel loop from 10 mm/s to 0.5 m/s
//! (wheel radius 152 mm, 2048 counts). Full weight inside the interval makes the estimate ripple
//! with the edges (1 % at 20 mm/s instead of 0.5 %); no weight, the obvious dead band, is calm for
//! a wheel that is driven from outside but makes the loop around it hunt (7 % at 20 mm/s).
//!
//! Cost: about 30 instructions. Errors at 20 mm/s, estimate and loop: below 1 %, asserted.

use crate::quantity::{Acceleration, Angle, Bandwidth, Large, Rate, Ratio, Time};

/// Weight of a distance that the counter cannot see. At a half, what lies beyond the interval adds
/// itself once more.
const WITHIN: f32 = 0.5;

/// Bandwidth per rate of edges.
const PER_EDGE: f32 = 0.5;

/// Slowest bandwidth, rad/s: how fast it notices a wheel that starts against expectation.
const BANDWIDTH_MIN: Bandwidth = Bandwidth::new(20.0);

/// Tracks one wheel.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Observer {
    /// Half the angle of one count, rad, positive.
    half_step: Angle,
    /// [`PER_EDGE`] times the counts of a radian.
    edges_per_radian: Large,
    bandwidth_max: Bandwidth,
    /// Model minus middle of the counter's interval, rad.
    lead: Angle,
    /// rad/s.
    rate: Rate,
}

impl Observer {
    /// For an encoder whose count is `step` rad, with a bandwidth of at most `bandwidth` rad/s.
    #[must_use]
    pub fn new(step: f32, bandwidth: f32) -> Self {
        Self {
            half_step: Angle::new(0.5 * step),
            edges_per_radian: Large::new(PER_EDGE / step),
            bandwidth_max: Bandwidth::new(bandwidth),
            lead: Angle::ZERO,
            rate: Rate::ZERO,
        }
    }

    /// Takes in that the wheel turned by `turned` rad (a whole number of counts) in the last `dt`
    /// s, in which it was meant to accelerate with `acceleration` rad/s^2. Returns the rate, rad/s.
    #[inline]
    pub fn update(&mut self, turned: Angle, acceleration: Acceleration, dt: Time) -> Rate {
        let half = self.half_step;
        let half_dt = dt.half();
        let rate = self.rate + acceleration.times(dt);
        let moved: Angle = (self.rate + rate).times(half_dt);
        let lead = self.lead + moved - turned;
        let beyond = if lead > half {
            lead - half
        } else if lead < -half {
            lead + half
        } else {
            Angle::ZERO
        };
        // Its weight is a factor of the time below.
        const { assert!(WITHIN == 0.5) };
        let ahead = lead + beyond;
        let edges: Bandwidth = rate.abs().times(self.edges_per_radian);
        let bandwidth = if edges > self.bandwidth_max {
            self.bandwidth_max
        } else if edges > BANDWIDTH_MIN {
            edges
        } else {
            BANDWIDTH_MIN
        };
        // Critically damped: 2 w and w^2.
        let share: Ratio = bandwidth.times(half_dt);
        let pull: Angle = ahead.times(share);
        self.lead = lead - (pull + pull);
        self.rate = rate - pull.times(bandwidth);
        self.rate
    }

    /// The rate estimate, rad/s.
    #[must_use]
    pub const fn rate(&self) -> Rate {
        self.rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const DT: f64 = 1e-3;
    /// 2048 counts a revolution.
    const STEP: f64 = core::f64::consts::TAU / 2048.0;

    /// Runs the observer on what an encoder shows of `angle(t)`; returns (estimate, naive) per
    /// tick.
    fn track(
        seconds: f64,
        angle: impl Fn(f64) -> f64,
        acceleration: impl Fn(f64) -> f64,
    ) -> Vec<(f64, f64)> {
        let mut observer = Observer::new(STEP as f32, 100.0);
        let mut last = (angle(0.0) / STEP).floor() as i64;
        let ticks = (seconds / DT).round() as usize;
        (1..=ticks)
            .map(|tick| {
                let t = tick as f64 * DT;
                let count = (angle(t) / STEP).floor() as i64;
                let turned = (count - last) as f64 * STEP;
                last = count;
                let rate = observer.update(
                    Angle::new(turned as f32),
                    Acceleration::new(acceleration(t - DT) as f32),
                    Time::new(DT as f32),
                );
                (f64::from(rate.to_f32()), turned / DT)
            })
            .collect()
    }

    fn rms(values: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = values.fold((0.0, 0), |(sum, n), v| (sum + v * v, n + 1));
        (sum / f64::from(count)).sqrt()
    }

    #[test]
    fn crawling_at_20_mm_s_is_known_to_one_percent() {
        // Wheel radius 0.1524 m: 0.1312 rad/s, 42.8 counts a second. Several phases of the edges.
        let rate = 0.02 / 0.1524;
        for phase in 0..8 {
            let start = f64::from(phase) * STEP / 8.0;
            let samples = track(4.0, |t| start + rate * t, |_| 0.0);
            let settled = &samples[2000..];
            let error = rms(settled.iter().map(|(estimate, _)| estimate - rate)) / rate;
            assert!(error < 0.01, "rms error {error} at phase {phase}");
            // The naive difference is off by several times the rate itself.
            let naive = rms(settled.iter().map(|(_, naive)| naive - rate)) / rate;
            assert!(naive > 4.0, "naive {naive}");
        }
    }

    #[test]
    fn constant_speed_has_no_lag_error() {
        for rate in [-30.0, -3.3, -0.5, 0.3, 1.0, 3.3, 12.0, 60.0] {
            let samples = track(3.0, |t| rate * t, |_| 0.0);
            let tail = &samples[2000..];
            let mean = tail.iter().map(|(estimate, _)| estimate).sum::<f64>() / tail.len() as f64;
            assert!((mean / rate - 1.0).abs() < 1e-3, "{mean} instead of {rate}");
            let ripple = rms(tail.iter().map(|(estimate, _)| estimate - rate)) / rate.abs();
            assert!(ripple < 0.01, "ripple {ripple} at {rate}");
        }
    }

    #[test]
    fn planned_acceleration_is_followed_without_lag() {
        // 6 rad/s^2 from standstill; 0.1 rad/s after the first edges have been seen.
        let samples = track(1.0, |t| 3.0 * t * t, |_| 6.0);
        for (tick, (estimate, _)) in samples.iter().enumerate().skip(100) {
            let rate = 6.0 * (tick + 1) as f64 * DT;
            assert!((estimate - rate).abs() < 0.05, "{estimate} at {rate}");
        }
    }

    #[test]
    fn unplanned_acceleration_is_noticed() {
        let samples = track(1.0, |t| 3.0 * t * t, |_| 0.0);
        let mut worst = 0.0_f64;
        for (tick, (estimate, _)) in samples.iter().enumerate().skip(200) {
            let rate = 6.0 * (tick + 1) as f64 * DT;
            worst = worst.max((estimate - rate).abs());
        }
        // Lag of a second-order loop: 2 a / w, w = 100 rad/s; twice that, because the correction
        // works only while the model is outside the counter's interval.
        assert!(worst < 2.0 * (2.0 * 6.0 / 100.0), "off by {worst}");
    }

    #[test]
    fn a_stop_is_noticed() {
        let samples = track(3.0, |t| 2.0 * t.min(1.0), |_| 0.0);
        let after = |seconds: f64| samples[(seconds / DT) as usize].0.abs();
        // The critically damped answer to a lost rate v swings to -v/e^2 and comes back.
        let swing = 2.0 * (-2.0_f64).exp();
        assert!(after(1.05) < swing, "{} after 50 ms", after(1.05));
        assert!(after(1.5) < 0.02, "{} after 500 ms", after(1.5));
    }
}
