//! General-purpose I/O (RM0390 rev 6, section 7): one port of 16 pins.
//!
//! A pin has a level from outside (or none), a pull resistor, and maybe a driver inside: the output
//! register or, in alternate-function mode, a peripheral. The peripheral provides the level that it
//! drives; this file only determines which peripheral has the pin.

mod f1;

use crate::family::Family;

/// A GPIO port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum Port {
    A,
    B,
    C,
    D,
    E,
    F,
    G,
    H,
    I,
}

impl Port {
    /// All ports, in order.
    pub const ALL: [Self; 9] = [
        Self::A,
        Self::B,
        Self::C,
        Self::D,
        Self::E,
        Self::F,
        Self::G,
        Self::H,
        Self::I,
    ];
}

/// What a pin does to the wire it is connected to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PinLevel {
    /// Driven low.
    Low,
    /// Driven high.
    High,
    /// Not driven: an input, analog, or an open drain that is off. What the wire's level is then is
    /// decided outside.
    Floating,
}

/// Function of a pin (MODER, 7.4.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Input, the state after reset.
    Input,
    /// Output of ODR.
    Output,
    /// Alternate function, 0..=15.
    Alternate(u8),
    /// Analog; the digital input is off and reads 0.
    Analog,
}

/// Bits 0, 2, 4 and so on, side by side.
fn even_bits(bits: u32) -> u32 {
    let bits = bits & 0x5555_5555;
    let bits = (bits | bits >> 1) & 0x3333_3333;
    let bits = (bits | bits >> 2) & 0x0F0F_0F0F;
    let bits = (bits | bits >> 4) & 0x00FF_00FF;
    (bits | bits >> 8) & 0xFFFF
}

/// One port.
#[derive(Debug, Clone)]
pub struct Gpio {
    port: Port,
    family: Family,
    moder: u32,
    otyper: u32,
    ospeedr: u32,
    pupdr: u32,
    odr: u32,
    lckr: u32,
    afr: [u32; 2],
    /// Levels given from outside, and which pins have one.
    external: u32,
    connected: u32,
}

impl Gpio {
    /// A port after reset, with nothing connected. Ports A and B wake up with the debug pins
    /// switched (7.4).
    #[must_use]
    pub fn new(family: Family, port: Port) -> Self {
        let (moder, ospeedr, pupdr) = match port {
            _ if family == Family::F1 => (0, 0, 0),
            Port::A => (0xA800_0000, 0x0C00_0000, 0x6400_0000),
            Port::B => (0x0000_0280, 0x0000_00C0, 0x0000_0100),
            _ => (0, 0, 0),
        };
        Self {
            port,
            family,
            moder,
            otyper: 0,
            ospeedr,
            pupdr,
            odr: 0,
            lckr: 0,
            afr: [0; 2],
            external: 0,
            connected: 0,
        }
    }

    /// Resets the port; what is connected stays.
    pub fn reset(&mut self) {
        let (external, connected) = (self.external, self.connected);
        *self = Self::new(self.family, self.port);
        self.external = external;
        self.connected = connected;
    }

    /// Connects a pin to a level outside.
    pub fn set_external(&mut self, pin: u8, level: bool) {
        let bit = 1 << (pin & 15);
        self.connected |= bit;
        self.external = if level {
            self.external | bit
        } else {
            self.external & !bit
        };
    }

    /// The level outside that a pin is connected to, if it is.
    pub(crate) fn external(&self, pin: u8) -> Option<bool> {
        let bit = 1 << (pin & 15);
        (self.connected & bit != 0).then_some(self.external & bit != 0)
    }

    /// Leaves a pin open outside.
    pub fn set_open(&mut self, pin: u8) {
        self.connected &= !(1 << (pin & 15));
    }

    /// Level to which a pin's resistor pulls it, if it has one.
    #[must_use]
    pub fn pull(&self, pin: u8) -> Option<bool> {
        match self.pupdr >> (2 * (pin & 15)) & 3 {
            1 => Some(true),
            2 => Some(false),
            _ => None,
        }
    }

