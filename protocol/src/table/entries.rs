//! The table as a whole, put together by the compiler: every object with its texts for the
//! generated documents, and a short entry of each for the robot.

use super::record::Record;
use super::{
    commissioning, diagnostics, geometry, group, history, identity, limits, lock, motors, process,
    rollers, update, wheels,
};
use crate::address::Address;
use crate::object::{Access, Kind, Object, Value, ValueError};

/// All records, by rising index.
const PARTS: &[&[Record]] = &[
    update::PROGRAM_RECORDS,
    identity::IDENTITY_RECORDS,
    update::UPDATE_RECORDS,
    lock::LOCK_RECORDS,
    geometry::ROBOT_RECORDS,
    wheels::wheel::RECORDS,
    geometry::DRIVE_RECORDS,
    motors::WHEELS_RECORDS,
    wheels::motor::RECORDS,
    motors::SUPPLY_RECORDS,
    motors::TORQUE_RECORDS,
    motors::OUTPUT_STAGE_RECORDS,
    rollers::PARAMETERS,
    motors::ROLLER_REFERENCE_RECORDS,
    motors::ENCODER_INPUTS_RECORDS,
    motors::SMART_DRIVES_RECORDS,
    limits::LIMITS_RECORDS,
    group::GROUP_RECORDS,
    commissioning::COMMISSIONING_RECORDS,
    commissioning::IDENTIFICATION_RECORDS,
    wheels::identified::RECORDS,
    commissioning::BLINK_RECORDS,
    process::SETPOINT_RECORDS,
    process::ALONE_RECORDS,
    process::STATUS_RECORDS,
    process::MEASURED_RECORDS,
    process::POSE_RECORDS,
    process::RATES_RECORDS,
    rollers::STATES,
    diagnostics::DIAGNOSTICS_RECORDS,
    history::RECORDS,
    diagnostics::STORE_RECORDS,
    diagnostics::POWER_RECORDS,
    diagnostics::FAULT_MEMORY_RECORDS,
    diagnostics::CAN_RECORDS,
    diagnostics::GYRO_RECORDS,
];

/// How many objects there are.
pub const COUNT: usize = count();

/// How many of them are parameters and so have a slot in the robot's store.
pub const PARAMETERS: usize = parameters();

/// Every object, by rising address.
pub static OBJECTS: &[Object] = &FLAT;

/// Name of the object or record at an index, for the EDS and the protocol page.
pub static RECORDS: &[(u16, &str)] = &records();

/// The same objects without the texts, for the robot.
pub static ENTRIES: [Entry; COUNT] = entries();

/// The indices among them that a profile of CiA has given a meaning: they are below 0x2000, beside
/// the objects of the communication.
pub static PROFILE_OBJECTS: [u16; update::PROGRAM_RECORDS.len()] = profile_objects();

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn profile_objects() -> [u16; update::PROGRAM_RECORDS.len()] {
    let mut out = [0; update::PROGRAM_RECORDS.len()];
    let mut next = 0;
    while next < out.len() {
        out[next] = update::PROGRAM_RECORDS[next].index;
        assert!(out[next] < 0x2000);
        next += 1;
    }
    out
}

static FLAT: [Object; COUNT] = flat();

const fn count() -> usize {
    let mut count = 0;
    let mut parts = PARTS;
    while let Some((part, rest)) = parts.split_first() {
        let mut part: &[Record] = part;
        while let Some((record, others)) = part.split_first() {
            count += record.objects.len();
            part = others;
        }
        parts = rest;
    }
    count
}

const fn record_count() -> usize {
    let mut count = 0;
    let mut parts = PARTS;
    while let Some((part, rest)) = parts.split_first() {
        count += part.len();
        parts = rest;
    }
    count
}

const fn parameters() -> usize {
    let mut objects = OBJECTS;
    let mut count = 0;
    while let Some((object, rest)) = objects.split_first() {
        if matches!(object.access, Access::Parameter) {
            count += 1;
        }
        objects = rest;
    }
    count
}

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn flat() -> [Object; COUNT] {
    let mut out = [PARTS[0][0].objects[0]; COUNT];
    let mut next = 0;
    let mut parts = PARTS;
    while let Some((part, rest)) = parts.split_first() {
        let mut part: &[Record] = part;
        while let Some((record, others)) = part.split_first() {
            let mut objects = record.objects;
            while let Some((object, behind)) = objects.split_first() {
                assert!(object.address.index == record.index, "in another record");
                assert!(
                    next == 0 || out[next - 1].address.packed() < object.address.packed(),
                    "the table is not in order"
                );
                out[next] = *object;
                next += 1;
                objects = behind;
            }
            part = others;
        }
        parts = rest;
    }
    out
}

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn records() -> [(u16, &'static str); record_count()] {
    let mut out = [(0, ""); record_count()];
    let mut next = 0;
    let mut parts = PARTS;
    while let Some((part, rest)) = parts.split_first() {
        let mut part: &[Record] = part;
        while let Some((record, others)) = part.split_first() {
            out[next] = (record.index, record.name);
            next += 1;
            part = others;
        }
        parts = rest;
    }
    out
}

/// Lowest and highest value and default of an object, as words.
type Range = [u32; 3];

/// Every combination that occurs, once, and how many there are.
const UNIQUE: ([Range; COUNT], usize) = unique();

/// The same for the robot: most objects share theirs with others.
static RANGES: [Range; UNIQUE.1] = ranges();

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn unique() -> ([Range; COUNT], usize) {
    let mut out = [[0; 3]; COUNT];
    let (mut next, mut found) = (0, 0);
    while next < COUNT {
        let range = FLAT[next].range();
        if place(&out, found, range) == found {
            out[found] = range;
            found += 1;
        }
        next += 1;
    }
    (out, found)
}

/// Where a range is among the first `count`; `count` if it is not there.
#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn place(ranges: &[Range; COUNT], count: usize, [a, b, c]: Range) -> usize {
    let mut at = 0;
    while at < count {
        let [x, y, z] = ranges[at];
        if a == x && b == y && c == z {
            return at;
        }
        at += 1;
    }
    count
}

