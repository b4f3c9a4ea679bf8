//! Groups, slip and rollers: members of different make measured together, the wheel that slips
//! found, the ripple of eight rollers as the paper measured it.

use mecanum_kinematics::{
    Formation, FourWheelGeometry, GeometryError, Group, Member, Mount, Platform, Pose, Rollers,
    Suspect, Twist, VelocityCompensation, Wheel, WheelKinematics, desaturate, group_scale,
};
use std::f64::consts::{FRAC_PI_6, PI};

fn four(roller_deg: f64) -> Platform<4, f64> {
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, roller_deg.to_radians()).unwrap();
    Platform::new(&robot.wheels().unwrap()).unwrap()
}

/// A long carrier with three wheels on each side.
fn six() -> Platform<6, f64> {
    let places = [
        (0.9, 0.5, 1.0),
        (0.9, -0.5, -1.0),
        (0.0, 0.5, -1.0),
        (0.0, -0.5, 1.0),
        (-0.9, 0.5, -1.0),
        (-0.9, -0.5, 1.0),
    ];
    Platform::new(&places.map(|(x, y, s)| Wheel::new(x, y, 0.0, s * 0.7, 0.1).unwrap())).unwrap()
}

fn c(x: f64, y: f64, w: f64) -> VelocityCompensation<f64> {
    VelocityCompensation::new(x, y, w).unwrap()
}

fn at(x: f64, y: f64, heading: f64) -> Mount<f64> {
    Mount::new(Pose::new(x, y, heading)).unwrap()
}

fn close(got: Twist<f64>, want: Twist<f64>, tolerance: f64) {
    let off = (got - want).vx.abs() + (got - want).vy.abs() + (got - want).omega.abs();
    assert!(off <= tolerance, "{got:?} is not {want:?}");
}

#[test]
fn group_forward_is_least_squares_over_all_wheels() {
    let (c1, c2) = (c(1.002, 1.033, 1.0195), c(1.02, 1.15, 1.02));
    let (m1, m2) = (at(1.0, 0.2, 0.3), at(-0.8, -0.4, -FRAC_PI_6));
    let (p1, p2) = (four(45.0), six());
    let (k1, k2) = (
        WheelKinematics::new(&p1, &m1, &c1),
        WheelKinematics::new(&p2, &m2, &c2),
    );
    let group = Group::new(&[Member::new(&p1, &m1, &c1), Member::new(&p2, &m2, &c2)]).unwrap();

    // Consistent rates: all members agree, for any weights.
    let twist = Twist::new(0.3, -0.2, 0.25);
    let measured = [
        k1.forward(&k1.inverse(twist)),
        k2.forward(&k2.inverse(twist)),
    ];
    close(group.forward(&measured), twist, 1e-12);
    assert!(group.disagreement(&measured).speed < 1e-12);

    // Disturbed rates: the optimum of the sum of squares over all ten wheels. At it, moving the
    // twist along any axis changes that sum only to second order.
    let mut r1 = k1.inverse(twist);
    let mut r2 = k2.inverse(twist);
    r1[2] += 0.3;
    r2[4] -= 0.5;
    let best = group.forward(&[k1.forward(&r1), k2.forward(&r2)]);
    let cost = |t: Twist<f64>| {
        let squares =
            |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        squares(&k1.inverse(t), &r1) + squares(&k2.inverse(t), &r2)
    };
    let h = 1e-4;
    for axis in [
        Twist::new(h, 0.0, 0.0),
        Twist::new(0.0, h, 0.0),
        Twist::new(0.0, 0.0, h),
    ] {
        let slope = (cost(best + axis) - cost(best - axis)) / (2.0 * h);
        assert!(slope.abs() < 1e-9, "slope {slope:e}");
        assert!(cost(best + axis) > cost(best));
    }
}

