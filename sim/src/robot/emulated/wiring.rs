//! What a board's pins are wired to, as in its own file under `src/board/`.
//!
//! Which board an image is for follows from the symbol `_board_id` of its memory layout.

use emulator::{Firmware, Port};

/// A pin.
pub type Pin = (Port, u8);

/// The pins of one board. Wheels are in the order front left, front right, rear left, rear right.
#[derive(Debug)]
pub(super) struct Wiring {
    /// Clock from outside, Hz.
    pub(super) hse_hz: u64,
    /// Direction, without which TIM8 makes a second PWM; its opposite where the board has it.
    pub(super) directions: Option<[Pin; 4]>,
    pub(super) inverse: Option<[Pin; 4]>,
    /// The encoders' wires A and B, and their indexes.
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
    /// Switches of the node-ID, the lowest bit first.
    pub(super) switches: &'static [Pin],
}

use Port::{A, B, C, D, F, I};

static NUCLEO_F446RE: Wiring = Wiring {
    hse_hz: 8_000_000,
    directions: Some([(C, 0), (C, 1), (C, 2), (C, 3)]),
    inverse: Some([(B, 2), (B, 4), (B, 5), (D, 2)]),
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
    ..NUCLEO_F446RE
};

static ROBOMASTER_C: Wiring = Wiring {
    hse_hz: 12_000_000,
    directions: Some([(C, 6), (I, 6), (I, 7), (F, 1)]),
    inverse: None,
    encoders: None,
    index: None,
    driver_enable: (B, 14),
    brake_release: (B, 15),
    emergency_stop: &[(B, 12)],
    driver_fault: (F, 0),
    protective_stop: (B, 13),
    supply: (F, 10),
    currents: &[],
    gyro: Some((B, 0)),
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
            Some(other) => Err(format!(
                "the image is for board {other}, which is not modelled"
            )),
        }
    }
}
