//! A robot with its wheels: battery, motors, gears and encoders, and the time each has reached.

use canopen::Frame;
use group::{Driver, EncoderFault, EncoderNoise, Simulation};
use kinematics::{Pose, WheelRates};

use crate::battery::{Battery, Supply};
use crate::bus::disturb::Share;
use crate::encoder::wires::{Decoder, Edge};
use crate::encoder::{EncoderState, WheelEncoder};
use crate::motor::{Bridge, Motors};
use crate::robot::{Robot, Wake};
use crate::truth::RobotTruth;
use crate::world::index::{self, IndexState, Indexes};

/// The USB end of a robot's cable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Cable {
    /// Plugged in.
    #[default]
    Plugged,
    /// Pulled. The ST-LINK has no power then, and its output holds the line low.
    Low,
    /// Pulled. The line is open, and the chip's pull-up holds it high.
    Open,
}

impl Cable {
    /// The level of the line into the chip while it is not driven.
    pub(super) fn level(self) -> Option<bool> {
        match self {
            Self::Plugged => None,
            Self::Low => Some(false),
            Self::Open => Some(true),
        }
    }
}

/// The bus faults of one robot.
#[derive(Debug, Clone, Copy)]
pub(super) struct InjectedFaults {
    /// The identifier of the frames that it does not get.
    pub misses: Option<u16>,
    /// Frames that its receiver gets wrong.
    pub bad_receiver: Share,
    /// The frame that its controller sends continuously instead of its own.
    pub babble: Option<Frame>,
    /// Delay of its frames, ns.
    pub delay_ns: u64,
}

impl Default for InjectedFaults {
    fn default() -> Self {
        Self {
            misses: None,
            bad_receiver: Share::NONE,
            babble: None,
            delay_ns: 0,
        }
    }
}

/// A robot with its wheels.
pub(super) struct Unit {
    pub node: u8,
    pub robot: Box<dyn Robot>,
    /// Off when its CAN connector is pulled.
    pub connected: bool,
    pub cable: Cable,
    /// In the half of a parted bus where the master is not.
    pub far: bool,
    pub powered: bool,
    pub injected: InjectedFaults,
    /// What it has to send, since when, while that is kept back.
    pub held: Option<(Frame, u64)>,
    /// While it is alone on its stub: when it may try again, ns.
    pub alone_ns: u64,
    /// Its receiver gets the frame on the wire wrong.
    pub misses_this: bool,
    /// The frame on the wire is its program's, not its babble.
    pub sends_own: bool,
    pub motors: Motors,
    encoders: [WheelEncoder; 4],
    /// Count the edges for a robot that only takes counts.
    decoders: [Decoder; 4],
    /// Edges of one wheel in one step.
    edges: Vec<Edge>,
    indexes: Indexes,
    /// Its encoders and indexes are without faults, and it reads them when it wakes.
    reads_sums: bool,
    pub supply: Supply,
    /// The current of a motor at which the driver trips, A, and whether it has.
    trips_at: Option<f64>,
    tripped: bool,
    /// A sensor of all motors' current: its scale, A/V, and its voltage without current, V.
    pub current_sensor: Option<(f64, f64)>,
    /// Half of the play between motor and wheel, rad, and the wheels' angles.
    half_play: f64,
    wheels: [f64; 4],
    drives: [Bridge; 4],
    directions: Directions,
    /// Time since which its bridges are off and its brake is commanded to engage, ns.
    pub safe_since_ns: Option<u64>,
    /// Angles last reported to the plant.
    reported: [f64; 4],
    /// What the plant adds to the wheels' angles: a plant outside may turn wheels itself.
    slipped: [f64; 4],
    /// Up to when its motors have turned, and its encoders followed them, ns.
    at_ns: u64,
    followed_ns: u64,
    /// Its encoders have yet to follow its wheels.
    owes_counts: bool,
    /// When it next does something by itself, as it last said; nothing of a robot that has to be
    /// asked each time.
    wake: Option<Wake>,
}

