//! `omnibus group new`: a group file from what owners of robots know.
//!
//! A robot's owner has a ruler, a pair of scales and the data sheet of a gear motor. The file wants
//! the motor as seen from the wheel. From supply V, no-load speed w, no-load current i and stall
//! current I of the gear's output shaft:
//!
//! - resistance `R = V / I`: at stall there is no back EMF;
//! - constant `k = (V - R i) / w`: without load the winding takes `R i`;
//! - friction `k i`: what the no-load current works against;
//! - efficiency of the gear `T / (k (I - i))` from the stall torque T, which lessens what
//!   accelerates the robot, so the inertia is divided by it.
//!
//! What is said twice must agree: a motor that gives more power than it takes was misread, and the
//! error says so. All of it is a start; `omnibus identify-motors` measures the motor itself.

use std::fmt::Write as _;
use std::io::{BufRead as _, IsTerminal as _};
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use group::{Examination, FIRST_NODE, LAST_NODE};

use super::{json, print_json, print_line, print_note};

const EXAMPLES: &str = "Examples:
  omnibus group new my-group.toml
  omnibus group new my-group.toml --robot 0.25,0 --robot -0.25,0 --track 0.30m --wheelbase 260mm \\
      --wheel-diameter 100mm --mass 8kg --supply 12V --no-load-speed 330rpm --no-load-current 0.2A \\
      --stall-torque 14kg.cm --stall-current 5.5A --counts 64 --gear-ratio 30

On a terminal it asks for what the options do not say. Numbers take a unit: m, cm, mm, in; V; A, mA; N.m, kg.cm, oz.in;
rpm, rad/s; kg, g. The data of the motor are those of its gear's output shaft.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The file to write.
    file: PathBuf,
    /// Replaces the file if it exists.
    #[arg(long)]
    replace: bool,
    /// Short name of the group; the file's name otherwise.
    #[arg(long)]
    name: Option<String>,
    /// Number of the group on the bus.
    #[arg(long, default_value_t = 1)]
    group_id: u8,
    /// Where a robot is in the group: x ahead, y left, and heading in degrees if it is not 0. Once
    /// for each robot; nodes are given from 2.
    #[arg(
        long = "robot",
        value_name = "X,Y[,DEGREES]",
        allow_hyphen_values = true
    )]
    robots: Vec<String>,
    /// Distance between the centres of the left and the right wheels.
    #[arg(long, value_name = "LENGTH")]
    track: Option<String>,
    /// Distance between the front and the rear axles.
    #[arg(long, value_name = "LENGTH")]
    wheelbase: Option<String>,
    /// Diameter of a wheel over its rollers.
    #[arg(long, value_name = "LENGTH")]
    wheel_diameter: Option<String>,
    /// Angle between roller axle and wheel axle, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 45.0)]
    roller_angle: f64,
    /// Mass of one robot with its share of the load.
    #[arg(long, value_name = "MASS")]
    mass: Option<String>,
    /// Supply voltage of the motors.
    #[arg(long, value_name = "VOLTAGE")]
    supply: Option<String>,
    /// Speed of the wheel without load at that voltage.
    #[arg(long, value_name = "SPEED")]
    no_load_speed: Option<String>,
    /// Current of a motor without load.
    #[arg(long, value_name = "CURRENT")]
    no_load_current: Option<String>,
    /// Torque at the wheel at which the motor stalls.
    #[arg(long, value_name = "TORQUE")]
    stall_torque: Option<String>,
    /// Current of a motor that stalls.
    #[arg(long, value_name = "CURRENT")]
    stall_current: Option<String>,
    /// Quadrature counts (lines times 4) per turn of the encoder's shaft.
    #[arg(long, value_name = "COUNTS")]
    counts: Option<String>,
    /// Turns of the encoder's shaft in one of the wheel; 1 for an encoder on the wheel.
    #[arg(long, value_name = "RATIO")]
    gear_ratio: Option<String>,
}

/// A unit and how many of the file's it is.
type Units = &'static [(&'static str, f64)];

