//! Flash interface (RM0390 rev 6, section 3; RM0090 rev 19, section 3, with more sectors): wait
//! states, key sequences, erase and program.
//!
//! The core reads the array directly as memory; this file handles the writes. An operation takes
//! the data sheet's typical time (DS10693 rev 10, table 49). Because the chip has one bank, nothing
//! can be read from it during that time: a core that fetches an instruction, a vector or a constant
//! there stalls, interrupts wait, and only the peripherals keep running. Code in RAM that reads
//! nothing of the flash runs on. A reset in the middle of an erase leaves the first half of the
//! sector erased and the rest unchanged, which is one of the possible outcomes of real flash.
//!
//! Operations are counted from power-on, and the power can be made to fail in the middle of any of
//! them: an erase then ends as with a reset, and a program operation has written the lower half of
//! its bytes. Option bytes are left erased, which is the worst that can happen to them: read
//! protection at level 1, no brown-out reset. The model has no cells between 0 and 1, which would
//! read differently from time to time.

use std::sync::Arc;

use rsemu::core::space::RamStore;

use crate::chip::{Chip, Sector};
use crate::family::Family;

const MS: u64 = 1_000_000_000; // ps
/// Time to erase and program the option bytes: that of a sector of 16 KiB at 32 bits; the data
/// sheet gives none.
const OPTIONS_MS: u64 = 250;
/// Typical time of one program operation, any width: 16 us.
const PROGRAM_PS: u64 = 16_000_000;

const SR_EOP: u32 = 1;
const SR_OPERR: u32 = 1 << 1;
const SR_WRPERR: u32 = 1 << 4;
const SR_PGPERR: u32 = 1 << 6;
const SR_PGSERR: u32 = 1 << 7;
const SR_BSY: u32 = 1 << 16;
/// OPTCR: locked, begin to program.
const OPTLOCK: u32 = 1;
const OPTSTRT: u32 = 1 << 1;
/// Option bytes of a chip as it comes from the factory (3.6, table 8): brown-out reset off.
pub const OPTIONS_FROM_FACTORY: u32 = 0x0FFF_AAEC;
/// The same after a robot's first start: brown-out reset at level 3.
pub const OPTIONS_ON_A_ROBOT: u32 = 0x0FFF_AAE0;
/// Erased option bytes: no write protection, brown-out reset off, read protection at level 1.
pub const OPTIONS_ERASED: u32 = 0x0FFF_FFEC;
/// The value of RDP, bits 8 to 15, for no read protection (3.6.3).
const UNPROTECTED: u32 = 0xAA;
/// ACR: prefetch.
const PRFTEN: u32 = 1 << 8;
const CR_PG: u32 = 1;
const CR_SER: u32 = 1 << 1;
const CR_MER: u32 = 1 << 2;
const CR_STRT: u32 = 1 << 16;
const CR_EOPIE: u32 = 1 << 24;
const CR_ERRIE: u32 = 1 << 25;
const CR_LOCK: u32 = 1 << 31;

/// The flash interface and its array.
#[derive(Debug, Clone)]
pub struct Flash {
    chip: &'static Chip,
    array: Arc<RamStore>,
    /// How many times the content of the array has changed.
    changes: u64,
    acr: u32,
    /// Where an STM32F1 erases: AR.
    address: u32,
    cr: u32,
    sr: u32,
    optcr: u32,
    /// What the option bytes hold, and where the sequence of their keys stands.
    options: u32,
    option_keys: u8,
    keys: u8,
    locked_out: bool,
    busy_until: u64,
    /// How many times as long as it should everything takes.
    factor: u64,
    /// How many times as long, on top of that, a word takes.
    program_factor: u64,
    erase: Option<Sector>,
    /// Option bytes under way.
    option_write: Option<u32>,
    operations: Operations,
    /// What each operation would leave if the power failed in it, while that is recorded.
    cuts: Option<Vec<Vec<u8>>>,
}

/// Program and erase operations begun since power-on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FlashOperations {
    /// Words programmed, of any width.
    pub programs: u64,
    /// Sectors erased; a mass erase counts as one.
    pub erases: u64,
    /// Times the option bytes were programmed.
    pub options: u64,
}

/// What has been done, and when the power fails.
#[derive(Debug, Clone, Copy, Default)]
struct Operations {
    done: FlashOperations,
    cut_at: Option<u64>,
    cut: bool,
}

