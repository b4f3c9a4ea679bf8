//! Mock robots, for tests of the master alone: they answer SDO, follow NMT, echo setpoints at SYNC,
//! and misbehave on request. They do not move. Time is virtual.

use std::collections::{HashMap, VecDeque};

use canopen::{AbortCode, Frame, Micros, NmtState, client};
use protocol::{Address, Code, Fault, MeasuredTwist, MemberState, MemberStatus, Scale, cob};

use crate::bus::link::{Link, LinkError, Schedule};
use crate::bus::punctuality::Punctuality;

/// How long a robot takes to answer, in µs.
const ANSWER_US: u64 = 300;

/// One cardboard robot.
pub struct FakeRobot {
    pub node: u8,
    /// Objects as last written.
    pub store: HashMap<Address, Vec<u8>>,
    pub nmt: NmtState,
    /// Refuses writes to this object.
    pub refuses: Option<(Address, AbortCode)>,
    /// Reads back this object as zeros.
    pub forgets: Option<Address>,
    /// Does not hear so many SDO requests.
    pub deaf_to: u32,
    /// Answers SDO so much later, µs.
    pub slow_us: u64,
    /// Says nothing from this time on, µs.
    pub silent_from: u64,
    /// Reports this fault from this time on, µs.
    pub fault: Option<(u64, Fault)>,
    sequence: u8,
}

impl FakeRobot {
    pub fn new(node: u8) -> Self {
        let wire = protocol::WIRE_VERSION.to_le_bytes().to_vec();
        let store = [
            (protocol::address::WIRE_VERSION, wire),
            (protocol::address::CONFIGURATION_STATUS, vec![0; 4]),
            (
                protocol::address::COMPENSATION_CRC,
                protocol::compensation::EMPTY[..4].to_vec(),
            ),
        ];
        Self {
            node,
            store: store.into(),
            nmt: NmtState::PreOperational,
            refuses: None,
            forgets: None,
            deaf_to: 0,
            slow_us: 0,
            silent_from: u64::MAX,
            fault: None,
            sequence: 0,
        }
    }

    fn sdo(&mut self, data: &[u8]) -> Vec<u8> {
        let (index, sub) = (u16::from_le_bytes([data[1], data[2]]), data[3]);
        let at = Address::new(index, sub);
        let abort = |code: AbortCode| {
            let mut out = vec![0x80, data[1], data[2], data[3]];
            out.extend(code.code().to_le_bytes());
            out
        };
        if data[0] == 0x40 {
            let Some(value) = self.store.get(&at) else {
                return abort(AbortCode::NoObject);
            };
            let mut out = vec![0x43 | ((4 - value.len() as u8) << 2), data[1], data[2], sub];
            out.extend(value);
            if self.forgets == Some(at) {
                out[4..].fill(0);
            }
            out.resize(8, 0);
            return out;
        }
        if let Some((refused, code)) = self.refuses
            && refused == at
        {
            return abort(code);
        }
        let length = 4 - usize::from(data[0] >> 2 & 3);
        self.store.insert(at, data[4..4 + length].to_vec());
        vec![0x60, data[1], data[2], sub, 0, 0, 0, 0]
    }
}

/// A bus with cardboard robots.
pub struct FakeBus {
    now: u64,
    pub robots: Vec<FakeRobot>,
    waiting: VecDeque<(u64, Frame)>,
    /// Everything the master sent, and SYNC that the bus sent for it.
    pub sent: Vec<(u64, Frame)>,
    /// Whether the bus can send SYNC by itself.
    pub paces: bool,
    /// At the first time, µs, the master's machine hangs until the second.
    pub hang: Option<(u64, u64)>,
    /// SYNC that it sent by itself and has not been asked for.
    paced: VecDeque<(Micros, Frame)>,
    pub schedule: Option<Schedule>,
}

impl FakeBus {
    pub fn new(nodes: &[u8]) -> Self {
        Self {
            now: 0,
            robots: nodes.iter().map(|node| FakeRobot::new(*node)).collect(),
            waiting: VecDeque::new(),
            sent: Vec::new(),
            paces: false,
            hang: None,
            paced: VecDeque::new(),
            schedule: None,
        }
    }

