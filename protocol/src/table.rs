//! Every object of a robot beyond the communication profile: type, access, limits, default, text.
//! The pages, the EDS and the DBC are generated from this table.
//!
//! A new object also needs its address and name in `address`; if it is not a plain parameter,
//! `robot::dictionary` has to answer it.
//!
//! A parameter marked *required* has a default only so that it can be read: the robot refuses to
//! enable its drivers until it has been written. A parameter is checked against its limits when it
//! is written, and the whole set once more, as a set, when the robot is started; object 0x2002:1
//! says then what is wrong.

use crate::address::{self as at, Address, history, identified, motor, rollers, wheel};
use crate::object::{Access, Entry, Kind, Object, Value};
use crate::{MEMBER_MASK, WIRE_VERSION};

/// Limits and default of a REAL32.
const fn real(min: f32, max: f32, default: f32) -> [Value; 3] {
    [Value::F32(min), Value::F32(max), Value::F32(default)]
}

/// Limits and default of an UNSIGNED8.
const fn byte(min: u8, max: u8, default: u8) -> [Value; 3] {
    [Value::U8(min), Value::U8(max), Value::U8(default)]
}

/// Limits and default of an UNSIGNED16.
const fn word(min: u16, max: u16, default: u16) -> [Value; 3] {
    [Value::U16(min), Value::U16(max), Value::U16(default)]
}

/// Limits and default of an UNSIGNED32.
const fn long(min: u32, max: u32, default: u32) -> [Value; 3] {
    [Value::U32(min), Value::U32(max), Value::U32(default)]
}

const IDENTITY: &[Object] = &[
    wire_version(),
    Object::state(
        at::SERIAL_NUMBER,
        "Serial number",
        "",
        Kind::U32,
        "Also 0x1018:4.",
    ),
    Object::state(
        at::FIRMWARE_VERSION,
        "Firmware version",
        "",
        Kind::U32,
        "Major, minor, patch in the upper three bytes; the lowest is 0.",
    ),
    Object::state(
        at::RESET_CAUSE,
        "Reset cause",
        "",
        Kind::U8,
        "0 power, 1 reset pin, 2 software, 3 independent watchdog, 4 window watchdog, 5 low \
         power, 6 brown-out.",
    ),
    Object::state(
        at::NODE_SWITCHES,
        "Node switches",
        "",
        Kind::U8,
        "Node that the switches on the board give.",
    ),
    Object::state(
        at::NODE_STORED,
        "Stored node",
        "",
        Kind::U8,
        "Node that was stored by LSS and comes before the switches; 0 for none.",
    ),
    Object::state(
        at::CONFIGURATION_STATUS,
        "Configuration status",
        "",
        Kind::U32,
        "0 when the configuration is complete and valid. Otherwise index, sub-index and reason of \
         the first objection from the top down: reason 1 not written, 2 does not fit the rest, 3 \
         refused as stored (0 for the object: the stored image as a whole).",
    ),
    Object::state(
        at::CONFIGURATION_CRC,
        "Configuration CRC",
        "",
        Kind::U32,
        "CRC-32 (IEEE 802.3) over all parameters in the order of this table, four bytes each (of \
         the compensation set its CRC), so that a master can tell whether a robot has the \
         configuration it means.",
    ),
    Object::state(
        at::GROUP_CRC,
        "Group CRC",
        "",
        Kind::U32,
        "The same over the parameters that must be equal in all members of a group: acceleration, \
         jerk, deceleration, group, members, times, restart and stops of the group, brake release. \
         Members that differ here would not move as one.",
    ),
];

/// The parameters that must be equal in all members of a group.
pub const COMMON: &[Address] = &[
    at::ACCELERATION,
    at::ACCELERATION_YAW,
    at::JERK,
    at::JERK_YAW,
    at::DECELERATION,
    at::DECELERATION_YAW,
    at::GROUP_ID,
    at::MEMBERS,
    at::SYNC_PERIOD,
    at::SYNC_TIMEOUT,
    at::SETPOINT_TIMEOUT,
    at::HEARTBEAT_TIMEOUT,
    at::STANDSTILL_SYNCS,
    at::CUTS_TOGETHER,
    at::BRAKE_RELEASE,
];

const fn wire_version() -> Object {
    let version = Value::U16(WIRE_VERSION);
    let mut object = Object::parameter(
        at::WIRE_VERSION,
        "Wire version",
        "",
        [version, version, version],
        "Changes with the meaning of any byte on the bus. A master refuses a robot that has \
         another.",
    );
    object.access = Access::Const;
    object.persistent = false;
    object
}

const ROBOT: &[Object] = &[
    Object::required(
        at::HALF_TRACK,
        "Half track",
        "m",
        real(0.02, 5.0, 0.2),
        "Half the distance between left and right wheel centres.",
    ),
    Object::required(
        at::HALF_WHEELBASE,
        "Half wheelbase",
        "m",
        real(0.02, 5.0, 0.2),
        "Half the distance between front and rear wheel centres.",
    ),
    Object::required(
        at::WHEEL_RADIUS,
        "Wheel radius",
        "m",
        real(0.01, 1.0, 0.05),
        "From the wheel axle to the ground under a roller.",
    ),
    Object::required(
        at::ROLLER_ANGLE,
        "Roller angle",
        "rad",
        real(0.1, 1.47, core::f32::consts::FRAC_PI_4),
        "Between roller axle and wheel axle.",
    ),
    Object::parameter(
        at::INDIVIDUAL_WHEELS,
        "Individual wheels",
        "",
        byte(0, 1, 0),
        "0: four wheels alike, placed by the values above. 1: each wheel is what 0x2014 to 0x2017 \
         say; the values above then only have to be written.",
    ),
    Object::required(
        at::MOUNT_X,
        "Mount x",
        "m",
        real(-50.0, 50.0, 0.0),
        "Position of the robot in the group frame, forward.",
    ),
    Object::required(
        at::MOUNT_Y,
        "Mount y",
        "m",
        real(-50.0, 50.0, 0.0),
        "Position of the robot in the group frame, left.",
    ),
    Object::required(
        at::MOUNT_HEADING,
        "Mount heading",
        "rad",
        real(-6.3, 6.3, 0.0),
        "Heading of the robot in the group frame, counter-clockwise.",
    ),
    Object::required(
        at::COMPENSATION_LONGITUDINAL,
        "Longitudinal compensation",
        "",
        real(0.5, 2.0, 1.0),
        "Commanded over achieved velocity along x of the robot, at any speed. For an axis that \
         has no rows in 0x2013.",
    ),
    Object::required(
        at::COMPENSATION_LATERAL,
        "Lateral compensation",
        "",
        real(0.5, 2.0, 1.0),
        "Commanded over achieved velocity along y of the robot.",
    ),
    Object::required(
        at::COMPENSATION_YAW,
        "Yaw compensation",
        "",
        real(0.5, 2.0, 1.0),
        "Commanded over achieved angular velocity.",
    ),
    Object::block(
        at::COMPENSATION_SET,
        "Compensation set",
        "Tables of these coefficients over speed and direction, as one block with its version and \
         CRC; layout above. Taken whole or refused: 0x06090030 for a wrong CRC, format or order \
         of rows, 0x06090032 for a coefficient below 0.5, 0x06040043 for tables that cannot be \
         inverted. After a reset to defaults a set without rows.",
    ),
    Object::state(
        at::COMPENSATION_VERSION,
        "Version of the set",
        "",
        Kind::U32,
        "As its writer chose it; 0 where there is none.",
    ),
    Object::state(
        at::COMPENSATION_CRC,
        "CRC of the set",
        "",
        Kind::U32,
        "The first four bytes of the set.",
    ),
];

