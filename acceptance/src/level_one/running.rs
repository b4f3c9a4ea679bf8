//! Stack and load of the shipped image, read by a debugger while it runs.
//!
//! Start-up fills the stack with a pattern, so the part of the pattern that is left shows how deep
//! the stack was. For the load, a timer that the program does not use loses its clock in sleep
//! (RM0390 6.3.14, TIM6LPEN), so it counts the time during which the core is awake, without help of
//! the program. It is measured at rest with SYNC at 100 Hz, and while the board drives as far as a
//! bare one can ([`super::driving`]); the stack is read after that.
//!
//! Limits: without a debugger none of this is measured. The manual does not say whether the timer
//! stops in sleep while DBGMCU_CR keeps the clocks on for the debugger; a figure near 100 % would
//! mean that it does not. The counter is read while the board drives, at an instant that is
//! uncertain by the time of the debugger's access, so the board drives for long.

use super::driving::{Drive, change};
use super::{Session, What, at_most};
use crate::bench::Debugger;
use crate::promise::{self, ACCEPTANCE, Column, PERFORMANCE, Promise};

/// The stack (`memory/nucleo_f446re.x`), and what start-up paints it with.
const STACK: u32 = 0x2000_0000;
const PAINT: u32 = 0xCCCC_CCCC;

const APB1ENR: u32 = 0x4002_3840;
const APB1LPENR: u32 = 0x4002_3860;
/// TIM6's bit in both.
const TIM6: u32 = 1 << 4;
const TIM6_CR1: u32 = 0x4000_1000;
const TIM6_EGR: u32 = 0x4000_1014;
const TIM6_CNT: u32 = 0x4000_1024;
const TIM6_PSC: u32 = 0x4000_1028;
/// Its clock is 90 MHz; it counts tenths of a millisecond.
const DIVIDER: u32 = 9_000;
const COUNT_MS: f64 = 0.1;

/// SYNCs a second.
const SYNCS: u64 = 100;

impl Session<'_> {
    /// Checks load and stack.
    pub(super) fn running(&mut self) -> anyhow::Result<()> {
        let mut rest = promise::number(ACCEPTANCE, "A board at rest is awake for at most", "%")?;
        let mut driven = promise::figure("load", Column::Ceiling)?;
        if !self.node.bench.hands_are_timed() {
            // A real board may be reached by its own cable.
            let cable = promise::figure("gateway.1_robots.load.more", Column::Ceiling)?;
            for load in [&mut rest, &mut driven] {
                load.value += cable.value;
                load.source += "; with that of gateway.1_robots.load.more";
            }
        }
        let reserved = promise::number(PERFORMANCE, "stack, for which", "KB of the chip's")?;
        let half = Promise {
            value: reserved.value * 1024.0 / 2.0,
            source: format!("{}, half of it", reserved.source),
        };
        let rest = at_most(
            "load.at_rest",
            rest,
            "%",
            "time awake by a timer without a clock in sleep, at rest with 100 setpoints a second",
        );
        let driven = at_most(
            "load.driving",
            driven,
            "%",
            "the same while the board follows a twist that always changes, its wheels standing",
        );
        let stack = at_most(
            "stack.high_water",
            half,
            "bytes",
            "paint that is left on the stack, after driving",
        );
        if self.node.bench.debugger().is_none() {
            for what in [rest, driven, stack] {
                self.leave_out(what, "it needs a debugger: --probe");
            }
            return Ok(());
        }
        let mut drive = Drive::new(&[self.node.id()])?;
        self.load(rest, &mut drive, self.options.load_s)?;

        self.release_stops()?;
        match self.begin_to_drive(&mut drive) {
            Ok(()) => {
                self.load(driven, &mut drive, self.options.drive_s)?;
                self.end_to_drive(&mut drive)?;
            }
            Err(error) => self.check(driven, Err(error)),
        }

        let words = reserved.value as usize * 256;
        let content = self.debugged(|debugger| debugger.read(STACK, words))?;
        let painted = content.iter().take_while(|word| **word == PAINT).count();
        self.check(stack, Ok((4 * (words - painted)) as f64));
        Ok(())
    }

    /// Measures the load for so many seconds of SYNC; what it is asked to do is up to `drive`.
    fn load(&mut self, what: What, drive: &mut Drive, seconds: u64) -> anyhow::Result<()> {
        self.debugged(begin)?;
        let from = self.node.bench.now_us();
        let mut went_on = true;
        for _ in 0..seconds * SYNCS {
            went_on &= self.period(drive)?;
        }
        let reading = self.debugged(|debugger| debugger.read_meanwhile(TIM6_CNT, 1))?;
        let awake = loop {
            went_on &= self.period(drive)?;
            match reading.try_recv() {
                Ok(awake) => break awake?,
                Err(std::sync::mpsc::TryRecvError::Empty) => {}
                Err(error) => return Err(error.into()),
            }
        };
        let span_ms = (self.node.bench.now_us() - from) as f64 / 1000.0;
        let awake_ms = f64::from(awake.first().copied().unwrap_or(0)) * COUNT_MS;
        let measured = match went_on {
            true => Ok(100.0 * awake_ms / span_ms),
            false => Err(anyhow::anyhow!("the board did not go on driving")),
        };
        self.check(what, measured);
        Ok(())
    }

    pub(super) fn debugged<T>(
        &mut self,
        use_it: impl FnOnce(&mut dyn Debugger) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        match self.node.bench.debugger() {
            Some(debugger) => use_it(debugger),
            None => anyhow::bail!("the debugger has gone"),
        }
    }
}

/// Makes TIM6 count the time awake, from 0.
fn begin(debugger: &mut dyn Debugger) -> anyhow::Result<()> {
    for (address, set, clear) in [(APB1ENR, TIM6, 0), (APB1LPENR, 0, TIM6)] {
        change(debugger, address, clear, set)?;
    }
    debugger.write(TIM6_CR1, 0)?;
    debugger.write(TIM6_PSC, DIVIDER - 1)?;
    // The divider takes effect with an update, which also clears the counter.
    debugger.write(TIM6_EGR, 1)?;
    debugger.write(TIM6_CR1, 1)
}
