//! `omnibus-sim study` drives many copies of a group along a motion without a bus; `omnibus-sim scale`
//! measures what a robot costs, in a study and on a bus.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{bail, ensure};
use canopen::NmtCommand;
use clap::{Args, ValueEnum};
use group::{GroupFile, Plant, Tables};
use kinematics::trajectory::{Circle, FigureEight, Ramped, Trajectory};
use kinematics::{Pose, Twist};
use omnibus_sim::configure::configure;
use omnibus_sim::paper::OnPlant;
use omnibus_sim::paper::robots::virtual_robots;
use omnibus_sim::rig::Rig;
use omnibus_sim::study::{Study, StudyGroup, StudyOptions};
use omnibus_sim::{Backend, Options, World};

/// Ramp at both ends of a motion, s.
const RAMP: f64 = 2.0;

/// Options of `omnibus-sim study`.
#[derive(Args)]
pub struct Arguments {
    /// The group file.
    group: PathBuf,
    /// How many groups, each with the next seed.
    #[arg(long, default_value_t = 1000)]
    groups: usize,
    /// What they drive.
    #[arg(long, value_enum, default_value = "figure-eight")]
    motion: Motion,
    /// Threads; 0 takes as many as the machine has.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Drives without compensation.
    #[arg(long)]
    uncompensated: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Motion {
    /// The paper's circle of 2500 mm.
    Circle,
    /// The paper's figure-eight of 2500 mm.
    FigureEight,
}

/// Drives the study and prints how far its groups end up from where they should.
///
/// # Errors
/// When the file is refused or a group cannot be built.
pub fn study(arguments: &Arguments) -> anyhow::Result<()> {
    ensure!(arguments.groups > 0, "--groups 0: give at least 1");
    let file = GroupFile::load(&arguments.group)?;
    let motion: Box<dyn Trajectory<f64> + Sync> = match arguments.motion {
        Motion::Circle => Box::new(Ramped::new(Circle::paper(), RAMP)),
        Motion::FigureEight => Box::new(Ramped::new(FigureEight::paper(), RAMP)),
    };
    let options = StudyOptions {
        compensation: !arguments.uncompensated,
        ..StudyOptions::default()
    };
    let start = motion.at(0.0).0;
    let mut study = Study::copies(&file, arguments.groups, start, options)?;
    let threads = match arguments.threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads,
    };
    let period = f64::from(file.sync_period_us) * 1e-6;
    let periods = (motion.duration() / period).ceil();
    let command = |_: usize, group: &StudyGroup| {
        // In the middle of the period that begins now.
        let (pose, twist) = motion.at(group.time() + 0.5 * period);
        twist.to_body(pose.heading)
    };
    let began = Instant::now();
    study.run(periods as u32, threads, &command)?;
    let seconds = began.elapsed().as_secs_f64();
    let end = motion.at(motion.duration()).0;
    let mut errors: Vec<f64> = study
        .groups()
        .iter()
        .map(|group| (group.pose().x - end.x).hypot(group.pose().y - end.y) * 1e3)
        .collect();
    errors.sort_by(f64::total_cmp);
    let shape = study.groups().iter().map(StudyGroup::worst_shape_error_mm);
    println!(
        "{} groups, {} robots, {:.1} s of motion",
        study.groups().len(),
        study.robots(),
        motion.duration()
    );
    println!(
        "distance from the motion's end: median {:.1} mm, largest {:.1} mm",
        errors[errors.len() / 2],
        errors[errors.len() - 1]
    );
    println!("largest shape error: {:.2} mm", shape.fold(0.0, f64::max));
    println!(
        "{seconds:.2} s on {threads} threads: {:.0} robot-seconds a second",
        study.robots() as f64 * motion.duration() / seconds
    );
    Ok(())
}

/// Robots of the measured studies.
const ROBOTS: [usize; 5] = [10, 40, 200, 1000, 4000];
/// Robot-steps of one measurement, and how many measurements of each size; the least counts.
const ROBOT_STEPS: usize = 400_000;
const ROUNDS: usize = 7;
/// How far the cost of a robot may differ between the sizes.
const FLAT: f64 = 1.2;
/// Virtual seconds of the bus that is measured, and how much faster than real time it has to be.
const BUS_SECONDS: u64 = 5;
const BUS_FACTOR: f64 = 20.0;

