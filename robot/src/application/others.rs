//! What a robot receives from the master and from other robots.

use canopen::{Frame, NmtState};
use control::time::Micros;
use protocol::cob::{self, Sent};
use protocol::timing::HEARTBEAT_MS;
use protocol::{Fault, MeasuredTwist, MemberStatus};

use super::Application;
use crate::state::{self, State};

/// How long a second robot with the same node counts as there after it was last heard, us: ten
/// heartbeats.
const DOUBLE_US: u64 = HEARTBEAT_MS as u64 * 10_000;

impl Application {
    /// The master's heartbeat. Only one that says OPERATIONAL is a sign of life; one that says
    /// boot-up means that the master has been restarted and does not know what it was doing.
    pub(super) fn on_master_heartbeat(&mut self, at: Micros, master: NmtState) {
        match master {
            NmtState::Operational => self.last_heartbeat = at,
            NmtState::Initialising => {
                self.alone.for_now = false;
                self.transition(state::Event::Failed(Fault::MasterSilent), at);
            }
            NmtState::PreOperational | NmtState::Stopped => {}
        }
    }

    /// A frame that another robot sends.
    pub(super) fn on_robot_frame(&mut self, at: Micros, frame: &Frame, is_operational: bool) {
        let Some((sent, node)) = cob::sent(frame.id()) else {
            return;
        };
        if node == self.identity.node.get() {
            return self.on_double(at);
        }
        if !is_operational {
            return;
        }
        match sent {
            Sent::Status => {
                if let Ok(status) = MemberStatus::try_from(frame.data()) {
                    self.on_vote(at, node, &status);
                }
            }
            Sent::Measured => {
                if let Ok(measured) = MeasuredTwist::try_from(frame.data()) {
                    self.strain.record(node, measured.twist);
                }
            }
            Sent::Emergency => {
                if let [low, high, _, _, _, _, _, _] = frame.data()
                    && let Some(fault) = Fault::from_code(u16::from_le_bytes([*low, *high]))
                {
                    self.on_member_fault(at, node, fault);
                }
            }
            Sent::Pose | Sent::WheelRates | Sent::YawRate | Sent::SdoResponse | Sent::Heartbeat => {
            }
        }
    }

    /// A frame with an identifier that only this robot uses: there is another one with its node
    /// number. Two of them are one node for all others, and both follow the group with one
    /// vote.
    #[inline(never)]
    pub(super) fn on_double(&mut self, at: Micros) {
        let known = at < self.doubled_until;
        self.doubled_until = at + Micros(DOUBLE_US);
        if !known {
            self.on_fault(at, Fault::DuplicateNode);
        }
    }

    /// Another robot has announced a fault. One of a member stops the group at once: its vote would
    /// say the same, up to a SYNC period later.
    fn on_member_fault(&mut self, at: Micros, node: u8, fault: Fault) {
        let Some(configuration) = &self.configuration else {
            return;
        };
        if !configuration.is_member(node) {
            return;
        }
        if fault == Fault::EmergencyStop && configuration.cuts_together {
            self.transition(state::Event::Cut(Fault::MemberStopped), at);
        } else if self.state == State::Moving {
            self.transition(state::Event::Failed(Fault::MemberStopped), at);
        }
    }
}
