//! Workspace tasks: `cargo xtask accept | demo | test | coverage | faults | interop | socketcan |
//! fuzz | bench | profile | size | flash | release | keys | web | check-elf | check-demo`.
//!
//! There is one file per task. A task that fails reports the cause and the remedy and exits with 1.
//! Only `rustup`, `cargo`, `pip` and `npm` (for `interop`) and `apt-get` (for `socketcan`) download
//! anything.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tasks::{cargo, demo, firmware};

mod accept;
mod bench;
mod check;
mod faults;
mod flash;
mod interop;
mod programs;
mod release;
mod size_canopen;
mod socketcan;
mod test;
mod web;

/// Workspace tasks of Omnibus.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Measures whether a board keeps what the documents promise; exits with 6 if not.
    Accept(accept::Arguments),
    /// Drives a group of emulated robots along a curve, without and with compensation.
    Demo(demo::Arguments),
    /// Runs all Rust tests of the workspace, including those that need the firmware image.
    Test {
        /// Runs the system tests that a board has, with its image; for the reference board all
        /// tests.
        #[arg(long, value_enum, default_value_t)]
        board: firmware::Board,
        /// Arguments for `cargo test`, after `--`.
        #[arg(last = true)]
        rest: Vec<String>,
    },
    /// Counts how many 95 % intervals of a calibration contain the true value, on robots whose
    /// floors, loads and rollers the fits do not know.
    Coverage {
        /// Number of robots: four phases and five coefficients each.
        #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(10..))]
        robots: u32,
        /// Simulates the robots as multi-body systems (`examples/mujoco_plant.py`) instead; each
        /// takes two minutes.
        #[arg(long)]
        multi_body: bool,
        /// Number of the first of those robots; other numbers draw other robots.
        #[arg(long, default_value_t = 1, requires = "multi_body")]
        first: u32,
    },
    /// Injects every cause of a stop into emulated robots and measures their reaction.
    Faults(faults::Arguments),
    /// Tests the robots with third-party software: python-canopen, cantools, tshark.
    Interop(interop::Arguments),
    /// Boots a kernel with SocketCAN under qemu and connects simulator, master and can-utils over
    /// it.
    Socketcan,
    /// Sends random frames to the CANopen device, which must neither panic nor hang.
    Fuzz {
        /// Number of frames.
        #[arg(long, default_value_t = 10_000_000)]
        frames: u64,
        /// Seed of the random frames.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Searches for new paths with libFuzzer instead, for this number of seconds; needs a C++
        /// compiler.
        #[arg(
            long,
            value_name = "SECONDS",
            conflicts_with_all = ["frames", "seed"],
            value_parser = clap::value_parser!(u64).range(1..)
        )]
        guided: Option<u64>,
    },
    /// Prints the instructions of a driving robot by function.
    Profile(bench::profile::Arguments),
    /// Prints the use of flash and RAM, by section and by crate.
    Size {
        /// Prints the size of the CANopen device, as the difference to an image without it; fails
        /// above its budget.
        #[arg(long)]
        canopen: bool,
        /// Where to write the figures as JSON.
        #[arg(long, value_name = "PATH")]
        json: Option<std::path::PathBuf>,
        /// Board whose image is measured.
        #[arg(long, value_enum, default_value_t, conflicts_with = "canopen")]
        board: firmware::Board,
    },
    /// Measures the cost of the firmware: instructions, load, memory, bus, accuracy.
    Bench(bench::Arguments),
    /// Builds the firmware and writes it to a board with probe-rs.
    Flash(flash::Arguments),
    /// Builds the firmware for both slots of flash and writes a signed image file.
    Release(release::Arguments),
    /// Makes a pair of keys for image files.
    Keys(release::KeysArguments),
    /// Builds the firmware for every board and checks that it is bootable: its boot code is at
    /// 0x08000000 and its vector table in slot A.
    CheckElf,
    /// Builds the page with the group in it, and the documents, as static files in target/web.
    Web(web::Arguments),
    /// Checks the JSON of a demo against the promised accuracy.
    CheckDemo {
        /// File written by `cargo xtask demo --json`.
        json: std::path::PathBuf,
    },
}

fn run(task: Task) -> anyhow::Result<ExitCode> {
    match task {
        Task::Accept(arguments) => return accept::run(&arguments),
        Task::Demo(arguments) => demo::run(&arguments),
        Task::Test { board, rest } => test::run(board, &rest),
        Task::Coverage {
            robots,
            multi_body: true,
            first,
        } => interop::coverage(robots, first),
        Task::Coverage { robots, .. } => cargo::coverage(robots),
        Task::Faults(arguments) => faults::run(&arguments),
        Task::Interop(arguments) => interop::run(&arguments),
        Task::Socketcan => socketcan::run(),
        Task::Fuzz {
            guided: Some(seconds),
            ..
        } => cargo::fuzz_guided(seconds),
        Task::Fuzz { frames, seed, .. } => cargo::fuzz(frames, seed),
        Task::Profile(arguments) => bench::profile::run(&arguments),
        Task::Size { canopen: true, .. } => size_canopen::run(),
        Task::Size { json, board, .. } => bench::size(board, json.as_deref()),
        Task::Bench(arguments) => bench::run(&arguments),
        Task::Flash(arguments) => flash::run(&arguments),
        Task::Release(arguments) => release::run(&arguments),
        Task::Keys(arguments) => release::keys(&arguments),
        Task::CheckElf => firmware::build_all_boards(),
        Task::Web(arguments) => web::run(&arguments),
        Task::CheckDemo { json } => check::demo(&json),
    }?;
    Ok(ExitCode::SUCCESS)
}

fn main() -> ExitCode {
    tasks::exit_code(run(Arguments::parse().task))
}
