//! What happens when the program is wrong: panic, HardFault, an interrupt nobody handles, stack overflow.
//!
//! Outputs first: drivers off, brake engaged, PWM off. Then one line in the log. Then nothing: interrupts stay
//! masked, the watchdog is no longer fed, and resets the chip within its 50 ms. The robot comes back disabled.
//!
//! The HardFault entry sets the stack pointer anew before anything else, because the most likely fault is a stack
//! that has run out (see `memory.x`), and a handler that pushes onto it would lock the core up with outputs on.

#![expect(
    unsafe_code,
    reason = "fault handlers run outside the language's rules"
)]

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;

use super::drive;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    drive::cut();
    match info.location() {
        Some(location) => defmt::error!("panic at {=str}:{=u32}", location.file(), location.line()),
        None => defmt::error!("panic"),
    }
    wait_for_reset()
}

/// defmt's own assertions end here as well.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    cortex_m::interrupt::disable();
    drive::cut();
    wait_for_reset()
}

/// Takes a fresh stack and calls [`hard_fault`] with the stack pointer of the fault.
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
extern "C" fn hard_fault_entry() -> ! {
    core::arch::naked_asm!(
        "mrs r0, MSP",
        "ldr r1, =_stack_start",
        "msr MSP, r1",
        "b {handler}",
        handler = sym hard_fault,
    )
}

extern "C" fn hard_fault(stack_pointer: u32) -> ! {
    cortex_m::interrupt::disable();
    drive::cut();
    // SAFETY: reading the fault status has no effect on anything else.
    let scb = unsafe { &*SCB::PTR };
    defmt::error!(
        "HardFault: sp {=u32:#010x}, cfsr {=u32:#010x}, bfar {=u32:#010x}",
        stack_pointer,
        scb.cfsr.read(),
        scb.bfar.read()
    );
    wait_for_reset()
}

#[exception]
unsafe fn DefaultHandler(interrupt: i16) {
    cortex_m::interrupt::disable();
    drive::cut();
    defmt::error!("interrupt {=i16} has no handler", interrupt);
    wait_for_reset()
}

fn wait_for_reset() -> ! {
    loop {
        cortex_m::asm::nop();
    }
}
