//! Which pin carries which signal in which alternate function, for the signals that are modelled:
//! data sheet DS10693 rev 10, table 11, as far as the pins exist on the 64-pin package; DS8626 rev
//! 9, table 9, for the package with 176 pins. What both chips have is in tables of its own. RM0008
//! rev 21, tables 38 to 52, for the STM32F103 in its package with 64 pins.

use crate::system::afio::{self, when};
use crate::system::gpio::Port;

/// A pin with what connects it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Route {
    /// Port.
    pub port: Port,
    /// Pin, 0..=15.
    pub pin: u8,
    /// Alternate function; on an STM32F1 the remap ([`crate::system::afio`]).
    pub af: u8,
}

const fn route(port: Port, pin: u8, af: u8) -> Route {
    Route { port, pin, af }
}

use Port::{A, B, C, D, E, F, H, I};

/// A timer or its break input, with a channel from 1 or 0, and a pin that can carry it.
pub(crate) type Row = (usize, usize, Route);

/// The pins of one chip: what all have, and what it has alone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pins {
    channels: [&'static [Row]; 2],
    complementary: [&'static [Row]; 2],
    breaks: [&'static [Row]; 2],
    /// Pins that can carry a line of CAN1, CAN2 or USART2.
    pub(crate) can1_receive: &'static [Route],
    pub(crate) can1_transmit: &'static [Route],
    pub(crate) can2_receive: &'static [Route],
    pub(crate) can2_transmit: &'static [Route],
    pub(crate) usart2_receive: &'static [Route],
    pub(crate) usart2_transmit: &'static [Route],
    /// SPI1: clock, in and out of a master.
    pub(crate) spi1: [&'static [Route]; 3],
}

/// SPI1 of the chips that have it modelled: SCK, MISO, MOSI.
const SPI1: [&[Route]; 3] = [
    &[route(A, 5, 5), route(B, 3, 5)],
    &[route(A, 6, 5), route(B, 4, 5)],
    &[route(A, 7, 5), route(B, 5, 5)],
];

/// Channels of timers that all chips have.
const CHANNELS: &[Row] = &[
    (1, 1, route(A, 8, 1)),
    (1, 2, route(A, 9, 1)),
    (1, 3, route(A, 10, 1)),
    (1, 4, route(A, 11, 1)),
    (2, 1, route(A, 0, 1)),
    (2, 1, route(A, 5, 1)),
    (2, 1, route(A, 15, 1)),
    (2, 2, route(A, 1, 1)),
    (2, 2, route(B, 3, 1)),
    (2, 3, route(A, 2, 1)),
    (2, 3, route(B, 10, 1)),
    (2, 4, route(A, 3, 1)),
    (3, 1, route(A, 6, 2)),
    (3, 1, route(B, 4, 2)),
    (3, 1, route(C, 6, 2)),
    (3, 2, route(A, 7, 2)),
    (3, 2, route(B, 5, 2)),
    (3, 2, route(C, 7, 2)),
    (3, 3, route(B, 0, 2)),
    (3, 3, route(C, 8, 2)),
    (3, 4, route(B, 1, 2)),
    (3, 4, route(C, 9, 2)),
    (4, 1, route(B, 6, 2)),
    (4, 2, route(B, 7, 2)),
    (4, 3, route(B, 8, 2)),
    (4, 4, route(B, 9, 2)),
    (5, 1, route(A, 0, 2)),
    (5, 2, route(A, 1, 2)),
    (5, 3, route(A, 2, 2)),
    (5, 4, route(A, 3, 2)),
    (8, 1, route(C, 6, 3)),
    (8, 2, route(C, 7, 3)),
    (8, 3, route(C, 8, 3)),
    (8, 4, route(C, 9, 3)),
    (9, 1, route(A, 2, 3)),
    (9, 2, route(A, 3, 3)),
    (10, 1, route(B, 8, 3)),
    (11, 1, route(B, 9, 3)),
    (12, 1, route(B, 14, 9)),
    (12, 2, route(B, 15, 9)),
    (13, 1, route(A, 6, 9)),
    (14, 1, route(A, 7, 9)),
];

/// Complementary outputs that all chips have.
const COMPLEMENTARY: &[Row] = &[
    (1, 1, route(A, 7, 1)),
    (1, 1, route(B, 13, 1)),
    (1, 2, route(B, 0, 1)),
    (1, 2, route(B, 14, 1)),
    (1, 3, route(B, 1, 1)),
    (1, 3, route(B, 15, 1)),
    (8, 1, route(A, 5, 3)),
    (8, 1, route(A, 7, 3)),
    (8, 2, route(B, 0, 3)),
    (8, 2, route(B, 14, 3)),
    (8, 3, route(B, 1, 3)),
    (8, 3, route(B, 15, 3)),
];

/// Break inputs that all chips have.
const BREAKS: &[Row] = &[
    (1, 0, route(A, 6, 1)),
    (1, 0, route(B, 12, 1)),
    (8, 0, route(A, 6, 3)),
];

/// DS10693.
pub(crate) const F446: Pins = Pins {
    channels: [
        CHANNELS,
        &[
            (2, 1, route(B, 8, 1)),
            (2, 2, route(B, 9, 1)),
            (2, 4, route(B, 2, 1)),
        ],
    ],
    complementary: [COMPLEMENTARY, &[]],
    breaks: [BREAKS, &[]],
    can1_receive: &[route(A, 11, 9), route(B, 8, 9)],
    can1_transmit: &[route(A, 12, 9), route(B, 9, 9)],
    can2_receive: &[route(B, 5, 9), route(B, 12, 9)],
    can2_transmit: &[route(B, 6, 9), route(B, 13, 9)],
    usart2_receive: &[route(A, 3, 7)],
    usart2_transmit: &[route(A, 2, 7)],
    spi1: SPI1,
};

/// DS8626.
pub(crate) const F407: Pins = Pins {
    channels: [
        CHANNELS,
        &[
            (1, 1, route(E, 9, 1)),
            (1, 2, route(E, 11, 1)),
            (1, 3, route(E, 13, 1)),
            (1, 4, route(E, 14, 1)),
            (2, 4, route(B, 11, 1)),
            (4, 1, route(D, 12, 2)),
            (4, 2, route(D, 13, 2)),
            (4, 3, route(D, 14, 2)),
            (4, 4, route(D, 15, 2)),
            (5, 1, route(H, 10, 2)),
            (5, 2, route(H, 11, 2)),
            (5, 3, route(H, 12, 2)),
            (5, 4, route(I, 0, 2)),
            (8, 1, route(I, 5, 3)),
            (8, 2, route(I, 6, 3)),
            (8, 3, route(I, 7, 3)),
            (8, 4, route(I, 2, 3)),
            (9, 1, route(E, 5, 3)),
            (9, 2, route(E, 6, 3)),
            (10, 1, route(F, 6, 3)),
            (11, 1, route(F, 7, 3)),
            (12, 1, route(H, 6, 9)),
            (12, 2, route(H, 9, 9)),
            (13, 1, route(F, 8, 9)),
            (14, 1, route(F, 9, 9)),
        ],
    ],
    complementary: [
        COMPLEMENTARY,
        &[
            (1, 1, route(E, 8, 1)),
            (1, 2, route(E, 10, 1)),
            (1, 3, route(E, 12, 1)),
            (8, 1, route(H, 13, 3)),
            (8, 2, route(H, 14, 3)),
            (8, 3, route(H, 15, 3)),
        ],
    ],
    breaks: [BREAKS, &[(1, 0, route(E, 15, 1)), (8, 0, route(I, 4, 3))]],
    can1_receive: &[
        route(A, 11, 9),
        route(B, 8, 9),
        route(D, 0, 9),
        route(I, 9, 9),
    ],
    can1_transmit: &[
        route(A, 12, 9),
        route(B, 9, 9),
        route(D, 1, 9),
        route(H, 13, 9),
    ],
    can2_receive: &[route(B, 5, 9), route(B, 12, 9)],
    can2_transmit: &[route(B, 6, 9), route(B, 13, 9)],
    usart2_receive: &[route(A, 3, 7), route(D, 6, 7)],
    usart2_transmit: &[route(A, 2, 7), route(D, 5, 7)],
    spi1: SPI1,
};

/// Channels that a remap of an STM32F103 gives to a pin: the values of the field of AFIO_MAPR.
const F103_CHANNELS: &[Row] = &[
    (1, 1, route(A, 8, when(afio::TIM1, 0b0011))),
    (1, 2, route(A, 9, when(afio::TIM1, 0b0011))),
    (1, 3, route(A, 10, when(afio::TIM1, 0b0011))),
    (1, 4, route(A, 11, when(afio::TIM1, 0b0011))),
    (2, 1, route(A, 0, when(afio::TIM2, 0b0101))),
    (2, 1, route(A, 15, when(afio::TIM2, 0b1010))),
    (2, 2, route(A, 1, when(afio::TIM2, 0b0101))),
    (2, 2, route(B, 3, when(afio::TIM2, 0b1010))),
    (2, 3, route(A, 2, when(afio::TIM2, 0b0011))),
    (2, 3, route(B, 10, when(afio::TIM2, 0b1100))),
    (2, 4, route(A, 3, when(afio::TIM2, 0b0011))),
    (2, 4, route(B, 11, when(afio::TIM2, 0b1100))),
    (3, 1, route(A, 6, when(afio::TIM3, 0b0001))),
    (3, 1, route(B, 4, when(afio::TIM3, 0b0100))),
    (3, 1, route(C, 6, when(afio::TIM3, 0b1000))),
    (3, 2, route(A, 7, when(afio::TIM3, 0b0001))),
    (3, 2, route(B, 5, when(afio::TIM3, 0b0100))),
    (3, 2, route(C, 7, when(afio::TIM3, 0b1000))),
    (3, 3, route(B, 0, when(afio::TIM3, 0b0101))),
    (3, 3, route(C, 8, when(afio::TIM3, 0b1000))),
    (3, 4, route(B, 1, when(afio::TIM3, 0b0101))),
    (3, 4, route(C, 9, when(afio::TIM3, 0b1000))),
    (4, 1, route(B, 6, when(afio::TIM4, 0b01))),
    (4, 2, route(B, 7, when(afio::TIM4, 0b01))),
    (4, 3, route(B, 8, when(afio::TIM4, 0b01))),
    (4, 4, route(B, 9, when(afio::TIM4, 0b01))),
    (5, 1, route(A, 0, when(afio::ALWAYS, 1))),
    (5, 2, route(A, 1, when(afio::ALWAYS, 1))),
    (5, 3, route(A, 2, when(afio::ALWAYS, 1))),
    (5, 4, route(A, 3, when(afio::ALWAYS, 1))),
    (8, 1, route(C, 6, when(afio::ALWAYS, 1))),
    (8, 2, route(C, 7, when(afio::ALWAYS, 1))),
    (8, 3, route(C, 8, when(afio::ALWAYS, 1))),
    (8, 4, route(C, 9, when(afio::ALWAYS, 1))),
];

/// RM0008.
pub(crate) const F103: Pins = Pins {
    channels: [F103_CHANNELS, &[]],
    complementary: [
        &[
            (1, 1, route(B, 13, when(afio::TIM1, 0b0001))),
            (1, 2, route(B, 14, when(afio::TIM1, 0b0001))),
            (1, 3, route(B, 15, when(afio::TIM1, 0b0001))),
            (1, 1, route(A, 7, when(afio::TIM1, 0b0010))),
            (1, 2, route(B, 0, when(afio::TIM1, 0b0010))),
            (1, 3, route(B, 1, when(afio::TIM1, 0b0010))),
            (8, 1, route(A, 7, when(afio::ALWAYS, 1))),
            (8, 2, route(B, 0, when(afio::ALWAYS, 1))),
            (8, 3, route(B, 1, when(afio::ALWAYS, 1))),
        ],
        &[],
    ],
    breaks: [
        &[
            (1, 0, route(B, 12, when(afio::TIM1, 0b0001))),
            (1, 0, route(A, 6, when(afio::TIM1, 0b0010))),
            (8, 0, route(A, 6, when(afio::ALWAYS, 1))),
        ],
        &[],
    ],
    can1_receive: &[
        route(A, 11, when(afio::CAN, 0b0001)),
        route(B, 8, when(afio::CAN, 0b0100)),
    ],
    can1_transmit: &[
        route(A, 12, when(afio::CAN, 0b0001)),
        route(B, 9, when(afio::CAN, 0b0100)),
    ],
    can2_receive: &[],
    can2_transmit: &[],
    usart2_receive: &[route(A, 3, when(afio::USART2, 0b01))],
    usart2_transmit: &[route(A, 2, when(afio::USART2, 0b01))],
    spi1: [&[]; 3],
};

impl Pins {
    /// Pins that can carry channel 1..=4 of a timer.
    pub(crate) fn timer_channel(
        &self,
        timer: usize,
        channel: usize,
    ) -> impl Iterator<Item = &'static Route> {
        let rows = self.channels.into_iter().flatten();
        rows.filter(move |row| (row.0, row.1) == (timer, channel))
            .map(|row| &row.2)
    }

    /// Pins that can carry the complementary output of channel 1..=3 of a timer.
    pub(crate) fn complementary(
        &self,
        timer: usize,
        channel: usize,
    ) -> impl Iterator<Item = &'static Route> {
        let rows = self.complementary.into_iter().flatten();
        rows.filter(move |row| (row.0, row.1) == (timer, channel))
            .map(|row| &row.2)
    }

    /// Complementary outputs (timer, channel from 1) that a pin can carry.
    pub(crate) fn complementary_at(
        &self,
        port: Port,
        pin: u8,
    ) -> impl Iterator<Item = &'static Row> {
        at(self.complementary, port, pin)
    }

    /// Pins that can carry the break input of TIM1 or TIM8.
    pub(crate) fn break_input(&self, timer: usize) -> impl Iterator<Item = &'static Route> {
        let rows = self.breaks.into_iter().flatten();
        rows.filter(move |row| row.0 == timer).map(|row| &row.2)
    }

    /// Channels of timers (timer, channel from 1) that a pin can carry.
    pub(crate) fn channels_at(&self, port: Port, pin: u8) -> impl Iterator<Item = &'static Row> {
        at(self.channels, port, pin)
    }

    /// Outputs of CAN1, CAN2 and USART2.
    pub(crate) fn bus_outputs(&self) -> impl Iterator<Item = &'static Route> {
        [self.can1_transmit, self.can2_transmit, self.usart2_transmit]
            .into_iter()
            .flatten()
    }
}

