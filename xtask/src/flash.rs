//! Writing the firmware to a board: `probe-rs` does it, through the NUCLEO's own ST-LINK.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::bail;

use omnibus::report::Scalar;

use crate::{cargo, firmware};

/// The chip of the reference board, as probe-rs names it.
const CHIP: &str = "STM32F446RETx";

/// Options of `cargo xtask flash`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Serial number of the probe, when several are connected (`probe-rs list`).
    #[arg(long)]
    probe: Option<String>,
    /// Stays connected and prints the firmware's log.
    #[arg(long)]
    log: bool,
}

/// A debug probe, by way of `probe-rs`.
pub struct Probe {
    /// Serial number, when several are connected.
    serial: Option<String>,
}

impl Probe {
    /// Looks whether `probe-rs` is there; the probe is looked for when it is needed.
    ///
    /// # Errors
    /// When `probe-rs` is not installed.
    pub fn new(serial: Option<String>) -> anyhow::Result<Self> {
        let found = Command::new("probe-rs")
            .arg("--version")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if !found.is_ok_and(|status| status.success()) {
            bail!(
                "probe-rs is not installed. Install it with one of\n  \
                 cargo install probe-rs-tools --locked\n  \
                 curl -LsSf https://github.com/probe-rs/probe-rs/releases/latest/download/probe-rs-tools-installer.sh | sh\n\
                 and, on Linux, its udev rules: https://probe.rs/docs/getting-started/probe-setup/"
            );
        }
        Ok(Self { serial })
    }

    /// The arguments of `probe-rs` for one of its commands.
    fn arguments(&self, command: &str) -> Vec<String> {
        let mut arguments = [command, "--chip", CHIP].map(str::to_owned).to_vec();
        if let Some(serial) = &self.serial {
            arguments.extend(["--probe".to_owned(), serial.clone()]);
        }
        arguments
    }

    /// Writes an image and starts it.
    ///
    /// # Errors
    /// When no probe is found, or the chip does not answer.
    pub fn write(&self, elf: &Path) -> anyhow::Result<()> {
        let mut download = Command::new("probe-rs");
        cargo::run(download.args(self.arguments("download")).arg(elf))?;
        cargo::run(Command::new("probe-rs").args(self.arguments("reset")))
    }
}

/// Builds and flashes.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let probe = Probe::new(arguments.probe.clone())?;
    let elf = firmware::build(Scalar::F32)?;
    if !arguments.log {
        return probe.write(&elf);
    }
    let mut command = Command::new("probe-rs");
    cargo::run(command.args(probe.arguments("run")).arg(&elf))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probe_rs_is_given_chip_and_probe() {
        let probe = |serial: Option<&str>| Probe {
            serial: serial.map(str::to_owned),
        };
        assert_eq!(
            probe(None).arguments("download"),
            ["download", "--chip", "STM32F446RETx"]
        );
        assert_eq!(
            probe(Some("066B")).arguments("reset"),
            ["reset", "--chip", "STM32F446RETx", "--probe", "066B"]
        );
    }
}
