//! One whole drive along a path: the session of the master with the robots, and what it came to.
//!
//! [`session`] is the same on every bus. [`measured`] drives real robots and takes their own
//! wheels' word for where they went, or an outside observer's;
//! [`simulated`](crate::simulation::run::simulated) drives in a simulated world and knows the
//! truth.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use canopen::Micros;
use group::GroupFile;
use kinematics::Pose;

use crate::abort::Abort;
use crate::bus::link::Link;
use crate::bus::punctuality::Punctuality;
use crate::bus::tap::FrameSink;
use crate::error::MasterError;
use crate::monitor::metrics::{MetricsError, PathPoint, evenness, path_errors};
use crate::monitor::odometry;
use crate::monitor::rows::{Row, TruthRow};
use crate::path::course::{Course, CourseError};
use crate::path::curve::Instant;
use crate::path::curve::Plan;
use crate::path::steering::{Law, PoseInput, Sighting, Steering};
use crate::report::{BackendName, Outline, Report, Run};
use crate::session::Group;
use crate::session::roller_index::IndexSearch;
use crate::source::pose::PoseStream;

/// Shares of the progress bar: the drive begins and ends here.
const DRIVING: std::ops::Range<f64> = 0.05..0.98;

/// What to drive, with which robots.
pub struct Drive<'a> {
    /// The group.
    pub group: &'a GroupFile,
    /// The curve, and how it is to be driven.
    pub course: Course,
    /// Feedback from where the group is seen to be; without it the group is driven by the curve
    /// alone.
    pub feedback: Option<Feedback>,
    /// Whether members compensate for wheel slip.
    pub compensation: bool,
    /// The firmware image for emulated robots, or a folder with one for each kind of robot; `None`
    /// for native ones.
    pub elf: Option<&'a Path>,
    /// Where to write every frame as a candump log.
    pub candump: Option<PathBuf>,
    /// Where to write what the robots' firmware logged; native robots log nothing.
    pub log: Option<PathBuf>,
    /// By which the drive can be stopped on the way.
    pub abort: Abort,
    /// Where every frame, the curve and what was seen of the group are recorded.
    pub record: Option<&'a dyn Record>,
    /// Called before the search for the wheels' indexes begins; `None` leaves the search out, and
    /// robots begin with the mean of their rollers.
    pub index_search: Option<&'a dyn Fn(&IndexSearch)>,
}

/// A recording, as a drive sees it. Times are on the link's clock.
pub trait Record {
    /// Where every frame goes.
    fn sink(&self) -> FrameSink;
    /// Where the group is to be.
    fn plan(&self, at: Micros, pose: Pose);
    /// Where the group was seen.
    fn truth(&self, at: Micros, pose: Pose);
}

/// Feedback on a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct Feedback {
    /// Where poses come from.
    pub source: Source,
    /// How they correct the drive.
    pub law: Law,
    /// Whether they correct it, or are only recorded.
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
pub(crate) type Observed = Rc<Cell<Option<(Micros, Pose)>>>;

impl Feedback {
    /// `seen` is where an observer in this process leaves what it sees; `time_waits` as the link
    /// says.
    fn steering(
        &self,
        start: Pose,
        seen: &Observed,
        time_waits: bool,
    ) -> Result<Steering, DriveError> {
        let input = match &self.source {
            Source::Odometry => PoseInput::Odometry,
            Source::Truth => PoseInput::Observer(Rc::clone(seen)),
            Source::Stream(address) => {
                let stream = PoseStream::connect(address);
                let stream = stream.map_err(|error| DriveError::Pose {
                    address: address.clone(),
                    problem: error.to_string(),
                })?;
                PoseInput::Stream(stream.on_waiting_bus(time_waits))
            }
        };
        Ok(Steering::new(self.law, input, start, self.corrects))
    }
}

/// Why a drive gave no result.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The source of poses.
    #[error(
        "no poses from {address}: {problem}; start the program that sends them (omnibus-sim serve \
         --pose-tcp prints its address) or correct --pose"
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
    #[cfg(feature = "simulation")]
    #[error(transparent)]
    Sim(#[from] sim::SimError),
    /// A simulated bus was asked for, and this build has none.
    #[error(
        "this build has no simulator; build with the cargo feature simulation, or give a real bus"
    )]
    NoSimulation,
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
    /// The drive ended before its curve did.
    #[error(transparent)]
    Stopped(Box<Stopped>),
}

/// A drive that ended before its curve did, by a wish or a fault.
#[derive(Debug, thiserror::Error)]
#[error("{error}")]
pub struct Stopped {
    /// Why.
    pub error: MasterError,
    /// What was driven.
    pub run: Run,
}

impl DriveError {
    /// The master's own error, where it is one.
    #[must_use]
    pub fn master(&self) -> Option<&MasterError> {
        match self {
            Self::Master(error) => Some(error),
            Self::Stopped(stopped) => Some(&stopped.error),
            _ => None,
        }
    }

    /// The error of a drive that ended early: with what was driven, where that can be measured.
    pub(crate) fn stopped(error: MasterError, run: Result<Run, Self>) -> Self {
        match run {
            Ok(run) => Self::Stopped(Box::new(Stopped { error, run })),
            Err(_) => Self::Master(error),
        }
    }
}

