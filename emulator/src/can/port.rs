//! The controller as seen from the bus.

use super::{Can, CanError, CanFrame, ErrorCounters};
use crate::board::Board;

/// One of the chip's CAN controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Which {
    /// CAN1.
    First,
    /// CAN2.
    Second,
}

/// A CAN connector of a board. All times are the board's present, the end of its last run.
///
/// A bus works in rounds. It asks every node for its [`pending`](Self::pending) frame, calls
/// [`begin`](Self::begin) on the node whose [`arbitration`](CanFrame::arbitration) is smallest and
/// [`lost_arbitration`](Self::lost_arbitration) on the others, waits for the frame's bits to pass,
/// and then calls [`transmitted`](Self::transmitted) or [`error`](Self::error) on the sender and
/// [`receive`](Self::receive) on the others.
pub struct CanPort<'a> {
    pub(crate) board: &'a mut Board,
    pub(crate) which: Which,
}

impl CanPort<'_> {
    /// Nominal bit rate in bit/s that the clock tree and the bit timing give, without the crystal's
    /// error; `None` while the controller is not on the bus: not started, bus-off, or its pins not
    /// switched to it.
    #[must_use]
    pub fn bit_rate(&self) -> Option<u32> {
        self.board.can_bit_rate(self.which)
    }

    /// Fraction of a bit before the sample point.
    #[must_use]
    pub fn sample_point(&self) -> f32 {
        self.board.see_can(self.which, |can| can.sample_point())
    }

    /// The frame that is to be sent next.
    #[must_use]
    pub fn pending(&self) -> Option<CanFrame> {
        self.bit_rate()?;
        self.board
            .see_can(self.which, Can::pending)
            .map(|(frame, _)| frame)
    }

    /// World time in ns at which the pending frame was requested.
    #[must_use]
    pub fn pending_since_ns(&self) -> Option<u64> {
        self.bit_rate()?;
        let (_, cycle) = self.board.see_can(self.which, Can::pending)?;
        Some(self.board.world_ns(cycle))
    }

    /// Puts the pending frame on the wire: from here on no other mailbox overtakes it and it cannot
    /// be aborted.
    pub fn begin(&mut self) -> Option<CanFrame> {
        self.bit_rate()?;
        let frame = self.board.with_can(self.which, |can, now| can.begin(now))?;
        if self.which == Which::First {
            self.board.look(|soc| soc.sends(frame));
        }
        Some(frame)
    }

    /// Another node begins to send a frame, whose bits last this times as long as they should. This
    /// is only for programs that look at the input's level; the frame comes with
    /// [`receive`](Self::receive).
    pub fn arrives(&mut self, frame: &CanFrame, bit_time: f64) {
        if self.which == Which::First {
            self.board.look(|soc| soc.arrives(*frame, bit_time));
        }
    }

    /// The frame went out and was acknowledged.
    pub fn transmitted(&mut self) {
        self.board.with_can(self.which, |can, _| can.transmitted());
    }

    /// Another node's frame had priority.
    pub fn lost_arbitration(&mut self) {
        self.board
            .with_can(self.which, |can, _| can.lost_arbitration());
    }

    /// The transmission failed.
    pub fn error(&mut self, error: CanError) {
        self.board
            .with_can(self.which, |can, now| can.transmit_error(now, error));
    }

    /// Another node's frame has arrived complete; its start is taken to be as long ago as it is
    /// without stuff bits.
    pub fn receive(&mut self, frame: &CanFrame) {
        self.receive_stuffed(frame, frame.bits());
    }

    /// Another node's frame has arrived complete. It took so many bits from its first to the end of
    /// its last.
    pub fn receive_stuffed(&mut self, frame: &CanFrame, bits: u32) {
        if self.which == Which::First {
            self.board.trace_arrival(frame);
        }
        self.board.can_receive(self.which, frame, bits);
    }

    /// Another node's frame was broken.
    pub fn receive_error(&mut self, error: CanError) {
        self.board
            .with_can(self.which, |can, _| can.receive_error(error));
    }

    /// Whether this node answers frames with a dominant acknowledge bit.
    #[must_use]
    pub fn acknowledges(&self) -> bool {
        self.bit_rate().is_some() && self.board.see_can(self.which, |can| !can.silent())
    }

    /// Whether the node is bus-off.
    #[must_use]
    pub fn bus_off(&self) -> bool {
        self.board.see_can(self.which, |can| can.bus_off())
    }

    /// Whether the node is error passive.
    #[must_use]
    pub fn error_passive(&self) -> bool {
        self.board.see_can(self.which, |can| can.error_passive())
    }

    /// The error counters.
    #[must_use]
    pub fn error_counters(&self) -> ErrorCounters {
        self.board.see_can(self.which, |can| can.error_counters())
    }
}
