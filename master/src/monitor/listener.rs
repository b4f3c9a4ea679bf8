//! The group as any node on the bus can observe it: frames in, one [`Snapshot`] per SYNC out.
//!
//! A [`Listener`] sends nothing. It receives every frame, the master's own included, and so says
//! the same about a group that this program drives, that another program drives, or that drove last
//! week and was recorded. What it knows about a SYNC period is complete when the next SYNC comes;
//! [`Listener::push`] returns it then. It holds one entry per robot and the frames of the last 100
//! ms, and cannot fail: what does not decode is left out.
//!
//! The target is where the setpoints alone would have brought the group since it last stood: the
//! sum of group twist times group scale. The way of a setpoint through the robots takes a SYNC
//! period and the time in which they agree, so while the group moves the target is ahead by that.

use std::collections::BTreeMap;

use canopen::{Frame, NmtState, client};
use kinematics::{Pose, Twist};
use protocol::{GroupTwist, MemberStatus, RobotReport, cob, is_robot};

use crate::bus::load::Meter;
use crate::monitor::average::{mean_pose, mean_twist, strain};
use crate::monitor::common_frame::CommonFrame;
use crate::monitor::telemetry::{
    Event, EventKind, MemberSample, SessionState, Snapshot, reportable,
};

/// Without a SYNC for this long, in s, no setpoint is in force.
const SYNC_PATIENCE: f64 = 0.5;
/// Slower than this the group stands, in m/s and rad/s: ten steps of the measured twist.
const STANDING: f32 = 1e-3;

/// Listens to a group.
#[derive(Clone, Debug)]
pub struct Listener {
    /// Whether robots that are not named beforehand are taken in.
    open: bool,
    now: f64,
    synced: bool,
    current: Snapshot,
    /// The newest group twist, not yet latched by a SYNC.
    pending: Option<GroupTwist>,
    commanded: bool,
    reckoning: Reckoning,
    load: Meter,
    /// One frame for the poses that robots report.
    frame: CommonFrame,
    events: Vec<Event>,
    /// When each member's last status came, and when it was last heard at all.
    last_frames: BTreeMap<u8, (Option<f64>, f64)>,
}

fn member(node: u8) -> MemberSample {
    MemberSample {
        node,
        ..MemberSample::default()
    }
}

impl Listener {
    /// Listens to these robots only; to every robot that is heard when there are none.
    #[must_use]
    pub fn new(nodes: impl IntoIterator<Item = u8>) -> Self {
        let members: Vec<_> = nodes.into_iter().map(member).collect();
        Self {
            open: members.is_empty(),
            now: 0.0,
            synced: false,
            current: Snapshot {
                members,
                ..Snapshot::default()
            },
            pending: None,
            commanded: false,
            reckoning: Reckoning::default(),
            load: Meter::default(),
            frame: CommonFrame::default(),
            events: Vec::new(),
            last_frames: BTreeMap::new(),
        }
    }

    /// Takes in a frame that was complete on the bus at `t`, in s. A SYNC completes the period
    /// before it, which is returned.
    pub fn push(&mut self, t: f64, frame: &Frame) -> Option<Snapshot> {
        self.now = t;
        self.load.record(t, frame);
        let (id, data) = (frame.id(), frame.data());
        if id == cob::SYNC {
            return self.close(t);
        }
        if id == cob::GROUP_TWIST {
            self.pending = GroupTwist::try_from(data).ok().or(self.pending);
        } else if let Some((node, state)) = client::parse_heartbeat(frame) {
            self.nmt(t, node.get(), state);
        } else {
            self.report(t, id, data);
        }
        None
    }

    /// The group as it is known at `t`: of the SYNC period that is not over yet, or of none.
    #[must_use]
    pub fn now(&self, t: f64) -> Snapshot {
        let mut snapshot = self.finished(t);
        if !self.synced || t - self.current.t > SYNC_PATIENCE {
            snapshot.t = t;
            snapshot.phase = SessionState::Idle;
            snapshot.command = Twist::ZERO;
            snapshot.target = None;
        }
        snapshot.bus_load = Some(self.load.share(t));
        snapshot
    }

