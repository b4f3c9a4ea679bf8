//! `cargo xtask faults`: injects every cause of a stop into emulated robots that run the release
//! image, and compares their reaction with `docs/safety.md`.
//!
//! [`acceptance::causes`] reads the page, [`causes`] injects the causes, [`measure`] drives and
//! measures, and [`pairs`] does the same with two causes at a time. Every trial has its own world,
//! so trials run in parallel. A broken promise is a failure, and so is a cause with a promised time
//! but without a trial.

mod causes;
mod image;
mod measure;
mod measured;
mod pairs;
mod power;
mod skew;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use acceptance::causes::{Promise, Slow};
use anyhow::{Context as _, bail};
use emulator::Firmware;
use group::{GroupFile, StageKind};
use protocol::Reaction;
use serde_json::json;

use crate::firmware::Board;
use crate::{cargo, firmware};
use causes::{CASES, Case, Procedure};
use measure::{Driving, Robots};
use measured::Measured;
use pairs::Pair;

/// Options of `cargo xtask faults`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Where to write the results as JSON.
    #[arg(long, value_name = "PATH")]
    json: Option<PathBuf>,
    /// Tests only the cause with this number.
    #[arg(long, value_name = "NUMBER")]
    only: Option<u8>,
    /// Pairs of causes to test: all of them with native robots and those that cut with the image,
    /// only those that cut, which is the default but for a kit, or none. Not with smart drives.
    #[arg(long, value_enum)]
    pairs: Option<Pairs>,
    /// Number of tests that run in parallel; by default the number of processors.
    #[arg(long, value_name = "NUMBER")]
    jobs: Option<NonZeroUsize>,
    /// Board of the robots.
    #[arg(long, value_enum, default_value = "nucleo-f446re")]
    board: Board,
    /// Kind of the robots' motor drivers, as `motor.output_stage` of group files; by default
    /// c620 with a board that drives by smart drives only, pwm-direction otherwise.
    #[arg(long, value_enum)]
    output_stage: Option<Stage>,
    /// Firmware image to test; by default it is built.
    #[arg(long, value_name = "PATH")]
    image: Option<PathBuf>,
}

/// Pairs of causes to test.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Pairs {
    /// All pairs with native robots, and those with a cut also with the image.
    All,
    /// Pairs with a cut, with native robots and with the image.
    Cuts,
    /// None.
    None,
}

/// Kinds of motor drivers.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Stage {
    /// PWM and direction.
    PwmDirection,
    /// Two half bridges per wheel.
    InInSlow,
    /// Two PWMs per wheel, one input low.
    InInFast,
    /// Two PWMs per wheel, one input high.
    InInBrake,
    /// Half of the period high is no voltage.
    LockedAntiphase,
    /// RoboMaster C620 drives on a CAN bus of their own.
    C620,
}

impl From<Stage> for StageKind {
    fn from(stage: Stage) -> Self {
        match stage {
            Stage::PwmDirection => Self::PwmDirection,
            Stage::InInSlow => Self::InInSlow,
            Stage::InInFast => Self::InInFast,
            Stage::InInBrake => Self::InInBrake,
            Stage::LockedAntiphase => Self::LockedAntiphase,
            Stage::C620 => Self::C620,
        }
    }
}

/// The group whose robots are tried.
const GROUP: &str = "groups/tcc-3.toml";

/// One line of the result.
struct Line {
    /// With the time of the case, where it has its own.
    promise: Promise,
    variant: &'static str,
    outcome: Outcome,
}

enum Outcome {
    Held(Measured),
    Missed(Measured),
    /// Something else than promised happened.
    Failed(String),
}

