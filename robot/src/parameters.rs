//! The parameters as the bus writes them: one word each, and whether it has been written.
//!
//! The compensation set is longer; its word is its CRC, and its bytes are stored beside the words.
//!
//! Nothing here takes effect. A value is checked against its own limits when it is written; the set
//! is converted into a [`control::configuration::Configuration`], and checked as a set, when the
//! robot is started.

use kinematics::{CompensationError, VelocityCompensation};
use protocol::address as at;
use protocol::compensation::{CompensationSet, EMPTY, LENGTH_MAX};
use protocol::{
    Address, ENTRIES, Entry, Value, crc32, entry,
    table::{COMMON, PARAMETERS},
};

const WORDS: usize = PARAMETERS.div_ceil(32);

/// Values of all parameters.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Parameters {
    values: [u32; PARAMETERS],
    written: [u32; WORDS],
    /// The compensation set; always a valid one.
    set: [u8; LENGTH_MAX],
    set_length: u8,
}

/// The length of a set fits a byte.
const _: () = assert!(LENGTH_MAX < 256);

impl Default for Parameters {
    fn default() -> Self {
        Self::new()
    }
}

impl Parameters {
    /// All at their defaults, none written.
    #[must_use]
    pub fn new() -> Self {
        let mut values = [0; PARAMETERS];
        let parameters = ENTRIES.iter().filter(|entry| entry.slot().is_some());
        for (value, entry) in values.iter_mut().zip(parameters) {
            *value = entry.default().to_bits();
        }
        let mut parameters = Self {
            values,
            written: [0; WORDS],
            set: [0; LENGTH_MAX],
            set_length: 0,
        };
        parameters.keep_set(&EMPTY);
        parameters
    }

    /// The value of a parameter; `None` for what is none.
    #[must_use]
    pub fn get(&self, address: Address) -> Option<Value> {
        let entry = entry(address)?;
        let bits = self.values.get(usize::from(entry.slot()?))?;
        Some(Value::from_bits(entry.kind, *bits))
    }

    /// Keeps a value that has been checked already.
    pub(crate) fn set(&mut self, slot: u8, value: Value) {
        let slot = usize::from(slot);
        if let Some(place) = self.values.get_mut(slot) {
            *place = value.to_bits();
        }
        if let Some(word) = self.written.get_mut(slot / 32) {
            *word |= 1 << (slot % 32);
        }
    }

    /// Keeps a compensation set that has been checked already.
    pub(crate) fn set_block(&mut self, slot: u8, bytes: &[u8]) {
        self.keep_set(bytes);
        let crc = self.values.get(usize::from(slot)).copied().unwrap_or(0);
        self.set(slot, Value::U32(crc));
    }

    fn keep_set(&mut self, bytes: &[u8]) {
        let (Some(to), Ok(length), Some(crc)) = (
            self.set.get_mut(..bytes.len()),
            u8::try_from(bytes.len()),
            bytes.first_chunk(),
        ) else {
            return;
        };
        to.copy_from_slice(bytes);
        self.set_length = length;
        let slot = entry(at::COMPENSATION_SET).and_then(|entry| entry.slot());
        if let Some(word) = slot.and_then(|slot| self.values.get_mut(usize::from(slot))) {
            *word = u32::from_le_bytes(*crc);
        }
    }

    /// The bytes of the compensation set.
    #[must_use]
    pub fn set_bytes(&self) -> &[u8] {
        self.set.get(..usize::from(self.set_length)).unwrap_or(&[])
    }