/// Newtons of a kilogram's weight, of a pound's (an ounce is a sixteenth), metres of an inch.
const KILOGRAM_FORCE: f64 = 9.806_65;
const OUNCE_FORCE: f64 = 4.448_221_615 / 16.0;
const INCH: f64 = 0.0254;

const LENGTH: Units = &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("in", INCH)];
const MASS: Units = &[("kg", 1.0), ("g", 1e-3)];
const VOLTAGE: Units = &[("v", 1.0)];
const CURRENT: Units = &[("a", 1.0), ("ma", 1e-3)];
const SPEED: Units = &[("rpm", std::f64::consts::TAU / 60.0), ("rad/s", 1.0)];
const TORQUE: Units = &[
    ("nm", 1.0),
    ("ncm", 1e-2),
    ("kgcm", KILOGRAM_FORCE * 1e-2),
    ("kgfcm", KILOGRAM_FORCE * 1e-2),
    ("ozin", OUNCE_FORCE * INCH),
];
const PLAIN: Units = &[("", 1.0)];

/// A number with one of the units; the first one where it has none. It must be above 0, or 0 where
/// `zero` allows it.
fn quantity(text: &str, units: Units, zero: bool) -> Result<f64, String> {
    let text = text.trim();
    let end = text
        .rfind(|c: char| c.is_ascii_digit() || c == '.' && text.ends_with('.'))
        .map_or(0, |n| n + 1);
    let (digits, unit) = text.split_at(end);
    let unit: String = unit
        .chars()
        .filter(|c| !matches!(c, ' ' | '.' | '*' | '·' | '-'))
        .flat_map(char::to_lowercase)
        .collect();
    let names: Vec<_> = units.iter().map(|(name, _)| *name).collect();
    let known = units.iter().find(|(name, _)| *name == unit);
    let factor = match (known, unit.is_empty()) {
        (Some((_, factor)), _) => *factor,
        (None, true) => units[0].1,
        (None, false) => {
            return Err(format!(
                "\"{unit}\" is none of its units: {}",
                names.join(", ")
            ));
        }
    };
    let value: f64 = digits
        .trim()
        .parse()
        .map_err(|_| format!("\"{text}\" is not a number"))?;
    if !value.is_finite() || value < 0.0 || value == 0.0 && !zero {
        return Err(format!("\"{text}\" is not above 0"));
    }
    Ok(value * factor)
}

/// Where a robot is: x, y in m, heading in degrees.
fn place(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(&[x, y]) => Ok([x, y, 0.0]),
        Ok(&[x, y, heading]) => Ok([x, y, heading]),
        _ => Err(format!("\"{text}\" is not X,Y or X,Y,DEGREES in metres")),
    }
}

/// Where answers come from: options first, then the person at the terminal.
struct Answers {
    asks: bool,
    missing: Vec<&'static str>,
    wrong: Vec<String>,
}

impl Answers {
    /// The value of an option, or what is answered to a question.
    fn get(
        &mut self,
        option: &'static str,
        given: Option<&String>,
        question: &str,
        usual: Option<&str>,
        units: Units,
    ) -> f64 {
        let zero = usual == Some("0");
        if let Some(text) = given {
            return quantity(text, units, zero).unwrap_or_else(|problem| {
                self.wrong.push(format!("{option}: {problem}"));
                f64::NAN
            });
        }
        if self.asks {
            loop {
                let Some(answer) = ask(question, usual) else {
                    self.asks = false;
                    break;
                };
                match quantity(&answer, units, zero) {
                    Ok(value) => return value,
                    Err(problem) => print_note(problem),
                }
            }
        }
        match usual {
            Some(usual) => quantity(usual, units, zero).unwrap_or(f64::NAN),
            None => {
                self.missing.push(option);
                f64::NAN
            }
        }
    }
}

