//! The chips that are emulated. A chip is a value: what differs between two microcontrollers of the
//! family is in a [`Chip`], and the peripherals read it from there.
//!
//! An image says which chip it is linked for: its memory layout defines the symbol `_chip_id` with
//! the device number of that chip (DBGMCU_IDCODE, DEV_ID). An image without the symbol is for
//! [`F446`].
//!
//! # Another chip
//!
//! One of a family that is here needs a file beside [`F446`]'s, a line in [`ALL`], and the rows of
//! its pins and peripherals. Another [`Family`] has other registers for the same peripherals: they
//! are a second view of one state, in a file `f1.rs` below the peripheral's own.

mod f103;
mod f407;
mod f446;

pub use f103::F103;
pub use f407::F407;
pub use f446::F446;

use rsemu::cpu::arm::v7m::Config;

use crate::family::Family;
use crate::system::map::{Entry, Gate, Unit};
use crate::system::pins::Pins;

/// All chips.
pub static ALL: [&Chip; 3] = [&F446, &F407, &F103];

/// Bytes of the largest flash of all chips.
pub(crate) const LARGEST_FLASH: u64 = 1024 * 1024;

/// A sector: first byte, counted from the start of the flash, and length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Sector {
    pub start: u64,
    pub length: u64,
}

/// One microcontroller.
pub struct Chip {
    /// Part number.
    pub name: &'static str,
    /// Its family.
    pub family: Family,
    /// The reference manual that its values are from.
    pub manual: &'static str,
    /// DBGMCU_IDCODE: device and revision.
    pub id_code: u32,
    /// Sectors of the flash, in order.
    pub sectors: &'static [Sector],
    /// Time to erase all of it at parallelism x8, x16 and x32, ms.
    pub mass_erase_ms: [u64; 3],
    /// Bytes of RAM in one piece from 0x2000_0000 on.
    pub ram: u32,
    /// What ST has programmed.
    pub(crate) system_memory: SystemMemory,
    /// Tables of the peripherals, each sorted by address.
    pub(crate) peripherals: [&'static [Entry]; 2],
    /// Which pin carries what.
    pub(crate) pins: Pins,
    /// Clock control.
    pub(crate) clocks: Clocks,
    /// Power control.
    pub(crate) power: Power,
    /// The processor.
    pub(crate) core: Config,
}

/// System memory: where it is, and the places in it that a program reads.
pub(crate) struct SystemMemory {
    pub(crate) base: u32,
    pub(crate) length: usize,
    /// Unique number, size of the flash in KiB, and where the chip has it VREFIN_CAL.
    pub(crate) uid: usize,
    pub(crate) flash_kib: usize,
    pub(crate) vrefin_cal: Option<usize>,
}

impl SystemMemory {
    /// That of an STM32F4 (RM0390 sections 2.3 and 34; RM0090 sections 2.4 and 39).
    pub(crate) const F4: Self = Self {
        base: 0x1FFF_0000,
        length: 0x8000,
        uid: 0x7A10,
        flash_kib: 0x7A22,
        vrefin_cal: Some(0x7A2A),
    };
}

/// What differs in RCC.
pub(crate) struct Clocks {
    pub(crate) family: Family,
    /// The internal oscillator, which runs after a reset, Hz.
    pub(crate) hsi_hz: u64,
    /// Largest frequencies of APB1 and APB2, Hz.
    pub(crate) apb1_hz: u64,
    pub(crate) apb2_hz: u64,
    /// Bits of CR that can be written, and those of PLLCFGR.
    pub(crate) cr: u32,
    pub(crate) pllcfgr: u32,
    /// Offset of the last register.
    pub(crate) last: u32,
    /// Reset values of the registers in banks, by their offsets.
    pub(crate) reset: &'static [(usize, u32)],
}

/// What differs in PWR.
pub(crate) struct Power {
    /// Reset value of CR, and its bits that can be written.
    pub(crate) reset: u32,
    pub(crate) writable: u32,
    /// Whether there is over-drive.
    pub(crate) over_drive: bool,
    /// Highest core clock, Hz, by the field VOS, without and with over-drive.
    pub(crate) max_hclk: [[u64; 2]; 4],
    /// Thresholds of the voltage detector by PLS for a falling and a rising VDD, typical, mV.
    pub(crate) detector: [(f64, f64); 8],
}

impl Chip {
    /// Bytes of flash.
    #[must_use]
    pub fn flash_size(&self) -> u64 {
        self.sectors.iter().map(|sector| sector.length).sum()
    }