#[test]
fn strain_is_how_fast_members_part() {
    let none = c(1.0, 1.0, 1.0);
    let Formation { mounts, .. } = Formation::<2, f64>::tcc_2(2.0).unwrap();
    let platform = four(45.0);
    let group = Group::new(&mounts.map(|m| Member::new(&platform, &m, &none))).unwrap();
    // The front robot measures 0.50, the rear one 0.48 m/s: 20 mm/s apart, 10 each against the
    // mean.
    let measured = [Twist::new(0.50, 0.0, 0.0), Twist::new(0.48, 0.0, 0.0)];
    close(group.forward(&measured), Twist::new(0.49, 0.0, 0.0), 1e-12);
    let [front, rear] = group.deviations(&measured);
    close(front, Twist::new(0.01, 0.0, 0.0), 1e-12);
    close(rear, Twist::new(-0.01, 0.0, 0.0), 1e-12);
    assert!((group.strain_rate(0, 1, &measured).unwrap() - 0.02).abs() < 1e-12);
    assert!((group.disagreement(&measured).speed - 0.01).abs() < 1e-12);
    assert_eq!(group.strain_rate(0, 2, &measured), None);
    assert_eq!(group.strain_rate(1, 1, &measured), None);
}

#[test]
fn the_slowest_wheel_of_the_group_slows_all_alike() {
    let none = c(1.0, 1.0, 1.0);
    let Formation { mounts, .. } = Formation::<3, f64>::tcc_3(1.2).unwrap();
    let members = mounts.map(|m| WheelKinematics::new(&four(45.0), &m, &none));
    let twist = Twist::new(0.5, 0.0, 1.0);
    let limits = [20.0, 20.0, 6.0];
    let scales: Vec<f64> = members
        .iter()
        .zip(limits)
        .map(|(k, limit)| desaturate(k.inverse(twist).into(), limit).1)
        .collect();
    let scale = group_scale(scales.iter().copied());
    assert!(scale < 1.0 && (scale - scales[2]).abs() < 1e-15);
    for (k, limit) in members.iter().zip(limits) {
        let rates = k.inverse(twist * scale);
        assert!(rates.iter().all(|rate| rate.abs() <= limit + 1e-12));
        close(k.forward(&rates), twist * scale, 1e-12);
    }
    assert_eq!(group_scale([0.5, f64::NAN]), 0.0);
    assert_eq!(group_scale(Vec::<f64>::new()), 0.0);
    assert_eq!(group_scale([3.0]), 1.0);
    assert_eq!(group_scale([0.5, -1.0]), 0.0);
}

#[test]
fn the_seven_configurations() {
    let two = [
        Formation::scc_2(1.0),
        Formation::suc_2(1.0),
        Formation::tcc_2(1.0),
        Formation::tuc_2(1.0),
        Formation::auc_2(1.0),
        Formation::acc_2(1.0),
    ]
    .map(Result::unwrap);
    let names = two.map(|c| (c.name, c.connected));
    assert_eq!(
        names,
        [
            ("SCC-2", true),
            ("SUC-2", false),
            ("TCC-2", true),
            ("TUC-2", false),
            ("AUC-2", false),
            ("ACC-2", true)
        ]
    );
    for Formation { name, mounts, .. } in two {
        let [one, other] = mounts.map(|m: Mount<f64>| m.pose());
        // The origin is in the middle, the members 1 m apart; side by side the first is on the
        // left.
        assert!((one.x + other.x).abs() < 1e-15 && (one.y + other.y).abs() < 1e-15);
        assert!(((one.x - other.x).hypot(one.y - other.y) - 1.0).abs() < 1e-15);
        let along = if name.starts_with('T') { one.x } else { one.y };
        assert_eq!(along, 0.5, "{name}");
        let angle = if name.starts_with('A') {
            FRAC_PI_6
        } else {
            0.0
        };
        assert!((other.heading - one.heading - angle).abs() < 1e-15);
    }
    let train = Formation::<3, f64>::tcc_3(1.0).unwrap();
    assert_eq!((train.name, train.connected), ("TCC-3", true));
    assert!(Formation::<2, f64>::tcc_2(f64::NAN).is_err());
}

