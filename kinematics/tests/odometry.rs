//! Odometry against closed form: arcs in f64, a million turns in f32, covariance against a
//! simulated cloud.

use mecanum_kinematics::{
    Covariance, FourWheelGeometry, MemberKinematics, Mount, Odometry, Platform, Pose, Twist,
    TwistUncertainty, UncertainOdometry, Uncertainty, VelocityCompensation, WheelRates,
};
use std::f64::consts::{PI, TAU};

/// Closed form: the end of an arc, from the centre of the circle it lies on.
fn arc(start: Pose<f64>, twist: Twist<f64>, time: f64) -> Pose<f64> {
    let end = start.heading + twist.omega * time;
    // The centre stands (-vy, vx)/omega from the body.
    let (cx, cy) = (-twist.vy / twist.omega, twist.vx / twist.omega);
    let turn = |(x, y): (f64, f64), a: f64| (x * a.cos() - y * a.sin(), x * a.sin() + y * a.cos());
    let (from, to) = (turn((cx, cy), start.heading), turn((cx, cy), end));
    Pose::new(start.x + from.0 - to.0, start.y + from.1 - to.1, end)
}

#[test]
fn arcs_of_any_size_are_exact() {
    for omega in [1e-3, 0.05, 0.1249, 0.1251, 0.9, 3.0, 7.0, -0.06, -2.0, -9.0] {
        for heading in [0.0, 2.0, -3.1] {
            let start = Pose::new(0.3, -0.2, heading);
            let twist = Twist::new(0.7, -0.4, omega);
            let mut odometry = Odometry::at(start);
            odometry.update(twist, 1.0);
            let (got, want) = (odometry.pose(), arc(start, twist, 1.0));
            // The closed form itself loses digits as the circle grows: 1e-16 times its radius.
            assert!(
                (got.x - want.x).abs() < 1e-12 + 1e-15 / omega.abs(),
                "{omega} {heading}"
            );
            assert!((got.y - want.y).abs() < 1e-12 + 1e-15 / omega.abs());
            let off = (got.heading - want.heading) / TAU;
            assert!((off - off.round()).abs() < 1e-15);
            assert!(got.heading.abs() <= PI + 1e-8);
        }
    }
}

/// The chord of an arc of length 1: sin(a)/a along its start and (1 - cos a)/a across, for turns of
/// either sign on both sides of where the series gives way to sine and cosine.
#[test]
fn single_precision_chords_are_as_good_as_documented() {
    const BOUND: f64 = 3e-7;
    for step in 1..=70_000_i32 {
        for sign in [1.0, -1.0] {
            let turn = (f64::from(step) * 1e-4 * sign) as f32;
            let mut odometry = Odometry::<f32>::new();
            odometry.advance(Twist::new(1.0, 0.0, turn));
            let (end, turn) = (odometry.pose(), f64::from(turn));
            // 1 - cos a without its cancellation.
            let half = (turn / 2.0).sin();
            let off = [
                f64::from(end.x) - turn.sin() / turn,
                f64::from(end.y) - 2.0 * half * half / turn,
            ];
            assert!(off.iter().all(|off| off.abs() < BOUND), "{turn}: {off:?}");
        }
    }
}

#[test]
fn single_precision_steps_agree_with_the_arc() {
    // 100 s at 1 kHz, 0.5 m/s: 50 m of arc of 1.25 m radius.
    let twist = Twist {
        vx: 0.5_f32,
        vy: 0.0,
        omega: 0.4,
    };
    let mut odometry = Odometry::new();
    for _ in 0..100_000 {
        odometry.update(twist, 1e-3);
    }
    // What was really added: the f32 product.
    let turn = f64::from(0.4_f32 * 1e-3_f32) * 1e5;
    let length = f64::from(0.5_f32 * 1e-3_f32) * 1e5;
    let want = arc(Pose::new(0.0, 0.0, 0.0), Twist::new(length, 0.0, turn), 1.0);
    let got = odometry.pose();
    assert!(
        (f64::from(got.x) - want.x).abs() < 1e-5,
        "{} {}",
        got.x,
        want.x
    );
    assert!(
        (f64::from(got.y) - want.y).abs() < 1e-5,
        "{} {}",
        got.y,
        want.y
    );
}

#[test]
fn a_million_turns_leave_the_heading_exact() {
    // 64 steps a turn; the step is the f32 next to it, so where it should end is known exactly.
    let step = (TAU / 64.0) as f32;
    let turns = 1_000_000_u32;
    let mut odometry = Odometry::<f32>::new();
    for _ in 0..turns * 64 {
        odometry.advance(Twist {
            vx: 0.0,
            vy: 0.0,
            omega: step,
        });
    }
    let want = f64::from(step) * f64::from(turns) * 64.0;
    let off = (f64::from(odometry.pose().heading) - want).rem_euclid(TAU);
    let off = off.min(TAU - off);
    // f64 resolves the 6.3 million rad of `want` to 1e-9; 2e6 half turns at 2^-62 are nothing.
    assert!(off < 5e-9, "off by {off:e}");
    // And back again: to the very bit.
    for _ in 0..turns * 64 {
        odometry.advance(Twist {
            vx: 0.0,
            vy: 0.0,
            omega: -step,
        });
    }
    assert_eq!(odometry.pose().heading, 0.0);
}

