//! Telemetry of a running group for its observers: live views, recorders, the page, your own
//! program.
//!
//! The session makes one [`Snapshot`] per SYNC period, when everything that belongs to that SYNC
//! has come in: one period after it happened. Snapshots, single frames and events go to every
//! [`Subscription`] of the session's [`Hub`]. A reader that is slow loses its oldest items and can
//! see how many; it never holds up the session. Without subscribers nothing is created or copied.
//!
//! All values are SI and in the group frame (x forward, y left, counter-clockwise positive). `None`
//! is "not known": no frame arrived, or it is not measured. Times are those of the link's clock
//! since the session began; on a simulated bus they are virtual.

mod stream;

pub use stream::{DEFAULT_CAPACITY, Hub, Interest, Subscription};

use std::sync::Arc;

use canopen::{Frame, NmtState};
use kinematics::{Pose, Twist, WheelRates};
use protocol::{Code, Limit, MemberState};

use crate::bus::punctuality::Punctuality;

/// One item of the stream.
#[derive(Clone, Debug, PartialEq)]
pub enum Telemetry {
    /// The group at one SYNC.
    Snapshot(Arc<Snapshot>),
    /// A frame on the bus; only for those who subscribed to frames.
    Frame(BusFrame),
    /// Something that happened once.
    Event(Event),
}

/// What the session is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SessionState {
    /// No SYNC is sent; robots are or are being configured.
    #[default]
    Idle,
    /// SYNC runs with a standing setpoint until all members are ready.
    Starting,
    /// Setpoints are followed.
    Running,
    /// Standstill is commanded.
    Stopping,
}

impl SessionState {
    /// One word for people and for JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Starting => "starting",
            Self::Running => "running",
            Self::Stopping => "stopping",
        }
    }
}

/// The group at one SYNC.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Time of the SYNC since the session began, in s.
    pub t: f64,
    /// What the session is doing.
    pub phase: SessionState,
    /// Another master is on the bus.
    pub foreign_master: bool,
    /// Sequence number of the group twist sent before the SYNC.
    pub sequence: u8,
    /// That group twist, in the group frame.
    pub command: Twist,
    /// Where the group should be at this instant, on a curve; frame of `pose`.
    pub target: Option<Pose>,
    /// How far the curve is that a pilot drives.
    pub curve: Option<Progress>,
    /// Where the group is: the mean of what the members work out from their wheels, in the frame in
    /// which they were configured.
    pub pose: Option<Pose>,
    /// How fast the group moves: the mean of the members' measured twists.
    pub measured: Option<Twist>,
    /// The smallest scale that a member permits, 0..=1: what the group moves at.
    pub scale: Option<f32>,
    /// Largest disagreement of two members about the group's motion, at its origin, in m/s.
    pub strain: Option<f32>,
    /// Share of the bus that frames took in the last 100 ms, 0..=1.
    pub bus_load: Option<f32>,
    /// How punctual SYNC was; `None` on a bus with virtual time, where it is exact.
    pub sync: Option<Punctuality>,
    /// One entry per robot, in the order of the group file.
    pub members: Vec<MemberSample>,
}

/// How far a curve is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Time since it began, in s.
    pub t: f64,
    /// How long it takes, in s.
    pub duration: f64,
}

/// The oldest status that counts as the present, in s.
pub const PRESENT: f64 = 0.1;
/// The oldest heartbeat that counts as the present, in s: robots send one every 100 ms at least.
pub const PRESENT_NMT: f64 = 1.0;

/// A status that is too old to be the present.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PastStatus {
    /// State, where it was known.
    pub state: Option<MemberState>,
    /// Limit or fault.
    pub code: Code,
    /// How old it is, in s.
    pub age: f64,
}

impl std::fmt::Display for PastStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let code = match self.code {
            Code::None => None,
            Code::Limit(limit) => Some(limit.name()),
            Code::Fault(fault) => Some(fault.name()),
        };
        let state = self.state.map(|state| format!("{state:?}"));
        let what = code.map(str::to_owned).or(state);
        write!(f, "{} ", what.as_deref().unwrap_or("heard"))?;
        match self.age {
            age if age < 10.0 => write!(f, "{age:.1} s ago"),
            age if age < 600.0 => write!(f, "{age:.0} s ago"),
            age => write!(f, "{:.0} min ago", age / 60.0),
        }
    }
}

