//! What passes between the two sides of a robot, and between the control side and the outside.
//!
//! Everything here is `Copy` and small, because the two sides run at different priorities: the
//! owner of both copies a [`Command`] one way and a [`Report`] the other, inside whatever critical
//! section the platform has. Nothing else is shared. Both are latest-wins: neither side waits for
//! the other, and each states in its own message which of the other's messages it has acted on.

use crate::time::Micros;
use kinematics::{Pose, Twist, WheelRates};
use protocol::{Fault, Limit};

use crate::gyro::{GyroReport, Reading};
use crate::odometry::Odometry;
use crate::quantity::{Angle, Drive, InputVoltage, Rate, Velocity, Voltage};
use crate::rollers::{IndexPulse, RollerState};
use crate::twist::{single, still};
use identification::Bounds;

/// The mode that the bus side requests. The control side decides: it owns drivers, brake and
/// duties.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Mode {
    /// Outputs off, brake engaged.
    #[default]
    Off,
    /// Drivers on, reference zero.
    Hold,
    /// Follow the target.
    Follow,
    /// Ramp down along the direction of motion, then outputs off.
    Ramp,
    /// Identify the motors, then hold.
    Identify,
}

/// The bus side's message to the control side.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Command {
    /// Requested mode.
    pub mode: Mode,
    /// Twist to reach within one SYNC period, group frame, group scale applied.
    pub twist_cmd: Twist,
    /// Sequence of the setpoint behind the target.
    pub sequence: u8,
    /// Counts the targets: a new one begins when this changes.
    pub update: u16,
    /// When the target takes effect.
    pub at: Micros,
    /// Counts the accepted starts: a new one clears latched faults.
    pub start: u16,
    /// The requested configuration: its checksum.
    pub configuration: u32,
    /// When the bus side last did its work.
    pub alive: Micros,
    /// For [`Mode::Identify`].
    pub bounds: Bounds,
}

impl Command {
    /// No request.
    pub const NONE: Self = Self {
        mode: Mode::Off,
        twist_cmd: Twist::ZERO,
        sequence: 0,
        update: 0,
        at: Micros::ZERO,
        start: 0,
        configuration: 0,
        alive: Micros::ZERO,
        bounds: Bounds {
            rate: 0.0,
            travel: 0.0,
            wheels: 0,
        },
    };
}

/// The control side's inputs in each tick.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Inputs {
    /// Encoder counters, wrapping: front left, front right, rear left, rear right.
    pub encoder_counts: [u16; 4],
    /// Emergency stop pressed, or its wire broken.
    pub emergency_stop: bool,
    /// What the motor drivers report: [`Fault::DriverFault`] where they have one line for it.
    pub drive_fault: Option<Fault>,
    /// The protective stop requests standstill, or its wire is broken; valid only where one is
    /// configured.
    pub protective_stop: bool,
    /// Voltage at the supply's measuring input, behind its divider, V, where there is one.
    pub supply_input: Option<InputVoltage>,
    /// Voltages at the current sensors' inputs, V, where sensors are configured and the board has
    /// such inputs.
    pub current_inputs: Option<[f32; 3]>,
    /// The last index pulse of each encoder; `None` where indexes are not used.
    pub index: Option<[IndexPulse; 4]>,
    /// What the gyro's driver says, where the board has a gyro.
    pub gyro: Option<Reading>,
}

/// The control side's outputs in each tick.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Outputs {
    /// What each wheel's drive gets ([`crate::wheel_drive`]): a duty, -1 to 1, or a current, A.
    /// Positive rolls the base forward where the motor is not reversed. Order as the encoders.
    pub drive: [Drive; 4],
    /// Motor drivers on.
    pub drivers_enabled: bool,
    /// Holding brake released. It is spring-applied: `false` is braked.
    pub brake_released: bool,
}

impl Outputs {
    /// No torque, drivers off, braked.
    pub const SAFE: Self = Self {
        drive: [Drive::ZERO; 4],
        drivers_enabled: false,
        brake_released: false,
    };

    /// What each wheel's drive gets, as floats.
    #[must_use]
    pub fn given(&self) -> [f32; 4] {
        self.drive.map(Drive::to_f32)
    }
}

