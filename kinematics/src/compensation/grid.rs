//! Compensation for a control loop: coefficients at equal steps of speed, with a lookup of a few
//! instructions.
//!
//! An [`AxisTable`] searches its rows and evaluates a cubic, which suits building and checking a
//! table. Here the same curve is sampled once, at [`INTERVALS`] equal steps from standstill to its
//! last row, and read by linear interpolation. The interpolation error is at most `1.5 (step / row
//! spacing)^2` of the difference of the two rows around it, in the middle between two samples; from
//! the last row on, and in a table of one row, it is zero. Samples are 16 bits over the range of
//! the table, so an axis takes 44 bytes.
//!
//! The three forms of this folder become this one: a constant is an axis without steps, a table
//! over each axis's own speed has no oblique samples, the directional one has them. About 20
//! instructions for each table that is looked up; none when all are constant
//! ([`GridCompensation::is_constant`]).

use super::{
    AxisTable, Compensation, DirectionalCompensation, SpeedCompensation, VelocityCompensation,
    invert,
};
use crate::arithmetic::Real;
use crate::frame::Twist;

/// Steps of speed in which an axis is sampled.
pub const INTERVALS: usize = 16;

/// Steps of a sample over the range of its table.
const STEPS: f32 = 65_535.0;

/// Below this square of a speed (m^2/s^2) the direction of motion means nothing.
const STANDING: f32 = 1e-12;

/// One axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    /// Intervals per speed; 0 for a constant.
    per_speed: f32,
    /// Smallest coefficient, and the coefficient per step of a sample.
    low: f32,
    per_step: f32,
    samples: [u16; INTERVALS + 1],
}

impl Axis {
    const fn constant(coefficient: f32) -> Self {
        Self {
            per_speed: 0.0,
            low: coefficient,
            per_step: 0.0,
            samples: [0; INTERVALS + 1],
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a small count; and a share of 65535, which the cast saturates"
    )]
    fn new<const R: usize>(table: &AxisTable<R>) -> Self {
        let (low, high) = table.range();
        let range = high - low;
        if range <= 0.0 {
            return Self::constant(low);
        }
        let step = table.last_speed() / INTERVALS as f32;
        let mut axis = Self {
            per_speed: 1.0 / step,
            low,
            per_step: range / STEPS,
            samples: [0; INTERVALS + 1],
        };
        for (i, sample) in axis.samples.iter_mut().enumerate() {
            let share = (table.coefficient(step * i as f32) - low) / range;
            *sample = (share * STEPS + 0.5) as u16;
        }
        axis
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "between 0 and 16"
    )]
    #[inline]
    fn coefficient(&self, speed: f32) -> f32 {
        const LAST: f32 = INTERVALS as f32;
        if self.is_constant() {
            return self.low;
        }
        let place = speed.abs() * self.per_speed;
        let place = if place > LAST { LAST } else { place };
        let at = (place as usize).min(INTERVALS - 1);
        let from = self.samples.get(at).copied().map_or(0.0, f32::from);
        let to = self.samples.get(at + 1).copied().map_or(0.0, f32::from);
        self.low + self.per_step * (from + (to - from) * (place - at as f32))
    }

    const fn is_constant(&self) -> bool {
        // Its bits: a comparison of floats is a call where there is no unit for it.
        self.per_step.to_bits() == 0
    }

    /// The largest coefficient this axis gives.
    fn high(&self) -> f32 {
        if self.is_constant() {
            self.low
        } else {
            self.low + self.per_step * STEPS
        }
    }
}

/// Any compensation, sampled for a control loop.
///
/// ```
/// use mecanum_kinematics::{AxisTable, Compensation, GridCompensation, SpeedCompensation, Twist};
///
/// let tables = SpeedCompensation {
///     longitudinal: AxisTable::new(&[(0.1, 1.022), (0.5, 1.027)])?,
///     lateral: AxisTable::new(&[(0.1, 1.141), (0.5, 1.157)])?,
///     yaw: AxisTable::new(&[(0.5, 1.025), (1.0, 1.026)])?,
/// };
/// let grid = GridCompensation::from(&tables);
/// let twist = Twist::new(0.3, -0.2, 0.1);
/// let (want, found) = (tables.apply(twist), grid.apply(twist));
/// assert!((want.vy - found.vy).abs() < 1e-4 * 0.2);
/// # Ok::<(), mecanum_kinematics::CompensationError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridCompensation {
    longitudinal: Axis,
    lateral: Axis,
    yaw: Axis,
    /// Longitudinal and lateral at 45 degrees; then all but yaw go by the speed of the whole
    /// motion.
    oblique: Option<[Axis; 2]>,
}

