//! The counted functions. None is inlined, so that each has an address to watch.

use core::hint::black_box;

use control::compensation::{Coefficients, GridCompensation};
use control::quantity::{Acceleration, Rate, Time, Voltage};
use control::twist::{quantities, still};
use control::wheel::{Available, Gains, Held, WheelLoop, WheelReference};
use fixed::types::I16F16;
use kinematics::arithmetic::sin_cos;
use kinematics::{
    AxisTable, FixedPhaseMember, FixedSecant, FourWheelGeometry, MemberKinematics, Mount, Odometry,
    PhaseMember, Pose, RollerAngle, Secant, SpeedCompensation, Twist, VelocityCompensation,
    WheelRates, desaturate,
};

/// Inputs of every function.
const INPUTS: u32 = 64;

type Fixed = MemberKinematics<I16F16>;

#[inline(never)]
fn nothing(_: &MemberKinematics, _: &Twist, _: &mut WheelRates) {
    // A call of a function without any effect would be left out.
    black_box(());
}

#[inline(never)]
fn inverse(k: &MemberKinematics, twist: &Twist, out: &mut WheelRates) {
    *out = k.inverse(*twist);
}

#[inline(never)]
fn inverse_desaturated(k: &MemberKinematics, twist: &Twist, out: &mut WheelRates) {
    *out = desaturate(k.inverse(*twist), 12.0).0;
}

#[inline(never)]
fn forward(k: &MemberKinematics, rates: &WheelRates, out: &mut Twist) {
    *out = k.forward(rates);
}

#[inline(never)]
fn forward_odometry(k: &MemberKinematics, angles: &WheelRates, odometry: &mut Odometry) {
    odometry.advance_wheels(k, angles);
}

#[inline(never)]
fn wheel_loop(wheel: &mut WheelLoop, reference: &WheelReference, rate: Rate, out: &mut Voltage) {
    let tick = Available {
        voltage: const { Voltage::new(24.0) },
        dt: Time::from_micros(1_000),
    };
    *out = wheel.update(*reference, rate, tick, &mut Held::default());
}

#[inline(never)]
fn compensation(tables: &GridCompensation, twist: &Twist<Rate>, out: &mut Coefficients) {
    *out = tables.coefficients(*twist);
}

#[inline(never)]
fn sine_cosine(angle: &f32, out: &mut (f32, f32)) {
    *out = sin_cos(*angle);
}

#[inline(never)]
fn fixed_inverse(k: &Fixed, twist: &Twist<I16F16>, out: &mut WheelRates<I16F16>) {
    *out = k.inverse(*twist);
}

#[inline(never)]
fn fixed_forward(k: &Fixed, rates: &WheelRates<I16F16>, out: &mut Twist<I16F16>) {
    *out = k.forward(rates);
}

/// The secants of four wheels, which the tick computes once for all functions that need them.
#[inline(never)]
fn secants_phase(secant: &Secant, angles: &[RollerAngle; 4], out: &mut [f32; 4]) {
    *out = angles.map(|angle| secant.at(angle));
}

#[inline(never)]
fn inverse_phase(k: &PhaseMember, asked: &(Twist, [f32; 4]), out: &mut WheelRates) {
    *out = k.inverse(asked.0, &asked.1);
}

#[inline(never)]
fn forward_phase(k: &PhaseMember, seen: &(WheelRates, [f32; 4]), out: &mut (Twist, f32)) {
    *out = k.measure(&seen.0, &seen.1);
}

#[inline(never)]
fn fixed_secants_phase(secant: &FixedSecant, angles: &[RollerAngle; 4], out: &mut [i32; 4]) {
    *out = angles.map(|angle| secant.at(angle));
}

#[inline(never)]
fn fixed_inverse_phase(k: &FixedPhaseMember, asked: &(Twist, [i32; 4]), out: &mut WheelRates) {
    *out = k.inverse(asked.0, &asked.1);
}

#[inline(never)]
fn fixed_forward_phase(
    k: &FixedPhaseMember,
    seen: &(WheelRates, [i32; 4]),
    out: &mut (Twist, f32),
) {
    *out = k.measure(&seen.0, &seen.1);
}

/// Numbers from -1 to 1, the same ones every time (Numerical Recipes' generator).
struct Spread(u32);

impl Spread {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 8_388_608.0 - 1.0
    }

    fn angle(&mut self) -> RollerAngle {
        RollerAngle::from_bits((self.next() * 2_147_483_648.0) as i32)
    }

    fn twist(&mut self) -> Twist {
        Twist::new(2.0 * self.next(), 2.0 * self.next(), self.next())
    }
}

/// What computes with roller angles: single precision, then fixed point.
struct Rollers {
    single: (PhaseMember, Secant),
    fixed: (FixedPhaseMember, FixedSecant),
}

