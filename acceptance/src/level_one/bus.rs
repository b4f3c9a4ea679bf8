//! CAN: errors over many frames, and recovery from bus-off.

use anyhow::Context as _;
use canopen::{Emergency, Frame};
use protocol::self_test::{BITS, CLOCK, OTHERS, OWN};

use super::{BY_HAND, Session, What, at_most};
use crate::check::Bound;
use crate::promise::{self, ACCEPTANCE};

/// Object 0x2130: error counters, last error, times bus-off.
const ERRORS: u16 = 0x2130;
/// How long to wait for the message that bus-off is over.
const SILENCE_US: u64 = 10_000_000;

/// An identifier that no node uses, for a frame to look at.
const UNUSED: u16 = 0x7F0;
/// A frame of eight bytes has more edges before its checksum, whatever they are.
const FEWEST_EDGES: u32 = 10;
const NO_EDGES: &str = "no edges at the input of CAN: is a transceiver connected?";

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

    /// Looks at the edges of a frame of the board, and of one of the other node.
    pub(super) fn bit_times(&mut self) -> anyhow::Result<()> {
        let tolerance = promise::number(ACCEPTANCE, "A bit on the bus is 1 us long within", "%")?;
        let phase = promise::number(ACCEPTANCE, "no edge farther than", "ns from its place")?;
        let per_us = f64::from(self.node.read(CLOCK, 2)?) / 1e6;
        for (name, whose) in [("own", OWN), ("others", OTHERS)] {
            self.node.write(BITS, 1, &[whose])?;
            if whose == OTHERS {
                // The board listens from 2 ms after its answer on, for 15 ms.
                self.node.wait(3_000)?;
                let frame = Frame::new(UNUSED, &[0x55; 8]).context("a frame has 8 bytes")?;
                self.node.bench.send(&frame)?;
            }
            self.node.wait(20_000)?;
            let total = f64::from(self.node.read(BITS, 2)?);
            let off = f64::from(self.node.read(BITS, 3)?);
            let bits = f64::from(self.node.read(BITS, 4)?);
            let edges = self.node.read(BITS, 5)?;
            let seen = edges >= FEWEST_EDGES;
            let bit_time = What {
                name: format!("can.bit_time.{name}"),
                promised: Bound::Near(1.0, tolerance.value / 100.0),
                unit: "us",
                source: tolerance.source.clone(),
                procedure: "from the first edge of a frame to the last before its checksum",
            };
            let off_by = at_most(
                &format!("can.phase.{name}"),
                phase.clone(),
                "ns",
                "the edge of a frame farthest from a whole number of bits after the first",
            );
            let figures = [total / bits / per_us, off / per_us * 1000.0];
            for (what, figure) in [bit_time, off_by].into_iter().zip(figures) {
                match seen {
                    true => self.check(what, Ok(figure)),
                    // The board's own cable is no bus.
                    false if !self.node.bench.hands_are_timed() => self.leave_out(what, NO_EDGES),
                    false => self.check(what, Err(anyhow::anyhow!(NO_EDGES))),
                }
            }
        }
        Ok(())
    }

    fn recovery(&mut self) -> anyhow::Result<()> {
        let before = self.node.read(ERRORS, 5)?;
        let forced = self.node.bench.force_bus_off();
        let from = self.node.bench.now_us();
        let back = self.back_from_bus_off(from + SILENCE_US)?;
        let promise = promise::number(ACCEPTANCE, "After bus-off it is back within", "ms")?;
        let what = at_most(
            "can.recovery",
            promise,
            "ms",
            "from bus-off to the message that it is over; the bus is good again",
        );
        let timed = self.node.bench.hands_are_timed();
        let measured = back.map(|at| at.saturating_sub(from) as f64 / 1000.0);
        match measured {
            Some(_) if !timed => self.leave_out(what, BY_HAND),
            Some(measured) => self.check(what, Ok(measured)),
            None => self.check(what, Err(anyhow::anyhow!("no such message within 10 s"))),
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
        self.check(what, forced.map(|()| f64::from(counted)));
        Ok(())
    }

    /// Waits for the board's message that bus-off is over; returns when it ended, us. Its other
    /// frames may have been on their way before.
    fn back_from_bus_off(&mut self, until_us: u64) -> anyhow::Result<Option<u64>> {
        let id = self.node.id();
        while let Some((at, frame)) = self.node.bench.receive(until_us)? {
            let says = Emergency::parse(&frame);
            if says.is_some_and(|(node, message)| {
                node == id && message.code == Emergency::BUS_OFF_RECOVERED
            }) {
                return Ok(Some(at));
            }
        }
        Ok(None)
    }
}
