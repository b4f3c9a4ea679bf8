//! The most that has been used of the stack, which all interrupts and tasks share, and the calls on
//! it.
//!
//! Start-up fills the stack with a pattern (`paint-stack` of cortex-m-rt); a word without it has
//! been used. The result is that of the deepest call since the start, to within one step of the
//! search.

#![expect(unsafe_code, reason = "the stack's limits are linker symbols")]

use core::ptr::addr_of;

unsafe extern "C" {
    /// Lowest address of the stack, from `memory/`.
    static _stack_end: u32;
    /// First address above the stack.
    static _stack_start: u32;
    /// First address of code, from cortex-m-rt.
    static __stext: u32;
    /// First address behind it.
    static __etext: u32;
}

/// The word with which cortex-m-rt paints the stack.
const PAINT: u32 = 0xCCCC_CCCC;

/// Bytes from one checked word to the next: checking each word of 32 KiB would take the bus side a
/// quarter of a millisecond. An exception's frame is as long and written without a gap.
const STEP_BYTES: usize = 32;

/// The stack in bytes.
pub struct Use {
    /// What has been used since boot.
    pub most: usize,
    /// What there is.
    pub size: usize,
}

/// How deep the stack has been since boot.
pub fn high_water() -> Use {
    let end = addr_of!(_stack_end) as usize;
    let start = addr_of!(_stack_start) as usize;
    let mut word = end;
    // SAFETY: the linker's symbols bound the stack, so this is an aligned word of RAM, of which any
    // bits are valid. An interrupt may write it; then the result is that of before or after.
    while word < start && unsafe { (word as *const u32).read_volatile() } == PAINT {
        word = word.wrapping_add(STEP_BYTES);
    }
    Use {
        most: start - word,
        size: start - end,
    }
}

/// Whether `address` lies in the stack with `bytes` above it.
pub fn contains(address: u32, bytes: u32) -> bool {
    let end = addr_of!(_stack_end) as usize as u32;
    let start = addr_of!(_stack_start) as usize as u32;
    (end..=start.saturating_sub(bytes)).contains(&address)
}

/// The calls that have led here, the latest first, by the addresses that they return to; zeros
/// after the first of all.
///
/// Whatever lies on the stack and follows a call in the code counts as one, so there may be some
/// among them that have returned already.
pub fn calls<const N: usize>() -> [u32; N] {
    let mut found = [0; N];
    let mut places = found.iter_mut();
    let mut at = cortex_m::register::msp::read();
    while contains(at, 4) {
        // SAFETY: the stack pointer is aligned, and the word is in the stack.
        let word = unsafe { (at as *const u32).read_volatile() };
        if is_after_call(word) {
            let Some(place) = places.next() else {
                break;
            };
            *place = word & !1;
        }
        at += 4;
    }
    found
}

/// Whether this is a return address: odd, and in the code behind `BL`, T1, or `BLX`, T1 (ARMv7-M
/// Architecture Reference Manual, A7.7.18 and A7.7.19).
fn is_after_call(word: u32) -> bool {
    const LONGEST: u32 = 4;
    let begin = addr_of!(__stext) as usize as u32 + LONGEST;
    let end = addr_of!(__etext) as usize as u32;
    let address = word & !1;
    if word == address || !(begin..end).contains(&address) {
        return false;
    }
    // SAFETY: both halfwords before it are code, and aligned.
    let [first, second] =
        [4, 2].map(|before| unsafe { ((address - before) as *const u16).read_volatile() });
    (first & 0xF800 == 0xF000 && second & 0xD000 == 0xD000) || second & 0xFF87 == 0x4780
}
