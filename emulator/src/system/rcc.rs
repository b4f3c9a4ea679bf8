//! Reset and clock control (RM0390 rev 6, section 6; RM0090 rev 19, section 7, is the same but for
//! what [`crate::chip`] says).
//!
//! The model computes the state from the registers: an oscillator is ready after its start-up time,
//! a PLL after its lock time and only when its source runs, and the frequencies of core, buses and
//! timers follow from the multipliers and dividers that were written. A wrong PLL therefore shows
//! as a wrong CAN bit rate, and a switch to a clock that is not ready does not happen, as on the
//! chip (6.2.6).
//!
//! Lock and start-up times are typical or, where the data sheet (DS10693 rev 10, tables 38 to 45)
//! gives no typical value, its largest.

use crate::chip;
use crate::family::Family;
use crate::system::map::Gate;

const US: u64 = 1_000_000; // ps

/// HSI start-up, typical 2.2 us.
const HSI_START_PS: u64 = 2_200_000;
/// HSE start-up with a crystal, typical 2 ms. In bypass the clock is there at once.
const HSE_START_PS: u64 = 2_000 * US;
/// PLL lock, 75..200 us.
const PLL_LOCK_PS: u64 = 200 * US;
/// LSI start-up, 40 us at most.
const LSI_START_PS: u64 = 40 * US;
/// LSE start-up, typical 2 s.
const LSE_START_PS: u64 = 2_000_000 * US;

/// Bits of CSR that hold the reset cause (6.3.21).
pub mod cause {
    /// Brown-out or power-on.
    pub const BOR: u32 = 1 << 25;
    /// Reset pin. Every internal reset pulls the pin too.
    pub const PIN: u32 = 1 << 26;
    /// Power-on.
    pub const POR: u32 = 1 << 27;
    /// Software (SYSRESETREQ).
    pub const SOFTWARE: u32 = 1 << 28;
    /// Independent watchdog.
    pub const IWDG: u32 = 1 << 29;
}

/// CR: HSE is a clock from outside.
const HSEBYP: u32 = 1 << 18;
/// CR: HSE on, clock security system on, main PLL on.
const HSEON: u32 = 1 << 16;
const CSSON: u32 = 1 << 19;
const PLLON: u32 = 1 << 24;
/// PLLCFGR: the PLLs' source is HSE.
const PLLSRC: u32 = 1 << 22;
/// CIR: the clock security system's flag, and what clears it.
const CSSF: u32 = 1 << 7;
const CSSC: u32 = 1 << 23;
const RMVF: u32 = 1 << 24;
const CAUSES: u32 = 0xFE00_0000;

/// Register offsets.
pub mod reg {
    #![allow(missing_docs)]
    pub const CR: u32 = 0x00;
    pub const PLLCFGR: u32 = 0x04;
    pub const CFGR: u32 = 0x08;
    pub const CIR: u32 = 0x0C;
    pub const APB2RSTR: u32 = 0x24;
    pub const AHB1ENR: u32 = 0x30;
    pub const APB2ENR: u32 = 0x44;
    pub const BDCR: u32 = 0x70;
    pub const CSR: u32 = 0x74;
    pub const DCKCFGR: u32 = 0x8C;
}

/// The frequencies that the registers ask for, in Hz by the board's own crystal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clocks {
    /// System clock.
    pub sysclk: u64,
    /// Core, memory and AHB clock.
    pub hclk: u64,
    /// APB1 peripheral clock (CAN).
    pub pclk1: u64,
    /// APB2 peripheral clock.
    pub pclk2: u64,
    /// Clock of TIM2..7 and TIM12..14.
    pub timer1: u64,
    /// Clock of TIM1 and TIM8..11.
    pub timer2: u64,
}

/// An oscillator or PLL: since when it is on.
#[derive(Debug, Clone, Copy, Default)]
struct Source {
    ready_at: Option<u64>,
}

impl Source {
    fn switch(&mut self, on: bool, now_ps: u64, delay: u64) {
        if !on {
            self.ready_at = None;
        } else if self.ready_at.is_none() {
            self.ready_at = Some(now_ps + delay);
        }
    }

