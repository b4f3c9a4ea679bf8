//! The node-ID, which a CANopen device adds to the base identifiers of its services.

use core::fmt;

/// A CANopen node-ID, 1 to 127.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NodeId(u8);

impl NodeId {
    /// The smallest node-ID.
    pub const MIN: Self = Self(1);
    /// The largest node-ID.
    pub const MAX: Self = Self(127);

    /// Makes a node-ID; `None` outside 1 to 127.
    #[must_use]
    pub const fn new(id: u8) -> Option<Self> {
        match id {
            1..=127 => Some(Self(id)),
            _ => None,
        }
    }

    /// The number, 1 to 127.
    #[must_use]
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The COB-ID of a service of this node in the pre-defined connection set, for example
    /// `0x580` for its SDO responses. A base above 0x780 is cut to 11 bits.
    #[must_use]
    pub const fn cob_id(self, base: u16) -> u16 {
        (base & 0x780) | self.0 as u16
    }

    /// The node a COB-ID of the pre-defined connection set belongs to; `None` for node 0.
    #[must_use]
    pub const fn of_cob_id(cob_id: u16) -> Option<Self> {
        let [low, _] = cob_id.to_le_bytes();
        Self::new(low & 0x7F)
    }
}

impl fmt::Debug for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {}", self.0)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exists_from_1_to_127() {
        assert_eq!(NodeId::new(0), None);
        assert_eq!(NodeId::new(128), None);
        assert_eq!(NodeId::new(1), Some(NodeId::MIN));
        assert_eq!(NodeId::new(127), Some(NodeId::MAX));
    }

    #[test]
    fn adds_itself_to_the_base_and_is_found_again() {
        let node = NodeId::new(17).unwrap();
        assert_eq!(node.cob_id(0x580), 0x591);
        assert_eq!(NodeId::of_cob_id(0x591), Some(node));
        assert_eq!(NodeId::of_cob_id(0x580), None);
    }
}
