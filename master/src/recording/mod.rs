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
pub mod csv;
pub mod messages;
pub mod page;
mod part;
mod read;
mod schema;
mod write;

use std::path::Path;

use serde::{Deserialize, Serialize};

pub use read::{Recorded, Recording, read};
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

/// What a frame is, for people: `GroupTwist`, `MemberStatus 3`, `SDO request 2`.
#[must_use]
pub fn frame_name(id: u16) -> String {
    let node = id & 0x7F;
    let of_node = |name: &str| format!("{name} {node}");
    match id & 0x780 {
        0x000 if node == 0 => "NMT".into(),
        0x080 if node == 0 => "SYNC".into(),
        0x080 => of_node("emergency"),
        0x180 if id == protocol::cob::GROUP_TWIST => "GroupTwist".into(),
        0x180 => of_node("MemberStatus"),
        0x200 => of_node("CommissioningTwist"),
        0x280 => of_node("MeasuredTwist"),
        0x380 => of_node("Pose"),
        0x480 => of_node("WheelRates"),
        0x580 => of_node("SDO answer"),
        0x600 => of_node("SDO request"),
        0x700 => of_node("heartbeat"),
        0x780 if matches!(id, 0x7E4 | 0x7E5) => "LSS".into(),
        _ => "unknown".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_the_names_of_the_protocol_page() {
        for (id, name) in [
            (0x000, "NMT"),
            (0x080, "SYNC"),
            (0x083, "emergency 3"),
            (0x181, "GroupTwist"),
            (0x191, "MemberStatus 17"),
            (0x582, "SDO answer 2"),
            (0x701, "heartbeat 1"),
            (0x7E5, "LSS"),
            (0x123, "unknown"),
        ] {
            assert_eq!(frame_name(id), name);
        }
    }

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
