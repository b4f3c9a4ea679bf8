//! One test per equation of the paper, named for it.
//!
//! The expected values are the paper's own forms, or numbers worked out from them by hand, in its own frame; the
//! crate's are computed in REP-103 and brought over. W differs from H, and roller angles other than 45 degrees are
//! always among the cases: at 45 degrees the two ways of measuring a roller angle cannot be told apart.

use kinematics::paper::{self, PaperTwist, PaperWheel};
use kinematics::{
    FourWheelGeometry, MemberKinematics, Mount, Platform, Pose, Twist, VelocityCompensation, Wheel,
    WheelRates, roller_angle_correction,
};
use mecanum_kinematics as kinematics;

/// Rounding of a few operations on numbers up to ten, f64.
const F64: f64 = 1e-12;
/// The same in f32.
const F32: f32 = 1e-5;

const ANGLES_DEG: [f64; 4] = [45.0, 30.0, 60.0, 38.5];

const TWISTS: [PaperTwist<f64>; 6] = [
    PaperTwist {
        x: 0.5,
        y: 0.0,
        theta: 0.0,
    },
    PaperTwist {
        x: 0.0,
        y: 0.5,
        theta: 0.0,
    },
    PaperTwist {
        x: 0.0,
        y: 0.0,
        theta: 0.7,
    },
    PaperTwist {
        x: 0.3,
        y: -0.4,
        theta: 0.0,
    },
    PaperTwist {
        x: -0.2,
        y: 0.1,
        theta: 0.9,
    },
    PaperTwist {
        x: 0.25,
        y: 0.35,
        theta: -0.6,
    },
];

fn virtual_robot(angle_deg: f64) -> FourWheelGeometry<f64> {
    FourWheelGeometry::new(0.370, 0.350, 0.1524, angle_deg.to_radians()).unwrap()
}

/// The four wheels as the paper's Figure 1 describes them: alpha + beta = 0.
fn paper_wheels(geometry: &FourWheelGeometry<f64>) -> [PaperWheel<f64>; 4] {
    let (w, h) = (geometry.half_track(), geometry.half_wheelbase());
    let g = geometry.roller_angle();
    [(w, h, -g), (-w, h, g), (-w, -h, -g), (w, -h, g)].map(|(x, y, gamma): (f64, f64, f64)| {
        let alpha = y.atan2(x);
        PaperWheel {
            l: x.hypot(y),
            alpha,
            beta: -alpha,
            gamma,
            radius: geometry.wheel_radius(),
        }
    })
}

/// The same wheel in this crate's terms: x forward is the paper's y.
fn wheel_of(p: PaperWheel<f64>) -> Wheel<f64> {
    let (x, y) = (p.l * p.alpha.cos(), p.l * p.alpha.sin());
    Wheel::new(y, -x, p.alpha + p.beta, p.gamma, p.radius).unwrap()
}

fn rate(wheel: &Wheel<f64>, twist: Twist<f64>) -> f64 {
    let [x, y, w] = wheel.jacobian_row();
    x * twist.vx + y * twist.vy + w * twist.omega
}

fn no_compensation() -> VelocityCompensation<f64> {
    VelocityCompensation::new(1.0, 1.0, 1.0).unwrap()
}

fn alone() -> Mount<f64> {
    Mount::new(Pose::new(0.0, 0.0, 0.0)).unwrap()
}

fn close(got: f64, want: f64, what: &str) {
    assert!((got - want).abs() <= F64, "{what}: got {got}, want {want}");
}

fn close_all(got: [f64; 4], want: [f64; 4], what: &str) {
    for (i, (got, want)) in got.into_iter().zip(want).enumerate() {
        close(got, want, &format!("{what}, wheel {}", i + 1));
    }
}

/// Wheels anywhere, at any attitude.
fn odd_wheels() -> Vec<PaperWheel<f64>> {
    let mut wheels = Vec::new();
    for alpha in [0.3, 1.9, -2.4] {
        for beta in [0.0, -0.3, 1.1] {
            for gamma in [std::f64::consts::FRAC_PI_4, -0.6, 1.2] {
                wheels.push(PaperWheel {
                    l: 0.61,
                    alpha,
                    beta,
                    gamma,
                    radius: 0.09,
                });
            }
        }
    }
    wheels
}

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

