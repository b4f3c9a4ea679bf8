//! What the parts promise beyond the paper's equations: refusals, limits, integration,
//! trajectories.

use mecanum_kinematics::trajectory::{Circle, FigureEight, Harmonic, Ramped, Trajectory};
use mecanum_kinematics::{
    CompensationError, FourWheelGeometry, GeometryError, Mount, MountError, Odometry, Platform,
    Pose, Twist, VelocityCompensation, Wheel, WheelRates, desaturate,
};

const DEG: f32 = core::f32::consts::PI / 180.0;

#[test]
fn geometry_refuses_and_names_the_field() {
    let build = |t, b, r, g| FourWheelGeometry::new(t, b, r, g).unwrap_err();
    assert_eq!(
        build(0.0, 0.3, 0.1, 0.7),
        GeometryError::NotPositive("half_track")
    );
    assert_eq!(
        build(0.3, -0.3, 0.1, 0.7),
        GeometryError::NotPositive("half_wheelbase")
    );
    assert_eq!(
        build(0.3, 0.3, f32::NAN, 0.7),
        GeometryError::NotFinite("wheel_radius")
    );
    assert_eq!(build(0.3, 0.3, 0.1, 0.0), GeometryError::RollerAngle);
    assert_eq!(build(0.3, 0.3, 0.1, 90.0 * DEG), GeometryError::RollerAngle);
    assert_eq!(
        Mount::new(Pose {
            x: 0.0,
            y: f32::NAN,
            heading: 0.0
        })
        .unwrap_err(),
        MountError::NotFinite("y")
    );
}

#[test]
fn compensation_refuses_zero_negative_and_nan() {
    assert_eq!(
        VelocityCompensation::new(1.0, 1.0, 0.0).unwrap_err(),
        CompensationError::NotPositive("yaw")
    );
    assert_eq!(
        VelocityCompensation::new(-1.0, 1.0, 1.0).unwrap_err(),
        CompensationError::NotPositive("longitudinal")
    );
    assert_eq!(
        VelocityCompensation::new(1.0, f32::NAN, 1.0).unwrap_err(),
        CompensationError::NotFinite("lateral")
    );
}

#[test]
fn uncontrollable_platforms_say_why() {
    // Every roller axle points at the origin.
    let radial = [0.0, 1.5, 3.1, 4.2].map(|bearing: f64| {
        let (sin, cos) = bearing.sin_cos();
        // The roller's axle is a quarter turn left of mounting + roller angle.
        let roller = 0.7;
        let mounting = bearing - std::f64::consts::FRAC_PI_2 - roller;
        Wheel::new(0.5 * cos, 0.5 * sin, mounting, roller, 0.1).unwrap()
    });
    assert_eq!(
        Platform::new(&radial).unwrap_err(),
        GeometryError::YawUncontrolled
    );
    let parallel = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2)]
        .map(|(x, y)| Wheel::new(x, y, 0.0, 0.7, 0.1).unwrap());
    assert_eq!(
        Platform::new(&parallel).unwrap_err(),
        GeometryError::TranslationUncontrolled
    );
    let two = [(0.3, 0.2), (0.3, -0.2)].map(|(x, y)| Wheel::new(x, y, 0.0, 0.7, 0.1).unwrap());
    assert_eq!(
        Platform::new(&two).unwrap_err(),
        GeometryError::TooFewWheels
    );
}

#[test]
fn desaturate_keeps_the_direction() {
    let rates = WheelRates::from([10.0, -20.0, 5.0, 0.0]);
    assert_eq!(desaturate(rates, 20.0), (rates, 1.0));
    assert_eq!(
        desaturate(rates, 10.0),
        (WheelRates::from([5.0, -10.0, 2.5, 0.0]), 0.5)
    );
}

/// Not by a unit in the last place either: a controller compares with the limit it gave.
#[test]
fn desaturate_leaves_no_rate_above_the_limit() {
    // xorshift64*, for values in 0 to 1.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut next = || {
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        let bits = state.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11;
        bits as f64 / 9_007_199_254_740_992.0
    };
    for _ in 0..20_000 {
        let rates = [(); 4].map(|()| 200.0 * next() - 100.0);
        let limit = 1.0 + 59.0 * next();
        let single = rates.map(|rate| rate as f32);
        let (limited, scale) = desaturate(WheelRates::from(single), limit as f32);
        for (got, asked) in <[f32; 4]>::from(limited).into_iter().zip(single) {
            assert!(got.abs() <= limit as f32, "{got} above {limit}");
            assert!((got - asked * scale).abs() <= f32::EPSILON * got.abs());
        }
        let (limited, scale) = desaturate(WheelRates::from(rates), limit);
        for (got, asked) in <[f64; 4]>::from(limited).into_iter().zip(rates) {
            assert!(got.abs() <= limit, "{got} above {limit}");
            assert!((got - asked * scale).abs() <= f64::EPSILON * got.abs());
        }
        let fastest = rates
            .iter()
            .fold(0.0_f64, |most, rate| most.max(rate.abs()));
        if fastest > limit {
            // The division's rounding and a unit in the last place.
            assert!((scale * fastest / limit - 1.0).abs() < 4.0 * f64::EPSILON);
        }
    }
    // Rates whose sum is no number are numbers.
    let (limited, scale) = desaturate(WheelRates::from([1e308_f64, -1e308, 0.5e308, 0.0]), 1.0);
    assert!((scale * 1e308 - 1.0).abs() < 1e-15);
    for (got, want) in <[f64; 4]>::from(limited)
        .into_iter()
        .zip([1.0, -1.0, 0.5, 0.0_f64])
    {
        assert!((got - want).abs() < 1e-15 && got.abs() <= 1.0, "{got}");
    }
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let stopped = desaturate(WheelRates::from([1.0, bad, 1.0, 1.0]), 5.0);
        assert_eq!(stopped, (WheelRates::from([0.0; 4]), 0.0));
    }
}

