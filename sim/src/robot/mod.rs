//! A robot as the world sees it: something with a CAN connection, four encoders and four motors.
//!
//! Two kinds. A *native* robot is the crate `robot` compiled for this machine; an *emulated* one is
//! the firmware's release image on an emulated processor. The world does not know which it has: it
//! delivers frames, turns encoders, reads the bridges, and lets time pass. Each robot has a clock
//! of its own behind this trait; all times here are bus time.

mod code;
pub mod emulated;
pub mod native;
mod program_flash;

use canopen::Frame;
use emulator::GyroDefect;
use group::Driver;

use crate::bus::errors::{ErrorCounters, ErrorState, TransmitError};
use crate::encoder::wires::Edge;
use crate::error::SimError;
use crate::motor::Bridge;
use crate::smart_drive::DriveChange;
use crate::world::index::Pulse;

/// When a robot next does something by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wake {
    /// It is computing and has to run in short steps.
    Busy,
    /// It sleeps until this time, ns, unless something from outside wakes it.
    At(u64),
    /// It sleeps until something from outside wakes it.
    Never,
}

/// A line of a robot's log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// The robot's own clock, us.
    pub time_us: u64,
    /// `error`, `warn`, `info`, `debug`, `trace`.
    pub level: String,
    /// What it says.
    pub text: String,
}

/// Failures of a robot's program. All but the first occur while the processor sleeps, that is, in
/// its lowest priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crash {
    /// It jumps to an address without memory.
    Nowhere,
    /// It panics.
    Panic,
    /// Its stack has no room left for the next interrupt.
    StackOverflow,
    /// Its thread mode loops without end; interrupts keep running.
    Loop,
}

/// One robot.
pub trait Robot: Send {
    /// Runs the robot until this time, ns; never backward.
    ///
    /// # Errors
    /// When it cannot continue.
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError>;

    /// When it next does something by itself.
    fn wake(&self) -> Wake;

    /// Whether it reads its wheels and changes its bridges only at the times [`wake`](Self::wake)
    /// names, so that it need not be run between them. Then [`set_now`](Self::set_now) tells it the
    /// time.
    fn is_lazy(&self) -> bool {
        false
    }

    /// It is this late, ns, and nothing of its own is due.
    fn set_now(&mut self, time_ns: u64) {
        let _ = time_ns;
    }

    /// The frame it would send first.
    fn pending(&self) -> Option<Frame>;

    /// The pending frame has won arbitration and is on the wire: nothing overtakes it any more.
    fn begin(&mut self) {}

    /// The pending frame has been sent and acknowledged.
    fn transmitted(&mut self);

    /// The pending frame lost arbitration; it stays pending.
    fn lost_arbitration(&mut self);

    /// A frame of another node has just ended.
    fn receive(&mut self, frame: &Frame);

    /// Its frame on the wire was destroyed. It stays pending, unless that took the robot off the
    /// bus.
    fn transmit_failed(&mut self, error: TransmitError) {
        let _ = error;
    }

    /// A frame of another node was destroyed; `first`: by this robot.
    fn receive_failed(&mut self, first: bool) {
        let _ = first;
    }

    /// The error state of its CAN controller, and its error counters.
    fn error_state(&self) -> (ErrorState, ErrorCounters) {
        Default::default()
    }

    /// The state of its bridges: front left, front right, rear left, rear right.
    fn drives(&self) -> [Bridge; 4];

    /// Exchanges its motor driver.
    fn wire_driver(&mut self, driver: Driver) {
        let _ = driver;
    }

    /// The wheels are turned by the smart drives that a group file gives this robot, if it does.
    fn wire_smart_drives(&mut self, robot: &group::Robot) {
        let _ = robot;
    }

    /// Something happens to the smart drive of a wheel.
    fn change_smart_drive(&mut self, wheel: usize, change: DriveChange) {
        let _ = (wheel, change);
    }

    /// Whether its board has a gyro.
    fn has_gyro(&self) -> bool {
        false
    }

    /// Its gyro, if it has one, measures this rate about the axis that points up, rad/s.
    fn set_yaw_rate(&mut self, rate: f64) {
        let _ = rate;
    }

    /// Something is wrong with its gyro, or no more.
    fn set_gyro_defect(&mut self, defect: Option<GyroDefect>) {
        let _ = defect;
    }

    /// The wheels turn at these rates, rad/s: for drives that measure them.
    fn set_wheel_rates(&mut self, rates: [f64; 4]) {
        let _ = rates;
    }

    /// The wheels went on by this many encoder counts.
    fn turn_encoders(&mut self, counts: [i32; 4]);

    /// The wires of a wheel's encoder change their levels at these times, which are in order;
    /// `false` when it takes counts only.
    fn encoder_edges(&mut self, wheel: usize, edges: &[Edge]) -> bool {
        let _ = (wheel, edges);
        false
    }