impl Operations {
    /// Whether the power fails in the operation that has just been counted.
    fn fails(&mut self) -> bool {
        let FlashOperations {
            programs,
            erases,
            options,
        } = self.done;
        let fails = self.cut_at == Some(programs + erases + options);
        self.cut |= fails;
        fails
    }
}

impl Flash {
    /// The interface of a chip to its array, after reset.
    #[must_use]
    pub fn new(chip: &'static Chip, array: Arc<RamStore>) -> Self {
        Self {
            chip,
            array,
            changes: 0,
            // PM0075 3.1: the prefetch of an STM32F1 is on.
            acr: match chip.family {
                Family::F1 => PRFTEN,
                Family::F4 => 0,
            },
            address: 0,
            cr: CR_LOCK,
            sr: 0,
            optcr: OPTIONS_ON_A_ROBOT | OPTLOCK,
            options: OPTIONS_ON_A_ROBOT,
            option_keys: 0,
            keys: 0,
            locked_out: false,
            busy_until: 0,
            factor: 1,
            program_factor: 1,
            erase: None,
            option_write: None,
            operations: Operations::default(),
            cuts: None,
        }
    }

    /// Exchanges the array for a copy of it.
    pub(crate) fn set_array(&mut self, array: Arc<RamStore>) {
        self.array = array;
    }

    /// Makes programming and erasing take so many times as long.
    pub fn set_factors(&mut self, times: u64, program: u64) {
        self.factor = times;
        self.program_factor = program;
    }

    /// How much has been done since power-on.
    #[must_use]
    pub fn operations(&self) -> FlashOperations {
        self.operations.done
    }

    /// Lets the power fail in the middle of an operation, counted from power-on, the first being 1.
    pub fn cut_power_at(&mut self, operation: u64) {
        self.operations.cut_at = Some(operation);
    }

    /// Begins to record what a power failure in each operation from now on would leave.
    pub fn record_cuts(&mut self) {
        self.cuts = Some(Vec::new());
    }

    /// What has been recorded: the whole array, once for each operation. Ends the recording.
    pub fn take_cuts(&mut self) -> Vec<Vec<u8>> {
        self.cuts.take().unwrap_or_default()
    }

    /// Records the array with `part` at `offset`.
    fn record_cut(&mut self, offset: u64, part: &[u8]) {
        let Some(cuts) = &mut self.cuts else {
            return;
        };
        let mut content = vec![0; self.array.len() as usize];
        // The array has this size, and the part lies in it.
        let _ = self.array.read_at(0, &mut content);
        let to = content.iter_mut().skip(offset as usize);
        to.zip(part).for_each(|(to, from)| *to = *from);
        cuts.push(content);
    }

    /// Whether the power has failed.
    #[must_use]
    pub fn power_is_cut(&self) -> bool {
        self.operations.cut
    }

    /// A system reset; an erase that was under way is left half done.
    pub fn reset(&mut self) {
        if let Some(erase) = self.erase.take() {
            self.blank(erase.start, erase.length / 2);
        }
        *self = Self {
            changes: self.changes,
            options: self.options,
            optcr: self.options | OPTLOCK,
            operations: self.operations,
            cuts: self.cuts.take(),
            factor: self.factor,
            program_factor: self.program_factor,
            ..Self::new(self.chip, Arc::clone(&self.array))
        };
    }

    /// Finishes what has finished by a local time in ps.
    pub fn sync(&mut self, now_ps: u64) {
        if self.sr & SR_BSY != 0 && now_ps >= self.busy_until {
            self.sr &= !SR_BSY;
            self.cr &= !CR_STRT;
            if self.cr & CR_EOPIE != 0 || self.chip.family == Family::F1 {
                self.sr |= SR_EOP;
            }
            if let Some(erase) = self.erase.take() {
                self.blank(erase.start, erase.length);
            }
            if let Some(options) = self.option_write.take() {
                let level_0 = |options: u32| options >> 8 & 0xFF == UNPROTECTED;
                if level_0(options) && !level_0(self.options) {
                    // 3.6.3: giving up the protection erases the whole flash.
                    self.blank(0, self.array.len());
                }
                self.options = options;
                self.optcr &= !OPTSTRT;
            }
        }
    }

    /// Erases a part of the array, which the array has.
    fn blank(&mut self, start: u64, length: u64) {
        self.changes += 1;
        let _ = self.array.fill(start, length, 0xFF);
    }

    /// Gives a part of the array another content. The bus has checked that the array has it.
    fn store(&mut self, offset: u64, content: &[u8]) {
        self.changes += 1;
        let _ = self.array.write_at(offset, content);
    }

