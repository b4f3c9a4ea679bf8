//! Saving and restoring parameters: objects 0x1010 and 0x1011.
//!
//! The image of the communication objects is a sequence of writes: index, sub-index, length, value.
//! It holds only what differs from the configuration, so identifiers that depend on the node-ID
//! keep following it; loading it is writing it, with all the checks of a write.

use super::Core;
use super::pdo::{self, Map};
use super::rpdo::Rpdo;
use super::tpdo::Tpdo;
use crate::bytes::{put, u32_of};
use crate::{AbortCode, Config, Micros, ObjectDictionary, StoreProgress, StoreScope};

/// Bytes of the longest image.
const IMAGE: usize = 512;

const SAVE: u32 = u32::from_le_bytes(*b"save");
const LOAD: u32 = u32::from_le_bytes(*b"load");

/// Collects an image.
struct Image<'a> {
    bytes: &'a mut [u8],
    len: usize,
}

impl Image<'_> {
    fn add(&mut self, index: u16, sub: u8, value: &[u8]) -> Result<(), AbortCode> {
        let [low, high] = index.to_le_bytes();
        let len = u8::try_from(value.len()).map_err(|_| AbortCode::CannotStore)?;
        for part in [&[low, high, sub, len], value] {
            let rest = self.bytes.get_mut(self.len..).unwrap_or(&mut []);
            let put = put(rest, part).map_err(|_| AbortCode::CannotStore)?;
            self.len = self.len.saturating_add(put);
        }
        Ok(())
    }

    /// Adds the value unless it is the default.
    fn add_changed(
        &mut self,
        index: u16,
        sub: u8,
        value: &[u8],
        default: &[u8],
    ) -> Result<(), AbortCode> {
        match value == default {
            true => Ok(()),
            false => self.add(index, sub, value),
        }
    }

    fn add_map(&mut self, index: u16, map: &Map) -> Result<(), AbortCode> {
        if map.is_default {
            return Ok(());
        }
        self.add(index, 0, &[0])?;
        let mut sub = 0u8;
        for entry in map.entries.iter().take(usize::from(map.count)) {
            sub = sub.saturating_add(1);
            self.add(index, sub, &entry.to_le_bytes())?;
        }
        self.add(index, 0, &[map.count])
    }

    /// Switches a PDO off, lets `change` add what is between, and sets its identifier.
    fn add_pdo(
        &mut self,
        index: u16,
        cob_id: u32,
        default: u32,
        change: impl FnOnce(&mut Self) -> Result<(), AbortCode>,
    ) -> Result<(), AbortCode> {
        let start = self.len;
        if default & pdo::OFF == 0 {
            self.add(index, 1, &(default | pdo::OFF).to_le_bytes())?;
        }
        let before = self.len;
        change(self)?;
        if self.len == before && cob_id == default {
            // Nothing has changed.
            self.len = start;
            return Ok(());
        }
        self.add(index, 1, &cob_id.to_le_bytes())
    }
}

/// The next write of an image, and what is behind it.
fn next_write(image: &[u8]) -> Option<(u16, u8, &[u8], &[u8])> {
    let (&[low, high, sub, len], rest) = image.split_first_chunk()?;
    let (value, rest) = rest.split_at_checked(usize::from(len))?;
    Some((u16::from_le_bytes([low, high]), sub, value, rest))
}

pub(super) fn read(index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
    let _ = index;
    match sub {
        0 => put(out, &[3]),
        // Bit 0: on command; of 0x1011: can be restored.
        1..=3 => put(out, &1u32.to_le_bytes()),
        _ => Err(AbortCode::NoSubIndex),
    }
}

impl Core {
    /// A write to 0x1010 or 0x1011.
    pub(super) fn write_store(
        &mut self,
        index: u16,
        sub: u8,
        data: &[u8],
        od: &mut dyn ObjectDictionary,
    ) -> Result<(), AbortCode> {
        let scope = match sub {
            0 => return Err(AbortCode::ReadOnly),
            1 => StoreScope::All,
            2 => StoreScope::Communication,
            _ => StoreScope::Application,
        };
        let saves = index == 0x1010;
        // Anything but the signature could be a mistake (CiA 301, 7.5.2.13).
        if u32_of(data)? != if saves { SAVE } else { LOAD } {
            return Err(AbortCode::CannotStore);
        }
        if self.storing {
            return Err(AbortCode::DeviceState);
        }
        let mut bytes = [0; IMAGE];
        let image = match saves && scope.has_communication() {
            true => self.image(&mut bytes)?,
            false => &[],
        };
        let storage = od.storage().ok_or(AbortCode::Hardware)?;
        let progress = match saves {
            true => storage.save(scope, image)?,
            false => storage.restore(scope)?,
        };
        self.storing = progress == StoreProgress::Pending;
        Ok(())
    }

