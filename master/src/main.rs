//! The `omnibus` command: everything done from the PC.
//!
//! One file per command under `cli/`; this one only reads the arguments and prints errors. Exit
//! codes: 0 done, 1 failed (the message says node, object or field and what to do), 2 wrong usage.

use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod cli;

const EXAMPLES: &str = "Examples:
  omnibus follow figure-eight --bus sim:groups/tcc-3.toml
  omnibus follow circle --bus sim:groups/tcc-2.toml --compensation off --json
  omnibus scan --bus sim:groups/tcc-3.toml
  omnibus group check groups/tcc-3.toml

A bus is sim:GROUP.toml (a simulated world in this process), socketcan:INTERFACE,
slcan:DEVICE or slcan-tcp://HOST:PORT; real ones need --group GROUP.toml beside them.";

/// Makes several Mecanum-wheeled robots move as one body.
#[derive(Parser)]
#[command(name = "omnibus", version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Drives the group along a curve and says how well it went.
    Follow(cli::follow::Arguments),
    /// Moves the group at one velocity for a time.
    Drive(cli::drive::Arguments),
    /// Lists the robots on the bus.
    Scan(cli::nodes::Scan),
    /// Says how every robot of the group is.
    Status(cli::nodes::Status),
    /// Reads and writes the robots' parameters.
    #[command(subcommand)]
    Param(cli::param::Command),
    /// Checks and shows group files.
    #[command(subcommand)]
    Group(cli::group::Command),
}

fn main() -> ExitCode {
    let done = match Arguments::parse().command {
        Command::Follow(arguments) => cli::follow::run(&arguments),
        Command::Drive(arguments) => cli::drive::run(&arguments),
        Command::Scan(arguments) => cli::nodes::scan(&arguments),
        Command::Status(arguments) => cli::nodes::status(&arguments),
        Command::Param(command) => cli::param::run(&command),
        Command::Group(command) => cli::group::run(&command),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if cli::reader_gone(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
