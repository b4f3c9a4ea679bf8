//! The error counters of the CAN controller, and what the robot reports of them.
//!
//! A loose connector or a missing terminator shows here long before frames are lost, because a
//! controller repeats frames that failed. Error passive is announced by the emergency message CiA
//! 301 has for it (0x8120) and shown as a limit for as long as it lasts. It does not stop the
//! group: only a missing frame does.

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

/// How the controller's state has changed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum CanChange {
    /// It is error passive now.
    Passive,
    /// It is well again.
    Active,
}

impl CanRecord {
    /// Takes in the counters.
    pub fn update(&mut self, errors: &CanErrors) -> Option<CanChange> {
        let last = match errors.last {
            0 => self.errors.last,
            last => last,
        };
        self.errors = CanErrors { last, ..*errors };
        if self.off {
            // A controller begins at zero when it comes back, which is not an error that went away
            // by itself. Back on the bus, 0x8140 says so first.
            return None;
        }
        let worst = errors.transmit.max(errors.receive);
        if worst >= PASSIVE && !self.passive {
            self.passive = true;
            self.passives = self.passives.wrapping_add(1);
            Some(CanChange::Passive)
        } else if worst < WARNING && self.passive {
            self.passive = false;
            Some(CanChange::Active)
        } else {
            None
        }
    }
}
