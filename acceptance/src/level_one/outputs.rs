//! PWM, direction and the two gates, measured at the pins.

use anyhow::{Context as _, bail};
use protocol::self_test::{CLOCK, OUTPUTS, WAVE};

use super::{Session, WHEELS, What};
use crate::check::Bound;
use crate::promise::{self, ACCEPTANCE, BRING_UP, Promise};
use crate::wires::{self, BRAKE, DIRECTION, ENABLE, INVERSE, PWM};

/// Duties at which a PWM is measured, thousandths.
const DUTIES: [i16; 10] = [50, 150, 250, 350, 450, 550, 650, 750, 850, 950];
/// Duty at which the direction is read.
const SLOW: i16 = 300;

/// A wave at a pin.
struct Wave {
    hz: f64,
    duty: f64,
}

impl Session<'_> {
    /// Checks what the power stage is given.
    pub(super) fn outputs(&mut self) -> anyhow::Result<()> {
        self.ready()?;
        let hz = promise::number(BRING_UP, "PWM FL FR RL RR,", "kHz")?;
        let tolerance = promise::number(ACCEPTANCE, "frequency of a PWM is measured within", "%")?;
        let step = promise::number(ACCEPTANCE, "its duty within", "%")?;
        for wheel in 0..4 {
            self.pwm(wheel, &hz, tolerance.value / 100.0, &step)?;
            self.pwm_pin(wheel)?;
        }
        for wheel in 0..4 {
            self.direction(wheel)?;
        }
        self.gate("driver_enable", ENABLE, 5)?;
        self.gate("brake_release", BRAKE, 6)
    }

    fn set_duty(&mut self, wheel: usize, duty: i16) -> anyhow::Result<()> {
        self.node
            .write(OUTPUTS, wheel as u8 + 1, &duty.to_le_bytes())
            .map(drop)
    }

    /// The wave at a pin, if there is one.
    fn wave(&mut self, pin: u8) -> anyhow::Result<Option<Wave>> {
        self.node.write(WAVE, 1, &[pin])?;
        let periods = f64::from(self.node.read(WAVE, 4)?);
        let total = f64::from(self.node.read(WAVE, 2)?);
        let high = f64::from(self.node.read(WAVE, 3)?);
        let core_hz = f64::from(self.node.read(CLOCK, 2)?);
        Ok((periods > 0.0 && total > 0.0).then(|| Wave {
            hz: core_hz * periods / total,
            duty: high / total,
        }))
    }

    /// Frequency and duty of one channel at ten points.
    fn pwm(
        &mut self,
        wheel: usize,
        promised: &Promise,
        tolerance: f64,
        step: &Promise,
    ) -> anyhow::Result<()> {
        let pin = wires::at(PWM[wheel]).to;
        let nominal = promised.value * 1000.0;
        let (mut worst_hz, mut worst_duty) = (nominal, 0.0);
        let mut silent = None;
        for duty in DUTIES {
            self.set_duty(wheel, duty)?;
            let Some(wave) = self.wave(pin)? else {
                silent.get_or_insert(duty);
                continue;
            };
            if (wave.hz - nominal).abs() > (worst_hz - nominal).abs() {
                worst_hz = wave.hz;
            }
            let error = 100.0 * (wave.duty - f64::from(duty) / 1000.0).abs();
            worst_duty = f64::max(worst_duty, error);
        }
        self.set_duty(wheel, 0)?;
        let figure = |value: f64| match silent {
            None => Ok(value),
            Some(duty) => bail!(
                "{} does not change at a duty of {duty} / 1000",
                wires::name(pin)
            ),
        };
        let name = WHEELS[wheel];
        let frequency = What {
            name: format!("pwm.{name}.frequency"),
            promised: Bound::Near(nominal, nominal * tolerance),
            unit: "Hz",
            source: promised.source.clone(),
            procedure: "worst of ten duties, eight periods each",
        };
        self.check(frequency, figure(worst_hz));
        let duty = What {
            name: format!("pwm.{name}.duty"),
            promised: Bound::AtMost(step.value),
            unit: "%",
            source: step.source.clone(),
            procedure: "largest error at ten duties from 5 to 95 %",
        };
        self.check(duty, figure(worst_duty));
        Ok(())
    }

    /// At which wheel's pin a channel's PWM is.
    fn pwm_pin(&mut self, wheel: usize) -> anyhow::Result<()> {
        self.set_duty(wheel, 500)?;
        let mut at = Vec::new();
        for (other, wire) in (1..).zip(PWM) {
            if self.wave(wires::at(wire).to)?.is_some() {
                at.push(other);
            }
        }
        self.set_duty(wheel, 0)?;
        let what = What {
            name: format!("pwm.{}.pin", WHEELS[wheel]),
            promised: Bound::Near(wheel as f64 + 1.0, 0.0),
            unit: "wheel",
            source: "docs/bring-up.md: PWM FL FR RL RR".to_owned(),
            procedure: "the pin at which the PWM of this wheel alone is seen",
        };
        let measured = match at[..] {
            [one] => Ok(f64::from(one)),
            _ => Err(anyhow::anyhow!("it is seen at {} pins", at.len())),
        };
        self.check(what, measured);
        Ok(())
    }

    /// Direction and inverse of one wheel, forwards and backwards.
    fn direction(&mut self, wheel: usize) -> anyhow::Result<()> {
        let pins = [DIRECTION, INVERSE].map(|wires| wires::at(wires[wheel]).to);
        let mut right = [0.0; 2];
        for (duty, forward) in [(SLOW, true), (-SLOW, false)] {
            self.set_duty(wheel, duty)?;
            for (right, (pin, high)) in right
                .iter_mut()
                .zip([(pins[0], forward), (pins[1], !forward)])
            {
                *right += f64::from(u8::from(self.level(pin)? == high));
            }
        }
        self.set_duty(wheel, 0)?;
        for (kind, right) in ["direction", "inverse"].into_iter().zip(right) {
            let what = What {
                name: format!("{kind}.{}", WHEELS[wheel]),
                promised: Bound::Near(2.0, 0.0),
                unit: "right levels of 2",
                source: "docs/bring-up.md: direction FL FR RL RR".to_owned(),
                procedure: "the level at a duty of 30 % forwards, and backwards",
            };
            self.check(what, Ok(right));
        }
        Ok(())
    }

    /// Driver enable or brake release: off, on, off.
    fn gate(&mut self, name: &str, wire: u8, sub: u8) -> anyhow::Result<()> {
        let pin = wires::at(wire).to;
        let mut right = 0.0;
        for on in [false, true, false] {
            self.node.write(OUTPUTS, sub, &[u8::from(on)])?;
            let level = self.level(pin).context("a gate cannot be read")?;
            right += f64::from(u8::from(level == on));
        }
        let what = What {
            name: name.to_owned(),
            promised: Bound::Near(3.0, 0.0),
            unit: "right levels of 3",
            source: format!("docs/bring-up.md: {}", name.replace('_', " ")),
            procedure: "the level off, on and off again, with PWM low",
        };
        self.check(what, Ok(right));
        Ok(())
    }
}
