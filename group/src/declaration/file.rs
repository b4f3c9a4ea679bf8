//! Keys of a file at its top level, `[limits]` and what belongs to the whole group.

use protocol::address as at;
use protocol::scaling::TWIST_MAX;

use super::robot::ROBOT;
use super::simulation::SIMULATION;
use super::{ANY, DEGREE, Field, Kind, MILLISECOND, POSITIVE, Range, field, number, to};
use crate::check::default;
use crate::parameters::ROOM;

/// The file itself.
pub const FILE: &[Field] = &[
    field("name", Kind::Text, "Short name of the group, for reports.").required(),
    field(
        "group_id",
        Kind::Whole(1, 255),
        "Number of the group on the bus. Robots ignore setpoints of other groups.",
    )
    .required(),
    number(
        "sync_period_ms",
        "ms",
        POSITIVE,
        "Period of SYNC, in whole milliseconds.",
    )
    .or(default::SYNC_PERIOD_MS)
    .object(at::SYNC_PERIOD, MILLISECOND),
    field(
        "limits",
        Kind::Table(&[LIMITS]),
        "Limits of the group's motion, at the origin of the group frame, and its timeouts.",
    ),
    field(
        "contact_lag",
        Kind::Table(&[CONTACT_LAG]),
        "Time by which the group's motion lags its wheels because rubber creeps. `omnibus \
         calibrate --all` measures it; it depends on floor and robot.",
    ),
    field(
        "roller_transition",
        Kind::Table(&[ROLLER_TRANSITION]),
        "Loss at roller transitions. Only for robots with `rollers`; `omnibus calibrate` measures \
         it.",
    )
    .formerly("hand_over"),
    field(
        "robot",
        Kind::Table(&[ROBOT]),
        "Values of every robot, unless its own entry has others.",
    ),
    field(
        "robots",
        Kind::Tables(&[ENTRY, ROBOT]),
        "One entry for each robot: its place, and every key of `[robot]` in which it differs.",
    )
    .needed(),
    field(
        "simulation",
        Kind::Table(&[SIMULATION]),
        "Values that only a simulated world needs. Real robots ignore them.",
    ),
];

/// A setpoint saturates at its ends, so a group that may go faster would be slow without a word.
const IN_A_SETPOINT: Range = Range {
    max: TWIST_MAX,
    ..POSITIVE
};

const LIMITS: &[Field] = &[
    number(
        "linear_speed",
        "m/s",
        IN_A_SETPOINT,
        "Fastest speed, at most what a setpoint on the bus can hold. Robots keep the group to 1.25 \
         times of it.",
    )
    .or(default::LINEAR_SPEED)
    .object(at::SPEED_MAX, ROOM as f64),
    number(
        "yaw_rate",
        "rad/s",
        IN_A_SETPOINT,
        "Fastest turning, at most what a setpoint on the bus can hold. Robots keep the group to 1.25 \
         times of it.",
    )
    .or(default::YAW_RATE)
    .object(at::YAW_RATE_MAX, ROOM as f64),
    number(
        "linear_acceleration",
        "m/s2",
        POSITIVE,
        "Largest acceleration; the ramps of stops also use it.",
    )
    .or(default::LINEAR_ACCELERATION)
    .object(at::ACCELERATION, 1.0),
    number(
        "yaw_acceleration",
        "rad/s2",
        POSITIVE,
        "The same for turning.",
    )
    .or(default::YAW_ACCELERATION)
    .object(at::ACCELERATION_YAW, 1.0),
    number(
        "linear_jerk",
        "m/s3",
        POSITIVE,
        "Fastest change of the acceleration.",
    )
    .or(default::LINEAR_JERK)
    .object(at::JERK, 1.0),
    number("yaw_jerk", "rad/s3", POSITIVE, "The same for turning.")
        .or(default::YAW_JERK)
        .object(at::JERK_YAW, 1.0),
    number(
        "command_timeout_ms",
        "ms",
        POSITIVE,
        "A setpoint older than this stops the group. Whole milliseconds.",
    )
    .or(default::COMMAND_TIMEOUT_MS)
    .object(at::SETPOINT_TIMEOUT, 1.0),
    number(
        "sync_timeout_ms",
        "ms",
        POSITIVE,
        "A member that hears no SYNC for this long stops. Whole milliseconds.",
    )
    .otherwise("two and a quarter periods")
    .object(at::SYNC_TIMEOUT, 1.0),
];

const CONTACT_LAG: &[Field] = &[
    number("longitudinal_ms", "ms", to(0.0, 100.0), "Ahead.").or(0.0),
    number("lateral_ms", "ms", to(0.0, 100.0), "Sideways.").or(0.0),
    number("yaw_ms", "ms", to(0.0, 100.0), "Turning.").or(0.0),
];

const ROLLER_TRANSITION: &[Field] = &[number(
    "loss_s_per_m",
    "s/m",
    to(0.0, 0.05),
    "Share of its speed that a robot loses sideways because rollers meet the floor at rest, \
     divided by that speed.",
)
.or(0.0)];

/// What only an entry of `[[robots]]` has.
const ENTRY: &[Field] = &[
    field(
        "node",
        Kind::Whole(2, 17),
        "Node id on the bus, different for every robot; 1 is the master.",
    )
    .needed(),
    number(
        "x",
        "m",
        ANY,
        "Where the robot's centre is in the group frame, ahead.",
    )
    .or(0.0)
    .object(at::MOUNT_X, 1.0),
    number("y", "m", ANY, "The same, to the left.")
        .or(0.0)
        .object(at::MOUNT_Y, 1.0),
    number(
        "heading_deg",
        "degrees",
        ANY,
        "Heading of the robot in the group frame, counter-clockwise; 0 is ahead.",
    )
    .or(0.0)
    .object(at::MOUNT_HEADING, DEGREE),
];
