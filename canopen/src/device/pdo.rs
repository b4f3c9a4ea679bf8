//! What receive and transmit PDOs have in common: identifier and mapping, and the rules by which a
//! master may change them (CiA 301, 7.5.2.35 to 7.5.2.38).
//!
//! A PDO is changed in this order: switch it off (bit 31 of sub-index 1), set the number of mapped
//! objects to 0, write the entries, set the number, switch it on again. Everything else is refused.

use crate::bytes::{high_u16, low_u8, low_u16};
use crate::{AbortCode, CobId, Mapping, NodeId, PdoConfig};

/// Objects in one PDO: eight bytes, none smaller than one.
pub const MAX_MAPPED: usize = 8;

/// Bit 31 of a PDO's COB-ID: it does not exist.
pub(super) const OFF: u32 = 1 << 31;
/// Bit 30: no remote frames.
pub(super) const NO_RTR: u32 = 1 << 30;

/// The highest transmission type that is synchronous.
pub(super) const LAST_SYNCHRONOUS: u8 = 240;

/// Identifiers CiA 301, table 40 keeps for other services.
#[inline(never)]
pub(super) const fn is_restricted(id: u16) -> bool {
    matches!(
        id,
        0..=0x07F | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..=0x6FF | 0x701..
    )
}

/// The COB-ID entry a configuration asks for. Without a node-ID, or with an identifier that is not
/// allowed, the PDO is off.
pub(super) fn default_cob_id(config: &PdoConfig, node: Option<NodeId>) -> u32 {
    let id = match (config.cob_id, node) {
        (CobId::Fixed(id), _) => id,
        (CobId::PlusNode(base), Some(node)) => base.saturating_add(u16::from(node.get())),
        (CobId::PlusNode(_), None) | (CobId::Disabled, _) => return OFF,
    };
    match is_restricted(id) {
        true => OFF,
        false => u32::from(id),
    }
}

/// Checks a new value of sub-index 1 against the one in force.
pub(super) fn check_cob_id(new: u32, old: u32, mapped: u8) -> Result<(), AbortCode> {
    if new & OFF != 0 {
        return Ok(());
    }
    let id = low_u16(new) & 0x7FF;
    let extended = new & !(NO_RTR | 0x7FF) != 0;
    let moves_while_on = old & OFF == 0 && old & 0x7FF != new & 0x7FF;
    match extended || is_restricted(id) || moves_while_on || mapped == 0 {
        true => Err(AbortCode::InvalidValue),
        false => Ok(()),
    }
}

/// Index, sub-index and bits of a mapping entry.
pub(super) const fn unpack(entry: u32) -> (u16, u8, u8) {
    (high_u16(entry), low_u8(entry >> 8), low_u8(entry))
}

/// Which parameters of which PDO, counted from 0, an index stands for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum PdoIndex {
    Receive(u16),
    ReceiveMap(u16),
    Transmit(u16),
    TransmitMap(u16),
}

impl PdoIndex {
    pub const fn of(index: u16) -> Option<Self> {
        let at = index & 0x1FF;
        match index & 0xFE00 {
            0x1400 => Some(Self::Receive(at)),
            0x1600 => Some(Self::ReceiveMap(at)),
            0x1800 => Some(Self::Transmit(at)),
            0x1A00 => Some(Self::TransmitMap(at)),
            _ => None,
        }
    }
}

/// Which objects a PDO carries: objects 0x1600 and 0x1A00.
#[derive(Clone, Copy)]
pub(super) struct Map {
    /// Sub-index 0.
    pub count: u8,
    /// Sub-indices 1 to 8.
    pub entries: [u32; MAX_MAPPED],
    /// Bytes of the objects mapped.
    pub bytes: u8,
    /// As the configuration says.
    pub is_default: bool,
}

impl Map {
    pub const EMPTY: Self = Self {
        count: 0,
        entries: [0; MAX_MAPPED],
        bytes: 0,
        is_default: false,
    };

    pub fn new(mapping: &[Mapping]) -> Self {
        let mut map = Self::EMPTY;
        for (entry, object) in map.entries.iter_mut().zip(mapping) {
            *entry = object.packed();
        }
        let count = u8::try_from(mapping.len()).unwrap_or(u8::MAX);
        // A configuration that breaks the rules leaves the PDO empty.
        map.is_default = map.set_count(count).is_ok();
        map
    }

    /// The objects mapped: index, sub-index, length in bytes.
    pub fn objects(&self) -> impl Iterator<Item = (u16, u8, u8)> + '_ {
        let mapped = self.entries.iter().take(usize::from(self.count));
        mapped.map(|entry| {
            let (index, sub, bits) = unpack(*entry);
            (index, sub, bits / 8)
        })
    }

    /// Sub-index 0.
    pub fn set_count(&mut self, count: u8) -> Result<(), AbortCode> {
        let wanted = self
            .entries
            .get(..usize::from(count))
            .ok_or(AbortCode::PdoLength)?;
        if wanted.contains(&0) {
            return Err(AbortCode::ParameterIncompatible);
        }
        let bits: u32 = wanted.iter().map(|entry| entry & 0xFF).sum();
        if bits > 64 {
            return Err(AbortCode::PdoLength);
        }
        self.count = count;
        self.bytes = low_u8(bits / 8);
        self.is_default = false;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pre_defined_connection_set_is_not_restricted_for_pdos() {
        for id in [
            0x80, 0x81, 0x100, 0x181, 0x57F, 0x580, 0x600, 0x680, 0x6DF, 0x700,
        ] {
            assert!(!is_restricted(id), "{id:#x}");
        }
        for id in [
            0, 1, 0x7F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x701, 0x7FF,
        ] {
            assert!(is_restricted(id), "{id:#x}");
        }
    }

    #[test]
    fn sixty_four_bits_fit_and_one_more_byte_does_not() {
        let fits = [Mapping::new(0x2000, 1, 32), Mapping::new(0x2000, 2, 32)];
        assert_eq!(Map::new(&fits).bytes, 8);
        let mut map = Map::new(&fits);
        map.entries[2] = Mapping::new(0x2000, 3, 8).packed();
        assert_eq!(map.set_count(3), Err(AbortCode::PdoLength));
        assert_eq!(map.set_count(9), Err(AbortCode::PdoLength));
        assert_eq!(map.count, 2);
    }
}
