//! The speed of simulated robots on this machine: in a study, on a bus, and of the kinematics
//! alone.
//!
//! Times are CPU times where the system provides them, so that other programs do not count;
//! everything but [`largest_on_all_threads`] runs on the caller's thread, and the fastest of
//! several rounds counts. Compare them
//! only within one run on one machine. The robots are the paper's virtual one, in a row, 1.2 m
//! apart.

use std::hint::black_box;
use std::time::{Duration, Instant};

use canopen::NmtCommand;
use group::GroupFile;
use kinematics::{
    FourWheelGeometry, MemberKinematics, Mount, Pose, Real, Twist, VelocityCompensation, WheelRates,
};
use protocol::MemberState;

use crate::configure::configure;
use crate::error::SimError;
use crate::paper::OnPlant;
use crate::paper::robots::{SPACING, virtual_robots};
use crate::robot::Backend;
use crate::study::{Study, StudyOptions};
use crate::test_master::TestMaster;
use crate::world::{Options, World};

/// Robots of the measured studies.
pub const ROBOTS: [usize; 4] = [10, 100, 1000, 4000];
/// Robots on the measured bus.
pub const ON_A_BUS: usize = 16;
/// Step of a study, ns.
pub const STEP_NS: f64 = 1e6;

/// Robot-steps of one measurement, and how many measurements of each size; the least counts.
const ROBOT_STEPS: usize = 400_000;
const ROUNDS: usize = 7;
/// Rounds of what runs on a bus.
const BUS_ROUNDS: usize = 3;
/// Steps in a SYNC period of the studies' groups.
const STEPS_A_PERIOD: usize = 10;
/// Calls of one measurement.
const CALLS: u32 = 20_000_000;

/// What a robot costs in studies of [`ROBOTS`], in groups of five, ns for a step of 1 ms.
///
/// # Errors
/// When a group cannot be built.
pub fn study_costs(plant: OnPlant) -> Result<[f64; ROBOTS.len()], SimError> {
    let mut studies = Vec::new();
    for robots in ROBOTS {
        studies.push((robots, groups_of_five(robots, plant)?));
    }
    let mut least = [f64::INFINITY; ROBOTS.len()];
    for _ in 0..ROUNDS {
        for ((robots, study), least) in studies.iter_mut().zip(&mut least) {
            let periods = (ROBOT_STEPS / (*robots * STEPS_A_PERIOD)).max(1);
            let began = Stopwatch::start();
            study.run(periods as u32, 1, &|n, _| {
                Twist::new(0.3, 0.01 * (n % 10) as f64, 0.1)
            })?;
            let steps = (periods * *robots * STEPS_A_PERIOD) as f64;
            *least = least.min(began.seconds() / steps * 1e9);
        }
    }
    Ok(least)
}

/// How much faster than real time the largest of [`ROBOTS`] are on all threads of the machine, by
/// the clock on the wall.
///
/// # Errors
/// When a group cannot be built.
pub fn largest_on_all_threads(plant: OnPlant) -> Result<f64, SimError> {
    const PERIODS: u32 = 20;
    let robots = ROBOTS[ROBOTS.len() - 1];
    let mut study = groups_of_five(robots, plant)?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut most = 0.0f64;
    for _ in 0..ROUNDS {
        let before = study.groups()[0].time();
        let began = Instant::now();
        study.run(PERIODS, threads, &|n, _| {
            Twist::new(0.3, 0.01 * (n % 10) as f64, 0.1)
        })?;
        let passed = study.groups()[0].time() - before;
        most = most.max(passed / began.elapsed().as_secs_f64());
    }
    Ok(most)
}

/// The dearest over the cheapest.
#[must_use]
pub fn spread(costs: &[f64]) -> f64 {
    let (low, high) = costs
        .iter()
        .fold((f64::INFINITY, 0.0f64), |(low, high), cost| {
            (low.min(*cost), high.max(*cost))
        });
    high / low
}

/// Groups of five, which every size is a multiple of: a group has a cost of its own, which an odd
/// one would shift.
fn groups_of_five(robots: usize, plant: OnPlant) -> Result<Study, SimError> {
    let mut file = line_of(5, plant)?;
    file.simulation.contact.scattered = plant == OnPlant::Contact;
    let start = Pose::new(0.0, 0.0, 0.0);
    Study::copies(&file, robots / 5, start, StudyOptions::default())
}

/// Connected robots in tandem.
fn line_of(robots: usize, plant: OnPlant) -> Result<GroupFile, SimError> {
    let place = |n: usize| Pose::new(SPACING * n as f32, 0.0, 0.0);
    let mounts: Vec<Pose> = (0..robots).map(place).collect();
    virtual_robots("line", &mounts, true, plant)
}

