//! Learning, while a curve is driven with feedback, by how much a floor takes more than was
//! calibrated.
//!
//! A P law alone needs an error to correct with: a group whose rollers stand at 46 instead of 45
//! degrees loses 3.5 % of what it does sideways, and trails by that velocity over the gain. What a
//! floor takes is in proportion to the curve's velocity (slip) and to its acceleration (creep, a
//! lag), along x, along y and about z of the group. These six shares are adapted:
//!
//! ```text
//! added  = share v + lag a
//! share' = rate e v / (v^2 + v0^2)        lag' = rate e a / (a^2 + a0^2)
//! ```
//!
//! with the error `e` that the P law corrects. With `e' = -gain e + (what is missing)` the sum of
//! `e^2` and of the squared errors of the shares, over the rate, falls whatever the curve does
//! (Lyapunov), as long as `rate / gain` is slow against the way of a setpoint through the group:
//! here 1/s against 30 ms. The shares are bounded, so that a source of poses that lies cannot make
//! them large, and rest while the correction is at its limit.

use kinematics::Twist;

/// How fast the shares follow, 1/s^2; over the gain of the P law it is 1/s.
const RATE: f32 = 2.0;
/// Velocities and accelerations far below these teach nothing: m/s, m/s, rad/s, and per s.
const LEAST_VELOCITY: [f32; 3] = [0.1, 0.1, 0.1];
const LEAST_ACCELERATION: [f32; 3] = [0.3, 0.3, 0.3];
/// Bounds of the shares: of the velocity, and s.
const LARGEST_SHARE: f32 = 0.1;
const LARGEST_LAG: f32 = 0.03;
/// Longest time that one sighting stands for, s.
const LONGEST: f32 = 0.05;

/// What has been learnt of a floor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Adaptation {
    /// Of the velocity, what is missing: along x, along y, about z.
    pub share: [f32; 3],
    /// Of the acceleration, s.
    pub lag: [f32; 3],
}

fn axes(twist: Twist) -> [f32; 3] {
    [twist.vx, twist.vy, twist.omega]
}

impl Adaptation {
    /// A sighting that stands for `dt` (s) shows the group off by `error` (m, m, rad) where the
    /// curve's velocity and acceleration are these, all in the group's own frame.
    pub fn learn(&mut self, error: [f32; 3], velocity: Twist, acceleration: Twist, dt: f32) {
        let step = RATE * dt.clamp(0.0, LONGEST);
        let (velocity, acceleration) = (axes(velocity), axes(acceleration));
        for n in 0..3 {
            let (v, a) = (velocity[n], acceleration[n]);
            let share = error[n] * v / (v * v + LEAST_VELOCITY[n].powi(2));
            let lag = error[n] * a / (a * a + LEAST_ACCELERATION[n].powi(2));
            self.share[n] = (self.share[n] + step * share).clamp(-LARGEST_SHARE, LARGEST_SHARE);
            self.lag[n] = (self.lag[n] + step * lag).clamp(-LARGEST_LAG, LARGEST_LAG);
        }
    }

    /// What is to be asked for beside a curve's velocity and acceleration, in the group's frame.
    #[must_use]
    pub fn added(&self, velocity: Twist, acceleration: Twist) -> Twist {
        let (v, a) = (axes(velocity), axes(acceleration));
        let [x, y, turn] = [0, 1, 2].map(|n| self.share[n] * v[n] + self.lag[n] * a[n]);
        Twist::new(x, y, turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 0.01;

    /// A point that loses a share of its velocity and a lag's worth of its acceleration on a sine,
    /// seen four setpoints late: what it loses is learnt, and nothing where nothing is lost.
    #[test]
    fn what_a_floor_takes_is_learnt() {
        for (lost, trails) in [(0.035_f32, 0.007_f32), (-0.02, 0.0), (0.0, 0.0)] {
            let mut adaptation = Adaptation::default();
            let mut errors = vec![0.0_f32; 5];
            let mut worst = 0.0_f32;
            for k in 0..6000_u16 {
                let t = f32::from(k) * DT;
                let (v, a) = (0.5 * t.sin(), 0.5 * t.cos());
                let [v, a] = [v, a].map(|v| Twist::new(0.0, v, 0.0));
                let seen = errors[errors.len() - 5];
                adaptation.learn([0.0, seen, 0.0], v, a, DT);
                let asked = v.vy + adaptation.added(v, a).vy + 2.0 * seen;
                let moves = (1.0 - lost) * asked - trails * a.vy;
                errors.push(errors[errors.len() - 1] + DT * (v.vy - moves));
                if t > 30.0 {
                    worst = worst.max(errors[errors.len() - 1].abs());
                }
            }
            let wanted = lost / (1.0 - lost);
            assert!(
                (adaptation.share[1] - wanted).abs() < 2e-3,
                "{adaptation:?}"
            );
            assert!((adaptation.lag[1] - trails).abs() < 2e-3, "{adaptation:?}");
            assert!(worst < 5e-4, "{worst}");
            assert_eq!(adaptation.share[0], 0.0);
        }
    }

    #[test]
    fn a_source_that_lies_cannot_teach_much() {
        let mut adaptation = Adaptation::default();
        let fast = Twist::new(1.0, 0.0, 0.0);
        for _ in 0..10_000 {
            adaptation.learn([5.0, 0.0, 0.0], fast, fast, 1.0);
        }
        let added = adaptation.added(fast, fast);
        assert!((added.vx - 0.13).abs() < 1e-6, "{added:?}");
    }
}
