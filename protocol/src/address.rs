//! Where every object is, by name. Each is declared with its object, in [`crate::table`].
//!
//! The objects of a program download, 0x1F50 on, are where CiA 302-3 has them. The manufacturer's
//! objects lie in the range of CiA 301 for them: 0x2000 identity, 0x2010 robot, 0x2020 wheels and
//! motors, 0x2030 limits and thresholds, 0x2040 group, 0x2050 commissioning, 0x2100 process data,
//! 0x2120 diagnostics.

/// Index and sub-index of an object.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// Index.
    pub index: u16,
    /// Sub-index; 0 for an object that is no record.
    pub sub: u8,
}

impl Address {
    /// The object at this index and sub-index.
    #[must_use]
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }

    /// Index and sub-index in one number, index in the upper bits.
    #[must_use]
    pub const fn packed(self) -> u32 {
        (self.index as u32) << 8 | self.sub as u32
    }
}

/// `2010:1`, the way people write it.
impl core::fmt::Debug for Address {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:04X}:{:X}", self.index, self.sub)
    }
}

impl core::fmt::Display for Address {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        core::fmt::Debug::fmt(self, f)
    }
}

pub use crate::table::names::*;
pub use crate::table::wheels::{identified, motor, wheel};
pub use crate::table::{history, rollers};
