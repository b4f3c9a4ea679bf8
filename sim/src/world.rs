//! The world: robots, their motors, the floor and the bus, in one virtual time.
//!
//! Time goes in steps that are as long as nothing happens and never longer than
//! [`Options::motor_step_ns`]. A step ends at the earliest of: the end of the frame on the bus, the moment
//! the bus is free for a waiting frame, a robot's next own event, the next plant step, and, while any
//! robot computes, one [`Options::quantum_ns`]. In a step the motors turn under the bridges' last state
//! and the encoders follow; then the robots run, in order; then what is due on the plant and the bus
//! happens. So a robot that wakes at a time reads encoders of that time, and whatever it changes acts
//! from the end of the step on: at most one quantum later than in life.
//!
//! Robots may run side by side within a step, everything else happens in one thread in a fixed order: the
//! same group, backend and calls give the same bytes on any number of threads, which [`World::digest`]
//! sums up.
//!
//! The master's frames wait in a queue without limit, in order; a master that sends more than the bus
//! carries sees its own delay grow. Frames for a port wait until they are taken.

use std::collections::VecDeque;

use canopen::{Frame, Micros};
use group::GroupFile;
use kinematics::{Pose, WheelRates};

use crate::bus::candump::Candump;
use crate::bus::{Bus, BusLoad, Transfer};
use crate::crew::{Absent, Crew};
use crate::digest::Digest;
use crate::error::SimError;
use crate::motor::{Drive, Motor, WheelEncoder};
use crate::plant::{self, Plant};
use crate::robot::{Backend, LogLine, Robot, Wake};
use crate::truth::{RobotTruth, TruthSample};

/// Steps and periods, all in ns of virtual time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Longest time between two looks at a computing robot.
    pub quantum_ns: u64,
    /// Longest step of the motors.
    pub motor_step_ns: u64,
    /// Period of truth samples, a multiple of the plant's; 0 keeps none.
    pub truth_period_ns: u64,
    /// Length of the windows of the bus load.
    pub load_window_ns: u64,
    /// Threads that run robots, the caller's included; 0 takes as many as the machine has. It makes no
    /// difference to what happens. Native robots always run on the caller's.
    pub threads: usize,
    /// Where the group frame stands at the beginning.
    pub start: Pose<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            quantum_ns: 20_000,
            motor_step_ns: 100_000,
            truth_period_ns: 10_000_000,
            load_window_ns: 100_000_000,
            threads: 1,
            start: Pose {
                x: 0.0,
                y: 0.0,
                heading: 0.0,
            },
        }
    }
}

/// A way for a program to be on the bus. Port 0 is the master's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Port(usize);

/// The master's port.
pub const MASTER: Port = Port(0);

#[derive(Debug, Default)]
struct PortQueues {
    send: VecDeque<Frame>,
    received: VecDeque<(Micros, Frame)>,
}

/// A robot with its wheels.
struct Unit {
    node: u8,
    robot: Box<dyn Robot>,
    motors: [Motor; 4],
    encoders: [WheelEncoder; 4],
    drives: [Drive; 4],
    /// Angles that the plant has been told.
    told: [f64; 4],
    /// What the plant adds to the motors' angles: a plant outside may turn wheels itself.
    slipped: [f64; 4],
    /// Off when its CAN connector is pulled.
    connected: bool,
}

/// Robots, motors, floor and bus in one virtual time. How it steps is told at the head of this file.
pub struct World {
    now_ns: u64,
    options: Options,
    units: Vec<Unit>,
    plant: Box<dyn Plant>,
    plant_at_ns: u64,
    plant_period_ns: u64,
    bus: Bus,
    ports: Vec<PortQueues>,
    candump: Option<Candump>,
    truth: Vec<TruthSample>,
    /// Time of the last sample, and how long the bus had been taken then.
    truth_at: (u64, u64),
    worst_shape_error_mm: f64,
    digest: Digest,
    crew: Option<Crew>,
    turned: Vec<[f64; 4]>,
}

impl World {
    /// The robots of a group, at rest, just switched on.
    ///
    /// # Errors
    /// When a robot or the plant cannot be built.
    pub fn new(group: &GroupFile, backend: Backend, options: Options) -> Result<Self, SimError> {
        let robots = group
            .robots
            .iter()
            .zip(&group.simulation.crystal_ppm)
            .map(|(robot, ppm)| backend.build(robot.node, *ppm))
            .collect::<Result<_, _>>()?;
        let options = Options {
            threads: if matches!(backend, Backend::Native) {
                1
            } else {
                options.threads
            },
            ..options
        };
        Self::with_parts(group, robots, plant::build(group, options.start)?, options)
    }

