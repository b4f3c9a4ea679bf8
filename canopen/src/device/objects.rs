//! The communication objects, 0x1000 to 0x1FFF, as SDO clients see them.
//!
//! `read` and `write` answer for the objects of the device and ask the application for all others.
//! A value is checked completely before anything changes.

use super::Core;
use super::pdo::{self, LAST_SYNCHRONOUS, MAX_MAPPED, Map};
use super::{heartbeat, store};
use crate::bytes::{high_u16, low_u8, put, u8_of, u16_of, u32_of};
use crate::time::Timer;
use crate::{AbortCode, Config, Micros, NmtState, ObjectDictionary, PdoDirection};

/// The highest sub-index of 0x1400 on.
const RPDO_LAST: u8 = 5;
/// The highest sub-index of 0x1800 on.
const TPDO_LAST: u8 = 6;

impl Core {
    pub(super) fn read(
        &self,
        index: u16,
        sub: u8,
        out: &mut [u8],
        od: &dyn ObjectDictionary,
    ) -> Result<usize, AbortCode> {
        match self.read_own(index, sub, out) {
            Some(done) => done,
            None => od.read(index, sub, out),
        }
    }

    pub(super) fn write(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        data: &[u8],
        od: &mut dyn ObjectDictionary,
    ) -> Result<(), AbortCode> {
        match self.write_own(now, index, sub, data, od) {
            Some(done) => done,
            None => od.write(index, sub, data, self.state),
        }
    }

    /// `None` if the object is not the device's.
    pub(super) fn read_own(
        &self,
        index: u16,
        sub: u8,
        out: &mut [u8],
    ) -> Option<Result<usize, AbortCode>> {
        let config = &self.config;
        Some(match index {
            0x1000 => single(sub, out, &config.device_type.to_le_bytes()),
            0x1001 | 0x1003 | 0x1014 | 0x1015 | 0x1029 => self.emergencies.read(index, sub, out),
            0x1005..=0x1007 | 0x1019 if sub != 0 => Err(AbortCode::NoSubIndex),
            0x1005 => put(out, &self.sync.cob_id.to_le_bytes()),
            0x1006 => put(out, &self.sync.period_us.to_le_bytes()),
            0x1007 => put(out, &self.sync.window_us.to_le_bytes()),
            0x1019 => put(out, &[self.sync.overflow]),
            0x1008 if !config.name.is_empty() => single(sub, out, config.name.as_bytes()),
            0x1009 if !config.hardware_version.is_empty() => {
                single(sub, out, config.hardware_version.as_bytes())
            }
            0x100A if !config.software_version.is_empty() => {
                single(sub, out, config.software_version.as_bytes())
            }
            0x1010 | 0x1011 if config.storage => store::read(index, sub, out),
            0x1016 => self.read_consumer(sub, out),
            0x1017 => single(sub, out, &self.heartbeat.period_ms.to_le_bytes()),
            0x1018 => {
                let identity = &config.identity;
                match sub {
                    0 => put(out, &[4]),
                    1 => put(out, &identity.vendor.to_le_bytes()),
                    2 => put(out, &identity.product.to_le_bytes()),
                    3 => put(out, &identity.revision.to_le_bytes()),
                    4 => put(out, &identity.serial.to_le_bytes()),
                    _ => Err(AbortCode::NoSubIndex),
                }
            }
            0x1F80 => single(sub, out, &self.startup.to_le_bytes()),
            0x1400..=0x15FF => {
                let rpdo = self.rpdos.get(index - 0x1400)?;
                match sub {
                    0 => put(out, &[RPDO_LAST]),
                    1 => put(out, &rpdo.cob_id.to_le_bytes()),
                    2 => put(out, &[rpdo.transmission]),
                    5 => put(out, &rpdo.deadline_ms.to_le_bytes()),
                    _ => Err(AbortCode::NoSubIndex),
                }
            }
            0x1600..=0x17FF => read_map(&self.rpdos.get(index - 0x1600)?.map, sub, out),
            0x1800..=0x19FF => {
                let tpdo = self.tpdos.get(index - 0x1800)?;
                match sub {
                    0 => put(out, &[TPDO_LAST]),
                    1 => put(out, &tpdo.cob_id.to_le_bytes()),
                    2 => put(out, &[tpdo.transmission]),
                    3 => put(out, &tpdo.inhibit_100us.to_le_bytes()),
                    5 => put(out, &tpdo.event_ms.to_le_bytes()),
                    6 => put(out, &[tpdo.sync_start]),
                    _ => Err(AbortCode::NoSubIndex),
                }
            }
            0x1A00..=0x1BFF => read_map(&self.tpdos.get(index - 0x1A00)?.map, sub, out),
            _ => return None,
        })
    }

