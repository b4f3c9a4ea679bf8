//! A group on a bus: from finding its robots to the SYNC that moves them.
//!
//! [`Group`] owns the link and is driven from one thread: every method sends what is due, listens
//! until the next thing is due, and returns. Whatever arrives while it waits is taken in by
//! [`Group::hear`], so no frame is ever lost between two steps; nothing is buffered apart from the
//! last word of every member and the recorder's rows.
//!
//! One period of SYNC looks like this. The group twist is sent [`Group::lead_us`] before the SYNC, not
//! together with it, because a controller with several mailboxes sends the lower identifier first
//! and SYNC's is lower. At SYNC k every member latches that twist and says what scale it can follow;
//! at SYNC k+1 all apply it. The members' statuses for SYNC k are judged just before SYNC k+1.
//!
//! Errors are returned as soon as they are known. The caller then calls [`Group::ramp_down`], which
//! never fails because of a member: robots that still listen must be told to stop.

use std::collections::BTreeSet;

use canopen::{Frame, Micros, NmtCommand, NmtState, NmtTarget, client};
use group::GroupFile;
use kinematics::Twist;
use protocol::{
    Code, Fault, GroupTwist, MeasuredTwist, MemberState, MemberStatus, PoseReport, WheelRateReport,
    cob,
};

use crate::abort::Abort;
use crate::error::MasterError;
use crate::link::Link;
use crate::record::Recorder;
use crate::wire::Wire;

/// How long robots may take to answer after the master came, in µs: a reset robot boots in far less.
const CONNECT_TIMEOUT_US: u64 = 3_000_000;
/// How long members may take from NMT start until all are ready, in µs.
const START_TIMEOUT_US: u64 = 2_000_000;
/// The twist goes out this long before its SYNC at most, in µs.
const MAX_LEAD_US: u64 = 2_000;
/// SYNCs without a status after which a member counts as missing.
const MISSING_SYNCS: u32 = 3;
/// The SYNC counter runs from 1 to this (object 0x1019).
pub const SYNC_OVERFLOW: u8 = 240;

/// What the master knows about one member.
#[derive(Clone, Debug)]
pub struct Member {
    /// Node id.
    pub node: u8,
    /// NMT state as last heard.
    pub nmt: Option<NmtState>,
    /// Status as last heard.
    pub status: Option<MemberStatus>,
    /// SYNCs since the last status.
    pub silent_syncs: u32,
}

/// A group of robots on a bus.
pub struct Group<'a, L> {
    pub(crate) wire: Wire<L>,
    pub(crate) file: &'a GroupFile,
    members: Vec<Member>,
    strangers: BTreeSet<u8>,
    recorder: Recorder,
    sequence: u8,
    counter: u8,
    began: Micros,
    next_sync: Micros,
    running: bool,
    abort: Abort,
}

impl<'a, L: Link> Group<'a, L> {
    /// Takes over the link and waits until every robot of the file has answered.
    ///
    /// # Errors
    /// When a robot does not answer in time, speaks another wire version, or the link fails.
    pub fn connect(link: L, file: &'a GroupFile) -> Result<Self, MasterError> {
        let now = link.now();
        let members = file.robots.iter().map(|robot| Member {
            node: robot.node,
            nmt: None,
            status: None,
            silent_syncs: 0,
        });
        let mut group = Self {
            wire: Wire::commanding(link),
            file,
            members: members.collect(),
            strangers: BTreeSet::new(),
            recorder: Recorder::default(),
            sequence: 0,
            counter: 0,
            began: now,
            next_sync: now,
            running: false,
            abort: Abort::default(),
        };
        let deadline = Micros(now.0 + CONNECT_TIMEOUT_US);
        for index in 0..group.members.len() {
            group.identify(index, deadline)?;
        }
        Ok(group)
    }

