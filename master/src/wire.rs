//! A link with the two things every conversation over it needs: the master's heartbeat, and a place
//! for frames that arrive while something else is waited for.
//!
//! The backlog is filled by SDO transfers and emptied by [`Wire::next`], which gives out what waited
//! before it asks the link again, so the order of frames is kept. It holds what arrives during one
//! transfer: some hundred frames at most on a busy bus.

use std::collections::VecDeque;

use canopen::{Frame, Micros, NmtState, NodeId, client};

use crate::error::MasterError;
use crate::link::Link;

/// The master's own node id.
const MASTER: NodeId = match NodeId::new(protocol::MASTER) {
    Some(node) => node,
    None => NodeId::MIN,
};
/// Period of the master's heartbeat, in µs.
pub const HEARTBEAT_PERIOD_US: u64 = 100_000;

/// A link in use.
pub struct Wire<L> {
    pub(crate) link: L,
    /// When the next heartbeat is due; `None` on a bus that is only listened to.
    next_heartbeat: Option<Micros>,
    pub(crate) backlog: VecDeque<(Micros, Frame)>,
}

impl<L: Link> Wire<L> {
    /// Takes over a link, as its master: with a heartbeat.
    #[must_use]
    pub fn commanding(link: L) -> Self {
        let next_heartbeat = Some(link.now());
        Self {
            link,
            next_heartbeat,
            backlog: VecDeque::new(),
        }
    }

    /// Takes over a link without claiming to be its master: no heartbeat.
    #[must_use]
    pub fn visiting(link: L) -> Self {
        Self {
            link,
            next_heartbeat: None,
            backlog: VecDeque::new(),
        }
    }

    /// Time on the link's clock.
    #[must_use]
    pub fn now(&self) -> Micros {
        self.link.now()
    }

    /// Sends a frame.
    ///
    /// # Errors
    /// When the link fails.
    pub fn send(&mut self, frame: &Frame) -> Result<(), MasterError> {
        Ok(self.link.send(frame)?)
    }

    /// Sends the master's heartbeat when it is due.
    pub(crate) fn beat(&mut self) -> Result<(), MasterError> {
        let now = self.link.now();
        if self.next_heartbeat.is_some_and(|due| now >= due) {
            let frame = client::heartbeat(MASTER, NmtState::Operational);
            self.link.send(&frame)?;
            self.next_heartbeat = Some(now + Micros(HEARTBEAT_PERIOD_US));
        }
        Ok(())
    }

    /// When to stop waiting so that neither `deadline` nor the master's heartbeat is missed.
    pub(crate) fn wake(&self, deadline: Micros) -> Micros {
        self.next_heartbeat
            .map_or(deadline, |heartbeat| heartbeat.min(deadline))
    }

    /// The next frame that arrives before `until`; `None` once `until` has come. The heartbeat goes
    /// on meanwhile.
    ///
    /// # Errors
    /// When the link fails.
    pub fn next(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, MasterError> {
        if let Some(waiting) = self.backlog.pop_front() {
            return Ok(Some(waiting));
        }
        loop {
            self.beat()?;
            let stop = self.wake(until);
            let received = self.link.receive(stop)?;
            if received.is_some() || stop >= until {
                return Ok(received);
            }
        }
    }
}
