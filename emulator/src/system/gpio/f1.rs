//! The registers of an STM32F1's port (RM0008 rev 21, section 9.2): four bits a pin say mode,
//! function and speed together, and the output register also chooses between pull-up and pull-down.
//! Which peripheral has a pin in alternate-function mode is in AFIO ([`crate::system::afio`]).

use super::Gpio;

/// Modes as in MODER.
const INPUT: u32 = 0;
const OUTPUT: u32 = 1;
const ALTERNATE: u32 = 2;
const ANALOG: u32 = 3;

/// Configurations of an input (9.1, table 20): analog, floating, with a pull.
const CNF_ANALOG: u32 = 0b0000;
const CNF_FLOATING: u32 = 0b0100;
const CNF_PULL: u32 = 0b1000;

/// Writes a field of two bits.
fn set(register: &mut u32, pin: u32, value: u32) {
    *register = *register & !(3 << (2 * pin)) | value << (2 * pin);
}

impl Gpio {
    pub(super) fn read_f1(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.configuration(0),
            0x04 => self.configuration(8),
            0x08 => self.idr(),
            0x0C => self.odr,
            0x10 | 0x14 => 0,
            0x18 => self.lckr,
            _ => return None,
        })
    }

    /// `None` for the lock register, too, which is not modelled.
    pub(super) fn write_f1(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => self.configure(0, value),
            0x04 => self.configure(8, value),
            0x08 => {}
            0x0C => self.odr = value & 0xFFFF,
            // 9.2.5: where both a set and a reset bit are written, set wins.
            0x10 => self.odr = (self.odr & !(value >> 16)) | (value & 0xFFFF),
            0x14 => self.odr &= !value,
            _ => return None,
        }
        for pin in 0..16 {
            if self.pupdr >> (2 * pin) & 3 != 0 {
                let up = self.odr >> pin & 1 != 0;
                set(&mut self.pupdr, pin, if up { 1 } else { 2 });
            }
        }
        Some(())
    }

    /// CRL or CRH: the configurations of eight pins.
    fn configuration(&self, first: u32) -> u32 {
        (0..8).fold(0, |all, index| {
            let pin = first + index;
            let two = |register: u32| register >> (2 * pin) & 3;
            let drain = (self.otyper >> pin & 1) << 2;
            let one = match two(self.moder) {
                INPUT if two(self.pupdr) == 0 => CNF_FLOATING,
                INPUT => CNF_PULL,
                OUTPUT => drain | two(self.ospeedr),
                ALTERNATE => 0b1000 | drain | two(self.ospeedr),
                _ => CNF_ANALOG,
            };
            all | one << (4 * index)
        })
    }

    fn configure(&mut self, first: u32, value: u32) {
        for index in 0..8 {
            let (pin, one) = (first + index, value >> (4 * index) & 0xF);
            // The speed, and for an input 0.
            let speed = one & 3;
            let (mode, drain, pull) = match (speed, one) {
                (0, CNF_ANALOG) => (ANALOG, 0, 0),
                (0, CNF_PULL) => (INPUT, 0, 1),
                (0, _) => (INPUT, 0, 0),
                (_, 0b1000..) => (ALTERNATE, one >> 2 & 1, 0),
                _ => (OUTPUT, one >> 2 & 1, 0),
            };
            set(&mut self.moder, pin, mode);
            set(&mut self.ospeedr, pin, speed);
            set(&mut self.pupdr, pin, pull);
            self.otyper = self.otyper & !(1 << pin) | drain << pin;
        }
    }
}

pub(super) fn register_name(offset: u32) -> &'static str {
    match offset {
        0x00 => "CRL",
        0x04 => "CRH",
        0x08 => "IDR",
        0x0C => "ODR",
        0x10 => "BSRR",
        0x14 => "BRR",
        0x18 => "LCKR",
        _ => "?",
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Mode, PinLevel, Port};
    use super::*;
    use crate::family::Family;

    fn port() -> Gpio {
        Gpio::new(Family::F1, Port::A)
    }

    #[test]
    fn every_configuration_is_read_as_it_was_written() {
        let mut gpio = port();
        assert_eq!(gpio.read(0x00), Some(0x4444_4444), "floating after reset");
        for one in [0, 4, 8, 1, 2, 3, 5, 6, 7, 9, 0xA, 0xB, 0xD, 0xE, 0xF] {
            for (offset, other) in [(0x00, 0x04), (0x04, 0x00)] {
                let value = 0x4444_0444 | one << 12;
                gpio.write(offset, value).unwrap();
                assert_eq!(gpio.read(offset), Some(value), "{one:#x}");
                gpio.write(offset, 0x4444_4444).unwrap();
                assert_eq!(gpio.read(other), Some(0x4444_4444));
            }
        }
    }

    #[test]
    fn modes_are_those_of_table_20() {
        let mut gpio = port();
        gpio.write(0x00, 0x4444_B370).unwrap();
        let modes = [0, 1, 2, 3, 4].map(|pin| gpio.mode(pin));
        assert_eq!(modes[..3], [Mode::Analog, Mode::Output, Mode::Output]);
        assert_eq!(modes[3..], [Mode::Alternate(0), Mode::Input]);
        assert!(gpio.open_drain(1) && !gpio.open_drain(2));
        gpio.write(0x10, 0b110).unwrap();
        assert_eq!(gpio.driven(1), PinLevel::Floating);
        assert_eq!(gpio.driven(2), PinLevel::High);
        gpio.write(0x14, 0b110).unwrap();
        assert_eq!(gpio.driven(2), PinLevel::Low);
    }

    #[test]
    fn the_output_register_chooses_the_pull() {
        let mut gpio = port();
        gpio.write(0x00, 0x4444_4488).unwrap();
        gpio.write(0x10, 1).unwrap();
        assert_eq!((gpio.pull(0), gpio.pull(1)), (Some(true), Some(false)));
        assert_eq!(gpio.read(0x08).unwrap() & 3, 0b01);
        gpio.write(0x10, 1 << 16 | 2).unwrap();
        assert_eq!(gpio.read(0x08).unwrap() & 3, 0b10);
        assert_eq!(gpio.pull(2), None);
    }
}
