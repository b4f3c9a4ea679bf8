//! The robot's part of the object dictionary: parameters, process data, diagnostics.
//!
//! Every access is looked up in the one table of `protocol`; what is not there does not exist, what
//! is out of its limits is refused, and a refused write changes nothing. Process data lies here as
//! the bytes that go on the bus, so a PDO costs a copy, and an SDO of one of its fields reads the
//! same bytes.

use canopen::{AbortCode, NmtState, ObjectDictionary, PdoDirection, ResetScope, Storage};
use protocol::address::{self as at, history};
use protocol::object::ValueError;
use protocol::{Access, Address, ENTRIES, Entry, Value, entry, table::highest_sub};

use crate::configuration::Configuration;
use crate::history::History;
use crate::parameters::Parameters;
use crate::store::Store;

/// What the robot counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counters {
    /// Control ticks more than half a period late.
    pub late_ticks: u32,
    /// Gaps in the SYNC counter.
    pub lost_syncs: u32,
    /// Setpoints not followed.
    pub ignored_setpoints: u32,
    /// Writes to the table that were refused.
    pub refused_writes: u32,
    /// Times a fault brought the robot to rest.
    pub stops: u32,
    /// Set by the platform.
    pub watchdog_resets: u32,
    /// Set by the platform.
    pub can_errors: u32,
}

/// Who the robot is, as the platform knows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Device {
    pub node: u8,
    pub serial: u32,
    pub firmware: u32,
    pub reset_cause: u8,
    pub storage: bool,
}

/// The application's objects.
pub(crate) struct Dictionary {
    pub device: Device,
    pub parameters: Parameters,
    /// The group twist as received, and whether it came since the last look.
    pub setpoint: ([u8; 8], bool),
    /// The commissioning twist as received, and whether it came since the last look.
    pub alone: ([u8; 8], bool),
    pub commissioning: bool,
    pub status: [u8; 8],
    pub measured: [u8; 8],
    pub pose: [u8; 8],
    pub rates: [u8; 8],
    pub supply: Option<f32>,
    pub counters: Counters,
    pub history: History,
    pub store: Store,
}

impl Dictionary {
    pub fn new(device: Device) -> Self {
        Self {
            device,
            parameters: Parameters::new(),
            setpoint: ([0; 8], false),
            alone: ([0; 8], false),
            commissioning: false,
            status: [0; 8],
            measured: [0; 8],
            pose: [0; 8],
            rates: [0; 8],
            supply: None,
            counters: Counters::default(),
            history: History::new(),
            store: Store::new(),
        }
    }

    fn process_data(&self, index: u16) -> Option<&[u8; 8]> {
        Some(match index {
            0x2100 => &self.setpoint.0,
            0x2101 => &self.alone.0,
            0x2110 => &self.status,
            0x2111 => &self.measured,
            0x2112 => &self.pose,
            0x2113 => &self.rates,
            _ => return None,
        })
    }

    fn value(&self, entry: &Entry) -> Option<Value> {
        let address = entry.address;
        let counters = &self.counters;
        Some(match address {
            at::WIRE_VERSION => entry.default,
            at::SERIAL_NUMBER => Value::U32(self.device.serial),
            at::FIRMWARE_VERSION => Value::U32(self.device.firmware),
            at::RESET_CAUSE => Value::U8(self.device.reset_cause),
            at::CONFIGURATION_STATUS => Value::U32(match self.store.corrupt {
                Some(address) => address.packed() << 8 | 3,
                None => Configuration::new(&self.parameters, self.device.node)
                    .map_or_else(|error| error.code(), |_| 0),
            }),
            at::CONFIGURATION_CRC => Value::U32(self.parameters.crc()),
            at::GROUP_CRC => Value::U32(self.parameters.group_crc()),
            at::COMMISSIONING => Value::U8(u8::from(self.commissioning)),
            at::SUPPLY => Value::F32(self.supply.unwrap_or(0.0)),
            at::LATE_TICKS => Value::U32(counters.late_ticks),
            at::LOST_SYNCS => Value::U32(counters.lost_syncs),
            at::IGNORED_SETPOINTS => Value::U32(counters.ignored_setpoints),
            at::REFUSED_WRITES => Value::U32(counters.refused_writes),
            at::STOPS => Value::U32(counters.stops),
            at::WATCHDOG_RESETS => Value::U32(counters.watchdog_resets),
            at::CAN_ERRORS => Value::U32(counters.can_errors),
            Address { index, sub } if index == history::code(1).index => {
                Value::U16(self.history.nth(sub).map_or(0, |(fault, _)| fault.code()))
            }
            Address { index, sub } if index == history::time(1).index => {
                Value::U32(self.history.nth(sub).map_or(0, |(_, time_ms)| time_ms))
            }
            _ => match self.process_data(address.index) {
                Some(bytes) => {
                    let (from, length) = place(entry);
                    Value::from_bytes(entry.kind, bytes.get(from..from + length)?).ok()?
                }
                None => self.parameters.get(address)?,
            },
        })
    }

