//! Compensation against the paper's Tables 3 to 9: what was measured is what the tables give back,
//! in both directions; coefficients are found again from measurements; bad data are refused with
//! the reason.

use mecanum_kinematics::estimate::{
    CalibrationError, EstimationError, Limits, Sample, fit, fit_constant, fit_table,
};
use mecanum_kinematics::paper;
use mecanum_kinematics::trajectory::{Circle, FigureEight, Trajectory};
use mecanum_kinematics::{
    AxisTable, CompensatedMember, Compensation, CompensationError, DirectionalCompensation,
    FourWheelGeometry, MemberKinematics, Mount, Odometry, Pose, SpeedCompensation, Twist,
    VelocityCompensation,
};

#[path = "compensation/curves.rs"]
mod curves;

/// Rows of a table in `tests/data`: (first column, the others as numbers, NaN where empty).
fn rows(text: &str) -> Vec<(String, Vec<f64>)> {
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .skip(1)
        .map(|line| {
            let mut cells = line.split(',');
            let first = cells.next().unwrap().to_string();
            (
                first,
                cells.map(|cell| cell.parse().unwrap_or(f64::NAN)).collect(),
            )
        })
        .collect()
}

/// (set, measured) in m/s of one axis of Table 3 or 7.
fn axis<const R: usize>(text: &str, axis: &str) -> [(f64, f64); R] {
    let found: Vec<_> = rows(text)
        .into_iter()
        .filter(|(name, _)| name == axis)
        .map(|(_, cells)| (cells[0] / 1000.0, cells[1] / 1000.0))
        .collect();
    found.try_into().unwrap()
}

const TABLE_3: &str = include_str!("data/table_03_simulated_translation.csv");
const TABLE_4: &str = include_str!("data/table_04_simulated_oblique.csv");
const TABLE_5: &str = include_str!("data/table_05_simulated_turning.csv");
const TABLE_7: &str = include_str!("data/table_07_physical_translation.csv");
const TABLE_8: &str = include_str!("data/table_08_physical_turning.csv");

fn turning<const R: usize>(text: &str) -> [(f64, f64); R] {
    let found: Vec<_> = rows(text)
        .into_iter()
        .map(|(set, cells)| (set.parse().unwrap(), cells[0]))
        .collect();
    found.try_into().unwrap()
}

fn table<const R: usize>(rows: &[(f64, f64); R]) -> AxisTable<R, f64> {
    AxisTable::from_measurements(rows).unwrap()
}

fn simulated() -> SpeedCompensation<5, 4, 3, f64> {
    SpeedCompensation {
        longitudinal: table(&axis(TABLE_3, "longitudinal")),
        lateral: table(&axis(TABLE_3, "lateral")),
        yaw: table(&turning(TABLE_5)),
    }
}

fn physical() -> SpeedCompensation<5, 5, 2, f64> {
    SpeedCompensation {
        longitudinal: table(&axis(TABLE_7, "longitudinal")),
        lateral: table(&axis(TABLE_7, "lateral")),
        yaw: table(&turning(TABLE_8)),
    }
}

fn same(got: Twist<f64>, want: Twist<f64>, tolerance: f64) {
    let off = (got.vx - want.vx).abs() + (got.vy - want.vy).abs() + (got.omega - want.omega).abs();
    assert!(off <= tolerance, "{got:?} is not {want:?}: {off:e}");
}

/// Every row of the table: to achieve what was measured, ask for what was set; and back.
fn gives_back<const R: usize>(
    c: &impl Compensation<f64>,
    rows: &[(f64, f64); R],
    along: Twist<f64>,
) {
    for (set, measured) in rows {
        for sign in [1.0, -1.0] {
            same(
                c.apply(along * (sign * measured)),
                along * (sign * set),
                1e-12,
            );
            same(
                c.remove(along * (sign * set)),
                along * (sign * measured),
                1e-12,
            );
        }
    }
}

const AHEAD: Twist<f64> = Twist::new(1.0, 0.0, 0.0);
const ASIDE: Twist<f64> = Twist::new(0.0, 1.0, 0.0);
const ABOUT: Twist<f64> = Twist::new(0.0, 0.0, 1.0);

