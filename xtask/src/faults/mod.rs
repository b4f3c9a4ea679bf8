//! `cargo xtask faults`: lets every cause of a stop happen to emulated robots that run the release image, and
//! compares what they do with `docs/safety.md`.
//!
//! [`promise`] reads the page, [`causes`] brings the causes about, [`measure`] drives and looks. Every trial is a
//! world of its own, so they run side by side. What cannot be tried is listed with the reason and is no failure; what
//! is tried and not kept is.

mod causes;
mod measure;
mod promise;

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, bail};
use emulator::Firmware;
use group::GroupFile;
use omnibus::report::Scalar;
use serde_json::json;

use crate::{cargo, firmware};
use causes::{TRIALS, Trial};
use measure::Measured;
use promise::Promise;

/// Options of `cargo xtask faults`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Where to write the results as JSON.
    #[arg(long, value_name = "PATH")]
    json: Option<PathBuf>,
    /// Tries the cause with this number only.
    #[arg(long, value_name = "NUMBER")]
    only: Option<u8>,
}

/// The group whose robots are tried.
const GROUP: &str = "groups/tcc-3.toml";

/// One line of the result.
struct Line {
    promise: Promise,
    variant: &'static str,
    outcome: Outcome,
}

enum Outcome {
    Kept(Measured),
    Missed(Measured),
    /// Something else than promised happened.
    Failed(String),
    NotCovered(&'static str),
}

/// Builds, tries, prints.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let page = cargo::root().join("docs/safety.md");
    let page = std::fs::read_to_string(&page)
        .with_context(|| format!("cannot read {}", page.display()))?;
    let promises = promise::read(&page)?;
    let group = GroupFile::load(cargo::root().join(GROUP))?;
    let firmware = Firmware::load(firmware::build(Scalar::F32)?)?;

    let jobs = jobs(&promises, arguments.only)?;
    let lines = side_by_side(&jobs, |(promise, variant, trial)| Line {
        promise: (*promise).clone(),
        variant,
        outcome: match trial {
            Trial::NotCovered(reason) => Outcome::NotCovered(reason),
            trial => tried(&group, &firmware, promise, variant, *trial),
        },
    });

    println!(
        "{:>2}  {:<70} {:<25} {:<5} {:>9} {:>9} {:>9} {:>8}",
        "#", "cause", "code", "how", "promised", "measured", "emergency", "rest"
    );
    for line in &lines {
        println!("{}", text(line));
    }
    if let Some(path) = &arguments.json {
        let all: Vec<_> = lines.iter().map(to_json).collect();
        let text = serde_json::to_string_pretty(&json!({ "faults": all }))?;
        std::fs::write(path, text + "\n")
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let bad = |line: &&Line| matches!(line.outcome, Outcome::Missed(_) | Outcome::Failed(_));
    match lines.iter().filter(bad).count() {
        0 => Ok(()),
        bad => bail!("{bad} of {} promises are not kept", lines.len()),
    }
}

type Job<'a> = (&'a Promise, &'static str, Trial);

/// What is to be tried, by number.
fn jobs(promises: &[Promise], only: Option<u8>) -> anyhow::Result<Vec<Job<'_>>> {
    let wanted = |number: u8| only.is_none_or(|only| only == number);
    TRIALS
        .iter()
        .filter(|(number, ..)| wanted(*number))
        .map(|(number, variant, trial)| {
            let promise = promises.iter().find(|promise| promise.number == *number);
            let promise = promise.with_context(|| format!("docs/safety.md has no row {number}"))?;
            Ok((promise, *variant, *trial))
        })
        .collect()
}

fn tried(
    group: &GroupFile,
    firmware: &Firmware,
    promise: &Promise,
    variant: &str,
    trial: Trial,
) -> Outcome {
    // A processor that is halted for good by the emergency stop's trial is reset by its watchdog and then
    // announces that, not the stop.
    let fault = promise.fault;
    let expected = if variant == causes::HALTED_STOP {
        protocol::Fault::WatchdogReset
    } else {
        fault
    };
    match measure::measure(group, firmware, trial, expected, fault.reaction()) {
        Ok(measured) if promise.millis.is_none_or(|ms| measured.reaction_ms <= ms) => {
            Outcome::Kept(measured)
        }
        Ok(measured) => Outcome::Missed(measured),
        Err(error) => Outcome::Failed(format!("{error:#}")),
    }
}

/// Does the jobs on as many threads as the machine has; the results in order.
fn side_by_side<J: Sync, R: Send>(jobs: &[J], work: impl Fn(&J) -> R + Sync) -> Vec<R> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let place = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = jobs.get(place) else { break };
                    let result = work(job);
                    if let Ok(mut results) = results.lock() {
                        results.push((place, result));
                    }
                }
            });
        }
    });
    let mut results = results
        .into_inner()
        .unwrap_or_else(|error| error.into_inner());
    results.sort_by_key(|(place, _)| *place);
    results.into_iter().map(|(_, result)| result).collect()
}

/// `ramp` or `cut`.
fn how(promise: &Promise) -> &'static str {
    match promise.fault.reaction() {
        protocol::Reaction::Ramp => "ramp",
        protocol::Reaction::Cut => "cut",
    }
}

fn cause(line: &Line) -> String {
    match line.variant {
        "" => line.promise.cause.clone(),
        words => format!("{} ({words})", line.promise.cause),
    }
}

fn text(line: &Line) -> String {
    let promise = &line.promise;
    let code = format!("0x{:04X} {}", promise.fault.code(), promise.fault.name());
    let ms = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1} ms"));
    let promised = promise
        .millis
        .map_or_else(|| "-".to_owned(), |ms| format!("{ms} ms"));
    let head = format!(
        "{:>2}  {:<70} {code:<25} {:<5} {promised:>9}",
        promise.number,
        cause(line),
        how(promise)
    );
    let figures = |measured: &Measured| {
        format!(
            "{:>9} {:>9} {:>8}",
            ms(Some(measured.reaction_ms)),
            ms(Some(measured.emergency_ms)),
            ms(Some(measured.rest_ms))
        )
    };
    match &line.outcome {
        Outcome::Kept(measured) => format!("{head} {}", figures(measured)),
        Outcome::Missed(measured) => format!("{head} {}  MISSED", figures(measured)),
        Outcome::Failed(problem) => format!("{head} FAILED: {problem}"),
        Outcome::NotCovered(reason) => format!("{head} not covered: {reason}"),
    }
}

fn to_json(line: &Line) -> serde_json::Value {
    let promise = &line.promise;
    let (verdict, measured, reason) = match &line.outcome {
        Outcome::Kept(measured) => ("kept", Some(measured), None),
        Outcome::Missed(measured) => ("missed", Some(measured), None),
        Outcome::Failed(problem) => ("failed", None, Some(problem.as_str())),
        Outcome::NotCovered(reason) => ("not covered", None, Some(*reason)),
    };
    json!({
        "number": promise.number,
        "cause": cause(line),
        "code": format!("0x{:04X}", promise.fault.code()),
        "fault": promise.fault.name(),
        "reaction": how(promise),
        "promised_ms": promise.millis,
        "measured_ms": measured.map(|m| m.reaction_ms),
        "emergency_ms": measured.map(|m| m.emergency_ms),
        "rest_ms": measured.map(|m| m.rest_ms),
        "verdict": verdict,
        "reason": reason,
    })
}
