//! Vectors, and what happens between a reset and the image.

#![expect(unsafe_code, reason = "what runs first has no caller")]

use core::arch::global_asm;
use core::panic::PanicInfo;

use omnibus_boot::records::{self, Candidate, Reason};

use crate::chip::{self, Flash};

global_asm!(
    ".section .vectors, \"a\", %progbits",
    ".word _stack_start",
    ".word reset",
    // NMI, faults, the others up to SysTick: none of them can come but for a fault.
    ".rept 14",
    ".word fault",
    ".endr",
    ".section .text.reset, \"ax\", %progbits",
    ".global reset",
    ".type reset, %function",
    ".thumb_func",
    "reset:",
    // Access to the floating-point registers, which the compiler may use: CPACR, PM0214 4.6.1.
    "    ldr     r0, =0xE000ED88",
    "    ldr     r1, [r0]",
    "    orr     r1, r1, #0xF00000",
    "    str     r1, [r0]",
    "    dsb",
    "    isb",
    "    b       start",
);

/// Starts an image.
#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    let checksum = |address, length| chip::fast(|| chip::checksum(address, length));
    for candidate in records::candidates(&Flash).into_iter().flatten() {
        let Candidate { slot, reason, .. } = candidate;
        if !candidate.is_whole(&Flash, checksum) {
            continue;
        }
        // An image on trial is not started without end because its attempts cannot be noted.
        if reason == Reason::Trial && records::count_attempt(&mut Flash, slot).is_err() {
            continue;
        }
        if matches!(reason, Reason::Trial | Reason::LastResort(_)) {
            chip::start_watchdog();
        }
        chip::jump(slot.address());
    }
    // Nothing to start: a programmer stops the processor.
    loop {
        core::hint::spin_loop();
    }
}

/// Panics and faults: from the beginning.
#[unsafe(no_mangle)]
extern "C" fn fault() -> ! {
    chip::reset()
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    chip::reset()
}