#[test]
fn table_03_05_07_08_are_given_back() {
    let c = simulated();
    gives_back(&c, &axis::<5>(TABLE_3, "longitudinal"), AHEAD);
    gives_back(&c, &axis::<4>(TABLE_3, "lateral"), ASIDE);
    gives_back(&c, &turning::<3>(TABLE_5), ABOUT);
    let c = physical();
    gives_back(&c, &axis::<5>(TABLE_7, "longitudinal"), AHEAD);
    gives_back(&c, &axis::<5>(TABLE_7, "lateral"), ASIDE);
    gives_back(&c, &turning::<2>(TABLE_8), ABOUT);
}

#[test]
fn table_03_07_printed_coefficients() {
    // The coefficient column, to its printed digits: 5 in Table 3, where some are cut instead of
    // rounded, 3 in Table 7.
    for (text, digit) in [(TABLE_3, 1e-5), (TABLE_7, 6e-4)] {
        for (_, cells) in rows(text) {
            let (set, measured, printed) = (cells[0], cells[1], cells[3]);
            if printed.is_finite() {
                let got = AxisTable::from_measurements(&[(set, measured)])
                    .unwrap()
                    .coefficient(0.3);
                assert!((got - printed).abs() <= digit, "{got} is not {printed}");
            }
        }
    }
}

/// (set, measured) per axis (longitudinal, lateral) of Table 4; its x is lateral.
fn oblique() -> [[(f64, f64); 2]; 2] {
    let rows = rows(TABLE_4);
    let cell = |axis: &str, set: f64| {
        let row = rows
            .iter()
            .find(|(name, c)| name == axis && c[0] == set)
            .unwrap();
        row.1[1] / 1000.0
    };
    [200.0, 500.0].map(|set| {
        [
            (set / 1000.0, cell("y", set)),
            (set / 1000.0, cell("x", set)),
        ]
    })
}

fn directional() -> DirectionalCompensation<5, 4, 2, 3, f64> {
    let runs = oblique();
    let of = |axis: usize| {
        AxisTable::new(&runs.map(|run| {
            let speed = run[0].1.hypot(run[1].1);
            (speed, run[axis].0 / run[axis].1)
        }))
        .unwrap()
    };
    let c = simulated();
    DirectionalCompensation::new(c.longitudinal, c.lateral, of(0), of(1), c.yaw).unwrap()
}

#[test]
fn table_04_oblique() {
    let c = directional();
    for [(set_x, measured_x), (set_y, measured_y)] in oblique() {
        // All four quadrants: the table is for speeds.
        for (sx, sy) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let desired = Twist::new(sx * measured_x, sy * measured_y, 0.0);
            let asked = Twist::new(sx * set_x, sy * set_y, 0.0);
            // The two measured speeds differ by 0.04 %, so the direction is off 45 degrees by that
            // much, and the coefficients by that share of what they change by.
            same(c.apply(desired), asked, 1e-5);
            same(c.remove(c.apply(desired)), desired, 1e-12);
        }
    }
    // And the axial runs stay right.
    gives_back(&c, &axis::<5>(TABLE_3, "longitudinal"), AHEAD);
    gives_back(&c, &axis::<4>(TABLE_3, "lateral"), ASIDE);
}

#[test]
fn table_04_is_missed_by_a_diagonal_matrix() {
    // What the direction is for: the per-axis tables miss the oblique runs by more than one
    // percent.
    let c = simulated();
    for [(set_x, measured_x), (set_y, measured_y)] in oblique() {
        let got = c.remove(Twist::new(set_x, set_y, 0.0));
        assert!(got.vx / measured_x - 1.0 > 0.012, "{}", got.vx / measured_x);
        assert!(
            got.vy / measured_y - 1.0 < -0.010,
            "{}",
            got.vy / measured_y
        );
    }
}

#[test]
fn table_04_follows_from_the_mean_of_the_axial_coefficients() {
    // At 200 mm/s both oblique coefficients are the mean of the axial ones within 0.04 %: a robot
    // whose oblique motion was not measured can be given that.
    let c = simulated();
    for (set, measured) in oblique()[0] {
        let speed = 0.2782;
        let mean = (c.longitudinal.coefficient(speed) + c.lateral.coefficient(speed)) / 2.0;
        assert!((set / measured / mean - 1.0).abs() < 5e-4);
    }
}

