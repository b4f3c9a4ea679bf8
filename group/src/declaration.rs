//! Every key of a group file: what it is called, what it holds, its unit, range and default.
//!
//! This is the one declaration. [`crate::structure`] checks a file against it, and
//! [`crate::reference`] makes the page `docs/group-files.md` and the JSON Schema of it. Where a key
//! becomes a parameter of the robot, its range is that of the robot's object, so a file that passes
//! is a file that robots accept. Rules that involve more than one key are in `check`, `member` and
//! `check_simulation`.
//!
//! A test compares the keys here with those that [`crate::schema`] reads.

use protocol::{Address, address as at};

use crate::check::default;

/// A key.
#[derive(Clone, Copy)]
pub struct Field {
    /// As in the file.
    pub key: &'static str,
    /// Its name in older files, still read.
    pub formerly: Option<&'static str>,
    /// What it holds.
    pub kind: Kind,
    /// Unit of a number; empty for none.
    pub unit: &'static str,
    /// What holds without it.
    pub without: Without,
    /// The parameter that it becomes.
    pub object: Option<Object>,
    /// What it means.
    pub text: &'static str,
}

/// The parameter that a key becomes.
#[derive(Clone, Copy)]
pub struct Object {
    /// Where the robot has it.
    pub address: Address,
    /// The robot's value over the file's.
    pub factor: f64,
}

/// What a key holds.
#[derive(Clone, Copy)]
pub enum Kind {
    /// A number in a range.
    Number(Range),
    /// A whole number, from and to.
    Whole(i64, i64),
    /// `true` or `false`.
    Flag,
    /// Text.
    Text,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A list of numbers: of so many, or of any length.
    Numbers(Option<usize>),
    /// A list of rows of so many numbers.
    Rows(usize),
    /// A table with these keys.
    Table(&'static [&'static [Field]]),
    /// A list of tables with these keys.
    Tables(&'static [&'static [Field]]),
}

/// The numbers that a key may have; a robot's object may narrow it.
#[derive(Clone, Copy)]
pub struct Range {
    /// Lowest.
    pub min: f64,
    /// Whether the lowest itself is outside.
    pub above_min: bool,
    /// Highest.
    pub max: f64,
}

/// What holds where a key is left out.
#[derive(Clone, Copy)]
pub enum Without {
    /// The file is refused.
    Required,
    /// The file is refused, by a rule that knows more than this declaration.
    Needed,
    /// It must stand in the robot's entry or in `[robot]`.
    NeededSomewhere,
    /// A number.
    Default(f64),
    /// This.
    Otherwise(&'static str),
}

const ANY: Range = Range {
    min: f64::MIN,
    above_min: false,
    max: f64::MAX,
};
const POSITIVE: Range = Range {
    min: 0.0,
    above_min: true,
    max: f64::MAX,
};
const NOT_NEGATIVE: Range = Range {
    min: 0.0,
    above_min: false,
    max: f64::MAX,
};

const fn to(min: f64, max: f64) -> Range {
    Range {
        min,
        above_min: false,
        max,
    }
}

const fn field(key: &'static str, kind: Kind, text: &'static str) -> Field {
    Field {
        key,
        formerly: None,
        kind,
        unit: "",
        without: Without::Otherwise("-"),
        object: None,
        text,
    }
}

const fn number(key: &'static str, unit: &'static str, range: Range, text: &'static str) -> Field {
    let mut out = field(key, Kind::Number(range), text);
    out.unit = unit;
    out
}

impl Field {
    const fn required(mut self) -> Self {
        self.without = Without::Required;
        self
    }

    const fn needed(mut self) -> Self {
        self.without = Without::Needed;
        self
    }

    const fn somewhere(mut self) -> Self {
        self.without = Without::NeededSomewhere;
        self
    }

    const fn or(mut self, default: f64) -> Self {
        self.without = Without::Default(default);
        self
    }

    const fn otherwise(mut self, what: &'static str) -> Self {
        self.without = Without::Otherwise(what);
        self
    }

    const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// The robot holds `factor` times the file's number at `address`.
    const fn object(mut self, address: Address, factor: f64) -> Self {
        self.object = Some(Object { address, factor });
        self
    }