/// One member at one SYNC; fields are `None` where its frame did not come in this period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MemberSample {
    /// Node id.
    pub node: u8,
    /// NMT state, if its heartbeat was heard within the last second.
    pub nmt: Option<NmtState>,
    /// State, if its status is not older than [`PRESENT`].
    pub state: Option<MemberState>,
    /// Limit or fault of that status.
    pub code: Code,
    /// Its last status, where that is older.
    pub past: Option<PastStatus>,
    /// SYNCs since its last status.
    pub silent_syncs: u32,
    /// Scale at which its own wheels could follow, 0..=1.
    pub permitted_scale: Option<f32>,
    /// Wheel rates that no rigid motion explains, in rad/s.
    pub slip_residual: Option<f32>,
    /// Measured velocity of the group as this member sees it, in the group frame.
    pub measured: Option<Twist>,
    /// Pose of the group as this member works it out.
    pub pose: Option<Pose>,
    /// Measured wheel rates in rad/s, positive rolls the base forward.
    pub wheel_rates: Option<WheelRates>,
    /// Yaw rate of its gyro, in rad/s, counter-clockwise positive; only where that is used.
    pub yaw_rate: Option<f32>,
    /// Temperature of the hottest motor behind smart drives, degrees Celsius: as last read, and
    /// asked for only while this program commands.
    pub motor_temperature: Option<u8>,
}

impl MemberSample {
    /// The same at a moment when its status and its last heartbeat are so old, in s: what is no
    /// longer the present is the past.
    #[must_use]
    pub fn aged(mut self, status: Option<f64>, heartbeat: Option<f64>) -> Self {
        if let Some(age) = status.filter(|age| *age > PRESENT) {
            self.past = Some(PastStatus {
                state: self.state.take(),
                code: std::mem::take(&mut self.code),
                age,
            });
            self.permitted_scale = None;
            self.slip_residual = None;
            self.measured = None;
            self.wheel_rates = None;
            self.yaw_rate = None;
        }
        if heartbeat.is_some_and(|age| age > PRESENT_NMT) {
            self.nmt = None;
        }
        self
    }
}

/// A frame on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BusFrame {
    /// Time since the session began, in s.
    pub t: f64,
    /// The frame.
    pub frame: Frame,
    /// Whether the master sent it.
    pub sent: bool,
}

/// Something that happened once.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// Time since the session began, in s.
    pub t: f64,
    /// The node concerned; `None` for the master itself or the bus.
    pub node: Option<u8>,
    /// What happened.
    pub what: EventKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum EventKind {
    /// The session went into another phase.
    SessionState(SessionState),
    /// A robot's NMT state changed, or was heard for the first time.
    Nmt(NmtState),
    /// A member's state changed.
    State(MemberState),
    /// A member's limit or fault appeared or went.
    Code(Code),
    /// A robot sent an emergency message: its error code (0 means over).
    Emergency(u16),
    /// The master was too late for one or more SYNCs with its setpoint; how many so far.
    Late(u64),
    /// A member has restarted or was missing, so all robots were configured again.
    ConfiguredAgain,
    /// The session ended with an error; its message.
    Failed(String),
}

/// What of a code is worth an event. That the group's own ramp holds it back is what every change
/// of velocity by hand does.
pub(crate) const fn reportable(code: Code) -> Code {
    match code {
        Code::Limit(Limit::Acceleration) => Code::None,
        other => other,
    }
}

impl std::fmt::Display for EventKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::SessionState(phase) => f.write_str(phase.name()),
            Self::Nmt(state) => write!(f, "NMT {state:?}"),
            Self::State(state) => write!(f, "{state:?}"),
            Self::Code(Code::None) => f.write_str("limit cleared"),
            Self::Code(code) => code.fmt(f),
            Self::Emergency(0) => f.write_str("emergency over"),
            Self::Emergency(code) => write!(f, "emergency {code:#06x}"),
            Self::Late(count) => write!(f, "the master fell behind: {count} setpoints too late"),
            Self::ConfiguredAgain => {
                f.write_str("configured again with the whole group, after a restart or a silence")
            }
            Self::Failed(message) => f.write_str(message),
        }
    }
}

/// How grave an event is: the numbers of `foxglove.Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Something changed.
    Info = 2,
    /// The group goes on, but not as asked.
    Warning = 3,
    /// The group cannot go on.
    Error = 4,
}

impl Level {
    /// One word for people and for JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// How grave something is that happened.
#[must_use]
pub const fn level(what: &EventKind) -> Level {
    match what {
        EventKind::Code(Code::Fault(_)) | EventKind::Failed(_) => Level::Error,
        EventKind::Emergency(code) if *code != 0 => Level::Error,
        EventKind::Code(Code::Limit(_)) | EventKind::Late(_) => Level::Warning,
        EventKind::Emergency(_)
        | EventKind::Code(Code::None)
        | EventKind::SessionState(_)
        | EventKind::Nmt(_)
        | EventKind::ConfiguredAgain
        | EventKind::State(_) => Level::Info,
    }
}
