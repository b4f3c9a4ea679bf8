//! Compensation for the control tick: coefficients at equal steps of speed, with a lookup of a few
//! instructions.
//!
//! An [`AxisTable`] searches its rows and evaluates a cubic, which suits building and checking a
//! table. Here the same curve is sampled once, at [`INTERVALS`] equal steps from standstill to its
//! last row, and read by linear interpolation. The interpolation error is at most `1.5 (step / row
//! spacing)^2` of the difference of the two rows around it, in the middle between two samples; from
//! the last row on, and in a table of one row, it is zero (in fixed point a step of the number).
//!
//! The three forms of [`kinematics`] become this one: a constant is an axis without steps, a table
//! over each axis's own speed has no oblique samples, the directional one has them. About 20
//! instructions for each table that is looked up; none when all are constant
//! ([`GridCompensation::is_constant`]).

use kinematics::{
    AxisTable, DirectionalCompensation, SpeedCompensation, Twist, VelocityCompensation,
};

use crate::quantity::{Rate, Ratio, Steps, polar};

/// Coefficients along x, along y and about z of a robot.
pub type Coefficients = [Ratio; 3];

/// Steps of speed in which an axis is sampled.
pub const INTERVALS: usize = 16;

/// One axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    /// Up to the last row; `None` for a constant.
    steps: Option<Steps<INTERVALS>>,
    samples: [Ratio; INTERVALS + 1],
}

impl Axis {
    const fn constant(coefficient: f32) -> Self {
        Self {
            steps: None,
            samples: [Ratio::new(coefficient); INTERVALS + 1],
        }
    }

    /// Takes a table.
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    #[inline(never)]
    fn sample<const R: usize>(&mut self, table: &AxisTable<R>) {
        let (low, high) = table.range();
        if high <= low {
            *self = Self::constant(low);
            return;
        }
        let end = table.last_speed();
        self.steps = Some(Steps::new(end));
        let step = end / INTERVALS as f32;
        for (i, sample) in self.samples.iter_mut().enumerate() {
            *sample = Ratio::new(table.coefficient(step * i as f32));
        }
    }

    #[inline]
    fn coefficient(&self, speed: Rate) -> Ratio {
        let Some(steps) = self.steps else {
            return self.standing();
        };
        let (at, part) = steps.at(speed);
        match self.samples.get(at..=at + 1) {
            Some([from, to]) => from.toward(*to, part),
            _ => self.standing(),
        }
    }

    /// At a speed of zero.
    const fn standing(&self) -> Ratio {
        let [first, ..] = self.samples;
        first
    }
}

/// Any compensation, sampled for the control tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridCompensation {
    is_constant: bool,
    longitudinal: Axis,
    lateral: Axis,
    yaw: Axis,
    /// Longitudinal and lateral at 45 degrees; then all but yaw go by the speed of the whole
    /// motion.
    oblique: Option<[Axis; 2]>,
}

impl GridCompensation {
    /// Takes tables over each axis's own speed. In place: a robot's stack has no room for many.
    pub fn sample<const X: usize, const Y: usize, const W: usize>(
        &mut self,
        tables: &SpeedCompensation<X, Y, W>,
    ) {
        self.longitudinal.sample(&tables.longitudinal);
        self.lateral.sample(&tables.lateral);
        self.yaw.sample(&tables.yaw);
        self.oblique = None;
        let axes = [&self.longitudinal, &self.lateral, &self.yaw];
        self.is_constant = axes.into_iter().all(|axis| axis.steps.is_none());
    }

    /// Takes tables over speed and direction, in place.
    pub fn sample_directions<const X: usize, const Y: usize, const O: usize, const W: usize>(
        &mut self,
        tables: &DirectionalCompensation<X, Y, O, W>,
    ) {
        let (ahead, aside, [along, across], yaw) = tables.tables();
        self.longitudinal.sample(ahead);
        self.lateral.sample(aside);
        self.yaw.sample(yaw);
        let [x, y] = self.oblique.insert([Axis::constant(1.0); 2]);
        x.sample(along);
        y.sample(across);
        self.is_constant = false;
    }

    /// Whether every coefficient is the same at any speed and in any direction.
    #[must_use]
    #[inline]
    pub const fn is_constant(&self) -> bool {
        self.is_constant
    }