#[test]
fn physical_oblique_run_is_given_back() {
    // Section 4: 353.6 per axis, 319.4 lateral and 330.7 longitudinal.
    let c = physical();
    let speed = 0.3194_f64.hypot(0.3307);
    let along = AxisTable::new(&[(speed, 0.3536 / 0.3307)]).unwrap();
    let across = AxisTable::new(&[(speed, 0.3536 / 0.3194)]).unwrap();
    let c = DirectionalCompensation::new(c.longitudinal, c.lateral, along, across, c.yaw).unwrap();
    let desired = Twist::new(0.3307, 0.3194, 0.0);
    // Here the direction is 1 degree off 45, the oblique coefficients apply at 45: 2 * 0.035 / 2 *
    // 5 % at most.
    same(
        c.apply(desired),
        Twist::new(0.3536, 0.3536, 0.0),
        2.0 * 0.3536 * 0.035 * 0.05,
    );
    same(c.remove(c.apply(desired)), desired, 1e-12);
}

#[test]
fn tables_never_leave_the_range_of_their_rows() {
    // Rising, a jump, flat, falling: a plain cubic spline would overshoot at every corner. And a
    // bend so sharp that the slope of either side alone would overshoot on the other.
    let corners = [
        (0.1, 1.02),
        (0.2, 1.02),
        (0.25, 1.06),
        (0.4, 1.061),
        (0.6, 1.0),
    ];
    let bends = [
        (0.1, 1.0),
        (0.3, 1.001),
        (0.32, 1.012),
        (0.34, 1.023),
        (0.6, 1.024),
    ];
    for rows in [corners, bends] {
        let table = AxisTable::new(&rows).unwrap();
        for pair in rows.windows(2) {
            let ((from, low), (to, high)) = (pair[0], pair[1]);
            let mut before = low;
            for i in 0..=1000 {
                let c = table.coefficient(from + (to - from) * f64::from(i) / 1000.0);
                assert!(
                    c >= low.min(high) - 1e-12 && c <= low.max(high) + 1e-12,
                    "{from}"
                );
                assert!(
                    (c - before) * (high - low) >= -1e-12,
                    "monotone from {from}"
                );
                before = c;
            }
        }
    }
    let table = AxisTable::new(&corners).unwrap();
    assert!((table.coefficient(0.0) - 1.02).abs() < 1e-12);
    assert!((table.coefficient(9.0) - 1.0).abs() < 1e-12);
    assert!((table.coefficient(-0.25) - 1.06).abs() < 1e-12);
}

#[test]
fn a_table_of_one_row_is_the_constant() {
    let one = |c| AxisTable::new(&[(0.3, c)]).unwrap();
    let table = SpeedCompensation {
        longitudinal: one(1.002),
        lateral: one(1.033),
        yaw: one(1.0195),
    };
    let constant = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let twist = Twist::new(0.4, -0.2, 0.3);
    same(
        Compensation::apply(&table, twist),
        constant.apply(twist),
        1e-15,
    );
    same(
        Compensation::remove(&table, twist),
        constant.remove(twist),
        1e-15,
    );
}

#[test]
fn bad_tables_are_refused() {
    let refuse = |rows: &[(f64, f64); 2]| AxisTable::new(rows).unwrap_err();
    assert_eq!(
        refuse(&[(0.2, 1.0), (0.2, 1.0)]),
        CompensationError::NotIncreasing(1)
    );
    assert_eq!(
        refuse(&[(0.0, 1.0), (0.2, 1.0)]),
        CompensationError::NotIncreasing(0)
    );
    assert_eq!(
        refuse(&[(f64::NAN, 1.0), (0.2, 1.0)]),
        CompensationError::NotIncreasing(0)
    );
    assert_eq!(
        refuse(&[(0.1, 0.0), (0.2, 1.0)]),
        CompensationError::NotPositive("coefficient")
    );
    assert_eq!(
        refuse(&[(0.1, 1.0), (0.2, f64::NAN)]),
        CompensationError::NotFinite("coefficient")
    );
    // Asks 0.20 for 0.1 and 0.15 for 0.15: not monotone.
    assert_eq!(
        refuse(&[(0.1, 2.0), (0.15, 1.0)]),
        CompensationError::TooSteep(1)
    );
    assert_eq!(
        AxisTable::<0, f64>::new(&[]).unwrap_err(),
        CompensationError::Empty
    );
    let one = |c: f64| AxisTable::new(&[(0.3, c)]).unwrap();
    assert_eq!(
        DirectionalCompensation::new(one(1.0), one(1.0), one(1.5), one(1.0), one(1.0)).unwrap_err(),
        CompensationError::TooOblique
    );
}

