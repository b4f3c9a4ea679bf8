//! Starting and stopping on a curve that is itself in full motion.
//!
//! Time along the curve is scaled at both ends: its rate rises from 0 to 1 and falls back to 0. The
//! body travels the same curve, only slower at the ends, so the shape does not change.

use super::{Acceleration, Trajectory};
use crate::arithmetic::Real;
use crate::frame::{Pose, Twist};

/// The cubic STEP function from 0 to 1 over `share` 0 to 1, held outside.
#[must_use]
pub fn step<S: Real>(share: S) -> S {
    let s = share.max(S::ZERO).min(S::ONE);
    s * s * (S::constant(3.0) - S::constant(2.0) * s)
}

/// A trajectory entered from rest and left to rest, on the same curve.
///
/// Time along the inner trajectory runs at a rate that rises from 0 to 1 over `ramp` seconds and
/// falls the same way at the end. Each ramp covers half of its own length of the inner trajectory,
/// so the motion takes `ramp` seconds longer than the inner one.
///
/// ```
/// use mecanum_kinematics::trajectory::{FigureEight, Ramped, Trajectory};
///
/// // As fast as 1.5 m/s2 allows.
/// let eight = Ramped::within(FigureEight::<f64>::paper(), 1.5, 1.0).unwrap();
/// let (pose, twist) = eight.at(0.0);
/// assert!(pose.x == 2.5 && twist.vy == 0.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramped<T, S = f32> {
    inner: T,
    ramp: S,
}

impl<S: Real, T: Trajectory<S>> Ramped<T, S> {
    /// Ramps over `ramp` seconds; shorter where the inner trajectory is too short for two ramps.
    ///
    /// The paper's figure-eight at 2500 mm and pi/10 needs 2 s to stay within what friction can
    /// push.
    #[must_use]
    pub fn new(inner: T, ramp: S) -> Self {
        let ramp = ramp.max(S::ZERO).min(inner.duration());
        Self { inner, ramp }
    }

    /// The shortest ramps (to 1 %) with which neither acceleration exceeds its limit anywhere on
    /// the way, m/s^2 and rad/s^2; `None` when the inner trajectory itself exceeds them, or cannot
    /// hold ramps that long.
    ///
    /// The limits are checked at 400 times along the motion.
    #[must_use]
    pub fn within(inner: T, linear: S, angular: S) -> Option<Self>
    where
        T: Clone,
    {
        let fits = |ramp: S| {
            let ramped = Self::new(inner.clone(), ramp);
            let step = ramped.duration() / S::constant(400.0);
            let mut time = S::ZERO;
            for _ in 0..400 {
                time += step;
                let Acceleration { ax, ay, alpha } = ramped.acceleration(time);
                let within = ax * ax + ay * ay <= linear * linear && alpha.abs() <= angular;
                if !within {
                    return false;
                }
            }
            true
        };
        let mut long = inner.duration();
        if !fits(long) {
            return None;
        }
        let mut short = S::ZERO;
        // Halving: a longer ramp never needs more.
        while long - short > long * S::constant(0.01) {
            let middle = (short + long) / S::constant(2.0);
            if fits(middle) {
                long = middle;
            } else {
                short = middle;
            }
        }
        Some(Self::new(inner, long))
    }

    /// The trajectory without its ramps.
    #[must_use]
    pub const fn inner(&self) -> &T {
        &self.inner
    }

    /// Inner time (s) at `time` (s), and the rate it passes at (0 to 1).
    #[must_use]
    pub fn warp(&self, time: S) -> (S, S) {
        let half = S::constant(0.5);
        let whole = self.duration();
        let time = time.max(S::ZERO).min(whole);
        // The way through one ramp: the integral of the STEP function.
        let risen = |since: S| {
            let s = since / self.ramp;
            self.ramp * s * s * s * (S::ONE - half * s)
        };
        if time < self.ramp {
            (risen(time), step(time / self.ramp))
        } else if time > whole - self.ramp {
            let left = whole - time;
            (self.inner.duration() - risen(left), step(left / self.ramp))
        } else {
            (time - half * self.ramp, S::ONE)
        }
    }

    /// How fast that rate changes at `time`, 1/s.
    fn bend(&self, time: S) -> S {
        let slope = |since: S| {
            let share = since / self.ramp;
            S::constant(6.0) * share * (S::ONE - share) / self.ramp
        };
        let left = self.duration() - time;
        if time < self.ramp {
            slope(time)
        } else if left < self.ramp {
            -slope(left)
        } else {
            S::ZERO
        }
    }
}

impl<S: Real, T: Trajectory<S>> Trajectory<S> for Ramped<T, S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        let (inner_time, rate) = self.warp(time);
        let (pose, twist) = self.inner.at(inner_time);
        let beyond = time < S::ZERO || time > self.duration();
        (
            pose,
            if beyond {
                twist * S::ZERO
            } else {
                twist * rate
            },
        )
    }

    fn acceleration(&self, time: S) -> Acceleration<S> {
        if time < S::ZERO || time > self.duration() {
            return Acceleration::default();
        }
        let (inner_time, rate) = self.warp(time);
        let bend = self.bend(time);
        let (_, twist) = self.inner.at(inner_time);
        let along = self.inner.acceleration(inner_time);
        let square = rate * rate;
        Acceleration::new(
            along.ax * square + twist.vx * bend,
            along.ay * square + twist.vy * bend,
            along.alpha * square + twist.omega * bend,
        )
    }

    fn duration(&self) -> S {
        self.inner.duration() + self.ramp
    }
}
