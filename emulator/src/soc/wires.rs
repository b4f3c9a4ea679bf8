//! Wires from pin to pin of one chip.
//!
//! The pins of a wire have one level: low if any of them drives it low, else high if any drives it
//! high, else that of a pull resistor, up before down. It is worked out after every write of a
//! register, and at a port before every read of its inputs, so an edge that the program makes
//! arrives at once, at inputs of timers, break inputs and the converter too. A wire with no pin of
//! a peripheral has the same level until a port, the clocks or the remaps are written.
//!
//! What it cannot do: a PWM reaches the registers of a port, but its edges do not by themselves
//! reach the inputs of timers and EXTI, because nothing is worked out at those moments.

use super::Soc;
use crate::system::gpio::{Mode, PinLevel, Port};

/// Supply of the chip, which a high output has, V.
const HIGH_V: f64 = 3.3;

/// Groups of pins that are connected.
#[derive(Debug, Clone, Default)]
pub(super) struct Wires {
    nets: Vec<Net>,
    /// The version of the wiring that all of them have followed.
    followed: Option<u64>,
}

/// Pins with one level.
#[derive(Debug, Clone)]
struct Net {
    pins: Vec<(Port, u8)>,
    /// Whether a peripheral has one of them, so that its level can change by itself.
    is_alternate: bool,
}

impl Net {
    fn is_at(&self, port: Option<Port>) -> bool {
        port.is_none_or(|port| self.pins.iter().any(|pin| pin.0 == port))
    }
}

impl Wires {
    /// Connects two pins, and with them what these are connected with.
    fn connect(&mut self, one: (Port, u8), other: (Port, u8)) {
        let mut joined = vec![one, other];
        self.nets.retain(|net| {
            let meets = net.pins.contains(&one) || net.pins.contains(&other);
            if meets {
                joined.extend(&net.pins);
            }
            !meets
        });
        joined.sort_unstable();
        joined.dedup();
        self.nets.push(Net {
            pins: joined,
            is_alternate: true,
        });
        self.forget();
    }

    /// Has every wire worked out the next time: something from outside changed a pin.
    pub(super) fn forget(&mut self) {
        self.followed = None;
    }
}

impl Soc {
    /// Connects two pins with a wire.
    pub(crate) fn connect(&mut self, one: (Port, u8), other: (Port, u8)) {
        self.wires.connect(one, other);
        self.follow_wires(None);
        self.settle();
    }

    /// Gives all wires their levels, or those at a port.
    pub(super) fn follow_wires(&mut self, at: Option<Port>) {
        if self.wires.nets.is_empty() {
            return;
        }
        let mut wires = std::mem::take(&mut self.wires);
        let is_new = wires.followed != Some(self.wiring);
        if is_new {
            for net in &mut wires.nets {
                let is_alternate = |&(port, pin): &(Port, u8)| {
                    matches!(self.gpio[port as usize].mode(pin), Mode::Alternate(_))
                };
                net.is_alternate = net.pins.iter().any(is_alternate);
            }
            wires.followed = Some(self.wiring);
        }
        // A wire can change what another carries: a break input cuts outputs. Two rounds settle it.
        for _ in 0..2 {
            let mut changed = false;
            let is_due = |net: &&Net| is_new || (net.is_alternate && net.is_at(at));
            for net in wires.nets.iter().filter(is_due) {
                let level = self.level_of(&net.pins);
                for &(port, pin) in &net.pins {
                    changed |= self.apply_wire(port, pin, level);
                }
            }
            if !changed {
                break;
            }
        }
        self.wires = wires;
    }

    fn level_of(&mut self, net: &[(Port, u8)]) -> Option<bool> {
        let mut driven = None;
        for &(port, pin) in net {
            match self.output(port, pin) {
                PinLevel::Low => return Some(false),
                PinLevel::High => driven = Some(true),
                PinLevel::Floating => {}
            }
        }
        let pulls = net.iter();
        let pull = pulls
            .filter_map(|&(port, pin)| self.gpio[port as usize].pull(pin))
            .max();
        driven.or(pull)
    }

