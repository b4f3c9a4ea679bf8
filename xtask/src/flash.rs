//! Writing the firmware to a board: `probe-rs` does it, through the NUCLEO's own ST-LINK.

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

/// Builds and flashes.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
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
    let elf = firmware::build(Scalar::F32)?;
    let mut command = Command::new("probe-rs");
    command
        .arg(if arguments.log { "run" } else { "download" })
        .args(["--chip", CHIP]);
    if let Some(probe) = &arguments.probe {
        command.args(["--probe", probe]);
    }
    cargo::run(command.arg(&elf))?;
    if !arguments.log {
        let mut reset = Command::new("probe-rs");
        reset.args(["reset", "--chip", CHIP]);
        if let Some(probe) = &arguments.probe {
            reset.args(["--probe", probe]);
        }
        cargo::run(&mut reset)?;
    }
    Ok(())
}