    /// The compensation set.
    #[must_use]
    pub fn compensation_set(&self) -> Option<CompensationSet<'_>> {
        CompensationSet::decode(self.set_bytes()).ok()
    }

    /// What axes without rows in the set have.
    pub(crate) fn constant_compensation(&self) -> Result<VelocityCompensation, CompensationError> {
        VelocityCompensation::new(
            self.real(at::COMPENSATION_LONGITUDINAL),
            self.real(at::COMPENSATION_LATERAL),
            self.real(at::COMPENSATION_YAW),
        )
    }

    /// The value of a parameter that has been written or loaded.
    pub(crate) fn written(&self, entry: &Entry) -> Option<Value> {
        let slot = usize::from(entry.slot()?);
        let is_written = self.written.get(slot / 32)? >> (slot % 32) & 1 == 1;
        let bits = self.values.get(slot)?;
        is_written.then(|| Value::from_bits(entry.kind, *bits))
    }

    /// The first required parameter that has not been written, by address.
    #[must_use]
    pub fn first_missing(&self) -> Option<Address> {
        ENTRIES.iter().find_map(|entry| {
            let slot = usize::from(entry.slot()?);
            let word = self.written.get(slot / 32)?;
            let missing = entry.is_required() && word & (1 << (slot % 32)) == 0;
            missing.then_some(entry.address)
        })
    }

    /// CRC-32 (IEEE 802.3) over all values, in the order of the table, four bytes each.
    #[must_use]
    pub fn crc(&self) -> u32 {
        crc32(self.values.iter().copied().flat_map(u32::to_le_bytes))
    }

    /// Another checksum, independent of the CRC: FNV-1a over all values and the bytes of the
    /// compensation set.
    #[must_use]
    pub fn check(&self) -> u32 {
        let set = self.set_bytes().iter().map(|byte| u32::from(*byte));
        let words = self.values.iter().copied().chain(set);
        words.fold(0x811C_9DC5, |hash, word| {
            (hash ^ word).wrapping_mul(0x0100_0193)
        })
    }

    /// The CRC over what all members of a group must have in common.
    #[must_use]
    pub fn group_crc(&self) -> u32 {
        let common = COMMON.iter().filter_map(|address| self.get(*address));
        crc32(common.map(Value::to_bits).flat_map(u32::to_le_bytes))
    }

    /// A REAL32 parameter, as a number.
    pub(crate) fn real(&self, address: Address) -> f32 {
        match self.get(address) {
            Some(Value::F32(value)) => value,
            _ => f32::NAN,
        }
    }

    /// An unsigned parameter of any length.
    pub(crate) fn unsigned(&self, address: Address) -> u32 {
        self.get(address).map_or(0, Value::to_bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::Kind;

    /// Gives a parameter another value than its default.
    fn change(parameters: &mut Parameters, entry: &Entry) {
        let changed = if entry.kind == Kind::Domain {
            Value::U32(1)
        } else {
            Value::from_bits(entry.kind, entry.default().to_bits() ^ 1)
        };
        parameters.set(entry.slot().unwrap(), changed);
    }

    #[test]
    fn starts_with_the_defaults_and_nothing_written() {
        let parameters = Parameters::new();
        for entry in &ENTRIES {
            if entry.slot().is_some() {
                assert_eq!(parameters.get(entry.address), Some(entry.default()));
            } else {
                assert_eq!(parameters.get(entry.address), None);
            }
        }
        assert_eq!(parameters.first_missing(), Some(at::HALF_TRACK));
    }

    #[test]
    fn group_crc_sees_what_is_common_and_nothing_else() {
        let plain = Parameters::new().group_crc();
        for entry in ENTRIES.iter().filter(|entry| entry.slot().is_some()) {
            let mut parameters = Parameters::new();
            change(&mut parameters, entry);
            let common = COMMON.contains(&entry.address);
            assert_eq!(
                parameters.group_crc() != plain,
                common,
                "{:?}",
                entry.address
            );
        }
    }

    #[test]
    fn every_required_parameter_is_missed() {
        let mut parameters = Parameters::new();
        let mut required = 0;
        while let Some(address) = parameters.first_missing() {
            let entry = entry(address).unwrap();
            parameters.set(entry.slot().unwrap(), entry.default());
            required += 1;
        }
        assert_eq!(required, ENTRIES.iter().filter(|e| e.is_required()).count());
    }

    #[test]
    fn both_checksums_tell_every_parameter_apart() {
        for sum in [Parameters::crc, Parameters::check] {
            let mut seen = std::collections::BTreeSet::new();
            seen.insert(sum(&Parameters::new()));
            for entry in ENTRIES.iter().filter(|entry| entry.slot().is_some()) {
                let mut parameters = Parameters::new();
                change(&mut parameters, entry);
                assert!(seen.insert(sum(&parameters)), "{:?}", entry.address);
            }
        }
    }

    #[test]
    fn the_second_checksum_covers_the_bytes_of_the_compensation_set() {
        let plain = Parameters::new();
        let mut other = plain;
        // Behind its own CRC, which both have.
        other.set[4] ^= 1;
        assert_eq!(plain.crc(), other.crc());
        assert_ne!(plain.check(), other.check());
    }
}
