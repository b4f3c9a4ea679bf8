//! The wheel encoders: a counter each, TIM2 to TIM5 in encoder mode (RM0390 rev 6, 18.3.12).
//!
//! The HAL's driver leaves the digital filter of the inputs off, and then every glitch of 11 ns is
//! an edge.

#![expect(unsafe_code, reason = "a timer's registers are found by its number")]

use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, FilterValue, Sms};

use super::pin::{Pull, Role};
use super::wiring::Encoder;
use crate::board::WIRING;

/// Filter of the channels until there is a configuration, the same as its default.
const FILTER: u8 = 3;

/// Data sheet DS10693 rev 10, table 11; DS8626, table 9: TIM2 is alternate function 1, TIM3
/// to TIM5 are 2.
const fn alternate_function(timer: usize) -> u8 {
    match timer {
        2 => 1,
        3..=5 => 2,
        _ => panic!("no timer with an encoder mode that is free"),
    }
}

/// A counter's registers. TIM2 and TIM5 have 32 bits, of which the lower 16 are used.
#[inline(always)]
pub const fn counter(timer: usize) -> TimGp16 {
    assert!(timer >= 2 && timer <= 5);
    // RM0390 rev 6, table 1: TIM2 is here, and the others behind it.
    let address = 0x4000_0000 + 0x400 * (timer - 2);
    // SAFETY: the registers of one of the four timers.
    unsafe { TimGp16::from_ptr(address as *mut ()) }
}

/// The count of one encoder.
#[inline(always)]
pub fn count(encoder: Option<Encoder>) -> u16 {
    encoder.map_or(0, |encoder| counter(encoder.timer).cnt().read().cnt())
}

/// The four encoder counters.
pub struct Encoders(());

impl Encoders {
    /// Starts the counters.
    pub fn new() -> Self {
        for Encoder { timer, channels } in WIRING.encoders.into_iter().flatten() {
            // RM0390 6.3.13: TIM2 is bit 0.
            pac::RCC.apb1enr().modify(|w| w.0 |= 1 << (timer - 2));
            let registers = counter(timer);
            registers.ccmr_input(0).write(|w| {
                w.set_ccs(0, CcmrInputCcs::TI4);
                w.set_ccs(1, CcmrInputCcs::TI4);
            });
            registers.ccer().write(|w| {
                w.set_cce(0, true);
                w.set_cce(1, true);
            });
            registers.smcr().write(|w| w.set_sms(Sms::ENCODER_MODE_3));
            registers.arr().write(|w| w.set_arr(u16::MAX));
            registers.cr1().write(|w| w.set_cen(true));
            let function = alternate_function(timer);
            for channel in channels {
                channel.become_a(Role::PeripheralInput(function, Pull::Up));
            }
        }
        let encoders = Self(());
        encoders.set_filter(FILTER);
        encoders
    }

    /// Sets the digital filter of all channels, 0 to 15: ICxF of RM0390 18.4.7, at the clock of the
    /// timers of APB1.
    #[inline(never)]
    pub fn set_filter(&self, filter: u8) {
        let filter = FilterValue::from_bits(filter);
        for encoder in WIRING.encoders.into_iter().flatten() {
            counter(encoder.timer).ccmr_input(0).modify(|w| {
                w.set_icf(0, filter);
                w.set_icf(1, filter);
            });
        }
    }

    /// Returns the counts front left, front right, rear left, rear right; they wrap at 16 bits and
    /// go up when the wheel rolls the base forward.
    pub fn counts(&self) -> [u16; 4] {
        let [a, b, c, d] = WIRING.encoders;
        [count(a), count(b), count(c), count(d)]
    }
}