/// The control side's message to the bus side.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Report {
    /// When the tick began.
    pub at: Micros,
    /// Start it has acted on.
    pub start: u16,
    /// Configuration in use; 0 for none.
    pub configuration: u32,
    /// Present mode.
    pub mode: Mode,
    /// In [`Mode::Ramp`]: the ramp is over and the wheels are at rest.
    pub standstill: bool,
    /// The brake has let go: the wheels can follow.
    pub brake_is_free: bool,
    /// Latched since that start.
    pub fault: Option<Fault>,
    /// The fault that prevents a start now.
    pub obstacle: Option<Fault>,
    /// The input of the protective stop is open.
    pub protective_stop: bool,
    /// The most important limit that is active.
    pub limit: Option<Limit>,
    /// Sequence of the setpoint it follows.
    pub sequence: u8,
    /// Group twist after all limits, group frame.
    pub twist_ref: Twist<Velocity>,
    /// Group twist as the wheels measure it, group frame.
    pub measured: Twist<Rate>,
    /// Wheel rates that no rigid motion explains, rad/s.
    pub slip_residual: Rate,
    /// Reference wheel rates, rad/s.
    pub rates_ref: [Rate; 4],
    /// Wheel rates measured, rad/s.
    pub rates: [Rate; 4],
    /// Since the robot was configured, for the pose of the group frame.
    pub odometry: Odometry,
    /// Supply voltage, V, where it is measured: the mean over some ticks.
    pub supply: Option<Voltage>,
    /// Current of the motors, A, as the sensors measure it; 0 where it is not measured.
    pub current: f32,
    /// Temperature of the hottest motor, degrees Celsius, as smart drives report it; 0 where it is
    /// not measured.
    pub temperature: u8,
    /// The gyro.
    pub gyro: GyroReport,
    /// Ticks more than half a period late, so far.
    pub late_ticks: u32,
    /// Ticks so far in which a number of fixed point was at an end of its range.
    pub saturated_ticks: u32,
    /// State of each wheel's roller phase.
    pub roller_states: [RollerState; 4],
    /// Roller angle of each wheel, rad.
    pub roller_sweeps: [Angle; 4],
}

impl Report {
    /// There has been no tick.
    pub const NONE: Self = Self {
        at: Micros::ZERO,
        start: 0,
        configuration: 0,
        mode: Mode::Off,
        standstill: false,
        brake_is_free: false,
        fault: None,
        obstacle: None,
        protective_stop: false,
        limit: None,
        sequence: 0,
        twist_ref: still(),
        measured: still(),
        slip_residual: Rate::ZERO,
        rates_ref: [Rate::ZERO; 4],
        rates: [Rate::ZERO; 4],
        odometry: Odometry::new(),
        supply: None,
        current: 0.0,
        temperature: 0,
        gyro: GyroReport::NONE,
        late_ticks: 0,
        saturated_ticks: 0,
        roller_states: [RollerState::Constant; 4],
        roller_sweeps: [Angle::ZERO; 4],
    };

    /// Group twist after all limits, group frame.
    #[must_use]
    pub fn twist_ref(&self) -> Twist {
        single(self.twist_ref)
    }

    /// Group twist as the wheels measure it, group frame.
    #[must_use]
    pub fn measured(&self) -> Twist {
        single(self.measured)
    }

    /// Wheel rates that no rigid motion explains, rad/s.
    #[must_use]
    pub const fn slip_residual(&self) -> f32 {
        self.slip_residual.to_f32()
    }

    /// Reference wheel rates, rad/s.
    #[must_use]
    pub fn rates_ref(&self) -> WheelRates {
        self.rates_ref.map(Rate::to_f32).into()
    }

    /// Wheel rates measured, rad/s.
    #[must_use]
    pub fn rates(&self) -> WheelRates {
        self.rates.map(Rate::to_f32).into()
    }

    /// Pose of the group frame since the robot was configured.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.odometry.pose()
    }

    /// Supply voltage, V, where it is measured.
    #[must_use]
    pub fn supply(&self) -> Option<f32> {
        self.supply.map(Voltage::to_f32)
    }
}
