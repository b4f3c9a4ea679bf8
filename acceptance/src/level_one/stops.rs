//! The emergency stop in hardware: the time from the edge at the input to the cut, without the
//! program.

use anyhow::bail;
use protocol::self_test::{CLOCK, NEVER, NO_PIN, OUTPUTS, WATCHED};

use super::{Session, What, at_most};
use crate::causes;
use crate::check::Bound;
use crate::wires::{self, BRAKE, ENABLE, PWM, STOP};

/// First sub-index of the times, and that of the pins.
const TIMES: u8 = 8;
const PINS: u8 = 2;

impl Session<'_> {
    /// Checks that both break inputs cut what they should.
    pub(super) fn stops(&mut self) -> anyhow::Result<()> {
        self.ready()?;
        for wheel in 1..=4 {
            self.node.write(OUTPUTS, wheel, &1000_i16.to_le_bytes())?;
        }
        self.stop("pwm", STOP[0], &PWM)?;
        self.ready()?;
        for gate in [5, 6] {
            self.node.write(OUTPUTS, gate, &[1])?;
        }
        self.stop("driver_enable_and_brake", STOP[1], &[ENABLE, BRAKE])
    }

    /// Raises an input, and checks when lines are low, and that they stay so.
    fn stop(&mut self, name: &str, source: u8, lines: &[u8]) -> anyhow::Result<()> {
        let pins: Vec<u8> = lines.iter().map(|line| wires::at(*line).to).collect();
        let mut high = true;
        for place in 0..WATCHED {
            let pin = pins.get(place).copied().unwrap_or(NO_PIN);
            self.node
                .write(protocol::self_test::STOP, PINS + place as u8, &[pin])?;
            if pin != NO_PIN {
                high &= self.level(pin)?;
            }
        }
        self.node
            .write(protocol::self_test::STOP, 1, &[wires::at(source).from])?;
        let per_ms = f64::from(self.node.read(CLOCK, 2)?) / 1000.0;
        let mut slowest = Ok(0.0);
        for (place, pin) in pins.iter().enumerate() {
            let clocks = self
                .node
                .read(protocol::self_test::STOP, TIMES + place as u8)?;
            slowest = match (slowest, clocks) {
                (Ok(_), NEVER) => Err(anyhow::anyhow!("{} stays high", wires::name(*pin))),
                (Ok(slowest), clocks) => Ok(f64::max(slowest, f64::from(clocks) / per_ms)),
                (error, _) => error,
            };
        }
        if !high {
            slowest = (|| bail!("a line was low before the stop"))();
        }
        let what = at_most(
            &format!("stop.{name}"),
            causes::time(15)?,
            "ms",
            "from the edge at the stop input to the last low line, with interrupts masked",
        );
        self.check(what, slowest);
        let mut back = 0.0;
        for pin in pins {
            back += f64::from(u8::from(self.level(pin)?));
        }
        let what = What {
            name: format!("stop.{name}.latched"),
            promised: Bound::Near(0.0, 0.0),
            unit: "lines",
            source: "docs/safety.md: never because an emergency stop was released".to_owned(),
            procedure: "lines that are high after the stop was released",
        };
        self.check(what, Ok(back));
        Ok(())
    }
}
