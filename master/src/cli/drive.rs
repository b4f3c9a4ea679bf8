//! `omnibus drive --vx --vy --omega --for`: one velocity of the group for a time, with ramps that the
//! robots make by their own limits.

use anyhow::bail;
use kinematics::Twist;
use omnibus::session::Group;

use super::{Target, say};

/// Longest time the group may take to come to rest, in µs.
const STOP_PATIENCE_US: u64 = 5_000_000;

#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Forward velocity of the group, m/s.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    vx: f32,
    /// Velocity to the left, m/s.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    vy: f32,
    /// Yaw rate, counter-clockwise, rad/s.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    omega: f32,
    /// For how long, s.
    #[arg(long = "for", value_name = "SECONDS")]
    seconds: f64,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = arguments.target.group()?;
    let twist = Twist {
        vx: arguments.vx,
        vy: arguments.vy,
        omega: arguments.omega,
    };
    let limits = &file.limits;
    let speed = twist.vx.hypot(twist.vy);
    if speed.is_nan() || speed > limits.linear_speed {
        bail!(
            "--vx, --vy: {speed} m/s is not within the group's limits.linear_speed, {} m/s",
            limits.linear_speed
        );
    }
    if twist.omega.is_nan() || twist.omega.abs() > limits.yaw_rate {
        bail!(
            "--omega: {} rad/s is not within the group's limits.yaw_rate, {} rad/s",
            twist.omega,
            limits.yaw_rate
        );
    }
    if !(arguments.seconds > 0.0 && arguments.seconds <= 3600.0) {
        bail!("--for: {} s is not between 0 and 3600 s", arguments.seconds);
    }
    let link = arguments.target.link(&file)?;
    let mut group = Group::connect(link, &file)?;
    group.set_abort(super::abort_on_ctrl_c()?);
    group.configure(true)?;
    group.start()?;
    let periods = (arguments.seconds * 1e6 / group.period_us() as f64).ceil() as u64;
    let mut driven = Ok(());
    for _ in 0..periods {
        driven = group.cycle(twist);
        if driven.is_err() {
            break;
        }
    }
    let stopped = group.ramp_down(STOP_PATIENCE_US);
    driven.and(stopped)?;
    let rows = group.recorder().rows();
    for (index, robot) in file.robots.iter().enumerate() {
        let last = rows.iter().rev().find_map(|row| row.members[index].pose);
        if let Some(pose) = last {
            say(format_args!(
                "node {}: by its wheels the group came to x {:.3} m, y {:.3} m, heading {:.4} rad",
                robot.node, pose.x, pose.y, pose.heading
            ))?;
        }
    }
    Ok(())
}
