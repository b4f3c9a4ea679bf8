//! Odometry in single precision.

use kinematics::{Pose, Twist};

use crate::quantity::Angle;

/// Integrates the displacements of the ticks.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Odometry(kinematics::Odometry);

impl Odometry {
    /// At the origin, heading along x.
    #[must_use]
    pub const fn new() -> Self {
        Self(kinematics::Odometry::new())
    }

    /// Moves on by a displacement in the group frame, m and rad.
    #[inline]
    pub fn advance(&mut self, moved: Twist<Angle>) {
        self.0.advance(Twist {
            vx: moved.vx.to_f32(),
            vy: moved.vy.to_f32(),
            omega: moved.omega.to_f32(),
        });
    }

    /// The pose, m and rad, heading within ±pi.
    #[must_use]
    #[inline]
    pub fn pose(&self) -> Pose {
        self.0.pose()
    }
}
