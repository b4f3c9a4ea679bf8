//! Fault confinement of ISO 11898-1: a node's error counters and states.
//!
//! An error adds 8 to the counter of the transmitter, 1 to that of a receiver, and 9 to that of the
//! receiver that detected it first (1, and 8 because it still receives dominant bits after its own
//! flag). A good frame subtracts 1. Above 127 a node is error passive: its error flags are
//! recessive and destroy no frame, and after sending it waits for eight bits. Above 255 a node is
//! bus-off; it recovers after 128 times 11 recessive bits.

pub use emulator::ErrorCounters;

use super::BIT_NS;

/// Time from the wish to come back from bus-off to being back, ns, on a bus that is quiet enough.
pub const RECOVERY_NS: u64 = 128 * 11 * BIT_NS;
/// Bits by which an error-passive node waits longer than the others after sending.
pub const SUSPEND: u32 = 8;

/// What a transmitter saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TransmitError {
    /// A bit on the wire was not the one it sent.
    Bit,
    /// A bit of the fixed form was wrong: a receiver has refused the frame.
    Form,
    /// No node acknowledged.
    Acknowledge,
}

/// What a node may still do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ErrorState {
    /// Everything.
    #[default]
    Active,
    /// Send and receive, but not destroy others' frames.
    Passive,
    /// Nothing.
    BusOff,
}

/// Counters and state of one CAN controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confinement {
    counters: ErrorCounters,
    off: bool,
}

impl Confinement {
    /// Limit of the error-active state.
    const ACTIVE: u32 = 127;
    /// Limit of a transmitter on the bus.
    const ON_BUS: u32 = 255;

    /// What the node may still do.
    #[must_use]
    pub fn state(&self) -> ErrorState {
        let ErrorCounters { transmit, receive } = self.counters;
        if self.off {
            ErrorState::BusOff
        } else if transmit > Self::ACTIVE || receive > Self::ACTIVE {
            ErrorState::Passive
        } else {
            ErrorState::Active
        }
    }

    /// The counters.
    #[must_use]
    pub fn counters(&self) -> ErrorCounters {
        self.counters
    }

    /// A frame of its own went out.
    pub fn transmitted(&mut self) {
        self.counters.transmit = self.counters.transmit.saturating_sub(1);
    }

    /// A frame of another node came in.
    pub fn received(&mut self) {
        let receive = &mut self.counters.receive;
        *receive = if *receive > Self::ACTIVE {
            // ISO 11898-1: to a value between 119 and 127; bxCAN takes 120.
            120
        } else {
            receive.saturating_sub(1)
        };
    }

    /// A frame of its own failed; `true` when that took it off the bus.
    pub fn transmit_failed(&mut self, error: TransmitError) -> bool {
        // A node that is alone becomes passive and stays so.
        let alone = error == TransmitError::Acknowledge && self.state() == ErrorState::Passive;
        if self.off || alone {
            return false;
        }
        self.counters.transmit += 8;
        self.off = self.counters.transmit > Self::ON_BUS;
        self.off
    }

    /// A frame of another node was broken; `first`: this node was the first to see it.
    pub fn receive_failed(&mut self, first: bool) {
        let more = if first { 9 } else { 1 };
        self.counters.receive = (self.counters.receive + more).min(Self::ON_BUS);
    }

    /// Back from bus-off.
    pub fn recovered(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_errors_to_passive_and_thirty_two_to_bus_off() {
        let mut node = Confinement::default();
        for n in 1..=32 {
            let off = node.transmit_failed(TransmitError::Bit);
            let wanted = match n {
                ..16 => ErrorState::Active,
                16..32 => ErrorState::Passive,
                _ => ErrorState::BusOff,
            };
            assert_eq!((node.state(), off), (wanted, n == 32), "{n}");
        }
        node.recovered();
        assert_eq!(node, Confinement::default());
    }

    #[test]
    fn a_missing_acknowledge_never_leads_to_bus_off() {
        let mut node = Confinement::default();
        for _ in 0..1_000 {
            assert!(!node.transmit_failed(TransmitError::Acknowledge));
        }
        assert_eq!(node.counters().transmit, 128);
        assert_eq!(node.state(), ErrorState::Passive);
        node.transmitted();
        assert_eq!(node.state(), ErrorState::Active);
    }

    #[test]
    fn fifteen_first_errors_make_a_receiver_passive_and_a_frame_heals_it() {
        let mut node = Confinement::default();
        (0..14).for_each(|_| node.receive_failed(true));
        assert_eq!(
            (node.counters().receive, node.state()),
            (126, ErrorState::Active)
        );
        node.receive_failed(false);
        node.receive_failed(false);
        assert_eq!(node.state(), ErrorState::Passive);
        node.received();
        assert_eq!(
            (node.counters().receive, node.state()),
            (120, ErrorState::Active)
        );
    }
}
