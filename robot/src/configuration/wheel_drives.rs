//! What turns the wheels: kind of bridges, smart drives.

use control::output_stage::OutputStage;
use control::smart_drive::index::index_error;
use control::smart_drive::{DriveConfiguration, frames};
use protocol::{Address, address as at};

use super::{ConfigurationError, encoder_counts};
use crate::parameters::Parameters;

/// The kind of bridges: one that the board can drive, whose safe state is wired where all outputs
/// low is none, and that stands what it does. One input of a slow-decay bridge is high as long as
/// it reverses, and of one that brakes in between always one, so a high side that needs pauses
/// (0x2027:1) gets none.
pub(super) fn output_stage(
    parameters: &Parameters,
    known: u8,
) -> Result<OutputStage, ConfigurationError> {
    let stage = OutputStage::from_number(parameters.unsigned(at::OUTPUT_STAGE));
    let bad = |address| Err(ConfigurationError::Inconsistent(address));
    if stage.bit() & known == 0 {
        return bad(at::OUTPUT_STAGE);
    }
    let needs_enable = matches!(stage, OutputStage::SlowDecay | OutputStage::LockedAntiphase);
    if needs_enable && parameters.unsigned(at::ENABLE_WIRED) == 0 {
        return bad(at::ENABLE_WIRED);
    }
    let keeps_high = matches!(stage, OutputStage::SlowDecay | OutputStage::BrakeBetween);
    if keeps_high && parameters.real(at::DUTY_MAX) < 1.0 {
        return bad(at::DUTY_MAX);
    }
    Ok(stage)
}

/// Counts by which an index may be off: what the robot has been told, and where smart drives turn
/// the wheels what the counts of two indexes are off at the highest rate.
pub(super) fn index_tolerance(parameters: &Parameters) -> u16 {
    let [low, high, ..] = parameters.unsigned(at::INDEX_TOLERANCE).to_le_bytes();
    let configured = u16::from_le_bytes([low, high]);
    let stage = OutputStage::from_number(parameters.unsigned(at::OUTPUT_STAGE));
    if stage.smart_drive().is_none() {
        return configured;
    }
    let turns = parameters.real(at::WHEEL_RATE_MAX) * parameters.real(at::GEAR_RATIO)
        / core::f32::consts::TAU;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positive, and a cast saturates"
    )]
    let error = (2.0 * index_error(turns * f32::from(frames::COUNTS))) as u16;
    configured.saturating_add(error)
}

/// The smart drives, where they turn the wheels: every wheel has one, they can give the largest
/// current, both it and the resistance are known, because a current follows from them, and the
/// counts are those that the drives report.
pub(super) fn drives(
    parameters: &Parameters,
    stage: OutputStage,
) -> Result<DriveConfiguration, ConfigurationError> {
    const IDENTIFIERS: [Address; 4] = [
        at::DRIVE_FRONT_LEFT,
        at::DRIVE_FRONT_RIGHT,
        at::DRIVE_REAR_LEFT,
        at::DRIVE_REAR_RIGHT,
    ];
    let byte = |address| parameters.unsigned(address).to_le_bytes()[0];
    let drives = DriveConfiguration {
        identifiers: IDENTIFIERS.map(byte),
        hottest: byte(at::DRIVE_HOTTEST),
    };
    let Some(model) = stage.smart_drive() else {
        return Ok(drives);
    };
    let bad = |address| Err(ConfigurationError::Inconsistent(address));
    if parameters.real(at::WINDING_RESISTANCE) == 0.0 {
        return bad(at::WINDING_RESISTANCE);
    }
    let largest = parameters.real(at::CURRENT_MAX);
    if largest == 0.0 || largest > model.largest() {
        return bad(at::CURRENT_MAX);
    }
    for place in 0..4 {
        if encoder_counts(parameters, place) != f32::from(frames::COUNTS) {
            return bad(at::ENCODER_COUNTS);
        }
    }
    let mut taken = 0_u32;
    for (identifier, address) in drives.identifiers.into_iter().zip(IDENTIFIERS) {
        if taken >> identifier & 1 == 1 {
            return bad(address);
        }
        taken |= 1 << identifier;
    }
    Ok(drives)
}
