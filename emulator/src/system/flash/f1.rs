//! The registers of an STM32F1's flash interface (PM0075 rev 2, sections 2 and 3): half-words are
//! programmed and pages of 2 KiB erased, a page by an address in it. The state is that of the
//! parent: each bit here has a counterpart there.
//!
//! A half-word takes its typical time, a page the longest that the data sheet allows (DS5792 rev
//! 13, table 41: 52.5 us, 20 to 40 ms without a typical value).
//!
//! Not modelled: the option bytes, which read as those of a factory chip and cannot be unlocked;
//! the bus error after a wrong key.

use super::{
    CR_EOPIE, CR_ERRIE, CR_LOCK, CR_MER, CR_PG, CR_SER, CR_STRT, Flash, PRFTEN, SR_BSY, SR_EOP,
    SR_PGSERR, SR_WRPERR,
};
use crate::chip::Sector;
use crate::memory_map::FLASH_BASE;

const ERASE_MS: u64 = 40;
const PROGRAM_PS: u64 = 52_500_000;

/// Bits of CR and SR with their counterparts: PG, PER, MER, STRT, LOCK, ERRIE, EOPIE; BSY, PGERR,
/// WRPRTERR, EOP.
const CR: [(u32, u32); 7] = [
    (0, CR_PG),
    (1, CR_SER),
    (2, CR_MER),
    (6, CR_STRT),
    (7, CR_LOCK),
    (10, CR_ERRIE),
    (12, CR_EOPIE),
];
const SR: [(u32, u32); 4] = [(0, SR_BSY), (2, SR_PGSERR), (4, SR_WRPERR), (5, SR_EOP)];
/// OPTPG and OPTER.
const OPTIONS: u32 = 1 << 4 | 1 << 5;
/// ACR: wait states, and prefetch with its status beside it.
const LATENCY: u32 = 7;
const PRFTBE: u32 = 1 << 4;
const PRFTBS: u32 = 1 << 5;

fn seen(state: u32, bits: &[(u32, u32)]) -> u32 {
    let set = bits.iter().filter(|(_, other)| state & other != 0);
    set.map(|(bit, _)| 1 << bit).sum()
}

fn meant(value: u32, bits: &[(u32, u32)]) -> u32 {
    let set = bits.iter().filter(|(bit, _)| value >> bit & 1 != 0);
    set.map(|(_, other)| other).sum()
}

impl Flash {
    pub(super) fn read_f1(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 if self.acr & PRFTEN != 0 => self.acr & LATENCY | PRFTBE | PRFTBS,
            0x00 => self.acr & LATENCY,
            0x0C => seen(self.sr, &SR),
            0x10 => seen(self.cr, &CR),
            0x04 | 0x08 | 0x14 => 0,
            // OBR and WRPR of a chip from the factory.
            0x1C => 0x03FF_FFFC,
            0x20 => 0xFFFF_FFFF,
            _ => return None,
        })
    }

    pub(super) fn write_f1(&mut self, now_ps: u64, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => {
                let prefetch = if value & PRFTBE != 0 { PRFTEN } else { 0 };
                self.acr = value & LATENCY | prefetch;
            }
            0x04 => self.write_key(value),
            // Flags are cleared by writing one.
            0x0C => self.sr &= !(meant(value, &SR) & !SR_BSY),
            0x10 if value & OPTIONS != 0 => return None,
            0x10 => self.write_cr_f1(now_ps, value),
            0x14 if self.sr & SR_BSY == 0 => self.address = value,
            0x14 => {}
            _ => return None,
        }
        Some(())
    }

    fn write_cr_f1(&mut self, now_ps: u64, value: u32) {
        if self.cr & CR_LOCK != 0 || self.sr & SR_BSY != 0 {
            return;
        }
        self.cr = meant(value, &CR);
        if self.cr & CR_STRT == 0 {
            return;
        }
        let at = u64::from(self.address.wrapping_sub(FLASH_BASE));
        let page = |sector: &&Sector| at.wrapping_sub(sector.start) < sector.length;
        let erased = if self.cr & CR_MER != 0 {
            Some(Sector {
                start: 0,
                length: self.array.len(),
            })
        } else if self.cr & CR_SER != 0 {
            self.chip.sectors.iter().find(page).copied()
        } else {
            None
        };
        match erased {
            Some(sector) => self.erase(now_ps, sector, ERASE_MS),
            None => self.cr &= !CR_STRT,
        }
    }

    /// A store to the array. A store of another width is a bus error (2.3.3); so is one without PG
    /// here, which the manual leaves open. A half-word that is not erased is left alone, unless it
    /// is to become 0.
    pub(super) fn program_f1(&mut self, now_ps: u64, offset: u64, data: &[u8]) -> bool {
        if data.len() != 2 || self.cr & CR_LOCK != 0 || self.cr & CR_PG == 0 {
            return false;
        }
        let mut old = [0; 2];
        let _ = self.array.read_at(offset, &mut old);
        if self.sr & SR_BSY != 0 || (old != [0xFF; 2] && data != [0; 2]) {
            self.sr |= SR_PGSERR;
        } else {
            self.clear_bits(now_ps, offset, data, PROGRAM_PS);
        }
        true
    }
}

