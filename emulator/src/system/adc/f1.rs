//! What an STM32F1's converter has of its own (RM0008 rev 21, section 11): no register in common
//! with others, the clock divided in RCC, other bits of CR2, a calibration.
//!
//! | CR2 | modelled |
//! |---|---|
//! | ADON | a second write of 1, alone, starts a conversion (11.3.1) |
//! | CONT, TSVREFE | yes |
//! | CAL, RSTCAL | CAL lasts 83 clocks (11.4); the results are exact with and without it |
//! | SWSTART | with EXTTRIG and EXTSEL at 7 |
//! | other triggers, DMA, ALIGN to the left | refused |
//!
//! Not modelled: the time until the converter is stable after it is switched on (1 us).

use super::Adc;

/// Sampling times by SMP and the conversion after it, half clocks (11.6, 11.12.4).
pub(super) const SAMPLING: [u64; 8] = [3, 15, 27, 57, 83, 111, 143, 479];
pub(super) const CONVERSION: u64 = 25;
/// The internal reference, V: typical (DS5792 rev 13, table 13).
pub(super) const VREFINT: f64 = 1.20;
/// Fastest clock by the data sheet, Hz.
const MAX_HZ: u64 = 14_000_000;
const CALIBRATION: u64 = 83;

const ADON: u32 = 1;
const CONT: u32 = 1 << 1;
const CAL: u32 = 1 << 2;
const RSTCAL: u32 = 1 << 3;
const BY_SOFTWARE: u32 = 7 << 17;
const EXTTRIG: u32 = 1 << 20;
const SWSTART: u32 = 1 << 22;
pub(super) const TSVREFE: u32 = 1 << 23;

impl Adc {
    pub(super) fn read_cr2_f1(&self, now_ps: u64) -> u32 {
        let calibrating = now_ps < self.calibrated;
        self.cr2 | if calibrating { CAL } else { 0 }
    }

    pub(super) fn write_cr2_f1(&mut self, now_ps: u64, value: u32) -> Result<(), &'static str> {
        let trigger = value & (BY_SOFTWARE | EXTTRIG);
        let known = ADON | CONT | CAL | RSTCAL | BY_SOFTWARE | EXTTRIG | SWSTART | TSVREFE;
        if value & !known != 0
            || !matches!(trigger, 0 | BY_SOFTWARE) && trigger & BY_SOFTWARE != BY_SOFTWARE
        {
            return Err("triggers, DMA, alignment to the left");
        }
        let kept = value & !(SWSTART | CAL | RSTCAL);
        let again = kept == self.cr2 && value == kept;
        self.cr2 = kept;
        if value & ADON == 0 {
            self.started = None;
            return Ok(());
        }
        if value & CAL != 0 {
            self.calibrated = now_ps + CALIBRATION * self.clock_ps();
        }
        let asked = value & SWSTART != 0 && trigger == BY_SOFTWARE | EXTTRIG;
        if asked || again {
            if self.pclk2 > MAX_HZ {
                return Err("a clock above 14 MHz (DS5792)");
            }
            self.start(now_ps);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::family::Family;
    use crate::system::gpio::Port;

    /// Channel 14 at 12 MHz: 239.5 + 12.5 clocks are 21 us.
    fn adc() -> Adc {
        let mut adc = Adc::new(Family::F1, 1);
        adc.set_clock(12_000_000);
        adc.set_pin(0, Port::C, 4, 1.65);
        for (offset, value) in [(0x0C, 7 << 12), (0x34, 14), (0x08, ADON | CONT)] {
            adc.write(0, offset, value).unwrap();
        }
        adc
    }

    #[test]
    fn a_conversion_takes_252_clocks() {
        let mut adc = adc();
        assert_eq!(adc.read(1_000_000_000, 0x00, true), Some(0), "not started");
        adc.write(0, 0x08, ADON | CONT).unwrap();
        assert_eq!(adc.read(20_990_000, 0x4C, true), Some(0));
        assert_eq!(adc.read(21_010_000, 0x4C, true), Some(2048));
        let on = ADON | CONT | BY_SOFTWARE | EXTTRIG;
        adc.write(30_000_000, 0x08, on | SWSTART).unwrap();
        assert_eq!(adc.read(50_900_000, 0x4C, true), Some(0), "begun again");
        assert_eq!(adc.read(51_100_000, 0x4C, true), Some(2048));
    }

    #[test]
    fn a_calibration_ends_after_83_clocks() {
        let mut adc = adc();
        adc.write(0, 0x08, ADON | CONT | CAL).unwrap();
        let left = |now| adc.read(now, 0x08, true).unwrap() & CAL;
        assert_eq!((left(6_900_000), left(6_950_000)), (CAL, 0));
    }

    #[test]
    fn too_fast_a_clock_and_other_triggers_are_refused() {
        let mut adc = adc();
        adc.set_clock(18_000_000);
        assert!(adc.write(0, 0x08, ADON | CONT).is_err());
        assert!(adc.write(0, 0x08, ADON | 1 << 8).is_err(), "DMA");
        assert!(adc.write(0, 0x08, ADON | 1 << 17 | EXTTRIG).is_err());
    }

    #[test]
    fn the_internal_reference_is_1_2_v() {
        let mut adc = adc();
        for (offset, value) in [(0x34, 17), (0x08, ADON | TSVREFE), (0x08, ADON | TSVREFE)] {
            adc.write(0, offset, value).unwrap();
        }
        // 1.20 / 3.3 x 4096.
        assert_eq!(adc.read(30_000_000, 0x4C, false), Some(1489));
    }
}
