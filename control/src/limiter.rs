//! Bounded acceleration and jerk on the group twist.
//!
//! Every member runs this on the same group twist with the same limits, before anything that
//! differs between members, so that all of them shape the same setpoint in the same way and the
//! group keeps its shape.
//!
//! The limiter follows its input *exactly*, without lag, as long as the input keeps the limits.
//! When it lags by `e`, its acceleration is that of the input plus the largest one from which it
//! can still return to zero, at the jerk limit, exactly when `e` is used up. On a grid of steps
//! `dt` the distance covered while an acceleration of `n` jerk steps goes back to zero is `j dt^2 n
//! (n + 1) / 2`; solved for `n` this gives `n = (sqrt(1 + 8 m) - 1) / 2` with `m = e / (j dt^2)`.
//! The end of a step response therefore neither overshoots nor chatters.
//!
//! Linear and angular parts are scaled by one common factor wherever a limit applies, so a change
//! of twist runs along a straight line in (vx, vy, omega). With zero as the input this is the
//! group's ramp to standstill: straight down along the direction of motion.
//!
//! Cost: about 110 instructions while following, about 190 while a limit applies.

use kinematics::Twist;

use crate::math::{inverse_sqrt, sqrt};

/// Limits on a twist's change.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ChangeLimits {
    acceleration_inverse: f32,
    acceleration_yaw_inverse: f32,
    jerk_inverse: f32,
    jerk_yaw_inverse: f32,
}

impl ChangeLimits {
    /// Limits in m/s^2, rad/s^2, m/s^3, rad/s^3; all above zero.
    #[must_use]
    pub fn new(acceleration: f32, acceleration_yaw: f32, jerk: f32, jerk_yaw: f32) -> Self {
        Self {
            acceleration_inverse: 1.0 / acceleration,
            acceleration_yaw_inverse: 1.0 / acceleration_yaw,
            jerk_inverse: 1.0 / jerk,
            jerk_yaw_inverse: 1.0 / jerk_yaw,
        }
    }
}

/// The square of a twist's size when one unit is `1 / linear` and `1 / angular`.
#[inline]
fn size_squared(twist: Twist, linear: f32, angular: f32) -> f32 {
    let along = (twist.vx * twist.vx + twist.vy * twist.vy) * (linear * linear);
    let about = twist.omega * angular;
    let about = about * about;
    if along > about { along } else { about }
}

/// A twist that changes within limits.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Limiter {
    velocity: Twist,
    acceleration: Twist,
}

impl Limiter {
    /// One step of `dt` s towards `input`, which changes at `slope` per second. Returns whether a
    /// limit kept it from getting there.
    #[inline]
    pub fn step(&mut self, input: Twist, slope: Twist, dt: f32, limits: &ChangeLimits) -> bool {
        let per_dt = 1.0 / dt;
        let behind = input - (self.velocity + slope * dt);
        // The remaining distance in steps of jerk: m squared.
        let grid = per_dt * per_dt;
        let m_squared = size_squared(
            behind,
            limits.jerk_inverse * grid,
            limits.jerk_yaw_inverse * grid,
        );
        let gain = if m_squared <= 1.0 {
            per_dt
        } else {
            let m = sqrt(m_squared);
            let n = 0.5 * (sqrt(1.0 + 8.0 * m) - 1.0);
            per_dt * n / m
        };
        let wanted = slope + behind * gain;
        let change = wanted - self.acceleration;
        let jerk_squared = size_squared(
            change,
            limits.jerk_inverse * per_dt,
            limits.jerk_yaw_inverse * per_dt,
        );
        let jerk_bites = jerk_squared > 1.0;
        let change = if jerk_bites {
            change * inverse_sqrt(jerk_squared)
        } else {
            change
        };
        let acceleration = self.acceleration + change;
        let acceleration_squared = size_squared(
            acceleration,
            limits.acceleration_inverse,
            limits.acceleration_yaw_inverse,
        );
        let acceleration_bites = acceleration_squared > 1.0;
        self.acceleration = if acceleration_bites {
            acceleration * inverse_sqrt(acceleration_squared)
        } else {
            acceleration
        };
        self.velocity = self.velocity + self.acceleration * dt;
        jerk_bites || acceleration_bites || m_squared > 1.0
    }

    /// The twist after the last step.
    #[must_use]
    pub const fn velocity(&self) -> Twist {
        self.velocity
    }

    /// Its change per second over the last step.
    #[must_use]
    pub const fn acceleration(&self) -> Twist {
        self.acceleration
    }

    /// Whether it is zero, within less than the resolution of any field on the bus.
    #[must_use]
    #[inline(never)]
    pub fn stands(&self) -> bool {
        let still = |twist: Twist, bound: f32| {
            twist.vx.abs() < bound && twist.vy.abs() < bound && twist.omega.abs() < bound
        };
        still(self.velocity, 1e-5) && still(self.acceleration, 1e-2)
    }

    /// Resets to standstill.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 1e-3;
    const ACCELERATION: f32 = 2.0;
    const YAW: f32 = 4.0;
    const JERK: f32 = 20.0;
    const JERK_YAW: f32 = 40.0;