fn at(tables: [&'static [Row]; 2], port: Port, pin: u8) -> impl Iterator<Item = &'static Row> {
    let rows = tables.into_iter().flatten();
    rows.filter(move |row| row.2.port == port && row.2.pin == pin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_pin_has_two_signals_in_one_function() {
        for pins in [F446, F407] {
            let tables = [pins.channels, pins.complementary, pins.breaks];
            let all: Vec<_> = tables.as_flattened().concat();
            for (index, one) in all.iter().enumerate() {
                let other = all[index + 1..].iter().find(|other| other.2 == one.2);
                assert!(other.is_none(), "{one:?}, {other:?}");
            }
        }
        let channels = |pins: Pins, port, pin| {
            let rows = pins.channels_at(port, pin);
            rows.map(|row| (row.0, row.1, row.2.af)).collect::<Vec<_>>()
        };
        assert_eq!(channels(F446, Port::A, 8), [(1, 1, 1)]);
        assert_eq!(channels(F407, Port::E, 14), [(1, 4, 1)]);
        assert_eq!(channels(F446, Port::E, 14), []);
        assert_eq!(channels(F446, Port::B, 8).len(), 3);
        assert_eq!(channels(F407, Port::B, 8).len(), 2);
    }

    /// The remaps of one timer never give a channel to two pins, or to none.
    #[test]
    fn every_remap_of_an_stm32f103_has_one_pin_for_each_channel() {
        // What the package with 64 pins lacks: port E, and all but three of port D.
        for (timer, remaps) in [(1, 0b0011), (2, 0b1111), (3, 0b1101), (4, 0b01), (8, 1)] {
            for value in (0..4).filter(|value| remaps >> value & 1 != 0) {
                for channel in 1..=4 {
                    let pins = F103.timer_channel(timer, channel);
                    let count = pins.filter(|route| route.af >> value & 1 != 0).count();
                    assert_eq!(count, 1, "TIM{timer} remap {value} channel {channel}");
                }
            }
        }
    }
}
