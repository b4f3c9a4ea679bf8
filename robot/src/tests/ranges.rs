//! Random parameters over all that the table accepts: a robot refuses those it cannot use by name;
//! with the others it drives as `f64` computes it, and no number overflows.

use control::interface::{Command, Inputs, Mode};
use control::quantity::InputVoltage;
use control::tick::ControlSide;
use control::time::{Micros, TICK_US};
use kinematics::{FourWheelGeometry, Mount, Pose, Twist, VelocityCompensation};
use protocol::address::{self as at, motor};
use protocol::{Address, Value, entry};
use std::vec::Vec;

use super::world::{ANY_DRIVES, configuration as usual};
use crate::configuration::{ConfigurationError, build};
use crate::parameters::Parameters;

/// What the numbers of a tick follow from.
const VARIED: [Address; 22] = [
    at::HALF_TRACK,
    at::HALF_WHEELBASE,
    at::WHEEL_RADIUS,
    at::ROLLER_ANGLE,
    at::MOUNT_X,
    at::MOUNT_Y,
    at::MOUNT_HEADING,
    at::COMPENSATION_LONGITUDINAL,
    at::COMPENSATION_LATERAL,
    at::COMPENSATION_YAW,
    at::ENCODER_COUNTS,
    at::GEAR_RATIO,
    at::OBSERVER_BANDWIDTH,
    at::WHEEL_RATE_MAX,
    at::ACCELERATION,
    at::ACCELERATION_YAW,
    at::JERK,
    at::JERK_YAW,
    motor::speed(0),
    motor::acceleration(1),
    motor::proportional(2),
    motor::integral(3),
];

/// Largest setpoint on each axis (docs/numbers.md), m/s and rad/s.
const SETPOINT: f32 = 3.3;

/// Numerical Recipes' generator.
struct Random(u32);

impl Random {
    /// From 0 to 1.
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 16_777_216.0
    }

    fn below(&mut self, count: usize) -> usize {
        ((self.next() * count as f32) as usize).min(count - 1)
    }

    /// A value that the table accepts: an end of the range, or between the ends, by its logarithm
    /// where all are positive.
    fn value(&mut self, address: Address) -> f32 {
        let entry = entry(address).unwrap();
        let (Value::F32(least), Value::F32(most)) = (entry.min(), entry.max()) else {
            panic!("{address:?} is no real");
        };
        match self.below(8) {
            0 => least,
            1 => most,
            _ if least > 0.0 => (least * (most / least).powf(self.next())).clamp(least, most),
            _ => least + (most - least) * self.next(),
        }
    }
}

/// The table's parameters of a usual robot.
fn parameters(values: &[(Address, Value)]) -> Parameters {
    let mut parameters = Parameters::new();
    for (address, value) in values {
        parameters.set(entry(*address).unwrap().slot().unwrap(), *value);
    }
    parameters
}

/// A robot's kinematics in double precision.
struct Wide {
    geometry: FourWheelGeometry<f64>,
    mount: Pose<f64>,
    coefficients: [f64; 3],
}

impl Wide {
    fn of(parameters: &Parameters) -> Self {
        let real = |address| f64::from(parameters.real(address));
        Self {
            geometry: FourWheelGeometry::new(
                real(at::HALF_TRACK),
                real(at::HALF_WHEELBASE),
                real(at::WHEEL_RADIUS),
                real(at::ROLLER_ANGLE),
            )
            .unwrap(),
            mount: Pose {
                x: real(at::MOUNT_X),
                y: real(at::MOUNT_Y),
                heading: real(at::MOUNT_HEADING),
            },
            coefficients: [
                real(at::COMPENSATION_LONGITUDINAL),
                real(at::COMPENSATION_LATERAL),
                real(at::COMPENSATION_YAW),
            ],
        }
    }

    /// The wheels' rates.
    fn rates(&self, group: Twist<f64>) -> [f64; 4] {
        let [x, y, w] = self.coefficients;
        let compensation = VelocityCompensation::new(x, y, w).unwrap();
        let mount = Mount::new(self.mount).unwrap();
        kinematics::MemberKinematics::new(&self.geometry, &mount, &compensation)
            .unwrap()
            .inverse(group)
            .into()
    }

    /// The largest that a wheel turns by a unit of each axis of the robot, rad/m and 1.
    fn rows(&self) -> [f64; 3] {
        let alone = Self {
            mount: Pose {
                x: 0.0,
                y: 0.0,
                heading: 0.0,
            },
            coefficients: [1.0; 3],
            ..*self
        };
        [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)].map(|(vx, vy, omega)| {
            let rates = alone.rates(Twist { vx, vy, omega });
            rates.into_iter().map(f64::abs).fold(0.0, f64::max)
        })
    }

    /// The sizes of what is added up on each axis, for group velocities or accelerations of this
    /// size.
    fn sizes(&self, linear: f64, yaw: f64) -> [f64; 3] {
        let [x, y, w] = self.coefficients;
        let carried = 2.0 * linear + yaw * (self.mount.x.abs() + self.mount.y.abs());
        [carried * x, carried * y, yaw * w]
    }
}

