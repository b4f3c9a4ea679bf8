//! `cargo xtask demo`: builds the firmware, boots the group's robots in the emulator and drives a
//! curve twice, without and with compensation; then prints the figures and writes the report. On
//! the contact plant it is driven twice more with roller-phase kinematics, and the compensation is
//! measured there first, by native robots.
//!
//! The two drives are independent worlds, each in its own thread. Each is a complete session of the
//! master: boot, scan, configuration over SDO, NMT start, the curve, the ramp to standstill.
//! `omnibus` computes all figures of the motion, from the poses of the simulated world.

use std::path::PathBuf;

use anyhow::Context as _;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use omnibus::abort::Abort;
use omnibus::error::MasterError;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::report::{self, BackendName, Run, Scalar};
use omnibus::run::{Drive, DriveError, report};
use omnibus::simulation::contact;
use omnibus::simulation::run::simulated;

use crate::{cargo, firmware};

/// Options of `cargo xtask demo`.
#[derive(clap::Args)]
pub struct Arguments {
    /// The curve to drive.
    #[arg(long, value_enum, default_value_t = Curve::FigureEight)]
    trajectory: Curve,
    /// Group file, or the name of one in `groups/`.
    #[arg(long, default_value = "tcc-3")]
    config: String,
    /// Backend of the robots.
    #[arg(long, value_enum, default_value_t = BackendName::Emulator)]
    backend: BackendName,
    /// Arithmetic of the robots' kinematics; fixed point only in the emulator.
    #[arg(long, value_enum, default_value_t = Scalar::F32)]
    scalar: Scalar,
    /// Floor; by default that of the group file. Contact is rollers with friction and random
    /// phases. On it the curve is driven twice more, with roller phases configured.
    #[arg(long, value_enum)]
    plant: Option<PlantName>,
    /// Drives only the first seconds of the curve.
    #[arg(long)]
    quick: bool,
    /// Prints the figures in the axes of the source paper (x lateral, y longitudinal), beside its
    /// values.
    #[arg(long)]
    paper: bool,
    /// Where to write the JSON file (default: target/demo/demo.json).
    #[arg(long, value_name = "PATH")]
    json: Option<PathBuf>,
}

/// Floors to choose from.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PlantName {
    /// Rollers with friction, eight per wheel.
    Contact,
}

/// Rollers of a wheel on the contact plant.
const ROLLERS: u8 = 8;

/// Path of a group file given by path or by name.
fn group_file(config: &str) -> PathBuf {
    let named = cargo::root().join("groups").join(format!("{config}.toml"));
    if !config.contains(['/', '.']) && named.is_file() {
        named
    } else {
        config.into()
    }
}

/// Whether a group has robots that are no reference boards with bridges.
fn is_mixed(group: &group::GroupFile) -> bool {
    let reference = group::Board::default();
    let mut robots = group.robots.iter();
    robots.any(|robot| robot.board != reference || robot.output.kind.drive_current().is_some())
}

