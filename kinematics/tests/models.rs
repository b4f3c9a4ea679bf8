//! Every model of a member, through the one trait: the motions {straight, strafe, turn, mixed,
//! off-centre} there and back, and no slip where a rigid motion turns the wheels.

use mecanum_kinematics::{
    AxisTable, CompensatedMember, FixedMember, FixedPhaseMember, FixedSecant, FourWheelGeometry,
    Kinematics, MemberKinematics, Mount, PhaseMember, Pose, RollerAngle, Rollers, Secant,
    SpeedCompensation, Twist, VelocityCompensation,
};

/// The four rollers' places, a turn of a roller being 2^32: all different.
const PLACES: [i32; 4] = [0, 1 << 28, 1 << 29, 1 << 30];

const MOTIONS: [Twist; 4] = [
    Twist {
        vx: 0.5,
        vy: 0.0,
        omega: 0.0,
    },
    Twist {
        vx: 0.0,
        vy: -0.4,
        omega: 0.0,
    },
    Twist {
        vx: 0.0,
        vy: 0.0,
        omega: 0.6,
    },
    Twist {
        vx: 0.3,
        vy: 0.2,
        omega: -0.4,
    },
];

/// Largest difference (m/s, rad/s) there and back over all motions, and largest slip residual,
/// rad/s.
fn errors(model: &impl Kinematics<Scalar = f32>) -> (f32, f32) {
    MOTIONS
        .into_iter()
        .fold((0.0, 0.0), |(twist_error, slip), twist| {
            let rates = model.inverse(twist);
            let lost = model.forward(&rates) - twist;
            let here = lost.vx.abs().max(lost.vy.abs()).max(lost.omega.abs());
            (
                here.max(twist_error),
                model.slip_residual(&rates).abs().max(slip),
            )
        })
}

#[test]
fn every_model_undoes_its_own_inverse_and_sees_no_slip_in_it() {
    let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians()).unwrap();
    let slip = VelocityCompensation::new(1.002, 1.033, 1.0195).unwrap();
    let rollers = Rollers::<f32>::new(8).unwrap();
    let secant = Secant::new(Some(&rollers));
    let fixed_secant =
        FixedSecant::new(&Secant::new(Some(&Rollers::<f64>::new(8).unwrap()))).unwrap();
    let table = |slow, fast| AxisTable::new(&[(0.1, slow), (0.5, fast)]).unwrap();
    let by_speed = SpeedCompensation {
        longitudinal: table(1.022, 1.027),
        lateral: table(1.141, 1.157),
        yaw: table(1.025, 1.026),
    };
    for mount in [
        Mount::IDENTITY,
        Mount::new(Pose::new(1.2, -0.3, 0.5)).unwrap(),
    ] {
        let single = MemberKinematics::new(&robot, &mount, &slip).unwrap();
        let by_phase = PhaseMember::new(&robot, &mount, &slip).unwrap();
        let by_phase = by_phase.at(PLACES.map(|at| secant.at(RollerAngle::from_bits(at))));
        let fixed = FixedMember::new(&robot, &mount, &slip).unwrap();
        let fixed_phase = FixedPhaseMember::new(&robot, &mount, &slip).unwrap();
        let fixed_phase =
            fixed_phase.at(PLACES.map(|at| fixed_secant.at(RollerAngle::from_bits(at))));
        let tables = CompensatedMember::new(&robot, &mount, by_speed).unwrap();
        // Rounding of f32: eight products of numbers up to 10 each way, of which each loses 2^-24.
        // Of a step of 2^-16 rad/s: four wheels of 0.15 m, over a lever of 0.72 m for the yaw rate;
        // the phase's fixed point has wheel rates in steps of 2^-11 at worst. A table's inversion
        // stops at 1e-6 of the coefficient.
        let (float, step, coarse) = (5e-6, 6e-5, 1e-3);
        for (name, (twist, residual), bound) in [
            ("f32", errors(&single), float),
            ("f32 by phase", errors(&by_phase), float),
            ("fixed", errors(&fixed), step),
            ("fixed by phase", errors(&fixed_phase), coarse),
            ("by speed", errors(&tables), float),
        ] {
            assert!(twist < bound, "{name}: {twist} lost there and back");
            assert!(residual < bound / 0.15, "{name}: {residual} rad/s of slip");
        }
    }
}
