//! What can go wrong between the master and a group. Every message names the node and the object or
//! field, and ends in what to do about it; nothing here ever moved because of an error, and a group
//! that was moving is ramped down by the code that receives one.

use canopen::{AbortCode, NmtState};
use protocol::{Fault, GyroState, MemberState};

use crate::bus::foreign::Sign;
use crate::bus::link::LinkError;

/// An error of the master.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MasterError {
    /// The bus itself.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A robot of the group file gave no sign of life.
    #[error(
        "node {node} does not answer; check its power, its node switches (id minus 2), the bit \
         rate (1 Mbit/s) and the termination of the bus"
    )]
    NodeSilent {
        /// The node.
        node: u8,
    },
    /// A robot gave no sign of life, and the adapter has an idea why.
    #[error("node {node} does not answer; {diagnosis}")]
    BusDiagnosis {
        /// The node.
        node: u8,
        /// What the adapter says, and what to check.
        diagnosis: String,
    },
    /// A robot speaks another version of the protocol.
    #[error(
        "node {node}: wire version {found}, this master speaks {}; flash the robot with the \
         firmware of this release",
        protocol::WIRE_VERSION
    )]
    WireVersion {
        /// The node.
        node: u8,
        /// What the node says.
        found: u32,
    },
    /// A robot does not take a new image.
    #[error("node {node}: no update: {reason}")]
    Update {
        /// The node.
        node: u8,
        /// Why, and what to do about it.
        reason: String,
    },
    /// A robot could not identify its motors.
    #[error("node {node}: motors not identified: {reason}")]
    Identification {
        /// The node.
        node: u8,
        /// Why, and what to do about it.
        reason: String,
    },
    /// A robot refused a parameter.
    #[error("node {node}: {action} was refused: {abort}; {}", remedy(*abort))]
    Refused {
        /// The node.
        node: u8,
        /// What was to be done, as in "reading State (2110:1)".
        action: String,
        /// The reason the node gave.
        abort: AbortCode,
    },
    /// A robot has another key than the one given.
    #[error("node {node} has another key; give the file from which its key was set")]
    WrongKey {
        /// The node.
        node: u8,
    },
    /// A robot takes no key at present.
    #[error(
        "node {node} accepts no key now: it waits up to 64 s after a wrong key, and it must not be \
         OPERATIONAL; stop it, or wait, and try again"
    )]
    Barred {
        /// The node.
        node: u8,
    },
    /// A robot answered an SDO request with something that is no answer to it.
    #[error("node {node}: {object}: {problem}; this happens when two masters use the bus")]
    Answer {
        /// The node.
        node: u8,
        /// Name and address of the object.
        object: String,
        /// What was wrong with it.
        problem: String,
    },
    /// A parameter read back is not what was written.
    #[error(
        "node {node}: {object} reads back as {found} after {written} was written; another master \
         may be writing to it"
    )]
    ReadBack {
        /// The node.
        node: u8,
        /// Name and address of the object.
        object: String,
        /// What was written.
        written: String,
        /// What came back.
        found: String,
    },
    /// A robot finds its configuration incomplete or contradictory.
    #[error("node {node}: {object} {reason}; correct the group file")]
    Configuration {
        /// The node.
        node: u8,
        /// Name and address of the object it objects to.
        object: String,
        /// Its reason.
        reason: String,
    },
    /// A robot did not get ready to move.
    #[error(
        "node {node} did not get ready to move: NMT state {}, member state {}, code {code}; \
         `omnibus status --history` shows its last faults",
        known(*nmt),
        known(*state)
    )]
    NotReady {
        /// The node.
        node: u8,
        /// Its NMT state as last heard.
        nmt: Option<NmtState>,
        /// Its member state as last heard.
        state: Option<MemberState>,
        /// Its limit or fault.
        code: String,
    },
    /// A robot reported a fault while the group was running.
    #[error("node {node}: fault {} ({:#06x}): {} The group ramps down.", fault.name(), fault.code(), fault.text().trim())]
    MemberFault {
        /// The node.
        node: u8,
        /// The fault.
        fault: Fault,
    },
    /// A robot stopped reporting while the group was running.
    #[error(
        "node {node} has sent no status for {syncs} SYNCs; the group ramps down. Check its power \
         and the bus wiring"
    )]
    MemberMissing {
        /// The node.
        node: u8,
        /// SYNCs without a status.
        syncs: u32,
    },
    /// All robots stopped reporting at once while the group was running.
    #[error(
        "no robot has sent a status for {syncs} SYNCs; the group ramps down. All fell silent at \
         once: check the adapter, its cable and the robots' supply. A simulator that was late says \
         'fell behind the clock'"
    )]
    MembersMissing {
        /// SYNCs without a status.
        syncs: u32,
    },
    /// A robot restarted while the group was running or being started.
    #[error(
        "node {node} restarted by itself; the group ramps down, and the next start configures it \
         again. Read its reset cause (2001:3) and its supply"
    )]
    MemberRestarted {
        /// The node.
        node: u8,
    },
    /// A robot left the OPERATIONAL state while the group was running.
    #[error("node {node} left OPERATIONAL (now {state:?}); the group ramps down")]
    MemberLeft {
        /// The node.
        node: u8,
        /// Its state as last heard.
        state: NmtState,
    },
    /// A robot's own pose was reset while the group was running.
    #[error(
        "node {node}: its pose jumped while the group was moving; the group ramps down. The robot \
         was reset, or its encoders lost their count: read its reset cause (2001:3)"
    )]
    PoseJumped {
        /// The node.
        node: u8,
    },
    /// This computer was late, which explains what happened.
    #[error(
        "this computer was too busy: it was {late_ms:.0} ms late within the last second, which \
         robots cannot distinguish from a broken bus. Close other programs, or permit real-time \
         priority (docs/operating.md, Busy computers). The resulting error: {error}"
    )]
    Busy {
        /// How late it was, in ms.
        late_ms: f64,
        /// The resulting error.
        error: Box<MasterError>,
    },
    /// The source of poses went silent.
    #[error(
        "no pose of the group has arrived for one second; the group ramps down. Check the program \
         that sends the poses"
    )]
    PoseLost,
    /// No person is there to answer a question.
    #[error("standard input ended before the question was answered")]
    NoAnswer,
    /// Giving node ids did not work.
    #[error("LSS: {0}")]
    Lss(String),
    /// Another master commands this bus.
    #[error(
        "another master is on the bus (received: {0}); stop it first: robots stop when two command \
         them"
    )]
    AnotherMaster(Sign),
    /// Another master has begun to command the robots of this one.
    #[error("another master took the robots (received, and not sent by this program: {0})")]
    Displaced(Sign),
    /// Something was to drive that does not listen to setpoints.
    #[error("the group is not started, so nothing would move; start it before each drive")]
    NotStarted,
    /// A stop was requested.
    #[error("stopped on request")]
    Aborted,
    /// Poses do not come as they should.
    #[error(
        "--pose {address}: {problem}; one line of JSON per sample is expected, see `docs/operating.md`"
    )]
    PoseSource {
        /// Where they come from.
        address: String,
        /// What is wrong.
        problem: String,
    },
    /// Yaw rates do not come as they should.
    #[error(
        "--gyro {address}: {problem}; one line of JSON per sample is expected, see `docs/operating.md`"
    )]
    GyroSource {
        /// Where they come from.
        address: String,
        /// What is wrong.
        problem: String,
    },
    /// Phases were to be found by the gyro on a robot's board, which does not use one.
    #[error("node {node}: the gyro on its board is not used, 0x2132:1 says \"{}\"; {}",
        .state.text(), gyro_remedy(*.state))]
    BoardGyro {
        /// The robot.
        node: u8,
        /// What the robot says of it.
        state: GyroState,
    },
    /// A wheel turned once and its encoder's index was not seen.
    #[error(
        "node {node}: the index of the {wheel} wheel was not detected within one turn (object \
         0x2114 is {state}); check its wire, or set rollers to none for this robot in the group file"
    )]
    NoIndex {
        /// The robot.
        node: u8,
        /// Its wheel.
        wheel: &'static str,
        /// What object 0x2114 says of it.
        state: u8,
    },
    /// A robot restarted in a calibration that goes by the angles of its rollers.
    #[error(
        "node {node} restarted and does not know the angles of its rollers any more; continue with \
         --resume, which searches for the indexes first"
    )]
    RollersLost {
        /// The robot.
        node: u8,
    },
    /// A curve asks for more than the group may do.
    #[error(
        "{trajectory} asks for {asked:.3} {unit}, but {limit_name} of the group is {limit:.3}; go \
         slower{}, or raise {limit_name} in the group file",
        if *is_curve { " (--speed or --scale below 1)" } else { "" }
    )]
    TooFast {
        /// Name of the curve, or "the velocity".
        trajectory: String,
        /// Whether it is a curve, which can be made slower or smaller.
        is_curve: bool,
        /// Largest value asked for.
        asked: f32,
        /// Unit of both values.
        unit: &'static str,
        /// Field of the group file.
        limit_name: &'static str,
        /// Its value.
        limit: f32,
    },
}