    /// A world of the caller's own robots, in the order of the group file, on the caller's own plant.
    ///
    /// # Errors
    /// When there are not as many robots as the group has.
    pub fn with_parts(
        group: &GroupFile,
        robots: Vec<Box<dyn Robot>>,
        plant: Box<dyn Plant>,
        options: Options,
    ) -> Result<Self, SimError> {
        if robots.len() != group.robots.len() {
            let problem = format!(
                "{} robots for a group of {}",
                robots.len(),
                group.robots.len()
            );
            return Err(SimError::Plant { problem });
        }
        let units: Vec<Unit> = group
            .robots
            .iter()
            .zip(robots)
            .map(|(data, robot)| Unit {
                node: data.node,
                drives: robot.drives(),
                robot,
                motors: std::array::from_fn(|_| Motor::new(&data.motor)),
                encoders: [WheelEncoder::new(&data.encoder); 4],
                told: [0.0; 4],
                slipped: [0.0; 4],
                connected: true,
            })
            .collect();
        let threads = match options.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let threads = threads.min(units.len()).saturating_sub(1);
        Ok(Self {
            now_ns: 0,
            turned: vec![[0.0; 4]; units.len()],
            units,
            plant_at_ns: 0,
            plant_period_ns: plant.period_ns(),
            plant,
            bus: Bus::new(options.load_window_ns),
            ports: vec![PortQueues::default()],
            candump: None,
            truth: Vec::new(),
            truth_at: (0, 0),
            worst_shape_error_mm: 0.0,
            digest: Digest::default(),
            crew: (threads > 0).then(|| Crew::new(threads)),
            options,
        })
    }

    /// Virtual time.
    #[must_use]
    pub fn now(&self) -> Micros {
        Micros(self.now_ns / 1_000)
    }

    /// Virtual time, ns.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// Queues a frame at the master's port, behind those already there.
    pub fn send(&mut self, frame: Frame) {
        self.send_from(MASTER, frame);
    }

    /// The next frame that reaches the master's port up to `until`, with the time it was complete.
    /// Virtual time goes on while this waits, to `until` if nothing comes.
    ///
    /// # Errors
    /// When a robot or the plant stops; time stands still then.
    pub fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, SimError> {
        let until_ns = until.0.saturating_mul(1_000);
        loop {
            if let Some(received) = self.take_received(MASTER) {
                return Ok(Some(received));
            }
            if self.now_ns >= until_ns {
                return Ok(None);
            }
            self.step(until_ns)?;
        }
    }

    /// Lets time pass to `until`; what arrives waits at the ports.
    ///
    /// # Errors
    /// As [`World::receive`].
    pub fn run_until(&mut self, until: Micros) -> Result<(), SimError> {
        let until_ns = until.0.saturating_mul(1_000);
        while self.now_ns < until_ns {
            self.step(until_ns)?;
        }
        Ok(())
    }

    /// Another port, for a program beside the master.
    pub fn add_port(&mut self) -> Port {
        self.ports.push(PortQueues::default());
        Port(self.ports.len() - 1)
    }

    /// Queues a frame at a port.
    pub fn send_from(&mut self, port: Port, frame: Frame) {
        if let Some(queues) = self.ports.get_mut(port.0) {
            queues.send.push_back(frame);
        }
    }

    /// The next frame that has reached a port, if any.
    pub fn take_received(&mut self, port: Port) -> Option<(Micros, Frame)> {
        self.ports.get_mut(port.0)?.received.pop_front()
    }

    /// Writes every frame from now on into this log; give it a buffered writer.
    pub fn log_candump(&mut self, out: Box<dyn std::io::Write + Send>) {
        self.candump = Some(Candump::new(out));
    }

    /// Writes out what the log has buffered.
    ///
    /// # Errors
    /// The first error since the log was opened.
    pub fn finish_candump(&mut self) -> std::io::Result<()> {
        self.candump.as_mut().map_or(Ok(()), Candump::finish)
    }

    /// Load of the bus so far.
    #[must_use]
    pub fn bus_load(&self) -> BusLoad {
        self.bus.load(self.now_ns)
    }

