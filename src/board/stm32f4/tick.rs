//! When the control tick begins: TIM7, one shot at a time (RM0390 rev 6, section 20).
//!
//! Its vector is the control executor's too (`executors`): the interrupt that ends a wait continues
//! with the task that has waited. A timer of `embassy-time` would be another interrupt before that
//! one, and two walks through the executor's queue of timers: a thousand cycles in every
//! millisecond (docs/performance.md).
//!
//! The counter counts microseconds beside the one of the local time, from the same clock. Each wait
//! is measured from the local time as it is, so nothing adds up.

use core::future::poll_fn;
use core::task::Poll;

use control::time::Micros;
use cortex_m::peripheral::NVIC;
use embassy_stm32::pac::timer::vals::Urs;
use embassy_stm32::{interrupt, pac};

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
            let now = now();
            let left = due.since(now).0;
            if left == 0 {
                return Poll::Ready(now);
            }
            // Ready at once, but not before the timer's interrupt: that is the executor's, and it
            // has no other task. So the interrupt does not have to wake a task. Nothing counts yet,
            // so what is taken back is this request alone.
            context.waker().wake_by_ref();
            NVIC::unpend(interrupt::TIM7);
            start(u16::try_from(left).unwrap_or(u16::MAX));
            Poll::Pending
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
