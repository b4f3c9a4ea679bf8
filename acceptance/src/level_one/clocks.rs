//! The board's clocks: crystal and watchdog oscillator.

use anyhow::{Context as _, ensure};
use protocol::self_test::{CLOCK, FAIL, HALT, OVER_DRIVE, PANIC, RESET};

use super::{PATIENCE_US, Session, What, at_most};
use crate::check::Bound;
use crate::promise::{self, ACCEPTANCE, SAFETY};

/// What the self-test image waits before it fails, us.
const BEFORE_FAILURE_US: f64 = 2_000.0;
/// LSI cycles from the last feeding to the reset: 400 counts of 4 (`src/board/stm32/iwdg.rs`).
const WATCHDOG_CYCLES: f64 = 1_600.0;
/// The reset cause of the watchdog, object 0x2001:3.
const BY_WATCHDOG: u32 = 3;

impl Session<'_> {
    /// Compares the crystal with the master's clock.
    pub(super) fn clocks(&mut self) -> anyhow::Result<()> {
        self.reset()?;
        let (from, begin) = self.node.read_at(CLOCK, 1)?;
        self.node.wait(self.options.clock_s * 1_000_000)?;
        let (to, end) = self.node.read_at(CLOCK, 1)?;
        let board = f64::from(to.wrapping_sub(from));
        let ppm = (board / (end - begin) as f64 - 1.0) * 1e6;
        let promise = promise::number(ACCEPTANCE, "differs from the master's by at most", "ppm")?;
        let what = What {
            name: "clock.crystal".to_owned(),
            promised: Bound::Near(0.0, promise.value),
            unit: "ppm",
            source: promise.source,
            procedure: "the board's time is asked for twice",
        };
        self.check(what, Ok(ppm));
        let flags = self.node.read(CLOCK, 3)?;
        let what = What {
            name: "clock.over_drive".to_owned(),
            promised: Bound::Near(f64::from(OVER_DRIVE), 0.0),
            unit: "flags",
            source: "docs/acceptance.md: a core at 180 MHz needs over-drive".to_owned(),
            procedure: "ready 1, switched 2 and the voltage's scale 4, once the clocks were compared",
        };
        self.check(what, Ok(flags.into()));
        Ok(())
    }

    /// Lets the program fail, and waits for the watchdog.
    pub(super) fn failures(&mut self) -> anyhow::Result<()> {
        let start = self.fail(RESET)?;
        let reset = promise::number(
            SAFETY,
            "a reset follows a halted core or a panic within",
            "ms",
        )?;
        let boot = promise::number(SAFETY, "`tests/storage.rs` holds it to", "ms")?;
        let mut promise = reset.clone();
        promise.value += boot.value;
        promise.source = format!("{}; {}", reset.source, boot.source);
        for (name, failure) in [("halt", HALT), ("panic", PANIC)] {
            let took = self.fail(failure);
            let cause = self.node.read(FAIL, 2)?;
            let what = at_most(
                &format!("watchdog.{name}"),
                promise.clone(),
                "ms",
                "from the answer to the first frame after the reset, by the master's clock",
            );
            let judged = took.and_then(|us| {
                let by_watchdog = cause == BY_WATCHDOG;
                ensure!(
                    by_watchdog,
                    "the reset's cause is {cause}, not the watchdog"
                );
                Ok(us / 1000.0)
            });
            let lsi = judged.as_ref().ok().map(|ms| {
                let waited_ms =
                    ms - (start - BEFORE_FAILURE_US) / 1000.0 - BEFORE_FAILURE_US / 1000.0;
                WATCHDOG_CYCLES / waited_ms
            });
            self.check(what, judged);
            if failure == HALT {
                self.oscillator(lsi)?;
            }
        }
        Ok(())
    }

    /// The watchdog's oscillator, by the time that the watchdog took.
    fn oscillator(&mut self, khz: Option<f64>) -> anyhow::Result<()> {
        let fastest = promise::number(SAFETY, "the data sheet allows (17 to", "kHz")?;
        let slowest = promise::number(SAFETY, "the data sheet allows (", "to 47 kHz")?;
        let middle = (fastest.value + slowest.value) / 2.0;
        let what = What {
            name: "clock.watchdog".to_owned(),
            promised: Bound::Near(middle, fastest.value - middle),
            unit: "kHz",
            source: fastest.source,
            procedure: "1600 cycles from the last feeding to the reset",
        };
        self.check(what, khz.context("the watchdog did not reset the board"));
        Ok(())
    }

    /// Lets the program fail; returns the time from the answer to the first frame, us.
    fn fail(&mut self, failure: u8) -> anyhow::Result<f64> {
        // Not from now on: a busy computer may come back to this after the board.
        let from = self.node.write(FAIL, 1, &[failure])?;
        let at = self.node.boot_up(PATIENCE_US)?;
        let at = at.context("the board did not come back within 5 s")?;
        Ok((at - from) as f64)
    }
}
