//! A group on a bus: from finding its robots to the SYNC that moves them.
//!
//! [`Group`] owns the link and is driven from one thread: every method sends what is due, listens
//! until the next thing is due, and returns. Whatever arrives while it waits is taken in by
//! [`Group::receive_frame`], so no frame is ever lost between two steps; nothing is buffered apart
//! from the last word of every member, the recorder's rows, and what subscribers of the telemetry
//! have not read.
//!
//! ```no_run
//! # fn main() -> anyhow::Result<()> {
//! use kinematics::Twist;
//! let file = group::GroupFile::load("groups/tcc-3.toml")?;
//! let bus = omnibus::bus::open(&"socketcan:can0".parse()?, &file)?;
//! let mut group = omnibus::Group::connect(bus, &file)?;
//! group.start()?;
//! group.set_twist(Twist::new(0.2, 0.0, 0.0))?;
//! group.run(3.0)?;
//! group.stop()?;
//! # Ok(())
//! # }
//! ```
//!
//! One period of SYNC looks like this. The group twist is sent [`Group::lead_us`] before the SYNC,
//! not together with it, because a controller with several mailboxes sends the lower identifier
//! first and SYNC's is lower. At SYNC k every member latches that twist and says what scale it can
//! follow; a few milliseconds later all apply it. The members' statuses for SYNC k are judged just
//! before SYNC k+1.
//!
//! On a real bus SYNC is sent by a thread of the link ([`Link::pace`]); the session only has to
//! have its setpoint out in time. When it is late, that SYNC goes without one, the miss is counted
//! and reported as telemetry, and the session goes on with the next SYNC; robots bridge a few and
//! then ramp down by themselves. Each wait that ends late lengthens the lead for good: latency is
//! given up only on a system that needs it. On a bus with virtual time the session sends SYNC
//! itself, exactly on time.
//!
//! Errors are returned as soon as they are known. The caller then calls [`Group::ramp_down`], which
//! never fails because of a member: robots that still listen must be told to stop.

pub mod configure;
mod cycle;
pub mod follow;
mod misbehave;
mod receive;
mod restart;
pub mod roller_index;
pub mod sdo;
mod snapshot;
mod temperature;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::sync::Arc;

use canopen::{Micros, NmtCommand, NmtState, NmtTarget, client};
use group::GroupFile;
use kinematics::{Pose, Twist};
use protocol::timing::SETPOINT_LEAD_US;
use protocol::{MemberState, MemberStatus};

use crate::abort::Abort;
use crate::bus::foreign::Sign;
use crate::bus::link::Link;
use crate::bus::punctuality::Punctuality;
use crate::bus::wire::{HubOwner, Wire};
use crate::error::MasterError;
use crate::monitor::common_frame::CommonFrame;
use crate::monitor::rows::Recorder;
use crate::monitor::telemetry::{
    DEFAULT_CAPACITY, Event, EventKind, Hub, Interest, Progress, SessionState, Subscription,
    Telemetry,
};
use crate::path::roller_transition;

/// How long robots may take to answer after the master came, in µs: a reset robot boots in far
/// less.
const CONNECT_TIMEOUT_US: u64 = 3_000_000;
/// How long members may take from NMT start until all are ready, in µs.
const START_TIMEOUT_US: u64 = 4_000_000;
/// How long the group may take to come to rest when it is stopped, in µs.
pub const STOP_PATIENCE_US: u64 = 5_000_000;
/// The twist goes out this long before its SYNC at most where the system is known to be late with
/// its threads, in µs.
const LONG_LEAD_US: u64 = 2_000;
/// SYNCs without a status after which a member counts as missing.
const MISSING_SYNCS: u32 = 3;