    fn ready(self, now_ps: u64) -> bool {
        self.ready_at.is_some_and(|at| now_ps >= at)
    }
}

/// What a change at the HSE input does to the chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HseFailure {
    /// Nothing fails.
    None,
    /// HSE fails, and the clock security system sees it.
    Seen,
    /// HSE fails under the system clock, and nothing sees it.
    Unseen,
}

/// RCC.
#[derive(Clone)]
pub(crate) struct Rcc {
    chip: &'static chip::Clocks,
    hse_hz: u64,
    /// Whether there is a clock at the HSE input.
    hse_runs: bool,
    /// CSSF: the clock security system has seen HSE fail.
    hse_failed: bool,
    cr: u32,
    pllcfgr: u32,
    cfgr: u32,
    cir: u32,
    /// RSTR, ENR and LPENR banks as plain words; index is offset / 4.
    banks: [u32; 0x28],
    bdcr: u32,
    csr: u32,
    hsi: Source,
    hse: Source,
    plls: [Source; 3],
    lsi: Source,
    lse: Source,
}

impl std::fmt::Debug for Rcc {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Rcc(CR {:#x}, CFGR {:#x})", self.cr, self.cfgr)
    }
}

impl Rcc {
    /// RCC of a chip after power-on, on a board that feeds `hse_hz` into the HSE input.
    #[must_use]
    pub fn new(chip: &'static chip::Clocks, hse_hz: u64) -> Self {
        let mut rcc = Self {
            chip,
            hse_hz,
            hse_runs: hse_hz != 0,
            hse_failed: false,
            cr: 0,
            pllcfgr: 0,
            cfgr: 0,
            cir: 0,
            banks: [0; 0x28],
            bdcr: 0,
            csr: match chip.family {
                Family::F1 => cause::PIN | cause::POR,
                Family::F4 => cause::BOR | cause::PIN | cause::POR,
            },
            hsi: Source { ready_at: Some(0) },
            hse: Source::default(),
            plls: [Source::default(); 3],
            lsi: Source::default(),
            lse: Source::default(),
        };
        rcc.reset(0);
        rcc
    }

    /// A system reset for a reason given as bits of CSR. The backup domain and the causes stay.
    pub fn reset(&mut self, causes: u32) {
        self.cr = 0x83;
        self.pllcfgr = 0x2400_3010;
        self.cfgr = 0;
        self.cir = 0;
        self.hse_failed = false;
        self.banks = [0; 0x28];
        for &(offset, value) in self.chip.reset {
            self.banks[offset / 4] = value;
        }
        self.csr |= causes;
        self.hsi = Source { ready_at: Some(0) };
        self.hse = Source::default();
        self.plls = [Source::default(); 3];
        // LSION is in CSR, which a system reset clears but for the causes (6.3.21).
        self.csr &= CAUSES;
        self.lsi = Source::default();
    }

    /// Whether a gate is open.
    #[must_use]
    pub fn enabled(&self, gate: Gate) -> bool {
        self.bit(gate, 0x30).unwrap_or(true)
    }

    /// Whether the reset bit that belongs to a gate is set.
    #[must_use]
    pub fn in_reset(&self, gate: Gate) -> bool {
        self.bit(gate, 0x10).unwrap_or(false)
    }

    /// A gate's bit in the bank of registers that begins at this offset; `None` for no gate.
    fn bit(&self, gate: Gate, bank: usize) -> Option<bool> {
        let (offset, bit) = match gate {
            Gate::None => return None,
            Gate::Ahb1(bit) => (0x00, bit),
            Gate::Ahb2(bit) => (0x04, bit),
            Gate::Ahb3(bit) => (0x08, bit),
            Gate::Apb1(bit) => (0x10, bit),
            Gate::Apb2(bit) => (0x14, bit),
            Gate::AnyOfApb2(bits) => return Some(self.banks[(bank + 0x14) / 4] & bits != 0),
        };
        Some(self.banks[(bank + offset) / 4] >> bit & 1 != 0)
    }

