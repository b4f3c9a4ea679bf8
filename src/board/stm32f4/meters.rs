//! The supply voltage, behind a divider, and the current sensors' outputs; the configuration knows
//! both.
//!
//! The converter converts its channels over and over, four of them in 87.5 us at 22.5 MHz, and
//! nobody waits for it: reading takes the last result. The sensors' are injected channels, which
//! have result registers of their own (RM0390 rev 6, 13.3.9, auto-injection).

#![expect(
    unsafe_code,
    reason = "a converter's registers are found by its number"
)]

use embassy_stm32::pac;
use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adccommon::vals::Adcpre;

use super::pin::Role;
use crate::board::WIRING;

/// The board's analog reference, V, and steps of the converter.
const REFERENCE: f32 = 3.3;
const STEPS: f32 = 4096.0;

/// DS10693 rev 10, table 74, and DS8626, table 67: the converter's clock is 36 MHz at most.
const LARGEST_CLOCK_HZ: u32 = 36_000_000;

/// The converter's registers.
const ADC: Adc = {
    assert!(WIRING.converter >= 1 && WIRING.converter <= 3);
    // RM0390 rev 6, table 1 and 13.13.17: ADC1 is here, and the others behind it.
    let address = 0x4001_2000 + 0x100 * (WIRING.converter - 1);
    // SAFETY: the registers of one of the three converters.
    unsafe { Adc::from_ptr(address as *mut ()) }
};

/// The converter, running.
pub struct Meters(());

impl Meters {
    /// Starts the converter.
    pub fn new() -> Self {
        // SMPR1 and SMPR2 side by side, three bits a channel: 480 clocks. The source has 9.1 kOhm.
        // RM0390 13.5, DS10693 table 78: with 480 clocks of 22.5 MHz it may have 500 kOhm.
        const CYCLES480: u64 = 7;
        let mut sampling = CYCLES480 << (3 * WIRING.supply.channel);
        // RM0390 13.13.12: a sequence of three begins with JSQ2.
        let mut injected = 2 << 20;
        WIRING.supply.pin.become_a(Role::Analog);
        for (place, input) in WIRING.currents.into_iter().flatten().enumerate() {
            input.pin.become_a(Role::Analog);
            sampling |= CYCLES480 << (3 * input.channel);
            injected |= u32::from(input.channel) << (5 * (place + 1));
        }
        // RM0390 6.3.14: ADC1 is bit 8.
        pac::RCC
            .apb2enr()
            .modify(|w| w.0 |= 1 << (7 + WIRING.converter));
        const {
            assert!(WIRING.clocks.apb2_hz() / 4 <= LARGEST_CLOCK_HZ);
        }
        pac::ADC123_COMMON
            .ccr()
            .modify(|w| w.set_adcpre(Adcpre::DIV4));
        // Channels 0 to 9 are in SMPR2.
        ADC.smpr2().write(|w| w.0 = (sampling & 0x3FFF_FFFF) as u32);
        ADC.smpr1().write(|w| w.0 = (sampling >> 30) as u32);
        ADC.sqr3().write(|w| w.set_sq(0, WIRING.supply.channel));
        if WIRING.currents.is_some() {
            ADC.jsqr().write(|w| w.0 = injected);
            ADC.cr1().write(|w| {
                w.set_scan(true);
                w.set_jauto(true);
            });
        }
        ADC.cr2().write(|w| {
            w.set_adon(true);
            w.set_cont(true);
        });
        // DS10693, table 74: it is stable after 3 us.
        cortex_m::asm::delay(3 * WIRING.clocks.cycles_per_us());
        ADC.cr2().modify(|w| w.set_swstart(true));
        Self(())
    }

    /// Volts at the supply's pin at the last conversion.
    pub fn supply(&self) -> f32 {
        volts(ADC.dr().read().data())
    }

    /// Volts at the current sensors' pins at their last conversions; 0 on a board without.
    pub fn currents(&self) -> [f32; 3] {
        [0, 1, 2].map(|n| volts(ADC.jdr(n).read().jdata()))
    }
}

fn volts(steps: u16) -> f32 {
    f32::from(steps) * (REFERENCE / STEPS)
}