impl Rollers {
    fn new(
        geometry: &FourWheelGeometry,
        mount: &Mount,
        slip: &VelocityCompensation,
    ) -> Option<Self> {
        let secant = Secant::for_count(8).ok()?;
        let fixed = FixedPhaseMember::new(geometry, mount, slip).ok()?;
        Some(black_box(Self {
            single: (PhaseMember::new(geometry, mount, slip).ok()?, secant),
            fixed: (fixed, FixedSecant::new(&secant).ok()?),
        }))
    }

    fn calls(&self, twist: Twist, angles: &[RollerAngle; 4]) {
        let (mut rates, mut back) = (WheelRates::ZERO, (Twist::ZERO, 0.0));
        let (k, secant) = &self.single;
        let mut secants = [0.0; 4];
        secants_phase(secant, angles, black_box(&mut secants));
        inverse_phase(k, black_box(&(twist, secants)), black_box(&mut rates));
        forward_phase(k, black_box(&(rates, secants)), black_box(&mut back));
        let (k, secant) = &self.fixed;
        let mut secants = [0; 4];
        fixed_secants_phase(secant, angles, black_box(&mut secants));
        fixed_inverse_phase(k, black_box(&(twist, secants)), black_box(&mut rates));
        fixed_forward_phase(k, black_box(&(rates, secants)), black_box(&mut back));
    }
}

/// Calls everything with all inputs; gives up where the constants make no robot.
pub fn run() {
    let _ = calls().and_then(|()| crate::robot::run());
}

fn calls() -> Option<()> {
    let geometry =
        FourWheelGeometry::new(0.370, 0.350, 0.1524, core::f32::consts::FRAC_PI_4).ok()?;
    let mount = Mount::new(Pose::new(1.2, -0.4, 0.3)).ok()?;
    let slip = VelocityCompensation::new(1.002, 1.033, 1.0195).ok()?;
    let k = black_box(MemberKinematics::new(&geometry, &mount, &slip).ok()?);
    let fixed = black_box(k.convert::<I16F16>().ok()?);
    let axis = |rows| AxisTable::<3>::new(rows).ok();
    let mut tables = GridCompensation::from(&slip);
    tables.sample(&SpeedCompensation {
        longitudinal: axis(&[(0.1, 1.022), (0.3, 1.024), (0.5, 1.027)])?,
        lateral: axis(&[(0.1, 1.141), (0.3, 1.151), (0.5, 1.157)])?,
        yaw: axis(&[(0.2, 1.018), (0.5, 1.02), (1.0, 1.021)])?,
    });
    let tables = black_box(tables);
    let mut odometry = black_box(Odometry::new());
    let rollers = Rollers::new(&geometry, &mount, &slip)?;
    let mut wheel = black_box(WheelLoop::new(
        Gains {
            static_friction: 0.4,
            speed: 0.8,
            acceleration: 0.15,
            proportional: 1.0,
            integral: 10.0,
        },
        6.0,
    ));
    let mut spread = Spread(1);
    for _ in 0..INPUTS {
        let twist = black_box(spread.twist());
        let (mut rates, mut back, mut voltage) = (WheelRates::ZERO, Twist::ZERO, Voltage::ZERO);
        let mut circle = (0.0, 0.0);
        nothing(&k, &twist, black_box(&mut rates));
        inverse_desaturated(&k, &twist, black_box(&mut rates));
        inverse(&k, &twist, black_box(&mut rates));
        forward(&k, black_box(&rates), black_box(&mut back));
        let angles: [f32; 4] = rates.into();
        let angles = black_box(WheelRates::from(angles.map(|rate| rate * 1e-3)));
        forward_odometry(&k, &angles, black_box(&mut odometry));
        let reference = black_box(WheelReference {
            rate: Rate::new(rates.front_left),
            acceleration: Acceleration::new(20.0 * spread.next()),
        });
        let rate = black_box(Rate::new(rates.front_left + 0.2 * spread.next()));
        wheel_loop(
            black_box(&mut wheel),
            &reference,
            rate,
            black_box(&mut voltage),
        );
        let mut coefficients = tables.coefficients(still());
        let here = black_box(quantities(twist));
        compensation(&tables, &here, black_box(&mut coefficients));
        sine_cosine(black_box(&(3.0 * spread.next())), black_box(&mut circle));
        let narrow = black_box(twist.convert::<I16F16>());
        let mut fixed_rates = WheelRates::from([I16F16::ZERO; 4]);
        fixed_inverse(&fixed, &narrow, black_box(&mut fixed_rates));
        let mut fixed_back = narrow;
        fixed_forward(&fixed, black_box(&fixed_rates), black_box(&mut fixed_back));
        let angles = black_box([0; 4].map(|_| spread.angle()));
        rollers.calls(twist, &angles);
    }
    Some(())
}
