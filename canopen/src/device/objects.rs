//! The communication objects, 0x1000 to 0x1FFF, as SDO clients see them.
//!
//! `own` finds every number that the device holds, with its length and its access; reading, the
//! checks before a write, and saving therefore do not depend on single objects. `set` is its
//! counterpart: it checks a new value and either applies it or changes nothing. All other indices
//! belong to the application.

use super::heartbeat::{Consumer, MAX_CONSUMERS};
use super::pdo::{self, LAST_SYNCHRONOUS, Map};
use super::{Core, PdoIndex};
use crate::bytes::{low_u8, low_u16, put};
use crate::time::Timer;
use crate::{AbortCode, Application, Config, Emergency, Micros, NmtState, PdoDirection};

/// What an object of the device holds.
pub(super) enum Value {
    Number { value: u32, len: u8, writable: bool },
    Text(&'static str),
}

type Found = Result<Value, AbortCode>;

const fn constant(value: u32, len: u8) -> Found {
    Ok(Value::Number {
        value,
        len,
        writable: false,
    })
}

const fn variable(value: u32, len: u8) -> Found {
    Ok(Value::Number {
        value,
        len,
        writable: true,
    })
}

impl Core {
    pub(super) fn read(
        &self,
        index: u16,
        sub: u8,
        out: &mut [u8],
        app: &dyn Application,
    ) -> Result<usize, AbortCode> {
        let Some(found) = self.own(index, sub) else {
            return app.read(index, sub, out);
        };
        match found? {
            Value::Number { value, len, .. } => {
                let bytes = value.to_le_bytes();
                put(out, bytes.get(..usize::from(len)).unwrap_or(&bytes))
            }
            Value::Text(text) => put(out, text.as_bytes()),
        }
    }

    pub(super) fn write(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        data: &[u8],
        app: &mut dyn Application,
    ) -> Result<(), AbortCode> {
        let len = match self.own(index, sub) {
            None => return app.write(index, sub, data, self.state),
            Some(Ok(Value::Number {
                len,
                writable: true,
                ..
            })) => usize::from(len),
            Some(Ok(_) | Err(AbortCode::NoData)) => return Err(AbortCode::ReadOnly),
            Some(Err(code)) => return Err(code),
        };
        if is_communication(index) {
            if self.config.fixed_in_operation && self.state == NmtState::Operational {
                return Err(AbortCode::DeviceState);
            }
            if self.state != NmtState::Initialising && !app.may_configure() {
                return Err(AbortCode::LocalControl);
            }
        }
        let mut bytes = [0; 4];
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = *from;
        }
        match data.len() {
            short if short < len => Err(AbortCode::TooShort),
            long if long > len => Err(AbortCode::TooLong),
            _ => self.set(now, index, sub, u32::from_le_bytes(bytes), app),
        }
    }

    /// What the device holds under this index; `None` if the index is not the device's.
    pub(super) fn own(&self, index: u16, sub: u8) -> Option<Found> {
        let (config, errors, sync) = (&self.config, &self.emergencies, &self.sync);
        let text = |text: &'static str| (!text.is_empty()).then_some(Ok(Value::Text(text)));
        let found = match index {
            0x1000 => constant(config.device_type, 4),
            0x1001 => constant(u32::from(errors.register()), 1),
            0x1003 => return Some(errors.entry(sub)),
            0x1005 => variable(sync.cob_id, 4),
            0x1006 => variable(sync.period_us, 4),
            0x1007 => variable(sync.window_us, 4),
            0x1008 => text(config.name)?,
            0x1009 => text(config.hardware_version)?,
            0x100A => text(config.software_version)?,
            0x1010 | 0x1011 if config.storage => {
                return Some(match sub {
                    0 => constant(3, 1),
                    // Bit 0: can be saved on command, can be restored.
                    1..=3 => variable(1, 4),
                    _ => Err(AbortCode::NoSubIndex),
                });
            }
            0x1014 => variable(errors.cob_id, 4),
            0x1015 => variable(u32::from(errors.inhibit_100us), 2),
            0x1016 => {
                let consumer = usize::from(sub).checked_sub(1);
                let consumer = consumer.map(|at| self.heartbeat.consumers.get(at));
                return Some(match consumer {
                    None => constant(CONSUMERS, 1),
                    Some(Some(consumer)) => variable(consumer.entry, 4),
                    Some(None) => Err(AbortCode::NoSubIndex),
                });
            }
            0x1017 => variable(u32::from(self.heartbeat.period_ms), 2),
            0x1018 => {
                let identity = &config.identity;
                return Some(match sub {
                    0 => constant(4, 1),
                    1 => constant(identity.vendor, 4),
                    2 => constant(identity.product, 4),
                    3 => constant(identity.revision, 4),
                    4 => constant(identity.serial, 4),
                    _ => Err(AbortCode::NoSubIndex),
                });
            }
            0x1019 => variable(u32::from(sync.overflow), 1),
            0x1029 => {
                return Some(match sub {
                    0 => constant(1, 1),
                    1 => variable(u32::from(errors.behaviour), 1),
                    _ => Err(AbortCode::NoSubIndex),
                });
            }
            0x1F80 => variable(self.startup, 4),
            _ => return self.own_pdo(index, sub),
        };
        Some(match sub {
            0 => found,
            _ => Err(AbortCode::NoSubIndex),
        })
    }