const fn wheel_record(at: u16) -> [Object; 5] {
    [
        Object::parameter(
            wheel::x(at),
            "x",
            "m",
            real(-10.0, 10.0, 0.0),
            "Wheel centre, forward of the robot's origin.",
        ),
        Object::parameter(
            wheel::y(at),
            "y",
            "m",
            real(-10.0, 10.0, 0.0),
            "Wheel centre, left of the robot's origin.",
        ),
        Object::parameter(
            wheel::radius(at),
            "Radius",
            "m",
            real(0.0, 1.0, 0.0),
            "From the axle to the ground under a roller; used where 0x2010:5 is 1, and then above \
             0.",
        ),
        Object::parameter(
            wheel::roller_angle(at),
            "Roller angle",
            "rad",
            real(-1.47, 1.47, 0.0),
            "Of the ground roller's axle against the wheel's axle, counter-clockwise from above; \
             on the usual robot positive front left and rear right, negative on the others. Not 0 \
             where 0x2010:5 is 1.",
        ),
        Object::parameter(
            wheel::encoder_counts(at),
            "Encoder counts",
            "counts",
            real(0.0, 1_000_000.0, 0.0),
            "Of this wheel, in place of 0x2020:1; 0 for the same as the others.",
        ),
    ]
}

const DRIVE: &[Object] = &[Object::parameter(
    at::GEAR_RATIO,
    "Gear ratio",
    "",
    real(0.01, 1_000.0, 1.0),
    "Revolutions of the encoder's shaft in one of the wheel. 1 where the counts are those of the \
     wheel.",
)];

const WHEELS: &[Object] = &[
    Object::required(
        at::ENCODER_COUNTS,
        "Encoder counts per revolution",
        "counts",
        real(16.0, 1_000_000.0, 2048.0),
        "All edges counted, in a revolution of the encoder's shaft: of the wheel where 0x2018:1 \
         is 1. May be a fraction.",
    ),
    Object::required(
        at::ENCODER_REVERSED,
        "Reversed encoders",
        "",
        byte(0, 15, 0),
        "Bit 0 front left, 1 front right, 2 rear left, 3 rear right: this encoder counts down \
         when the wheel rolls the base forward.",
    ),
    Object::required(
        at::MOTOR_REVERSED,
        "Reversed motors",
        "",
        byte(0, 15, 0),
        "Bits as above: this motor rolls the base backward with a positive duty.",
    ),
    Object::parameter(
        at::OBSERVER_BANDWIDTH,
        "Observer bandwidth",
        "rad/s",
        real(5.0, 400.0, 100.0),
        "Natural frequency of the wheel-rate observer.",
    ),
];

const WHEEL_NAMES: [&str; 4] = ["Front left", "Front right", "Rear left", "Rear right"];

const fn roller_record(phase: bool) -> [Object; 4] {
    const fn one(phase: bool, wheel: u8, name: &'static str) -> Object {
        if phase {
            Object::parameter(
                rollers::phase(wheel),
                name,
                "rad",
                real(-1.048, 1.048, 0.0),
                "How far the wheel has rolled on past the middle of its ground roller when its \
                 index comes, once a turn of the wheel. From calibration.",
            )
        } else {
            Object::parameter(
                rollers::count(wheel),
                name,
                "",
                byte(0, 64, 0),
                "Rollers of this wheel, 3 at least; 0 computes with ideal rollers.",
            )
        }
    }
    let [a, b, c, d] = WHEEL_NAMES;
    [
        one(phase, 0, a),
        one(phase, 1, b),
        one(phase, 2, c),
        one(phase, 3, d),
    ]
}

const ENCODER_INPUTS: &[Object] = &[Object::parameter(
    at::ENCODER_FILTER,
    "Filter",
    "",
    byte(0, 15, 3),
    "Digital filter of the encoder channels, ICxF of RM0390 18.4.7 at 90 MHz: a level counts once \
     it has lasted 0, 2, 4, 8, 12, 16, 24, 32, 48, 64, 80, 96, 128, 160, 192 or 256 clocks of \
     11.1 ns; 3 is 89 ns. Refused where the counts at the maximum wheel rate come faster than one \
     in that time.",
)];

const ROLLER_REFERENCE: &[Object] = &[
    Object::parameter(
        at::ROLLER_REFERENCE,
        "Source",
        "",
        byte(0, 1, 0),
        "Where the angle of the rollers comes from: 0 nowhere, every wheel computes with the mean \
         over its rollers; 1 the index inputs, once a turn of the wheel each: behind a gear that \
         takes a sensor on the wheel.",
    ),
    Object::parameter(
        at::INDEX_TOLERANCE,
        "Index tolerance",
        "counts",
        word(1, 10_000, 20),
        "An index further than this from a whole number of turns after the last is unexpected. \
         Covers two counts and the play between encoder and wheel; at most 1/64 of a turn is \
         used.",
    ),
];

