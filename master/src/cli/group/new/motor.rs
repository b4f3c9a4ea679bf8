//! A robot as its owner knows it; from that its motor as seen from the wheel, and the limits that
//! its wheels can follow.

use anyhow::Context as _;
use group::{RAMP_GRACE, ROOM};
use kinematics::{FourWheelGeometry, MemberKinematics, Mount, Pose, Twist, VelocityCompensation};

use super::quantity::{CURRENT, LENGTH, MASS, PLAIN, SPEED, TORQUE, VOLTAGE};
use super::{Answers, Arguments};

/// What an owner knows of a robot, in SI units.
pub(super) struct Robot {
    pub(super) track: f64,
    pub(super) wheelbase: f64,
    pub(super) diameter: f64,
    pub(super) mass: f64,
    pub(super) supply: f64,
    pub(super) no_load_rate: f64,
    pub(super) no_load_current: f64,
    pub(super) stall_torque: f64,
    pub(super) stall_current: f64,
    pub(super) counts: f64,
    pub(super) gear_ratio: f64,
}

impl Robot {
    pub(super) fn ask(arguments: &Arguments, answers: &mut Answers) -> Self {
        let mut get = |option, given: &Option<String>, question, usual, units| {
            answers.get(option, given.as_ref(), question, usual, units)
        };
        let a = arguments;
        Self {
            track: get(
                "--track",
                &a.track,
                "Distance between the centres of left and right wheels (0.30m, 300mm)",
                None,
                LENGTH,
            ),
            wheelbase: get(
                "--wheelbase",
                &a.wheelbase,
                "Distance between front and rear axles",
                None,
                LENGTH,
            ),
            diameter: get(
                "--wheel-diameter",
                &a.wheel_diameter,
                "Diameter of a wheel over its rollers (100mm)",
                None,
                LENGTH,
            ),
            mass: get(
                "--mass",
                &a.mass,
                "Mass of a robot with its share of the load (8kg)",
                None,
                MASS,
            ),
            supply: get(
                "--supply",
                &a.supply,
                "Supply voltage of the motors (12V)",
                None,
                VOLTAGE,
            ),
            no_load_rate: get(
                "--no-load-speed",
                &a.no_load_speed,
                "Speed of the gear's output shaft without load (330rpm)",
                None,
                SPEED,
            ),
            no_load_current: get(
                "--no-load-current",
                &a.no_load_current,
                "Current without load (0.2A, 200mA; 0 if unknown)",
                Some("0"),
                CURRENT,
            ),
            stall_torque: get(
                "--stall-torque",
                &a.stall_torque,
                "Stall torque of the output shaft (1.4N.m, 14kg.cm, 200oz.in)",
                None,
                TORQUE,
            ),
            stall_current: get(
                "--stall-current",
                &a.stall_current,
                "Stall current (5.5A)",
                None,
                CURRENT,
            ),
            counts: get(
                "--counts",
                &a.counts,
                "Encoder counts per turn of its own shaft, lines times 4 (64)",
                None,
                PLAIN,
            ),
            gear_ratio: get(
                "--gear-ratio",
                &a.gear_ratio,
                "Turns of the encoder's shaft in one of the wheel; 1 if it sits on the wheel (30)",
                None,
                PLAIN,
            ),
        }
    }
}

/// The motor as seen from the wheel.
#[derive(Debug)]
pub(super) struct Motor {
    /// Of the winding, Ohm.
    pub(super) resistance: f64,
    /// Torque constant at the wheel, N m/A.
    pub(super) constant: f64,
    /// Dry friction at the wheel, N m.
    pub(super) friction: f64,
    /// Of the gear, a fraction, from the stall torque.
    pub(super) efficiency: f64,
    /// What the wheel turns, kg m^2.
    pub(super) inertia: f64,
}

/// Share of what a motor can do that a group file asks of it: what is left is for the wheel loops.
pub(super) const RESERVE: f64 = 0.8;