    /// Frames sent so far.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.bus.frames()
    }

    /// The truth now.
    #[must_use]
    pub fn truth(&self) -> TruthSample {
        let (since_ns, busy_ns) = self.truth_at;
        let busy = self.bus.busy_ns(self.now_ns) - busy_ns;
        let since = self.now_ns - since_ns;
        TruthSample {
            time_ns: self.now_ns,
            group: self.plant.group(),
            shape_error_mm: self.plant.shape_error_mm(),
            bus_load: busy as f64 / since.max(1) as f64,
            robots: self
                .units
                .iter()
                .zip(self.plant.poses())
                .map(|(u, pose)| u.truth(*pose))
                .collect(),
        }
    }

    /// The samples since the last call, one every [`Options::truth_period_ns`].
    pub fn take_truth(&mut self) -> Vec<TruthSample> {
        std::mem::take(&mut self.truth)
    }

    /// Largest shape error of all plant steps since the beginning or the last reset, mm.
    #[must_use]
    pub fn worst_shape_error_mm(&self) -> f64 {
        self.worst_shape_error_mm
    }

    /// Begins a new search for the largest shape error.
    pub fn reset_worst_shape_error(&mut self) {
        self.worst_shape_error_mm = 0.0;
    }

    /// Presses or releases the emergency stop of a robot, by its place in the group file.
    pub fn set_emergency_stop(&mut self, robot: usize, pressed: bool) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.robot.set_emergency_stop(pressed);
        }
    }

    /// Raises or clears the driver fault of a robot.
    pub fn set_driver_fault(&mut self, robot: usize, fault: bool) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.robot.set_driver_fault(fault);
        }
    }

    /// Plugs or pulls the CAN connector of a robot.
    pub fn set_connected(&mut self, robot: usize, connected: bool) {
        if let Some(unit) = self.units.get_mut(robot) {
            unit.connected = connected;
        }
    }

    /// Log lines of all robots since the last call, each with its robot's node.
    pub fn take_logs(&mut self) -> Vec<(u8, LogLine)> {
        let lines = |u: &mut Unit| {
            let node = u.node;
            u.robot.take_log().into_iter().map(move |line| (node, line))
        };
        self.units.iter_mut().flat_map(lines).collect()
    }

    /// Instructions that all emulated processors have executed.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.units.iter().map(|u| u.robot.instructions()).sum()
    }

    /// A hash of every frame with its time and of every change of a bridge: equal runs, equal digests.
    #[must_use]
    pub fn digest(&self) -> u64 {
        self.digest.value()
    }

    /// One step of time, to `until_ns` at most.
    fn step(&mut self, until_ns: u64) -> Result<(), SimError> {
        if self.bus.is_free(self.now_ns) {
            self.arbitrate();
        }
        let end_ns = self.step_end(until_ns);
        let dt = (end_ns - self.now_ns) as f64 * 1e-9;
        for unit in &mut self.units {
            unit.turn(dt);
        }
        self.now_ns = end_ns;
        self.run_robots(end_ns)?;
        for unit in &mut self.units {
            if unit.look_at_bridges() {
                self.digest.bridges(end_ns, unit.node, &unit.drives);
            }
        }
        if end_ns - self.plant_at_ns >= self.plant_period_ns {
            self.step_plant()?;
        }
        if let Some(transfer) = self.bus.finish(end_ns) {
            self.deliver(&transfer);
        }
        Ok(())
    }

    /// Runs all robots to a time, heavy ones side by side if there are several.
    fn run_robots(&mut self, end_ns: u64) -> Result<(), SimError> {
        let heavy = |unit: &Unit| unit.robot.is_heavy(end_ns);
        let several = self.crew.is_some() && self.units.iter().filter(|u| heavy(u)).count() > 1;
        let mut away = Vec::new();
        for (place, unit) in self.units.iter_mut().enumerate() {
            if several && heavy(unit) {
                away.push((place, std::mem::replace(&mut unit.robot, Box::new(Absent))));
            } else {
                unit.robot.run_until(end_ns)?;
            }
        }
        match &self.crew {
            Some(crew) if several => {
                let units = &mut self.units;
                crew.run(away, end_ns, &mut |place, robot| units[place].robot = robot)
            }
            _ => Ok(()),
        }
    }

    /// The earliest moment at which something may happen that others can notice.
    fn step_end(&self, until_ns: u64) -> u64 {
        let mut end = until_ns
            .min(self.now_ns + self.options.motor_step_ns)
            .min(self.plant_at_ns + self.plant_period_ns);
        if let Some(at) = self.bus.transfer_end_ns() {
            end = end.min(at);
        } else if self.now_ns < self.bus.free_at_ns() {
            end = end.min(self.bus.free_at_ns());
        }
        for unit in &self.units {
            match unit.robot.wake() {
                Wake::Busy => end = end.min(self.now_ns + self.options.quantum_ns),
                Wake::At(at) => end = end.min(at),
                Wake::Never => {}
            }
        }
        // An event in the past is due now; time must still move for anything to run.
        end.max(self.now_ns + 1)
    }

    fn arbitrate(&mut self) {
        let ports = self.ports.iter().enumerate();
        let from_ports = ports.filter_map(|(n, port)| Some((n, *port.send.front()?)));
        let first = self.ports.len();
        let units = self.units.iter().enumerate().filter(|(_, u)| u.connected);
        let from_units = units.filter_map(|(n, u)| Some((first + n, u.robot.pending()?)));
        let Some(transfer) = self
            .bus
            .arbitrate(self.now_ns, from_ports.chain(from_units))
        else {
            return;
        };
        for (n, unit) in self.units.iter_mut().enumerate() {
            if first + n == transfer.sender {
                unit.robot.begin();
            } else if unit.connected && unit.robot.pending().is_some() {
                unit.robot.lost_arbitration();
            }
        }
    }

    fn deliver(&mut self, transfer: &Transfer) {
        let time = Micros(transfer.end_ns / 1_000);
        let first = self.ports.len();
        for (n, port) in self.ports.iter_mut().enumerate() {
            if n == transfer.sender {
                port.send.pop_front();
            } else {
                port.received.push_back((time, transfer.frame));
            }
        }
        for (n, unit) in self.units.iter_mut().enumerate() {
            if first + n == transfer.sender {
                unit.robot.transmitted();
            } else if unit.connected {
                unit.robot.receive(&transfer.frame);
            }
        }
        if let Some(log) = &mut self.candump {
            log.frame(transfer.end_ns, &transfer.frame);
        }
        self.digest.frame(transfer.end_ns, &transfer.frame);
    }

    fn step_plant(&mut self) -> Result<(), SimError> {
        let dt = (self.now_ns - self.plant_at_ns) as f64 * 1e-9;
        for (unit, turned) in self.units.iter_mut().zip(&mut self.turned) {
            *turned = unit.turned();
        }
        self.plant.step(dt, &self.turned)?;
        self.plant_at_ns = self.now_ns;
        for (robot, unit) in self.units.iter_mut().enumerate() {
            if let Some(angles) = self.plant.wheel_angles(robot) {
                unit.correct(angles);
            }
        }
        self.worst_shape_error_mm = self.worst_shape_error_mm.max(self.plant.shape_error_mm());
        let period = self.options.truth_period_ns;
        if period > 0 && self.now_ns.is_multiple_of(period) {
            self.truth.push(self.truth());
            self.truth_at = (self.now_ns, self.bus.busy_ns(self.now_ns));
        }
        Ok(())
    }
}

