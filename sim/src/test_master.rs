//! A master that misbehaves on demand: it stops its heartbeat, SYNC or setpoints, sends nonsense,
//! or is joined by a second one. What a group does about that is what rules and faults are tried
//! with.
//!
//! It drives robots that are configured already: its heartbeat goes out every 100 ms, SYNC every
//! period, and the setpoint [`SETPOINT_LEAD_US`] before it. Everything the robots say is kept until
//! the test master is dropped, some hundred kilobytes for a second of a group of three.

use std::collections::BTreeMap;

use can_text::slcan::{self, Answer, Answers};
use canopen::{Frame, Micros, NmtCommand, NmtState, NmtTarget, NodeId, client};
use kinematics::{Twist, WheelRates};
use protocol::timing::{HEARTBEAT_MS, SETPOINT_LEAD_US, SYNC_OVERFLOW};
use protocol::{GroupTwist, MemberState, MemberStatus, RobotReport, cob};

use crate::error::SimError;
use crate::world::{MASTER, World};

/// One step of [`TestMaster::step`], µs.
pub const STEP_US: u64 = 250;

/// The master, what it does at the moment, and what it has heard.
pub struct TestMaster {
    /// The world it drives.
    pub world: World,
    /// Whether it sends its heartbeat.
    pub heartbeat: bool,
    /// Whether it sends SYNC.
    pub sync: bool,
    /// How late SYNC is, µs, a multiple of [`STEP_US`].
    pub sync_late_us: u64,
    /// The setpoint that it sends, m/s and rad/s in the group frame; `None` sends none.
    pub twist: Option<Twist>,
    /// Whether every setpoint has a new sequence.
    pub counts: bool,
    /// Whether a second master sends setpoints of its own, in the middle between two SYNCs.
    pub second: bool,
    group: u8,
    period_us: u64,
    sequence: u8,
    counter: u8,
    status: BTreeMap<u8, MemberStatus>,
    measured: BTreeMap<u8, Twist>,
    rates: BTreeMap<u8, WheelRates>,
    emergencies: Vec<(Micros, u8, u16)>,
    /// The robot at whose cable it is, instead of on the bus, and what that says.
    cable: Option<(u8, Answers)>,
    /// Bytes that the cable has carried from the robot.
    carried: u64,
}

impl TestMaster {
    /// A second one with a world of its own, in the same state, unless that has no copy
    /// ([`World::try_clone`]).
    #[must_use]
    pub fn try_clone(&self) -> Option<Self> {
        Some(Self {
            world: self.world.try_clone()?,
            status: self.status.clone(),
            measured: self.measured.clone(),
            rates: self.rates.clone(),
            emergencies: self.emergencies.clone(),
            cable: self.cable.clone(),
            ..*self
        })
    }

    /// Takes over a world of configured robots: heartbeat and SYNC run, the setpoint is standstill.
    #[must_use]
    pub fn new(world: World, file: &group::GroupFile) -> Self {
        Self {
            world,
            heartbeat: true,
            sync: true,
            sync_late_us: 0,
            twist: Some(Twist::default()),
            counts: true,
            second: false,
            group: file.group_id,
            period_us: u64::from(file.sync_period_us),
            sequence: 0,
            counter: 0,
            status: BTreeMap::new(),
            measured: BTreeMap::new(),
            rates: BTreeMap::new(),
            emergencies: Vec::new(),
            cable: None,
            carried: 0,
        }
    }

    /// Leaves the bus for the cable of a robot, whose channel it opens.
    pub fn plug_in(&mut self, node: u8) {
        self.world.set_listening(MASTER, false);
        self.world.send_cable(node, b"\rC\rS8\rO\r");
        self.cable = Some((node, Answers::new()));
    }

    /// Bytes that the cable has carried from the robot so far.
    #[must_use]
    pub fn carried(&self) -> u64 {
        self.carried
    }

    fn put(&mut self, frame: Frame) {
        match &self.cable {
            Some((node, _)) => {
                let line = slcan::frame(&frame, None);
                self.world.send_cable(*node, line.as_bytes());
            }
            None => self.world.send(frame),
        }
    }

    /// Takes in what the cable has brought.
    fn receive_cable(&mut self) {
        let Some((node, mut answers)) = self.cable.take() else {
            return;
        };
        let now = self.world.now();
        for (_, byte) in self.world.take_cable(node) {
            self.carried += 1;
            if let Some(Answer::Frame(frame, _)) = answers.push(byte) {
                self.receive(now, &frame);
            }
        }
        self.cable = Some((node, answers));
    }

