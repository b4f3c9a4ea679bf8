//! What happens when the program is wrong (panic, HardFault, an interrupt without a handler, stack
//! overflow), and when clock or supply of the chip fail.
//!
//! Outputs first: drivers off, brake engaged, PWM off. Then a record for the next start and a line
//! in the log. Then nothing: interrupts stay masked, the watchdog is no longer fed, and resets the
//! chip. The robot comes back disabled. The HardFault entry resets the stack pointer before
//! anything else, because the most likely fault is a stack that has run out (see `memory/`), and a
//! handler that pushes onto it would lock the core up with outputs on.

#![expect(
    unsafe_code,
    reason = "fault handlers run outside the language's rules"
)]

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use embassy_stm32::interrupt::typelevel::{Handler, Interrupt};

#[cfg(not(feature = "sketch"))]
use super::outputs;
#[cfg(feature = "sketch")]
use super::sketch as outputs;
use crate::board::family::clocks;
use crate::board::post_mortem::{self, Calls, Failure};
use crate::board::stack;

/// Set by the first failure. A later failure on the way to the reset, above all in the log, must
/// not replace its record.
static FAILED: AtomicBool = AtomicBool::new(false);

/// Whether this is the first failure since the start.
fn is_first() -> bool {
    // No other failure can occur in between and continue here.
    let failed = FAILED.load(Ordering::Relaxed);
    FAILED.store(true, Ordering::Relaxed);
    !failed
}

// Inlined into `core`'s only call of it, the optimiser sees that message, file and line are not
// used, and leaves out all of them and what passes them on: 10 KB.
#[expect(
    unused_attributes,
    reason = "of an exported function rustc says so, but LLVM gets it"
)]
#[inline(always)]
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    stop()
}

fn stop() -> ! {
    cortex_m::interrupt::disable();
    outputs::cut();
    record(Failure::Panic(Calls::here()));
    wait_for_reset()
}

/// defmt's own assertions end here as well.
#[defmt::panic_handler]
fn defmt_panic() -> ! {
    cortex_m::interrupt::disable();
    outputs::cut();
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

extern "C" fn hard_fault(sp: u32) -> ! {
    cortex_m::interrupt::disable();
    outputs::cut();
    // The core has pushed r0..r3, r12, lr, pc, psr, unless the stack had no room for them.
    const FRAME_BYTES: u32 = 32;
    const PC_OFFSET: u32 = 24;
    let pc = if sp.is_multiple_of(4) && stack::contains(sp, FRAME_BYTES) {
        // SAFETY: `contains` has found the whole frame inside the stack, and the address is
        // aligned.
        unsafe { core::ptr::read_volatile((sp + PC_OFFSET) as *const u32) }
    } else {
        0
    };
    // SAFETY: reading the fault status changes nothing.
    let scb = unsafe { &*SCB::PTR };
    let (cfsr, bfar) = (scb.cfsr.read(), scb.bfar.read());
    record(Failure::HardFault { pc, sp, cfsr, bfar });
    wait_for_reset()
}

/// Keeps and logs the first failure.
fn record(failure: Failure) {
    if is_first() {
        post_mortem::write(failure);
        defmt::error!("{}", failure);
    }
}

/// Clock security system: HSE has stopped. TIM1 and TIM8 have switched their outputs off in
/// hardware. Nothing is logged, because this can interrupt a line of the log.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    outputs::cut();
    let failure = if clocks::hse_has_stopped() {
        Failure::ClockLost
    } else {
        Failure::UnhandledInterrupt(NMI)
    };
    if is_first() {
        post_mortem::write(failure);
    }
    wait_for_reset()
}

/// Number of the NMI as `DefaultHandler` counts.
const NMI: i16 = -14;

/// Voltage detector: the chip's supply is sinking. It preempts every other interrupt, so it does
/// not log either.
pub struct SupplyHandler;

impl<I: Interrupt> Handler<I> for SupplyHandler {
    unsafe fn on_interrupt() {
        cortex_m::interrupt::disable();
        outputs::cut();
        if is_first() {
            post_mortem::write(Failure::SupplyCollapse);
        }
        wait_for_reset()
    }
}

#[exception]
unsafe fn DefaultHandler(interrupt: i16) {
    cortex_m::interrupt::disable();
    outputs::cut();
    record(Failure::UnhandledInterrupt(interrupt));
    wait_for_reset()
}

fn wait_for_reset() -> ! {
    loop {
        cortex_m::asm::nop();
    }
}
