//! What the robot reports about itself, at every SYNC and to everybody who reads it.

use control::time::Micros;
use protocol::{Code, Limit, MeasuredTwist, MemberStatus, PoseReport, Scale, WheelRateReport};

use super::BusSide;
use crate::state::State;

impl BusSide {
    /// Brings the process data up to date.
    pub(super) fn publish(&mut self, at: Micros) {
        self.dictionary.uptime_ms = u32::try_from(at.0 / 1000).unwrap_or(u32::MAX);
        let code = self.code();
        self.remember(at, code);
        let report = &self.report;
        let sequence = self.setpoints.sequence();
        let configuration = self.configuration.as_ref();
        let group = configuration.map_or(0, |configuration| configuration.group);
        self.dictionary.status = MemberStatus {
            state: self.state.reported(configuration.is_some()),
            sequence,
            scale: self.own.scale,
            slip_residual: (report.configuration != 0).then_some(report.slip_residual),
            code,
            plan: self.own.plan,
        }
        .encode();
        self.dictionary.measured = MeasuredTwist {
            twist: report.measured,
            sequence: report.sequence,
            group,
        }
        .encode();
        self.dictionary.pose = PoseReport { pose: report.pose }.encode();
        self.dictionary.rates = WheelRateReport {
            rates: report.rates,
        }
        .encode();
    }

    /// Keeps a limit in the history when it becomes active.
    fn remember(&mut self, at: Micros, code: Code) {
        let limit = match code {
            Code::Limit(limit) => limit.code(),
            Code::None | Code::Fault(_) => 0,
        };
        if limit != 0 && limit != self.limit {
            let time_ms = u32::try_from(at.0 / 1000).unwrap_or(u32::MAX);
            self.dictionary.limits.push(limit, time_ms);
        }
        self.limit = limit;
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
        let limit = self.waits.or(self.report.limit).or_else(|| {
            if self.dictionary.can.passive {
                Some(Limit::BusErrors)
            } else if moving && self.strain.is_limit() {
                Some(Limit::Strain)
            } else if self.setpoints.is_disturbed() {
                Some(Limit::Setpoint)
            } else if moving && self.scale < Scale::ONE {
                Some(if self.scale_is_own {
                    Limit::WheelRate
                } else {
                    Limit::GroupScale
                })
            } else {
                None
            }
        });
        limit.map_or(Code::None, Code::Limit)
    }
}