    /// The index of a wheel has pulsed.
    fn index(&mut self, wheel: usize, pulse: Pulse) {
        let _ = (wheel, pulse);
    }

    /// Presses or releases the emergency stop.
    fn set_emergency_stop(&mut self, pressed: bool);

    /// Opens or closes the contact of the protective stop.
    fn set_protective_stop(&mut self, open: bool) {
        let _ = open;
    }

    /// Raises or clears the motor driver's fault line.
    fn set_driver_fault(&mut self, fault: bool);

    /// Changes the voltage at its supply input, V.
    fn set_supply(&mut self, volts: f64) {
        let _ = volts;
    }

    /// Changes the voltages at its current sensors' inputs, V.
    fn set_current_inputs(&mut self, volts: [f64; 3]) {
        let _ = volts;
    }

    /// Switches its power off or on. Without power it neither sends nor receives, its bridges are
    /// off and its brake is engaged; with it, it starts like a robot that has just been switched
    /// on, with what its flash holds. What is pressed or pulled stays so.
    fn set_power(&mut self, on: bool);

    /// Fails to send until its CAN controller is off the bus; `false` when it has nothing to send.
    fn force_bus_off(&mut self) -> bool {
        false
    }

    /// Gets more frames at once than its CAN controller holds.
    fn overrun(&mut self) {}

    /// Halts or resumes its processor; `false` when it has none.
    fn halt(&mut self, halted: bool) -> bool {
        let _ = halted;
        false
    }

    /// Makes its program fail; `false` when it has no processor, or when its program is at a place
    /// where this is impossible.
    fn crash(&mut self, how: Crash) -> bool {
        let _ = how;
        false
    }

    /// Begins to record when its outputs change.
    fn start_trace(&mut self) {}

    /// When the duty of its front left wheel changed since the last call, ns.
    fn take_duty_changes(&mut self) -> Vec<u64> {
        Vec::new()
    }

    /// Log lines since the last call.
    fn take_log(&mut self) -> Vec<LogLine> {
        Vec::new()
    }

    /// Puts bytes on the line into its serial port, from a sender with this baud rate; without a
    /// processor they are lost.
    fn send_cable(&mut self, bytes: &[u8], baud: f64) {
        let _ = (bytes, baud);
    }

    /// The other end of the line into its serial port lets go of it, so that it stays at this
    /// level, or drives it again.
    fn release_cable(&mut self, level: Option<bool>) {
        let _ = level;
    }

    /// Takes the bytes that its serial port has sent, each with the time at which it ended, ns
    /// since it was switched on.
    fn take_cable(&mut self) -> Vec<(u64, u8)> {
        Vec::new()
    }

    /// Its emulated board, if it has one.
    fn board(&mut self) -> Option<&mut emulator::Board> {
        None
    }

    /// Instructions its processor has executed, if it has one.
    fn instructions(&self) -> u64 {
        0
    }

    /// The same robot in the same state, which goes on by itself, if there can be one.
    fn try_clone(&self) -> Option<Box<dyn Robot>> {
        None
    }
}

/// What the robots of a world are.
#[derive(Debug, Clone)]
pub enum Backend {
    /// The crate `robot`, compiled for this machine.
    Native,
    /// This image, on an emulated processor each.
    Emulator(emulator::Firmware),
    /// These images; a robot runs the one for its board and its drives.
    Images(Vec<emulator::Firmware>),
}

impl Backend {
    /// A robot with this node and crystal error, just switched on.
    ///
    /// # Errors
    /// When there can be no robot with this node.
    pub fn build(&self, node: u8, crystal_ppm: f64) -> Result<Box<dyn Robot>, SimError> {
        Ok(match self {
            Self::Native => Box::new(native::NativeRobot::new(node, crystal_ppm)?),
            Self::Emulator(firmware) => {
                Box::new(emulated::EmulatedRobot::new(firmware, node, crystal_ppm)?)
            }
            Self::Images(_) => {
                let problem = "its board is not known".to_owned();
                return Err(SimError::Robot { node, problem });
            }
        })
    }

    /// The same with the image for the board and the drives that a group file gives the robot.
    ///
    /// # Errors
    /// As [`Backend::build`], and when no image is for this robot.
    pub fn build_for(
        &self,
        robot: &group::Robot,
        crystal_ppm: f64,
    ) -> Result<Box<dyn Robot>, SimError> {
        match self {
            Self::Images(images) => {
                let image = images.iter().find(|image| emulated::is_for(image, robot));
                let image = image.ok_or_else(|| SimError::Robot {
                    node: robot.node,
                    problem: format!(
                        "no image is for its board ({:?}) and drives ({:?})",
                        robot.board, robot.output.kind
                    ),
                })?;
                Self::Emulator(image.clone()).build(robot.node, crystal_ppm)
            }
            _ => self.build(robot.node, crystal_ppm),
        }
    }
}