    /// Sends what is due and goes on to the next whole multiple of [`STEP_US`].
    ///
    /// # Errors
    /// When a robot or the plant stops.
    pub fn step(&mut self) -> Result<(), SimError> {
        let now = self.world.now().0;
        self.send(now);
        if self.sync && now % self.period_us == self.sync_late_us {
            self.counter = self.counter % SYNC_OVERFLOW + 1;
            self.put(client::sync(Some(self.counter)));
        }
        self.world
            .run_until(Micros((now / STEP_US + 1) * STEP_US))?;
        while let Some((at, frame)) = self.world.take_received(MASTER) {
            self.receive(at, &frame);
        }
        self.receive_cable();
        Ok(())
    }

    /// Lets this many milliseconds pass.
    ///
    /// # Errors
    /// As [`TestMaster::step`].
    pub fn run(&mut self, millis: u64) -> Result<(), SimError> {
        (0..millis * 1_000 / STEP_US).try_for_each(|_| self.step())
    }

    /// Lets time pass until it is `offset` ms after a whole multiple of `period` ms.
    ///
    /// # Errors
    /// As [`TestMaster::step`].
    pub fn run_to_phase(&mut self, period: u64, offset: u64) -> Result<(), SimError> {
        self.step()?;
        while self.world.now().0 % (period * 1_000) != offset * 1_000 {
            self.step()?;
        }
        Ok(())
    }

    /// Sends an NMT command to one robot, or to all.
    pub fn command(&mut self, command: NmtCommand, node: Option<u8>) {
        let target = node
            .and_then(NodeId::new)
            .map_or(NmtTarget::All, NmtTarget::Node);
        self.put(client::nmt(command, target));
    }

    /// Sends a setpoint beside the regular ones, with a sequence this far from the last.
    pub fn send_setpoint(&mut self, twist: Twist, ahead: u8) {
        let setpoint = GroupTwist {
            twist,
            sequence: self.sequence.wrapping_add(ahead),
            group: self.group,
        };
        self.put(Frame::of(cob::GROUP_TWIST, setpoint.encode()));
    }

    /// The sequence of the last regular setpoint.
    #[must_use]
    pub fn sequence(&self) -> u8 {
        self.sequence
    }

    /// A member's last status.
    #[must_use]
    pub fn status(&self, node: u8) -> Option<&MemberStatus> {
        self.status.get(&node)
    }

    /// Whether every member said last that it is in this state.
    #[must_use]
    pub fn all_are(&self, state: MemberState) -> bool {
        !self.status.is_empty() && self.status.values().all(|status| status.state == state)
    }

    /// A member's last measured twist, in the group frame.
    #[must_use]
    pub fn measured(&self, node: u8) -> Option<Twist> {
        self.measured.get(&node).copied()
    }

    /// A member's last wheel rates as it measures them, rad/s.
    #[must_use]
    pub fn rates(&self, node: u8) -> Option<WheelRates> {
        self.rates.get(&node).copied()
    }

    /// Emergency messages of a node so far: when they were complete, and their code.
    pub fn emergencies(&self, node: u8) -> impl Iterator<Item = (Micros, u16)> {
        let received_codes = self.emergencies.iter();
        received_codes
            .filter_map(move |(at, sender, code)| (*sender == node).then_some((*at, *code)))
    }

    /// Sends the heartbeat and setpoints that are due.
    fn send(&mut self, now: u64) {
        if self.heartbeat && now.is_multiple_of(u64::from(HEARTBEAT_MS) * 1_000) {
            let master = NodeId::new(protocol::MASTER).unwrap_or(NodeId::MIN);
            let frame = client::heartbeat(master, NmtState::Operational);
            self.put(frame);
        }
        let is_ahead = |us: u64| (now + us).is_multiple_of(self.period_us);
        let (due, between) = (
            is_ahead(SETPOINT_LEAD_US.into()),
            is_ahead(self.period_us / 2),
        );
        if let Some(twist) = self.twist.filter(|_| due) {
            self.sequence = self.sequence.wrapping_add(u8::from(self.counts));
            self.send_setpoint(twist, 0);
        }
        if let Some(twist) = self.twist.filter(|_| self.second && between) {
            self.send_setpoint(twist, 100);
        }
    }

    fn receive(&mut self, at: Micros, frame: &Frame) {
        match RobotReport::decode(frame.id(), frame.data()) {
            Some((node, RobotReport::Status(status))) => {
                self.status.insert(node, status);
            }
            Some((node, RobotReport::Measured(measured))) => {
                self.measured.insert(node, measured.twist);
            }
            Some((node, RobotReport::WheelRates(report))) => {
                self.rates.insert(node, report.rates);
            }
            Some((node, RobotReport::Emergency(code))) => self.emergencies.push((at, node, code)),
            Some((_, RobotReport::Pose(_) | RobotReport::YawRate(_))) | None => {}
        }
    }
}
