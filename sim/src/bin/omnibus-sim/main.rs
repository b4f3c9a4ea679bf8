//! The `omnibus-sim` command: a simulated group that other programs reach over a bus.
//!
//! One file per subcommand; each either finishes, or says what failed and what to do about it, and
//! exits with 1.

// `output` has what does not panic without a reader.
#![deny(clippy::print_stdout, clippy::print_stderr)]

use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod bench;
mod emulate;
mod endpoints;
mod faults;
mod gdb;
mod output;
mod paper;
mod robots;
mod serve;
mod study;

/// Simulates groups of Mecanum-wheeled robots.
#[derive(Parser)]
#[command(name = "omnibus-sim", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Simulates a group and serves its bus.
    Serve(serve::Serve),
    /// Runs the source paper's experiments and compares them with its numbers.
    Paper(paper::Paper),
    /// Drives many copies of a group along a curve, without a bus.
    Study(study::Arguments),
    /// Measures the computing time of simulated robots.
    Scale,
    /// Runs the firmware image of one robot and shows its log.
    Emulate(emulate::Emulate),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Serve(arguments) => serve::serve(&arguments),
        Command::Paper(arguments) => paper::paper(&arguments),
        Command::Study(arguments) => study::study(&arguments),
        Command::Scale => study::scale(),
        Command::Emulate(arguments) => emulate::emulate(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<output::ReaderGone>() => ExitCode::SUCCESS,
        Err(error) => {
            output::print_note(format_args!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
