//! The paper's measured velocities as data: what a robot really does when its wheels ask for a
//! velocity.
//!
//! Source: "Kinematic Modeling of a Combined System of Multiple Mecanum-Wheeled Robots with
//! Velocity Compensation", Tables 3 and 5 (virtual robot) and 7 and 8 (physical robot), and the
//! text beside Table 3 for 500 mm/s lateral, whose row is lost. The source's axes are x lateral, y
//! longitudinal; the tables here are named, not lettered. Turning follows the printed velocities:
//! Table 8's percentages do not agree with them.
//!
//! Between rows the ratio of measured to asked is interpolated linearly over the asked speed;
//! outside the rows the nearest row holds, which matters for the figure-eight: it is three times as
//! fast as the fastest row.

#![expect(
    clippy::approx_constant,
    reason = "the source prints 15, 30, 45 and 60 degrees like this"
)]

/// A row of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Asked speed in the table's unit.
    pub asked: f64,
    /// Measured over asked speed.
    pub ratio: f64,
}

/// Asked and measured speed, as printed.
const fn row(asked: f64, measured: f64) -> Row {
    Row {
        asked,
        ratio: measured / asked,
    }
}

/// One axis: rows in order of asked speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis(&'static [Row]);

impl Axis {
    /// Measured over asked speed at an asked speed (table's unit, either sign).
    #[must_use]
    pub fn ratio(&self, asked: f64) -> f64 {
        let asked = asked.abs();
        let above = self.0.partition_point(|row| row.asked <= asked);
        match (
            above.checked_sub(1).and_then(|below| self.0.get(below)),
            self.0.get(above),
        ) {
            (Some(low), Some(high)) => {
                let part = (asked - low.asked) / (high.asked - low.asked);
                low.ratio + part * (high.ratio - low.ratio)
            }
            (Some(end), None) | (None, Some(end)) => end.ratio,
            (None, None) => 1.0,
        }
    }

    /// The rows.
    #[must_use]
    pub fn rows(&self) -> &'static [Row] {
        self.0
    }
}

/// The losses of one kind of robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Losses {
    /// Along x, mm/s.
    pub longitudinal: Axis,
    /// Along y, mm/s.
    pub lateral: Axis,
    /// About z, rad/s.
    pub yaw: Axis,
}

/// Tables 3 and 5: the paper's virtual robot.
pub const VIRTUAL: Losses = Losses {
    longitudinal: Axis(&[
        row(100.0, 99.767),
        row(200.0, 199.564),
        row(300.0, 299.339),
        row(400.0, 399.151),
        row(500.0, 498.905),
    ]),
    lateral: Axis(&[
        row(100.0, 96.928),
        row(200.0, 193.684),
        row(300.0, 290.504),
        row(500.0, 483.2),
    ]),
    yaw: Axis(&[
        row(0.261799, 0.257),
        row(0.523599, 0.514),
        row(0.785398, 0.768),
    ]),
};

/// Tables 7 and 8: the paper's physical robot.
pub const PHYSICAL: Losses = Losses {
    longitudinal: Axis(&[
        row(100.0, 97.822),
        row(200.0, 196.287),
        row(300.0, 293.731),
        row(400.0, 390.558),
        row(500.0, 486.907),
    ]),
    lateral: Axis(&[
        row(100.0, 87.621),
        row(200.0, 174.193),
        row(300.0, 260.675),
        row(400.0, 345.426),
        row(500.0, 432.065),
    ]),
    yaw: Axis(&[row(0.523599, 0.511), row(1.047198, 1.020)]),
};

/// No losses.
pub const IDEAL: Losses = Losses {
    longitudinal: Axis(&[]),
    lateral: Axis(&[]),
    yaw: Axis(&[]),
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolates_the_ratio_and_holds_the_ends() {
        // Halfway between 0.96928 and 0.96842.
        assert!((VIRTUAL.lateral.ratio(150.0) - 0.96885).abs() < 1e-12);
        assert_eq!(VIRTUAL.lateral.ratio(0.0), 96.928 / 100.0);
        assert_eq!(VIRTUAL.lateral.ratio(-5000.0), 483.2 / 500.0);
        assert_eq!(IDEAL.yaw.ratio(1.0), 1.0);
    }

    #[test]
    fn rows_are_in_order() {
        for losses in [VIRTUAL, PHYSICAL] {
            for axis in [losses.longitudinal, losses.lateral, losses.yaw] {
                assert!(
                    axis.rows()
                        .windows(2)
                        .all(|pair| pair[0].asked < pair[1].asked)
                );
            }
        }
    }
}