const fn roller_state(sweep: bool) -> [Object; 4] {
    const fn one(sweep: bool, wheel: u8, name: &'static str) -> Object {
        if sweep {
            Object::state(
                rollers::sweep(wheel),
                name,
                "rad",
                Kind::F32,
                "How far the wheel has rolled on past the middle of its ground roller now; true \
                 when the state is 2.",
            )
        } else {
            Object::state(
                rollers::state(wheel),
                name,
                "",
                Kind::U8,
                "0 ideal rollers; 1 the mean over a roller, index not seen yet; 2 the roller's \
                 angle; 3 the mean, the reference was wrong or has slipped.",
            )
        }
    }
    let [a, b, c, d] = WHEEL_NAMES;
    [
        one(sweep, 0, a),
        one(sweep, 1, b),
        one(sweep, 2, c),
        one(sweep, 3, d),
    ]
}

const fn motor_record(wheel: u16) -> [Object; 5] {
    [
        Object::required(
            motor::static_friction(wheel),
            "Static friction",
            "V",
            real(0.0, 50.0, 0.0),
            "Voltage at which the wheel just keeps turning.",
        ),
        Object::required(
            motor::speed(wheel),
            "Speed feedforward",
            "V s/rad",
            real(0.0, 100.0, 0.0),
            "Additional voltage per wheel rate.",
        ),
        Object::required(
            motor::acceleration(wheel),
            "Acceleration feedforward",
            "V s^2/rad",
            real(0.0, 50.0, 0.0),
            "Additional voltage per wheel acceleration.",
        ),
        Object::required(
            motor::proportional(wheel),
            "Proportional gain",
            "V s/rad",
            real(0.0, 100.0, 0.0),
            "Voltage per error of the wheel rate.",
        ),
        Object::required(
            motor::integral(wheel),
            "Integral gain",
            "V/rad",
            real(0.0, 2000.0, 0.0),
            "Voltage per error of the wheel angle.",
        ),
    ]
}

const SUPPLY: &[Object] = &[
    Object::required(
        at::SUPPLY_NOMINAL,
        "Nominal supply",
        "V",
        real(1.0, 100.0, 24.0),
        "Voltage at full duty where the supply is not measured.",
    ),
    Object::parameter(
        at::SUPPLY_MINIMUM,
        "Minimum supply",
        "V",
        real(0.0, 100.0, 0.0),
        "Below this for 100 ms the robot comes to rest. 0 says that the supply is not measured: \
         no check, and no correction of the duty.",
    ),
    Object::parameter(
        at::SUPPLY_MAXIMUM,
        "Maximum supply",
        "V",
        real(0.0, 100.0, 0.0),
        "Above this for 10 ms the drivers are switched off, because braking on would raise it \
         further. 0 for no check. Not checked where the supply is not measured (0x2025:2 is 0).",
    ),
    Object::parameter(
        at::SUPPLY_MARGIN,
        "Supply margin",
        "V",
        real(0.0, 50.0, 1.0),
        "Less than this above the minimum, the supply limit is reported.",
    ),
    Object::parameter(
        at::SUPPLY_DIVIDER,
        "Supply divider",
        "",
        real(1.0, 100.0, 11.0),
        "Supply voltage per voltage at the measuring input; 11 is 100 kOhm and 10 kOhm, for at \
         most 36 V at 3.3 V.",
    ),
];

const TORQUE: &[Object] = &[
    Object::parameter(
        at::WINDING_RESISTANCE,
        "Winding resistance",
        "ohm",
        real(0.0, 100.0, 0.0),
        "Of a motor with its leads and bridge; 0 where it is not known.",
    ),
    Object::parameter(
        at::CURRENT_MAX,
        "Largest current",
        "A",
        real(0.0, 1000.0, 0.0),
        "Of a motor. A wheel gets at most this times the resistance beyond its back EMF. With \
         both 0 the bound is half of the nominal supply; one without the other is refused.",
    ),
    Object::parameter(
        at::CURRENT_SCALE,
        "Current scale",
        "A/V",
        real(0.0, 1000.0, 0.0),
        "Current per voltage at a current sensor's input; 0: none is connected. More than 1.25 \
         times what four motors may take (0x2026:2), or an input at the end of its range, for 20 \
         ms is fault OverCurrent. The range must reach that far.",
    ),
    Object::parameter(
        at::CURRENT_OFFSET,
        "Current offset",
        "V",
        real(0.0, 3.3, 0.0),
        "Voltage at the input without current: 0 for a shunt, half of the range for most Hall \
         sensors.",
    ),
    Object::parameter(
        at::CURRENT_INPUTS,
        "Current inputs",
        "",
        byte(1, 3, 1),
        "How many inputs are added up, from the first: 1 for one sensor that sees all motors, 2 \
         or 3 for sensors that each see some of them. They have the same scale and offset.",
    ),
];

const OUTPUT_STAGE: &[Object] = &[
    Object::parameter(
        at::DUTY_MAX,
        "Largest duty",
        "",
        real(0.1, 1.0, 1.0),
        "Less than 1 for bridges whose high side needs pauses to charge (bootstrap).",
    ),
    Object::parameter(
        at::DIRECTION_PAUSE,
        "Direction pause",
        "",
        byte(0, 1, 0),
        "1: a bridge gets no duty for one tick before it changes its direction.",
    ),
    Object::parameter(
        at::BRAKE_RELEASE,
        "Brake release time",
        "ms",
        word(0, 1000, 0),
        "What the slowest brake of the group takes to let go, the same in all members. So long \
         after it was released nothing is followed and no wheel is judged; the loops hold.",
    ),
    Object::parameter(
        at::BRAKE_ENGAGE,
        "Brake engage time",
        "ms",
        word(0, 1000, 0),
        "What the brake takes to hold. So long after it was engaged at standstill the drivers \
         stay on and the loops hold. A cut does not wait.",
    ),
    Object::parameter(
        at::PWM_FREQUENCY,
        "PWM frequency",
        "Hz",
        word(8_000, 40_000, 20_000),
        "What drivers and motors want. Below 16 kHz it is heard; above 20 kHz many drivers lose \
         more.",
    ),
];

