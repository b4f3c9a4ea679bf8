//! How deep the one stack has been.
//!
//! Start-up fills the stack with a pattern (`paint-stack` of cortex-m-rt); what has lost it has
//! been used. All interrupts and the tasks share this stack. It sees the deepest call ever
//! made, not the present one, to within the step with which it looks.

#![expect(unsafe_code, reason = "the stack's limits are linker symbols")]

use core::ptr::{addr_of, read_volatile};

unsafe extern "C" {
    /// Lowest address of the stack, from `memory/`.
    static _stack_end: u32;
    /// First address above the stack.
    static _stack_start: u32;
}

/// The word with which cortex-m-rt paints the stack.
const PAINT: u32 = 0xCCCC_CCCC;

/// Words between two that are checked: checking each of 32 KiB would take the bus side a quarter of
/// a millisecond. An exception's frame is as long and written without a gap.
const STEP_WORDS: usize = 8;

/// The stack in bytes.
pub struct Use {
    /// What has been used since boot.
    pub most: usize,
    /// What there is.
    pub size: usize,
}

/// How deep the stack has been since boot.
pub fn high_water() -> Use {
    // SAFETY: only the addresses of the symbols are used, and every word between them is RAM that
    // nothing writes below the present stack pointer except interrupts, whose writes only make the
    // answer one call older.
    unsafe {
        let end = addr_of!(_stack_end);
        let start = addr_of!(_stack_start);
        let size = start as usize - end as usize;
        let mut word = end;
        while word < start && read_volatile(word) == PAINT {
            word = word.add(STEP_WORDS);
        }
        Use {
            most: start as usize - word as usize,
            size,
        }
    }
}

/// Whether `address` lies in the stack with `bytes` above it.
pub fn contains(address: u32, bytes: u32) -> bool {
    let end = addr_of!(_stack_end) as usize as u32;
    let start = addr_of!(_stack_start) as usize as u32;
    (end..=start.saturating_sub(bytes)).contains(&address)
}