    /// Reads a register at a local time in ps; `None` for an offset without one.
    #[must_use]
    pub fn read(&self, now_ps: u64, offset: u32) -> Option<u32> {
        Some(match self.place(offset)? {
            reg::CR => {
                let mut value = self.cr;
                for (source, bit) in [
                    (self.hsi, 1),
                    (self.hse, 17),
                    (self.plls[0], 25),
                    (self.plls[1], 27),
                    (self.plls[2], 29),
                ] {
                    value |= u32::from(source.ready(now_ps)) << bit;
                }
                value
            }
            reg::PLLCFGR => self.pllcfgr,
            reg::CFGR => (self.cfgr & !0xC) | (self.switched(now_ps) << 2),
            reg::CIR => self.cir | if self.hse_failed { CSSF } else { 0 },
            reg::BDCR => self.bdcr | u32::from(self.lse.ready(now_ps)) << 1,
            reg::CSR => self.csr | u32::from(self.lsi.ready(now_ps)) << 1,
            offset if self.has_bank(offset) => self.banks[(offset / 4) as usize],
            reg::DCKCFGR => 0,
            _ => return None,
        })
    }

    /// Whether there is a register at an offset that keeps what is written.
    fn has_bank(&self, offset: u32) -> bool {
        matches!(
            offset,
            0x10..=0x18
                | 0x20
                | 0x24
                | 0x30..=0x38
                | 0x40
                | 0x44
                | 0x50..=0x58
                | 0x60
                | 0x64
                | 0x80..=0x94
        ) && offset <= self.chip.last
    }

    /// Whether a timer on APB1 has a clock, but none while the core sleeps (APB1LPENR). Those on
    /// APB2 are not modelled to stop.
    #[must_use]
    pub fn stops_asleep(&self, timer: usize) -> bool {
        let bit = match timer {
            // An STM32F1 has no such register.
            _ if self.chip.family == Family::F1 => return false,
            2..=7 => timer - 2,
            12..=14 => timer - 6,
            _ => return false,
        };
        self.banks[0x40 / 4] & !self.banks[0x60 / 4] & 1 << bit != 0
    }

    /// Writes a register at a local time in ps; `None` for an offset without one. `backup_access`
    /// is PWR_CR.DBP.
    pub fn write(
        &mut self,
        now_ps: u64,
        offset: u32,
        value: u32,
        backup_access: bool,
    ) -> Option<()> {
        match self.place(offset)? {
            reg::CR => self.write_cr(now_ps, value),
            reg::PLLCFGR => {
                // 6.3.2: to be written only while the PLL is off.
                if self.cr & 1 << 24 == 0 {
                    self.pllcfgr = value & self.chip.pllcfgr;
                }
            }
            reg::CFGR if self.chip.family == Family::F1 => self.write_cfgr_f1(value),
            reg::CFGR => self.cfgr = value & 0xFFFF_FFF3 & !0x300,
            reg::CIR => {
                self.cir = value & 0x7F00;
                self.hse_failed &= value & CSSC == 0;
            }
            reg::BDCR => {
                if backup_access {
                    self.bdcr = if value & 1 << 16 != 0 {
                        1 << 16
                    } else {
                        value & 0x0001_830D
                    };
                    let delay = if value & 4 != 0 { 0 } else { LSE_START_PS };
                    self.lse.switch(self.bdcr & 1 != 0, now_ps, delay);
                }
            }
            reg::CSR => {
                if value & RMVF != 0 {
                    self.csr &= !CAUSES;
                }
                self.csr = (self.csr & CAUSES) | (value & 1);
                self.lsi.switch(value & 1 != 0, now_ps, LSI_START_PS);
            }
            offset if self.has_bank(offset) => self.banks[(offset / 4) as usize] = value,
            // Reserved where a chip does not have it; the HAL clears its bits on every chip.
            reg::DCKCFGR if value == 0 => {}
            _ => return None,
        }
        Some(())
    }

