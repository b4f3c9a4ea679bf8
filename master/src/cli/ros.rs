//! `omnibus ros`: the group is one holonomic robot to ROS 2.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;
use omnibus::ros::{Options, RosError, operate};
use ros::names::{Frames, frame_prefix, namespace};
use ros::node::environment::{Environment, Reach, Services};
use ros::node::{self, Settings};

use super::{Target, print_note};

const EXAMPLES: &str = "Examples:
  omnibus ros --bus sim:groups/tcc-2.toml
  omnibus ros --namespace left --bus socketcan:can0 --group my-group.toml
  omnibus ros --stamped false --no-tf --bus slcan:/dev/ttyACM0 --group my-group.toml

Call the service start, then publish geometry_msgs/TwistStamped on cmd_vel at least every 0.25 s; the service stop
switches the robots off. ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY, ROS_STATIC_PEERS and
RMW_IMPLEMENTATION are read. docs/ros.md lists all topics and services.";

/// How other nodes tell requests of services apart.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Rmw {
    Fastrtps,
    Cyclonedds,
}

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Namespace of the node and its topics. It also is the prefix of frames, unless --frame-prefix
    /// gives another one.
    #[arg(long, value_name = "NAME", default_value = "/", value_parser = namespace)]
    namespace: String,
    /// Prefix of the frames odom and base_link.
    #[arg(long, value_name = "PREFIX", value_parser = frame_prefix)]
    frame_prefix: Option<String>,
    /// Whether cmd_vel is geometry_msgs/TwistStamped (true) or geometry_msgs/Twist (false).
    #[arg(long, value_name = "BOOL", default_value_t = true, action = clap::ArgAction::Set)]
    stamped: bool,
    /// How long a velocity is good for, and how old its stamp may be, in s.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.25)]
    cmd_timeout: f64,
    /// Messages of odom, tf and joint_states per second.
    #[arg(long, value_name = "HZ", default_value_t = 50.0)]
    rate: f64,
    /// Does not publish the transform from odom to base_link: robot_localization does.
    #[arg(long)]
    no_tf: bool,
    /// Starts the robots at once; by default the service start does.
    #[arg(long)]
    start: bool,
    /// Middleware of the nodes that call services; by default as RMW_IMPLEMENTATION says.
    #[arg(long, value_enum)]
    rmw: Option<Rmw>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let group = target.group()?;
    let (settings, options) = settings(arguments, &group)?;
    let abort = super::abort_on_ctrl_c()?;
    // A panic of the library in a thread of its own leaves a node that looks alive.
    let (on_panic, panicked) = (abort.clone(), Arc::new(AtomicBool::new(false)));
    let (report, its_panicked) = (std::panic::take_hook(), Arc::clone(&panicked));
    std::panic::set_hook(Box::new(move |info| {
        report(info);
        its_panicked.store(true, Ordering::Relaxed);
        on_panic.ask();
    }));
    let network = match settings.environment.reach {
        Reach::Localhost => "this computer",
        Reach::Subnet => "the local network",
    };
    let of = if settings.stamped {
        "TwistStamped"
    } else {
        "Twist"
    };
    print_note(format_args!(
        "ROS 2 domain {} on {network}: node {}/{}, cmd_vel is geometry_msgs/{of}",
        settings.environment.domain,
        settings.namespace.trim_end_matches('/'),
        settings.name
    ));
    let pilot = Arc::new(target.pilot(&group)?);
    let body = Box::new(
        move |outgoing, on: &mut dyn FnMut(node::Incoming) -> node::Reply| {
            node::run(&settings, outgoing, on)
        },
    );
    operate(pilot, &group, &options, &abort, body).map_err(|error| match error {
        // By itself, because exit codes look for it.
        RosError::Drive(error) => anyhow!(error),
        other => anyhow!(other),
    })?;
    if panicked.load(Ordering::Relaxed) {
        return Err(RosError::NodeLost.into());
    }
    Ok(())
}

fn settings(
    arguments: &Arguments,
    group: &group::GroupFile,
) -> anyhow::Result<(Settings, Options)> {
    if !(0.05..=2.0).contains(&arguments.cmd_timeout) {
        usage!(
            "--cmd-timeout: {} s is not between 0.05 s and 2 s",
            arguments.cmd_timeout
        );
    }
    if !(1.0..=1000.0).contains(&arguments.rate) {
        usage!(
            "--rate: {} Hz is not between 1 Hz and 1000 Hz",
            arguments.rate
        );
    }
    let namespace = arguments.namespace.clone();
    let mut environment =
        Environment::read(|name| std::env::var(name).ok()).map_err(|error| anyhow!(error))?;
    match arguments.rmw {
        Some(Rmw::Fastrtps) => environment.services = Services::FastDds,
        Some(Rmw::Cyclonedds) => environment.services = Services::Cyclone,
        None => {}
    }
    let prefix = arguments.frame_prefix.clone().unwrap_or_else(|| {
        let name = namespace.trim_matches('/');
        if name.is_empty() {
            String::new()
        } else {
            format!("{name}/")
        }
    });
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 50 and 2000"
    )]
    let timeout_ms = (arguments.cmd_timeout * 1e3).round() as u64;
    let options = Options {
        frames: Frames::new(&prefix),
        timeout_ms,
        interval: 1.0 / arguments.rate,
        transforms: !arguments.no_tf,
        start: arguments.start,
    };
    let settings = Settings {
        environment,
        namespace,
        name: "omnibus".into(),
        stamped: arguments.stamped,
        description: ros::urdf::urdf(group),
    };
    Ok((settings, options))
}