const LIMITS: &[Object] = &[
    Object::required(
        at::WHEEL_RATE_MAX,
        "Maximum wheel rate",
        "rad/s",
        real(0.1, 65.0, 10.0),
        "What this robot's wheels can follow; sets its permitted group scale.",
    ),
    Object::required(
        at::ACCELERATION,
        "Group acceleration",
        "m/s^2",
        real(0.01, 20.0, 1.0),
        "Largest acceleration of the group frame's origin. The same in every member.",
    ),
    Object::required(
        at::ACCELERATION_YAW,
        "Group angular acceleration",
        "rad/s^2",
        real(0.01, 50.0, 1.0),
        "The same about z.",
    ),
    Object::required(
        at::JERK,
        "Group jerk",
        "m/s^3",
        real(0.1, 2000.0, 20.0),
        "Largest change of acceleration per second. The same in every member.",
    ),
    Object::required(
        at::JERK_YAW,
        "Group angular jerk",
        "rad/s^3",
        real(0.1, 5000.0, 20.0),
        "The same about z.",
    ),
    Object::required(
        at::DECELERATION,
        "Ramp deceleration",
        "m/s^2",
        real(0.05, 20.0, 1.0),
        "Of every ramp to standstill, along the direction of motion. The same in every member.",
    ),
    Object::required(
        at::DECELERATION_YAW,
        "Ramp angular deceleration",
        "rad/s^2",
        real(0.05, 50.0, 1.0),
        "The same about z; the slower of the two decides.",
    ),
    Object::parameter(
        at::SLIP_LIMIT,
        "Slip limit",
        "rad/s",
        real(0.0, 60.0, 1.0),
        "Slip residual above which the slip limit is reported; 0 for never.",
    ),
    Object::parameter(
        at::SLIP_FAULT,
        "Slip fault",
        "rad/s",
        real(0.0, 60.0, 2.5),
        "Slip residual above which the robot comes to rest; 0 for never. It must last for one and a \
         half times 0x2031:6, and 300 ms at least. No drive of the tests without a fault has 0.1 \
         for that long; one wheel that stands still while the others roll at 0.6 m/s (152 mm) has \
         2.0, and is named by the wheel watch.",
    ),
    Object::parameter(
        at::STRAIN_LIMIT,
        "Strain limit",
        "m/s",
        real(0.0, 5.0, 0.05),
        "Difference between this robot's and another member's measured group twist, at this \
         robot's place, above which the strain limit is reported; 0 for never.",
    ),
    Object::parameter(
        at::STRAIN_FAULT,
        "Strain fault",
        "m/s",
        real(0.0, 5.0, 0.3),
        "The same, above which the robot comes to rest; 0 for never. It must last as long as slip \
         above 0x2031:2. No drive of the tests without a fault has 0.01 for that long; a member \
         with one dead encoder at 0.6 m/s has 0.21, and is named by its wheel watch.",
    ),
    Object::parameter(
        at::BLOCKED_RATE,
        "Blocked wheel",
        "rad/s",
        real(0.0, 60.0, 2.0),
        "Wheel rate asked for and not reached that means a blocked or dead wheel; 0 for no check.",
    ),
    Object::parameter(
        at::WHEEL_FAULT_TIME,
        "Wheel fault time",
        "ms",
        word(10, 2000, 200),
        "How long that must last.",
    ),
];

const GROUP: &[Object] = &[
    Object::required(
        at::GROUP_ID,
        "Group",
        "",
        byte(0, 255, 0),
        "Group twists for another group are not for this robot: they are neither taken nor \
         counted, so several groups can share a bus, its SYNC and its master's heartbeat.",
    ),
    Object::required(
        at::MEMBERS,
        "Members",
        "",
        long(4, MEMBER_MASK, 4),
        "Bit n stands for node n; robots are 2 to 17. This robot must be among them; only a robot \
         that is alone among them may move on its own (0x2050:1).",
    ),
    Object::parameter(
        at::SYNC_PERIOD,
        "SYNC period",
        "us",
        long(2_000, 100_000, 10_000),
        "Also the time over which one setpoint passes into the next.",
    ),
    Object::parameter(
        at::SYNC_TIMEOUT,
        "SYNC timeout",
        "ms",
        word(0, 1000, 0),
        "Moving, without SYNC for this long: ramp down; 0 for two and a quarter periods. When a \
         member's status is missing, too, a period and a quarter is enough.",
    ),
    Object::parameter(
        at::SETPOINT_TIMEOUT,
        "Setpoint timeout",
        "ms",
        word(4, 5000, 100),
        "Moving, without a fresh setpoint for this long: ramp down.",
    ),
    Object::parameter(
        at::HEARTBEAT_TIMEOUT,
        "Master heartbeat timeout",
        "ms",
        word(10, 10_000, 500),
        "Armed or moving, without the master's heartbeat for this long: ramp down. Only one that \
         says OPERATIONAL counts; a boot-up message is a stop.",
    ),
    Object::parameter(
        at::STANDSTILL_SYNCS,
        "Standstill before motion",
        "SYNCs",
        byte(1, 250, 3),
        "After a start, so many SYNCs in a row must bring a setpoint of less than 0.01 m/s and \
         0.01 rad/s that all members agree on; until then any other is a scale of 0.",
    ),
    Object::parameter(
        at::PROTECTIVE_STOP,
        "Protective stop",
        "",
        byte(0, 1, 0),
        "1: a normally closed contact is connected to the protective stop input; open is a ramp, \
         then outputs off.",
    ),
    Object::parameter(
        at::CUTS_TOGETHER,
        "Cut together",
        "",
        byte(0, 1, 0),
        "1: the emergency stop of one member is a cut for all, announced by its emergency \
         message; 0: the others ramp.",
    ),
];

