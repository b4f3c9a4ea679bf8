//! Saving and restoring parameters: objects 0x1010 and 0x1011.
//!
//! The image of the communication objects is a sequence of writes: index, sub-index, length, value.
//! It holds only what differs from the configuration; loading it is writing it, with all the checks
//! of a write.
//!
//! The COB-ID of a PDO or of the emergency message has four bytes where a client has given it an
//! identifier of its own. Where it has the default one, it has one byte, bits 24 to 31 of the
//! entry. Loading changes only these, and the rest is the default of the node that loads: the
//! identifier follows the node-ID, although the PDO has been changed. Images without this form, of
//! earlier versions, have four bytes everywhere and pin the identifier of the node that saved them.

use super::heartbeat::Consumer;
use super::objects::Value;
use super::pdo::{self, Map};
use super::{Core, emergency};
use crate::{AbortCode, Application, Micros, StoreProgress, StoreScope};

/// Bytes of the longest image.
const IMAGE: usize = 512;

/// What an image keeps of a COB-ID with the default identifier.
const FLAGS: u32 = 0xFF << 24;

const SAVE: u32 = u32::from_le_bytes(*b"save");
const LOAD: u32 = u32::from_le_bytes(*b"load");

/// Collects an image.
struct Image {
    bytes: [u8; IMAGE],
    len: usize,
}

impl Image {
    fn push(&mut self, byte: u8) -> Result<(), AbortCode> {
        *self.bytes.get_mut(self.len).ok_or(AbortCode::CannotStore)? = byte;
        self.len = self.len.saturating_add(1);
        Ok(())
    }

    fn add(&mut self, index: u16, sub: u8, value: u32, len: u8) -> Result<(), AbortCode> {
        let [low, high] = index.to_le_bytes();
        for byte in [low, high, sub, len] {
            self.push(byte)?;
        }
        for byte in value.to_le_bytes().into_iter().take(usize::from(len)) {
            self.push(byte)?;
        }
        Ok(())
    }

    /// Adds an identifier: as it is, or that it is the default one. Inlined, it would cost flash.
    #[inline(never)]
    fn add_cob_id(
        &mut self,
        index: u16,
        sub: u8,
        cob_id: u32,
        default: u32,
    ) -> Result<(), AbortCode> {
        match (cob_id ^ default) & !FLAGS {
            0 => self.add(index, sub, cob_id >> 24, 1),
            _ => self.add(index, sub, cob_id, 4),
        }
    }
}

/// The next write of an image, and what is behind it.
fn next_write(image: &[u8]) -> Option<(u16, u8, &[u8], &[u8])> {
    let (&[low, high, sub, len], rest) = image.split_first_chunk()?;
    let (value, rest) = rest.split_at_checked(usize::from(len))?;
    Some((u16::from_le_bytes([low, high]), sub, value, rest))
}

impl Core {
    /// A write to sub-index 1 to 3 of 0x1010 or 0x1011.
    pub(super) fn store(
        &mut self,
        saves: bool,
        sub: u8,
        signature: u32,
        app: &mut dyn Application,
    ) -> Result<(), AbortCode> {
        let scope = match sub {
            1 => StoreScope::All,
            2 => StoreScope::Communication,
            _ => StoreScope::Application,
        };
        // Anything but the signature could be a mistake (CiA 301, 7.5.2.13).
        if signature != if saves { SAVE } else { LOAD } {
            return Err(AbortCode::CannotStore);
        }
        if self.storing {
            return Err(AbortCode::DeviceState);
        }
        let mut image = Image {
            bytes: [0; IMAGE],
            len: 0,
        };
        if saves && scope.has_communication() {
            self.collect(&mut image)?;
        }
        let storage = app.storage().ok_or(AbortCode::Hardware)?;
        let progress = match saves {
            true => storage.save(scope, image.bytes.get(..image.len).unwrap_or(&[]))?,
            false => storage.restore(scope)?,
        };
        self.storing = progress == StoreProgress::Pending;
        Ok(())
    }

    /// Brings back the communication objects that have been saved.
    pub(super) fn load(&mut self, now: Micros, app: &mut dyn Application) {
        if !self.config.storage {
            return;
        }
        let mut bytes = [0; IMAGE];
        let len = match app.storage() {
            Some(storage) => storage.load(&mut bytes),
            None => 0,
        };
        let mut rest = bytes.get(..len).unwrap_or(&[]);
        while let Some((index, sub, value, behind)) = next_write(rest) {
            // What a later version of the software refuses stays at its default. Only the
            // communication objects are taken from here.
            if matches!(index, 0x1000..=0x100F | 0x1012..=0x1FFF) {
                let whole;
                let value = match (value, self.own(index, sub)) {
                    // A COB-ID, which still has the default identifier.
                    (&[flags], Some(Ok(Value::Number { value, len: 4, .. }))) => {
                        let [a, b, c, _] = value.to_le_bytes();
                        whole = [a, b, c, flags];
                        whole.as_slice()
                    }
                    _ => value,
                };
                let _ = self.write(now, index, sub, value, app);
            }
            rest = behind;
        }
    }

