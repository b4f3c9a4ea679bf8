//! SYNC: applies the waiting RPDOs, then lets the application and the synchronous TPDOs have their
//! turn.

use super::Core;
use crate::{Config, Event, Frame, Micros, NmtState, ObjectDictionary};

/// The pre-defined identifier.
const SYNC: u32 = 0x80;

pub(super) struct Sync {
    /// 0x1005.
    pub cob_id: u32,
    /// 0x1019: highest counter, 0 for none.
    pub overflow: u8,
    /// Counter of the last SYNC, if it had one.
    counter: Option<u8>,
    /// A SYNC came and its TPDOs have not been sent yet.
    waits: bool,
}

impl Sync {
    pub const fn new(config: &Config) -> Self {
        Self {
            cob_id: SYNC,
            overflow: config.sync_overflow,
            counter: None,
            waits: false,
        }
    }

    pub const fn id(&self) -> u16 {
        crate::bytes::low_u16(self.cob_id)
    }

    pub const fn counter(&self) -> Option<u8> {
        self.counter
    }

    pub const fn waits_for_application(&self) -> bool {
        self.waits
    }

    /// Forgets the last SYNC.
    pub fn clear(&mut self) {
        self.counter = None;
        self.waits = false;
    }

    /// Takes a new counter; returns what it should have been if SYNCs are missing.
    fn advance(&mut self, counter: Option<u8>) -> Option<(u8, u8)> {
        let last = self.counter;
        self.counter = counter;
        let (last, received) = last.zip(counter)?;
        let expected = match self.overflow {
            // Without 0x1019 the turn-over is not known; every 1 could be one.
            0 if received == 1 => 1,
            overflow if overflow != 0 && last >= overflow => 1,
            _ => last.saturating_add(1),
        };
        (received != expected).then_some((expected, received))
    }
}

impl Core {
    pub(super) fn on_sync<O: ObjectDictionary>(&mut self, now: Micros, frame: &Frame, od: &mut O) {
        let counter = match (self.state, frame.data()) {
            (NmtState::Initialising | NmtState::Stopped, _) => return,
            (NmtState::PreOperational | NmtState::Operational, &[]) => None,
            (NmtState::PreOperational | NmtState::Operational, &[counter]) => Some(counter),
            (NmtState::PreOperational | NmtState::Operational, _) => return,
        };
        let applied = self.apply_rpdos(od);
        if let Some((expected, received)) = self.sync.advance(counter) {
            self.out.count(|counters| &mut counters.sync_gaps);
            self.out.emit(Event::SyncGap { expected, received });
        }
        self.sync.waits = true;
        let at = now;
        self.out.emit(Event::Sync {
            counter,
            at,
            applied,
        });
    }

    pub(super) fn on_sync_done<O: ObjectDictionary>(&mut self, now: Micros, od: &mut O) {
        if core::mem::take(&mut self.sync.waits) {
            self.send_synchronous_tpdos(now, od);
        }
    }
}
