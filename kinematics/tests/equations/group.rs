//! (9) to (15) and (18) to (22): members of a group, and compensation.

use super::*;

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
    // Same heading: K = T(D, psi). Tandem psi = +-90 degrees adds -+D to the x row; side by side
    // psi = 0 and 180 adds +-D to the y row.
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
    // With no rotation the position in the group drops out and only the heading is left;
    // compensated or not.
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
