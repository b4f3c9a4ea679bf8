//! A second derivation, sharing nothing with the crate's: every wheel placed in the group, its
//! contact's velocity taken from rigid-body motion, and the two unknowns (wheel rate, roller rate)
//! solved from the two velocity components in the ground plane. The way back by orthogonalisation
//! instead of normal equations. Then the laws every such robot obeys, as properties.

use mecanum_kinematics::{
    FourWheelGeometry, MemberKinematics, Mount, Platform, Pose, Twist, VelocityCompensation, Wheel,
    WheelKinematics, WheelRates, desaturate,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Agreement asked of f64, relative to the size of the rates.
const F64: f64 = 1e-12;
/// Agreement asked of f32: its step is 1.2e-7, a rate is a sum of a few products, each rounded
/// three times.
const F32: f64 = 3e-6;

#[derive(Debug, Clone, Copy)]
struct Plan {
    x: f64,
    y: f64,
    mounting: f64,
    roller: f64,
    radius: f64,
}

type Vector = (f64, f64);

fn turn((x, y): Vector, angle: f64) -> Vector {
    (
        x * angle.cos() - y * angle.sin(),
        x * angle.sin() + y * angle.cos(),
    )
}

/// Rate of one wheel when the body it is fixed to moves like this, from the two ground-plane
/// components.
fn oracle_rate(wheel: Plan, [vx, vy, omega]: [f64; 3]) -> f64 {
    let hub = (vx - omega * wheel.y, vy + omega * wheel.x);
    let rolling = turn((1.0, 0.0), wheel.mounting);
    // The roller's axle is the wheel's axle turned by the roller angle; it rolls square to that.
    let axle = turn((0.0, 1.0), wheel.mounting + wheel.roller);
    let free = (axle.1, -axle.0);
    // hub = rate * radius * rolling + slide * free: Cramer.
    let determinant = rolling.0 * free.1 - rolling.1 * free.0;
    (hub.0 * free.1 - hub.1 * free.0) / determinant / wheel.radius
}

/// The motion of a member's own frame, compensated, when its group moves.
fn oracle_member(pose: [f64; 3], c: [f64; 3], [vx, vy, omega]: [f64; 3]) -> [f64; 3] {
    let [x, y, heading] = pose;
    let (ax, ay) = turn((vx - omega * y, vy + omega * x), -heading);
    [c[0] * ax, c[1] * ay, c[2] * omega]
}

/// Least squares by Gram and Schmidt: the twist whose rates are nearest, `columns[j][i]` being
/// wheel i's rate for unit motion j.
fn oracle_forward(columns: [Vec<f64>; 3], rates: &[f64]) -> [f64; 3] {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut base: Vec<Vec<f64>> = Vec::new();
    let mut r = [[0.0; 3]; 3];
    for (j, column) in columns.iter().enumerate() {
        let mut rest = column.clone();
        // Twice is enough.
        for _ in 0..2 {
            for (i, unit) in base.iter().enumerate() {
                let along = dot(unit, &rest);
                r[i][j] += along;
                rest.iter_mut().zip(unit).for_each(|(x, u)| *x -= along * u);
            }
        }
        r[j][j] = dot(&rest, &rest).sqrt();
        base.push(rest.iter().map(|x| x / r[j][j]).collect());
    }
    let mut twist = [0.0; 3];
    for j in (0..3).rev() {
        let known: f64 = (j + 1..3).map(|k| r[j][k] * twist[k]).sum();
        twist[j] = (dot(&base[j], rates) - known) / r[j][j];
    }
    twist
}

fn angle() -> impl Strategy<Value = f64> {
    -3.2..3.2
}

/// Roller angles of either handedness, not so small or large that the wheel is useless.
fn roller() -> impl Strategy<Value = f64> {
    (0.35..1.2, any::<bool>())
        .prop_map(|(angle, left): (f64, bool)| if left { angle } else { -angle })
}

prop_compose! {
    fn plan()(
        x in -0.8..0.8,
        y in -0.8..0.8,
        mounting in angle(),
        roller in roller(),
        radius in 0.05..0.3,
    ) -> Plan {
        Plan { x, y, mounting, roller, radius }
    }
}

fn twist() -> impl Strategy<Value = [f64; 3]> {
    [-2.0..2.0, -2.0..2.0, -2.0..2.0]
}

fn pose() -> impl Strategy<Value = [f64; 3]> {
    [-3.0..3.0, -3.0..3.0, -3.2..3.2]
}

fn coefficients() -> impl Strategy<Value = [f64; 3]> {
    [0.95..1.2, 0.95..1.2, 0.95..1.2]
}

fn robot() -> impl Strategy<Value = [f64; 4]> {
    [0.15..0.8, 0.15..0.8, 0.05..0.3, 0.4..1.2]
}

fn wheel(p: Plan) -> Wheel<f64> {
    Wheel::new(p.x, p.y, p.mounting, p.roller, p.radius).unwrap()
}

fn mount([x, y, heading]: [f64; 3]) -> Mount<f64> {
    Mount::new(Pose::new(x, y, heading)).unwrap()
}

fn compensation([x, y, w]: [f64; 3]) -> VelocityCompensation<f64> {
    VelocityCompensation::new(x, y, w).unwrap()
}

fn of([vx, vy, omega]: [f64; 3]) -> Twist<f64> {
    Twist::new(vx, vy, omega)
}

fn member(r: [f64; 4], at: [f64; 3], c: [f64; 3]) -> MemberKinematics<f64> {
    let [w, h, radius, gamma] = r;
    let geometry = FourWheelGeometry::new(w, h, radius, gamma).unwrap();
    MemberKinematics::new(&geometry, &mount(at), &compensation(c)).unwrap()
}

fn plans([w, h, radius, roller]: [f64; 4]) -> [Plan; 4] {
    [
        (h, w, roller),
        (h, -w, -roller),
        (-h, w, -roller),
        (-h, -w, roller),
    ]
    .map(|(x, y, roller)| Plan {
        x,
        y,
        mounting: 0.0,
        roller,
        radius,
    })
}

fn size(values: &[f64]) -> f64 {
    1.0 + values.iter().fold(0.0, |most: f64, v| most.max(v.abs()))
}

fn near(got: &[f64], want: &[f64], tolerance: f64) -> Result<(), TestCaseError> {
    for (got, want) in got.iter().zip(want) {
        prop_assert!(
            (got - want).abs() <= tolerance,
            "{got} is not {want}: {:e}",
            got - want
        );
    }
    Ok(())
}

fn three(t: Twist<f64>) -> [f64; 3] {
    [t.vx, t.vy, t.omega]
}

proptest! {
    #![proptest_config(ProptestConfig {
        // The same cases every time: a failure can be repeated.
        rng_seed: RngSeed::Fixed(2021),
        failure_persistence: None,
        ..ProptestConfig::with_cases(2000)
    })]

    #[test]
    fn any_wheel_agrees_with_the_oracle(p in plan(), t in twist()) {
        let [x, y, w] = wheel(p).jacobian_row();
        let want = oracle_rate(p, t);
        near(&[x * t[0] + y * t[1] + w * t[2]], &[want], F64 * size(&[want]))?;
        // A wheel mounted the other way round is the same wheel with its rate turned around.
        let around = Plan { mounting: p.mounting + std::f64::consts::PI, ..p };
        let [x, y, w] = wheel(around).reversed().jacobian_row();
        near(&[x * t[0] + y * t[1] + w * t[2]], &[want], F64 * size(&[want]))?;
    }

    #[test]
    fn members_agree_with_the_oracle(
        r in robot(),
        at in pose(),
        c in coefficients(),
        t in twist(),
    ) {
        let k = member(r, at, c);
        let asked = oracle_member(at, c, t);
        let want = plans(r).map(|p| oracle_rate(p, asked));
        let got: [f64; 4] = k.inverse(of(t)).into();
        near(&got, &want, F64 * size(&want))?;

        // f32, from f32 inputs: the oracle gets the same rounded inputs.
        let round = |v: f64| v as f32;
        let [w, h, radius, gamma] = r.map(round);
        let geometry = FourWheelGeometry::new(w, h, radius, gamma).unwrap();
        let [mx, my, mh] = at.map(round);
        let [cx, cy, cw] = c.map(round);
        let k = MemberKinematics::<f32>::new(
            &geometry,
            &Mount::new(Pose::new(mx, my, mh)).unwrap(),
            &VelocityCompensation::new(cx, cy, cw).unwrap(),
        ).unwrap();
        let t = t.map(round);
        let wide = |v: f32| f64::from(v);
        let asked = oracle_member(
            [mx, my, mh].map(wide), [cx, cy, cw].map(wide), t.map(wide),
        );
        let want = plans([w, h, radius, gamma].map(wide)).map(|p| oracle_rate(p, asked));
        let got: [f32; 4] = k.inverse(Twist::new(t[0], t[1], t[2])).into();
        // Relative to the largest rate any of the inputs alone could cause: they may cancel.
        let most = (t[0].abs() + t[1].abs() + t[2].abs() * 6.0) * 4.0 / radius;
        near(&got.map(wide), &want, F32 * f64::from(most))?;
    }

    #[test]
    fn forward_agrees_with_the_oracle(
        r in robot(),
        at in pose(),
        c in coefficients(),
        rates in [-20.0..20.0, -20.0..20.0, -20.0..20.0, -20.0..20.0],
    ) {
        let k = member(r, at, c);
        let column = |t: [f64; 3]| -> Vec<f64> {
            let asked = oracle_member(at, c, t);
            plans(r).map(|p| oracle_rate(p, asked)).to_vec()
        };
        let columns = [column([1.0, 0.0, 0.0]), column([0.0, 1.0, 0.0]), column([0.0, 0.0, 1.0])];
        let want = oracle_forward(columns, &rates);
        let got = three(k.forward(&WheelRates::from(rates)));
        near(&got, &want, F64 * size(&want))?;
        // What is left is what the residual says: Pythagoras.
        let explained: [f64; 4] = k.inverse(of(got)).into();
        let left: f64 = rates.iter().zip(explained).map(|(a, b)| (a - b) * (a - b)).sum();
        near(&[k.slip_residual(&WheelRates::from(rates)).abs()], &[left.sqrt()], 1e-10)?;
    }

    #[test]
    fn six_wheels_agree_with_the_oracle(
        ps in proptest::array::uniform6(plan()),
        at in pose(),
        c in coefficients(),
        t in twist(),
        rates in proptest::array::uniform6(-20.0..20.0),
    ) {
        let Ok(platform) = Platform::new(&ps.map(wheel)) else { return Ok(()); };
        let k = WheelKinematics::new(&platform, &mount(at), &compensation(c));
        let column = |t: [f64; 3]| -> Vec<f64> {
            let asked = oracle_member(at, c, t);
            ps.map(|p| oracle_rate(p, asked)).to_vec()
        };
        near(&k.inverse(of(t)), &column(t), F64 * size(&column(t)))?;
        let columns = [column([1.0, 0.0, 0.0]), column([0.0, 1.0, 0.0]), column([0.0, 0.0, 1.0])];
        let want = oracle_forward(columns, &rates);
        // Six wheels anywhere are conditioned up to 100 times worse than a robot; ten times the
        // tolerance suffices.
        near(&three(k.forward(&rates)), &want, 1e-11 * size(&want))?;
    }

    #[test]
    fn there_and_back_is_the_twist(r in robot(), at in pose(), c in coefficients(), t in twist()) {
        let k = member(r, at, c);
        let rates = k.inverse(of(t));
        near(&three(k.forward(&rates)), &t, F64 * 10.0)?;
        near(&[k.slip_residual(&rates)], &[0.0], 1e-10)?;
    }

    #[test]
    fn a_group_of_one_is_the_robot(r in robot(), c in coefficients(), t in twist()) {
        let one = member(r, [0.0; 3], c);
        let [w, h, radius, gamma] = r;
        let wheels = FourWheelGeometry::new(w, h, radius, gamma).unwrap().wheels().unwrap();
        let want = Platform::new(&wheels).unwrap().rates(compensation(c).apply(of(t)));
        let got: [f64; 4] = one.inverse(of(t)).into();
        near(&got, &want, F64 * size(&want))?;
    }

    #[test]
    fn the_choice_of_group_frame_does_not_matter(
        r in robot(),
        at in pose(),
        frame in pose(),
        c in coefficients(),
        t in twist(),
    ) {
        // The same member and the same motion, described in a group frame placed elsewhere.
        let whole = Pose::new(frame[0], frame[1], frame[2]);
        let inner = Pose::new(at[0], at[1], at[2]);
        let outer = whole.compose(inner);
        let seen = mount(frame).to_group(of(t));
        let want: [f64; 4] = member(r, at, c).inverse(of(t)).into();
        let got: [f64; 4] = member(r, [outer.x, outer.y, outer.heading], c).inverse(seen).into();
        near(&got, &want, 1e-11 * size(&want))?;
    }

    #[test]
    fn a_mirrored_robot_mirrors_the_motion(
        r in robot(),
        at in pose(),
        c in coefficients(),
        t in twist(),
    ) {
        let here = member(r, at, c).inverse(of(t));
        let there = member(r, [at[0], -at[1], -at[2]], c).inverse(of([t[0], -t[1], -t[2]]));
        let got = [there.front_right, there.front_left, there.rear_right, there.rear_left];
        let want: [f64; 4] = here.into();
        near(&got, &want, F64 * size(&want))?;
    }

    #[test]
    fn desaturate_scales_the_motion_and_nothing_else(
        r in robot(),
        at in pose(),
        t in twist(),
        limit in 0.1..30.0,
    ) {
        let k = member(r, at, [1.0; 3]);
        let (limited, scale) = desaturate(k.inverse(of(t)), limit);
        prop_assert!((0.0..=1.0).contains(&scale));
        near(&three(k.forward(&limited)), &t.map(|v| v * scale), 1e-10)?;
        let rates: [f64; 4] = limited.into();
        prop_assert!(rates.iter().all(|rate| rate.abs() <= limit * (1.0 + 1e-15)));
    }
}