const COMMISSIONING: &[Object] = &[
    Object::command(
        at::COMMISSIONING,
        "Commissioning permission",
        "",
        Kind::U8,
        "1 declares that this robot may move on its own: not coupled to a load, wheels free or \
         area clear. Refused with 0x06040043 unless 0x2040:2 names this robot alone, or 0x2050:2 \
         is 1. Gone after every change of the NMT state and after 60 s; writing 1 again gives \
         another 60 s. A commissioning twist is followed up to 0.25 m/s and 0.5 rad/s.",
    ),
    Object::command(
        at::ALONE_FOR_NOW,
        "Alone for now",
        "",
        Kind::U8,
        "1 makes a robot that is a member of a group its own only member for a test: it needs no \
         votes but its own and follows no group twist, and its vote lets the group not move \
         either (limit 0x000E). Only before NMT start. Gone when the robot leaves OPERATIONAL, \
         when the master's heartbeat is overdue (0x2041:4) and when the master boots.",
    ),
];

const IDENTIFICATION: &[Object] = &[
    Object::command(
        at::IDENTIFY,
        "Identification",
        "",
        Kind::U8,
        "1 begins to identify the motors: all wheels forward on a slow ramp of voltage, then \
         backward on a step. Refused unless the robot is started, stands, and 0x2050:1 is 1. 0 \
         stops. However it ends, the robot comes to rest and needs an NMT start.",
    ),
    Object::state(
        at::IDENTIFY_STATUS,
        "Identification status",
        "",
        Kind::U8,
        "0 never run, 1 running, 2 done; stopped: 3 by the master, 4 by a fault, 5 by its time \
         limit of 20 s, 6 wheel too fast, 7 wheel too far, 8 wheel does not turn, 9 wheel turns \
         backwards, 10 no motor's behaviour.",
    ),
    Object::state(
        at::IDENTIFY_WHEEL,
        "Identification wheel",
        "",
        Kind::U8,
        "The wheel that stopped it: 0 front left, 1 front right, 2 rear left, 3 rear right; 255 \
         none.",
    ),
    Object::setting(
        at::IDENTIFY_RATE,
        "Identification wheel rate",
        "rad/s",
        real(0.5, 50.0, 5.0),
        "The ramp ends when a wheel is that fast; half as much again stops it.",
    ),
    Object::setting(
        at::IDENTIFY_TRAVEL,
        "Identification travel",
        "rad",
        real(1.0, 200.0, 12.0),
        "Farthest a wheel may turn from where it stood; the ramp ends at three fifths of it.",
    ),
    Object::setting(
        at::IDENTIFY_BANDWIDTH,
        "Identification bandwidth",
        "rad/s",
        real(1.0, 100.0, 10.0),
        "Of the loop for which 0x2052 to 0x2055 show gains.",
    ),
    Object::setting(
        at::IDENTIFY_DAMPING,
        "Identification damping",
        "",
        real(0.5, 2.0, 1.0),
        "Of the same; 1 is critical.",
    ),
    Object::setting(
        at::IDENTIFY_WHEELS,
        "Identification wheels",
        "",
        byte(0, 15, 0),
        "Wheels that get the voltage: bit 0 front left, 1 front right, 2 rear left, 3 rear right; \
         0 is all. The others need not turn: for wheels off the floor.",
    ),
];

const BLINK: &[Object] = &[Object::command(
    at::BLINK,
    "Blink",
    "s",
    Kind::U8,
    "For so many seconds the LED shows which robot this is: five short flashes and a pause. 0 \
     ends it. Reads as the seconds left.",
)];

const fn identified_record(wheel: u16) -> [Object; 6] {
    const fn result(wheel: u16, sub: u8, name: &'static str, unit: &'static str) -> Object {
        let text = "Found by the last identification; 0 before. Not in effect until it is written \
            to the motor's object.";
        Object::state(identified::value(wheel, sub), name, unit, Kind::F32, text)
    }
    [
        result(wheel, 1, "Static friction", "V"),
        result(wheel, 2, "Speed", "V s/rad"),
        result(wheel, 3, "Acceleration", "V s^2/rad"),
        result(wheel, 4, "Proportional", "V s/rad"),
        result(wheel, 5, "Integral", "V/rad"),
        result(wheel, 6, "Misfit", "V"),
    ]
}

