//! The speed of kinematics, the emulator and native robots on this machine: `cargo xtask bench
//! --host`.
//!
//! The times depend on the machine and differ in every run; they have no bounds and are separate
//! from the other figures. Only ratios within one run can be compared.

use emulator::Firmware;
use group::GroupFile;
use sim::Backend;
use sim::paper::OnPlant;
use sim::scale::{self, Calls};

use super::figure::{Better, Figure};

/// Virtual seconds of a round of the emulated robots.
const EMULATED_S: u16 = 3;

fn speed(name: impl Into<String>, value: f64, unit: &'static str) -> Figure {
    Figure {
        better: Better::Higher,
        ..Figure::new(name, value, unit)
    }
}

/// Measures everything; `alone` is a group of one robot, `three` one of three.
pub fn figures(
    alone: &GroupFile,
    three: &GroupFile,
    firmware: &Firmware,
) -> anyhow::Result<Vec<Figure>> {
    let mut figures = kinematics()?;
    let emulated =
        |group| scale::times_real_time(group, Backend::Emulator(firmware.clone()), EMULATED_S);
    let (one, of_three) = (emulated(alone)?, emulated(three)?);
    figures.extend([
        speed("host.emulator.1_robot", one, REAL_TIME),
        speed("host.emulator.3_robots", of_three, REAL_TIME),
        // 1: a robot among three costs what one alone does.
        Figure::new(
            "host.emulator.cost_among_3",
            one / (3.0 * of_three),
            "times",
        ),
    ]);
    for plant in [OnPlant::Table, OnPlant::Contact] {
        let factor = scale::sixteen_on_a_bus(plant)?;
        let name = format!("host.bus.{}.16_robots", plant.name());
        figures.push(speed(name, factor, REAL_TIME));
        figures.extend(study(plant)?);
    }
    Ok(figures)
}

const REAL_TIME: &str = "x real time";

fn kinematics() -> anyhow::Result<Vec<Figure>> {
    let unit = "million calls/s";
    let (single, double) = (scale::kinematics_f32()?, scale::kinematics_f64()?);
    let both = |scalar: &str, calls: Calls| {
        [
            speed(format!("host.inverse.{scalar}"), calls.inverse / 1e6, unit),
            speed(format!("host.forward.{scalar}"), calls.forward / 1e6, unit),
        ]
    };
    let mut figures = Vec::from(both("f32", single));
    figures.extend(both("f64", double));
    for (name, ratio) in [
        ("host.inverse.f64_cost", single.inverse / double.inverse),
        ("host.forward.f64_cost", single.forward / double.forward),
    ] {
        figures.push(Figure::new(name, ratio, "times f32"));
    }
    Ok(figures)
}

/// Robots without a bus: what one costs, in the size of study where it is cheapest and relative to
/// that in the others.
fn study(plant: OnPlant) -> anyhow::Result<Vec<Figure>> {
    let costs = scale::study_costs(plant)?;
    let cheapest = costs.iter().copied().fold(f64::INFINITY, f64::min);
    let name = |what: &str| format!("host.study.{}.{what}", plant.name());
    let mut figures = vec![Figure::new(name("cheapest"), cheapest, "ns/robot/ms")];
    for (robots, cost) in scale::ROBOTS.iter().zip(costs) {
        let relative = name(&format!("{robots}_robots.cost"));
        figures.push(Figure::new(relative, cost / cheapest, "times cheapest"));
        if *robots == 4000 {
            let factor = scale::STEP_NS / (cost * 4000.0);
            figures.push(speed(name("4000_robots"), factor, REAL_TIME));
        }
    }
    let together = scale::largest_on_all_threads(plant)?;
    figures.push(speed(name("4000_robots.all_cores"), together, REAL_TIME));
    Ok(figures)
}
