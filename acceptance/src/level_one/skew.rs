//! The skew between two boards that drive as one: the time between the changes of their outputs,
//! measured by wire.
//!
//! One wheel of both boards reverses once a second, and the output with the inverse of its
//! direction changes together with its duty, in the same instructions of the same tick. The wire
//! [`wires::SECOND`] connects this output of the second board with a capture input of the first;
//! wire 12 connects the first board's own output with the other channel of the same timer, TIM12,
//! which the program does not use. One clock therefore measures the time between the two. The
//! debugger sets the timer up and reads the captured values; both boards run the unmodified shipped
//! image.
//!
//! Limits: a change of the duty alone makes no edge, so the ticks in between are not observed.
//! Changes more than half a tick apart belong to different ticks and are not counted.

use anyhow::{Context as _, ensure};
use canopen::NodeId;

use super::driving::{Drive, REVERSAL, change};
use super::{Session, at_most};
use crate::promise::{self, Column};
use crate::wires;

const APB1ENR: u32 = 0x4002_3840;
/// TIM12's bit in it.
const TIM12: u32 = 1 << 6;
/// Registers (RM0390 19.5): both channels inputs on their own pins, any edge.
const BASE: u32 = 0x4000_1800;
const SETTINGS: [(u32, u32); 5] = [
    (0x18, 0x0101),
    (0x20, 0xBB),
    (0x28, DIVIDER - 1),
    (0x14, 1),
    (0x00, 1),
];
const CAPTURED: u32 = BASE + 0x34;
/// Its clock is 90 MHz; it counts tenths of a microsecond.
const DIVIDER: u32 = 9;
const COUNT_US: f64 = 0.1;
/// PB14 and PB15 are its channels (DS10693, table 11: AF9).
const PORT_B: u32 = 0x4002_0400;
const AFRH: u32 = 0x24;

/// SYNCs until the clocks are in step: the time constant of the loop is 64.
const SETTLE: u64 = 500;
/// Time for both boards to start, us.
const START_US: u64 = 1_000_000;
/// Half of a control tick, us.
const SAME_TICK_US: f64 = 500.0;

impl Session<'_> {
    /// Compares two boards.
    pub(super) fn skew(&mut self) -> anyhow::Result<()> {
        let what = at_most(
            "skew.pwm",
            promise::figure("skew.worst", Column::Budget)?,
            "us",
            "largest time between the reversals of one wheel in two boards, by one timer's captures",
        );
        if self.node.bench.debugger().is_none() {
            self.leave_out(what, "it needs a debugger: --probe");
            return Ok(());
        }
        let Some(second) = self.node.bench.join_second()? else {
            self.leave_out(what, "it needs a second board: --second");
            return Ok(());
        };
        self.node.wait(START_US)?;
        let second = NodeId::new(second).context("the second board has no node-ID")?;
        let measured = self.compare(second);
        self.check(what, measured);
        Ok(())
    }

    fn compare(&mut self, second: NodeId) -> anyhow::Result<f64> {
        self.release_stops()?;
        self.debugged(|debugger| {
            change(debugger, APB1ENR, 0, TIM12)?;
            change(debugger, PORT_B + AFRH, 0xFF << 24, 0x99 << 24)?;
            change(debugger, PORT_B, 0xF << 28, 0xA << 28)?;
            let mut settings = SETTINGS.iter();
            settings.try_for_each(|(offset, value)| debugger.write(BASE + offset, *value))
        })?;
        let mut drive = Drive::to_and_fro(&[self.node.id(), second])?;
        self.begin_to_drive(&mut drive)?;
        let mut went_on = true;
        for _ in 0..SETTLE {
            went_on &= self.period(&mut drive)?;
        }
        let mut captured = Vec::new();
        for _ in 0..self.options.skew_s * 100 / REVERSAL {
            let reading = self.debugged(|debugger| debugger.read_meanwhile(CAPTURED, 2))?;
            for _ in 0..REVERSAL {
                went_on &= self.period(&mut drive)?;
            }
            let words = reading.recv().context("the debugger has gone")??;
            captured.push([0, 1].map(|channel| words.get(channel).copied().unwrap_or(0)));
        }
        self.end_to_drive(&mut drive)?;
        ensure!(went_on, "the boards did not go on driving");
        worst(&captured)
    }
}

/// The largest time between the two edges of one reversal, us.
fn worst(captured: &[[u32; 2]]) -> anyhow::Result<f64> {
    let changed = |channel: usize| {
        let pairs = captured.windows(2);
        pairs.filter(move |pair| pair[0][channel] != pair[1][channel])
    };
    let second = wires::SECOND;
    let from = wires::name(second.from);
    let own = usize::from(wires::WITH_SECOND[0]) + 1;
    ensure!(
        changed(1).count() > 0,
        "the first board's own signal is not seen: is wire {own} in?"
    );
    ensure!(
        changed(0).count() > 0,
        "the second board's {from} is not seen at {}: is wire {} in?",
        wires::name(second.to),
        wires::WIRES.len() + 1
    );
    let both = captured.windows(2).filter(|pair| {
        let [before, after] = pair else { return false };
        before[0] != after[0] && before[1] != after[1]
    });
    let apart = both.filter_map(|pair| {
        let [one, other] = pair.last()?;
        let counts = (*one as u16).wrapping_sub(*other as u16).cast_signed();
        Some(f64::from(counts).abs() * COUNT_US)
    });
    let together: Vec<f64> = apart.filter(|us| *us < SAME_TICK_US).collect();
    ensure!(
        2 * together.len() >= captured.len(),
        "of {} reversals only {} are those of one tick",
        captured.len(),
        together.len()
    );
    Ok(together.into_iter().fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_pair_counts_also_where_the_timer_turns() {
        let pairs = [[0, 0], [100, 110], [65_530, 4], [7_000, 7_025], [9, 3]];
        // 1 us, 1 us over the end of the counter, 2.5 us, 0.6 us.
        assert_eq!(worst(&pairs).unwrap(), 2.5);
    }

    #[test]
    fn edges_of_different_ticks_are_no_pair() {
        let pairs = [[0, 0], [100, 10_100], [300, 320], [400, 410], [500, 510]];
        assert_eq!(worst(&pairs).unwrap(), 2.0);
        let pairs = [[0, 0], [100, 10_100], [300, 10_300]];
        assert!(worst(&pairs).is_err());
    }

    #[test]
    fn a_signal_that_does_not_change_names_its_wire() {
        let error = worst(&[[0, 0], [0, 5], [0, 9]]).unwrap_err().to_string();
        assert!(error.ends_with("is wire 18 in?"), "{error}");
        let error = worst(&[[0, 0], [5, 0], [9, 0]]).unwrap_err().to_string();
        assert!(error.ends_with("is wire 12 in?"), "{error}");
    }
}
