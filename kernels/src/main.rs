//! The functions of the control tick, one by one, over a range of inputs, and whole control ticks
//! (`robot`), for `cargo xtask bench`.
//!
//! This image is built in the firmware's profile and run in the emulator, which counts the
//! instructions of every call of the functions in `kernels`. Each calls the function of the library
//! with its arguments in memory; `nothing` is the same without a call, and its cost is subtracted.
//! The image also tests the firmware's own copying of memory (`copying`). On the host this is an
//! empty program.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod copying;
#[cfg(target_os = "none")]
mod kernels;
#[cfg(target_os = "none")]
#[path = "../../src/board/memory.rs"]
mod memory;
#[cfg(target_os = "none")]
mod robot;

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    kernels::run();
    copying::check();
    loop {
        core::hint::spin_loop();
    }
}

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

/// Says what this is good for.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This runs in the emulator; cargo xtask bench builds it for its target.");
}