    /// The members in the order of the group file.
    #[must_use]
    pub fn members(&self) -> &[Member] {
        &self.members
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

    /// How long before its SYNC a group twist is sent, in µs.
    #[must_use]
    pub fn lead_us(&self) -> u64 {
        MAX_LEAD_US.min(self.period_us() / 4)
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
        while let Some((_, frame)) = self.wire.next(until)? {
            self.hear(&frame);
        }
        Ok(())
    }

    /// Takes in whatever a robot said. Frames that are not the robots' are no concern of the master;
    /// frames that do not decode are left out of the record, and their sender will be missed.
    pub(crate) fn hear(&mut self, frame: &Frame) {
        let (id, data) = (frame.id(), frame.data());
        if let Some((node, state)) = client::parse_heartbeat(frame) {
            let member = self.members.iter_mut().find(|m| m.node == node.get());
            match member {
                Some(member) => member.nmt = Some(state),
                None if node.get() == protocol::MASTER => {}
                None => {
                    self.strangers.insert(node.get());
                }
            }
            return;
        }
        for (index, member) in self.members.iter_mut().enumerate() {
            let node = member.node;
            let Some(row) = self.recorder.member(index) else {
                return;
            };
            if id == cob::member_status(node) {
                if let Ok(status) = MemberStatus::try_from(data) {
                    member.silent_syncs = 0;
                    member.status = Some(status);
                    row.permitted_scale = Some(status.scale.factor());
                    row.slip_residual = status.slip_residual;
                    row.code = Some(status.code.code());
                }
            } else if id == cob::measured_twist(node) {
                row.measured = MeasuredTwist::try_from(data).ok().map(|m| m.twist);
            } else if id == cob::pose(node) {
                row.pose = PoseReport::try_from(data).ok().map(|p| p.pose);
            } else if id == cob::wheel_rates(node) {
                row.wheel_rates = WheelRateReport::try_from(data).ok().map(|w| w.rates);
            } else {
                continue;
            }
            return;
        }
    }

    /// Starts SYNC with a standing setpoint, then the robots, and returns once all are ready to move.
    ///
    /// # Errors
    /// When a member does not get ready in time, or the link fails; all robots are then back in
    /// PRE-OPERATIONAL.
    pub fn start(&mut self) -> Result<(), MasterError> {
        let started = self.bring_up();
        if started.is_err() {
            self.ramp_down(self.period_us())?;
        }
        started
    }

    fn bring_up(&mut self) -> Result<(), MasterError> {
        // On whole periods of the link's clock: an observer who samples at that rate sees every SYNC.
        let period = self.period_us();
        self.next_sync = Micros((self.wire.now().0 / period + 2) * period);
        self.began = self.next_sync;
        for _ in 0..4 {
            self.cycle(Twist::default())?;
        }
        self.command(NmtCommand::Start)?;
        let deadline = self.wire.now().0 + START_TIMEOUT_US;
        loop {
            self.cycle(Twist::default())?;
            let Some(waiting) = self.members.iter().find(|m| !self.is_ready(m)) else {
                self.running = true;
                // A status is only sent in OPERATIONAL; the last heartbeat may be older.
                for member in &mut self.members {
                    member.nmt = Some(NmtState::Operational);
                }
                return Ok(());
            };
            if self.wire.now().0 > deadline {
                return Err(MasterError::NotReady {
                    node: waiting.node,
                    nmt: waiting.nmt,
                    state: waiting.status.map(|s| s.state),
                    code: waiting
                        .status
                        .map_or_else(|| "unknown".into(), |s| describe(s.code)),
                });
            }
        }
    }

    /// Whether a member followed the setpoint before the last and can follow another. (The answer to
    /// the SYNC just sent is still on its way.)
    fn is_ready(&self, member: &Member) -> bool {
        member.status.is_some_and(|status| {
            status.state.can_follow() && status.sequence == self.sequence.wrapping_sub(1)
        })
    }

    /// One SYNC period: listens until the next SYNC is due, sends the setpoint ahead of it and the
    /// SYNC, in time, and judges what the members said about the SYNC before.
    ///
    /// # Errors
    /// When a member faults, leaves or is missing while the group runs, or the link fails.
    pub fn cycle(&mut self, twist: Twist) -> Result<(), MasterError> {
        let sync_at = self.next_sync;
        self.listen(Micros(sync_at.0.saturating_sub(self.lead_us())))?;
        self.sequence = self.sequence.wrapping_add(1);
        let setpoint = GroupTwist {
            twist,
            sequence: self.sequence,
            group: self.file.group_id,
        };
        self.wire
            .send(&Frame::of(cob::GROUP_TWIST, setpoint.encode()))?;
        self.listen(sync_at)?;
        let judged = self.judge();
        self.counter = self.counter % SYNC_OVERFLOW + 1;
        self.wire.send(&client::sync(Some(self.counter)))?;
        let t = (sync_at.0 as f64 - self.began.0 as f64) * 1e-6;
        let members = self.members.len();
        self.recorder.open(t, self.sequence, twist, members);
        for member in &mut self.members {
            member.silent_syncs += 1;
        }
        self.next_sync = Micros(sync_at.0 + self.period_us());
        judged?;
        if self.running && self.abort.is_asked() {
            return Err(MasterError::Aborted);
        }
        Ok(())
    }

    /// The first thing wrong with a member, causes before consequences.
    fn judge(&self) -> Result<(), MasterError> {
        if !self.running {
            return Ok(());
        }
        let faults = self.members.iter().filter_map(|member| {
            let Code::Fault(fault) = member.status?.code else {
                return None;
            };
            Some((is_consequence(fault), member.node, fault))
        });
        if let Some((_, node, fault)) = faults.min_by_key(|(consequence, ..)| *consequence) {
            return Err(MasterError::MemberFault { node, fault });
        }
        for member in &self.members {
            if member.silent_syncs >= MISSING_SYNCS {
                return Err(MasterError::MemberMissing {
                    node: member.node,
                    syncs: member.silent_syncs,
                });
            }
            if member.nmt == Some(NmtState::Initialising) {
                return Err(MasterError::MemberRestarted { node: member.node });
            }
            if let Some(state) = member.nmt
                && state != NmtState::Operational
            {
                return Err(MasterError::MemberLeft {
                    node: member.node,
                    state,
                });
            }
        }
        Ok(())
    }

    /// Commands standstill until the members report it (or `patience_us` is over), then takes them
    /// out of OPERATIONAL. Members' complaints do not stop it.
    ///
    /// # Errors
    /// Only when the link itself fails.
    pub fn ramp_down(&mut self, patience_us: u64) -> Result<(), MasterError> {
        self.running = false;
        let deadline = self.wire.now().0 + patience_us;
        self.next_sync = Micros(self.next_sync.0.max(self.wire.now().0 + self.lead_us()));
        // Two SYNCs until the first standing setpoint is in force, one more to be measured.
        for cycle in 0.. {
            self.cycle(Twist::default())?;
            if self.abort.is_urgent()
                || self.wire.now().0 > deadline
                || (cycle > 3 && self.stands())
            {
                break;
            }
        }
        self.command(NmtCommand::EnterPreOperational)?;
        let settle = Micros(self.wire.now().0 + self.period_us());
        self.listen(settle)
    }

    /// Whether every member that still talks measures no motion worth mentioning: 1 mm/s, 1 mrad/s.
    fn stands(&self) -> bool {
        let rows = self.recorder.rows();
        let Some(row) = rows.len().checked_sub(2).and_then(|i| rows.get(i)) else {
            return false;
        };
        row.members.iter().all(|member| {
            member
                .measured
                .is_none_or(|m| m.vx.hypot(m.vy) < 1e-3 && m.omega.abs() < 1e-3)
        })
    }
}

/// Whether a fault usually is another node's doing.
fn is_consequence(fault: Fault) -> bool {
    matches!(
        fault,
        Fault::MemberStopped | Fault::MemberSilent | Fault::SequenceMismatch
    )
}

/// A limit or fault in words.
#[must_use]
pub fn describe(code: Code) -> String {
    match code {
        Code::None => "none".into(),
        Code::Limit(limit) => format!("limit {}: {}", limit.name(), limit.text().trim()),
        Code::Fault(fault) => format!("fault {}: {}", fault.name(), fault.text().trim()),
    }
}

/// Whether a member is in a state from which it cannot move until it is started again.
#[must_use]
pub fn is_at_rest(state: MemberState) -> bool {
    !matches!(
        state,
        MemberState::Moving | MemberState::Alone | MemberState::Ramping
    )
}
