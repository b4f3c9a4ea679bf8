//! Which pin carries which signal in which alternate function, for the signals that are modelled:
//! data sheet DS10693 rev 10, table 11, as far as the pins exist on the 64-pin package; DS8626 rev
//! 9, table 9, for the package with 176 pins. What both chips have is in tables of its own.

use crate::system::gpio::Port;

/// A pin with the alternate function that connects it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Route {
    /// Port.
    pub port: Port,
    /// Pin, 0..=15.
    pub pin: u8,
    /// Alternate function.
    pub af: u8,
}

const fn route(port: Port, pin: u8, af: u8) -> Route {
    Route { port, pin, af }
}

use Port::{A, B, C, D, E, F, H, I};

/// A timer or its break input, with a channel from 1 or 0, and a pin that can carry it.
type Row = (usize, usize, Route);

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
}

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

    /// The timer and channel (from 1) whose complementary output this is.
    pub(crate) fn complementary_at(&self, route: Route) -> Option<(usize, usize)> {
        at(self.complementary, route)
    }

    /// Pins that can carry the break input of TIM1 or TIM8.
    pub(crate) fn break_input(&self, timer: usize) -> impl Iterator<Item = &'static Route> {
        let rows = self.breaks.into_iter().flatten();
        rows.filter(move |row| row.0 == timer).map(|row| &row.2)
    }

    /// The timer channel (timer, channel from 1) that an alternate function connects to a pin.
    pub(crate) fn timer_at(&self, port: Port, pin: u8, af: u8) -> Option<(usize, usize)> {
        at(self.channels, Route { port, pin, af })
    }

    /// Whether this is an output of CAN1, CAN2 or USART2.
    pub(crate) fn is_bus_output(&self, route: Route) -> bool {
        [self.can1_transmit, self.can2_transmit, self.usart2_transmit]
            .into_iter()
            .any(|routes| routes.contains(&route))
    }
}

fn at(tables: [&'static [Row]; 2], route: Route) -> Option<(usize, usize)> {
    let mut rows = tables.into_iter().flatten();
    let row = rows.find(|row| row.2 == route)?;
    Some((row.0, row.1))
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
        assert_eq!(F446.timer_at(Port::A, 8, 1), Some((1, 1)));
        assert_eq!(F446.timer_at(Port::A, 8, 2), None);
        assert_eq!(F407.timer_at(Port::E, 14, 1), Some((1, 4)));
        assert_eq!(F446.timer_at(Port::E, 14, 1), None);
        assert_eq!(F407.timer_at(Port::B, 8, 1), None, "the STM32F446's alone");
    }
}