#[test]
fn one_slipping_wheel_is_named() {
    let platform = six();
    let twist = Twist::new(0.4, -0.3, 0.2);
    let healthy = platform.rates(twist);
    assert_eq!(platform.suspect(&healthy, 0.01), Suspect::None);
    for wheel in 0..6 {
        for excess in [0.5, -1.5] {
            let mut rates = healthy;
            rates[wheel] += excess;
            let Suspect::Wheel {
                index,
                excess: found,
            } = platform.suspect(&rates, 0.01)
            else {
                panic!("wheel {wheel} not named");
            };
            assert_eq!(index, wheel);
            assert!((found - excess).abs() < 1e-9);
        }
    }
    // Two at once: no wheel is named.
    let mut rates = healthy;
    rates[0] += 1.0;
    rates[3] += 0.7;
    assert_eq!(platform.suspect(&rates, 0.01), Suspect::Unclear);
}

#[test]
fn one_dead_wheel_is_named() {
    // Six wheels, encoder dead: the rate reads zero.
    let platform = six();
    let twist = Twist::new(0.4, -0.3, 0.2);
    for wheel in 0..6 {
        let mut rates = platform.rates(twist);
        let was = rates[wheel];
        rates[wheel] = 0.0;
        assert!(matches!(
            platform.suspect(&rates, 0.01),
            Suspect::Wheel { index, excess }
                if index == wheel && (excess + was).abs() < 1e-9
        ));
    }
    // Four wheels have one check only: they know that something is wrong, and the command knows
    // what.
    let platform = four(45.0);
    for wheel in 0..4 {
        let mut rates = platform.rates(twist);
        let was = rates[wheel];
        rates[wheel] = 0.0;
        assert_eq!(platform.suspect(&rates, 0.01), Suspect::Unclear);
        assert!(matches!(
            platform.suspect_against(twist, &rates, 0.05),
            Suspect::Wheel { index, excess }
                if index == wheel && (excess + was).abs() < 1e-9
        ));
    }
    assert_eq!(
        platform.suspect_against(twist, &platform.rates(twist), 0.05),
        Suspect::None
    );
    assert_eq!(
        platform.suspect_against(twist, &[0.0; 4], 0.05),
        Suspect::Unclear
    );
}

#[test]
fn weights_trust_some_wheels_less() {
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.785).unwrap();
    let wheels = robot.wheels().unwrap();
    let twist = Twist::new(0.4, -0.3, 0.2);
    let dead = Platform::weighted(&wheels, &[1.0, 1.0, 0.0, 1.0]).unwrap();
    let mut rates = dead.rates(twist);
    rates[2] = 99.0;
    close(dead.twist(&rates), twist, 1e-12);
    // A wheel trusted a quarter pulls a quarter as much as its diagonal opposite: closed form for
    // vx is awkward, so the law is tested: the weighted residual is orthogonal to every motion.
    let weights = [1.0, 0.25, 2.0, 0.5];
    let platform = Platform::weighted(&wheels, &weights).unwrap();
    let left = platform.residual(&[1.0, -2.0, 0.5, 3.0]);
    for column in platform.jacobian().column_iter() {
        let product: f64 = column
            .iter()
            .zip(left)
            .zip(weights)
            .map(|((j, e), w)| j * e * w)
            .sum();
        assert!(product.abs() < 1e-12);
    }
    for weights in [[1.0, 1.0, -1.0, 1.0], [1.0, 1.0, f64::NAN, 1.0]] {
        assert_eq!(
            Platform::weighted(&wheels, &weights).unwrap_err(),
            GeometryError::Weight
        );
    }
    assert_eq!(
        Platform::weighted(&wheels, &[1.0, 0.0, 0.0, 1.0]).unwrap_err(),
        GeometryError::TooFewWheels
    );
}

