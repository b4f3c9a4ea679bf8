//! STM32F103RC (RM0008 rev 21; PM0075 rev 2 for the flash; data sheet DS5792 rev 13): the chip of
//! many kits for small robots. Its Cortex-M3 (PM0056 rev 6) has no floating-point unit and no DSP
//! instructions; such an instruction is a usage fault.
//!
//! It differs from an STM32F4 in its registers for GPIO, RCC and flash, and in these: 8 MHz after a
//! reset, 48 KiB of RAM, TIM2 and TIM5 with 16 bits, one CAN controller with 14 filter banks, no
//! brown-out reset, flash in pages that is read in lines of 64 bits without caches.
//!
//! # What is modelled
//!
//! | modelled | RM0008 | not modelled (an access stops the run unless noted) |
//! |---|---|---|
//! | RCC: HSI, HSE, PLL, dividers, gates, resets, causes, CSS | 7 | MCO and the USB divider (no effect) |
//! | PWR: voltage detector, access to the backup domain | 5 | stop and standby mode |
//! | flash: half-words, pages, mass erase, stall, prefetch | PM0075 | option bytes; half-cycle access (no effect) |
//! | GPIO A..G: CRL and CRH, set and reset | 9 | lock |
//! | AFIO: remaps of TIM1 to TIM4, CAN and USART2, SWJ_CFG, EXTI | 9.4 | other remaps (no effect), EVENTOUT, MAPR2 |
//! | TIM1 to TIM8 | 14, 15, 17 | as on the STM32F4 |
//! | ADC1, ADC2: one regular channel, injected ones, calibration | 11 | ADC3, dual mode, triggers, DMA |
//! | CAN, IWDG, EXTI, CRC | 24, 19, 10, 4 | as on the STM32F4 |
//! | USART2 without DMA | 27 | USART1, USART3, UART4, UART5 |
//! | DBGMCU | 31.16 | |
//! | | | DMA1, DMA2, RTC, BKP, WWDG, SPI, I2C, USB, DAC, SDIO |

use rsemu::cpu::arm::v7m::Config;

use super::{Chip, Clocks, Power, Sector, SystemMemory};
use crate::family::Family;
use crate::system::gpio::Port;
use crate::system::map::Gate::{Ahb1, Apb1, Apb2, None as Always};
use crate::system::map::Unit::{
    Adc, Afio, Can1, Crc, Exti, Flash, Gpio, Iwdg, Other, Pwr, Rcc, Timer, Usart2,
};
use crate::system::map::{Entry, entry};
use crate::system::pins;

/// PM0075 table 3: pages of 2 KiB.
const PAGES: [Sector; 128] = {
    let mut all = [Sector {
        start: 0,
        length: 0x800,
    }; 128];
    let mut number = 0;
    while number < all.len() {
        all[number].start = 0x800 * number as u64;
        number += 1;
    }
    all
};