/// Builds, tries, prints.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let page = cargo::root().join("docs/safety.md");
    let page = std::fs::read_to_string(&page)
        .with_context(|| format!("cannot read {}", page.display()))?;
    let mut promises = acceptance::causes::read(&page)?;
    if arguments.board == Board::KitF103rc {
        for promise in &mut promises {
            promise.millis = promise.kit_millis.or(promise.millis);
        }
    }
    let slow = acceptance::causes::slow(&page)?;
    let mut group = GroupFile::load(cargo::root().join(GROUP))?;
    let stage = arguments.stage();
    let smart = matches!(stage, Stage::C620);
    let pairs = match arguments.pairs {
        None | Some(Pairs::None) if smart => Pairs::None,
        Some(_) if smart => {
            bail!("--pairs: pairs of causes are not tested with smart drives; give --pairs none")
        }
        // They take longer than all other trials of a kit.
        None if arguments.board == Board::KitF103rc => Pairs::None,
        pairs => pairs.unwrap_or(Pairs::Cuts),
    };
    for robot in &mut group.robots {
        robot.board = arguments.board.into();
        robot.output.kind = stage.into();
        robot.output.enable_wired = robot.output.kind.needs_enable();
        if smart {
            fit_drives(robot);
        }
    }
    let image = match &arguments.image {
        Some(path) => path.clone(),
        None => firmware::build_with(arguments.board, StageKind::from(stage).into())?,
    };
    let firmware = Firmware::load(image)?;
    let threads = match arguments.jobs {
        Some(jobs) => jobs.get(),
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };

    let driving = Driving::new(&group, Robots::Emulated(&firmware));
    let jobs = jobs(&promises, arguments.only, (arguments.board, stage.into()))?;
    let (lines, skew) = std::thread::scope(|scope| {
        // The longest trial beside the others. A duty changes the PWM of the other kinds by fewer
        // steps, so that too few ticks show when it does.
        let all = arguments.only.is_none();
        let skew = (all && matches!(stage, Stage::PwmDirection))
            .then(|| scope.spawn(|| skew::measure(&group, &firmware)));
        let lines = side_by_side(threads, &jobs, |(promise, case)| Line {
            promise: Promise {
                millis: case.millis.or(promise.millis_with(smart)),
                wheel_rate: case.wheel_rate.or(promise.wheel_rate),
                ..(*promise).clone()
            },
            variant: case.variant,
            outcome: tried(&driving, &firmware, promise, case, smart),
        });
        (lines, skew.map(std::thread::ScopedJoinHandle::join))
    });

    println!(
        "{:>2}  {:<70} {:<25} {:<5} {:>9} {:>9} {:>9} {:>8} {:>6} {:>7}",
        "#", "cause", "code", "how", "promised", "measured", "emergency", "rest", "wheel", "way"
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
    let only = arguments.only;
    let causes = pairs::all(&promises, (arguments.board, stage.into()));
    let tried = try_pairs(pairs, only, threads, (causes, slow), &group, &firmware);
    print_pairs(&tried);
    if let Some(path) = &arguments.json {
        let all: Vec<_> = lines.iter().map(to_json).collect();
        let pairs: Vec<_> = tried.iter().map(pair_to_json).collect();
        let worst_us = skew.map(|skew| skew.worst_us);
        let text = serde_json::to_string_pretty(
            &json!({ "faults": all, "pairs": pairs, "pwm_skew_us": worst_us, "pwm_skew_limit_us": skew::LIMIT_US }),
        )?;
        std::fs::write(path, text + "\n")
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let bad = |line: &&Line| matches!(line.outcome, Outcome::Missed(_) | Outcome::Failed(_));
    let bad = lines.iter().filter(bad).count();
    if bad > 0 {
        bail!("{bad} of {} causes break their promise", lines.len());
    }
    let bad = tried.iter().filter(|tried| !tried.holds()).count();
    if bad > 0 {
        bail!("{bad} of {} pairs of causes break a promise", tried.len());
    }
    if skew.is_some_and(|skew| skew.worst_us > skew::LIMIT_US) {
        bail!("the robots change their PWM at times too far apart");
    }
    Ok(())
}

type Job<'a> = (&'a Promise, &'static Case);

impl Arguments {
    /// Kind of the robots' motor drivers.
    fn stage(&self) -> Stage {
        self.output_stage.unwrap_or(match self.board {
            Board::NucleoF446re => Stage::PwmDirection,
            Board::RobomasterC => Stage::C620,
            Board::KitF103rc => Stage::InInBrake,
        })
    }
}

/// A robot gets C620 drives, with the encoder and the current of M3508 motors behind their gear.
fn fit_drives(robot: &mut group::Robot) {
    robot.encoder.counts_per_revolution = 8192.0;
    robot.encoder.gear_ratio = 3591.0 / 187.0;
    robot.output.largest_current = Some(20.0);
}

/// What is to be tried, by number.
fn jobs(
    promises: &[Promise],
    only: Option<u8>,
    (board, kind): (Board, StageKind),
) -> anyhow::Result<Vec<Job<'_>>> {
    let wanted = |number: u8| only.is_none_or(|only| only == number);
    CASES
        .iter()
        .filter(|case| wanted(case.number) && case.drives.concern(kind) && (case.boards)(board))
        .map(|case| {
            let number = case.number;
            let promise = promises.iter().find(|promise| promise.number == number);
            let promise = promise.with_context(|| format!("docs/safety.md has no row {number}"))?;
            Ok((promise, case))
        })
        .collect()
}

