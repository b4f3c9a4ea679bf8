//! A bus, a master and native robots with a motor model, stepped by the millisecond.

use std::collections::VecDeque;
use std::vec::Vec;

use canopen::client::{Outcome, SdoClient, SdoError};
use canopen::{Frame, NmtCommand, NodeId};
use control::time::Micros;
use kinematics::Twist;
use protocol::address::{self as at, motor};
use protocol::{Address, ENTRIES, GroupTwist, MASTER, MemberStatus, Value, cob};

use control::interface::{Inputs, Outputs};
use control::quantity::InputVoltage;
use control::tick::ControlSide;

use crate::{BusSide, Event, Hardware, Identity};

/// Motor of every wheel, in the units of the feedforward.
pub const STATIC_FRICTION: f32 = 0.5;
pub const SPEED: f32 = 1.5;
pub const ACCELERATION: f32 = 0.15;
pub const SUPPLY: f32 = 24.0;
/// Of the measuring input, as a robot assumes it.
pub const DIVIDER: f32 = 11.0;
pub const COUNTS: f32 = 4096.0;
pub const GROUP: u8 = 5;
/// Group acceleration limits of the tests.
pub const MAX_ACCELERATION: f32 = 1.5;
pub const DECELERATION: f32 = 1.0;
pub const JERK: f32 = 20.0;

/// The reference board, with smart drives, too.
pub const ANY_DRIVES: Hardware = Hardware {
    output_stages: Hardware::SWITCHED | Hardware::SMART,
    ..Hardware::NUCLEO_F446RE
};

pub struct Robot {
    pub node: u8,
    pub bus: BusSide,
    pub control: ControlSide,
    pub inputs: Inputs,
    pub outputs: Outputs,
    /// True wheel rates, rad/s.
    pub rates: [f64; 4],
    /// Angles as the encoders see them, rad.
    pub angles: [f64; 4],
    /// Frames from the bus do not reach it.
    pub deaf: bool,
    /// Its frames do not reach the bus.
    pub mute: bool,
    /// Its frames reach the bus so much later, us.
    pub holds: Option<u64>,
    /// The encoder of this wheel is dead (0) or reversed (-1).
    pub encoder_sign: [f64; 4],
    /// Counts that an encoder has made besides those of its wheel.
    pub stray: [i64; 4],
    /// This wheel cannot turn.
    pub blocked: [bool; 4],
    /// Counts of its encoders in a wheel's revolution.
    pub counts: f64,
    /// This wheel drags: it turns, but hardly.
    pub drag: [bool; 4],
    /// Where it is not [`SUPPLY`], V.
    pub supply: Option<f32>,
    /// Control ticks happen.
    pub ticking: bool,
    /// The bus task runs.
    pub bus_runs: bool,
    /// Local clock minus true time.
    pub offset: u64,
}

impl Robot {
    fn new(node: u8, hardware: Hardware) -> Self {
        let id = NodeId::new(node).unwrap();
        Self {
            node,
            bus: BusSide::new(Identity {
                storage: true,
                hardware,
                ..Identity::new(id, u32::from(node) * 1000)
            }),
            control: ControlSide::new(),
            inputs: Inputs::default(),
            outputs: Outputs::SAFE,
            rates: [0.0; 4],
            angles: [0.0; 4],
            deaf: false,
            mute: false,
            holds: None,
            encoder_sign: [1.0; 4],
            stray: [0; 4],
            blocked: [false; 4],
            counts: f64::from(COUNTS),
            drag: [false; 4],
            supply: None,
            ticking: true,
            bus_runs: true,
            offset: u64::from(node) * 1_234_567,
        }
    }

    /// The supply is this, V, and measured.
    pub fn set_supply(&mut self, volts: f32) {
        self.supply = Some(volts);
        self.inputs.supply_input = Some(InputVoltage::new(volts / DIVIDER));
    }

    /// The group's velocity as its true wheel rates make it, if it drove alone.
    pub fn moves(&self) -> Twist {
        self.control.report().measured()
    }