/// Measures and prints; fails when the cost of a robot is not flat within 20 %, or 16 robots on a bus are
/// not 20 times faster than real time. Times are the processor's where the system tells them, so that
/// other programs do not count.
///
/// # Errors
/// See above.
pub fn scale() -> anyhow::Result<()> {
    let mut bad = Vec::new();
    for plant in [OnPlant::Table, OnPlant::Contact] {
        let mut studies = Vec::new();
        for robots in ROBOTS {
            studies.push((robots, groups_of_four(robots, plant)?));
        }
        let mut least = [f64::INFINITY; ROBOTS.len()];
        for _ in 0..ROUNDS {
            for ((robots, study), least) in studies.iter_mut().zip(&mut least) {
                let steps_a_period = 10;
                let periods = (ROBOT_STEPS / (*robots * steps_a_period)).max(1);
                let began = Stopwatch::start();
                study.run(periods as u32, 1, &|n, _| {
                    Twist::new(0.3, 0.01 * (n % 10) as f64, 0.1)
                })?;
                let steps = (periods * *robots * steps_a_period) as f64;
                *least = least.min(began.seconds() / steps * 1e9);
            }
        }
        for (robots, cost) in ROBOTS.iter().zip(least) {
            println!(
                "study, {} plant, {robots:>4} robots: {cost:.0} ns a robot and step of 1 ms",
                plant.name()
            );
        }
        let (low, high) = least
            .iter()
            .fold((f64::INFINITY, 0.0f64), |(low, high), c| {
                (low.min(*c), high.max(*c))
            });
        println!(
            "study, {} plant: dearest over cheapest {:.2}",
            plant.name(),
            high / low
        );
        if high / low > FLAT {
            bad.push(format!(
                "the {} plant's cost of a robot is not flat",
                plant.name()
            ));
        }
    }
    for plant in [OnPlant::Table, OnPlant::Contact] {
        let factor = sixteen_on_a_bus(plant)?;
        println!(
            "bus, {} plant, 16 native robots: {factor:.1} times real time",
            plant.name()
        );
        if plant == OnPlant::Table && factor < BUS_FACTOR {
            bad.push("16 robots on a bus are slower than 20 times real time".to_owned());
        }
    }
    if !bad.is_empty() {
        bail!("{}", bad.join("; "));
    }
    Ok(())
}

/// Groups of four, the last one of what is left.
fn groups_of_four(robots: usize, plant: OnPlant) -> anyhow::Result<Study> {
    let mut groups = Vec::new();
    let mut left = robots;
    while left > 0 {
        let count = left.min(4);
        let mut file = line_of(count, plant)?;
        file.simulation.seed = groups.len() as u64;
        file.simulation.contact.scattered = plant == OnPlant::Contact;
        let here = Pose::new(0.0, 0.0, 0.0);
        groups.push(StudyGroup::new(&file, here, StudyOptions::default())?);
        left -= count;
    }
    Ok(Study::new(groups))
}

/// Connected robots in tandem.
fn line_of(robots: usize, plant: OnPlant) -> anyhow::Result<GroupFile> {
    let place = |n: usize| Pose::new(1.2 * n as f32, 0.0, 0.0);
    let mounts: Vec<Pose> = (0..robots).map(place).collect();
    Ok(virtual_robots("line", &mounts, true, plant)?)
}

/// How much faster than real time 16 robots are that drive.
fn sixteen_on_a_bus(plant: OnPlant) -> anyhow::Result<f64> {
    let mut file = line_of(16, plant)?;
    if plant == OnPlant::Table {
        file.simulation.plant = Plant::Table(Tables::Virtual);
    }
    // Every clock its own.
    file.simulation.crystal_ppm = (0..16).map(|n| f64::from(n) * 5.0 - 40.0).collect();
    let mut world = World::new(&file, Backend::Native, Options::default())?;
    configure(&mut world, &file, true)?;
    let mut rig = Rig::new(world, &file);
    rig.run_to_phase(10, 0)?;
    rig.run(100)?;
    rig.command(NmtCommand::Start, None);
    rig.run(500)?;
    rig.twist = Some(kinematics::Twist::new(0.2, 0.1, 0.0));
    rig.run(1_000)?;
    ensure!(
        rig.all_are(protocol::MemberState::Moving),
        "16 robots on a bus: not all move"
    );
    let began = Stopwatch::start();
    rig.run(BUS_SECONDS * 1_000)?;
    Ok(BUS_SECONDS as f64 / began.seconds())
}

/// Time this thread has had the processor, where the system tells it, else time on the wall.
struct Stopwatch {
    wall: Instant,
    processor_ns: Option<u64>,
}

impl Stopwatch {
    fn start() -> Self {
        Self {
            wall: Instant::now(),
            processor_ns: processor_ns(),
        }
    }

    fn seconds(&self) -> f64 {
        match self.processor_ns.zip(processor_ns()) {
            Some((began, now)) => (now - began) as f64 * 1e-9,
            None => self.wall.elapsed().as_secs_f64(),
        }
    }
}

/// Linux: the first number is what the thread has run, ns.
fn processor_ns() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok()
}
