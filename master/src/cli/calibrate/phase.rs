//! `omnibus calibrate --phase`: the angle of each wheel's rollers at its index, from a source of
//! poses or from gyros.

use group::GroupFile;
use omnibus::bus::address::BusAddress;
use omnibus::bus::link::Link;
use omnibus::commission::calibrate::journal::Journal;
use omnibus::commission::calibrate::recorded_motions::Source;
use omnibus::commission::calibrate::rollers::{self, RobotPhases};
use omnibus::error::MasterError;
use omnibus::session::Group;
#[cfg(feature = "simulation")]
use omnibus::simulation::link::SimLink;
use omnibus::source::gyro::GyroStream;
#[cfg(feature = "simulation")]
use omnibus::source::gyro::RateSample;
use protocol::{Value, address};
use roller_phase::Residual;
use serde_json::json;

use super::progress::Progress;
use super::{Arguments, abort_on_ctrl_c, pose_stream, print_line};
use crate::cli::{json, print_json};

/// The gyros of simulated robots.
const SIM: &str = "sim";
/// Those on the robots' own boards, whose turns come over the bus.
pub const BOARD: &str = "robot";

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = rollers::without_phases(&target.group()?, arguments.rollers())?;
    let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
    match (&target.bus, arguments.gyro.as_deref(), &arguments.pose) {
        (BusAddress::Sim(_), _, Some(_)) => {
            usage!("--pose is not needed on a simulated bus")
        }
        #[cfg(feature = "simulation")]
        (BusAddress::Sim(_), None, None) => {
            let source = &mut Source::Poses(&mut true_poses);
            calibrate(arguments, &group, target.simulated(&group)?, source)
        }
        #[cfg(feature = "simulation")]
        (BusAddress::Sim(_), Some(BOARD), None) => {
            let link = target.simulated(&group)?;
            calibrate(arguments, &group, link, &mut Source::Board)
        }
        (_, Some(BOARD), _) => {
            let link = target.command(&group)?;
            calibrate(arguments, &group, link, &mut Source::Board)
        }
        #[cfg(feature = "simulation")]
        (BusAddress::Sim(_), Some(gyro), None) => {
            is_simulated(gyro)?;
            let source = &mut Source::Gyro(&mut simulated_gyros);
            calibrate(arguments, &group, target.simulated(&group)?, source)
        }
        (_, Some(gyro), _) => {
            let stream = gyro_stream(gyro)?;
            let link = target.command(&group)?;
            let mut rates = |link: &mut Box<dyn Link>| stream.take(&nodes, link.now());
            calibrate(arguments, &group, link, &mut Source::Gyro(&mut rates))
        }
        (_, None, Some(pose)) => {
            let stream = pose_stream(pose)?;
            let link = target.command(&group)?;
            let stream = stream.on_waiting_bus(link.time_waits());
            let mut poses = |link: &mut Box<dyn Link>| stream.robots(&nodes, link.now());
            calibrate(arguments, &group, link, &mut Source::Poses(&mut poses))
        }
        (_, None, None) => usage!(
            "no source of measurements: give --pose tcp://HOST:PORT (poses) or --gyro \
             tcp://HOST:PORT (yaw rates), both as JSON lines, or --gyro {BOARD} (gyros on the \
             robots' boards)"
        ),
    }
}

/// Refuses a gyro that a simulated bus does not have.
#[cfg(feature = "simulation")]
pub fn is_simulated(gyro: &str) -> anyhow::Result<()> {
    if gyro != SIM {
        usage!(
            "--gyro {gyro} is for real buses; on a simulated one give --gyro {SIM}, or --gyro \
             {BOARD} where the boards have one"
        );
    }
    Ok(())
}

#[cfg(feature = "simulation")]
fn true_poses(link: &mut SimLink) -> Result<Vec<[f64; 3]>, MasterError> {
    let truth = link.world.truth();
    let poses = truth.robots.iter().map(|robot| robot.pose);
    Ok(poses.map(|pose| [pose.x, pose.y, pose.heading]).collect())
}