    fn turn(&mut self) {
        const STEPS: u32 = 10;
        let dt = 1e-3 / f64::from(STEPS);
        for wheel in 0..4 {
            let voltage = if self.outputs.drivers_enabled {
                f64::from(self.outputs.given()[wheel] * self.supply.unwrap_or(SUPPLY))
            } else {
                0.0
            };
            for _ in 0..STEPS {
                let rate = &mut self.rates[wheel];
                let friction = f64::from(STATIC_FRICTION);
                let drive = voltage - f64::from(SPEED) * *rate;
                let net = if *rate == 0.0 {
                    drive.abs().max(friction) - friction
                } else {
                    0.0
                };
                let change = if *rate == 0.0 {
                    net.copysign(drive)
                } else {
                    drive - friction.copysign(*rate)
                } / f64::from(ACCELERATION)
                    * dt;
                let next = *rate + change;
                // Friction stops, it does not reverse.
                *rate = if *rate != 0.0 && next * *rate < 0.0 && drive.abs() < friction {
                    0.0
                } else {
                    next
                };
                if self.blocked[wheel] || !self.outputs.brake_released {
                    *rate = 0.0;
                }
                if self.drag[wheel] {
                    *rate = rate.clamp(-0.5, 0.5);
                }
                self.angles[wheel] += *rate * self.encoder_sign[wheel] * dt;
            }
            let turns = self.angles[wheel] / core::f64::consts::TAU;
            let counts = (turns * self.counts).floor() as i64 + self.stray[wheel];
            self.inputs.encoder_counts[wheel] = counts as u16;
        }
    }

    fn tick(&mut self, now: u64) {
        if !self.ticking {
            return;
        }
        if self.bus_runs
            && let Some(configuration) = self.bus.take_configuration()
        {
            self.control.configure(configuration);
        }
        let now = Micros(now + self.offset);
        let command = *self.bus.command();
        self.outputs = self.control.tick(now, &command, &self.inputs);
        if self.bus_runs {
            self.bus.on_report(self.control.report());
            if let Some(outcome) = self.control.take_identification() {
                self.bus.on_identification(now, &outcome);
            }
        }
    }
}

pub struct World {
    pub now: u64,
    pub robots: Vec<Robot>,
    pub sequence: u8,
    pub twist: Option<Twist>,
    pub sync: bool,
    pub heartbeat: bool,
    pub counter: u8,
    /// All frames on the bus since the start.
    pub log: Vec<(u64, Frame)>,
    /// All events but SYNC, with the node of the robot.
    pub events: Vec<(u8, Event)>,
    /// Whether a frame from one node reaches another; a parted bus lets some not.
    pub passes: fn(u8, u8) -> bool,
    wire: VecDeque<(u8, Frame)>,
    /// Frames on hold, and when they get to the bus.
    held: VecDeque<(u64, u8, Frame)>,
}

impl World {
    /// Robots with these nodes, powered, in PRE-OPERATIONAL.
    pub fn new(nodes: &[u8]) -> Self {
        Self::on(ANY_DRIVES, nodes)
    }

    /// The same with robots that have this hardware.
    pub fn on(hardware: Hardware, nodes: &[u8]) -> Self {
        let mut world = Self {
            now: 0,
            robots: nodes
                .iter()
                .map(|node| Robot::new(*node, hardware))
                .collect(),
            sequence: 0,
            twist: None,
            sync: true,
            heartbeat: true,
            counter: 0,
            log: Vec::new(),
            events: Vec::new(),
            passes: |_, _| true,
            wire: VecDeque::new(),
            held: VecDeque::new(),
        };
        // Powered and heard for long enough to be allowed to move.
        world.run(155);
        world
    }

    /// The same, configured in a row along x and started.
    pub fn started(nodes: &[u8]) -> Self {
        let mut world = Self::new(nodes);
        world.configure();
        world.start();
        world.run(30);
        world
    }

    pub fn mask(&self) -> u32 {
        self.robots.iter().map(|robot| 1 << robot.node).sum()
    }

    /// Writes a complete configuration to every robot.
    pub fn configure(&mut self) {
        for robot in 0..self.robots.len() {
            let node = self.robots[robot].node;
            for (address, value) in configuration(robot, self.mask()) {
                assert_eq!(self.write(node, address, value), Ok(()), "{address:?}");
            }
        }
    }

    /// An SDO write, expedited; the abort code if it was refused.
    pub fn write(&mut self, node: u8, address: Address, value: Value) -> Result<(), u32> {
        let length = value.kind().bytes();
        let [a, b, c, d] = value.to_bytes();
        let [low, high] = address.index.to_le_bytes();
        let data = [0x23 | (4 - length) << 2, low, high, address.sub, a, b, c, d];
        let answer = self.sdo(node, &data);
        match answer[0] {
            0x60 => Ok(()),
            _ => Err(u32::from_le_bytes(answer[4..8].try_into().unwrap())),
        }
    }