    fn write_cr(&mut self, now_ps: u64, value: u32) {
        let mut value = value & self.chip.cr;
        // A clock that feeds the system cannot be switched off (6.3.1).
        match self.switched(now_ps) {
            0 => value |= 1,
            1 => value |= 1 << 16,
            _ => value |= 1 << 24,
        }
        self.cr = value;
        self.switch_sources(now_ps);
    }

    /// Starts and stops the oscillators and PLLs as CR says.
    fn switch_sources(&mut self, now_ps: u64) {
        let value = self.cr;
        self.hsi.switch(value & 1 != 0, now_ps, HSI_START_PS);
        let delay = if value & HSEBYP != 0 { 0 } else { HSE_START_PS };
        self.hse
            .switch(value & HSEON != 0 && self.hse_runs, now_ps, delay);
        let fed = if self.pll_takes_hse() {
            self.hse
        } else {
            self.hsi
        };
        for (index, pll) in self.plls.iter_mut().enumerate() {
            let on = value >> (24 + 2 * index) & 1 != 0;
            // Without an input it never locks.
            match fed.ready_at {
                Some(at) => pll.switch(on, now_ps.max(at), PLL_LOCK_PS),
                None => pll.switch(false, now_ps, 0),
            }
        }
    }

    /// The clock at the HSE input begins or stops (6.2.7). A failure that the clock security system
    /// sees switches HSE, and the PLL that it feeds, off and the system clock to HSI.
    pub fn set_hse(&mut self, now_ps: u64, runs: bool) -> HseFailure {
        let runs = runs && self.hse_hz != 0;
        let fails = !runs && self.hse.ready(now_ps);
        let feeds = match self.switched(now_ps) {
            1 => true,
            2 => self.pll_takes_hse(),
            _ => false,
        };
        self.hse_runs = runs;
        let seen = fails && self.cr & CSSON != 0;
        if seen {
            self.cr &= !HSEON;
            if self.pll_takes_hse() {
                self.cr &= !PLLON;
            }
            if feeds {
                self.cfgr &= !3;
                self.cr |= 1;
            }
            self.hse_failed = true;
        }
        self.switch_sources(now_ps);
        match (seen, fails && feeds) {
            (true, _) => HseFailure::Seen,
            (false, true) => HseFailure::Unseen,
            (false, false) => HseFailure::None,
        }
    }

    /// Whether the clock security system asks for an NMI.
    #[must_use]
    pub fn nmi(&self) -> bool {
        self.hse_failed
    }

    /// The system clock in use (SWS): what SW asks for, if it is ready.
    fn switched(&self, now_ps: u64) -> u32 {
        match self.cfgr & 3 {
            1 if self.hse.ready(now_ps) => 1,
            2 if self.plls[0].ready(now_ps) => 2,
            // Requested but not ready: the previous clock continues. Everything starts from HSI.
            _ => 0,
        }
    }

    /// Whether the PLLs' source is HSE.
    fn pll_takes_hse(&self) -> bool {
        match self.chip.family {
            Family::F1 => self.cfgr & f1::PLLSRC != 0,
            Family::F4 => self.pllcfgr & PLLSRC != 0,
        }
    }

    /// Input frequency of the PLLs in Hz.
    fn pll_source(&self) -> u64 {
        if self.pll_takes_hse() {
            self.hse_hz
        } else {
            self.chip.hsi_hz
        }
    }

    /// Frequency of the main PLL's output P in Hz (6.3.2).
    #[must_use]
    pub fn pll_p(&self) -> u64 {
        if self.chip.family == Family::F1 {
            return self.pll_f1().1;
        }
        let m = u64::from(self.pllcfgr & 0x3F).max(1);
        let n = u64::from(self.pllcfgr >> 6 & 0x1FF);
        let p = 2 * (u64::from(self.pllcfgr >> 16 & 3) + 1);
        self.pll_source() * n / m / p
    }

