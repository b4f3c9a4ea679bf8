//! The values that a calibration replaces, saved so that it can be undone.

use std::path::Path;

use protocol::{Kind, Value, address};
use serde::{Deserialize, Serialize};

use super::CalibrateError;
use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;

/// The constants of 0x2012, in their order.
const CONSTANTS: [protocol::Address; 3] = [
    address::COMPENSATION_LONGITUDINAL,
    address::COMPENSATION_LATERAL,
    address::COMPENSATION_YAW,
];

/// What one robot holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Held {
    /// Its node.
    pub node: u8,
    /// Constants without a unit: longitudinal, lateral, yaw.
    pub constants: [f32; 3],
    /// The compensation set, bytes of 0x2013:1.
    pub set: Vec<u8>,
    /// Roller angles at the index, rad: front left, front right, rear left, rear right.
    #[serde(default)]
    pub phases: Option<[f32; 4]>,
}

impl Held {
    /// Reads it from a robot.
    ///
    /// # Errors
    /// When the robot does not answer.
    pub fn read<L: Link>(wire: &mut Wire<L>, node: u8) -> Result<Self, MasterError> {
        let mut constants = [1.0; 3];
        for (constant, at) in constants.iter_mut().zip(CONSTANTS) {
            if let Value::F32(value) = wire.read(node, at, Kind::F32)? {
                *constant = value;
            }
        }
        let set = wire.read_block(node, address::COMPENSATION_SET)?;
        let mut phases = [0.0; 4];
        for (wheel, phase) in (0..).zip(&mut phases) {
            if let Value::F32(value) = wire.read(node, address::rollers::phase(wheel), Kind::F32)? {
                *phase = value;
            }
        }
        Ok(Self {
            node,
            constants,
            set,
            phases: Some(phases),
        })
    }

    /// Writes it into its robot, which is in PRE-OPERATIONAL, and reads it back.
    ///
    /// # Errors
    /// When the robot refuses it or does not answer.
    pub fn write<L: Link>(&self, wire: &mut Wire<L>) -> Result<(), MasterError> {
        for (constant, at) in self.constants.into_iter().zip(CONSTANTS) {
            wire.write_checked(self.node, at, Value::F32(constant))?;
        }
        for (wheel, phase) in (0..).zip(self.phases.into_iter().flatten()) {
            let at = address::rollers::phase(wheel);
            wire.write_checked(self.node, at, Value::F32(phase))?;
        }
        wire.write_block(self.node, address::COMPENSATION_SET, &self.set)
    }

    /// Version of its set; 0 of none.
    #[must_use]
    pub fn version(&self) -> u32 {
        protocol::compensation::CompensationSet::decode(&self.set).map_or(0, |set| set.version)
    }
}

/// What a calibration replaced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UndoRecord {
    /// The robots' sets.
    pub robots: Vec<Held>,
    /// The group file's text, where it was rewritten.
    pub group_file: Option<String>,
}

impl UndoRecord {
    /// Reads a file that [`UndoRecord::save`] wrote.
    ///
    /// # Errors
    /// When there is none, or it is no such file.
    pub fn load(path: &Path) -> Result<Self, CalibrateError> {
        let text = group::input::text(path).map_err(|error| {
            file(
                path,
                format!("{error}; there is no earlier --write to undo"),
            )
        })?;
        serde_json::from_str(&text).map_err(|error| file(path, error.to_string()))
    }

    /// Writes it beside the group file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CalibrateError> {
        let text = serde_json::to_string_pretty(self).map_err(|e| file(path, e.to_string()))?;
        crate::file::replace(path, text + "\n").map_err(|error| file(path, error.to_string()))
    }
}

fn file(path: &Path, problem: String) -> CalibrateError {
    CalibrateError::File {
        path: path.display().to_string(),
        problem,
    }
}
