//! One SYNC period after the other, and the way to standstill.

use canopen::{Frame, Micros, NmtCommand, NmtState, client};
use kinematics::Twist;
use protocol::{Code, GroupTwist, cob};

use super::{Group, LONG_LEAD_US, MISSING_SYNCS, Member};
use crate::bus::link::{Link, Schedule};
use crate::error::MasterError;
use crate::monitor::telemetry::{EventKind, SessionState};
use protocol::timing::SYNC_OVERFLOW;

/// A setpoint must be on its way this long before its SYNC, in µs; a frame takes 0.13 ms on the
/// wire.
const MARGIN_US: u64 = 400;
/// A wait that ends later than this lengthens the lead, in µs: half of what the margin leaves of
/// the short one.
const LATE_US: u64 = 400;

impl<L: Link> Group<L> {
    /// Begins to send SYNC at [`Group::next_sync`], from the link's own thread where it has one.
    pub(super) fn begin_sync(&mut self) {
        let schedule = Schedule {
            first: self.next_sync,
            period_us: self.period_us(),
            counter: self.next_counter(),
            overflow: SYNC_OVERFLOW,
        };
        self.paced = self.wire.link.pace(Some(schedule));
    }

    /// The counter of the next SYNC: one more than that of the last SYNC on the bus, from any
    /// master.
    fn next_counter(&self) -> u8 {
        self.wire.sync_counter() % SYNC_OVERFLOW + 1
    }

    /// Stops sending SYNC.
    pub(super) fn end_sync(&mut self) -> Result<(), MasterError> {
        if self.paced {
            self.wire.link.pace(None);
            self.paced = false;
            // The last SYNC may have gone out meanwhile: it is noted, too.
            self.listen(self.wire.now())?;
        }
        Ok(())
    }

    /// One SYNC period: listens until the next SYNC is due, sends the setpoint ahead of it and the
    /// SYNC, in time, and judges what the members said about the SYNC before.
    ///
    /// # Errors
    /// When a member faults, leaves or is missing while the group runs, or the link fails.
    pub fn cycle(&mut self, twist: Twist) -> Result<(), MasterError> {
        self.cycle_with(&mut |_| twist)
    }

    /// The same with a setpoint that depends on the time of its SYNC on the link's clock. (Not
    /// always the one that was next: a session that was too late goes on with a later one.)
    ///
    /// # Errors
    /// As [`Group::cycle`].
    pub fn cycle_with(
        &mut self,
        setpoint: &mut dyn FnMut(Micros) -> Twist,
    ) -> Result<(), MasterError> {
        self.await_turn()?;
        let twist = setpoint(self.next_sync);
        self.run_period(twist)
    }

    /// Listens until the setpoint for the next SYNC has to go out; [`Group::next_sync`] then says
    /// which.
    pub(crate) fn await_turn(&mut self) -> Result<(), MasterError> {
        self.ask_for_temperature()?;
        let ahead = Micros(self.next_sync.0.saturating_sub(self.lead_us()));
        self.listen(ahead)?;
        if self.paced && self.wire.now().0 > ahead.0 + LATE_US {
            self.longest_lead_us = LONG_LEAD_US;
        }
        self.catch_up()
    }

    /// Sends the setpoint and sees the SYNC through.
    pub(crate) fn run_period(&mut self, twist: Twist) -> Result<(), MasterError> {
        self.sequence = self.sequence.wrapping_add(1);
        let frame = GroupTwist {
            twist,
            sequence: self.sequence,
            group: self.file.group_id,
        };
        self.wire
            .send(&Frame::of(cob::GROUP_TWIST, frame.encode()))?;
        self.finish_period(twist)
    }

    /// Sees the SYNC through.
    pub(super) fn finish_period(&mut self, twist: Twist) -> Result<(), MasterError> {
        let sync_at = self.next_sync;
        self.listen(sync_at)?;
        let judged = self.judge().map_err(|error| self.wire.blame(error));
        let is_missing = |member: &Member| member.silent_syncs >= MISSING_SYNCS;
        if self.phase == SessionState::Running && self.members.iter().any(is_missing) {
            self.doubt_configuration();
        }
        self.close_row();
        if !self.paced {
            let sync = client::sync(Some(self.next_counter()));
            self.wire.send(&sync)?;
        }
        let t = (sync_at.0 as f64 - self.began.0 as f64) * 1e-6;
        let members = self.members.len();
        self.recorder.open(t, self.sequence, twist, members);
        for member in &mut self.members {
            member.silent_syncs += 1;
        }
        self.next_sync = Micros(sync_at.0 + self.period_us());
        judged?;
        if self.phase == SessionState::Running && self.abort.is_asked() {
            return Err(MasterError::Aborted);
        }
        Ok(())
    }

