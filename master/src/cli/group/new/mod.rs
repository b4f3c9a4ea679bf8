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
//! Values that determine each other must agree: a motor that gives more power than it takes was
//! misread, and the error says so. All of these are starting values; `omnibus identify-motors`
//! measures the motor itself.

use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use group::{Examination, FIRST_NODE, LAST_NODE};

use crate::cli::check_writable;

use super::{json, print_json, print_line, print_note};

use motor::{Motor, Robot};
use quantity::{Units, place, quantity};
use text::file;

mod motor;
mod quantity;
mod text;

const EXAMPLES: &str = "Examples:
  omnibus group new my-group.toml
  omnibus group new my-group.toml --robot 0.25,0 --robot -0.25,0 --track 0.30m --wheelbase 260mm \\
      --wheel-diameter 100mm --mass 8kg --supply 12V --no-load-speed 330rpm --no-load-current 0.2A \\
      --stall-torque 14kg.cm --stall-current 5.5A --counts 64 --gear-ratio 30

On a terminal it asks for everything that the options do not give. Numbers may have a unit: m, cm, mm, in; V; A, mA;
N.m, kg.cm, oz.in; rpm, rad/s; kg, g. Motor data are those at the output shaft of the gear.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The file to write.
    file: PathBuf,
    /// Replaces the file if it exists.
    #[arg(long)]
    replace: bool,
    /// Short name of the group; by default the file's name.
    #[arg(long)]
    name: Option<String>,
    /// Number of the group on the bus.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    group_id: u8,
    /// Position of a robot in the group: x ahead, y left, and heading in degrees if it is not 0.
    /// Repeat for each robot; node ids count up from 2.
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
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 45.0,
        value_parser = crate::cli::real::<f64>
    )]
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

/// Where answers come from: options first, then the person at the terminal.
struct Answers {
    asks: bool,
    missing: Vec<&'static str>,
    wrong: Vec<String>,
    /// What was answered, with the options that say the same.
    typed: Vec<(&'static str, String)>,
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
                    Ok(value) => {
                        self.typed.push((option, answer));
                        return value;
                    }
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

/// Options as a shell takes them.
fn as_options(typed: &[(&str, String)]) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-+.,/".contains(c);
    let words = typed
        .iter()
        .map(|(option, value)| match value.chars().all(plain) {
            true => format!("{option} {value}"),
            false => format!("{option} \"{value}\""),
        });
    words.collect::<Vec<_>>().join(" ")
}

/// Asks one question; `None` at the end of the input.
fn ask(question: &str, usual: Option<&str>) -> Option<String> {
    let usual_text = usual.map_or_else(String::new, |usual| format!(" [{usual}]"));
    let _ = write!(std::io::stderr().lock(), "{question}{usual_text}: ");
    let mut line = String::new();
    match std::io::stdin().lock().read_line(&mut line) {
        Ok(0) | Err(_) => None,
        Ok(_) if line.trim().is_empty() => Some(usual.unwrap_or_default().to_owned()),
        Ok(_) => Some(line.trim().to_owned()),
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
    // Before anybody answers a dozen questions.
    check_writable("FILE", path)?;
    let mut answers = Answers {
        asks: std::io::stdin().is_terminal() && std::io::stderr().is_terminal(),
        missing: Vec::new(),
        wrong: Vec::new(),
        typed: Vec::new(),
    };
    let written = write(arguments, &mut answers);
    if written.is_err() && !answers.typed.is_empty() {
        print_note(format_args!(
            "Your answers as options, to be corrected: {}",
            as_options(&answers.typed)
        ));
    }
    written
}

/// Writes the file of what is given and answered.
fn write(arguments: &Arguments, answers: &mut Answers) -> anyhow::Result<()> {
    let path = &arguments.file;
    let places = places(arguments, answers);
    let robot = Robot::ask(arguments, answers);
    let mut problems = std::mem::take(&mut answers.wrong);
    if !answers.missing.is_empty() {
        problems.push(format!(
            "missing: {} (on a terminal this command asks)",
            answers.missing.join(", ")
        ));
    }
    if !problems.is_empty() {
        usage!("{}", problems.join("; "));
    }
    let motor = Motor::of(&robot)?;
    let stem = path
        .file_stem()
        .map(|stem| stem.to_string_lossy().into_owned());
    let name = arguments.name.clone().or(stem).unwrap_or_default();
    let text = file(arguments, &name, &robot, &motor, &places)?;
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
        "{shown} is written. Its motor values are calculated from the data sheet; with the wheels \
         free, `omnibus identify-motors --accept --save` measures them."
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
                    Ok(at) => {
                        places.push(at);
                        answers.typed.push(("--robot", answer));
                    }
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

#[cfg(test)]
mod tests {
    use super::as_options;

    #[test]
    fn answers_become_options() {
        let typed = [
            ("--robot", "-0.25,0"),
            ("--track", "30 cm"),
            ("--counts", "64"),
        ];
        let typed = typed.map(|(option, value)| (option, value.to_owned()));
        let options = as_options(&typed);
        assert_eq!(options, "--robot -0.25,0 --track \"30 cm\" --counts 64");
    }
}
