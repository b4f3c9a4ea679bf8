//! Frames of RoboMaster C620 and C610 drives: commands and feedback.
//!
//! Source: "RoboMaster C610 Brushless DC Motor Speed Controller User Guide", v1.0, 2019.03, "CAN
//! Communication Protocol": identifiers, bytes, the C610's range of +-10000 for +-10 A, feedback at
//! 1 kHz, angle 0 to 8191 for a turn, speed in rpm, 1 Mbit/s. The C620's user guide was not
//! available. Its range of +-16384 for +-20 A, and the motor's temperature in degrees Celsius in
//! byte 6 of its feedback, are taken from projects that drive it. A C610 leaves byte 6 zero.
//!
//! The guide does not say what a drive does when commands stop, or at which temperature it switches
//! itself off. Both have to be measured on the drive in use.

/// Identifier of the commands to drives 1 to 4.
pub const COMMAND: u16 = 0x200;

/// Identifier of the feedback of drive 1; drive n follows n - 1 behind.
pub const FIRST_FEEDBACK: u16 = 0x201;

/// Drives that can be told apart on a bus by their feedback.
pub const IDENTIFIERS: usize = 8;

/// Counts in a turn of the rotor.
pub const COUNTS: u16 = 8192;

/// A kind of drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Model {
    /// C620, as a rule with an M3508 and its gear of 3591 : 187.
    C620,
    /// C610, as a rule with an M2006 and its gear of 36 : 1.
    C610,
}

impl Model {
    /// The largest current that can be commanded, A.
    #[must_use]
    pub const fn largest(self) -> f32 {
        match self {
            Self::C620 => 20.0,
            Self::C610 => 10.0,
        }
    }

    /// The number that commands it.
    const fn full_scale(self) -> f32 {
        match self {
            Self::C620 => 16_384.0,
            Self::C610 => 10_000.0,
        }
    }

    /// The number for a current, A, within the drive's range, rounded to the nearest; 0 for what is
    /// not a number.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the value is within the range of an i16; NaN becomes 0"
    )]
    pub fn number(self, current: f32) -> i16 {
        let full = self.full_scale();
        let number = current * (full / self.largest());
        let number = if number > full {
            full
        } else if number < -full {
            -full
        } else {
            number
        };
        let half = if number < 0.0 { -0.5 } else { 0.5 };
        (number + half) as i16
    }
}

/// The data of a command for drives 1 to 4, by identifier, from currents in A.
#[must_use]
pub fn command(model: Model, currents: [f32; 4]) -> [u8; 8] {
    let [a, b, c, d] = currents.map(|current| model.number(current).to_be_bytes());
    [a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1]]
}

/// What a drive reports.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Feedback {
    /// Angle of the rotor, 0 to 8191 for a turn.
    pub angle: u16,
    /// Rate of the rotor, rpm.
    pub rpm: i16,
    /// Torque current as the drive measures it, in its command's numbers.
    pub current: i16,
    /// Temperature of the motor, degrees Celsius; 0 from a C610.
    pub temperature: u8,
}

impl Feedback {
    /// What the data of a frame says; `None` when no drive can have sent it.
    #[must_use]
    pub fn decode(data: &[u8]) -> Option<Self> {
        let [a, b, c, d, e, f, temperature, _] = *data else {
            return None;
        };
        let angle = u16::from_be_bytes([a, b]);
        (angle < COUNTS).then_some(Self {
            angle,
            rpm: i16::from_be_bytes([c, d]),
            current: i16::from_be_bytes([e, f]),
            temperature,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 A is 16384, 0x4000; -10 A is -8192, 0xE000; 0.001 A is 0.8, which is 1.
    #[test]
    fn a_command_has_four_currents_high_byte_first() {
        let data = command(Model::C620, [20.0, -10.0, 0.001, 0.0]);
        assert_eq!(data, [0x40, 0, 0xE0, 0, 0, 1, 0, 0]);
        let data = command(Model::C610, [10.0, -0.5, 99.0, -99.0]);
        assert_eq!(data, [0x27, 0x10, 0xFE, 0x0C, 0x27, 0x10, 0xD8, 0xF0]);
        assert_eq!(command(Model::C620, [f32::NAN; 4]), [0; 8]);
    }

    #[test]
    fn feedback_is_read_by_the_guides_table() {
        let data = [0x1F, 0xFF, 0xFF, 0x38, 0x01, 0x00, 45, 0];
        let expected = Feedback {
            angle: 8191,
            rpm: -200,
            current: 256,
            temperature: 45,
        };
        assert_eq!(Feedback::decode(&data), Some(expected));
        assert_eq!(Feedback::decode(&[0x20, 0, 0, 0, 0, 0, 0, 0]), None, "8192");
        assert_eq!(Feedback::decode(&data[..7]), None, "seven bytes");
    }
}
