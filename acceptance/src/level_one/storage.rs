//! The shipped image on a bare board: starts, and the flash behind its parameters.

use anyhow::Context as _;
use protocol::ENTRIES;
use protocol::self_test::{CLOCK, FLASH};

use super::{BY_HAND, PATIENCE_US, Session, What, at_most};
use crate::bench::Image;
use crate::check::Bound;
use crate::promise::{self, ACCEPTANCE, SAFETY};

/// Object 0x1010:1 and what it has to be written (CiA 301, 7.5.2.13).
const SAVE: (u16, u8) = (0x1010, 1);
const SIGNATURE: &[u8] = b"save";
/// A parameter whose value does not matter without a robot: 0x2027:4, brake engage time.
const CHANGED: (u16, u8) = (0x2027, 4);
/// Number of this start, object 0x2129:1. Starts that do not last a second are not counted.
const START: (u16, u8) = (0x2129, 1);
const COUNTED_US: u64 = 1_500_000;

/// The words around the longest erase of a sector in docs/safety.md.
const ERASE: (&str, &str) = ("a quarter of a second where a sector is erased (", "s");
/// Reads that tell how long the way to the board is.
const READINGS: u32 = 21;
/// Words that are programmed one by one.
const WORDS: u8 = 250;

impl Session<'_> {
    /// Checks starts and saves.
    pub(super) fn storage(&mut self) -> anyhow::Result<()> {
        self.node.bench.flash(Image::Shipped)?;
        let at = self.node.boot_up(PATIENCE_US)?;
        at.context("the shipped image sends no boot-up message")?;
        self.saves()?;
        self.starts()
    }

    /// Times single operations of the flash, with the self-test image.
    pub(super) fn raw_flash(&mut self) -> anyhow::Result<()> {
        let per_us = f64::from(self.node.read(CLOCK, 2)?) / 1e6;
        self.node.write(FLASH, 1, &[WORDS])?;
        let erase_ms = f64::from(self.node.read(FLASH, 2)?) / per_us / 1000.0;
        let word_us = f64::from(self.node.read(FLASH, 3)?) / per_us;
        let wrong = self.node.read(FLASH, 4)?;
        let mut erase = promise::number(SAFETY, ERASE.0, ERASE.1)?;
        erase.value *= 1000.0;
        let word = promise::number(ACCEPTANCE, "A word of flash is programmed within", "us")?;
        let procedure = "the longest of three erases of a sector of 16 KiB, by the core's counter";
        self.check(
            at_most("flash.sector", erase, "ms", procedure),
            Ok(erase_ms),
        );
        let procedure = "the longest of 250 words, by the core's counter";
        self.check(at_most("flash.word", word, "us", procedure), Ok(word_us));
        let what = What {
            name: "flash.words_wrong".to_owned(),
            promised: Bound::Near(0.0, 0.0),
            unit: "words",
            source: "docs/acceptance.md: what is programmed is read back".to_owned(),
            procedure: "words that read back wrong, and operations that failed",
        };
        self.check(what, Ok(wrong.into()));
        Ok(())
    }

    /// Saves parameters many times.
    fn saves(&mut self) -> anyhow::Result<()> {
        self.set_all_parameters()?;
        let bus_ms = self.round_trip()?;
        let mut times = Vec::new();
        let mut refused = 0.0;
        for save in 0..self.options.saves {
            // An image that is stored already would not be written.
            let value = (save as u16 % 2 + 1).to_le_bytes();
            self.node.write(CHANGED.0, CHANGED.1, &value)?;
            let from = self.node.bench.now_us();
            match self.node.write(SAVE.0, SAVE.1, SIGNATURE) {
                Ok(_) => {
                    let took_ms = (self.node.bench.now_us() - from) as f64 / 1000.0;
                    times.push((took_ms - bus_ms).max(0.0));
                }
                Err(_) => refused += 1.0,
            }
        }
        times.sort_unstable_by(f64::total_cmp);
        let median = times.get(times.len() / 2).copied();
        let longest = times.last().copied();
        let what = What {
            name: "flash.saves_refused".to_owned(),
            promised: Bound::Near(0.0, 0.0),
            unit: "saves",
            source: format!("docs/acceptance.md: {} saves in a row", self.options.saves),
            procedure: "0x1010:1 is written again and again",
        };
        self.check(what, Ok(refused));
        let program = promise::number(ACCEPTANCE, "All parameters are saved within", "ms")?;
        let erase = promise::number(SAFETY, ERASE.0, ERASE.1)?;
        let mut erase_ms = erase;
        erase_ms.value *= 1000.0;
        let none = "no save was answered";
        self.check(
            at_most(
                "flash.program",
                program,
                "ms",
                "median from request to answer of a save, less that of a read",
            ),
            median.context(none),
        );
        self.check(
            at_most(
                "flash.erase",
                erase_ms,
                "ms",
                "longest from request to answer of a save, less that of a read: one that erases a sector",
            ),
            longest.context(none),
        );
        Ok(())
    }

    /// How long a question and its answer are on their way, ms: the median of several reads. A
    /// serial adapter takes longer than the flash.
    fn round_trip(&mut self) -> anyhow::Result<f64> {
        let mut times = Vec::new();
        for _ in 0..READINGS {
            let from = self.node.bench.now_us();
            self.node.read(CHANGED.0, CHANGED.1)?;
            times.push((self.node.bench.now_us() - from) as f64 / 1000.0);
        }
        times.sort_unstable_by(f64::total_cmp);
        Ok(times.get(times.len() / 2).copied().unwrap_or(0.0))
    }

    /// Writes every parameter with what it is, so that all of them are in the image.
    fn set_all_parameters(&mut self) -> anyhow::Result<()> {
        for entry in ENTRIES {
            if entry.slot().is_none() || entry.kind.bytes() == 0 {
                continue;
            }
            let address = entry.address;
            let value = self.node.read(address.index, address.sub)?;
            let bytes = value.to_le_bytes();
            let data = &bytes[..usize::from(entry.kind.bytes())];
            // What is refused has a value that only a configuration gives.
            let _ = self.node.write(address.index, address.sub, data);
        }
        Ok(())
    }

    /// Switches the board off and on.
    fn starts(&mut self) -> anyhow::Result<()> {
        self.node.wait(COUNTED_US)?;
        let first = self.node.read(START.0, START.1)?;
        let mut slowest: f64 = 0.0;
        for _ in 0..self.options.starts {
            self.node.bench.power_cycle()?;
            let from = self.node.bench.now_us();
            let at = self.node.boot_up(PATIENCE_US)?;
            let at = at.context("the board did not start")?;
            slowest = slowest.max(at.saturating_sub(from) as f64 / 1000.0);
            self.node.wait(COUNTED_US)?;
        }
        let counted = self.node.read(START.0, START.1)?.wrapping_sub(first);
        let boot = promise::number(SAFETY, "`tests/storage.rs` holds it to", "ms")?;
        let first_frame = at_most(
            "start.first_frame",
            boot,
            "ms",
            "from power-on to the boot-up message, the slowest of all starts",
        );
        if self.node.bench.hands_are_timed() {
            self.check(first_frame, Ok(slowest));
        } else {
            self.leave_out(first_frame, BY_HAND);
        }
        let what = What {
            name: "start.counted".to_owned(),
            promised: Bound::Near(f64::from(self.options.starts), 0.0),
            unit: "starts",
            source: "docs/can-protocol.md: 0x2129:1".to_owned(),
            procedure: "the board is switched off and on",
        };
        self.check(what, Ok(f64::from(counted)));
        Ok(())
    }
}