    /// How many times the content of the array has changed since power-on.
    #[must_use]
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// Local time in ps at which the operation under way ends.
    #[must_use]
    pub fn busy_until(&self) -> Option<u64> {
        (self.sr & SR_BSY != 0).then_some(self.busy_until)
    }

    /// Interrupt line.
    #[must_use]
    pub fn line(&self) -> bool {
        let errors = self.sr & (SR_OPERR | SR_WRPERR | SR_PGPERR | SR_PGSERR) != 0;
        (self.sr & SR_EOP != 0 && self.cr & CR_EOPIE != 0) || (errors && self.cr & CR_ERRIE != 0)
    }

    /// The access control register: wait states, prefetch, caches.
    #[must_use]
    pub fn acr(&self) -> u32 {
        self.acr
    }

    /// Wait states in use.
    #[must_use]
    pub fn wait_states(&self) -> u32 {
        self.acr & 0xF
    }

    /// The highest core clock in Hz that the wait states allow at a supply in V (3.4.1, table 6).
    #[must_use]
    pub fn max_hclk(&self, vdd: f64) -> u64 {
        let step = match vdd {
            // PM0075 3.1, at any supply.
            _ if self.chip.family == Family::F1 => 24_000_000,
            2.7.. => 30_000_000,
            2.4.. => 24_000_000,
            2.1.. => 22_000_000,
            _ => 20_000_000,
        };
        step * u64::from(self.wait_states() + 1)
    }

    /// Sets what the option bytes hold, as a programmer does before power-on.
    pub fn set_options(&mut self, options: u32) {
        self.options = options & !(OPTLOCK | OPTSTRT);
        self.optcr = self.options | OPTLOCK;
    }

    /// What the option bytes hold, in the places of OPTCR.
    #[must_use]
    pub fn options(&self) -> u32 {
        self.options
    }

    /// Supply in V below which the brown-out reset comes, and above which it ends: typical by
    /// BOR_LEV (data sheet DS10693 rev 10, table 24). Power-down reset where it is off.
    #[must_use]
    pub fn brown_out(&self) -> (f64, f64) {
        match self.options >> 2 & 3 {
            // DS5792 rev 13, table 12: power-down reset alone.
            _ if self.chip.family == Family::F1 => (1.88, 1.92),
            0 => (2.83, 2.92),
            1 => (2.50, 2.59),
            2 => (2.19, 2.29),
            _ => (1.68, 1.72),
        }
    }

    /// Reads a register; `None` for an offset without one.
    pub fn read(&mut self, now_ps: u64, offset: u32) -> Option<u32> {
        self.sync(now_ps);
        if self.chip.family == Family::F1 {
            return self.read_f1(offset);
        }
        Some(match offset {
            0x00 => self.acr,
            0x04 | 0x08 => 0,
            0x0C => self.sr,
            0x10 => self.cr,
            0x14 => self.optcr,
            _ => return None,
        })
    }

    /// Writes a register; `None` for an offset without one.
    pub fn write(&mut self, now_ps: u64, offset: u32, value: u32) -> Option<()> {
        self.sync(now_ps);
        if self.chip.family == Family::F1 {
            return self.write_f1(now_ps, offset, value);
        }
        match offset {
            0x00 => self.acr = value & 0x1F0F,
            0x04 => self.write_key(value),
            // Flags are cleared by writing one.
            0x0C => self.sr &= !(value & 0x1F3),
            0x08 => self.write_option_key(value),
            0x10 => self.write_cr(now_ps, value),
            0x14 => self.write_optcr(now_ps, value),
            _ => return None,
        }
        Some(())
    }

    fn write_key(&mut self, key: u32) {
        self.keys = match (self.keys, key) {
            (0, 0x4567_0123) if !self.locked_out => 1,
            (1, 0xCDEF_89AB) => {
                self.cr &= !CR_LOCK;
                0
            }
            _ => {
                // 3.5.1: a wrong sequence locks until the next reset.
                self.locked_out = true;
                0
            }
        };
    }

    fn write_option_key(&mut self, key: u32) {
        self.option_keys = match (self.option_keys, key) {
            (0, 0x0819_2A3B) => 1,
            (1, 0x4C5D_6E7F) => {
                self.optcr &= !OPTLOCK;
                0
            }
            _ => 0,
        };
    }

