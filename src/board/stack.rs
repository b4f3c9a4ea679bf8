//! The most that has been used of the stack, which all interrupts and tasks share.
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
