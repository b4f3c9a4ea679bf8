//! What a board drives its pins with.

use super::Board;
use crate::soc::Soc;
use crate::system::gpio::{PinLevel, Port};
use crate::timer::PwmState;

/// The outputs at one moment.
#[derive(Debug)]
pub struct Outputs<'a>(&'a mut Soc);

impl Outputs<'_> {
    /// How a pin drives the wire to which it is connected.
    #[must_use]
    pub fn level(&mut self, port: Port, pin: u8) -> PinLevel {
        self.0.output(port, pin & 15)
    }

    /// State of a PWM output: timer 1..=14, channel 1..=4.
    #[must_use]
    pub fn pwm(&mut self, timer: usize, channel: usize) -> PwmState {
        self.0.pwm(timer, channel)
    }

    /// The same of a complementary output, 1..=3, that is on without its main one.
    #[must_use]
    pub fn complementary_pwm(&mut self, timer: usize, channel: usize) -> PwmState {
        self.0.complementary_pwm(timer, channel)
    }
}

impl Board {
    /// Looks at several outputs.
    pub fn outputs<T>(&self, look: impl FnOnce(&mut Outputs<'_>) -> T) -> T {
        self.shared.look(|soc| look(&mut Outputs(soc)))
    }

    /// How a pin drives the wire to which it is connected, as [`Outputs::level`].
    #[must_use]
    pub fn output(&self, port: Port, pin: u8) -> PinLevel {
        self.outputs(|outputs| outputs.level(port, pin))
    }

    /// State of a PWM output, as [`Outputs::pwm`].
    #[must_use]
    pub fn pwm(&self, timer: usize, channel: usize) -> PwmState {
        self.outputs(|outputs| outputs.pwm(timer, channel))
    }

    /// The same of a complementary output, as [`Outputs::complementary_pwm`].
    #[must_use]
    pub fn complementary_pwm(&self, timer: usize, channel: usize) -> PwmState {
        self.outputs(|outputs| outputs.complementary_pwm(timer, channel))
    }
}