    /// Moves on to the next SYNC that a setpoint can still reach. SYNCs that went without one are
    /// counted; members answer them all the same, so no member is missing because of them.
    fn catch_up(&mut self) -> Result<(), MasterError> {
        let period = self.period_us();
        let margin = MARGIN_US.min(self.lead_us() / 2);
        let now = self.wire.now().0;
        if !self.paced || now + margin <= self.next_sync.0 {
            return Ok(());
        }
        let skipped = (now + margin - self.next_sync.0).div_ceil(period);
        self.next_sync = Micros(self.next_sync.0 + skipped * period);
        self.missed += skipped;
        self.wire.count_late(Micros(skipped * period));
        self.publish(None, EventKind::Late(self.missed));
        let ahead = Micros(self.next_sync.0.saturating_sub(self.lead_us()));
        self.listen(ahead)
    }

    /// The first thing wrong with a member, causes before consequences.
    fn judge(&self) -> Result<(), MasterError> {
        let restarted = self
            .restarted
            .map(|node| MasterError::MemberRestarted { node });
        match (self.phase, &restarted) {
            (SessionState::Running, _) => {}
            // It would start with the parameters of its flash.
            (SessionState::Starting, Some(error)) => return Err(error.clone()),
            _ => return Ok(()),
        }
        if let Some(sign) = self.displaced {
            return Err(MasterError::Displaced(sign));
        }
        let faults = self.members.iter().filter_map(|member| {
            let Code::Fault(fault) = member.status?.code else {
                return None;
            };
            Some((fault.is_consequence(), member.node, fault))
        });
        let first = faults.min_by_key(|(consequence, ..)| *consequence);
        if first.is_none_or(|(consequence, ..)| consequence)
            && let Some(error) = restarted
        {
            return Err(error);
        }
        if let Some((_, node, fault)) = first {
            // The culprit is the one that was not heard, not the first to say so.
            let silent = self.members.iter().max_by_key(|member| member.silent_syncs);
            return Err(match silent {
                Some(silent)
                    if fault == protocol::Fault::MemberSilent && silent.silent_syncs > 1 =>
                {
                    MasterError::MemberMissing {
                        node: silent.node,
                        syncs: silent.silent_syncs,
                    }
                }
                _ => MasterError::MemberFault { node, fault },
            });
        }
        let since_any = self.members.iter().map(|member| member.silent_syncs).min();
        if let Some(syncs) = since_any
            && syncs >= MISSING_SYNCS
            && self.members.len() > 1
        {
            return Err(MasterError::MembersMissing { syncs });
        }
        for member in &self.members {
            if member.silent_syncs >= MISSING_SYNCS {
                return Err(MasterError::MemberMissing {
                    node: member.node,
                    syncs: member.silent_syncs,
                });
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
        if let Some(node) = self.jumped {
            return Err(MasterError::PoseJumped { node });
        }
        Ok(())
    }

    /// Commands standstill until the members report it (or `patience_us` is over), then takes them
    /// out of OPERATIONAL. Members' complaints do not stop it.
    ///
    /// # Errors
    /// Only when the link itself fails.
    pub fn ramp_down(&mut self, patience_us: u64) -> Result<(), MasterError> {
        self.set_phase(SessionState::Stopping);
        self.set_target(None);
        if self.displaced.take().is_some() {
            // The robots are the other's now: a setpoint or NMT command from here would stop them.
            self.doubt_configuration();
            self.end_sync()?;
            self.wire.claim(false);
            self.set_phase(SessionState::Idle);
            return Ok(());
        }
        let deadline = self.wire.now().0 + patience_us;
        if !self.paced {
            self.next_sync = Micros(self.next_sync.0.max(self.wire.now().0 + self.lead_us()));
        }
        // One SYNC until the first standing setpoint is reached, one more to be measured.
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
        self.listen(settle)?;
        self.end_sync()?;
        self.set_phase(SessionState::Idle);
        Ok(())
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
