//! The fixed-point path against f64, over the whole input range: error within the stated bound, and
//! never a wrapped result: what does not fit saturates and says so.

use fixed::types::I16F16;
use mecanum_kinematics::trajectory::{FigureEight, Trajectory};
use mecanum_kinematics::{
    FixedMember, FourWheelGeometry, GeometryError, MemberKinematics, Mount, Odometry, Pose,
    RangeError, Scalar, Twist, VelocityCompensation, WheelKinematics, WheelRates, desaturate,
};

/// The input range of a robot: 4 m/s and 8 rad/s, wheels to 200 rad/s.
const TWIST_RANGE: [f64; 3] = [4.0, 4.0, 8.0];
const RATE_RANGE: f64 = 200.0;
/// Worst case over that range: one step of 2^-16 and 16 units of input at half a step of 2^-20.
const INVERSE_BOUND: f64 = 1.0 / 65_536.0 + 16.0 * 0.5 / 1_048_576.0;
/// Half a step and 800 units of input at half a step of 2^-28.
const FORWARD_BOUND: f64 = 0.5 / 65_536.0 + 800.0 * 0.5 / 268_435_456.0;
/// Half of 2^15, where an I16F16 ends.
const END: f64 = 32_768.0;

/// A small reproducible generator (xorshift).
struct Random(u64);

impl Random {
    fn bits(&mut self) -> i32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 32) as i32
    }

    /// Anything an I16F16 can hold, small magnitudes as often as large ones.
    fn any(&mut self) -> I16F16 {
        let shift = self.bits() & 31;
        I16F16::from_bits(self.bits() >> shift)
    }

    fn within(&mut self, range: f64) -> I16F16 {
        I16F16::from_num(f64::from(self.bits()) / 2_147_483_648.0 * range)
    }
}

fn members() -> Vec<MemberKinematics<f64>> {
    let mut members = Vec::new();
    for (geometry, angle) in [
        ((0.370, 0.350, 0.1524), 45.0_f64),
        ((0.225, 0.2, 0.05), 38.5),
    ] {
        let (w, h, r) = geometry;
        let robot = FourWheelGeometry::new(w, h, r, angle.to_radians()).unwrap();
        for mount in [(0.0, 0.0, 0.0), (1.1, 0.0, 0.0), (-3.0, 2.0, 0.7)] {
            let mount = Mount::new(Pose::new(mount.0, mount.1, mount.2)).unwrap();
            let c = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
            members.push(MemberKinematics::new(&robot, &mount, &c).unwrap());
        }
    }
    members
}

/// The part of the range that only saturated values may stand in.
const MARGIN: f64 = 1.0 / 16.0;

/// `got` is right within `bound`, or saturated where `want` lies beyond the range.
fn agrees(got: I16F16, want: f64, bound: f64) {
    let value = got.to_num::<f64>();
    if want.abs() >= END - MARGIN + bound {
        assert!(got.is_saturated(), "{want} must saturate, not {got}");
        assert!(value.abs() >= END - MARGIN && value.signum() == want.signum());
    } else {
        let error = (value - want).abs();
        // f64 itself is exact to 1e-16 of 1e9 or so here.
        assert!(
            error <= bound + 1e-9,
            "{got} for {want}: {error:e} > {bound:e}"
        );
        if want.abs() < END - MARGIN - bound {
            assert!(!got.is_saturated(), "{got} for {want} is within the range");
        }
    }
}

#[test]
fn inverse_keeps_its_bound_over_the_whole_input_range() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let mut saturated = 0;
    for exact in members() {
        let fixed = exact.convert::<I16F16>().unwrap();
        for _ in 0..200_000 {
            let twist = Twist {
                vx: random.any(),
                vy: random.any(),
                omega: random.any(),
            };
            let got = fixed.inverse(twist);
            saturated += u32::from(got.is_saturated());
            let want: [f64; 4] = exact.inverse(twist.convert()).into();
            let bound = WheelKinematics::<4, I16F16>::inverse_bound(twist);
            for (got, want) in <[I16F16; 4]>::from(got).into_iter().zip(want) {
                agrees(got, want, bound);
            }
        }
    }
    assert!(saturated > 1000, "the range's end was visited");
}