/// What the master knows about one member.
#[derive(Clone, Debug)]
pub struct Member {
    /// Node id.
    pub node: u8,
    /// NMT state as last heard.
    pub nmt: Option<NmtState>,
    /// Status as last heard.
    pub status: Option<MemberStatus>,
    /// When that was.
    pub status_at: Option<Micros>,
    /// When it was last heard at all.
    pub last_heartbeat: Option<Micros>,
    /// SYNCs since the last status.
    pub silent_syncs: u32,
    /// Temperature of the hottest motor behind smart drives as last heard, degrees Celsius.
    pub temperature: Option<u8>,
}

/// Whether the robots hold the group file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Configured {
    /// They have not got it in this session.
    Never,
    /// They have got it.
    Whole,
    /// They have got it, and one may have lost it since.
    Doubtful,
}

/// A group of robots on a bus.
pub struct Group<L> {
    pub(crate) wire: Wire<L>,
    pub(crate) file: Arc<GroupFile>,
    members: Vec<Member>,
    strangers: BTreeSet<u8>,
    recorder: Recorder,
    sequence: u8,
    began: Micros,
    next_sync: Micros,
    /// The link sends SYNC by itself.
    paced: bool,
    /// How long before its SYNC a twist goes out, at most; grows when the session comes late.
    longest_lead_us: u64,
    missed: u64,
    phase: SessionState,
    configured: Configured,
    /// The member whose boot-up was received last since the robots were configured.
    restarted: Option<u8>,
    /// Whether losses are made up for, as the robots were told when they were configured.
    compensation: bool,
    twist: Twist,
    /// Where the group should be at the SYNC whose row is being filled.
    target: Option<Pose>,
    curve: Option<Progress>,
    /// When another master's SYNC or heartbeat was last heard.
    foreign: Option<(Micros, Sign)>,
    /// What another master sent while this one commanded.
    displaced: Option<Sign>,
    /// One frame for the poses that members report.
    frame: CommonFrame,
    /// A member whose pose jumped while the group was driven.
    jumped: Option<u8>,
    abort: Abort,
}

impl<L: Link> Group<L> {
    /// Takes over the link as master and waits until every robot of the file has answered.
    ///
    /// # Errors
    /// When a robot does not answer in time, speaks another wire version, or the link fails.
    pub fn connect(bus: L, config: &GroupFile) -> Result<Self, MasterError> {
        let mut group = Self::observe(bus, config);
        group.wire.claim(true);
        group.find_members()?;
        Ok(group)
    }

    /// Takes over the link without claiming to be the master: it listens only, until
    /// [`Group::claim`].
    #[must_use]
    pub fn observe(bus: L, config: &GroupFile) -> Self {
        let now = bus.now();
        let mut wire = Wire::visiting(bus);
        wire.late_us = config.sync_period_us.into();
        let members = config.robots.iter().map(|robot| Member {
            node: robot.node,
            nmt: None,
            status: None,
            status_at: None,
            last_heartbeat: None,
            silent_syncs: 0,
            temperature: None,
        });
        Self {
            wire,
            members: members.collect(),
            file: Arc::new(config.clone()),
            strangers: BTreeSet::new(),
            recorder: Recorder::default(),
            sequence: 0,
            began: now,
            next_sync: now,
            paced: false,
            longest_lead_us: SETPOINT_LEAD_US.into(),
            missed: 0,
            phase: SessionState::Idle,
            configured: Configured::Never,
            restarted: None,
            compensation: false,
            twist: Twist::default(),
            target: None,
            curve: None,
            foreign: None,
            displaced: None,
            frame: CommonFrame::default(),
            jumped: None,
            abort: Abort::default(),
        }
    }

    /// Becomes the master of a bus that was only observed, and finds the members.
    ///
    /// # Errors
    /// When another master has been heard in the last second, or as [`Group::connect`].
    pub fn claim(&mut self) -> Result<(), MasterError> {
        if self.wire.is_master() {
            return Ok(());
        }
        if let Some(sign) = self.foreign_sign() {
            return Err(MasterError::AnotherMaster(sign));
        }
        self.wire.claim(true);
        self.find_members()
    }

