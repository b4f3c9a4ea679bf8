//! What stands still while a debugger halts the core of a bench image (RM0390 33.16.4 and 33.16.5):
//! the watchdog and all timers that are used. In an image that drives they go on, because a halted
//! core with running PWM is a run-away.

use embassy_stm32::pac;

/// From now on watchdog and timers stand while the core is halted.
pub fn in_debug_halt() {
    pac::DBGMCU.apb1fzr().modify(|w| {
        w.set_iwdg(true);
        w.set_tim2(true);
        w.set_tim3(true);
        w.set_tim4(true);
        w.set_tim5(true);
        w.set_tim7(true);
    });
    pac::DBGMCU.apb2fzr().modify(|w| {
        w.set_tim1(true);
        w.set_tim8(true);
        w.set_tim9(true);
    });
}
