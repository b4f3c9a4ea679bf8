//! The curves themselves: the three of the paper's Table 2, straight lines, turning on the spot,
//! and two ways to hold the heading on any of them.

use super::{Acceleration, Trajectory};
use crate::arithmetic::Real;
use crate::frame::{Pose, Twist};

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
            Pose::new(l * cos, -l * sin_2, S::ZERO),
            Twist::new(-l * w * sin, -two * l * w * cos_2, S::ZERO),
        )
    }

    fn acceleration(&self, time: S) -> Acceleration<S> {
        let Self {
            amplitude: l,
            frequency: w,
        } = *self;
        let (_, cos) = (w * time).sine_cosine();
        let (sin_2, _) = (S::constant(2.0) * w * time).sine_cosine();
        let square = l * w * w;
        Acceleration::new(-square * cos, S::constant(4.0) * square * sin_2, S::ZERO)
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
            Pose::new(r * cos, -r * sin, S::ZERO),
            Twist::new(-r * w * sin, -r * w * cos, S::ZERO),
        )
    }

    fn acceleration(&self, time: S) -> Acceleration<S> {
        let (sin, cos) = (self.frequency * time).sine_cosine();
        let square = self.radius * self.frequency * self.frequency;
        Acceleration::new(-square * cos, square * sin, S::ZERO)
    }

    fn duration(&self) -> S {
        S::two_pi() / self.frequency.abs()
    }
}

/// A harmonic curve: uniform sideways, sinusoidal forward and back.
///
/// The paper's Table 2 has lost this equation; its text says uniform along one axis and sinusoidal
/// along the other. Here `x = a sin wt`, `y = -v t`: in the paper's frame, uniform along its x,
/// harmonic along its y.
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
            Pose::new(a * sin, -v * time, S::ZERO),
            Twist::new(a * w * cos, -v, S::ZERO),
        )
    }

    fn acceleration(&self, time: S) -> Acceleration<S> {
        let (sin, _) = (self.frequency * time).sine_cosine();
        let square = self.amplitude * self.frequency * self.frequency;
        Acceleration::new(-square * sin, S::ZERO, S::ZERO)
    }

    fn duration(&self) -> S {
        self.periods * S::two_pi() / self.frequency.abs()
    }
}

/// Straight ahead, sideways or obliquely, at a constant velocity and heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line<S = f32> {
    /// Velocity along x, m/s.
    pub vx: S,
    /// Velocity along y, m/s.
    pub vy: S,
    /// How long, s.
    pub duration: S,
}

impl<S: Real> Trajectory<S> for Line<S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        (
            Pose::new(self.vx * time, self.vy * time, S::ZERO),
            Twist::translation(self.vx, self.vy),
        )
    }

    fn acceleration(&self, _: S) -> Acceleration<S> {
        Acceleration::default()
    }

    fn duration(&self) -> S {
        self.duration
    }
}

/// Turning on the spot at a constant rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn<S = f32> {
    /// Angular velocity, counter-clockwise positive, rad/s.
    pub omega: S,
    /// How long, s.
    pub duration: S,
}

impl<S: Real> Trajectory<S> for Turn<S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        (
            Pose::new(S::ZERO, S::ZERO, self.omega * time),
            Twist::new(S::ZERO, S::ZERO, self.omega),
        )
    }

    fn acceleration(&self, _: S) -> Acceleration<S> {
        Acceleration::default()
    }

    fn duration(&self) -> S {
        self.duration
    }
}

/// The same path with another heading: fixed ("oblique" in the paper), or turning evenly
/// ("centripetal", when it turns with the circle, so that the same side faces the centre all the
/// way).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heading<T, S = f32> {
    /// The path; its own heading is added.
    pub path: T,
    /// Heading at the start, rad.
    pub offset: S,
    /// How fast the heading turns, rad/s.
    pub rate: S,
}

impl<S: Real, T: Trajectory<S>> Trajectory<S> for Heading<T, S> {
    fn at(&self, time: S) -> (Pose<S>, Twist<S>) {
        let (pose, twist) = self.path.at(time);
        let heading = pose.heading + self.offset + self.rate * time;
        (
            Pose::new(pose.x, pose.y, heading),
            Twist::new(twist.vx, twist.vy, twist.omega + self.rate),
        )
    }

    fn acceleration(&self, time: S) -> Acceleration<S> {
        self.path.acceleration(time)
    }

    fn duration(&self) -> S {
        self.path.duration()
    }
}
