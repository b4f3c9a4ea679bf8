//! Evaluates frames of robots and of other masters.
//!
//! Frames that are not the robots' are no concern of the master; frames that do not decode are left
//! out of the record, and their sender will be missed. On a bus that is only observed, another
//! master's SYNC closes the row and its group twist is taken for the command.

use canopen::{Frame, Micros, NmtCommand, client};
use protocol::{GroupTwist, RobotReport, cob};

use super::Group;
use crate::bus::foreign::Sign;
use crate::bus::link::Link;
use crate::monitor::telemetry::{EventKind, SessionState, reportable};

impl<L: Link> Group<L> {
    /// Takes in a frame.
    pub(crate) fn receive_frame(&mut self, at: Micros, frame: &Frame) {
        let (id, data) = (frame.id(), frame.data());
        self.watch_for_masters(at, frame);
        if let Some((node, state)) = client::parse_heartbeat(frame) {
            let node = node.get();
            if node == protocol::MASTER {
                return;
            }
            match self.members.iter_mut().find(|m| m.node == node) {
                Some(member) => {
                    let before = member.last_heartbeat.replace(at);
                    let changed = member.nmt.replace(state) != Some(state);
                    if changed {
                        self.publish(Some(node), EventKind::Nmt(state));
                    }
                    self.note_restart(node, state, at, before);
                }
                None => {
                    self.strangers.insert(node);
                }
            }
        } else if id == cob::SYNC {
            if !self.wire.is_master() {
                self.on_foreign_sync(at);
            }
        } else if id == cob::GROUP_TWIST {
            if let Ok(setpoint) = GroupTwist::try_from(data)
                && setpoint.group == self.file.group_id
            {
                (self.twist, self.sequence) = (setpoint.twist, setpoint.sequence);
            }
        } else {
            self.take_temperature(id, data);
            self.on_report(at, id, data);
        }
    }

    /// Remembers signs of another master. An adapter may return what this program has sent, so
    /// while it commands only what it cannot have sent counts as displacing it.
    fn watch_for_masters(&mut self, at: Micros, frame: &Frame) {
        let Some(sign) = Sign::of(frame) else { return };
        if sign != Sign::Nmt {
            self.foreign = Some((at, sign));
        }
        if self.phase == SessionState::Idle && matches!(sign, Sign::Sync | Sign::GroupTwist) {
            // It drives, so it has configured the robots.
            self.doubt_configuration();
        }
        if self.phase != SessionState::Running {
            return;
        }
        let displaces = match sign {
            // Its own come every 100 ms, with the same content.
            Sign::Heartbeat => false,
            Sign::Sync => frame.data() != [self.wire.sync_counter()],
            Sign::GroupTwist => GroupTwist::try_from(frame.data()).is_ok_and(|twist| {
                twist.group == self.file.group_id && twist.sequence != self.sequence
            }),
            Sign::Nmt => frame.data() != [NmtCommand::Start as u8, 0],
        };
        if displaces {
            self.displaced = Some(sign);
        }
    }

    /// Another master's SYNC: the row before it is complete.
    fn on_foreign_sync(&mut self, at: Micros) {
        self.close_row();
        let t = self.wire.seconds(at);
        let (sequence, twist) = (self.sequence, self.twist);
        self.recorder.open(t, sequence, twist, self.members.len());
        for member in &mut self.members {
            member.silent_syncs = member.silent_syncs.saturating_add(1);
        }
    }

    fn on_report(&mut self, at: Micros, id: u16, data: &[u8]) {
        let Some((node, report)) = RobotReport::decode(id, data) else {
            return;
        };
        let Some(index) = self.members.iter().position(|member| member.node == node) else {
            return;
        };
        let mut events = [None, None];
        if let RobotReport::Emergency(code) = report {
            events[0] = Some(EventKind::Emergency(code));
        } else if let Some(row) = self.recorder.member(index) {
            match report {
                RobotReport::Status(status) => {
                    let member = &mut self.members[index];
                    let before = member.status.replace(status);
                    if before.map(|b| b.state) != Some(status.state) {
                        events[0] = Some(EventKind::State(status.state));
                    }
                    let was = before.map_or(protocol::Code::None, |b| reportable(b.code));
                    let is = reportable(status.code);
                    if was != is {
                        events[1] = Some(EventKind::Code(is));
                    }
                    member.silent_syncs = 0;
                    (member.status_at, member.last_heartbeat) = (Some(at), Some(at));
                    row.permitted_scale = Some(status.scale.factor());
                    row.slip_residual = status.slip_residual;
                    row.code = Some(status.code.code());
                }
                RobotReport::Measured(measured) => row.measured = Some(measured.twist),
                RobotReport::Pose(report) => {
                    if self.phase == SessionState::Starting {
                        // A robot that takes over its configuration starts again.
                        self.frame.gather();
                    }
                    let placed = self.frame.place(index, at.0 as f64 * 1e-6, report.pose);
                    row.pose = Some(placed.pose);
                    if placed.jumped && self.phase == SessionState::Running {
                        self.jumped = Some(node);
                    }
                }
                RobotReport::WheelRates(report) => row.wheel_rates = Some(report.rates),
                RobotReport::YawRate(report) => row.yaw_rate = report.yaw_rate,
                RobotReport::Emergency(_) => {}
            }
        }
        let from = Some(node);
        for event in events.into_iter().flatten() {
            self.publish(from, event);
        }
    }
}