/// How far a rate may be off, rad/s: one step of each axis of the group's twist, which its velocity
/// loses as a rate, and four of each axis of the robot's, times the row; half a step of the row's
/// entries; one step of the result; and 2e-6 of all that is added up, in which the matrix itself is
/// single precision. A float has the last alone.
fn bound(wide: &Wide, twist: Twist<f64>) -> f64 {
    let linear = twist.vx.abs().max(twist.vy.abs());
    let sizes = wide.sizes(linear, twist.omega.abs());
    let rows = wide.rows();
    let of_floats: f64 = rows.iter().zip(sizes).map(|(row, size)| row * size).sum();
    let of_floats = 2e-6 * of_floats;
    if !cfg!(feature = "fixed-point") {
        return of_floats;
    }
    let step = 2.0_f64.powi(-23);
    let lost = wide.sizes(step, step);
    let member = rows
        .iter()
        .zip(lost)
        .map(|(row, lost)| row * (lost + 4.0 * step));
    let member: f64 = member.sum();
    let entries: f64 = sizes.iter().map(|size| size * 2.0_f64.powi(-21)).sum();
    step + member + entries + of_floats
}

/// Drives a robot whose wheels follow exactly to the fastest that they may, for a tenth of a
/// second; compares every reference, and returns the ticks that did not fit.
fn drive(parameters: &Parameters, twist: Twist) -> u32 {
    let configuration = build(parameters, 2, ANY_DRIVES).unwrap();
    let wide = Wide::of(parameters);
    let counts = f64::from(parameters.real(at::ENCODER_COUNTS) * parameters.real(at::GEAR_RATIO));
    let mut side = ControlSide::new();
    side.configure(&configuration);
    let mut turns = [0.0_f64; 4];
    for number in 0..100_u16 {
        let now = Micros(u64::from(number) * u64::from(TICK_US));
        let update = number / 10;
        let command = Command {
            mode: Mode::Follow,
            twist_cmd: twist * (f32::from(update) / 9.0),
            update,
            at: Micros(u64::from(update) * 10 * u64::from(TICK_US)),
            configuration: configuration.crc,
            alive: now,
            ..Command::NONE
        };
        let inputs = Inputs {
            encoder_counts: turns.map(|turn| (turn * counts) as i64 as u16),
            supply_input: Some(InputVoltage::new(24.0 / 11.0)),
            ..Inputs::default()
        };
        side.tick(now, &command, &inputs);
        let report = side.report();
        let asked = report.twist_ref();
        let exact = Twist {
            vx: f64::from(asked.vx),
            vy: f64::from(asked.vy),
            omega: f64::from(asked.omega),
        };
        let found: [f32; 4] = report.rates_ref().into();
        let bound = bound(&wide, exact);
        for ((found, exact), turn) in found.into_iter().zip(wide.rates(exact)).zip(&mut turns) {
            let off = (f64::from(found) - exact).abs();
            assert!(
                off <= bound,
                "{off:e} of {bound:e} rad/s: {asked:?} {found}"
            );
            *turn += exact * f64::from(TICK_US) * 1e-6 / core::f64::consts::TAU;
        }
    }
    side.report().saturated_ticks
}

#[test]
fn what_a_robot_accepts_fits_and_what_it_refuses_has_a_name() {
    let mut random = Random(20);
    let (mut accepted, mut refused) = (0, Vec::new());
    let mut values = usual(0, 1 << 2);
    for (address, value) in &mut values {
        if *address == at::MEMBERS {
            *value = Value::U32(1 << 2);
        }
    }
    for _ in 0..6_000 {
        let mut tried = values.clone();
        for _ in 0..=random.below(3) {
            let address = VARIED[random.below(VARIED.len())];
            let value = Value::F32(random.value(address));
            match tried.iter_mut().find(|(one, _)| *one == address) {
                Some((_, old)) => *old = value,
                None => tried.push((address, value)),
            }
        }
        let parameters = parameters(&tried);
        match build(&parameters, 2, ANY_DRIVES) {
            Ok(_) => {}
            Err(ConfigurationError::Missing(address)) => panic!("{address:?}"),
            Err(ConfigurationError::Inconsistent(address)) => {
                assert!(entry(address).is_some(), "{address:?}");
                refused.push((address.index, address.sub));
                continue;
            }
        }
        values = tried;
        accepted += 1;
        // As fast as the wheels may.
        let wide = Wide::of(&parameters);
        let direction = [0, 1, 2].map(|_| 2.0 * random.next() - 1.0);
        let [vx, vy, omega] = direction.map(f64::from);
        let fastest = wide.rates(Twist { vx, vy, omega }).map(f64::abs);
        let fastest = fastest.into_iter().fold(0.0, f64::max);
        let scale = f64::from(parameters.real(at::WHEEL_RATE_MAX)) / fastest;
        let scale = scale.min(f64::from(SETPOINT));
        let [vx, vy, omega] = [vx, vy, omega].map(|axis| (axis * scale) as f32);
        let saturated = drive(&parameters, Twist::new(vx, vy, omega));
        // Accelerations beyond 4096, of the robot or of a wheel, are known not to fit.
        let real = |address| f64::from(parameters.real(address));
        let sizes = wide.sizes(real(at::ACCELERATION), real(at::ACCELERATION_YAW));
        let wheel: f64 = wide
            .rows()
            .iter()
            .zip(sizes)
            .map(|(row, size)| row * size)
            .sum();
        let fits = wheel.max(sizes[0]).max(sizes[1]) < 4_080.0;
        assert!(
            saturated == 0 || !fits,
            "{saturated} ticks: {tried:?}",
            tried = values
        );
    }
    refused.sort_unstable();
    refused.dedup();
    assert!(accepted > 500, "{accepted} accepted");
    // 8 V s^2/rad and 16 rad a count, which only fixed point cannot say.
    for address in [motor::acceleration(1), at::GEAR_RATIO] {
        let is_refused = refused.contains(&(address.index, address.sub));
        assert_eq!(is_refused, cfg!(feature = "fixed-point"), "{address:?}");
    }
}
