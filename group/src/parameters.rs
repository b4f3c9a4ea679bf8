//! The group file as a list of objects and values, as each robot needs them.
//!
//! One function of the file, so that every master writes the same: the `omnibus` command, and the
//! simulator when it drives robots of its own.

use protocol::compensation::{EMPTY, LENGTH_MAX, SetError, Tables};
use protocol::{Address, Value, address, timing};

use crate::model::{CurrentSensor, GroupFile, Robot};

/// What robots permit of the limits of speed, a ratio: room for what a closed loop and the
/// corrections of a floor add to a curve.
pub const ROOM: f32 = 1.25;

/// A value to be written, under the address it goes to.
pub type Parameter = (Address, Value);

/// Bit mask of all members: bit n stands for node n.
#[must_use]
pub fn member_mask(file: &GroupFile) -> u32 {
    let bits = file.robots.iter().map(|robot| 1_u32 << robot.node);
    bits.fold(0, |mask, bit| mask | bit)
}

/// From SYNC to the effect of the setpoint latched there, µs: the smallest that fits the members.
/// 0, which the robots refuse, where their votes do not fit into the SYNC period.
#[must_use]
pub fn agreement_delay_us(file: &GroupFile) -> u32 {
    timing::agreement_delay_us(member_mask(file), file.sync_period_us, timing::BIT_RATE)
        .unwrap_or(0)
}

/// How long after the SYNC that latches a setpoint the group has reached it, µs. A master that
/// drives a curve on time sends each setpoint ahead by that.
#[must_use]
pub fn preview_us(file: &GroupFile) -> u32 {
    timing::reached_after_us(file.sync_period_us, agreement_delay_us(file))
}

/// Milliseconds of a time in µs, saturating.
fn millis(us: u32) -> u16 {
    u16::try_from(us.div_ceil(1000)).unwrap_or(u16::MAX)
}