/// Table 3. AHBENR is in the place of AHB1ENR.
const PERIPHERALS: &[Entry] = &[
    entry(0x4000_0000, "TIM2", Apb1(0), Timer(2)),
    entry(0x4000_0400, "TIM3", Apb1(1), Timer(3)),
    entry(0x4000_0800, "TIM4", Apb1(2), Timer(4)),
    entry(0x4000_0C00, "TIM5", Apb1(3), Timer(5)),
    entry(0x4000_1000, "TIM6", Apb1(4), Timer(6)),
    entry(0x4000_1400, "TIM7", Apb1(5), Timer(7)),
    entry(0x4000_2800, "RTC", Always, Other),
    entry(0x4000_2C00, "WWDG", Apb1(11), Other),
    entry(0x4000_3000, "IWDG", Always, Iwdg),
    entry(0x4000_3800, "SPI2", Apb1(14), Other),
    entry(0x4000_3C00, "SPI3", Apb1(15), Other),
    entry(0x4000_4400, "USART2", Apb1(17), Usart2),
    entry(0x4000_4800, "USART3", Apb1(18), Other),
    entry(0x4000_4C00, "UART4", Apb1(19), Other),
    entry(0x4000_5000, "UART5", Apb1(20), Other),
    entry(0x4000_5400, "I2C1", Apb1(21), Other),
    entry(0x4000_5800, "I2C2", Apb1(22), Other),
    entry(0x4000_5C00, "USB", Apb1(23), Other),
    entry(0x4000_6000, "USB SRAM", Apb1(23), Other),
    entry(0x4000_6400, "CAN", Apb1(25), Can1),
    entry(0x4000_6C00, "BKP", Apb1(27), Other),
    entry(0x4000_7000, "PWR", Apb1(28), Pwr),
    entry(0x4000_7400, "DAC", Apb1(29), Other),
    entry(0x4001_0000, "AFIO", Apb2(0), Afio),
    entry(0x4001_0400, "EXTI", Always, Exti),
    entry(0x4001_0800, "GPIOA", Apb2(2), Gpio(Port::A)),
    entry(0x4001_0C00, "GPIOB", Apb2(3), Gpio(Port::B)),
    entry(0x4001_1000, "GPIOC", Apb2(4), Gpio(Port::C)),
    entry(0x4001_1400, "GPIOD", Apb2(5), Gpio(Port::D)),
    entry(0x4001_1800, "GPIOE", Apb2(6), Gpio(Port::E)),
    entry(0x4001_1C00, "GPIOF", Apb2(7), Gpio(Port::F)),
    entry(0x4001_2000, "GPIOG", Apb2(8), Gpio(Port::G)),
    entry(0x4001_2400, "ADC1", Apb2(9), Adc(1)),
    entry(0x4001_2800, "ADC2", Apb2(10), Adc(2)),
    entry(0x4001_2C00, "TIM1", Apb2(11), Timer(1)),
    entry(0x4001_3000, "SPI1", Apb2(12), Other),
    entry(0x4001_3400, "TIM8", Apb2(13), Timer(8)),
    entry(0x4001_3800, "USART1", Apb2(14), Other),
    entry(0x4001_3C00, "ADC3", Apb2(15), Other),
    entry(0x4001_8000, "SDIO", Ahb1(10), Other),
    entry(0x4002_0000, "DMA1", Ahb1(0), Other),
    entry(0x4002_0400, "DMA2", Ahb1(1), Other),
    entry(0x4002_1000, "RCC", Always, Rcc),
    entry(0x4002_2000, "FLASH", Always, Flash),
    entry(0x4002_3000, "CRC", Ahb1(6), Crc),
];

/// See the [module](self).
pub static F103: Chip = Chip {
    name: "STM32F103RC",
    family: Family::F1,
    manual: "RM0008",
    // Revisions X and Y (31.6.1).
    id_code: 0x1003_6414,
    sectors: &PAGES,
    // DS5792 table 41.
    mass_erase_ms: [40; 3],
    ram: 48 << 10,
    // RM0008 30.1 and 30.2; behind system memory the option bytes.
    system_memory: SystemMemory {
        base: 0x1FFF_F000,
        length: 0x810,
        uid: 0x7E8,
        flash_kib: 0x7E0,
        vrefin_cal: None,
    },
    peripherals: [PERIPHERALS, &[]],
    pins: pins::F103,
    clocks: Clocks {
        family: Family::F1,
        hsi_hz: 8_000_000,
        apb1_hz: 36_000_000,
        apb2_hz: 72_000_000,
        cr: 0x010D_00F9,
        // It has none.
        pllcfgr: 0,
        last: 0x44,
        // AHBENR (7.3.6): SRAM and FLITF.
        reset: &[(0x30, 0x14)],
    },
    // 5.4.1: no voltage scale.
    power: Power {
        reset: 0,
        writable: 0x1F3,
        over_drive: false,
        max_hclk: [[72_000_000; 2]; 4],
        // DS5792 table 12.
        detector: [
            (2080.0, 2180.0),
            (2180.0, 2280.0),
            (2280.0, 2380.0),
            (2380.0, 2480.0),
            (2480.0, 2580.0),
            (2580.0, 2680.0),
            (2680.0, 2780.0),
            (2780.0, 2880.0),
        ],
    },
    core: Config::CORTEX_M3,
};
