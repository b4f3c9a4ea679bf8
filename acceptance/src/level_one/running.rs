//! Stack and load of the shipped image, by a debugger that looks at it while it runs.
//!
//! Start-up paints the stack, so the paint that is left shows how deep it was. For the load a timer
//! that nothing uses counts without a clock in sleep (RM0390 6.3.14, TIM6LPEN), so it counts the
//! time that the core is awake, and the program has no part in it. The board is at rest, with SYNC
//! at 100 Hz: a bare board cannot drive.
//!
//! What it cannot do: without a debugger neither is tried. Whether the timer stops while the chip
//! is told to keep its clocks for the debugger (DBGMCU_CR) is not said in the manual; a figure
//! near 100 % would mean that it does not.

use canopen::Frame;

use super::{Session, at_most};
use crate::bench::Debugger;
use crate::promise::{self, ACCEPTANCE, PERFORMANCE, Promise};

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

const SYNC: u16 = 0x080;
const SYNC_US: u64 = 10_000;

impl Session<'_> {
    /// Checks load and stack.
    pub(super) fn running(&mut self) -> anyhow::Result<()> {
        let load = promise::number(ACCEPTANCE, "A board at rest is awake for at most", "%")?;
        let reserved = promise::number(PERFORMANCE, "stack, for which", "KB of the chip's")?;
        let half = Promise {
            value: reserved.value * 1024.0 / 2.0,
            source: format!("{}, half of it", reserved.source),
        };
        let load = at_most(
            "load.at_rest",
            load,
            "%",
            "time awake by a timer without a clock in sleep, at rest with 100 SYNCs a second",
        );
        let stack = at_most(
            "stack.high_water",
            half,
            "bytes",
            "paint that is left on the stack",
        );
        let Some(debugger) = self.node.bench.debugger() else {
            for what in [load, stack] {
                self.leave_out(what, "it needs a debugger: --probe");
            }
            return Ok(());
        };
        begin(debugger)?;
        let from = self.node.bench.now_us();
        for sync in 0..self.options.load_s * 1_000_000 / SYNC_US {
            let counter = [(sync % 240) as u8 + 1];
            if let Some(frame) = Frame::new(SYNC, &counter) {
                self.node.bench.send(&frame)?;
            }
            let next = (from + (sync + 1) * SYNC_US).saturating_sub(self.node.bench.now_us());
            self.node.wait(next)?;
        }
        let awake = self.debugged(|debugger| debugger.read(TIM6_CNT, 1))?;
        let span_ms = (self.node.bench.now_us() - from) as f64 / 1000.0;
        let awake_ms = f64::from(awake.first().copied().unwrap_or(0)) * COUNT_MS;
        self.check(load, Ok(100.0 * awake_ms / span_ms));

        let words = reserved.value as usize * 256;
        let content = self.debugged(|debugger| debugger.read(STACK, words))?;
        let painted = content.iter().take_while(|word| **word == PAINT).count();
        self.check(stack, Ok((4 * (words - painted)) as f64));
        Ok(())
    }

    fn debugged<T>(
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
        let before = debugger.read(address, 1)?;
        let before = before.first().copied().unwrap_or(0);
        debugger.write(address, before & !clear | set)?;
    }
    debugger.write(TIM6_CR1, 0)?;
    debugger.write(TIM6_PSC, DIVIDER - 1)?;
    // The divider takes effect with an update, which also clears the counter.
    debugger.write(TIM6_EGR, 1)?;
    debugger.write(TIM6_CR1, 1)
}