#[test]
fn tiny_turns_are_not_lost() {
    let mut odometry = Odometry::<f32>::at(Pose::new(0.0, 0.0, 3.0));
    for _ in 0..1_000_000 {
        odometry.advance(Twist {
            vx: 0.0,
            vy: 0.0,
            omega: 1e-8,
        });
    }
    assert!((odometry.pose().heading - 3.01).abs() < 5e-7);
}

#[test]
fn wheel_angle_increments_need_no_speed() {
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.7).unwrap();
    let c = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let mount = Mount::new(Pose::new(0.0, 0.0, 0.0)).unwrap();
    let k = MemberKinematics::<f64>::new(&robot, &mount, &c).unwrap();
    let (mut by_angle, mut by_twist) = (Odometry::new(), Odometry::new());
    let twist = Twist::new(0.4, -0.3, 0.5);
    let increments = WheelRates::from(<[f64; 4]>::from(k.inverse(twist)).map(|rate| rate * 0.01));
    for _ in 0..500 {
        by_angle.advance_wheels(&k, &increments);
        by_twist.update(twist, 0.01);
    }
    assert!((by_angle.pose().x - by_twist.pose().x).abs() < 1e-12);
    assert!((by_angle.pose().y - by_twist.pose().y).abs() < 1e-12);
    by_angle.reset(Pose::new(1.0, 2.0, 7.0));
    let pose = by_angle.pose();
    assert!((pose.x, pose.y) == (1.0, 2.0) && (pose.heading - (7.0 - TAU)).abs() < 1e-15);
}

/// Normally distributed numbers from a small generator (sum of twelve uniform ones).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            sum += (self.0 >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    }
}

#[test]
fn pose_covariance_is_that_of_a_cloud() {
    let (sx, sy, sw) = (0.004, 0.006, 0.01);
    for omega in [0.05, 0.4] {
        let step = Twist::new(0.3, 0.1, omega);
        let start = Covariance::from_deviations(0.01, 0.02, 0.015);
        let mut odometry = UncertainOdometry::at(Pose::new(0.0, 0.0, 0.5), start);
        let noise = Covariance::from_deviations(sx, sy, sw);
        for _ in 0..8 {
            odometry.advance(step, &noise);
        }
        let (centre, covariance) = (odometry.pose(), odometry.covariance());
        let mut random = Noise(0x2545_f491_4f6c_dd1d);
        let runs = 40_000;
        let mut sums = [0.0; 6];
        for _ in 0..runs {
            let (dx, dy, dh) = (
                0.01 * random.next(),
                0.02 * random.next(),
                0.015 * random.next(),
            );
            let mut one = Odometry::at(Pose::new(dx, dy, 0.5 + dh));
            for _ in 0..8 {
                let (ex, ey, ew) = (sx * random.next(), sy * random.next(), sw * random.next());
                one.advance(step + Twist::new(ex, ey, ew));
            }
            let (x, y) = (one.pose().x - centre.x, one.pose().y - centre.y);
            let h = one.pose().heading - centre.heading;
            let h = h - TAU * (h / TAU).round();
            for (sum, term) in sums
                .iter_mut()
                .zip([x * x, x * y, x * h, y * y, y * h, h * h])
            {
                *sum += term / f64::from(runs);
            }
        }
        let Covariance {
            xx,
            xy,
            xw,
            yy,
            yw,
            ww,
        } = covariance;
        // Sampling error of 40 000 runs is 0.7 %; the first-order step adds a little.
        let scale = [
            xx,
            (xx * yy).sqrt(),
            (xx * ww).sqrt(),
            yy,
            (yy * ww).sqrt(),
            ww,
        ];
        for ((got, want), scale) in [xx, xy, xw, yy, yw, ww].into_iter().zip(sums).zip(scale) {
            assert!(
                (got - want).abs() < 0.03 * scale,
                "{got:e} against {want:e}"
            );
        }
    }
}

