//! Registers of the chip, by address: clocks, CRC unit, flash, watchdog.

#![expect(unsafe_code, reason = "registers")]

use core::ptr::{read_volatile, write_volatile};

use omnibus_boot::records::FlashError;

/// RM0390 section 6.3: control, PLL, configuration, clocks of the AHB1.
const RCC_CR: u32 = 0x4002_3800;
const RCC_PLLCFGR: u32 = 0x4002_3804;
const RCC_CFGR: u32 = 0x4002_3808;
const RCC_AHB1ENR: u32 = 0x4002_3830;
/// Section 3.8: access control, keys, status, control.
const FLASH_ACR: u32 = 0x4002_3C00;
const FLASH_KEYR: u32 = 0x4002_3C04;
const FLASH_SR: u32 = 0x4002_3C0C;
const FLASH_CR: u32 = 0x4002_3C10;
/// Section 4.4: data, control.
const CRC_DR: u32 = 0x4002_3000;
const CRC_CR: u32 = 0x4002_3008;
/// Section 21.4: key, prescaler, reload, status.
const IWDG_KR: u32 = 0x4000_3000;
const IWDG_PR: u32 = 0x4000_3004;
const IWDG_RLR: u32 = 0x4000_3008;
const IWDG_SR: u32 = 0x4000_300C;
/// PM0214 section 4.4: vector table, reset.
const SCB_VTOR: u32 = 0xE000_ED08;
const SCB_AIRCR: u32 = 0xE000_ED0C;

const PLLON: u32 = 1 << 24;
const PLLRDY: u32 = 1 << 25;
const CRCEN: u32 = 1 << 12;
/// PLLCFGR and ACR after a reset.
const PLLCFGR_RESET: u32 = 0x2400_3010;
const ACR_RESET: u32 = 0;
/// HSI at 16 MHz / 16 * 336 / 4 = 84 MHz; the VCO at 336 MHz, its input at 1 MHz.
const PLLCFGR_84_MHZ: u32 = 0x2400_0000 | 1 << 16 | 336 << 6 | 16;
/// Two wait states, enough to 90 MHz at 2.7 V; prefetch and both caches.
const ACR_84_MHZ: u32 = 0x702;
/// PLL as the system clock; APB1 at half of it, 42 MHz.
const CFGR_84_MHZ: u32 = 4 << 10 | 2;
/// CFGR: which clock is in use.
const SWS: u32 = 3 << 2;
const SWS_PLL: u32 = 2 << 2;

/// Longest wait for a clock or the watchdog, in turns of some ten cycles at 16 MHz: 5 ms at least.
const TURNS: u32 = 8_000;

/// The register at an address.
pub fn read(address: u32) -> u32 {
    // SAFETY: the callers name registers, or aligned words of flash, all of which can be read. An
    // address without memory is a fault, which resets the chip.
    unsafe { read_volatile(address as *const u32) }
}

fn write(address: u32, value: u32) {
    // SAFETY: the callers name registers, none of which moves memory, or, with PG set, a word of
    // the records. Neither the boot code nor its variables lie there.
    unsafe { write_volatile(address as *mut u32, value) }
}

/// Waits for bits of a register, but not for ever.
fn wait(address: u32, mask: u32, value: u32) -> bool {
    (0..TURNS).any(|_| read(address) & mask == value)
}

/// Runs something at 84 MHz; at 16 MHz when the PLL does not lock, which takes longer.
pub fn fast<T>(f: impl FnOnce() -> T) -> T {
    let cr = read(RCC_CR);
    write(RCC_PLLCFGR, PLLCFGR_84_MHZ);
    write(RCC_CR, cr | PLLON);
    if wait(RCC_CR, PLLRDY, PLLRDY) {
        write(FLASH_ACR, ACR_84_MHZ);
        write(RCC_CFGR, CFGR_84_MHZ);
        wait(RCC_CFGR, SWS, SWS_PLL);
    }
    let result = f();
    write(RCC_CFGR, 0);
    wait(RCC_CFGR, SWS, 0);
    write(RCC_CR, cr);
    wait(RCC_CR, PLLRDY, 0);
    write(RCC_PLLCFGR, PLLCFGR_RESET);
    // The caches are cleared while they are off (3.4.2), because the image may erase what is in
    // them.
    write(FLASH_ACR, 3 << 11);
    write(FLASH_ACR, ACR_RESET);
    result
}

/// The checksum of so many bytes of flash from an address on, by the CRC unit.
pub fn checksum(address: u32, length: u32) -> u32 {
    let clocks = read(RCC_AHB1ENR);
    write(RCC_AHB1ENR, clocks | CRCEN);
    // The clock is there two cycles after it was enabled; the read back takes longer.
    read(RCC_AHB1ENR);
    write(CRC_CR, 1);
    for at in (address..address + length).step_by(4) {
        write(CRC_DR, read(at));
    }
    let checksum = read(CRC_DR);
    write(RCC_AHB1ENR, clocks);
    checksum
}

/// Flash, by address.
pub struct Flash;

impl omnibus_boot::Flash for Flash {
    fn word(&self, address: u32) -> u32 {
        read(address)
    }

    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError> {
        write(FLASH_KEYR, 0x4567_0123);
        write(FLASH_KEYR, 0xCDEF_89AB);
        // Errors of the last operation are cleared by writing ones.
        write(FLASH_SR, 0xF2);
        // PG, 32 bits.
        write(FLASH_CR, 1 | 2 << 8);
        write(address, word);
        while read(FLASH_SR) >> 16 & 1 == 1 {}
        write(FLASH_CR, 1 << 31);
        if read(address) == word {
            Ok(())
        } else {
            Err(FlashError)
        }
    }

    /// The boot code never erases.
    fn erase(&mut self, _: u8) -> Result<(), FlashError> {
        Err(FlashError)
    }
}

/// Starts the watchdog: 3 s at 32 kHz, 2 to 6 s over the range of LSI. The image makes it shorter.
pub fn start_watchdog() {
    write(IWDG_KR, 0xCCCC);
    write(IWDG_KR, 0x5555);
    // 32 LSI cycles a count.
    write(IWDG_PR, 3);
    write(IWDG_RLR, 3000 - 1);
    wait(IWDG_SR, 3, 0);
    write(IWDG_KR, 0xAAAA);
}

/// Resets the chip.
pub fn reset() -> ! {
    write(SCB_AIRCR, 0x05FA_0004);
    loop {
        core::hint::spin_loop();
    }
}

/// Hands over to the image whose vectors are at an address.
pub fn jump(vectors: u32) -> ! {
    write(SCB_VTOR, vectors);
    let (stack, entry) = (read(vectors), read(vectors + 4));
    // SAFETY: `start`, the only caller, has found both vectors to be those of an image
    // (`Candidate::is_whole`). CONTROL gets its value after a reset: privileged, main stack, no
    // floating-point context. Nothing of this program runs afterwards, so its stack may be lost.
    unsafe {
        core::arch::asm!(
            "msr control, {zero}",
            "isb",
            "msr msp, {stack}",
            "bx {entry}",
            zero = in(reg) 0,
            stack = in(reg) stack,
            entry = in(reg) entry,
            options(noreturn)
        )
    }
}