    fn check_write(
        &mut self,
        address: Address,
        data: &[u8],
        state: NmtState,
    ) -> Result<(), AbortCode> {
        let entry = find(address)?;
        match entry.access {
            Access::Const | Access::ReadOnly => return Err(AbortCode::ReadOnly),
            Access::Parameter if state == NmtState::Operational => {
                return Err(AbortCode::DeviceState);
            }
            Access::Parameter | Access::ReadWrite => {}
        }
        let value = entry.accept(data).map_err(|error| match error {
            ValueError::TooShort => AbortCode::TooShort,
            ValueError::TooLong => AbortCode::TooLong,
            ValueError::Invalid => AbortCode::InvalidValue,
            ValueError::TooHigh => AbortCode::ValueTooHigh,
            ValueError::TooLow => AbortCode::ValueTooLow,
        })?;
        if let Some(slot) = entry.slot {
            self.parameters.set(slot, value);
            return Ok(());
        }
        match address.index {
            0x2050 => {
                if value.to_bits() > 1 {
                    return Err(AbortCode::InvalidValue);
                }
                self.commissioning = value.to_bits() == 1;
            }
            0x2100 => write_field(&mut self.setpoint, entry, data),
            0x2101 => write_field(&mut self.alone, entry, data),
            _ => return Err(AbortCode::ReadOnly),
        }
        Ok(())
    }
}

/// Offset and length of a field in its process data: the fields lie in the order of their
/// sub-indices.
fn place(entry: &Entry) -> (usize, usize) {
    let before = ENTRIES.iter().filter(|other| {
        other.address.index == entry.address.index && other.address.sub < entry.address.sub
    });
    let from = before.map(|other| usize::from(other.kind.bytes())).sum();
    (from, usize::from(entry.kind.bytes()))
}

fn write_field((bytes, fresh): &mut ([u8; 8], bool), entry: &Entry, data: &[u8]) {
    let (from, length) = place(entry);
    if let Some(field) = bytes.get_mut(from..from + length) {
        for (to, value) in field.iter_mut().zip(data) {
            *to = *value;
        }
        *fresh = true;
    }
}

fn find(address: Address) -> Result<&'static Entry, AbortCode> {
    entry(address).ok_or(match highest_sub(address.index) {
        Some(_) => AbortCode::NoSubIndex,
        None => AbortCode::NoObject,
    })
}

impl ObjectDictionary for Dictionary {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        if sub == 0
            && let Some(highest) = highest_sub(index)
            && highest != 0
        {
            *out.first_mut().ok_or(AbortCode::OutOfMemory)? = highest;
            return Ok(1);
        }
        let entry = find(Address::new(index, sub))?;
        let value = self.value(entry).ok_or(AbortCode::General)?;
        let length = usize::from(entry.kind.bytes());
        let to = out.get_mut(..length).ok_or(AbortCode::OutOfMemory)?;
        for (to, byte) in to.iter_mut().zip(value.to_bytes()) {
            *to = byte;
        }
        Ok(length)
    }

    fn write(
        &mut self,
        index: u16,
        sub: u8,
        data: &[u8],
        state: NmtState,
    ) -> Result<(), AbortCode> {
        let done = if sub == 0 && highest_sub(index).is_some_and(|highest| highest != 0) {
            Err(AbortCode::ReadOnly)
        } else {
            self.check_write(Address::new(index, sub), data, state)
        };
        if done.is_err() {
            self.counters.refused_writes = self.counters.refused_writes.wrapping_add(1);
        }
        done
    }

    fn mappable(&self, index: u16, sub: u8, direction: PdoDirection) -> Result<u8, AbortCode> {
        let entry = find(Address::new(index, sub))?;
        let fits = match direction {
            PdoDirection::Receive => entry.access == Access::ReadWrite,
            PdoDirection::Transmit => true,
        };
        if entry.mappable && fits {
            Ok(entry.kind.bytes() * 8)
        } else {
            Err(AbortCode::NotMappable)
        }
    }

    fn rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        let (Ok(bytes), Some(to)) = (
            data.try_into(),
            match number {
                1 => Some(&mut self.setpoint),
                2 => Some(&mut self.alone),
                _ => None,
            },
        ) else {
            return false;
        };
        *to = (bytes, true);
        true
    }

    fn tpdo(&self, number: u8, out: &mut [u8; 8]) -> Option<usize> {
        *out = match number {
            1 => self.status,
            2 => self.measured,
            3 => self.pose,
            4 => self.rates,
            _ => return None,
        };
        Some(8)
    }

    fn storage(&mut self) -> Option<&mut dyn Storage> {
        if self.device.storage {
            Some(self)
        } else {
            None
        }
    }

    fn reset(&mut self, scope: ResetScope) {
        self.setpoint.1 = false;
        self.alone.1 = false;
        self.commissioning = false;
        if scope == ResetScope::Application {
            self.parameters = self.store.parameters();
        }
    }
}