    /// Function of a pin.
    #[must_use]
    pub fn mode(&self, pin: u8) -> Mode {
        let pin = u32::from(pin & 15);
        match self.moder >> (2 * pin) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => Mode::Alternate((self.afr[(pin / 8) as usize] >> (4 * (pin % 8)) & 0xF) as u8),
            _ => Mode::Analog,
        }
    }

    /// Whether the register at an offset connects pins to peripherals: MODER, AFRL, AFRH; CRL, CRH.
    #[must_use]
    pub fn connects(&self, offset: u32) -> bool {
        match self.family {
            Family::F1 => matches!(offset, 0x00 | 0x04),
            Family::F4 => matches!(offset, 0x00 | 0x20 | 0x24),
        }
    }

    /// What the output register does to a pin; [`PinLevel::Floating`] in any mode but output.
    #[must_use]
    pub fn driven(&self, pin: u8) -> PinLevel {
        let high = self.odr >> (pin & 15) & 1 != 0;
        match (self.mode(pin), high, self.open_drain(pin)) {
            (Mode::Output, false, _) => PinLevel::Low,
            (Mode::Output, true, false) => PinLevel::High,
            _ => PinLevel::Floating,
        }
    }

    /// The same of all pins at once: those driven low, and those driven high.
    pub(crate) fn all_driven(&self) -> (u32, u32) {
        let output = even_bits(self.moder & !(self.moder >> 1));
        (output & !self.odr, output & self.odr & !self.otyper)
    }

    /// Pins in alternate-function mode.
    pub(crate) fn alternate(&self) -> u32 {
        even_bits(!self.moder & self.moder >> 1)
    }

    /// Whether a pin is open-drain.
    #[must_use]
    pub fn open_drain(&self, pin: u8) -> bool {
        self.otyper >> (pin & 15) & 1 != 0
    }

    /// Level at the input of a pin: its own output, else the level outside, else the pull, else
    /// low.
    #[must_use]
    pub fn level(&self, pin: u8) -> bool {
        self.levels() >> (pin & 15) & 1 != 0
    }

    /// The same of all pins, worked out at once because every access of a port needs them.
    fn levels(&self) -> u32 {
        let output = even_bits(self.moder & !(self.moder >> 1));
        let pull_up = even_bits(self.pupdr & !(self.pupdr >> 1));
        let driven = output & !(self.odr & self.otyper);
        let outside = self.connected & self.external | !self.connected & pull_up;
        driven & self.odr | !driven & outside
    }

    /// The input register (7.4.5): analog pins read 0.
    #[must_use]
    pub fn idr(&self) -> u32 {
        self.levels() & !even_bits(self.moder & self.moder >> 1) & 0xFFFF
    }

    /// Reads a register; `None` for an offset without one.
    #[must_use]
    pub fn read(&self, offset: u32) -> Option<u32> {
        if self.family == Family::F1 {
            return self.read_f1(offset);
        }
        Some(match offset {
            0x00 => self.moder,
            0x04 => self.otyper,
            0x08 => self.ospeedr,
            0x0C => self.pupdr,
            0x10 => self.idr(),
            0x14 => self.odr,
            0x18 => 0,
            0x1C => self.lckr,
            0x20 => self.afr[0],
            0x24 => self.afr[1],
            _ => return None,
        })
    }

    /// Writes a register; `None` for an offset without one, or the lock register, which is not
    /// modelled.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        if self.family == Family::F1 {
            return self.write_f1(offset, value);
        }
        match offset {
            0x00 => self.moder = value,
            0x04 => self.otyper = value & 0xFFFF,
            0x08 => self.ospeedr = value,
            0x0C => self.pupdr = value,
            0x10 => {}
            0x14 => self.odr = value & 0xFFFF,
            // 7.4.7: where both a set and a reset bit are written, set wins.
            0x18 => self.odr = (self.odr & !(value >> 16)) | (value & 0xFFFF),
            0x20 => self.afr[0] = value,
            0x24 => self.afr[1] = value,
            _ => return None,
        }
        Some(())
    }

    /// Name of the register at an offset.
    #[must_use]
    pub fn register_name(&self, offset: u32) -> &'static str {
        if self.family == Family::F1 {
            return f1::register_name(offset);
        }
        match offset {
            0x00 => "MODER",
            0x04 => "OTYPER",
            0x08 => "OSPEEDR",
            0x0C => "PUPDR",
            0x10 => "IDR",
            0x14 => "ODR",
            0x18 => "BSRR",
            0x1C => "LCKR",
            0x20 => "AFRL",
            0x24 => "AFRH",
            _ => "?",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reset_values_keep_the_debug_port() {
        assert_eq!(Gpio::new(Family::F4, Port::A).read(0), Some(0xA800_0000));
        assert_eq!(Gpio::new(Family::F4, Port::A).mode(13), Mode::Alternate(0));
        assert_eq!(Gpio::new(Family::F4, Port::B).mode(4), Mode::Alternate(0));
    }

    #[test]
    fn an_output_register_without_output_mode_drives_nothing() {
        let mut gpio = Gpio::new(Family::F4, Port::C);
        gpio.write(0x18, 1).unwrap();
        assert_eq!(gpio.driven(0), PinLevel::Floating);
        gpio.write(0x00, 1).unwrap();
        assert_eq!(gpio.driven(0), PinLevel::High);
        gpio.write(0x18, 1 << 16).unwrap();
        assert_eq!(gpio.driven(0), PinLevel::Low);
    }

    #[test]
    fn set_wins_over_reset() {
        let mut gpio = Gpio::new(Family::F4, Port::C);
        gpio.write(0x18, 0x0001_0001).unwrap();
        assert_eq!(gpio.read(0x14), Some(1));
    }

    #[test]
    fn pulls_decide_what_an_open_input_reads() {
        let mut gpio = Gpio::new(Family::F4, Port::C);
        gpio.write(0x0C, 0b10_01).unwrap();
        assert_eq!(gpio.idr() & 3, 0b01);
        gpio.set_external(0, false);
        gpio.set_external(1, true);
        assert_eq!(gpio.idr() & 3, 0b10);
    }

    #[test]
    fn open_drain_only_pulls_down() {
        let mut gpio = Gpio::new(Family::F4, Port::C);
        gpio.write(0x00, 1).unwrap();
        gpio.write(0x04, 1).unwrap();
        assert_eq!(gpio.driven(0), PinLevel::Low);
        gpio.write(0x14, 1).unwrap();
        assert_eq!(gpio.driven(0), PinLevel::Floating);
        gpio.set_external(0, true);
        assert_eq!(gpio.idr() & 1, 1);
    }

    #[test]
    fn an_analog_pin_reads_zero() {
        let mut gpio = Gpio::new(Family::F4, Port::C);
        gpio.set_external(0, true);
        gpio.write(0x00, 3).unwrap();
        assert_eq!(gpio.idr() & 1, 0);
    }
}
