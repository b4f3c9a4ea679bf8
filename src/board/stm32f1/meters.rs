//! The supply voltage, behind a divider; the configuration knows that.
//!
//! ADC1 converts its one channel over and over, in 21 us at 12 MHz, and no task waits for it:
//! reading returns the last result (RM0008 rev 21, section 11). The source's resistance may be 350
//! kOhm (DS5792 rev 13, table 60: 239.5 clocks of sampling at 14 MHz).
//!
//! # Limits
//!
//! The converter's reference is the board's 3.3 V. ST has measured no reference in these chips, and
//! theirs, of 1.16 to 1.24 V (table 13), is not better than a board's regulator. There are no
//! current sensors.

use control::quantity::InputVoltage;
use embassy_stm32::pac;
use embassy_stm32::pac::adc::vals::SampleTime;

use crate::board::WIRING;
use crate::board::stm32::pin::Role;

/// Volts of one step.
const STEP: InputVoltage = InputVoltage::new(3.3 / 4096.0);

const ADC: pac::adc::Adc = pac::ADC1;

/// The converter, running.
pub struct Meters(());

impl Meters {
    /// Starts the converter.
    pub fn new() -> Self {
        const {
            assert!(WIRING.converter == 1 && WIRING.currents.is_none());
        }
        let channel = WIRING.supply.channel;
        WIRING.supply.pin.become_a(Role::Analog);
        pac::RCC.apb2enr().modify(|w| w.set_adc1en(true));
        // Channels 0 to 9 are in SMPR2.
        match channel.checked_sub(10) {
            Some(upper) => ADC
                .smpr1()
                .write(|w| w.set_smp(upper.into(), SampleTime::CYCLES239_5)),
            None => ADC
                .smpr2()
                .write(|w| w.set_smp(channel.into(), SampleTime::CYCLES239_5)),
        }
        ADC.sqr3().write(|w| w.set_sq(0, channel));
        ADC.cr2().write(|w| w.set_adon(true));
        // DS5792, table 59: it is stable after 1 us; 11.4: two of its clocks before a calibration.
        cortex_m::asm::delay(2 * WIRING.clocks.cycles_per_us());
        ADC.cr2().modify(|w| w.set_rstcal(true));
        while ADC.cr2().read().rstcal() {}
        ADC.cr2().modify(|w| w.set_cal(true));
        while ADC.cr2().read().cal() {}
        ADC.cr2().modify(|w| w.set_cont(true));
        // 11.3.1: ADON written once more, with nothing else changed, starts it.
        ADC.cr2().modify(|w| w.set_adon(true));
        Self(())
    }

    /// Volts at the supply's pin at the last conversion.
    pub fn supply(&self) -> InputVoltage {
        STEP.many(ADC.dr().read().data())
    }

    /// There are none.
    pub fn currents(&self) -> [f32; 3] {
        [0.0; 3]
    }
}

/// Nothing to compare the reference with.
pub fn calibrate() {}
