//! An emulated robot that the world runs and that the measurement can inspect.
//!
//! The world owns its robots; this type is a handle, of which the world gets one and the
//! measurement keeps another. The robot runs exactly as without it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Context as _;
use canopen::Frame;
use emulator::profile::Profile;
use emulator::{Board, Firmware};
use sim::SimError;
use sim::motor::Bridge;
use sim::robot::emulated::EmulatedRobot;
use sim::robot::{LogLine, Robot, Wake};

/// See the [module](self).
#[derive(Clone)]
pub struct Watched(Arc<Mutex<Inner>>);

struct Inner {
    robot: EmulatedRobot,
    received: Vec<Received>,
}

/// A frame that the robot was given.
#[derive(Clone, Copy)]
pub struct Received {
    /// Core cycle since power-on.
    pub at: u64,
    /// Its identifier.
    pub id: u16,
}

impl Watched {
    /// A robot just switched on.
    pub fn new(firmware: &Firmware, node: u8, crystal_ppm: f64) -> Result<Self, SimError> {
        let robot = EmulatedRobot::new(firmware, node, crystal_ppm)?;
        Ok(Self(Arc::new(Mutex::new(Inner {
            robot,
            received: Vec::new(),
        }))))
    }

    /// Looks at the board or changes something about it.
    pub fn board<T>(&self, f: impl FnOnce(&mut Board) -> T) -> T {
        f(self.lock().robot.board_mut())
    }

    /// Profiles it from now on, call by call of the functions at these addresses.
    pub fn start_profile(&self, functions: &[u32]) {
        self.board(|board| {
            board.start_profile();
            if let Some(profile) = board.profile() {
                for function in functions {
                    profile.watch(*function);
                }
            }
        });
    }

    /// What has been profiled since.
    pub fn take_profile(&self) -> anyhow::Result<Profile> {
        self.board(Board::take_profile)
            .context("the robot has not been profiled")
    }

    /// The frames it has been given, in order.
    pub fn received(&self) -> Vec<Received> {
        self.lock().received.clone()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing is left half-done when a measurement panics.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Robot for Watched {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        self.lock().robot.run_until(time_ns)
    }

    fn wake(&self) -> Wake {
        self.lock().robot.wake()
    }

    fn pending(&self) -> Option<Frame> {
        self.lock().robot.pending()
    }

    fn begin(&mut self) {
        self.lock().robot.begin();
    }

    fn transmitted(&mut self) {
        self.lock().robot.transmitted();
    }

    fn lost_arbitration(&mut self) {
        self.lock().robot.lost_arbitration();
    }

    fn receive(&mut self, frame: &Frame) {
        let mut inner = self.lock();
        let received = Received {
            at: inner.robot.board_mut().cycles().0,
            id: frame.id(),
        };
        inner.received.push(received);
        inner.robot.receive(frame);
    }

    fn drives(&self) -> [Bridge; 4] {
        self.lock().robot.drives()
    }

    fn turn_encoders(&mut self, counts: [i32; 4]) {
        self.lock().robot.turn_encoders(counts);
    }

    fn wire_driver(&mut self, driver: group::Driver) {
        self.lock().robot.wire_driver(driver);
    }

    fn set_emergency_stop(&mut self, pressed: bool) {
        self.lock().robot.set_emergency_stop(pressed);
    }

    fn set_protective_stop(&mut self, open: bool) {
        self.lock().robot.set_protective_stop(open);
    }

    fn set_driver_fault(&mut self, fault: bool) {
        self.lock().robot.set_driver_fault(fault);
    }

    fn set_power(&mut self, on: bool) {
        self.lock().robot.set_power(on);
    }

    fn send_cable(&mut self, bytes: &[u8], baud: f64) {
        self.lock().robot.send_cable(bytes, baud);
    }

    fn take_cable(&mut self) -> Vec<(u64, u8)> {
        self.lock().robot.take_cable()
    }

    fn start_trace(&mut self) {
        self.lock().robot.start_trace();
    }

    fn take_duty_changes(&mut self) -> Vec<u64> {
        self.lock().robot.take_duty_changes()
    }

    fn take_log(&mut self) -> Vec<LogLine> {
        self.lock().robot.take_log()
    }

    fn instructions(&self) -> u64 {
        self.lock().robot.instructions()
    }
}