    /// An SDO read, as the word in the answer.
    pub fn read(&mut self, node: u8, address: Address) -> Result<u32, u32> {
        let [low, high] = address.index.to_le_bytes();
        let answer = self.sdo(node, &[0x40, low, high, address.sub, 0, 0, 0, 0]);
        let word = u32::from_le_bytes(answer[4..8].try_into().unwrap());
        if answer[0] == 0x80 {
            Err(word)
        } else {
            Ok(word)
        }
    }

    /// A segmented SDO write; the abort code if it was refused.
    pub fn write_block(&mut self, node: u8, address: Address, data: &[u8]) -> Result<(), u32> {
        let mut client = SdoClient::new(NodeId::new(node).unwrap(), canopen::Micros(1_000_000));
        let started = client.download(canopen::Micros(self.now), address.index, address.sub, data);
        started.unwrap();
        self.transfer(node, &mut client).map(|_| ())
    }

    /// A segmented SDO read.
    pub fn read_block(&mut self, node: u8, address: Address) -> Result<Vec<u8>, u32> {
        let mut client = SdoClient::new(NodeId::new(node).unwrap(), canopen::Micros(1_000_000));
        let started = client.upload(canopen::Micros(self.now), address.index, address.sub);
        started.unwrap();
        self.transfer(node, &mut client)
    }

    fn transfer(&mut self, node: u8, client: &mut SdoClient) -> Result<Vec<u8>, u32> {
        loop {
            let request = client.pop_frame().expect("a request");
            let answer = self.sdo(node, request.data().try_into().unwrap());
            let answer = Frame::new(cob::sdo_response(node), &answer).unwrap();
            match client.on_frame(canopen::Micros(self.now), &answer) {
                None => {}
                Some(Outcome::Failed(SdoError::Aborted(code))) => return Err(code),
                Some(Outcome::Failed(error)) => panic!("{error:?}"),
                Some(_) => return Ok(client.data().to_vec()),
            }
        }
    }

    fn sdo(&mut self, node: u8, data: &[u8; 8]) -> [u8; 8] {
        let before = self.log.len();
        self.send(MASTER, cob::sdo_request(node), data);
        let answer = self.log[before..]
            .iter()
            .find(|(_, frame)| frame.id() == cob::sdo_response(node))
            .expect("an answer");
        answer.1.data().try_into().unwrap()
    }

    pub fn start(&mut self) {
        self.nmt(NmtCommand::Start, 0);
    }

    pub fn nmt(&mut self, command: NmtCommand, node: u8) {
        self.send(MASTER, cob::NMT, &[command.code(), node]);
    }

    /// Puts a frame on the bus and everything that follows from it.
    pub fn send(&mut self, from: u8, id: u16, data: &[u8]) {
        self.wire.push_back((from, Frame::new(id, data).unwrap()));
        self.settle();
    }

    fn settle(&mut self) {
        loop {
            for robot in &mut self.robots {
                while let Some(frame) = robot.bus.pop_frame() {
                    if let Some(late_us) = robot.holds {
                        self.held.push_back((self.now + late_us, robot.node, frame));
                    } else if !robot.mute {
                        self.wire.push_back((robot.node, frame));
                    }
                }
            }
            let Some((from, frame)) = self.wire.pop_front() else {
                return;
            };
            self.log.push((self.now, frame));
            for robot in &mut self.robots {
                let passes = (self.passes)(from, robot.node);
                if robot.node != from && passes && !robot.deaf && robot.bus_runs {
                    robot.bus.on_frame(Micros(self.now + robot.offset), &frame);
                }
            }
        }
    }

    /// Sends the present twist, with a new sequence, and SYNC.
    pub fn cycle(&mut self) {
        if let Some(twist) = self.twist {
            self.sequence = self.sequence.wrapping_add(1);
            let frame = GroupTwist {
                twist,
                sequence: self.sequence,
                group: GROUP,
            };
            self.send(MASTER, cob::GROUP_TWIST, &frame.encode());
        }
        if self.sync {
            self.counter = self.counter % 240 + 1;
            self.send(MASTER, cob::SYNC, &[self.counter]);
        }
    }