#[test]
fn forward_and_residual_keep_their_bound_over_the_whole_input_range() {
    let mut random = Random(0x1234_5678_9abc_def1);
    for exact in members() {
        let fixed = exact.convert::<I16F16>().unwrap();
        for _ in 0..200_000 {
            let rates = [random.any(), random.any(), random.any(), random.any()];
            let bound = WheelKinematics::<4, I16F16>::forward_bound(&rates);
            let wide = WheelRates::from(rates.map(|rate| rate.to_num::<f64>()));
            let rates = WheelRates::from(rates);
            let (got, want) = (fixed.forward(&rates), exact.forward(&wide));
            agrees(got.vx, want.vx, bound);
            agrees(got.vy, want.vy, bound);
            agrees(got.omega, want.omega, bound);
            agrees(
                fixed.slip_residual(&rates),
                exact.slip_residual(&wide),
                bound,
            );
        }
    }
}

#[test]
fn a_robots_range_stays_within_one_and_a_half_steps() {
    let mut random = Random(7);
    for exact in members() {
        let fixed = exact.convert::<I16F16>().unwrap();
        let [x, y, w] = TWIST_RANGE;
        for _ in 0..100_000 {
            let twist = Twist {
                vx: random.within(x),
                vy: random.within(y),
                omega: random.within(w),
            };
            let want: [f64; 4] = exact.inverse(twist.convert()).into();
            let got: [I16F16; 4] = fixed.inverse(twist).into();
            for (got, want) in got.into_iter().zip(want) {
                agrees(got, want, INVERSE_BOUND);
            }
            let rates = [(); 4].map(|()| random.within(RATE_RANGE));
            let wide = WheelRates::from(rates.map(|rate| rate.to_num::<f64>()));
            let (got, want) = (fixed.forward(&rates.into()), exact.forward(&wide));
            agrees(got.vx, want.vx, FORWARD_BOUND);
            agrees(got.vy, want.vy, FORWARD_BOUND);
            agrees(got.omega, want.omega, FORWARD_BOUND);
        }
    }
}

#[test]
fn coefficients_that_do_not_fit_are_refused() {
    let convert = |robot: FourWheelGeometry<f64>, x: f64| {
        let mount = Mount::new(Pose::new(x, 0.0, 0.0)).unwrap();
        let c = VelocityCompensation::new(1.0, 1.0, 1.0).unwrap();
        MemberKinematics::new(&robot, &mount, &c)
            .unwrap()
            .convert::<I16F16>()
            .map(|_| ())
    };
    let angle = 45_f64.to_radians();
    let small = FourWheelGeometry::new(0.3, 0.3, 0.01, angle).unwrap();
    assert_eq!(convert(small, 1.0), Ok(()));
    assert_eq!(convert(small, 50.0), Err(RangeError::Inverse));
    let large = FourWheelGeometry::new(0.5, 0.5, 0.5, angle).unwrap();
    assert_eq!(convert(large, 100.0), Err(RangeError::Forward));
}

#[test]
fn desaturate_in_fixed_point_keeps_limit_and_direction() {
    let mut random = Random(99);
    for _ in 0..200_000 {
        let rates = [(); 4].map(|()| random.any());
        let limit = random.any().saturating_abs();
        let (got, scale) = desaturate(WheelRates::from(rates), limit);
        let fastest = rates
            .iter()
            .fold(0.0, |most: f64, rate| most.max(rate.to_num::<f64>().abs()));
        let share = if fastest <= limit.to_num::<f64>() {
            1.0
        } else {
            limit.to_num::<f64>() / fastest
        };
        assert!((scale.to_num::<f64>() - share).abs() <= 1.0 / 65_536.0);
        for (got, rate) in <[I16F16; 4]>::from(got).into_iter().zip(rates) {
            assert!(got.unsigned_abs() <= limit.unsigned_abs());
            // Rounded towards zero, once, from a factor with 32 fractional bits.
            let want = rate.to_num::<f64>() * share;
            assert!((got.to_num::<f64>() - want).abs() <= 1.0 / 65_536.0 + 8e-6);
        }
    }
    let rates = WheelRates::from([I16F16::ONE; 4]);
    let (still, zero) = desaturate(rates, I16F16::NEG_ONE);
    assert_eq!(
        (still, zero),
        (WheelRates::from([I16F16::ZERO; 4]), I16F16::ZERO)
    );
}