    /// Whether another master's frames have been heard in the last second.
    #[must_use]
    pub fn foreign_master(&self) -> bool {
        self.foreign_sign().is_some()
    }

    /// What gave away another master in the last second.
    fn foreign_sign(&self) -> Option<Sign> {
        let now = self.wire.now().0;
        let (at, sign) = self.foreign?;
        (now < at.0 + 1_000_000).then_some(sign)
    }

    fn find_members(&mut self) -> Result<(), MasterError> {
        let deadline = Micros(self.wire.now().0 + CONNECT_TIMEOUT_US);
        for index in 0..self.members.len() {
            self.check_version(index, deadline)?;
        }
        Ok(())
    }

    /// The members in the order of the group file.
    #[must_use]
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// The group file.
    #[must_use]
    pub fn config(&self) -> &GroupFile {
        &self.file
    }

    /// Nodes that are on the bus and not in the group file.
    #[must_use]
    pub fn strangers(&self) -> &BTreeSet<u8> {
        &self.strangers
    }

    /// What came back so far.
    #[must_use]
    pub fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Keeps only about the last `rows` rows: for sessions without an end.
    pub fn keep_last(&mut self, rows: usize) {
        self.recorder.keep_last(rows);
    }

    /// A stream of snapshots (one per SYNC) and events from now on.
    #[must_use]
    pub fn telemetry(&self) -> Subscription {
        self.wire.hub.0.subscribe(Interest::Group, DEFAULT_CAPACITY)
    }

    /// Where subscriptions come from: a clone of it works from other threads.
    #[must_use]
    pub fn hub(&self) -> Hub {
        self.wire.hub.0.clone()
    }

    /// Publishes to a hub that already exists.
    pub fn set_hub(&mut self, hub: Hub) {
        self.wire.hub = HubOwner(hub);
    }

    /// What the session is doing.
    #[must_use]
    pub fn phase(&self) -> SessionState {
        self.phase
    }

    /// How punctual SYNC was so far; `None` on a bus with virtual time, where it is exact.
    #[must_use]
    pub fn punctuality(&self) -> Option<Punctuality> {
        let mut read = self.wire.link.punctuality()?;
        read.missed = self.missed;
        Some(read)
    }

    /// A handle by which another thread can stop the group: give it to a signal handler.
    #[must_use]
    pub fn abort(&self) -> Abort {
        self.abort.clone()
    }

    /// Uses an abort that already exists.
    pub fn set_abort(&mut self, abort: Abort) {
        self.abort = abort;
    }

    /// The wire, for reading and writing objects.
    pub fn wire(&mut self) -> &mut Wire<L> {
        &mut self.wire
    }

    /// The link, for an observer of a simulated world.
    pub fn link(&mut self) -> &mut L {
        &mut self.wire.link
    }

    /// Period of SYNC in µs.
    #[must_use]
    pub fn period_us(&self) -> u64 {
        u64::from(self.file.sync_period_us)
    }

    /// How long before its SYNC a group twist is sent, in µs: a quarter of the period and
    /// [`SETPOINT_LEAD_US`] at most, and 2 ms at most once the system has woken the session late.
    #[must_use]
    pub fn lead_us(&self) -> u64 {
        self.longest_lead_us.min(self.period_us() / 4)
    }

    /// When the next SYNC is due, on the link's clock.
    #[must_use]
    pub fn next_sync(&self) -> Micros {
        self.next_sync
    }

    /// Sends an NMT command to all robots.
    ///
    /// # Errors
    /// When the link fails.
    pub fn command(&mut self, command: NmtCommand) -> Result<(), MasterError> {
        self.wire.send(&client::nmt(command, NmtTarget::All))
    }

    /// Listens until `until`, sending the master's heartbeat whenever it is due.
    ///
    /// # Errors
    /// When the link fails.
    pub fn listen(&mut self, until: Micros) -> Result<(), MasterError> {
        while let Some((at, frame)) = self.wire.next(until)? {
            self.receive_frame(at, &frame);
        }
        Ok(())
    }

