//! Keys of `[robot]` and its tables: geometry, encoders, motors, loops, compensation, rollers.

use protocol::address as at;

use super::{ANY, DEGREE, Field, Kind, NOT_NEGATIVE, POSITIVE, field, number, to};
use crate::check::default;

pub(super) const ROBOT: &[Field] = &[
    number(
        "half_track",
        "m",
        POSITIVE,
        "Half the distance between the centres of the left and the right wheels.",
    )
    .somewhere()
    .object(at::HALF_TRACK, 1.0),
    number(
        "half_wheelbase",
        "m",
        POSITIVE,
        "Half the distance between the axles of the front and the rear wheels.",
    )
    .somewhere()
    .object(at::HALF_WHEELBASE, 1.0),
    number(
        "wheel_radius",
        "m",
        POSITIVE,
        "Radius of a wheel over its rollers.",
    )
    .somewhere()
    .object(at::WHEEL_RADIUS, 1.0),
    number(
        "roller_angle_deg",
        "degrees",
        POSITIVE,
        "Angle between roller axle and wheel axle; 45 for nearly every wheel on sale.",
    )
    .somewhere()
    .object(at::ROLLER_ANGLE, DEGREE),
    number(
        "max_wheel_rate",
        "rad/s",
        POSITIVE,
        "Fastest rate of a wheel; not above what the motor reaches without load.",
    )
    .somewhere()
    .object(at::WHEEL_RATE_MAX, 1.0),
    field(
        "board",
        Kind::Choice(&["nucleo-f446re", "robomaster-c", "kit-f103rc"]),
        "Its board, which says what image it runs; a simulated world picks it.",
    )
    .otherwise("nucleo-f446re"),
    field(
        "encoder",
        Kind::Table(&[ENCODER]),
        "The encoder of each wheel.",
    )
    .needed(),
    field(
        "motor",
        Kind::Table(&[MOTOR]),
        "Each wheel's motor with its gear, as seen from the wheel: torques and rates are the \
         wheel's. `omnibus group new` works it out from a gear motor's data sheet.",
    )
    .needed(),
    field(
        "control",
        Kind::Table(&[CONTROL]),
        "Gains of the wheel-rate loops.",
    ),
    field(
        "compensation",
        Kind::Table(&[COMPENSATION]),
        "Compensation for slip; `omnibus calibrate --write` fills it in.",
    ),
    field(
        "rollers",
        Kind::Table(&[ROLLERS]),
        "The rollers of the wheels, where an index tells which one is on the floor. `compensation` \
         then has no effect.",
    )
    .otherwise("computed with ideal rollers"),
    field(
        "wheels",
        Kind::Table(&[WHEELS]),
        "The four wheels one by one, for a robot whose wheels differ. Then all four are needed.",
    )
    .otherwise("four equal wheels at the corners"),
];

const ENCODER: &[Field] = &[
    number(
        "counts_per_revolution",
        "counts",
        POSITIVE,
        "Quadrature counts (lines times 4) per turn of the encoder's shaft; per turn of the wheel \
         where `gear_ratio` is 1. With the gear at least 4 per turn of the wheel.",
    )
    .somewhere()
    .object(at::ENCODER_COUNTS, 1.0),
    number(
        "gear_ratio",
        "",
        POSITIVE,
        "Turns of the encoder's shaft in one of the wheel.",
    )
    .or(1.0)
    .object(at::GEAR_RATIO, 1.0),
    field(
        "directions",
        Kind::Numbers(Some(4)),
        "-1 for an encoder that counts down when its wheel rolls the base forward, 1 for the others: \
         front left, front right, rear left, rear right. `omnibus wheel-test --ask` finds it.",
    )
    .otherwise("all 1; with `identified`, the robot's own"),
];

