//! Clock control of an STM32F1 (RM0008 rev 21, section 7.3): the same oscillators, PLL, gates and
//! causes of a reset behind registers at other places. CFGR also holds what an STM32F4 has in
//! PLLCFGR, and the prescaler of the converters.

use super::{PLLON, Rcc, reg};

/// CFGR: the PLL takes HSE, and half of it.
pub(super) const PLLSRC: u32 = 1 << 16;
const PLLXTPRE: u32 = 1 << 17;
/// CFGR: the PLL's fields, which can be written while it is off (7.3.2).
const PLL: u32 = PLLSRC | PLLXTPRE | 0xF << 18;
/// CFGR: all that can be written; USBPRE and MCO among them, without effect.
const CFGR: u32 = 0x077F_FFF3;

/// Where an STM32F4 has the register that is at this offset of an STM32F1.
pub(super) fn place(offset: u32) -> Option<u32> {
    Some(match offset {
        0x00 => reg::CR,
        0x04 => reg::CFGR,
        0x08 => reg::CIR,
        0x0C => reg::APB2RSTR,
        0x10 => reg::APB2RSTR - 4,
        0x14 => reg::AHB1ENR,
        0x18 => reg::APB2ENR,
        0x1C => reg::APB2ENR - 4,
        0x20 => reg::BDCR,
        0x24 => reg::CSR,
        _ => return None,
    })
}

impl Rcc {
    pub(super) fn write_cfgr_f1(&mut self, value: u32) {
        let keep = if self.cr & PLLON != 0 { PLL } else { 0 };
        self.cfgr = (self.cfgr & keep) | (value & CFGR & !keep);
    }

    /// Frequencies at the PLL's input and output, Hz (7.2.3).
    pub(super) fn pll_f1(&self) -> (u64, u64) {
        let halved = self.cfgr & PLLSRC == 0 || self.cfgr & PLLXTPRE != 0;
        let input = self.pll_source() / (1 + u64::from(halved));
        let times = u64::from(self.cfgr >> 18 & 0xF) + 2;
        (input, input * times.min(16))
    }

    /// What is wrong with the PLL, by the data sheet DS5792 rev 13, table 27.
    pub(super) fn pll_fault_f1(&self) -> Option<String> {
        let (input, output) = self.pll_f1();
        if !(1_000_000..=25_000_000).contains(&input) {
            return Some(format!("PLL input of {input} Hz, allowed are 1 to 25 MHz"));
        }
        (!(16_000_000..=72_000_000).contains(&output))
            .then(|| format!("PLL output at {output} Hz, allowed are 16 to 72 MHz"))
    }

    /// The converters' clock, Hz (7.3.2, ADCPRE).
    pub(super) fn adc_f1(&self, pclk2: u64) -> u64 {
        pclk2 / (2 * (u64::from(self.cfgr >> 14 & 3) + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Clocks, HSEON, PLL_LOCK_PS, cause};
    use super::*;
    use crate::chip::F103;
    use crate::system::map::Gate;

    /// HSE x 9 as the system clock, APB1 by 2, converters by 6.
    fn running(hse_hz: u64, times: u32) -> (Rcc, u64) {
        let mut rcc = Rcc::new(&F103.clocks, hse_hz);
        rcc.write(0, 0x00, 0x83 | HSEON, false).unwrap();
        let late = 3_000_000_000;
        let cfgr = PLLSRC | (times - 2) << 18 | 4 << 8 | 2 << 14;
        rcc.write(late, 0x04, cfgr, false).unwrap();
        rcc.write(late, 0x00, 0x83 | HSEON | PLLON, false).unwrap();
        let locked = late + PLL_LOCK_PS;
        rcc.write(locked, 0x04, cfgr | 2, false).unwrap();
        (rcc, locked)
    }

    #[test]
    fn the_tree_at_72_mhz() {
        let (rcc, now) = running(8_000_000, 9);
        assert_eq!(rcc.read(now, 0x04).unwrap() >> 2 & 3, 2, "SWS");
        let clocks = rcc.clocks(now);
        assert_eq!(
            clocks,
            Clocks {
                sysclk: 72_000_000,
                hclk: 72_000_000,
                pclk1: 36_000_000,
                pclk2: 72_000_000,
                timer1: 72_000_000,
                timer2: 72_000_000
            }
        );
        assert_eq!(rcc.adc_source(clocks.pclk2), 12_000_000);
        assert_eq!(rcc.pll_fault(now), None);
        let (fast, now) = running(8_000_000, 10);
        assert!(fast.pll_fault(now).unwrap().contains("80000000"));
    }

    #[test]
    fn it_starts_from_8_mhz_and_has_no_brown_out_reset() {
        let rcc = Rcc::new(&F103.clocks, 8_000_000);
        assert_eq!(rcc.clocks(0).hclk, 8_000_000);
        assert_eq!(rcc.read(0, 0x00), Some(0x83));
        assert_eq!(rcc.read(0, 0x14), Some(0x14), "SRAM and FLITF");
        assert_eq!(rcc.read(0, 0x24), Some(cause::PIN | cause::POR));
        assert_eq!(rcc.read(0, 0x30), None);
    }

    #[test]
    fn the_fields_of_a_running_pll_stay() {
        let (mut rcc, now) = running(8_000_000, 9);
        rcc.write(now, 0x04, 2, false).unwrap();
        assert_eq!(rcc.clocks(now).hclk, 72_000_000);
    }

    #[test]
    fn gates_and_resets_are_at_their_own_places() {
        let mut rcc = Rcc::new(&F103.clocks, 8_000_000);
        for (offset, gate) in [
            (0x18, Gate::Apb2(11)),
            (0x1C, Gate::Apb1(25)),
            (0x14, Gate::Ahb1(6)),
        ] {
            assert!(!rcc.enabled(gate));
            rcc.write(0, offset, u32::MAX, false).unwrap();
            assert!(rcc.enabled(gate) && !rcc.in_reset(gate));
        }
        assert!(rcc.resets(0x0C) && rcc.resets(0x10) && !rcc.resets(0x14));
        rcc.write(0, 0x0C, 1 << 11, false).unwrap();
        assert!(rcc.in_reset(Gate::Apb2(11)) && !rcc.in_reset(Gate::Apb1(25)));
    }
}