#[test]
fn poor_wheels_are_refused_with_the_reason() {
    // Axles within a tenth of a degree of parallel.
    let wheels = [
        (0.3, 0.2, 0.700),
        (0.3, -0.2, 0.7005),
        (-0.3, 0.2, 0.7),
        (-0.3, -0.2, 0.7003),
    ]
    .map(|(x, y, roller)| Wheel::new(x, y, 0.0, roller, 0.1).unwrap());
    assert_eq!(
        Platform::<4, f64>::new(&wheels).unwrap_err(),
        GeometryError::TranslationPoor
    );
    // The "O" arrangement on a nearly square base: the axles nearly meet in the middle.
    let wheels = [
        (0.3, 0.301, -1.0),
        (0.3, -0.301, 1.0),
        (-0.3, 0.301, 1.0),
        (-0.3, -0.301, -1.0),
    ]
    .map(|(x, y, s)| Wheel::new(x, y, 0.0, s * PI / 4.0, 0.1).unwrap());
    assert_eq!(
        Platform::<4, f64>::new(&wheels).unwrap_err(),
        GeometryError::YawPoor
    );
    // The usual robot is about as good as can be: 1 for translation, and yaw of the same size per
    // lever arm.
    assert!((four(45.0).conditioning() - 1.0).abs() < 1e-9);
    assert!((four(60.0).conditioning() - 3.0_f64.sqrt()).abs() < 1e-2);
}

#[test]
fn eight_rollers_lose_and_ripple_as_the_paper_measured() {
    // Section 3.2: set 500 mm/s sideways; 497.5 at most, 460.4 at least, 483.2 on average.
    let rollers = Rollers::<f64>::new(8).unwrap();
    assert!((500.0 * rollers.least_lateral_ratio() - 460.4).abs() < 2.0);
    assert!((rollers.mean_lateral_ratio() - 0.974_495).abs() < 1e-6);
    // The mean over whole rollers of the ripple is the mean ratio; a period is an eighth of a turn.
    let steps = 8000;
    let mut sum = 0.0;
    for i in 0..steps {
        let angle = rollers.pitch() * (f64::from(i) + 0.5) / f64::from(steps);
        let sweep = rollers.sweep(angle, 0.3);
        assert!(sweep.abs() <= rollers.pitch() / 2.0 + 1e-12);
        assert!((rollers.sweep(angle + rollers.pitch(), 0.3) - sweep).abs() < 1e-12);
        sum += rollers.lateral_ratio(sweep);
    }
    assert!((sum / f64::from(steps) - rollers.mean_lateral_ratio()).abs() < 1e-7);
    assert!((rollers.ripple(0.0) - (1.0 / rollers.mean_lateral_ratio() - 1.0)).abs() < 1e-15);
    assert!(Rollers::<f64>::new(2).is_err());
}

#[test]
fn a_swept_wheel_is_the_roller_axle_seen_from_above() {
    // In space: the roller's axle through (0, 0, -a), along n cos g - d sin g, turned by the sweep
    // about the wheel's axle; where it crosses below the wheel's axle is the contact, its shadow is
    // the axle.
    let (gamma, axle, radius): (f64, f64, f64) = (0.6, 0.12, 0.15);
    for sweep in [-0.39, -0.1, 0.0, 0.2, 0.39_f64] {
        let wheel = Wheel::new(0.3, 0.2, 0.0, gamma, radius)
            .unwrap()
            .swept(sweep, axle)
            .unwrap();
        // Rolling forward turns ahead (x) down (-z) and down back (-x).
        let spin = |x: f64, z: f64| {
            (
                x * sweep.cos() + z * sweep.sin(),
                -x * sweep.sin() + z * sweep.cos(),
            )
        };
        let (mid_x, _) = spin(0.0, -axle);
        let (dir_x, _) = spin(-gamma.sin(), 0.0);
        let along = -mid_x / dir_x;
        let left = along * gamma.cos();
        assert!((wheel.x() - 0.3).abs() < 1e-15);
        assert!(
            (wheel.y() - (0.2 + left)).abs() < 1e-12,
            "{} {}",
            wheel.y(),
            0.2 + left
        );
        assert!((wheel.roller_angle().tan() - -dir_x / gamma.cos()).abs() < 1e-12);
        // Sideways motion per wheel angle shrinks by the cosine.
        let ratio = Wheel::new(0.3, 0.2, 0.0, gamma, radius)
            .unwrap()
            .jacobian_row()[1]
            / wheel.jacobian_row()[1];
        assert!((ratio - Rollers::new(8).unwrap().lateral_ratio(sweep)).abs() < 1e-12);
    }
}

