//! Alternate functions of an STM32F1 (RM0008 rev 21, section 9.4): which pins a peripheral has, for
//! all its pins at once. The selection of a port for each external interrupt is at the same offsets
//! as in an STM32F4's SYSCFG, and is [`crate::system::exti`]'s.
//!
//! A peripheral drives a pin that is in alternate-function mode; its inputs take any pin that is
//! not analog. SWJ_CFG gives the pins of the debug port to the program. It can only be written
//! (9.4.2), and reads as 0 here: a program that changes another field by reading the register first
//! takes those pins back.
//!
//! Not modelled: EVENTOUT, and the remaps of peripherals that are not modelled (stored, without
//! effect); MAPR2.

use crate::system::gpio::Port;

/// Fields of MAPR that pins depend on: shift and mask.
const FIELDS: [(u32, u32); 7] = [(0, 0), (6, 3), (8, 3), (10, 3), (12, 1), (13, 3), (3, 1)];
/// Their numbers: pins that need none, and the fields of these peripherals.
pub(crate) const ALWAYS: u8 = 0;
pub(crate) const TIM1: u8 = 1;
pub(crate) const TIM2: u8 = 2;
pub(crate) const TIM3: u8 = 3;
pub(crate) const TIM4: u8 = 4;
pub(crate) const CAN: u8 = 5;
pub(crate) const USART2: u8 = 6;

const SWJ_CFG: u32 = 7 << 24;

/// The condition that a field has one of the values whose bits are set in `values`, for
/// [`Route::af`](crate::system::pins::Route::af).
pub(crate) const fn when(field: u8, values: u8) -> u8 {
    field << 4 | values
}

/// See the [module](self).
#[derive(Debug, Clone, Default)]
pub struct Afio {
    evcr: u32,
    mapr: u32,
}

impl Afio {
    /// Reads EVCR or MAPR; `None` for another offset.
    #[must_use]
    pub fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.evcr,
            0x04 => self.mapr & !SWJ_CFG,
            _ => return None,
        })
    }

    /// Writes EVCR or MAPR; `None` for another offset, and for an output of EVENTOUT.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 if value & 0x80 == 0 => self.evcr = value & 0xFF,
            0x04 => self.mapr = value & 0x071F_FFFF,
            _ => return None,
        }
        Some(())
    }

    /// Whether the remap that a pin needs for a signal ([`when`]) is selected.
    #[must_use]
    pub fn selects(&self, remap: u8) -> bool {
        let (shift, mask) = FIELDS[usize::from(remap >> 4) % FIELDS.len()];
        let value = self.mapr >> shift & mask;
        remap >> value & 1 != 0
    }

    /// Whether a pin is the debug port's (table 37).
    #[must_use]
    pub fn debug_has(&self, port: Port, pin: u8) -> bool {
        let configuration = (self.mapr & SWJ_CFG) >> 24;
        match (port, pin) {
            (Port::A, 13 | 14) => configuration != 4,
            (Port::A, 15) | (Port::B, 3) => configuration < 2,
            (Port::B, 4) => configuration == 0,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_selects_the_pins_of_its_peripheral() {
        let mut afio = Afio::default();
        let [always, can] = [when(ALWAYS, 1), when(CAN, 0b0100)];
        assert!(afio.selects(always) && !afio.selects(can));
        afio.write(4, 2 << 13).unwrap();
        assert!(afio.selects(always) && afio.selects(can));
        afio.write(4, 3 << 13).unwrap();
        assert!(!afio.selects(can));
        let partial = when(TIM2, 0b1010);
        for (value, selected) in [(0, false), (1, true), (2, false), (3, true)] {
            afio.write(4, value << 8).unwrap();
            assert_eq!(afio.selects(partial), selected);
        }
    }

    #[test]
    fn the_debug_port_gives_its_pins_away_and_takes_them_back_unasked() {
        let mut afio = Afio::default();
        let pins = [(Port::A, 13), (Port::A, 15), (Port::B, 3), (Port::B, 4)];
        let held = |afio: &Afio| pins.map(|(port, pin)| afio.debug_has(port, pin));
        for (configuration, expected) in [
            (0, [true, true, true, true]),
            (1, [true, true, true, false]),
            (2, [true, false, false, false]),
            (4, [false, false, false, false]),
        ] {
            afio.write(4, configuration << 24).unwrap();
            assert_eq!(held(&afio), expected);
        }
        let read = afio.read(4).unwrap();
        afio.write(4, read | 2 << 13).unwrap();
        assert_eq!(held(&afio), [true; 4]);
    }
}