#[test]
fn asking_grows_with_wanting_and_comes_back() {
    let (speed, direction, physical) = (simulated(), directional(), physical());
    let mut before = 0.0;
    for i in 1..=2000 {
        let v = f64::from(i) * 1e-3;
        let asked = physical.apply(Twist::new(0.0, v, 0.0)).vy;
        assert!(asked > before);
        before = asked;
        for angle in 0..24 {
            let (sin, cos) = (15.0 * f64::from(angle)).to_radians().sin_cos();
            let twist = Twist::new(v * cos, v * sin, 0.3 * sin);
            same(speed.remove(speed.apply(twist)), twist, 1e-12);
            same(direction.remove(direction.apply(twist)), twist, 1e-12);
            same(physical.remove(physical.apply(twist)), twist, 1e-12);
        }
    }
    same(
        direction.apply(Twist::new(0.0, 0.0, 0.0)),
        Twist::new(0.0, 0.0, 0.0),
        0.0,
    );
}

#[test]
fn forward_uses_the_inverse_of_the_same_object() {
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.7).unwrap();
    let mount = Mount::new(Pose::new(0.4, -1.2, 0.5)).unwrap();
    let k = CompensatedMember::new(&robot, &mount, directional()).unwrap();
    let twist = Twist::new(0.3, -0.2, 0.4);
    same(k.forward(&k.inverse(twist)), twist, 1e-12);
    assert!(k.slip_residual(&k.inverse(twist)).abs() < 1e-12);
    // With a constant it is the folded matrix.
    let c = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let folded: [f64; 4] = MemberKinematics::new(&robot, &mount, &c)
        .unwrap()
        .inverse(twist)
        .into();
    let steps: [f64; 4] = CompensatedMember::new(&robot, &mount, c)
        .unwrap()
        .inverse(twist)
        .into();
    for (a, b) in folded.into_iter().zip(steps) {
        assert!((a - b).abs() < 1e-12);
    }
}

#[test]
fn estimation_finds_the_papers_coefficients() {
    // C1 and C3 of the paper: means of the printed columns. Least squares weighs the fast runs
    // more, so it comes out within the spread of the column.
    let of = |text, axis: &str| {
        let samples: Vec<_> = rows(text)
            .into_iter()
            .filter(|(name, _)| name == axis)
            .map(|(_, c)| Sample {
                commanded: c[0] / 1000.0,
                measured: c[1] / 1000.0,
            })
            .collect();
        fit(
            samples.into_iter(),
            &Limits {
                resolution: 5e-3,
                ..Limits::default()
            },
        )
        .unwrap()
    };
    let ahead = of(TABLE_3, "longitudinal");
    assert!((ahead.coefficient - 1.002).abs() < 3e-4 && ahead.rejected == 0 && ahead.used == 5);
    assert!((of(TABLE_3, "lateral").coefficient - 1.033).abs() < 1.5e-3);
    assert!((of(TABLE_7, "lateral").coefficient - 1.151).abs() < 6e-3);
    let (low, high) = ahead.interval;
    assert!(low < ahead.coefficient && ahead.coefficient < high && high - low < 1e-3);
}

/// A reproducible noise of about unit deviation.
fn noise(i: u32) -> f64 {
    let h = |k: u32| {
        let mut x = i
            .wrapping_mul(0x9e37_79b9)
            .wrapping_add(k.wrapping_mul(0x85eb_ca6b));
        x ^= x >> 16;
        x = x.wrapping_mul(0x7feb_352d);
        x ^= x >> 15;
        x = x.wrapping_mul(0x846c_a68b);
        f64::from(x ^ (x >> 16)) / 4_294_967_296.0
    };
    (0..12).map(h).sum::<f64>() - 6.0
}

