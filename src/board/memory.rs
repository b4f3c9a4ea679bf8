//! Copying and clearing memory: what the compiler calls for anything larger than a few words.
//!
//! The compiler's own library has these too, in 3.3 KB and at three to five instructions for each
//! word, with which a robot spent a tenth of its time. These are 200 bytes. Words are moved where
//! both sides are aligned, four at a time; a Cortex-M4 also loads and stores single words at any
//! address in RAM or flash, which does for the rest. None of it is for registers of peripherals.
//!
//! Names and arguments are those of the run-time ABI for the Arm architecture (RTABI32, section
//! 4.3.4).

#![expect(unsafe_code, reason = "assembly")]

use core::arch::global_asm;

global_asm!(
    ".section .text.memory, \"ax\", %progbits",
    ".syntax unified",
    ".thumb",
    // memcpy(to: r0, from: r1, bytes: r2), which returns `to`; the others return nothing.
    ".macro function name",
    ".global \\name",
    ".type \\name, %function",
    ".thumb_func",
    "\\name:",
    ".endm",
    "function memmove",
    "function __aeabi_memmove",
    "function __aeabi_memmove4",
    "function __aeabi_memmove8",
    "    subs    r3, r0, r1",
    "    cmp     r3, r2",
    "    bhs     memcpy", // `to` is below `from`, or behind its end: upwards is right.
    "    add     r0, r2",
    "    add     r1, r2",
    "1:  subs    r2, #4",
    "    ittt    hs",
    "    ldrhs   r3, [r1, #-4]!",
    "    strhs   r3, [r0, #-4]!",
    "    bhs     1b",
    "    adds    r2, #4",
    "2:  subs    r2, #1",
    "    ittt    hs",
    "    ldrbhs  r3, [r1, #-1]!",
    "    strbhs  r3, [r0, #-1]!",
    "    bhs     2b",
    "    bx      lr",
    "function memcpy",
    "function __aeabi_memcpy",
    "function __aeabi_memcpy4",
    "function __aeabi_memcpy8",
    "    push    {{r0, r4, r5, lr}}",
    "    orr     r3, r0, r1",
    "    lsls    r3, r3, #30",
    "    bne     2f", // LDM and STM insist on alignment.
    "    subs    r2, #16",
    "    blo     3f",
    "1:  ldmia   r1!, {{r3, r4, r5, r12}}",
    "    subs    r2, #16",
    "    stmia   r0!, {{r3, r4, r5, r12}}",
    "    bhs     1b",
    "3:  adds    r2, #16",
    "2:  subs    r2, #4",
    "    ittt    hs",
    "    ldrhs   r3, [r1], #4",
    "    strhs   r3, [r0], #4",
    "    bhs     2b",
    "    adds    r2, #4",
    "3:  subs    r2, #1",
    "    ittt    hs",
    "    ldrbhs  r3, [r1], #1",
    "    strbhs  r3, [r0], #1",
    "    bhs     3b",
    "    pop     {{r0, r4, r5, pc}}",
    // memset(to: r0, byte: r1, bytes: r2) returns `to`.
    "function memset",
    "    mov     r3, r1",
    "    mov     r1, r2",
    "    mov     r2, r3",
    "    b       1f",
    "function __aeabi_memclr",
    "function __aeabi_memclr4",
    "function __aeabi_memclr8",
    "    movs    r2, #0",
    // __aeabi_memset(to: r0, bytes: r1, byte: r2).
    "function __aeabi_memset",
    "function __aeabi_memset4",
    "function __aeabi_memset8",
    "1:  mov     r12, r0",
    "    uxtb    r2, r2",
    "    orr     r2, r2, r2, lsl #8",
    "    orr     r2, r2, r2, lsl #16",
    "2:  subs    r1, #4",
    "    itt     hs",
    "    strhs   r2, [r12], #4",
    "    bhs     2b",
    "    adds    r1, #4",
    "3:  subs    r1, #1",
    "    itt     hs",
    "    strbhs  r2, [r12], #1",
    "    bhs     3b",
    "    bx      lr",
    ".purgem function",
);
