//! The group as the programs use it: SI units, REP-103 axes, every value checked.
//!
//! Nothing here can be built with a value that breaks a rule except by hand; [`GroupFile::load`] is
//! the way in. `f32` where a robot will hold the value (it travels as REAL32), `f64` where only the
//! simulated world uses it.

use kinematics::{FourWheelGeometry, Pose, VelocityCompensation};
use protocol::compensation::{ObliqueRow, Row};
use robot::Hardware;

use serde::Deserialize;

use crate::simulation::{Driver, Simulation};

/// Lowest node identifier of a robot; node 1 is the master.
pub const FIRST_NODE: u8 = 2;
/// Highest node identifier of a robot: sixteen on one bus.
pub const LAST_NODE: u8 = 17;

/// A whole group.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupFile {
    /// Short name, for reports.
    pub name: String,
    /// Group identifier on the bus, 1..=255; robots ignore setpoints of other groups.
    pub group_id: u8,
    /// Period of SYNC in microseconds, a whole number of milliseconds.
    pub sync_period_us: u32,
    /// Limits of the group's motion, the same in every member.
    pub limits: Limits,
    /// How the group trails its wheels.
    pub contact_lag: ContactLag,
    /// Share of its speed that a robot loses sideways because rollers meet the floor at rest, over
    /// that speed, s/m.
    pub hand_over_loss: f32,
    /// The members, in the order of the file.
    pub robots: Vec<Robot>,
    /// What a simulated world needs to be told.
    pub simulation: Simulation,
}

/// Limits of the group's motion, in the group frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Speed of the group frame's origin, m/s.
    pub linear_speed: f32,
    /// Yaw rate, rad/s.
    pub yaw_rate: f32,
    /// m/s².
    pub linear_acceleration: f32,
    /// rad/s².
    pub yaw_acceleration: f32,
    /// m/s³.
    pub linear_jerk: f32,
    /// rad/s³.
    pub yaw_jerk: f32,
    /// A setpoint older than this stops the group, microseconds.
    pub command_timeout_us: u32,
    /// So long without SYNC stops a member, microseconds; 0 for two and a quarter periods.
    pub sync_timeout_us: u32,
}

/// By how much the group's motion trails what its wheels turn, s, in the group frame.
///
/// Rubber creeps: what pushes a roller along its axle is in proportion to its slip, so a group that
/// accelerates slips in proportion to the acceleration. For wheels that carry mass `m` with
/// friction `mu` and creep to the full at `c` m/s, and rollers at 45 degrees, that is `2 c / (mu
/// g)` for either translation, whatever `m` is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ContactLag {
    /// Ahead.
    pub longitudinal: f32,
    /// Sideways.
    pub lateral: f32,
    /// Turning.
    pub yaw: f32,
}

/// One member.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// CANopen node identifier, [`FIRST_NODE`]..=[`LAST_NODE`].
    pub node: u8,
    /// Pose in the group frame: metres, radians, counter-clockwise.
    pub mount: Pose,
    /// Wheels and where they are.
    pub geometry: FourWheelGeometry,
    /// The wheels one by one, where they differ; see [`Robot::each_wheel`].
    pub wheels: Option<[Wheel; 4]>,
    /// What the master writes into the robot against its losses; 1 is none.
    pub compensation: VelocityCompensation,
    /// Tables over speed and direction that stand in for it, axis by axis, where they have rows.
    pub compensation_table: CompensationTable,
    /// Its wheels' rollers, where their phase is known; `None` computes with ideal rollers.
    pub rollers: Option<Rollers>,
    /// Fastest wheel rate that may be asked for, rad/s.
    pub max_wheel_rate: f32,
    /// Its board: which image it runs.
    pub board: Board,
    /// The wheel's encoder.
    pub encoder: Encoder,
    /// Encoders and motors that are wired or mounted the other way round.
    pub reversed: Reversed,
    /// The wheel's motor with its gear.
    pub motor: Motor,
    /// What its motors' drivers and brakes stand and take.
    pub output: OutputStage,
    /// Gains of the wheel-rate loop.
    pub control: Control,
}

impl Robot {
    /// Its wheels, whether the file has them one by one or not: front left, front right, rear left,
    /// rear right.
    #[must_use]
    pub fn each_wheel(&self) -> [Wheel; 4] {
        let geometry = &self.geometry;
        let (x, y) = (geometry.half_wheelbase(), geometry.half_track());
        let (radius, angle) = (geometry.wheel_radius(), geometry.roller_angle());
        let usual = [
            (x, y, angle),
            (x, -y, -angle),
            (-x, y, -angle),
            (-x, -y, angle),
        ];
        self.wheels
            .unwrap_or(usual.map(|(x, y, roller_angle)| Wheel {
                x,
                y,
                radius,
                roller_angle,
                counts_per_revolution: None,
            }))
    }
}

