//! The value of every object beyond the communication profile, and what a write does.
//!
//! Every access is looked up in the table of `protocol`. An object that is not there does not
//! exist, a value outside its limits is refused, and a refused write changes nothing. Parameters
//! are stored ([`crate::parameters`]). All other objects are computed here when they are read, and
//! take effect here when they are written.

use core::ops::Range;

use canopen::{AbortCode, NmtState};
use control::compensation::GridCompensation;
use control::time::Micros;
use protocol::address::{self as at, history, rollers};
use protocol::compensation::{CompensationSet, SetError};
use protocol::object::ValueError;
use protocol::{Access, Address, ENTRIES, Entry, Kind, Value, entry, table::highest_sub};

use super::publish::record;
use super::{Application, Received};
use crate::compensation::tabulate;
use crate::configuration;

impl Application {
    /// The bytes of a DOMAIN.
    pub(super) fn block(&self, address: Address) -> &[u8] {
        match address {
            at::STORED_FAULTS => self.memory.bytes(),
            _ => self.parameters.set_bytes(),
        }
    }

    /// How many seconds the LED will blink.
    fn blinks_left(&self) -> u8 {
        let left = self.blinks_until.since(self.now()).0;
        u8::try_from(left.div_ceil(1_000_000)).unwrap_or(u8::MAX)
    }

    /// What speaks against the parameters, as object 0x2002:1 shows it; 0 if nothing. Not inlined:
    /// the configuration on its stack is a kilobyte.
    #[inline(never)]
    pub(super) fn objection(&self) -> u32 {
        match self.store.corrupt {
            Some(address) => address.packed() << 8 | 3,
            None => {
                let (node, hardware) = (self.identity.node.get(), self.identity.hardware);
                configuration::build(&self.parameters, node, hardware)
                    .map_or_else(|error| error.code(), |_| 0)
            }
        }
    }

    pub(super) fn value(&self, entry: &Entry) -> Option<Value> {
        let address = entry.address;
        let counters = &self.counters;
        Some(match address {
            at::WIRE_VERSION => entry.default(),
            at::SERIAL_NUMBER => Value::U32(self.identity.serial),
            at::FIRMWARE_VERSION => Value::U32(self.identity.firmware),
            at::RESET_CAUSE => Value::U8(self.identity.reset_cause),
            at::CHIP => Value::U32(self.identity.chip),
            at::NODE_SWITCHES => Value::U8(self.identity.node_switches),
            at::CLOCK_WAIT => Value::U16(self.identity.clock_wait_ms),
            at::BROWN_OUT_LEVEL => Value::U8(self.identity.brown_out_level),
            at::NODE_STORED => Value::U8(self.store.node()),
            at::CONFIGURATION_STATUS => Value::U32(self.objection()),
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
            at::COMMISSIONING => Value::U8(u8::from(self.alone.is_permitted)),
            at::ALONE_FOR_NOW => Value::U8(u8::from(self.alone.for_now)),
            at::IDENTIFY => Value::U8(u8::from(self.identification.status == 1)),
            at::IDENTIFY_STATUS => Value::U8(self.identification.status),
            at::IDENTIFY_WHEEL => Value::U8(self.identification.wheel),
            at::IDENTIFY_RATE => Value::F32(self.identification.bounds.rate),
            at::IDENTIFY_TRAVEL => Value::F32(self.identification.bounds.travel),
            at::IDENTIFY_BANDWIDTH => Value::F32(self.identification.bandwidth),
            at::IDENTIFY_DAMPING => Value::F32(self.identification.damping),
            at::IDENTIFY_WHEELS => Value::U8(self.identification.bounds.wheels),
            at::BLINK => Value::U8(self.blinks_left()),
            at::LOCK_STATE => Value::U8(self.lock.state(self.now())),
            at::SUPPLY => Value::F32(self.report.supply().unwrap_or(0.0)),
            at::SLIP => Value::F32(self.report.slip_residual()),
            at::CURRENT => Value::F32(self.report.current),
            at::TEMPERATURE => Value::U8(self.report.temperature),
            at::GYRO_STATE => Value::U8(self.report.gyro.state as u8),
            at::GYRO_RATE => Value::F32(self.report.gyro.rate),
            at::GYRO_BIAS => Value::F32(self.report.gyro.bias),
            at::LATE_TICKS => Value::U32(self.report.late_ticks),
            at::SATURATED_TICKS => Value::U32(self.report.saturated_ticks),
            at::LOST_SYNCS => Value::U32(counters.lost_syncs),
            at::IGNORED_SETPOINTS => Value::U32(counters.ignored_setpoints),
            at::REFUSED_WRITES => Value::U32(counters.refused_writes),
            at::STOPS => Value::U32(counters.stops),
            at::WATCHDOG_RESETS => Value::U32(counters.watchdog_resets),
            at::CAN_ERRORS => Value::U32(counters.can_errors),
            at::LATE_VOTES => Value::U32(counters.late_votes),
            at::LATEST_VOTE => Value::U32(counters.latest_vote_us),
            at::CAN_TRANSMIT_ERRORS => Value::U8(self.can.errors.transmit),
            at::CAN_RECEIVE_ERRORS => Value::U8(self.can.errors.receive),
            at::CAN_LAST_ERROR => Value::U8(self.can.errors.last),
            at::CAN_PASSIVES => Value::U32(self.can.passives),
            at::CAN_BUS_OFFS => Value::U32(self.can.bus_offs),
            at::CABLE_LOST => Value::U32(counters.cable.to_cable),
            at::CABLE_NOT_SENT => Value::U32(counters.cable.to_bus),
            at::CABLE_DAMAGED => Value::U32(counters.cable.damaged),
            at::SAVES => Value::U32(counters.store.saves),
            at::ERASES => Value::U32(counters.store.erases),
            at::CUT_SAVES => Value::U32(counters.store.cut),
            at::UPTIME => Value::U32(u32::try_from(self.now().0 / 1000).unwrap_or(u32::MAX)),
            at::START_NUMBER => Value::U32(self.memory.start),
            at::UNSTORED_FAULTS => Value::U8(self.memory.unstored()),
            Address { index, sub } if index == history::code(1).index => {
                Value::U16(self.faults.nth(sub).0)
            }
            Address { index, sub } if index == history::time(1).index => {
                Value::U32(self.faults.nth(sub).1)
            }
            Address { index, sub } if index == history::limit_code(1).index => {
                Value::U16(self.limits.nth(sub).0)
            }
            Address { index, sub } if index == history::limit_time(1).index => {
                Value::U32(self.limits.nth(sub).1)
            }
            Address { index, sub } if index == rollers::state(0).index => {
                let wheel = usize::from(sub.checked_sub(1)?);
                Value::U8(*self.report.roller_states.get(wheel)? as u8)
            }
            Address { index, sub } if index == rollers::sweep(0).index => {
                let wheel = usize::from(sub.checked_sub(1)?);
                Value::F32(self.report.roller_sweeps.get(wheel)?.to_f32())
            }
            _ if let Some(value) = self.update_value(address) => value,
            _ => match self.process_data(address.index) {
                Some(bytes) => Value::from_bytes(entry.kind, bytes.get(place(entry))?).ok()?,
                None => match self.identification.result(address) {
                    Some(result) => Value::F32(result),
                    None => self.parameters.get(address)?,
                },
            },
        })
    }

