//! The LSS slave: a master finds the device by its identity and assigns it a node-ID (CiA 305).
//!
//! Requests arrive on 0x7E5 and answers are sent on 0x7E4, in every NMT state and also without a
//! node-ID. A device without a node-ID boots as soon as it has received one and is switched back to
//! waiting; a device that has one applies the new one at the next reset. The bit rate cannot be
//! changed, because the board sets it: *configure bit timing* (0x13) is always answered with error
//! 1, not supported.
//!
//! Two devices must not get the same node-ID. A node-ID is therefore neither accepted nor stored
//! while the device is OPERATIONAL or the application forbids it (error 0xFF), the global switch
//! into configuration is ignored then, and a device that was switched by it accepts no node-ID if
//! it knows of another device: one whose heartbeat it has received since its boot-up, or that has
//! answered to LSS since the switch. A device that was selected or found by fastscan is unique.
//! Limit: two devices without a node-ID that answer in the same bits do not detect each other.

use super::Core;
use crate::bytes::{high_u16, low_u16};
use crate::{
    AbortCode, Application, Frame, Identity, Micros, NmtState, NodeId, ResetScope, StoreProgress,
};

pub(super) const REQUEST: u16 = 0x7E5;
pub(super) const RESPONSE: u16 = 0x7E4;

/// "No node-ID" on the wire.
const UNCONFIGURED: u8 = 0xFF;

/// The error code of a node-ID or a bit rate that cannot be.
const REFUSED: u8 = 1;
/// The error code of what cannot be done now.
const NOT_NOW: u8 = 0xFF;

#[derive(Clone)]
pub(super) struct Lss {
    /// Listens to configuration commands.
    configuring: bool,
    /// It was switched by the global command.
    with_all: bool,
    /// A frame of another device has been received.
    pub crowded: bool,
    /// How many parts of the identity have matched in a selective switch.
    selected: u8,
    /// How many parts of the identity a remote identification has matched.
    identified: u8,
    /// Which part of the identity fastscan is at.
    scanned: u8,
    /// The node-ID is being saved.
    storing: bool,
    /// The node-ID from the next reset on.
    pub node: Option<NodeId>,
}

impl Lss {
    pub const fn new(node: Option<NodeId>) -> Self {
        Self {
            configuring: false,
            with_all: false,
            crowded: false,
            selected: 0,
            identified: 0,
            scanned: 0,
            storing: false,
            node,
        }
    }
}

/// Vendor, product, revision or serial number.
const fn part(identity: &Identity, which: u8) -> Option<u32> {
    match which {
        0 => Some(identity.vendor),
        1 => Some(identity.product),
        2 => Some(identity.revision),
        3 => Some(identity.serial),
        _ => None,
    }
}

impl Core {
    pub(super) fn on_lss(&mut self, now: Micros, frame: &Frame, app: &mut dyn Application) {
        if frame.len() != 8 {
            return;
        }
        let [command, a, b, c, d, ..] = *frame.padded();
        let number = u32::from_le_bytes([a, b, c, d]);
        let configuring = self.lss.configuring;
        match command {
            0x04 => self.switch_lss(now, a, app),
            0x40..=0x43 if !configuring => self.select_lss(command - 0x40, number),
            0x46..=0x4B => self.identify_lss(command - 0x46, number),
            0x4C if self.node.is_none() && self.lss.node.is_none() => self.answer_lss(0x50, [0; 4]),
            0x51 if !configuring => self.scan_lss(frame),
            0x11 if configuring => {
                let error = if !self.may_change_node(app) {
                    NOT_NOW
                } else if a == UNCONFIGURED || self.config.permits_node(a) {
                    self.lss.node = NodeId::new(a);
                    0
                } else {
                    REFUSED
                };
                self.answer_lss(0x11, [error, 0, 0, 0]);
            }
            0x13 if configuring => self.answer_lss(0x13, [REFUSED, 0, 0, 0]),
            0x17 if configuring && !self.may_change_node(app) => {
                self.answer_lss(0x17, [NOT_NOW, 0, 0, 0]);
            }
            0x17 if configuring => self.store_lss(app),
            0x5A..=0x5D if configuring => {
                let number = part(&self.config.identity, command - 0x5A).unwrap_or(0);
                self.answer_lss(command, number.to_le_bytes());
            }
            0x5E if configuring => {
                let node = self.node.map_or(UNCONFIGURED, NodeId::get);
                self.answer_lss(0x5E, [node, 0, 0, 0]);
            }
            _ => {}
        }
    }

    /// Whether it may become another node, or store which one it is.
    fn may_change_node(&self, app: &dyn Application) -> bool {
        let among_others = self.lss.with_all && self.lss.crowded;
        self.state != NmtState::Operational && !among_others && app.may_change_node()
    }

