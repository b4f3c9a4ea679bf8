//! Kinematics by roller phase: against the swept wheel, closed forms and the constant model.

use std::f64::consts::{PI, TAU};

use mecanum_kinematics::{
    FixedPhaseMember, FixedSecant, FourWheelGeometry, GeometryError, MemberKinematics, Mount,
    Odometry, PhaseMember, PhasePlatform, Platform, Pose, RollerAngle, RollerTrack, Rollers,
    Secant, SecantEstimate, Twist, VelocityCompensation, Wheel, WheelRates,
};
use proptest::prelude::*;

#[path = "phase/fixed_point.rs"]
mod fixed_point;

/// Rounding of f64 in sums of a dozen terms of order 100.
const ROUNDING: f64 = 1e-11;

fn robot(angle: f64) -> FourWheelGeometry<f64> {
    FourWheelGeometry::new(0.370, 0.350, 0.1524, angle.to_radians()).unwrap()
}

fn mount(x: f64, y: f64, heading: f64) -> Mount<f64> {
    Mount::new(Pose::new(x, y, heading)).unwrap()
}

fn compensation() -> VelocityCompensation<f64> {
    VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap()
}

/// Secants between those of a roller's middle and of the transition of eight rollers.
fn secants() -> impl Strategy<Value = [f64; 4]> {
    let one = 1.0..1.0 / (PI / 8.0).cos();
    [one.clone(), one.clone(), one.clone(), one]
}

fn twists() -> impl Strategy<Value = Twist<f64>> {
    (-2.0..2.0, -2.0..2.0, -3.0..3.0).prop_map(|(x, y, w)| Twist::new(x, y, w))
}

fn close(a: Twist<f64>, b: Twist<f64>, tolerance: f64) -> bool {
    (a.vx - b.vx).abs() < tolerance
        && (a.vy - b.vy).abs() < tolerance
        && (a.omega - b.omega).abs() < tolerance
}

/// The errors the secant's polynomial promises, from three rollers up.
#[test]
fn secant_is_as_good_as_it_says() {
    for (rollers, bound) in [
        (3, 2e-3),
        (4, 7e-5),
        (6, 2e-6),
        (8, 2e-7),
        (10, 2e-7),
        (20, 2e-7),
    ] {
        let known = Rollers::<f64>::new(rollers).unwrap();
        let secant = Secant::new(Some(&known));
        let fixed = FixedSecant::new(&secant).unwrap();
        for step in -1000..=1000_i32 {
            let sweep = known.pitch() * f64::from(step) / 2001.0;
            let angle = RollerAngle::new(sweep, &known);
            let exact = 1.0 / sweep.cos();
            let error = secant.at(angle) / exact - 1.0;
            assert!(error.abs() < bound, "{rollers} rollers at {sweep}: {error}");
            // A few steps of 2^-26 on top.
            let one = f64::from(1 << FixedSecant::FRACTION);
            let error = f64::from(fixed.at(angle)) / one / exact - 1.0;
            assert!(
                error.abs() < bound + 1e-7,
                "{rollers} rollers at {sweep}: {error}"
            );
        }
    }
}

#[test]
fn secant_is_continuous_at_the_hand_over() {
    for rollers in [6, 8, 12] {
        let secant = Secant::<f64>::for_count(rollers).unwrap();
        let before = secant.at(RollerAngle::from_bits(i32::MAX));
        let after = secant.at(RollerAngle::from_bits(i32::MIN));
        // One step of the angle: 2^-32 of a pitch at a slope below 1.
        assert!((before - after).abs() < 1e-9);
        assert!((after - secant.largest()).abs() == 0.0);
    }
}

