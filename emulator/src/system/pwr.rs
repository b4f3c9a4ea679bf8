//! Power control (RM0390 rev 6, section 5; RM0090 rev 19, section 5): voltage scaling and, where
//! the chip has it, over-drive, without which an STM32F446 must not be clocked at 180 MHz, the
//! write protection of the backup domain, and the programmable voltage detector (5.2.3).

use crate::chip::Power;

/// Over-drive and its switch are ready within some 10 us each; the regulator's voltage follows in
/// 40 us (data sheet DS10693 rev 10, table 23).
const OVER_DRIVE_PS: u64 = 10_000_000;

/// When over-drive that is lost goes off.
const LOST_PS: u64 = 100_000_000_000;

/// Supply of the chip on the board, V.
pub const NOMINAL_VDD: f64 = 3.3;

const ODEN: u32 = 1 << 16;
const ODSWEN: u32 = 1 << 17;
/// The voltage detector is on.
const PVDE: u32 = 1 << 4;
/// Its output in CSR: VDD is below the threshold.
const PVDO: u32 = 1 << 2;
/// VOS, where a chip has it.
const VOS: u32 = 1 << 14;

/// PWR.
#[derive(Clone)]
pub(crate) struct Pwr {
    chip: &'static Power,
    cr: u32,
    over_drive_at: Option<u64>,
    switched_at: Option<u64>,
    /// A defect: over-drive goes off by itself.
    loses: bool,
    /// V, and whether the detector finds that too little.
    vdd: f64,
    low: bool,
}

impl std::fmt::Debug for Pwr {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Pwr(CR {:#x}, {} V)", self.cr, self.vdd)
    }
}

impl Pwr {
    /// PWR of a chip after reset.
    pub(crate) fn new(chip: &'static Power) -> Self {
        Self {
            chip,
            cr: chip.reset,
            over_drive_at: None,
            switched_at: None,
            loses: false,
            vdd: NOMINAL_VDD,
            low: false,
        }
    }

    /// Reads a register at a local time in ps; `None` for an offset without one.
    #[must_use]
    pub fn read(&self, now_ps: u64, offset: u32) -> Option<u32> {
        match offset {
            0 => Some(self.cr),
            4 => {
                let until = |at: u64| if self.loses { at + LOST_PS } else { u64::MAX };
                let ready = |at: Option<u64>| {
                    u32::from(at.is_some_and(|at| (at..until(at)).contains(&now_ps)))
                };
                // VOSRDY (14) is modelled as always reached: the scale is written before the clock
                // is raised.
                let low = if self.is_low() { PVDO } else { 0 };
                let scale = self.chip.writable & VOS;
                Some(low | scale | ready(self.over_drive_at) << 16 | ready(self.switched_at) << 17)
            }
            _ => None,
        }
    }

    /// Writes a register at a local time in ps; `None` for an offset without one.
    pub fn write(&mut self, now_ps: u64, offset: u32, value: u32) -> Option<()> {
        match offset {
            0 => {
                let set =
                    |on: bool, at: Option<u64>| on.then(|| at.unwrap_or(now_ps + OVER_DRIVE_PS));
                let over_drive = self.chip.over_drive && value & ODEN != 0;
                self.over_drive_at = set(over_drive, self.over_drive_at);
                // 5.1.4: the switch works only once over-drive is ready.
                let ready = self.over_drive_at.is_some_and(|at| now_ps >= at);
                self.switched_at = set(value & ODSWEN != 0 && ready, self.switched_at);
                self.cr = value & self.chip.writable;
                self.compare();
                Some(())
            }
            4 => Some(()),
            _ => None,
        }
    }

    /// Resets it; the supply stays.
    pub fn reset(&mut self) {
        *self = Self {
            vdd: self.vdd,
            loses: self.loses,
            ..Self::new(self.chip)
        };
    }

    /// Makes over-drive go off by itself 100 ms after it is on.
    pub fn lose_over_drive(&mut self) {
        self.loses = true;
    }

    /// Sets the chip's supply, V.
    pub fn set_vdd(&mut self, volts: f64) {
        self.vdd = volts;
        self.compare();
    }

    /// The chip's supply, V.
    #[must_use]
    pub fn vdd(&self) -> f64 {
        self.vdd
    }

    fn compare(&mut self) {
        let (falling, rising) = self.chip.detector[(self.cr >> 5 & 7) as usize];
        self.low = self.vdd * 1e3 < if self.low { rising } else { falling };
    }

    /// Whether the voltage detector is on and finds VDD below its threshold: EXTI line 16.
    #[must_use]
    pub fn is_low(&self) -> bool {
        self.cr & PVDE != 0 && self.low
    }

    /// Whether the backup domain may be written (DBP).
    #[must_use]
    pub fn backup_access(&self) -> bool {
        self.cr & 1 << 8 != 0
    }

    /// The highest core clock in Hz that the voltage scale and over-drive allow.
    #[must_use]
    pub fn max_hclk(&self, now_ps: u64) -> u64 {
        let over_drive = self.switched_at.is_some_and(|at| now_ps >= at);
        self.chip.max_hclk[(self.cr >> 14 & 3) as usize][usize::from(over_drive)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::{F407, F446};

    #[test]
    fn the_detector_has_hysteresis() {
        let mut pwr = Pwr::new(&F446.power);
        pwr.set_vdd(2.9);
        assert!(!pwr.is_low(), "off");
        pwr.write(0, 0, PVDE | 6 << 5).unwrap();
        assert!(pwr.is_low());
        for (volts, low) in [(3.0, true), (3.04, false), (2.95, false), (2.92, true)] {
            pwr.set_vdd(volts);
            assert_eq!(pwr.read(0, 4).unwrap() & PVDO != 0, low, "{volts} V");
        }
    }

    #[test]
    fn over_drive_before_180_mhz() {
        let mut pwr = Pwr::new(&F446.power);
        assert_eq!(pwr.max_hclk(0), 168_000_000);
        pwr.write(0, 0, 0xC000 | ODEN | ODSWEN).unwrap();
        // The switch was asked for before over-drive was ready, so it is not in effect.
        assert_eq!(pwr.max_hclk(1_000_000_000), 168_000_000);
        assert_eq!(pwr.read(OVER_DRIVE_PS, 4).unwrap() >> 16 & 3, 1);
        pwr.write(OVER_DRIVE_PS, 0, 0xC000 | ODEN | ODSWEN).unwrap();
        assert_eq!(pwr.max_hclk(2 * OVER_DRIVE_PS), 180_000_000);
        assert_eq!(pwr.read(2 * OVER_DRIVE_PS, 4).unwrap() >> 16 & 3, 3);
    }

    /// RM0090 5.4.1: scale 1 after reset, and no over-drive to go beyond it.
    #[test]
    fn an_stm32f407_ends_at_168_mhz() {
        let mut pwr = Pwr::new(&F407.power);
        assert_eq!(pwr.max_hclk(0), 168_000_000);
        for _ in 0..2 {
            pwr.write(OVER_DRIVE_PS, 0, 0xC000 | ODEN | ODSWEN).unwrap();
        }
        assert_eq!(pwr.read(2 * OVER_DRIVE_PS, 0), Some(0x4000));
        assert_eq!(pwr.read(2 * OVER_DRIVE_PS, 4).unwrap() >> 16, 0);
        assert_eq!(pwr.max_hclk(2 * OVER_DRIVE_PS), 168_000_000);
        pwr.write(0, 0, 0).unwrap();
        assert_eq!(pwr.max_hclk(0), 144_000_000);
    }
}