    fn limits() -> ChangeLimits {
        ChangeLimits::new(ACCELERATION, YAW, JERK, JERK_YAW)
    }

    fn linear(twist: Twist) -> f32 {
        (twist.vx * twist.vx + twist.vy * twist.vy).sqrt()
    }

    /// Steps to a constant input and checks both bounds at each step.
    fn run(limiter: &mut Limiter, input: Twist, steps: usize) {
        let limits = limits();
        for _ in 0..steps {
            let before = limiter.acceleration();
            limiter.step(input, Twist::ZERO, DT, &limits);
            let a = limiter.acceleration();
            // One part in 1e5 for the rounding of f32.
            assert!(linear(a) <= ACCELERATION * 1.000_01);
            assert!(a.omega.abs() <= YAW * 1.000_01);
            let jerk = (a - before) * (1.0 / DT);
            assert!(linear(jerk) <= JERK * 1.001, "jerk {}", linear(jerk));
            assert!(jerk.omega.abs() <= JERK_YAW * 1.001);
        }
    }

    #[test]
    fn a_step_arrives_without_overshoot_in_the_closed_form_time() {
        // 1 m/s with 2 m/s^2 and 20 m/s^3: 1/2 + 2/20 = 0.6 s.
        let mut limiter = Limiter::default();
        run(&mut limiter, Twist::new(1.0, 0.0, 0.0), 590);
        assert!(limiter.velocity().vx < 1.0 - 1e-5, "too early");
        let mut highest = 0.0_f32;
        for _ in 0..30 {
            run(&mut limiter, Twist::new(1.0, 0.0, 0.0), 1);
            highest = highest.max(limiter.velocity().vx);
        }
        assert!((limiter.velocity().vx - 1.0).abs() < 1e-5, "too late");
        assert!(highest <= 1.0 + 1e-5, "overshoot to {highest}");
    }

    #[test]
    fn a_small_step_stays_below_the_acceleration_limit() {
        // 0.05 m/s: the acceleration peaks at sqrt(0.05 * 20) = 1 m/s^2, after 2 * 1/20 = 0.1 s.
        let mut limiter = Limiter::default();
        let mut peak = 0.0_f32;
        for _ in 0..103 {
            run(&mut limiter, Twist::new(0.0, 0.05, 0.0), 1);
            peak = peak.max(limiter.acceleration().vy);
        }
        assert!((limiter.velocity().vy - 0.05).abs() < 1e-6);
        // Within one jerk step of the closed form.
        assert!((peak - 1.0).abs() <= JERK * DT, "peak {peak}");
    }

    #[test]
    fn an_input_within_the_limits_is_followed_exactly() {
        // A sine of 0.5 m/s at 2 rad/s: 1 m/s^2, 2 m/s^3.
        let limits = limits();
        let mut limiter = Limiter::default();
        let mut worst = 0.0_f32;
        let mut phase = 0.0_f32;
        for step in 0..5000 {
            let (sin, cos) = (2.0 * phase).sin_cos();
            // 1 - cos starts with zero velocity and acceleration.
            let input = Twist::new(0.5 * (1.0 - cos), 0.0, 0.0);
            let slope = Twist::new(1.0 * sin, 0.0, 0.0);
            limiter.step(input, slope, DT, &limits);
            if step > 10 {
                worst = worst.max((limiter.velocity().vx - input.vx).abs());
            }
            phase += DT;
        }
        assert!(worst < 1e-6, "lag {worst}");
    }

    #[test]
    fn standstill_is_reached_along_the_direction_of_motion() {
        let mut limiter = Limiter {
            velocity: Twist::new(0.6, -0.3, 0.9),
            acceleration: Twist::ZERO,
        };
        for _ in 0..600 {
            run(&mut limiter, Twist::ZERO, 1);
            let v = limiter.velocity();
            if v.vx < 1e-4 {
                break;
            }
            assert!((v.vy / v.vx + 0.5).abs() < 1e-3, "left its direction");
            assert!((v.omega / v.vx - 1.5).abs() < 1e-3, "left its direction");
        }
        run(&mut limiter, Twist::ZERO, 50);
        assert!(limiter.stands());
    }

    #[test]
    fn standstill_does_not_reverse() {
        for speed in [0.001, 0.02, 0.3, 1.0, 2.5] {
            let mut limiter = Limiter {
                velocity: Twist::new(speed, 0.0, 0.0),
                acceleration: Twist::ZERO,
            };
            for _ in 0..2000 {
                run(&mut limiter, Twist::ZERO, 1);
                // A quarter of one step of jerk, 5e-6 m/s: the grid does not divide every way
                // evenly.
                let v = limiter.velocity().vx;
                assert!(v >= -0.25 * JERK * DT * DT, "reversed to {v} from {speed}");
            }
            assert!(limiter.stands());
        }
    }

    #[test]
    fn the_slower_axis_decides_and_both_arrive_together() {
        // Yaw alone would take 2/4 + 4/40 = 0.6 s, x alone 0.1 s or so.
        let mut limiter = Limiter::default();
        run(&mut limiter, Twist::new(0.05, 0.0, 2.0), 300);
        let v = limiter.velocity();
        assert!((v.omega / v.vx / 40.0 - 1.0).abs() < 1e-3);
    }
}
