//! STM32F446RE (RM0390 rev 6, data sheet DS10693 rev 10): the chip of the reference board.
//!
//! Beside what no chip has (the table of the [crate]):
//!
//! | not modelled | RM0390 |
//! |---|---|
//! | CEC, FMPI2C1, SPDIFRX, SAI1, SAI2, SPI4, FMC, QUADSPI | 31, 24, 27, 28, 26, 11, 12 |
//! | PLLSAI and the clocks it feeds: it locks, and its registers keep what is written | 6.3.23 |

use rsemu::cpu::arm::v7m::Config;

use super::{Chip, Clocks, F4_DETECTOR, Power, Sector, SystemMemory, sectors};
use crate::family::Family;
use crate::system::map::{self, Entry, Gate, Unit, entry};
use crate::system::pins;

const SECTORS: [Sector; 8] = sectors();

/// Table 1.
const PERIPHERALS: &[Entry] = &[
    entry(0x4000_4000, "SPDIFRX", Gate::Apb1(16), Unit::Other),
    entry(0x4000_6000, "FMPI2C1", Gate::Apb1(24), Unit::Other),
    entry(0x4000_6C00, "CEC", Gate::Apb1(27), Unit::Other),
    entry(0x4001_3400, "SPI4", Gate::Apb2(13), Unit::Other),
    entry(0x4001_5800, "SAI1", Gate::Apb2(22), Unit::Other),
    entry(0x4001_5C00, "SAI2", Gate::Apb2(23), Unit::Other),
    entry(0xA000_0000, "FMC", Gate::Ahb3(0), Unit::Other),
    entry(0xA000_1000, "QUADSPI", Gate::Ahb3(1), Unit::Other),
];

/// See the [module](self).
pub static F446: Chip = Chip {
    name: "STM32F446RE",
    family: Family::F4,
    manual: "RM0390",
    // Revision A (33.6.1).
    id_code: 0x1000_0421,
    sectors: &SECTORS,
    // DS10693 table 49.
    mass_erase_ms: [8_000, 5_500, 4_000],
    ram: 128 << 10,
    system_memory: SystemMemory::F4,
    peripherals: [map::STM32F4, PERIPHERALS],
    pins: pins::F446,
    clocks: Clocks {
        family: Family::F4,
        hsi_hz: 16_000_000,
        apb1_hz: 45_000_000,
        apb2_hz: 90_000_000,
        cr: 0x150D_00F9,
        pllcfgr: 0x7F43_7FFF,
        last: 0x94,
        reset: &[
            (0x30, 0x0010_0000),
            (0x50, 0x7E67_91FF),
            (0x54, 0x0000_00F1),
            (0x58, 0x0000_0003),
            (0x60, 0x3FFF_CFFF),
            (0x64, 0x00C7_7F33),
            (0x84, 0x2400_3010),
            (0x88, 0x2400_3010),
        ],
    },
    // 5.1.4, table 17.
    power: Power {
        reset: 0xC000,
        writable: 0x003F_FFF3,
        over_drive: true,
        max_hclk: [
            [120_000_000; 2],
            [120_000_000; 2],
            [144_000_000, 168_000_000],
            [168_000_000, 180_000_000],
        ],
        detector: F4_DETECTOR,
    },
    core: Config::CORTEX_M4F,
};