impl GridCompensation {
    /// Whether every coefficient is the same at any speed and in any direction.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        let axes =
            self.longitudinal.is_constant() && self.lateral.is_constant() && self.yaw.is_constant();
        axes && self.oblique.is_none()
    }

    /// Coefficients along x, along y and about z for this motion (achieved, robot frame).
    #[must_use]
    #[inline]
    pub fn coefficients(&self, desired: Twist) -> [f32; 3] {
        let yaw = self.yaw.coefficient(desired.omega);
        let Some([oblique_x, oblique_y]) = &self.oblique else {
            let x = self.longitudinal.coefficient(desired.vx);
            return [x, self.lateral.coefficient(desired.vy), yaw];
        };
        let (xx, yy) = (desired.vx * desired.vx, desired.vy * desired.vy);
        let square = xx + yy;
        let speed = square.root();
        let ahead = self.longitudinal.coefficient(speed);
        let aside = self.lateral.coefficient(speed);
        if square < STANDING {
            return [ahead, aside, yaw];
        }
        let twice = 2.0 / square;
        [
            ahead + twice * yy * (oblique_x.coefficient(speed) - ahead),
            aside + twice * xx * (oblique_y.coefficient(speed) - aside),
            yaw,
        ]
    }

    /// The largest coefficient it gives for any motion: along x, along y, about z.
    ///
    /// With oblique samples a coefficient leads on from the axial through the oblique one to as far
    /// behind it.
    #[must_use]
    pub fn largest(&self) -> [f32; 3] {
        let across = |axial: &Axis, oblique: Option<&Axis>| {
            let far = oblique.map_or(0.0, |oblique| 2.0 * oblique.high() - axial.low);
            axial.high().max(far)
        };
        let oblique = self.oblique.as_ref();
        [
            across(&self.longitudinal, oblique.map(|[x, _]| x)),
            across(&self.lateral, oblique.map(|[_, y]| y)),
            self.yaw.high(),
        ]
    }
}

impl From<&VelocityCompensation> for GridCompensation {
    fn from(constant: &VelocityCompensation) -> Self {
        Self {
            longitudinal: Axis::constant(constant.longitudinal()),
            lateral: Axis::constant(constant.lateral()),
            yaw: Axis::constant(constant.yaw()),
            oblique: None,
        }
    }
}

impl<const X: usize, const Y: usize, const W: usize> From<&SpeedCompensation<X, Y, W>>
    for GridCompensation
{
    fn from(tables: &SpeedCompensation<X, Y, W>) -> Self {
        Self {
            longitudinal: Axis::new(&tables.longitudinal),
            lateral: Axis::new(&tables.lateral),
            yaw: Axis::new(&tables.yaw),
            oblique: None,
        }
    }
}

impl<const X: usize, const Y: usize, const O: usize, const W: usize>
    From<&DirectionalCompensation<X, Y, O, W>> for GridCompensation
{
    fn from(tables: &DirectionalCompensation<X, Y, O, W>) -> Self {
        let (ahead, aside, oblique, yaw) = tables.tables();
        Self {
            longitudinal: Axis::new(ahead),
            lateral: Axis::new(aside),
            yaw: Axis::new(yaw),
            oblique: Some(oblique.map(Axis::new)),
        }
    }
}

impl Compensation for GridCompensation {
    fn apply(&self, desired: Twist) -> Twist {
        let [x, y, w] = self.coefficients(desired);
        Twist::new(desired.vx * x, desired.vy * y, desired.omega * w)
    }