proptest! {
    /// The row of a leaning wheel is that of the wheel whose roller stands as it is seen from
    /// above, for any wheel.
    #[test]
    fn row_is_that_of_the_swept_wheel(
        (x, y) in (-1.0_f64..1.0, -1.0_f64..1.0),
        mounting in -PI..PI,
        angle in 0.2_f64..1.2,
        hand in prop::bool::ANY,
        reversed in prop::bool::ANY,
        sweep in -0.5_f64..0.5,
    ) {
        let angle = if hand { angle } else { -angle };
        let wheel = Wheel::new(x, y, mounting, angle, 0.1).unwrap();
        let wheel = if reversed { wheel.reversed() } else { wheel };
        let expected = wheel.swept(sweep, 0.0).unwrap().jacobian_row();
        let (straight, across) = wheel.jacobian_parts();
        for ((s, a), e) in straight.iter().zip(across).zip(expected) {
            prop_assert!((s + a / sweep.cos() - e).abs() < 1e-9, "{} {}", s + a / sweep.cos(), e);
        }
    }

    /// The fast way is the general one, with mount and compensation.
    #[test]
    fn member_is_the_platform(twist in twists(), secants in secants(), angle in 30.0..60.0) {
        let robot = robot(angle);
        let platform = PhasePlatform::new(&robot.wheels().unwrap()).unwrap();
        let (mount, c) = (mount(1.2, -0.4, 0.3), compensation());
        let member = PhaseMember::new(&robot, &mount, &c).unwrap();
        let expected = platform.rates(c.apply(mount.to_member(twist)), &secants);
        let rates: [f64; 4] = member.inverse(twist, &secants).into();
        for (rate, expected) in rates.iter().zip(expected) {
            prop_assert!((rate - expected).abs() < 100.0 * ROUNDING);
        }
    }

    #[test]
    fn forward_undoes_inverse(twist in twists(), secants in secants()) {
        let (mount, c) = (mount(1.2, -0.4, 0.3), compensation());
        let member = PhaseMember::new(&robot(45.0), &mount, &c).unwrap();
        let rates = member.inverse(twist, &secants);
        let (back, residual) = member.measure(&rates, &secants);
        prop_assert!(close(back, twist, ROUNDING), "{back:?}");
        prop_assert!(residual.abs() < 100.0 * ROUNDING);
        let platform = PhasePlatform::new(&robot(45.0).wheels().unwrap()).unwrap();
        let there = platform.twist(&platform.rates(twist, &secants), &secants).unwrap();
        prop_assert!(close(there, twist, ROUNDING));
    }

    /// With all secants 1 it is the constant model, residual included.
    #[test]
    fn infinitely_many_rollers_are_the_constant_model(
        twist in twists(),
        slips in [-1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0],
    ) {
        let (robot, mount, c) = (robot(40.0), mount(-0.3, 0.8, 1.1), compensation());
        let constant = MemberKinematics::new(&robot, &mount, &c).unwrap();
        let phase = PhaseMember::new(&robot, &mount, &c).unwrap();
        let none = Secant::<f64>::for_count(0).unwrap();
        let ones = [none.at(RollerAngle::from_bits(123)); 4];
        prop_assert_eq!(ones, [1.0; 4]);
        prop_assert_eq!(none.unknown(), 1.0);
        let rates: [f64; 4] = constant.inverse(twist).into();
        let same: [f64; 4] = phase.inverse(twist, &ones).into();
        let disturbed: [f64; 4] = std::array::from_fn(|n| rates[n] + slips[n]);
        for (a, b) in rates.iter().zip(same) {
            prop_assert!((a - b).abs() < 100.0 * ROUNDING);
        }
        let disturbed = WheelRates::from(disturbed);
        let (back, residual) = phase.measure(&disturbed, &ones);
        prop_assert!(close(back, constant.forward(&disturbed), ROUNDING));
        prop_assert!((residual - constant.slip_residual(&disturbed)).abs() < 100.0 * ROUNDING);
    }

    /// The closed form is not quite least squares when the secants differ: its variance is at most
    /// 0.4 % above.
    #[test]
    fn variance_is_close_to_least_squares(secants in secants()) {
        let robot = robot(45.0);
        let (mount, none) = (Mount::at_origin(), VelocityCompensation::none());
        let member = PhaseMember::new(&robot, &mount, &none).unwrap();
        let platform = PhasePlatform::new(&robot.wheels().unwrap()).unwrap();
        let known = secants.map(SecantEstimate::known);
        let best = platform.covariance(&[0.0; 4], &known, 1.0).unwrap();
        let mut variance = [0.0; 3];
        for wheel in 0..4 {
            let mut one = [0.0; 4];
            one[wheel] = 1.0;
            let t = member.forward(&WheelRates::from(one), &secants);
            for (v, t) in variance.iter_mut().zip([t.vx, t.vy, t.omega]) {
                *v += t * t;
            }
        }
        for (v, best) in variance.iter().zip([best.xx, best.yy, best.ww]) {
            prop_assert!(*v >= best * (1.0 - 1e-9) && *v <= best * 1.004, "{v} {best}");
        }
    }

    /// The track never loses a step: going somewhere in any number of parts ends at the same angle.
    #[test]
    fn track_does_not_depend_on_the_way(
        parts in prop::collection::vec(-30_000..30_000_i32, 1..50),
        start in any::<i32>(),
    ) {
        let mut stepwise = RollerTrack::new(9, 4096.0 * 19.2).unwrap();
        stepwise.set(RollerAngle::from_bits(start));
        let mut at_once = stepwise;
        for counts in &parts {
            stepwise.advance(*counts);
        }
        at_once.advance(parts.iter().sum());
        prop_assert_eq!(stepwise, at_once);
        // And it is the angle: counts over counts a pitch.
        let turned = f64::from(parts.iter().sum::<i32>()) / (4096.0 * 19.2 / 9.0);
        let pitches = turned + f64::from(start) / 4_294_967_296.0;
        let error = f64::from(stepwise.angle().to_bits()) / 4_294_967_296.0 - pitches;
        prop_assert!((error - error.round()).abs() < 1e-8);
    }

    /// A count is rollers over counts, in steps of 2^-64 to the nearest: against whole numbers of
    /// 128 bits. The angle shows the upper 32 bits, so 2^32 counts of it show the rest.
    #[test]
    fn a_count_is_a_fraction_of_a_pitch(
        rollers in 3..200_u16,
        counts in 800..4_000_000_u32,
        down in any::<bool>(),
    ) {
        let sign = if down { -1 } else { 1 };
        let mut track = RollerTrack::new(rollers, f64::from(counts) * f64::from(sign)).unwrap();
        let exact = ((u128::from(rollers) << 65) / u128::from(counts)).div_ceil(2);
        let mut shown = 0_u128;
        for _ in 0..4 {
            (0..4).for_each(|_| track.advance(1 << 30));
            shown += 1;
            let expected = (exact * shown) as u32 as i32;
            prop_assert_eq!(
                track.angle().to_bits(),
                if down {
                    expected.wrapping_neg()
                } else {
                    expected
                }
            );
        }
    }

    /// Closed form over any stretch: the integral of the cosine of the sweep, against a fine sum.
    #[test]
    fn lateral_travel_is_the_integral(
        from in -3.0..3.0,
        turned in -4.0..4.0,
        rollers in 3..16_u16,
    ) {
        let known = Rollers::<f64>::new(rollers).unwrap();
        const PARTS: u32 = 20_000;
        let step = turned / f64::from(PARTS);
        let sum: f64 = (0..PARTS)
            .map(|k| from + (f64::from(k) + 0.5) * step)
            .map(|at| known.lateral_ratio(known.sweep(at, 0.0)) * step)
            .sum();
        let travel = known.lateral_travel(turned, from);
        prop_assert!((travel - sum).abs() < 1e-6, "{travel} {sum}");
    }
}

