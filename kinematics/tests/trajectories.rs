//! Trajectories: derivatives against each other, closed forms, and the paper's numbers.

use mecanum_kinematics::paper;
use mecanum_kinematics::trajectory::{
    Acceleration, Circle, FigureEight, Harmonic, Heading, Line, MotionMode, PaperMotion, Ramped,
    Trajectory, step,
};
use std::f64::consts::{FRAC_PI_3, FRAC_PI_4, PI, TAU};

/// Velocity is the derivative of the pose, acceleration that of the velocity; by central
/// differences of 20 us.
fn derivatives_agree(motion: &dyn Trajectory<f64>) {
    let h = 1e-5;
    for i in 1..200 {
        let t = motion.duration() * f64::from(i) / 200.0;
        let (before, here, after) = (motion.sample(t - h), motion.sample(t), motion.sample(t + h));
        let d = |a: f64, b: f64| (b - a) / (2.0 * h);
        let pairs = [
            (here.twist.vx, d(before.pose.x, after.pose.x)),
            (here.twist.vy, d(before.pose.y, after.pose.y)),
            (here.twist.omega, d(before.pose.heading, after.pose.heading)),
            (here.acceleration.ax, d(before.twist.vx, after.twist.vx)),
            (here.acceleration.ay, d(before.twist.vy, after.twist.vy)),
            (
                here.acceleration.alpha,
                d(before.twist.omega, after.twist.omega),
            ),
        ];
        for (k, (got, want)) in pairs.into_iter().enumerate() {
            // Truncation h^2/6 of a third derivative of order 1, rounding 1e-16/h. Across a joint
            // of a ramp the acceleration's slope jumps, and half that jump times h is left.
            assert!(
                (got - want).abs() < 3e-5,
                "t {t}, {k}: {got} against {want}"
            );
        }
    }
}

#[test]
fn derivatives_of_all_eleven_motions_agree() {
    for mode in MotionMode::ALL {
        let motion: PaperMotion<f64> = mode.motion();
        derivatives_agree(&motion);
        derivatives_agree(&Ramped::new(motion, 2.0));
    }
}

#[test]
fn an_acceleration_that_is_not_given_is_found() {
    struct Plain(FigureEight<f64>);
    impl Trajectory<f64> for Plain {
        fn at(
            &self,
            time: f64,
        ) -> (
            mecanum_kinematics::Pose<f64>,
            mecanum_kinematics::Twist<f64>,
        ) {
            self.0.at(time)
        }
        fn duration(&self) -> f64 {
            self.0.duration()
        }
    }
    let eight = FigureEight::paper();
    for i in 0..40 {
        let t = f64::from(i) * 0.5;
        let (got, want) = (Plain(eight).acceleration(t), eight.acceleration(t));
        assert!((got.ax - want.ax).abs() + (got.ay - want.ay).abs() < 1e-6);
    }
}

#[test]
fn table_02_curves_in_the_papers_frame() {
    // x = r sin wt, y = r cos wt; x = l sin 2wt, y = l cos wt.
    let w = PI / 10.0;
    for i in 0..=80 {
        let t = f64::from(i) * 0.25;
        let (x, y) = paper::from_position(Circle::paper().at(t).0);
        assert!((x - 2.5 * (w * t).sin()).abs() < 1e-12 && (y - 2.5 * (w * t).cos()).abs() < 1e-12);
        let (x, y) = paper::from_position(FigureEight::paper().at(t).0);
        assert!((x - 2.5 * (2.0 * w * t).sin()).abs() < 1e-12);
        assert!((y - 2.5 * (w * t).cos()).abs() < 1e-12);
    }
}

#[test]
fn centripetal_motion_keeps_the_same_side_to_the_centre() {
    for (mode, side) in [
        (MotionMode::Centripetal, 0.0),
        (MotionMode::ObliqueCentripetal, FRAC_PI_4),
    ] {
        let motion: PaperMotion<f64> = mode.motion();
        assert!((motion.duration() - 10.0).abs() < 1e-12);
        let first = motion.sample(0.0).body_twist();
        for i in 0..=100 {
            let sample = motion.sample(f64::from(i) * 0.1);
            let outwards = sample.pose.y.atan2(sample.pose.x);
            let off = (sample.pose.heading - outwards - side) / TAU;
            assert!((off - off.round()).abs() < 1e-12);
            assert!((sample.pose.x.hypot(sample.pose.y) - 1.35).abs() < 1e-12);
            // In the robot's frame nothing changes: constant twist, constant acceleration inwards.
            let twist = sample.body_twist();
            assert!((twist.vx - first.vx).abs() + (twist.vy - first.vy).abs() < 1e-12);
            assert!((twist.omega + PI / 5.0).abs() < 1e-12);
            let Acceleration { ax, ay, .. } = sample.body_acceleration();
            let want = 1.35 * (PI / 5.0) * (PI / 5.0);
            assert!(
                (ax + want * side.cos()).abs() < 1e-12 && (ay - want * side.sin()).abs() < 1e-12
            );
        }
    }
}

