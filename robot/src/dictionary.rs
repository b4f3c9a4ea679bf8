//! The robot's part of the object dictionary: parameters, process data, diagnostics.
//!
//! Every access is looked up in the one table of `protocol`; what is not there does not exist, what
//! is out of its limits is refused, and a refused write changes nothing. Process data lies here as
//! the bytes that go on the bus, so a PDO costs a copy, and an SDO of one of its fields reads the
//! same bytes.

use canopen::{AbortCode, NmtState, ObjectDictionary, PdoDirection, ResetScope, Storage};
use protocol::address::{self as at, history, rollers};
use protocol::compensation::{CompensationSet, SetError};
use protocol::object::ValueError;
use protocol::{Access, Address, ENTRIES, Entry, Kind, Value, entry, table::highest_sub};

use crate::bus::{CanRecord, Record};
use crate::compensation::compensation;
use crate::configuration;
use crate::fault_memory::FaultMemory;
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
    /// What the platform's store has been through.
    pub store: StoreWear,
}

/// What a store has been through since it was new.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StoreWear {
    /// Images stored.
    pub saves: u32,
    /// Sectors erased.
    pub erases: u32,
    /// Saves that a loss of power cut off.
    pub cut: u32,
}

/// Who the robot is, as the platform knows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Device {
    pub node: u8,
    pub serial: u32,
    pub firmware: u32,
    pub reset_cause: u8,
    pub node_switches: u8,
    pub clock_wait_ms: u16,
    pub brown_out_level: u8,
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
    /// The permission has been given or renewed, until it is looked at.
    pub permission_renewed: bool,
    /// This robot is its own only member, whatever 0x2040:2 says.
    pub alone_for_now: bool,
    /// That has just been declared, until it is looked at.
    pub alone_declared: bool,
    pub status: [u8; 8],
    pub measured: [u8; 8],
    pub pose: [u8; 8],
    pub rates: [u8; 8],
    pub roller_states: [u8; 4],
    pub roller_sweeps: [f32; 4],
    /// Since the robot started, ms.
    pub uptime_ms: u32,
    pub supply: Option<f32>,
    /// Of the motors, A; 0 where it is not measured.
    pub current: f32,
    /// Signed and in full, rad/s.
    pub slip: f32,
    pub counters: Counters,
    pub can: CanRecord,
    /// Faults.
    pub history: History,
    pub limits: History,
    pub memory: FaultMemory,
    pub store: Store,
    pub identification: Record,
    /// Seconds for which the LED shall blink, until it is looked at, and those that are left.
    pub blink_asked: Option<u8>,
    pub blinks: u8,
}

