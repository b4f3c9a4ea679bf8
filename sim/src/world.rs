//! The world: robots, their motors, the floor and the bus, in one virtual time.
//!
//! Time advances in steps that end at the next event and are never longer than
//! [`Options::motor_step_ns`]. A step ends at the earliest of: the end of the frame on the bus, the
//! moment the bus is free for a waiting frame, a robot's next own event, the next plant step, and,
//! while any robot computes, one [`Options::quantum_ns`]. In a step the motors turn with the last
//! state of the bridges and the encoders follow; then the robots run, in order; then due events of
//! the plant and the bus are processed. A robot that wakes therefore reads the encoders of that
//! time, and its changes act from the end of the step on, at most one quantum later than in
//! reality. Native robots sleep between their own events. They read wheels and change bridges only
//! at these events, so their motors are only stepped up to those times and to the plant's steps,
//! and their encoders follow only then, unless something is wrong with one.
//!
//! Robots may run in parallel within a step; everything else runs in one thread in a fixed order.
//! The same group, backend and calls therefore give the same bytes on any number of threads;
//! [`World::digest`] is a checksum of them.
//!
//! The master's frames wait in a queue without limit, in order; a master that sends more than the
//! bus carries sees its own delay grow. Frames for a port wait until they are taken.

mod cable;
mod fault_injection;
pub mod index;
mod nodes;
mod ports;
mod unit;

use canopen::{Frame, Micros};
use group::{GroupFile, Gyro};
use kinematics::Pose;

pub use self::unit::Cable;
use crate::bus::candump::Candump;
use crate::bus::disturb::Disturbances;
use crate::bus::{Bus, BusLoad};
use crate::digest::Digest;
pub use crate::encoder::EncoderState;
use crate::error::SimError;
use crate::gyro::{GyroSample, Gyros};
use crate::plant::{self, Plant};
use crate::robot::{Backend, LogLine, Robot, Wake};
use crate::truth::{NoisyPoses, TruthSample};
use ports::PortQueues;
use unit::Unit;

/// Steps and periods, all in ns of virtual time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Longest time for which a computing robot runs at once.
    pub quantum_ns: u64,
    /// Longest step of the motors.
    pub motor_step_ns: u64,
    /// Period of truth samples, a multiple of the plant's; 0 keeps none.
    pub truth_period_ns: u64,
    /// Length of the windows of the bus load.
    pub load_window_ns: u64,
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

