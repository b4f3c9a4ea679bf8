//! `omnibus-sim serve` builds the world of a group file, opens its endpoints, prints one line per
//! endpoint when it is ready, and lets time pass until Ctrl-C: as fast as the clock on the wall, or
//! as fast as it can.

use std::io::BufWriter;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use canopen::Micros;
use clap::{Args, ValueEnum};
use group::{GroupFile, Plant};
use omnibus_sim::endpoint::Endpoint;
use omnibus_sim::{Backend, MASTER, Options, World};

use crate::endpoints::Endpoints;
use crate::faults::Faults;
use crate::output::{create, print_line, print_note};
use crate::robots::Robots;

/// Virtual time between two looks at the endpoints.
const SLICE: Micros = Micros(500);
/// Further behind the clock on the wall than this, the world gives up catching up.
pub const LAG: Duration = Duration::from_millis(200);
/// Further behind than this, robots and master may miss each other's frames: it is said.
const LATE: Duration = Duration::from_millis(10);
/// Further behind than this, frames have come together that were sent apart.
const BUNCHED: Duration = Duration::from_millis(2);
/// How often it is said at most.
const REPORT_EVERY: Duration = Duration::from_secs(1);
/// While an endpoint holds the time, how often the others are asked.
pub const HELD: Duration = Duration::from_millis(1);

/// Options of `omnibus-sim serve`.
#[derive(Args)]
#[command(after_help = "Examples:
  omnibus-sim serve groups/tcc-2.toml --lockstep 127.0.0.1:7701 --pose-tcp 127.0.0.1:7702
  omnibus-sim serve groups/tcc-3.toml --slcan-tcp 127.0.0.1:7701 --fault t=5:node=3:power-cycle
  omnibus-sim serve groups/tcc-3.toml --log bus.log --duration 2 --speed max")]
pub struct Serve {
    /// The group file.
    group: PathBuf,
    #[command(flatten)]
    robots: Robots,
    /// Plant to use instead of the group file's: table, contact, or tcp://HOST:PORT.
    #[arg(long)]
    plant: Option<String>,
    #[command(flatten)]
    endpoints: Endpoints,
    /// Writes every frame to a candump log.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Speed of time.
    #[arg(
        long,
        value_enum,
        default_value = "real",
        env = "OMNIBUS_SIM_SPEED",
        hide_env_values = true
    )]
    speed: Speed,
    /// Ends after this much virtual time, s; by default at Ctrl-C.
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Seed to use instead of the group file's.
    #[arg(long)]
    seed: Option<u64>,
    /// Injects a fault, for example t=5:node=3:power-cycle. May be repeated; a single - reads more
    /// of them from standard input, one per line. docs/simulation.md lists them.
    #[arg(long, value_name = "SPEC")]
    fault: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Speed {
    /// Real time.
    Real,
    /// As fast as possible.
    Max,
}

/// Serves until told to stop.
pub fn serve(arguments: &Serve) -> anyhow::Result<()> {
    let mut group = GroupFile::load(&arguments.group)?;
    if let Some(plant) = &arguments.plant {
        group.simulation.plant = named_plant(plant, &group.simulation.plant)?;
    }
    if let Some(seed) = arguments.seed {
        group.simulation.seed = seed;
    }
    let backend = arguments.robots.backend()?;
    let options = Options {
        truth_period_ns: arguments.endpoints.pose_period_ns()?,
        ..Options::default()
    };
    let until = end(arguments.duration)?;
    let has_processor = matches!(backend, Backend::Emulator(_));
    if arguments.endpoints.need_processors() && !has_processor {
        bail!(
            "--cable and --lockstep ADDR@NODE: only emulated robots have a serial port; add \
             --backend emulator"
        );
    }
    let mut faults = Faults::new(&group, has_processor, &arguments.fault)?;
    let mut world = World::new(&group, backend, options)?;
    // The master's own port is not used here.
    world.set_listening(MASTER, false);
    world.set_adapter(arguments.endpoints.adapter(&group)?);
    let mut endpoints = arguments.endpoints.open(&group)?;
    if endpoints.is_empty() && arguments.duration.is_none() && arguments.log.is_none() {
        bail!(
            "no program could reach these robots; give an endpoint, for example --lockstep \
             127.0.0.1:7701, or --duration or --log to run without clients"
        );
    }
    // Last: a command that is refused replaces no file.
    let mut used = vec![(&*arguments.group, "the group file")];
    used.extend(arguments.robots.image());
    used.extend(arguments.endpoints.inputs());
    if let [Some(file)] = create([("--log", arguments.log.as_deref())], used)? {
        world.log_candump(Box::new(BufWriter::new(file)));
    }
    // A signal ends at once what waits for files and programs up to here.
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    ctrlc::set_handler(move || seen.store(true, Ordering::Relaxed))?;
    for endpoint in &endpoints {
        print_line(endpoint.announce())?;
    }
    print_line(format_args!("serving {}", group.name))?;
    let pace = Pace {
        speed: arguments.speed,
        until,
        stop: &stop,
    };
    let result = run(&mut world, &mut endpoints, &mut faults, &pace);
    world.finish_candump().context("the log is incomplete")?;
    result
}

