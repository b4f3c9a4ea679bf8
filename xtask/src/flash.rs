//! Writing the firmware to a board: `probe-rs` does it, through the NUCLEO's own ST-LINK or the
//! probe at another board's connector.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::bail;

use crate::firmware::Board;
use crate::{cargo, firmware};

/// Options of `cargo xtask flash`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Board that is connected.
    #[arg(long, value_enum, default_value_t)]
    board: Board,
    /// Serial number of the probe, when several are connected (`probe-rs list`).
    #[arg(long)]
    probe: Option<String>,
    /// Stays connected and prints the firmware's log.
    #[arg(long)]
    log: bool,
}

/// A debug probe, by way of `probe-rs`.
#[derive(Clone)]
pub struct Probe {
    board: Board,
    /// Serial number, when several are connected.
    serial: Option<String>,
}

impl Probe {
    /// Looks whether `probe-rs` is there; the probe is looked for when it is needed.
    ///
    /// # Errors
    /// When `probe-rs` is not installed.
    pub fn new(board: Board, serial: Option<String>) -> anyhow::Result<Self> {
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
        Ok(Self { board, serial })
    }

    /// The arguments of `probe-rs` for one of its commands.
    fn arguments(&self, command: &str) -> Vec<String> {
        let mut arguments = [command, "--chip", self.board.chip()]
            .map(str::to_owned)
            .to_vec();
        if let Some(serial) = &self.serial {
            arguments.extend(["--probe".to_owned(), serial.clone()]);
        }
        arguments
    }

    /// Reads words while the program runs.
    ///
    /// # Errors
    /// As [`Probe::write`].
    pub fn read(&self, address: u32, words: usize) -> anyhow::Result<Vec<u32>> {
        let mut read = Command::new("probe-rs");
        read.args(self.arguments("read"));
        read.args(["b32", &format!("{address:#x}"), &words.to_string()]);
        let output = read.stderr(Stdio::inherit()).output()?;
        if !output.status.success() {
            bail!("probe-rs cannot read {words} words at {address:#010x}");
        }
        words_of(&String::from_utf8_lossy(&output.stdout), words)
    }

    /// Writes a word while the program runs.
    ///
    /// # Errors
    /// As [`Probe::write`].
    pub fn poke(&self, address: u32, word: u32) -> anyhow::Result<()> {
        let mut write = Command::new("probe-rs");
        write.args(self.arguments("write"));
        cargo::run(write.args(["b32", &format!("{address:#x}"), &format!("{word:#x}")]))
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

/// The words that `probe-rs read` prints: hexadecimal, separated by spaces or lines.
fn words_of(text: &str, words: usize) -> anyhow::Result<Vec<u32>> {
    let read: Result<Vec<u32>, _> = text
        .split_whitespace()
        .map(|word| u32::from_str_radix(word.trim_start_matches("0x"), 16))
        .collect();
    match read {
        Ok(read) if read.len() == words => Ok(read),
        _ => bail!("probe-rs printed something else than {words} words: {text:.80}"),
    }
}

/// Builds and flashes.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let probe = Probe::new(arguments.board, arguments.probe.clone())?;
    let elf = firmware::build_for(arguments.board)?;
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
        let probe = |board, serial: Option<&str>| Probe {
            board,
            serial: serial.map(str::to_owned),
        };
        assert_eq!(
            probe(Board::NucleoF446re, None).arguments("download"),
            ["download", "--chip", "STM32F446RETx"]
        );
        assert_eq!(
            probe(Board::RobomasterC, Some("066B")).arguments("reset"),
            ["reset", "--chip", "STM32F407IGHx", "--probe", "066B"]
        );
    }
}
