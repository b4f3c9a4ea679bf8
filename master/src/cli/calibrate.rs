//! `omnibus calibrate`: finds what robots have to be told about themselves.

use anyhow::{Context as _, bail};
use kinematics::{FourWheelGeometry, Rollers, Twist, VelocityCompensation};
use omnibus::bus::BusAddress;
use omnibus::calibrate::drive;
use omnibus::calibrate::phase::{self, Phases};
use omnibus::drive::DriveError;
use omnibus::error::MasterError;
use omnibus::link::Link;
use omnibus::pose::PoseStream;
use omnibus::session::Group;
use omnibus::sim_link::SimLink;
use protocol::{Value, address};

use super::{Target, abort_on_ctrl_c, say};

mod slip;

const EXAMPLES: &str = "Examples:
  omnibus calibrate --bus sim:groups/tcc-2.toml
  omnibus calibrate --pose tcp://127.0.0.1:7702 --plot floor.svg --write --save --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --tape --speeds 0.3 --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --undo --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --phase --bus sim:groups/single.toml

The group needs a clear floor of --distance (1 m) and the ramps to every side. Every motion is driven there and back.";

/// Slow enough that slip and loop lag are small, fast enough not to take all day: m/s and rad/s.
const SIDEWAYS: f32 = 0.15;
const TURNING: f32 = 0.3;
/// How long each way, s.
const SECONDS: f64 = 6.0;

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Finds how the rollers of each wheel stand when its encoder's index comes, instead of what the floor takes away.
    #[arg(long)]
    phase: bool,
    /// Rollers of a wheel, where the group file does not say.
    #[arg(long, default_value_t = 8)]
    rollers: u8,
    /// Where poses come from: tcp://HOST:PORT with JSON lines. A simulated bus has its own.
    #[arg(long, value_name = "tcp://HOST:PORT")]
    pose: Option<String>,
    /// Writes what was found into the robots; coefficients into the group file, too.
    #[arg(long)]
    write: bool,
    #[command(flatten)]
    slip: slip::Slip,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if !arguments.phase {
        return slip::run(arguments);
    }
    let target = &arguments.target;
    let mut group = target.group()?;
    if group.simulation.rigid && group.robots.len() > 1 {
        bail!(
            "the robots of {} are bolted to one load, which hides the ripple of each behind the others'; calibrate them \
             apart (simulation.rigid = false in the group file says so)",
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
            compensation: VelocityCompensation::NONE,
        });
    }
    match (&target.bus, &arguments.pose) {
        (BusAddress::Sim(_), None) => {
            let start = kinematics::Pose::new(0.0, 0.0, 0.0);
            let world = omnibus::drive::world(&group, target.elf()?, start)?;
            let link = SimLink::new(world, target.bus.to_string());
            calibrate(arguments, &group, link, &mut |link| {
                let truth = link.world.truth();
                let poses = truth.robots.iter().map(|robot| robot.pose);
                Ok(poses.map(|pose| [pose.x, pose.y, pose.heading]).collect())
            })
        }
        (BusAddress::Sim(_), Some(_)) => bail!("--pose is for real buses; a simulated one knows"),
        (_, None) => {
            bail!("--pose tcp://HOST:PORT is missing: where do the robots' poses come from?")
        }
        (_, Some(source)) => {
            let source = pose_stream(source)?;
            let nodes: Vec<u8> = group.robots.iter().map(|robot| robot.node).collect();
            let link = target.link(&group)?;
            calibrate(arguments, &group, link, &mut |_| source.robots(&nodes))
        }
    }
}

/// Connects to `tcp://HOST:PORT`.
fn pose_stream(source: &str) -> anyhow::Result<PoseStream> {
    let address = source
        .strip_prefix("tcp://")
        .with_context(|| format!("--pose {source} is not tcp://HOST:PORT"))?;
    PoseStream::connect(address).map_err(|error| {
        let address = address.to_owned();
        let problem = error.to_string();
        DriveError::Pose { address, problem }.into()
    })
}

fn calibrate<L: Link>(
    arguments: &Arguments,
    file: &group::GroupFile,
    link: L,
    poses: drive::Poses<'_, L>,
) -> anyhow::Result<()> {
    let mut group = Group::connect(link, file)?;
    group.set_abort(abort_on_ctrl_c()?);
    group.configure(false)?;
    group.find_rollers()?;
    group.start()?;
    let driven = motions(&mut group, poses);
    let stopped = group.stop();
    let motions = driven?;
    stopped?;
    for (robot, motions) in file.robots.iter().zip(&motions) {
        let count = robot
            .rollers
            .map_or(arguments.rollers, |rollers| rollers.count);
        let g = robot.geometry;
        let geometry = FourWheelGeometry::new(
            f64::from(g.half_track()),
            f64::from(g.half_wheelbase()),
            f64::from(g.wheel_radius()),
            f64::from(g.roller_angle()),
        )?;
        let found = phase::estimate(&geometry, Rollers::new(u16::from(count))?, motions)
            .with_context(|| format!("node {}", robot.node))?;
        show(robot.node, count, &found)?;
        if arguments.write {
            write(&mut group, robot.node, &found)?;
        }
    }
    Ok(())
}

/// Sideways and back, turning and back; one list of motions a robot.
fn motions<L: Link>(
    group: &mut Group<L>,
    poses: drive::Poses<'_, L>,
) -> Result<Vec<Vec<Vec<phase::Sample>>>, MasterError> {
    let mut out = vec![Vec::new(); group.config().robots.len()];
    for twist in [
        Twist::new(0.0, SIDEWAYS, 0.0),
        Twist::new(0.0, -SIDEWAYS, 0.0),
        Twist::new(0.0, 0.0, TURNING),
        Twist::new(0.0, 0.0, -TURNING),
    ] {
        for (all, motion) in out
            .iter_mut()
            .zip(drive::record(group, (twist, SECONDS), poses)?)
        {
            all.push(motion);
        }
    }
    Ok(out)
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
    say(format!(
        "# ± {:.2} {:.2} {:.2} {:.2} degrees (95 %); residual {:.3} mm over {} intervals; {:.1} % of the ripple explained",
        sure[0],
        sure[1],
        sure[2],
        sure[3],
        found.residual_mm,
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
