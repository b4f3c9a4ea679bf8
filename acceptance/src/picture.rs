//! The picture of the jumper wires: the connectors of the reference board from above, and [`all`]
//! wires between their pins, numbered in the order in which they are put in. The one from a second
//! board is dashed and begins below the board.
//!
//! It is drawn from the table that the checks use, so it cannot show other wires. Limits: it knows
//! only the two 38-pin connectors of a NUCLEO-64.

use std::fmt::Write as _;

use crate::wires::{self, Numbered, Wire, all};

/// Pins in a column of a connector.
const ROWS: u8 = 19;
/// Distance between two rows, and between the columns of a connector.
const PITCH: f64 = 24.0;
/// Place of pin 1.
const TOP: f64 = 96.0;
/// Left columns of CN7 and CN10.
const LEFT: [f64; 2] = [150.0, 460.0];
/// Radius of a numbered pin.
const DISC: f64 = 9.0;
/// Where the list of wires begins.
const LIST: f64 = 610.0;

/// Where the wire from a second board begins, below the first one, and how far right of its pin on
/// the first one its number is: another wire has its number on that pin.
const SECOND_BOARD: (f64, f64) = (430.0, 597.0);
const BESIDE: f64 = 62.0;

/// Kinds of wires: how their purpose begins, and their colour.
const COLOURS: [(&str, &str); 7] = [
    ("PWM", "#c2410c"),
    ("direction", "#1d4ed8"),
    ("inverse", "#15803d"),
    ("supply", "#7a5230"),
    ("stop", "#b91c1c"),
    ("the other board", "#0e7490"),
    ("", "#7e22ce"),
];

fn colour(wire: &Wire) -> &'static str {
    let of = COLOURS.iter().find(|row| wire.what.starts_with(row.0));
    of.map_or("", |row| row.1)
}

/// Connector (0 is CN7) and pin in it.
fn socket(pin: u8) -> Option<(usize, u8)> {
    let (connector, number) = wires::connector(pin).split_once('-')?;
    let connector = ["CN7", "CN10"].iter().position(|name| *name == connector)?;
    Some((connector, number.parse().ok()?))
}

/// Where a pin of a connector is: odd numbers left, even ones right, pin 1 on top.
fn place((connector, number): (usize, u8)) -> (f64, f64) {
    let row = f64::from((number - 1) / 2);
    let column = f64::from((number - 1) % 2);
    (LEFT[connector] + PITCH * column, TOP + PITCH * row)
}

/// The picture as SVG.
#[must_use]
pub fn svg() -> String {
    let height = TOP + PITCH * f64::from(ROWS) + 64.0;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1240 {height}\" \
         font-family=\"sans-serif\" font-size=\"13\">\n\
         <title>Jumper wires of level 1 on the NUCLEO-F446RE</title>\n\
         <rect width=\"1240\" height=\"{height}\" fill=\"#fff\"/>\n\
         <rect x=\"78\" y=\"28\" width=\"480\" height=\"{}\" rx=\"10\" fill=\"#f4f6f8\" \
         stroke=\"#5b6673\"/>\n\
         <text x=\"318\" y=\"50\" text-anchor=\"middle\">NUCLEO-F446RE from above, USB at the \
         top</text>\n",
        height - 68.0
    );
    for (connector, name) in ["CN7", "CN10"].into_iter().enumerate() {
        let middle = LEFT[connector] + PITCH / 2.0;
        let _ = writeln!(
            out,
            "<text x=\"{middle}\" y=\"76\" text-anchor=\"middle\" font-weight=\"bold\">{name}\
             </text>"
        );
        for number in 1..=2 * ROWS {
            let (x, y) = place((connector, number));
            let _ = writeln!(
                out,
                "<circle cx=\"{x}\" cy=\"{y}\" r=\"3\" fill=\"#9aa5b1\"/>"
            );
        }
    }
    for numbered in all() {
        match numbered.is_of_second {
            true => curve_from_second(&mut out, &numbered),
            false => curve(&mut out, &numbered.wire),
        }
    }
    for numbered in all() {
        let Numbered { number, wire, .. } = numbered;
        if numbered.is_of_second {
            ends_of_second(&mut out, &numbered);
            continue;
        }
        for pin in [wire.from, wire.to] {
            end(&mut out, number, pin, colour(&wire));
        }
    }
    list(&mut out);
    out += "</svg>\n";
    out
}

/// A wire, bent into the space between the connectors.
fn curve(out: &mut String, wire: &Wire) {
    let (Some(from), Some(to)) = (socket(wire.from), socket(wire.to)) else {
        return;
    };
    let ((x1, y1), (x2, y2)) = (place(from), place(to));
    // Wires of one connector keep clear of its own pins: the longer, the wider the bend.
    let bend = match from.0 == to.0 {
        true => 50.0 + (y2 - y1).abs() / 4.0,
        false => 110.0,
    };
    let inwards = |connector: usize| if connector == 0 { bend } else { -bend };
    let _ = writeln!(
        out,
        "<path d=\"M {x1} {y1} C {} {y1} {} {y2} {x2} {y2}\" fill=\"none\" stroke=\"{}\" \
         stroke-width=\"2\" stroke-opacity=\"0.75\"/>",
        x1 + inwards(from.0),
        x2 + inwards(to.0),
        colour(wire)
    );
}

