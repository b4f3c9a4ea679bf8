//! The true state of the world, as a perfect observer measures it.
//!
//! Samples are taken at whole multiples of a period of virtual time and kept until someone takes
//! them away; a minute at 100 Hz with three robots is about 4 MB. Nothing in the simulated robots
//! can read them. [`NoisyPoses`] are an observer's that are not perfect.

use group::PoseNoise;
use kinematics::{Pose, WheelRates};

use crate::random::Random;

/// One instant.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthSample {
    /// Virtual time, ns.
    pub time_ns: u64,
    /// Pose of the group frame in the world, m and rad, heading unwrapped.
    pub group: Pose<f64>,
    /// Distance of the robot that is farthest from its place in the group, mm.
    pub shape_error_mm: f64,
    /// Part of the time since the last sample in which the bus was taken, 0..=1.
    pub bus_load: f64,
    /// One entry a robot, in the order of the group file.
    pub robots: Vec<RobotTruth>,
}

/// One robot at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotTruth {
    /// CANopen node.
    pub node: u8,
    /// Pose in the world, m and rad, heading unwrapped.
    pub pose: Pose<f64>,
    /// Wheel angles, rad, front left, front right, rear left, rear right; positive rolls forward.
    pub wheel_angles: [f64; 4],
    /// Wheel rates, rad/s, positive rolls the base forward.
    pub wheel_rates: WheelRates<f64>,
    /// Bridge voltage over supply voltage, -1..=1, same order; 0 while the drivers are off.
    pub duties: [f64; 4],
    /// Currents of the motors, A, same order; positive drives forward.
    pub currents: [f64; 4],
    /// Voltage at the bridges, V.
    pub supply: f64,
    /// Whether the bridges conduct.
    pub drivers_enabled: bool,
    /// Whether the holding brake is commanded to open.
    pub brake_released: bool,
    /// Whether the holding brake of any wheel holds, whatever its command.
    pub brake_holds: bool,
}

/// Eyes that see poses with some noise, the same for the same seed.
#[derive(Debug, Clone)]
pub(crate) struct NoisyPoses {
    noise: PoseNoise,
    random: Random,
}

impl NoisyPoses {
    pub fn new(noise: PoseNoise, seed: u64) -> Self {
        // Apart from the streams of everything else that comes from the seed.
        let random = Random::new(seed ^ 0xEE5E_5EEE_0B5E_44ED);
        Self { noise, random }
    }

    /// A sample as these eyes see it.
    pub fn see(&mut self, mut sample: TruthSample) -> TruthSample {
        if self.noise != PoseNoise::default() {
            self.blur(&mut sample.group);
            for robot in &mut sample.robots {
                self.blur(&mut robot.pose);
            }
        }
        sample
    }

    fn blur(&mut self, pose: &mut Pose<f64>) {
        pose.x += self.noise.position * self.random.normal();
        pose.y += self.noise.position * self.random.normal();
        pose.heading += self.noise.heading * self.random.normal();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2 mm and 1 mrad: over 10 000 looks the deviations within four of their own, 1 / sqrt(20 000)
    /// each.
    #[test]
    fn eyes_are_as_bad_as_they_are_said_to_be() {
        let noise = PoseNoise {
            position: 0.002,
            heading: 0.001,
        };
        let mut noisy_poses = NoisyPoses::new(noise, 3);
        let sample = TruthSample {
            time_ns: 0,
            group: Pose::new(1.0, 2.0, 3.0),
            shape_error_mm: 0.0,
            bus_load: 0.0,
            robots: vec![],
        };
        let seen: Vec<_> = (0..10_000)
            .map(|_| noisy_poses.see(sample.clone()).group)
            .collect();
        let deviation = |value: &dyn Fn(&Pose<f64>) -> f64| {
            (seen.iter().map(|p| value(p).powi(2)).sum::<f64>() / 1e4).sqrt()
        };
        for (found, expected) in [
            (deviation(&|p| p.x - 1.0), 0.002),
            (deviation(&|p| p.y - 2.0), 0.002),
            (deviation(&|p| p.heading - 3.0), 0.001),
        ] {
            assert!((found / expected - 1.0).abs() < 0.03, "{found} {expected}");
        }
        let mut again = NoisyPoses::new(noise, 3);
        assert_eq!(again.see(sample.clone()).group, seen[0]);
        let mut perfect = NoisyPoses::new(PoseNoise::default(), 3);
        assert_eq!(perfect.see(sample.clone()), sample);
    }
}