/// Members as the paper places them: heading delta, distance D, bearing psi.
const PLACES: [(f64, f64, f64); 4] = [
    (0.0, 1.2, std::f64::consts::FRAC_PI_2),
    (0.0, 0.9, 0.0),
    (0.523_598_775_598_298_8, 1.5, 2.1),
    (-1.1, 0.7, -0.4),
];

/// The same place as a mount: (right, forward) becomes (forward, left).
fn mount_of((delta, distance, psi): (f64, f64, f64)) -> Mount<f64> {
    Mount::new(Pose::new(
        distance * psi.sin(),
        -distance * psi.cos(),
        delta,
    ))
    .unwrap()
}

#[test]
fn eq_10_member_of_a_group() {
    for deg in ANGLES_DEG {
        let robot = virtual_robot(deg);
        for place in PLACES {
            let k = MemberKinematics::new(&robot, &mount_of(place), &no_compensation()).unwrap();
            let (delta, d, psi) = place;
            for group in TWISTS {
                let member = paper::transform(paper::eq_11(delta, d, psi), group);
                let want = paper::eq_06(&robot).map(|row| paper::times(row, member));
                let got = paper::from_rates(k.inverse(paper::to_twist(group)));
                close_all(got, want, "member");
            }
        }
    }
}

#[test]
fn eq_11_mount_matrix() {
    for place in PLACES {
        let (delta, d, psi) = place;
        let mount = mount_of(place);
        for group in TWISTS {
            let want = paper::transform(paper::eq_11(delta, d, psi), group);
            let got = paper::from_twist(mount.to_member(paper::to_twist(group)));
            close(got.x, want.x, "x");
            close(got.y, want.y, "y");
            close(got.theta, want.theta, "theta");
            let back = paper::from_twist(mount.to_group(mount.to_member(paper::to_twist(group))));
            close(back.x, group.x, "x back");
            close(back.y, group.y, "y back");
            close(back.theta, group.theta, "theta back");
        }
    }
}

#[test]
fn eq_11_is_rotation_times_translation() {
    // The printed product of R(delta) and T(D, psi), multiplied out here.
    for (delta, d, psi) in PLACES {
        let t = [
            [1.0, 0.0, -d * psi.sin()],
            [0.0, 1.0, d * psi.cos()],
            [0.0, 0.0, 1.0],
        ];
        for twist in TWISTS {
            let want = paper::transform(paper::rotation(delta), paper::transform(t, twist));
            let got = paper::transform(paper::eq_11(delta, d, psi), twist);
            close(got.x, want.x, "x");
            close(got.y, want.y, "y");
        }
    }
}

#[test]
fn eq_13_whole_group_in_the_world() {
    let robot = virtual_robot(38.5);
    for theta in [0.8, -1.7] {
        for world in TWISTS {
            for place in PLACES {
                let k =
                    MemberKinematics::new(&robot, &mount_of(place), &no_compensation()).unwrap();
                let (delta, d, psi) = place;
                let group = paper::transform(paper::rotation(theta), world);
                let member = paper::transform(paper::eq_11(delta, d, psi), group);
                let want = paper::eq_06(&robot).map(|row| paper::times(row, member));
                let got = k.inverse(paper::to_twist(world).to_body(theta));
                close_all(paper::from_rates(got), want, "group");
            }
        }
    }
}

