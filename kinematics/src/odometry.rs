//! From velocity to pose, exactly.
//!
//! A body that keeps a constant twist for `dt` moves on a circular arc. The Euler step (straight ahead, then
//! turn) misses that arc by half the turn; here the arc is integrated in closed form, so the only errors left
//! are the twist's own and the rounding of the sums.

use crate::arithmetic::Real;
use crate::frame::{Pose, Twist};

/// Integrates a body's twist into its pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Odometry<S = f32> {
    pose: Pose<S>,
}

impl<S: Real> Odometry<S> {
    /// Starts at the origin, heading along x.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Starts at this pose (m, m, rad).
    #[must_use]
    pub fn at(pose: Pose<S>) -> Self {
        Self {
            pose: Pose {
                heading: wrap(pose.heading),
                ..pose
            },
        }
    }

    /// Moves on with a constant `twist` (body frame) for `dt` seconds.
    pub fn update(&mut self, twist: Twist<S>, dt: S) {
        let turn = twist.omega * dt;
        // (sin a)/a and (1 - cos a)/a: the chord of the arc, along and across the initial heading.
        let (along, across) = if turn.abs() < S::constant(0.25) {
            let square = turn * turn;
            (
                S::one()
                    - square
                        * (S::constant(1.0 / 6.0)
                            - square
                                * (S::constant(1.0 / 120.0) - square * S::constant(1.0 / 5040.0))),
                turn * (S::constant(0.5)
                    - square * (S::constant(1.0 / 24.0) - square * S::constant(1.0 / 720.0))),
            )
        } else {
            let (sin, cos) = turn.sine_cosine();
            (sin / turn, (S::one() - cos) / turn)
        };
        let (sin, cos) = self.pose.heading.sine_cosine();
        let step_x = (along * twist.vx - across * twist.vy) * dt;
        let step_y = (across * twist.vx + along * twist.vy) * dt;
        self.pose.x += cos * step_x - sin * step_y;
        self.pose.y += sin * step_x + cos * step_y;
        self.pose.heading = wrap(self.pose.heading + turn);
    }

    /// The pose now: m, m, and the heading within ±pi.
    #[must_use]
    pub const fn pose(&self) -> Pose<S> {
        self.pose
    }
}

/// The same angle within ±pi.
fn wrap<S: Real>(angle: S) -> S {
    let turn = S::two_pi();
    if angle > S::pi() {
        let once = angle - turn;
        if once > S::pi() {
            angle - turn * ((angle + S::pi()) / turn).floor()
        } else {
            once
        }
    } else if angle < -S::pi() {
        let once = angle + turn;
        if once < -S::pi() {
            angle - turn * ((angle + S::pi()) / turn).floor()
        } else {
            once
        }
    } else {
        angle
    }
}