impl Unit {
    /// Turns the wheels for `dt` (s) and the encoders with them.
    fn turn(&mut self, dt: f64) {
        let mut counts = [0; 4];
        let wheels = self
            .motors
            .iter_mut()
            .zip(&mut self.encoders)
            .zip(&mut counts);
        for (((motor, encoder), count), (drive, slipped)) in
            wheels.zip(self.drives.iter().zip(&self.slipped))
        {
            motor.step(dt, *drive);
            *count = encoder.follow(motor.angle() + slipped);
        }
        if counts != [0; 4] {
            self.robot.turn_encoders(counts);
        }
    }

    /// Looks at the bridges; whether anything changed.
    fn look_at_bridges(&mut self) -> bool {
        let drives = self.robot.drives();
        std::mem::replace(&mut self.drives, drives) != drives
    }

    /// By how much the motors have turned the wheels since the plant was last told, rad.
    fn turned(&mut self) -> [f64; 4] {
        let angles = [0, 1, 2, 3].map(|n: usize| self.motors[n].angle());
        let told = std::mem::replace(&mut self.told, angles);
        std::array::from_fn(|n| angles[n] - told[n])
    }

    /// The plant says where the wheels really are.
    fn correct(&mut self, angles: [f64; 4]) {
        self.slipped = std::array::from_fn(|n| angles[n] - self.motors[n].angle());
    }

    fn truth(&self, pose: Pose<f64>) -> RobotTruth {
        let on = |drive: &Drive| if drive.enabled { drive.duty } else { 0.0 };
        RobotTruth {
            node: self.node,
            pose,
            wheel_angles: std::array::from_fn(|n| self.motors[n].angle() + self.slipped[n]),
            wheel_rates: WheelRates::from([0, 1, 2, 3].map(|n: usize| self.motors[n].rate())),
            duties: [0, 1, 2, 3].map(|n: usize| on(&self.drives[n])),
            drivers_enabled: self.drives.iter().any(|d| d.enabled),
            brake_released: self.drives.iter().any(|d| d.brake_released),
        }
    }
}
