//! Where every object is, by name.
//!
//! Manufacturer objects as CiA 301 allots them: 0x2000 identity, 0x2010 robot, 0x2020 wheels and
//! motors, 0x2030 limits and thresholds, 0x2040 group, 0x2050 commissioning, 0x2100 process data,
//! 0x2120 diagnostics.

/// Index and sub-index of an object.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// Index, 0x2000 and up for everything this crate declares.
    pub index: u16,
    /// Sub-index; 0 for an object that is no record.
    pub sub: u8,
}

impl Address {
    /// The object at this index and sub-index.
    #[must_use]
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }

    /// Index and sub-index in one number, index in the upper bits.
    #[must_use]
    pub const fn packed(self) -> u32 {
        (self.index as u32) << 8 | self.sub as u32
    }
}

/// `2010:1`, the way people write it.
impl core::fmt::Debug for Address {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:04X}:{:X}", self.index, self.sub)
    }
}

impl core::fmt::Display for Address {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        core::fmt::Debug::fmt(self, f)
    }
}

macro_rules! addresses {
    ($($(#[doc = $text:literal])+ $name:ident = $index:literal : $sub:literal;)+) => {
        $($(#[doc = $text])+ pub const $name: Address = Address::new($index, $sub);)+
    };
}

addresses! {
    /// Version of the byte layouts.
    WIRE_VERSION = 0x2000:0;
    /// Serial number.
    SERIAL_NUMBER = 0x2001:1;
    /// Firmware version.
    FIRMWARE_VERSION = 0x2001:2;
    /// Why the processor started.
    RESET_CAUSE = 0x2001:3;
    /// Node by the switches on the board.
    NODE_SWITCHES = 0x2001:4;
    /// Node stored by LSS.
    NODE_STORED = 0x2001:5;
    /// What is missing from the configuration.
    CONFIGURATION_STATUS = 0x2002:1;
    /// CRC-32 over the whole configuration.
    CONFIGURATION_CRC = 0x2002:2;
    /// CRC-32 over what all members must have in common.
    GROUP_CRC = 0x2002:3;

    /// Half the distance between left and right wheels.
    HALF_TRACK = 0x2010:1;
    /// Half the distance between front and rear wheels.
    HALF_WHEELBASE = 0x2010:2;
    /// Wheel radius.
    WHEEL_RADIUS = 0x2010:3;
    /// Angle between roller axle and wheel axle.
    ROLLER_ANGLE = 0x2010:4;
    /// Whether each wheel is described by itself.
    INDIVIDUAL_WHEELS = 0x2010:5;
    /// Position of the member in the group frame.
    MOUNT_X = 0x2011:1;
    /// Position of the member in the group frame.
    MOUNT_Y = 0x2011:2;
    /// Heading of the member in the group frame.
    MOUNT_HEADING = 0x2011:3;
    /// Compensation along x.
    COMPENSATION_LONGITUDINAL = 0x2012:1;
    /// Compensation along y.
    COMPENSATION_LATERAL = 0x2012:2;
    /// Compensation about z.
    COMPENSATION_YAW = 0x2012:3;
    /// Compensation tables, see [`crate::compensation`].
    COMPENSATION_SET = 0x2013:1;
    /// Version of the compensation tables.
    COMPENSATION_VERSION = 0x2013:2;
    /// CRC of the compensation tables.
    COMPENSATION_CRC = 0x2013:3;
    /// Gear between encoder and wheel.
    GEAR_RATIO = 0x2018:1;

    /// Counts per wheel revolution.
    ENCODER_COUNTS = 0x2020:1;
    /// Encoders that count backwards.
    ENCODER_REVERSED = 0x2020:2;
    /// Motors that turn backwards.
    MOTOR_REVERSED = 0x2020:3;
    /// Bandwidth of the wheel-rate observer.
    OBSERVER_BANDWIDTH = 0x2020:4;
    /// Supply voltage the motors are computed for.
    SUPPLY_NOMINAL = 0x2025:1;
    /// Supply voltage below which the robot stops.
    SUPPLY_MINIMUM = 0x2025:2;
    /// Supply voltage above which the robot stops.
    SUPPLY_MAXIMUM = 0x2025:3;
    /// Voltage above the minimum at which the supply is reported as low.
    SUPPLY_MARGIN = 0x2025:4;
    /// Supply voltage per voltage at the measuring input.
    SUPPLY_DIVIDER = 0x2025:5;
    /// Resistance of a motor's winding.
    WINDING_RESISTANCE = 0x2026:1;
    /// Largest current of a motor.
    CURRENT_MAX = 0x2026:2;
    /// Current per voltage at a sensor's input.
    CURRENT_SCALE = 0x2026:3;
    /// Voltage at a sensor's input without current.
    CURRENT_OFFSET = 0x2026:4;
    /// How many sensors are added up.
    CURRENT_INPUTS = 0x2026:5;
    /// Largest duty of a bridge.
    DUTY_MAX = 0x2027:1;
    /// Whether a bridge rests for a tick before it changes its direction.
    DIRECTION_PAUSE = 0x2027:2;
    /// How long the brake takes to let go.
    BRAKE_RELEASE = 0x2027:3;
    /// How long the brake takes to hold.
    BRAKE_ENGAGE = 0x2027:4;
    /// Frequency of the bridges' PWM.
    PWM_FREQUENCY = 0x2027:5;

    /// Where the angle of the rollers comes from.
    ROLLER_REFERENCE = 0x202A:1;
    /// Counts by which an index may be off.
    INDEX_TOLERANCE = 0x202A:2;
    /// Filter of the encoder inputs.
    ENCODER_FILTER = 0x202B:1;
    /// Fastest wheel rate.
    WHEEL_RATE_MAX = 0x2030:1;
    /// Group acceleration, linear.
    ACCELERATION = 0x2030:2;
    /// Group acceleration, angular.
    ACCELERATION_YAW = 0x2030:3;
    /// Group jerk, linear.
    JERK = 0x2030:4;
    /// Group jerk, angular.
    JERK_YAW = 0x2030:5;
    /// Deceleration of every ramp to standstill, linear.
    DECELERATION = 0x2030:6;
    /// Deceleration of every ramp to standstill, angular.
    DECELERATION_YAW = 0x2030:7;
    /// Slip residual that is a limit.
    SLIP_LIMIT = 0x2031:1;
    /// Slip residual that is a fault.
    SLIP_FAULT = 0x2031:2;
    /// Disagreement with another member that is a limit.
    STRAIN_LIMIT = 0x2031:3;
    /// Disagreement with another member that is a fault.
    STRAIN_FAULT = 0x2031:4;
    /// Wheel tracking error that means a blocked wheel.
    BLOCKED_RATE = 0x2031:5;
    /// How long a wheel may look blocked, dead or inverted.
    WHEEL_FAULT_TIME = 0x2031:6;

    /// Group this robot belongs to.
    GROUP_ID = 0x2040:1;
    /// All members of the group.
    MEMBERS = 0x2040:2;
    /// Period of SYNC.
    SYNC_PERIOD = 0x2041:1;
    /// How long without SYNC.
    SYNC_TIMEOUT = 0x2041:2;
    /// How long without a fresh setpoint.
    SETPOINT_TIMEOUT = 0x2041:3;
    /// How long without the master's heartbeat.
    HEARTBEAT_TIMEOUT = 0x2041:4;

    /// How many SYNCs near standstill come before motion.
    STANDSTILL_SYNCS = 0x2042:1;
    /// Whether a protective stop is connected.
    PROTECTIVE_STOP = 0x2042:2;
    /// Whether an emergency stop of one member cuts all.
    CUTS_TOGETHER = 0x2042:3;

    /// Permission to move this robot alone.
    COMMISSIONING = 0x2050:1;
    /// This robot is its own only member for a while.
    ALONE_FOR_NOW = 0x2050:2;
    /// Begins and stops the identification of the motors.
    IDENTIFY = 0x2051:1;
    /// How it stands with it.
    IDENTIFY_STATUS = 0x2051:2;
    /// The wheel that made it fail.
    IDENTIFY_WHEEL = 0x2051:3;
    /// Fastest wheel rate meanwhile.
    IDENTIFY_RATE = 0x2051:4;
    /// Longest way of a wheel meanwhile.
    IDENTIFY_TRAVEL = 0x2051:5;
    /// Bandwidth of the gains.
    IDENTIFY_BANDWIDTH = 0x2051:6;
    /// Damping of the gains.
    IDENTIFY_DAMPING = 0x2051:7;
    /// Wheels that take part.
    IDENTIFY_WHEELS = 0x2051:8;
    /// Seconds for which the LED blinks.
    BLINK = 0x2059:0;

    /// Group twist received: vx.
    SETPOINT_VX = 0x2100:1;
    /// Group twist received: vy.
    SETPOINT_VY = 0x2100:2;
    /// Group twist received: omega.
    SETPOINT_OMEGA = 0x2100:3;
    /// Group twist received: sequence.
    SETPOINT_SEQUENCE = 0x2100:4;
    /// Group twist received: group.
    SETPOINT_GROUP = 0x2100:5;
    /// Commissioning twist received: vx.
    ALONE_VX = 0x2101:1;
    /// Commissioning twist received: vy.
    ALONE_VY = 0x2101:2;
    /// Commissioning twist received: omega.
    ALONE_OMEGA = 0x2101:3;
    /// Commissioning twist received: sequence.
    ALONE_SEQUENCE = 0x2101:4;
    /// Commissioning twist received: group.
    ALONE_GROUP = 0x2101:5;
    /// Member state.
    STATE = 0x2110:1;
    /// Echoed sequence.
    STATUS_SEQUENCE = 0x2110:2;
    /// Permitted group scale.
    STATUS_SCALE = 0x2110:3;
    /// Slip residual.
    STATUS_SLIP = 0x2110:4;
    /// Limit or fault code.
    STATUS_CODE = 0x2110:5;
    /// Checksum over what it is about to do.
    STATUS_PLAN = 0x2110:6;
    /// Measured group twist: vx.
    MEASURED_VX = 0x2111:1;
    /// Measured group twist: vy.
    MEASURED_VY = 0x2111:2;
    /// Measured group twist: omega.
    MEASURED_OMEGA = 0x2111:3;
    /// Measured group twist: sequence.
    MEASURED_SEQUENCE = 0x2111:4;
    /// Measured group twist: group.
    MEASURED_GROUP = 0x2111:5;
    /// Pose of the group frame: x.
    POSE_X = 0x2112:1;
    /// Pose of the group frame: y.
    POSE_Y = 0x2112:2;
    /// Pose of the group frame: heading.
    POSE_HEADING = 0x2112:3;
    /// Wheel rate.
    RATE_FRONT_LEFT = 0x2113:1;
    /// Wheel rate.
    RATE_FRONT_RIGHT = 0x2113:2;
    /// Wheel rate.
    RATE_REAR_LEFT = 0x2113:3;
    /// Wheel rate.
    RATE_REAR_RIGHT = 0x2113:4;

    /// Supply voltage.
    SUPPLY = 0x2120:1;
    /// Wheel rates that no rigid motion explains.
    SLIP = 0x2120:2;
    /// Current of the motors.
    CURRENT = 0x2120:3;
    /// Control ticks that came late.
    LATE_TICKS = 0x2121:1;
    /// SYNCs that did not come.
    LOST_SYNCS = 0x2121:2;
    /// Setpoints not followed.
    IGNORED_SETPOINTS = 0x2121:3;
    /// Writes refused.
    REFUSED_WRITES = 0x2121:4;
    /// Times the robot came to rest by a fault.
    STOPS = 0x2121:5;
    /// Watchdog resets.
    WATCHDOG_RESETS = 0x2121:6;
    /// CAN frames lost or in error.
    CAN_ERRORS = 0x2121:7;
    /// Transmit error counter of the CAN controller.
    CAN_TRANSMIT_ERRORS = 0x2130:1;
    /// Receive error counter of the CAN controller.
    CAN_RECEIVE_ERRORS = 0x2130:2;
    /// The last error on the bus.
    CAN_LAST_ERROR = 0x2130:3;
    /// Times the CAN controller became error passive.
    CAN_PASSIVES = 0x2130:4;
    /// Times the CAN controller went off the bus.
    CAN_BUS_OFFS = 0x2130:5;
    /// Saves since the store was new.
    SAVES = 0x2126:1;
    /// Sectors erased since the store was new.
    ERASES = 0x2126:2;
    /// Saves that a loss of power cut off.
    CUT_SAVES = 0x2126:3;
    /// How long the start waited for clock and supply.
    CLOCK_WAIT = 0x2127:1;
    /// Level of the brown-out reset.
    BROWN_OUT_LEVEL = 0x2127:2;
    /// The last faults, over power losses.
    STORED_FAULTS = 0x2128:1;
    /// Number of this start.
    START_NUMBER = 0x2129:1;
    /// Faults that are not in flash yet.
    UNSTORED_FAULTS = 0x2129:2;
    /// Time since the robot started.
    UPTIME = 0x2129:3;
}

/// The motor of one wheel, at 0x2021 to 0x2024 in the order front left, front right, rear left,
/// rear right.
pub mod motor {
    use super::Address;

    /// Index of the front left motor's record; the others follow.
    pub const FIRST: u16 = 0x2021;

    /// Static friction, V.
    #[must_use]
    pub const fn static_friction(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 1)
    }

    /// Voltage per wheel rate, V s/rad.
    #[must_use]
    pub const fn speed(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 2)
    }

    /// Voltage per wheel acceleration, V s^2/rad.
    #[must_use]
    pub const fn acceleration(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 3)
    }

    /// Proportional gain, V s/rad.
    #[must_use]
    pub const fn proportional(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 4)
    }

    /// Integral gain, V/rad.
    #[must_use]
    pub const fn integral(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 5)
    }
}