impl MasterError {
    /// The error itself, without the remark that this computer was late.
    #[must_use]
    pub fn cause(&self) -> &Self {
        match self {
            Self::Busy { error, .. } => error.cause(),
            error => error,
        }
    }

    /// Whether it is what robots do or seem to do when the master is late.
    pub(crate) fn may_come_of_lateness(&self) -> bool {
        match self {
            Self::NodeSilent { .. }
            | Self::BusDiagnosis { .. }
            | Self::Identification { .. }
            | Self::NotReady { .. }
            | Self::MemberMissing { .. }
            | Self::MembersMissing { .. }
            | Self::MemberLeft { .. }
            | Self::PoseLost => true,
            Self::MemberFault { fault, .. } => matches!(
                fault,
                Fault::MasterSilent
                    | Fault::SyncLost
                    | Fault::SetpointOverdue
                    | Fault::MemberSilent
                    | Fault::MemberStopped
                    | Fault::SequenceMismatch
                    | Fault::TwoMasters
            ),
            _ => false,
        }
    }
}

/// A state as last heard.
fn known(state: Option<impl std::fmt::Debug>) -> String {
    state.map_or_else(|| "unknown".into(), |state| format!("{state:?}"))
}

/// What to do about a gyro that is not used.
const fn gyro_remedy(state: GyroState) -> &'static str {
    match state {
        GyroState::None => "give --gyro tcp://HOST:PORT or --pose tcp://HOST:PORT",
        GyroState::Starting | GyroState::InUse => {
            "let the robot stand for two seconds, with its wheels still"
        }
        GyroState::Missing | GyroState::Stuck | GyroState::Implausible | GyroState::Silent => {
            "start the robot's program again, and see \"Gyro\" in docs/bring-up.md"
        }
    }
}

/// What to do about an SDO abort.
fn remedy(abort: AbortCode) -> &'static str {
    match abort {
        AbortCode::NoObject | AbortCode::NoSubIndex => {
            "the robot has the firmware of another release; flash it"
        }
        AbortCode::ValueTooHigh | AbortCode::ValueTooLow | AbortCode::InvalidValue => {
            "correct the value in the group file"
        }
        AbortCode::DeviceState => {
            "the robot does so only while its group is stopped (PRE-OPERATIONAL)"
        }
        AbortCode::LocalControl => "the robot is locked; `omnibus unlock --key FILE` first",
        AbortCode::Timeout => "check the bus wiring and that the node is powered",
        _ => "see the object's text in docs/can-protocol.md",
    }
}
