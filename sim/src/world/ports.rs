//! What waits at a port: frames of a program, in both directions.

use std::collections::VecDeque;

use canopen::{Frame, Micros};

use crate::bus::errors::Confinement;

/// The frames of a port, and its state on the bus.
#[derive(Debug, Clone, Default)]
pub(super) struct PortQueues {
    /// Each with the time, ns, from which it is ready to be sent.
    pub send: VecDeque<(u64, Frame)>,
    /// Each with the time it was complete.
    pub received: VecDeque<(Micros, Frame)>,
    /// Received frames are not kept.
    pub deaf: bool,
    /// Error counters.
    pub errors: Confinement,
    /// While bus-off: when it is back, ns.
    pub back_ns: u64,
}

impl PortQueues {
    /// Spreads the frames that are ready from `ready_ns` on over `over_ns` behind it.
    pub fn spread(&mut self, ready_ns: u64, over_ns: u64) {
        let new = self.send.iter_mut().filter(|(at, _)| *at == ready_ns);
        let new: Vec<&mut u64> = new.map(|(at, _)| at).collect();
        let count = new.len() as u64;
        for (place, at) in (0..count).zip(new) {
            *at += over_ns * place / count;
        }
    }
}
