//! The supply of an STM32G4: its voltage detector (RM0440 rev 4, 6.2.2).
//!
//! # Limits
//!
//! The brown-out level, in the option bytes, is neither read nor programmed.

use embassy_stm32::pac;

pub use embassy_stm32::interrupt::PVD_PVM as PVD;

/// Core cycles of a millisecond on the internal oscillator, which runs after reset.
pub const CYCLES_PER_MS: u32 = 16_000;

/// Its highest threshold, PLS: about 2.9 V, as a header for this field has it; the data sheet's
/// table was not at hand. 7 compares a pin with the reference.
const DETECTOR_LEVEL: u8 = 6;

/// Gives the detector its clock.
pub fn clock() {
    let _ = vectors::Irqs;
    pac::RCC.apb1enr1().modify(|w| w.set_pwren(true));
}

/// Switches the voltage detector on.
pub fn detect() {
    pac::PWR.cr2().modify(|w| {
        w.set_pls(DETECTOR_LEVEL);
        w.set_pvde(true);
    });
}

/// Whether the supply is below the threshold.
pub fn is_low() -> bool {
    pac::PWR.sr2().read().pvdo()
}

/// The vector, which has the name of the interrupt.
mod vectors {
    use embassy_stm32::bind_interrupts;

    use crate::board::stm32::safe_state::SupplyHandler;

    bind_interrupts!(pub struct Irqs {
        PVD_PVM => SupplyHandler;
    });
}