const fn twist_fields(
    index: u16,
    access: Access,
    name: [&'static str; 5],
    of: &'static str,
) -> [Object; 5] {
    const fn field(
        address: Address,
        access: Access,
        name: &'static str,
        unit: &'static str,
        kind: Kind,
        text: &'static str,
    ) -> Object {
        let mut object = Object::state(address, name, unit, kind, text).mapped();
        object.access = access;
        object
    }
    let [vx, vy, omega, sequence, group] = name;
    [
        field(
            Address::new(index, 1),
            access,
            vx,
            "0.1 mm/s",
            Kind::I16,
            of,
        ),
        field(
            Address::new(index, 2),
            access,
            vy,
            "0.1 mm/s",
            Kind::I16,
            of,
        ),
        field(
            Address::new(index, 3),
            access,
            omega,
            "0.1 mrad/s",
            Kind::I16,
            of,
        ),
        field(Address::new(index, 4), access, sequence, "", Kind::U8, of),
        field(Address::new(index, 5), access, group, "", Kind::U8, of),
    ]
}

const SETPOINT: [Object; 5] = twist_fields(
    at::SETPOINT_VX.index,
    Access::ReadWrite,
    ["vx", "vy", "omega", "sequence", "group"],
    "Group twist as received by RPDO1, in the group frame; -32768 is invalid.",
);

const ALONE: [Object; 5] = twist_fields(
    at::ALONE_VX.index,
    Access::ReadWrite,
    ["vx", "vy", "omega", "sequence", "group"],
    "Commissioning twist as received by RPDO2, in the robot's frame; -32768 is invalid.",
);

const STATUS: &[Object] = &[
    Object::state(
        at::STATE,
        "State",
        "",
        Kind::U8,
        "0 unconfigured, 1 ready, 2 armed, 3 moving, 4 alone, 5 ramping, 6 faulted.",
    )
    .mapped(),
    Object::state(
        at::STATUS_SEQUENCE,
        "Echoed sequence",
        "",
        Kind::U8,
        "Of the setpoint latched at the last SYNC.",
    )
    .mapped(),
    Object::state(
        at::STATUS_SCALE,
        "Permitted group scale",
        "1/65535",
        Kind::U16,
        "Scale at which this robot's own wheels can follow; 0 stops the group.",
    )
    .mapped(),
    Object::state(
        at::STATUS_SLIP,
        "Slip residual",
        "20 mrad/s",
        Kind::U8,
        "Magnitude of the wheel rates that no rigid motion explains; 254 is this or more, 255 not \
         measured. With its sign and in full: 0x2120:2.",
    )
    .mapped(),
    Object::state(
        at::STATUS_CODE,
        "Limit or fault",
        "",
        Kind::U16,
        "0 nothing, below 0x1000 a limit, else a fault; the number is that of the emergency \
         message.",
    )
    .mapped(),
    Object::state(
        at::STATUS_PLAN,
        "Plan checksum",
        "",
        Kind::U8,
        "Over what this robot is about to do: the setpoint as it understood it, its group \
         parameters, its communication objects. Members that differ stop the group.",
    )
    .mapped(),
];

const MEASURED: [Object; 5] = twist_fields(
    at::MEASURED_VX.index,
    Access::ReadOnly,
    ["vx", "vy", "omega", "sequence", "group"],
    "Velocity of the group as this robot's wheels measure it, in the group frame.",
);

const POSE: &[Object] = &[
    Object::state(
        at::POSE_X,
        "x",
        "0.1 mm",
        Kind::I24,
        "Position of the group frame since the robot was configured.",
    )
    .mapped(),
    Object::state(
        at::POSE_Y,
        "y",
        "0.1 mm",
        Kind::I24,
        "The same to the left.",
    )
    .mapped(),
    Object::state(
        at::POSE_HEADING,
        "Heading",
        "0.1 mrad",
        Kind::I16,
        "Heading of the group frame, within +-pi.",
    )
    .mapped(),
];

const fn rate(address: Address, name: &'static str) -> Object {
    Object::state(
        address,
        name,
        "2 mrad/s",
        Kind::I16,
        "Measured wheel rate; positive rolls the base forward.",
    )
    .mapped()
}

const RATES: &[Object] = &[
    rate(at::RATE_FRONT_LEFT, "Front left"),
    rate(at::RATE_FRONT_RIGHT, "Front right"),
    rate(at::RATE_REAR_LEFT, "Rear left"),
    rate(at::RATE_REAR_RIGHT, "Rear right"),
];

const fn counter(address: Address, name: &'static str, text: &'static str) -> Object {
    Object::state(address, name, "", Kind::U32, text)
}

const DIAGNOSTICS: &[Object] = &[
    Object::state(
        at::SUPPLY,
        "Supply voltage",
        "V",
        Kind::F32,
        "As measured; 0 where it is not.",
    ),
    Object::state(
        at::SLIP,
        "Slip residual",
        "rad/s",
        Kind::F32,
        "Wheel rates that no rigid motion explains; 0 when not measured.",
    ),
    Object::state(
        at::CURRENT,
        "Motor current",
        "A",
        Kind::F32,
        "As the sensors of 0x2026:3 see it, with its sign; 0 where it is not measured.",
    ),
    counter(
        at::LATE_TICKS,
        "Late ticks",
        "Control ticks more than half a period late.",
    ),
    counter(at::LOST_SYNCS, "Lost SYNCs", "Gaps in the SYNC counter."),
    counter(
        at::IGNORED_SETPOINTS,
        "Ignored setpoints",
        "Invalid, or with a sequence that does not follow the last.",
    ),
    counter(
        at::REFUSED_WRITES,
        "Refused writes",
        "Writes to this table that were refused.",
    ),
    counter(
        at::STOPS,
        "Stops",
        "Times a fault brought the robot to rest.",
    ),
    counter(at::WATCHDOG_RESETS, "Watchdog resets", "Since power came."),
    counter(
        at::CAN_ERRORS,
        "CAN errors",
        "Frames lost by overflow or bus-off.",
    ),
];

const CAN: &[Object] = &[
    Object::state(
        at::CAN_TRANSMIT_ERRORS,
        "Transmit errors",
        "",
        Kind::U8,
        "Transmit error counter (ISO 11898-1): 8 up with a frame that failed, 1 down with one \
         that did not; from 128 on the controller is error passive, above 255 it is off the bus.",
    ),
    Object::state(
        at::CAN_RECEIVE_ERRORS,
        "Receive errors",
        "",
        Kind::U8,
        "Receive error counter: 1 to 9 up with a frame that was broken, 1 down with a good one; \
         from 128 on error passive.",
    ),
    Object::state(
        at::CAN_LAST_ERROR,
        "Last error",
        "",
        Kind::U8,
        "0 none since the start, 1 stuffing, 2 form, 3 not acknowledged, 4 recessive bit read as \
         dominant, 5 dominant bit read as recessive, 6 checksum. Looked at every few ms, so one \
         of several may be missed.",
    ),
    counter(
        at::CAN_PASSIVES,
        "Times error passive",
        "Since power came. Each is announced by emergency message 0x8120 and taken back once both \
         error counters are below 96.",
    ),
    counter(at::CAN_BUS_OFFS, "Times bus-off", "Since power came."),
];

const STORE: &[Object] = &[
    counter(
        at::SAVES,
        "Saves",
        "Images stored since the store was new, kept with them.",
    ),
    counter(
        at::ERASES,
        "Erases",
        "Sectors erased since the store was new, each of the two half as often; a save that was \
         cut off counts as one. The chip is made for 10 000 of each.",
    ),
    counter(
        at::CUT_SAVES,
        "Cut saves",
        "Saves during which power was lost; announced as fault 0xFF15 at the next start.",
    ),
];

const POWER: &[Object] = &[
    Object::state(
        at::CLOCK_WAIT,
        "Wait at start",
        "ms",
        Kind::U16,
        "How long the last start waited for the clock from outside and for the processor's supply.",
    ),
    Object::state(
        at::BROWN_OUT_LEVEL,
        "Brown-out reset",
        "",
        Kind::U8,
        "Level of the processor's brown-out reset: 3, programmed at the first start, resets below \
         2.8 V. Below 2.7 V the processor is not reliable; 0 is off.",
    ),
];

const FAULT_MEMORY: &[Object] = &[
    Object::state(
        at::STORED_FAULTS,
        "Stored faults",
        "",
        Kind::Domain,
        "The last eight faults, kept over power losses, the newest first: 32 bytes each, layout \
         above. Shorter while there have been fewer.",
    ),
    counter(
        at::START_NUMBER,
        "Start",
        "Number of this start, from 1; starts that do not last a second are not counted.",
    ),
    Object::state(
        at::UNSTORED_FAULTS,
        "Unstored",
        "",
        Kind::U8,
        "How many of these faults are not in flash yet: they are written at rest, at most eight \
         every 10 s.",
    ),
    Object::state(
        at::UPTIME,
        "Uptime",
        "ms",
        Kind::U32,
        "Time since the robot started, on the clock of 0x2123 and 0x2125.",
    ),
];

const fn history_record(index: u16) -> [Object; history::DEPTH as usize] {
    const NAMES: [&str; 8] = [
        "Newest", "Second", "Third", "Fourth", "Fifth", "Sixth", "Seventh", "Eighth",
    ];
    let [a, b, c, d, e, f, g, h] = NAMES;
    const fn one(index: u16, nth: u8, name: &'static str) -> Object {
        let at = Address::new(index, nth);
        match index {
            0x2122 => Object::state(
                at,
                name,
                "",
                Kind::U16,
                "Fault code; 0 when there was none.",
            ),
            0x2123 => Object::state(
                at,
                name,
                "ms",
                Kind::U32,
                "When that fault appeared, since the robot started.",
            ),
            0x2124 => Object::state(
                at,
                name,
                "",
                Kind::U16,
                "Limit code; 0 when there was none.",
            ),
            _ => Object::state(
                at,
                name,
                "ms",
                Kind::U32,
                "When that limit became active, since the robot started.",
            ),
        }
    }
    [
        one(index, 1, a),
        one(index, 2, b),
        one(index, 3, c),
        one(index, 4, d),
        one(index, 5, e),
        one(index, 6, f),
        one(index, 7, g),
        one(index, 8, h),
    ]
}

const PARTS: &[&[Object]] = &[
    IDENTITY,
    ROBOT,
    &wheel_record(0),
    &wheel_record(1),
    &wheel_record(2),
    &wheel_record(3),
    DRIVE,
    WHEELS,
    &motor_record(0),
    &motor_record(1),
    &motor_record(2),
    &motor_record(3),
    SUPPLY,
    TORQUE,
    OUTPUT_STAGE,
    &roller_record(false),
    &roller_record(true),
    ROLLER_REFERENCE,
    ENCODER_INPUTS,
    LIMITS,
    GROUP,
    COMMISSIONING,
    IDENTIFICATION,
    &identified_record(0),
    &identified_record(1),
    &identified_record(2),
    &identified_record(3),
    BLINK,
    &SETPOINT,
    &ALONE,
    STATUS,
    &MEASURED,
    POSE,
    RATES,
    &roller_state(false),
    &roller_state(true),
    DIAGNOSTICS,
    &history_record(0x2122),
    &history_record(0x2123),
    &history_record(0x2124),
    &history_record(0x2125),
    STORE,
    POWER,
    FAULT_MEMORY,
    CAN,
];

/// Name of the object or record at an index, for the EDS and the protocol page.
pub const RECORDS: &[(u16, &str)] = &[
    (0x2000, "Wire version"),
    (0x2001, "Device"),
    (0x2002, "Configuration"),
    (0x2010, "Geometry"),
    (0x2011, "Mount"),
    (0x2012, "Compensation"),
    (0x2013, "Compensation tables"),
    (0x2014, "Wheel front left"),
    (0x2015, "Wheel front right"),
    (0x2016, "Wheel rear left"),
    (0x2017, "Wheel rear right"),
    (0x2018, "Drive"),
    (0x2020, "Wheels"),
    (0x2021, "Motor front left"),
    (0x2022, "Motor front right"),
    (0x2023, "Motor rear left"),
    (0x2024, "Motor rear right"),
    (0x2025, "Supply"),
    (0x2026, "Torque"),
    (0x2027, "Output stage"),
    (0x2028, "Roller counts"),
    (0x2029, "Roller phases"),
    (0x202A, "Roller reference"),
    (0x202B, "Encoder inputs"),
    (0x2030, "Limits"),
    (0x2031, "Thresholds"),
    (0x2040, "Group"),
    (0x2041, "Times"),
    (0x2042, "Restart and stops"),
    (0x2050, "Commissioning"),
    (0x2051, "Identification"),
    (0x2052, "Identified front left"),
    (0x2053, "Identified front right"),
    (0x2054, "Identified rear left"),
    (0x2055, "Identified rear right"),
    (0x2059, "Blink"),
    (0x2100, "Group twist"),
    (0x2101, "Commissioning twist"),
    (0x2110, "Status"),
    (0x2111, "Measured twist"),
    (0x2112, "Pose"),
    (0x2113, "Wheel rates"),
    (0x2114, "Roller states"),
    (0x2115, "Roller angles"),
    (0x2120, "Measurements"),
    (0x2121, "Counters"),
    (0x2122, "Fault codes"),
    (0x2123, "Fault times"),
    (0x2124, "Limit codes"),
    (0x2125, "Limit times"),
    (0x2126, "Store"),
    (0x2127, "Clock and supply"),
    (0x2128, "Fault memory"),
    (0x2129, "State of the fault memory"),
    (0x2130, "CAN"),
];

/// How many objects there are.
pub const COUNT: usize = count();

/// How many of them are parameters and so have a slot in the robot's store.
pub const PARAMETERS: usize = parameters();

/// Every object, by rising address.
pub static OBJECTS: &[Object] = &FLAT;

/// The same without the texts, for the robot.
pub static ENTRIES: [Entry; COUNT] = entries();

static FLAT: [Object; COUNT] = flat();

const fn count() -> usize {
    let mut parts = PARTS;
    let mut count = 0;
    while let Some((part, rest)) = parts.split_first() {
        count += part.len();
        parts = rest;
    }
    count
}

const fn parameters() -> usize {
    let mut objects = OBJECTS;
    let mut count = 0;
    while let Some((object, rest)) = objects.split_first() {
        if matches!(object.access, Access::Parameter) {
            count += 1;
        }
        objects = rest;
    }
    count
}

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn flat() -> [Object; COUNT] {
    let mut out = [wire_version(); COUNT];
    let mut parts = PARTS;
    let mut next = 0;
    while let Some((part, rest)) = parts.split_first() {
        let mut part: &[Object] = part;
        while let Some((object, others)) = part.split_first() {
            assert!(
                next == 0 || out[next - 1].address.packed() < object.address.packed(),
                "the table is not in order"
            );
            out[next] = *object;
            next += 1;
            part = others;
        }
        parts = rest;
    }
    out
}

/// Lowest and highest value and default of an object, as words.
type Range = [u32; 3];

/// Every combination that occurs, once, and how many there are.
const UNIQUE: ([Range; COUNT], usize) = unique();

/// The same for the robot: most objects share theirs with others.
static RANGES: [Range; UNIQUE.1] = ranges();

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn unique() -> ([Range; COUNT], usize) {
    let mut out = [[0; 3]; COUNT];
    let (mut next, mut found) = (0, 0);
    while next < COUNT {
        let range = FLAT[next].range();
        if place(&out, found, range) == found {
            out[found] = range;
            found += 1;
        }
        next += 1;
    }
    (out, found)
}

/// Where a range is among the first `count`; `count` if it is not there.
#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn place(ranges: &[Range; COUNT], count: usize, [a, b, c]: Range) -> usize {
    let mut at = 0;
    while at < count {
        let [x, y, z] = ranges[at];
        if a == x && b == y && c == z {
            return at;
        }
        at += 1;
    }
    count
}

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn ranges() -> [Range; UNIQUE.1] {
    let mut out = [[0; 3]; UNIQUE.1];
    let mut next = 0;
    while next < out.len() {
        out[next] = UNIQUE.0[next];
        next += 1;
    }
    out
}

