//! `cargo xtask faults`: lets every cause of a stop happen to emulated robots that run the release image, and
//! compares what they do with `docs/safety.md`.
//!
//! [`promise`] reads the page, [`causes`] brings the causes about, [`measure`] drives and looks. Every trial is a
//! world of its own, so they run side by side. A promise that is not kept is a failure, and so is one of the causes 1 to 22
//! without a time or a trial.

mod causes;
mod image;
mod measure;
mod power;
mod promise;
mod skew;

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, bail};
use emulator::Firmware;
use group::GroupFile;
use omnibus::report::Scalar;
use protocol::Reaction;
use serde_json::json;

use crate::{cargo, firmware};
use causes::{CASES, Case};
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
    let (lines, skew) = std::thread::scope(|scope| {
        // The longest trial beside the others.
        let skew = arguments
            .only
            .is_none()
            .then(|| scope.spawn(|| skew::measure(&group, &firmware)));
        let lines = side_by_side(&jobs, |(promise, case)| Line {
            promise: (*promise).clone(),
            variant: case.variant,
            outcome: tried(&group, &firmware, promise, case),
        });
        (lines, skew.map(std::thread::ScopedJoinHandle::join))
    });

    println!(
        "{:>2}  {:<70} {:<25} {:<5} {:>9} {:>9} {:>9} {:>8}",
        "#", "cause", "code", "how", "promised", "measured", "emergency", "rest"
    );
    for line in &lines {
        println!("{}", text(line));
    }
    let skew = match skew {
        Some(Ok(skew)) => Some(skew?),
        Some(Err(_)) => bail!("the measurement of the PWM skew panicked"),
        None => None,
    };
    if let Some(skew) = skew {
        println!(
            "\nPWM of two robots, crystals {:+} and {:+} ppm, SYNC off by up to {} us, {} s: changes at most {:.1} us \
             apart, promised {} us ({} changes)",
            skew::CRYSTALS_PPM[0],
            skew::CRYSTALS_PPM[1],
            skew::JITTER_US,
            skew::SECONDS,
            skew.worst_us,
            skew::LIMIT_US,
            skew.changes
        );
    }
    if let Some(path) = &arguments.json {
        let all: Vec<_> = lines.iter().map(to_json).collect();
        let worst_us = skew.map(|skew| skew.worst_us);
        let text = serde_json::to_string_pretty(
            &json!({ "faults": all, "pwm_skew_us": worst_us, "pwm_skew_limit_us": skew::LIMIT_US }),
        )?;
        std::fs::write(path, text + "\n")
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let bad = |line: &&Line| matches!(line.outcome, Outcome::Missed(_) | Outcome::Failed(_));
    let bad = lines.iter().filter(bad).count();
    if bad > 0 {
        bail!("{bad} of {} promises are not kept", lines.len());
    }
    if skew.is_some_and(|skew| skew.worst_us > skew::LIMIT_US) {
        bail!("the robots change their PWM too far apart");
    }
    Ok(())
}

type Job<'a> = (&'a Promise, &'static Case);

/// What is to be tried, by number.
fn jobs(promises: &[Promise], only: Option<u8>) -> anyhow::Result<Vec<Job<'_>>> {
    let wanted = |number: u8| only.is_none_or(|only| only == number);
    CASES
        .iter()
        .filter(|case| wanted(case.number))
        .map(|case| {
            let number = case.number;
            let promise = promises.iter().find(|promise| promise.number == number);
            let promise = promise.with_context(|| format!("docs/safety.md has no row {number}"))?;
            Ok((promise, case))
        })
        .collect()
}

fn tried(group: &GroupFile, firmware: &Firmware, promise: &Promise, case: &Case) -> Outcome {
    let fault = promise.fault;
    let announced = case.announced.unwrap_or(fault);
    let kept = |measured: &Measured| {
        // A cut is one of drivers and brake together.
        let time = match fault.reaction() {
            Reaction::Ramp => measured.reaction_ms,
            Reaction::Cut => measured.reaction_ms.max(measured.rest_ms),
        };
        promise.millis.is_some_and(|promised| time <= promised)
    };
    match measure::measure(group, firmware, case, announced, fault.reaction()) {
        Ok(measured) if kept(&measured) => Outcome::Kept(measured),
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
        Reaction::Ramp => "ramp",
        Reaction::Cut => "cut",
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
    }
}

fn to_json(line: &Line) -> serde_json::Value {
    let promise = &line.promise;
    let (verdict, measured, reason) = match &line.outcome {
        Outcome::Kept(measured) => ("kept", Some(measured), None),
        Outcome::Missed(measured) => ("missed", Some(measured), None),
        Outcome::Failed(problem) => ("failed", None, Some(problem.as_str())),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_of_the_22_causes_is_promised_a_time_and_tried() {
        let promises = promise::read(include_str!("../../../docs/safety.md")).unwrap();
        for number in 1..=22 {
            assert!(CASES.iter().any(|case| case.number == number), "{number}");
            let promise = promises.iter().find(|promise| promise.number == number);
            assert!(promise.unwrap().millis.is_some(), "{number}");
        }
    }
}
