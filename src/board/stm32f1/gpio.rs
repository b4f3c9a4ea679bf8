//! Pins of an STM32F1 (RM0008 rev 21, section 9), and the first instructions after reset.
//!
//! A pin has no alternate function of its own: AFIO assigns peripherals as a whole
//! (`clocks::start`). So the number of an alternate function means nothing here. A peripheral reads
//! a pin that is an input.

#![expect(
    unsafe_code,
    reason = "the first instructions after reset are assembly"
)]

use crate::board::stm32::SAFE_OUTPUTS;
use crate::board::stm32::pin::{Pin, Pull, Role, Speed};

/// Ports A to E.
pub const PORTS: usize = 5;

/// CNF and MODE (9.2.1, 9.2.2).
const ANALOG: u32 = 0b0000;
const FLOATING: u32 = 0b0100;
const PULLED: u32 = 0b1000;
const OUTPUT_2_MHZ: u32 = 0b0010;
const PERIPHERAL: u32 = 0b1000;

/// Gives a pin a role (CRL, CRH, and ODR for the direction of a pull).
#[inline(always)]
pub fn give(pin: Pin, role: Role) {
    let bits = match role {
        Role::Input(pull) | Role::PeripheralInput(_, pull) => match pull {
            Pull::None => FLOATING,
            Pull::Up | Pull::Down => {
                pin.set(matches!(pull, Pull::Up));
                PULLED
            }
        },
        Role::Output => OUTPUT_2_MHZ,
        Role::PeripheralOutput(_, _, speed) => {
            PERIPHERAL
                | match speed {
                    Speed::Low => 0b10,
                    Speed::Medium => 0b01,
                    Speed::VeryHigh => 0b11,
                }
        }
        Role::Analog => ANALOG,
    };
    let shift = 4 * (pin.bit % 8);
    let half = if pin.bit < 8 { 0 } else { 1 };
    pin.registers()
        .cr(half)
        .modify(|w| w.0 = w.0 & !(0b1111 << shift) | bits << shift);
}

/// Words for the start: address of CRL or CRH and the four bits of each pin among these, register
/// by register, and a 0 behind the last.
const fn outputs_by_register(pins: &[Pin]) -> [u32; 4 * PORTS + 1] {
    let mut words = [0; 4 * PORTS + 1];
    let (mut register, mut end) = (0, 0);
    while register < 2 * PORTS {
        let (mut bits, mut at) = (0, 0);
        while at < pins.len() {
            let Pin { port, bit } = pins[at];
            if 2 * port as usize + bit as usize / 8 == register {
                bits |= 0b1111 << (4 * (bit % 8));
            }
            at += 1;
        }
        if bits != 0 {
            words[end] = (port_address(register / 2) + 4 * (register % 2)) as u32;
            words[end + 1] = bits;
            end += 2;
        }
        register += 1;
    }
    words
}

/// Address of a port's registers, of which CRL and CRH are the first (table 3).
pub const fn port_address(port: usize) -> usize {
    0x4001_0800 + 0x400 * port
}

/// Bits of APB2ENR that clock the ports of these pins.
const fn ports_of(pins: &[Pin]) -> u32 {
    let (mut ports, mut at) = (0, 0);
    while at < pins.len() {
        ports |= 1 << (2 + pins[at].port);
        at += 1;
    }
    ports
}

/// For the first instructions, in flash.
static OUTPUTS_BY_REGISTER: [u32; 4 * PORTS + 1] = outputs_by_register(&SAFE_OUTPUTS);

/// The first instructions after reset: PWM, driver enable, brake release and LED become outputs,
/// which are low. Painting the stack and setting up the variables takes milliseconds on the
/// internal oscillator, waiting for clock and supply longer. In assembly, because there are no
/// variables yet.
#[unsafe(naked)]
#[unsafe(export_name = "__pre_init")]
extern "C" fn make_outputs_safe() {
    core::arch::naked_asm!(
        "ldr r0, ={apb2enr}",
        "ldr r1, [r0]",
        "ldr r2, ={ports}",
        "orr r1, r1, r2",
        "str r1, [r0]",
        // Reads back, so that the ports have their clock.
        "ldr r1, [r0]",
        "ldr r0, ={outputs}",
        "1: ldr r1, [r0], #4",
        "cbz r1, 2f",
        "ldr r2, [r0], #4",
        "ldr r3, [r1]",
        "bic r3, r3, r2",
        "and r2, r2, #0x22222222", // OUTPUT_2_MHZ
        "orr r3, r3, r2",
        "str r3, [r1]",
        "b 1b",
        "2: bx lr",
        apb2enr = const 0x4002_1018_u32,
        ports = const ports_of(&SAFE_OUTPUTS),
        outputs = sym OUTPUTS_BY_REGISTER,
    )
}
