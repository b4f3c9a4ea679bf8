//! Erase, program and option bytes against RM0390 rev 6, section 3.

use super::*;
use crate::chip::{F407, F446};

fn flash_of(chip: &'static Chip) -> (Flash, Arc<RamStore>) {
    let array = Arc::new(RamStore::new(chip.flash_size()));
    array.fill(0, array.len(), 0).unwrap();
    (Flash::new(chip, Arc::clone(&array)), array)
}

fn flash() -> (Flash, Arc<RamStore>) {
    flash_of(&F446)
}

fn unlock(flash: &mut Flash) {
    flash.write(0, 4, 0x4567_0123).unwrap();
    flash.write(0, 4, 0xCDEF_89AB).unwrap();
}

fn byte(array: &RamStore, at: u64) -> u8 {
    array.read_u8(at).unwrap()
}

const ERASE_SECTOR_1_X32: u32 = CR_SER | 1 << 3 | 2 << 8 | CR_STRT;

#[test]
fn option_bytes_are_programmed_behind_their_own_keys() {
    let (mut flash, _) = flash();
    flash.set_options(OPTIONS_FROM_FACTORY);
    assert_eq!(flash.read(0, 0x14), Some(0x0FFF_AAED));
    flash.write(0, 0x14, OPTIONS_ON_A_ROBOT | OPTSTRT).unwrap();
    assert_eq!(flash.busy_until(), None, "locked");
    flash.write(0, 8, 0x0819_2A3B).unwrap();
    flash.write(0, 8, 0x4C5D_6E7F).unwrap();
    flash.write(0, 0x14, OPTIONS_ON_A_ROBOT).unwrap();
    flash.write(0, 0x14, OPTIONS_ON_A_ROBOT | OPTSTRT).unwrap();
    let done = flash.busy_until().expect("it takes its time");
    assert_eq!(flash.options(), OPTIONS_FROM_FACTORY);
    assert_eq!(flash.read(done, 0x0C), Some(0));
    assert_eq!(flash.options(), OPTIONS_ON_A_ROBOT);
    assert_eq!(flash.brown_out().0, 2.83);
}

/// Programs these option bytes and waits for the end.
fn program_options(flash: &mut Flash, options: u32) {
    flash.write(0, 8, 0x0819_2A3B).unwrap();
    flash.write(0, 8, 0x4C5D_6E7F).unwrap();
    flash.write(0, 0x14, options).unwrap();
    flash.write(0, 0x14, options | OPTSTRT).unwrap();
    if let Some(done) = flash.busy_until() {
        flash.sync(done);
    }
}

#[test]
fn power_that_fails_leaves_erased_option_bytes_and_giving_up_protection_erases_the_flash() {
    let (mut flash, array) = flash();
    flash.set_options(OPTIONS_FROM_FACTORY);
    flash.cut_power_at(1);
    program_options(&mut flash, OPTIONS_ON_A_ROBOT);
    assert!(flash.power_is_cut());
    assert_eq!(flash.options(), OPTIONS_ERASED);
    assert_eq!(flash.brown_out().0, 1.68);
    // Another level of the brown-out reset, and the protection as it is.
    program_options(&mut flash, OPTIONS_ERASED & !0xC);
    assert_eq!((flash.brown_out().0, byte(&array, 0)), (2.83, 0));
    program_options(&mut flash, OPTIONS_ON_A_ROBOT);
    assert_eq!(byte(&array, 0), 0xFF);
}

#[test]
fn erases_one_sector_in_its_time() {
    let (mut flash, array) = flash();
    unlock(&mut flash);
    flash.write(0, 0x10, ERASE_SECTOR_1_X32).unwrap();
    assert_eq!(flash.busy_until(), Some(250 * MS));
    assert_eq!(flash.read(250 * MS - 1, 0x0C), Some(SR_BSY));
    assert_eq!(flash.read(250 * MS, 0x0C), Some(0));
    assert_eq!((byte(&array, 0x3FFF), byte(&array, 0x4000)), (0, 0xFF));
    assert_eq!((byte(&array, 0x7FFF), byte(&array, 0x8000)), (0xFF, 0));
}