const MOTOR: &[Field] = &[
    number(
        "supply",
        "V",
        POSITIVE,
        "Nominal supply voltage of the bridge.",
    )
    .somewhere()
    .object(at::SUPPLY_NOMINAL, 1.0),
    number(
        "constant",
        "V s/rad",
        to(1e-4, 100.0),
        "Back-EMF constant; the same number is the torque constant in N m/A.",
    )
    .somewhere(),
    number("resistance", "ohm", to(1e-4, 1e4), "Resistance of the winding.").somewhere(),
    number(
        "inductance",
        "H",
        to(0.0, 1.0),
        "Inductance of the winding; for simulations.",
    )
    .or(default::INDUCTANCE),
    number(
        "inertia",
        "kg m2",
        to(1e-8, 1e5),
        "Inertia that one motor turns: rotor, gear, wheel, and a quarter of the robot's mass times the \
         wheel's radius squared. Its mechanical time constant with `constant`, `resistance` and \
         `viscous` is at least 1 ms.",
    )
    .somewhere(),
    number("friction", "N m", to(0.0, 1e4), "Dry friction.").or(default::FRICTION),
    number("viscous", "N m s/rad", to(0.0, 1e4), "Viscous friction.").or(default::VISCOUS),
    field(
        "directions",
        Kind::Numbers(Some(4)),
        "-1 for a motor that rolls the base backward with a positive duty, 1 for the others, as \
         `encoder.directions`.",
    )
    .otherwise("all 1; with `identified`, the robot's own"),
    number(
        "largest_current",
        "A",
        POSITIVE,
        "Largest current of a motor: the smaller one of motor and bridge.",
    )
    .otherwise("no bound")
    .object(at::CURRENT_MAX, 1.0),
    number(
        "largest_duty",
        "",
        to(0.1, 1.0),
        "Largest duty of a bridge, for bridges whose high side needs pauses.",
    )
    .or(1.0)
    .object(at::DUTY_MAX, 1.0),
    number(
        "brake_release_ms",
        "ms",
        to(0.0, 1000.0),
        "Time that the holding brake needs to release. All members wait for the slowest.",
    )
    .or(0.0)
    .object(at::BRAKE_RELEASE, 1.0),
    number(
        "brake_engage_ms",
        "ms",
        to(0.0, 1000.0),
        "Time that the holding brake needs to engage.",
    )
    .or(0.0)
    .object(at::BRAKE_ENGAGE, 1.0),
    field(
        "direction_pause",
        Kind::Flag,
        "A bridge gets no duty for one tick before it changes its direction.",
    )
    .otherwise("false"),
    field(
        "pwm_frequency",
        Kind::Whole(8_000, 40_000),
        "Frequency of the bridges' PWM, as drivers and motors require.",
    )
    .unit("Hz")
    .or(20_000.0)
    .object(at::PWM_FREQUENCY, 1.0),
    field(
        "output_stage",
        Kind::Choice(&[
            "pwm-direction",
            "in-in-slow",
            "in-in-fast",
            "locked-antiphase",
            "c620",
            "c610",
            "in-in-brake",
        ]),
        "How a duty is put on a bridge's inputs; `docs/bring-up.md` says which kind a driver \
         needs. `in-in-slow` and `locked-antiphase` need `enable_wired`; `in-in-fast` and \
         `in-in-brake` have two PWMs per wheel and need an image that is built for that. `c620` \
         and `c610` are drives on a CAN bus of their own: they need an image that is built for \
         them, and `largest_current`.",
    )
    .otherwise("pwm-direction"),
    field(
        "drive_identifiers",
        Kind::Numbers(Some(4)),
        "Which smart drive turns which wheel: the identifiers of the drives front left, front right, \
         rear left, rear right, 1 to 4, all different. `omnibus wheel-test --ask` finds them.",
    )
    .otherwise("1, 2, 3, 4"),
    field(
        "enable_wired",
        Kind::Flag,
        "The robot's driver enable is wired to the drivers and switches all bridges off.",
    )
    .otherwise("false"),
    number(
        "current_scale",
        "A/V",
        NOT_NEGATIVE,
        "Current per voltage of the sensor of the motors' current; 0 for none. It has to reach \
         1.25 times what four motors may take.",
    )
    .or(0.0)
    .object(at::CURRENT_SCALE, 1.0),
    number(
        "current_offset",
        "V",
        NOT_NEGATIVE,
        "Voltage of that sensor without current.",
    )
    .or(0.0)
    .object(at::CURRENT_OFFSET, 1.0),
    field(
        "current_inputs",
        Kind::Whole(1, 3),
        "Number of sensors whose currents are added.",
    )
    .or(1.0)
    .object(at::CURRENT_INPUTS, 1.0),
];

