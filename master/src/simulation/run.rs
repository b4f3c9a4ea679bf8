//! A drive in a simulated world: built, booted, driven along the path, and measured from outside.
//!
//! The robots are moved by the master through the virtual bus alone. What they did is read from the
//! world's truth, as a motion-capture system would see it, and only for the report: nothing of it
//! reaches the master or the robots. The world is built with the group standing where the curve
//! begins, so truth and curve share one frame.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::time::Instant as WallClock;

use canopen::Micros;
use emulator::Firmware;
use group::GroupFile;
use kinematics::{Pose, WheelRates};
use sim::robot::LogLine;
use sim::{Backend, Options, TruthSample, World};

use super::link::SimLink;
use crate::monitor::metrics::{evenness, path_errors};
use crate::monitor::rows::{RobotTruth, TruthRow};
use crate::path::curve::Instant;
use crate::path::curve::Plan;
use crate::report::Run;
use crate::run::{Drive, DriveError, Driven, Observed, has_rollers, path, session};

/// SYNC periods over which the bus load is averaged before the largest is taken: 100 ms at 100 Hz.
const LOAD_WINDOW: usize = 10;

#[expect(
    clippy::cast_possible_truncation,
    reason = "reports use f32; 2.5 m has steps of 0.2 um there"
)]
fn pose(pose: &Pose<f64>) -> Pose {
    Pose {
        x: pose.x as f32,
        y: pose.y as f32,
        heading: pose.heading as f32,
    }
}

#[expect(clippy::cast_possible_truncation, reason = "for charts")]
fn rates(rates: WheelRates<f64>) -> WheelRates {
    let rates: [f64; 4] = rates.into();
    rates.map(|rate| rate as f32).into()
}

/// What the world was at a sample, beside what the curve asks for at `t`, the time of the sample.
fn row(plan: &Plan, t: f64, sample: &TruthSample) -> TruthRow {
    let (theory, theory_twist) = plan.at(t);
    let robots = sample.robots.iter().map(|robot| RobotTruth {
        pose: pose(&robot.pose),
        wheel_rates: rates(robot.wheel_rates),
    });
    TruthRow {
        t,
        theory,
        theory_twist,
        group: pose(&sample.group),
        shape_error_mm: sample.shape_error_mm,
        bus_load: sample.bus_load,
        robots: robots.collect(),
    }
}

/// The largest mean bus load over [`LOAD_WINDOW`] periods, in per cent.
fn largest_load(rows: &[TruthRow]) -> f64 {
    let mean = |rows: &[TruthRow]| {
        rows.iter().map(|row| row.bus_load).sum::<f64>() / rows.len().max(1) as f64
    };
    let windows = rows.windows(LOAD_WINDOW.min(rows.len().max(1)));
    windows.map(mean).fold(0.0, f64::max) * 100.0
}

/// Builds the simulated world of a group, which keeps a sample of the truth every SYNC period for
/// an observer to take.
///
/// # Errors
/// When the image cannot be loaded or the world cannot be built.
pub fn world(group: &GroupFile, elf: Option<&Path>, start: Pose<f64>) -> Result<World, DriveError> {
    build(group, elf, start, u64::from(group.sync_period_us) * 1_000)
}

/// As [`world`], with a sample of the truth every `truth_period_ns`; 0 for none.
pub(super) fn build(
    group: &GroupFile,
    elf: Option<&Path>,
    start: Pose<f64>,
    truth_period_ns: u64,
) -> Result<World, DriveError> {
    let backend = match elf {
        None => Backend::Native,
        Some(path) if path.is_dir() => Backend::Images(images(path)?),
        Some(path) => Backend::Emulator(image(path)?),
    };
    let options = Options {
        truth_period_ns,
        start,
        ..Options::default()
    };
    Ok(World::new(group, backend, options)?)
}

fn image(path: &Path) -> Result<Firmware, DriveError> {
    Firmware::load(path).map_err(|error| DriveError::Firmware {
        path: path.display().to_string(),
        problem: error.to_string(),
    })
}

