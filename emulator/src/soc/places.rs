//! What is looked up at every access of a peripheral or a pin, so that no table has to be searched.

use crate::chip::Chip;
use crate::system::gpio::Port;
use crate::system::map::{Entry, Gate, Unit};
use crate::system::pins::{Route, Row};

/// By number, port and pin.
#[derive(Debug, Clone)]
pub(super) struct Places {
    /// Peripherals that have a whole kilobyte from [`PERIPHERALS`] on.
    pages: [Option<&'static Entry>; 256],
    pub(super) timer_gates: [Gate; 15],
    /// Pins that can carry the channels of a timer, and channels that a pin can carry.
    pub(super) channels: [[Vec<&'static Route>; 4]; 15],
    pub(super) channels_at: AtPins,
    /// Complementary outputs that a pin can carry, and the pins that can carry one.
    pub(super) complementary_at: AtPins,
    pub(super) complementary_pins: [u32; Port::ALL.len()],
}

/// Rows of a table by port and pin.
type AtPins = [[Vec<&'static Row>; 16]; Port::ALL.len()];

const PERIPHERALS: u32 = 0x4000_0000;
const PAGE: u32 = 0x400;

impl Places {
    pub(super) fn new(chip: &Chip) -> Self {
        let page = |number: usize| {
            let first = PERIPHERALS + PAGE * number as u32;
            let entry = chip.peripheral(first)?;
            let last = chip.peripheral(first + PAGE - 1)?;
            (entry.base == last.base).then_some(entry)
        };
        let complementary_at: AtPins = Port::ALL.map(|port| {
            std::array::from_fn(|pin| chip.pins.complementary_at(port, pin as u8).collect())
        });
        Self {
            pages: std::array::from_fn(page),
            timer_gates: std::array::from_fn(|number| chip.gate(Unit::Timer(number))),
            channels: std::array::from_fn(|timer| {
                [1, 2, 3, 4].map(|channel| chip.pins.timer_channel(timer, channel).collect())
            }),
            channels_at: Port::ALL.map(|port| {
                std::array::from_fn(|pin| chip.pins.channels_at(port, pin as u8).collect())
            }),
            complementary_pins: complementary_at.each_ref().map(|pins| {
                let rows = pins.iter().enumerate();
                rows.fold(0, |all, (pin, rows)| {
                    all | u32::from(!rows.is_empty()) << pin
                })
            }),
            complementary_at,
        }
    }

    /// The peripheral that has an address.
    pub(super) fn peripheral(&self, chip: &Chip, address: u32) -> Option<&'static Entry> {
        let page = address.checked_sub(PERIPHERALS)? / PAGE;
        let known = self.pages.get(page as usize).copied().flatten();
        known.or_else(|| chip.peripheral(address))
    }
}