/// Asks one question; `None` when nobody answers any more.
fn ask(question: &str, usual: Option<&str>) -> Option<String> {
    let usual_text = usual.map_or_else(String::new, |usual| format!(" [{usual}]"));
    eprint!("{question}{usual_text}: ");
    let mut line = String::new();
    match std::io::stdin().lock().read_line(&mut line) {
        Ok(0) | Err(_) => None,
        Ok(_) if line.trim().is_empty() => Some(usual.unwrap_or_default().to_owned()),
        Ok(_) => Some(line.trim().to_owned()),
    }
}

/// What an owner knows of a robot, in SI units.
struct Robot {
    track: f64,
    wheelbase: f64,
    diameter: f64,
    mass: f64,
    supply: f64,
    no_load_rate: f64,
    no_load_current: f64,
    stall_torque: f64,
    stall_current: f64,
    counts: f64,
    gear_ratio: f64,
}

impl Robot {
    fn ask(arguments: &Arguments, answers: &mut Answers) -> Self {
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
struct Motor {
    resistance: f64,
    constant: f64,
    friction: f64,
    /// Of the gear, from the stall torque.
    efficiency: f64,
    inertia: f64,
}

/// Share of what a motor can do that a group file asks of it: what is left is for the wheel loops.
const RESERVE: f64 = 0.8;
/// Friction that a rubber roller surely has on a clean floor, for the limit of the acceleration.
const FRICTION: f64 = 0.35;
const GRAVITY: f64 = 9.81;

impl Motor {
    fn of(robot: &Robot) -> anyhow::Result<Self> {
        if robot.no_load_current >= robot.stall_current {
            bail!(
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
            bail!(
                "these motor data contradict each other: at {:.1} A and {:.1} rad/s without load a \
                 motor stalls at {ideal:.3} N m at most, not at {:.3}; check the units, and that \
                 speed and torque are both those of the gear's output shaft",
                robot.stall_current,
                robot.no_load_rate,
                robot.stall_torque
            );
        }
        if efficiency < 0.2 {
            bail!(
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
fn down(value: f64) -> f64 {
    let step = 10_f64.powf(value.abs().log10().floor() - 1.0);
    let whole = (value / step + 1e-9).floor();
    // Through text, so that 0.52 is not 0.5200000000000001.
    let digits = (-step.log10().round()).max(0.0);
    format!("{:.*}", digits as usize, whole * step)
        .parse()
        .unwrap_or(value)
}

/// To four significant digits.
fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// The limits of the group's motion that the wheels can follow.
struct Limits {
    wheel_rate: f64,
    speed: f64,
    yaw_rate: f64,
    acceleration: f64,
    yaw_acceleration: f64,
}

impl Limits {
    fn of(robot: &Robot, places: &[[f64; 3]]) -> Self {
        let wheel_rate = down(RESERVE * robot.no_load_rate);
        let radius = robot.diameter / 2.0;
        let rim = wheel_rate * radius;
        // The farthest wheel of the group turns it; rollers at 45 degrees ask for |x| + |y|.
        let far = |[x, y, _]: &[f64; 3]| x.abs() + y.abs() + (robot.track + robot.wheelbase) / 2.0;
        let reach = places.iter().map(far).fold(0.0, f64::max);
        // Half of the stall torque of four wheels, and what the floor holds: rollers at 45 degrees
        // share the push between ahead and aside.
        let push = 4.0 * 0.5 * robot.stall_torque / radius / robot.mass;
        let acceleration = down(push.min(FRICTION * GRAVITY / std::f64::consts::SQRT_2));
        Self {
            wheel_rate,
            // In every direction, the diagonals too.
            speed: down(rim / std::f64::consts::SQRT_2),
            yaw_rate: down((rim / reach).min(1.5)),
            acceleration,
            yaw_acceleration: down((acceleration / reach).min(4.0)),
        }
    }
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let path = &arguments.file;
    if path.exists() && !arguments.replace {
        bail!(
            "{}: exists; give another name, or --replace",
            path.display()
        );
    }
    let mut answers = Answers {
        asks: std::io::stdin().is_terminal() && std::io::stderr().is_terminal(),
        missing: Vec::new(),
        wrong: Vec::new(),
    };
    let places = places(arguments, &mut answers);
    let robot = Robot::ask(arguments, &mut answers);
    let mut problems = answers.wrong;
    if !answers.missing.is_empty() {
        problems.push(format!(
            "missing: {} (on a terminal this command asks)",
            answers.missing.join(", ")
        ));
    }
    if !problems.is_empty() {
        bail!("{}", problems.join("; "));
    }
    let motor = Motor::of(&robot)?;
    let stem = path
        .file_stem()
        .map(|stem| stem.to_string_lossy().into_owned());
    let name = arguments.name.clone().or(stem).unwrap_or_default();
    let text = file(arguments, &name, &robot, &motor, &places);
    let shown = path.display().to_string();
    let found = Examination::of(&shown, &text);
    if let Some(error) = found.errors.first() {
        // The line is that of a file that is not there.
        bail!("{}: {}; {}", error.field, error.problem, error.remedy);
    }
    omnibus::file::replace(path, text.as_bytes())
        .with_context(|| format!("cannot write {shown}"))?;
    if json() {
        return print_json(&serde_json::json!({"file": shown, "group": name}));
    }
    if let Some(group) = &found.group {
        print_line(super::draw::text(group).trim_end())?;
    }
    for warning in &found.warnings {
        print_line(format_args!("warning: {warning}"))?;
    }
    print_line(format_args!(
        "{shown} is written. The motor is worked out from its data sheet; with the wheels free, \
         `omnibus identify-motors --accept --save` measures it."
    ))
}

/// Where the robots are.
fn places(arguments: &Arguments, answers: &mut Answers) -> Vec<[f64; 3]> {
    let most = usize::from(LAST_NODE - FIRST_NODE) + 1;
    let mut places = Vec::new();
    for text in &arguments.robots {
        match place(text) {
            Ok(at) => places.push(at),
            Err(problem) => answers.wrong.push(format!("--robot: {problem}")),
        }
    }
    if arguments.robots.is_empty() && answers.asks {
        print_note(
            "Where is each robot in the group? X,Y in metres (x ahead, y left), and its heading in degrees if not 0.",
        );
        while places.len() < most {
            let question = format!(
                "Robot {} (node {}), Enter if there is none",
                places.len() + 1,
                places.len() + 2
            );
            match ask(&question, (places.is_empty()).then_some("0,0")) {
                Some(answer) if answer.is_empty() => break,
                Some(answer) => match place(&answer) {
                    Ok(at) => places.push(at),
                    Err(problem) => print_note(problem),
                },
                None => break,
            }
        }
    }
    if places.is_empty() {
        answers.missing.push("--robot");
    }
    if places.len() > most {
        answers
            .wrong
            .push(format!("--robot: {} robots; at most {most}", places.len()));
    }
    places
}

/// The file itself.
fn file(
    arguments: &Arguments,
    name: &str,
    robot: &Robot,
    motor: &Motor,
    places: &[[f64; 3]],
) -> String {
    let limits = Limits::of(robot, places);
    let quoted = toml_edit::Value::from(name).to_string();
    let mut out = format!(
        "# Every key is explained in docs/group-files.md; `omnibus group check` checks this file.\n\
         name = {}\ngroup_id = {}\nsync_period_ms = 10\n\n\
         # What the wheels can follow: in every direction, with a fifth in reserve.\n\
         [limits]\n\
         linear_speed = {} # m/s\n\
         yaw_rate = {} # rad/s\n\
         linear_acceleration = {} # m/s2: what motors and a clean floor give\n\
         yaw_acceleration = {} # rad/s2\n\n",
        quoted.trim(),
        arguments.group_id,
        limits.speed,
        limits.yaw_rate,
        limits.acceleration,
        limits.yaw_acceleration,
    );
    let _ = write!(
        out,
        "# What every robot is, unless its own entry says otherwise.\n\
         [robot]\n\
         half_track = {} # m\n\
         half_wheelbase = {} # m\n\
         wheel_radius = {} # m\n\
         roller_angle_deg = {}\n\
         max_wheel_rate = {} # rad/s: 80 % of the no-load speed\n\n\
         [robot.encoder]\n\
         counts_per_revolution = {}\n\
         gear_ratio = {}\n\n",
        short(robot.track / 2.0),
        short(robot.wheelbase / 2.0),
        short(robot.diameter / 2.0),
        arguments.roller_angle,
        limits.wheel_rate,
        robot.counts,
        robot.gear_ratio,
    );
    let _ = write!(
        out,
        "# As seen from the wheel, from the gear motor's data: {} V, {} rad/s and {} A without load,\n\
         # {} N m and {} A at stall. The gear passes on {:.0} % of the torque.\n\
         [robot.motor]\n\
         supply = {} # V\n\
         constant = {} # V s/rad, and N m/A\n\
         resistance = {} # ohm\n\
         inertia = {} # kg m2: a quarter of {} kg at the rim, over the gear's losses\n\
         friction = {} # N m\n\
         largest_current = {} # A: at stall; lower it to what your bridges stand\n\n",
        short(robot.supply),
        short(robot.no_load_rate),
        short(robot.no_load_current),
        short(robot.stall_torque),
        short(robot.stall_current),
        100.0 * motor.efficiency,
        short(robot.supply),
        short(motor.constant),
        short(motor.resistance),
        short(motor.inertia),
        short(robot.mass),
        short(motor.friction),
        short(robot.stall_current),
    );
    // In proportion to the motor's constant, as in the files of `groups/`.
    out.push_str("# Gains of the wheel-rate loops, as duty; `identify-motors` finds better ones.\n[robot.control]\n");
    let _ = writeln!(
        out,
        "proportional = {}",
        short(1.2 * motor.constant / robot.supply)
    );
    let _ = writeln!(
        out,
        "integral = {}",
        short(12.0 * motor.constant / robot.supply)
    );
    out.push_str("\n# Members: x ahead, y left, heading counter-clockwise.\n");
    for (node, [x, y, heading]) in (FIRST_NODE..).zip(places) {
        let _ = write!(out, "[[robots]]\nnode = {node}\nx = {x}\ny = {y}\n");
        if *heading != 0.0 {
            let _ = writeln!(out, "heading_deg = {heading}");
        }
        out.push('\n');
    }
    aligned(out.trim_end())
}

/// The same text with the comments behind values in one column.
fn aligned(text: &str) -> String {
    let mut out = String::new();
    for line in text.lines() {
        match line.split_once(" #") {
            Some((value, comment)) if !line.starts_with('#') => {
                let _ = writeln!(out, "{:<COMMENTS$}#{comment}", value.trim_end());
            }
            _ => {
                let _ = writeln!(out, "{line}");
            }
        }
    }
    out
}

/// Column of the comments behind values.
const COMMENTS: usize = 28;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_take_units() {
        let of = |text, units| quantity(text, units, false);
        assert_eq!(of("300mm", LENGTH), Ok(0.3));
        assert_eq!(of("0.3", LENGTH), Ok(0.3));
        assert_eq!(of("30 cm", LENGTH), Ok(0.3));
        assert_eq!(of("10in", LENGTH), Ok(0.254));
        assert_eq!(of("200 mA", CURRENT), Ok(0.2));
        // 1 kg cm is 9.80665 N x 0.01 m, 1 oz in is 4.448/16 N x 0.0254 m.
        assert!((of("14 kg.cm", TORQUE).unwrap() - 1.372_931).abs() < 1e-6);
        assert!((of("100oz-in", TORQUE).unwrap() - 0.706_155).abs() < 1e-6);
        // 60 rpm is one turn a second.
        assert!((of("60rpm", SPEED).unwrap() - std::f64::consts::TAU).abs() < 1e-12);
        assert!(
            of("3 parsec", LENGTH)
                .unwrap_err()
                .contains("m, cm, mm, in")
        );
        assert!(of("-3", LENGTH).is_err() && of("0", LENGTH).is_err() && of("", LENGTH).is_err());
        assert_eq!(quantity("0", CURRENT, true), Ok(0.0));
    }

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
