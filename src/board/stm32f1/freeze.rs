//! Stops the watchdog and all used timers while a debugger halts the core of a bench image (RM0008
//! rev 21, 31.16.3). In an image that drives they keep running, because motors would run away if
//! the core stopped while the PWM continued.

use embassy_stm32::pac;

/// From now on watchdog and timers stop while the core is halted.
pub fn in_debug_halt() {
    pac::DBGMCU.cr().modify(|w| {
        w.set_iwdg(true);
        w.set_tim1(true);
        w.set_tim2(true);
        w.set_tim3(true);
        w.set_tim4(true);
        w.set_tim5(true);
        w.set_tim6(true);
        w.set_tim7(true);
        w.set_tim8(true);
    });
}