    /// What happened since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    fn emit(&mut self, t: f64, node: u8, what: EventKind) {
        self.events.push(Event {
            t,
            node: Some(node),
            what,
        });
    }

    fn place(&mut self, node: u8) -> Option<usize> {
        let members = &mut self.current.members;
        let found = members.iter().position(|member| member.node == node);
        if found.is_some() || !self.open || !is_robot(node) {
            return found;
        }
        let at = members.partition_point(|member| member.node < node);
        members.insert(at, member(node));
        Some(at)
    }

    fn nmt(&mut self, t: f64, node: u8, state: NmtState) {
        let Some(at) = self.place(node) else {
            return;
        };
        self.last_frames.entry(node).or_insert((None, t)).1 = t;
        let member = &mut self.current.members[at];
        if member.nmt.replace(state) == Some(state) {
            return;
        }
        if state != NmtState::Operational {
            // A robot that left does not say so in a status: it sends none any more.
            member.state = None;
        }
        self.emit(t, node, EventKind::Nmt(state));
    }

    /// Process data or an emergency message of a robot.
    fn report(&mut self, t: f64, id: u16, data: &[u8]) {
        let Some((node, report)) = RobotReport::decode(id, data) else {
            return;
        };
        let Some(at) = self.place(node) else {
            return;
        };
        let member = &mut self.current.members[at];
        match report {
            RobotReport::Status(status) => self.status(t, at, &status),
            RobotReport::Measured(measured) => member.measured = Some(measured.twist),
            RobotReport::Pose(report) => {
                member.pose = Some(self.frame.place(usize::from(node), t, report.pose).pose);
            }
            RobotReport::WheelRates(report) => member.wheel_rates = Some(report.rates),
            RobotReport::YawRate(report) => member.yaw_rate = report.yaw_rate,
            RobotReport::Emergency(code) => self.emit(t, node, EventKind::Emergency(code)),
        }
    }

    fn status(&mut self, t: f64, at: usize, status: &MemberStatus) {
        let member = &mut self.current.members[at];
        let node = member.node;
        self.last_frames.insert(node, (Some(t), t));
        member.silent_syncs = 0;
        // A status is only sent in OPERATIONAL; the last heartbeat may be older.
        member.nmt = Some(NmtState::Operational);
        member.permitted_scale = Some(status.scale.factor());
        member.slip_residual = status.slip_residual;
        let state = member.state.replace(status.state);
        let code = std::mem::replace(&mut member.code, status.code);
        if state != Some(status.state) {
            self.emit(t, node, EventKind::State(status.state));
        }
        let (was, is) = (reportable(code), reportable(status.code));
        if was != is {
            self.emit(t, node, EventKind::Code(is));
        }
    }

    /// The period that is open, with what follows from its members.
    fn finished(&self, t: f64) -> Snapshot {
        let mut snapshot = self.current.clone();
        for member in &mut snapshot.members {
            if let Some((status, last_frames)) = self.last_frames.get(&member.node) {
                *member = member.aged(status.map(|at| t - at), Some(t - last_frames));
            }
        }
        let members = &snapshot.members;
        snapshot.pose = mean_pose(members.iter().filter_map(|member| member.pose));
        snapshot.measured = mean_twist(members.iter().filter_map(|member| member.measured));
        snapshot.scale = members
            .iter()
            .filter_map(|member| member.permitted_scale)
            .reduce(f32::min);
        snapshot.strain = strain(members.iter().filter_map(|member| member.measured));
        snapshot.target = self.reckoning.target;
        snapshot.phase = match (self.commanded, members.iter().all(can_follow)) {
            (false, _) => SessionState::Idle,
            (true, false) => SessionState::Starting,
            (true, true) => SessionState::Running,
        };
        snapshot
    }

    /// Ends the period at the SYNC at `t` and opens the next.
    fn close(&mut self, t: f64) -> Option<Snapshot> {
        let mut snapshot = self.finished(t);
        snapshot.bus_load = Some(self.load.share(t));
        snapshot.target = self.reckoning.advance(&snapshot);
        self.current.t = t;
        self.commanded = self.pending.is_some();
        if let Some(setpoint) = self.pending.take() {
            self.current.sequence = setpoint.sequence;
            self.current.command = setpoint.twist;
        } else {
            self.current.command = Twist::ZERO;
        }
        for member in &mut self.current.members {
            *member = MemberSample {
                silent_syncs: member.silent_syncs.saturating_add(1),
                permitted_scale: None,
                slip_residual: None,
                measured: None,
                pose: None,
                wheel_rates: None,
                yaw_rate: None,
                ..*member
            };
        }
        std::mem::replace(&mut self.synced, true).then_some(snapshot)
    }
}

/// Adds up setpoints to where they alone would have brought the group since it last stood.
#[derive(Clone, Debug, Default)]
pub struct Reckoning {
    before: Option<Snapshot>,
    target: Option<Pose>,
}

