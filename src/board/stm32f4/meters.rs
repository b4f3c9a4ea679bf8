//! The supply voltage, behind a divider, and the current sensors' outputs; the configuration knows
//! both.
//!
//! The converter converts its channels over and over, five of them in 109 us at 22.5 MHz, and no
//! task waits for it: reading returns the last result. The sensors' are injected channels, which
//! have result registers of their own (RM0390 rev 6, 13.3.9, auto-injection).
//!
//! The converter's reference is the chip's supply, and a regulator gives 3.3 V within per cents
//! only. So ADC1 converts the chip's own reference, VREFINT, as well, and [`calibrate`] compares
//! the result with the one ST took at 3.3 V. ADC2 and ADC3 have no such channel: where they have
//! the inputs, ADC1 converts nothing else.

#![expect(
    unsafe_code,
    reason = "a converter's registers are found by its number"
)]

use core::sync::atomic::{AtomicU32, Ordering};

use control::quantity::InputVoltage;
use embassy_stm32::pac;
use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adccommon::vals::Adcpre;

use crate::board::WIRING;
use crate::board::stm32::pin::Role;

/// The converter's reference, V, at which ST measures VREFINT, and its steps.
const REFERENCE: f32 = 3.3;
const STEPS: f32 = 4096.0;

/// Volts of one step, the bits of an `f32`.
static STEP: AtomicU32 = AtomicU32::new((REFERENCE / STEPS).to_bits());

/// Channel of VREFINT on ADC1 (RM0390 13.10).
const VREFINT_CHANNEL: u8 = 17;

/// ST's measurement of VREFINT at 3.3 V and 30 C (VREFIN_CAL, DS10693 and DS8626, embedded
/// reference voltage).
const VREFIN_CAL: *const u16 = 0x1FFF_7A2A as *const u16;

/// How many sensors are converted after the supply, and the place of VREFINT behind them, from 0,
/// where the converter has it.
const SENSORS: usize = if WIRING.currents.is_some() { 3 } else { 0 };
const REFERENCE_AT: Option<usize> = match WIRING.converter {
    1 => Some(SENSORS),
    _ => None,
};

/// ADC1, which alone has VREFINT.
const ADC1: Adc = converter(1);

/// DS10693 rev 10, table 74, and DS8626, table 67: the converter's clock is 36 MHz at most.
const LARGEST_CLOCK_HZ: u32 = 36_000_000;

/// The converter's registers.
const ADC: Adc = converter(WIRING.converter);

/// The registers of a converter, 1 to 3.
const fn converter(number: usize) -> Adc {
    assert!(number >= 1 && number <= 3);
    // RM0390 rev 6, table 1 and 13.13.17: ADC1 is here, and the others behind it.
    let address = 0x4001_2000 + 0x100 * (number - 1);
    // SAFETY: the registers of one of the three converters.
    unsafe { Adc::from_ptr(address as *mut ()) }
}

/// The converter, running.
pub struct Meters(());

impl Meters {
    /// Starts the converter.
    pub fn new() -> Self {
        // SMPR1 and SMPR2 side by side, three bits a channel: 480 clocks. The source has 9.1 kOhm.
        // RM0390 13.5, DS10693 table 78: with 480 clocks of 22.5 MHz it may have 500 kOhm. VREFINT
        // wants 10 us; these are 21.
        const CYCLES480: u64 = 7;
        // RM0390 13.13.12: a sequence of n ends with JSQ4.
        let mut sampling = CYCLES480 << (3 * WIRING.supply.channel);
        let mut sequence = 0;
        let mut inject = |channel: u8| {
            sampling |= CYCLES480 << (3 * channel);
            sequence = sequence >> 5 | u32::from(channel) << 15;
        };
        WIRING.supply.pin.become_a(Role::Analog);
        for input in WIRING.currents.into_iter().flatten() {
            input.pin.become_a(Role::Analog);
            inject(input.channel);
        }
        if REFERENCE_AT.is_some() {
            inject(VREFINT_CHANNEL);
        }
        // RM0390 6.3.14: ADC1 is bit 8.
        pac::RCC
            .apb2enr()
            .modify(|w| w.0 |= 1 << (7 + WIRING.converter));
        const {
            assert!(WIRING.clocks.apb2_hz() / 4 <= LARGEST_CLOCK_HZ);
        }
        pac::ADC123_COMMON.ccr().write(|w| {
            w.set_adcpre(Adcpre::DIV4);
            w.set_tsvrefe(true);
        });
        // Channels 0 to 9 are in SMPR2.
        ADC.smpr2().write(|w| w.0 = (sampling & 0x3FFF_FFFF) as u32);
        ADC.smpr1().write(|w| w.0 = (sampling >> 30) as u32);
        ADC.sqr3().write(|w| w.set_sq(0, WIRING.supply.channel));
        let injected = SENSORS as u32 + u32::from(REFERENCE_AT.is_some());
        if injected > 0 {
            ADC.jsqr().write(|w| w.0 = sequence | (injected - 1) << 20);
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
        if REFERENCE_AT.is_none() {
            convert_reference();
        }
        Self(())
    }

    /// Volts at the supply's pin at the last conversion.
    pub fn supply(&self) -> InputVoltage {
        InputVoltage::new(volts(ADC.dr().read().data()))
    }

    /// Volts at the current sensors' pins at their last conversions; 0 on a board without.
    pub fn currents(&self) -> [f32; 3] {
        let volts_of = |n| volts(ADC.jdr(n).read().jdata());
        // Unrolled: a loop checks the number of the register.
        [volts_of(0), volts_of(1), volts_of(2)]
    }
}

/// Starts ADC1 for VREFINT alone, over and over.
fn convert_reference() {
    const SAMPLING: u32 = 0b111 << (3 * (VREFINT_CHANNEL - 10)); // 480 clocks
    pac::RCC.apb2enr().modify(|w| w.set_adc1en(true));
    ADC1.smpr1().write(|w| w.0 = SAMPLING);
    ADC1.sqr3().write(|w| w.set_sq(0, VREFINT_CHANNEL));
    ADC1.cr2().write(|w| {
        w.set_adon(true);
        w.set_cont(true);
    });
    cortex_m::asm::delay(3 * WIRING.clocks.cycles_per_us());
    ADC1.cr2().modify(|w| w.set_swstart(true));
}

fn volts(steps: u16) -> f32 {
    f32::from(steps) * f32::from_bits(STEP.load(Ordering::Relaxed))
}

/// Compares the converter's reference with the chip's own. Call it from time to time.
pub fn calibrate() {
    // SAFETY: a half-word of system memory, which can always be read.
    let at_reference = f32::from(unsafe { VREFIN_CAL.read_volatile() });
    let now = f32::from(match REFERENCE_AT {
        Some(place) => ADC.jdr(place).read().jdata(),
        None => ADC1.dr().read().data(),
    });
    let reference = REFERENCE * at_reference / now;
    // The chip is made for 3.6 V at most, and below 2.9 V nothing runs here; else there is no
    // calibration, or no conversion yet.
    if (2.9..=3.6).contains(&reference) {
        STEP.store((reference / STEPS).to_bits(), Ordering::Relaxed);
    }
}
