//! The row of a SYNC and what is known besides, put together for those who watch.

use std::sync::Arc;

use canopen::Micros;
use protocol::Code;

use super::Group;
use crate::bus::link::Link;
use crate::monitor::average::{mean_pose, mean_twist, strain};
use crate::monitor::rows::MemberRow;
use crate::monitor::telemetry::{Interest, MemberSample, Snapshot, Telemetry};

impl<L: Link> Group<L> {
    /// Publishes the row that has just been completed, if it has a subscriber.
    pub(super) fn close_row(&mut self) {
        if self.wire.hub.0.is_wanted(Interest::Group)
            && let Some(snapshot) = self.snapshot()
        {
            self.wire
                .hub
                .0
                .publish(&Telemetry::Snapshot(Arc::new(snapshot)));
        }
    }

    /// The group as it is known, without a SYNC: NMT states of a group that is not running.
    pub fn publish_idle(&mut self) {
        let now = self.wire.now();
        let t = self.wire.seconds(now);
        let blank = MemberRow::default();
        let snapshot = Snapshot {
            t,
            phase: self.phase,
            foreign_master: self.foreign_master(),
            bus_load: self.wire.bus_load(),
            sync: self.punctuality(),
            members: (0..self.members.len())
                .map(|index| self.sample(now, index, &blank))
                .collect(),
            ..Snapshot::default()
        };
        self.wire
            .hub
            .0
            .publish(&Telemetry::Snapshot(Arc::new(snapshot)));
    }

    fn snapshot(&self) -> Option<Snapshot> {
        let row = self.recorder.rows().last()?;
        let measured = row.members.iter().filter_map(|m| m.measured);
        let now = self.wire.now();
        Some(Snapshot {
            t: self.wire.seconds(self.began) + row.t,
            phase: self.phase,
            foreign_master: self.foreign_master(),
            sequence: row.sequence,
            command: row.command,
            target: self.target,
            curve: self.curve,
            pose: mean_pose(row.members.iter().filter_map(|m| m.pose)),
            measured: mean_twist(measured.clone()),
            scale: row
                .members
                .iter()
                .filter_map(|m| m.permitted_scale)
                .reduce(f32::min),
            strain: strain(measured),
            bus_load: self.wire.bus_load(),
            sync: self.punctuality(),
            members: row
                .members
                .iter()
                .enumerate()
                .map(|(index, row)| self.sample(now, index, row))
                .collect(),
        })
    }

    fn sample(&self, now: Micros, index: usize, row: &MemberRow) -> MemberSample {
        let member = &self.members[index];
        let age = |at: Option<Micros>| at.map(|at| now.0.saturating_sub(at.0) as f64 * 1e-6);
        let sample = MemberSample {
            node: member.node,
            nmt: member.nmt,
            state: member.status.map(|status| status.state),
            code: member.status.map_or(Code::None, |status| status.code),
            silent_syncs: member.silent_syncs,
            permitted_scale: row.permitted_scale,
            slip_residual: row.slip_residual,
            measured: row.measured,
            pose: row.pose,
            wheel_rates: row.wheel_rates,
            yaw_rate: row.yaw_rate,
            motor_temperature: member.temperature,
            past: None,
        };
        sample.aged(age(member.status_at), age(member.last_heartbeat))
    }
}