/// Yaw rates that the simulated gyros have measured since the last call.
#[cfg(feature = "simulation")]
pub fn simulated_gyros(link: &mut SimLink) -> Result<Vec<Vec<RateSample>>, MasterError> {
    let robots = link.world.truth().robots.len();
    let mut out = vec![Vec::new(); robots];
    for sample in link.world.take_gyros() {
        let t = sample.time_ns as f64 * 1e-9;
        for (samples, yaw_rate) in out.iter_mut().zip(sample.rates) {
            samples.push(RateSample {
                arrived: t,
                t,
                yaw_rate,
            });
        }
    }
    Ok(out)
}

/// Connects to `tcp://HOST:PORT`.
pub fn gyro_stream(source: &str) -> anyhow::Result<GyroStream> {
    if source == SIM {
        usage!(
            "--gyro {SIM} is for simulated buses; give --gyro tcp://HOST:PORT, where yaw rates \
             come as JSON lines"
        );
    }
    let Some(address) = source.strip_prefix("tcp://") else {
        usage!("--gyro {source} is not tcp://HOST:PORT or {BOARD}");
    };
    GyroStream::connect(address).map_err(|error| {
        MasterError::GyroSource {
            address: source.to_owned(),
            problem: error.to_string(),
        }
        .into()
    })
}

fn calibrate<L: Link>(
    arguments: &Arguments,
    file: &GroupFile,
    link: L,
    source: &mut Source<'_, L>,
) -> anyhow::Result<()> {
    let mut group = Group::connect(link, file)?;
    group.set_abort(abort_on_ctrl_c()?);
    let mut progress = Progress::new(None);
    let journal = &mut Journal::new(|step| progress.show(step));
    let found = rollers::find(&mut group, arguments.slip.repeats()?, source, journal)?;
    for robot in &found {
        show(robot)?;
    }
    if arguments.write {
        let known = rollers::with_phases(file, &found)?;
        for robot in &known.robots {
            let phases = robot.rollers.map_or([0.0; 4], |rollers| rollers.phases);
            write(&mut group, robot.node, phases)?;
        }
    }
    if json() {
        let robots: Vec<_> = found.iter().map(to_json).collect();
        print_json(&json!({"robots": robots, "written": arguments.write}))?;
    }
    Ok(())
}

/// A robot's phases as JSON.
pub fn to_json(RobotPhases { node, count, found }: &RobotPhases) -> serde_json::Value {
    json!({
        "node": node,
        "rollers": count,
        "phases_deg": found.phases.map(f64::to_degrees),
        "confidence_deg": found.confidence.map(f64::to_degrees),
        "explained_percent": 100.0 * found.explained,
        "intervals": found.intervals,
    })
}

/// Prints a robot's phases as its line of the group file.
pub fn show(RobotPhases { node, count, found }: &RobotPhases) -> anyhow::Result<()> {
    let degrees = found.phases.map(f64::to_degrees);
    let sure = found.confidence.map(f64::to_degrees);
    print_line(format!(
        "# node {node}: front left, front right, rear left, rear right"
    ))?;
    print_line(format!(
        "rollers = {{ count = {count}, phases_deg = [{:.2}, {:.2}, {:.2}, {:.2}] }}",
        degrees[0], degrees[1], degrees[2], degrees[3]
    ))?;
    let residual = match found.residual {
        Residual::Displacement(metres) => format!("{:.3} mm", metres * 1e3),
        Residual::YawRate(rate) => format!("{:.3} degrees/s", rate.to_degrees()),
    };
    print_line(format!(
        "# ± {:.2} {:.2} {:.2} {:.2} degrees (95 %); residual {residual} over {} intervals; {:.1} \
         % of the ripple explained",
        sure[0],
        sure[1],
        sure[2],
        sure[3],
        found.intervals,
        100.0 * found.explained
    ))
}

fn write<L: Link>(group: &mut Group<L>, node: u8, phases: [f32; 4]) -> anyhow::Result<()> {
    for (wheel, phase) in (0..).zip(phases) {
        let at = address::rollers::phase(wheel);
        group.wire().write_checked(node, at, Value::F32(phase))?;
    }
    print_line(format!(
        "# node {node}: written; `omnibus param save` keeps it through a power cycle"
    ))
}
