//! The wires themselves, before anything is measured with them.
//!
//! The far ends of the wires are driven low, one after the other, while all other pins are inputs
//! with pull-ups: the pins that become low are connected with it. Driver enable and brake release
//! are never driven this way. They are low outputs, so a wire to one of them shows because the pull
//! resistors at its far end have no effect; which of the two it is shows when each is switched.

use protocol::self_test::{LEVELS, OUTPUTS, PIN};

use super::{Session, What};
use crate::check::Bound;
use crate::wires::{self, BRAKE, ENABLE, WIRES, Wire};

/// Pull resistors, as the self-test image has them.
const NONE: u8 = 0;
const UP: u8 = 1;
const DOWN: u8 = 2;

/// What was seen of a wire.
#[derive(Clone, PartialEq)]
enum Seen {
    Right,
    Missing,
    /// It leads to these pins.
    Elsewhere(Vec<u8>),
}

/// Whether it is the wire of driver enable or brake release.
fn is_gate(wire: &Wire) -> bool {
    *wire == wires::at(ENABLE) || *wire == wires::at(BRAKE)
}

impl Session<'_> {
    /// Checks every wire; whether all are right.
    pub(super) fn wires(&mut self) -> anyhow::Result<bool> {
        self.reset()?;
        let mut seen = self.by_driving()?;
        // The pull-up of an input would look like an output.
        for wire in WIRES.iter().filter(|wire| !is_gate(wire)) {
            self.node.write(PIN, 1, &[wire.from, NONE])?;
        }
        seen[usize::from(ENABLE)] = self.has_a_gate(ENABLE)?;
        seen[usize::from(BRAKE)] = self.has_a_gate(BRAKE)?;
        self.ready()?;
        self.distinguish_gates(&mut seen)?;
        for (place, wire) in WIRES.iter().enumerate() {
            let what = What {
                name: format!("wire.{:02}", place + 1),
                promised: Bound::Near(1.0, 0.0),
                unit: "wire",
                source: format!(
                    "docs/acceptance.md: wire {}, {} to {}",
                    place + 1,
                    wires::name(wire.from),
                    wires::name(wire.to)
                ),
                procedure: "one end is driven, all other pins are read",
            };
            self.check(what, Ok(f64::from(u8::from(seen[place] == Seen::Right))));
            if let Some(check) = self.checks.last_mut() {
                check.note = remedy(&seen, place);
            }
        }
        Ok(seen.iter().all(|seen| *seen == Seen::Right))
    }

    /// Every wire but those of the gates.
    fn by_driving(&mut self) -> anyhow::Result<Vec<Seen>> {
        for wire in &WIRES {
            self.node.write(PIN, 1, &[wire.to, UP])?;
            if !is_gate(wire) {
                self.node.write(PIN, 1, &[wire.from, UP])?;
            }
        }
        let before = self.low_pins()?;
        let mut seen = Vec::new();
        for wire in &WIRES {
            if is_gate(wire) {
                seen.push(Seen::Missing);
                continue;
            }
            self.drive(wire.to, false)?;
            let mut low = self.low_pins()?;
            self.node.write(PIN, 1, &[wire.to, UP])?;
            low.retain(|pin| *pin != wire.to && !before.contains(pin));
            seen.push(match low[..] {
                // Low before: it leads to driver enable or brake release.
                [] if before.contains(&wire.to) => {
                    let gates = [ENABLE, BRAKE].map(|gate| wires::at(gate).from);
                    Seen::Elsewhere(gates.to_vec())
                }
                [] => Seen::Missing,
                [pin] if pin == wire.from => Seen::Right,
                _ => Seen::Elsewhere(low),
            });
        }
        Ok(seen)
    }

    /// The pins of wires that are low.
    fn low_pins(&mut self) -> anyhow::Result<Vec<u8>> {
        let mut ports = [0; 4];
        for (port, sub) in ports.iter_mut().zip(1..) {
            *port = self.node.read(LEVELS, sub)?;
        }
        let ends = WIRES.iter().flat_map(|wire| [wire.from, wire.to]);
        let low = |pin: &u8| ports[usize::from(pin >> 4)] >> (pin & 15) & 1 == 0;
        Ok(ends.filter(low).collect())
    }

    /// Whether the far end of a gate's wire is connected with an output at all.
    fn has_a_gate(&mut self, gate: u8) -> anyhow::Result<Seen> {
        let pin = wires::at(gate).to;
        self.node.write(PIN, 1, &[pin, DOWN])?;
        let down = self.level(pin)?;
        self.node.write(PIN, 1, &[pin, UP])?;
        let up = self.level(pin)?;
        Ok(if up && !down {
            Seen::Missing
        } else {
            Seen::Right
        })
    }

    /// Switches each gate, and finds the wires that lead to the other one.
    fn distinguish_gates(&mut self, seen: &mut [Seen]) -> anyhow::Result<()> {
        for (gate, other, sub) in [(ENABLE, BRAKE, 5), (BRAKE, ENABLE, 6)] {
            let pins = [wires::at(gate).to, wires::at(other).to];
            let before = [self.level(pins[0])?, self.level(pins[1])?];
            self.node.write(OUTPUTS, sub, &[1])?;
            let after = [self.level(pins[0])?, self.level(pins[1])?];
            self.node.write(OUTPUTS, sub, &[0])?;
            let place = usize::from(other);
            if before[0] == after[0] && before[1] != after[1] && seen[place] == Seen::Right {
                seen[place] = Seen::Elsewhere(vec![wires::at(gate).from]);
            }
        }
        Ok(())
    }
}

/// What to do about a wire.
fn remedy(seen: &[Seen], place: usize) -> String {
    let wire = WIRES[place];
    let (number, to) = (place + 1, wires::name(wire.to));
    let from = wires::name(wire.from);
    match &seen[place] {
        Seen::Right => String::new(),
        Seen::Missing => {
            format!(
                "wire {number} is missing: connect {from} with {to} ({})",
                wire.what
            )
        }
        Seen::Elsewhere(pins) => {
            let swapped = |other: &usize| {
                let there = Seen::Elsewhere(vec![wire.from]);
                pins[..] == [WIRES[*other].from] && seen[*other] == there
            };
            if let Some(other) = (0..WIRES.len()).find(swapped) {
                return format!("wires {number} and {} are swapped", other + 1);
            }
            let pins: Vec<String> = pins.iter().map(|pin| wires::name(*pin)).collect();
            let pins = pins.join(" or ");
            format!("wire {number} is wrong: {to} is connected with {pins} instead of {from}")
        }
    }
}