/// What four roundings to `f32`, of 2^-24 each, make of the velocity 70 m from the axis of a turn
/// with 0.2 rad/s, 14 m/s; m/s.
const FAR: f64 = 4e-6;

#[test]
fn a_group_far_from_its_origin_is_as_accurate_as_one_near_it() {
    let robot = FourWheelGeometry::<f32>::new(0.370, 0.350, 0.1524, 45_f32.to_radians()).unwrap();
    let platform = Platform::new(&robot.wheels().unwrap()).unwrap();
    let member = |x, y, heading| {
        let mount = Mount::new(Pose::new(x, y, heading)).unwrap();
        Member::new(&platform, &mount, &VelocityCompensation::NONE)
    };
    let wide = |twist: Twist<f32>| twist.convert::<f64>();
    for (x, y) in [(50.0, 0.0), (0.0, -50.0), (-48.0, 48.0), (48.0, 17.0)] {
        // A member alone is the group.
        let twist = Twist::new(0.5_f32, -0.3, 0.2);
        let alone = Group::new(&[member(x, y, 0.3)]).unwrap();
        close(wide(alone.forward(&[twist])), wide(twist), FAR);

        // Two alike, d ahead of and behind a middle, which measure v and w. Each counts as 1 along
        // both axes and as l^2 for yaw, l = half track + half wheelbase, so least squares gives
        // that middle the mean velocity and
        // Omega = (d (v1 - v2) + l^2 (w1 + w2)) / (2 d^2 + 2 l^2), v being velocity to the left.
        let (d, l) = (0.625, 0.720);
        let pair = Group::new(&[member(x + 0.625, y, 0.0), member(x - 0.625, y, 0.0)]).unwrap();
        let measured = [Twist::new(0.5_f32, -0.3, 0.2), Twist::new(0.9, -0.6, 0.21)];
        let (x, y) = (f64::from(x), f64::from(y));
        let at = |twist: Twist<f64>, x: f64, y: f64| {
            Twist::new(
                twist.vx - twist.omega * y,
                twist.vy + twist.omega * x,
                twist.omega,
            )
        };
        let [one, other] = measured.map(wide);
        let (one, other) = (at(one, x + d, y), at(other, x - d, y));
        let omega = (d * (one.vy - other.vy) + l * l * (one.omega + other.omega))
            / (2.0 * d * d + 2.0 * l * l);
        let middle = Twist::new((one.vx + other.vx) / 2.0, (one.vy + other.vy) / 2.0, omega);
        close(wide(pair.forward(&measured)), at(middle, -x, -y), FAR);
    }
}

#[test]
fn wheels_far_from_the_robots_origin_lose_a_rounding_of_their_lever_and_not_its_square() {
    // 70 m off, J's yaw entries are up to 660, so they are off by 3e-5, which 0.2 rad/s makes 6e-6
    // rad/s of a rate; and rates of 130 rad/s are rounded by as much. A row back has up to 5 m for
    // each of four such rates, and 3e-7 m of rounding for 130 rad/s: (12e-6 * 5 + 3e-7 * 130) * 4,
    // if all had one sign; half of that here.
    const BOUND: f64 = 2e-4;
    let robot = FourWheelGeometry::<f32>::new(0.370, 0.350, 0.1524, 45_f32.to_radians()).unwrap();
    let wheels = robot.wheels().unwrap();
    let twist = Twist::new(0.5_f32, -0.3, 0.2);
    for (x, y) in [(50.0, 0.0), (0.0, -50.0), (-50.0, 50.0)] {
        let moved = wheels.map(|w| {
            let (x, y) = (w.x() + x, w.y() + y);
            Wheel::new(x, y, w.mounting_angle(), w.roller_angle(), w.radius()).unwrap()
        });
        for weights in [[1.0; 4], [1.0, 0.25, 2.0, 0.5]] {
            let platform = Platform::weighted(&moved, &weights).unwrap();
            let back = platform.twist(&platform.rates(twist));
            close(back.convert(), twist.convert(), BOUND);
        }
    }
}

/// Sum and folding of angles of a few turns, cosine and chord, in `f32`.
const RATIO: f64 = 1e-6;