impl Reckoning {
    /// Takes the group at the next SYNC and says where the setpoints before it would have brought
    /// it.
    #[expect(clippy::cast_possible_truncation, reason = "a period of SYNC in s")]
    pub fn advance(&mut self, now: &Snapshot) -> Option<Pose> {
        let stands =
            |twist: Twist| twist.vx.hypot(twist.vy) < STANDING && twist.omega.abs() < STANDING;
        let resting = stands(now.command) && now.measured.is_none_or(stands);
        let before = self.before.replace(now.clone());
        let dt = before
            .as_ref()
            .map_or(f64::INFINITY, |before| now.t - before.t);
        self.target = match (before, self.target) {
            _ if now.phase == SessionState::Idle => None,
            (Some(before), Some(mut target)) if !resting && (0.0..SYNC_PATIENCE).contains(&dt) => {
                let step = dt as f32 * before.scale.unwrap_or(1.0);
                let half = target.heading + before.command.omega * step / 2.0;
                let moved = before.command.to_world(half);
                target.x += moved.vx * step;
                target.y += moved.vy * step;
                target.heading += moved.omega * step;
                Some(target)
            }
            (_, target) => now.pose.or(target),
        };
        self.target
    }
}

fn can_follow(member: &MemberSample) -> bool {
    member.state.is_some_and(protocol::MemberState::can_follow)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{Code, MeasuredTwist, MemberState, PoseReport, Scale};

    /// One step of a measured twist or pose on the wire: 0.1 mm/s, 0.1 mm.
    const LSB: f32 = 1e-4;

    fn twist(vx: f32, sequence: u8) -> Frame {
        let setpoint = GroupTwist {
            twist: Twist::new(vx, 0.0, 0.0),
            sequence,
            group: 1,
        };
        Frame::of(cob::GROUP_TWIST, setpoint.encode())
    }

    fn status(node: u8, scale: f32, code: Code) -> Frame {
        let status = MemberStatus {
            state: MemberState::Moving,
            sequence: 1,
            scale: Scale::new(scale),
            slip_residual: Some(0.5),
            code,
            plan: 0,
        };
        Frame::of(cob::member_status(node), status.encode())
    }

    fn measured(node: u8, vx: f32, vy: f32) -> Frame {
        let measured = MeasuredTwist {
            twist: Twist::new(vx, vy, 0.0),
            sequence: 1,
            group: 1,
        };
        Frame::of(cob::measured_twist(node), measured.encode())
    }

    fn pose(node: u8, x: f32, heading: f32) -> Frame {
        let report = PoseReport {
            pose: Pose::new(x, 0.0, heading),
        };
        Frame::of(cob::pose(node), report.encode())
    }

    fn sync() -> Frame {
        client::sync(Some(1))
    }

    #[test]
    fn a_period_is_told_when_the_next_sync_comes() {
        let mut listener = Listener::new([2, 3]);
        assert_eq!(listener.push(1.0, &twist(0.2, 7)), None);
        assert_eq!(listener.push(1.002, &sync()), None);
        for frame in [
            status(2, 0.5, Code::None),
            status(3, 0.25, Code::None),
            measured(2, 0.1, 0.0),
            measured(3, 0.1, 0.03),
            pose(2, 1.5, 3.1),
            pose(3, 1.5, 3.1),
            pose(2, 1.45, 3.1),
            pose(3, 1.55, -3.1),
        ] {
            assert_eq!(listener.push(1.005, &frame), None);
        }
        let snapshot = listener.push(1.012, &sync()).unwrap();
        assert_eq!(
            (snapshot.t, snapshot.sequence, snapshot.phase),
            (1.002, 7, SessionState::Running)
        );
        assert_eq!(snapshot.command, Twist::new(0.2, 0.0, 0.0));
        // The smallest; 0.25 is rounded to a step of 1/65535.
        assert!((snapshot.scale.unwrap() - 0.25).abs() < 1.0 / 65535.0);
        assert!((snapshot.strain.unwrap() - 0.03).abs() < LSB);
        let mean = snapshot.pose.unwrap();
        assert!((mean.x - 1.5).abs() < LSB);
        // Half way between 3.1 and -3.1 is pi, not 0.
        assert!(
            (mean.heading - std::f32::consts::PI).abs() < LSB,
            "{mean:?}"
        );
        // No robot sent anything in the next period.
        let empty = listener.push(1.022, &sync()).unwrap();
        assert_eq!((empty.pose, empty.scale, empty.strain), (None, None, None));
        assert_eq!(empty.members[0].silent_syncs, 1);
        assert_eq!(empty.members[0].state, Some(MemberState::Moving));
    }

    #[test]
    fn the_target_is_the_sum_of_setpoints_times_scale() {
        let mut listener = Listener::new([2]);
        let mut t = 0.0;
        let mut cycle = |vx: f32, scale: f32, moved: f32| {
            listener.push(t, &twist(vx, 1));
            let snapshot = listener.push(t, &sync());
            for frame in [
                status(2, scale, Code::None),
                measured(2, moved, 0.0),
                pose(2, 1.0, 0.0),
            ] {
                listener.push(t + 0.002, &frame);
            }
            t += 0.01;
            snapshot
        };
        for _ in 0..3 {
            cycle(0.0, 1.0, 0.0);
        }
        for _ in 0..10 {
            cycle(0.4, 0.5, 0.2);
        }
        cycle(0.0, 1.0, 0.2);
        let snapshot = cycle(0.0, 1.0, 0.0).unwrap();
        // Ten periods of 10 ms at 0.4 m/s times 0.5, from where the group stood.
        assert!(
            (snapshot.target.unwrap().x - 1.02).abs() < LSB,
            "{snapshot:?}"
        );
        cycle(0.0, 1.0, 0.0);
        let snapshot = cycle(0.0, 1.0, 0.0).unwrap();
        assert!(
            (snapshot.target.unwrap().x - 1.0).abs() < LSB,
            "{snapshot:?}"
        );
    }

    #[test]
    fn changes_are_events_once() {
        let mut listener = Listener::new([2]);
        let fault = Code::Fault(protocol::Fault::EncoderDead);
        listener.push(0.0, &Frame::of(0x702, [5]));
        listener.push(0.1, &Frame::of(0x702, [5]));
        listener.push(0.2, &status(2, 1.0, fault));
        listener.push(0.3, &status(2, 1.0, fault));
        listener.push(0.4, &Frame::of(0x082, [0x0B, 0xFF, 0, 0, 0, 0, 0, 0]));
        listener.push(0.5, &Frame::of(0x083, [0x0B, 0xFF, 0, 0, 0, 0, 0, 0]));
        let what: Vec<_> = listener.take_events().into_iter().map(|e| e.what).collect();
        assert_eq!(
            what,
            [
                EventKind::Nmt(NmtState::Operational),
                EventKind::State(MemberState::Moving),
                EventKind::Code(fault),
                EventKind::Emergency(0xFF0B),
            ]
        );
        assert!(listener.take_events().is_empty());
    }

    #[test]
    fn the_groups_own_ramp_is_no_event() {
        let mut listener = Listener::new([2]);
        let ramp = Code::Limit(protocol::Limit::Acceleration);
        let slip = Code::Limit(protocol::Limit::Slip);
        for code in [ramp, Code::None, ramp, slip, ramp] {
            listener.push(0.0, &status(2, 1.0, code));
        }
        let events = listener.take_events().into_iter();
        let codes: Vec<_> = events
            .filter(|event| matches!(event.what, EventKind::Code(_)))
            .map(|event| event.what)
            .collect();
        assert_eq!(codes, [EventKind::Code(slip), EventKind::Code(Code::None)]);
    }

    #[test]
    fn without_a_group_file_robots_are_taken_as_they_come() {
        let mut listener = Listener::new([]);
        for id in [0x705, 0x702, 0x701, 0x77F] {
            listener.push(0.0, &Frame::of(id, [5]));
        }
        let nodes: Vec<_> = listener.now(0.0).members.iter().map(|m| m.node).collect();
        assert_eq!(nodes, [2, 5]);
    }

    #[test]
    fn the_load_is_that_of_the_last_100_ms() {
        let mut listener = Listener::new([]);
        let frame = Frame::of(0x555, []);
        // 45 bits by hand (canopen::bits) and three of intermission, a hundred times in 100 ms.
        for n in 0..200 {
            listener.push(f64::from(n) * 1e-3, &frame);
        }
        let load = listener.now(0.1995).bus_load.unwrap();
        assert!((load - 0.048).abs() < 1e-6, "{load}");
        assert_eq!(listener.now(1.0).bus_load, Some(0.0));
    }

    #[test]
    fn a_status_of_a_tenth_of_a_second_ago_is_the_past() {
        let fault = Code::Fault(protocol::Fault::SyncLost);
        let mut listener = Listener::new([2]);
        listener.push(0.0, &Frame::of(0x702, [5]));
        listener.push(0.01, &status(2, 1.0, fault));
        let then = listener.now(0.1).members[0];
        assert_eq!((then.state, then.code), (Some(MemberState::Moving), fault));
        let later = listener.now(0.2).members[0];
        assert_eq!((later.state, later.code), (None, Code::None));
        assert_eq!(later.permitted_scale, None);
        let past = later.past.unwrap();
        assert_eq!((past.state, past.code), (then.state, fault));
        assert!((past.age - 0.19).abs() < 1e-9);
        assert_eq!(past.to_string(), "SyncLost 0.2 s ago");
        // No heartbeat for a second: it may be off.
        assert_eq!(later.nmt, Some(NmtState::Operational));
        assert_eq!(listener.now(1.2).members[0].nmt, None);
    }

    #[test]
    fn a_master_that_stopped_leaves_no_setpoint_behind() {
        let mut listener = Listener::new([2]);
        listener.push(0.0, &twist(0.5, 1));
        listener.push(0.0, &sync());
        assert_eq!(listener.now(0.1).command.vx, 0.5);
        let later = listener.now(1.0);
        assert_eq!(
            (later.command, later.phase),
            (Twist::ZERO, SessionState::Idle)
        );
    }
}