/// Over one passage the wheels turn by a pitch and the robot moves by sin(pi/n)/(pi/n) of it,
/// whatever the phases, when all wheels have the same.
#[test]
fn mean_over_a_passage_is_the_closed_form() {
    for count in [6, 8, 10, 12] {
        let rollers = Rollers::<f64>::new(count).unwrap();
        let pitch = rollers.pitch();
        let expected = (PI / f64::from(count)).sin() / (PI / f64::from(count));
        for phase in [0.0, 0.1, -0.3] {
            let ratio = rollers.mean_lateral_ratio_between(0.0, pitch, phase * pitch);
            assert!((ratio - expected).abs() < 1e-14, "{count}: {ratio}");
        }
        // The same by odometry from wheel-angle increments: 0.1524 m of rim a radian.
        let member = PhaseMember::new(
            &robot(45.0),
            &Mount::at_origin(),
            &VelocityCompensation::none(),
        )
        .unwrap();
        let secant = Secant::new(Some(&rollers));
        let mut odometry = Odometry::<f64>::new();
        const PARTS: u32 = 1000;
        let step = pitch / f64::from(PARTS);
        for k in 0..PARTS {
            let middle = (f64::from(k) + 0.5) * step;
            // Wheels forward and back by turns: left motion.
            let left = secant.at(RollerAngle::new(-middle, &rollers));
            let right = secant.at(RollerAngle::new(middle, &rollers));
            let increments = WheelRates::from([-step, step, step, -step]);
            odometry.advance(member.displacement(&increments, &[left, right, right, left]));
        }
        let moved = odometry.pose().y / (pitch * 0.1524);
        // Midpoint rule: pitch^2 / 24 / PARTS^2, and the polynomial's 2e-6 at six rollers.
        assert!(
            (moved - expected).abs() < 3e-6,
            "{count}: {moved} {expected}"
        );
    }
}

