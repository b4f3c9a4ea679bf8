//! The names of the CAN controller on an STM32F1, which shares vectors with USB; that is off.

use embassy_stm32::pac;
use embassy_stm32::pac::can::Can;

pub use embassy_stm32::interrupt::{
    CAN1_RX1, CAN1_SCE, USB_HP_CAN1_TX as CAN1_TX, USB_LP_CAN1_RX0 as CAN1_RX0,
};

/// The vectors as types.
pub mod typelevel {
    pub use embassy_stm32::interrupt::typelevel::{
        CAN1_RX1, CAN1_SCE, USB_HP_CAN1_TX as CAN1_TX, USB_LP_CAN1_RX0 as CAN1_RX0,
    };
}

/// The controller.
pub const CAN: Can = pac::CAN;

/// Gives it its clock.
pub fn clock() {
    let _ = vectors::Irqs;
    pac::RCC.apb1enr().modify(|w| w.set_canen(true));
}

/// The vectors, which have the names of the interrupts.
mod vectors {
    use embassy_stm32::bind_interrupts;

    use crate::board::stm32::can::interrupts::{ErrorHandler, LaterHandler, RxHandler, TxHandler};

    bind_interrupts!(pub struct Irqs {
        USB_LP_CAN1_RX0 => RxHandler;
        CAN1_RX1 => LaterHandler;
        USB_HP_CAN1_TX => TxHandler;
        CAN1_SCE => ErrorHandler;
    });
}
