//! Which pin carries which signal in which alternate function (data sheet DS10693 rev 10, table
//! 11), for the signals that are modelled, as far as the pins exist on the 64-pin package.

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

use Port::{A, B, C};

/// Timer, channel from 1, and a pin that can carry it.
const TIMER_CHANNELS: &[(usize, usize, Route)] = &[
    (1, 1, route(A, 8, 1)),
    (1, 2, route(A, 9, 1)),
    (1, 3, route(A, 10, 1)),
    (1, 4, route(A, 11, 1)),
    (2, 1, route(A, 0, 1)),
    (2, 1, route(A, 5, 1)),
    (2, 1, route(A, 15, 1)),
    (2, 1, route(B, 8, 1)),
    (2, 2, route(A, 1, 1)),
    (2, 2, route(B, 3, 1)),
    (2, 2, route(B, 9, 1)),
    (2, 3, route(A, 2, 1)),
    (2, 3, route(B, 10, 1)),
    (2, 4, route(A, 3, 1)),
    (2, 4, route(B, 2, 1)),
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

/// Pins that can carry channel 1..=4 of a timer.
pub fn timer_channel(timer: usize, channel: usize) -> impl Iterator<Item = &'static Route> {
    TIMER_CHANNELS
        .iter()
        .filter(move |row| (row.0, row.1) == (timer, channel))
        .map(|row| &row.2)
}

/// Timer, channel from 1, and a pin that can carry its complementary output.
const COMPLEMENTARY: &[(usize, usize, Route)] = &[
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

/// The timer and channel (from 1) whose complementary output this is.
#[must_use]
pub fn complementary_at(route: Route) -> Option<(usize, usize)> {
    let row = COMPLEMENTARY.iter().find(|row| row.2 == route)?;
    Some((row.0, row.1))
}

const BREAK_INPUTS: &[(usize, Route)] = &[
    (1, route(A, 6, 1)),
    (1, route(B, 12, 1)),
    (8, route(A, 6, 3)),
];

/// Pins that can carry the break input of TIM1 or TIM8.
pub fn break_input(timer: usize) -> impl Iterator<Item = &'static Route> {
    BREAK_INPUTS
        .iter()
        .filter(move |row| row.0 == timer)
        .map(|row| &row.1)
}

/// Pins that can carry CAN1's receive line.
pub const CAN1_RX: &[Route] = &[route(A, 11, 9), route(B, 8, 9)];

/// Pins that can carry CAN1's transmit line.
pub const CAN1_TX: &[Route] = &[route(A, 12, 9), route(B, 9, 9)];

/// Pins that can carry CAN2's receive line.
pub const CAN2_RX: &[Route] = &[route(B, 5, 9), route(B, 12, 9)];

/// Pins that can carry CAN2's transmit line.
pub const CAN2_TX: &[Route] = &[route(B, 6, 9), route(B, 13, 9)];

/// Pins that can carry USART2's output.
pub const USART2_TX: &[Route] = &[route(A, 2, 7)];

/// Pins that can carry USART2's input.
pub const USART2_RX: &[Route] = &[route(A, 3, 7)];

/// The timer channel (timer, channel from 1) that an alternate function connects to a pin.
#[must_use]
pub fn timer_at(port: Port, pin: u8, af: u8) -> Option<(usize, usize)> {
    let route = Route { port, pin, af };
    TIMER_CHANNELS
        .iter()
        .find(|row| row.2 == route)
        .map(|row| (row.0, row.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_pin_has_two_signals_in_one_function() {
        let rows = TIMER_CHANNELS.iter().chain(COMPLEMENTARY);
        let all: Vec<_> = rows.map(|row| row.2).collect();
        for (index, one) in all.iter().enumerate() {
            assert!(!all[index + 1..].contains(one), "{one:?}");
        }
        assert_eq!(timer_at(Port::A, 8, 1), Some((1, 1)));
        assert_eq!(timer_at(Port::A, 8, 2), None);
    }
}
