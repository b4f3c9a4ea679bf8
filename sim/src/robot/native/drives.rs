//! The smart drives of a native robot, and what the firmware's driver does between them and the
//! control side.
//!
//! The drives and their bus are those of emulated robots ([`DriveBus`]). In place of the second CAN
//! controller there is one mailbox, in which a new command replaces one that still waits, and what
//! the drives report goes to the control side's own code ([`Drives`]).

use canopen::Frame;
use control::rollers::IndexPulse;
use control::smart_drive::frames::{COMMAND, Model, command};
use control::smart_drive::index::IndexEdge;
use control::smart_drive::{DriveConfiguration, Drives};
use control::time::Micros;
use protocol::Fault;

use super::Clock;
use crate::motor::Bridge;
use crate::smart_drive::{Connector, DriveBus, DriveChange};

/// The robot's end of the drives' bus.
#[derive(Clone, Default)]
struct Controller {
    waiting: Option<Frame>,
    sending: Option<Frame>,
    received: Option<Frame>,
}

impl Connector for Controller {
    fn pending(&self) -> Option<Frame> {
        self.waiting
    }

    fn begin(&mut self) -> Option<Frame> {
        self.sending = self.waiting.take();
        self.sending
    }

    fn lost_arbitration(&mut self) {}

    fn transmitted(&mut self) {
        self.sending = None;
    }

    fn receive(&mut self, frame: &Frame, _: u32) {
        self.received = Some(*frame);
    }
}

/// See the [module](self).
#[derive(Clone)]
pub(super) struct SmartDrives {
    bus: DriveBus,
    controller: Controller,
    seen: Drives,
    wheels: DriveConfiguration,
    model: Model,
    /// Counts since the last frame.
    counts: [i32; 4],
    /// The last edges of the wheels' indexes.
    edges: [IndexEdge; 4],
    /// Rates of the wheels, rad/s.
    pub rates: [f64; 4],
    /// Supply voltage, V.
    pub supply: f64,
}

impl SmartDrives {
    /// The drives of a robot that is switched on now, if it has such.
    pub fn new(robot: &group::Robot, now_ns: u64) -> Option<Self> {
        Some(Self {
            bus: DriveBus::new(robot, now_ns)?,
            controller: Controller::default(),
            seen: Drives::new(),
            wheels: DriveConfiguration::DEFAULT,
            model: Model::C620,
            counts: [0; 4],
            edges: [IndexEdge::default(); 4],
            rates: [0.0; 4],
            supply: robot.motor.supply.into(),
        })
    }

    /// Switches the robot and its drives on again; the wheels turn as before.
    pub fn restart(&mut self, robot: &group::Robot, now_ns: u64) {
        let (rates, supply) = (self.rates, self.supply);
        if let Some(fresh) = Self::new(robot, now_ns) {
            *self = Self {
                rates,
                supply,
                ..fresh
            };
        }
    }

    pub fn configure(&mut self, wheels: DriveConfiguration, model: Model) {
        self.wheels = wheels;
        self.model = model;
    }

    /// Something happens to the drive of a wheel.
    pub fn change(&mut self, wheel: usize, change: DriveChange) {
        self.bus.change(wheel, change);
    }

    pub fn turn(&mut self, counts: [i32; 4]) {
        for (sum, counts) in self.counts.iter_mut().zip(counts) {
            *sum += counts;
        }
    }

    /// The index of a wheel has pulsed at a local time.
    pub fn index(&mut self, wheel: usize, at: Micros) {
        if let Some(edge) = self.edges.get_mut(wheel) {
            edge.number = edge.number.wrapping_add(1);
            edge.at_us = at.0 as u16;
        }
    }

    /// The index pulses of the wheels.
    pub fn index_pulses(&self, now: Micros) -> [IndexPulse; 4] {
        self.seen.index_pulses(&self.wheels, &self.edges, now)
    }

    pub fn next_event_ns(&self) -> u64 {
        self.bus.next_event_ns()
    }

    /// Runs the bus up to a time, at which the wheels have turned by what was said.
    pub fn run(&mut self, time_ns: u64, clock: Clock) {
        self.bus
            .turn(std::mem::take(&mut self.counts), self.rates, time_ns);
        loop {
            let at = self.bus.next_event_ns().min(time_ns);
            self.bus.run(at, &mut self.controller);
            let received = self.controller.received.take();
            // Before the program runs nothing takes it.
            if let Some(frame) = received.filter(|_| at >= clock.boot_ns) {
                self.seen
                    .on_frame(frame.id(), frame.data(), clock.local(at));
            }
            if self.bus.next_event_ns() > time_ns {
                return;
            }
        }
    }

    /// The counts of the wheels, and what is wrong with their drives.
    pub fn read(&self, now: Micros) -> ([u16; 4], Option<Fault>) {
        let (seen, wheels) = (&self.seen, &self.wheels);
        (seen.counts(wheels, now), seen.fault(wheels, now))
    }

    /// The temperature of the hottest motor, degrees Celsius.
    pub fn temperature(&self) -> u8 {
        self.seen.temperature(&self.wheels)
    }

    /// Commands the currents of the wheels, A; where the drivers are disabled, none.
    pub fn send(&mut self, currents: [f32; 4], enabled: bool) {
        let mut by_identifier = [0.0; 4];
        if enabled {
            for (identifier, current) in self.wheels.identifiers.into_iter().zip(currents) {
                let place = usize::from(identifier).wrapping_sub(1);
                if let Some(place) = by_identifier.get_mut(place) {
                    *place = current;
                }
            }
        }
        self.controller.waiting = Frame::new(COMMAND, &command(self.model, by_identifier));
    }

    /// What the motors get.
    pub fn bridges(&self, brake_released: bool) -> [Bridge; 4] {
        self.bus.bridges(self.rates, self.supply, brake_released)
    }
}