    /// Adds every object that is not as configured.
    fn collect(&self, image: &mut Image) -> Result<(), AbortCode> {
        let config = &self.config;
        let default = emergency::default_cob_id(self.node);
        if self.emergencies.cob_id != default {
            // It cannot be changed while the service is on.
            image.add_cob_id(0x1014, 0, default | pdo::OFF, default)?;
            image.add_cob_id(0x1014, 0, self.emergencies.cob_id, default)?;
        }
        for (index, sub, default) in [
            (0x1007, 0, config.sync_window_us),
            (0x1015, 0, u32::from(config.emergency_inhibit_100us)),
            (0x1017, 0, u32::from(config.heartbeat_ms)),
            (0x1029, 1, u32::from(config.error_behaviour)),
            (0x1F80, 0, config.startup),
        ] {
            self.add(image, index, sub, default)?;
        }
        // All are emptied before any is filled: a node is refused as long as it is also in its old
        // place.
        for fills in [false, true] {
            let mut defaults = config.consumers.iter();
            for (sub, consumer) in (1..).zip(&self.heartbeat.consumers) {
                let default = defaults.next();
                let default =
                    default.map_or(0, |(node, millis)| Consumer::of(*node, *millis).entry);
                let (from, to) = match fills {
                    false => (default, 0),
                    true => (0, consumer.entry),
                };
                if consumer.entry != default && from != to {
                    image.add(0x1016, sub, to, 4)?;
                }
            }
        }
        if self.sync.overflow != config.sync_overflow {
            // It can be changed only while the period is 0.
            image.add(0x1006, 0, 0, 4)?;
            image.add(0x1019, 0, u32::from(self.sync.overflow), 1)?;
            image.add(0x1006, 0, self.sync.period_us, 4)?;
        }
        self.add(image, 0x1006, 0, config.sync_period_us)?;
        self.add(image, 0x1005, 0, super::sync::SYNC)?;
        for (at, default) in (0u16..).zip(config.rpdos) {
            let Some(rpdo) = self.rpdos.get(at) else {
                break;
            };
            let parameters = [
                (2, u32::from(default.transmission)),
                (5, u32::from(default.event_ms)),
            ];
            let cob_id = (rpdo.cob_id, pdo::default_cob_id(default, self.node));
            self.add_pdo(image, 0x1400 | at, cob_id, &rpdo.map, &parameters)?;
        }
        for (at, default) in (0u16..).zip(config.tpdos) {
            let Some(tpdo) = self.tpdos.get(at) else {
                break;
            };
            let parameters = [
                (2, u32::from(default.transmission)),
                (3, u32::from(default.inhibit_100us)),
                (5, u32::from(default.event_ms)),
                (6, 0),
            ];
            let cob_id = (tpdo.cob_id, pdo::default_cob_id(default, self.node));
            self.add_pdo(image, 0x1800 | at, cob_id, &tpdo.map, &parameters)?;
        }
        Ok(())
    }

    /// Adds an object unless it has this value.
    fn add(&self, image: &mut Image, index: u16, sub: u8, default: u32) -> Result<(), AbortCode> {
        match self.own(index, sub) {
            Some(Ok(Value::Number { value, len, .. })) if value != default => {
                image.add(index, sub, value, len)
            }
            _ => Ok(()),
        }
    }

    /// Adds what has changed of a PDO, between switching it off and giving it its identifier, which
    /// comes with the one by default.
    fn add_pdo(
        &self,
        image: &mut Image,
        index: u16,
        (cob_id, default): (u32, u32),
        map: &Map,
        parameters: &[(u8, u32)],
    ) -> Result<(), AbortCode> {
        let start = image.len;
        image.add_cob_id(index, 1, default | pdo::OFF, default)?;
        let before = image.len;
        if !map.is_default {
            let index = index | 0x200;
            image.add(index, 0, 0, 1)?;
            for (sub, entry) in (1..=map.count).zip(&map.entries) {
                image.add(index, sub, *entry, 4)?;
            }
            image.add(index, 0, u32::from(map.count), 1)?;
        }
        for (sub, default) in parameters {
            self.add(image, index, *sub, *default)?;
        }
        if image.len == before && cob_id == default {
            // Nothing has changed.
            image.len = start;
            return Ok(());
        }
        image.add_cob_id(index, 1, cob_id, default)
    }
}
