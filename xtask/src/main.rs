//! Workspace tasks: `cargo xtask demo | test | interop | fuzz | size | flash | check-elf | check-demo`.
//!
//! One file per task; [`cargo`] runs the tools and [`firmware`] builds and inspects the image. A
//! task either finishes, or says what failed and what to do about it, and exits with 1. Nothing is
//! downloaded except what `rustup` and `cargo` fetch themselves, and `pip` for `interop`.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use omnibus::report::Scalar;

mod cargo;
mod check;
mod demo;
mod firmware;
mod flash;
mod interop;

/// Workspace tasks of Omnibus.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Drives a group of emulated robots along a curve, without and with compensation.
    Demo(demo::Arguments),
    /// Runs all Rust tests of the workspace, those that need the firmware image included.
    Test {
        /// Arguments for `cargo test`, after `--`.
        #[arg(last = true)]
        rest: Vec<String>,
    },
    /// Lets foreign software talk to the robots: python-canopen, cantools, tshark.
    Interop(interop::Arguments),
    /// Throws random frames at the CANopen device; nothing may panic or hang.
    Fuzz {
        /// How many frames.
        #[arg(long, default_value_t = 10_000_000)]
        frames: u64,
        /// Another stream of frames; the same seed gives the same.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Prints the size of the firmware image by section.
    Size,
    /// Builds the firmware and writes it to a board with probe-rs.
    Flash(flash::Arguments),
    /// Checks that the firmware image is bootable: its vector table is at 0x08000000.
    CheckElf,
    /// Checks the JSON of a demo against what the project promises.
    CheckDemo {
        /// File written by `cargo xtask demo --json`.
        json: std::path::PathBuf,
    },
}

fn run(task: Task) -> anyhow::Result<()> {
    match task {
        Task::Demo(arguments) => demo::run(&arguments),
        Task::Test { rest } => cargo::test(&rest),
        Task::Interop(arguments) => interop::run(&arguments),
        Task::Fuzz { frames, seed } => cargo::fuzz(frames, seed),
        Task::Size => firmware::print_size(&firmware::build(Scalar::F32)?),
        Task::Flash(arguments) => flash::run(&arguments),
        Task::CheckElf => firmware::check(&firmware::build(Scalar::F32)?),
        Task::CheckDemo { json } => check::demo(&json),
    }
}

fn main() -> ExitCode {
    match run(Arguments::parse().task) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
