//! The `omnibus-sim` command: a simulated group that other programs reach over a bus.
//!
//! `serve` builds the world of a group file, opens its endpoints, prints one line per endpoint when it
//! is ready, and lets time pass until Ctrl-C: as fast as the clock on the wall, or as fast as it can.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use canopen::Micros;
use clap::{Args, Parser, Subcommand, ValueEnum};
use group::{GroupFile, Plant};
use omnibus_sim::endpoint::slcan::SlcanServer;
use omnibus_sim::{Backend, MASTER, Options, World};

/// Virtual time between two looks at the endpoints.
const SLICE: Micros = Micros(500);
/// Further behind the clock on the wall than this, the world gives up catching up.
const LAG: Duration = Duration::from_millis(200);

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
    Serve(Serve),
}

#[derive(Args)]
struct Serve {
    /// The group file.
    group: PathBuf,
    /// What the robots are.
    #[arg(long, value_enum, default_value = "native")]
    backend: BackendName,
    /// The firmware's release image, for emulated robots.
    #[arg(
        long,
        default_value = "target/thumbv7em-none-eabihf/release/omnibus-firmware"
    )]
    elf: PathBuf,
    /// The plant instead of the file's: table, contact, or tcp://HOST:PORT.
    #[arg(long)]
    plant: Option<String>,
    /// Serves slcan here, for example 127.0.0.1:7701; port 0 picks a free one.
    #[arg(long, value_name = "ADDR")]
    slcan_tcp: Option<String>,
    /// Writes every frame into a candump log.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// How fast time passes.
    #[arg(long, value_enum, default_value = "real")]
    speed: Speed,
    /// Seed instead of the file's.
    #[arg(long)]
    seed: Option<u64>,
}

#[derive(Clone, Copy, ValueEnum)]
enum BackendName {
    /// The firmware's control code compiled for this machine.
    Native,
    /// The firmware image on emulated microcontrollers.
    Emulator,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Speed {
    /// As the clock on the wall.
    Real,
    /// As fast as it goes.
    Max,
}

fn main() -> ExitCode {
    let Command::Serve(arguments) = Arguments::parse().command;
    match serve(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn serve(arguments: &Serve) -> anyhow::Result<()> {
    let mut group = GroupFile::load(&arguments.group)?;
    if let Some(plant) = &arguments.plant {
        group.simulation.plant = named_plant(plant)?;
    }
    if let Some(seed) = arguments.seed {
        group.simulation.seed = seed;
    }
    let backend = match arguments.backend {
        BackendName::Native => Backend::Native,
        BackendName::Emulator => Backend::Emulator(
            emulator::Firmware::load(&arguments.elf)
                .with_context(|| format!("cannot load {}", arguments.elf.display()))?,
        ),
    };
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let mut world = World::new(&group, backend, options)?;
    if let Some(path) = &arguments.log {
        let file =
            File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
        world.log_candump(Box::new(BufWriter::new(file)));
    }
    let mut slcan = match &arguments.slcan_tcp {
        Some(address) => {
            let server = SlcanServer::bind(address)
                .with_context(|| format!("cannot listen on {address}"))?;
            println!("slcan-tcp {}", server.address()?);
            Some(server)
        }
        None => None,
    };
    println!("serving {}", group.name);
    std::io::stdout().flush()?;
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    ctrlc::set_handler(move || seen.store(true, Ordering::Relaxed))?;
    let result = run(&mut world, slcan.as_mut(), arguments.speed, &stop);
    world.finish_candump().context("the log is incomplete")?;
    result
}

/// Lets time pass until told to stop.
fn run(
    world: &mut World,
    mut slcan: Option<&mut SlcanServer>,
    speed: Speed,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    let mut began = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        world.run_until(world.now() + SLICE)?;
        // Nobody sits at the master's port here.
        while world.take_received(MASTER).is_some() {}
        if let Some(server) = &mut slcan {
            server.exchange(world);
        }
        if speed == Speed::Real {
            let due = Duration::from_micros(world.now().0);
            let passed = began.elapsed();
            if due > passed {
                std::thread::sleep(due - passed);
            } else if passed - due > LAG {
                began += passed - due;
            }
        }
    }
    Ok(())
}

fn named_plant(name: &str) -> anyhow::Result<Plant> {
    Ok(match name {
        "table" => Plant::Table(group::Tables::Virtual),
        "contact" => Plant::Contact { rollers: 8 },
        _ => match name.strip_prefix("tcp://") {
            Some(address) if address.contains(':') => Plant::External {
                address: address.to_owned(),
            },
            _ => bail!("--plant {name}: give table, contact or tcp://HOST:PORT"),
        },
    })
}