/// Theory and group of every row.
pub(crate) fn path(rows: &[TruthRow]) -> Vec<PathPoint> {
    let point = |row: &TruthRow| PathPoint {
        t: row.t,
        theory: row.theory,
        actual: row.group,
    };
    rows.iter().map(point).collect()
}

/// What a session along the path left.
pub(crate) struct Driven {
    /// Everything the master heard, one row a SYNC.
    pub rows: Vec<Row>,
    /// The first of them that belongs to the path.
    #[cfg_attr(
        not(feature = "simulation"),
        expect(dead_code, reason = "only a simulated drive cuts there")
    )]
    pub first: usize,
    /// What the path asked for at each SYNC.
    pub instants: Vec<Instant>,
    /// Where feedback saw the group.
    pub sightings: Vec<Sighting>,
    /// How punctual SYNC was; `None` on a bus with virtual time.
    pub punctuality: Option<Punctuality>,
    /// Why the path was not driven to its end, where it was not.
    pub stopped: Option<MasterError>,
}

/// One session of the master along `plan`: claims the bus, configures, starts, drives and stands
/// again. `watch` is called before the path begins with `None`, and at every SYNC of it.
pub(crate) fn session<L: Link>(
    link: L,
    drive: &Drive<'_>,
    plan: &Plan,
    seen: &Observed,
    progress: &mut dyn FnMut(f64, &'static str),
    watch: &mut dyn FnMut(&mut L, Option<&Instant>),
) -> Result<Driven, DriveError> {
    let mut steering = match &drive.feedback {
        Some(feedback) => Some(feedback.steering(plan.at(0.0).0, seen, link.time_waits())?),
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
    if let Some(announce) = drive.index_search
        && has_rollers(drive.group)
    {
        progress(DRIVING.start / 2.0, "index search");
        group.find_rollers(&mut |search| announce(search))?;
    }
    group.start()?;
    let first = group.recorder().rows().len();
    watch(group.link(), None);
    let mut instants = Vec::new();
    let followed = group.follow_with(plan, steering.as_mut(), &mut |link, instant| {
        instants.push(*instant);
        watch(link, Some(instant));
        let share = (instant.t / instant.duration).min(1.0);
        progress(
            DRIVING.start + share * (DRIVING.end - DRIVING.start),
            "driving",
        );
    });
    Ok(Driven {
        rows: group.recorder().rows().to_vec(),
        first,
        instants,
        sightings: steering
            .map(|steering| steering.sightings)
            .unwrap_or_default(),
        punctuality: group.punctuality(),
        stopped: followed.err(),
    })
}

/// Whether the robots are configured with rollers.
pub(crate) fn has_rollers(group: &GroupFile) -> bool {
    group.robots.iter().any(|robot| robot.rollers.is_some())
}

/// Drives the robots on a real bus. The path is what their own wheels say; where another source of
/// poses was given, the errors are by that. Returns how punctual SYNC was, too.
///
/// # Errors
/// When anything on the way fails; the group has then been told to stand. On the curve that is
/// [`DriveError::Stopped`], with what was driven.
pub fn measured<L: Link>(
    link: L,
    drive: &Drive<'_>,
    progress: &mut dyn FnMut(f64, &'static str),
) -> Result<(Run, Option<Punctuality>), DriveError> {
    let plan = drive.course.plan()?;
    plan.check(&drive.group.limits)?;
    if let Some(feedback) = &drive.feedback
        && feedback.source == Source::Truth
    {
        return Err(DriveError::NoTruth);
    }
    let mut watch = |link: &mut L, instant: Option<&Instant>| {
        if let (Some(recorder), Some(instant)) = (drive.record, instant) {
            recorder.plan(link.now(), instant.pose);
        }
    };
    let mut driven = session(
        link,
        drive,
        &plan,
        &Observed::default(),
        progress,
        &mut watch,
    )?;
    let (stopped, punctuality) = (driven.stopped.take(), driven.punctuality);
    let run = by_wheels(drive, &plan, driven);
    if let Some(error) = stopped {
        return Err(DriveError::stopped(error, run));
    }
    progress(1.0, "done");
    Ok((run?, punctuality))
}

/// A drive as the robots' own wheels saw it, and its errors by them or by another observer.
fn by_wheels(drive: &Drive<'_>, plan: &Plan, driven: Driven) -> Result<Run, DriveError> {
    let mounts: Vec<_> = drive.group.robots.iter().map(|robot| robot.mount).collect();
    let by_wheels = odometry::rows(plan.at(0.0).0, &mounts, &driven.instants, &driven.rows);
    let points = match &drive.feedback {
        Some(_) => driven
            .sightings
            .iter()
            .map(|sighting| PathPoint {
                t: sighting.t,
                theory: plan.at(sighting.t).0,
                actual: sighting.pose,
            })
            .collect(),
        None => path(&by_wheels),
    };
    Ok(Run {
        compensation: drive.compensation,
        phase: has_rollers(drive.group),
        errors: path_errors(&points)?,
        evenness: evenness(&points)?,
        shape_error_mm: by_wheels
            .iter()
            .map(|row| row.shape_error_mm)
            .fold(0.0, f64::max),
        bus_load_percent: None,
        realtime_factor: 1.0,
        truth: by_wheels,
        rows: driven.rows,
    })
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
        paper: false,
        stopped: None,
    }
}
