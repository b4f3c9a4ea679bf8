//! The names of CAN1 on an STM32F4.

use embassy_stm32::pac;
use embassy_stm32::pac::can::Can;

pub use embassy_stm32::interrupt::{CAN1_RX0, CAN1_RX1, CAN1_SCE, CAN1_TX, typelevel};

/// The controller.
pub const CAN: Can = pac::CAN1;

/// Gives it its clock.
pub fn clock() {
    let _ = vectors::Irqs;
    pac::RCC.apb1enr().modify(|w| w.set_can1en(true));
}

/// The vectors, which have the names of the interrupts.
mod vectors {
    use embassy_stm32::bind_interrupts;

    use crate::board::stm32::can::interrupts::{ErrorHandler, LaterHandler, RxHandler, TxHandler};

    bind_interrupts!(pub struct Irqs {
        CAN1_RX0 => RxHandler;
        CAN1_RX1 => LaterHandler;
        CAN1_TX => TxHandler;
        CAN1_SCE => ErrorHandler;
    });
}