/// What an identification has found, one record for each wheel at 0x2052 to 0x2055, with the
/// sub-indices of [`motor`].
pub mod identified {
    use super::Address;

    /// Index of the front left wheel's record; the others follow.
    pub const FIRST: u16 = 0x2052;

    /// The value that would be written to this sub-index of the wheel's motor.
    #[must_use]
    pub const fn value(wheel: u16, sub: u8) -> Address {
        Address::new(FIRST + wheel, sub)
    }

    /// Rms misfit, V.
    #[must_use]
    pub const fn residual(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 6)
    }
}

/// A wheel of its own kind, at 0x2014 to 0x2017 in the order front left, front right, rear left,
/// rear right.
pub mod wheel {
    use super::Address;

    /// Index of the front left wheel's record; the others follow.
    pub const FIRST: u16 = 0x2014;

    /// Position of its centre, forward, m.
    #[must_use]
    pub const fn x(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 1)
    }

    /// Position of its centre, left, m.
    #[must_use]
    pub const fn y(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 2)
    }

    /// Radius, m.
    #[must_use]
    pub const fn radius(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 3)
    }

    /// Roller angle with the sign of the wheel's hand, rad.
    #[must_use]
    pub const fn roller_angle(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 4)
    }

    /// Encoder counts per revolution.
    #[must_use]
    pub const fn encoder_counts(wheel: u16) -> Address {
        Address::new(FIRST + wheel, 5)
    }
}