/// How encoders and motors are wired or mounted: 1, or -1 where the other way round.
#[derive(Clone, Copy)]
struct Directions {
    encoders: [f64; 4],
    motors: [f64; 4],
}

impl Directions {
    /// What the robot's outputs do to its motors.
    fn at_motors(&self, drives: [Bridge; 4]) -> [Bridge; 4] {
        std::array::from_fn(|n| Bridge {
            duty: self.motors[n] * drives[n].duty,
            ..drives[n]
        })
    }
}

impl Unit {
    pub fn new(
        place: usize,
        data: &group::Robot,
        mut robot: Box<dyn Robot>,
        simulation: &Simulation,
    ) -> Self {
        // Every encoder has a stream of its own.
        let seed = |wheel: usize| {
            simulation.seed ^ ((4 * place + wheel + 1) as u64).wrapping_mul(0xD6E8_FEB8_6659_FD93)
        };
        robot.set_supply(data.motor.supply.into());
        let right = Driver::from(data.output.kind);
        robot.wire_driver(simulation.driver.unwrap_or(right));
        robot.wire_smart_drives(data);
        let signs = |bits: Option<u8>| {
            let bits = bits.unwrap_or_default();
            [0, 1, 2, 3].map(|wheel| if bits >> wheel & 1 == 1 { -1.0 } else { 1.0 })
        };
        let directions = Directions {
            encoders: signs(data.reversed.encoders),
            motors: signs(data.reversed.motors),
        };
        let lazy = robot.is_lazy();
        Self {
            node: data.node,
            drives: directions.at_motors(robot.drives()),
            directions,
            reads_sums: lazy && simulation.encoder_noise == EncoderNoise::default(),
            wake: lazy.then(|| robot.wake()),
            robot,
            connected: true,
            cable: Cable::default(),
            far: false,
            powered: true,
            injected: InjectedFaults::default(),
            held: None,
            alone_ns: 0,
            misses_this: false,
            sends_own: false,
            motors: Motors::new(&data.motor),
            encoders: std::array::from_fn(|wheel| {
                WheelEncoder::new(&data.encoder, simulation.encoder_noise, seed(wheel))
            }),
            decoders: [Decoder::default(); 4],
            edges: Vec::new(),
            indexes: Indexes::new(
                &index::robot_angles(simulation.seed, place),
                (data.encoder.counts_per_revolution * data.encoder.gear_ratio).into(),
                seed(4),
            ),
            supply: Supply::new(simulation.battery.as_ref().map(Battery::new)),
            trips_at: None,
            tripped: false,
            current_sensor: None,
            half_play: 0.5 * simulation.backlash,
            safe_since_ns: Some(0),
            wheels: [0.0; 4],
            reported: [0.0; 4],
            slipped: [0.0; 4],
            at_ns: 0,
            followed_ns: 0,
            owes_counts: false,
        }
    }

    /// The same in the same state, which goes on by itself; `None` with a robot that has no copy.
    pub fn try_clone(&self) -> Option<Self> {
        Some(Self {
            robot: self.robot.try_clone()?,
            motors: self.motors.clone(),
            encoders: self.encoders.clone(),
            edges: self.edges.clone(),
            indexes: self.indexes.clone(),
            supply: self.supply.clone(),
            ..*self
        })
    }

    /// An encoder, to change it.
    pub fn encoder_mut(&mut self, wheel: usize) -> Option<&mut WheelEncoder> {
        self.reads_sums = false;
        self.encoders.get_mut(wheel)
    }

    /// The state of an index, to change it.
    pub fn index_mut(&mut self, wheel: usize) -> Option<&mut IndexState> {
        self.reads_sums = false;
        self.indexes.state.get_mut(wheel)
    }

    /// Whether it need not be run between its wake-up times.
    pub fn is_lazy(&self) -> bool {
        self.wake.is_some()
    }

    /// When it next does something by itself.
    pub fn wake(&self) -> Wake {
        self.wake.unwrap_or_else(|| self.robot.wake())
    }

