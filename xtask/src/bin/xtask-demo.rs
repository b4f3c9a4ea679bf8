//! `cargo xtask demo` alone. The launcher starts this for a demo, so that a fresh clone drives
//! before what the other tasks need is built.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tasks::demo;

/// The demo of Omnibus.
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
}

fn main() -> ExitCode {
    let Task::Demo(arguments) = Arguments::parse().task;
    tasks::exit_code(demo::run(&arguments).map(|()| ExitCode::SUCCESS))
}
