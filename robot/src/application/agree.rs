//! SYNC: the next setpoint and the vote on it; the decision when the last vote is in, or at the
//! next SYNC if one never came.
//!
//! The rules themselves are in [`crate::agreement`] and [`crate::interlock`].

use control::configuration::Configuration;
use control::math::sqrt;
use control::time::Micros;
use control::twist::to;
use kinematics::{Twist, desaturate};
use protocol::address::SYNC_PERIOD;
use protocol::{Fault, Limit, MemberStatus, Scale};

use super::Application;
use crate::agreement::{Own, Verdict};
use crate::interlock::is_standstill;
use crate::rhythm::Beat;
use crate::sequence::Reception;
use crate::state::{self, State};

impl Application {
    /// The robot's part of a SYNC, between its setpoint and its status.
    #[inline(never)]
    pub(super) fn agree(&mut self, at: Micros, counter: Option<u8>) {
        self.last_sync = at;
        let period_us = self.parameters.unsigned(SYNC_PERIOD);
        self.clock.on_sync(at, period_us);
        let beat = self.rhythm.on_sync(at, counter, period_us);
        let Some(configuration) = &self.configuration else {
            return;
        };
        let (members, group) = (configuration.members, configuration.group);
        // From now on the votes of this SYNC are missing.
        self.runs_out = self
            .runs_out
            .min(at + Micros(configuration.times.silence_us()));
        if self.is_undecided {
            self.decide(at, members);
        }
        self.agreement.clear();
        let before = self.setpoints.ignored();
        let received = self.group_twist.take();
        let reception = self.setpoints.on_sync(at, beat, received.as_ref(), group);
        let ignored = self.setpoints.ignored().wrapping_sub(before);
        let counter = &mut self.counters.ignored_setpoints;
        *counter = counter.wrapping_add(ignored);
        if reception == Reception::TwoMasters {
            self.transition(state::Event::Failed(Fault::TwoMasters), at);
        }
        if let Some(configuration) = &self.configuration
            && let Some(fault) = self
                .strain
                .on_sync(at, to(self.report.measured), configuration)
            && self.state == State::Moving
        {
            self.transition(state::Event::Failed(fault), at);
        }
        self.vote(beat);
        self.is_undecided = self.agrees();
        if self.is_undecided {
            self.decide_if_complete(at);
        } else {
            self.interlock.disagree();
        }
        self.follow_alone(at, beat);
    }

    /// Whether this robot takes part in the decision on the setpoint that it has latched.
    fn agrees(&self) -> bool {
        let takes_part = match self.state {
            State::Armed => !self.alone.started_so,
            State::Moving => true,
            State::Ready | State::Alone | State::Ramping(_) | State::Faulted(_) => false,
        };
        takes_part && self.setpoints.latched().is_some()
    }

    /// How many votes the decision on the latched setpoint waits for.
    #[inline]
    pub fn votes_missing(&self) -> u32 {
        match &self.configuration {
            Some(configuration) if self.is_undecided => {
                let node = self.identity.node.get();
                self.agreement.missing(configuration.members, node)
            }
            _ => 0,
        }
    }

    /// A member's vote has come in.
    pub(super) fn on_vote(&mut self, at: Micros, node: u8, status: &MemberStatus) {
        if self.is_undecided {
            self.agreement.record(node, status);
            self.decide_if_complete(at);
        }
    }

    /// Decides when all votes are in, and notes how long they have taken.
    fn decide_if_complete(&mut self, at: Micros) {
        let Some(configuration) = &self.configuration else {
            return;
        };
        let (members, delay_us) = (
            configuration.members,
            configuration.times.agreement_delay_us,
        );
        if self.votes_missing() > 0 {
            return;
        }
        let took_us = u32::try_from(at.since(self.last_sync).0).unwrap_or(u32::MAX);
        let counters = &mut self.counters;
        counters.latest_vote_us = counters.latest_vote_us.max(took_us);
        self.is_late = took_us > delay_us;
        counters.late_votes = counters.late_votes.wrapping_add(u32::from(self.is_late));
        self.decide(at, members);
    }

    /// Groups share the bus, its SYNC and its master's heartbeat. A twist for another one is
    /// neither taken nor counted.
    pub(super) fn is_for_this_group(&self, data: &[u8]) -> bool {
        let group = self.configuration.as_ref().map(|known| known.group);
        let addressed = self.group_byte.and_then(|byte| data.get(byte).copied());
        group.is_none() || addressed.is_none() || group == addressed
    }

    /// Rules 2 and 3: what was latched at the last SYNC takes effect, or is a stop.
    fn decide(&mut self, at: Micros, members: u32) {
        self.is_undecided = false;
        let latched = self.setpoints.latched().filter(|_| self.agrees());
        let Some(latched) = latched else {
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
                // Before motion everything else may be over at the next decision.
                if self.state == State::Moving || fault == Fault::PlanMismatch {
                    self.transition(state::Event::Failed(fault), at);
                }
            }
        }
    }

    /// Rule 1: what this robot would do with what it just latched, and the scale at which its own
    /// wheels could follow.
    fn vote(&mut self, beat: Beat) {
        self.own = Own {
            sequence: self.setpoints.sequence(),
            ..Own::NONE
        };
        let armed = self.state == State::Armed;
        let standstill = armed && self.interlock.permits_standstill() && !beat.off_period;
        self.waits = (armed && self.rhythm.is_off()).then_some(Limit::SyncPeriod);
        if self.alone.started_so {
            self.waits = Some(Limit::Alone);
        }
        let Some(latched) = self.setpoints.latched() else {
            return;
        };
        self.own.plan = self.plan.checksum(&latched.encode());
        let permits = match self.state {
            State::Moving => true,
            State::Armed if self.alone.started_so => false,
            State::Armed if is_standstill(latched.twist) => standstill,
            State::Armed => {
                self.waits = self.waits.or(Some(Limit::AwaitingStandstill));
                false
            }
            State::Ready | State::Alone | State::Ramping(_) | State::Faulted(_) => false,
        };
        if let Some(configuration) = self.able_to_move().filter(|_| permits) {
            let (speed, yaw_rate) = (configuration.speed_max, configuration.yaw_rate_max);
            let wheels = permitted(configuration, latched.twist);
            let group = slower(latched.twist, speed, yaw_rate).map_or(Scale::ONE, Scale::new);
            (self.own.scale, self.own_limit) = match group < wheels {
                true => (group, Limit::GroupSpeed),
                false => (wheels, Limit::WheelRate),
            };
        }
    }
}

/// The factor at which a twist is no faster than these, m/s and rad/s; `None` where it is not
/// anyway, which needs neither a root nor a division.
pub(super) fn slower(twist: Twist, speed: f32, yaw_rate: f32) -> Option<f32> {
    let squared = twist.vx * twist.vx + twist.vy * twist.vy;
    if squared <= speed * speed && twist.omega.abs() <= yaw_rate {
        return None;
    }
    let over = (sqrt(squared) / speed).max(twist.omega.abs() / yaw_rate);
    Some(1.0 / over)
}

/// The scale at which this robot's wheels can make the group move like that.
pub(super) fn permitted(configuration: &Configuration, twist: Twist) -> Scale {
    let drivetrain = &configuration.drivetrain;
    let scale = |twist| desaturate(drivetrain.fastest(twist), configuration.wheel_rate_max).1;
    let first = scale(twist);
    if drivetrain.is_constant() || first >= 1.0 {
        return Scale::new(first);
    }
    // At the smaller speed the compensation asks for a little more or less.
    Scale::new(first * scale(twist * first))
}