    /// As `own`, for the parameters and mappings of PDOs.
    fn own_pdo(&self, index: u16, sub: u8) -> Option<Found> {
        Some(match PdoIndex::of(index)? {
            PdoIndex::Receive(at) => {
                let rpdo = self.rpdos.get(at)?;
                match sub {
                    0 => constant(5, 1),
                    1 => variable(rpdo.cob_id, 4),
                    2 => variable(u32::from(rpdo.transmission), 1),
                    5 => variable(u32::from(rpdo.deadline_ms), 2),
                    _ => Err(AbortCode::NoSubIndex),
                }
            }
            PdoIndex::Transmit(at) => {
                let tpdo = self.tpdos.get(at)?;
                match sub {
                    0 => constant(6, 1),
                    1 => variable(tpdo.cob_id, 4),
                    2 => variable(u32::from(tpdo.transmission), 1),
                    3 => variable(u32::from(tpdo.inhibit_100us), 2),
                    5 => variable(u32::from(tpdo.event_ms), 2),
                    6 => variable(u32::from(tpdo.sync_start), 1),
                    _ => Err(AbortCode::NoSubIndex),
                }
            }
            PdoIndex::ReceiveMap(at) => mapped(&self.rpdos.get(at)?.map, sub),
            PdoIndex::TransmitMap(at) => mapped(&self.tpdos.get(at)?.map, sub),
        })
    }

    /// Takes a new value of an object that `own` has found to be writable.
    fn set(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        value: u32,
        app: &mut dyn Application,
    ) -> Result<(), AbortCode> {
        match index {
            0x1015 if value > u32::from(self.config.longest_emergency_inhibit_100us) => {
                return Err(AbortCode::ValueTooHigh);
            }
            0x1003 | 0x1014 | 0x1015 | 0x1029 => return self.emergencies.set(index, value),
            0x1005..=0x1007 | 0x1019 => return self.set_sync(now, index, value),
            0x1010 | 0x1011 => return self.store(index == 0x1010, sub, value, app),
            0x1016 => return self.set_consumer(now, sub, value),
            0x1017 => {
                self.heartbeat.period_ms = low_u16(value);
                self.start_heartbeat(now);
            }
            0x1F80 => match value {
                0 | Config::STARTUP_BY_MASTER => self.startup = value,
                _ => return Err(AbortCode::InvalidValue),
            },
            _ => return self.set_pdo(now, index, sub, value, app),
        }
        Ok(())
    }

    fn set_consumer(&mut self, now: Micros, sub: u8, entry: u32) -> Result<(), AbortCode> {
        let new = Consumer::new(entry);
        let at = usize::from(sub.saturating_sub(1));
        let consumers = &mut self.heartbeat.consumers;
        // One node may be monitored once only (CiA 301, 7.5.2.18).
        let clash = |(other, consumer): (usize, &Consumer)| {
            other != at && consumer.is_used() && consumer.node() == new.node()
        };
        if new.is_used() && consumers.iter().enumerate().any(clash) {
            return Err(AbortCode::ParameterIncompatible);
        }
        let entry = consumers.get_mut(at).ok_or(AbortCode::NoSubIndex)?;
        // Whoever is not monitored any more is not missed any more.
        let missed = core::mem::replace(entry, new).node();
        if let Some(node) = missed {
            self.clear(now, Emergency::HEARTBEAT_LOST, node.get());
        }
        Ok(())
    }