/// Lowest and highest value and default, by [`Entry`]'s number.
pub(crate) fn range(number: u8) -> Range {
    RANGES.get(usize::from(number)).copied().unwrap_or([0; 3])
}

#[expect(
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    reason = "evaluated by the compiler only, with the numbers asserted"
)]
const fn entries() -> [Entry; COUNT] {
    const { assert!(PARAMETERS < 256 && UNIQUE.1 < 256, "both are bytes") };
    let mut out = [Entry::of(&FLAT[0], 0, None); COUNT];
    let (mut next, mut slot) = (0, 0_usize);
    while next < COUNT {
        let object = &FLAT[next];
        let range = place(&UNIQUE.0, UNIQUE.1, object.range()) as u8;
        out[next] = if matches!(object.access, Access::Parameter) {
            slot += 1;
            Entry::of(object, range, Some((slot - 1) as u8))
        } else {
            Entry::of(object, range, None)
        };
        next += 1;
    }
    out
}

/// The entry of an object, or `None` when there is no such object.
#[must_use]
pub fn entry(address: Address) -> Option<&'static Entry> {
    let found = ENTRIES
        .binary_search_by_key(&address.packed(), |entry| entry.address.packed())
        .ok()?;
    ENTRIES.get(found)
}

/// The highest sub-index at an index: what sub-index 0 of a record reads. `None` when there is no
/// such index, 0 when it is no record.
#[must_use]
pub fn highest_sub(index: u16) -> Option<u8> {
    let end = ENTRIES.partition_point(|entry| entry.address.index <= index);
    let last = ENTRIES.get(end.checked_sub(1)?)?;
    (last.address.index == index).then_some(last.address.sub)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_object_is_found_by_its_address() {
        for object in OBJECTS {
            let entry = entry(object.address).unwrap();
            assert_eq!(entry.address, object.address);
            assert_eq!(entry.kind, object.kind);
            assert_eq!(entry.min(), object.min);
            assert_eq!(entry.max(), object.max);
            assert_eq!(entry.default(), object.default);
        }
        assert!(entry(Address::new(0x2000, 1)).is_none());
        assert!(entry(Address::new(0x2FFF, 0)).is_none());
    }

    #[test]
    fn every_default_is_within_its_own_limits() {
        for object in OBJECTS {
            assert_eq!(
                object.default.check(object.min, object.max),
                Ok(()),
                "{:?} {}",
                object.address,
                object.name
            );
            assert_eq!(object.min.kind(), object.kind);
            assert_eq!(object.max.kind(), object.kind);
        }
    }

    #[test]
    fn slots_count_the_parameters_without_gaps() {
        let slots: std::vec::Vec<u8> = ENTRIES.iter().filter_map(|entry| entry.slot).collect();
        let want: std::vec::Vec<u8> = (0..u8::try_from(PARAMETERS).unwrap()).collect();
        assert_eq!(slots, want);
    }

    #[test]
    fn records_name_every_index_once() {
        let mut indices: std::vec::Vec<u16> =
            OBJECTS.iter().map(|object| object.address.index).collect();
        indices.dedup();
        let named: std::vec::Vec<u16> = RECORDS.iter().map(|(index, _)| *index).collect();
        assert_eq!(indices, named);
    }

    #[test]
    fn sub_indices_of_a_record_have_no_gaps() {
        for (index, _) in RECORDS {
            let subs: std::vec::Vec<u8> = OBJECTS
                .iter()
                .filter(|object| object.address.index == *index)
                .map(|object| object.address.sub)
                .collect();
            let highest = highest_sub(*index).unwrap();
            if highest == 0 {
                assert_eq!(subs, [0]);
            } else {
                let want: std::vec::Vec<u8> = (1..=highest).collect();
                assert_eq!(subs, want, "index {index:04X}");
            }
        }
        assert_eq!(highest_sub(0x2003), None);
        assert_eq!(highest_sub(0x1FFF), None);
    }

    #[test]
    fn what_changes_the_motion_is_locked_while_operational() {
        for object in OBJECTS.iter().filter(|object| object.required) {
            assert_eq!(object.access, Access::Parameter);
            assert!(object.persistent);
        }
    }

    #[test]
    fn wire_version_is_an_object() {
        let entry = entry(at::WIRE_VERSION).unwrap();
        assert_eq!(entry.default(), Value::U16(WIRE_VERSION));
        assert_eq!(entry.access, Access::Const);
    }
}
