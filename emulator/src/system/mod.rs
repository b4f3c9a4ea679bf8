//! The system peripherals: address map, clocks, power, flash, pins, external interrupts, watchdog,
//! DMA, serial port.

pub mod adc;
pub(crate) mod dma;
pub mod exti;
pub mod flash;
pub mod gpio;
pub mod iwdg;
pub mod map;
pub mod pins;
pub mod pwr;
pub mod rcc;
pub(crate) mod usart;