#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn ranges() -> [Range; UNIQUE.1] {
    let mut out = [[0; 3]; UNIQUE.1];
    let mut next = 0;
    while next < out.len() {
        out[next] = UNIQUE.0[next];
        next += 1;
    }
    out
}

/// Lowest and highest value and default, by [`Entry`]'s number.
fn range(number: u8) -> Range {
    RANGES.get(usize::from(number)).copied().unwrap_or([0; 3])
}

#[expect(
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    reason = "evaluated by the compiler only, with the numbers asserted"
)]
const fn entries() -> [Entry; COUNT] {
    const { assert!(PARAMETERS < 255 && UNIQUE.1 < 256, "both are bytes") };
    let mut out = [Entry::of(&FLAT[0], 0, None); COUNT];
    let (mut next, mut slot) = (0, 0_usize);
    while next < COUNT {
        let object = &FLAT[next];
        let range = place(&UNIQUE.0, UNIQUE.1, object.range()) as u8;
        out[next] = if matches!(object.access, Access::Parameter) {
            slot += 1;
            Entry::of(object, range, Some((slot - 1) as u8))
        } else {
            Entry::of(object, range, None)
        };
        next += 1;
    }
    out
}

/// The entry of an object, or `None` when there is no such object.
#[must_use]
pub fn entry(address: Address) -> Option<&'static Entry> {
    let found = ENTRIES
        .binary_search_by_key(&address.packed(), |entry| entry.address.packed())
        .ok()?;
    ENTRIES.get(found)
}

/// The highest sub-index at an index: what sub-index 0 of a record reads. `None` when there is no
/// such index, 0 when it is no record.
#[must_use]
pub fn highest_sub(index: u16) -> Option<u8> {
    let end = ENTRIES.partition_point(|entry| entry.address.index <= index);
    let last = ENTRIES.get(end.checked_sub(1)?)?;
    (last.address.index == index).then_some(last.address.sub)
}

/// What a robot needs of an [`Object`] at run time. Eight bytes, because there are some 250 of them
/// in flash.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Index and sub-index.
    pub address: Address,
    /// Type on the wire.
    pub kind: Kind,
    /// Access, and the bits [`GUARDED`], [`MAPPABLE`] and [`REQUIRED`].
    bits: u8,
    /// Number of its limits and default.
    range: u8,
    /// Place of a parameter in the robot's store; [`NO_SLOT`] for what is not a parameter.
    slot: u8,
}

const CONST: u8 = 0;
const READ_ONLY: u8 = 1;
const READ_WRITE: u8 = 2;
const PARAMETER: u8 = 3;
const WRITE_ONLY: u8 = 4;
const GUARDED: u8 = 1 << 5;
const MAPPABLE: u8 = 1 << 6;
const REQUIRED: u8 = 1 << 7;
const NO_SLOT: u8 = u8::MAX;

const _: () = assert!(size_of::<Entry>() == 8);

impl Entry {
    /// A valid value of this object from the bytes of a write.
    ///
    /// # Errors
    /// Any [`ValueError`].
    pub fn accept(&self, data: &[u8]) -> Result<Value, ValueError> {
        let value = Value::from_bytes(self.kind, data)?;
        value.check(self.min(), self.max())?;
        Ok(value)
    }

    /// Who may write it.
    #[must_use]
    pub const fn access(&self) -> Access {
        match self.bits & !(GUARDED | MAPPABLE | REQUIRED) {
            CONST => Access::Const,
            READ_ONLY => Access::ReadOnly,
            WRITE_ONLY => Access::WriteOnly,
            READ_WRITE => Access::ReadWrite,
            _ => Access::Parameter,
        }
    }

    /// Must not be written while the robot is locked.
    #[must_use]
    pub const fn is_guarded(&self) -> bool {
        self.bits & GUARDED != 0
    }

    /// May be mapped into a PDO.
    #[must_use]
    pub const fn is_mappable(&self) -> bool {
        self.bits & MAPPABLE != 0
    }

    /// Must have been written before the drivers can be enabled.
    #[must_use]
    pub const fn is_required(&self) -> bool {
        self.bits & REQUIRED != 0
    }

