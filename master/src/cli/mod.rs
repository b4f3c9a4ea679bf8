//! What the commands share: which bus, which group, and how both are opened.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use ::group::GroupFile;
use anyhow::{Context as _, bail};
use canopen::Micros;
use clap::ArgMatches;
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use omnibus::abort::Abort;
use omnibus::bus::address::BusAddress;
use omnibus::bus::foreign;
use omnibus::bus::link::Link;
use omnibus::bus::wire::Wire;
use omnibus::error::MasterError;
use omnibus::monitor::rows::Slowdown;
use omnibus::pilot::Pilot;
use omnibus::recording::Header;
use omnibus::report::BackendName;
use omnibus::run::DriveError;
use omnibus::session::Group;
#[cfg(feature = "simulation")]
use omnibus::simulation::{self, link::SimLink};
use protocol::Limit;

/// Ends a function with [`Usage`]: the call is wrong, which its arguments alone show.
macro_rules! usage {
    ($($message:tt)*) => {
        return Err($crate::cli::Usage(format!($($message)*)).into())
    };
}

pub mod accept;
pub mod bridge;
pub mod bus_load;
pub mod calibrate;
mod communication;
pub mod completions;
pub mod convert;
pub mod drive;
pub mod follow;
pub mod group;
mod input;
pub mod live;
pub mod lock;
pub mod lss;
pub mod motors;
pub mod nodes;
pub mod output;
pub mod param;
pub mod param_file;
mod param_text;
pub mod plot;
pub mod record;
pub mod recorder;
pub mod replay;
pub mod reset;
#[cfg(feature = "ros")]
pub mod ros;
pub mod serve;
pub mod update;
#[cfg(feature = "vda5050")]
pub mod vda5050;
pub mod wheel_test;

pub use output::{Usage, json, print_json, print_json_line, print_line, print_note, quiet};

/// Where the firmware image is after `cargo xtask size`, from the root of the workspace.
const DEFAULT_ELF: &str = "target/thumbv7em-none-eabihf/release/omnibus-firmware";

/// When simulated robots have said that they are there.
#[cfg(feature = "simulation")]
const BOOTED: Micros = Micros(100_000);

/// A command that this build lacks, with any arguments.
#[cfg(not(all(feature = "ros", feature = "vda5050")))]
#[derive(clap::Args)]
pub struct NotBuilt {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<std::ffi::OsString>,
}

#[cfg(not(all(feature = "ros", feature = "vda5050")))]
impl NotBuilt {
    /// Says what installs it.
    pub fn refuse(self, feature: &str) -> anyhow::Result<()> {
        drop(self.arguments);
        usage!(
            "omnibus {feature} is not in this program; `cargo install --profile dev --locked --path \
             master --features {feature}` installs it (docs/{feature}.md)"
        )
    }
}

/// Which bus, and which group on it.
pub struct Target {
    pub bus: BusAddress,
    group: Option<PathBuf>,
    /// Not an argument with a variable of its own: a simulated bus goes before the variable, but
    /// contradicts another file that is typed.
    usual_group: Option<PathBuf>,
    /// The firmware image of the robots on a simulated bus, which without one are native.
    elf: Option<PathBuf>,
    pub force: bool,
}

/// [`Target`], as it is typed.
#[derive(clap::Args)]
struct TargetOptions {
    /// auto (the adapter or robot that is plugged in), sim:GROUP.toml, socketcan:INTERFACE,
    /// slcan:DEVICE, slcan-tcp://HOST:PORT or socketcand://HOST:PORT/INTERFACE; omnibus-sim serves
    /// lockstep://HOST:PORT.
    #[arg(
        long,
        help_heading = "Bus",
        env = "OMNIBUS_BUS",
        hide_env_values = true
    )]
    bus: BusAddress,
    /// Group file, or the environment variable OMNIBUS_GROUP; a simulated bus names its own.
    #[arg(long, help_heading = "Bus", value_name = "GROUP.toml")]
    group: Option<PathBuf>,
    /// Backend of the robots on a simulated bus.
    #[arg(long, help_heading = "Bus", value_enum, default_value_t = BackendName::Native)]
    backend: BackendName,
    /// Firmware image for emulated robots, or a folder with images (*.elf) for their boards; by
    /// default the release image that `cargo xtask size` builds.
    #[arg(long, help_heading = "Bus", value_name = "PATH")]
    elf: Option<PathBuf>,
    /// Commands the robots even if another master is on the bus.
    #[arg(long, help_heading = "Bus")]
    force: bool,
}

