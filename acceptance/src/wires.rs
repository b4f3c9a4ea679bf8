//! The wires of level 1 on the reference board, in the order in which they are put in.
//!
//! Each connects an output with an input of the board itself. The outputs are those of the power
//! stage, so each is seen at the pin that a driver would be connected to.

use protocol::self_test::pin;

/// A jumper wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wire {
    /// The output.
    pub from: u8,
    /// The input.
    pub to: u8,
    /// What it is for.
    pub what: &'static str,
}

const fn wire(from: u8, to: u8, what: &'static str) -> Wire {
    Wire { from, to, what }
}

/// PWM of the wheels in their order, at inputs A of their encoders.
pub const PWM: [u8; 4] = [0, 1, 2, 3];
/// Directions, at inputs B.
pub const DIRECTION: [u8; 4] = [4, 5, 6, 7];
/// Inverse directions, at the inputs of the index.
pub const INVERSE: [u8; 4] = [8, 9, 10, 11];
/// Driver enable.
pub const ENABLE: u8 = 12;
/// Brake release.
pub const BRAKE: u8 = 13;
/// Emergency stop, at the break input of TIM1, and of TIM8.
pub const STOP: [u8; 2] = [14, 15];
/// Supply voltage.
pub const SUPPLY: u8 = 16;

/// Wires that stay in beside a second board: its own signal, and the stop.
pub const WITH_SECOND: [u8; 3] = [INVERSE[3], STOP[0], STOP[1]];
/// The wire from the second board to the first: the last one of [`all`].
pub const SECOND: Wire = wire(pin(b'D', 2), pin(b'B', 14), "the other board's inverse");

/// The wires of one board, in their order.
pub const WIRES: [Wire; 17] = [
    wire(pin(b'A', 8), pin(b'A', 15), "PWM front left"),
    wire(pin(b'A', 9), pin(b'C', 6), "PWM front right"),
    wire(pin(b'A', 10), pin(b'B', 6), "PWM rear left"),
    wire(pin(b'A', 11), pin(b'A', 0), "PWM rear right"),
    wire(pin(b'C', 0), pin(b'B', 3), "direction front left"),
    wire(pin(b'C', 1), pin(b'C', 7), "direction front right"),
    wire(pin(b'C', 2), pin(b'B', 7), "direction rear left"),
    wire(pin(b'C', 3), pin(b'A', 1), "direction rear right"),
    wire(pin(b'B', 2), pin(b'B', 10), "inverse front left"),
    wire(pin(b'B', 4), pin(b'A', 12), "inverse front right"),
    wire(pin(b'B', 5), pin(b'B', 14), "inverse rear left"),
    wire(pin(b'D', 2), pin(b'B', 15), "inverse rear right"),
    wire(pin(b'B', 0), pin(b'B', 13), "driver enable"),
    wire(pin(b'B', 1), pin(b'C', 12), "brake release"),
    wire(pin(b'C', 8), pin(b'B', 12), "stop of the PWM"),
    wire(
        pin(b'C', 9),
        pin(b'A', 6),
        "stop of driver enable and brake",
    ),
    wire(pin(b'C', 10), pin(b'A', 4), "supply voltage"),
];

/// Where the pins are on the Nucleo's connectors (UM1724 rev 15, table 29).
const CONNECTORS: [(&str, &str); 34] = [
    ("PC10", "CN7-1"),
    ("PC12", "CN7-3"),
    ("PD2", "CN7-4"),
    ("PA15", "CN7-17"),
    ("PB7", "CN7-21"),
    ("PA0", "CN7-28"),
    ("PA1", "CN7-30"),
    ("PA4", "CN7-32"),
    ("PB0", "CN7-34"),
    ("PC2", "CN7-35"),
    ("PC1", "CN7-36"),
    ("PC3", "CN7-37"),
    ("PC0", "CN7-38"),
    ("PC9", "CN10-1"),
    ("PC8", "CN10-2"),
    ("PC6", "CN10-4"),
    ("PA12", "CN10-12"),
    ("PA6", "CN10-13"),
    ("PA11", "CN10-14"),
    ("PB12", "CN10-16"),
    ("PB6", "CN10-17"),
    ("PC7", "CN10-19"),
    ("PA9", "CN10-21"),
    ("PB2", "CN10-22"),
    ("PA8", "CN10-23"),
    ("PB1", "CN10-24"),
    ("PB10", "CN10-25"),
    ("PB15", "CN10-26"),
    ("PB4", "CN10-27"),
    ("PB14", "CN10-28"),
    ("PB5", "CN10-29"),
    ("PB13", "CN10-30"),
    ("PB3", "CN10-31"),
    ("PA10", "CN10-33"),
];