    /// Another device has answered an LSS master: a node-ID given to all devices is not accepted.
    pub(super) fn on_lss_answer(&mut self) {
        if self.lss.configuring && self.lss.with_all {
            self.lss.crowded = true;
            self.lss.node = self.node;
        }
    }

    /// Store configuration.
    fn store_lss(&mut self, app: &mut dyn Application) {
        if self.storing {
            return self.answer_lss_store(Err(AbortCode::DeviceState));
        }
        let node = self.lss.node;
        let saved = match app.storage() {
            Some(storage) => storage.save_node(node),
            None => Err(AbortCode::UnsupportedAccess),
        };
        match saved {
            Ok(StoreProgress::Pending) => {
                self.storing = true;
                self.lss.storing = true;
            }
            Ok(StoreProgress::Done) => self.answer_lss_store(Ok(())),
            Err(code) => self.answer_lss_store(Err(code)),
        }
    }

    /// The node-ID has been saved, or not. `false` if it was not that which was being saved.
    pub(super) fn finish_lss_store(&mut self, result: Result<(), AbortCode>) -> bool {
        let was_storing = core::mem::take(&mut self.lss.storing);
        if was_storing {
            self.storing = false;
            self.answer_lss_store(result);
        }
        was_storing
    }

    fn answer_lss_store(&mut self, result: Result<(), AbortCode>) {
        let error = match result {
            Ok(()) => 0,
            Err(AbortCode::UnsupportedAccess) => 1,
            Err(_) => 2,
        };
        self.answer_lss(0x17, [error, 0, 0, 0]);
    }

    fn answer_lss(&mut self, command: u8, value: [u8; 4]) {
        let [a, b, c, d] = value;
        let answer = [command, a, b, c, d, 0, 0, 0];
        self.out.send(Frame::of(RESPONSE, answer));
    }

    /// Switch state global.
    fn switch_lss(&mut self, now: Micros, mode: u8, app: &mut dyn Application) {
        match mode {
            0 => {
                self.lss.configuring = false;
                if self.node.is_none() && self.lss.node.is_some() {
                    self.reset(now, ResetScope::Communication, app);
                }
            }
            1 if self.state != NmtState::Operational => {
                (self.lss.configuring, self.lss.with_all) = (true, true);
            }
            _ => {}
        }
        (self.lss.selected, self.lss.scanned) = (0, 0);
    }

    /// One of the four frames of switch state selective.
    fn select_lss(&mut self, which: u8, number: u32) {
        let in_order = self.lss.selected == which || which == 0;
        self.lss.selected = match in_order && part(&self.config.identity, which) == Some(number) {
            true => which.saturating_add(1),
            false => 0,
        };
        if self.lss.selected == 4 {
            self.lss.selected = 0;
            (self.lss.configuring, self.lss.with_all) = (true, false);
            self.answer_lss(0x44, [0; 4]);
        }
    }

    /// One of the six frames of identify remote slave: vendor, product, then the bounds of revision
    /// and serial number.
    fn identify_lss(&mut self, which: u8, number: u32) {
        let identity = &self.config.identity;
        let matches = match which {
            0 => identity.vendor == number,
            1 => identity.product == number,
            // The major revisions must be the same, the minor one lie between.
            2 => {
                high_u16(identity.revision) == high_u16(number)
                    && low_u16(identity.revision) >= low_u16(number)
            }
            3 => {
                high_u16(identity.revision) == high_u16(number)
                    && low_u16(identity.revision) <= low_u16(number)
            }
            4 => identity.serial >= number,
            _ => identity.serial <= number,
        };
        let in_order = self.lss.identified == which || which == 0;
        self.lss.identified = match in_order && matches {
            true => which.saturating_add(1),
            false => 0,
        };
        if self.lss.identified == 6 {
            self.lss.identified = 0;
            self.answer_lss(0x4F, [0; 4]);
        }
    }

    /// Fastscan: only a device without a node-ID takes part.
    fn scan_lss(&mut self, frame: &Frame) {
        if self.node.is_some() || self.lss.node.is_some() {
            return;
        }
        let [_, a, b, c, d, bit, sub, next] = *frame.padded();
        let number = u32::from_le_bytes([a, b, c, d]);
        if bit == 0x80 {
            self.lss.scanned = 0;
            return self.answer_lss(0x4F, [0; 4]);
        }
        let Some(own) = part(&self.config.identity, sub) else {
            return;
        };
        let differs = (own ^ number).checked_shr(u32::from(bit)).unwrap_or(1);
        if sub != self.lss.scanned || next > 3 || differs != 0 {
            return;
        }
        if bit == 0 {
            // The last part confirmed: this device is found.
            self.lss.configuring = sub == 3 && next == 0;
            self.lss.with_all = false;
            self.lss.scanned = next;
        }
        self.answer_lss(0x4F, [0; 4]);
    }
}