    /// Place of a parameter in the robot's store, counted from 0; `None` for what is not a
    /// parameter and so is not kept in flash either.
    #[must_use]
    pub const fn slot(&self) -> Option<u8> {
        if self.slot == NO_SLOT {
            None
        } else {
            Some(self.slot)
        }
    }

    /// Lowest value accepted.
    #[must_use]
    pub fn min(&self) -> Value {
        let [min, _, _] = range(self.range);
        Value::from_bits(self.kind, min)
    }

    /// Highest value accepted.
    #[must_use]
    pub fn max(&self) -> Value {
        let [_, max, _] = range(self.range);
        Value::from_bits(self.kind, max)
    }

    /// Value after a reset to defaults.
    #[must_use]
    pub fn default(&self) -> Value {
        let [_, _, default] = range(self.range);
        Value::from_bits(self.kind, default)
    }

    const fn of(object: &Object, range: u8, slot: Option<u8>) -> Self {
        let access = match object.access {
            Access::Const => CONST,
            Access::ReadOnly => READ_ONLY,
            Access::WriteOnly => WRITE_ONLY,
            Access::ReadWrite => READ_WRITE,
            Access::Parameter => PARAMETER,
        };
        let mappable = if object.mappable { MAPPABLE } else { 0 };
        let required = if object.required { REQUIRED } else { 0 };
        let guarded = if object.guarded { GUARDED } else { 0 };
        // What could be saved but not loaded.
        assert!(object.persistent == slot.is_some());
        Self {
            address: object.address,
            kind: object.kind,
            bits: access | guarded | mappable | required,
            range,
            slot: match slot {
                Some(slot) => slot,
                None => NO_SLOT,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::WIRE_VERSION;
    use crate::address as at;
    use crate::object::{Access, Value};

    #[test]
    fn every_object_is_found_by_its_address() {
        for object in OBJECTS {
            let entry = entry(object.address).unwrap();
            assert_eq!(entry.address, object.address);
            assert_eq!(entry.kind, object.kind);
            assert_eq!(entry.min(), object.min);
            assert_eq!(entry.max(), object.max);
            assert_eq!(entry.default(), object.default);
        }
        assert!(entry(Address::new(0x2000, 1)).is_none());
        assert!(entry(Address::new(0x2FFF, 0)).is_none());
    }

    #[test]
    fn every_default_is_within_its_own_limits() {
        for object in OBJECTS {
            assert_eq!(
                object.default.check(object.min, object.max),
                Ok(()),
                "{:?} {}",
                object.address,
                object.name
            );
            assert_eq!(object.min.kind(), object.kind);
            assert_eq!(object.max.kind(), object.kind);
        }
    }

    #[test]
    fn slots_count_the_parameters_without_gaps() {
        let slots: std::vec::Vec<u8> = ENTRIES.iter().filter_map(|entry| entry.slot()).collect();
        let want: std::vec::Vec<u8> = (0..u8::try_from(PARAMETERS).unwrap()).collect();
        assert_eq!(slots, want);
    }

    #[test]
    fn records_name_every_index_once() {
        let mut indices: std::vec::Vec<u16> =
            OBJECTS.iter().map(|object| object.address.index).collect();
        indices.dedup();
        let named: std::vec::Vec<u16> = RECORDS.iter().map(|(index, _)| *index).collect();
        assert_eq!(indices, named);
    }

    #[test]
    fn sub_indices_of_a_record_have_no_gaps() {
        for (index, _) in RECORDS {
            let subs: std::vec::Vec<u8> = OBJECTS
                .iter()
                .filter(|object| object.address.index == *index)
                .map(|object| object.address.sub)
                .collect();
            let highest = highest_sub(*index).unwrap();
            if highest == 0 {
                assert_eq!(subs, [0]);
            } else {
                let want: std::vec::Vec<u8> = (1..=highest).collect();
                assert_eq!(subs, want, "index {index:04X}");
            }
        }
        assert_eq!(highest_sub(0x2005), None);
        assert_eq!(highest_sub(0x1FFF), None);
    }

    #[test]
    fn what_changes_the_motion_is_locked_while_operational() {
        for object in OBJECTS.iter().filter(|object| object.required) {
            assert_eq!(object.access, Access::Parameter);
            assert!(object.persistent);
        }
    }

    #[test]
    fn parameters_updates_and_the_key_are_guarded_and_nothing_that_moves_or_stops() {
        for object in OBJECTS {
            let address = object.address;
            let others = [at::PROGRAM_DATA, at::PROGRAM_CONTROL, at::LOCK_KEY];
            let wanted = object.persistent || others.contains(&address);
            assert_eq!(object.guarded, wanted, "{} {address}", object.name);
            assert_eq!(entry(address).unwrap().is_guarded(), wanted);
            assert!(!(object.guarded && object.mappable), "{address}");
        }
    }

    #[test]
    fn wire_version_is_an_object() {
        let entry = entry(at::WIRE_VERSION).unwrap();
        assert_eq!(entry.default(), Value::U16(WIRE_VERSION));
        assert_eq!(entry.access(), Access::Const);
    }
}
