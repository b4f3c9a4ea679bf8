//! What the simulated robots run: the control code compiled for this machine, or a firmware image.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use anyhow::{anyhow, bail};
use clap::{Args, ValueEnum};
use emulator::Firmware;
use omnibus_sim::Backend;

/// Where `cargo xtask size` leaves the image, from the root of the workspace.
const DEFAULT_ELF: &str = "target/thumbv7em-none-eabihf/release/omnibus-firmware";

/// The options of every command that builds robots.
#[derive(Args)]
pub struct Robots {
    /// Backend of the robots.
    #[arg(long, value_enum, default_value = "native")]
    backend: BackendName,
    /// Firmware image of emulated robots, an ELF file; by default the release image that `cargo
    /// xtask size` builds.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum BackendName {
    /// The firmware's control code compiled for this machine.
    Native,
    /// The firmware image on emulated microcontrollers.
    Emulator,
}

impl Robots {
    /// The image that was named.
    pub fn image(&self) -> Option<(&Path, &'static str)> {
        self.elf.as_deref().map(|path| (path, "the image"))
    }

    /// The backend, with its image.
    ///
    /// # Errors
    /// When the image cannot be loaded, or was given to robots that run none.
    pub fn backend(&self) -> anyhow::Result<Backend> {
        match (self.backend, &self.elf) {
            (BackendName::Native, None) => Ok(Backend::Native),
            (BackendName::Native, Some(elf)) => bail!(
                "--elf {}: native robots run no image; add --backend emulator",
                elf.display()
            ),
            (BackendName::Emulator, elf) => {
                let elf = elf.as_deref().unwrap_or_else(|| Path::new(DEFAULT_ELF));
                let option = format_args!("--elf {}", elf.display());
                Ok(Backend::Emulator(firmware(option, elf)?))
            }
        }
    }
}

/// Loads an image, which an error calls `name`.
pub fn firmware(name: impl Display, elf: &Path) -> anyhow::Result<Firmware> {
    Firmware::load(elf)
        .map_err(|error| anyhow!("{name}: {error}; `cargo xtask size` builds the firmware"))
}
