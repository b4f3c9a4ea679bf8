//! Keys of `[simulation]` and its tables, which real robots ignore.

use super::{Field, Kind, field, number, to, up_to};
use crate::check::default;

pub(super) const SIMULATION: &[Field] = &[
    field("rigid", Kind::Flag, "The robots are bolted to one load; otherwise each moves by itself.")
        .otherwise("true"),
    field(
        "plant",
        Kind::Choice(&["table", "contact", "external"]),
        "How wheel motion becomes robot motion: measured losses, rollers and friction, or another \
         program.",
    )
    .otherwise("table"),
    field(
        "tables",
        Kind::Choice(&["virtual", "physical", "ideal"]),
        "Losses of the table plant: the paper's virtual robot, its physical one, or none.",
    )
    .otherwise("virtual"),
    field("rollers", Kind::Whole(3, 64), "Rollers of a wheel on the contact plant.")
        .or(default::ROLLERS as f64),
    field("address", Kind::Text, "The external plant's `host:port`.")
        .otherwise("needed with plant = \"external\""),
    field(
        "crystal_ppm",
        Kind::Numbers(None),
        "Error of each robot's crystal, one value per robot, -1000 to 1000.",
    )
    .unit("ppm")
    .otherwise("0 each"),
    field("seed", Kind::Whole(0, i64::MAX), "Seed of everything random.").or(1.0),
    number("backlash_deg", "degrees", to(0.0, 10.0), "Play between motor and wheel, at the wheel.")
        .or(0.0),
    field(
        "driver",
        Kind::Choice(&["pwm-direction", "pwm-in1-in2", "half-bridges", "locked-antiphase"]),
        "What the motor drivers make of the robots' outputs, whatever `output_stage` says: a \
         sign-magnitude driver, one with PWM, IN1 and IN2, two half bridges, or a locked \
         antiphase driver.",
    )
    .otherwise("what `output_stage` is for"),
    number("friction", "", up_to(10.0), "Friction of rollers on the floor; contact plant only.")
        .otherwise("the plant's own"),
    number("robot_mass", "kg", to(1e-3, 1e6), "Mass of a robot; contact plant only.")
        .otherwise("the plant's own"),
    number(
        "wheel_inertia",
        "kg m2",
        to(1e-8, 1e5),
        "Inertia that turns with a wheel, so that the floor's forces act on the motors; contact plant \
         only. The same time constant as with `motor.inertia` is at least 1 ms.",
    )
    .otherwise("wheels turn by their motors alone"),
    field(
        "scattered_rollers",
        Kind::Flag,
        "Every wheel begins at a roller phase of its own, from the seed; contact plant only.",
    )
    .otherwise("false"),
    field("battery", Kind::Table(&[BATTERY]), "Supply of a robot's motors.")
        .otherwise("the nominal voltage at any current"),
    field("encoder", Kind::Table(&[ENCODER_NOISE]), "Permanent errors of the encoders."),
    field("encoder_faults", Kind::Tables(&[ENCODER_FAULT]), "Encoders that break."),
    field("pose_noise", Kind::Table(&[POSE_NOISE]), "Noise of the poses that an observer measures."),
    field("gyro", Kind::Table(&[GYRO]), "The gyro that every robot carries."),
    field("payload", Kind::Table(&[PAYLOAD]), "A load on a rigid group; contact plant only."),
    field(
        "floor",
        Kind::Tables(&[PATCH]),
        "Rectangles of the floor with a friction of their own; contact plant only.",
    ),
];

const BATTERY: &[Field] = &[
    number(
        "resistance",
        "ohm",
        to(0.0, 1e3),
        "Internal resistance and wiring.",
    )
    .required(),
    number("capacity_ah", "Ah", to(1e-3, 1e6), "Charge when full.")
        .otherwise("it never discharges"),
    number(
        "charge",
        "",
        to(0.0, 1.0),
        "Charge at the beginning, of the capacity.",
    )
    .or(1.0),
    field(
        "curve",
        Kind::Rows(2),
        "Charge (0 to 1, rising) and voltage without load.",
    )
    .unit("-, V")
    .otherwise("the motor's supply at any charge"),
];

const ENCODER_NOISE: &[Field] = &[
    number(
        "lost",
        "",
        to(0.0, 1.0),
        "Fraction of the counts that is lost.",
    )
    .or(0.0),
    number(
        "extra_per_s",
        "1/s",
        to(0.0, 1e6),
        "Random counts of either sign.",
    )
    .or(0.0),
];

const ENCODER_FAULT: &[Field] = &[
    field("node", Kind::Whole(2, 17), "Which robot.").required(),
    field(
        "wheel",
        Kind::Choice(&["front-left", "front-right", "rear-left", "rear-right"]),
        "Which wheel.",
    )
    .required(),
    field(
        "kind",
        Kind::Choice(&["dead", "one-channel", "reversed"]),
        "A broken cable, one silent channel, or channels swapped.",
    )
    .required(),
    number("at", "s", to(0.0, 1e9), "When, in virtual time.").or(0.0),
];

const POSE_NOISE: &[Field] = &[
    number(
        "position_mm",
        "mm",
        to(0.0, 1e4),
        "Standard deviation of either coordinate.",
    )
    .or(0.0),
    number(
        "heading_mrad",
        "mrad",
        to(0.0, 1e4),
        "Standard deviation of the heading.",
    )
    .or(0.0),
];

const GYRO: &[Field] = &[
    field(
        "rate_hz",
        Kind::Whole(1, 4000),
        "Samples a second, a divisor of 4000.",
    )
    .unit("Hz")
    .or(200.0),
    number(
        "noise_dps_rthz",
        "degrees/s/sqrt(Hz)",
        to(0.0, 1000.0),
        "Density of its noise.",
    )
    .or(0.005),
    number(
        "bias_dps",
        "degrees/s",
        to(-2000.0, 2000.0),
        "Its output at rest.",
    )
    .or(0.5),
    number(
        "drift_dps_rts",
        "degrees/s/sqrt(s)",
        to(0.0, 1000.0),
        "Random walk of the bias.",
    )
    .or(3e-4),
    number("delay_ms", "ms", to(0.0, 1000.0), "Delay of its samples.").or(4.0),
];

const PAYLOAD: &[Field] = &[
    number("mass", "kg", to(1e-3, 1e6), "Its mass.").required(),
    number(
        "x",
        "m",
        to(-1e3, 1e3),
        "Its centre of mass in the group frame, ahead.",
    )
    .or(0.0),
    number("y", "m", to(-1e3, 1e3), "The same, to the left.").or(0.0),
];

const PATCH: &[Field] = &[
    field("x", Kind::Numbers(Some(2)), "From and to, in the world.")
        .unit("m")
        .required(),
    field("y", Kind::Numbers(Some(2)), "From and to, in the world.")
        .unit("m")
        .required(),
    number("friction", "", up_to(10.0), "Friction there.").required(),
];
