//! One complete drive in a simulated world: boot, scan, configuration, start, the curve, standstill.
//!
//! The robots are moved by the master through the virtual bus alone. What they did is read from the
//! world's truth, as a motion-capture system would see it, and only for the report: nothing of it
//! reaches the master or the robots. The world is built with the group standing where the curve
//! begins, so truth and curve share one frame.

use std::cell::Cell;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Instant as WallClock;

use canopen::Micros;
use emulator::Firmware;
use group::GroupFile;
use kinematics::{Pose, WheelRates};
use sim::robot::LogLine;
use sim::{Backend, Options, TruthSample, World};

use crate::abort::Abort;
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::monitor::metrics::{MetricsError, PathPoint, evenness, path_errors};
use crate::monitor::odometry;
use crate::monitor::rows::{RobotTruth, Row, TruthRow};
use crate::monitor::telemetry::Punctuality;
use crate::path::course::{Course, CourseError};
use crate::path::curve::Plan;
use crate::path::steering::{Eyes, Law, Steering};
use crate::recording::{PLAN, Recorder, TRUTH};
use crate::report::{BackendName, Outline, Report, Run};
use crate::session::Group;
use crate::simulation::link::SimLink;
use crate::source::pose::PoseStream;

/// SYNC periods over which the bus load is averaged before the largest is taken: 100 ms at 100 Hz.
const LOAD_WINDOW: usize = 10;
/// Shares of the progress bar: the drive begins and ends here.
const DRIVING: std::ops::Range<f64> = 0.05..0.98;

/// What to drive, with which robots.
pub struct Drive<'a> {
    /// The group.
    pub group: &'a GroupFile,
    /// The curve, and how it is to be driven.
    pub course: Course,
    /// Feedback from where the group is seen to be; without it the group is driven by the curve alone.
    pub feedback: Option<Feedback>,
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
    /// Where every frame, the curve and what was seen of the group are recorded.
    pub record: Option<&'a Recorder>,
}

/// Feedback on a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct Feedback {
    /// Where poses come from.
    pub source: Source,
    /// How they correct the drive.
    pub law: Law,
    /// Whether they correct it, or are only looked at.
    pub corrects: bool,
}

/// Where poses come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The robots' own wheels.
    Odometry,
    /// The simulated world itself, as a perfect motion-capture system.
    Truth,
    /// A program that sends JSON lines at this address.
    Stream(String),
}

impl std::str::FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("tcp://")) {
            ("odometry", _) => Ok(Self::Odometry),
            ("truth", _) => Ok(Self::Truth),
            (_, Some(address)) if address.contains(':') => Ok(Self::Stream(address.into())),
            _ => Err("give tcp://HOST:PORT, odometry, or (on a simulated bus) truth".into()),
        }
    }
}

/// What an observer leaves for the feedback to see.
type Seen = Rc<Cell<Option<(Micros, Pose)>>>;

impl Feedback {
    /// `seen` is where an observer in this process leaves what it sees.
    fn steering(&self, start: Pose, seen: &Seen) -> Result<Steering, DriveError> {
        let eyes = match &self.source {
            Source::Odometry => Eyes::Odometry,
            Source::Truth => Eyes::Observer(Rc::clone(seen)),
            Source::Stream(address) => {
                let stream = PoseStream::connect(address);
                Eyes::Stream(stream.map_err(|error| DriveError::Pose {
                    address: address.clone(),
                    problem: error.to_string(),
                })?)
            }
        };
        Ok(Steering::new(self.law, eyes, start, self.corrects))
    }
}

