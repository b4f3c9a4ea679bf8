//! The functions of the control tick, one by one, over a spread of inputs, for `cargo xtask bench`
//! to count.
//!
//! Built in the firmware's profile and run in the emulator, which counts the instructions of every
//! call of the functions in `kernels`. Each is the function of the library with its arguments in
//! memory; `nothing` is the same without a function in it, and its cost is subtracted. It also
//! holds the firmware's own copying of memory to what it says (`copying`). On the host this is an
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