impl TargetOptions {
    /// The firmware image of the robots, unless an option is there that would do nothing.
    fn elf(&self, is_backend_typed: bool) -> Result<Option<PathBuf>, String> {
        let elf = self.elf.as_ref();
        if !matches!(self.bus, BusAddress::Sim(_)) {
            let typed = match elf {
                Some(elf) => format!("--elf {}", elf.display()),
                None if is_backend_typed => format!("--backend {}", self.backend),
                None => return Ok(None),
            };
            return Err(format!(
                "{typed}: what robots run is chosen on a simulated bus (sim:GROUP.toml) only; \
                 leave it out with {}",
                self.bus
            ));
        }
        match (self.backend, elf) {
            (BackendName::Emulator, elf) => {
                Ok(Some(elf.cloned().unwrap_or_else(|| DEFAULT_ELF.into())))
            }
            (_, None) => Ok(None),
            (_, Some(elf)) => Err(format!(
                "--elf {}: native robots run no image; add --backend emulator",
                elf.display()
            )),
        }
    }
}

impl clap::Args for Target {
    fn augment_args(command: clap::Command) -> clap::Command {
        TargetOptions::augment_args(command)
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        TargetOptions::augment_args_for_update(command)
    }
}

impl clap::FromArgMatches for Target {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let options = TargetOptions::from_arg_matches(matches)?;
        let backend = matches.value_source("backend");
        let elf = options
            .elf(backend == Some(ValueSource::CommandLine))
            .map_err(|problem| clap::Error::raw(ErrorKind::ArgumentConflict, problem))?;
        Ok(Self {
            bus: options.bus,
            group: options.group,
            usual_group: std::env::var_os("OMNIBUS_GROUP").map(PathBuf::from),
            elf,
            force: options.force,
        })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Target {
    /// Reads the group file.
    pub fn group(&self) -> anyhow::Result<GroupFile> {
        match self.group_if_any()? {
            Some(group) => Ok(group),
            None => usage!(
                "--group GROUP.toml is missing; it says which robots are on {}",
                self.bus
            ),
        }
    }

    /// Reads the group file, if one was given: commands that need to know no group go without.
    pub fn group_if_any(&self) -> anyhow::Result<Option<GroupFile>> {
        let path = match (&self.bus, &self.group) {
            (BusAddress::Sim(path), None) => path,
            (BusAddress::Sim(own), Some(path)) if !is_same(own, path) => usage!(
                "--group {}: a simulated bus uses the group file in its address, {}",
                path.display(),
                own.display()
            ),
            (BusAddress::Sim(path), Some(_)) => path,
            (_, Some(path)) => path,
            (_, None) => match &self.usual_group {
                Some(path) => path,
                None => return Ok(None),
            },
        };
        Ok(Some(GroupFile::load(path)?))
    }

    /// Where the group file is.
    pub fn group_path(&self) -> anyhow::Result<&Path> {
        match (&self.bus, &self.group, &self.usual_group) {
            (BusAddress::Sim(path), ..) | (_, Some(path), _) | (_, None, Some(path)) => Ok(path),
            _ => usage!("--group GROUP.toml is missing"),
        }
    }

    /// Refuses an output that would replace the group file or the image in use, or that cannot be
    /// written: before anything moves, whose result would be lost. `option` is what names it.
    pub fn check_output(&self, option: &str, output: &Path) -> anyhow::Result<()> {
        if let Ok(group) = self.group_path() {
            refuse_input(option, output, group, "the group file in use")?;
        }
        if let Some(elf) = &self.elf {
            refuse_input(option, output, elf, "the image in use")?;
        }
        check_writable(option, output)
    }

    /// Opens the bus for a command that needs to know no group.
    pub fn link_if_any(&self, group: Option<&GroupFile>) -> anyhow::Result<Box<dyn Link>> {
        match (&self.bus, group) {
            (BusAddress::Sim(_), Some(group)) => self.link(group),
            (BusAddress::Sim(_), None) => self.link(&self.group()?),
            (real, _) => Ok(omnibus::bus::adapter::open(real)?),
        }
    }

    /// Opens the bus to change something on it, unless another master commands it.
    pub fn exclusive(&self) -> anyhow::Result<Wire<Box<dyn Link>>> {
        let group = self.group_if_any()?;
        let mut link = self.link_if_any(group.as_ref())?;
        self.refuse_foreign(&mut link)?;
        Ok(Wire::visiting(link))
    }

    /// Opens the bus without claiming to be its master.
    pub fn visit(&self) -> anyhow::Result<Wire<Box<dyn Link>>> {
        let group = self.group_if_any()?;
        Ok(Wire::visiting(self.link_if_any(group.as_ref())?))
    }

    /// What is known about a recording of this bus, whose link has `now` on its clock.
    pub fn header(&self, activity: &str, now: Micros) -> anyhow::Result<Header> {
        let group = match self.group_path() {
            Ok(path) => Some(input::text(path, "the path of a group file")?),
            Err(_) => None,
        };
        // A simulated bus begins at 0 every time, so that the same drive is the same file.
        let epoch_ns = match &self.bus {
            BusAddress::Sim(_) => 0,
            _ => {
                let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?;
                u64::try_from(since_1970.as_nanos())?.saturating_sub(now.0 * 1_000)
            }
        };
        Ok(Header {
            bus: self.bus.to_string(),
            activity: activity.into(),
            group,
            epoch_ns,
        })
    }

    /// What the robots run on.
    pub fn backend(&self) -> BackendName {
        match (&self.bus, &self.elf) {
            (BusAddress::Sim(_), Some(_)) => BackendName::Emulator,
            (BusAddress::Sim(_), None) => BackendName::Native,
            _ => BackendName::Robots,
        }
    }

    /// The firmware image, when the robots are emulated ones.
    pub fn elf(&self) -> anyhow::Result<Option<&Path>> {
        let elf = self.elf.as_deref();
        if let Some(elf) = elf.filter(|elf| !elf.exists()) {
            bail!(
                "--elf {}: there is no such file; build the firmware with `cargo xtask size`",
                elf.display()
            );
        }
        Ok(elf)
    }

    /// Opens the bus for a command that only listens: the group file is optional.
    pub fn link_alone(&self) -> anyhow::Result<Box<dyn Link>> {
        match &self.bus {
            BusAddress::Sim(_) => self.link(&self.group()?),
            real => Ok(omnibus::bus::adapter::open(real)?),
        }
    }

    /// Builds the simulated world that this bus is, with freshly booted robots.
    #[cfg(feature = "simulation")]
    pub fn simulated(&self, group: &GroupFile) -> anyhow::Result<SimLink> {
        let elf = self.elf()?;
        Ok(simulation::open(group, elf, self.bus.to_string())?)
    }

    /// Launches a pilot, which opens the bus in its own thread; a simulated one keeps the time of
    /// the clock on the wall.
    pub fn pilot(&self, group: &GroupFile) -> anyhow::Result<Pilot> {
        let (bus, file) = (self.bus.clone(), group.clone());
        #[cfg(feature = "simulation")]
        let elf = self.elf()?.map(Path::to_path_buf);
        let open = move || -> Result<Box<dyn Link>, DriveError> {
            #[cfg(feature = "simulation")]
            if let BusAddress::Sim(_) = &bus {
                let link = simulation::open(&file, elf.as_deref(), bus.to_string())?;
                return Ok(Box::new(link.in_real_time()));
            }
            omnibus::bus::open(&bus, &file)
        };
        Ok(Pilot::launch(open, group.clone()))
    }

    /// Opens the bus to command the robots on it, unless another master does.
    pub fn command(&self, group: &GroupFile) -> anyhow::Result<Box<dyn Link>> {
        let mut link = self.link(group)?;
        self.refuse_foreign(&mut link)?;
        Ok(link)
    }

    /// Refuses a bus that another master commands. A simulated one has no other master.
    pub fn refuse_foreign(&self, link: &mut Box<dyn Link>) -> anyhow::Result<()> {
        if matches!(self.bus, BusAddress::Sim(_)) {
            return Ok(());
        }
        match foreign::look(link)? {
            Some(sign) if self.force => {
                print_note(format!(
                    "{}: another master is on the bus (received: {sign}); --force takes its robots",
                    self.bus
                ));
                Ok(())
            }
            Some(sign) => Err(MasterError::AnotherMaster(sign).into()),
            None => Ok(()),
        }
    }

    /// Opens the bus. A simulated one is built with freshly booted robots.
    pub fn link(&self, group: &GroupFile) -> anyhow::Result<Box<dyn Link>> {
        match &self.bus {
            #[cfg(feature = "simulation")]
            BusAddress::Sim(_) => {
                let mut link = self.simulated(group)?;
                // On a real bus the robots have long been there.
                link.world.run_until(BOOTED)?;
                Ok(Box::new(link))
            }
            real => Ok(omnibus::bus::open(real, group)?),
        }
    }
}

/// Refuses to write to a file that the command reads; `what` says which one that is.
pub fn refuse_input(option: &str, output: &Path, input: &Path, what: &str) -> anyhow::Result<()> {
    // A terminal is in and out; only an ordinary file would be lost.
    if output.is_file() && is_same(output, input) {
        usage!(
            "{option} {}: this is {what}, which would be replaced; give another file",
            output.display()
        );
    }
    Ok(())
}

/// Refuses a file that cannot be written.
pub fn check_writable(option: &str, output: &Path) -> anyhow::Result<()> {
    omnibus::file::check(output)
        .with_context(|| format!("{option} {}: cannot be written", output.display()))
}

/// Refuses to write to one file for two options.
pub fn refuse_shared(outputs: &[(&str, &Path)]) -> anyhow::Result<()> {
    for (n, (option, path)) in outputs.iter().enumerate() {
        let mut others = outputs[..n].iter();
        if let Some((other, _)) = others.find(|(_, it)| is_same(it, path))
            // A terminal can show both.
            && (path.is_file() || !path.exists())
        {
            usage!(
                "{option} {}: {other} writes this file, too; give another one",
                path.display()
            );
        }
    }
    Ok(())
}

/// Whether two paths lead to one file, which need not be there yet.
fn is_same(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| {
        path.canonicalize().or_else(|error| {
            let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
                return Err(error);
            };
            Ok(Path::new(".").join(folder).canonicalize()?.join(name))
        })
    };
    a == b || matches!((place(a), place(b)), (Ok(a), Ok(b)) if a == b)
}

