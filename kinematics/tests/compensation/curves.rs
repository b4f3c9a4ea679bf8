//! The curves of Tables 6 and 9, from the losses of the other tables.

use super::*;

const TABLE_6: &str = include_str!("../data/table_06_simulated_curves.csv");
const TABLE_9: &str = include_str!("../data/table_09_physical_curves.csv");

#[test]
fn table_06_09_relative_errors_are_the_mean_of_both_sides() {
    // Printed to 0.01 points (0.001 in the last row of Table 9). Table 9's harmonic row has "dmax -
    // nominal" digits of its own, its RED follows all the same.
    for (_, text) in rows(TABLE_6).into_iter().zip(TABLE_6.lines().skip(2)) {
        let cells: Vec<&str> = text.split(',').collect();
        let [most, least, printed] = [2, 3, 4].map(|i| cells[i].parse::<f64>().unwrap());
        let got = paper::relative_displacement_error(most, least, 2500.0) * 100.0;
        assert!((got - printed).abs() < 0.006, "{got} is not {printed}");
    }
    for text in TABLE_9.lines().skip(2) {
        let cells: Vec<&str> = text.split(',').collect();
        for (most, least, printed) in [(2, 3, 6), (4, 5, 7)] {
            let [most, least, printed] =
                [most, least, printed].map(|i| cells[i].parse::<f64>().unwrap());
            let got = paper::relative_displacement_error(most, least, 1000.0) * 100.0;
            assert!((got - printed).abs() < 0.006, "{got} is not {printed}");
        }
    }
}

/// Displacement errors in percent (paper's x, y) of a robot with these losses whose wheels are
/// driven by `asked`.
fn displacement(
    curve: &impl Trajectory<f64>,
    robot: &impl Compensation<f64>,
    driver: &impl Compensation<f64>,
    nominal: f64,
) -> (f64, f64) {
    let (start, _) = curve.at(0.0);
    let mut odometry = Odometry::at(start);
    let (mut x, mut y) = ((0.0_f64, 0.0_f64), (0.0_f64, 0.0_f64));
    let steps = 20_000;
    let dt = curve.duration() / f64::from(steps);
    for i in 0..steps {
        let (_, twist) = curve.at((f64::from(i) + 0.5) * dt);
        odometry.update(robot.remove(driver.apply(twist)), dt);
        let (px, py) = paper::from_position(odometry.pose());
        x = (x.0.max(px), x.1.min(px));
        y = (y.0.max(py), y.1.min(py));
    }
    let error = |(most, least)| paper::relative_displacement_error(most, least, nominal) * 100.0;
    (error(x), error(y))
}

/// How far Tables 3 and 6 of the paper agree with each other, in points of percent.
const TABLES_AGREE: f64 = 0.5;

#[test]
fn table_06_follows_from_table_03() {
    // Uncompensated, printed: circle -3.48 and -0.14, figure-eight -2.92 and -0.28 %.
    let none = VelocityCompensation::new(1.0, 1.0, 1.0).unwrap();
    let near = |(x, y): (f64, f64), want: (f64, f64)| {
        assert!(
            (x - want.0).abs() < TABLES_AGREE && (y - want.1).abs() < TABLES_AGREE,
            "{x} {y}"
        );
    };
    near(
        displacement(&Circle::paper(), &simulated(), &none, 2.5),
        (-3.48, -0.14),
    );
    near(
        displacement(&FigureEight::paper(), &simulated(), &none, 2.5),
        (-2.92, -0.28),
    );
    // The constant C1 (with 1 where the paper prints 0) takes all but 0.2 points out; the table
    // takes it all.
    let c1 = VelocityCompensation::new(1.002, 1.033, 1.0).unwrap();
    let (x, y) = displacement(&FigureEight::paper(), &simulated(), &c1, 2.5);
    assert!(x.abs() < 0.2 && y.abs() < 0.05, "{x} {y}");
    let (x, y) = displacement(&FigureEight::paper(), &simulated(), &simulated(), 2.5);
    // What is left is how finely the extremes are sampled.
    assert!(x.abs() < 1e-5 && y.abs() < 1e-5, "{x} {y}");
}

#[test]
fn table_06_and_table_04_contradict_each_other() {
    // Were steady oblique losses (Table 4) also those of a curve, which is oblique most of the
    // time, the circle and the figure-eight would lose more than a percent ahead. Table 6 has 0.14
    // and 0.28. So the directional form is for robots whose own curves show it, and the constant
    // stays the default.
    let none = VelocityCompensation::new(1.0, 1.0, 1.0).unwrap();
    for (_, y) in [
        displacement(&Circle::paper(), &directional(), &none, 2.5),
        displacement(&FigureEight::paper(), &directional(), &none, 2.5),
    ] {
        assert!(y < -1.0, "{y}");
    }
}

#[test]
fn table_09_improves_with_c3() {
    // Measured with C3 = (1.145, 1.04): lateral -15.2 and -13.9 % become -2.0. The per-axis Table 7
    // under C3 says the same within two points, ahead and sideways.
    let none = VelocityCompensation::new(1.0, 1.0, 1.0).unwrap();
    let c3 = VelocityCompensation::new(1.04, 1.145, 1.0).unwrap();
    let eight = FigureEight {
        amplitude: 1.0,
        frequency: std::f64::consts::PI / 10.0,
    };
    let (before_x, before_y) = displacement(&eight, &physical(), &none, 1.0);
    let (after_x, after_y) = displacement(&eight, &physical(), &c3, 1.0);
    assert!(
        (before_x + 13.91).abs() < 2.0 && (after_x + 1.95).abs() < 2.0,
        "{before_x} {after_x}"
    );
    assert!(
        (before_y + 1.17).abs() < 2.0 && (after_y + 0.04).abs() < 2.0,
        "{before_y} {after_y}"
    );
}
