//! `cargo xtask accept`: level 1 of the acceptance of a board, a real or an emulated one.
//!
//! The procedure and its checks are the crate `acceptance`; this builds the two images, puts the
//! board together and writes the report. It exits with 6 when a promise is not kept, so that a
//! script can tell this from a procedure that could not be run.

#[cfg(unix)]
mod adapter;
mod board;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use acceptance::Check;
use acceptance::emulated::mutation::MUTATIONS;
use acceptance::emulated::{EmulatedBench, Images, Mutation, NODE};
use acceptance::level_one::{self, Options};
use acceptance::picture;
use acceptance::report::{self, Count, Subject};
use anyhow::{Context as _, bail};
use canopen::NodeId;
use emulator::Firmware;
use omnibus::bus::address::BusAddress;
use omnibus::report::Scalar;

use crate::firmware;
use crate::firmware::Board;
use crate::flash::Probe;
use board::{BoardBench, Paths, Person};

/// What an emulated board without defects measures, for comparison.
const EMULATED: &str = include_str!("../../../acceptance/emulated/level-1.json");

/// Checks that compare the board's time with the master's, or need setpoints in time. An emulated
/// board that has to keep up with this computer's clock falls behind it, above all while its flash
/// changes.
#[cfg(unix)]
const BY_THE_MASTERS_CLOCK: [&str; 7] = [
    "clock.crystal",
    "clock.watchdog",
    "watchdog.halt",
    "watchdog.panic",
    "flash.program",
    "flash.erase",
    "load.driving",
];

/// What a report says whose trial has not come to its end.
const ENDED_EARLY: &str = "the trial ended early: what is not listed was not tried";

/// A promise was not kept.
const BROKEN: u8 = 6;

/// Options of `cargo xtask accept`.
#[derive(clap::Args)]
#[command(group(clap::ArgGroup::new("board").required(true).args(["bus", "emulated", "wiring"])))]
pub struct Arguments {
    /// Measures an emulated board with virtual wires.
    #[arg(long)]
    emulated: bool,
    /// Puts the emulated board behind an emulated serial adapter, in real time: the way to a real
    /// board, tried without one.
    #[cfg(unix)]
    #[arg(long, requires = "emulated")]
    serial: bool,
    /// Writes a picture of the jumper wires and measures nothing.
    #[arg(long, value_name = "FILE.svg")]
    wiring: Option<PathBuf>,
    /// Measures the board on this bus, given as for `omnibus --bus`: slcan:DEVICE and so on.
    #[arg(long, value_name = "BUS")]
    bus: Option<BusAddress>,
    /// Flashes the board with probe-rs, through the probe with this serial number or the only one;
    /// a person is asked to do it otherwise.
    #[arg(long, value_name = "SERIAL", num_args = 0..=1, requires = "bus")]
    probe: Option<Option<String>>,
    /// There is a second board, whose outputs are compared with the first one's; needs `--probe`.
    #[arg(long, requires = "probe")]
    second: bool,
    /// Node of the board, as its switches say.
    #[arg(long, default_value_t = NODE, requires = "bus")]
    node: u8,
    /// Gives the board the defect with this name; `list` prints all of them.
    #[arg(long, value_name = "NAME", conflicts_with = "bus")]
    mutate: Option<String>,
    /// Where to write the report as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Where to write the report as a page.
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// Image as shipped; by default it is built.
    #[arg(long, value_name = "PATH")]
    image: Option<PathBuf>,
    /// Self-test image; by default it is built.
    #[arg(long, value_name = "PATH")]
    self_test: Option<PathBuf>,
}

/// Builds, tries, reports.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitCode> {
    if arguments.mutate.as_deref() == Some("list") {
        for mutation in MUTATIONS {
            println!(
                "{:<20} {}: caught by {}",
                mutation.name, mutation.what, mutation.caught_by
            );
        }
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(path) = &arguments.wiring {
        return write(path, &picture::svg()).map(|()| ExitCode::SUCCESS);
    }
    let mutation = mutation(arguments.mutate.as_deref())?;
    let emulated = serde_json::from_str(EMULATED).context("the emulated figures")?;
    let subject = subject(arguments, mutation);
    // Now, so that a file that cannot be written is found before a quarter of an hour is spent; and
    // after every check, so that Ctrl-C or a board that dies leaves what was measured.
    let keep = |checks: &[Check], ended: bool| -> anyhow::Result<()> {
        let mut subject = subject.clone();
        if let Some(chip) = level_one::chip(checks) {
            let emulated = if subject.hardware { "" } else { ", emulated" };
            subject.chip = format!("{chip}{emulated}");
        }
        if !ended {
            subject.limits.insert(0, ENDED_EARLY.to_owned());
        }
        let mut checks = checks.to_vec();
        report::expect(&mut checks, &emulated);
        if let Some(path) = &arguments.json {
            let text = serde_json::to_string_pretty(&report::json(&subject, &checks))? + "\n";
            write(path, &text)?;
        }
        if let Some(path) = &arguments.html {
            write(path, &report::html(&subject, &checks))?;
        }
        Ok(())
    };
    keep(&[], false)?;
    let mut so_far = |checks: &[Check]| {
        if let Some(last) = checks.last() {
            eprintln!("{:>3} {}", checks.len(), last.name);
        }
        if let Err(error) = keep(checks, false) {
            eprintln!("{error:#}");
        }
    };
    let mut checks = match &arguments.bus {
        Some(bus) => of_a_board(arguments, bus, &mut so_far)?,
        #[cfg(unix)]
        None if arguments.serial => behind_an_adapter(arguments, mutation, &mut so_far)?,
        None => {
            let images = images(arguments)?;
            let mut bench = EmulatedBench::new(&images, mutation);
            let node = NodeId::new(NODE).context("the board has no node-ID")?;
            level_one::run_reporting(&mut bench, node, &Options::SHORT, &mut so_far)?
        }
    };
    keep(&checks, true)?;
    report::expect(&mut checks, &emulated);

    for check in &checks {
        println!("{}", report::line(check));
    }
    let count = Count::of(&checks);
    println!("\n{count}");
    for limit in &subject.limits {
        println!("  {limit}");
    }
    Ok(if count.missed > 0 {
        ExitCode::from(BROKEN)
    } else {
        ExitCode::SUCCESS
    })
}