/// Fastest wheel that a robot can be told of, rad/s: object 0x2030:1.
pub(super) const FASTEST: f64 = 65.0;

/// Friction that a rubber roller surely has on a clean floor, a ratio of forces, for the limit of
/// the acceleration.
pub(super) const FRICTION: f64 = 0.35;

/// Acceleration of free fall, m/s^2.
pub(super) const GRAVITY: f64 = 9.81;

impl Motor {
    pub(super) fn of(robot: &Robot) -> anyhow::Result<Self> {
        if robot.no_load_current >= robot.stall_current {
            usage!(
                "--no-load-current: {} A is not below the stall current, {} A",
                robot.no_load_current,
                robot.stall_current
            );
        }
        let resistance = robot.supply / robot.stall_current;
        let constant = (robot.supply - resistance * robot.no_load_current) / robot.no_load_rate;
        let ideal = constant * (robot.stall_current - robot.no_load_current);
        let efficiency = robot.stall_torque / ideal;
        if efficiency > 1.1 {
            usage!(
                "these motor data contradict each other: at {:.1} A and {:.1} rad/s without load a \
                 motor stalls at {ideal:.3} N m at most, not at {:.3}; check the units, and that \
                 speed and torque are both those of the gear's output shaft",
                robot.stall_current,
                robot.no_load_rate,
                robot.stall_torque
            );
        }
        if efficiency < 0.2 {
            usage!(
                "these motor data contradict each other: a motor of {:.1} A and {:.1} rad/s without \
                 load that stalls at {:.3} N m would lose {:.0} % in its gear; check the units, and \
                 that speed and torque are both those of the gear's output shaft",
                robot.stall_current,
                robot.no_load_rate,
                robot.stall_torque,
                100.0 * (1.0 - efficiency)
            );
        }
        let efficiency = efficiency.min(1.0);
        let radius = robot.diameter / 2.0;
        Ok(Self {
            resistance,
            constant,
            friction: constant * robot.no_load_current,
            efficiency,
            inertia: robot.mass / 4.0 * radius * radius / efficiency,
        })
    }
}

/// Rounded down to two significant digits, so that what is asked stays within what can be.
pub(super) fn down(value: f64) -> f64 {
    let step = 10_f64.powf(value.abs().log10().floor() - 1.0);
    let whole = (value / step + 1e-9).floor();
    // Through text, so that 0.52 is not 0.5200000000000001.
    let digits = (-step.log10().round()).max(0.0);
    format!("{:.*}", digits as usize, whole * step)
        .parse()
        .unwrap_or(value)
}

/// To four significant digits.
pub(super) fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// The limits of the group's motion that the wheels can follow: rad/s, m/s, rad/s, m/s^2, rad/s^2.
pub(super) struct Limits {
    pub(super) wheel_rate: f64,
    pub(super) speed: f64,
    pub(super) yaw_rate: f64,
    pub(super) acceleration: f64,
    pub(super) yaw_acceleration: f64,
}

/// Time in which a group comes to rest from its limits, s: less than the robots ask for.
const REST: f64 = 0.9 * RAMP_GRACE as f64;