    fn set_pdo(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        value: u32,
        app: &mut dyn Application,
    ) -> Result<(), AbortCode> {
        let missing = AbortCode::NoObject;
        match PdoIndex::of(index).ok_or(missing)? {
            PdoIndex::Receive(at) => {
                let rpdo = self.rpdos.get_mut(at).ok_or(missing)?;
                match sub {
                    1 => {
                        pdo::check_cob_id(value, rpdo.cob_id, rpdo.map.count)?;
                        rpdo.cob_id = value;
                        self.rpdos.listen();
                    }
                    2 => rpdo.transmission = transmission(value)?,
                    _ => {
                        rpdo.deadline_ms = low_u16(value);
                        rpdo.deadline = Timer::OFF;
                        let number = low_u8(u32::from(at)).saturating_add(1);
                        self.clear(now, Emergency::RPDO_TIMEOUT, number);
                    }
                }
            }
            PdoIndex::Transmit(at) => {
                let tpdo = self.tpdos.get_mut(at).ok_or(missing)?;
                match sub {
                    1 => {
                        pdo::check_cob_id(value, tpdo.cob_id, tpdo.map.count)?;
                        tpdo.cob_id = value;
                    }
                    2 => tpdo.transmission = transmission(value)?,
                    3 | 6 if tpdo.is_on() => return Err(AbortCode::DeviceState),
                    3 => tpdo.inhibit_100us = low_u16(value),
                    6 => match value {
                        // Higher than any counter (CiA 301, 7.5.2.37).
                        241.. => return Err(AbortCode::ValueTooHigh),
                        _ => tpdo.sync_start = low_u8(value),
                    },
                    _ => tpdo.event_ms = low_u16(value),
                }
                if self.state == NmtState::Operational {
                    tpdo.restart(now);
                    self.out.wake(Timer::at(now));
                }
            }
            PdoIndex::ReceiveMap(at) => {
                let rpdo = self.rpdos.get_mut(at).ok_or(missing)?;
                let is_on = rpdo.cob_id & pdo::OFF == 0;
                set_map(&mut rpdo.map, is_on, sub, value, PdoDirection::Receive, app)?;
            }
            PdoIndex::TransmitMap(at) => {
                let tpdo = self.tpdos.get_mut(at).ok_or(missing)?;
                let is_on = tpdo.is_on();
                set_map(
                    &mut tpdo.map,
                    is_on,
                    sub,
                    value,
                    PdoDirection::Transmit,
                    app,
                )?;
            }
        }
        Ok(())
    }
}

/// Whether an object says how the device communicates; saving, and clearing the error history, do
/// not.
const fn is_communication(index: u16) -> bool {
    matches!(index, 0x1005..=0x1007 | 0x1014..=0x1017 | 0x1019 | 0x1029 | 0x1400..=0x1BFF | 0x1F80)
}

const CONSUMERS: u32 = 17;
const _: () = assert!(MAX_CONSUMERS == CONSUMERS as usize);

/// 252 and 253 would need remote frames, 241 to 251 are reserved.
fn transmission(value: u32) -> Result<u8, AbortCode> {
    match low_u8(value) {
        kind @ (0..=LAST_SYNCHRONOUS | 254 | 255) => Ok(kind),
        _ => Err(AbortCode::InvalidValue),
    }
}

fn mapped(map: &Map, sub: u8) -> Found {
    match usize::from(sub).checked_sub(1) {
        None => variable(u32::from(map.count), 1),
        Some(at) => match map.entries.get(at) {
            Some(entry) => variable(*entry, 4),
            None => Err(AbortCode::NoSubIndex),
        },
    }
}

fn set_map(
    map: &mut Map,
    is_on: bool,
    sub: u8,
    value: u32,
    direction: PdoDirection,
    app: &dyn Application,
) -> Result<(), AbortCode> {
    if is_on || (sub != 0 && map.count != 0) {
        return Err(AbortCode::UnsupportedAccess);
    }
    let Some(at) = usize::from(sub).checked_sub(1) else {
        return map.set_count(low_u8(value));
    };
    let (index, sub, bits) = pdo::unpack(value);
    let allowed = match (value, index, direction) {
        (0, _, _) => 0,
        (_, ..0x20, PdoDirection::Receive) => dummy_bits(index).ok_or(AbortCode::NotMappable)?,
        _ => app.mappable(index, sub, direction)?,
    };
    if bits != allowed || bits & 7 != 0 {
        return Err(AbortCode::NotMappable);
    }
    *map.entries.get_mut(at).ok_or(AbortCode::NoSubIndex)? = value;
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