#[test]
fn desaturate_stops_on_what_makes_no_sense() {
    let rates = WheelRates::from([10.0, -20.0, 5.0, 0.0]);
    let (still, zero) = (WheelRates::ZERO, 0.0);
    assert_eq!(desaturate(rates, 0.0), (still, zero));
    assert_eq!(desaturate(still, 0.0), (still, 1.0), "nothing has to give");
    assert_eq!(desaturate(still, -1.0), (still, zero));
    assert_eq!(desaturate(rates, -1.0), (still, zero));
    assert_eq!(desaturate(rates, f32::NAN), (still, zero));
    for bad in [f32::NAN, f32::INFINITY] {
        assert_eq!(
            desaturate(WheelRates::from([1.0, bad, 1.0, 1.0]), 5.0),
            (still, zero)
        );
    }
}

#[test]
fn odometry_follows_the_arc_exactly() {
    // A quarter of a circle of 1 m radius in one step: Euler would end at (pi/2, 0).
    let quarter = std::f64::consts::FRAC_PI_2;
    let mut one = Odometry::new();
    one.update(Twist::new(1.0, 0.0, 1.0), quarter);
    let pose = one.pose();
    assert!((pose.x - 1.0).abs() < 1e-12 && (pose.y - 1.0).abs() < 1e-12);
    assert!((pose.heading - quarter).abs() < 1e-12);
    // The same in 1000 small steps, in f32.
    let mut many = Odometry::new();
    for _ in 0..1000 {
        many.update(
            Twist {
                vx: 1.0,
                vy: 0.0,
                omega: 1.0,
            },
            quarter as f32 / 1000.0,
        );
    }
    assert!((many.pose().x - 1.0).abs() < 1e-4 && (many.pose().y - 1.0).abs() < 1e-4);
}

#[test]
fn figure_eight_is_the_papers_in_our_frame() {
    // Paper: x = l sin 2wt, y = l cos wt. At t = 2.5 s, wt = pi/4: x = 2.5, y = 1.767 767.
    let eight = FigureEight::<f64>::paper();
    let (pose, twist) = eight.at(2.5);
    assert!((pose.y + 2.5).abs() < 1e-12);
    assert!((pose.x - 1.767_766_952_966).abs() < 1e-9);
    assert!(twist.vy.abs() < 1e-12);
    assert!((twist.vx + 0.555_360_367_270).abs() < 1e-9);
    assert!((eight.duration() - 20.0).abs() < 1e-12);
    // Fastest sideways at the crossing: 2 l w = 1.570 796 m/s.
    assert!((eight.at(5.0).1.vy - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
}

fn velocity_is_the_derivative(trajectory: &impl Trajectory<f64>) {
    let step = 1e-5;
    for i in 1..100 {
        let t = trajectory.duration() * f64::from(i) / 100.0;
        let (a, b) = (trajectory.at(t - step).0, trajectory.at(t + step).0);
        let twist = trajectory.at(t).1;
        for (got, want) in [
            (twist.vx, (b.x - a.x) / (2.0 * step)),
            (twist.vy, (b.y - a.y) / (2.0 * step)),
            (twist.omega, (b.heading - a.heading) / (2.0 * step)),
        ] {
            assert!((got - want).abs() < 1e-7, "t {t}: {got} against {want}");
        }
    }
}

#[test]
fn velocities_are_derivatives_of_poses() {
    let eight = FigureEight::paper();
    let circle = Circle::paper();
    let wave = Harmonic {
        amplitude: 1.0,
        speed: 0.3,
        frequency: 0.6,
        periods: 2.0,
    };
    velocity_is_the_derivative(&eight);
    velocity_is_the_derivative(&circle);
    velocity_is_the_derivative(&wave);
    velocity_is_the_derivative(&Ramped::new(eight, 2.0));
    velocity_is_the_derivative(&Ramped::new(wave, 1.0));
}

#[test]
fn ramps_start_and_stop_at_rest_on_the_curve() {
    let ramped = Ramped::new(FigureEight::<f64>::paper(), 2.0);
    assert!((ramped.duration() - 22.0).abs() < 1e-12);
    for t in [-1.0, 0.0, 22.0, 23.0] {
        let (pose, twist) = ramped.at(t);
        assert_eq!((twist.vx, twist.vy, twist.omega), (0.0, 0.0, 0.0));
        assert!((pose.x - 2.5).abs() < 1e-9 && pose.y.abs() < 1e-9);
    }
    // Half way through the time is half way along the curve.
    assert!((ramped.warp(11.0).0 - 10.0).abs() < 1e-12);
}