impl Limits {
    /// With rollers at an angle in degrees, for robots at these places (m, m, degrees).
    ///
    /// # Errors
    /// When the dimensions make no robot.
    pub(super) fn of(robot: &Robot, angle: f64, places: &[[f64; 3]]) -> anyhow::Result<Self> {
        let radius = robot.diameter / 2.0;
        let (track, wheelbase) = (robot.track / 2.0, robot.wheelbase / 2.0);
        let [track, wheelbase, rim] = [track, wheelbase, radius].map(|length| length as f32);
        let angle = angle.to_radians();
        let geometry = FourWheelGeometry::new(track, wheelbase, rim, angle as f32)
            .map_err(|error| anyhow::anyhow!("these dimensions make no robot: {error}"))?;
        // Wheel rates for 1 m/s ahead, 1 m/s to the left, 1 rad/s.
        let (mut along, mut turn) = (0.0_f64, 0.0_f64);
        for [x, y, heading] in places {
            let pose = Pose::new(*x as f32, *y as f32, heading.to_radians() as f32);
            let mount = Mount::new(pose).context("--robot")?;
            let member = MemberKinematics::new(&geometry, &mount, &VelocityCompensation::NONE)
                .context("--robot")?;
            let rates = |twist| <[f32; 4]>::from(member.inverse(twist)).map(f64::from);
            let ahead = rates(Twist::new(1.0, 0.0, 0.0));
            let left = rates(Twist::new(0.0, 1.0, 0.0));
            // In every direction, the diagonals too.
            let fastest = ahead.into_iter().zip(left).map(|(x, y)| x.hypot(y));
            along = fastest.fold(along, f64::max);
            let fastest = rates(Twist::new(0.0, 0.0, 1.0)).map(f64::abs);
            turn = fastest.into_iter().fold(turn, f64::max);
        }
        let wheel_rate = down(RESERVE * robot.no_load_rate).min(FASTEST);
        let reach = turn * radius;
        // Half of the stall torque of four wheels ahead and sideways, and what the floor holds:
        // rollers share the push between ahead and aside.
        let worst = (1.0 / angle.tan()).min(1.0);
        let push = 4.0 * 0.5 * robot.stall_torque / radius / robot.mass * worst;
        let floor = FRICTION * GRAVITY * angle.sin().min(angle.cos());
        let acceleration = down(push.min(floor));
        let yaw_acceleration = down((acceleration / reach).min(4.0));
        let rests = |acceleration: f64| acceleration * REST / f64::from(ROOM);
        Ok(Self {
            wheel_rate,
            speed: down((wheel_rate / along).min(rests(acceleration))),
            yaw_rate: down((wheel_rate / turn).min(1.5).min(rests(yaw_acceleration))),
            acceleration,
            yaw_acceleration,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot() -> Robot {
        Robot {
            track: 0.3,
            wheelbase: 0.26,
            diameter: 0.1,
            mass: 8.0,
            supply: 12.0,
            no_load_rate: 34.56,
            no_load_current: 0.2,
            stall_torque: 1.373,
            stall_current: 5.5,
            counts: 64.0,
            gear_ratio: 30.0,
        }
    }

    /// What the file says of the motor gives its data back.
    #[test]
    fn a_motor_is_what_its_data_sheet_says() {
        let robot = robot();
        let motor = Motor::of(&robot).unwrap();
        // Without load: k w + R i = V with the current that friction takes, i = friction / k.
        let current = motor.friction / motor.constant;
        let volts = motor.constant * robot.no_load_rate + motor.resistance * current;
        assert!((volts - robot.supply).abs() < 1e-9);
        assert!((current - robot.no_load_current).abs() < 1e-9);
        // At stall: the current is V / R, and the torque that of the data sheet.
        assert!((robot.supply / motor.resistance - robot.stall_current).abs() < 1e-9);
        let torque =
            motor.efficiency * motor.constant * (robot.stall_current - robot.no_load_current);
        assert!((torque - robot.stall_torque).abs() < 1e-9);
    }

    #[test]
    fn data_that_contradict_each_other_are_refused() {
        // 14 kg.cm taken for 14 N m, and the torque of the motor's own shaft.
        for torque in [14.0, 1.373 / 30.0] {
            let error = Motor::of(&Robot {
                stall_torque: torque,
                ..robot()
            });
            assert!(
                error
                    .unwrap_err()
                    .to_string()
                    .contains("contradict each other")
            );
        }
    }

    #[test]
    fn numbers_are_rounded_down_to_two_digits() {
        assert_eq!(down(1.279), 1.2);
        assert_eq!(down(27.65), 27.0);
        assert_eq!(down(0.0559), 0.055);
        assert_eq!(down(2.0), 2.0);
    }
}
