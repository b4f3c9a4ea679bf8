//! What a board has of the hardware that parameters are about.
//!
//! [`crate::configuration::build`] refuses parameters that need something else. The platform gives
//! this to [`crate::Identity`]; a group file is checked with that of the board that it names. The
//! firmware compares its pins and clocks with it when it is compiled.
//!
//! Limits: the kinds of bridges depend on the image, too, and are those of a board's usual image
//! here.

use control::output_stage::OutputStage;

/// See the [module](self).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Hardware {
    /// Kinds of drives, a mask of [`OutputStage::bit`].
    pub output_stages: u8,
    /// Clock of the timers that count the encoders, MHz; their input filter runs at it.
    pub encoder_clock_mhz: u8,
    /// Inputs for sensors of the motors' current.
    pub current_inputs: u8,
}

impl Hardware {
    /// The kinds of bridges that a board drives with a PWM and a direction a wheel, and with a
    /// driver enable that it cuts in hardware.
    pub const SWITCHED: u8 = OutputStage::PwmDirection.bit()
        | OutputStage::SlowDecay.bit()
        | OutputStage::LockedAntiphase.bit();

    /// The kinds of bridges that a board drives with two PWMs a wheel.
    pub const TWO_PWMS: u8 = OutputStage::FastDecay.bit() | OutputStage::BrakeBetween.bit();

    /// The kinds that an image for smart drives has.
    pub const SMART: u8 = OutputStage::C620.bit() | OutputStage::C610.bit();

    /// NUCLEO-F446RE, the reference board.
    pub const NUCLEO_F446RE: Self = Self {
        output_stages: Self::SWITCHED,
        encoder_clock_mhz: 90,
        current_inputs: 3,
    };

    /// RoboMaster Development Board C.
    pub const ROBOMASTER_C: Self = Self {
        output_stages: Self::SMART,
        encoder_clock_mhz: 84,
        current_inputs: 0,
    };

    /// A kit's controller with an STM32F103RC.
    pub const KIT_F103RC: Self = Self {
        output_stages: Self::TWO_PWMS,
        encoder_clock_mhz: 72,
        current_inputs: 0,
    };
}