    /// Whether it has something to do at this time.
    pub fn is_due(&self, now_ns: u64) -> bool {
        match self.wake {
            None | Some(Wake::Busy) => true,
            Some(Wake::At(at)) => at <= now_ns,
            Some(Wake::Never) => false,
        }
    }

    /// It has been at work: it may want to wake at another time.
    pub fn has_run(&mut self) {
        if let Some(wake) = &mut self.wake {
            *wake = self.robot.wake();
        }
    }

    /// Called before a change from outside at the present time: afterwards the robot has to be run.
    pub fn touch(&mut self, now_ns: u64, step_ns: u64) {
        self.turn_to(now_ns, step_ns);
        self.robot.set_now(now_ns);
        if let Some(wake) = &mut self.wake {
            *wake = Wake::At(now_ns);
        }
    }

    /// Turns the wheels up to a time, in steps of at most `step_ns`, and the encoders with them.
    pub fn turn_to(&mut self, now_ns: u64, step_ns: u64) {
        self.turn_motors(now_ns, step_ns);
        self.turn_encoders();
    }

    /// Turns the motors alone up to a time.
    pub fn turn_motors(&mut self, now_ns: u64, step_ns: u64) {
        if now_ns == self.at_ns {
            return;
        }
        let steps = (now_ns - self.at_ns).div_ceil(step_ns.max(1));
        let dt = (now_ns - self.at_ns) as f64 * 1e-9;
        self.at_ns = now_ns;
        let step = dt / steps as f64;
        let before = self.supply.volts();
        match self.trips_at {
            None => self.supply.run(&mut self.motors, &self.drives, steps, step),
            Some(amperes) => self.turn_until_it_trips(amperes, steps, step),
        }
        if let Some(volts) = self.supply.volts() {
            self.robot.set_supply(volts);
        } else if before.is_some() {
            self.robot.set_supply(self.motors.supply());
        }
        if let Some((scale, offset)) = self.current_sensor {
            let sum: f64 = self.motors.currents().iter().sum();
            self.robot
                .set_current_inputs([offset + sum / scale, 0.0, 0.0]);
        }
    }

    /// Lets the wheels follow the motors to where these are. The encoders and the indexes follow
    /// them, too, unless their sum at the next wake-up is the same.
    pub fn turn_wheels(&mut self) {
        if self.followed_ns == self.at_ns {
            return;
        }
        let wheels = self.behind_play();
        let turned = std::array::from_fn(|n| wheels[n] + self.slipped[n]);
        if !self.reads_sums || !self.indexes.stays_between_pulses(turned) {
            self.turn_encoders();
            return;
        }
        self.wheels = wheels;
        self.followed_ns = self.at_ns;
        self.owes_counts = true;
    }

    /// The wheels' angles, within the play of the motors' ones.
    #[inline(always)]
    fn behind_play(&self) -> [f64; 4] {
        let (angles, play) = (self.motors.angles(), self.half_play);
        std::array::from_fn(|n| self.wheels[n].clamp(angles[n] - play, angles[n] + play))
    }

    /// Lets the wheels, the encoders and the indexes follow the motors to where these are.
    fn turn_encoders(&mut self) {
        let span = (
            std::mem::replace(&mut self.followed_ns, self.at_ns),
            self.at_ns,
        );
        if span.0 == span.1 && !self.owes_counts {
            return;
        }
        self.owes_counts = false;
        self.wheels = self.behind_play();
        let mut pulses = [None; 4];
        let (mut counts, mut rates) = ([0; 4], self.motors.rates());
        for (wheel, angle) in self.motors.angles().into_iter().enumerate() {
            let angle = angle + self.slipped[wheel];
            let turned = self.wheels[wheel] + self.slipped[wheel];
            if let Some(pulse) = self.indexes.follow(wheel, turned, angle, span) {
                pulses[wheel] = Some(pulse);
            }
            let direction = self.directions.encoders[wheel];
            rates[wheel] *= direction;
            counts[wheel] = self.encoders[wheel].follow(direction * angle, span, &mut self.edges);
            if self.edges.is_empty() {
                continue;
            }
            if self.robot.encoder_edges(wheel, &self.edges) {
                self.edges.clear();
            }
            let decoder = &mut self.decoders[wheel];
            counts[wheel] += self.edges.drain(..).map(|e| decoder.count(&e)).sum::<i32>();
        }
        self.robot.set_wheel_rates(rates);
        if counts != [0; 4] {
            self.robot.turn_encoders(counts);
        }
        for (wheel, pulse) in pulses.into_iter().enumerate() {
            if let Some(pulse) = pulse {
                self.robot.index(wheel, pulse);
            }
        }
    }