const CONTROL: &[Field] = &[
    number(
        "proportional",
        "1/(rad/s)",
        NOT_NEGATIVE,
        "Duty per rad/s of error.",
    )
    .or(default::PROPORTIONAL),
    number(
        "integral",
        "1/rad",
        NOT_NEGATIVE,
        "Duty per rad of accumulated error.",
    )
    .or(default::INTEGRAL),
    field(
        "identified",
        Kind::Flag,
        "The robot keeps the values that `omnibus identify-motors --accept --save` found: the group \
         file does not overwrite them.",
    )
    .otherwise("false"),
];

const COMPENSATION: &[Field] = &[
    number(
        "longitudinal",
        "",
        POSITIVE,
        "Commanded over achieved velocity, ahead.",
    )
    .or(1.0)
    .object(at::COMPENSATION_LONGITUDINAL, 1.0),
    number("lateral", "", POSITIVE, "The same, sideways.")
        .or(1.0)
        .object(at::COMPENSATION_LATERAL, 1.0),
    number("yaw", "", POSITIVE, "The same, turning.")
        .or(1.0)
        .object(at::COMPENSATION_YAW, 1.0),
    field(
        "table",
        Kind::Table(&[COMPENSATION_TABLE]),
        "Coefficients over speed, up to eight rows per axis; an axis with rows ignores its \
         constant.",
    ),
];

const COMPENSATION_TABLE: &[Field] = &[
    field(
        "version",
        Kind::Whole(0, 4_294_967_295),
        "Distinguishes one calibration from another, for example by its date.",
    )
    .required(),
    field(
        "longitudinal",
        Kind::Rows(2),
        "Achieved speed and coefficient, ahead.",
    )
    .unit("m/s, -")
    .otherwise("no rows"),
    field("lateral", Kind::Rows(2), "The same, sideways.")
        .unit("m/s, -")
        .otherwise("no rows"),
    field(
        "oblique",
        Kind::Rows(3),
        "Speed along 45 degrees, longitudinal and lateral coefficient.",
    )
    .unit("m/s, -, -")
    .otherwise("no rows"),
    field("yaw", Kind::Rows(2), "Achieved yaw rate and coefficient.")
        .unit("rad/s, -")
        .otherwise("no rows"),
];

const ROLLERS: &[Field] = &[
    field("count", Kind::Whole(3, 64), "Rollers of a wheel.").required(),
    field(
        "phases_deg",
        Kind::Numbers(Some(4)),
        "How far each wheel has rolled past the middle of its ground roller when its index comes: \
         front left, front right, rear left, rear right. `omnibus calibrate --phase` finds them.",
    )
    .unit("degrees")
    .otherwise("0 each"),
    field(
        "index_tolerance",
        Kind::Whole(1, 10_000),
        "Encoder counts by which an index may deviate: the play between encoder and wheel, plus two.",
    )
    .unit("counts")
    .otherwise("the robot's own value")
    .object(at::INDEX_TOLERANCE, 1.0),
    number("longitudinal", "", to(0.5, 2.0), "Remaining compensation, ahead.").or(1.0),
    number("lateral", "", to(0.5, 2.0), "The same, sideways.").or(1.0),
    number("yaw", "", to(0.5, 2.0), "The same, turning.").or(1.0),
];

const WHEELS: &[Field] = &[
    field(
        "front_left",
        Kind::Table(&[WHEEL]),
        "The wheel in front on the left.",
    )
    .required(),
    field(
        "front_right",
        Kind::Table(&[WHEEL]),
        "The wheel in front on the right.",
    )
    .required(),
    field(
        "rear_left",
        Kind::Table(&[WHEEL]),
        "The wheel behind on the left.",
    )
    .required(),
    field(
        "rear_right",
        Kind::Table(&[WHEEL]),
        "The wheel behind on the right.",
    )
    .required(),
];

const WHEEL: &[Field] = &[
    number(
        "x",
        "m",
        ANY,
        "Centre of the wheel, ahead of the robot's centre.",
    )
    .required(),
    number("y", "m", ANY, "The same, to the left.").required(),
    number("radius", "m", POSITIVE, "Radius over the rollers.").required(),
    number(
        "roller_angle_deg",
        "degrees",
        ANY,
        "Roller axle on the floor against wheel axle, counter-clockwise from above.",
    )
    .required(),
    number(
        "counts_per_revolution",
        "counts",
        POSITIVE,
        "Encoder counts, where they are not the robot's.",
    )
    .otherwise("the robot's"),
];
