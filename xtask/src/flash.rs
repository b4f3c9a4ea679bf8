//! Writing the firmware to a board: `probe-rs` does it, through the NUCLEO's own ST-LINK or the
//! probe at another board's connector.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, bail};

use crate::firmware::Board;
use crate::{cargo, firmware};

/// The program.
const PROGRAM: &str = "probe-rs";
/// What to look at when `probe-rs` has failed.
const REMEDY: &str = "is there a probe, and a chip behind it? Connect the NUCLEO's own USB socket \
     (CN1; of another board its debug probe), switch the board on, and end every other program that \
     uses the probe; `probe-rs list` shows the probes. With several, give the serial number of one; \
     with none, `cargo xtask accept` without --probe asks you to write the images yourself";

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
    program: PathBuf,
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
        Self::with(PROGRAM.into(), board, serial)
    }

    /// The same with another program.
    fn with(program: PathBuf, board: Board, serial: Option<String>) -> anyhow::Result<Self> {
        let found = Command::new(&program)
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
        Ok(Self {
            program,
            board,
            serial,
        })
    }

    /// `probe-rs` with one of its commands.
    fn command(&self, command: &str) -> Command {
        let mut started = Command::new(&self.program);
        started.args(self.arguments(command));
        started
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
        let mut read = self.command("read");
        read.args(["b32", &format!("{address:#x}"), &words.to_string()]);
        let output = read.stderr(Stdio::inherit()).output()?;
        if !output.status.success() {
            bail!("probe-rs cannot read {words} words at {address:#010x}: {REMEDY}");
        }
        words_of(&String::from_utf8_lossy(&output.stdout), words)
    }

    /// Writes a word while the program runs.
    ///
    /// # Errors
    /// As [`Probe::write`].
    pub fn poke(&self, address: u32, word: u32) -> anyhow::Result<()> {
        let mut write = self.command("write");
        let arguments = ["b32", &format!("{address:#x}"), &format!("{word:#x}")];
        cargo::run(write.args(arguments)).context(REMEDY)
    }

    /// Writes an image and starts it.
    ///
    /// # Errors
    /// When no probe is found, or the chip does not answer.
    pub fn write(&self, elf: &Path) -> anyhow::Result<()> {
        cargo::run(self.command("download").arg(elf)).context(REMEDY)?;
        cargo::run(&mut self.command("reset")).context(REMEDY)
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
        _ => bail!("probe-rs printed something other than {words} words: {text:.80}"),
    }
}

/// Builds and flashes.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let probe = Probe::new(arguments.board, arguments.probe.clone())?;
    let elf = firmware::build_for(arguments.board)?;
    if !arguments.log {
        return probe.write(&elf);
    }
    cargo::run(probe.command("run").arg(&elf))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probe_rs_is_given_chip_and_probe() {
        let probe = |board, serial: Option<&str>| Probe {
            program: PROGRAM.into(),
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

    #[test]
    fn probe_rs_that_is_not_there_is_named_with_how_to_install_it() {
        let nowhere = PathBuf::from("/nowhere/probe-rs");
        let Err(error) = Probe::with(nowhere, Board::default(), None) else {
            panic!("it is not there");
        };
        let error = error.to_string();
        assert!(error.starts_with("probe-rs is not installed"), "{error}");
        assert!(error.contains("cargo install probe-rs-tools"), "{error}");
    }

    /// `false` answers as `probe-rs` does without a probe: with a failure.
    #[test]
    fn a_probe_that_is_not_found_is_named_with_what_to_do() {
        let probe = Probe {
            program: "false".into(),
            board: Board::default(),
            serial: None,
        };
        let errors = [
            probe.write(Path::new("image")).unwrap_err(),
            probe.poke(0x2000_0000, 1).unwrap_err(),
            probe.read(0x2000_0000, 1).unwrap_err(),
        ];
        for error in errors {
            let error = format!("{error:#}");
            assert!(error.contains("`probe-rs list`"), "{error}");
        }
    }
}
