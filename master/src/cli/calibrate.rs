//! `omnibus calibrate`: measures the constants that robots need about themselves and their floor.

use omnibus::run::DriveError;
use omnibus::source::pose::PoseStream;

use super::{Target, abort_on_ctrl_c, print_line};

mod found;
mod phase;
mod progress;
mod slip;
pub mod tape;

const EXAMPLES: &str = "Examples:
  omnibus calibrate --bus sim:groups/tcc-2.toml
  omnibus calibrate --pose tcp://127.0.0.1:7702 --plot floor.svg --write --save --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --all --write --save --plot fit.html --pose tcp://127.0.0.1:7702 \\
      --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --tape --speeds 0.3 --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --undo --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --phase --bus sim:groups/single-rollers.toml
  omnibus calibrate --phase --gyro sim --bus sim:groups/single-rollers.toml
  omnibus calibrate --phase --gyro robot --write --bus socketcan:can0 --group my-group.toml
  omnibus calibrate --phase --gyro tcp://127.0.0.1:7703 --write --bus socketcan:can0 --group my-group.toml

The group needs clear floor on every side: --distance (1 m; with --phase 2.5 m) plus the ramps. Every motion is driven
there and back.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Finds the angle of each wheel's rollers at its index, instead of the loss by slip.
    #[arg(long)]
    phase: bool,
    /// Number of rollers of a wheel, where the group file does not give it; otherwise 8.
    #[arg(long, value_parser = clap::value_parser!(u8).range(3..=64))]
    rollers: Option<u8>,
    /// Source of poses: tcp://HOST:PORT with JSON lines. A simulated bus has its own.
    #[arg(long, value_name = "tcp://HOST:PORT")]
    pose: Option<String>,
    /// Finds phases from yaw rates instead of poses: robot for the gyros on the robots' boards,
    /// tcp://HOST:PORT for JSON lines, or, on a simulated bus, sim for gyros placed on its robots.
    #[arg(long, value_name = "robot|tcp://HOST:PORT|sim")]
    gyro: Option<String>,
    /// Writes the result into the robots, and without --phase also into the group file.
    #[arg(long)]
    write: bool,
    #[command(flatten)]
    slip: slip::Slip,
}

impl Arguments {
    /// Rollers of a wheel where the group file does not say.
    fn rollers(&self) -> u8 {
        self.rollers.unwrap_or(8)
    }
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.rollers.is_some() && !arguments.phase && !arguments.slip.all {
        wrong("--rollers is for finding their phases; add --phase or --all");
    }
    if arguments.gyro.is_some() {
        if !arguments.phase && !arguments.slip.all {
            wrong("--gyro measures the phases of rollers; add --phase or --all");
        }
        if arguments.phase && arguments.pose.is_some() {
            wrong("--phase needs either --pose or --gyro, not both");
        }
    }
    if arguments.phase {
        phase::run(arguments)
    } else {
        slip::run(arguments)
    }
}

/// Ends the program as for any other options that do not go together.
fn wrong(problem: &str) -> ! {
    let mut command = clap::Command::new("omnibus calibrate");
    command
        .error(clap::error::ErrorKind::ArgumentConflict, problem)
        .exit()
}

/// Connects to `tcp://HOST:PORT`.
fn pose_stream(source: &str) -> anyhow::Result<PoseStream> {
    let Some(address) = source.strip_prefix("tcp://") else {
        usage!("--pose {source} is not tcp://HOST:PORT");
    };
    PoseStream::connect(address).map_err(|error| {
        let address = address.to_owned();
        let problem = error.to_string();
        DriveError::Pose { address, problem }.into()
    })
}
