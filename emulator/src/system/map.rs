//! The addresses of the peripherals that all chips have (RM0390 rev 6, section 2.2.2, table 1;
//! RM0090 rev 19, table 1) and their clock enable bits (RM0390 sections 6.3.10 to 6.3.14). Those of
//! one chip alone are with that chip ([`crate::chip`]).
//!
//! The table also contains peripherals that are not modelled, so that a stop can name the one that
//! was accessed.

use crate::system::gpio::Port;

/// A register of RCC that gates clocks, with the matching reset register 0x20 below it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gate {
    /// Always clocked.
    None,
    /// AHB1ENR, bit.
    Ahb1(u32),
    /// AHB2ENR, bit.
    Ahb2(u32),
    /// AHB3ENR, bit.
    Ahb3(u32),
    /// APB1ENR, bit.
    Apb1(u32),
    /// APB2ENR, bit.
    Apb2(u32),
    /// APB2ENR, any of these bits.
    AnyOfApb2(u32),
}

/// What answers at an address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// TIM1..TIM14.
    Timer(usize),
    /// A GPIO port.
    Gpio(Port),
    /// CAN1.
    Can1,
    /// CAN2.
    Can2,
    /// RCC.
    Rcc,
    /// PWR.
    Pwr,
    /// The flash interface.
    Flash,
    /// EXTI.
    Exti,
    /// SYSCFG.
    Syscfg,
    /// AFIO.
    Afio,
    /// IWDG.
    Iwdg,
    /// ADC1 to ADC3.
    Adc(usize),
    /// What the three share.
    AdcCommon,
    /// USART2.
    Usart2,
    /// SPI1.
    Spi1,
    /// DMA1.
    Dma1,
    /// The CRC unit.
    Crc,
    /// Not modelled.
    Other,
}

/// One peripheral's place.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// First address.
    pub base: u32,
    /// Name as in the reference manual.
    pub name: &'static str,
    /// What gates its clock.
    pub gate: Gate,
    /// What answers.
    pub unit: Unit,
}

/// One row of a table.
pub(crate) const fn entry(base: u32, name: &'static str, gate: Gate, unit: Unit) -> Entry {
    Entry {
        base,
        name,
        gate,
        unit,
    }
}

use Gate::{Ahb1, Ahb2, AnyOfApb2, Apb1, Apb2, None as Always};
use Unit::{
    Adc, AdcCommon, Can1, Can2, Crc, Dma1, Exti, Flash, Gpio, Iwdg, Other, Pwr, Rcc, Spi1, Syscfg,
    Timer, Usart2,
};

