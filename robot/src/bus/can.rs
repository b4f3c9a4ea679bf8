//! What the CAN controller says about the bus: its error counters, and what others are told of
//! them.
//!
//! A connector that works loose or a missing terminator shows here first, long before frames are
//! lost for good: a controller repeats what failed. Error passive is announced by the emergency
//! message CiA 301 has for it (0x8120) and shown as a limit for as long as it lasts. It stops
//! nobody: what stops a group is a frame that did not come.

use canopen::{Emergency, ErrorClass};
use control::time::Micros;

use super::{BusSide, device_time};

/// Error counters of the CAN controller (ISO 11898-1).
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CanErrors {
    /// Transmit error counter.
    pub transmit: u8,
    /// Receive error counter.
    pub receive: u8,
    /// The last error, as object 0x2130:3 has it; 0 for none.
    pub last: u8,
}

/// From here on a controller is error passive.
const PASSIVE: u8 = 128;
/// From here on CAN controllers warn; below, what was wrong is over.
const WARNING: u8 = 96;

impl BusSide {
    /// Takes in the error counters of the CAN controller; nothing happens when they have not
    /// changed.
    pub fn on_can_errors(&mut self, now: Micros, errors: &CanErrors) {
        let record = &mut self.dictionary.can;
        let last = match errors.last {
            0 => record.errors.last,
            last => last,
        };
        record.errors = CanErrors { last, ..*errors };
        if record.off {
            // A controller begins at zero when it comes back, which is not an error that went away
            // by itself. Back on the bus, 0x8140 says so first.
            return;
        }
        let worst = errors.transmit.max(errors.receive);
        if worst >= PASSIVE && !record.passive {
            record.passive = true;
            record.passives = record.passives.wrapping_add(1);
            self.announce_passive(now);
        } else if worst < WARNING && record.passive {
            record.passive = false;
            self.device
                .clear_error(device_time(now), Emergency::CAN_PASSIVE, 0);
        }
    }

    /// Says so, after a reset of the communication once more.
    pub(super) fn announce_passive(&mut self, now: Micros) {
        if self.dictionary.can.passive {
            let class = ErrorClass::Communication;
            let info = [0; 5];
            self.device
                .raise_error(device_time(now), Emergency::CAN_PASSIVE, class, info);
        }
    }
}

/// What object 0x2130 shows.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct CanRecord {
    pub errors: CanErrors,
    /// Error passive, or not yet well again.
    pub passive: bool,
    pub passives: u32,
    /// Bus-off, and not back yet.
    pub off: bool,
    pub bus_offs: u32,
}
