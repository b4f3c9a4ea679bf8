//! Velocity and pose of a body in the plane.
//!
//! REP-103: x forward, y left, heading counter-clockwise. A [`Twist`] does not contain its frame;
//! the functions that take one document which frame they expect, and this file has the two that
//! change it.

use core::ops::{Add, Mul, Neg, Sub};

use crate::arithmetic::{Real, Scalar};

/// Velocity of a body in the plane.
///
/// ```
/// use mecanum_kinematics::Twist;
///
/// let ahead = Twist::new(0.5_f64, 0.0, 0.1);
/// // The same motion in the world, of a body that heads left.
/// let world = ahead.to_world(core::f64::consts::FRAC_PI_2);
/// assert!(world.vx.abs() < 1e-12 && (world.vy - 0.5).abs() < 1e-12);
/// assert_eq!((ahead * 2.0).omega, 0.2);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Twist<S = f32> {
    /// Velocity along x, forward positive, m/s.
    pub vx: S,
    /// Velocity along y, left positive, m/s.
    pub vy: S,
    /// Angular velocity, counter-clockwise positive, rad/s.
    pub omega: S,
}

impl Twist {
    /// Standing still.
    pub const ZERO: Self = Self {
        vx: 0.0,
        vy: 0.0,
        omega: 0.0,
    };
}

impl<S: Scalar> Twist<S> {
    /// The same twist in another scalar, rounded to the nearest and, in fixed point, saturated.
    #[must_use]
    pub fn convert<T: Scalar>(self) -> Twist<T> {
        Twist {
            vx: T::constant(self.vx.widen()),
            vy: T::constant(self.vy.widen()),
            omega: T::constant(self.omega.widen()),
        }
    }

    /// Whether any component stands at the end of its scalar's range, so that the true one may lie
    /// beyond.
    #[must_use]
    #[inline]
    pub fn is_saturated(&self) -> bool {
        self.vx.is_saturated() | self.vy.is_saturated() | self.omega.is_saturated()
    }
}

impl<S: Real> Twist<S> {
    /// A twist from its components, m/s, m/s, rad/s.
    #[must_use]
    pub const fn new(vx: S, vy: S, omega: S) -> Self {
        Self { vx, vy, omega }
    }

    /// Translation only, m/s: the motion of equations (14) and (21).
    #[must_use]
    pub const fn translation(vx: S, vy: S) -> Self {
        Self::new(vx, vy, S::ZERO)
    }

    /// The same velocity, given in the world frame, seen from a body with this heading (rad).
    #[must_use]
    pub fn to_body(self, heading: S) -> Self {
        self.rotated(Rotation::by(heading).inverse())
    }

    /// The same velocity, given in the frame of a body with this heading (rad), in the world frame.
    #[must_use]
    pub fn to_world(self, heading: S) -> Self {
        self.rotated(Rotation::by(heading))
    }

    /// The linear part turned counter-clockwise.
    pub(crate) fn rotated(self, Rotation { sin, cos }: Rotation<S>) -> Self {
        Self {
            vx: cos * self.vx - sin * self.vy,
            vy: sin * self.vx + cos * self.vy,
            omega: self.omega,
        }
    }
}

/// Sine and cosine of an angle by which something is turned counter-clockwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rotation<S> {
    pub sin: S,
    pub cos: S,
}

impl<S: Real> Rotation<S> {
    /// By an angle in rad.
    pub fn by(angle: S) -> Self {
        let (sin, cos) = angle.sine_cosine();
        Self { sin, cos }
    }

    /// By an angle within ±8 rad.
    #[inline]
    pub fn by_heading(angle: S) -> Self {
        let (sin, cos) = angle.heading_sine_cosine();
        Self { sin, cos }
    }

    /// By the same angle, clockwise.
    pub fn inverse(self) -> Self {
        let Self { sin, cos } = self;
        Self { sin: -sin, cos }
    }
}

impl<S: Add<Output = S>> Add for Twist<S> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            vx: self.vx + other.vx,
            vy: self.vy + other.vy,
            omega: self.omega + other.omega,
        }
    }
}

impl<S: Sub<Output = S>> Sub for Twist<S> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self {
            vx: self.vx - other.vx,
            vy: self.vy - other.vy,
            omega: self.omega - other.omega,
        }
    }
}

impl<S: Mul<Output = S> + Copy> Mul<S> for Twist<S> {
    type Output = Self;
    fn mul(self, factor: S) -> Self {
        Self {
            vx: self.vx * factor,
            vy: self.vy * factor,
            omega: self.omega * factor,
        }
    }
}

impl<S: Neg<Output = S>> Neg for Twist<S> {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            vx: -self.vx,
            vy: -self.vy,
            omega: -self.omega,
        }
    }
}

/// Position and heading of a body in the plane.
///
/// ```
/// use mecanum_kinematics::Pose;
///
/// let group = Pose::new(10.0_f64, 0.0, core::f64::consts::FRAC_PI_2);
/// let member = Pose::new(1.0, 0.0, 0.0); // 1 m ahead in the group
/// let in_world = group.compose(member);
/// assert!((in_world.x - 10.0).abs() < 1e-12 && (in_world.y - 1.0).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pose<S = f32> {
    /// Position along x, m.
    pub x: S,
    /// Position along y, m.
    pub y: S,
    /// Heading, counter-clockwise positive, 0 along x, rad.
    pub heading: S,
}

impl Pose {
    /// At the origin, heading along x.
    pub const ZERO: Self = Self {
        x: 0.0,
        y: 0.0,
        heading: 0.0,
    };
}

impl<S: Real> Pose<S> {
    /// A pose from its components, m, m, rad.
    #[must_use]
    pub const fn new(x: S, y: S, heading: S) -> Self {
        Self { x, y, heading }
    }

    /// A pose given in the frame of `self`, in the frame `self` is given in.
    #[must_use]
    pub fn compose(self, inner: Self) -> Self {
        let (sin, cos) = self.heading.sine_cosine();
        Self {
            x: self.x + cos * inner.x - sin * inner.y,
            y: self.y + sin * inner.x + cos * inner.y,
            heading: self.heading + inner.heading,
        }
    }
}