/// The largest number of an option: no message has to print a longer one.
const LARGEST: f64 = 1e6;

/// A number of an option: not "nan", which passes every comparison it should fail, and not "inf".
pub fn real<T: std::str::FromStr + Copy + Into<f64>>(text: &str) -> Result<T, String> {
    match text.parse::<T>() {
        Ok(number) if number.into().abs() <= LARGEST => Ok(number),
        // Perhaps infinity to the type, but a number as written.
        Ok(_) if text.contains(|letter: char| letter.is_ascii_digit()) => {
            Err(format!("`{text}` is too large a number"))
        }
        _ => Err(format!("`{text}` is not a number; give one such as 0.5")),
    }
}

/// The node of a robot.
pub fn robot(text: &str) -> Result<u8, String> {
    let node = text.parse().ok().filter(|node| protocol::is_robot(*node));
    node.ok_or_else(|| "robots are nodes 2 to 17".to_owned())
}

/// An abort that Ctrl-C asks for: once ramps down, twice stops at once.
pub fn abort_on_ctrl_c() -> anyhow::Result<Abort> {
    let abort = Abort::default();
    let shared = abort.clone();
    ctrlc::set_handler(move || shared.ask()).context("cannot watch for Ctrl-C")?;
    Ok(abort)
}

/// A configured group for the commissioning of one of its robots, and the abort that Ctrl-C asks
/// for. It is watched for from the beginning, and a configuration that has begun is completed, so
/// that all robots are configured or none.
pub fn configured(
    target: &Target,
    file: &GroupFile,
) -> anyhow::Result<(Group<Box<dyn Link>>, Abort)> {
    let abort = abort_on_ctrl_c()?;
    let mut group = Group::connect(target.command(file)?, file)?;
    abort.check()?;
    group.configure(true)?;
    abort.check()?;
    Ok((group, abort))
}

/// Says how punctual SYNC was on a bus in real time, and how to permit real-time priority where
/// that would have helped.
pub fn note_punctuality(group: &Group<impl Link>) {
    if let Some(sync) = group.punctuality().filter(|sync| sync.count > 0) {
        print_note(sync);
    }
}

/// Says that a group ran slower than it was asked to, and because of whom.
pub fn print_slowdown(slowed: Option<Slowdown>, group: &GroupFile) {
    let Some(Slowdown {
        scale,
        member,
        limit,
    }) = slowed
    else {
        return;
    };
    let node = group.robots.get(member).map_or(0, |robot| robot.node);
    let limit = limit.map_or("the wheels", Limit::name);
    print_note(format!(
        "The group was slowed down to {:.0} % of the commanded velocity: {limit} of node {node}.",
        100.0 * scale
    ));
}

/// How punctual SYNC was, as JSON.
pub fn sync_json(punctuality: &omnibus::bus::punctuality::Punctuality) -> serde_json::Value {
    serde_json::json!({"count": punctuality.count, "mean_us": punctuality.mean_us,
        "p99_us": punctuality.p99_us, "worst_us": punctuality.worst_us, "missed": punctuality.missed})
}