/// The wire from a second board, of which the pin alone is shown.
fn curve_from_second(out: &mut String, numbered: &Numbered) {
    let Some(socket) = socket(numbered.wire.to) else {
        return;
    };
    let ((x1, y1), (x2, y2)) = (SECOND_BOARD, place(socket));
    let beside = x2 + BESIDE;
    let _ = writeln!(
        out,
        "<path d=\"M {x1} {y1} C {beside} {y1} {beside} {y1} {beside} {y2} L {x2} {y2}\" \
         fill=\"none\" stroke=\"{}\" stroke-width=\"2\" stroke-dasharray=\"6 3\"/>",
        colour(&numbered.wire)
    );
}

/// Its ends: below the board, and beside its pin.
fn ends_of_second(out: &mut String, numbered: &Numbered) {
    let Some(socket) = socket(numbered.wire.to) else {
        return;
    };
    let ((x1, y1), (x2, y2)) = (SECOND_BOARD, place(socket));
    for at in [(x1, y1), (x2 + BESIDE, y2)] {
        disc(out, at, numbered.number, colour(&numbered.wire));
    }
    let _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"end\" font-size=\"11\">{}</text>",
        x1 - 13.0,
        y1 + 4.5,
        numbered.ends()[0]
    );
}

/// A number in its circle.
fn disc(out: &mut String, (x, y): (f64, f64), number: usize, colour: &str) {
    let _ = writeln!(
        out,
        "<circle cx=\"{x}\" cy=\"{y}\" r=\"{DISC}\" fill=\"{colour}\"/>\
         <text x=\"{x}\" y=\"{}\" text-anchor=\"middle\" fill=\"#fff\" font-size=\"11\" \
         font-weight=\"bold\">{number}</text>",
        y + 4.5
    );
}

/// The end of a wire: its number on the pin, and the pin's name beside the connector.
fn end(out: &mut String, number: usize, pin: u8, colour: &str) {
    let Some(socket) = socket(pin) else { return };
    let (x, y) = place(socket);
    let base = y + 4.5;
    disc(out, (x, y), number, colour);
    let (offset, anchor) = match socket.1 % 2 {
        1 => (-13.0, "end"),
        _ => (13.0, "start"),
    };
    let _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{base}\" text-anchor=\"{anchor}\" font-size=\"11\" stroke=\"#f4f6f8\" \
         stroke-width=\"3\" paint-order=\"stroke\">{}</text>",
        x + offset,
        wires::name(pin)
    );
}

/// The wires in their order.
fn list(out: &mut String) {
    for numbered in all() {
        let y = TOP + PITCH * numbered.number as f64;
        let wire = &numbered.wire;
        disc(out, (LIST, y - 4.5), numbered.number, colour(wire));
        let [from, to] = numbered.ends();
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"{y}\">{from} to {to}: {}</text>",
            LIST + 20.0,
            wire.what
        );
    }
    let _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{TOP}\" font-weight=\"bold\">Wires, in the order in which they are put \
         in</text>",
        LIST - DISC
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wire_begins_and_ends_at_its_pins() {
        let picture = svg();
        for numbered in all() {
            let wire = numbered.wire;
            let [from, to] = [wire.from, wire.to].map(|pin| place(socket(pin).unwrap()));
            let from = if numbered.is_of_second {
                SECOND_BOARD
            } else {
                from
            };
            let begins = format!("M {} {} C", from.0, from.1);
            let ends = format!(" {} {}\" fill", to.0, to.1);
            let curve = picture.lines().find(|line| line.contains(&begins));
            assert!(curve.is_some_and(|line| line.contains(&ends)), "{wire:?}");
            // Its number at both ends and in the list, and the list's words.
            let number = format!(">{}</text>", numbered.number);
            assert_eq!(picture.matches(&number).count(), 3, "{wire:?}");
            let [from, to] = numbered.ends();
            let words = format!(">{from} to {to}: {}</text>", wire.what);
            assert!(picture.contains(&words), "{words}");
        }
        assert_eq!(picture.matches("<path").count(), all().count());
    }

    /// UM1724 rev 15, table 29: PC10 and PC11 are CN7's first two pins, PC9 and PC8 CN10's.
    #[test]
    fn odd_pins_are_left_and_the_first_is_on_top() {
        let pc9 = place(socket(protocol::self_test::pin(b'C', 9)).unwrap());
        let pc8 = place(socket(protocol::self_test::pin(b'C', 8)).unwrap());
        assert_eq!((pc9, pc8), ((460.0, 96.0), (484.0, 96.0)));
    }

    #[test]
    fn the_page_has_this_picture() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/acceptance-wires.svg");
        if std::env::var_os("OMNIBUS_WRITE_DOCS").is_some() {
            std::fs::write(path, svg()).unwrap();
            return;
        }
        let there = std::fs::read_to_string(path).unwrap();
        assert_eq!(there, svg(), "write it with OMNIBUS_WRITE_DOCS=1");
    }
}
