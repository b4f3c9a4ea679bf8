//! The local time of an STM32F1, and the driver of `embassy-time` for it.
//!
//! # Theory of operation
//!
//! TIM6 counts microseconds, 16 bits of them, without an interrupt. [`now_us`] keeps the last time
//! it has returned and adds what has been counted since, so it has to be called once in 65 ms: the
//! control tick does it every millisecond. Flash stands still for 40 ms at most (`flash`), and a
//! tick that does not come for longer ends in a reset by the watchdog.
//!
//! TIM6 and TIM7 have no channel that could compare, and all other timers are taken by motors and
//! encoders. So alarms are checked in each tick ([`tick`]), and are up to a millisecond late; LED
//! and log are all that wait for one.
//!
//! # Limits
//!
//! Before the first tick no alarm comes.

use core::cell::{Cell, RefCell};
use core::task::Waker;

use embassy_stm32::pac;
use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

use crate::board::WIRING;

/// What has been returned last.
static LAST: CriticalSectionMutex<Cell<u64>> = CriticalSectionMutex::new(Cell::new(0));

/// Who waits, and until when the first of them does.
struct Alarms(CriticalSectionMutex<RefCell<(Queue, u64)>>);

impl Alarms {
    const fn new() -> Self {
        let none = (Queue::new(), u64::MAX);
        Self(CriticalSectionMutex::new(RefCell::new(none)))
    }
}

embassy_time_driver::time_driver_impl!(static ALARMS: Alarms = Alarms::new());

/// Starts counting.
pub fn start() {
    const CLOCKS_PER_US: u16 = (WIRING.clocks.apb1_timers_hz() / 1_000_000) as u16;
    pac::RCC.apb1enr().modify(|w| w.set_tim6en(true));
    let timer = pac::TIM6;
    timer.psc().write_value(CLOCKS_PER_US - 1);
    timer.arr().write(|w| w.set_arr(u16::MAX));
    // Takes over the prescaler.
    timer.egr().write(|w| w.set_ug(true));
    timer.cr1().write(|w| w.set_cen(true));
}

/// Microseconds since the start.
pub fn now_us() -> u64 {
    LAST.lock(|last| {
        let before = last.get();
        let counted = pac::TIM6.cnt().read().cnt().wrapping_sub(before as u16);
        let now = before + u64::from(counted);
        last.set(now);
        now
    })
}

/// The time has no interrupt.
pub fn set_priority() {}

/// In every tick: wakes what is due.
#[inline(always)]
pub fn tick() {
    ALARMS.0.lock(|alarms| {
        let (queue, first) = &mut *alarms.borrow_mut();
        let now = now_us();
        if *first <= now {
            *first = queue.next_expiration(now);
        }
    });
}

impl Driver for Alarms {
    fn now(&self) -> u64 {
        now_us()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        self.0.lock(|alarms| {
            let (queue, first) = &mut *alarms.borrow_mut();
            if queue.schedule_wake(at, waker) {
                *first = (*first).min(at);
            }
        });
    }
}
