//! The gyros that the robots carry, about the axis that points up.
//!
//! A sample is the mean rate since the one before, as a gyro gives that integrates inside, with a
//! bias, white noise and a bias that strays; it comes late by the filters' delay. The samples of
//! all robots are of one clock, the world's. What a gyro costs the simulation is nothing until its
//! samples are requested.

use group::Gyro;
use kinematics::Pose;

use crate::random::Random;

/// One sample of every robot's gyro.
#[derive(Debug, Clone, PartialEq)]
pub struct GyroSample {
    /// When it came, ns of virtual time.
    pub time_ns: u64,
    /// Yaw rates, rad/s, counter-clockwise positive, in the order of the group file.
    pub rates: Vec<f64>,
}

/// All gyros of a world.
#[derive(Debug, Clone)]
pub(crate) struct Gyros {
    kind: Gyro,
    random: Random,
    period_ns: u64,
    /// Headings at the last sample.
    headings: Vec<f64>,
    biases: Vec<f64>,
    /// Rising times, some yet to come.
    samples: Vec<GyroSample>,
}

/// Samples a second of a board's own gyro, and what sets its noise apart from the others'.
const BOARD_HZ: u32 = 1000;
const BOARD_SEED: u64 = 0x424D_4930_3838;

impl Gyros {
    /// Those on the robots' boards, as bad as the others and with more samples.
    pub fn on_boards(simulation: &group::Simulation, poses: &[Pose<f64>]) -> Self {
        let kind = Gyro {
            rate_hz: BOARD_HZ,
            ..simulation.gyro
        };
        Self::new(kind, simulation.seed ^ BOARD_SEED, poses)
    }

    pub fn new(kind: Gyro, seed: u64, poses: &[Pose<f64>]) -> Self {
        Self {
            kind,
            // Apart from the streams of everything else that comes from the seed.
            random: Random::new(seed ^ 0x4759_524F_4759_524F),
            period_ns: 1_000_000_000 / u64::from(kind.rate_hz),
            headings: poses.iter().map(|pose| pose.heading).collect(),
            biases: vec![kind.bias; poses.len()],
            samples: Vec::new(),
        }
    }

    /// The plant has come to `now_ns`.
    pub fn follow(&mut self, now_ns: u64, poses: &[Pose<f64>]) {
        if !now_ns.is_multiple_of(self.period_ns) {
            return;
        }
        let period = self.period_ns as f64 * 1e-9;
        // White noise of this density in half a sampling rate's bandwidth.
        let noise = self.kind.noise * (0.5 / period).sqrt();
        let drift = self.kind.drift * period.sqrt();
        let mut rates = Vec::with_capacity(poses.len());
        let robots = self.headings.iter_mut().zip(&mut self.biases).zip(poses);
        for ((heading, bias), pose) in robots {
            let turned = pose.heading - std::mem::replace(heading, pose.heading);
            *bias += drift * self.random.normal();
            rates.push(turned / period + *bias + noise * self.random.normal());
        }
        self.samples.push(GyroSample {
            time_ns: now_ns + (self.kind.delay * 1e9) as u64,
            rates,
        });
    }

    /// The samples that have come.
    pub fn take(&mut self, now_ns: u64) -> Vec<GyroSample> {
        let come = self.samples.partition_point(|s| s.time_ns <= now_ns);
        self.samples.drain(..come).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that turns at 0.2 rad/s, seen for 100 s at 100 Hz. The mean is the rate and the
    /// bias, within four of its deviations, density / sqrt(2 s); the deviation of single samples is
    /// the density times sqrt(50 Hz), within four of its own, 1 / sqrt(20 000). Nothing comes
    /// before its delay.
    #[test]
    fn a_gyro_is_as_bad_as_it_is_said_to_be() {
        let kind = Gyro {
            rate_hz: 100,
            noise: 0.001,
            bias: 0.01,
            drift: 0.0,
            delay: 0.015,
        };
        let pose = |t: f64| [Pose::new(0.0, 0.0, 0.2 * t)];
        let mut gyros = Gyros::new(kind, 5, &pose(0.0));
        for ms in 1..=100_000_u64 {
            gyros.follow(ms * 1_000_000, &pose(ms as f64 * 1e-3));
        }
        let samples = gyros.take(100_000_000_000);
        assert_eq!(samples.len(), 9_998, "the last two are not there yet");
        assert_eq!(samples[0].time_ns, 25_000_000);
        let rates: Vec<f64> = samples.iter().map(|s| s.rates[0] - 0.21).collect();
        let mean = rates.iter().sum::<f64>() / rates.len() as f64;
        assert!(mean.abs() < 4.0 * 0.001 / 200_f64.sqrt(), "{mean}");
        let square = rates.iter().map(|r| r * r).sum::<f64>() / rates.len() as f64;
        let expected = 0.001 * 50_f64.sqrt();
        assert!(
            (square.sqrt() / expected - 1.0).abs() < 0.029,
            "{}",
            square.sqrt()
        );
        assert_eq!(gyros.take(100_015_000_000).len(), 2);
    }

    /// A bias that strays by 0.001 rad/s in a second strays by 0.01 in 100: over 400 robots within
    /// four deviations, 1 / sqrt(800).
    #[test]
    fn a_bias_strays_with_the_root_of_time() {
        let kind = Gyro {
            rate_hz: 1,
            noise: 0.0,
            bias: 0.0,
            drift: 0.001,
            delay: 0.0,
        };
        let poses = [Pose::new(0.0, 0.0, 0.0); 400];
        let mut gyros = Gyros::new(kind, 9, &poses);
        for s in 1..=100 {
            gyros.follow(s * 1_000_000_000, &poses);
        }
        let last = gyros.take(100_000_000_000).pop().unwrap();
        let square = last.rates.iter().map(|r| r * r).sum::<f64>() / 400.0;
        assert!(
            (square.sqrt() / 0.01 - 1.0).abs() < 0.142,
            "{}",
            square.sqrt()
        );
    }
}
