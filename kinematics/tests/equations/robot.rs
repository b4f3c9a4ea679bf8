//! (1) to (8): one wheel, one robot.

use super::*;

#[test]
fn eq_01_both_lines_hold_with_the_rate_of_the_general_wheel() {
    for p in odd_wheels() {
        for twist in TWISTS {
            let phi = -rate(&wheel_of(p), paper::to_twist(twist));
            let (_, v) = paper::eq_01(p, twist);
            let a = p.alpha + p.beta;
            close(
                twist.x * a.sin() - twist.y * a.cos() - p.l * twist.theta * p.beta.cos(),
                p.radius * phi - v * p.gamma.cos(),
                "rolling",
            );
            close(
                twist.x * a.cos() + twist.y * a.sin() + p.l * twist.theta * p.beta.sin(),
                -v * p.gamma.sin(),
                "sliding",
            );
        }
    }
}

#[test]
fn eq_02_constraint_without_the_roller_speed() {
    for p in odd_wheels() {
        for twist in TWISTS {
            let phi = -rate(&wheel_of(p), paper::to_twist(twist));
            let sum = p.alpha + p.beta + p.gamma;
            close(
                twist.x * sum.cos()
                    + twist.y * sum.sin()
                    + p.l * twist.theta * (p.beta + p.gamma).sin(),
                -p.radius * phi * p.gamma.sin(),
                "constraint",
            );
        }
    }
}

#[test]
fn eq_03_row_of_any_wheel() {
    for p in odd_wheels() {
        for twist in TWISTS {
            close(
                -rate(&wheel_of(p), paper::to_twist(twist)),
                paper::times(paper::eq_03(p), twist),
                "row",
            );
        }
    }
}

#[test]
fn eq_04_world_velocity() {
    for p in odd_wheels() {
        for theta in [0.4, -2.9] {
            for world in TWISTS {
                let body = paper::to_twist(world).to_body(theta);
                let want = paper::times(
                    paper::eq_03(p),
                    paper::transform(paper::rotation(theta), world),
                );
                close(-rate(&wheel_of(p), body), want, "world");
            }
        }
    }
}

#[test]
fn eq_05_row_with_the_axle_across() {
    // -(1/r) [cot g, 1, X - Y cot g] with (X, Y) the wheel's centre.
    for deg in ANGLES_DEG {
        for p in paper_wheels(&virtual_robot(deg)) {
            let (x, y) = (p.l * p.alpha.cos(), p.l * p.alpha.sin());
            let cot = 1.0 / p.gamma.tan();
            let want = [cot, 1.0, x - y * cot].map(|v| -v / p.radius);
            for (got, want) in paper::eq_03(p).into_iter().zip(want) {
                close(got, want, "row");
            }
        }
    }
}

#[test]
fn eq_06_inverse_for_any_roller_angle() {
    for deg in ANGLES_DEG {
        let robot = virtual_robot(deg);
        let k = MemberKinematics::new(&robot, &alone(), &no_compensation()).unwrap();
        for twist in TWISTS {
            let want = paper::eq_06(&robot).map(|row| paper::times(row, twist));
            let got = paper::from_rates(k.inverse(paper::to_twist(twist)));
            close_all(got, want, "inverse");
        }
    }
}

#[test]
fn eq_06_signs_of_the_axes() {
    // +y (-,-,-,-), +x (+,-,+,-), +heading (-,+,+,-), read from the printed matrix.
    for deg in ANGLES_DEG {
        let k = MemberKinematics::new(&virtual_robot(deg), &alone(), &no_compensation()).unwrap();
        for (axis, want) in [
            (
                PaperTwist {
                    x: 0.0,
                    y: 1.0,
                    theta: 0.0,
                },
                [-1.0, -1.0, -1.0, -1.0],
            ),
            (
                PaperTwist {
                    x: 1.0,
                    y: 0.0,
                    theta: 0.0,
                },
                [1.0, -1.0, 1.0, -1.0],
            ),
            (
                PaperTwist {
                    x: 0.0,
                    y: 0.0,
                    theta: 1.0,
                },
                [-1.0, 1.0, 1.0, -1.0],
            ),
        ] {
            let got = paper::from_rates(k.inverse(paper::to_twist(axis))).map(f64::signum);
            assert_eq!(got, want);
        }
    }
}

#[test]
fn eq_07_jacobian_at_45_degrees() {
    // W + H = 0.720 m, r = 0.1524 m: 1/r = 6.561 680, (W + H)/r = 4.724 409.
    let (a, b) = (1.0 / 0.1524, 0.720 / 0.1524);
    let want = [[a, -a, -b], [-a, -a, b], [a, -a, b], [-a, -a, -b]];
    let robot = virtual_robot(45.0);
    for (got, want) in paper::eq_06(&robot).into_iter().zip(want) {
        for (got, want) in got.into_iter().zip(want) {
            close(got, want, "entry");
        }
    }
    // Forward at 0.5 m/s: every wheel at 3.280 840 rad/s, positive here.
    let k = MemberKinematics::new(&robot, &alone(), &no_compensation()).unwrap();
    let rates: [f64; 4] = k.inverse(Twist::new(0.5, 0.0, 0.0)).into();
    for rate in rates {
        assert!((rate - 3.280_840).abs() < 1e-6);
    }
}

#[test]
fn eq_08_world_velocity_of_the_four_wheel_robot() {
    for deg in ANGLES_DEG {
        let robot = virtual_robot(deg);
        let k = MemberKinematics::new(&robot, &alone(), &no_compensation()).unwrap();
        for theta in [0.0, 1.3, -2.2] {
            for world in TWISTS {
                let body = paper::transform(paper::rotation(theta), world);
                let want = paper::eq_06(&robot).map(|row| paper::times(row, body));
                let got = k.inverse(paper::to_twist(world).to_body(theta));
                close_all(paper::from_rates(got), want, "world");
            }
        }
    }
}