/// One increment over a good part of a roller, with the mean secant: as good as many small ones
/// when the motion is along one axis.
#[test]
fn a_long_increment_takes_the_mean_ratio() {
    let rollers = Rollers::<f64>::new(8).unwrap();
    let member = PhaseMember::new(
        &robot(45.0),
        &Mount::at_origin(),
        &VelocityCompensation::none(),
    )
    .unwrap();
    let (turned, phase) = (0.6, 0.1);
    // All wheels' rollers lean alike at equal distances rolled.
    let ratio = rollers.mean_lateral_ratio_between(0.0, turned, phase);
    let secants = [1.0 / ratio; 4];
    let moved = member.displacement(
        &WheelRates::from([-turned, turned, turned, -turned]),
        &secants,
    );
    let end = rollers.sweep(turned, phase);
    // By hand: from 0.1 to the transition at pi/8, then from -pi/8 to the end.
    let expected = 0.1524 * (2.0 * (PI / 8.0).sin() - 0.1_f64.sin() + end.sin());
    assert!(
        (moved.vy - expected).abs() < ROUNDING,
        "{moved:?} {expected}"
    );
}

/// A wheel of unknown phase: the value is the reciprocal of the mean ratio, the deviation is the
/// secant's spread about it; both against sums.
#[test]
fn unknown_phase_is_as_unsure_as_the_secants_spread() {
    for count in [6, 8, 12] {
        let rollers = Rollers::<f64>::new(count).unwrap();
        let estimate = SecantEstimate::unknown(&rollers);
        let half = PI / f64::from(count);
        assert!((estimate.value - half / half.sin()).abs() < 1e-14);
        const PARTS: u32 = 10_000;
        let spread = (0..PARTS)
            .map(|k| {
                let sweep = half * ((f64::from(k) + 0.5) / f64::from(PARTS) * 2.0 - 1.0);
                (1.0 / sweep.cos() - estimate.value).powi(2)
            })
            .sum::<f64>()
            / f64::from(PARTS);
        assert!(
            (estimate.deviation - spread.sqrt()).abs() < 1e-6,
            "{estimate:?} {}",
            spread.sqrt()
        );
    }
}

/// Sideways at 0.5 m/s with every phase unknown: each wheel's rate is unsure by deviation times its
/// sideways part, and vy by half of that (four wheels); ahead nothing changes.
#[test]
fn covariance_reflects_an_unknown_phase() {
    let rollers = Rollers::<f64>::new(8).unwrap();
    let platform = PhasePlatform::new(&robot(45.0).wheels().unwrap()).unwrap();
    let unknown = SecantEstimate::unknown(&rollers);
    let secants = [unknown; 4];
    let values = secants.map(|s| s.value);
    let noise = 0.02;
    let sideways = platform.rates(Twist::new(0.0, 0.5, 0.0), &values);
    let c = platform.covariance(&sideways, &secants, noise).unwrap();
    let r = 0.1524;
    let each = (noise * noise + (unknown.deviation * 0.5 / r).powi(2)).sqrt();
    assert!(
        (c.yy.sqrt() - each * r / unknown.value / 2.0).abs() < 1e-12,
        "{c:?}"
    );
    let ahead = platform.rates(Twist::new(0.5, 0.0, 0.0), &values);
    let c = platform.covariance(&ahead, &secants, noise).unwrap();
    assert!((c.xx.sqrt() - noise * r / 2.0).abs() < 1e-12, "{c:?}");
    assert!(
        (c.yy.sqrt() - noise * r / unknown.value / 2.0).abs() < 1e-12,
        "{c:?}"
    );
}

/// Known phases leave the covariance of the plain platform.
#[test]
fn covariance_of_known_phases_is_least_squares() {
    let wheels = robot(45.0).wheels().unwrap();
    let c = PhasePlatform::new(&wheels)
        .unwrap()
        .covariance(&[1.0, 2.0, 3.0, 4.0], &[SecantEstimate::known(1.0); 4], 0.1)
        .unwrap();
    let information = Platform::new(&wheels)
        .unwrap()
        .information()
        .try_inverse()
        .unwrap();
    assert!((c.xx - 0.01 * information.m11).abs() < 1e-15);
    assert!((c.yy - 0.01 * information.m22).abs() < 1e-15);
    assert!((c.ww - 0.01 * information.m33).abs() < 1e-15);
}