/// Within a roller, between two sweeps: the mean of a cosine.
fn mean_cosine(from: f64, to: f64) -> f64 {
    let half = (to - from) / 2.0;
    let chord = if half == 0.0 { 1.0 } else { half.sin() / half };
    ((from + to) / 2.0).cos() * chord
}

#[test]
fn the_mean_lateral_ratio_of_any_turn_within_a_roller_is_the_mean_of_its_cosine() {
    let (single, double) = (
        Rollers::<f32>::new(8).unwrap(),
        Rollers::<f64>::new(8).unwrap(),
    );
    let phase = 0.1_f32;
    for roller in -3..=3_i16 {
        for sweep in [-0.35_f32, -0.2, 0.0, 0.15, 0.25] {
            let from = f32::from(roller) * single.pitch() + sweep - phase;
            for turn in [1e-7_f32, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1] {
                let to = from + turn;
                let [a, b] = [from, to].map(|angle| double.sweep(angle.into(), phase.into()));
                let want = mean_cosine(a, b);
                for (from, to) in [(from, to), (to, from)] {
                    let got = single.mean_lateral_ratio_between(from, to, phase);
                    assert!((f64::from(got) - want).abs() < RATIO, "{from} {to}: {got}");
                }
            }
        }
    }
    // Turns that vanish beside the phase.
    for turn in [0.0, 1e-300, 1e-17, 1e-16, 1e-12] {
        let got = double.mean_lateral_ratio_between(0.0, turn, 0.3);
        assert!(
            (got - mean_cosine(0.3, 0.3 + turn)).abs() < 1e-15,
            "{turn}: {got}"
        );
    }
}

#[test]
fn the_mean_lateral_ratio_across_transitions_is_that_of_the_parts_by_their_length() {
    let (single, double) = (
        Rollers::<f32>::new(8).unwrap(),
        Rollers::<f64>::new(8).unwrap(),
    );
    let end = double.pitch() / 2.0;
    for turn in [1e-5_f32, 1e-4, 1e-3, 1e-2, 0.1, 0.5] {
        let from = single.pitch() / 2.0 - turn / 3.0;
        let to = from + turn;
        let (before, after) = (end - f64::from(from), f64::from(to) - end);
        let want = (before * mean_cosine(end - before, end)
            + after * mean_cosine(-end, after - end))
            / (before + after);
        let got = single.mean_lateral_ratio_between(from, to, 0.0);
        assert!(
            (f64::from(got) - want).abs() < RATIO,
            "{turn}: {got} for {want}"
        );
        // Five whole rollers more.
        let whole = 5.0 * double.pitch();
        let more = (want * (before + after) + double.mean_lateral_ratio() * whole)
            / (before + after + whole);
        let (from, to) = (f64::from(from), f64::from(to) + whole);
        for (from, to) in [(from, to), (to, from)] {
            let got = double.mean_lateral_ratio_between(from, to, 0.0);
            assert!((got - more).abs() < 1e-13, "{turn}: {got} for {more}");
        }
    }
}

#[test]
fn a_sweep_of_a_right_angle_or_more_is_refused() {
    let wheel = Wheel::new(0.35_f64, 0.37, 0.0, PI / 4.0, 0.15).unwrap();
    for degrees in [89.9_f64, -89.9] {
        assert!(wheel.swept(degrees.to_radians(), 0.1).is_ok());
    }
    for degrees in [90.0_f64, -90.0, 91.0, 135.0, -180.0, 270.0, 360.0] {
        let refused = wheel.swept(degrees.to_radians(), 0.1);
        assert_eq!(refused, Err(GeometryError::RollerAngle), "{degrees}");
    }
    for sweep in [f64::NAN, f64::INFINITY] {
        assert_eq!(
            wheel.swept(sweep, 0.1),
            Err(GeometryError::NotFinite("sweep"))
        );
    }
    let single = Wheel::new(0.35_f32, 0.37, 0.0, 0.785, 0.15).unwrap();
    assert_eq!(
        single.swept(90_f32.to_radians(), 0.1),
        Err(GeometryError::RollerAngle)
    );
}