/// Everything a robot must know, in the order of the object dictionary. With `compensation` off it
/// gets the values of one that loses nothing. A robot whose motors are identified keeps what it has
/// found.
#[must_use]
pub fn parameters(file: &GroupFile, robot: &Robot, compensation: bool) -> Vec<Parameter> {
    let real = |at: Address, value: f32| (at, Value::F32(value));
    let geometry = &robot.geometry;
    let given = robot
        .rollers
        .map_or(robot.compensation, |rollers| rollers.compensation);
    let coefficient = |value: f32| if compensation { value } else { 1.0 };
    let mut out = vec![
        real(address::HALF_TRACK, geometry.half_track()),
        real(address::HALF_WHEELBASE, geometry.half_wheelbase()),
        real(address::WHEEL_RADIUS, geometry.wheel_radius()),
        real(address::ROLLER_ANGLE, geometry.roller_angle()),
        (
            address::INDIVIDUAL_WHEELS,
            Value::U8(u8::from(robot.wheels.is_some())),
        ),
        real(address::MOUNT_X, robot.mount.x),
        real(address::MOUNT_Y, robot.mount.y),
        real(address::MOUNT_HEADING, robot.mount.heading),
        real(
            address::COMPENSATION_LONGITUDINAL,
            coefficient(given.longitudinal()),
        ),
        real(address::COMPENSATION_LATERAL, coefficient(given.lateral())),
        real(address::COMPENSATION_YAW, coefficient(given.yaw())),
        real(address::GEAR_RATIO, robot.encoder.gear_ratio),
        real(address::ENCODER_COUNTS, robot.encoder.counts_per_revolution),
    ];
    // As wired by the book: encoders count up and motors turn forward when it rolls forward.
    let usual = (!robot.control.identified).then_some(0);
    for (at, reversed) in [
        (address::ENCODER_REVERSED, robot.reversed.encoders),
        (address::MOTOR_REVERSED, robot.reversed.motors),
    ] {
        out.extend(reversed.or(usual).map(|bits| (at, Value::U8(bits))));
    }
    for (place, wheel) in (0..).zip(robot.wheels.iter().flatten()) {
        out.extend([
            real(address::wheel::x(place), wheel.x),
            real(address::wheel::y(place), wheel.y),
            real(address::wheel::radius(place), wheel.radius),
            real(address::wheel::roller_angle(place), wheel.roller_angle),
        ]);
    }
    // Counts of their own hold for wheels that are alike too, so those of an earlier file must go.
    for place in 0..4 {
        let wheel = robot.wheels.map(|wheels| wheels[usize::from(place)]);
        let counts = wheel.and_then(|wheel| wheel.counts_per_revolution);
        let at = address::wheel::encoder_counts(place);
        out.push(real(at, counts.unwrap_or(0.0)));
    }
    // The file has duties, the robot volts: what a duty is worth depends on the battery.
    let (forward, supply) = (robot.motor.feedforward(), robot.motor.supply);
    for wheel in (0..4).filter(|_| !robot.control.identified) {
        out.extend([
            real(
                address::motor::static_friction(wheel),
                forward.duty_static * supply,
            ),
            real(address::motor::speed(wheel), forward.duty_per_rate * supply),
            real(
                address::motor::acceleration(wheel),
                forward.duty_per_acceleration * supply,
            ),
            real(
                address::motor::proportional(wheel),
                robot.control.proportional * supply,
            ),
            real(
                address::motor::integral(wheel),
                robot.control.integral * supply,
            ),
        ]);
    }
    // Written always: a robot that had rollers before must forget them.
    let rollers = robot.rollers.map_or((0, [0.0; 4]), |r| (r.count, r.phases));
    for wheel in 0..4 {
        out.push((address::rollers::count(wheel), Value::U8(rollers.0)));
    }
    for (wheel, phase) in (0..).zip(rollers.1) {
        out.push(real(address::rollers::phase(wheel), phase));
    }
    let reference = Value::U8(u8::from(rollers.0 > 0));
    out.push((address::ROLLER_REFERENCE, reference));
    if let Some(counts) = robot.rollers.and_then(|rollers| rollers.index_tolerance) {
        out.push((address::INDEX_TOLERANCE, Value::U16(counts)));
    }
    // A bound needs both its parameters or none.
    let current = robot.output.largest_current;
    let resistance = current.map_or(0.0, |_| robot.motor.resistance);
    let no_sensor = CurrentSensor {
        scale: 0.0,
        offset: 0.0,
        inputs: 1,
    };
    let sensor = robot.output.current_sensor.unwrap_or(no_sensor);
    // All wait for the slowest brake, and then begin at the same time.
    let releases = file.robots.iter().map(|one| one.output.brake_release_ms);
    let release_ms = releases.max().unwrap_or(0);
    let is_smart = robot.output.kind.drive_current().is_some();
    let drive_constant = if is_smart { robot.motor.constant } else { 0.0 };
    if is_smart {
        let wheels = [
            address::DRIVE_FRONT_LEFT,
            address::DRIVE_FRONT_RIGHT,
            address::DRIVE_REAR_LEFT,
            address::DRIVE_REAR_RIGHT,
        ];
        let identifiers = robot.output.drive_identifiers.map(Value::U8);
        out.extend(wheels.into_iter().zip(identifiers));
    }
    let limits = &file.limits;
    out.extend([
        real(address::WINDING_RESISTANCE, resistance),
        real(address::CURRENT_MAX, current.unwrap_or(0.0)),
        real(address::DUTY_MAX, robot.output.largest_duty),
        real(address::CURRENT_SCALE, sensor.scale),
        real(address::CURRENT_OFFSET, sensor.offset),
        (address::CURRENT_INPUTS, Value::U8(sensor.inputs)),
        (
            address::DIRECTION_PAUSE,
            Value::U8(u8::from(robot.output.direction_pause)),
        ),
        (
            address::PWM_FREQUENCY,
            Value::U16(robot.output.pwm_frequency),
        ),
        (address::OUTPUT_STAGE, Value::U8(robot.output.kind as u8)),
        real(address::DRIVE_CONSTANT, drive_constant),
        (
            address::ENABLE_WIRED,
            Value::U8(u8::from(robot.output.enable_wired)),
        ),
        (address::BRAKE_RELEASE, Value::U16(release_ms)),
        (
            address::BRAKE_ENGAGE,
            Value::U16(robot.output.brake_engage_ms),
        ),
        real(address::SUPPLY_NOMINAL, supply),
        real(address::WHEEL_RATE_MAX, robot.max_wheel_rate),
        real(address::ACCELERATION, limits.linear_acceleration),
        real(address::ACCELERATION_YAW, limits.yaw_acceleration),
        real(address::JERK, limits.linear_jerk),
        real(address::JERK_YAW, limits.yaw_jerk),
        real(address::DECELERATION, limits.linear_acceleration),
        real(address::DECELERATION_YAW, limits.yaw_acceleration),
        real(address::SPEED_MAX, ROOM * limits.linear_speed),
        real(address::YAW_RATE_MAX, ROOM * limits.yaw_rate),
        (address::GROUP_ID, Value::U8(file.group_id)),
        (address::MEMBERS, Value::U32(member_mask(file))),
        (address::SYNC_PERIOD, Value::U32(file.sync_period_us)),
        (
            address::SYNC_TIMEOUT,
            Value::U16(millis(limits.sync_timeout_us)),
        ),
        (
            address::AGREEMENT_DELAY,
            Value::U16(u16::try_from(agreement_delay_us(file)).unwrap_or(u16::MAX)),
        ),
        (
            address::SETPOINT_TIMEOUT,
            Value::U16(millis(limits.command_timeout_us)),
        ),
    ]);
    out
}

/// The compensation set of a robot in the bytes of object 0x2013:1; one without rows where the file
/// has no table or `compensation` is off.
///
/// # Errors
/// When the tables make no set, which those of a file that was loaded do.
pub fn compensation_set(robot: &Robot, compensation: bool) -> Result<Vec<u8>, SetError> {
    // A table was measured with ideal rollers.
    if !compensation || robot.rollers.is_some() {
        return Ok(EMPTY.to_vec());
    }
    let table = &robot.compensation_table;
    let tables = Tables {
        version: table.version,
        longitudinal: &table.longitudinal,
        lateral: &table.lateral,
        oblique: &table.oblique,
        yaw: &table.yaw,
    };
    let mut bytes = [0; LENGTH_MAX];
    let length = tables.encode(&mut bytes)?;
    Ok(bytes[..length].to_vec())
}