fn tried(
    driving: &Driving<'_>,
    firmware: &Firmware,
    promise: &Promise,
    case: &Case,
    smart: bool,
) -> Outcome {
    let announced = case.announced.unwrap_or(promise.fault);
    let holds = |measured: &Measured| {
        // A cut is one of drivers and brake together.
        let time = match announced.reaction() {
            Reaction::Ramp => measured.reaction_ms,
            Reaction::Cut => measured.reaction_ms.max(measured.rest_ms),
        };
        let within = |measured: Option<f64>, promised: Option<f64>| {
            measured.zip(promised).is_none_or(|(m, p)| m <= p)
        };
        let millis = case.millis.or(promise.millis_with(smart));
        let wheel_rate = case.wheel_rate.or(promise.wheel_rate);
        millis.is_some_and(|promised| time <= promised)
            && within(measured.wheel_rate, wheel_rate)
            && within(measured.way, promise.way)
    };
    let measured = match case.procedure {
        Procedure::Stored(procedure) => procedure(firmware),
        _ => measure::measure(driving, case, announced, smart),
    };
    match measured {
        Ok(measured) if holds(&measured) => Outcome::Held(measured),
        Ok(measured) => Outcome::Missed(measured),
        Err(error) => Outcome::Failed(format!("{error:#}")),
    }
}

/// A pair of causes that has been tried.
struct TriedPair<'a> {
    pair: Pair<'a>,
    image: bool,
    outcome: anyhow::Result<pairs::Outcome>,
}

impl TriedPair<'_> {
    fn holds(&self) -> bool {
        self.outcome.as_ref().is_ok_and(pairs::Outcome::holds)
    }
}

/// Tries the pairs that are asked for.
fn try_pairs<'a>(
    which: Pairs,
    only: Option<u8>,
    threads: usize,
    (causes, slow): (Vec<Pair<'a>>, Slow),
    group: &GroupFile,
    firmware: &Firmware,
) -> Vec<TriedPair<'a>> {
    if which == Pairs::None {
        return Vec::new();
    }
    let concerned = |pair: &Pair<'_>| only.is_none_or(|only| pair.concerns(only));
    let jobs = causes.into_iter().filter(concerned);
    let mut jobs: Vec<_> = jobs
        .flat_map(|pair| [(pair, true), (pair, false)])
        .filter(|(pair, image)| match image {
            true => pair.cuts(),
            false => !pair.needs_image() && (pair.cuts() || which == Pairs::All),
        })
        .collect();
    // The longest first, so that no thread is left with one at the end.
    jobs.sort_by_key(|(_, image)| !image);
    let emulated = Driving::new(group, Robots::WatchedEmulated(firmware));
    let native = Driving::new(group, Robots::Native);
    side_by_side(threads, &jobs, |(pair, image)| TriedPair {
        pair: *pair,
        image: *image,
        outcome: pair.measure(if *image { &emulated } else { &native }, slow),
    })
}