    fn remove(&self, asked: Twist) -> Twist {
        invert(asked, |desired| self.coefficients(desired))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's Table 7, lateral, as (achieved speed, coefficient): the steepest of its tables.
    fn lateral() -> AxisTable<5> {
        AxisTable::from_measurements(&[
            (0.1, 0.087_621),
            (0.2, 0.174_193),
            (0.3, 0.260_675),
            (0.4, 0.346_9),
            (0.5, 0.432_065),
        ])
        .unwrap()
    }

    fn constant(coefficient: f32) -> AxisTable<1> {
        AxisTable::new(&[(0.3, coefficient)]).unwrap()
    }

    #[test]
    fn a_constant_is_exact() {
        let constant = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
        let grid = GridCompensation::from(&constant);
        assert!(grid.is_constant());
        for twist in [Twist::ZERO, Twist::new(0.5, -3.0, 0.2)] {
            assert_eq!(grid.coefficients(twist), [1.002, 1.033, 1.0195]);
            assert_eq!(grid.apply(twist), constant.apply(twist));
        }
        assert_eq!(grid.largest(), [1.002, 1.033, 1.0195]);
    }

    #[test]
    fn samples_keep_the_stated_bound() {
        let table = lateral();
        let grid = GridCompensation::from(&SpeedCompensation {
            longitudinal: constant(1.0),
            lateral: table,
            yaw: constant(1.0),
        });
        assert!(!grid.is_constant());
        let (low, high) = table.range();
        let step = 0.432_065 / 16.0;
        // Rows are 0.0865 apart; no two differ by more than the whole range. Half a sample on top.
        let bound = 1.5 * (step / 0.0864_f32).powi(2) * (high - low) + (high - low) / 65_535.0;
        let mut worst = 0.0_f32;
        for mm in 0..700_i16 {
            let speed = f32::from(mm) * 1e-3;
            let [_, found, _] = grid.coefficients(Twist::new(0.0, -speed, 0.0));
            worst = worst.max((found - table.coefficient(speed)).abs());
        }
        assert!(worst <= bound, "{worst} > {bound}");
        assert!(worst > 0.0, "the curve is not straight");
        // Beyond the last row it stays where it is.
        let [_, last, _] = grid.coefficients(Twist::new(0.0, 3.0, 0.0));
        assert!((last - 0.5 / 0.432_065).abs() < 1e-6);
        let [_, largest, _] = grid.largest();
        assert!((largest - high).abs() < 1e-6);
    }

    /// Table 3 and 4 of the paper: 1.0022 ahead, 1.0326 aside, 1.0170 and 1.0175 at 45 degrees.
    fn directional() -> DirectionalCompensation<1, 1, 1, 1> {
        DirectionalCompensation::new(
            constant(1.0022),
            constant(1.0326),
            constant(1.0170),
            constant(1.0175),
            constant(1.0195),
        )
        .unwrap()
    }

    #[test]
    fn direction_counts_as_in_the_table() {
        let tables = directional();
        let grid = GridCompensation::from(&tables);
        assert!(!grid.is_constant());
        let [x, y, w] = grid.coefficients(Twist::new(0.2, -0.2, 0.1));
        assert!((x - 1.0170).abs() < 1e-6 && (y - 1.0175).abs() < 1e-6);
        assert!((w - 1.0195).abs() < 1e-6);
        for degrees in 0..360_i16 {
            let (sin, cos) = f32::from(degrees).to_radians().sin_cos();
            let twist = Twist::new(0.4 * cos, 0.4 * sin, 0.0);
            let (want, found) = (tables.apply(twist), grid.apply(twist));
            assert!((want.vx - found.vx).abs() < 1e-6, "{degrees}");
            assert!((want.vy - found.vy).abs() < 1e-6, "{degrees}");
            let [x, y, _] = grid.coefficients(twist);
            let [most_x, most_y, _] = grid.largest();
            assert!(x <= most_x + 1e-6 && y <= most_y + 1e-6, "{degrees}");
        }
        assert_eq!(grid.coefficients(Twist::ZERO), [1.0022, 1.0326, 1.0195]);
    }

    #[test]
    fn removed_is_what_was_applied() {
        let grids = [
            GridCompensation::from(&directional()),
            GridCompensation::from(&SpeedCompensation {
                longitudinal: constant(1.02),
                lateral: lateral(),
                yaw: constant(1.03),
            }),
        ];
        for grid in grids {
            for twist in [
                Twist::new(0.31, -0.22, 0.4),
                Twist::new(0.0, 0.1, 0.0),
                Twist::ZERO,
            ] {
                let back = grid.remove(grid.apply(twist));
                assert!((back.vx - twist.vx).abs() < 1e-6);
                assert!((back.vy - twist.vy).abs() < 1e-6);
                assert!((back.omega - twist.omega).abs() < 1e-6);
            }
        }
    }
}