    const fn formerly(mut self, key: &'static str) -> Self {
        self.formerly = Some(key);
        self
    }
}

/// Degrees to radians, milliseconds to microseconds.
const DEGREE: f64 = std::f64::consts::PI / 180.0;
const MILLISECOND: f64 = 1e3;

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
        "By how much the group's motion trails its wheels because rubber creeps. `omnibus calibrate \
         --all` measures it; times of another floor or robot do not serve.",
    ),
    field(
        "roller_transition",
        Kind::Table(&[ROLLER_TRANSITION]),
        "What a change of rollers costs. For robots with `rollers` only; `omnibus calibrate` \
         measures it.",
    )
    .formerly("hand_over"),
    field(
        "robot",
        Kind::Table(&[ROBOT]),
        "What every robot is, unless its own entry says otherwise.",
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
        "What a simulated world has to be told. Real robots ignore it.",
    ),
];

const LIMITS: &[Field] = &[
    number("linear_speed", "m/s", POSITIVE, "Fastest speed.").or(default::LINEAR_SPEED),
    number("yaw_rate", "rad/s", POSITIVE, "Fastest turning.").or(default::YAW_RATE),
    number(
        "linear_acceleration",
        "m/s2",
        POSITIVE,
        "Largest acceleration; the ramps of stops have it too.",
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
    "Share of its speed that a robot loses sideways because rollers meet the floor at rest, over \
     that speed.",
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
        "Which way the robot faces in the group frame, counter-clockwise; 0 is ahead.",
    )
    .or(0.0)
    .object(at::MOUNT_HEADING, DEGREE),
];

const ROBOT: &[Field] = &[
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
        "What the robot adds against slip; `omnibus calibrate --write` fills it in.",
    ),
    field(
        "rollers",
        Kind::Table(&[ROLLERS]),
        "The rollers of the wheels, where an index tells which one is on the floor. \
         `compensation` is then without effect.",
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
         where `gear_ratio` is 1.",
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
        POSITIVE,
        "Back-EMF constant; the same number is the torque constant in N m/A.",
    )
    .somewhere(),
    number("resistance", "ohm", POSITIVE, "Resistance of the winding.").somewhere(),
    number(
        "inductance",
        "H",
        NOT_NEGATIVE,
        "Inductance of the winding; for simulations.",
    )
    .or(default::INDUCTANCE),
    number(
        "inertia",
        "kg m2",
        POSITIVE,
        "What one motor turns: rotor, gear, wheel, and a quarter of the robot's mass times the \
         wheel's radius squared.",
    )
    .somewhere(),
    number("friction", "N m", NOT_NEGATIVE, "Dry friction.").or(default::FRICTION),
    number("viscous", "N m s/rad", NOT_NEGATIVE, "Viscous friction.").or(default::VISCOUS),
    number(
        "largest_current",
        "A",
        POSITIVE,
        "Largest current of a motor: of motor and bridge the smaller.",
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
        "What the holding brake takes to let go. All members wait for the slowest.",
    )
    .or(0.0)
    .object(at::BRAKE_RELEASE, 1.0),
    number(
        "brake_engage_ms",
        "ms",
        to(0.0, 1000.0),
        "What the holding brake takes to hold.",
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
        "Of the bridges' PWM: what drivers and motors want.",
    )
    .unit("Hz")
    .or(20_000.0)
    .object(at::PWM_FREQUENCY, 1.0),
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
        "How many sensors are added up.",
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
        "The robot keeps what `omnibus identify-motors --accept --save` found, and its wiring: \
         nothing of that is written into it.",
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
        "Coefficients over speed, up to eight rows an axis; an axis with rows ignores its constant.",
    ),
];