/// Prints how many pairs kept their promises, and those that did not.
fn print_pairs(tried: &[TriedPair<'_>]) {
    if tried.is_empty() {
        return;
    }
    let image = tried.iter().filter(|tried| tried.image).count();
    println!(
        "\n{} pairs of causes, {:?} ms apart: {image} with the image, {} native",
        tried.len(),
        pairs::DELAYS_MS,
        tried.len() - image
    );
    for bad in tried.iter().filter(|tried| !tried.holds()) {
        let pair = &bad.pair;
        let robots = if bad.image { "image" } else { "native" };
        let name = |(promise, case): (&Promise, &Case)| {
            format!(
                "{} {} {}",
                promise.number,
                promise.fault.name(),
                case.variant
            )
        };
        let outcome = match &bad.outcome {
            Ok(outcome) => {
                let measured = outcome.measured_ms;
                let measured = measured.map_or("not at all".to_owned(), |ms| format!("{ms:.1} ms"));
                let faster = if outcome.faster {
                    ", the wheel became faster"
                } else {
                    ""
                };
                format!(
                    "off after {measured}, promised {} ms{faster}",
                    outcome.promise_ms
                )
            }
            Err(error) => format!("{error:#}"),
        };
        println!(
            "{}, then after {} ms {} ({robots}): {outcome}",
            name(pair.first).trim(),
            pair.delay_ms,
            name(pair.second).trim()
        );
    }
}

fn pair_to_json(tried: &TriedPair<'_>) -> serde_json::Value {
    let pair = &tried.pair;
    let outcome = tried.outcome.as_ref();
    json!({
        "first": pair.first.0.number,
        "first_variant": pair.first.1.variant,
        "second": pair.second.0.number,
        "second_variant": pair.second.1.variant,
        "delay_ms": pair.delay_ms,
        "cuts": pair.cuts(),
        "robots": if tried.image { "image" } else { "native" },
        "promise_ms": outcome.ok().map(|outcome| outcome.promise_ms),
        "measured_ms": outcome.ok().and_then(|outcome| outcome.measured_ms),
        "kept": tried.holds(),
        "reason": outcome.err().map(|error| format!("{error:#}")),
    })
}

/// Does the jobs on so many threads; the results in order.
fn side_by_side<J: Sync, R: Send>(
    threads: usize,
    jobs: &[J],
    work: impl Fn(&J) -> R + Sync,
) -> Vec<R> {
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
            "{:>9} {:>9} {:>8} {:>6} {:>7}",
            ms(Some(measured.reaction_ms)),
            ms(Some(measured.emergency_ms)),
            ms(Some(measured.rest_ms)),
            measured
                .wheel_rate
                .map_or_else(|| "-".to_owned(), |rate| format!("{rate:.2}")),
            measured
                .way
                .map_or_else(|| "-".to_owned(), |way| format!("{way:.3} m"))
        )
    };
    match &line.outcome {
        Outcome::Held(measured) => format!("{head} {}", figures(measured)),
        Outcome::Missed(measured) => format!("{head} {}  MISSED", figures(measured)),
        Outcome::Failed(problem) => format!("{head} FAILED: {problem}"),
    }
}

fn to_json(line: &Line) -> serde_json::Value {
    let promise = &line.promise;
    let (verdict, measured, reason) = match &line.outcome {
        Outcome::Held(measured) => ("kept", Some(measured), None),
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
        "promised_wheel_rate": promise.wheel_rate,
        "wheel_rate": measured.and_then(|m| m.wheel_rate),
        "promised_way_m": promise.way,
        "way_m": measured.and_then(|m| m.way),
        "verdict": verdict,
        "reason": reason,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_of_the_page_is_promised_a_time_and_tried_or_tried_elsewhere() {
        let promises = acceptance::causes::read(include_str!("../../../docs/safety.md")).unwrap();
        for promise in &promises {
            let number = promise.number;
            let tried = CASES.iter().any(|case| case.number == number);
            let elsewhere = causes::ELSEWHERE.iter().any(|(row, _)| *row == number);
            let promised = promise.millis_with(true).is_some();
            assert_eq!(promised, tried, "{number}");
            assert_ne!(tried, elsewhere, "{number}");
        }
    }
}