/// What is tried.
fn subject(arguments: &Arguments, mutation: Option<&Mutation>) -> Subject {
    let hardware = arguments.bus.as_ref().is_some_and(|bus| !bus.waits());
    let board = match hardware {
        true => "NUCLEO-F446RE",
        false => "NUCLEO-F446RE, emulated",
    };
    Subject {
        level: 1,
        board: board.to_owned(),
        chip: "not read".to_owned(),
        versions: env!("CARGO_PKG_VERSION").to_owned(),
        date: report::today(),
        hardware,
        mutation: mutation.map(|mutation| mutation.name.to_owned()),
        limits: match hardware {
            true => Vec::new(),
            false => Options::SHORT.limits(),
        },
    }
}

fn mutation(name: Option<&str>) -> anyhow::Result<Option<&'static Mutation>> {
    let Some(name) = name else { return Ok(None) };
    match Mutation::find(name) {
        Some(mutation) => Ok(Some(mutation)),
        None => bail!("there is no mutation '{name}'; `--mutate list` names all"),
    }
}

/// Level 1 of the board on a bus.
fn of_a_board(
    arguments: &Arguments,
    bus: &BusAddress,
    so_far: &mut dyn FnMut(&[Check]),
) -> anyhow::Result<Vec<Check>> {
    let node = NodeId::new(arguments.node);
    let node = node.with_context(|| format!("--node {}: give 1 to 127", arguments.node))?;
    let probe = arguments.probe.clone();
    let probe = probe
        .map(|serial| Probe::new(Board::default(), serial))
        .transpose()?;
    let link = omnibus::bus::adapter::open(bus)?;
    let paths = paths(arguments)?;
    let second = arguments.second;
    let hands = Box::new(Person {
        probe,
        paths,
        second,
    });
    let mut bench = BoardBench { link, hands };
    level_one::run_reporting(&mut bench, node, &Options::FULL, so_far)
}

/// Level 1 of an emulated board behind an emulated serial adapter.
#[cfg(unix)]
fn behind_an_adapter(
    arguments: &Arguments,
    mutation: Option<&'static Mutation>,
    so_far: &mut dyn FnMut(&[Check]),
) -> anyhow::Result<Vec<Check>> {
    let adapter = adapter::Adapter::start(images(arguments)?, mutation)?;
    let address = format!("slcan:{}", adapter.path().display());
    eprintln!("the emulated board is at --bus {address}");
    let link = omnibus::bus::adapter::open(&address.parse()?)?;
    let hands = Box::new(adapter);
    let mut bench = BoardBench { link, hands };
    let node = NodeId::new(NODE).context("the board has no node-ID")?;
    let mut checks = level_one::run_reporting(&mut bench, node, &Options::SHORT, so_far)?;
    for check in &mut checks {
        if BY_THE_MASTERS_CLOCK.contains(&check.name.as_str()) {
            check.tried = false;
            check.note = "an emulated board is as late as this computer is busy".to_owned();
        }
    }
    Ok(checks)
}

/// The images, built where none were given.
fn paths(arguments: &Arguments) -> anyhow::Result<Paths> {
    let self_test = match &arguments.self_test {
        Some(path) => path.clone(),
        None => firmware::build_self_test()?,
    };
    let shipped = match &arguments.image {
        Some(path) => path.clone(),
        None => firmware::build(Scalar::F32)?,
    };
    Ok(Paths { self_test, shipped })
}

fn images(arguments: &Arguments) -> anyhow::Result<Images> {
    let paths = paths(arguments)?;
    let load = |path: &Path| {
        Firmware::load(path).with_context(|| format!("cannot use {}", path.display()))
    };
    Ok(Images {
        self_test: load(&paths.self_test)?,
        shipped: load(&paths.shipped)?,
    })
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
    }
    omnibus::file::replace(path, text).with_context(|| format!("cannot write {}", path.display()))
}
