//! `omnibus wheel-test`, which tests whether every wire is in its place, and `omnibus blink`, which
//! shows which robot a node-ID belongs to.

use std::cell::Cell;
use std::io::BufRead as _;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::bail;
use omnibus::abort::Abort;
use omnibus::commission::motors::{Turned, WHEELS};
use omnibus::commission::wheel_test::{Finding, Observed, test_wheels};
use omnibus::error::MasterError;
use protocol::{Value, address};
use serde_json::json;

use super::output::{self, Found, Progress};
use super::{Target, print_line, print_note};

/// About how long a wheel's test takes, in s, for the bar.
const WHEEL_SECONDS: f64 = 4.4;

const EXAMPLES: &str = "Examples:
  omnibus wheel-test --node 2 --wheels-free --bus sim:groups/tcc-2.toml
  omnibus wheel-test --node 2 --wheels-free --ask --bus socketcan:can0 --group my-group.toml

Each wheel in turn rolls slowly forward, stops, jerks backward and stops, with at most 6 rad and half of the supply.
Exits with code 6 if something is wrong.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Node of the robot.
    #[arg(long, value_parser = super::robot)]
    node: u8,
    /// Confirms that the robot's wheels are off the floor.
    #[arg(long)]
    wheels_free: bool,
    /// Asks after every wheel what you saw turn, which distinguishes motors from encoders.
    #[arg(long)]
    ask: bool,
    #[command(flatten)]
    target: Target,
}

const BLINK_EXAMPLES: &str = "Examples:
  omnibus blink --node 3 --bus socketcan:can0
  omnibus blink --node 3 --for 0 --bus socketcan:can0";

#[derive(clap::Args)]
#[command(after_help = BLINK_EXAMPLES)]
pub struct Blink {
    /// Node of the robot.
    #[arg(long, value_parser = super::robot)]
    node: u8,
    /// Duration, s, up to 255; 0 ends the blinking.
    #[arg(long = "for", default_value_t = 10, value_name = "SECONDS")]
    seconds: u8,
    #[command(flatten)]
    target: Target,
}

/// `omnibus blink`.
pub fn blink(arguments: &Blink) -> anyhow::Result<()> {
    let (node, seconds) = (arguments.node, arguments.seconds);
    let mut wire = arguments.target.visit()?;
    wire.write(node, address::BLINK, Value::U8(seconds))?;
    if super::json() {
        return super::print_json(&json!({"node": node, "seconds": seconds}));
    }
    print_line(match seconds {
        0 => format!("node {node}: its LED shows its state again"),
        _ => format!("node {node}: its LED flashes five times and pauses, for {seconds} s"),
    })
}

/// `omnibus wheel-test`.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let group = arguments.target.group()?;
    let node = arguments.node;
    let Some(robot) = group.robots.iter().find(|robot| robot.node == node) else {
        bail!("--node {node}: group '{}' has no such robot", group.name);
    };
    if !arguments.wheels_free {
        usage!(
            "the wheels of node {node} will turn one by one; lift them off the floor, then add \
             --wheels-free"
        );
    }
    let (mut session, abort) = super::configured(&arguments.target, &group)?;
    let period_us = session.period_us();
    let progress = Progress::new(&format!("turning the wheels of node {node}"));
    let done = Cell::new(0);
    let mut turned = Vec::new();
    let mut look = |wheel, counted: &Turned| {
        done.set(wheel + 1);
        turned.push(Finding {
            wheel,
            turned: *counted,
            problem: None,
        });
        match arguments.ask {
            true => progress.aside(|| ask(wheel, &abort)),
            false => Ok(None),
        }
    };
    let mut watch = |seconds: f64| {
        let this = (seconds / WHEEL_SECONDS).min(1.0);
        let name = WHEELS.get(done.get()).copied().unwrap_or("");
        progress.share((done.get() as f64 + this) / WHEELS.len() as f64, name);
        abort.check()
    };
    let wire = session.wire();
    let tested = test_wheels(wire, node, period_us, &mut look, &mut watch);
    drop(progress);
    super::note_punctuality(&session);
    let findings = match tested {
        Ok(findings) => findings,
        Err(error) => {
            // Which wires are wrong takes all four; what the encoders counted is not lost.
            if !turned.is_empty() && !super::json() {
                show(&turned)?;
            }
            return Err(error.into());
        }
    };
    let wrong = findings.iter().filter(|f| f.problem.is_some()).count();
    if super::json() {
        let wheels: Vec<_> = findings.iter().map(finding_json).collect();
        super::print_json(&json!({"node": node, "wheels": wheels}))?;
    } else {
        show(&findings)?;
    }
    if wrong > 0 {
        return Err(Found(format!("node {node}: {wrong} of 4 wheels have a problem")).into());
    }
    print_line(
        "All four wheels turn in the right direction, and each one's own encoder counts it.",
    )?;
    if !arguments.ask {
        print_line(
            "Not checked by eye: a motor and an encoder that are both reversed would give the \
             same result. Use --ask.",
        )?;
        if robot.output.kind.drive_current().is_some() {
            print_line(
                "Swapped identifiers of smart drives do not show either: a drive reports the wheel \
                 that it turns itself.",
            )?;
        }
    }
    Ok(())
}

