//! A second emulated board on the bus of the first, with its own crystal, and a wire from its
//! output to the first one's input.
//!
//! The boards share frames and one wire with one direction, so the second board can always run
//! first: its edges are recorded with their times and applied to the first board when it reaches
//! them. Frames are exchanged every [`SLICE_NS`], so a transmission may begin late by that time.

use emulator::{Board, BoardConfig, CanFrame, Change, Firmware, PinLevel, Port};

use super::{BIT_NS, EmulatedBench, port};
use crate::wires;

/// How long both boards run without being asked for frames.
pub(super) const SLICE_NS: u64 = 20_000;
/// Error of its crystal; that of the first is exact.
const CRYSTAL_PPM: f64 = 70.0;
/// Pins that are at ground: switch 0 of the node number, and both inputs of the stop.
const GROUND: [(Port, u8); 3] = [(Port::C, 8), (Port::B, 12), (Port::A, 6)];

/// The second board.
pub(super) struct Second {
    board: Board,
    /// World time at which it was switched on.
    on_ns: u64,
}

impl Second {
    /// Switches it on.
    pub(super) fn start(firmware: &Firmware, now_ns: u64) -> Self {
        let config = BoardConfig {
            crystal_ppm: CRYSTAL_PPM,
            uid: *b"OMNIBUS-0002",
            ..BoardConfig::default()
        };
        let mut board = Board::new(firmware, config);
        for (port, pin) in GROUND {
            board.set_input(port, pin, false);
        }
        board.start_trace();
        Self {
            board,
            on_ns: now_ns,
        }
    }

    /// Runs it until a world time; returns the edges of its wire.
    pub(super) fn run(&mut self, world_ns: u64) -> anyhow::Result<Vec<(u64, bool)>> {
        let ran = self.board.run_until(world_ns.saturating_sub(self.on_ns));
        ran.map_err(|stop| anyhow::anyhow!("the second board: {stop}"))?;
        let from = port(wires::SECOND.from);
        let edge = |traced: emulator::Traced| match traced.change {
            Change::Pin { port, pin, level } if (port, pin) == from => {
                Some((self.on_ns + traced.t_ns, level == PinLevel::High))
            }
            _ => None,
        };
        Ok(self
            .board
            .take_trace()
            .into_iter()
            .filter_map(edge)
            .collect())
    }
}

impl EmulatedBench<'_> {
    /// Lets the second board's frame pass, if it has one that goes before the first board's.
    pub(super) fn next_of_second(&mut self) -> anyhow::Result<Option<CanFrame>> {
        let first = self.board.can().pending().and_then(|f| f.standard_id());
        let Some(second) = &mut self.second else {
            return Ok(None);
        };
        let pending = second.board.can().pending().and_then(|f| f.standard_id());
        let Some(id) = pending else { return Ok(None) };
        if first.is_some_and(|first| first < id) {
            return Ok(None);
        }
        let Some(frame) = second.board.can().begin() else {
            return Ok(None);
        };
        let end = self.now_ns() + u64::from(frame.bits()) * BIT_NS;
        self.run(end)?;
        if let Some(second) = &mut self.second {
            second.board.can().transmitted();
        }
        self.board.can().receive(&frame);
        Ok(Some(frame))
    }

    /// A frame of another node has passed.
    pub(super) fn pass_to_second(&mut self, frame: &CanFrame) -> anyhow::Result<()> {
        if self.second.is_none() {
            return Ok(());
        }
        if self.faults.second_late_ns > 0 {
            self.run(self.now_ns() + self.faults.second_late_ns)?;
        }
        if let Some(second) = &mut self.second {
            second.board.can().receive(frame);
        }
        Ok(())
    }
}
