//! Pins of chips whose ports have MODER (STM32F4: RM0390 rev 6, section 7; STM32G4: RM0440), and
//! the first instructions after reset. Where the ports and their clocks are is the family's.

#![expect(
    unsafe_code,
    reason = "the first instructions after reset are assembly"
)]

use crate::board::family::gpio::{PORT_A, PORT_CLOCKS, PORTS};
use crate::board::stm32::SAFE_OUTPUTS;
use crate::board::stm32::pin::{Pin, Pull, Role, Speed};

/// Gives a pin a role (MODER, AFR, PUPDR, OSPEEDR).
#[inline(always)]
pub fn give(pin: Pin, role: Role) {
    // MODER: 0 input, 1 output, 2 alternate function, 3 analog.
    let (mode, function, pull, speed) = match role {
        Role::Input(pull) => (0, 0, pull, Speed::Low),
        Role::Output => (1, 0, Pull::None, Speed::Low),
        Role::PeripheralInput(function, pull) => (2, function, pull, Speed::Low),
        Role::PeripheralOutput(function, pull, speed) => (2, function, pull, speed),
        Role::Analog => (3, 0, Pull::None, Speed::Low),
    };
    let port = pin.registers();
    let put = |word: &mut u32, width: u8, place: u8, value: u8| {
        let (shift, mask) = (width * place, (1 << width) - 1);
        *word = *word & !(mask << shift) | u32::from(value) << shift;
    };
    port.pupdr()
        .modify(|w| put(&mut w.0, 2, pin.bit, pull as u8));
    port.ospeedr()
        .modify(|w| put(&mut w.0, 2, pin.bit, speed as u8));
    // Before the mode, so that a pin drives only its intended level.
    let half = if pin.bit < 8 { 0 } else { 1 };
    port.afr(half)
        .modify(|w| put(&mut w.0, 4, pin.bit % 8, function));
    port.moder().modify(|w| put(&mut w.0, 2, pin.bit, mode));
}

/// Words for the start: address of MODER and the bits that make outputs of a port's pins among
/// these, port by port, and a 0 behind the last.
const fn outputs_by_port(pins: &[Pin]) -> [u32; 2 * PORTS + 1] {
    let mut words = [0; 2 * PORTS + 1];
    let (mut port, mut end) = (0, 0);
    while port < PORTS {
        let (mut bits, mut at) = (0, 0);
        while at < pins.len() {
            if pins[at].port as usize == port {
                bits |= 1 << (2 * pins[at].bit);
            }
            at += 1;
        }
        if bits != 0 {
            words[end] = port_address(port) as u32;
            words[end + 1] = bits;
            end += 2;
        }
        port += 1;
    }
    words
}

/// Address of a port's registers, of which MODER is the first: port A and the others behind it.
pub const fn port_address(port: usize) -> usize {
    PORT_A + 0x400 * port
}

/// Bits that clock the ports of these pins.
const fn ports_of(pins: &[Pin]) -> u32 {
    let (mut ports, mut at) = (0, 0);
    while at < pins.len() {
        ports |= 1 << pins[at].port;
        at += 1;
    }
    ports
}

/// For the first instructions, in flash.
static OUTPUTS_BY_PORT: [u32; 2 * PORTS + 1] = outputs_by_port(&SAFE_OUTPUTS);

/// The first instructions after reset: PWM, directions, driver enable, brake release and LED become
/// outputs, which are low. Painting the stack and setting up the variables takes milliseconds on
/// the internal oscillator, waiting for clock and supply longer. In assembly, because there are no
/// variables yet.
#[unsafe(naked)]
#[unsafe(export_name = "__pre_init")]
extern "C" fn make_outputs_safe() {
    core::arch::naked_asm!(
        "ldr r0, ={port_clocks}",
        "ldr r1, [r0]",
        "ldr r2, ={ports}",
        "orr r1, r1, r2",
        "str r1, [r0]",
        // RM0390 6.2.14: two cycles until the ports have their clock; this reads back.
        "ldr r1, [r0]",
        "ldr r0, ={outputs}",
        // MODER is the first register of a port: 01 is an output, which is low after reset. Most of
        // these pins are 00 then, and PB4 10; on an STM32G4 they are 11.
        "1: ldr r1, [r0], #4",
        "cbz r1, 2f",
        "ldr r2, [r0], #4",
        "ldr r3, [r1]",
        "orr r3, r3, r2",
        "bic r3, r3, r2, lsl #1",
        "str r3, [r1]",
        "b 1b",
        "2: bx lr",
        port_clocks = const PORT_CLOCKS,
        ports = const ports_of(&SAFE_OUTPUTS),
        outputs = sym OUTPUTS_BY_PORT,
    )
}
