//! The values that a simulated world needs and a real one has by itself: the `[simulation]` table.
//!
//! Everything random in it comes from one seed.

use serde::Deserialize;

/// What a simulated world needs to be told and a real one knows by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// All members are bolted to one load; otherwise each moves alone.
    pub rigid: bool,
    /// How wheel motion becomes robot motion.
    pub plant: Plant,
    /// Crystal error of every robot in parts per million, in the order of `robots`.
    pub crystal_ppm: Vec<f64>,
    /// Seed of everything random.
    pub seed: u64,
    /// What feeds a robot's motors; `None` holds the nominal voltage whatever is drawn.
    pub battery: Option<Battery>,
    /// Play between motor and wheel, at the wheel, rad.
    pub backlash: f64,
    /// What the motor drivers really are; `None` is what each robot's `output_stage` is for.
    pub driver: Option<Driver>,
    /// Permanent errors of the encoders.
    pub encoder_noise: EncoderNoise,
    /// Encoders that break.
    pub encoder_faults: Vec<EncoderFault>,
    /// Noise of the poses that an observer measures.
    pub pose_noise: PoseNoise,
    /// The gyro that every robot carries.
    pub gyro: Gyro,
    /// What only the contact plant knows.
    pub contact: Contact,
}

/// What a motor driver makes of its inputs: a PWM, a direction or a second PWM, and the
/// direction's inverse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Driver {
    /// PWM for so long in the direction, then both ends of the motor to one rail.
    #[default]
    PwmDirection,
    /// PWM with IN1 (direction) and IN2 (its inverse), as TB6612: equal inputs do not drive.
    PwmIn1In2,
    /// A half bridge on the PWM and one on the direction or the second PWM, as BTS7960: each output
    /// follows its input.
    HalfBridges,
    /// The whole voltage in one direction while the PWM is high, in the other while it is low.
    LockedAntiphase,
}

/// A robot's battery.
#[derive(Debug, Clone, PartialEq)]
pub struct Battery {
    /// Internal resistance and wiring, ohm.
    pub resistance: f64,
    /// Charge when full, Ah; `None` never runs down.
    pub capacity_ah: Option<f64>,
    /// Charge at the beginning, 0..=1 of the capacity.
    pub charge: f64,
    /// Voltage without load over charge (0..=1), charge ascending; empty is the motor's supply
    /// voltage at any charge.
    pub curve: Vec<(f64, f64)>,
}

/// Permanent errors of the encoders.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EncoderNoise {
    /// Share of the counts that is lost, 0..1.
    pub lost: f64,
    /// Stray counts of either sign, on average this many a second.
    pub extra_per_s: f64,
}

/// How an encoder breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EncoderFaultKind {
    /// It says nothing: a broken cable.
    Dead,
    /// One of its two channels says nothing: it counts one up and one down again.
    OneChannel,
    /// Its channels are swapped: it counts the other way.
    Reversed,
}

/// Wheels as the group file names them, in the usual order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WheelName {
    /// Front left.
    FrontLeft,
    /// Front right.
    FrontRight,
    /// Rear left.
    RearLeft,
    /// Rear right.
    RearRight,
}

/// An encoder that breaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderFault {
    /// Place of the robot in the file.
    pub robot: usize,
    /// Which wheel.
    pub wheel: WheelName,
    /// How.
    pub kind: EncoderFaultKind,
    /// When, s of virtual time.
    pub at: f64,
}

/// Standard deviations of what an observer sees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseNoise {
    /// Of either coordinate, m.
    pub position: f64,
    /// Of the heading, rad.
    pub heading: f64,
}

/// A gyro about the axis that points up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gyro {
    /// Samples a second: a divisor of 4000, the rate at which the plant is sampled.
    pub rate_hz: u32,
    /// Density of its white noise, rad/s in a bandwidth of 1 Hz.
    pub noise: f64,
    /// What it shows at rest, rad/s.
    pub bias: f64,
    /// How far the bias strays: standard deviation after a second, rad/s, growing with the root of
    /// time.
    pub drift: f64,
    /// By how much its samples are late, s.
    pub delay: f64,
}

impl Default for Gyro {
    /// An inexpensive micromechanical one.
    fn default() -> Self {
        Self {
            rate_hz: 200,
            noise: 0.005_f64.to_radians(),
            bias: 0.5_f64.to_radians(),
            drift: 3e-4_f64.to_radians(),
            delay: 0.004,
        }
    }
}

/// What only the contact plant knows. `None` is the plant's own value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contact {
    /// Coefficient of friction between rollers and floor, a ratio of forces.
    pub friction: Option<f64>,
    /// Mass of a robot, kg.
    pub robot_mass: Option<f64>,
    /// The floor's forces act on the motors, and this is what turns with a wheel, kg m²; `None`
    /// turns every wheel as its motor alone would, with the motor's own inertia.
    pub wheel_inertia: Option<f64>,
    /// Every wheel begins at a roller phase of its own, from the seed.
    pub scattered: bool,
    /// What the robots carry.
    pub payload: Option<Payload>,
    /// Parts of the floor that are different.
    pub floor: Vec<Patch>,
}

/// A load on a rigid group: a mass at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payload {
    /// kg.
    pub mass: f64,
    /// Its centre of mass in the group frame, m.
    pub x: f64,
    /// See `x`.
    pub y: f64,
}

/// A rectangle of the floor, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// From and to, m.
    pub x: (f64, f64),
    /// From and to, m.
    pub y: (f64, f64),
    /// Friction there.
    pub friction: f64,
}

/// How wheel motion becomes robot motion.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Plant {
    /// Measured losses over speed.
    Table(Tables),
    /// Rollers, friction and rigid-body dynamics.
    Contact {
        /// Rollers per wheel.
        rollers: u8,
    },
    /// Another simulator, reached over TCP.
    External {
        /// `host:port`.
        address: String,
    },
}

/// Which measured losses the table plant has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tables {
    /// The paper's virtual robot, Tables 3 and 5.
    Virtual,
    /// The paper's physical robot, Tables 7 and 8.
    Physical,
    /// No losses.
    Ideal,
}
