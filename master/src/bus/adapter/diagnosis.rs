//! What an adapter says about the state of the bus, in words that say what to check.
//!
//! Adapters notice what a master cannot: frames that no node acknowledges or can read because the
//! bit rate is wrong. The reading thread leaves the latest such report here; it is shown when
//! robots do not answer.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// The latest report, shared between the reading thread and the link.
#[derive(Clone, Default)]
pub(super) struct Diagnosis {
    text: Arc<Mutex<Option<&'static str>>>,
    /// Inquiries that the adapter has answered.
    inquiries: Arc<AtomicU32>,
}

impl Diagnosis {
    pub fn report(&self, text: Option<&'static str>) {
        *self.text.lock().unwrap_or_else(PoisonError::into_inner) = text;
    }

    pub fn read(&self) -> Option<&'static str> {
        *self.text.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The adapter has answered an inquiry.
    pub fn answered(&self) {
        self.inquiries.fetch_add(1, Ordering::Relaxed);
    }

    pub fn inquiries(&self) -> u32 {
        self.inquiries.load(Ordering::Relaxed)
    }
}

pub(super) const NO_ACKNOWLEDGE: &str = "no other node acknowledges frames: check that a robot is \
    powered, CAN high and low are not swapped, 120 ohm are at both ends, and the bit rate is 1 \
    Mbit/s everywhere";
#[cfg(all(feature = "adapters", target_os = "linux"))]
pub(super) const BUS_OFF: &str = "the adapter went bus-off after too many errors: check \
    CAN high and low for a short circuit, 120 ohm at both ends, and that the bit rate is 1 Mbit/s \
    everywhere";
pub(super) const BUS_ERRORS: &str = "the adapter reports errors on the bus: check that the bit rate is 1 \
    Mbit/s everywhere, the wiring, and 120 ohm at both ends";
pub(super) const REFUSES: &str = "the adapter refuses to send: no node acknowledges its frames, \
    or its channel is not open; check that a robot is powered and 120 ohm are at both ends";

/// From the class bits of a SocketCAN error frame (linux/can/error.h).
#[cfg(all(feature = "adapters", target_os = "linux"))]
pub(super) const fn of_error_frame(bits: u32) -> Option<&'static str> {
    const CONTROLLER: u32 = 0x04;
    const PROTOCOL: u32 = 0x08;
    const ACKNOWLEDGE: u32 = 0x20;
    const OFF: u32 = 0x40;
    const BUS_ERROR: u32 = 0x80;
    const RESTARTED: u32 = 0x100;
    if bits & OFF != 0 {
        Some(BUS_OFF)
    } else if bits & ACKNOWLEDGE != 0 {
        Some(NO_ACKNOWLEDGE)
    } else if bits & RESTARTED != 0 {
        None
    } else if bits & (PROTOCOL | BUS_ERROR | CONTROLLER) != 0 {
        Some(BUS_ERRORS)
    } else {
        None
    }
}

/// From the status flags of an slcan adapter.
pub(super) const fn of_slcan_flags(flags: u8) -> Option<&'static str> {
    use can_text::slcan::flags::{BUS_ERROR, PASSIVE, TRANSMIT_FULL};
    if flags & PASSIVE != 0 || flags & TRANSMIT_FULL != 0 {
        Some(NO_ACKNOWLEDGE)
    } else if flags & BUS_ERROR != 0 {
        Some(BUS_ERRORS)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn the_worst_of_an_error_frame_is_told() {
        assert_eq!(of_error_frame(0x40 | 0x20 | 0x08), Some(BUS_OFF));
        assert_eq!(of_error_frame(0x20), Some(NO_ACKNOWLEDGE));
        assert_eq!(of_error_frame(0x08 | 0x80), Some(BUS_ERRORS));
        assert_eq!(of_error_frame(0x100), None);
        assert_eq!(of_error_frame(0x02), None);
    }

    #[test]
    fn slcan_flags_in_words() {
        assert_eq!(of_slcan_flags(0), None);
        assert_eq!(of_slcan_flags(0x20), Some(NO_ACKNOWLEDGE));
        assert_eq!(of_slcan_flags(0x80), Some(BUS_ERRORS));
        // A lost arbitration and a warning are nothing to worry about.
        assert_eq!(of_slcan_flags(0x40 | 0x04), None);
    }
}