    /// Gives a pin the level of its wire, and says whether that is another than before.
    fn apply_wire(&mut self, port: Port, pin: u8, level: Option<bool>) -> bool {
        let gpio = &mut self.gpio[port as usize];
        let changed = gpio.external(pin) != level;
        if changed {
            let before = gpio.idr();
            match level {
                Some(level) => gpio.set_external(pin, level),
                None => gpio.set_open(pin),
            }
            if gpio.idr() != before {
                self.pins_changed(port, before);
            }
        }
        if self.gpio[port as usize].mode(pin) == Mode::Analog {
            self.set_analog(port, pin, if level == Some(true) { HIGH_V } else { 0.0 });
        }
        changed
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rsemu::core::space::RamStore;

    use super::*;
    use crate::board::BoardConfig;
    use crate::chip::F446;
    use crate::ram::Ram;

    const GPIOA: u32 = 0x4002_0000;
    const GPIOC: u32 = 0x4002_0800;

    fn soc(config: &BoardConfig) -> Soc {
        let store = Arc::new(RamStore::new(F446.flash_size()));
        let mut soc = Soc::new(&F446, store, Arc::new(Ram::new(&F446)), config);
        soc.system_reset(0);
        soc.write(0x4002_3830, 4, 0b111);
        soc
    }

    fn level(soc: &mut Soc, base: u32, pin: u32) -> bool {
        soc.read(base + 0x10, 4) >> pin & 1 != 0
    }

    #[test]
    fn the_strongest_pin_gives_a_wire_its_level() {
        let mut soc = soc(&BoardConfig::default());
        soc.connect((Port::A, 8), (Port::C, 6));
        assert!(!level(&mut soc, GPIOC, 6), "open");
        soc.write(GPIOA + 0xC, 4, 1 << 16);
        assert!(level(&mut soc, GPIOC, 6), "PA8 has a pull-up");
        soc.write(GPIOC + 0xC, 4, 2 << 12);
        assert!(
            level(&mut soc, GPIOC, 6),
            "the pull-up before the pull-down"
        );
        soc.write(GPIOA, 4, 1 << 16);
        assert!(!level(&mut soc, GPIOC, 6), "PA8 is an output, low");
        soc.write(GPIOA + 0x18, 4, 1 << 8);
        assert!(level(&mut soc, GPIOC, 6));
    }

    #[test]
    fn a_level_from_outside_does_not_outlast_the_wire() {
        let mut soc = soc(&BoardConfig::default());
        soc.connect((Port::A, 8), (Port::C, 6));
        soc.write(GPIOA, 4, 1 << 16);
        assert!(!level(&mut soc, GPIOC, 6));
        soc.set_input(Port::C, 6, true);
        assert!(!level(&mut soc, GPIOC, 6), "PA8 is an output, low");
    }

    #[test]
    fn two_wires_at_one_pin_are_one() {
        let mut soc = soc(&BoardConfig::default());
        soc.connect((Port::A, 8), (Port::C, 6));
        soc.connect((Port::C, 7), (Port::C, 6));
        soc.write(GPIOC, 4, 1 << 14);
        soc.write(GPIOC + 0x18, 4, 1 << 7);
        assert!(level(&mut soc, GPIOA, 8));
    }

    #[test]
    fn a_pwm_is_read_at_the_other_end() {
        let mut soc = soc(&BoardConfig::default());
        soc.connect((Port::A, 8), (Port::C, 6));
        for (address, value) in [
            (0x4002_3844, 1),    // TIM1
            (0x4001_002C, 99),   // ARR
            (0x4001_0034, 25),   // CCR1
            (0x4001_0018, 0x60), // PWM mode 1
            (0x4001_0020, 1),
            (0x4001_0044, 0x8000),
            (0x4001_0000, 1),
            (GPIOA + 0x24, 1), // PA8 is TIM1's
            (GPIOA, 2 << 16),
        ] {
            soc.write(address, 4, value);
        }
        let from = soc.now;
        let high = (0..200).filter(|tick| {
            soc.now = from + tick;
            level(&mut soc, GPIOC, 6)
        });
        assert_eq!(high.count(), 50);
    }
}