pub(super) fn register_name(offset: u32) -> &'static str {
    match offset {
        0x00 => "ACR",
        0x04 => "KEYR",
        0x08 => "OPTKEYR",
        0x0C => "SR",
        0x10 => "CR",
        0x14 => "AR",
        0x1C => "OBR",
        0x20 => "WRPR",
        _ => "?",
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rsemu::core::space::RamStore;

    use super::*;
    use crate::chip::F103;

    const PG: u32 = 1;
    const PER: u32 = 2;
    const STRT: u32 = 1 << 6;
    const BSY: u32 = 1;
    const PGERR: u32 = 1 << 2;
    const EOP: u32 = 1 << 5;

    /// An array of zeros, unlocked.
    fn flash() -> (Flash, Arc<RamStore>) {
        let array = Arc::new(RamStore::new(F103.flash_size()));
        array.fill(0, array.len(), 0).unwrap();
        let mut flash = Flash::new(&F103, Arc::clone(&array));
        assert_eq!(flash.read(0, 0x10), Some(0x80), "locked");
        for key in [0x4567_0123, 0xCDEF_89AB] {
            flash.write(0, 0x04, key).unwrap();
        }
        assert_eq!(flash.read(0, 0x10), Some(0));
        (flash, array)
    }

    fn erase(flash: &mut Flash, now_ps: u64, address: u32) -> u64 {
        flash.write(now_ps, 0x10, PER).unwrap();
        flash.write(now_ps, 0x14, address).unwrap();
        flash.write(now_ps, 0x10, PER | STRT).unwrap();
        flash.busy_until().expect("under way")
    }

    fn bytes<const N: usize>(array: &RamStore, at: u64) -> [u8; N] {
        std::array::from_fn(|index| array.read_u8(at + index as u64).unwrap())
    }

    #[test]
    fn a_page_is_erased_by_an_address_in_it_in_40_ms() {
        let (mut flash, array) = flash();
        let done = erase(&mut flash, 0, FLASH_BASE + 0x1003);
        assert_eq!(done, 40_000_000_000);
        assert_eq!(flash.read(done - 1, 0x0C), Some(BSY));
        assert_eq!(bytes(&array, 0x1000), [0]);
        assert_eq!(flash.read(done, 0x0C), Some(EOP));
        assert_eq!(bytes(&array, 0xFFF), [0, 0xFF]);
        assert_eq!(bytes(&array, 0x17FF), [0xFF, 0]);
        flash.write(done, 0x0C, EOP).unwrap();
        assert_eq!(flash.read(done, 0x0C), Some(0));
        assert_eq!(flash.operations().erases, 1);
    }

    #[test]
    fn an_address_outside_the_flash_erases_nothing() {
        let (mut flash, _) = flash();
        flash.write(0, 0x14, FLASH_BASE + (256 << 10)).unwrap();
        flash.write(0, 0x10, PER | STRT).unwrap();
        assert_eq!(flash.busy_until(), None);
    }

    #[test]
    fn half_words_are_programmed_where_they_are_erased() {
        let (mut flash, array) = flash();
        let now = erase(&mut flash, 0, FLASH_BASE);
        flash.sync(now);
        assert!(!flash.program(now, 0, &[1, 2]), "without PG");
        flash.write(now, 0x10, PG).unwrap();
        assert!(!flash.program(now, 0, &[1]));
        assert!(!flash.program(now, 0, &[1, 2, 3, 4]));
        assert!(flash.program(now, 0, &[1, 2]));
        let done = flash.busy_until().unwrap();
        assert_eq!(done - now, 52_500_000);
        assert_eq!(flash.read(done, 0x0C).unwrap() & PGERR, 0);
        assert!(
            flash.program(done, 0, &[1, 0]),
            "bits that could be cleared"
        );
        assert_eq!(flash.read(done, 0x0C).unwrap() & PGERR, PGERR);
        assert_eq!(bytes(&array, 0), [1, 2, 0xFF]);
        flash.write(done, 0x0C, PGERR).unwrap();
        assert!(flash.program(done, 0, &[0, 0]), "0 is always possible");
        assert_eq!(flash.read(done, 0x0C).unwrap() & PGERR, 0);
        assert_eq!(bytes(&array, 0), [0, 0, 0xFF]);
        assert_eq!(flash.operations().programs, 2);
    }

    #[test]
    fn power_that_fails_leaves_one_byte_of_two_and_half_of_a_page() {
        let (mut flash, array) = flash();
        flash.cut_power_at(1);
        flash.write(0, 0x10, PER).unwrap();
        flash.write(0, 0x14, FLASH_BASE).unwrap();
        flash.write(0, 0x10, PER | STRT).unwrap();
        assert!(flash.power_is_cut());
        assert_eq!(bytes(&array, 0x3FF), [0xFF, 0]);
        flash.write(0, 0x10, PG).unwrap();
        flash.cut_power_at(2);
        flash.program(0, 0, &[1, 2]);
        assert_eq!(bytes(&array, 0), [1, 0xFF]);
    }

    #[test]
    fn wait_states_allow_24_mhz_each() {
        let (mut flash, _) = flash();
        assert_eq!(flash.read(0, 0), Some(0x30), "prefetch is on after reset");
        assert_eq!(flash.max_hclk(3.3), 24_000_000);
        flash.write(0, 0, 2).unwrap();
        assert_eq!(
            (flash.read(0, 0), flash.max_hclk(2.0)),
            (Some(2), 72_000_000)
        );
    }

    #[test]
    fn option_bytes_are_refused() {
        let (mut flash, _) = flash();
        assert_eq!(flash.write(0, 0x08, 0x4567_0123), None);
        assert_eq!(flash.write(0, 0x10, 1 << 4), None);
    }
}
