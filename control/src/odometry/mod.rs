//! The group's pose from its displacement in each tick.
//!
//! # Theory of operation
//!
//! A body that turns while it moves runs along an arc. In single precision [`kinematics::Odometry`]
//! integrates it. In fixed point the arc is replaced by its chord: the displacement in the
//! direction half-way through the turn, shortened by `sin(w/2) / (w/2)`. Both are exact; only
//! rounding differs.
//!
//! # Limits
//!
//! In fixed point a displacement saturates at 16 m a tick and the position at 4 000 km, and a turn
//! of more than 1.4 rad a tick has the chord of one of 1.4 rad.

#[cfg(feature = "fixed-point")]
mod fixed_point;
#[cfg(feature = "fixed-point")]
use fixed_point as scalar;
#[cfg(not(feature = "fixed-point"))]
mod single;
#[cfg(not(feature = "fixed-point"))]
use single as scalar;

pub use scalar::Odometry;

#[cfg(test)]
mod tests {
    use super::Odometry;
    use crate::quantity::Angle;
    use kinematics::Twist;

    /// A thousand ticks of the same displacement against `f64`'s integral of the same, m and rad.
    fn off(ticks: u32, vx: f32, vy: f32, omega: f32) -> (f64, f64) {
        let moved = Twist {
            vx: Angle::new(vx),
            vy: Angle::new(vy),
            omega: Angle::new(omega),
        };
        let mut odometry = Odometry::new();
        let mut exact = kinematics::Odometry::<f64>::new();
        for _ in 0..ticks {
            odometry.advance(moved);
            exact.advance(Twist {
                vx: moved.vx.to_f32().into(),
                vy: moved.vy.to_f32().into(),
                omega: moved.omega.to_f32().into(),
            });
        }
        let (pose, exact) = (odometry.pose(), exact.pose());
        let turn = (f64::from(pose.heading) - exact.heading).rem_euclid(core::f64::consts::TAU);
        (
            (f64::from(pose.x) - exact.x).hypot(f64::from(pose.y) - exact.y),
            turn.min(core::f64::consts::TAU - turn),
        )
    }

    /// From a still robot to one that turns by 1.3 rad in a tick, which is 65 rad/s for 20 ms.
    #[test]
    fn the_pose_is_that_of_the_arc() {
        for turn in [0.0, 1e-6, -3e-4, 0.002, 0.03, -0.12, 0.13, 0.5, -1.3_f32] {
            for (vx, vy) in [(1e-3, 0.0), (0.0, -2e-3), (0.065, 0.04), (-1.3, 0.5_f32)] {
                let (place, heading) = off(1_000, vx, vy, turn);
                let way = 1e3 * f64::from(vx.hypot(vy));
                // A float's steps of the result, and of every sine.
                assert!(place <= 3e-7 * way + 1e-8, "{place:e} m: {vx} {vy} {turn}");
                assert!(heading <= 3e-7, "{heading:e} rad: {turn}");
            }
        }
    }

    /// A minute of a quarter of a metre a second around a circle.
    #[test]
    fn rounding_does_not_add_up() {
        let (place, heading) = off(60_000, 2.5e-4, 1e-5, 7e-4);
        assert!(
            place < 1e-6 && heading < 1e-6,
            "{place:e} m {heading:e} rad"
        );
    }
}