/// How much faster than real time [`ON_A_BUS`] native robots are that drive on one bus, every clock
/// its own.
///
/// # Errors
/// When they do not drive.
pub fn sixteen_on_a_bus(plant: OnPlant) -> Result<f64, SimError> {
    let mut file = line_of(ON_A_BUS, plant)?;
    file.simulation.crystal_ppm = (0..ON_A_BUS).map(|n| n as f64 * 5.0 - 40.0).collect();
    times_real_time(&file, Backend::Native, 5)
}

/// How much faster than real time the robots of a group are that drive for so many seconds.
///
/// # Errors
/// When they do not drive.
pub fn times_real_time(file: &GroupFile, backend: Backend, seconds: u16) -> Result<f64, SimError> {
    let mut world = World::new(file, backend, Options::default())?;
    configure(&mut world, file, true)?;
    let mut master = TestMaster::new(world, file);
    master.run_to_phase(10, 0)?;
    master.run(100)?;
    master.command(NmtCommand::Start, None);
    master.run(500)?;
    master.twist = Some(Twist::new(0.2, 0.1, 0.0));
    master.run(1_000)?;
    if let Some(robot) = file.robots.iter().find(|robot| {
        master
            .status(robot.node)
            .is_none_or(|status| status.state != MemberState::Moving)
    }) {
        let problem = "does not move when it is commanded to".to_owned();
        return Err(SimError::Robot {
            node: robot.node,
            problem,
        });
    }
    let mut most = 0.0f64;
    for _ in 0..BUS_ROUNDS {
        let began = Stopwatch::start();
        master.run(u64::from(seconds) * 1_000)?;
        most = most.max(f64::from(seconds) / began.seconds());
    }
    Ok(most)
}

/// Calls of a member's kinematics in a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calls {
    /// From twist to wheel rates.
    pub inverse: f64,
    /// And back.
    pub forward: f64,
}

/// Kinematics in `f32`.
///
/// # Errors
/// Never with these wheels.
pub fn kinematics_f32() -> Result<Calls, SimError> {
    calls::<f32>()
}

/// Kinematics in `f64`.
///
/// # Errors
/// Never with these wheels.
pub fn kinematics_f64() -> Result<Calls, SimError> {
    calls::<f64>()
}

/// Each call takes its argument from memory and leaves its result there, as the counted ones of the
/// firmware do.
fn calls<S: Real>() -> Result<Calls, SimError> {
    let c = S::constant;
    let angle = c(core::f64::consts::FRAC_PI_4);
    let geometry = FourWheelGeometry::new(c(0.370), c(0.350), c(0.1524), angle);
    let mount = Mount::new(Pose::new(c(1.2), c(0.0), c(0.1)));
    let compensation = VelocityCompensation::new(c(1.002), c(1.033), c(1.0195));
    let member = MemberKinematics::new(
        &geometry.map_err(SimError::wheels)?,
        &mount.map_err(SimError::wheels)?,
        &compensation.map_err(SimError::wheels)?,
    )
    .map_err(SimError::wheels)?;
    let twist = Twist::new(c(0.4), c(-0.3), c(0.2));
    let rates: WheelRates<S> = member.inverse(twist);
    Ok(Calls {
        inverse: a_second(|| {
            black_box(member.inverse(*black_box(&twist)));
        }),
        forward: a_second(|| {
            black_box(member.forward(black_box(&rates)));
        }),
    })
}

/// How often something can be done in a second.
fn a_second(mut call: impl FnMut()) -> f64 {
    (0..ROUNDS).fold(0.0f64, |most, _| {
        let began = Stopwatch::start();
        for _ in 0..CALLS {
            call();
        }
        most.max(f64::from(CALLS) / began.seconds())
    })
}

/// CPU time of this thread where the system provides it, else wall-clock time.
struct Stopwatch {
    began: Duration,
}

impl Stopwatch {
    fn start() -> Self {
        Self { began: now() }
    }

    fn seconds(&self) -> f64 {
        now().saturating_sub(self.began).as_secs_f64()
    }
}

/// To the nanosecond; the scheduler's own figures in `/proc` advance only every 4 ms.
#[cfg(unix)]
fn now() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(
        time.tv_sec.unsigned_abs(),
        time.tv_nsec.unsigned_abs() as u32,
    )
}

#[cfg(not(unix))]
fn now() -> Duration {
    use std::sync::LazyLock;
    static BEGAN: LazyLock<std::time::Instant> = LazyLock::new(std::time::Instant::now);
    BEGAN.elapsed()
}
