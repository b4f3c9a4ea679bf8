//! CAN: errors over many frames, and the way back from bus-off.

use super::{BY_HAND, Session, What, at_most};
use crate::check::Bound;
use crate::promise::{self, ACCEPTANCE};

/// Object 0x2130: error counters, last error, times bus-off.
const ERRORS: u16 = 0x2130;
/// Heartbeats come this often; after bus-off the first frame is one.
const SILENCE_US: u64 = 10_000_000;

impl Session<'_> {
    /// Checks error counters and recovery.
    pub(super) fn bus(&mut self) -> anyhow::Result<()> {
        let mut worst = 0;
        // A question and its answer.
        for _ in 0..self.options.frames / 2 {
            worst = worst.max(self.node.read(ERRORS, 1)?);
        }
        let receive = self.node.read(ERRORS, 2)?;
        let last = self.node.read(ERRORS, 3)?;
        let what = What {
            name: "can.errors".to_owned(),
            promised: Bound::Near(0.0, 0.0),
            unit: "counts",
            source: "docs/can-protocol.md: 0x2130:1 to 3".to_owned(),
            procedure: "largest error counter, and 1 for any error, while frames are exchanged",
        };
        let any = u32::from(last != 0);
        self.check(what, Ok(f64::from(worst.max(receive).max(any))));
        self.recovery()
    }

    fn recovery(&mut self) -> anyhow::Result<()> {
        let before = self.node.read(ERRORS, 5)?;
        self.node.bench.force_bus_off()?;
        let from = self.node.bench.now_us();
        let back = self.node.bench.receive(from + SILENCE_US)?;
        let promise = promise::number(ACCEPTANCE, "After bus-off it is back within", "ms")?;
        let what = at_most(
            "can.recovery",
            promise,
            "ms",
            "from bus-off to the first frame; the bus is good again",
        );
        let timed = self.node.bench.hands_are_timed();
        let measured = back.map(|(at, _)| at.saturating_sub(from) as f64 / 1000.0);
        match measured {
            Some(_) if !timed => self.leave_out(what, BY_HAND),
            Some(measured) => self.check(what, Ok(measured)),
            None => self.check(what, Err(anyhow::anyhow!("no frame within 10 s"))),
        }
        let counted = self.node.read(ERRORS, 5)?.wrapping_sub(before);
        let what = What {
            name: "can.bus_off".to_owned(),
            // As long as a person holds the wires it comes again and again.
            promised: if timed {
                Bound::Near(1.0, 0.0)
            } else {
                Bound::AtLeast(1.0)
            },
            unit: "times",
            source: "docs/can-protocol.md: 0x2130:5".to_owned(),
            procedure: "the board counts how often it was bus-off",
        };
        self.check(what, Ok(f64::from(counted)));
        Ok(())
    }
}