/// The images in a folder: the files that end with `.elf`, in the order of their names.
fn images(folder: &Path) -> Result<Vec<Firmware>, DriveError> {
    let files = std::fs::read_dir(folder).map_err(|error| file_error(folder, &error))?;
    let mut paths: Vec<_> = files.flatten().map(|file| file.path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "elf"));
    paths.sort();
    paths.iter().map(|path| image(path)).collect()
}

/// Drives and returns everything that is known about it. `progress` is called with the fraction
/// done, 0..=1, and the phase.
///
/// # Errors
/// When anything on the way fails; the group then stands. On the curve that is
/// [`DriveError::Stopped`], with what was driven.
pub fn simulated(
    drive: &Drive<'_>,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<Run, DriveError> {
    let plan = drive.course.plan()?;
    plan.check(&drive.group.limits)?;
    progress(0.0, "booting");
    let mut world = world(drive.group, drive.elf, plan.start())?;
    if let Some(path) = &drive.candump {
        let file = File::create(path).map_err(|error| file_error(path, &error))?;
        world.log_candump(Box::new(BufWriter::new(file)));
    }
    let began = WallClock::now();
    let mut link = SimLink::new(world, format!("sim:{}", drive.group.name));
    let driven = drive_world(&mut link, drive, &plan, progress);
    let elapsed = began.elapsed().as_secs_f64();
    // The logs are written however it ended: that is what they are for.
    let mut world = link.world;
    if let Some(path) = &drive.candump {
        let finished = world.finish_candump();
        finished.map_err(|error| file_error(path, &error))?;
    }
    if let Some(path) = &drive.log {
        write_log(path, &world.take_logs()).map_err(|error| file_error(path, &error))?;
    }
    let (truth, mut driven) = driven?;
    let judged =
        path_errors(&path(&truth)).and_then(|errors| Ok((errors, evenness(&path(&truth))?)));
    let run = judged.map(|(errors, evenness)| Run {
        compensation: drive.compensation,
        phase: has_rollers(drive.group),
        errors,
        evenness,
        shape_error_mm: world.worst_shape_error_mm(),
        bus_load_percent: Some(largest_load(&truth)),
        realtime_factor: world.now_ns() as f64 * 1e-9 / elapsed,
        truth,
        rows: driven.rows.split_off(driven.first),
    });
    let run = run.map_err(DriveError::from);
    if let Some(error) = driven.stopped {
        return Err(DriveError::stopped(error, run));
    }
    progress(1.0, "done");
    run
}

/// One session of the master with a simulated world, and what an observer saw of it.
fn drive_world(
    link: &mut SimLink,
    drive: &Drive<'_>,
    plan: &Plan,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<(Vec<TruthRow>, Driven), DriveError> {
    let seen = Observed::default();
    let mut truth = Vec::new();
    let mut watch = |link: &mut &mut SimLink, instant: Option<&Instant>| {
        let Some(instant) = instant else {
            link.world.take_truth();
            link.world.reset_worst_shape_error();
            return;
        };
        if let Some(sample) = link.world.take_truth().last() {
            // The world is sampled at times of its own, up to a period before this SYNC.
            let at = Micros(sample.time_ns / 1_000);
            let age = link.world.now_ns() - sample.time_ns;
            seen.set(Some((at, pose(&sample.group))));
            let sampled = row(plan, instant.t - age as f64 * 1e-9, sample);
            if let Some(recorder) = drive.record {
                recorder.plan(at, sampled.theory);
                recorder.truth(at, sampled.group);
            }
            truth.push(sampled);
        }
    };
    let driven = session(link, drive, plan, &seen, progress, &mut watch)?;
    Ok((truth, driven))
}

/// Writes what the robots' firmware logged, one line each.
fn write_log(path: &Path, lines: &[(u8, LogLine)]) -> std::io::Result<()> {
    let mut out = BufWriter::new(File::create(path)?);
    for (node, line) in lines {
        let seconds = line.time_us as f64 * 1e-6;
        writeln!(
            out,
            "node {node} {seconds:>11.6} {:<5} {}",
            line.level, line.text
        )?;
    }
    out.flush()
}

fn file_error(path: &Path, error: &std::io::Error) -> DriveError {
    DriveError::File {
        path: path.display().to_string(),
        problem: error.to_string(),
    }
}
