//! Curves for a body to follow: pose and velocity in the world frame at time t.
//!
//! The paper's curves (its Table 2) translate with a fixed heading. They start in full motion, which no robot
//! can; [`Ramped`] bends time at both ends, so that the body travels the same curve but leaves and reaches it
//! at rest. The bend is the cubic STEP function: `3 s^2 - 2 s^3`.

use crate::arithmetic::Real;
use crate::frame::{Pose, Twist};

/// A motion over a limited time.
pub trait Trajectory<S = f32> {
    /// Pose and twist at `time` s, both in the world frame.
    fn at(&self, time: S) -> (Pose<S>, Twist<S>);
    /// How long the motion takes, s.
    fn duration(&self) -> S;
}

/// The paper's figure-eight: in its frame `x = l sin 2wt`, `y = l cos wt`.
///
/// Here, with x forward and y left: `x = l cos wt`, `y = -l sin 2wt`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FigureEight<S = f32> {
    /// Amplitude `l` on both axes, m.
    pub amplitude: S,
    /// Angular frequency `w`, rad/s.
    pub frequency: S,
}

impl<S: Real> FigureEight<S> {
    /// The curve of the paper: 2500 mm, pi/10 rad/s, 20 s for one round.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            amplitude: S::constant(2.5),
            frequency: S::pi() / S::constant(10.0),
        }
    }
}

impl<S: Real> Trajectory<S> for FigureEight<S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        let Self {
            amplitude: l,
            frequency: w,
        } = *self;
        let two = S::constant(2.0);
        let (sin, cos) = (w * time).sine_cosine();
        let (sin_2, cos_2) = (two * w * time).sine_cosine();
        (
            Pose::new(l * cos, -l * sin_2, S::zero()),
            Twist::new(-l * w * sin, -two * l * w * cos_2, S::zero()),
        )
    }

    fn duration(&self) -> S {
        S::two_pi() / self.frequency.abs()
    }
}

/// The paper's circle, heading fixed: in its frame `x = r sin wt`, `y = r cos wt`.
///
/// Here, with x forward and y left: `x = r cos wt`, `y = -r sin wt`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle<S = f32> {
    /// Radius, m.
    pub radius: S,
    /// Angular frequency, rad/s; positive goes round clockwise, as in the paper.
    pub frequency: S,
}

impl<S: Real> Circle<S> {
    /// The curve of the paper: 2500 mm, pi/10 rad/s, 20 s for one round.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            radius: S::constant(2.5),
            frequency: S::pi() / S::constant(10.0),
        }
    }
}

impl<S: Real> Trajectory<S> for Circle<S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        let Self {
            radius: r,
            frequency: w,
        } = *self;
        let (sin, cos) = (w * time).sine_cosine();
        (
            Pose::new(r * cos, -r * sin, S::zero()),
            Twist::new(-r * w * sin, -r * w * cos, S::zero()),
        )
    }

    fn duration(&self) -> S {
        S::two_pi() / self.frequency.abs()
    }
}

/// A harmonic curve: uniform sideways, sinusoidal forward and back.
///
/// The paper's Table 2 has lost this equation; its text says uniform along one axis and sinusoidal along the
/// other. Here `x = a sin wt`, `y = -v t`: in the paper's frame, uniform along its x, harmonic along its y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Harmonic<S = f32> {
    /// Amplitude `a` of the forward motion, m.
    pub amplitude: S,
    /// Speed `v` of the uniform motion to the right, m/s.
    pub speed: S,
    /// Angular frequency `w`, rad/s.
    pub frequency: S,
    /// How many periods.
    pub periods: S,
}

impl<S: Real> Trajectory<S> for Harmonic<S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        let Self {
            amplitude: a,
            speed: v,
            frequency: w,
            ..
        } = *self;
        let (sin, cos) = (w * time).sine_cosine();
        (
            Pose::new(a * sin, -v * time, S::zero()),
            Twist::new(a * w * cos, -v, S::zero()),
        )
    }

    fn duration(&self) -> S {
        self.periods * S::two_pi() / self.frequency.abs()
    }
}

/// The cubic STEP function from 0 to 1 over `share` 0 to 1, held outside.
#[must_use]
pub fn step<S: Real>(share: S) -> S {
    let s = share.max(S::zero()).min(S::one());
    s * s * (S::constant(3.0) - S::constant(2.0) * s)
}

/// A trajectory entered from rest and left to rest, on the same curve.
///
/// Time along the inner trajectory runs at a rate that rises from 0 to 1 over `ramp` seconds and falls the same
/// way at the end. Each ramp covers half of its own length of the inner trajectory, so the motion takes `ramp`
/// seconds longer than the inner one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramped<T, S = f32> {
    inner: T,
    ramp: S,
}

impl<S: Real, T: Trajectory<S>> Ramped<T, S> {
    /// Ramps over `ramp` seconds; shorter where the inner trajectory is too short for two ramps.
    ///
    /// The paper's figure-eight at 2500 mm and pi/10 needs 2 s to stay within what friction can push.
    #[must_use]
    pub fn new(inner: T, ramp: S) -> Self {
        let ramp = ramp.max(S::zero()).min(inner.duration());
        Self { inner, ramp }
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
        let time = time.max(S::zero()).min(whole);
        // The way through one ramp: the integral of the STEP function.
        let risen = |since: S| {
            let s = since / self.ramp;
            self.ramp * s * s * s * (S::one() - half * s)
        };
        if time < self.ramp {
            (risen(time), step(time / self.ramp))
        } else if time > whole - self.ramp {
            let left = whole - time;
            (self.inner.duration() - risen(left), step(left / self.ramp))
        } else {
            (time - half * self.ramp, S::one())
        }
    }
}

impl<S: Real, T: Trajectory<S>> Trajectory<S> for Ramped<T, S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        let (inner_time, rate) = self.warp(time);
        let (pose, twist) = self.inner.at(inner_time);
        let beyond = time < S::zero() || time > self.duration();
        (
            pose,
            if beyond {
                twist * S::zero()
            } else {
                twist * rate
            },
        )
    }

    fn duration(&self) -> S {
        self.inner.duration() + self.ramp
    }
}