#[test]
fn confidence_intervals_hold_in_95_of_100_cases() {
    let mut held = 0;
    let trials = 1000;
    for round in 0..trials {
        let samples = (0..12).map(|i| Sample {
            commanded: 0.1 + 0.05 * f64::from(i % 6),
            measured: (0.1 + 0.05 * f64::from(i % 6)) / 1.04 + 0.002 * noise(round * 100 + i),
        });
        // No outliers here: rejection off, for it would narrow the interval.
        let limits = Limits {
            outlier_deviations: 1e9,
            ..Limits::default()
        };
        let (low, high) = fit(samples, &limits).unwrap().interval;
        held += u32::from(low <= 1.04 && 1.04 <= high);
    }
    // 950 expected; the standard deviation of the count is 7.
    assert!((925..=975).contains(&held), "{held} of {trials}");
}

#[test]
fn outliers_are_left_out_and_counted() {
    let samples = (0..20).map(|i| {
        let commanded = 0.2 + 0.01 * f64::from(i);
        // 2 % off, 4 to 6 mm/s: forty standard deviations.
        let slip = if i == 3 || i == 11 { 0.98 } else { 1.0 };
        Sample {
            commanded,
            measured: slip * commanded / 1.05 + 1e-4 * noise(i),
        }
    });
    let fit = fit(samples, &Limits::default()).unwrap();
    assert_eq!((fit.used, fit.rejected), (18, 2));
    assert!((fit.coefficient - 1.05).abs() < 5e-4);
}

#[test]
fn data_that_determine_nothing_are_refused() {
    let of = |pairs: &[(f64, f64)]| {
        let samples = pairs.iter().map(|&(commanded, measured)| Sample {
            commanded,
            measured,
        });
        fit(samples, &Limits::default()).unwrap_err()
    };
    assert_eq!(of(&[]), EstimationError::TooFewSamples(0));
    assert_eq!(of(&[(0.0, 0.0); 9]), EstimationError::TooFewSamples(0));
    assert_eq!(
        of(&[(0.3, 0.29), (0.3, 0.29)]),
        EstimationError::TooFewSamples(2)
    );
    assert_eq!(
        of(&[(0.3, 0.29), (0.3, f64::NAN)]),
        EstimationError::NotFinite(1)
    );
    assert_eq!(of(&[(0.3, 0.0); 5]), EstimationError::NotFollowing);
    assert_eq!(of(&[(0.3, -0.29); 5]), EstimationError::NotFollowing);
    let scattered = [
        (0.3, 0.30),
        (0.3, 0.25),
        (0.3, 0.28),
        (0.3, 0.33),
        (0.3, 0.27),
    ];
    assert!(matches!(of(&scattered), EstimationError::TooUncertain(share) if share > 0.05));
}

#[test]
fn whole_calibration_names_the_axis_it_cannot_determine() {
    let truth = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let run = |commanded: Twist<f64>| (commanded, truth.remove(commanded));
    let mut samples = Vec::new();
    for i in 1..=4 {
        let v = 0.1 * f64::from(i);
        samples.push(run(Twist::new(v, 0.0, 0.0)));
        samples.push(run(Twist::new(0.0, -v, 0.0)));
    }
    assert_eq!(
        fit_constant(&samples, &Limits::default()).unwrap_err(),
        CalibrationError::Axis("yaw", EstimationError::TooFewSamples(0))
    );
    for i in 1..=4 {
        samples.push(run(Twist::new(0.0, 0.0, 0.2 * f64::from(i))));
    }
    let (found, fits) = fit_constant(&samples, &Limits::default()).unwrap();
    assert!((found.lateral() - 1.033).abs() < 1e-9 && (found.yaw() - 1.0195).abs() < 1e-9);
    assert!(fits.iter().all(|fit| fit.used == 4 && fit.rejected == 0));
}

#[test]
fn table_07_is_found_from_repeated_runs() {
    let rows = axis::<5>(TABLE_7, "lateral");
    let samples: Vec<_> = (0..50)
        .map(|i| {
            let (commanded, measured) = rows[i as usize % 5];
            Sample {
                commanded,
                measured: measured + 2e-4 * noise(i),
            }
        })
        .collect();
    let speeds = rows.map(|(set, _)| set);
    let (table, fits) = fit_table(&samples, &speeds, &Limits::default()).unwrap();
    for ((set, measured), fit) in rows.into_iter().zip(fits) {
        assert!((fit.coefficient - set / measured).abs() < 3e-3);
        assert!((table.coefficient(measured) - set / measured).abs() < 3e-3);
    }
}