    /// The coefficients for this motion (achieved, robot frame).
    #[must_use]
    #[inline]
    pub fn coefficients(&self, desired: Twist<Rate>) -> Coefficients {
        let (longitudinal, lateral) = (&self.longitudinal, &self.lateral);
        let yaw = self.yaw.coefficient(desired.omega);
        let Some([oblique_x, oblique_y]) = &self.oblique else {
            let x = longitudinal.coefficient(desired.vx);
            return [x, lateral.coefficient(desired.vy), yaw];
        };
        let Some((speed, across)) = polar(desired.vx, desired.vy) else {
            return [longitudinal.standing(), lateral.standing(), yaw];
        };
        let ahead = longitudinal.coefficient(speed);
        let aside = lateral.coefficient(speed);
        let along = const { Ratio::new(2.0) } - across;
        [
            ahead.toward(oblique_x.coefficient(speed), across),
            aside.toward(oblique_y.coefficient(speed), along),
            yaw,
        ]
    }
}

impl From<&VelocityCompensation> for GridCompensation {
    fn from(constant: &VelocityCompensation) -> Self {
        Self {
            is_constant: true,
            longitudinal: Axis::constant(constant.longitudinal()),
            lateral: Axis::constant(constant.lateral()),
            yaw: Axis::constant(constant.yaw()),
            oblique: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twist::quantities;
    use kinematics::Compensation as _;

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

    /// Coefficients as floats.
    fn at(grid: &GridCompensation, twist: Twist) -> [f32; 3] {
        grid.coefficients(quantities(twist)).map(Ratio::to_f32)
    }

    #[test]
    fn a_constant_is_exact() {
        let constant = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
        let grid = GridCompensation::from(&constant);
        assert!(grid.is_constant());
        for twist in [Twist::ZERO, Twist::new(0.5, -3.0, 0.2)] {
            assert_eq!(at(&grid, twist), [1.002, 1.033, 1.0195]);
        }
    }

    #[test]
    fn samples_keep_the_stated_bound() {
        let table = lateral();
        let mut grid = GridCompensation::from(&VelocityCompensation::NONE);
        grid.sample(&SpeedCompensation {
            longitudinal: constant(1.0),
            lateral: table,
            yaw: constant(1.0),
        });
        assert!(!grid.is_constant());
        let (low, high) = table.range();
        let step = 0.432_065 / 16.0;
        // Rows are 0.0865 apart; no two differ by more than the whole range. A few steps on top.
        let bound = 1.5 * (step / 0.0864_f32).powi(2) * (high - low) + 4e-7;
        let mut worst = 0.0_f32;
        for mm in 0..700_i16 {
            let speed = f32::from(mm) * 1e-3;
            let [_, found, _] = at(&grid, Twist::new(0.0, -speed, 0.0));
            worst = worst.max((found - table.coefficient(speed)).abs());
        }
        assert!(worst <= bound, "{worst} > {bound}");
        assert!(worst > 0.0, "the curve is not straight");
        // Beyond the last row it stays where it is.
        let [_, last, _] = at(&grid, Twist::new(0.0, 3.0, 0.0));
        assert!((last - 0.5 / 0.432_065).abs() < 1e-6);
    }

    /// Table 3 and 4 of the paper: 1.0022 ahead, 1.0326 aside, 1.0170 and 1.0175 at 45 degrees.
    #[test]
    fn direction_counts_as_in_the_table() {
        let tables = DirectionalCompensation::new(
            constant(1.0022),
            constant(1.0326),
            constant(1.0170),
            constant(1.0175),
            constant(1.0195),
        )
        .unwrap();
        let mut grid = GridCompensation::from(&VelocityCompensation::NONE);
        grid.sample_directions(&tables);
        assert!(!grid.is_constant());
        let [x, y, w] = at(&grid, Twist::new(0.2, -0.2, 0.1));
        assert!((x - 1.0170).abs() < 1e-6 && (y - 1.0175).abs() < 1e-6);
        assert!((w - 1.0195).abs() < 1e-6);
        for degrees in 0..360_i16 {
            let (sin, cos) = f32::from(degrees).to_radians().sin_cos();
            let twist = Twist::new(0.4 * cos, 0.4 * sin, 0.0);
            let want = tables.apply(twist);
            let [x, y, _] = at(&grid, twist);
            assert!((want.vx - twist.vx * x).abs() < 1e-6, "{degrees}");
            assert!((want.vy - twist.vy * y).abs() < 1e-6, "{degrees}");
        }
        assert_eq!(at(&grid, Twist::ZERO), [1.0022, 1.0326, 1.0195]);
    }
}