fn show(findings: &[Finding]) -> anyhow::Result<()> {
    let mut table = output::table(std::iter::once("driven").chain(WHEELS));
    for finding in findings {
        let mut row = vec![WHEELS.get(finding.wheel).copied().unwrap_or("").to_owned()];
        row.extend(finding.turned.ways.map(|way| format!("{way:+.2}")));
        table.add_row(row);
    }
    print_line(&table)?;
    print_line("How far each wheel's encoder turned, rad; + is forward.")?;
    for finding in findings {
        if let Some(problem) = &finding.problem {
            let wheel = WHEELS.get(finding.wheel).copied().unwrap_or("");
            print_line(format!("{wheel}: {problem}"))?;
        }
    }
    Ok(())
}

fn finding_json(finding: &Finding) -> serde_json::Value {
    json!({"wheel": WHEELS.get(finding.wheel), "ways_rad": finding.turned.ways,
        "speed_v_s_per_rad": finding.turned.speed, "problem": finding.problem})
}

/// Asks which wheel was seen to turn, until the answer is one.
fn ask(wheel: usize, abort: &Abort) -> Result<Option<Observed>, MasterError> {
    let name = WHEELS.get(wheel).copied().unwrap_or("");
    loop {
        print_note(format!(
            "{name}: what turned first? f: this wheel, forward; b: this wheel, backward; n: \
             nothing; another wheel: fl, fr, rl or rr, then f or b (`rl f`); Enter: not seen"
        ));
        let line = read_line(abort)?;
        let words: Vec<_> = line.split_whitespace().collect();
        let (which, way) = match words.as_slice() {
            [] => return Ok(None),
            ["n"] => return Ok(Some(Observed::Nothing)),
            [way] => (wheel, *way),
            [other, way] => match ["fl", "fr", "rl", "rr"].iter().position(|n| n == other) {
                Some(which) => (which, *way),
                None => continue,
            },
            _ => continue,
        };
        if let "f" | "b" = way {
            return Ok(Some(Observed::Wheel {
                wheel: which,
                forward: way == "f",
            }));
        }
    }
}

/// How often a question looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// A line from the standard input. It is read in a thread of its own, because reading does not end
/// at Ctrl-C.
fn read_line(abort: &Abort) -> Result<String, MasterError> {
    let (sender, answer) = channel();
    std::thread::spawn(move || {
        let mut line = String::new();
        let read = std::io::stdin().lock().read_line(&mut line);
        let _ = sender.send(read.ok().filter(|bytes| *bytes > 0).map(|_| line));
    });
    loop {
        match answer.recv_timeout(LOOK) {
            Ok(Some(line)) => return Ok(line),
            Ok(None) | Err(RecvTimeoutError::Disconnected) => {
                abort.check()?;
                return Err(MasterError::NoAnswer);
            }
            Err(RecvTimeoutError::Timeout) => abort.check()?,
        }
    }
}