    /// Starts SYNC with a standing setpoint, then the robots, and returns once all are ready to
    /// move. Robots that have not been configured in this session get the group file first, and so
    /// do all when one may have lost it: after a restart, or when it was missing.
    ///
    /// # Errors
    /// When a member refuses its configuration or does not get ready in time, or the link fails;
    /// all robots are then back in PRE-OPERATIONAL.
    pub fn start(&mut self) -> Result<(), MasterError> {
        self.ensure_configured()?;
        self.set_phase(SessionState::Starting);
        self.twist = Twist::default();
        self.jumped = None;
        let started = self.bring_up();
        if let Err(error) = &started {
            self.fail(error);
            self.ramp_down(self.period_us())?;
        }
        started
    }

    fn bring_up(&mut self) -> Result<(), MasterError> {
        // On whole periods of the link's clock: an observer who samples at that rate sees every
        // SYNC.
        let period = self.period_us();
        self.next_sync = Micros((self.wire.now().0 / period + 2) * period);
        self.began = self.next_sync;
        self.begin_sync();
        for _ in 0..4 {
            self.cycle(Twist::default())?;
        }
        self.command(NmtCommand::Start)?;
        let deadline = self.wire.now().0 + START_TIMEOUT_US;
        loop {
            self.cycle(Twist::default())?;
            let Some(waiting) = self.members.iter().find(|m| !self.is_ready(m)) else {
                // A status is only sent in OPERATIONAL; the last heartbeat may be older.
                for member in &mut self.members {
                    member.nmt = Some(NmtState::Operational);
                }
                self.set_phase(SessionState::Running);
                return Ok(());
            };
            if self.wire.now().0 > deadline {
                let error = MasterError::NotReady {
                    node: waiting.node,
                    nmt: waiting.nmt,
                    state: waiting.status.map(|s| s.state),
                    code: waiting
                        .status
                        .map_or_else(|| "unknown".into(), |s| s.code.to_string()),
                };
                return Err(self.wire.blame(error));
            }
        }
    }

    /// Whether a member follows, and followed the setpoint before the last: it does so once the
    /// group has agreed on standstill often enough (object 0x2042:1). (The answer to the SYNC just
    /// sent is still on its way.)
    fn is_ready(&self, member: &Member) -> bool {
        member.status.is_some_and(|status| {
            status.state == MemberState::Moving && status.sequence == self.sequence.wrapping_sub(1)
        })
    }

    /// Sets the velocity of the group, in the group frame, for [`Group::run`].
    ///
    /// # Errors
    /// When it is beyond the limits of the group file, or not a number; the old one stays.
    pub fn set_twist(&mut self, twist: Twist) -> Result<(), MasterError> {
        check_twist(twist, &self.file.limits)?;
        self.twist = twist;
        Ok(())
    }

    /// Moves with the velocity set, for so many seconds of the bus's time.
    ///
    /// # Errors
    /// When the group is not started, or as [`Group::cycle`]; call [`Group::stop`] then.
    pub fn run(&mut self, seconds: f64) -> Result<(), MasterError> {
        self.run_with(seconds, &mut |_| {})
    }

    /// The same; `tell` is called once per SYNC with the fraction of the time that is over.
    ///
    /// # Errors
    /// As [`Group::run`].
    pub fn run_with(&mut self, seconds: f64, tell: &mut dyn FnMut(f64)) -> Result<(), MasterError> {
        self.check_started()?;
        let from = self.next_sync.0 as f64;
        while (self.next_sync.0 as f64) < from + seconds * 1e6 {
            self.cycle(self.twist)?;
            tell((self.next_sync.0 as f64 - from) / (seconds * 1e6));
        }
        Ok(())
    }