#[test]
fn oblique_motions_hold_60_degrees_on_the_same_path() {
    for (oblique, plain) in [
        (MotionMode::ObliqueCircle, MotionMode::Circle),
        (MotionMode::ObliqueFigureEight, MotionMode::FigureEight),
    ] {
        let (oblique, plain) = (oblique.motion::<f64>(), plain.motion::<f64>());
        for i in 0..=20 {
            let t = f64::from(i);
            let ((a, v), (b, u)) = (oblique.at(t), plain.at(t));
            assert!((a.x, a.y, v) == (b.x, b.y, u));
            // Section 3.2.2: "maintaining a 60 degree angle during translating motion".
            assert!((a.heading - FRAC_PI_3).abs() < 1e-15);
        }
    }
}

#[test]
fn simple_motions_go_where_the_paper_goes() {
    let end = |mode: MotionMode| {
        let motion = mode.motion::<f64>();
        let (x, y) = paper::from_position(motion.at(motion.duration()).0);
        (x, y, motion.at(motion.duration()).0.heading)
    };
    // 500 mm/s for 10 s is 5000 mm, as in section 3.2 (1).
    assert_eq!(end(MotionMode::Longitudinal), (0.0, 5.0, 0.0));
    assert_eq!(end(MotionMode::Lateral), (5.0, 0.0, 0.0));
    assert_eq!(end(MotionMode::Oblique), (5.0, 5.0, 0.0));
    let (x, y, heading) = end(MotionMode::Turning);
    assert!(x == 0.0 && y == 0.0 && (heading - TAU).abs() < 1e-12);
    let (x, y, _) = end(MotionMode::Harmonic);
    assert!((x - 6.0).abs() < 1e-12 && y.abs() < 1e-12);
}

#[test]
fn arc_lengths_are_those_of_closed_forms() {
    assert!((Circle::<f64>::paper().arc_length() - TAU * 2.5).abs() < 1e-9);
    let line = Line {
        vx: 0.3,
        vy: -0.4,
        duration: 7.0,
    };
    assert!((Trajectory::<f64>::arc_length(&line) - 3.5).abs() < 1e-12);
    // Bending time does not change the way.
    let eight = FigureEight::<f64>::paper();
    let ramped = Ramped::new(eight, 2.0);
    assert!((ramped.arc_length() - eight.arc_length()).abs() < 1e-4);
    // A figure-eight by fine polygon, from below.
    let mut polygon = 0.0;
    for i in 0..100_000 {
        let at = |i: i32| paper::from_position(eight.at(f64::from(i) * 2e-4).0);
        let ((a, b), (c, d)) = (at(i), at(i + 1));
        polygon += (c - a).hypot(d - b);
    }
    assert!((eight.arc_length() - polygon).abs() < 1e-6);
    // A heading of its own does not change it either; f32 is good to its digits.
    let turned = Heading {
        path: Circle::<f32>::paper(),
        offset: 0.3,
        rate: 0.2,
    };
    assert!((turned.arc_length() - 15.708).abs() < 1e-3);
}

#[test]
fn step_is_the_cubic() {
    for (share, want) in [
        (-1.0, 0.0),
        (0.0, 0.0),
        (0.25, 0.15625),
        (0.5, 0.5),
        (1.0, 1.0),
        (2.0, 1.0),
    ] {
        assert_eq!(step(share), want);
    }
}

/// Largest accelerations along a motion, sampled finely.
fn most(motion: &impl Trajectory<f64>) -> (f64, f64) {
    (0..=20_000).fold((0.0, 0.0), |(linear, angular): (f64, f64), i| {
        let t = motion.duration() * f64::from(i) / 20_000.0;
        let Acceleration { ax, ay, alpha } = motion.acceleration(t);
        (linear.max(ax.hypot(ay)), angular.max(alpha.abs()))
    })
}

#[test]
fn ramps_respect_an_acceleration_limit() {
    // Friction allows 0.35 g cos 45 = 2.43 m/s2 on the paper's virtual robot.
    let eight = FigureEight::<f64>::paper();
    let ramped = Ramped::within(eight, 2.4, 1.0).unwrap();
    let (linear, _) = most(&ramped);
    assert!(linear <= 2.4 * 1.002, "{linear}");
    // Not longer than needed, and longer than the paper's 0.6 s, which would slip.
    let ramp = ramped.duration() - eight.duration();
    assert!(ramp > 0.6 && ramp < 2.0, "{ramp}");
    assert!(most(&Ramped::new(eight, 0.6)).0 > 2.4);
    // A turn is limited by its angular acceleration: 1.5 omega / ramp.
    let turn = MotionMode::Turning.motion::<f64>();
    let ramped = Ramped::within(turn, 1.0, 0.5).unwrap();
    let want = 1.5 * PI / 6.0 / 0.5;
    assert!(((ramped.duration() - 12.0) / want - 1.0).abs() < 0.02);
    // The figure-eight itself needs 0.99 m/s2 in its bends.
    assert!(Ramped::within(eight, 0.9, 1.0).is_none());
}

#[test]
fn ramps_bend_time_and_nothing_else() {
    let harmonic = Harmonic {
        amplitude: 1.0,
        speed: 0.3,
        frequency: 0.6,
        periods: 2.0,
    };
    let ramped = Ramped::new(harmonic, 1.5);
    for i in 0..=100 {
        let t = ramped.duration() * f64::from(i) / 100.0;
        let (inner, rate) = ramped.warp(t);
        assert_eq!(ramped.at(t).0, harmonic.at(inner).0);
        assert!((0.0..=1.0).contains(&rate));
    }
}
