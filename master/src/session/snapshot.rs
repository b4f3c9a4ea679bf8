//! The row of a SYNC and what is known besides, put together for those who watch.

use std::sync::Arc;

use kinematics::{Pose, Twist};
use protocol::Code;

use super::Group;
use crate::link::Link;
use crate::record::MemberRow;
use crate::telemetry::{Interest, MemberSample, Snapshot, Telemetry};

impl<L: Link> Group<L> {
    /// Publishes the row that has just been completed, if anybody wants it.
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
        let t = self.wire.seconds(self.wire.now());
        let blank = MemberRow::default();
        let snapshot = Snapshot {
            t,
            phase: self.phase,
            bus_load: self.wire.bus_load(),
            sync: self.punctuality(),
            members: (0..self.members.len())
                .map(|index| self.sample(index, &blank))
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
        let measured: Vec<Twist> = row.members.iter().filter_map(|m| m.measured).collect();
        Some(Snapshot {
            t: row.t,
            phase: self.phase,
            sequence: row.sequence,
            command: row.command,
            target: self.target,
            pose: mean_pose(&row.members),
            measured: mean_twist(&measured),
            scale: row
                .members
                .iter()
                .filter_map(|m| m.permitted_scale)
                .reduce(f32::min),
            strain: largest_difference(&measured),
            bus_load: self.wire.bus_load(),
            sync: self.punctuality(),
            members: row
                .members
                .iter()
                .enumerate()
                .map(|(index, row)| self.sample(index, row))
                .collect(),
        })
    }

    fn sample(&self, index: usize, row: &MemberRow) -> MemberSample {
        let member = &self.members[index];
        MemberSample {
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
        }
    }
}

/// The mean of the poses reported; `None` when there are none. Headings are averaged about the first one's,
/// so that +-pi does no harm.
pub(crate) fn mean_pose(members: &[MemberRow]) -> Option<Pose> {
    let poses: Vec<Pose> = members.iter().filter_map(|member| member.pose).collect();
    let first = poses.first()?;
    let count = poses.len() as f32;
    let turn = |heading: f32| {
        let (sin, cos) = (heading - first.heading).sin_cos();
        sin.atan2(cos)
    };
    Some(Pose {
        x: poses.iter().map(|pose| pose.x).sum::<f32>() / count,
        y: poses.iter().map(|pose| pose.y).sum::<f32>() / count,
        heading: first.heading + poses.iter().map(|p| turn(p.heading)).sum::<f32>() / count,
    })
}

fn mean_twist(twists: &[Twist]) -> Option<Twist> {
    let count = twists.len() as f32;
    let sum = twists
        .iter()
        .copied()
        .reduce(|a, b| Twist::new(a.vx + b.vx, a.vy + b.vy, a.omega + b.omega))?;
    Some(Twist::new(
        sum.vx / count,
        sum.vy / count,
        sum.omega / count,
    ))
}

/// Largest difference of two measured velocities at the group's origin, in m/s; `None` for fewer than two.
fn largest_difference(twists: &[Twist]) -> Option<f32> {
    let pairs = twists
        .iter()
        .enumerate()
        .flat_map(|(n, a)| twists[n + 1..].iter().map(move |b| (a, b)));
    pairs
        .map(|(a, b)| (a.vx - b.vx).hypot(a.vy - b.vy))
        .reduce(f32::max)
}
