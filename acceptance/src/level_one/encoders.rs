//! The encoder inputs, with signals from the board's own pins.

use protocol::self_test::{ENCODER, METERS};

use super::{Session, WHEELS, What};
use crate::check::Bound;
use crate::promise::{self, ACCEPTANCE};
use crate::wires::{self, DIRECTION, PWM, SUPPLY};

/// Edges in a test.
const EDGES: i16 = 400;

impl Session<'_> {
    /// Checks counts in both directions, and that short pulses do not count.
    pub(super) fn encoders(&mut self) -> anyhow::Result<()> {
        self.ready()?;
        for wheel in 0..4 {
            let pins = [PWM, DIRECTION].map(|wires| wires::at(wires[wheel]).from);
            for (pin, sub) in pins.into_iter().zip(2..) {
                self.drive(pin, false)?;
                self.node.write(ENCODER, sub, &[pin])?;
            }
            for (name, edges, noisy) in [
                ("forwards", EDGES, false),
                ("backwards", -EDGES, false),
                ("noise", EDGES, true),
            ] {
                let counted = self.turn(wheel, edges, noisy)?;
                let what = What {
                    name: format!("encoder.{}.{name}", WHEELS[wheel]),
                    promised: Bound::Near(f64::from(edges), 0.0),
                    unit: "counts",
                    source: if noisy {
                        "docs/bring-up.md: a level takes effect once it has lasted 89 ns".to_owned()
                    } else {
                        "docs/bring-up.md: encoders".to_owned()
                    },
                    procedure: if noisy {
                        "400 edges, each inside a pulse of some 30 ns at the other input"
                    } else {
                        "400 edges, 5 us apart"
                    },
                };
                self.check(what, Ok(f64::from(counted)));
            }
        }
        Ok(())
    }

    /// Makes edges; returns what was counted.
    fn turn(&mut self, wheel: usize, edges: i16, noisy: bool) -> anyhow::Result<i16> {
        let counter = wheel as u8 + 6;
        self.node.write(ENCODER, 4, &[5])?;
        self.node.write(ENCODER, 5, &[u8::from(noisy)])?;
        let before = self.node.read(ENCODER, counter)? as u16;
        self.node.write(ENCODER, 1, &edges.to_le_bytes())?;
        let after = self.node.read(ENCODER, counter)? as u16;
        Ok(after.wrapping_sub(before).cast_signed())
    }

    /// Checks the supply's input with both rails of the chip.
    pub(super) fn supply(&mut self) -> anyhow::Result<()> {
        let source = wires::at(SUPPLY).from;
        let tolerance = promise::number(ACCEPTANCE, "reads the supply of the chip within", "mV")?;
        for (name, high, millivolts) in [("supply.high", true, 3300.0), ("supply.low", false, 0.0)]
        {
            self.drive(source, high)?;
            self.node.wait(2_000)?;
            // The first reading has compared the references.
            self.node.read(METERS, 1)?;
            let measured = self.node.read(METERS, 1)?;
            let what = What {
                name: name.to_owned(),
                promised: Bound::Near(millivolts, tolerance.value),
                unit: "mV",
                source: tolerance.source.clone(),
                procedure: "an output of the chip at the converter's input",
            };
            self.check(what, Ok(f64::from(measured)));
        }
        Ok(())
    }
}