/// Robots, motors, floor and bus in one virtual time. The essay at the head of this file describes
/// its steps.
pub struct World {
    now_ns: u64,
    /// The robot whose cable programs use instead of the bus.
    adapter: Option<u8>,
    options: Options,
    units: Vec<Unit>,
    /// The places of those that have something to do in this step.
    due: Vec<usize>,
    /// No robot has a connector pulled, a cable broken before it, or frames that are delayed; false
    /// after every change of these, until the nodes are looked at.
    all_connected: bool,
    plant: Box<dyn Plant>,
    plant_at_ns: u64,
    plant_period_ns: u64,
    bus: Bus,
    /// The half of a parted bus where the master is not.
    far: Bus,
    disturbances: Disturbances,
    /// Delay of frames sent by the ports, ns.
    port_delay_ns: u64,
    /// Error-passive nodes that have just sent, and until when each lets others go first.
    suspended: Vec<(usize, u64)>,
    ports: Vec<PortQueues>,
    candump: Option<Candump>,
    truth: Vec<TruthSample>,
    noisy_poses: NoisyPoses,
    /// Parameters of the robots' gyros, and the gyros themselves once they are read.
    gyro: (Gyro, u64),
    gyros: Option<Gyros>,
    /// Those on the robots' boards.
    board_gyros: Option<Gyros>,
    /// Time of the last sample, and how long the bus had been taken then.
    truth_at: (u64, u64),
    worst_shape_error_mm: f64,
    digest: Digest,
    turned: Vec<[f64; 4]>,
    /// Encoders still to break, the last first: when (ns), whose, which, how.
    breaking: Vec<(u64, usize, usize, EncoderState)>,
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
            .map(|(robot, ppm)| backend.build_for(robot, *ppm))
            .collect::<Result<_, _>>()?;
        Self::with_parts(group, robots, plant::build(group, options.start)?, options)
    }

    /// A world of the caller's own robots, in the order of the group file, on the caller's own
    /// plant.
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
        let mut units: Vec<Unit> = group
            .robots
            .iter()
            .zip(robots)
            .enumerate()
            .map(|(place, (data, robot))| Unit::new(place, data, robot, &group.simulation))
            .collect();
        set_inertia(&mut units, plant.wheel_inertia());
        let has_gyro = units.iter().any(|unit| unit.robot.has_gyro());
        let board_gyros = has_gyro.then(|| Gyros::on_boards(&group.simulation, plant.poses()));
        Ok(Self {
            now_ns: 0,
            adapter: None,
            turned: vec![[0.0; 4]; units.len()],
            due: Vec::with_capacity(units.len()),
            all_connected: false,
            breaking: unit::breaking(&group.simulation.encoder_faults),
            units,
            plant_at_ns: 0,
            plant_period_ns: plant.period_ns(),
            plant,
            bus: Bus::new(options.load_window_ns),
            far: Bus::new(options.load_window_ns),
            disturbances: Disturbances::new(group.simulation.seed),
            port_delay_ns: 0,
            suspended: Vec::new(),
            ports: vec![PortQueues::default()],
            candump: None,
            truth: Vec::new(),
            noisy_poses: NoisyPoses::new(group.simulation.pose_noise, group.simulation.seed),
            gyro: (group.simulation.gyro, group.simulation.seed),
            gyros: None,
            board_gyros,
            truth_at: (0, 0),
            worst_shape_error_mm: 0.0,
            digest: Digest::default(),
            options,
        })
    }

    /// A second world in the same state, which goes on by itself: with the same calls from now on
    /// both do the same, to the bit. It writes no log. `None` with a plant outside, or with a robot
    /// of the caller's own that has no copy.
    #[must_use]
    pub fn try_clone(&self) -> Option<Self> {
        Some(Self {
            units: self
                .units
                .iter()
                .map(Unit::try_clone)
                .collect::<Option<_>>()?,
            due: self.due.clone(),
            plant: self.plant.try_clone()?,
            bus: self.bus.clone(),
            far: self.far.clone(),
            disturbances: self.disturbances.clone(),
            suspended: self.suspended.clone(),
            ports: self.ports.clone(),
            candump: None,
            truth: self.truth.clone(),
            noisy_poses: self.noisy_poses.clone(),
            gyros: self.gyros.clone(),
            board_gyros: self.board_gyros.clone(),
            digest: self.digest.clone(),
            turned: self.turned.clone(),
            breaking: self.breaking.clone(),
            ..*self
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
    /// Virtual time advances while this waits, to `until` if no frame arrives.
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
                self.turn_wheels();
                return Ok(None);
            }
            self.step(until_ns)?;
        }
    }

    /// Advances time to `until`; received frames wait at the ports.
    ///
    /// # Errors
    /// As [`World::receive`].
    pub fn run_until(&mut self, until: Micros) -> Result<(), SimError> {
        let until_ns = until.0.saturating_mul(1_000);
        while self.now_ns < until_ns {
            self.step(until_ns)?;
        }
        self.turn_wheels();
        Ok(())
    }

    /// Another port, for a program beside the master.
    pub fn add_port(&mut self) -> Port {
        self.ports.push(PortQueues::default());
        Port(self.ports.len() - 1)
    }

    /// Queues a frame at a port.
    pub fn send_from(&mut self, port: Port, frame: Frame) {
        self.send_at(port, self.now_ns, frame);
    }

    /// Queues a frame at a port, behind those already there; it is ready to be sent from this time
    /// on, ns.
    pub fn send_at(&mut self, port: Port, at_ns: u64, frame: Frame) {
        if let Some(queues) = self.ports.get_mut(port.0) {
            queues.send.push_back((at_ns + self.port_delay_ns, frame));
        }
    }

    /// Spreads the frames that were queued just now over as much time from now on. For a computer
    /// that was late by `over_ns` and learns of them together: they came one after the other during
    /// that time, so that is how they go onto the bus.
    pub fn spread_queued(&mut self, over_ns: u64) {
        let ready_ns = self.now_ns + self.port_delay_ns;
        for queues in &mut self.ports {
            queues.spread(ready_ns, over_ns);
        }
    }

    /// Sets whether received frames are kept at a port. A new port keeps them; a port that does not
    /// still acknowledges frames.
    pub fn set_listening(&mut self, port: Port, listening: bool) {
        if let Some(queues) = self.ports.get_mut(port.0) {
            queues.deaf = !listening;
            if queues.deaf {
                queues.received.clear();
            }
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
        self.bus.frames() + self.far.frames()
    }

    /// Error frames so far.
    #[must_use]
    pub fn error_frames(&self) -> u64 {
        self.bus.error_frames() + self.far.error_frames()
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

    /// The same samples as an observer sees them, with the noise of the group file on every pose.
    pub fn take_observed(&mut self) -> Vec<TruthSample> {
        let truth = self.take_truth();
        truth.into_iter().map(|s| self.noisy_poses.see(s)).collect()
    }

    /// The samples of the robots' gyros that have come since the last call. The first call switches
    /// them on.
    pub fn take_gyros(&mut self) -> Vec<GyroSample> {
        let (kind, seed) = self.gyro;
        let poses = self.plant.poses();
        let gyros = self
            .gyros
            .get_or_insert_with(|| Gyros::new(kind, seed, poses));
        gyros.take(self.now_ns)
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

    /// Time since which a robot's bridges have been off and its brake commanded to engage, ns, by
    /// its position in the group file.
    #[must_use]
    pub fn safe_since_ns(&self, robot: usize) -> Option<u64> {
        self.units.get(robot)?.safe_since_ns
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

    /// The emulated board of a robot, for a debugger or a trace.
    pub fn board(&mut self, node: u8) -> Option<&mut emulator::Board> {
        self.units
            .iter_mut()
            .find(|u| u.node == node)?
            .robot
            .board()
    }

    /// A hash of every frame with its time and of every change of a bridge: equal runs, equal
    /// digests.
    #[must_use]
    pub fn digest(&self) -> u64 {
        self.digest.value()
    }

    /// One step of time, to `until_ns` at most.
    fn step(&mut self, until_ns: u64) -> Result<(), SimError> {
        self.look_at_nodes();
        if self.bus.is_free(self.now_ns) {
            self.arbitrate(false);
        }
        if self.is_parted() && self.far.is_free(self.now_ns) {
            self.arbitrate(true);
        }
        let end_ns = self.step_end(until_ns);
        self.now_ns = end_ns;
        let step_ns = self.options.motor_step_ns;
        self.due.clear();
        for (place, unit) in self.units.iter_mut().enumerate() {
            if unit.is_due(end_ns) {
                unit.turn_to(end_ns, step_ns);
                self.due.push(place);
            }
        }
        self.break_encoders();
        self.run_robots(end_ns)?;
        for place in &self.due {
            let unit = &mut self.units[*place];
            let node = unit.node;
            if let Some(drives) = unit.look_at_bridges(end_ns) {
                self.digest.bridges(end_ns, node, drives);
            }
            unit.has_run();
        }
        if end_ns - self.plant_at_ns >= self.plant_period_ns {
            self.step_plant()?;
        }
        if let Some(transfer) = self.bus.finish(end_ns) {
            self.deliver(&transfer, false);
        }
        if let Some(transfer) = self.far.finish(end_ns) {
            self.deliver(&transfer, true);
        }
        Ok(())
    }

    /// Turns all wheels up to now.
    fn turn_wheels(&mut self) {
        // A motor's steps wait for each other, but the processor turns the motors of several robots
        // at the same time.
        for unit in &mut self.units {
            unit.turn_motors(self.now_ns, self.options.motor_step_ns);
        }
        for unit in &mut self.units {
            unit.turn_wheels();
        }
    }

    /// Runs the robots that are due to a time.
    fn run_robots(&mut self, end_ns: u64) -> Result<(), SimError> {
        for place in &self.due {
            self.units[*place].robot.run_until(end_ns)?;
        }
        Ok(())
    }

    /// The earliest moment at which something may happen that others can notice.
    fn step_end(&self, until_ns: u64) -> u64 {
        let mut end = until_ns.min(self.plant_at_ns + self.plant_period_ns);
        if let Some((at, ..)) = self.breaking.last() {
            end = end.min(*at);
        }
        for bus in [&self.bus, &self.far] {
            if let Some(at) = bus.transfer_end_ns() {
                end = end.min(at);
            } else if self.now_ns < bus.free_at_ns() {
                end = end.min(bus.free_at_ns());
            }
        }
        for unit in &self.units {
            if !unit.is_lazy() {
                end = end.min(self.now_ns + self.options.motor_step_ns);
            }
            match unit.wake() {
                Wake::Busy => end = end.min(self.now_ns + self.options.quantum_ns),
                Wake::At(at) => end = end.min(at),
                Wake::Never => {}
            }
        }
        end = end.min(self.next_of_nodes());
        // An event in the past is due now; time must still move for anything to run.
        end.max(self.now_ns + 1)
    }

    fn step_plant(&mut self) -> Result<(), SimError> {
        let dt = (self.now_ns - self.plant_at_ns) as f64 * 1e-9;
        self.turn_wheels();
        for (unit, turned) in self.units.iter_mut().zip(&mut self.turned) {
            *turned = unit.turned();
        }
        let known = self.plant.wheel_inertia();
        for (robot, unit) in self.units.iter().enumerate() {
            self.plant.drive(robot, unit.motors.torques());
        }
        self.plant.step(dt, &self.turned)?;
        self.plant_at_ns = self.now_ns;
        // A plant outside says it with its first answer.
        let inertia = self.plant.wheel_inertia();
        if inertia != known {
            set_inertia(&mut self.units, inertia);
        }
        let coupled = inertia.is_some();
        for (robot, unit) in self.units.iter_mut().enumerate() {
            if coupled {
                unit.push_wheels(self.plant.floor_torques(robot));
            }
            if let Some(angles) = self.plant.wheel_angles(robot) {
                unit.correct(angles);
            }
        }
        self.worst_shape_error_mm = self.worst_shape_error_mm.max(self.plant.shape_error_mm());
        if let Some(gyros) = &mut self.gyros {
            gyros.follow(self.now_ns, self.plant.poses());
        }
        if let Some(gyros) = &mut self.board_gyros {
            gyros.follow(self.now_ns, self.plant.poses());
            for sample in gyros.take(self.now_ns) {
                let robots = self.units.iter_mut().map(|unit| &mut unit.robot);
                for (robot, rate) in robots.zip(sample.rates) {
                    robot.set_yaw_rate(rate);
                }
            }
        }
        let period = self.options.truth_period_ns;
        if period > 0 && self.now_ns.is_multiple_of(period) {
            self.truth.push(self.truth());
            self.truth_at = (self.now_ns, self.bus.busy_ns(self.now_ns));
        }
        Ok(())
    }
}

/// What turns with each wheel, where the plant says so; else the motors know it.
fn set_inertia(units: &mut [Unit], inertia: Option<f64>) {
    if let Some(inertia) = inertia {
        let motors = units.iter_mut().map(|unit| &mut unit.motors);
        motors.for_each(|motors| motors.set_inertia(inertia));
    }
}
