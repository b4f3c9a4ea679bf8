//! Recordings: everything that was on the bus, in a file that other programs open.
//!
//! The form is MCAP (<https://mcap.dev>), which Foxglove and PlotJuggler read: channels of JSON
//! messages, each with its JSON Schema, times in ns. The channel [`CAN`] holds every frame and is
//! what [`read()`], `convert`, `replay`, `plot` and `report` go by; the others say the same in SI
//! units, for people and their tools. `docs/recording.md` describes them all.
//!
//! Frames come in through a [`FrameSink`](crate::bus::tap::FrameSink), which
//! [`Tap`](crate::bus::tap::Tap) puts between a program and its bus. It hands them to a thread of
//! its own over a queue, so a slow disk does not delay SYNC; a full disk ends the recording and is
//! reported at once. Chunks are compressed and closed once a second of the bus's time, so that a
//! file that was cut off is readable up to its last second.

pub mod candump;
pub mod charts;
mod content;
pub mod csv;
pub mod messages;
pub mod page;
mod part;
mod read;
pub mod rosbag;
mod schema;
mod write;

use std::path::Path;

use serde::{Deserialize, Serialize};

pub use crate::bus::frame_name::frame_name;
pub use content::{Recorded, Recording};
pub use read::{read, read_with};
pub use write::{OnError, Recorder, Settings, Summary};

/// Every frame on the bus.
pub const CAN: &str = "/can";
/// The group at every SYNC.
pub const GROUP: &str = "/group";
/// What one robot said at every SYNC; its node id follows.
pub const ROBOT: &str = "/robot/";
/// Where the curve that is being driven asks the group to be.
pub const PLAN: &str = "/plan";
/// Where an outside observer saw the group: the simulator, or a motion-capture system.
pub const TRUTH: &str = "/truth";
/// Faults, limits and states, as they changed.
pub const EVENTS: &str = "/events";
/// The frames of the group and its robots, for 3D views.
pub const TRANSFORMS: &str = "/tf";
/// Name of the metadata record.
const METADATA: &str = "omnibus";

/// What is known about a recording before it begins.
#[derive(Clone, Debug, Default)]
pub struct Header {
    /// The bus as the user named it.
    pub bus: String,
    /// What was done: `record`, `drive`, or `follow circle`.
    pub activity: String,
    /// The group file's text, when there is one.
    pub group: Option<String>,
    /// Time of the link's zero, in ns since 1970; 0 on a simulated bus, whose recordings are the
    /// same every time.
    pub epoch_ns: u64,
}

/// A pose as it is written.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseRecord {
    /// Forward, m.
    pub x: f32,
    /// Left, m.
    pub y: f32,
    /// Counter-clockwise, rad.
    pub heading: f32,
}

impl From<kinematics::Pose> for PoseRecord {
    fn from(pose: kinematics::Pose) -> Self {
        Self {
            x: pose.x,
            y: pose.y,
            heading: pose.heading,
        }
    }
}

impl From<PoseRecord> for kinematics::Pose {
    fn from(pose: PoseRecord) -> Self {
        Self::new(pose.x, pose.y, pose.heading)
    }
}

/// A frame as it is written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct FrameRecord {
    id: u16,
    name: String,
    data: String,
    sent: bool,
}

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {problem}")]
pub struct RecordingError {
    /// The file.
    pub path: String,
    /// What is wrong, and what to do.
    pub problem: String,
}

impl RecordingError {
    fn new(path: &Path, problem: impl std::fmt::Display) -> Self {
        Self {
            path: path.display().to_string(),
            problem: problem.to_string(),
        }
    }
}

/// Bytes as hexadecimal digits.
fn to_hex(data: &[u8]) -> String {
    data.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// The bytes of hexadecimal digits; `None` when they are something else.
fn from_hex(digits: &str) -> Option<Vec<u8>> {
    if !digits.len().is_multiple_of(2) || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(digits.get(at..at + 2)?, 16).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_goes_both_ways_and_refuses_the_rest() {
        assert_eq!(to_hex(&[0, 0xAB, 9]), "00AB09");
        assert_eq!(from_hex("00ab09"), Some(vec![0, 0xAB, 9]));
        assert_eq!(from_hex(""), Some(vec![]));
        for bad in ["0", "0x", "+1", "é0", "zz"] {
            assert_eq!(from_hex(bad), None, "{bad}");
        }
    }
}