/// Encoders and motors that are wired or mounted the other way round, as objects 0x2020:2 and :3:
/// bit 0 front left, 1 front right, 2 rear left, 3 rear right. `None` where the file does not say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reversed {
    /// These count down when the wheel rolls the base forward.
    pub encoders: Option<u8>,
    /// These roll the base backward with a positive duty.
    pub motors: Option<u8>,
}

/// One wheel of a robot whose wheels differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheel {
    /// Centre, forward, m.
    pub x: f32,
    /// Centre, left, m.
    pub y: f32,
    /// m.
    pub radius: f32,
    /// Roller axle against wheel axle, counter-clockwise from above, rad.
    pub roller_angle: f32,
    /// Encoder counts per revolution, where they are not the robot's.
    pub counts_per_revolution: Option<f32>,
}

/// Compensation over speed and direction; every row with the speed that is achieved.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CompensationTable {
    /// Distinguishes one calibration from another, for example by its date. 0 where the file has no
    /// table.
    pub version: u32,
    /// m/s, coefficient.
    pub longitudinal: Vec<Row>,
    /// m/s, coefficient.
    pub lateral: Vec<Row>,
    /// m/s, longitudinal and lateral coefficient at 45 degrees.
    pub oblique: Vec<ObliqueRow>,
    /// rad/s, coefficient.
    pub yaw: Vec<Row>,
}

/// The rollers of a robot's wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rollers {
    /// Rollers of a wheel.
    pub count: u8,
    /// How far each wheel has rolled on past the middle of its ground roller when its index comes
    /// (once a turn of the wheel), rad: front left, front right, rear left, rear right. From
    /// calibration.
    pub phases: [f32; 4],
    /// By how many encoder counts an index may be off; what the robot holds without it.
    pub index_tolerance: Option<u16>,
    /// What is left to compensate when the wheels' roller angles are taken into account; stands in
    /// for [`Robot::compensation`].
    pub compensation: VelocityCompensation,
}

/// The encoder of a wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Encoder {
    /// Quadrature counts per revolution of the encoder's shaft (lines times 4); of the wheel where
    /// the gear ratio is 1.
    pub counts_per_revolution: f32,
    /// Revolutions of the encoder's shaft in one of the wheel.
    pub gear_ratio: f32,
}

/// Motor and gear as seen from the wheel: torques and rates are the wheel's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motor {
    /// Supply voltage of the bridge, V.
    pub supply: f32,
    /// Back-EMF constant in V·s/rad; the same number is the torque constant in N·m/A.
    pub constant: f32,
    /// Winding resistance, Ω.
    pub resistance: f32,
    /// Winding inductance, H.
    pub inductance: f32,
    /// Inertia the motor turns, kg·m²: rotor, gear, wheel, and this wheel's share of the robot.
    pub inertia: f32,
    /// Dry friction torque, N·m.
    pub friction: f32,
    /// Viscous friction, N·m·s/rad.
    pub viscous: f32,
}

/// Motor drivers and holding brake of a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutputStage {
    /// Largest current of a motor, A; without it the robot's own bound holds.
    pub largest_current: Option<f32>,
    /// Largest duty of a bridge, 0.1..=1.
    pub largest_duty: f32,
    /// What the brake takes to let go, ms.
    pub brake_release_ms: u16,
    /// What the brake takes to hold, ms.
    pub brake_engage_ms: u16,
    /// A bridge gets no duty for a tick before it changes its direction.
    pub direction_pause: bool,
    /// Of the bridges' PWM, Hz.
    pub pwm_frequency: u16,
    /// How a duty is put on a bridge's inputs.
    pub kind: StageKind,
    /// Identifiers of the smart drives, 1 to 4, all different: front left, front right, rear left,
    /// rear right.
    pub drive_identifiers: [u8; 4],
    /// The robot's driver enable switches all bridges off.
    pub enable_wired: bool,
    /// Sensors of the motors' current, where there are any.
    pub current_sensor: Option<CurrentSensor>,
}

/// A board, with its number in image files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Board {
    /// NUCLEO-F446RE, the reference board.
    #[default]
    NucleoF446re = 1,
    /// RoboMaster Development Board C.
    RobomasterC = 2,
    /// A kit's controller with an STM32F103RC.
    KitF103rc = 5,
}