#[test]
fn conversion_saturates_and_says_so() {
    let twist = Twist {
        vx: 1e9_f32,
        vy: 0.0,
        omega: 0.0,
    }
    .convert::<I16F16>();
    assert!(twist.is_saturated() && twist.vx == I16F16::MAX);
    assert!(I16F16::constant(f64::NAN) == I16F16::ZERO);
}

#[test]
fn a_fixed_member_stands_in_for_a_single_precision_one() {
    // The figure-eight, each robot odd in its own way, driven by either: displacements agree to far
    // better than 0.05 %, and so does what the members measure.
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.7_f32).unwrap();
    let mount = Mount::new(Pose::new(1.2, -0.3, 0.4)).unwrap();
    let c = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let single = MemberKinematics::new(&robot, &mount, &c).unwrap();
    let fixed = FixedMember::new(&robot, &mount, &c).unwrap();
    let eight = FigureEight::<f32>::paper();
    let (start, _) = eight.at(0.0);
    let mut odometry = [Odometry::at(start), Odometry::at(start)];
    let mut apart = 0.0_f32;
    for i in 0..20_000_u16 {
        let (_, twist) = eight.at((f32::from(i) + 0.5) * 1e-3);
        // What really happens follows from the wheel rates in single precision.
        odometry[0].update(single.forward(&single.inverse(twist)), 1e-3);
        odometry[1].update(single.forward(&fixed.inverse(twist)), 1e-3);
        let measured = fixed.forward(&single.inverse(twist));
        assert!((measured.vx - twist.vx).abs() + (measured.vy - twist.vy).abs() < 4e-5);
        assert!(fixed.slip_residual(&single.inverse(twist)).abs() < 4e-5);
        // A tick's worth of wheel angle, as odometry takes it: 1e-3 s of it, to a hundredth of a
        // micrometre.
        let angles =
            WheelRates::from(<[f32; 4]>::from(single.inverse(twist)).map(|rate| rate * 1e-3));
        let (got, want) = (fixed.displacement(&angles), single.displacement(&angles));
        assert!((got.vx - want.vx).abs() + (got.vy - want.vy).abs() < 4e-8);
        let (a, b) = (odometry[0].pose(), odometry[1].pose());
        apart = apart.max((a.x - b.x).abs().max((a.y - b.y).abs()));
    }
    assert!(apart < 0.0005 * 2.5 / 10.0, "{apart} m apart");
}

#[test]
fn a_fixed_member_saturates_and_refuses() {
    let robot = FourWheelGeometry::new(0.3, 0.3, 0.01, 0.7_f32).unwrap();
    let c = VelocityCompensation::NONE;
    let fixed = FixedMember::new(&robot, &Mount::IDENTITY, &c).unwrap();
    let rates = fixed.inverse(Twist::new(1e6, 0.0, 0.0));
    assert!(FixedMember::is_saturated(rates.front_left));
    assert!(!FixedMember::is_saturated(
        fixed.inverse(Twist::new(1.0, 0.0, 0.0)).front_left
    ));
    assert_eq!(
        fixed.inverse(Twist::new(f32::NAN, 0.0, 0.0)),
        WheelRates::ZERO
    );
    let far = Mount::new(Pose::new(50.0, 0.0, 0.0)).unwrap();
    assert_eq!(
        FixedMember::new(&robot, &far, &c).unwrap_err(),
        GeometryError::Range
    );
}