    /// One millisecond.
    pub fn step(&mut self) {
        if self.now.is_multiple_of(100_000) && self.heartbeat {
            self.send(MASTER, cob::MASTER_HEARTBEAT, &[5]);
        }
        if self.now.is_multiple_of(10_000) {
            self.cycle();
        }
        while let Some((at, node, frame)) = self.held.front().copied()
            && at <= self.now
        {
            self.held.pop_front();
            self.wire.push_back((node, frame));
        }
        for robot in &mut self.robots {
            let local = Micros(self.now + robot.offset);
            if robot.bus_runs && robot.bus.next_deadline().is_some_and(|due| due <= local) {
                robot.bus.poll(local);
            }
        }
        self.settle();
        for robot in &mut self.robots {
            while let Some(event) = robot.bus.pop_event() {
                if !matches!(event, Event::Sync { .. }) {
                    self.events.push((robot.node, event));
                }
            }
            robot.tick(self.now);
            robot.turn();
        }
        self.now += 1000;
    }

    pub fn run(&mut self, millis: u32) {
        for _ in 0..millis {
            self.step();
        }
    }

    /// Asks for standstill until robots that have just been started follow.
    pub fn release(&mut self) {
        let armed = |robot: &Robot| robot.bus.state() == crate::State::Armed;
        for _ in 0..100 {
            if !self.robots.iter().any(armed) {
                break;
            }
            self.twist = Some(Twist::ZERO);
            self.step();
        }
    }

    /// Gives every robot this twist to follow from now on, for a while, after standstill if they
    /// have just been started.
    pub fn drive(&mut self, twist: Twist, millis: u32) {
        self.release();
        self.twist = Some(twist);
        self.run(millis);
    }

    /// Runs until the condition holds; returns after how many milliseconds.
    pub fn until(&mut self, limit: u32, condition: impl Fn(&Self) -> bool) -> u32 {
        for millis in 0..limit {
            if condition(self) {
                return millis;
            }
            self.step();
        }
        panic!("not within {limit} ms");
    }

    /// The last status a robot sent.
    pub fn status(&self, node: u8) -> MemberStatus {
        let frame = self
            .log
            .iter()
            .rev()
            .find(|(_, frame)| frame.id() == cob::member_status(node))
            .expect("a status");
        MemberStatus::try_from(frame.1.data()).unwrap()
    }

    /// Codes of the emergency messages a robot sent.
    pub fn emergencies(&self, node: u8) -> Vec<u16> {
        self.log
            .iter()
            .filter(|(_, frame)| frame.id() == cob::emergency(node))
            .map(|(_, frame)| u16::from_le_bytes([frame.data()[0], frame.data()[1]]))
            .collect()
    }
}

/// A complete configuration; `place` counts the robots from the front of the group.
pub fn configuration(place: usize, members: u32) -> Vec<(Address, Value)> {
    let real = |value: f32| Value::F32(value);
    let mut all = std::vec![
        (at::HALF_TRACK, real(0.37)),
        (at::HALF_WHEELBASE, real(0.35)),
        (at::WHEEL_RADIUS, real(0.1524)),
        (at::ROLLER_ANGLE, real(core::f32::consts::FRAC_PI_4)),
        (at::MOUNT_X, real(1.0 - place as f32)),
        (at::MOUNT_Y, real(0.0)),
        (at::MOUNT_HEADING, real(0.0)),
        (at::COMPENSATION_LONGITUDINAL, real(1.0)),
        (at::COMPENSATION_LATERAL, real(1.0)),
        (at::COMPENSATION_YAW, real(1.0)),
        (at::ENCODER_COUNTS, real(COUNTS)),
        (at::ENCODER_REVERSED, Value::U8(0)),
        (at::MOTOR_REVERSED, Value::U8(0)),
        (at::SUPPLY_NOMINAL, real(SUPPLY)),
        (at::WHEEL_RATE_MAX, real(10.0)),
        (at::ACCELERATION, real(MAX_ACCELERATION)),
        (at::ACCELERATION_YAW, real(3.0)),
        (at::JERK, real(JERK)),
        (at::JERK_YAW, real(40.0)),
        (at::DECELERATION, real(DECELERATION)),
        (at::DECELERATION_YAW, real(2.0)),
        (at::GROUP_ID, Value::U8(GROUP)),
        (at::MEMBERS, Value::U32(members)),
    ];
    for wheel in 0..4 {
        all.extend([
            (motor::static_friction(wheel), real(STATIC_FRICTION)),
            (motor::speed(wheel), real(SPEED)),
            (motor::acceleration(wheel), real(ACCELERATION)),
            (motor::proportional(wheel), real(2.0)),
            (motor::integral(wheel), real(20.0)),
        ]);
    }
    let required = ENTRIES.iter().filter(|entry| entry.is_required()).count();
    assert_eq!(all.len(), required, "the configuration is complete");
    all
}