#[test]
fn programs_words_and_only_clears_bits() {
    let (mut flash, array) = flash();
    unlock(&mut flash);
    flash.write(0, 0x10, ERASE_SECTOR_1_X32).unwrap();
    flash.write(250 * MS, 0x10, CR_PG | 2 << 8).unwrap();
    flash.program(250 * MS, 0x4000, &[0x12, 0x34, 0x56, 0x78]);
    flash.program(300 * MS, 0x4000, &[0xF0, 0xFF, 0xFF, 0xFF]);
    assert_eq!(byte(&array, 0x4000), 0x10);
    assert_eq!(byte(&array, 0x4003), 0x78);
}

#[test]
fn refuses_while_locked_busy_or_with_the_wrong_width() {
    let (mut flash, array) = flash();
    flash.write(0, 0x10, ERASE_SECTOR_1_X32).unwrap();
    assert_eq!(flash.busy_until(), None, "locked");
    unlock(&mut flash);
    flash.write(0, 0x10, ERASE_SECTOR_1_X32).unwrap();
    flash.write(250 * MS, 0x10, CR_PG | 2 << 8).unwrap();
    flash.program(250 * MS, 0x4000, &[0, 0]);
    assert_eq!(flash.read(250 * MS, 0x0C), Some(SR_PGPERR));
    assert_eq!(byte(&array, 0x4000), 0xFF);
}

#[test]
fn a_wrong_key_locks_until_reset() {
    let (mut flash, _) = flash();
    flash.write(0, 4, 1).unwrap();
    unlock(&mut flash);
    assert_ne!(flash.read(0, 0x10).unwrap() & CR_LOCK, 0);
    flash.reset();
    unlock(&mut flash);
    assert_eq!(flash.read(0, 0x10).unwrap() & CR_LOCK, 0);
}

#[test]
fn the_power_fails_in_the_middle_of_the_operation_asked_for() {
    let (mut flash, array) = flash();
    flash.cut_power_at(2);
    unlock(&mut flash);
    flash.write(0, 0x10, ERASE_SECTOR_1_X32).unwrap();
    flash.write(250 * MS, 0x10, CR_PG | 2 << 8).unwrap();
    assert!(!flash.power_is_cut());
    flash.program(250 * MS, 0x4000, &[0x12, 0x34, 0x56, 0x78]);
    assert!(flash.power_is_cut());
    let word = [0, 1, 2, 3].map(|at| byte(&array, 0x4000 + at));
    assert_eq!(word, [0x12, 0x34, 0xFF, 0xFF]);
    let once = FlashOperations {
        programs: 1,
        erases: 1,
        options: 0,
    };
    assert_eq!(flash.operations(), once);
}

#[test]
fn a_reset_leaves_an_erase_half_done() {
    let (mut flash, array) = flash();
    unlock(&mut flash);
    flash.write(0, 0x10, ERASE_SECTOR_1_X32).unwrap();
    flash.reset();
    assert_eq!((byte(&array, 0x5FFF), byte(&array, 0x6000)), (0xFF, 0));
}

/// Sector 11 is the last of an STM32F407IG; an STM32F446 has none of this number.
#[test]
fn a_sector_that_a_chip_does_not_have_is_an_error() {
    for (chip, begun) in [(&F446, false), (&F407, true)] {
        let (mut flash, array) = flash_of(chip);
        unlock(&mut flash);
        let erase = CR_SER | 11 << 3 | 2 << 8 | CR_STRT;
        flash.write(0, 0x10, erase).unwrap();
        assert_eq!(flash.busy_until(), begun.then_some(1_000 * MS));
        let error = if begun { 0 } else { SR_OPERR };
        assert_eq!(flash.read(1_000 * MS, 0x0C), Some(error));
        if begun {
            let ends = [0xD_FFFF, 0xE_0000, 0xF_FFFF].map(|at| byte(&array, at));
            assert_eq!(ends, [0, 0xFF, 0xFF]);
        }
    }
}
