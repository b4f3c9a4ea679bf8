//! Writing flash, and the two sectors that belong to the parameters (RM0390 rev 6 section 3;
//! `memory/` has the map).
//!
//! The chip has one bank: while a word is programmed (16 us, 100 us at most) or a sector erased
//! (16 KiB: 250 ms typically, 500 ms at most at 32 bits parallelism, data sheet DS10693 rev 10
//! table 49) it executes nothing that lies in flash; only [`away`] lies in RAM. For that long no
//! interrupt is served, and frames that do not fit into the CAN controller's FIFO are lost; during
//! an erase the local time stands still. Between the operations interrupts are served, but no
//! other task of the bus executor runs. So flash is written only while the outputs are off, and
//! [`patiently`] gives more time to the watchdog, which cannot be stopped. Reading takes no longer
//! than reading RAM.
//!
//! [`away`]: crate::board::stm32::can::away
//! [`patiently`]: crate::board::stm32::iwdg::patiently

#![expect(
    unsafe_code,
    reason = "flash is memory that is read and written by address"
)]

use embassy_stm32::pac;
use embassy_stm32::pac::flash::vals::Psize;
use robot::record_store::{Flash, StoreError};

/// First sector of the two, and its address; `__parameters_start` in `memory/`.
const FIRST: u8 = 1;
const ADDRESS: u32 = 0x0800_4000;

/// Flash sectors 1 and 2.
pub struct ParameterFlash(());

impl ParameterFlash {
    /// Takes the flash interface.
    pub fn new() -> Self {
        Self(())
    }
}

impl Flash for ParameterFlash {
    const SECTOR: u32 = 0x4000;

    fn word(&self, at: u32) -> u32 {
        // SAFETY: the address is a word of one of the two sectors, which are always readable.
        address(at).map_or(u32::MAX, |from| unsafe { from.read_volatile() })
    }

    fn program(&mut self, at: u32, word: u32) -> Result<(), StoreError> {
        let to = address(at).ok_or(StoreError)?;
        // SAFETY: the address is a word of one of the two sectors, where neither code nor constants
        // lie.
        unsafe { program(to, word) }
    }

    fn erase(&mut self, at: u32) -> Result<(), StoreError> {
        erase(FIRST + u8::from(at >= Self::SECTOR), &mut || {
            pac::FLASH.cr().modify(|w| w.set_strt(true));
        })
    }
}

/// Programs a word of flash.
///
/// # Safety
/// `to` is a word of flash in which neither code nor constants of this program lie.
pub unsafe fn program(to: *mut u32, word: u32) -> Result<(), StoreError> {
    unlock();
    pac::FLASH.cr().write(|w| {
        w.set_psize(Psize::PSIZE32);
        w.set_pg(true);
    });
    // SAFETY: by the contract. With PG set the write programs the word, and the core waits where it
    // needs the flash.
    unsafe { to.write_volatile(word) };
    finish()
}

/// Erases a sector, which must have neither code nor constants of this program. `start` sets STRT
/// in FLASH_CR, from where the program waits for the end unless it is in RAM.
pub fn erase(sector: u8, start: &mut dyn FnMut()) -> Result<(), StoreError> {
    unlock();
    pac::FLASH.cr().write(|w| {
        w.set_psize(Psize::PSIZE32);
        w.set_ser(true);
        w.set_snb(sector);
    });
    // The local time counts this timer's overflows in an interrupt. If it missed some, the time
    // and the timer would be permanently half a period apart, and every alarm 33 ms off; the
    // time is therefore stopped.
    pac::TIM9.cr1().modify(|w| w.set_cen(false));
    start();
    let result = finish();
    pac::TIM9.cr1().modify(|w| w.set_cen(true));
    // 3.4.2: an erase does not update the data cache.
    pac::FLASH.acr().modify(|w| w.set_dcen(false));
    pac::FLASH.acr().modify(|w| w.set_dcrst(true));
    pac::FLASH.acr().modify(|w| w.set_dcrst(false));
    pac::FLASH.acr().modify(|w| w.set_dcen(true));
    result
}

/// Where a word of the two sectors is; none for what is not in them.
fn address(at: u32) -> Option<*mut u32> {
    let is_inside = at < 2 * ParameterFlash::SECTOR && at.is_multiple_of(4);
    is_inside.then_some((ADDRESS + at) as *mut u32)
}

/// Permits an operation (3.5.1), with the error flags of the last one cleared.
fn unlock() {
    if pac::FLASH.cr().read().lock() {
        pac::FLASH.keyr().write_value(0x4567_0123);
        pac::FLASH.keyr().write_value(0xCDEF_89AB);
    }
    // Flags are cleared by writing one.
    pac::FLASH.sr().modify(|_| {});
}

/// Waits for the end of an operation and permits no other.
fn finish() -> Result<(), StoreError> {
    // The last write has reached the interface before BSY is read.
    cortex_m::asm::dsb();
    while pac::FLASH.sr().read().bsy() {}
    let status = pac::FLASH.sr().read();
    pac::FLASH.cr().write(|w| w.set_lock(true));
    if status.pgserr() || status.pgperr() || status.pgaerr() || status.wrperr() {
        return Err(StoreError);
    }
    Ok(())
}
