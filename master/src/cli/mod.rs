//! What the commands share: which bus, which group, and how both are opened.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use ::group::GroupFile;
use anyhow::{Context as _, bail};
use kinematics::Pose;
use omnibus::abort::Abort;
use omnibus::bus::BusAddress;
use omnibus::link::Link;
use omnibus::report::BackendName;
use omnibus::sim_link::SimLink;

pub mod drive;
pub mod follow;
pub mod group;
pub mod nodes;
pub mod param;

/// Where the firmware image is after `cargo xtask size`, from the root of the workspace.
const DEFAULT_ELF: &str = "target/thumbv7em-none-eabihf/release/omnibus-firmware";

/// Which bus, and which group on it.
#[derive(clap::Args)]
pub struct Target {
    /// sim:GROUP.toml, socketcan:INTERFACE, slcan:DEVICE or slcan-tcp://HOST:PORT.
    #[arg(long)]
    pub bus: BusAddress,
    /// Group file; a simulated bus has its own.
    #[arg(long, value_name = "GROUP.toml")]
    group: Option<PathBuf>,
    /// What the robots of a simulated bus run on.
    #[arg(long, value_enum, default_value_t = BackendName::Native)]
    pub backend: BackendName,
    /// Firmware image for emulated robots.
    #[arg(long, value_name = "PATH", default_value = DEFAULT_ELF)]
    elf: PathBuf,
}

impl Target {
    /// Reads the group file.
    pub fn group(&self) -> anyhow::Result<GroupFile> {
        let path = match (&self.bus, &self.group) {
            (BusAddress::Sim(path), None) => path,
            (BusAddress::Sim(_), Some(_)) => {
                bail!("--group is not for a simulated bus, which names its own group file")
            }
            (_, Some(path)) => path,
            (_, None) => bail!(
                "--group GROUP.toml is missing: which robots are on {}?",
                self.bus
            ),
        };
        Ok(GroupFile::load(path)?)
    }

    /// The firmware image, when the robots are emulated ones.
    pub fn elf(&self) -> anyhow::Result<Option<&Path>> {
        if self.backend == BackendName::Native {
            return Ok(None);
        }
        if !self.elf.is_file() {
            bail!(
                "--elf {}: there is no such file; build the firmware with `cargo xtask size`",
                self.elf.display()
            );
        }
        Ok(Some(&self.elf))
    }

    /// Opens the bus. A simulated one is built with freshly booted robots.
    pub fn link(&self, group: &GroupFile) -> anyhow::Result<Box<dyn Link>> {
        match &self.bus {
            BusAddress::Sim(_) => {
                let start = Pose {
                    x: 0.0,
                    y: 0.0,
                    heading: 0.0,
                };
                let world = omnibus::drive::world(group, self.elf()?, start)?;
                Ok(Box::new(SimLink::new(world, self.bus.to_string())))
            }
            real => Ok(Box::new(omnibus::adapter::open(real)?)),
        }
    }
}

/// An abort that Ctrl-C asks for: once ramps down, twice stops at once.
pub fn abort_on_ctrl_c() -> anyhow::Result<Abort> {
    let abort = Abort::default();
    let shared = abort.clone();
    ctrlc::set_handler(move || shared.ask()).context("cannot watch for Ctrl-C")?;
    Ok(abort)
}

/// Prints a line. Unlike `println!` it does not panic when the reader has gone (`omnibus ... | head`).
pub fn say(line: impl std::fmt::Display) -> anyhow::Result<()> {
    writeln!(std::io::stdout().lock(), "{line}")?;
    Ok(())
}

/// Prints a value as JSON.
pub fn print_json(value: &serde_json::Value) -> anyhow::Result<()> {
    say(serde_json::to_string_pretty(value).context("cannot write JSON")?)
}

/// Whether a command only failed because nobody reads its output any more.
pub fn reader_gone(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}
