//! STM32F407IG (RM0090 rev 19, data sheet DS8626 rev 9): the chip of the RoboMaster Development
//! Board C.
//!
//! It differs from the STM32F446 in what this file says: 1 MiB of flash, 168 MHz without
//! over-drive, ports up to I, and no PLLSAI.
//!
//! Beside what no chip has (the table of the [crate]):
//!
//! | not modelled | RM0090 |
//! |---|---|
//! | 64 KiB of core-coupled RAM at 0x1000_0000: an access is a bus fault | 2.3.1 |
//! | Ethernet, FSMC, RNG, the second half of I2S2 and I2S3 | 33, 36, 24, 28 |
//! | reset of ADC2 and ADC3 by ADCRST | 7.3.9 |

use rsemu::cpu::arm::v7m::Config;

use super::{Chip, Clocks, F4_DETECTOR, Power, Sector, SystemMemory, sectors};
use crate::family::Family;
use crate::system::gpio::Port;
use crate::system::map::{self, Entry, Gate, Unit, entry};
use crate::system::pins;

const SECTORS: [Sector; 12] = sectors();

/// Table 1.
const PERIPHERALS: &[Entry] = &[
    entry(0x4000_3400, "I2S2ext", Gate::Apb1(14), Unit::Other),
    entry(0x4000_4000, "I2S3ext", Gate::Apb1(15), Unit::Other),
    entry(0x4002_2000, "GPIOI", Gate::Ahb1(8), Unit::Gpio(Port::I)),
    entry(0x4002_8000, "ETH", Gate::Ahb1(25), Unit::Other),
    entry(0x5006_0800, "RNG", Gate::Ahb2(6), Unit::Other),
    entry(0xA000_0000, "FSMC", Gate::Ahb3(0), Unit::Other),
];

/// See the [module](self).
pub static F407: Chip = Chip {
    name: "STM32F407IG",
    family: Family::F4,
    manual: "RM0090",
    // Revision Y (38.6.1).
    id_code: 0x100F_0413,
    sectors: &SECTORS,
    // DS8626 table 41.
    mass_erase_ms: [16_000, 11_000, 8_000],
    ram: 128 << 10,
    system_memory: SystemMemory::F4,
    peripherals: [map::STM32F4, PERIPHERALS],
    pins: pins::F407,
    clocks: Clocks {
        family: Family::F4,
        hsi_hz: 16_000_000,
        apb1_hz: 42_000_000,
        apb2_hz: 84_000_000,
        cr: 0x050D_00F9,
        pllcfgr: 0x0F43_7FFF,
        last: 0x84,
        reset: &[
            (0x30, 0x0010_0000),
            (0x50, 0x7E67_91FF),
            (0x54, 0x0000_00F1),
            (0x58, 0x0000_0001),
            (0x60, 0x36FE_C9FF),
            (0x64, 0x0007_5F33),
            (0x84, 0x2000_3000),
        ],
    },
    // 5.4.1: VOS is bit 14 alone; scale 2 up to 144 MHz, scale 1, the reset value, up to 168 MHz.
    power: Power {
        reset: 0x4000,
        writable: 0x43F3,
        over_drive: false,
        max_hclk: [[144_000_000; 2], [168_000_000; 2], [0; 2], [0; 2]],
        detector: F4_DETECTOR,
    },
    core: Config::CORTEX_M4F,
};
