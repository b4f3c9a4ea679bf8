//! Writing flash, and the eight pages at its end that belong to the parameters (PM0075 rev 2;
//! `memory/` has the map).
//!
//! The chip has one bank: while a half-word is programmed (40 to 70 us) or a page erased (20 to 40
//! ms, DS5792 rev 13 table 29) it executes nothing that lies in flash. For that long no interrupt
//! is served, and frames that do not fit into the CAN controller's FIFO are lost; the local time
//! goes on. Between the operations interrupts are served, but no other task of the bus executor
//! runs. So writing may be done only while the outputs are off, and the watchdog, which cannot be
//! stopped, is given more time by [`patiently`](crate::board::stm32::iwdg::patiently). Reading takes
//! no longer than reading RAM.
//!
//! A word is two half-words, the lower one first. A cut of power in between leaves a word of which
//! half is blank; to the store that is an unfinished record, like any other word half programmed.

#![expect(
    unsafe_code,
    reason = "flash is memory that is read and written by address"
)]

use embassy_stm32::pac;
use robot::record_store::{Flash, StoreError};

/// Bytes of a page, and pages of a sector of the store.
const PAGE: u32 = 0x800;
const PAGES: u32 = 4;

/// Where the first sector is: `__parameters_start` in `memory/`.
const ADDRESS: u32 = 0x0803_C000;

/// The last eight pages.
pub struct ParameterFlash(());

impl ParameterFlash {
    /// Takes the flash interface.
    pub fn new() -> Self {
        Self(())
    }
}

impl Flash for ParameterFlash {
    const SECTOR: u32 = PAGES * PAGE;

    fn word(&self, at: u32) -> u32 {
        // SAFETY: the address is a word of one of the two sectors, which are always readable.
        address(at).map_or(u32::MAX, |from| unsafe { from.read_volatile() })
    }

    fn program(&mut self, at: u32, word: u32) -> Result<(), StoreError> {
        let to = address(at).ok_or(StoreError)?.cast::<u16>();
        unlock();
        pac::FLASH.cr().write(|w| w.set_pg(true));
        let [a, b, c, d] = word.to_le_bytes();
        let mut result = Ok(());
        for (half, bits) in [[a, b], [c, d]].into_iter().enumerate() {
            // SAFETY: the address is a half of a word of one of the two sectors, where neither code
            // nor constants lie. With PG set the write programs it, and the core waits where it
            // needs the flash.
            unsafe { to.add(half).write_volatile(u16::from_le_bytes(bits)) };
            result = result.and(finished());
        }
        lock();
        result
    }

    fn erase(&mut self, at: u32) -> Result<(), StoreError> {
        let first = if at >= Self::SECTOR { Self::SECTOR } else { 0 };
        let mut result = Ok(());
        for page in 0..PAGES {
            unlock();
            pac::FLASH.cr().write(|w| w.set_per(true));
            pac::FLASH
                .ar()
                .write(|w| w.set_far(ADDRESS + first + page * PAGE));
            pac::FLASH.cr().write(|w| {
                w.set_per(true);
                w.set_strt(true);
            });
            result = result.and(finished());
            lock();
        }
        result
    }
}

/// Where a word of the two sectors is; none for what is not in them.
fn address(at: u32) -> Option<*mut u32> {
    let is_inside = at < 2 * ParameterFlash::SECTOR && at.is_multiple_of(4);
    is_inside.then_some((ADDRESS + at) as *mut u32)
}

/// Permits an operation (2.3.1), with the flags of the last one cleared.
fn unlock() {
    if pac::FLASH.cr().read().lock() {
        pac::FLASH.keyr().write(|w| *w = 0x4567_0123);
        pac::FLASH.keyr().write(|w| *w = 0xCDEF_89AB);
    }
    // Flags are cleared by writing one.
    pac::FLASH.sr().modify(|_| {});
}

/// Permits no other.
fn lock() {
    pac::FLASH.cr().write(|w| w.set_lock(true));
}

/// Waits for the end of an operation.
fn finished() -> Result<(), StoreError> {
    // The last write has reached the interface before BSY is read.
    cortex_m::asm::dsb();
    while pac::FLASH.sr().read().bsy() {}
    let status = pac::FLASH.sr().read();
    if status.pgerr() || status.wrprterr() {
        return Err(StoreError);
    }
    Ok(())
}
