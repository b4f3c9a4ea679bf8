//! The events that the device reports to the application.

use crate::{AbortCode, NmtCommand, NmtState, NodeId};

/// A set of receive PDOs by number, 1 to 32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RpdoSet(pub(crate) u32);

impl RpdoSet {
    /// Whether RPDO `number` (1 is 0x1400) is in the set.
    #[must_use]
    pub const fn contains(self, number: u8) -> bool {
        matches!(number, 1..=32) && self.0 >> (number - 1) & 1 == 1
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// Something the application may want to act on. Events come in the order of their causes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Event {
    /// An NMT command for this node came in. The change it makes, if any, is the next event.
    NmtCommand(NmtCommand),
    /// The NMT state has changed, at resets also from and to `Initialising`.
    NmtChanged {
        /// The state before.
        from: NmtState,
        /// The state now.
        to: NmtState,
    },
    /// The SYNC counter skipped: SYNC frames have been lost.
    SyncGap {
        /// The counter that should have come.
        expected: u8,
        /// The one that came.
        received: u8,
    },
    /// No SYNC came within one and a half periods (0x1006) while OPERATIONAL.
    SyncLost,
    /// An event-driven RPDO (type 254 or 255) was received and written.
    RpdoApplied {
        /// 1 is 0x1400.
        number: u8,
    },
    /// An RPDO was shorter than its mapping and has been discarded.
    RpdoTooShort {
        /// 1 is 0x1400.
        number: u8,
    },
    /// An RPDO did not come within its deadline (event timer).
    RpdoLate {
        /// 1 is 0x1400.
        number: u8,
    },
    /// The application refused an object of an RPDO.
    RpdoRefused {
        /// 1 is 0x1400.
        number: u8,
        /// Why.
        code: AbortCode,
    },
    /// A heartbeat of a monitored node was received for the first time, or again after it was lost.
    HeartbeatStarted {
        /// Whose heartbeat.
        node: NodeId,
        /// Its state.
        state: NmtState,
    },
    /// A monitored node has changed its state.
    HeartbeatChanged {
        /// Whose heartbeat.
        node: NodeId,
        /// Its state now; `Initialising` is its boot-up.
        state: NmtState,
    },
    /// No heartbeat of a monitored node was received within its consumer heartbeat time.
    HeartbeatLost {
        /// Whose heartbeat.
        node: NodeId,
    },
    /// Communication has failed (heartbeat lost or bus-off) and object 0x1029 has changed the NMT
    /// state; the change is the event before.
    CommunicationError,
    /// The CAN controller went bus-off; frames waiting to be sent have been dropped.
    BusOff,
    /// The pause after a bus-off is over: bring the CAN controller back, then call
    /// [`on_bus_recovered`](crate::Device::on_bus_recovered).
    RecoverBus,
    /// The device is back on the bus.
    BusRecovered,
    /// An SDO client has written an object, successfully.
    ObjectWritten {
        /// Index of the object.
        index: u16,
        /// Sub-index of the object.
        sub: u8,
    },
}

/// Counts of errors since the start; never reset, wrapping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Frames that found the transmit queue full and were dropped.
    pub tx_overflow: u32,
    /// Events that found the event queue full and were dropped.
    pub event_overflow: u32,
    /// Gaps seen in the SYNC counter.
    pub sync_gaps: u32,
    /// SYNCs that did not come in time.
    pub syncs_lost: u32,
    /// RPDOs that did not come in time, and synchronous ones outside the window of 0x1007.
    pub pdos_late: u32,
    /// RPDOs that were too short for their mapping.
    pub rpdo_too_short: u32,
    /// RPDO objects the application refused.
    pub rpdo_refused: u32,
    /// Times the CAN controller went bus-off.
    pub bus_off: u32,
    /// SDO transfers this device aborted.
    pub sdo_aborts: u32,
    /// Heartbeats of monitored nodes that did not come in time.
    pub heartbeats_lost: u32,
}
