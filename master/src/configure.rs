//! What the group file says, written into the robots.
//!
//! Every value goes over SDO in PRE-OPERATIONAL and is read back; then the robot is asked whether
//! its configuration is complete and fits together (object 0x2002:1). Nothing is written into a
//! robot that has not said before that it speaks this wire version. The list of values is one
//! function of the file, [`parameters`], which `omnibus group show` prints as well.

use canopen::{Micros, NmtCommand};
use group::{GroupFile, Robot};
use protocol::{Address, Kind, Value, address};

use crate::error::MasterError;
use crate::link::Link;
use crate::sdo;
use crate::session::Group;

/// A value to be written, under the address it goes to.
pub type Parameter = (Address, Value);

/// Bit mask of all members: bit n stands for node n.
#[must_use]
pub fn member_mask(file: &GroupFile) -> u32 {
    let bits = file.robots.iter().map(|robot| 1_u32 << robot.node);
    bits.fold(0, |mask, bit| mask | bit)
}

/// Milliseconds of a time in µs, saturating.
fn millis(us: u32) -> u16 {
    u16::try_from(us.div_ceil(1000)).unwrap_or(u16::MAX)
}

/// Everything a robot must know, in the order of the object dictionary. With `compensation` off it
/// is told that it loses nothing.
#[must_use]
pub fn parameters(file: &GroupFile, robot: &Robot, compensation: bool) -> Vec<Parameter> {
    let real = |at: Address, value: f32| (at, Value::F32(value));
    let geometry = &robot.geometry;
    let given = &robot.compensation;
    let coefficient = |value: f32| if compensation { value } else { 1.0 };
    let mut out = vec![
        real(address::HALF_TRACK, geometry.half_track()),
        real(address::HALF_WHEELBASE, geometry.half_wheelbase()),
        real(address::WHEEL_RADIUS, geometry.wheel_radius()),
        real(address::ROLLER_ANGLE, geometry.roller_angle()),
        real(address::MOUNT_X, robot.mount.x),
        real(address::MOUNT_Y, robot.mount.y),
        real(address::MOUNT_HEADING, robot.mount.heading),
        real(
            address::COMPENSATION_LONGITUDINAL,
            coefficient(given.longitudinal()),
        ),
        real(address::COMPENSATION_LATERAL, coefficient(given.lateral())),
        real(address::COMPENSATION_YAW, coefficient(given.yaw())),
        real(address::ENCODER_COUNTS, robot.encoder.counts_per_revolution),
        // Wiring is the robot's business: encoders count up and motors turn when it rolls forward.
        (address::ENCODER_REVERSED, Value::U8(0)),
        (address::MOTOR_REVERSED, Value::U8(0)),
    ];
    // The file has duties, the robot volts: what a duty is worth depends on the battery.
    let (forward, supply) = (robot.motor.feedforward(), robot.motor.supply);
    for wheel in 0..4 {
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
    let limits = &file.limits;
    out.extend([
        real(address::SUPPLY_NOMINAL, supply),
        real(address::WHEEL_RATE_MAX, robot.max_wheel_rate),
        real(address::ACCELERATION, limits.linear_acceleration),
        real(address::ACCELERATION_YAW, limits.yaw_acceleration),
        real(address::JERK, limits.linear_jerk),
        real(address::JERK_YAW, limits.yaw_jerk),
        real(address::DECELERATION, limits.linear_acceleration),
        real(address::DECELERATION_YAW, limits.yaw_acceleration),
        (address::GROUP_ID, Value::U8(file.group_id)),
        (address::MEMBERS, Value::U32(member_mask(file))),
        (address::SYNC_PERIOD, Value::U32(file.sync_period_us)),
        (
            address::SYNC_TIMEOUT,
            Value::U16(millis(file.sync_period_us.saturating_mul(5))),
        ),
        (
            address::SETPOINT_TIMEOUT,
            Value::U16(millis(limits.command_timeout_us)),
        ),
    ]);
    out
}

impl<L: Link> Group<'_, L> {
    /// Asks one robot who it is, again and again until it answers or `deadline` has come: it may
    /// still be booting.
    pub(crate) fn identify(&mut self, index: usize, deadline: Micros) -> Result<(), MasterError> {
        let node = self.members()[index].node;
        loop {
            match self.wire.read(node, address::WIRE_VERSION, Kind::U16) {
                Ok(Value::U16(version)) if version == protocol::WIRE_VERSION => return Ok(()),
                Ok(value) => {
                    return Err(MasterError::WireVersion {
                        node,
                        found: value.to_bits(),
                    });
                }
                Err(MasterError::NodeSilent { .. }) if self.wire.now().0 < deadline.0 => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Takes all robots into PRE-OPERATIONAL and writes the group file into them.
    ///
    /// # Errors
    /// When a robot refuses a value, a value reads back differently, or a robot finds its
    /// configuration incomplete; the error names node and object. Nothing moves.
    pub fn configure(&mut self, compensation: bool) -> Result<(), MasterError> {
        self.command(NmtCommand::EnterPreOperational)?;
        let file = self.file;
        for robot in &file.robots {
            for (at, value) in parameters(file, robot, compensation) {
                self.wire.write_checked(robot.node, at, value)?;
            }
        }
        for robot in &file.robots {
            self.check_configuration(robot.node)?;
        }
        Ok(())
    }

    /// Reads whether a robot finds its configuration complete.
    fn check_configuration(&mut self, node: u8) -> Result<(), MasterError> {
        let status = self
            .wire
            .read(node, address::CONFIGURATION_STATUS, Kind::U32)?;
        let bits = status.to_bits();
        if bits == 0 {
            return Ok(());
        }
        // Index in the upper half, then sub-index, then the reason.
        let [reason, sub, low, high] = bits.to_le_bytes();
        let at = Address::new(u16::from_le_bytes([low, high]), sub);
        Err(MasterError::Configuration {
            node,
            object: sdo::name(at),
            reason: match reason {
                1 => "was not written".into(),
                2 => "does not fit the rest of the configuration".into(),
                other => format!("is objected to for reason {other}"),
            },
        })
    }
}