/// Why a drive gave no result.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The source of poses.
    #[error(
        "no poses from {address}: {problem}; start what sends them (omnibus-sim serve --pose-tcp prints its \
         address) or correct --pose"
    )]
    Pose {
        /// Where they were to come from.
        address: String,
        /// What is wrong.
        problem: String,
    },
    /// The source of poses is not there.
    #[error("--pose truth is for simulated buses; on a real one give odometry or tcp://HOST:PORT")]
    NoTruth,
    /// What is to be driven.
    #[error(transparent)]
    Course(#[from] CourseError),
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
    let (truth, rows) = driven?;
    let errors = path_errors(&path(&truth))?;
    progress(1.0, "done");
    Ok(Run {
        compensation: drive.compensation,
        phase: has_rollers(drive.group),
        errors,
        evenness: evenness(&path(&truth))?,
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
) -> Result<(Vec<TruthRow>, Vec<Row>), DriveError> {
    let seen = Seen::default();
    let mut steering = match &drive.feedback {
        Some(feedback) => Some(feedback.steering(plan.at(0.0).0, &seen)?),
        None => None,
    };
    let mut group = Group::observe(link, drive.group);
    if let Some(recorder) = drive.record {
        group.wire().tap(recorder.sink());
    }
    group.claim()?;
    progress(DRIVING.start / 2.0, "configuring");
    group.set_abort(drive.abort.clone());
    group.configure(drive.compensation)?;
    find_rollers(&mut group, progress)?;
    group.start()?;
    let before = group.recorder().rows().len();
    let world = &mut group.link().world;
    world.take_truth();
    world.reset_worst_shape_error();
    let mut truth = Vec::new();
    group.follow_with(plan, steering.as_mut(), &mut |link, instant| {
        if let Some(sample) = link.world.take_truth().last() {
            // The world is sampled at times of its own, up to a period before this SYNC.
            let at = Micros(sample.time_ns / 1_000);
            let age = link.world.now_ns() - sample.time_ns;
            seen.set(Some((at, pose(&sample.group))));
            let sampled = row(plan, instant.t - age as f64 * 1e-9, sample);
            if let Some(recorder) = drive.record {
                recorder.pose(PLAN, at, sampled.theory);
                recorder.pose(TRUTH, at, sampled.group);
            }
            truth.push(sampled);
        }
        let share = (instant.t / instant.duration).min(1.0);
        progress(
            DRIVING.start + share * (DRIVING.end - DRIVING.start),
            "driving",
        );
    })?;
    Ok((truth, group.recorder().rows()[before..].to_vec()))
}

/// Whether the robots are told about their rollers.
fn has_rollers(group: &GroupFile) -> bool {
    group.robots.iter().any(|robot| robot.rollers.is_some())
}

/// Lets robots with rollers find the angles of their wheels.
fn find_rollers<L: Link>(
    group: &mut Group<L>,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<(), MasterError> {
    if has_rollers(group.config()) {
        progress(DRIVING.start / 2.0, "seeking index");
        group.find_rollers()?;
    }
    Ok(())
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

/// Drives the robots on a real bus. The path is what their own wheels say; where another source of poses was
/// given, the errors are by that. Returns how punctual SYNC was, too.
///
/// # Errors
/// When anything on the way fails; the group has then been told to stand.
pub fn measured<L: Link>(
    link: L,
    drive: &Drive<'_>,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<(Run, Option<Punctuality>), DriveError> {
    let plan = drive.course.plan()?;
    plan.check(&drive.group.limits)?;
    let mut steering = match &drive.feedback {
        Some(feedback) if feedback.source == Source::Truth => return Err(DriveError::NoTruth),
        Some(feedback) => Some(feedback.steering(plan.at(0.0).0, &Seen::default())?),
        None => None,
    };
    let mut group = Group::observe(link, drive.group);
    if let Some(recorder) = drive.record {
        group.wire().tap(recorder.sink());
    }
    group.claim()?;
    progress(DRIVING.start / 2.0, "configuring");
    group.set_abort(drive.abort.clone());
    group.configure(drive.compensation)?;
    find_rollers(&mut group, progress)?;
    group.start()?;
    let mut instants = Vec::new();
    group.follow_with(&plan, steering.as_mut(), &mut |link, instant| {
        instants.push(*instant);
        if let Some(recorder) = drive.record {
            recorder.pose(PLAN, link.now(), instant.pose);
        }
        let share = (instant.t / instant.duration).min(1.0);
        progress(
            DRIVING.start + share * (DRIVING.end - DRIVING.start),
            "driving",
        );
    })?;
    let rows = group.recorder().rows().to_vec();
    let seen = odometry::rows(plan.at(0.0).0, &instants, &rows);
    let points = match &steering {
        Some(steering) => steering
            .sightings
            .iter()
            .map(|sighting| PathPoint {
                t: sighting.t,
                theory: plan.at(sighting.t).0,
                actual: sighting.pose,
            })
            .collect(),
        None => path(&seen),
    };
    progress(1.0, "done");
    let run = Run {
        compensation: drive.compensation,
        phase: has_rollers(drive.group),
        errors: path_errors(&points)?,
        evenness: evenness(&points)?,
        shape_error_mm: seen.iter().map(|r| r.shape_error_mm).fold(0.0, f64::max),
        bus_load_percent: None,
        realtime_factor: 1.0,
        truth: seen,
        rows,
    };
    Ok((run, group.punctuality()))
}

fn file_error(path: &Path, error: &std::io::Error) -> DriveError {
    DriveError::File {
        path: path.display().to_string(),
        problem: error.to_string(),
    }
}

/// Puts runs of one group along one curve together.
#[must_use]
pub fn report(group: &GroupFile, trajectory: &str, backend: BackendName, runs: Vec<Run>) -> Report {
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
        trajectory: trajectory.into(),
        robots: robots.collect(),
        runs,
    }
}
