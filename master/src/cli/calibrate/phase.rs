//! `omnibus calibrate --phase`: how the rollers of each wheel stand at its encoder's index, from a
//! source of poses or from gyros.

use anyhow::{Context as _, bail};
use group::GroupFile;
use kinematics::{FourWheelGeometry, Rollers, VelocityCompensation};
use omnibus::bus::address::BusAddress;
use omnibus::bus::link::Link;
use omnibus::commission::calibrate::phase::{self, Phases, Residual};
use omnibus::commission::calibrate::recorded_motions::{self, Source};
use omnibus::error::MasterError;
use omnibus::session::Group;
#[cfg(feature = "simulation")]
use omnibus::simulation::link::SimLink;
use omnibus::source::gyro::GyroStream;
#[cfg(feature = "simulation")]
use omnibus::source::gyro::RateSample;
use protocol::{Value, address};
use serde_json::json;

use super::{Arguments, abort_on_ctrl_c, pose_stream, say};
use crate::cli::{json, print_json};

/// The gyros of simulated robots.
const SIM: &str = "sim";

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let mut group = target.group()?;
    if group.simulation.rigid && group.robots.len() > 1 {
        bail!(
            "the robots of {} are bolted to one load, which hides the ripple of each behind the \
             others'; calibrate them apart (simulation.rigid = false in the group file says so)",
            group.name
        );
    }
    for robot in &mut group.robots {
        let count = robot
            .rollers
            .map_or(arguments.rollers, |rollers| rollers.count);
        robot.rollers = Some(group::Rollers {
            count,
            phases: [0.0; 4],
            index_tolerance: robot.rollers.and_then(|rollers| rollers.index_tolerance),
            compensation: VelocityCompensation::NONE,
        });
    }
    let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
    match (&target.bus, &arguments.gyro, &arguments.pose) {
        (BusAddress::Sim(_), _, Some(_)) => {
            bail!("--pose is not needed on a simulated bus")
        }
        #[cfg(feature = "simulation")]
        (BusAddress::Sim(_), None, None) => {
            let source = &mut Source::Poses(&mut true_poses);
            calibrate(arguments, &group, target.simulated(&group)?, source)
        }
        #[cfg(feature = "simulation")]
        (BusAddress::Sim(_), Some(gyro), None) => {
            if gyro != SIM {
                bail!("--gyro {gyro} is for real buses; on a simulated one give --gyro {SIM}");
            }
            let source = &mut Source::Gyro(&mut simulated_gyros);
            calibrate(arguments, &group, target.simulated(&group)?, source)
        }
        (_, Some(gyro), _) => {
            let stream = gyro_stream(gyro)?;
            let link = target.link(&group)?;
            let mut rates = |link: &mut Box<dyn Link>| stream.take(&nodes, link.now());
            calibrate(arguments, &group, link, &mut Source::Gyro(&mut rates))
        }
        (_, None, Some(pose)) => {
            let stream = pose_stream(pose)?;
            let link = target.link(&group)?;
            let mut poses = |_: &mut Box<dyn Link>| stream.robots(&nodes);
            calibrate(arguments, &group, link, &mut Source::Poses(&mut poses))
        }
        (_, None, None) => bail!(
            "no source of measurements: give --pose tcp://HOST:PORT (their poses) or --gyro \
             tcp://HOST:PORT (their yaw rates), JSON lines both"
        ),
    }
}

#[cfg(feature = "simulation")]
fn true_poses(link: &mut SimLink) -> Result<Vec<[f64; 3]>, MasterError> {
    let truth = link.world.truth();
    let poses = truth.robots.iter().map(|robot| robot.pose);
    Ok(poses.map(|pose| [pose.x, pose.y, pose.heading]).collect())
}

#[cfg(feature = "simulation")]
fn simulated_gyros(link: &mut SimLink) -> Result<Vec<Vec<RateSample>>, MasterError> {
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
fn gyro_stream(source: &str) -> anyhow::Result<GyroStream> {
    if source == SIM {
        bail!(
            "--gyro {SIM} is for simulated buses; give --gyro tcp://HOST:PORT, where yaw rates \
             come as JSON lines"
        );
    }
    let address = source
        .strip_prefix("tcp://")
        .with_context(|| format!("--gyro {source} is not tcp://HOST:PORT"))?;
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
    let geometries: Vec<_> = file
        .robots
        .iter()
        .map(|robot| {
            let g = robot.geometry;
            FourWheelGeometry::new(
                f64::from(g.half_track()),
                f64::from(g.half_wheelbase()),
                f64::from(g.wheel_radius()),
                f64::from(g.roller_angle()),
            )
        })
        .collect::<Result<_, _>>()?;
    let Some(first) = geometries.first() else {
        bail!("{} has no robots", file.name);
    };
    let twists = recorded_motions::motions(first, &file.limits, arguments.slip.repeats()?);
    let mut group = Group::connect(link, file)?;
    group.set_abort(abort_on_ctrl_c()?);
    group.configure(false)?;
    group.find_rollers()?;
    let motions = recorded_motions::record(&mut group, &twists, source)?;
    let mut outcomes = Vec::new();
    for ((robot, geometry), motions) in file.robots.iter().zip(&geometries).zip(&motions) {
        let count = robot
            .rollers
            .map_or(arguments.rollers, |rollers| rollers.count);
        let found = phase::estimate(geometry, Rollers::new(u16::from(count))?, motions)
            .with_context(|| format!("node {}", robot.node))?;
        show(robot.node, count, &found)?;
        outcomes.push(json!({
            "node": robot.node,
            "rollers": count,
            "phases_deg": found.phases.map(f64::to_degrees),
            "confidence_deg": found.confidence.map(f64::to_degrees),
            "explained_percent": 100.0 * found.explained,
            "intervals": found.intervals,
        }));
        if arguments.write {
            write(&mut group, robot.node, &found)?;
        }
    }
    if json() {
        print_json(&json!({"robots": outcomes, "written": arguments.write}))?;
    }
    Ok(())
}

fn show(node: u8, count: u8, found: &Phases) -> anyhow::Result<()> {
    let degrees = found.phases.map(f64::to_degrees);
    let sure = found.confidence.map(f64::to_degrees);
    say(format!(
        "# node {node}: front left, front right, rear left, rear right"
    ))?;
    say(format!(
        "rollers = {{ count = {count}, phases_deg = [{:.2}, {:.2}, {:.2}, {:.2}] }}",
        degrees[0], degrees[1], degrees[2], degrees[3]
    ))?;
    let residual = match found.residual {
        Residual::Displacement(metres) => format!("{:.3} mm", metres * 1e3),
        Residual::YawRate(rate) => format!("{:.3} degrees/s", rate.to_degrees()),
    };
    say(format!(
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

#[expect(
    clippy::cast_possible_truncation,
    reason = "a robot holds an angle as f32"
)]
fn write<L: Link>(group: &mut Group<L>, node: u8, found: &Phases) -> anyhow::Result<()> {
    for (wheel, phase) in (0..).zip(found.phases) {
        let value = Value::F32(phase as f32);
        group
            .wire()
            .write(node, address::rollers::phase(wheel), value)?;
    }
    say(format!(
        "# node {node}: written; `omnibus param save` keeps it through a power cycle"
    ))
}