    /// Sets the current of a motor, A, at which the driver trips, or never; resets a trip.
    pub fn set_trip(&mut self, amperes: Option<f64>) {
        self.trips_at = amperes;
        if std::mem::take(&mut self.tripped) {
            self.robot.set_driver_fault(false);
        }
    }

    /// Turns the motors, and trips the driver when one draws more than this: all bridges off and
    /// the fault line pulled.
    fn turn_until_it_trips(&mut self, amperes: f64, steps: u64, dt: f64) {
        for _ in 0..steps {
            let mut drives = self.drives;
            for drive in &mut drives {
                drive.enabled &= !self.tripped;
            }
            self.supply.run(&mut self.motors, &drives, 1, dt);
            let over = |current: &f64| current.abs() > amperes;
            if !self.tripped && self.motors.currents().iter().any(over) {
                self.tripped = true;
                self.robot.set_driver_fault(true);
            }
        }
    }

    /// Reads the bridges; returns their state if it changed.
    pub fn look_at_bridges(&mut self, now_ns: u64) -> Option<&[Bridge; 4]> {
        let drives = self.directions.at_motors(self.robot.drives());
        let live = |drive: &Bridge| drive.enabled || drive.brake_released;
        if drives.iter().any(live) {
            self.safe_since_ns = None;
        } else {
            self.safe_since_ns.get_or_insert(now_ns);
        }
        let changed = std::mem::replace(&mut self.drives, drives) != drives;
        changed.then_some(&self.drives)
    }

    /// Angles by which the wheels have turned since the last report to the plant, rad.
    pub fn turned(&mut self) -> [f64; 4] {
        let reported = std::mem::replace(&mut self.reported, self.wheels);
        std::array::from_fn(|n| self.wheels[n] - reported[n])
    }

    /// Sets the torques of the floor on the wheels, N·m.
    pub fn push_wheels(&mut self, torques: [f64; 4]) {
        self.motors.set_floor(torques);
    }

    /// The plant says where the wheels really are.
    pub fn correct(&mut self, angles: [f64; 4]) {
        self.slipped = std::array::from_fn(|n| angles[n] - self.wheels[n]);
    }

    pub fn truth(&self, pose: Pose<f64>) -> RobotTruth {
        let on = |drive: &Bridge| if drive.enabled { drive.duty } else { 0.0 };
        RobotTruth {
            node: self.node,
            pose,
            wheel_angles: std::array::from_fn(|n| self.wheels[n] + self.slipped[n]),
            wheel_rates: WheelRates::from(self.motors.rates()),
            duties: [0, 1, 2, 3].map(|n: usize| on(&self.drives[n])),
            currents: self.motors.currents(),
            supply: self.supply.volts().unwrap_or(self.motors.supply()),
            brake_holds: self.motors.brakes_hold().contains(&true),
            drivers_enabled: self.drives.iter().any(|d| d.enabled),
            brake_released: self.drives.iter().any(|d| d.brake_released),
        }
    }
}

/// The encoders that a group file lets break, the last first.
pub(super) fn breaking(faults: &[EncoderFault]) -> Vec<(u64, usize, usize, EncoderState)> {
    let of = |fault: &EncoderFault| {
        let at_ns = (fault.at * 1e9).round() as u64;
        (at_ns, fault.robot, fault.wheel as usize, fault.kind.into())
    };
    let mut all: Vec<_> = faults.iter().map(of).collect();
    all.sort_by_key(|(at_ns, ..)| std::cmp::Reverse(*at_ns));
    all
}
