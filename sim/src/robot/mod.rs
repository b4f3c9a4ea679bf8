//! A robot as the world sees it: something with a CAN connection, four encoders and four motors.
//!
//! Two kinds. A *native* robot is the controller crate compiled for this machine; an *emulated* one is
//! the firmware's release image on an emulated processor. The world does not know which it has: it
//! delivers frames, turns encoders, reads the bridges, and lets time pass. Each robot has a clock of its
//! own behind this trait; all times here are bus time.

pub mod emulated;
pub mod native;

use canopen::Frame;

use crate::error::SimError;
use crate::motor::Drive;

/// When a robot next does something by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wake {
    /// It is computing: let it run in short steps.
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

/// One robot.
pub trait Robot: Send {
    /// Lets the robot run until this time, ns; never backwards.
    ///
    /// # Errors
    /// When it cannot go on.
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError>;

    /// When it next does something by itself.
    fn wake(&self) -> Wake;

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

    /// What its outputs do to the motors: front left, front right, rear left, rear right.
    fn drives(&self) -> [Drive; 4];

    /// The wheels went on by this many encoder counts.
    fn turn_encoders(&mut self, counts: [i32; 4]);

    /// Presses or releases the emergency stop.
    fn set_emergency_stop(&mut self, pressed: bool);

    /// Raises or clears the motor driver's fault line.
    fn set_driver_fault(&mut self, fault: bool);

    /// Fails to send until its CAN controller is off the bus; `false` when it has nothing to send.
    fn force_bus_off(&mut self) -> bool {
        false
    }

    /// Gets more frames at once than its CAN controller holds.
    fn overrun(&mut self) {}

    /// Halts its processor or lets it go on; `false` when it has none.
    fn halt(&mut self, halted: bool) -> bool {
        let _ = halted;
        false
    }

    /// Sends its processor where there is no memory; `false` when it has none.
    fn crash(&mut self) -> bool {
        false
    }

    /// Log lines since the last call.
    fn take_log(&mut self) -> Vec<LogLine> {
        Vec::new()
    }

    /// Whether running it to this time takes long enough to be worth a thread of its own.
    fn is_heavy(&self, until_ns: u64) -> bool {
        let _ = until_ns;
        false
    }

    /// Instructions its processor has executed, if it has one.
    fn instructions(&self) -> u64 {
        0
    }
}

/// What the robots of a world are.
#[derive(Debug, Clone)]
pub enum Backend {
    /// The controller crate, compiled for this machine.
    Native,
    /// This image, on an emulated processor each.
    Emulator(emulator::Firmware),
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
        })
    }
}
