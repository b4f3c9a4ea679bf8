//! A pin of the chip: its port and its number, known to the compiler.
//!
//! A pin is data, so that a board is a table. Everything that is read or set in a control tick or
//! in an interrupt is a constant, and compiles to one load or store.

#![expect(unsafe_code, reason = "a port's registers are found by its number")]

use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::gpio::regs::Bsrr;

use crate::board::family::gpio::{self, PORTS};

/// One pin.
#[derive(Clone, Copy)]
pub struct Pin {
    /// 0 is port A.
    pub port: u8,
    /// 0..=15.
    pub bit: u8,
}

/// What a pin is used as.
#[derive(Clone, Copy)]
pub enum Role {
    /// Input.
    Input(Pull),
    /// Output of the port.
    Output,
    /// Input of a peripheral with this alternate function.
    PeripheralInput(u8, Pull),
    /// Push-pull output of a peripheral with this alternate function.
    PeripheralOutput(u8, Pull, Speed),
    /// Input of the converter.
    Analog,
}

/// Pull resistor.
#[derive(Clone, Copy)]
pub enum Pull {
    /// None.
    None = 0,
    /// To the supply.
    Up = 1,
    /// To ground.
    Down = 2,
}

/// Steepness of an output's edges.
#[derive(Clone, Copy)]
pub enum Speed {
    /// Up to 8 MHz.
    Low = 0,
    /// Up to 50 MHz.
    Medium = 1,
    /// Up to 180 MHz.
    VeryHigh = 3,
}

/// The pin with this name, such as `PB12`. Anything else does not compile.
pub const fn pin(name: &str) -> Pin {
    let name = name.as_bytes();
    let (port, bit) = match *name {
        [b'P', port, units] => (port, units - b'0'),
        [b'P', port, tens, units] => (port, 10 * (tens - b'0') + units - b'0'),
        _ => panic!("a pin is P, a port and a number"),
    };
    let port = port - b'A';
    assert!((port as usize) < PORTS && bit < 16, "no such pin");
    Pin { port, bit }
}

/// Several pins.
pub const fn pins<const N: usize>(names: [&str; N]) -> [Pin; N] {
    let mut found = [Pin { port: 0, bit: 0 }; N];
    let mut at = 0;
    while at < N {
        found[at] = pin(names[at]);
        at += 1;
    }
    found
}

impl Pin {
    /// The registers of its port.
    #[inline(always)]
    pub const fn registers(self) -> Gpio {
        // SAFETY: the chip has the port, from A to I: `pin` and `probe::by_number` check it, and
        // the literals of this crate are port A.
        unsafe { Gpio::from_ptr(gpio::port_address(self.port as usize) as *mut ()) }
    }

    /// Whether its level is high.
    #[inline(always)]
    pub fn is_high(self) -> bool {
        self.registers().idr().read().0 >> self.bit & 1 == 1
    }

    /// The word for BSRR that sets it to a level: the lower half sets pins, the upper half resets
    /// them.
    #[inline(always)]
    pub const fn level(self, high: bool) -> u32 {
        let set = if high { 1 } else { 1 << 16 };
        set << self.bit
    }

    /// Sets its output to a level.
    #[inline(always)]
    pub fn set(self, high: bool) {
        self.registers().bsrr().write_value(Bsrr(self.level(high)));
    }

    /// Gives it a role. For start-up: nothing else may write the registers of its port meanwhile.
    #[inline(never)]
    pub fn become_a(self, role: Role) {
        gpio::give(self, role);
    }
}

/// Whether all these are different pins.
pub const fn all_differ(pins: &[Pin]) -> bool {
    let mut at = 0;
    while at < pins.len() {
        let mut other = 0;
        while other < at {
            if pins[at].port == pins[other].port && pins[at].bit == pins[other].bit {
                return false;
            }
            other += 1;
        }
        at += 1;
    }
    true
}