/// How fast time passes, and until when.
struct Pace<'a> {
    speed: Speed,
    until: Micros,
    stop: &'a AtomicBool,
}

/// Lets time pass until told to stop.
fn run(
    world: &mut World,
    endpoints: &mut [Box<dyn Endpoint>],
    faults: &mut Faults<'_>,
    pace: &Pace<'_>,
) -> anyhow::Result<()> {
    let mut began = Instant::now();
    let mut behind = Behind::default();
    while world.now() < pace.until && !pace.stop.load(Ordering::Relaxed) {
        for endpoint in &mut *endpoints {
            endpoint
                .exchange(world)
                .with_context(|| format!("{} is lost", endpoint.announce()))?;
        }
        faults.listen(world.now_ns());
        let now = world.now();
        let limit = endpoints.iter().filter_map(|one| one.limit(now)).min();
        if pace.speed == Speed::Real && limit.is_none() {
            let lag = began.elapsed().saturating_sub(Duration::from_micros(now.0));
            if lag > BUNCHED {
                world.spread_queued(lag.min(LAG).as_nanos() as u64);
            }
        }
        let to = limit.map_or(now + SLICE, |limit| limit.min(now + SLICE));
        let to = to.min(pace.until);
        if to <= now {
            let mut all = endpoints.iter();
            if let Some(held) = all.find(|one| one.limit(now).is_some_and(|to| to <= now)) {
                let listeners = endpoints.iter().filter_map(|one| one.listener());
                held.wait(&listeners.collect::<Vec<_>>(), HELD);
            }
            continue;
        }
        faults.run(world, to.0 * 1_000)?;
        if pace.speed == Speed::Real {
            let due = Duration::from_micros(world.now().0);
            let passed = began.elapsed();
            if due > passed {
                std::thread::sleep(due - passed);
                behind.caught_up();
                continue;
            }
            // Where time waits, nothing is late.
            if limit.is_none() {
                behind.record(passed - due);
            }
            if passed - due > LAG {
                began += passed - due;
            }
        }
    }
    behind.sum_up();
    Ok(())
}

/// Says that this machine is too slow for real time: otherwise people look for faults in the bus.
#[derive(Default)]
struct Behind {
    /// Worst lag of the stall that is going on.
    stall: Duration,
    stalls: u64,
    worst: Duration,
    reported: Option<Instant>,
}

impl Behind {
    fn record(&mut self, lag: Duration) {
        if lag < LATE {
            return;
        }
        if self.stall.is_zero() {
            self.stalls += 1;
        }
        self.stall = self.stall.max(lag);
        self.worst = self.worst.max(lag);
        if self
            .reported
            .is_none_or(|reported| reported.elapsed() > REPORT_EVERY)
        {
            self.reported = Some(Instant::now());
            print_note(format_args!(
                "fell behind the clock by {} ms: this computer is too busy, and a master may lose \
                 contact with robots; --lockstep makes time wait instead",
                lag.as_millis()
            ));
        }
    }

    fn caught_up(&mut self) {
        self.stall = Duration::ZERO;
    }

    fn sum_up(&self) {
        if self.stalls > 0 {
            let (stalls, worst) = (self.stalls, self.worst.as_millis());
            let times = if stalls == 1 { "time" } else { "times" };
            print_note(format_args!(
                "fell behind the clock {stalls} {times}, by {worst} ms at most"
            ));
        }
    }
}

fn end(duration: Option<f64>) -> anyhow::Result<Micros> {
    match duration {
        None => Ok(Micros(u64::MAX / 1_000)),
        // Some centuries fit.
        Some(s) if s > 0.0 && s < 1e9 => Ok(Micros((s * 1e6).ceil() as u64)),
        Some(s) => bail!("--duration {s:?}: give more than 0 s and less than 1e9 s"),
    }
}

/// The plant of this name; what the file says about one of that kind stays.
fn named_plant(name: &str, of_file: &Plant) -> anyhow::Result<Plant> {
    Ok(match (name, of_file) {
        ("table", Plant::Table(_)) | ("contact", Plant::Contact { .. }) => of_file.clone(),
        ("table", _) => Plant::Table(group::Tables::Virtual),
        ("contact", _) => Plant::Contact { rollers: 8 },
        _ => match name.strip_prefix("tcp://") {
            Some(address) if address.contains(':') => Plant::External {
                address: address.to_owned(),
            },
            _ => bail!("--plant {name}: give table, contact or tcp://HOST:PORT"),
        },
    })
}
