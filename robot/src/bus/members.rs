//! What a robot hears from the master and the other members, and what it decides with them.
//!
//! The rules themselves are in [`crate::agreement`] and [`crate::interlock`]; here they meet the
//! frames.

use canopen::{Frame, NmtState};
use control::time::Micros;
use kinematics::{Twist, desaturate};
use protocol::{Fault, Limit, MeasuredTwist, MemberStatus, Plan, Scale, cob};

use super::BusSide;
use crate::agreement::{Agreement, Own, Verdict};
use crate::interlock::is_standstill;
use crate::rhythm::Beat;
use crate::state::{self, State};
use control::configuration::Configuration;

/// What of an object is part of a plan.
#[derive(Clone, Copy)]
enum Part {
    /// Its value, the same in all members.
    Same,
    /// An identifier of the robot's own: its value less the node number.
    OwnIdentifier,
    /// The number of a PDO's entries, and then these.
    Map,
}

/// The communication objects that are part of a plan: SYNC, emergency message, and the PDOs that
/// carry group twist, status and measured twist. Every other PDO is a member's own matter.
static PARTS: [(u16, u8, Part); 20] = [
    (0x1005, 0, Part::Same),
    (0x1006, 0, Part::Same),
    (0x1007, 0, Part::Same),
    (0x1014, 0, Part::OwnIdentifier),
    (0x1400, 1, Part::Same),
    (0x1400, 2, Part::Same),
    (0x1400, 5, Part::Same),
    (0x1600, 0, Part::Map),
    (0x1800, 1, Part::OwnIdentifier),
    (0x1800, 2, Part::Same),
    (0x1800, 3, Part::Same),
    (0x1800, 5, Part::Same),
    (0x1800, 6, Part::Same),
    (0x1A00, 0, Part::Map),
    (0x1801, 1, Part::OwnIdentifier),
    (0x1801, 2, Part::Same),
    (0x1801, 3, Part::Same),
    (0x1801, 5, Part::Same),
    (0x1801, 6, Part::Same),
    (0x1A01, 0, Part::Map),
];

/// Most words that they have: eight entries a map.
const WORDS: usize = PARTS.len() + 3 * canopen::MAX_MAPPED;

impl BusSide {
    /// The master's heartbeat. Only one that says OPERATIONAL is a sign of life; one that says
    /// boot-up means that the master has been restarted and does not know what it was doing.
    pub(super) fn on_master_heartbeat(&mut self, at: Micros, data: &[u8]) {
        match data {
            [state] if *state == NmtState::Operational.code() => self.last_heartbeat = at,
            [state] if *state == NmtState::Initialising.code() => {
                self.dictionary.alone_for_now = false;
                self.transition(state::Event::Failed(Fault::MasterSilent), at);
            }
            _ => {}
        }
    }

    /// A frame while OPERATIONAL that may be another member's, or a setpoint.
    pub(super) fn on_member_frame(&mut self, at: Micros, frame: &Frame) {
        let (id, data) = (frame.id(), frame.data());
        if id == cob::GROUP_TWIST {
            self.setpoints.count_frame();
        } else if let Some(node) = cob::status_sender(id) {
            if let Ok(status) = MemberStatus::try_from(data) {
                self.agreement.record(node, &status);
            }
        } else if let Some(node) = cob::measured_sender(id) {
            if let Ok(measured) = MeasuredTwist::try_from(data) {
                self.strain.record(node, measured.twist);
            }
        } else if let Some(node) = cob::emergency_sender(id)
            && let [low, high, _, _, _, _, _, _] = data
            && let Some(fault) = Fault::from_code(u16::from_le_bytes([*low, *high]))
        {
            self.on_member_fault(at, node, fault);
        }
    }

    /// Another robot has announced a fault. One of a member stops the group at once: its vote would
    /// say the same, up to two SYNCs later.
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

    /// Whether every other member has voted since the last SYNC.
    pub(super) fn has_all_votes(&self, configuration: &Configuration) -> bool {
        let node = self.identity.node.get();
        self.agreement.is_complete(configuration.members, node)
    }

