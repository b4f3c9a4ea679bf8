//! (16) and (17): what an error of the roller angle does.

use super::*;

/// d(wheel i's angle)/d(gamma): gamma_1 = gamma_3 = -gamma, gamma_2 = gamma_4 = gamma.
const HANDS: [f64; 4] = [-1.0, 1.0, -1.0, 1.0];

#[test]
fn eq_16_roller_angle_sensitivity() {
    for deg in ANGLES_DEG {
        let robot = virtual_robot(deg);
        let (h, r) = (robot.half_wheelbase(), robot.wheel_radius());
        let csc2 = 1.0 / robot.roller_angle().sin().powi(2);
        // As printed.
        let want = [
            [1.0, 0.0, -h],
            [-1.0, 0.0, h],
            [1.0, 0.0, h],
            [-1.0, 0.0, -h],
        ]
        .map(|row| row.map(|entry| -entry * csc2 / r));
        for ((p, want), hand) in paper_wheels(&robot).into_iter().zip(want).zip(HANDS) {
            let [x, y, w] = wheel_of(p).roller_angle_sensitivity();
            for twist in TWISTS {
                let t = paper::to_twist(twist);
                let got = -(x * t.vx + y * t.vy + w * t.omega) * hand;
                close(got, paper::times(want, twist), "sensitivity");
            }
        }
    }
}

#[test]
fn eq_16_agrees_with_finite_differences_for_any_wheel() {
    let step = 1e-5;
    for p in odd_wheels() {
        let at = |gamma: f64| wheel_of(PaperWheel { gamma, ..p }).jacobian_row();
        let (low, high) = (at(p.gamma - step), at(p.gamma + step));
        for ((got, low), high) in wheel_of(p)
            .roller_angle_sensitivity()
            .into_iter()
            .zip(low)
            .zip(high)
        {
            let want = (high - low) / (2.0 * step);
            // The difference quotient errs by step^2 times the third derivative: up to 300 here.
            assert!(
                (got - want).abs() < 1e-7 * (1.0 + want.abs()),
                "{got} {want}"
            );
        }
    }
}

#[test]
fn eq_17_roller_angle_error() {
    // At 45 degrees, as printed: -(dg/r) [[2, 0, -2H], [-2, 0, 2H], [2, 0, 2H], [-2, 0, -2H]].
    let robot = virtual_robot(45.0);
    let (h, r) = (robot.half_wheelbase(), robot.wheel_radius());
    let dg = 0.01;
    let printed = [
        [2.0, 0.0, -2.0 * h],
        [-2.0, 0.0, 2.0 * h],
        [2.0, 0.0, 2.0 * h],
        [-2.0, 0.0, -2.0 * h],
    ];
    let wheels = robot.wheels().unwrap();
    // Ours are front left, front right, rear left, rear right; gamma grows by dg on all of them.
    let deviations = [dg, -dg, -dg, dg];
    for twist in TWISTS {
        let want = printed.map(|row| -dg / r * paper::times(row, twist));
        let got = roller_angle_correction(&wheels, &deviations, paper::to_twist(twist));
        close_all(paper::from_rates(WheelRates::from(got)), want, "correction");
        // Longitudinal motion needs none.
        let ahead = roller_angle_correction(&wheels, &deviations, Twist::new(0.5, 0.0, 0.0));
        close_all(ahead, [0.0; 4], "ahead");
    }
    // The exact answer is a robot built with the measured angles; the correction misses it by
    // second order only.
    let measured = virtual_robot(45.0 + dg.to_degrees());
    let exact = Platform::new(&measured.wheels().unwrap()).unwrap();
    let nominal = Platform::new(&wheels).unwrap();
    let twist = Twist::new(0.2, 0.5, 0.4);
    let correction = roller_angle_correction(&wheels, &deviations, twist);
    for ((exact, nominal), correction) in exact
        .rates(twist)
        .into_iter()
        .zip(nominal.rates(twist))
        .zip(correction)
    {
        // d2(cot)/dg2 / 2 = cot csc2 = 2: 2 dg^2 (|vy| + H |omega|) / r.
        assert!((nominal + correction - exact).abs() < 2.1 * dg * dg * 0.64 / r);
        assert!((nominal - exact).abs() > 0.0);
    }
}