    /// Brings back the communication objects that have been saved.
    pub(super) fn load(&mut self, now: Micros, od: &mut dyn ObjectDictionary) {
        if !self.config.storage {
            return;
        }
        let mut bytes = [0; IMAGE];
        let len = match od.storage() {
            Some(storage) => storage.load(&mut bytes),
            None => 0,
        };
        let mut rest = bytes.get(..len).unwrap_or(&[]);
        while let Some((index, sub, value, behind)) = next_write(rest) {
            // What a later version of the software refuses stays at its default. Only the
            // communication objects are taken from here.
            if matches!(index, 0x1000..=0x100F | 0x1012..=0x1FFF) {
                let _ = self.write_own(now, index, sub, value, od);
            }
            rest = behind;
        }
    }

    fn image<'a>(&self, bytes: &'a mut [u8; IMAGE]) -> Result<&'a [u8], AbortCode> {
        let mut image = Image { bytes, len: 0 };
        let config = &self.config;
        self.add_objects(&mut image, config)?;
        let mut at = 0;
        for default in config.rpdos {
            let Some(rpdo) = self.rpdos.get(at) else {
                break;
            };
            let default = Rpdo::new(default, self.node);
            image.add_pdo(0x1400 + at, rpdo.cob_id, default.cob_id, |image| {
                image.add_map(0x1600 + at, &rpdo.map)?;
                image.add_changed(
                    0x1400 + at,
                    2,
                    &[rpdo.transmission],
                    &[default.transmission],
                )?;
                let deadline = rpdo.deadline_ms.to_le_bytes();
                image.add_changed(
                    0x1400 + at,
                    5,
                    &deadline,
                    &default.deadline_ms.to_le_bytes(),
                )
            })?;
            at += 1;
        }
        at = 0;
        for default in config.tpdos {
            let Some(tpdo) = self.tpdos.get(at) else {
                break;
            };
            let default = Tpdo::new(default, self.node);
            image.add_pdo(0x1800 + at, tpdo.cob_id, default.cob_id, |image| {
                image.add_map(0x1A00 + at, &tpdo.map)?;
                for ((sub, value, len), (_, default, _)) in
                    tpdo.parameters().into_iter().zip(default.parameters())
                {
                    let (value, default) = (value.get(..len), default.get(..len));
                    let (value, default) = (value.unwrap_or(&[]), default.unwrap_or(&[]));
                    image.add_changed(0x1800 + at, sub, value, default)?;
                }
                Ok(())
            })?;
            at += 1;
        }
        let Image { bytes, len } = image;
        Ok(bytes.get(..len).unwrap_or(&[]))
    }

    /// The objects that are not PDOs.
    fn add_objects(&self, image: &mut Image<'_>, config: &Config) -> Result<(), AbortCode> {
        for (index, default) in [
            (0x1006, config.sync_period_us),
            (0x1007, config.sync_window_us),
            (0x1014, super::emergency::default_cob_id(self.node)),
            (0x1017, u32::from(config.heartbeat_ms)),
            (0x1015, u32::from(config.emergency_inhibit_100us)),
            (0x1F80, config.startup),
        ] {
            self.add_object(image, index, 0, default)?;
        }
        self.add_object(image, 0x1029, 1, u32::from(config.error_behaviour))?;
        for sub in 1..=u8::try_from(super::MAX_CONSUMERS).unwrap_or(u8::MAX) {
            let default = config.consumers.get(usize::from(sub - 1));
            let default = default.map_or(0, |(node, millis)| {
                u32::from(node.get()) << 16 | u32::from(*millis)
            });
            self.add_object(image, 0x1016, sub, default)?;
        }
        // The counter can be set only while the period is 0, and SYNC starts last.
        if self.sync.overflow != config.sync_overflow {
            image.add(0x1006, 0, &[0; 4])?;
            image.add(0x1019, 0, &[self.sync.overflow])?;
            image.add(0x1006, 0, &self.sync.period_us.to_le_bytes())?;
        }
        self.add_object(image, 0x1005, 0, super::sync::SYNC)
    }

    /// Adds an object of up to four bytes unless it has this value.
    fn add_object(
        &self,
        image: &mut Image<'_>,
        index: u16,
        sub: u8,
        default: u32,
    ) -> Result<(), AbortCode> {
        let mut value = [0; 4];
        let len = self
            .read_own(index, sub, &mut value)
            .unwrap_or(Err(AbortCode::NoObject))?;
        if u32::from_le_bytes(value) == default {
            return Ok(());
        }
        if index == 0x1014 {
            // Its identifier cannot change while it is on.
            image.add(index, sub, &(default | pdo::OFF).to_le_bytes())?;
        }
        image.add(index, sub, value.get(..len).unwrap_or(&value))
    }
}
