//! The `omnibus` command: everything done from the PC.
//!
//! One file per command under `cli/`; this one only reads the arguments and prints errors. Exit
//! codes are listed in `cli/output.rs` and at the end of the help.

// `cli/output.rs` has what does not panic without a reader.
#![deny(clippy::print_stdout, clippy::print_stderr)]

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};

mod cli;

const EXAMPLES: &str = "Examples:
  omnibus follow figure-eight --bus sim:groups/tcc-3.toml
  omnibus scan --bus socketcan:can0
  omnibus group check groups/tcc-3.toml

A bus is auto (the adapter or robot that is plugged in), sim:GROUP.toml (a simulated world in this
process), socketcan:INTERFACE, slcan:DEVICE, slcan-tcp://HOST:PORT,
socketcand://HOST:PORT/INTERFACE or lockstep://HOST:PORT (served by omnibus-sim). Commands that move
a group on a real bus also need --group GROUP.toml. The environment variables OMNIBUS_BUS and
OMNIBUS_GROUP replace --bus and --group.";

/// Makes several Mecanum-wheeled robots move as one body.
#[derive(Parser)]
#[command(name = "omnibus", version, after_help = format!("{EXAMPLES}\n\n{}", cli::output::EXIT_CODES))]
struct Arguments {
    #[command(flatten)]
    output: cli::output::Output,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Drives the group along a curve and reports how well it followed.
    Follow(cli::follow::Arguments),
    /// Moves the group at one velocity for a time.
    Drive(cli::drive::Arguments),
    /// Measures slip and roller phases and writes the result into the robots.
    Calibrate(cli::calibrate::Arguments),
    /// Shows a running group in the terminal, and starts, stops and drives it by keyboard.
    Watch(cli::live::Watch),
    /// Drives the group by keyboard or gamepad, as long as a key is held.
    Teleop(cli::live::Teleop),
    /// Lists the robots on the bus.
    Scan(cli::nodes::Scan),
    /// Shows the state of every robot.
    Status(cli::nodes::Status),
    /// Reads and writes the robots' parameters.
    Param(cli::param::Arguments),
    /// Checks and shows group files, and writes them into the robots.
    Group(cli::group::Arguments),
    /// Gives robots their node ids over the bus.
    #[command(subcommand, after_help = cli::lss::EXAMPLES)]
    Lss(cli::lss::Command),
    /// Resets robots, as if they were switched off and on.
    Reset(cli::reset::Arguments),
    /// Flashes one robot's LED, to tell which robot it is.
    #[command(alias = "identify")]
    Blink(cli::wheel_test::Blink),
    /// Updates the firmware of all robots, or of none if one fails.
    Update(cli::update::Arguments),
    /// Locks the parameters and images of robots with a key, or sets that key.
    Lock(cli::lock::Lock),
    /// Unlocks robots with their key, for a limited time.
    Unlock(cli::lock::Unlock),
    /// Turns one wheel after the other and reports wrong wiring.
    WheelTest(cli::wheel_test::Arguments),
    /// Identifies the motors of one robot and sets its wheel loops.
    IdentifyMotors(cli::motors::Arguments),
    /// Measures a group against the promises of the documents, on stands or on the floor.
    Accept(cli::accept::Arguments),
    /// Calculates the bus load.
    BusLoad(cli::bus_load::Arguments),
    /// Listens to a bus and records everything on it.
    Record(cli::record::Arguments),
    /// Turns a recording into CSV or a candump log, or a log into a recording.
    Convert(cli::convert::Arguments),
    /// Sends the frames of a recorded master again, with their timing.
    Replay(cli::replay::Arguments),
    /// Draws a recording as SVG and PNG.
    Plot(cli::plot::Plot),
    /// Makes an HTML page of a recording.
    Report(cli::plot::Report),
    /// Serves a page with the live group and a joystick.
    Serve(cli::serve::Arguments),
    /// Lets other programs drive and observe the group by JSON lines, and shows it in Foxglove.
    Bridge(cli::bridge::Arguments),
    /// Lets a fleet control drive the group as one vehicle, by VDA 5050 over MQTT.
    #[cfg(feature = "vda5050")]
    Vda5050(cli::vda5050::Arguments),
    #[cfg(not(feature = "vda5050"))]
    #[command(hide = true, disable_help_flag = true)]
    Vda5050(cli::NotBuilt),
    /// Makes the group one holonomic robot of ROS 2.
    #[cfg(feature = "ros")]
    Ros(cli::ros::Arguments),
    #[cfg(not(feature = "ros"))]
    #[command(hide = true, disable_help_flag = true)]
    Ros(cli::NotBuilt),
    /// Prints a script that completes commands in your shell.
    Completions(cli::completions::Arguments),
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return ExitCode::from(cli::output::print_usage(&error)),
    };
    cli::output::set(arguments.output);
    omnibus::file::on_leftover(cli::output::print_leftover);
    let done = match arguments.command {
        Command::Follow(arguments) => cli::follow::run(&arguments),
        Command::Drive(arguments) => cli::drive::run(&arguments),
        Command::Calibrate(arguments) => cli::calibrate::run(&arguments),
        Command::Watch(arguments) => cli::live::watch(&arguments),
        Command::Teleop(arguments) => cli::live::teleop(&arguments),
        Command::Scan(arguments) => cli::nodes::scan(&arguments),
        Command::Status(arguments) => cli::nodes::status(&arguments),
        Command::Lock(arguments) => cli::lock::run(&arguments),
        Command::Unlock(arguments) => cli::lock::run_unlock(&arguments),
        Command::Reset(arguments) => cli::reset::run(&arguments),
        Command::Update(arguments) => cli::update::run(&arguments),
        Command::Param(arguments) => cli::param::run(&arguments),
        Command::Group(arguments) => cli::group::run(&arguments),
        Command::Lss(command) => cli::lss::run(&command),
        Command::Blink(arguments) => cli::wheel_test::blink(&arguments),
        Command::WheelTest(arguments) => cli::wheel_test::run(&arguments),
        Command::IdentifyMotors(arguments) => cli::motors::run(&arguments),
        Command::Accept(arguments) => cli::accept::run(&arguments),
        Command::BusLoad(arguments) => cli::bus_load::run(&arguments),
        Command::Record(arguments) => cli::record::run(&arguments),
        Command::Convert(arguments) => cli::convert::run(&arguments),
        Command::Replay(arguments) => cli::replay::run(&arguments),
        Command::Plot(arguments) => cli::plot::plot(&arguments),
        Command::Report(arguments) => cli::plot::report(&arguments),
        Command::Serve(arguments) => cli::serve::run(&arguments),
        Command::Bridge(arguments) => cli::bridge::run(&arguments),
        #[cfg(feature = "vda5050")]
        Command::Vda5050(arguments) => cli::vda5050::run(&arguments),
        #[cfg(not(feature = "vda5050"))]
        Command::Vda5050(command) => command.refuse("vda5050"),
        #[cfg(feature = "ros")]
        Command::Ros(arguments) => cli::ros::run(&arguments),
        #[cfg(not(feature = "ros"))]
        Command::Ros(command) => command.refuse("ros"),
        Command::Completions(arguments) => {
            cli::completions::run(&arguments, &mut Arguments::command())
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if cli::output::reader_gone(&error) => ExitCode::SUCCESS,
        Err(error) => {
            cli::output::print_error(&error);
            ExitCode::from(cli::output::exit_code(&error))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        Arguments::command().debug_assert();
    }
}
