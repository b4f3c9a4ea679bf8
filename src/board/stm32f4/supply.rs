//! The supply of an STM32F4: its voltage detector and its brown-out reset (RM0390 rev 6, 5.2 and
//! 3.6). The brown-out level is in the option bytes, off in a fresh chip, and is programmed once.

use embassy_stm32::pac;

pub use embassy_stm32::interrupt::PVD;

use crate::board::stm32::iwdg;

/// Core cycles of a millisecond on the internal oscillator, which runs after reset.
pub const CYCLES_PER_MS: u32 = 16_000;

/// Its threshold, PLS: 2.95 to 3.09 V falling (DS10693 rev 10, table 24). The board's regulator
/// gives 3.23 V at least, and the brown-out reset comes at 2.88 V at most.
const DETECTOR_LEVEL: u8 = 7;

/// BOR_LEV (RM0390 3.6.1): 0 is level 3, 2.75 to 2.88 V falling; 3 is off.
const BROWN_OUT_LEVEL_3: u8 = 0;
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// Gives the detector its clock.
pub fn clock() {
    let _ = vectors::Irqs;
    pac::RCC.apb1enr().modify(|w| w.set_pwren(true));
}

/// Switches the voltage detector on.
pub fn detect() {
    pac::PWR.cr1().modify(|w| {
        w.set_pls(DETECTOR_LEVEL);
        w.set_pvde(true);
    });
}

/// Whether the supply is below the threshold.
pub fn is_low() -> bool {
    pac::PWR.csr1().read().pvdo()
}

/// Level of the brown-out reset as the option bytes have it: 3 is the highest, 0 is off.
pub fn brown_out_level() -> u8 {
    3 - pac::FLASH.optcr().read().bor_lev()
}

/// Programs the brown-out reset to its highest level where it is not. With the outputs off, the
/// supply at its nominal value and the watchdog at its longer time; takes as long as the erase of a
/// sector, once in the chip's life.
pub fn program_brown_out() {
    let flash = pac::FLASH;
    if brown_out_level() == 3 - BROWN_OUT_LEVEL_3 || is_low() {
        return;
    }
    defmt::warn!(
        "brown-out reset: level {=u8}, programming level 3",
        brown_out_level()
    );
    // No interrupt counts the timer's overflows meanwhile, as in an erase (`flash`).
    pac::TIM9.cr1().modify(|w| w.set_cen(false));
    let done = iwdg::patiently(|| {
        // RM0390 3.6.2.
        for key in OPTION_KEYS {
            flash.optkeyr().write_value(key);
        }
        while flash.sr().read().bsy() {}
        flash.optcr().modify(|w| w.set_bor_lev(BROWN_OUT_LEVEL_3));
        flash.optcr().modify(|w| w.set_optstrt(true));
        while flash.sr().read().bsy() {}
        flash.optcr().modify(|w| w.set_optlock(true));
    });
    pac::TIM9.cr1().modify(|w| w.set_cen(true));
    if done.is_err() || brown_out_level() != 3 {
        defmt::error!("brown-out reset: cannot be programmed");
    }
}

/// The vector, which has the name of the interrupt.
mod vectors {
    use embassy_stm32::bind_interrupts;

    use crate::board::stm32::safe_state::SupplyHandler;

    bind_interrupts!(pub struct Irqs {
        PVD => SupplyHandler;
    });
}