    /// Bits of [`Self::id_code`] that say the device: DEV_ID.
    #[must_use]
    pub fn device(&self) -> u32 {
        self.id_code & 0xFFF
    }

    /// The chip with this device number.
    #[must_use]
    pub fn with_device(device: u32) -> Option<&'static Self> {
        ALL.into_iter().find(|chip| chip.device() == device)
    }

    /// The peripheral at an address, if there is one.
    pub(crate) fn peripheral(&self, address: u32) -> Option<&'static Entry> {
        let mut tables = self.peripherals.into_iter();
        tables.find_map(|table| crate::system::map::find(table, address))
    }

    /// All peripherals.
    pub(crate) fn all_peripherals(&self) -> impl Iterator<Item = &'static Entry> {
        self.peripherals.into_iter().flatten()
    }

    /// What gates the clock of a unit.
    pub(crate) fn gate(&self, unit: Unit) -> Gate {
        let found = self.all_peripherals().find(|entry| entry.unit == unit);
        found.map_or(Gate::None, |entry| entry.gate)
    }
}

impl std::fmt::Debug for Chip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

/// Thresholds of the STM32F4's voltage detector (DS10693 rev 10, table 24), for all of them.
const F4_DETECTOR: [(f64, f64); 8] = [
    (2040.0, 2140.0),
    (2190.0, 2300.0),
    (2350.0, 2450.0),
    (2510.0, 2600.0),
    (2660.0, 2760.0),
    (2820.0, 2930.0),
    (2930.0, 3030.0),
    (3030.0, 3140.0),
];

/// Sectors of an STM32F4: four of 16 KiB, one of 64 KiB, and all others of 128 KiB.
const fn sectors<const N: usize>() -> [Sector; N] {
    let mut all = [Sector {
        start: 0,
        length: 0,
    }; N];
    let (mut number, mut start) = (0, 0);
    while number < N {
        let length = match number {
            0..=3 => 0x4000,
            4 => 0x1_0000,
            _ => 0x2_0000,
        };
        all[number] = Sector { start, length };
        start += length;
        number += 1;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_sorted_and_no_chip_has_two_peripherals_at_one_address() {
        for chip in ALL {
            for table in chip.peripherals {
                assert!(table.windows(2).all(|pair| pair[0].base < pair[1].base));
            }
            let mut bases: Vec<_> = chip.all_peripherals().map(|entry| entry.base).collect();
            let all = bases.len();
            bases.sort_unstable();
            bases.dedup();
            assert_eq!(bases.len(), all, "{chip:?}");
        }
    }

    /// RM0390 table 5; RM0090 table 5.
    #[test]
    fn sectors_and_sizes_are_those_of_the_manuals() {
        assert_eq!((F446.flash_size(), F446.sectors.len()), (512 << 10, 8));
        assert_eq!((F407.flash_size(), F407.sectors.len()), (1024 << 10, 12));
        assert_eq!((F103.flash_size(), F103.sectors.len()), (256 << 10, 128));
        let starts = [4, 5, 6, 11].map(|number: usize| F407.sectors[number].start);
        assert_eq!(starts, [0x1_0000, 0x2_0000, 0x4_0000, 0xE_0000]);
        assert!(ALL.iter().all(|chip| chip.flash_size() <= LARGEST_FLASH));
    }

    #[test]
    fn a_chip_is_found_by_its_number_and_has_only_its_own_peripherals() {
        assert_eq!(
            Chip::with_device(0x421).map(|chip| chip.name),
            Some(F446.name)
        );
        assert_eq!(
            Chip::with_device(0x413).map(|chip| chip.name),
            Some(F407.name)
        );
        assert_eq!(
            Chip::with_device(0x414).map(|chip| chip.name),
            Some(F103.name)
        );
        assert!(Chip::with_device(0).is_none());
        let name = |chip: &Chip, at| chip.peripheral(at).map(|entry| entry.name);
        assert_eq!(name(&F446, 0x4000_6400), Some("CAN1"));
        assert_eq!(name(&F446, 0x4002_3BFF), Some("RCC"));
        assert_eq!(name(&F446, 0x5003_FFFF), Some("USB OTG FS"));
        assert_eq!(name(&F407, 0x4001_2200), Some("ADC3"));
        assert_eq!(name(&F407, 0x4002_2000), Some("GPIOI"));
        assert_eq!(name(&F446, 0x4002_2000), None);
        assert_eq!(name(&F446, 0x4000_6C00), Some("CEC"));
        assert_eq!(name(&F407, 0x4000_6C00), None);
        assert_eq!(name(&F446, 0x4000_2400), None);
        assert_eq!(name(&F446, 0x3FFF_FFFF), None);
    }
}