/// The peripherals outside the core that all chips have, by address. Each reaches up to the next,
/// and at most [`LARGEST`] bytes.
pub const STM32F4: &[Entry] = &[
    entry(0x4000_0000, "TIM2", Apb1(0), Timer(2)),
    entry(0x4000_0400, "TIM3", Apb1(1), Timer(3)),
    entry(0x4000_0800, "TIM4", Apb1(2), Timer(4)),
    entry(0x4000_0C00, "TIM5", Apb1(3), Timer(5)),
    entry(0x4000_1000, "TIM6", Apb1(4), Timer(6)),
    entry(0x4000_1400, "TIM7", Apb1(5), Timer(7)),
    entry(0x4000_1800, "TIM12", Apb1(6), Timer(12)),
    entry(0x4000_1C00, "TIM13", Apb1(7), Timer(13)),
    entry(0x4000_2000, "TIM14", Apb1(8), Timer(14)),
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
    entry(0x4000_5C00, "I2C3", Apb1(23), Other),
    entry(0x4000_6400, "CAN1", Apb1(25), Can1),
    entry(0x4000_6800, "CAN2", Apb1(26), Can2),
    entry(0x4000_7000, "PWR", Apb1(28), Pwr),
    entry(0x4000_7400, "DAC", Apb1(29), Other),
    entry(0x4001_0000, "TIM1", Apb2(0), Timer(1)),
    entry(0x4001_0400, "TIM8", Apb2(1), Timer(8)),
    entry(0x4001_1000, "USART1", Apb2(4), Other),
    entry(0x4001_1400, "USART6", Apb2(5), Other),
    entry(0x4001_2000, "ADC1", Apb2(8), Adc(1)),
    entry(0x4001_2100, "ADC2", Apb2(9), Adc(2)),
    entry(0x4001_2200, "ADC3", Apb2(10), Adc(3)),
    entry(0x4001_2300, "ADC", AnyOfApb2(7 << 8), AdcCommon),
    entry(0x4001_2C00, "SDIO", Apb2(11), Other),
    entry(0x4001_3000, "SPI1", Apb2(12), Spi1),
    entry(0x4001_3800, "SYSCFG", Apb2(14), Syscfg),
    entry(0x4001_3C00, "EXTI", Always, Exti),
    entry(0x4001_4000, "TIM9", Apb2(16), Timer(9)),
    entry(0x4001_4400, "TIM10", Apb2(17), Timer(10)),
    entry(0x4001_4800, "TIM11", Apb2(18), Timer(11)),
    entry(0x4002_0000, "GPIOA", Ahb1(0), Gpio(Port::A)),
    entry(0x4002_0400, "GPIOB", Ahb1(1), Gpio(Port::B)),
    entry(0x4002_0800, "GPIOC", Ahb1(2), Gpio(Port::C)),
    entry(0x4002_0C00, "GPIOD", Ahb1(3), Gpio(Port::D)),
    entry(0x4002_1000, "GPIOE", Ahb1(4), Gpio(Port::E)),
    entry(0x4002_1400, "GPIOF", Ahb1(5), Gpio(Port::F)),
    entry(0x4002_1800, "GPIOG", Ahb1(6), Gpio(Port::G)),
    entry(0x4002_1C00, "GPIOH", Ahb1(7), Gpio(Port::H)),
    entry(0x4002_3000, "CRC", Ahb1(12), Crc),
    entry(0x4002_3800, "RCC", Always, Rcc),
    entry(0x4002_3C00, "FLASH", Always, Flash),
    entry(0x4002_4000, "BKPSRAM", Ahb1(18), Other),
    entry(0x4002_6000, "DMA1", Ahb1(21), Dma1),
    entry(0x4002_6400, "DMA2", Ahb1(22), Other),
    entry(0x4004_0000, "USB OTG HS", Ahb1(29), Other),
    entry(0x5000_0000, "USB OTG FS", Ahb2(7), Other),
    entry(0x5005_0000, "DCMI", Ahb2(0), Other),
];

/// Size of the largest register block (USB OTG), in bytes.
pub const LARGEST: u32 = 0x4_0000;

/// The peripheral of a table at an address, if there is one.
#[must_use]
pub fn find(table: &'static [Entry], address: u32) -> Option<&'static Entry> {
    let next = table.partition_point(|entry| entry.base <= address);
    let entry = &table[next.checked_sub(1)?];
    let size = match entry.name {
        "USB OTG HS" | "USB OTG FS" => LARGEST,
        "ETH" => 0x1400,
        "BKPSRAM" | "FMC" | "FSMC" | "QUADSPI" => 0x1000,
        _ => 0x400,
    };
    (address - entry.base < size).then_some(entry)
}

/// Interrupt numbers (RM0390 rev 6, section 10.2, table 38; the same in RM0090, table 61).
pub mod irq {
    #![allow(missing_docs)]
    pub const PVD: u16 = 1;
    pub const FLASH: u16 = 4;
    pub const EXTI: [u16; 5] = [6, 7, 8, 9, 10];
    /// Streams 5 and 6.
    pub const DMA1_STREAM_5: u16 = 16;
    pub const DMA1_STREAM_6: u16 = 17;
    pub const CAN1_TX: u16 = 19;
    pub const CAN1_RX0: u16 = 20;
    pub const CAN1_RX1: u16 = 21;
    pub const CAN1_SCE: u16 = 22;
    pub const EXTI9_5: u16 = 23;
    pub const TIM1_BRK_TIM9: u16 = 24;
    pub const TIM1_UP_TIM10: u16 = 25;
    pub const TIM1_TRG_COM_TIM11: u16 = 26;
    pub const TIM1_CC: u16 = 27;
    pub const TIM2: u16 = 28;
    pub const TIM3: u16 = 29;
    pub const TIM4: u16 = 30;
    pub const USART2: u16 = 38;
    pub const EXTI15_10: u16 = 40;
    pub const TIM8_BRK_TIM12: u16 = 43;
    pub const TIM8_UP_TIM13: u16 = 44;
    pub const TIM8_TRG_COM_TIM14: u16 = 45;
    pub const TIM8_CC: u16 = 46;
    pub const TIM5: u16 = 50;
    pub const TIM6_DAC: u16 = 54;
    pub const TIM7: u16 = 55;
    pub const CAN2_TX: u16 = 63;
    pub const CAN2_RX0: u16 = 64;
    pub const CAN2_RX1: u16 = 65;
    pub const CAN2_SCE: u16 = 66;
}
