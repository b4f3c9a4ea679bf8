//! What a board's pins are wired to, as in its own file under `src/board/`.
//!
//! Which board an image is for follows from the symbol `_board_id` of its memory layout.

use std::ops::Range;

use emulator::{Firmware, Port};

/// A pin.
pub type Pin = (Port, u8);

/// The pins of one board. Wheels are in the order front left, front right, rear left, rear right.
#[derive(Debug)]
pub(super) struct Wiring {
    /// Clock from outside, Hz.
    pub(super) hse_hz: u64,
    /// The channels that make PWM: where there is no direction both, else the first.
    pub(super) channels: [[Channel; 2]; 4],
    /// Direction, without which there is a second PWM; its opposite where the board has it.
    pub(super) directions: Option<[Pin; 4]>,
    pub(super) inverse: Option<[Pin; 4]>,
    /// The encoders' timers, wires A and B, and indexes.
    pub(super) encoder_timers: [usize; 4],
    pub(super) encoders: Option<[[Pin; 2]; 4]>,
    pub(super) index: Option<[Pin; 4]>,
    pub(super) driver_enable: Pin,
    pub(super) brake_release: Pin,
    /// Emergency stop: pins that are wired together.
    pub(super) emergency_stop: &'static [Pin],
    pub(super) driver_fault: Pin,
    pub(super) protective_stop: Pin,
    /// Supply behind its divider, and current sensors.
    pub(super) supply: Pin,
    pub(super) currents: &'static [Pin],
    /// Chip select of the gyro on SPI1.
    pub(super) gyro: Option<Pin>,
    /// The two sectors of the parameters, bytes from the start of the flash.
    pub(super) parameters: Range<usize>,
    /// Switches of the node-ID, the lowest bit first.
    pub(super) switches: &'static [Pin],
}

/// A timer's output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) timer: usize,
    /// From 1.
    pub(super) number: usize,
    pub(super) complementary: bool,
}

const fn channel(timer: usize, number: usize) -> Channel {
    Channel {
        timer,
        number,
        complementary: false,
    }
}

const fn complementary(timer: usize, number: usize) -> Channel {
    Channel {
        complementary: true,
        ..channel(timer, number)
    }
}

/// Channels 1 to 4 of TIM1, and of TIM8 where it makes PWM.
const IN_ORDER: [[Channel; 2]; 4] = [
    [channel(1, 1), channel(8, 1)],
    [channel(1, 2), channel(8, 2)],
    [channel(1, 3), channel(8, 3)],
    [channel(1, 4), channel(8, 4)],
];

use Port::{A, B, C, D, E, F};

static NUCLEO_F446RE: Wiring = Wiring {
    hse_hz: 8_000_000,
    channels: IN_ORDER,
    directions: Some([(C, 0), (C, 1), (C, 2), (C, 3)]),
    inverse: Some([(B, 2), (B, 4), (B, 5), (D, 2)]),
    encoder_timers: [2, 3, 4, 5],
    encoders: Some([
        [(A, 15), (B, 3)],
        [(C, 6), (C, 7)],
        [(B, 6), (B, 7)],
        [(A, 0), (A, 1)],
    ]),
    index: Some([(B, 10), (A, 12), (B, 14), (B, 15)]),
    driver_enable: (B, 0),
    brake_release: (B, 1),
    emergency_stop: &[(B, 12), (A, 6)],
    driver_fault: (B, 13),
    protective_stop: (C, 12),
    supply: (A, 4),
    currents: &[(A, 7), (C, 4), (C, 5)],
    gyro: None,
    parameters: 0x4000..0xC000,
    switches: &[(C, 8), (C, 9), (C, 10), (C, 11)],
};

/// With the feature `two-pwms`.
static NUCLEO_F446RE_TWO_PWMS: Wiring = Wiring {
    directions: None,
    inverse: None,
    encoders: Some([
        [(A, 15), (B, 3)],
        [(B, 4), (B, 5)],
        [(B, 6), (B, 7)],
        [(A, 0), (A, 1)],
    ]),
    switches: &[(C, 0), (C, 1), (C, 10), (C, 11)],
    parameters: 0x4000..0xC000,
    ..NUCLEO_F446RE
};

static ROBOMASTER_C: Wiring = Wiring {
    hse_hz: 12_000_000,
    channels: IN_ORDER,
    directions: None,
    inverse: None,
    encoder_timers: [2, 3, 4, 5],
    encoders: None,
    index: Some([(E, 9), (E, 11), (E, 13), (E, 14)]),
    driver_enable: (B, 14),
    brake_release: (B, 15),
    emergency_stop: &[(B, 12)],
    driver_fault: (F, 0),
    protective_stop: (B, 13),
    supply: (F, 10),
    currents: &[],
    gyro: Some((B, 0)),
    parameters: 0x4000..0xC000,
    switches: &[],
};

static KIT_F103RC: Wiring = Wiring {
    hse_hz: 8_000_000,
    channels: [
        [channel(8, 1), channel(8, 2)],
        [channel(1, 4), channel(1, 1)],
        [channel(8, 3), channel(8, 4)],
        [complementary(1, 2), complementary(1, 3)],
    ],
    directions: None,
    inverse: None,
    encoder_timers: [2, 4, 5, 3],
    encoders: Some([
        [(A, 15), (B, 3)],
        [(B, 6), (B, 7)],
        [(A, 0), (A, 1)],
        [(B, 4), (B, 5)],
    ]),
    index: None,
    driver_enable: (C, 10),
    brake_release: (C, 11),
    emergency_stop: &[(A, 6)],
    driver_fault: (C, 5),
    protective_stop: (C, 12),
    supply: (C, 4),
    currents: &[],
    gyro: None,
    parameters: 0x3_C000..0x4_0000,
    switches: &[],
};

/// Whether an image is for the board and the drives of a robot.
pub(in crate::robot) fn is_for(image: &Firmware, robot: &group::Robot) -> bool {
    let symbol = |name, default| image.variable(name).map_or(default, |found| found.address);
    let kind = robot.output.kind;
    symbol("_board_id", 1) == robot.board as u32
        && (symbol("_smart_drives", 0) != 0) == kind.drive_current().is_some()
        && (symbol("_two_pwms", 0) != 0) == kind.has_two_pwms()
}

/// Driver enable and brake release of the board that an image is for.
///
/// # Errors
/// When the board is not modelled.
pub fn outputs(firmware: &Firmware) -> Result<[Pin; 2], String> {
    let wiring = Wiring::of(firmware)?;
    Ok([wiring.driver_enable, wiring.brake_release])
}

/// Where the two sectors of the parameters are in the flash of the board that an image is for.
///
/// # Errors
/// When the board is not modelled.
pub fn parameters(firmware: &Firmware) -> Result<Range<usize>, String> {
    Ok(Wiring::of(firmware)?.parameters.clone())
}

impl Wiring {
    /// That of the board an image is for; an image that does not say it is for the reference board.
    pub(super) fn of(firmware: &Firmware) -> Result<&'static Self, String> {
        let symbol = |name| firmware.variable(name).map(|symbol| symbol.address);
        match symbol("_board_id") {
            None | Some(1) if symbol("_two_pwms").is_some_and(|has| has != 0) => {
                Ok(&NUCLEO_F446RE_TWO_PWMS)
            }
            None | Some(1) => Ok(&NUCLEO_F446RE),
            Some(2) => Ok(&ROBOMASTER_C),
            Some(5) => Ok(&KIT_F103RC),
            Some(other) => Err(format!(
                "the image is for board {other}, which is not modelled"
            )),
        }
    }
}
