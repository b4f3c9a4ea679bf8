//! One complete drive in a simulated world: boot, scan, configuration, start, the curve, standstill.
//!
//! The robots are moved by the master through the virtual bus alone. What they did is read from the
//! world's truth, as a motion-capture system would see it, and only for the report: nothing of it
//! reaches the master or the robots. The world is built with the group standing where the curve
//! begins, so truth and curve share one frame.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::time::Instant as WallClock;

use emulator::Firmware;
use group::GroupFile;
use kinematics::{Pose, WheelRates};
use sim::robot::LogLine;
use sim::{Backend, Options, TruthSample, World};

use crate::abort::Abort;
use crate::curve::{Curve, Plan};
use crate::error::MasterError;
use crate::follow::Instant;
use crate::link::Link;
use crate::metrics::{MetricsError, PathPoint, path_errors};
use crate::odometry;
use crate::record::{RobotTruth, Row, TruthRow};
use crate::report::{BackendName, Outline, Report, Run};
use crate::session::Group;
use crate::sim_link::SimLink;

/// SYNC periods over which the bus load is averaged before the largest is taken: 100 ms at 100 Hz.
const LOAD_WINDOW: usize = 10;
/// Shares of the progress bar: the drive begins and ends here.
const DRIVING: std::ops::Range<f64> = 0.05..0.98;

/// What to drive, with which robots.
pub struct Drive<'a> {
    /// The group.
    pub group: &'a GroupFile,
    /// The curve.
    pub curve: Curve,
    /// Whether to drive only its beginning.
    pub quick: bool,
    /// Whether members compensate for wheel slip.
    pub compensation: bool,
    /// The firmware image for emulated robots; `None` for native ones.
    pub elf: Option<&'a Path>,
    /// Where to write every frame as a candump log.
    pub candump: Option<PathBuf>,
    /// Where to write what the robots' firmware logged; native robots log nothing.
    pub log: Option<PathBuf>,
    /// By which the drive can be stopped on the way.
    pub abort: Abort,
}

