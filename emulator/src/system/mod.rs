//! The system peripherals: address map, clocks, power, flash, pins, external interrupts, watchdog,
//! DMA, serial port, CRC unit.

pub mod adc;
pub mod afio;
pub mod crc;
pub(crate) mod dma;
pub mod exti;
pub mod flash;
pub mod gpio;
pub mod iwdg;
pub mod map;
pub mod pins;
pub mod pwr;
pub mod rcc;
pub(crate) mod spi;
pub(crate) mod usart;