/// Where a pin of the wires is on the board: `CN10-16`.
#[must_use]
pub fn connector(pin: u8) -> &'static str {
    let name = name(pin);
    let found = CONNECTORS.iter().find(|row| row.0 == name);
    found.map_or("", |row| row.1)
}

/// One of [`all`] wires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Numbered {
    /// Its number, from 1 on: what texts, table and picture call it.
    pub number: usize,
    /// The wire.
    pub wire: Wire,
    /// Whether it comes from a second board.
    pub is_of_second: bool,
}

/// All wires with their numbers. Table, picture and texts are made from this.
pub fn all() -> impl Iterator<Item = Numbered> {
    let every = WIRES.into_iter().chain([SECOND]);
    (1..).zip(every).map(|(number, wire)| Numbered {
        number,
        wire,
        is_of_second: number > WIRES.len(),
    })
}

/// The number of the wire from the second board.
pub const SECOND_NUMBER: usize = WIRES.len() + 1;

impl Numbered {
    /// Both ends in words: `PA8 (CN10-23)`.
    #[must_use]
    pub fn ends(&self) -> [String; 2] {
        let end = |pin| format!("{} ({})", name(pin), connector(pin));
        let [from, to] = [self.wire.from, self.wire.to].map(end);
        match self.is_of_second {
            true => [from + " of the second board", to + " of the first"],
            false => [from, to],
        }
    }
}

/// The wires as a table of Markdown, for docs/acceptance.md.
#[must_use]
pub fn table() -> String {
    let mut text = "| wire | from | to | for |\n|---|---|---|---|\n".to_owned();
    for wire in all() {
        let [from, to] = wire.ends();
        text += &format!("| {} | {from} | {to} | {} |\n", wire.number, wire.wire.what);
    }
    text
}

/// The wire with this place in [`WIRES`].
#[must_use]
pub fn at(place: u8) -> Wire {
    WIRES[usize::from(place)]
}

/// The name of a pin: `PB12`.
#[must_use]
pub fn name(pin: u8) -> String {
    let port = char::from(b'A' + (pin >> 4));
    format!("P{port}{}", pin & 15)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pin_has_one_wire() {
        let ends = WIRES.iter().flat_map(|wire| [wire.from, wire.to]);
        let mut ends: Vec<u8> = ends.collect();
        let count = ends.len();
        ends.sort_unstable();
        ends.dedup();
        assert_eq!(ends.len(), count);
        assert_eq!(name(pin(b'B', 12)), "PB12");
    }

    #[test]
    fn the_page_has_these_wires() {
        let page = include_str!("../../docs/acceptance.md");
        assert!(
            page.contains(&table()),
            "docs/acceptance.md lacks\n{}",
            table()
        );
    }

    /// The page says in words how many wires there are, and which one is the second board's.
    #[test]
    fn the_text_counts_as_the_table_does() {
        let page = include_str!("../../docs/acceptance.md");
        let words = [
            format!("a bare board, {} jumper wires", WIRES.len()),
            format!("**Wire {SECOND_NUMBER}** leads from {} ", name(SECOND.from)),
            format!("to {} ({})", name(SECOND.to), connector(SECOND.to)),
            "all wires but 12, 15 and 16;".to_owned(),
        ];
        for words in words {
            assert!(page.contains(&words), "docs/acceptance.md lacks '{words}'");
        }
        assert_eq!(WITH_SECOND.map(|place| place + 1), [12, 15, 16]);
        assert_eq!(all().count(), SECOND_NUMBER);
        assert_eq!(all().last().map(|wire| wire.wire), Some(SECOND));
    }

    /// What bring-up.md calls a pin that it gives a connector for.
    #[test]
    fn connectors_are_those_of_the_wiring() {
        let page = include_str!("../../docs/bring-up.md");
        assert!(page.contains("PA8 PA9 PA10 PA11 | D7 D8 D2 CN10-14"));
        assert_eq!(connector(pin(b'A', 11)), "CN10-14");
        assert!(
            WIRES
                .iter()
                .all(|wire| !connector(wire.from).is_empty() && !connector(wire.to).is_empty())
        );
    }
}
