//! What the robot reports about itself: its process data, computed when they are sent or read.

use control::time::Micros;
use protocol::{Code, Limit, MeasuredTwist, MemberStatus, PoseReport, Scale, WheelRateReport};

use super::Application;
use crate::state::State;

/// Indices of the records that are process data.
pub(super) mod record {
    use protocol::address as at;

    pub const GROUP_TWIST: u16 = at::SETPOINT_VX.index;
    pub const ALONE_TWIST: u16 = at::ALONE_VX.index;
    pub const STATUS: u16 = at::STATE.index;
    pub const MEASURED: u16 = at::MEASURED_VX.index;
    pub const POSE: u16 = at::POSE_X.index;
    pub const RATES: u16 = at::RATE_FRONT_LEFT.index;
}

impl Application {
    /// The record of process data at this index, as the bytes of its PDO.
    #[inline(never)]
    pub(super) fn process_data(&self, index: u16) -> Option<[u8; 8]> {
        let report = &self.report;
        Some(match index {
            record::GROUP_TWIST => self.group_twist.bytes,
            record::ALONE_TWIST => self.alone.twist.bytes,
            record::STATUS => self.status().encode(),
            record::MEASURED => MeasuredTwist {
                twist: report.measured(),
                sequence: report.sequence,
                group: self.configuration.as_ref().map_or(0, |known| known.group),
            }
            .encode(),
            record::POSE => PoseReport {
                pose: report.pose(),
            }
            .encode(),
            record::RATES => WheelRateReport {
                rates: report.rates(),
            }
            .encode(),
            _ => return None,
        })
    }

    fn status(&self) -> MemberStatus {
        let report = &self.report;
        // A ready robot is asked by SDO; one that is started has a configuration.
        let is_complete = self.state != State::Ready || self.objection() == 0;
        MemberStatus {
            state: self.state.reported(is_complete),
            sequence: self.setpoints.sequence(),
            scale: self.own.scale,
            slip_residual: (report.configuration != 0).then(|| report.slip_residual()),
            code: self.code(),
            plan: self.own.plan,
        }
    }

    /// Keeps a limit in the history when it becomes active.
    pub(super) fn note_limit(&mut self, at: Micros) {
        let limit = match self.code() {
            Code::Limit(limit) => limit.code(),
            Code::None | Code::Fault(_) => 0,
        };
        if limit != 0 && limit != self.limit {
            let time_ms = u32::try_from(at.0 / 1000).unwrap_or(u32::MAX);
            self.limits.push(limit, time_ms);
        }
        self.limit = limit;
    }

    /// The same where there may be no SYNC.
    #[inline]
    pub fn note_limit_at_rest(&mut self, now: Micros) {
        if self.is_at_rest() {
            self.note_limit(now);
        }
    }

    /// The most important thing to say.
    fn code(&self) -> Code {
        if let Some(fault) = self.state.fault() {
            return Code::Fault(fault);
        }
        if let (State::Ready, Some(obstacle)) = (self.state, self.report.obstacle) {
            return Code::Fault(obstacle);
        }
        let moving = matches!(self.state, State::Moving | State::Alone);
        // What a start waits for, and its votes, are over when the robot is not started any more. A
        // late vote comes before what the motion meets: it is seen in one status only.
        let late = self.is_late.then_some(Limit::LateVote);
        let started = self.waits.or(late).filter(|_| self.state != State::Ready);
        let limit = started.or(self.report.limit).or_else(|| {
            if self.can.passive {
                Some(Limit::BusErrors)
            } else if moving && self.strain.is_limit() {
                Some(Limit::Strain)
            } else if self.setpoints.is_disturbed() {
                Some(Limit::Setpoint)
            } else if moving && self.scale < Scale::ONE {
                Some(if self.scale_is_own {
                    self.own_limit
                } else {
                    Limit::GroupScale
                })
            } else if cfg!(feature = "gyro") && self.report.gyro.state.has_failed() {
                Some(Limit::Gyro)
            } else {
                None
            }
        });
        limit.map_or(Code::None, Code::Limit)
    }
}
