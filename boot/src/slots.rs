//! The layout of flash. It is defined only here in Rust; `memory/` has it for the linker.
//!
//! | sectors | address | length | |
//! |---|---|---|---|
//! | 0 | 0x0800_0000 | 16 KiB | boot code |
//! | 1, 2 | 0x0800_4000 | 32 KiB | parameters |
//! | 3 | 0x0800_C000 | 16 KiB | mark of the cable |
//! | 4, 5 | 0x0801_0000 | 192 KiB | slot A |
//! | 6, 7 | 0x0804_0000 | 256 KiB | slot B |
//!
//! The STM32F446 (RM0390 rev 6, table 5) and the first half of the STM32F407IG (RM0090, table 5)
//! have the same sectors.

use core::ops::{Range, RangeInclusive};

/// First address of flash, where the boot code lies.
pub const BOOT: u32 = 0x0800_0000;

/// Bytes for the boot code.
pub const BOOT_LENGTH: u32 = 0x4000;

/// First address of the sector with the mark of the cable.
pub const MARK: u32 = 0x0800_C000;

/// Bytes at the end of a slot that say what is known about it.
pub const TAIL_LENGTH: u32 = 64;

/// Bytes of the shortest image: the vectors of the processor and of the chip.
pub const SHORTEST_IMAGE: u32 = 512;

/// RAM that a stack may begin in; both chips have 128 KiB from here on.
const RAM: RangeInclusive<u32> = 0x2000_0000..=0x2002_0000;

/// One of the two places for an image.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Slot {
    /// The one that is written by cable.
    A,
    /// The other one.
    B,
}

impl Slot {
    /// Both.
    pub const ALL: [Self; 2] = [Self::A, Self::B];

    /// First address, where the vectors of the image are.
    #[must_use]
    pub const fn address(self) -> u32 {
        match self {
            Self::A => 0x0801_0000,
            Self::B => 0x0804_0000,
        }
    }

    /// Bytes.
    #[must_use]
    pub const fn length(self) -> u32 {
        match self {
            Self::A => 0x3_0000,
            Self::B => 0x4_0000,
        }
    }

    /// Sectors of flash, and how many bytes each has.
    #[must_use]
    pub const fn sectors(self) -> [(u8, u32); 2] {
        match self {
            Self::A => [(4, 0x1_0000), (5, 0x2_0000)],
            Self::B => [(6, 0x2_0000), (7, 0x2_0000)],
        }
    }

    /// Addresses.
    #[must_use]
    pub const fn range(self) -> Range<u32> {
        self.address()..self.address() + self.length()
    }

    /// Bytes of the longest image, a multiple of four.
    #[must_use]
    pub const fn longest_image(self) -> u32 {
        self.length() - TAIL_LENGTH
    }

    /// First address of what is known about the slot.
    #[must_use]
    pub const fn tail(self) -> u32 {
        self.address() + self.longest_image()
    }

    /// The other one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }

    /// The slot that an address is in, for instance that of the vectors in use.
    #[must_use]
    pub fn containing(address: u32) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|slot| slot.range().contains(&address))
    }

    /// Whether an image of this length can be in the slot.
    #[must_use]
    pub const fn holds(self, length: u32) -> bool {
        SHORTEST_IMAGE <= length && length <= self.longest_image() && length.is_multiple_of(4)
    }

    /// Whether the first two words of the slot can be those of an image: a stack in RAM and an
    /// entry, in Thumb state, in the slot.
    #[must_use]
    pub fn has_vectors(self, stack: u32, entry: u32) -> bool {
        let is_stack = RAM.contains(&stack) && stack.is_multiple_of(8);
        is_stack && entry & 1 == 1 && (self.address()..self.tail()).contains(&entry)
    }
}