    /// 3.6.2: what is written is programmed when OPTSTRT is set. A reset before the end of it is
    /// taken to leave what was there, which is the kind one of the outcomes that real option bytes
    /// have; a loss of power the unkind one.
    fn write_optcr(&mut self, now_ps: u64, value: u32) {
        if self.optcr & OPTLOCK != 0 || self.sr & SR_BSY != 0 {
            return;
        }
        self.optcr = value & 0x0FFF_FFEF;
        if value & OPTSTRT == 0 {
            return;
        }
        self.operations.done.options += 1;
        if self.operations.fails() {
            self.options = OPTIONS_ERASED;
            return;
        }
        self.option_write = Some(value & 0x0FFF_FFEC);
        self.sr |= SR_BSY;
        self.busy_until = now_ps + OPTIONS_MS * MS;
    }

    fn write_cr(&mut self, now_ps: u64, value: u32) {
        if self.cr & CR_LOCK != 0 || self.sr & SR_BSY != 0 {
            return;
        }
        self.cr = value & 0x8301_03FF;
        if value & CR_STRT == 0 || value & (CR_SER | CR_MER) == 0 {
            return;
        }
        // Typical erase times by parallelism: x8, x16, x32 (and x64, which needs an external
        // voltage).
        let column = (value >> 8 & 3).min(2) as usize;
        let (start, length, ms) = if value & CR_MER != 0 {
            (0, self.array.len(), self.chip.mass_erase_ms[column])
        } else {
            let sector = self.chip.sectors.get((value >> 3 & 0xF) as usize);
            let Some(&Sector { start, length }) = sector else {
                self.sr |= SR_OPERR;
                return;
            };
            let times = match length {
                0x4000 => [400, 300, 250],
                0x1_0000 => [1200, 700, 550],
                _ => [2000, 1300, 1000],
            };
            (start, length, times[column])
        };
        self.erase(now_ps, Sector { start, length }, ms);
    }

    /// Begins to erase.
    fn erase(&mut self, now_ps: u64, sector: Sector, ms: u64) {
        let Sector { start, length } = sector;
        self.operations.done.erases += 1;
        self.record_cut(start, &vec![0xFF; length as usize / 2]);
        if self.operations.fails() {
            self.blank(start, length / 2);
            return;
        }
        self.erase = Some(sector);
        self.sr |= SR_BSY;
        self.busy_until = now_ps + ms * MS * self.factor;
    }

    /// A write to the array at an offset. Bits can only be cleared; what is not allowed sets an
    /// error flag and leaves the array alone (3.5.4). False for a bus error.
    pub fn program(&mut self, now_ps: u64, offset: u64, data: &[u8]) -> bool {
        self.sync(now_ps);
        if self.chip.family == Family::F1 {
            return self.program_f1(now_ps, offset, data);
        }
        let width = 1_usize << (self.cr >> 8 & 3);
        if self.cr & CR_LOCK != 0 {
            self.sr |= SR_WRPERR;
        } else if self.cr & CR_PG == 0 || self.sr & SR_BSY != 0 {
            self.sr |= SR_PGSERR;
        } else if data.len() != width {
            self.sr |= SR_PGPERR;
        } else {
            self.clear_bits(now_ps, offset, data, PROGRAM_PS);
        }
        true
    }

    /// Begins to program: clears the bits that are clear in `data`.
    fn clear_bits(&mut self, now_ps: u64, offset: u64, data: &[u8], ps: u64) {
        let mut old = [0xFF_u8; 8];
        let old = &mut old[..data.len()];
        let _ = self.array.read_at(offset, old);
        self.operations.done.programs += 1;
        let half: Vec<u8> = old
            .iter()
            .zip(data)
            .take(data.len() / 2)
            .map(|(old, new)| old & new)
            .collect();
        self.record_cut(offset, &half);
        if self.operations.fails() {
            self.store(offset, &half);
        } else {
            old.iter_mut().zip(data).for_each(|(old, new)| *old &= new);
            self.store(offset, old);
        }
        self.sr |= SR_BSY;
        self.busy_until = now_ps + ps * self.factor * self.program_factor;
    }

    /// Name of the register at an offset.
    #[must_use]
    pub fn register_name(&self, offset: u32) -> &'static str {
        if self.chip.family == Family::F1 {
            return f1::register_name(offset);
        }
        match offset {
            0x00 => "ACR",
            0x04 => "KEYR",
            0x08 => "OPTKEYR",
            0x0C => "SR",
            0x10 => "CR",
            0x14 => "OPTCR",
            _ => "?",
        }
    }
}

mod f1;
#[cfg(test)]
mod tests;
