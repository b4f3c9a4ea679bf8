//! The LSS master: assigns node-IDs to devices with a known identity, or finds an unknown one
//! (fastscan, CiA 305).

use core::ops::RangeInclusive;

use crate::time::Timer;
use crate::{Frame, Identity, Micros, NodeId};

const REQUEST: u16 = 0x7E5;
const RESPONSE: u16 = 0x7E4;

/// An answer of an LSS slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LssAnswer {
    /// It has been selected by its identity.
    Selected,
    /// It takes the node-ID (0) or not (the error code).
    NodeIdSet(u8),
    /// It has stored its configuration (0) or not (the error code).
    Stored(u8),
    /// Its node-ID; `None` if it has none.
    Node(Option<NodeId>),
    /// A part of its identity: 0 vendor, 1 product, 2 revision, 3 serial number.
    Part(u8, u32),
    /// There is at least one that matches what was asked.
    Present,
}

/// Reads an answer; `None` if the frame is not one.
#[must_use]
pub fn parse_lss(frame: &Frame) -> Option<LssAnswer> {
    let (RESPONSE, &[command, a, b, c, d, _, _, _]) = (frame.id(), frame.data()) else {
        return None;
    };
    match command {
        0x44 => Some(LssAnswer::Selected),
        0x11 => Some(LssAnswer::NodeIdSet(a)),
        0x17 => Some(LssAnswer::Stored(a)),
        0x5E => Some(LssAnswer::Node(NodeId::new(a))),
        0x5A..=0x5D => {
            let number = u32::from_le_bytes([a, b, c, d]);
            Some(LssAnswer::Part(command - 0x5A, number))
        }
        0x4F | 0x50 => Some(LssAnswer::Present),
        _ => None,
    }
}

fn request(command: u8, value: u32) -> Frame {
    let [a, b, c, d] = value.to_le_bytes();
    Frame::of(REQUEST, [command, a, b, c, d, 0, 0, 0])
}

/// Switches every slave to configuration, or back to waiting.
#[must_use]
pub fn lss_switch_all(configuration: bool) -> Frame {
    request(0x04, u32::from(configuration))
}

/// Switches the one slave with this identity to configuration: four frames, in this order.
#[must_use]
pub fn lss_select(identity: &Identity) -> [Frame; 4] {
    [
        request(0x40, identity.vendor),
        request(0x41, identity.product),
        request(0x42, identity.revision),
        request(0x43, identity.serial),
    ]
}

/// Asks whether there is a slave with this vendor, product and revision and one of these serial
/// numbers: six frames, in this order. All that match answer with the same frame, and nothing
/// changes in them.
#[must_use]
pub fn lss_identify(identity: &Identity, serials: &RangeInclusive<u32>) -> [Frame; 6] {
    [
        request(0x46, identity.vendor),
        request(0x47, identity.product),
        request(0x48, identity.revision),
        request(0x49, identity.revision),
        request(0x4A, *serials.start()),
        request(0x4B, *serials.end()),
    ]
}

/// Gives a node-ID to the slaves in configuration, or takes it away.
#[must_use]
pub fn lss_set_node(node: Option<NodeId>) -> Frame {
    request(0x11, u32::from(node.map_or(0xFF, NodeId::get)))
}

/// Makes the slaves in configuration store what they have been given.
#[must_use]
pub fn lss_store() -> Frame {
    request(0x17, 0)
}

/// Asks the slave in configuration for its node-ID.
#[must_use]
pub fn lss_inquire_node() -> Frame {
    request(0x5E, 0)
}

/// How a fastscan ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scanned {
    /// A device without a node-ID has been found; it is in configuration now.
    Found(Identity),
    /// No slave is unconfigured: none without a node-ID has answered.
    NoUnconfiguredSlave,
    /// There was one, but it stopped answering.
    Lost,
}

/// Finds one device without a node-ID by asking for the bits of its identity, one at a time: 133
/// questions. Several devices are found one after the other, the one with the smaller number first.
pub struct FastScan {
    /// How long an answer may take.
    timeout: Micros,
    timer: Timer,
    outgoing: Option<Frame>,
    found: [u32; 4],
    /// Which number is being searched, and down to which bit; 0x80 asks whether any device answers.
    part: u8,
    bit: u8,
    /// Asking whether the whole number is right.
    confirming: bool,
}

impl FastScan {
    const ANY_DEVICE: u8 = 0x80;

    /// Begins a scan; an answer may take `timeout`.
    #[must_use]
    pub fn new(now: Micros, timeout: Micros) -> Self {
        let mut scan = Self {
            timeout,
            timer: Timer::OFF,
            outgoing: None,
            found: [0; 4],
            part: 0,
            bit: Self::ANY_DEVICE,
            confirming: false,
        };
        scan.ask(now);
        scan
    }

    /// The next frame to send.
    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.outgoing.take()
    }

    /// When [`poll`](Self::poll) has something to do.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Micros> {
        self.timer.is_on().then(|| self.timer.moment())
    }

    /// Hands over a received frame.
    pub fn on_frame(&mut self, now: Micros, frame: &Frame) -> Option<Scanned> {
        match parse_lss(frame) {
            Some(LssAnswer::Present) if self.timer.is_on() => self.advance(now, true),
            _ => None,
        }
    }

    /// No device answered in time.
    pub fn poll(&mut self, now: Micros) -> Option<Scanned> {
        match self.timer.due(now) {
            true => self.advance(now, false),
            false => None,
        }
    }

    fn advance(&mut self, now: Micros, answered: bool) -> Option<Scanned> {
        if self.bit == Self::ANY_DEVICE {
            if !answered {
                return self.end(Scanned::NoUnconfiguredSlave);
            }
            self.bit = 31;
        } else if self.confirming {
            if !answered {
                return self.end(Scanned::Lost);
            }
            if self.part == 3 {
                let [vendor, product, revision, serial] = self.found;
                return self.end(Scanned::Found(Identity {
                    vendor,
                    product,
                    revision,
                    serial,
                }));
            }
            (self.part, self.bit, self.confirming) = (self.part.saturating_add(1), 31, false);
        } else {
            if !answered && let Some(number) = self.found.get_mut(usize::from(self.part)) {
                *number |= 1u32.checked_shl(u32::from(self.bit)).unwrap_or(0);
            }
            match self.bit.checked_sub(1) {
                Some(bit) => self.bit = bit,
                None => self.confirming = true,
            }
        }
        self.ask(now);
        None
    }

    fn end(&mut self, how: Scanned) -> Option<Scanned> {
        self.timer = Timer::OFF;
        Some(how)
    }

    fn ask(&mut self, now: Micros) {
        let number = self.found.get(usize::from(self.part)).copied();
        let [a, b, c, d] = number.unwrap_or(0).to_le_bytes();
        let next = match self.confirming {
            true => self.part.saturating_add(1) & 3,
            false => self.part,
        };
        self.timer = Timer::at(now + self.timeout);
        self.outgoing = Some(Frame::of(
            REQUEST,
            [0x51, a, b, c, d, self.bit, self.part, next],
        ));
    }
}