    /// What is part of every checksum from this start on: group parameters, and what the frames of
    /// the group are and carry.
    #[inline(never)]
    pub(super) fn make_plan(&self) -> Plan {
        let node = u32::from(self.identity.node.get());
        let mut words = heapless::Vec::<u32, WORDS>::new();
        for (index, sub, part) in PARTS.iter().copied() {
            let word = self.object(index, sub);
            let _ = words.push(match part {
                Part::OwnIdentifier => word.wrapping_sub(node),
                Part::Same | Part::Map => word,
            });
            let mapped = match part {
                Part::Map => word.to_le_bytes()[0],
                Part::Same | Part::OwnIdentifier => 0,
            };
            for sub in 1..=mapped {
                let _ = words.push(self.object(index, sub));
            }
        }
        Plan::new(self.dictionary.parameters.group_crc(), words.into_iter())
    }

    /// Which byte of a frame with the group twist is the group, by the mapping of RPDO1 (0x1600).
    pub(super) fn group_byte(&self) -> Option<usize> {
        const GROUP: u32 = 0x2100_0508;
        let mut bits = 0;
        let [mapped, ..] = self.object(0x1600, 0).to_le_bytes();
        for sub in 1..=mapped {
            let entry = self.object(0x1600, sub);
            if entry == GROUP && bits % 8 == 0 {
                return Some(bits / 8);
            }
            bits += (entry & 0xFF) as usize;
        }
        None
    }

    /// An object of the device, as a number; 0 for none.
    #[inline(never)]
    fn object(&self, index: u16, sub: u8) -> u32 {
        let mut bytes = [0; 4];
        let read = self.device.read(index, sub, &mut bytes, &self.dictionary);
        read.map_or(0, |_| u32::from_le_bytes(bytes))
    }

    /// Rule 2: what was latched at the last SYNC takes effect at this one, or is a stop.
    pub(super) fn decide(&mut self, at: Micros, members: u32) {
        let latched = match self.state {
            State::Armed if self.alone_for_now => None,
            State::Armed | State::Moving => self.setpoints.latched(),
            State::Ready | State::Alone | State::Ramping(_) | State::Faulted(_) => None,
        };
        let Some(latched) = latched else {
            self.agreement = Agreement::new();
            self.interlock.disagree();
            return;
        };
        let node = self.identity.node.get();
        match self.agreement.decide(members, node, self.own) {
            Verdict::Go { scale, own } => {
                if self.state == State::Armed {
                    if !self.interlock.agree() {
                        return;
                    }
                    self.setpoints.touch(at);
                }
                self.scale = scale;
                self.scale_is_own = own;
                self.transition(state::Event::GroupSetpoint, at);
                self.aim(at, latched.twist * scale.factor(), latched.sequence);
            }
            Verdict::Stop(fault) => {
                self.interlock.disagree();
                // Before motion everything else may be over at the next SYNC.
                if self.state == State::Moving || fault == Fault::PlanMismatch {
                    self.transition(state::Event::Failed(fault), at);
                }
            }
        }
    }

    /// Rule 1: what this robot would do with what it just latched, and the scale at which its own
    /// wheels could follow.
    pub(super) fn vote(&mut self, beat: Beat) {
        self.own = Own {
            sequence: self.setpoints.sequence(),
            ..Own::NONE
        };
        let armed = self.state == State::Armed;
        let standstill = armed && self.interlock.permits_standstill() && !beat.off_period;
        self.waits = (armed && self.rhythm.is_off()).then_some(Limit::SyncPeriod);
        if self.alone_for_now {
            self.waits = Some(Limit::Alone);
        }
        let Some(latched) = self.setpoints.latched() else {
            return;
        };
        self.own.plan = self.plan.checksum(&latched.encode());
        let permits = match self.state {
            State::Moving => true,
            State::Armed if self.alone_for_now => false,
            State::Armed if is_standstill(latched.twist) => standstill,
            State::Armed => {
                self.waits = self.waits.or(Some(Limit::AwaitingStandstill));
                false
            }
            State::Ready | State::Alone | State::Ramping(_) | State::Faulted(_) => false,
        };
        if let Some(configuration) = self.able().filter(|_| permits) {
            self.own.scale = permitted(configuration, latched.twist);
        }
    }
}

/// The scale at which this robot's wheels can make the group move like that.
pub(super) fn permitted(configuration: &Configuration, twist: Twist) -> Scale {
    let drivetrain = &configuration.drivetrain;
    let scale = |twist| desaturate(drivetrain.fastest(twist), configuration.wheel_rate_max).1;
    let first = scale(twist);
    if drivetrain.is_constant() {
        return Scale::new(first);
    }
    // At the smaller speed the compensation asks for a little more or less.
    Scale::new(first * scale(twist * first))
}