    /// What is wrong with the PLL that feeds the system, by the limits of 6.3.2 and the data sheet.
    #[must_use]
    pub fn pll_fault(&self, now_ps: u64) -> Option<String> {
        if self.switched(now_ps) != 2 {
            return None;
        }
        if self.chip.family == Family::F1 {
            return self.pll_fault_f1();
        }
        let m = u64::from(self.pllcfgr & 0x3F);
        let n = u64::from(self.pllcfgr >> 6 & 0x1FF);
        if m < 2 || !(50..=432).contains(&n) {
            return Some(format!("PLLM {m} or PLLN {n} is out of range"));
        }
        let input = self.pll_source() / m;
        let vco = self.pll_source() * n / m;
        if !(950_000..=2_100_000).contains(&input) {
            return Some(format!(
                "PLL input of {input} Hz, allowed are 0.95 to 2.1 MHz"
            ));
        }
        (!(100_000_000..=432_000_000).contains(&vco))
            .then(|| format!("PLL VCO at {vco} Hz, allowed are 100 to 432 MHz"))
    }

    /// The frequencies in effect at a local time in ps.
    #[must_use]
    pub fn clocks(&self, now_ps: u64) -> Clocks {
        let sysclk = match self.switched(now_ps) {
            1 => self.hse_hz,
            2 => self.pll_p(),
            _ => self.chip.hsi_hz,
        };
        let hclk = sysclk
            / match self.cfgr >> 4 & 0xF {
                hpre @ 8..=11 => 1 << (hpre - 7),
                hpre @ 12..=15 => 1 << (hpre - 6),
                _ => 1,
            };
        let divider = |ppre: u32| if ppre < 4 { 1 } else { 1 << (ppre - 3) };
        // PPRE1; PPRE2 is behind it.
        let ppre = match self.chip.family {
            Family::F1 => 8,
            Family::F4 => 10,
        };
        let field = |at: u32| divider(self.cfgr >> at & 7);
        let (d1, d2) = (field(ppre), field(ppre + 3));
        // 6.2: timers run at twice the bus clock when it is divided; with TIMPRE at four times, up
        // to HCLK.
        let timpre = self.banks[0x8C / 4] >> 24 & 1 != 0;
        let timer = |d: u64| match (timpre, d) {
            (false, 1) | (true, 1..=4) => hclk,
            (false, d) => hclk / d * 2,
            (true, d) => hclk / d * 4,
        };
        Clocks {
            sysclk,
            hclk,
            pclk1: hclk / d1,
            pclk2: hclk / d2,
            timer1: timer(d1),
            timer2: timer(d2),
        }
    }

    /// The clock that the converters divide, Hz: PCLK2, on an STM32F1 behind ADCPRE.
    #[must_use]
    pub fn adc_source(&self, pclk2: u64) -> u64 {
        match self.chip.family {
            Family::F1 => self.adc_f1(pclk2),
            Family::F4 => pclk2,
        }
    }

    /// Where an STM32F4 has the register that is at this offset.
    fn place(&self, offset: u32) -> Option<u32> {
        match self.chip.family {
            Family::F1 => f1::place(offset),
            Family::F4 => Some(offset),
        }
    }

    /// Whether the register at an offset holds peripherals in reset.
    #[must_use]
    pub fn resets(&self, offset: u32) -> bool {
        self.place(offset)
            .is_some_and(|offset| (0x10..0x28).contains(&offset))
    }

    /// Name of the register at an offset.
    #[must_use]
    pub fn register_name(&self, offset: u32) -> &'static str {
        match self.place(offset).unwrap_or(u32::MAX) {
            reg::CR => "CR",
            reg::PLLCFGR => "PLLCFGR",
            reg::CFGR => "CFGR",
            reg::CIR => "CIR",
            0x10..=0x27 => "xxxRSTR",
            0x30..=0x47 => "xxxENR",
            0x50..=0x67 => "xxxLPENR",
            reg::BDCR => "BDCR",
            reg::CSR => "CSR",
            _ => "?",
        }
    }
}

mod f1;
#[cfg(test)]
mod tests;