impl Board {
    /// Its name in a group file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NucleoF446re => "nucleo-f446re",
            Self::RobomasterC => "robomaster-c",
            Self::KitF103rc => "kit-f103rc",
        }
    }

    /// What robots on it check their configuration against, with the drives of its usual image.
    #[must_use]
    pub const fn hardware(self) -> Hardware {
        match self {
            Self::NucleoF446re => Hardware::NUCLEO_F446RE,
            Self::RobomasterC => Hardware::ROBOMASTER_C,
            Self::KitF103rc => Hardware::KIT_F103RC,
        }
    }
}

/// What turns the wheels, and how a duty is put on the two inputs of a bridge, with the numbers of
/// object 0x2027:6.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageKind {
    /// PWM and direction, and where the bridge wants them IN1 and IN2: the direction and its
    /// inverse.
    #[default]
    PwmDirection = 0,
    /// PWM on IN1, direction on IN2.
    InInSlow = 1,
    /// PWM on one input, the other low; needs two PWMs a wheel.
    InInFast = 2,
    /// Half of the period high is no voltage.
    LockedAntiphase = 3,
    /// RoboMaster C620 drives on a CAN bus of their own.
    C620 = 4,
    /// RoboMaster C610 drives on a CAN bus of their own.
    C610 = 5,
    /// PWM on one input, the other high; needs two PWMs a wheel.
    InInBrake = 6,
}

impl StageKind {
    /// Whether it needs an image with two PWMs a wheel.
    #[must_use]
    pub const fn has_two_pwms(self) -> bool {
        matches!(self, Self::InInFast | Self::InInBrake)
    }

    /// Whether it has no safe state but by the drivers' enable.
    #[must_use]
    pub const fn needs_enable(self) -> bool {
        matches!(self, Self::InInSlow | Self::LockedAntiphase)
    }

    /// The largest current that a smart drive of this kind can be told, A; `None` for a bridge.
    #[must_use]
    pub const fn drive_current(self) -> Option<f32> {
        match self {
            Self::C620 => Some(20.0),
            Self::C610 => Some(10.0),
            Self::PwmDirection
            | Self::InInSlow
            | Self::InInFast
            | Self::LockedAntiphase
            | Self::InInBrake => None,
        }
    }
}

impl From<StageKind> for Driver {
    fn from(kind: StageKind) -> Self {
        match kind {
            // The outputs for bridges are low with smart drives; nothing is wired to them.
            StageKind::PwmDirection | StageKind::C620 | StageKind::C610 => Self::PwmDirection,
            StageKind::InInSlow | StageKind::InInFast | StageKind::InInBrake => Self::HalfBridges,
            StageKind::LockedAntiphase => Self::LockedAntiphase,
        }
    }
}

/// Sensors of the motors' current.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurrentSensor {
    /// A/V.
    pub scale: f32,
    /// Voltage without current, V.
    pub offset: f32,
    /// Inputs that are added up, 1 to 3.
    pub inputs: u8,
}

/// Gains of the wheel-rate loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Control {
    /// Duty per rad/s of rate error.
    pub proportional: f32,
    /// Duty per rad of accumulated rate error.
    pub integral: f32,
    /// The robot knows its motors, gains and wiring from an identification and keeps them; nothing
    /// of that is written into it.
    pub identified: bool,
}

/// Duty that holds or changes a wheel rate, from the motor's own data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feedforward {
    /// Duty that overcomes dry friction, 0..=1, with the sign of the rate.
    pub duty_static: f32,
    /// Duty per rad/s.
    pub duty_per_rate: f32,
    /// Duty per rad/s².
    pub duty_per_acceleration: f32,
}

impl Motor {
    /// The feedforward that fits this motor: steady state of `duty * supply = constant * rate +
    /// resistance * torque / constant`.
    #[must_use]
    pub fn feedforward(&self) -> Feedforward {
        let duty_per_torque = self.resistance / (self.constant * self.supply);
        Feedforward {
            duty_static: self.friction * duty_per_torque,
            duty_per_rate: self.constant / self.supply + self.viscous * duty_per_torque,
            duty_per_acceleration: self.inertia * duty_per_torque,
        }
    }

    /// Rate at full duty without load, rad/s.
    #[must_use]
    pub fn no_load_rate(&self) -> f32 {
        let f = self.feedforward();
        (1.0 - f.duty_static) / f.duty_per_rate
    }
}
