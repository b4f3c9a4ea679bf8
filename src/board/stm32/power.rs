//! Clock and supply of the chip: what has to be there before anything starts, and what happens when
//! it goes.
//!
//! HSE is what feeds the clocks: on the reference board the debugger's microcontroller, elsewhere a
//! crystal. It may come late or never, so [`wait`] runs on the internal oscillator with safe
//! outputs and the watchdog running, shows a code on the LED while HSE or supply are missing, and
//! tries again and again. Without HSE there is no CAN: the internal oscillator is off by up to 1 %
//! (DS10693 rev 10, table 41), and the bus stands 0.5 %.
//!
//! When HSE stops later, the clock security system (RM0390 6.2.7) takes the outputs of TIM1 and
//! TIM8 away through their break, which needs no program, and the NMI leaves a record
//! (`safe_state`). When the supply of the chip sinks below 3.0 V the voltage detector's interrupt
//! does the same; below 2.8 V the brown-out reset holds the chip, which is not made for 180 MHz
//! below 2.7 V. What else differs between families is in `supply`.

use cortex_m::peripheral::SYST;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac;

use super::iwdg;
use crate::board::WIRING;
use crate::board::family::supply::{self, CYCLES_PER_MS, PVD, detect, is_low};

/// Time of waiting for HSE after which the LED shows it.
const PATIENCE_MS: u32 = 200;

/// The code on the LED: four flashes of 0.2 s, 1 s off.
const FLASHES: u32 = 4;
const FLASH_MS: u32 = 200;
const CODE_MS: u32 = 2 * FLASH_MS * FLASHES + 800;

/// Line of the voltage detector (RM0390 10.2.5).
const DETECTOR_LINE: usize = 16;
/// Waits for HSE and for the supply, feeding the watchdog. Returns how long that took, ms. To be
/// called before the HAL is initialised, which waits for HSE without a time limit; the ports are
/// clocked and the LED's pin is an output.
pub fn wait() -> u32 {
    supply::clock();
    detect();
    start_hse();
    let mut ms: u32 = 0;
    while !pac::RCC.cr().read().hserdy() || is_low() {
        millisecond();
        iwdg::feed();
        ms += 1;
        if let Some(late) = ms.checked_sub(PATIENCE_MS) {
            let at = late % CODE_MS;
            if at == 0 {
                pac::RCC.cr().modify(|w| w.set_hseon(false));
                start_hse();
            }
            let flash = at / FLASH_MS;
            light(flash.is_multiple_of(2) && flash / 2 < FLASHES);
        }
    }
    light(false);
    ms
}

/// Waits for a millisecond by the core's own timer, and leaves it stopped.
#[expect(unsafe_code, reason = "the core's timer, by its address")]
fn millisecond() {
    const ENABLE_FROM_CORE: u32 = 0b101;
    const COUNTFLAG: u32 = 1 << 16;
    // SAFETY: nothing else runs yet; `can::away`, which uses this timer later, sets it up anew.
    let timer = unsafe { &*SYST::PTR };
    // SAFETY: no interrupt is enabled; any reload value is valid.
    unsafe {
        timer.rvr.write(CYCLES_PER_MS - 1);
        timer.cvr.write(0);
        timer.csr.write(ENABLE_FROM_CORE);
    }
    while timer.csr.read() & COUNTFLAG == 0 {}
    // SAFETY: as above.
    unsafe { timer.csr.write(0) };
}

fn start_hse() {
    pac::RCC
        .cr()
        .modify(|w| w.set_hsebyp(WIRING.clocks.hse_is_clock));
    pac::RCC.cr().modify(|w| w.set_hseon(true));
}

fn light(on: bool) {
    WIRING.led.set(on);
}

/// From now on clock and supply are monitored. To be called after the HAL is initialised, which
/// resets PWR.
#[expect(
    unsafe_code,
    reason = "enabling an interrupt can break a critical section"
)]
pub fn watch() {
    pac::RCC.cr().modify(|w| w.set_csson(true));
    detect();
    pac::EXTI
        .rtsr(0)
        .modify(|w| w.set_line(DETECTOR_LINE, true));
    pac::EXTI.imr(0).modify(|w| w.set_line(DETECTOR_LINE, true));
    PVD.set_priority(Priority::P0);
    // SAFETY: the handler never returns, so what it interrupts does not matter.
    unsafe { PVD.enable() };
    if is_low() {
        PVD.pend();
    }
}
