//! The supply of an STM32F1: its voltage detector (RM0008 rev 21, 5.2). Below it there is the
//! power-on reset, at 1.80 to 1.96 V, and no brown-out reset (DS5792 table 12).

use embassy_stm32::pac;

pub use embassy_stm32::interrupt::PVD;

/// Core cycles of a millisecond on the internal oscillator, which runs after reset.
pub const CYCLES_PER_MS: u32 = 8_000;

/// Threshold of the voltage detector, PLS: 2.66 to 2.90 V falling (DS5792 table 12), its highest.
const DETECTOR_LEVEL: u8 = 7;

/// Gives the detector its clock.
pub fn clock() {
    let _ = vectors::Irqs;
    pac::RCC.apb1enr().modify(|w| w.set_pwren(true));
}

/// Switches the voltage detector on.
pub fn detect() {
    pac::PWR.cr().modify(|w| {
        w.set_pls(DETECTOR_LEVEL);
        w.set_pvde(true);
    });
}

/// Whether the supply is below the threshold.
pub fn is_low() -> bool {
    pac::PWR.csr().read().pvdo()
}

/// There is no brown-out reset.
pub fn brown_out_level() -> u8 {
    0
}

/// There is none.
pub fn program_brown_out() {}

/// The vector, which has the name of the interrupt.
mod vectors {
    use embassy_stm32::bind_interrupts;

    use crate::board::stm32::safe_state::SupplyHandler;

    bind_interrupts!(pub struct Irqs {
        PVD => SupplyHandler;
    });
}