/// Why a drive gave no result.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The master.
    #[error(transparent)]
    Master(#[from] MasterError),
    /// The simulated world.
    #[error(transparent)]
    Sim(#[from] sim::SimError),
    /// The firmware image.
    #[error("{path}: {problem}; build it with `cargo xtask size`")]
    Firmware {
        /// The file.
        path: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A file to be written.
    #[error("cannot write {path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// The system's message.
        problem: String,
    },
    /// The recorded path.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
}

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

fn row(instant: &Instant, sample: &TruthSample) -> TruthRow {
    let robots = sample.robots.iter().map(|robot| RobotTruth {
        pose: pose(&robot.pose),
        wheel_rates: rates(robot.wheel_rates),
    });
    TruthRow {
        t: instant.t,
        theory: instant.pose,
        theory_twist: instant.twist,
        group: pose(&sample.group),
        shape_error_mm: sample.shape_error_mm,
        bus_load: sample.bus_load,
        robots: robots.collect(),
    }
}

/// Theory and group of every row.
fn path(rows: &[TruthRow]) -> Vec<PathPoint> {
    let point = |row: &TruthRow| PathPoint {
        t: row.t,
        theory: row.theory,
        actual: row.group,
    };
    rows.iter().map(point).collect()
}

/// The largest mean bus load over [`LOAD_WINDOW`] periods, in per cent.
fn largest_load(rows: &[TruthRow]) -> f64 {
    let mean = |rows: &[TruthRow]| {
        rows.iter().map(|row| row.bus_load).sum::<f64>() / rows.len().max(1) as f64
    };
    let windows = rows.windows(LOAD_WINDOW.min(rows.len().max(1)));
    windows.map(mean).fold(0.0, f64::max) * 100.0
}

/// Builds the simulated world of a group.
///
/// # Errors
/// When the image cannot be loaded or the world cannot be built.
pub fn world(group: &GroupFile, elf: Option<&Path>, start: Pose<f64>) -> Result<World, DriveError> {
    let backend = match elf {
        None => Backend::Native,
        Some(path) => {
            let image = Firmware::load(path).map_err(|error| DriveError::Firmware {
                path: path.display().to_string(),
                problem: error.to_string(),
            })?;
            Backend::Emulator(image)
        }
    };
    let options = Options {
        truth_period_ns: u64::from(group.sync_period_us) * 1_000,
        start,
        ..Options::default()
    };
    Ok(World::new(group, backend, options)?)
}

/// Drives and returns everything that is known about it. `progress` is told the share done, 0..=1,
/// and the phase.
///
/// # Errors
/// When anything on the way fails; the group then stands.
pub fn simulated(
    drive: &Drive<'_>,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<Run, DriveError> {
    let plan = drive.curve.plan(drive.quick);
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
    let (truth, rows) = driven?;
    progress(1.0, "done");
    Ok(Run {
        compensation: drive.compensation,
        errors: path_errors(&path(&truth))?,
        shape_error_mm: world.worst_shape_error_mm(),
        bus_load_percent: Some(largest_load(&truth)),
        realtime_factor: world.now_ns() as f64 * 1e-9 / elapsed,
        truth,
        rows,
    })
}

/// One session of the master with a simulated world, and what an observer saw of it.
fn drive_world(
    link: &mut SimLink,
    drive: &Drive<'_>,
    plan: &Plan,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<(Vec<TruthRow>, Vec<Row>), MasterError> {
    let mut group = Group::connect(link, drive.group)?;
    progress(DRIVING.start / 2.0, "configuring");
    group.set_abort(drive.abort.clone());
    group.configure(drive.compensation)?;
    group.start()?;
    let world = &mut group.link().world;
    world.take_truth();
    world.reset_worst_shape_error();
    let mut truth = Vec::new();
    group.follow(plan, &mut |link, instant| {
        if let Some(sample) = link.world.take_truth().last() {
            truth.push(row(instant, sample));
        }
        let share = (instant.t / instant.duration).min(1.0);
        progress(
            DRIVING.start + share * (DRIVING.end - DRIVING.start),
            "driving",
        );
    })?;
    Ok((truth, group.recorder().rows().to_vec()))
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

/// Drives the robots on a real bus. The path is what their own wheels say.
///
/// # Errors
/// When anything on the way fails; the group has then been told to stand.
pub fn measured<L: Link>(
    link: L,
    drive: &Drive<'_>,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<Run, DriveError> {
    let plan = drive.curve.plan(drive.quick);
    plan.check(&drive.group.limits)?;
    let mut group = Group::connect(link, drive.group)?;
    progress(DRIVING.start / 2.0, "configuring");
    group.set_abort(drive.abort.clone());
    group.configure(drive.compensation)?;
    group.start()?;
    let mut instants = Vec::new();
    let followed = group.follow(&plan, &mut |_, instant| {
        instants.push(*instant);
        let share = (instant.t / instant.duration).min(1.0);
        progress(
            DRIVING.start + share * (DRIVING.end - DRIVING.start),
            "driving",
        );
    });
    followed?;
    let rows = group.recorder().rows().to_vec();
    let seen = odometry::rows(plan.at(0.0).0, &instants, &rows);
    progress(1.0, "done");
    Ok(Run {
        compensation: drive.compensation,
        errors: path_errors(&path(&seen))?,
        shape_error_mm: seen.iter().map(|r| r.shape_error_mm).fold(0.0, f64::max),
        bus_load_percent: None,
        realtime_factor: 1.0,
        truth: seen,
        rows,
    })
}

fn file_error(path: &Path, error: &std::io::Error) -> DriveError {
    DriveError::File {
        path: path.display().to_string(),
        problem: error.to_string(),
    }
}

/// Puts runs of one group along one curve together.
#[must_use]
pub fn report(group: &GroupFile, curve: Curve, backend: BackendName, runs: Vec<Run>) -> Report {
    let robots = group.robots.iter().map(|robot| Outline {
        node: robot.node,
        mount: robot.mount,
        half_track: robot.geometry.half_track(),
        half_wheelbase: robot.geometry.half_wheelbase(),
    });
    Report {
        backend,
        scalar: None,
        config: group.name.clone(),
        trajectory: curve.name().into(),
        robots: robots.collect(),
        runs,
    }
}