    /// `None` if the object is not the device's.
    pub(super) fn write_own(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        data: &[u8],
        od: &mut dyn ObjectDictionary,
    ) -> Option<Result<(), AbortCode>> {
        // Reading settles whether the object exists at all.
        let mut scratch = [0; 64];
        if let Err(code @ (AbortCode::NoObject | AbortCode::NoSubIndex)) =
            self.read_own(index, sub, &mut scratch)?
        {
            return Some(Err(code));
        }
        Some(match index {
            0x1001 | 0x1003 | 0x1014 | 0x1015 | 0x1029 => self.emergencies.write(index, sub, data),
            0x1005..=0x1007 | 0x1019 => self.write_sync(now, index, data),
            0x1010 | 0x1011 => self.write_store(index, sub, data, od),
            0x1016 if sub != 0 => self.write_consumer(sub, data),
            0x1017 => u16_of(data).map(|period| {
                self.heartbeat.period_ms = period;
                self.start_heartbeat(now);
            }),
            0x1F80 => match u32_of(data) {
                Ok(startup @ (0 | Config::STARTUP_BY_MASTER)) => {
                    self.startup = startup;
                    Ok(())
                }
                Ok(_) => Err(AbortCode::InvalidValue),
                Err(code) => Err(code),
            },
            0x1400..=0x15FF if sub != 0 => self.write_rpdo(index - 0x1400, sub, data),
            0x1600..=0x17FF => {
                let rpdo = self.rpdos.get_mut(index - 0x1600)?;
                let is_on = rpdo.cob_id & pdo::OFF == 0;
                write_map(&mut rpdo.map, is_on, sub, data, PdoDirection::Receive, od)
            }
            0x1800..=0x19FF if sub != 0 => self.write_tpdo(now, index - 0x1800, sub, data),
            0x1A00..=0x1BFF => {
                let tpdo = self.tpdos.get_mut(index - 0x1A00)?;
                let is_on = tpdo.cob_id & pdo::OFF == 0;
                write_map(&mut tpdo.map, is_on, sub, data, PdoDirection::Transmit, od)
            }
            _ => Err(AbortCode::ReadOnly),
        })
    }

    fn read_consumer(&self, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        let consumers = &self.heartbeat.consumers;
        match sub.checked_sub(1) {
            None => put(out, &[u8::try_from(consumers.len()).unwrap_or(u8::MAX)]),
            Some(at) => {
                let consumer = consumers
                    .get(usize::from(at))
                    .ok_or(AbortCode::NoSubIndex)?;
                put(out, &consumer.entry.to_le_bytes())
            }
        }
    }

    fn write_consumer(&mut self, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        let new = heartbeat::Consumer::new(u32_of(data)?);
        let at = usize::from(sub.saturating_sub(1));
        let consumers = &mut self.heartbeat.consumers;
        // One node may be monitored once only (CiA 301, 7.5.2.18).
        let clash = |(other, consumer): (usize, &heartbeat::Consumer)| {
            other != at && consumer.is_used() && consumer.node() == new.node()
        };
        if new.is_used() && consumers.iter().enumerate().any(clash) {
            return Err(AbortCode::ParameterIncompatible);
        }
        *consumers.get_mut(at).ok_or(AbortCode::NoSubIndex)? = new;
        Ok(())
    }