impl Dictionary {
    #[inline(always)]
    pub fn new(device: Device) -> Self {
        Self {
            device,
            parameters: Parameters::new(),
            setpoint: ([0; 8], false),
            alone: ([0; 8], false),
            commissioning: false,
            permission_renewed: false,
            alone_for_now: false,
            alone_declared: false,
            status: [0; 8],
            measured: [0; 8],
            pose: [0; 8],
            rates: [0; 8],
            roller_states: [0; 4],
            roller_sweeps: [0.0; 4],
            uptime_ms: 0,
            supply: None,
            current: 0.0,
            slip: 0.0,
            counters: Counters::default(),
            can: CanRecord::default(),
            history: History::new(),
            limits: History::new(),
            memory: FaultMemory::new(),
            store: Store::new(),
            identification: Record::new(),
            blink_asked: None,
            blinks: 0,
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
            at::WIRE_VERSION => entry.default(),
            at::SERIAL_NUMBER => Value::U32(self.device.serial),
            at::FIRMWARE_VERSION => Value::U32(self.device.firmware),
            at::RESET_CAUSE => Value::U8(self.device.reset_cause),
            at::NODE_SWITCHES => Value::U8(self.device.node_switches),
            at::CLOCK_WAIT => Value::U16(self.device.clock_wait_ms),
            at::BROWN_OUT_LEVEL => Value::U8(self.device.brown_out_level),
            at::NODE_STORED => Value::U8(self.store.node()),
            at::CONFIGURATION_STATUS => Value::U32(match self.store.corrupt {
                Some(address) => address.packed() << 8 | 3,
                None => configuration::build(&self.parameters, self.device.node)
                    .map_or_else(|error| error.code(), |_| 0),
            }),
            at::CONFIGURATION_CRC => Value::U32(self.parameters.crc()),
            at::GROUP_CRC => Value::U32(self.parameters.group_crc()),
            at::COMPENSATION_VERSION => {
                let set = self.parameters.compensation_set();
                Value::U32(set.map_or(0, |set| set.version))
            }
            at::COMPENSATION_CRC => {
                let set = self.parameters.compensation_set();
                Value::U32(set.map_or(0, |set| set.crc))
            }
            at::COMMISSIONING => Value::U8(u8::from(self.commissioning)),
            at::ALONE_FOR_NOW => Value::U8(u8::from(self.alone_for_now)),
            at::IDENTIFY => Value::U8(u8::from(self.identification.status == 1)),
            at::IDENTIFY_STATUS => Value::U8(self.identification.status),
            at::IDENTIFY_WHEEL => Value::U8(self.identification.wheel),
            at::IDENTIFY_RATE => Value::F32(self.identification.bounds.rate),
            at::IDENTIFY_TRAVEL => Value::F32(self.identification.bounds.travel),
            at::IDENTIFY_BANDWIDTH => Value::F32(self.identification.bandwidth),
            at::IDENTIFY_DAMPING => Value::F32(self.identification.damping),
            at::IDENTIFY_WHEELS => Value::U8(self.identification.bounds.wheels),
            at::BLINK => Value::U8(self.blinks),
            at::SUPPLY => Value::F32(self.supply.unwrap_or(0.0)),
            at::SLIP => Value::F32(self.slip),
            at::CURRENT => Value::F32(self.current),
            at::LATE_TICKS => Value::U32(counters.late_ticks),
            at::LOST_SYNCS => Value::U32(counters.lost_syncs),
            at::IGNORED_SETPOINTS => Value::U32(counters.ignored_setpoints),
            at::REFUSED_WRITES => Value::U32(counters.refused_writes),
            at::STOPS => Value::U32(counters.stops),
            at::WATCHDOG_RESETS => Value::U32(counters.watchdog_resets),
            at::CAN_ERRORS => Value::U32(counters.can_errors),
            at::CAN_TRANSMIT_ERRORS => Value::U8(self.can.errors.transmit),
            at::CAN_RECEIVE_ERRORS => Value::U8(self.can.errors.receive),
            at::CAN_LAST_ERROR => Value::U8(self.can.errors.last),
            at::CAN_PASSIVES => Value::U32(self.can.passives),
            at::CAN_BUS_OFFS => Value::U32(self.can.bus_offs),
            at::SAVES => Value::U32(counters.store.saves),
            at::ERASES => Value::U32(counters.store.erases),
            at::CUT_SAVES => Value::U32(counters.store.cut),
            at::UPTIME => Value::U32(self.uptime_ms),
            at::START_NUMBER => Value::U32(self.memory.start),
            at::UNSTORED_FAULTS => Value::U8(self.memory.unstored()),
            Address { index, sub } if index == history::code(1).index => {
                Value::U16(self.history.nth(sub).0)
            }
            Address { index, sub } if index == history::time(1).index => {
                Value::U32(self.history.nth(sub).1)
            }
            Address { index, sub } if index == history::limit_code(1).index => {
                Value::U16(self.limits.nth(sub).0)
            }
            Address { index, sub } if index == history::limit_time(1).index => {
                Value::U32(self.limits.nth(sub).1)
            }
            Address { index, sub } if index == rollers::state(0).index => {
                let wheel = usize::from(sub.checked_sub(1)?);
                Value::U8(*self.roller_states.get(wheel)?)
            }
            Address { index, sub } if index == rollers::sweep(0).index => {
                let wheel = usize::from(sub.checked_sub(1)?);
                Value::F32(*self.roller_sweeps.get(wheel)?)
            }
            _ => match self.process_data(address.index) {
                Some(bytes) => {
                    let (from, length) = place(entry);
                    Value::from_bytes(entry.kind, bytes.get(from..from + length)?).ok()?
                }
                None => match self.identification.result(address) {
                    Some(result) => Value::F32(result),
                    None => self.parameters.get(address)?,
                },
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
        if entry.kind == Kind::Domain {
            return self.write_set(entry, data);
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
            0x2050 => self.write_alone(address, value.to_bits(), state)?,
            0x2051 => self.write_identification(address, value, state)?,
            0x2059 => self.blink_asked = u8::try_from(value.to_bits()).ok(),
            0x2100 => write_field(&mut self.setpoint, entry, data),
            0x2101 => write_field(&mut self.alone, entry, data),
            _ => return Err(AbortCode::ReadOnly),
        }
        Ok(())
    }

    /// Takes a compensation set as a whole or not at all.
    fn write_set(&mut self, entry: &Entry, data: &[u8]) -> Result<(), AbortCode> {
        let set = CompensationSet::decode(data).map_err(|error| match error {
            SetError::TooShort => AbortCode::TooShort,
            SetError::TooLong => AbortCode::TooLong,
            SetError::CoefficientTooLow => AbortCode::ValueTooLow,
            SetError::OutOfRange => AbortCode::ValueTooHigh,
            SetError::Crc | SetError::Format | SetError::TooManyRows | SetError::Speed => {
                AbortCode::InvalidValue
            }
        })?;
        let constant = self.parameters.constant_compensation();
        constant
            .and_then(|constant| compensation(&set, &constant))
            .map_err(|_| AbortCode::ParameterIncompatible)?;
        let slot = entry.slot.ok_or(AbortCode::General)?;
        self.parameters.set_block(slot, data);
        Ok(())
    }
}

impl Dictionary {
    /// The permission to move alone, and what makes a member of a group alone for a while.
    fn write_alone(
        &mut self,
        address: Address,
        value: u32,
        state: NmtState,
    ) -> Result<(), AbortCode> {
        if value > 1 {
            return Err(AbortCode::InvalidValue);
        }
        let wanted = value == 1;
        if address == at::ALONE_FOR_NOW {
            // A started robot has told the others what it is a part of.
            if state == NmtState::Operational {
                return Err(AbortCode::DeviceState);
            }
            self.alone_for_now = wanted;
            self.alone_declared = wanted;
            return Ok(());
        }
        let itself = 1 << self.device.node;
        let alone = self.alone_for_now || self.parameters.unsigned(at::MEMBERS) == itself;
        if wanted && !alone {
            return Err(AbortCode::ParameterIncompatible);
        }
        self.commissioning = wanted;
        self.permission_renewed = wanted;
        Ok(())
    }

    /// A run begins only where a robot may move alone; what it may do is settled before.
    fn write_identification(
        &mut self,
        address: Address,
        value: Value,
        state: NmtState,
    ) -> Result<(), AbortCode> {
        let record = &mut self.identification;
        match (address, value) {
            (at::IDENTIFY, Value::U8(0)) => record.asked = Some(false),
            (at::IDENTIFY, Value::U8(1)) => {
                let permitted = self.commissioning && record.permitted;
                if state != NmtState::Operational || !permitted {
                    return Err(AbortCode::DeviceState);
                }
                record.asked = Some(true);
            }
            (at::IDENTIFY_RATE, Value::F32(value)) => record.bounds.rate = value,
            (at::IDENTIFY_TRAVEL, Value::F32(value)) => record.bounds.travel = value,
            (at::IDENTIFY_BANDWIDTH, Value::F32(value)) => record.bandwidth = value,
            (at::IDENTIFY_DAMPING, Value::F32(value)) => record.damping = value,
            (at::IDENTIFY_WHEELS, Value::U8(value)) => record.bounds.wheels = value,
            _ => return Err(AbortCode::InvalidValue),
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
        if entry.kind == Kind::Domain {
            let set = match entry.address {
                at::STORED_FAULTS => self.memory.bytes(),
                _ => self.parameters.set_bytes(),
            };
            let to = out.get_mut(..set.len()).ok_or(AbortCode::OutOfMemory)?;
            to.copy_from_slice(set);
            return Ok(set.len());
        }
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

    fn may_change_node(&self) -> bool {
        self.store.at_rest
    }

    fn reset(&mut self, scope: ResetScope) {
        self.setpoint.1 = false;
        self.alone.1 = false;
        self.commissioning = false;
        self.alone_for_now = false;
        if scope == ResetScope::Application {
            self.parameters = self.store.parameters();
            // What is measured is not reset: a reset does not move the robot. The sequence that
            // it followed last stays barred.
            (self.setpoint.0, self.alone.0) = ([0; 8], [0; 8]);
        }
    }
}
