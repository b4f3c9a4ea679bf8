//! `omnibus-sim study` drives many copies of a group along a motion without a bus; `omnibus-sim
//! scale` measures what a robot costs, in a study and on a bus.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::output::{print_line, print_note};
use anyhow::bail;
use clap::{Args, ValueEnum};
use group::GroupFile;
use kinematics::trajectory::{Circle, FigureEight, Ramped, Trajectory};
use omnibus_sim::paper::OnPlant;
use omnibus_sim::scale;
use omnibus_sim::study::{Study, StudyGroup, StudyOptions};

/// Ramp at both ends of a motion, s.
const RAMP: f64 = 2.0;

/// Options of `omnibus-sim study`.
#[derive(Args)]
#[command(after_help = "Example:
  omnibus-sim study groups/tcc-3.toml --groups 1000")]
pub struct Arguments {
    /// The group file.
    group: PathBuf,
    /// Number of groups, each with the next seed.
    #[arg(
        long,
        default_value_t = 1000,
        value_parser = clap::value_parser!(u32).range(1..=10_000_000)
    )]
    groups: u32,
    /// Curve to drive.
    #[arg(long, value_enum, default_value = "figure-eight")]
    motion: Motion,
    /// Number of threads; 0 uses all processors.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=1024))]
    threads: u16,
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

/// Groups of a thread that exist at a time: memory is limited however many are driven.
const BATCH: usize = 64;
/// Time between two notes of how many groups are done.
const NOTED_EVERY: Duration = Duration::from_secs(5);

/// Drives the study and prints how far its groups end up from where they should.
///
/// # Errors
/// When the file is refused or a group cannot be built.
pub fn study(arguments: &Arguments) -> anyhow::Result<()> {
    let mut file = GroupFile::load(&arguments.group)?;
    let motion: Box<dyn Trajectory<f64> + Sync> = match arguments.motion {
        Motion::Circle => Box::new(Ramped::new(Circle::paper(), RAMP)),
        Motion::FigureEight => Box::new(Ramped::new(FigureEight::paper(), RAMP)),
    };
    let options = StudyOptions {
        compensation: !arguments.uncompensated,
        ..StudyOptions::default()
    };
    let start = motion.at(0.0).0;
    let threads = match arguments.threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads.into(),
    };
    let period = f64::from(file.sync_period_us) * 1e-6;
    let periods = (motion.duration() / period).ceil();
    let command = |_: usize, group: &StudyGroup| {
        // In the middle of the period that begins now.
        let (pose, twist) = motion.at(group.time() + 0.5 * period);
        twist.to_body(pose.heading)
    };
    let end = motion.at(motion.duration()).0;
    let mut errors = Vec::new();
    let (mut robots, mut shape) = (0, 0.0_f64);
    let began = Instant::now();
    let mut noted = began;
    let groups = arguments.groups as usize;
    let batch = BATCH * threads;
    for first in (0..groups).step_by(batch) {
        let count = batch.min(groups - first);
        let mut study = Study::copies(&file, count, start, options)?;
        file.simulation.seed = file.simulation.seed.wrapping_add(count as u64);
        study.run(periods as u32, threads, &command)?;
        robots += study.robots();
        for group in study.groups() {
            let away = (group.pose().x - end.x).hypot(group.pose().y - end.y);
            errors.push(away * 1e3);
            shape = shape.max(group.worst_shape_error_mm());
        }
        if noted.elapsed() > NOTED_EVERY {
            noted = Instant::now();
            print_note(format_args!(
                "{} of {} groups",
                errors.len(),
                arguments.groups
            ));
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    errors.sort_by(f64::total_cmp);
    print_line(format_args!(
        "{} groups, {robots} robots, {:.1} s of motion",
        errors.len(),
        motion.duration()
    ))?;
    print_line(format_args!(
        "distance from the end of the curve: median {:.1} mm, largest {:.1} mm",
        errors[errors.len() / 2],
        errors[errors.len() - 1]
    ))?;
    print_line(format_args!("largest shape error: {shape:.2} mm"))?;
    print_line(format_args!(
        "{seconds:.2} s on {threads} threads: {:.0} robot-seconds a second",
        robots as f64 * motion.duration() / seconds
    ))?;
    Ok(())
}

/// How far the cost of a robot may differ between the sizes.
const FLAT: f64 = 1.2;
/// How much faster than real time 16 robots on a bus have to be.
const BUS_FACTOR: f64 = 20.0;

/// Measures and prints; fails when the cost of a robot is not flat within 20 %, or 16 robots on a
/// bus are not 20 times faster than real time.
///
/// # Errors
/// See above.
pub fn scale() -> anyhow::Result<()> {
    let mut bad = Vec::new();
    for plant in [OnPlant::Table, OnPlant::Contact] {
        let name = plant.name();
        let costs = scale::study_costs(plant)?;
        for (robots, cost) in scale::ROBOTS.iter().zip(costs) {
            print_line(format_args!(
                "study, {name} plant, {robots:>4} robots: {cost:.0} ns a robot and step of 1 ms"
            ))?;
        }
        let spread = scale::spread(&costs);
        print_line(format_args!(
            "study, {name} plant: most expensive size over cheapest {spread:.2}"
        ))?;
        if spread > FLAT {
            bad.push(format!("the cost of a robot on the {name} plant depends on the number of robots by more than the limit"));
        }
    }
    for plant in [OnPlant::Table, OnPlant::Contact] {
        let factor = scale::sixteen_on_a_bus(plant)?;
        print_line(format_args!(
            "bus, {} plant, 16 native robots: {factor:.1} times real time",
            plant.name()
        ))?;
        if plant == OnPlant::Table && factor < BUS_FACTOR {
            bad.push("16 robots on a bus are slower than 20 times real time".to_owned());
        }
    }
    if !bad.is_empty() {
        bail!("{}", bad.join("; "));
    }
    Ok(())
}