/// Builds, drives, reports.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.scalar == Scalar::Fixed && arguments.backend != BackendName::Emulator {
        anyhow::bail!("--scalar fixed: native robots are compiled for f32; add --backend emulator");
    }
    // A group file with a mistake is refused before anything is built or moved.
    let path = group_file(&arguments.config);
    let group = group::GroupFile::load(&path)?;
    let groups = match arguments.plant {
        None => {
            let phase = group.robots.iter().any(|robot| robot.rollers.is_some());
            vec![(group.clone(), phase)]
        }
        Some(PlantName::Contact) => {
            println!("calibrating native robots on the contact plant");
            let plain = contact::on_contact(&group, ROLLERS);
            let phase = contact::with_phases(&plain);
            let none = Abort::default();
            vec![
                (contact::calibrated(&plain, &none)?, false),
                (contact::calibrated(&phase, &none)?, true),
            ]
        }
    };
    let elf = match arguments.backend {
        BackendName::Emulator if is_mixed(&group) => {
            if arguments.scalar == Scalar::Fixed {
                anyhow::bail!(
                    "--scalar fixed: only for robots that are all reference boards with bridges"
                );
            }
            let images = cargo::target_folder().join("demo/images");
            firmware::build_for_group(&group, &images)?;
            Some(images)
        }
        BackendName::Emulator => Some(firmware::build(arguments.scalar)?),
        BackendName::Native | BackendName::Robots => None,
    };
    let folder = cargo::target_folder().join("demo");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot create {}", folder.display()))?;

    // A failed drive stops the other one: there is no report without both.
    let abort = Abort::default();
    let bars = MultiProgress::new();
    let one = |group: &group::GroupFile, phase: bool, compensation: bool| {
        let word = match (phase, compensation) {
            (false, false) => "off",
            (false, true) => "on",
            (true, false) => "phase",
            (true, true) => "phase+on",
        };
        let name = format!("{}, compensation {word}", arguments.trajectory);
        let progress = bars.add(bar(&name));
        let drive = Drive {
            group,
            course: Course {
                quick: arguments.quick,
                ..Course::of(arguments.trajectory)
            },
            feedback: None,
            compensation,
            elf: elf.as_deref(),
            candump: Some(folder.join(format!("compensation-{word}.candump.log"))),
            log: elf
                .is_some()
                .then(|| folder.join(format!("compensation-{word}.robots.log"))),
            abort: abort.clone(),
            record: None,
            index_search: Some(&|_| {}),
        };
        let run = simulated(&drive, &mut |done, phase| {
            progress.set_position((done * PROGRESS_STEPS) as u64);
            progress.set_message(phase);
        });
        if run.is_err() {
            abort.ask();
        }
        progress.finish_with_message(if run.is_ok() { "done" } else { "failed" });
        run.with_context(|| name)
    };
    let mut runs = Vec::new();
    for (group, phase) in &groups {
        let (off, on) = std::thread::scope(|scope| {
            let off = scope.spawn(|| one(group, *phase, false));
            let on = scope.spawn(|| one(group, *phase, true));
            (off.join(), on.join())
        });
        runs.extend(finished([off, on])?);
    }

    let mut report = report(&group, arguments.trajectory.name(), arguments.backend, runs);
    report.scalar = Some(arguments.scalar);
    report.paper = arguments.paper;
    let html = folder.join("report.html");
    write(&html, &report::html::to_html(&report)?)?;
    for (name, chart) in [
        ("trajectory.svg", report::charts::map(&report)),
        ("tracking.svg", report::charts::tracking(&report)),
        ("heading.svg", report::charts::heading(&report)),
    ] {
        write(&folder.join(name), &chart.to_svg()?)?;
    }
    let json = arguments
        .json
        .clone()
        .unwrap_or_else(|| folder.join("demo.json"));
    write(&json, &report::json::to_json(&report))?;

    println!("{}", report::table::to_table(&report));
    if arguments.paper {
        println!("Axes as in the paper: x lateral, y longitudinal.");
    }
    println!("report   {}", html.display());
    println!(
        "frames   {}",
        folder.join("compensation-*.candump.log").display()
    );
    println!("json     {}", json.display());
    Ok(())
}

/// Both runs, or the error that was there first: the one that is not "stopped on request".
fn finished(runs: [std::thread::Result<anyhow::Result<Run>>; 2]) -> anyhow::Result<Vec<Run>> {
    let mut done = Vec::new();
    let mut failed: Option<anyhow::Error> = None;
    for run in runs {
        match run {
            Ok(Ok(run)) => done.push(run),
            Ok(Err(error)) => {
                let stopped = matches!(
                    error.downcast_ref(),
                    Some(DriveError::Master(MasterError::Aborted))
                );
                if failed.is_none() || !stopped {
                    failed = Some(error);
                }
            }
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
    failed.map_or(Ok(done), Err)
}

/// Resolution of the progress bar.
const PROGRESS_STEPS: f64 = 1000.0;

fn bar(name: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template("{prefix:<34} [{bar:30}] {percent:>3} %  {elapsed} {msg}");
    let bar = ProgressBar::new(PROGRESS_STEPS as u64);
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_prefix(name.to_owned());
    bar
}

fn write(path: &std::path::Path, text: &str) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
