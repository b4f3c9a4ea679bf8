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

#[cfg(feature = "fixed-point")]
#[path = "fixed_point.rs"]
mod scalar;
#[cfg(not(feature = "fixed-point"))]
#[path = "single.rs"]
mod scalar;

use kinematics::Twist;

use crate::quantity::{Acceleration, Change, PerSecond, Quantity, Ratio, Time, Velocity};
use crate::twist::{scaled, to, within};

pub use scalar::ChangeLimits;

/// A twist that changes within limits.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Limiter {
    velocity: Twist<Velocity>,
    acceleration: Twist<Change>,
}

/// The time of one step, s, and one over it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Step {
    /// s.
    pub dt: Time,
    /// 1/s.
    pub per_second: PerSecond,
}

impl Step {
    /// Of so many microseconds.
    #[must_use]
    #[inline]
    pub const fn of_micros(micros: u32) -> Self {
        Self {
            dt: Time::from_micros(micros),
            per_second: PerSecond::of_micros(micros),
        }
    }
}

impl Limiter {
    /// One step towards `input`, which changes at `slope` per second. Returns whether a limit kept
    /// it from getting there.
    #[inline]
    pub fn step(
        &mut self,
        input: Twist<Velocity>,
        slope: Twist<Acceleration>,
        step: Step,
        limits: &ChangeLimits,
    ) -> bool {
        let behind = input - (self.velocity + scaled(slope, step.dt));
        let approach = limits.approach(behind, step.per_second);
        let wanted = slope + scaled(behind, approach.per_second);
        let change = wanted - to(self.acceleration);
        let jerk = limits.jerk_share(change, step);
        let acceleration = self.acceleration + shared(change, jerk);
        let bound = limits.acceleration_share(acceleration);
        self.acceleration = shared(acceleration, bound);
        self.velocity = self.velocity + scaled(self.acceleration, step.dt);
        jerk.is_some() || bound.is_some() || approach.is_far
    }

    /// Ends at once what makes it faster: a ramp to standstill that has to wait for the jerk limit
    /// first would go on accelerating.
    #[inline(never)]
    pub fn stop_accelerating(&mut self) {
        let (velocity, acceleration) = (&self.velocity, &mut self.acceleration);
        for (velocity, acceleration) in [
            (velocity.vx, &mut acceleration.vx),
            (velocity.vy, &mut acceleration.vy),
            (velocity.omega, &mut acceleration.omega),
        ] {
            if acceleration.agrees(velocity) {
                *acceleration = Change::ZERO;
            }
        }
    }

    /// The twist after the last step.
    #[must_use]
    pub const fn velocity(&self) -> Twist<Velocity> {
        self.velocity
    }

    /// Its change per second over the last step.
    #[must_use]
    pub const fn acceleration(&self) -> Twist<Change> {
        self.acceleration
    }

    /// Whether it is zero, within less than the resolution of any field on the bus.
    #[must_use]
    #[inline(never)]
    pub fn stands(&self) -> bool {
        within(self.velocity, const { Velocity::new(1e-5) })
            && within(self.acceleration, const { Change::new(1e-2) })
    }

    /// Resets to standstill.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

/// How fast the rest of the way is made.
#[derive(Clone, Copy)]
struct Approach {
    /// Of what is left, 1/s.
    per_second: PerSecond,
    /// More is left than one step can make.
    is_far: bool,
}

/// The share of a twist that a limit leaves; without a share all of it.
#[inline(always)]
fn shared<const A: u32>(twist: Twist<Quantity<A>>, share: Option<Ratio>) -> Twist<Change> {
    match share {
        None => to(twist),
        Some(share) => scaled(twist, share),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twist::{quantities, single};

    const DT: f32 = 1e-3;
    const STEP: Step = Step::of_micros(1_000);
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
            let before = single(limiter.acceleration());
            limiter.step(quantities(input), Twist::default(), STEP, &limits);
            let a = single(limiter.acceleration());
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
        assert!(single(limiter.velocity()).vx < 1.0 - 1e-5, "too early");
        let mut highest = 0.0_f32;
        for _ in 0..30 {
            run(&mut limiter, Twist::new(1.0, 0.0, 0.0), 1);
            highest = highest.max(single(limiter.velocity()).vx);
        }
        assert!(
            (single(limiter.velocity()).vx - 1.0).abs() < 1e-5,
            "too late"
        );
        assert!(highest <= 1.0 + 1e-5, "overshoot to {highest}");
    }

    #[test]
    fn a_small_step_stays_below_the_acceleration_limit() {
        // 0.05 m/s: the acceleration peaks at sqrt(0.05 * 20) = 1 m/s^2, after 2 * 1/20 = 0.1 s.
        let mut limiter = Limiter::default();
        let mut peak = 0.0_f32;
        for _ in 0..103 {
            run(&mut limiter, Twist::new(0.0, 0.05, 0.0), 1);
            peak = peak.max(single(limiter.acceleration()).vy);
        }
        assert!((single(limiter.velocity()).vy - 0.05).abs() < 1e-6);
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
            limiter.step(quantities(input), quantities(slope), STEP, &limits);
            if step > 10 {
                worst = worst.max((single(limiter.velocity()).vx - input.vx).abs());
            }
            phase += DT;
        }
        assert!(worst < 1e-6, "lag {worst}");
    }

    #[test]
    fn standstill_is_reached_along_the_direction_of_motion() {
        let mut limiter = Limiter {
            velocity: quantities(Twist::new(0.6, -0.3, 0.9)),
            acceleration: Twist::default(),
        };
        for _ in 0..600 {
            run(&mut limiter, Twist::ZERO, 1);
            let v = single(limiter.velocity());
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
                velocity: quantities(Twist::new(speed, 0.0, 0.0)),
                acceleration: Twist::default(),
            };
            for _ in 0..2000 {
                run(&mut limiter, Twist::ZERO, 1);
                // A quarter of one step of jerk, 5e-6 m/s: the grid does not divide every way
                // evenly.
                let v = single(limiter.velocity()).vx;
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
        let v = single(limiter.velocity());
        assert!((v.omega / v.vx / 40.0 - 1.0).abs() < 1e-3);
    }
}