#[test]
fn eq_15_tandem_and_side_by_side() {
    // Same heading: K = T(D, psi). Tandem psi = +-90 degrees adds -+D to the x row; side by side psi = 0 and
    // 180 adds +-D to the y row.
    let robot = virtual_robot(45.0);
    let d = 1.1;
    for (mount, lever) in [
        (
            Pose::new(d, 0.0, 0.0),
            PaperTwist {
                x: -d,
                y: 0.0,
                theta: 0.0,
            },
        ),
        (
            Pose::new(-d, 0.0, 0.0),
            PaperTwist {
                x: d,
                y: 0.0,
                theta: 0.0,
            },
        ),
        (
            Pose::new(0.0, -d, 0.0),
            PaperTwist {
                x: 0.0,
                y: d,
                theta: 0.0,
            },
        ),
        (
            Pose::new(0.0, d, 0.0),
            PaperTwist {
                x: 0.0,
                y: -d,
                theta: 0.0,
            },
        ),
    ] {
        let k =
            MemberKinematics::new(&robot, &Mount::new(mount).unwrap(), &no_compensation()).unwrap();
        for group in TWISTS {
            let member = PaperTwist {
                x: group.x + lever.x * group.theta,
                y: group.y + lever.y * group.theta,
                theta: group.theta,
            };
            let want = paper::eq_06(&robot).map(|row| paper::times(row, member));
            let got = paper::from_rates(k.inverse(paper::to_twist(group)));
            close_all(got, want, "tandem");
        }
    }
}

/// C2 of the paper: lateral 1.04, longitudinal 1.002, yaw 1.0195.
fn c2() -> VelocityCompensation<f64> {
    VelocityCompensation::new(1.002, 1.04, 1.0195).unwrap()
}

#[test]
fn eq_18_compensation_matrix() {
    let want = paper::eq_18(1.04, 1.002, 1.0195);
    for twist in TWISTS {
        let want = paper::transform(want, twist);
        let got = paper::from_twist(c2().apply(paper::to_twist(twist)));
        close(got.x, want.x, "lateral");
        close(got.y, want.y, "longitudinal");
        close(got.theta, want.theta, "yaw");
        let back = paper::from_twist(c2().remove(c2().apply(paper::to_twist(twist))));
        close(back.x, twist.x, "lateral back");
    }
}

#[test]
fn eq_19_compensated_member() {
    for deg in ANGLES_DEG {
        let robot = virtual_robot(deg);
        for place in PLACES {
            let k = MemberKinematics::new(&robot, &mount_of(place), &c2()).unwrap();
            let (delta, d, psi) = place;
            for theta in [0.0, 2.1] {
                for world in TWISTS {
                    let group = paper::transform(paper::rotation(theta), world);
                    let member = paper::transform(paper::eq_11(delta, d, psi), group);
                    let asked = paper::transform(paper::eq_18(1.04, 1.002, 1.0195), member);
                    let want = paper::eq_06(&robot).map(|row| paper::times(row, asked));
                    let got = k.inverse(paper::to_twist(world).to_body(theta));
                    close_all(paper::from_rates(got), want, "compensated");
                }
            }
        }
    }
}

#[test]
fn eq_20_compensated_group_of_different_members() {
    let members = [
        (virtual_robot(45.0), PLACES[0], (1.002, 1.033, 1.0195)),
        (virtual_robot(30.0), PLACES[2], (1.023, 1.151, 1.0255)),
    ];
    for world in TWISTS {
        let group = paper::transform(paper::rotation(0.6), world);
        for (robot, place, (g, f, u)) in members {
            let c = VelocityCompensation::new(g, f, u).unwrap();
            let k = MemberKinematics::new(&robot, &mount_of(place), &c).unwrap();
            let (delta, d, psi) = place;
            let member = paper::transform(paper::eq_11(delta, d, psi), group);
            let asked = paper::transform(paper::eq_18(f, g, u), member);
            let want = paper::eq_06(&robot).map(|row| paper::times(row, asked));
            let got = k.inverse(paper::to_twist(world).to_body(0.6));
            close_all(paper::from_rates(got), want, "member");
        }
    }
}

#[test]
fn eq_19_forward_takes_back_the_same_product() {
    for deg in ANGLES_DEG {
        for place in PLACES {
            let k = MemberKinematics::new(&virtual_robot(deg), &mount_of(place), &c2()).unwrap();
            for group in TWISTS {
                let group = paper::to_twist(group);
                let rates = k.inverse(group);
                let back = k.forward(&rates);
                close(back.vx, group.vx, "vx");
                close(back.vy, group.vy, "vy");
                close(back.omega, group.omega, "omega");
                close(k.slip_residual(&rates), 0.0, "residual");
            }
        }
    }
}

