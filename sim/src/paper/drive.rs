//! Drives simulated robots along a motion over their bus, and records their poses.
//!
//! The master is [`crate::test_master`]: one setpoint before every SYNC, sent ahead by the known
//! delay of a setpoint ([`group::preview_us`]), so that robots follow the motion without a
//! predictable lag.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use canopen::NmtCommand;
use group::GroupFile;
use kinematics::trajectory::Trajectory;
use kinematics::{Pose, Twist};
use protocol::{Code, MemberState};

use crate::configure::configure;
use crate::error::SimError;
use crate::robot::Backend;
use crate::test_master::TestMaster;
use crate::world::{Options, World};

/// How long robots may take from NMT start until they are ready, in SYNC periods.
const START_SYNCS: u32 = 200;
/// How long they are watched after the motion's end, s.
const TAIL: f64 = 0.1;

/// One drive.
pub struct Job {
    /// The robots.
    pub file: GroupFile,
    /// Where to; from rest to rest.
    pub motion: Box<dyn Trajectory<f64> + Send + Sync>,
    /// Whether the robots compensate.
    pub compensation: bool,
}

/// One instant of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Since the motion began, s.
    pub t: f64,
    /// Where the motion is.
    pub theory: Pose<f64>,
    /// Where the group is.
    pub group: Pose<f64>,
    /// Where its robots are.
    pub robots: Vec<Pose<f64>>,
}

/// Drives, and gives a point for every SYNC.
///
/// # Errors
/// When a robot cannot be started, faults, or the world stops.
pub fn drive(job: &Job, backend: &Backend) -> Result<Vec<Point>, SimError> {
    let file = &job.file;
    let period_us = u64::from(file.sync_period_us);
    let options = Options {
        truth_period_ns: period_us * 1_000,
        start: job.motion.at(0.0).0,
        ..Options::default()
    };
    let mut world = World::new(file, backend.clone(), options)?;
    configure(&mut world, file, job.compensation)?;
    let mut master = TestMaster::new(world, file);
    let period_ms = period_us / 1_000;
    master.run_to_phase(period_ms, 0)?;
    master.run(4 * period_ms)?;
    master.command(NmtCommand::Start, None);
    start(&mut master, file, period_ms)?;
    master.world.take_truth();

    // Now a SYNC is due; the next is the motion's first instant.
    let begin_ns = master.world.now_ns() + period_us * 1_000;
    let period = period_us as f64 * 1e-6;
    let preview = f64::from(group::preview_us(file)) * 1e-6;
    let mut points = Vec::new();
    let mut syncs = 0.0;
    while syncs * period <= job.motion.duration() + TAIL {
        let (pose, twist) = job.motion.at(syncs * period + preview);
        let asked = twist.to_body(pose.heading);
        master.twist = Some(Twist::new(
            asked.vx as f32,
            asked.vy as f32,
            asked.omega as f32,
        ));
        master.run(period_ms)?;
        check(&master, file)?;
        for sample in master.world.take_truth() {
            if sample.time_ns < begin_ns {
                continue;
            }
            let t = (sample.time_ns - begin_ns) as f64 * 1e-9;
            points.push(Point {
                t,
                theory: job.motion.at(t).0,
                group: sample.group,
                robots: sample.robots.iter().map(|robot| robot.pose).collect(),
            });
        }
        syncs += 1.0;
    }
    Ok(points)
}

/// Waits until all robots can follow.
fn start(master: &mut TestMaster, file: &GroupFile, period_ms: u64) -> Result<(), SimError> {
    let ready = |master: &TestMaster, node| {
        master
            .status(node)
            .is_some_and(|s| s.state == MemberState::Moving)
    };
    for _ in 0..START_SYNCS {
        master.run(period_ms)?;
        if file.robots.iter().all(|robot| ready(master, robot.node)) {
            return Ok(());
        }
    }
    let late = file.robots.iter().find(|robot| !ready(master, robot.node));
    Err(SimError::Robot {
        node: late.map_or(0, |robot| robot.node),
        problem: "does not get ready".to_owned(),
    })
}

/// The first fault of a robot is an error.
fn check(master: &TestMaster, file: &GroupFile) -> Result<(), SimError> {
    for robot in &file.robots {
        if let Some(Code::Fault(fault)) = master.status(robot.node).map(|status| status.code) {
            return Err(SimError::Robot {
                node: robot.node,
                problem: format!("fault {}", fault.name()),
            });
        }
    }
    Ok(())
}

/// Drives all jobs, as many at a time as the machine has threads; the answers are in their order.
///
/// # Errors
/// The first job's that failed.
pub fn drive_all(jobs: &[Job], backend: &Backend) -> Result<Vec<Vec<Point>>, SimError> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    type Slot = Mutex<Option<Result<Vec<Point>, SimError>>>;
    let done: Vec<Slot> = jobs.iter().map(|_| Mutex::new(None)).collect();
    std::thread::scope(|scope| {
        for _ in 0..threads.min(jobs.len()) {
            scope.spawn(|| {
                while let Some((job, slot)) = {
                    let place = next.fetch_add(1, Ordering::Relaxed);
                    jobs.get(place).zip(done.get(place))
                } {
                    let result = drive(job, backend);
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
                }
            });
        }
    });
    let answers = done
        .into_iter()
        .filter_map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    answers.collect()
}

/// A position in the paper's axes, mm: right, forward.
#[must_use]
pub fn in_paper(pose: &Pose<f64>) -> (f64, f64) {
    (-pose.y * 1e3, pose.x * 1e3)
}

/// Smallest and largest of some values.
pub fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    })
}

/// Relative error of displacement, per cent, along one axis: the path's extent over the motion's,
/// less 1. With the path about the origin it is the paper's, (|max| + |min|) / (2 nominal) - 1.
/// `None` where the motion does not go that way.
#[must_use]
pub fn displacement_error(points: &[Point], axis: impl Fn(&Pose<f64>) -> f64) -> Option<f64> {
    let length = |(low, high): (f64, f64)| high - low;
    let theory = length(extent(points.iter().map(|p| axis(&p.theory))));
    let path = length(extent(points.iter().map(|p| axis(&p.group))));
    (theory > 1e-3).then(|| (path / theory - 1.0) * 100.0)
}

/// Root mean square distance between path and motion at the same instant, mm.
#[must_use]
pub fn rms_mm(points: &[Point]) -> f64 {
    let square = |p: &Point| (p.group.x - p.theory.x).powi(2) + (p.group.y - p.theory.y).powi(2);
    (points.iter().map(square).sum::<f64>() / points.len().max(1) as f64).sqrt() * 1e3
}

/// Mean velocity between two instants, m/s and rad/s, world frame.
#[must_use]
pub fn mean_velocity(points: &[Point], from: f64, to: f64) -> Twist<f64> {
    let at = |t: f64| {
        let after = points.partition_point(|p| p.t <= t);
        let (Some(low), Some(high)) = (points.get(after.wrapping_sub(1)), points.get(after)) else {
            return Pose::new(f64::NAN, f64::NAN, f64::NAN);
        };
        let part = (t - low.t) / (high.t - low.t);
        let (a, b) = (low.group, high.group);
        Pose::new(
            a.x + part * (b.x - a.x),
            a.y + part * (b.y - a.y),
            a.heading + part * (b.heading - a.heading),
        )
    };
    let (a, b) = (at(from), at(to));
    let time = to - from;
    Twist::new(
        (b.x - a.x) / time,
        (b.y - a.y) / time,
        (b.heading - a.heading) / time,
    )
}
