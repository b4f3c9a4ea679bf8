//! Coefficients that also depend on the direction of motion.
//!
//! The paper's robot, moving at 45 degrees, loses 1.7 % on *both* axes (Table 4), while it loses
//! 0.2 % straight ahead and 3.2 % sideways (Table 3): the loss depends on the whole motion, because
//! at 45 degrees only two wheels roll. With `s` the lateral fraction of the squared speed, 0
//! straight ahead, 1/2 at 45 degrees, 1 sideways,
//!
//! `longitudinal = ahead + 2 s (oblique - ahead)`, `lateral = aside + 2 (1 - s) (oblique - aside)`,
//!
//! which is exact at all three measured directions and linear in `s` between them. Each of the four
//! numbers is a table over the speed of the whole motion.

use super::{AxisTable, Compensation, STEEPEST, invert};
use crate::arithmetic::Real;
use crate::error::CompensationError;
use crate::frame::Twist;

/// Tables for motion along the axes, at 45 degrees, and on the spot.
///
/// ```
/// use mecanum_kinematics::{AxisTable, Compensation, DirectionalCompensation, Twist};
///
/// let at_any_speed = |coefficient: f64| AxisTable::new(&[(0.3, coefficient)]);
/// let compensation = DirectionalCompensation::new(
///     at_any_speed(1.0022)?, // straight ahead
///     at_any_speed(1.0326)?, // sideways
///     at_any_speed(1.0170)?, // longitudinal at 45 degrees
///     at_any_speed(1.0175)?, // lateral at 45 degrees
///     at_any_speed(1.0195)?, // yaw
/// )?;
/// let asked = compensation.apply(Twist::new(0.2, -0.2, 0.0));
/// assert!((asked.vx - 0.2034).abs() < 1e-12 && (asked.vy + 0.2035).abs() < 1e-12);
/// # Ok::<(), mecanum_kinematics::CompensationError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectionalCompensation<
    const X: usize,
    const Y: usize,
    const O: usize,
    const W: usize,
    S = f32,
> {
    ahead: AxisTable<X, S>,
    aside: AxisTable<Y, S>,
    oblique_longitudinal: AxisTable<O, S>,
    oblique_lateral: AxisTable<O, S>,
    yaw: AxisTable<W, S>,
}

impl<const X: usize, const Y: usize, const O: usize, const W: usize, S: Real>
    DirectionalCompensation<X, Y, O, W, S>
{
    /// From the coefficients straight ahead, sideways, of each axis at 45 degrees (all over the
    /// speed of the whole motion, m/s), and about z (over rad/s).
    ///
    /// # Errors
    ///
    /// [`CompensationError::TooOblique`] when the coefficients differ so much that the inverse
    /// might not be unique.
    pub fn new(
        ahead: AxisTable<X, S>,
        aside: AxisTable<Y, S>,
        oblique_longitudinal: AxisTable<O, S>,
        oblique_lateral: AxisTable<O, S>,
        yaw: AxisTable<W, S>,
    ) -> Result<Self, CompensationError> {
        // A change of direction by d changes s by at most d, so a coefficient by at most 2 |oblique
        // - axial| d; a change of speed changes it by at most what the steeper table does, three
        // times over at the far end of s.
        let spread = |(low, high): (S, S), (other_low, other_high): (S, S)| {
            let apart = (high - other_low).max(other_high - low);
            S::constant(2.0) * apart / low.min(other_low)
        };
        let across = spread(ahead.range(), oblique_longitudinal.range())
            .max(spread(aside.range(), oblique_lateral.range()));
        let along = ahead
            .steepness()
            .max(aside.steepness())
            .max(oblique_longitudinal.steepness())
            .max(oblique_lateral.steepness())
            * S::constant(3.0);
        if across + along > S::constant(STEEPEST) {
            return Err(CompensationError::TooOblique);
        }
        Ok(Self {
            ahead,
            aside,
            oblique_longitudinal,
            oblique_lateral,
            yaw,
        })
    }

    /// Ahead, aside, both at 45 degrees, yaw.
    #[must_use]
    #[expect(clippy::type_complexity, reason = "the four kinds of table there are")]
    pub const fn tables(
        &self,
    ) -> (
        &AxisTable<X, S>,
        &AxisTable<Y, S>,
        [&AxisTable<O, S>; 2],
        &AxisTable<W, S>,
    ) {
        let oblique = [&self.oblique_longitudinal, &self.oblique_lateral];
        (&self.ahead, &self.aside, oblique, &self.yaw)
    }

    fn coefficients(&self, desired: Twist<S>) -> [S; 3] {
        let yaw = self.yaw.coefficient(desired.omega);
        let (xx, yy) = (desired.vx * desired.vx, desired.vy * desired.vy);
        let square = xx + yy;
        let speed = square.root();
        let ahead = self.ahead.coefficient(speed);
        let aside = self.aside.coefficient(speed);
        if speed <= S::ZERO {
            return [ahead, aside, yaw];
        }
        let two = S::constant(2.0);
        let (lateral, longitudinal) = (two * yy / square, two * xx / square);
        let oblique = self.oblique_longitudinal.coefficient(speed);
        let oblique_lateral = self.oblique_lateral.coefficient(speed);
        [
            ahead + lateral * (oblique - ahead),
            aside + longitudinal * (oblique_lateral - aside),
            yaw,
        ]
    }
}

impl<const X: usize, const Y: usize, const O: usize, const W: usize, S: Real> Compensation<S>
    for DirectionalCompensation<X, Y, O, W, S>
{
    fn apply(&self, desired: Twist<S>) -> Twist<S> {
        let [x, y, w] = self.coefficients(desired);
        Twist::new(desired.vx * x, desired.vy * y, desired.omega * w)
    }

    fn remove(&self, asked: Twist<S>) -> Twist<S> {
        invert(asked, |desired| self.coefficients(desired))
    }
}