#[test]
fn eq_19_in_single_precision() {
    let g = FourWheelGeometry::new(0.370, 0.350, 0.1524, 38.5_f32.to_radians()).unwrap();
    let mount = Mount::new(Pose {
        x: 0.4,
        y: -1.2,
        heading: 0.5,
    })
    .unwrap();
    let c = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let k = MemberKinematics::new(&g, &mount, &c).unwrap();
    let twist = Twist {
        vx: 0.5,
        vy: -0.3,
        omega: 0.7,
    };
    let back = k.forward(&k.inverse(twist));
    assert!((back.vx - twist.vx).abs() < F32);
    assert!((back.vy - twist.vy).abs() < F32);
    assert!((back.omega - twist.omega).abs() < F32);
    // One wheel alone turning is half explained on the symmetric robot's slip direction.
    let slip = k.slip_residual(&WheelRates {
        front_left: 1.0,
        ..WheelRates::ZERO
    });
    assert!((slip - 0.5).abs() < F32);
}

#[test]
fn eq_09_each_member_in_its_own_frame() {
    // Phi_j = J_j zeta_j: a member alone, whatever group it is in.
    for deg in ANGLES_DEG {
        let robot = virtual_robot(deg);
        let platform = Platform::new(&robot.wheels().unwrap()).unwrap();
        for twist in TWISTS {
            let want = paper::eq_06(&robot).map(|row| paper::times(row, twist));
            let rates = WheelRates::from(platform.rates(paper::to_twist(twist)));
            close_all(paper::from_rates(rates), want, "member");
        }
    }
}

#[test]
fn eq_12_member_in_the_world() {
    let robot = virtual_robot(60.0);
    for place in PLACES {
        let (delta, d, psi) = place;
        let k = MemberKinematics::new(&robot, &mount_of(place), &no_compensation()).unwrap();
        for theta in [0.3, -2.0] {
            for world in TWISTS {
                let group = paper::transform(paper::rotation(theta), world);
                let member = paper::transform(paper::eq_11(delta, d, psi), group);
                let want = paper::eq_06(&robot).map(|row| paper::times(row, member));
                let got = k.inverse(paper::to_twist(world).to_body(theta));
                close_all(paper::from_rates(got), want, "world");
            }
        }
    }
}

#[test]
fn eq_14_and_eq_21_translation_does_not_feel_the_lever() {
    // With no rotation the position in the group drops out and only the heading is left; compensated or not.
    let robot = virtual_robot(38.5);
    for c in [no_compensation(), c2()] {
        for (delta, distance, psi) in PLACES {
            let here = mount_of((delta, distance, psi));
            let centre = mount_of((delta, 0.0, 0.0));
            let k = MemberKinematics::new(&robot, &here, &c).unwrap();
            let alone = MemberKinematics::new(&robot, &centre, &c).unwrap();
            let twist = Twist::translation(0.35, -0.25);
            let want = paper::from_rates(alone.inverse(twist));
            close_all(paper::from_rates(k.inverse(twist)), want, "translation");
            // And as printed: J C K times (x, y, 0).
            let member = paper::transform(
                paper::eq_11(delta, distance, psi),
                PaperTwist {
                    x: 0.25,
                    y: 0.35,
                    theta: 0.0,
                },
            );
            let asked =
                paper::transform(paper::eq_18(c.lateral(), c.longitudinal(), c.yaw()), member);
            let want = paper::eq_06(&robot).map(|row| paper::times(row, asked));
            close_all(paper::from_rates(k.inverse(twist)), want, "printed");
        }
    }
}

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
    // The exact answer is a robot built with the measured angles; the correction misses it by second order only.
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

#[test]
fn eq_22_compensated_robot_in_the_world() {
    // Printed with second derivatives; they are first derivatives.
    let robot = virtual_robot(45.0);
    let k = MemberKinematics::new(&robot, &alone(), &c2()).unwrap();
    for theta in [0.0, 0.9, -2.4] {
        for world in TWISTS {
            let body = paper::transform(paper::rotation(theta), world);
            let asked = paper::transform(paper::eq_18(1.04, 1.002, 1.0195), body);
            let want = paper::eq_06(&robot).map(|row| paper::times(row, asked));
            let got = k.inverse(paper::to_twist(world).to_body(theta));
            close_all(paper::from_rates(got), want, "world");
        }
    }
}
