//! From the tables a robot is given to the compensation its control tick uses.
//!
//! It runs when parameters change, never in the tick, so it is built for size with the rest of this
//! crate.

use kinematics::{
    AxisTable, CompensationError, DirectionalCompensation, GridCompensation, SpeedCompensation,
    VelocityCompensation,
};
use protocol::compensation::{CompensationSet, ROWS, Row};

/// The compensation a set means; axes without rows have the constant.
///
/// # Errors
/// [`CompensationError`] for tables that cannot be inverted.
#[inline(never)]
pub(crate) fn compensation(
    set: &CompensationSet<'_>,
    constant: &VelocityCompensation,
) -> Result<GridCompensation, CompensationError> {
    if set.is_empty() {
        return Ok(GridCompensation::from(constant));
    }
    let longitudinal =
        AxisTable::<ROWS>::filled(set.longitudinal().map(Row::pair), constant.longitudinal())?;
    let lateral = AxisTable::<ROWS>::filled(set.lateral().map(Row::pair), constant.lateral())?;
    let yaw = AxisTable::<ROWS>::filled(set.yaw().map(Row::pair), constant.yaw())?;
    if set.oblique().next().is_none() {
        return Ok(GridCompensation::from(&SpeedCompensation {
            longitudinal,
            lateral,
            yaw,
        }));
    }
    let oblique_x = AxisTable::<ROWS>::filled(set.oblique().map(|row| row.along().pair()), 1.0)?;
    let oblique_y = AxisTable::<ROWS>::filled(set.oblique().map(|row| row.across().pair()), 1.0)?;
    let tables = DirectionalCompensation::new(longitudinal, lateral, oblique_x, oblique_y, yaw)?;
    Ok(GridCompensation::from(&tables))
}

#[cfg(test)]
mod tests {
    use super::*;
    use kinematics::{Compensation as _, Twist};
    use protocol::compensation::{LENGTH_MAX, ObliqueRow, Tables};

    fn made(
        tables: &Tables<'_>,
        constant: [f32; 3],
    ) -> Result<GridCompensation, CompensationError> {
        let mut bytes = [0; LENGTH_MAX];
        let length = tables.encode(&mut bytes).unwrap();
        let set = CompensationSet::decode(&bytes[..length]).unwrap();
        let [x, y, w] = constant;
        compensation(&set, &VelocityCompensation::new(x, y, w).unwrap())
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
            let found = compensation.apply(twist);
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
        let at = |vx, vy| compensation.coefficients(Twist::new(vx, vy, 0.0));
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
        let (a, b) = (from_table.apply(twist), constant.apply(twist));
        // Half a step of 1/32768 on either side.
        assert!((a.vx - b.vx).abs() < 0.4 / 32_768.0 && (a.vy - b.vy).abs() < 0.3 / 32_768.0);
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
