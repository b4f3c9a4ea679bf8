//! Level 1: a bare board, the wires of [`wires`], no motors.
//!
//! The self-test image measures first, then the shipped image is tested as far as a bare board
//! permits. A failed check does not end the rest, but checks that need wires are skipped while a
//! wire is wrong, because they would attribute its error to the board.

mod bus;
mod clocks;
mod driving;
mod encoders;
mod outputs;
mod running;
mod skew;
mod stops;
mod storage;
mod wiring;

use anyhow::Context as _;
use canopen::NodeId;
use protocol::self_test::{CHIP, FAIL, LEVELS, NAME, PIN, RESET};

use crate::bench::{Bench, Image};
use crate::check::{Bound, Check};
use crate::chip;
use crate::node::Node;
use crate::promise::{self, ACCEPTANCE, Promise};
use crate::wires;

/// The wheels, in their order.
const WHEELS: [&str; 4] = ["front_left", "front_right", "rear_left", "rear_right"];

/// Why a time from a person's deed is not tried.
const BY_HAND: &str = "a person's hands are not timed";

/// How long a board may take to its boot-up message before it counts as dead, us.
const PATIENCE_US: u64 = 5_000_000;

/// Frequency, duty and so on of what is measured next.
struct What {
    name: String,
    promised: Bound,
    unit: &'static str,
    source: String,
    procedure: &'static str,
}

/// A board while it is being tried.
struct Session<'a> {
    node: Node<'a>,
    options: &'a Options,
    checks: Vec<Check>,
    /// Is told what was found so far, after every check.
    so_far: &'a mut dyn FnMut(&[Check]),
}

/// How long the long checks last.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Time over which the clocks are compared, s.
    pub clock_s: u64,
    /// How often parameters are saved.
    pub saves: u32,
    /// Frames that are exchanged before the error counters are read.
    pub frames: u32,
    /// Cold starts.
    pub starts: u32,
    /// Time over which the load is measured, s.
    pub load_s: u64,
    /// The same while the board drives, s.
    pub drive_s: u64,
    /// Time over which two boards are compared, s.
    pub skew_s: u64,
    /// What is tried.
    pub parts: Parts,
}

/// Parts of level 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parts {
    /// All of them.
    All,
    /// What the self-test image measures.
    SelfTest,
    /// What the shipped image does.
    Shipped,
    /// What two boards do.
    Second,
}

impl Options {
    /// For a real board: a quarter of an hour.
    pub const FULL: Self = Self {
        clock_s: 20,
        saves: 200,
        frames: 1_000_000,
        starts: 20,
        load_s: 5,
        drive_s: 60,
        skew_s: 60,
        parts: Parts::All,
    };
    /// For an emulated board, which is the same each time.
    pub const SHORT: Self = Self {
        clock_s: 2,
        saves: 200,
        frames: 2_000,
        starts: 3,
        load_s: 1,
        drive_s: 2,
        skew_s: 60,
        parts: Parts::All,
    };
}

impl Options {
    /// How much is done of what takes long: check, what, number.
    fn amounts(&self) -> [(&'static str, &'static str, u64); 7] {
        [
            (
                "can.errors",
                "frames until the error counters are read",
                self.frames.into(),
            ),
            ("flash.saves_refused", "saves", self.saves.into()),
            ("start.counted", "cold starts", self.starts.into()),
            (
                "clock.crystal",
                "seconds between two looks at the clocks",
                self.clock_s,
            ),
            ("load.at_rest", "seconds of load at rest", self.load_s),
            ("load.driving", "seconds of load driving", self.drive_s),
            ("skew.pwm", "seconds of two boards", self.skew_s),
        ]
    }

    /// What these do less of than a trial of a real board, and what no emulated one has tried.
    #[must_use]
    pub fn limits(&self) -> Vec<String> {
        let both = self.amounts().into_iter().zip(Self::FULL.amounts());
        let shorter = both.filter(|(here, real)| here.2 < real.2);
        let mut limits: Vec<String> = shorter
            .map(|((check, what, here), (.., real))| format!("{check}: {here} {what}, not {real}"))
            .collect();
        limits.push(
            "probe-rs was not run: the emulator wrote the images into its flash, and read and set \
             its memory, by itself"
                .to_owned(),
        );
        limits
    }

    /// The amounts as a table of Markdown, for docs/acceptance.md.
    #[must_use]
    pub fn table() -> String {
        let mut text = "| amount | emulated | real |\n|---|---|---|\n".to_owned();
        let both = Self::SHORT.amounts().into_iter().zip(Self::FULL.amounts());
        for ((check, what, here), (.., real)) in both {
            text += &format!("| {what} (`{check}`) | {here} | {real} |\n");
        }
        text
    }
}

/// Tries a board; returns what was found.
///
/// # Errors
/// When nothing can be measured: no image, no bus, no answer.
pub fn run(bench: &mut dyn Bench, node: NodeId, options: &Options) -> anyhow::Result<Vec<Check>> {
    run_reporting(bench, node, options, &mut |_| {})
}

