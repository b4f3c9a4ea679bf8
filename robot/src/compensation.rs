//! From the tables a robot is given to the compensation its control tick uses.
//!
//! It runs when parameters change, never in the tick, so it is built for size with the rest of this
//! crate.

use control::compensation::GridCompensation;
use kinematics::{
    AxisTable, CompensationError, DirectionalCompensation, SpeedCompensation, VelocityCompensation,
};
use protocol::compensation::{CompensationSet, ROWS, Row};

/// Puts the tables of a set into a compensation; axes without rows have the constant.
///
/// # Errors
/// [`CompensationError`] for tables that cannot be inverted.
#[inline(never)]
pub(crate) fn tabulate(
    compensation: &mut GridCompensation,
    set: &CompensationSet<'_>,
    constant: &VelocityCompensation,
) -> Result<(), CompensationError> {
    if set.is_empty() {
        return Ok(());
    }
    let longitudinal =
        AxisTable::<ROWS>::filled(set.longitudinal().map(Row::pair), constant.longitudinal())?;
    let lateral = AxisTable::<ROWS>::filled(set.lateral().map(Row::pair), constant.lateral())?;
    let yaw = AxisTable::<ROWS>::filled(set.yaw().map(Row::pair), constant.yaw())?;
    if set.oblique().next().is_none() {
        compensation.sample(&SpeedCompensation {
            longitudinal,
            lateral,
            yaw,
        });
        return Ok(());
    }
    let oblique_x = AxisTable::<ROWS>::filled(set.oblique().map(|row| row.along().pair()), 1.0)?;
    let oblique_y = AxisTable::<ROWS>::filled(set.oblique().map(|row| row.across().pair()), 1.0)?;
    let tables = DirectionalCompensation::new(longitudinal, lateral, oblique_x, oblique_y, yaw)?;
    compensation.sample_directions(&tables);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::quantity::Ratio;
    use control::twist::quantities;
    use kinematics::{Compensation as _, Twist};
    use protocol::compensation::{LENGTH_MAX, ObliqueRow, Tables};
    use std::vec::Vec;

    fn made(
        tables: &Tables<'_>,
        constant: [f32; 3],
    ) -> Result<GridCompensation, CompensationError> {
        let mut bytes = [0; LENGTH_MAX];
        let length = tables.encode(&mut bytes).unwrap();
        let set = CompensationSet::decode(&bytes[..length]).unwrap();
        let [x, y, w] = constant;
        let constant = VelocityCompensation::new(x, y, w).unwrap();
        let mut compensation = GridCompensation::from(&constant);
        tabulate(&mut compensation, &set, &constant).map(|()| compensation)
    }

    fn coefficients(of: &GridCompensation, twist: Twist) -> [f32; 3] {
        of.coefficients(quantities(twist)).map(Ratio::to_f32)
    }

    #[test]
    fn a_set_means_what_its_tables_mean() {
        let set = Tables {
            version: 1,
            longitudinal: &[Row::new(0.1, 1.022), Row::new(0.5, 1.027)],
            lateral: &[
                Row::new(0.1, 1.141),
                Row::new(0.3, 1.151),
                Row::new(0.5, 1.157),
            ],
            oblique: &[],
            yaw: &[],
        };
        let compensation = made(&set, [1.5, 1.5, 1.0195]).unwrap();
        let tables = SpeedCompensation {
            longitudinal: AxisTable::new(&[(0.1, 1.022), (0.5, 1.027)]).unwrap(),
            lateral: AxisTable::new(&[(0.1, 1.141), (0.3, 1.151), (0.5, 1.157)]).unwrap(),
            // No rows: the constant.
            yaw: AxisTable::new(&[(1.0, 1.0195)]).unwrap(),
        };
        for twist in [
            Twist::new(0.3, 0.0, 0.0),
            Twist::new(0.1, -0.25, 0.2),
            Twist::new(2.0, 0.5, -0.5),
            Twist::ZERO,
        ] {
            let want = tables.apply(twist);
            let [x, y, w] = coefficients(&compensation, twist);
            let found = Twist::new(twist.vx * x, twist.vy * y, twist.omega * w);
            // Coefficients in steps of 1/32768, and 1e-4 for the samples.
            let bound = |of: f32| of.abs() * 1.5e-4 + 1e-7;
            assert!((want.vx - found.vx).abs() <= bound(want.vx), "{twist:?}");
            assert!((want.vy - found.vy).abs() <= bound(want.vy), "{twist:?}");
            assert!((want.omega - found.omega).abs() <= bound(want.omega));
        }
    }

    #[test]
    fn oblique_rows_make_the_direction_count() {
        let tables = Tables {
            oblique: &[ObliqueRow {
                speed: 0.3,
                longitudinal: 1.017,
                lateral: 1.0175,
            }],
            ..Tables::default()
        };
        let compensation = made(&tables, [1.0022, 1.0326, 1.0195]).unwrap();
        let at = |vx, vy| coefficients(&compensation, Twist::new(vx, vy, 0.0));
        // Half a step of 1/32768.
        let near = |found: f32, want: f32| (found - want).abs() <= 0.6 / 32_768.0;
        assert!(near(at(0.2, 0.2)[0], 1.017) && near(at(0.2, -0.2)[1], 1.0175));
        assert!(near(at(0.2, 0.0)[0], 1.0022) && near(at(0.0, 0.2)[1], 1.0326));
    }

    #[test]
    fn one_row_is_the_constant_case() {
        let one = Tables {
            longitudinal: &[Row::new(0.3, 1.002)],
            lateral: &[Row::new(0.3, 1.033)],
            yaw: &[Row::new(0.3, 1.0195)],
            ..Tables::default()
        };
        let from_table = made(&one, [1.0; 3]).unwrap();
        let constant = made(&Tables::default(), [1.002, 1.033, 1.0195]).unwrap();
        assert!(from_table.is_constant() && constant.is_constant());
        let twist = Twist::new(0.4, -0.3, 0.2);
        let [x, y, _] = coefficients(&from_table, twist);
        let [a, b, _] = coefficients(&constant, twist);
        // Half a step of 1/32768 on either side.
        assert!((x - a).abs() < 1.0 / 32_768.0 && (y - b).abs() < 1.0 / 32_768.0);
    }

    /// Numerical Recipes' generator, from 0 to 1.
    struct Random(u32);

    impl Random {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / 16_777_216.0
        }

        /// Rows up to a speed, with coefficients around this one.
        fn rows(&mut self, middle: f32, most: f32) -> Vec<Row> {
            let count = 1 + (8.0 * self.next()) as usize;
            let last = 1e-3 * 6_553.0_f32.powf(self.next());
            let spread = most * self.next() * self.next();
            let row = |i| {
                let coefficient = middle * (1.0 + spread * (self.next() - 0.5));
                Row::new(
                    last * (i as f32 + 0.3 + 0.7 * self.next()) / count as f32,
                    coefficient.clamp(0.5, 1.999),
                )
            };
            (0..count).map(row).collect()
        }
    }

    /// The same tables in double precision, sampled as the tick samples them.
    struct Wide {
        /// Longitudinal, lateral, yaw; the two at 45 degrees.
        axes: [AxisTable<ROWS, f64>; 3],
        oblique: Option<[AxisTable<ROWS, f64>; 2]>,
    }

    fn wide(row: Row) -> (f64, f64) {
        (row.speed.into(), row.coefficient.into())
    }

    impl Wide {
        fn of(set: &CompensationSet<'_>) -> Self {
            let table = |rows: &mut dyn Iterator<Item = Row>| {
                AxisTable::filled(rows.map(wide), 1.0).unwrap()
            };
            let [along, across] = [
                table(&mut set.oblique().map(ObliqueRow::along)),
                table(&mut set.oblique().map(ObliqueRow::across)),
            ];
            Self {
                axes: [
                    table(&mut set.longitudinal()),
                    table(&mut set.lateral()),
                    table(&mut set.yaw()),
                ],
                oblique: set.oblique().next().is_some().then_some([along, across]),
            }
        }

        /// A coefficient of an axis at a speed, and how far off it may be: what the speed is off by
        /// changes it along the steepest step around.
        fn one(table: &AxisTable<ROWS, f64>, speed: f64) -> (f64, f64) {
            let step = table.last_speed() / 16.0;
            let sample = |i: f64| table.coefficient(step * i.clamp(0.0, 16.0));
            let place = (speed.abs() / step).min(16.0);
            let low = place.floor();
            let rise = |i: f64| (sample(i + 1.0) - sample(i)).abs() / step;
            let steepest = rise(low - 1.0).max(rise(low)).max(rise(low + 1.0));
            let value = sample(low) + (sample(low + 1.0) - sample(low)) * (place - low);
            (value, 1e-6 + steepest * (STEP + 3e-7 * speed.abs()))
        }

        /// The coefficients of a motion, and how far off each may be.
        fn coefficients(&self, [x, y, w]: [f64; 3]) -> [(f64, f64); 3] {
            let [along, across, about] = &self.axes;
            let yaw = Self::one(about, w);
            let Some(oblique) = &self.oblique else {
                return [Self::one(along, x), Self::one(across, y), yaw];
            };
            let speed = x.hypot(y);
            let twice = |part: f64| 2.0 * (part / speed).powi(2);
            // The direction is off by a step of either axis.
            let turned = 4e-7 + 4.0 * STEP / speed;
            let both = |axial, oblique, share| {
                let ((a, off_a), (b, off_b)) = (Self::one(axial, speed), Self::one(oblique, speed));
                let off = off_a + 2.0 * (off_a + off_b) + (b - a).abs() * turned;
                (a + (b - a) * share, off)
            };
            let [x_at_45, y_at_45] = oblique;
            [
                both(along, x_at_45, twice(y)),
                both(across, y_at_45, twice(x)),
                yaw,
            ]
        }
    }

    /// What a speed may be off by, m/s or rad/s: a step of the tick's rates, and of their size.
    const STEP: f64 = if cfg!(feature = "fixed-point") {
        1.0 / 8_388_608.0
    } else {
        0.0
    };

    /// Sets over all that a robot accepts, at speeds from a crawl to beyond every table:
    /// coefficients and their inverses against double precision.
    #[test]
    fn coefficients_are_off_by_their_steps() {
        let mut random = Random(23);
        let (mut accepted, mut oblique, mut extreme) = (0, 0, [1.0_f64; 2]);
        for _ in 0..10_000 {
            let middle = 0.5 + 1.5 * random.next();
            let is_oblique = random.next() < 0.5;
            // Steeper tables cannot be inverted.
            let most = if is_oblique { 0.15 } else { 0.5 };
            let rows = [0, 1, 2].map(|_| random.rows(middle, most));
            let at_45 = match is_oblique {
                true => random.rows(middle, most),
                false => Vec::new(),
            };
            let at_45 = at_45.iter().map(|row| ObliqueRow {
                speed: row.speed,
                longitudinal: row.coefficient,
                lateral: (row.coefficient * (0.95 + 0.1 * random.next())).clamp(0.5, 1.999),
            });
            let at_45: Vec<ObliqueRow> = at_45.collect();
            let [longitudinal, lateral, yaw] = &rows;
            let tables = Tables {
                version: 1,
                longitudinal,
                lateral,
                oblique: &at_45,
                yaw,
            };
            let mut bytes = [0; LENGTH_MAX];
            let Ok(length) = tables.encode(&mut bytes) else {
                continue;
            };
            let set = CompensationSet::decode(&bytes[..length]).unwrap();
            let mut found = GridCompensation::from(&VelocityCompensation::NONE);
            if tabulate(&mut found, &set, &VelocityCompensation::NONE).is_err() {
                continue;
            }
            accepted += 1;
            oblique += usize::from(!at_45.is_empty());
            let exact = Wide::of(&set);
            for _ in 0..20 {
                let size = 1e-4 * 10_f32.powf(5.0 * random.next());
                let [x, y, w] = [0, 1, 2].map(|_| size * (2.0 * random.next() - 1.0));
                let coefficients = found.coefficients(quantities(Twist::new(x, y, w)));
                let wanted = exact.coefficients([x, y, w].map(f64::from));
                for (found, (wanted, bound)) in coefficients.into_iter().zip(wanted) {
                    let off = (f64::from(found.to_f32()) - wanted).abs();
                    assert!(off <= bound, "{off:e} of {bound:e}: {tables:?} {x} {y} {w}");
                    let inverse = f64::from(found.inverse().to_f32()) * wanted - 1.0;
                    assert!(inverse.abs() <= 3.0 * bound, "{inverse:e} of {bound:e}");
                    extreme = [extreme[0].min(wanted), extreme[1].max(wanted)];
                }
            }
        }
        assert!(accepted > 2_000 && oblique > 500, "{accepted} {oblique}");
        // A coefficient leads on from the axial through the oblique one to as far behind it.
        assert!(extreme[0] < 0.501 && extreme[1] > 1.99, "{extreme:?}");
    }

    #[test]
    fn tables_that_cannot_be_inverted_are_refused() {
        let tables = Tables {
            lateral: &[Row::new(0.3, 0.6), Row::new(0.31, 1.9)],
            ..Tables::default()
        };
        assert_eq!(made(&tables, [1.0; 3]), Err(CompensationError::TooSteep(1)));
    }
}