#[test]
fn twist_covariance_grows_with_slip_and_with_compensation() {
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 0.785_f64).unwrap();
    let platform = Platform::new(&robot.wheels().unwrap()).unwrap();
    let mount = Mount::new(Pose::new(0.0, 0.0, 0.0)).unwrap();
    let c = VelocityCompensation::new(1.0, 1.0, 1.0).unwrap();
    let noise = |wheel_rate, share| {
        let u = Uncertainty {
            wheel_rate,
            longitudinal: share,
            lateral: share,
            yaw: share,
        };
        TwistUncertainty::new(&platform, &mount, &c, &u)
    };
    // Closed form on the symmetric robot: vx is the mean of four r * rate: variance (r s)^2 / 4.
    let quiet = noise(0.02, 0.0).covariance(&[1.0; 4]);
    assert!((quiet.xx - (0.1524_f64 * 0.02).powi(2) / 4.0).abs() < 1e-15);
    // One wheel 0.4 rad/s off: residual 0.2, one degree of freedom, so 0.04 joins the 0.0004.
    let slipping = noise(0.02, 0.0).covariance(&[1.4, 1.0, 1.0, 1.0]);
    assert!((slipping.xx / quiet.xx - (0.0404 / 0.0004)).abs() < 1e-9);
    // 1 % of 0.1524 m/s.
    let vague = noise(0.0, 0.01).covariance(&[1.0; 4]);
    assert!((vague.xx - 0.001_524_f64.powi(2)).abs() < 1e-15 && vague.yy.abs() < 1e-15);
    // Seen from a mount ahead, the yaw uncertainty moves the group's origin sideways.
    let ahead = Mount::new(Pose::new(2.0, 0.0, 0.0)).unwrap();
    let u = Uncertainty {
        wheel_rate: 0.02,
        longitudinal: 0.0,
        lateral: 0.0,
        yaw: 0.0,
    };
    let seen = TwistUncertainty::new(&platform, &ahead, &c, &u).covariance(&[1.0; 4]);
    assert!((seen.yy - (quiet.yy + 4.0 * quiet.ww)).abs() < 1e-15);
}

#[test]
fn small_steps_far_from_the_origin_are_not_lost() {
    // At 1000 m an f32 has steps of 61 um; these are of 10 um.
    let mut odometry = Odometry::<f32>::at(Pose::new(1000.0, -1000.0, 0.0));
    for _ in 0..100_000 {
        odometry.advance(Twist {
            vx: 1e-5,
            vy: 1e-5,
            omega: 0.0,
        });
    }
    assert!(
        (odometry.pose().x - 1001.0).abs() <= 1.3e-4,
        "{}",
        odometry.pose().x
    );
    assert!(
        (odometry.pose().y + 999.0).abs() <= 1.3e-4,
        "{}",
        odometry.pose().y
    );
}

#[test]
fn pose_covariance_is_carried_by_the_exact_derivatives() {
    // One step; each source of error alone; against central differences of the exact step.
    let h = 1e-6;
    for omega in [0.03, 0.1, 0.9, -2.0] {
        let step = Twist::new(0.7, -0.4, omega);
        let at = |x: f64, y: f64, w: f64| {
            let mut odometry = Odometry::at(Pose::new(0.0, 0.0, 0.5));
            odometry.advance(step + Twist::new(x, y, w));
            odometry.pose()
        };
        let axes = [(h, 0.0, 0.0), (0.0, h, 0.0), (0.0, 0.0, h)];
        for (x, y, w) in axes {
            let (after, before) = (at(x, y, w), at(-x, -y, -w));
            let d = [
                (after.x - before.x) / (2.0 * h),
                (after.y - before.y) / (2.0 * h),
                (after.heading - before.heading) / (2.0 * h),
            ];
            let noise = Covariance::from_deviations(x / h, y / h, w / h);
            let mut odometry =
                UncertainOdometry::at(Pose::new(0.0, 0.0, 0.5), Covariance::default());
            odometry.advance(step, &noise);
            let Covariance {
                xx,
                xy,
                xw,
                yy,
                yw,
                ww,
            } = odometry.covariance();
            let want = [
                d[0] * d[0],
                d[0] * d[1],
                d[0] * d[2],
                d[1] * d[1],
                d[1] * d[2],
                d[2] * d[2],
            ];
            for (got, want) in [xx, xy, xw, yy, yw, ww].into_iter().zip(want) {
                assert!(
                    (got - want).abs() < 1e-8,
                    "omega {omega}: {got} against {want}"
                );
            }
        }
    }
}

/// One step of any size turns the heading by what is beyond whole turns.
#[test]
fn a_large_turn_in_single_precision_is_exact() {
    // f64 resolves 1e7 rad to 2e-9; the heading is read in steps of 2^-22 (the last bit of an f32
    // near pi).
    const BOUND: f64 = 3e-7;
    for turn in [0.2_f32, -0.9, 1.5, 3.5, -4.0, 100.0, -6_283_186.0, 1e7] {
        let mut odometry = Odometry::<f32>::new();
        odometry.advance(Twist::new(0.0, 0.0, turn));
        let apart = f64::from(odometry.pose().heading) - f64::from(turn);
        let whole = (apart / core::f64::consts::TAU).round() * core::f64::consts::TAU;
        assert!((apart - whole).abs() < BOUND, "{turn}: {apart}");
    }
}