#[test]
fn refuses_what_no_wheel_is() {
    assert_eq!(
        Secant::<f32>::for_count(2).unwrap_err(),
        GeometryError::NotPositive("rollers - 2")
    );
    assert!(RollerTrack::new(2, 4096.0).is_err());
    assert!(RollerTrack::new(8, 31.0).is_err());
    assert!(RollerTrack::new(8, -31.0).is_err());
    assert!(RollerTrack::new(8, 32.0).is_ok());
    assert!(RollerTrack::new(8, f64::NAN).is_err());
    assert!(RollerTrack::new(8, 0.0).is_err());
    for counts in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
        assert_eq!(
            RollerTrack::new(8, counts),
            Err(GeometryError::NotFinite("counts_per_turn"))
        );
    }
    // A count is 8/2^68 pitches, half a step of 2^-64, and then a quarter, which is none.
    let most = 2_f64.powi(68);
    assert!(RollerTrack::new(8, most).is_ok() && RollerTrack::new(8, -most).is_ok());
    for counts in [2.0 * most, -2.0 * most, 1e30, f64::MAX] {
        assert_eq!(
            RollerTrack::new(8, counts),
            Err(GeometryError::NotPositive("pitches a count")),
            "{counts}"
        );
    }
    let fixed = |half_track: f64, half_wheelbase: f64, radius: f64| {
        let robot = FourWheelGeometry::new(half_track, half_wheelbase, radius, 0.7).unwrap();
        FixedPhaseMember::new(&robot, &Mount::at_origin(), &VelocityCompensation::none())
    };
    assert_eq!(fixed(10.0, 0.1, 0.1), Err(GeometryError::Range));
    assert_eq!(fixed(0.001, 10.0, 0.1), Err(GeometryError::Range));
    assert_eq!(fixed(0.3, 0.3, 0.001), Err(GeometryError::Range));
    assert!(fixed(1.0, 0.1, 0.1).is_ok());
}

/// Single precision: 3e-6 of the largest rate any input alone would cause.
#[test]
fn single_precision_is_enough() {
    let single = PhaseMember::new(
        &FourWheelGeometry::new(0.370_f32, 0.350, 0.1524, 45_f32.to_radians()).unwrap(),
        &Mount::IDENTITY,
        &VelocityCompensation::NONE,
    )
    .unwrap();
    let double = PhaseMember::new(
        &robot(45.0),
        &Mount::at_origin(),
        &VelocityCompensation::none(),
    )
    .unwrap();
    let (secant, exact) = (
        Secant::<f32>::for_count(8).unwrap(),
        Secant::<f64>::for_count(8).unwrap(),
    );
    for step in 0..1000_i32 {
        let angles = [0, 1, 2, 3]
            .map(|n| RollerAngle::from_bits(step.wrapping_mul(4_000_037).wrapping_add(n << 29)));
        let twist = Twist::new(
            (f64::from(step) * 0.37).sin(),
            (f64::from(step) * 0.73).cos(),
            0.5,
        );
        let rates: [f64; 4] = double.inverse(twist, &angles.map(|a| exact.at(a))).into();
        let found: [f32; 4] = single
            .inverse(twist.convert(), &angles.map(|a| secant.at(a)))
            .into();
        let largest = (1.0 + 1.1 + 0.5) / 0.1524;
        for (a, b) in rates.iter().zip(found) {
            assert!((a - f64::from(b)).abs() < 3e-6 * largest, "{a} {b}");
        }
    }
    assert!((TAU / 8.0 - Rollers::<f64>::new(8).unwrap().pitch()).abs() < 1e-15);
}

/// Motion across the rollers' axles is harder than along them by the cotangent of the roller angle:
/// 115 at half a degree, 95 at 0.6, and the limit is 100.
#[test]
fn refuses_the_wheels_that_the_constant_model_refuses() {
    let (mount, none) = (Mount::at_origin(), VelocityCompensation::none());
    for (angle, refused) in [(0.5, true), (0.6, false), (89.4, false), (89.5, true)] {
        let robot = robot(angle);
        let error = refused.then_some(GeometryError::TranslationPoor);
        let constant = MemberKinematics::new(&robot, &mount, &none);
        assert_eq!(constant.err(), error, "{angle}");
        assert_eq!(
            PhaseMember::new(&robot, &mount, &none).err(),
            error,
            "{angle}"
        );
        if refused {
            let fixed = FixedPhaseMember::new(&robot, &mount, &none);
            assert_eq!(fixed.err(), error, "{angle}");
        }
    }
}
