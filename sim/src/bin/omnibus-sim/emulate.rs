//! `omnibus-sim emulate` runs one robot's image on an emulated board: its log on the terminal, its
//! bus at the endpoints, a trace in a file, a debugger at a port.

use std::io::BufWriter;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::Args;
use group::GroupFile;
use omnibus_sim::{Backend, MASTER, Options, World};

use crate::bench::Bench;
use crate::endpoints::Endpoints;
use crate::gdb;
use crate::output::{create, print_line};
use crate::robots::firmware;
use crate::serve::{LAG, Speed};

/// The robot that is emulated where no group file says otherwise.
const SINGLE: &str = include_str!("../../../../groups/single.toml");

/// Virtual time between two looks at the clock on the wall, ns.
const SLICE_NS: u64 = 1_000_000;

/// Options of `omnibus-sim emulate`.
#[derive(Args)]
#[command(after_help = "Examples:
  omnibus-sim emulate target/thumbv7em-none-eabihf/release/omnibus-firmware
  omnibus-sim emulate ELF --slcan-tcp 127.0.0.1:7701    # then: omnibus scan --bus slcan-tcp://127.0.0.1:7701
  omnibus-sim emulate ELF --trace run.vcd --duration 2 --speed max
  omnibus-sim emulate ELF --gdb 3333                    # then: gdb-multiarch ELF -ex 'target remote :3333'")]
pub struct Emulate {
    /// The firmware image, an ELF file.
    elf: PathBuf,
    /// Group file with one robot, for its motors, encoders and floor; by default
    /// groups/single.toml.
    #[arg(long, value_name = "FILE")]
    group: Option<PathBuf>,
    /// Waits for GDB at this port of this machine, or at HOST:PORT, before the first instruction.
    /// Simulated time stands still while GDB has stopped the core.
    #[arg(long, value_name = "PORT")]
    gdb: Option<String>,
    /// Writes PWM, pins, encoders, CAN frames, exceptions and tasks to a VCD file, which makes the
    /// emulation some six times slower.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    #[command(flatten)]
    endpoints: Endpoints,
    /// Writes every frame to a candump log.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Speed of time; with --gdb always max.
    #[arg(long, value_enum, default_value = "real")]
    speed: Speed,
    /// Ends after this much virtual time, s; by default at Ctrl-C.
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
}

/// Runs until told to stop.
pub fn emulate(arguments: &Emulate) -> anyhow::Result<()> {
    let until_ns = match arguments.duration {
        None => u64::MAX,
        Some(s) if s > 0.0 && s < 1e9 => (s * 1e9).ceil() as u64,
        Some(s) => bail!("--duration {s:?}: give more than 0 s and less than 1e9 s"),
    };
    let group = match &arguments.group {
        Some(path) => GroupFile::load(path)?,
        None => GroupFile::parse("groups/single.toml", SINGLE)?,
    };
    let [robot] = &*group.robots else {
        let robots = group.robots.len();
        bail!(
            "--group: the file has {robots} robots; give one with a single robot, or use omnibus-sim serve"
        );
    };
    let elf = arguments.elf.display();
    let firmware = firmware(&elf, &arguments.elf)?;
    let options = Options {
        truth_period_ns: arguments.endpoints.pose_period_ns()?,
        ..Options::default()
    };
    let mut world = World::new(&group, Backend::Emulator(firmware), options)?;
    world.set_listening(MASTER, false);
    world.set_adapter(arguments.endpoints.adapter(&group)?);
    let endpoints = arguments.endpoints.open(&group)?;
    let debugger = arguments.gdb.as_deref().map(gdb::listen).transpose()?;
    // The files last: a command that is refused replaces none.
    let mut used = vec![(&*arguments.elf, "the image")];
    used.extend(arguments.group.as_deref().map(|it| (it, "the group file")));
    used.extend(arguments.endpoints.inputs());
    let outputs = [
        ("--log", arguments.log.as_deref()),
        ("--trace", arguments.trace.as_deref()),
    ];
    let [log, trace] = create(outputs, used)?;
    if let Some(log) = log {
        world.log_candump(Box::new(BufWriter::new(log)));
    }
    for endpoint in &endpoints {
        print_line(endpoint.announce())?;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    ctrlc::set_handler(move || seen.store(true, Ordering::Relaxed))?;
    let mut bench = Bench::new(world, robot.node, endpoints);
    if let Some(trace) = trace {
        bench.trace(trace)?;
    }
    let result = match &debugger {
        Some(listener) => gdb::serve(&mut bench, listener, until_ns, &stop),
        None => run(&mut bench, arguments.speed, until_ns, &stop),
    };
    bench.finish()?;
    result
}

fn run(bench: &mut Bench, speed: Speed, until_ns: u64, stop: &AtomicBool) -> anyhow::Result<()> {
    print_line(format_args!("node {}", bench.node))?;
    let mut began = Instant::now();
    while bench.world.now_ns() < until_ns && !stop.load(Ordering::Relaxed) {
        let left = until_ns - bench.world.now_ns();
        bench.advance(left.min(SLICE_NS))?;
        let due = Duration::from_nanos(bench.world.now_ns());
        if speed == Speed::Real {
            let passed = began.elapsed();
            std::thread::sleep(due.saturating_sub(passed));
            let late = passed.saturating_sub(due);
            if late > LAG {
                began += late;
            }
        }
    }
    Ok(())
}
