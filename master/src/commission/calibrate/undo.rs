//! What a calibration replaces, so that it can be taken back, and the group file's new lines.

use std::path::Path;

use group::{CompensationTable, GroupFile};
use kinematics::VelocityCompensation;
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
    /// Constants: longitudinal, lateral, yaw.
    pub constants: [f32; 3],
    /// The compensation set, bytes of 0x2013:1.
    pub set: Vec<u8>,
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
        Ok(Self {
            node,
            constants,
            set,
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
        let text = std::fs::read_to_string(path).map_err(|error| {
            file(
                path,
                format!("{error}; nothing has been written here that could be taken back"),
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
        std::fs::write(path, text + "\n").map_err(|error| file(path, error.to_string()))
    }
}

fn file(path: &Path, problem: String) -> CalibrateError {
    CalibrateError::File {
        path: path.display().to_string(),
        problem,
    }
}

/// The compensation as lines of a group file, below a `[robot.compensation]` of their own.
#[must_use]
pub fn section(constant: &VelocityCompensation, table: &CompensationTable) -> String {
    let pairs = |rows: &[(f32, f32)]| {
        let rows = rows.iter().map(|(s, c)| format!("[{s:.4}, {c:.5}]"));
        rows.collect::<Vec<_>>().join(", ")
    };
    let oblique = table.oblique.iter();
    let oblique: Vec<_> = oblique
        .map(|(s, x, y)| format!("[{s:.4}, {x:.5}, {y:.5}]"))
        .collect();
    format!(
        "[robot.compensation]\nlongitudinal = {:.5}\nlateral = {:.5}\nyaw = {:.5}\n\n\
         # Achieved speed (m/s, rad/s) and coefficient, from `omnibus calibrate`.\n\
         [robot.compensation.table]\nversion = {}\nlongitudinal = [{}]\nlateral = [{}]\noblique = [{}]\nyaw = [{}]\n",
        constant.longitudinal(),
        constant.lateral(),
        constant.yaw(),
        table.version,
        pairs(&table.longitudinal),
        pairs(&table.lateral),
        oblique.join(", "),
        pairs(&table.yaw),
    )
}

/// A group file's text with this section in place of the `[robot.compensation]` it has and the
/// comment above that; all else stays as it is.
///
/// # Errors
/// When the result does not say what `wanted` says: a robot has coefficients of its own, or they
/// stand elsewhere.
pub fn rewrite(path: &Path, section: &str, wanted: &GroupFile) -> Result<String, CalibrateError> {
    let text = std::fs::read_to_string(path).map_err(|error| file(path, error.to_string()))?;
    let mut out = String::new();
    let mut pending = String::new();
    let (mut skipping, mut placed) = (false, false);
    for line in text.lines() {
        let start = line.trim_start();
        if start.starts_with('#') || start.is_empty() {
            // Comments belong to what stands below them.
            pending += line;
            pending += "\n";
            continue;
        }
        let before = std::mem::take(&mut pending);
        if start.starts_with('[') {
            skipping = start.starts_with("[robot.compensation");
            if !placed && (skipping || start.starts_with("[[robots]]")) {
                out = out.trim_end().to_owned() + "\n\n" + section + "\n";
                placed = true;
            }
        }
        if !skipping {
            out += if out.ends_with("\n\n") {
                before.trim_start()
            } else {
                &before
            };
            out += line;
            out += "\n";
        }
    }
    let differs = || {
        let problem = "its compensation is not all in [robot.compensation]; put these lines into it by hand:\n";
        file(path, format!("{problem}{section}"))
    };
    let parsed = GroupFile::parse(&path.to_string_lossy(), &out).map_err(|_| differs())?;
    let same = parsed.robots.iter().zip(&wanted.robots).all(|(a, b)| {
        let near = |a: f32, b: f32| (a - b).abs() < 1e-4;
        let rows =
            |t: &CompensationTable| t.lateral.iter().chain(&t.yaw).copied().collect::<Vec<_>>();
        let (rows_a, rows_b) = (rows(&a.compensation_table), rows(&b.compensation_table));
        near(a.compensation.lateral(), b.compensation.lateral())
            && rows_a.len() == rows_b.len()
            && rows_a
                .iter()
                .zip(&rows_b)
                .all(|(a, b)| near(a.0, b.0) && near(a.1, b.1))
    });
    if same { Ok(out) } else { Err(differs()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_file_keeps_everything_but_its_compensation() {
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
        let before = std::fs::read_to_string(source).unwrap();
        let path = std::env::temp_dir().join(format!("omnibus-kept-{}.toml", std::process::id()));
        std::fs::write(&path, &before).unwrap();
        let mut wanted = GroupFile::load(&path).unwrap();
        let constant = VelocityCompensation::new(1.01, 1.1, 1.02).unwrap();
        let table = CompensationTable {
            version: 3,
            longitudinal: vec![(0.1, 1.01)],
            lateral: vec![(0.1, 1.1), (0.4, 1.12)],
            oblique: vec![(0.2, 1.03, 1.04)],
            yaw: vec![(0.5, 1.02)],
        };
        for robot in &mut wanted.robots {
            robot.compensation = constant;
            robot.compensation_table = table.clone();
        }
        let lines = section(&constant, &table);
        let once = rewrite(&path, &lines, &wanted).unwrap();
        std::fs::write(&path, &once).unwrap();
        assert_eq!(GroupFile::load(&path).unwrap(), wanted);
        // Whatever else was in the file still is, and a second calibration adds nothing.
        let gone: Vec<_> = before.lines().filter(|l| !once.contains(l)).collect();
        assert_eq!(gone.len(), 4, "a comment and three coefficients: {gone:?}");
        assert_eq!(rewrite(&path, &lines, &wanted).unwrap(), once);
        // A robot with coefficients of its own would not get these.
        std::fs::write(&path, once + "\n[robots.compensation]\nlateral = 1.2\n").unwrap();
        let text = rewrite(&path, &lines, &wanted).unwrap_err().to_string();
        assert!(text.contains("by hand"), "{text}");
        std::fs::remove_file(path).unwrap();
    }
}
