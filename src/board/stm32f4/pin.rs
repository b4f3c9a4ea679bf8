//! A pin of the chip: its port and its number, known to the compiler.
//!
//! A pin is data, so that a board is a table. Everything that is read or set in a control tick or
//! in an interrupt is a constant, and compiles to one load or store.

#![expect(unsafe_code, reason = "a port's registers are found by its number")]

use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::gpio::regs::Bsrr;

/// Ports A to I.
pub const PORTS: usize = 9;

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

/// Pull resistor (PUPDR).
#[derive(Clone, Copy)]
pub enum Pull {
    /// None.
    None = 0,
    /// To the supply.
    Up = 1,
    /// To ground.
    Down = 2,
}

/// Steepness of an output's edges (OSPEEDR).
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
        unsafe { Gpio::from_ptr(port_address(self.port as usize) as *mut ()) }
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
        // MODER: 0 input, 1 output, 2 alternate function, 3 analog.
        let (mode, function, pull, speed) = match role {
            Role::Input(pull) => (0, 0, pull, Speed::Low),
            Role::Output => (1, 0, Pull::None, Speed::Low),
            Role::PeripheralInput(function, pull) => (2, function, pull, Speed::Low),
            Role::PeripheralOutput(function, pull, speed) => (2, function, pull, speed),
            Role::Analog => (3, 0, Pull::None, Speed::Low),
        };
        let port = self.registers();
        let put = |word: &mut u32, width: u8, place: u8, value: u8| {
            let (shift, mask) = (width * place, (1 << width) - 1);
            *word = *word & !(mask << shift) | u32::from(value) << shift;
        };
        port.pupdr()
            .modify(|w| put(&mut w.0, 2, self.bit, pull as u8));
        port.ospeedr()
            .modify(|w| put(&mut w.0, 2, self.bit, speed as u8));
        // Before the mode, so that a pin drives only its intended level.
        let half = if self.bit < 8 { 0 } else { 1 };
        port.afr(half)
            .modify(|w| put(&mut w.0, 4, self.bit % 8, function));
        port.moder().modify(|w| put(&mut w.0, 2, self.bit, mode));
    }
}

/// Words for the start: address of MODER and the bits that make outputs of a port's pins among
/// these, port by port, and a 0 behind the last.
pub const fn outputs_by_port(pins: &[Pin]) -> [u32; 2 * PORTS + 1] {
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

/// Address of a port's registers, of which MODER is the first: port A and the others behind it
/// (RM0390 rev 6, table 1; RM0090, table 1).
const fn port_address(port: usize) -> usize {
    0x4002_0000 + 0x400 * port
}

/// Bits of AHB1ENR that clock the ports of these pins.
pub const fn ports_of(pins: &[Pin]) -> u32 {
    let (mut ports, mut at) = (0, 0);
    while at < pins.len() {
        ports |= 1 << pins[at].port;
        at += 1;
    }
    ports
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