/// As [`run`]; `so_far` is told what was found after every check, so that a trial that ends early
/// leaves that behind.
///
/// # Errors
/// As [`run`].
pub fn run_reporting(
    bench: &mut dyn Bench,
    node: NodeId,
    options: &Options,
    so_far: &mut dyn FnMut(&[Check]),
) -> anyhow::Result<Vec<Check>> {
    let mut session = Session {
        node: Node::new(bench, node),
        options,
        checks: Vec::new(),
        so_far,
    };
    let has = |part| options.parts == Parts::All || options.parts == part;
    if has(Parts::SelfTest) {
        session.start()?;
        session.chip()?;
        if session.wires()? {
            session.outputs()?;
            session.stops()?;
            session.encoders()?;
            session.supply()?;
        }
        session.clocks()?;
        session.bit_times()?;
        session.raw_flash()?;
        session.failures()?;
    }
    if has(Parts::Shipped) {
        // The shipped program drives, and these lines are inputs and outputs of its own.
        session
            .node
            .bench
            .take_out(&[wires::ENABLE, wires::BRAKE])?;
        session.storage()?;
        session.running()?;
        session.bus()?;
    }
    if has(Parts::Second) {
        session.skew()?;
    }
    Ok(session.checks)
}

/// Chip and revision, if they were read: `STM32F446, revision 0x1000`.
#[must_use]
pub fn chip(checks: &[Check]) -> Option<&str> {
    let chip = checks.iter().find(|check| check.name == "chip")?;
    Some(&chip.note)
        .filter(|note| !note.is_empty())
        .map(String::as_str)
}

/// Checks the wires alone.
///
/// # Errors
/// As [`run`].
pub fn wires_alone(bench: &mut dyn Bench, node: NodeId) -> anyhow::Result<Vec<Check>> {
    let mut session = Session {
        node: Node::new(bench, node),
        options: &Options::SHORT,
        checks: Vec::new(),
        so_far: &mut |_| {},
    };
    session.start()?;
    session.wires()?;
    Ok(session.checks)
}

impl Session<'_> {
    /// Starts the self-test image.
    fn start(&mut self) -> anyhow::Result<()> {
        self.node.bench.flash(Image::SelfTest)?;
        self.node.boot_up(PATIENCE_US)?.context(
            "the self-test image sends no boot-up message: is the bus connected and terminated, \
             and at 1 Mbit/s?",
        )?;
        let name = self.node.text(0x1008, 0)?;
        anyhow::ensure!(name == NAME, "the board answers as '{name}', not '{NAME}'");
        Ok(())
    }

    /// Reads which chip it is.
    fn chip(&mut self) -> anyhow::Result<()> {
        let promise = promise::number(ACCEPTANCE, "says that it is device", "(STM32F446")?;
        let code = self.node.read(CHIP, 1)?;
        let what = What {
            name: "chip".to_owned(),
            promised: Bound::Near(promise.value, 0.0),
            unit: "device",
            source: promise.source,
            procedure: "the program reads DBGMCU_IDCODE",
        };
        self.check(what, Ok((code & 0xFFF).into()));
        if let Some(check) = self.checks.last_mut() {
            check.note = chip::describe(code);
        }
        Ok(())
    }

    /// Records a figure; what could not be measured is a broken promise with its reason.
    fn check(&mut self, what: What, measured: anyhow::Result<f64>) {
        self.record(what, measured, true);
    }

    fn record(&mut self, what: What, measured: anyhow::Result<f64>, tried: bool) {
        let (measured, note) = match measured {
            Ok(value) => (Some(value), String::new()),
            Err(error) => (None, format!("{error:#}")),
        };
        self.checks.push(Check {
            name: what.name,
            promised: what.promised,
            measured,
            unit: what.unit,
            tried,
            expected: None,
            source: what.source,
            procedure: what.procedure,
            note,
        });
        (self.so_far)(&self.checks);
    }

    /// Records that a figure was left out.
    fn leave_out(&mut self, what: What, reason: &str) {
        self.record(what, Err(anyhow::anyhow!("{reason}")), false);
    }

    /// Resets the board by its own software.
    fn reset(&mut self) -> anyhow::Result<()> {
        self.node.write(FAIL, 1, &[RESET])?;
        let at = self.node.boot_up(PATIENCE_US)?;
        at.context("the board did not come back after a reset")?;
        Ok(())
    }

    /// Resets the board and releases its emergency stops.
    fn ready(&mut self) -> anyhow::Result<()> {
        self.reset()?;
        for stop in wires::STOP {
            self.drive(wires::at(stop).from, false)?;
        }
        Ok(())
    }

    /// Makes a pin an output.
    fn drive(&mut self, pin: u8, high: bool) -> anyhow::Result<()> {
        self.node.write(PIN, 2, &[pin, u8::from(high)]).map(drop)
    }

    /// The level of a pin.
    fn level(&mut self, pin: u8) -> anyhow::Result<bool> {
        let port = self.node.read(LEVELS, (pin >> 4) + 1)?;
        Ok(port >> (pin & 15) & 1 != 0)
    }
}

/// A promise that is kept by a figure of at most its value.
fn at_most(name: &str, promise: Promise, unit: &'static str, procedure: &'static str) -> What {
    What {
        name: name.to_owned(),
        promised: Bound::AtMost(promise.value),
        unit,
        source: promise.source,
        procedure,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_says_how_much_shorter_an_emulated_trial_is() {
        let page = include_str!("../../../docs/acceptance.md");
        let table = Options::table();
        assert!(page.contains(&table), "docs/acceptance.md lacks\n{table}");
    }

    #[test]
    fn what_is_shorter_is_a_limit_and_what_is_not_is_none() {
        let limits = Options::SHORT.limits();
        let frames = "can.errors: 2000 frames until the error counters are read, not 1000000";
        assert_eq!(limits[0], frames);
        assert!(!limits.iter().any(|limit| limit.contains("saves")));
        assert!(
            limits
                .last()
                .is_some_and(|last| last.starts_with("probe-rs"))
        );
    }
}