    fn write_rpdo(&mut self, at: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        let rpdo = self.rpdos.get_mut(at).ok_or(AbortCode::NoObject)?;
        match sub {
            1 => {
                let cob_id = u32_of(data)?;
                pdo::check_cob_id(cob_id, rpdo.cob_id, rpdo.map.count)?;
                rpdo.cob_id = cob_id;
                self.rpdos.listen();
            }
            2 => rpdo.transmission = transmission(data)?,
            _ => {
                rpdo.deadline_ms = u16_of(data)?;
                rpdo.deadline = Timer::OFF;
            }
        }
        Ok(())
    }

    fn write_tpdo(&mut self, now: Micros, at: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        let operational = self.state == NmtState::Operational;
        let tpdo = self.tpdos.get_mut(at).ok_or(AbortCode::NoObject)?;
        let is_on = tpdo.cob_id & pdo::OFF == 0;
        match sub {
            1 => {
                let cob_id = u32_of(data)?;
                pdo::check_cob_id(cob_id, tpdo.cob_id, tpdo.map.count)?;
                tpdo.cob_id = cob_id;
            }
            2 => tpdo.transmission = transmission(data)?,
            3 | 6 if is_on => return Err(AbortCode::DeviceState),
            3 => tpdo.inhibit_100us = u16_of(data)?,
            6 => tpdo.sync_start = u8_of(data)?,
            _ => tpdo.event_ms = u16_of(data)?,
        }
        if operational {
            tpdo.restart(now);
            self.out.wake(Timer::at(now));
        }
        Ok(())
    }
}

/// The value of an object without sub-indices.
fn single(sub: u8, out: &mut [u8], value: &[u8]) -> Result<usize, AbortCode> {
    match sub {
        0 => put(out, value),
        _ => Err(AbortCode::NoSubIndex),
    }
}

/// 252 and 253 would need remote frames, 241 to 251 are reserved.
fn transmission(data: &[u8]) -> Result<u8, AbortCode> {
    match u8_of(data)? {
        value @ (0..=LAST_SYNCHRONOUS | 254 | 255) => Ok(value),
        _ => Err(AbortCode::InvalidValue),
    }
}

fn read_map(map: &Map, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
    match sub.checked_sub(1) {
        None => put(out, &[map.count]),
        Some(at) => {
            let entry = map.entries.get(usize::from(at));
            put(out, &entry.ok_or(AbortCode::NoSubIndex)?.to_le_bytes())
        }
    }
}

fn write_map(
    map: &mut Map,
    is_on: bool,
    sub: u8,
    data: &[u8],
    direction: PdoDirection,
    od: &dyn ObjectDictionary,
) -> Result<(), AbortCode> {
    if is_on || (sub != 0 && map.count != 0) {
        return Err(AbortCode::UnsupportedAccess);
    }
    let Some(at) = sub.checked_sub(1) else {
        return map.set_count(u8_of(data)?);
    };
    let entry = u32_of(data)?;
    let (index, sub, bits) = (high_u16(entry), low_u8(entry >> 8), low_u8(entry));
    let allowed = match (entry, index, direction) {
        (0, _, _) => 0,
        (_, ..0x20, PdoDirection::Receive) => dummy_bits(index).ok_or(AbortCode::NotMappable)?,
        _ => od.mappable(index, sub, direction)?,
    };
    if bits != allowed || !bits.is_multiple_of(8) {
        return Err(AbortCode::NotMappable);
    }
    *map.entries
        .get_mut(usize::from(at).min(MAX_MAPPED))
        .ok_or(AbortCode::NoSubIndex)? = entry;
    Ok(())
}

/// The length of a data type used to leave a gap in a receive PDO (CiA 301, 7.4.7.2).
const fn dummy_bits(index: u16) -> Option<u8> {
    match index {
        2 | 5 => Some(8),
        3 | 6 => Some(16),
        4 | 7 => Some(32),
        _ => None,
    }
}