const COMPENSATION_TABLE: &[Field] = &[
    field(
        "version",
        Kind::Whole(0, 4_294_967_295),
        "Tells one calibration from another; a date serves.",
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
        "By how many encoder counts an index may be off: the play between encoder and wheel, and two.",
    )
    .unit("counts")
    .otherwise("what the robot holds")
    .object(at::INDEX_TOLERANCE, 1.0),
    number("longitudinal", "", to(0.5, 2.0), "What is left to compensate, ahead.").or(1.0),
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

const SIMULATION: &[Field] = &[
    field("rigid", Kind::Flag, "The robots are bolted to one load; otherwise each moves alone.")
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
        "Error of each robot's crystal, one a robot, -1000 to 1000.",
    )
    .unit("ppm")
    .otherwise("0 each"),
    field("seed", Kind::Whole(0, i64::MAX), "Seed of everything random.").or(1.0),
    number("backlash_deg", "degrees", to(0.0, 10.0), "Play between motor and wheel, at the wheel.")
        .or(0.0),
    number("friction", "", POSITIVE, "Friction of rollers on the floor; contact plant only.")
        .otherwise("the plant's own"),
    number("robot_mass", "kg", POSITIVE, "Mass of a robot; contact plant only.")
        .otherwise("the plant's own"),
    number(
        "wheel_inertia",
        "kg m2",
        POSITIVE,
        "What turns with a wheel, so that the floor's forces act on the motors; contact plant only.",
    )
    .otherwise("wheels turn by their motors alone"),
    field(
        "scattered_rollers",
        Kind::Flag,
        "Every wheel begins at a roller phase of its own, from the seed; contact plant only.",
    )
    .otherwise("false"),
    field("battery", Kind::Table(&[BATTERY]), "What feeds a robot's motors.")
        .otherwise("the nominal voltage, whatever is drawn"),
    field("encoder", Kind::Table(&[ENCODER_NOISE]), "What encoders get wrong all the time."),
    field("encoder_faults", Kind::Tables(&[ENCODER_FAULT]), "Encoders that break."),
    field("pose_noise", Kind::Table(&[POSE_NOISE]), "How well an observer sees the robots."),
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
        NOT_NEGATIVE,
        "Internal resistance and wiring.",
    )
    .required(),
    number("capacity_ah", "Ah", POSITIVE, "Charge when full.").otherwise("it never runs down"),
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
        "Share of the counts that is lost.",
    )
    .or(0.0),
    number(
        "extra_per_s",
        "1/s",
        NOT_NEGATIVE,
        "Counts of either sign that nothing caused.",
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
    number("at", "s", NOT_NEGATIVE, "When, in virtual time.").or(0.0),
];

const POSE_NOISE: &[Field] = &[
    number(
        "position_mm",
        "mm",
        NOT_NEGATIVE,
        "Standard deviation of either coordinate.",
    )
    .or(0.0),
    number(
        "heading_mrad",
        "mrad",
        NOT_NEGATIVE,
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
        NOT_NEGATIVE,
        "Density of its noise.",
    )
    .or(0.005),
    number("bias_dps", "degrees/s", ANY, "What it shows at rest.").or(0.5),
    number(
        "drift_dps_rts",
        "degrees/s/sqrt(s)",
        NOT_NEGATIVE,
        "How far the bias strays in a second.",
    )
    .or(3e-4),
    number(
        "delay_ms",
        "ms",
        NOT_NEGATIVE,
        "By how much its samples are late.",
    )
    .or(4.0),
];

const PAYLOAD: &[Field] = &[
    number("mass", "kg", POSITIVE, "Its mass.").required(),
    number(
        "x",
        "m",
        ANY,
        "Its centre of mass in the group frame, ahead.",
    )
    .or(0.0),
    number("y", "m", ANY, "The same, to the left.").or(0.0),
];

const PATCH: &[Field] = &[
    field("x", Kind::Numbers(Some(2)), "From and to, in the world.")
        .unit("m")
        .required(),
    field("y", Kind::Numbers(Some(2)), "From and to, in the world.")
        .unit("m")
        .required(),
    number("friction", "", POSITIVE, "Friction there.").required(),
];

impl Field {
    /// The keys of the table or tables that it holds.
    pub fn inner(&self) -> impl Iterator<Item = &'static Field> + use<> {
        let parts: &[&[Field]] = match self.kind {
            Kind::Table(parts) | Kind::Tables(parts) => parts,
            _ => &[],
        };
        parts.iter().flat_map(|part| part.iter())
    }

    /// The range of a number in the file's unit, with what the robot's object allows; `None` for
    /// what is no number.
    #[must_use]
    pub fn range(&self) -> Option<Range> {
        let own = match self.kind {
            Kind::Number(range) => range,
            Kind::Whole(min, max) => to(min as f64, max as f64),
            _ => return None,
        };
        let Some(object) = self.object else {
            return Some(own);
        };
        let entry = protocol::entry(object.address)?;
        let (min, max) = (real(entry.min())?, real(entry.max())?);
        let (min, max) = (min / object.factor, max / object.factor);
        Some(Range {
            // 0 to the robot is "my own value", which a file says by leaving the key out.
            min: own.min.max(min),
            above_min: own.above_min && own.min >= min,
            max: own.max.min(max),
        })
    }
}

/// A value of a robot as a number.
pub(crate) fn real(value: protocol::Value) -> Option<f64> {
    use protocol::Value;
    Some(match value {
        Value::U8(v) => f64::from(v),
        Value::U16(v) => f64::from(v),
        Value::U32(v) => f64::from(v),
        Value::I16(v) => f64::from(v),
        Value::I24(v) => f64::from(v),
        // The shortest decimal that a robot reads as this: 0.1, not 0.10000000149.
        Value::F32(v) => v.to_string().parse().ok()?,
        Value::Domain => return None,
    })
}