/// The histories: faults at 0x2122 (codes) and 0x2123 (times), limits at 0x2124 and 0x2125;
/// sub-index 1 is the newest.
pub mod history {
    use super::Address;

    /// Faults, and limits, that are remembered.
    pub const DEPTH: u8 = 8;

    /// Code of a fault; `nth` counts from 1, the newest.
    #[must_use]
    pub const fn code(nth: u8) -> Address {
        Address::new(0x2122, nth)
    }

    /// When that was, ms since the robot started.
    #[must_use]
    pub const fn time(nth: u8) -> Address {
        Address::new(0x2123, nth)
    }

    /// Code of a limit; `nth` counts from 1, the newest.
    #[must_use]
    pub const fn limit_code(nth: u8) -> Address {
        Address::new(0x2124, nth)
    }

    /// When it became active, ms since the robot started.
    #[must_use]
    pub const fn limit_time(nth: u8) -> Address {
        Address::new(0x2125, nth)
    }
}

/// The rollers of one wheel; wheels in the order front left, front right, rear left, rear right.
pub mod rollers {
    use super::Address;

    /// How many rollers; 0 for the ideal wheel.
    #[must_use]
    pub const fn count(wheel: u8) -> Address {
        Address::new(0x2028, wheel + 1)
    }

    /// Roller angle at the encoder's index, rad.
    #[must_use]
    pub const fn phase(wheel: u8) -> Address {
        Address::new(0x2029, wheel + 1)
    }

    /// What the wheel computes with.
    #[must_use]
    pub const fn state(wheel: u8) -> Address {
        Address::new(0x2114, wheel + 1)
    }

    /// Roller angle now, rad.
    #[must_use]
    pub const fn sweep(wheel: u8) -> Address {
        Address::new(0x2115, wheel + 1)
    }
}