    /// Sends SYNC as long as it is due before `until`.
    fn keep_schedule(&mut self, until: u64) {
        while let Some(schedule) = &mut self.schedule
            && schedule.first.0 <= until
        {
            let (at, counter) = (schedule.first.0, schedule.counter);
            schedule.first.0 += schedule.period_us;
            schedule.counter = counter % schedule.overflow + 1;
            let sync = client::sync(Some(counter));
            self.paced.push_back((Micros(at), sync));
            self.deliver(at, &sync);
        }
    }

    /// What the master sent with an identifier.
    pub fn sent_as(&self, id: u16) -> Vec<(u64, Vec<u8>)> {
        let frames = self.sent.iter().filter(|(_, frame)| frame.id() == id);
        frames
            .map(|(at, frame)| (*at, frame.data().to_vec()))
            .collect()
    }
}

impl Link for FakeBus {
    fn now(&self) -> Micros {
        Micros(self.now)
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        self.deliver(self.now, frame);
        Ok(())
    }

    fn pace(&mut self, schedule: Option<Schedule>) -> bool {
        self.schedule = schedule;
        self.paces
    }

    fn take_sent(&mut self) -> Option<(Micros, Frame)> {
        self.paced.pop_front()
    }

    fn punctuality(&self) -> Option<Punctuality> {
        self.paces.then(Punctuality::default)
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        let until = match self.hang {
            Some((from, to)) if self.now >= from => {
                self.hang = None;
                self.now = to;
                Micros(to)
            }
            _ => until,
        };
        if self.paces {
            self.keep_schedule(until.0);
        }
        match self.waiting.front() {
            Some((at, _)) if *at <= until.0 => {
                let (at, frame) = self.waiting.pop_front().unwrap();
                self.now = self.now.max(at);
                Ok(Some((Micros(at), frame)))
            }
            _ => {
                self.now = self.now.max(until.0);
                Ok(None)
            }
        }
    }
}

impl FakeBus {
    /// What the robots do about a frame.
    fn deliver(&mut self, now: u64, frame: &Frame) {
        self.sent.push((now, *frame));
        let (id, data) = (frame.id(), frame.data());
        for robot in self.robots.iter_mut().filter(|r| now < r.silent_from) {
            let sdo = id == cob::sdo_request(robot.node);
            let after = ANSWER_US + if sdo { robot.slow_us } else { 0 };
            let mut print_line = |id: u16, data: &[u8]| {
                let frame = Frame::new(id, data).unwrap();
                self.waiting.push_back((now + after, frame));
            };
            // An abort is not answered.
            if sdo && (robot.deaf_to > 0 || data[0] == 0x80) {
                robot.deaf_to = robot.deaf_to.saturating_sub(u32::from(data[0] != 0x80));
            } else if sdo {
                let answer = robot.sdo(data);
                print_line(cob::sdo_response(robot.node), &answer);
            } else if let Some((command, _)) = client::parse_nmt(frame) {
                robot.nmt = match command {
                    canopen::NmtCommand::Start => NmtState::Operational,
                    _ => NmtState::PreOperational,
                };
                print_line(cob::heartbeat(robot.node), &[robot.nmt.code()]);
            } else if id == cob::GROUP_TWIST {
                robot.sequence = data[6];
            } else if id == cob::SYNC && robot.nmt == NmtState::Operational {
                let code = match robot.fault {
                    Some((from, fault)) if now >= from => Code::Fault(fault),
                    _ => Code::None,
                };
                let status = MemberStatus {
                    state: MemberState::Moving,
                    sequence: robot.sequence,
                    scale: Scale::ONE,
                    slip_residual: Some(0.0),
                    code,
                    plan: 0,
                };
                print_line(cob::member_status(robot.node), &status.encode());
                let measured = MeasuredTwist {
                    twist: kinematics::Twist::default(),
                    sequence: robot.sequence,
                    group: data[0],
                };
                print_line(cob::measured_twist(robot.node), &measured.encode());
            }
        }
    }
}
