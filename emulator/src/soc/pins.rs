//! Which peripheral has which pin, and what a change of a pin does.

use super::Soc;
use crate::defect::Defect;
use crate::family::Family;
use crate::system::gpio::{Mode, Port};
use crate::system::map::Unit;
use crate::system::pins::Route;

impl Soc {
    /// Processes a change of a pin: edges for EXTI, the encoder and the break inputs.
    pub(super) fn pins_changed(&mut self, port: Port, before: u32) {
        let after = self.gpio[port as usize].idr();
        let mut changed = before ^ after;
        while changed != 0 {
            let pin = changed.trailing_zeros() as u8;
            changed &= changed - 1;
            self.exti.edge(port, pin, after >> pin & 1 != 0);
            self.timer_input(port, pin);
        }
        self.follow_breaks();
    }

    /// Other pins belong to the peripherals of an STM32F1.
    pub(super) fn remapped(&mut self) {
        for port in Port::ALL {
            (0..16).for_each(|pin| self.timer_input(port, pin));
        }
        self.follow_breaks();
    }

    /// Tells the timers the levels at their break inputs.
    fn follow_breaks(&mut self) {
        for timer in [1, 8] {
            let level = self.chip.pins.break_input(timer).any(|route| {
                self.receives(route) && self.gpio[route.port as usize].level(route.pin)
            });
            let level = level && !self.defects.has(Defect::BreakInput(timer));
            self.timers[timer].set_break_input(self.now, level);
        }
    }

    /// Whether a peripheral drives a pin.
    pub(super) fn connected(&self, route: &Route) -> bool {
        let mode = self.gpio[route.port as usize].mode(route.pin);
        match self.chip.family {
            Family::F1 => matches!(mode, Mode::Alternate(_)) && self.selected(route),
            Family::F4 => mode == Mode::Alternate(route.af),
        }
    }

    /// Whether a pin is an input of a peripheral.
    pub(super) fn receives(&self, route: &Route) -> bool {
        match self.chip.family {
            Family::F1 => {
                let mode = self.gpio[route.port as usize].mode(route.pin);
                mode != Mode::Analog && self.selected(route)
            }
            Family::F4 => self.connected(route),
        }
    }

    /// Whether an STM32F1's remaps give a pin to a signal.
    fn selected(&self, route: &Route) -> bool {
        self.afio.selects(route.af) && !self.afio.debug_has(route.port, route.pin)
    }

    pub(super) fn timer_clocked(&self, number: usize) -> bool {
        self.rcc.enabled(self.places.timer_gates[number])
    }

    pub(super) fn clocked(&self, unit: Unit) -> bool {
        self.rcc.enabled(self.chip.gate(unit))
    }
}