    pub(super) fn check_write(
        &mut self,
        address: Address,
        data: &[u8],
        state: NmtState,
    ) -> Result<(), AbortCode> {
        let entry = find(address)?;
        match entry.access() {
            Access::Const | Access::ReadOnly => return Err(AbortCode::ReadOnly),
            Access::Parameter if state == NmtState::Operational => {
                return Err(AbortCode::DeviceState);
            }
            Access::Parameter | Access::ReadWrite | Access::WriteOnly => {}
        }
        self.pass_lock(entry, data)?;
        if entry.address.index == at::LOCK_KEY.index && entry.kind == Kind::Domain {
            return self.write_lock(address, data);
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
        if let Some(slot) = entry.slot() {
            self.parameters.set(slot, value);
            return Ok(());
        }
        self.take_value(entry, value, state)
    }

    /// What the write of an object does that is no parameter.
    fn take_value(&mut self, entry: &Entry, value: Value, nmt: NmtState) -> Result<(), AbortCode> {
        let record = &mut self.identification;
        match (entry.address, value) {
            (at::COMMISSIONING, Value::U8(wanted @ 0..=1)) => {
                return self.permit_alone(wanted == 1);
            }
            (at::ALONE_FOR_NOW, Value::U8(wanted @ 0..=1)) => {
                return self.declare_alone(wanted == 1, nmt);
            }
            (at::PROGRAM_CONTROL, Value::U8(value)) => return self.control_update(value, nmt),
            (at::IDENTIFY, Value::U8(0)) if record.is_running => {
                self.end_identification(self.now())
            }
            (at::IDENTIFY, Value::U8(0)) => {}
            (at::IDENTIFY, Value::U8(1)) => return self.begin_identification(nmt),
            (at::IDENTIFY_RATE, Value::F32(value)) => record.bounds.rate = value,
            (at::IDENTIFY_TRAVEL, Value::F32(value)) => record.bounds.travel = value,
            (at::IDENTIFY_BANDWIDTH, Value::F32(value)) => record.bandwidth = value,
            (at::IDENTIFY_DAMPING, Value::F32(value)) => record.damping = value,
            (at::IDENTIFY_WHEELS, Value::U8(value)) => record.bounds.wheels = value,
            (at::LOCK_STATE, Value::U8(1)) => self.lock.lock(),
            (at::BLINK, Value::U8(seconds)) => {
                self.blinks_until = self.now() + Micros(u64::from(seconds) * 1_000_000);
            }
            _ if entry.address.index == record::GROUP_TWIST => {
                write_field(&mut self.group_twist, entry, value);
            }
            _ if entry.address.index == record::ALONE_TWIST => {
                write_field(&mut self.alone.twist, entry, value);
            }
            _ => return Err(AbortCode::InvalidValue),
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
            .and_then(|constant| tabulate(&mut GridCompensation::from(&constant), &set, &constant))
            .map_err(|_| AbortCode::ParameterIncompatible)?;
        let slot = entry.slot().ok_or(AbortCode::General)?;
        self.parameters.set_block(slot, data);
        Ok(())
    }
}

/// Where a field lies in its process data: the fields are in the order of their sub-indices.
fn place(entry: &Entry) -> Range<usize> {
    let before = ENTRIES.iter().filter(|other| {
        other.address.index == entry.address.index && other.address.sub < entry.address.sub
    });
    let from: usize = before.map(|other| usize::from(other.kind.bytes())).sum();
    from..from + usize::from(entry.kind.bytes())
}

fn write_field(to: &mut Received, entry: &Entry, value: Value) {
    if let Some(field) = to.bytes.get_mut(place(entry)) {
        for (to, byte) in field.iter_mut().zip(value.to_bytes()) {
            *to = byte;
        }
        to.is_fresh = true;
    }
}

pub(super) fn find(address: Address) -> Result<&'static Entry, AbortCode> {
    entry(address).ok_or(match highest_sub(address.index) {
        Some(_) => AbortCode::NoSubIndex,
        None => AbortCode::NoObject,
    })
}