    pub(crate) fn check_started(&self) -> Result<(), MasterError> {
        if self.phase == SessionState::Running {
            Ok(())
        } else {
            Err(MasterError::NotStarted)
        }
    }

    /// Brings the group to rest, however it was moving, and takes it out of OPERATIONAL.
    ///
    /// # Errors
    /// Only when the link fails.
    pub fn stop(&mut self) -> Result<(), MasterError> {
        self.ramp_down(STOP_PATIENCE_US)
    }

    fn set_phase(&mut self, phase: SessionState) {
        if self.phase != phase {
            self.phase = phase;
            self.publish(None, EventKind::SessionState(phase));
        }
    }

    /// Tells subscribers why the session ends.
    pub(crate) fn fail(&self, error: &MasterError) {
        self.publish(None, EventKind::Failed(error.to_string()));
    }

    fn publish(&self, node: Option<u8>, what: EventKind) {
        let t = self.wire.seconds(self.wire.now());
        let event = Event { t, node, what };
        self.wire.hub.0.publish(&Telemetry::Event(event));
    }

    /// Goes by another file from now on, with the same robots; they get it when they are configured
    /// or started next.
    #[cfg(feature = "calibration")]
    pub(crate) fn set_config(&mut self, file: GroupFile) {
        self.file = Arc::new(file);
        self.configured = Configured::Never;
    }

    /// What has to be asked for beside a twist in the group frame; nothing where losses are not
    /// made up for.
    pub(crate) fn lost_by_hand_over(&self, twist: Twist) -> Twist {
        if self.compensation {
            roller_transition::lost(&self.file, twist)
        } else {
            Twist::ZERO
        }
    }

    /// Zero of the recorder's rows, on the link's clock.
    pub(crate) fn rows_began(&self) -> Micros {
        self.began
    }

    pub(crate) fn set_target(&mut self, target: Option<Pose>) {
        self.target = target;
    }

    pub(crate) fn set_curve(&mut self, curve: Option<Progress>) {
        self.curve = curve;
    }
}

/// `twist`, slowed down in its direction as far as the limits of the group ask, and by which
/// factor. `None` for a value that is not finite.
#[must_use]
pub fn slowed(twist: Twist, limits: &group::Limits) -> Option<(Twist, f32)> {
    let speed = twist.vx.hypot(twist.vy) / limits.linear_speed;
    let turn = twist.omega.abs() / limits.yaw_rate;
    if !(speed.is_finite() && turn.is_finite()) {
        return None;
    }
    let excess = speed.max(turn);
    // A hair below, so that rounding does not end above.
    let share = if excess > 1.0 { 0.9999 / excess } else { 1.0 };
    let slowed = Twist::new(twist.vx * share, twist.vy * share, twist.omega * share);
    Some((slowed, share))
}

/// Checks a velocity of the group against its limits.
///
/// # Errors
/// Names the limit of the group file.
pub fn check_twist(twist: Twist, limits: &group::Limits) -> Result<(), MasterError> {
    let refused = |asked: f32, unit, limit_name, limit| MasterError::TooFast {
        trajectory: "the velocity".into(),
        is_curve: false,
        asked,
        unit,
        limit_name,
        limit,
    };
    let speed = twist.vx.hypot(twist.vy);
    if speed.is_nan() || speed > limits.linear_speed {
        let limit = limits.linear_speed;
        return Err(refused(speed, "m/s", "limits.linear_speed", limit));
    }
    if twist.omega.is_nan() || twist.omega.abs() > limits.yaw_rate {
        let limit = limits.yaw_rate;
        return Err(refused(twist.omega, "rad/s", "limits.yaw_rate", limit));
    }
    Ok(())
}

/// Whether a member is in a state from which it cannot move until it is started again.
#[must_use]
pub fn is_at_rest(state: MemberState) -> bool {
    !matches!(
        state,
        MemberState::Moving | MemberState::Alone | MemberState::Ramping
    )
}
