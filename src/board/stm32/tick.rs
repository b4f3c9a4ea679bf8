//! When the control tick begins: TIM7, one shot at a time (RM0390 rev 6, section 20).
//!
//! Its vector is the control executor's too (`executors`): the interrupt that ends a wait continues
//! with the task that has waited. A timer of `embassy-time` would be another interrupt before that
//! one, and two walks through the executor's queue of timers: a thousand cycles in every
//! millisecond (docs/performance.md).
//!
//! The counter counts microseconds beside the one of the local time, from the same clock. Each wait
//! is measured from the local time as it is, so nothing adds up.
//!
//! What the control task shares with thread mode is behind a [`TickMutex`].

#![expect(unsafe_code, reason = "a mutex vouches for exclusion")]

use core::future::poll_fn;
use core::task::Poll;

use control::time::Micros;
use cortex_m::peripheral::{NVIC, SCB};
use cortex_m::register::primask;
use embassy_stm32::pac::timer::vals::Urs;
use embassy_stm32::{interrupt, pac};
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::board::{WIRING, now};

/// Clocks of the timers of APB1 in a microsecond.
const CLOCKS_PER_US: u16 = {
    let hz = WIRING.clocks.apb1_timers_hz();
    assert!(hz.is_multiple_of(1_000_000));
    (hz / 1_000_000) as u16
};

/// The timer of the control task.
pub struct TickTimer(());

impl TickTimer {
    /// Takes the timer; it does not run yet.
    pub fn new() -> Self {
        pac::RCC.apb1enr().modify(|w| w.set_tim7en(true));
        pac::TIM7.psc().write_value(CLOCKS_PER_US - 1);
        pac::TIM7.cr1().write(|w| w.set_urs(Urs::COUNTER_ONLY));
        pac::TIM7.dier().write(|w| w.set_uie(true));
        Self(())
    }

    /// Waits until `due`, not at all if that has been, and returns the time it is then.
    pub async fn until(&mut self, due: Micros) -> Micros {
        poll_fn(|context| {
            // Masked: an interrupt between the time and the start would delay the tick by as much.
            cortex_m::interrupt::free(|_| {
                let now = now();
                let left = due.since(now).0;
                if left == 0 {
                    return Poll::Ready(now);
                }
                // Ready at once, but not before the timer's interrupt: that is the executor's, and
                // it has no other task. So the interrupt does not have to wake a task. Nothing
                // counts yet, so what is taken back is this request alone.
                context.waker().wake_by_ref();
                NVIC::unpend(interrupt::TIM7);
                start(u16::try_from(left).unwrap_or(u16::MAX));
                Poll::Pending
            })
        })
        .await
    }
}

/// Counts so many microseconds from now, two at least: the counter does not run to 0.
fn start(us: u16) {
    let timer = pac::TIM7;
    timer.arr().write(|w| w.set_arr(us.max(2) - 1));
    // Counter and prescaler restart; with URS this does not count as the end of a wait.
    timer.egr().write(|w| w.set_ug(true));
    timer.cr1().write(|w| {
        w.set_urs(Urs::COUNTER_ONLY);
        w.set_opm(true);
        w.set_cen(true);
    });
}

/// For the interrupt handler, before it runs the executor: a wait is over.
pub fn over() {
    pac::TIM7.sr().write(|w| w.set_uif(false));
}

/// Excludes thread mode and the control task from each other. Thread mode masks interrupts while it
/// holds the mutex; the task, which runs in an interrupt, need not do anything, because thread mode
/// does not run beside it, and so does not hold up the stronger interrupts with their time stamps.
pub struct TickMutex(());

// SAFETY: `lock` runs `f` in thread mode with interrupts masked, or in TIM7's handler, which thread
// mode cannot interrupt and which cannot interrupt itself; anywhere else it panics. So no two
// calls overlap, except for one inside the other.
unsafe impl RawMutex for TickMutex {
    const INIT: Self = Self(());

    #[inline(always)]
    fn lock<R>(&self, f: impl FnOnce() -> R) -> R {
        /// RM0390 table 38: exceptions of the core come first.
        const TICK: u16 = 16 + interrupt::TIM7 as u16;
        // ARMv7-M ARM, B3.2.4: VECTACTIVE is bits 0 to 8, and 0 in thread mode.
        // SAFETY: a read of this register changes nothing.
        let active = unsafe { (*SCB::PTR).icsr.read() } as u16 & 0x1FF;
        let is_tick = active == TICK;
        assert!(is_tick || active == 0, "neither the tick nor thread mode");
        let unmask = !is_tick && primask::read().is_active();
        if unmask {
            cortex_m::interrupt::disable();
        }
        let result = f();
        if unmask {
            // SAFETY: they were not masked before.
            unsafe { cortex_m::interrupt::enable() };
        }
        result
    }
}
