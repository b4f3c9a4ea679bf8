//! What really happened, as an observer with perfect eyes sees it.
//!
//! Samples are taken at whole multiples of a period of virtual time and kept until someone takes them
//! away; a minute at 100 Hz with three robots is about 4 MB. Nothing in the simulated robots can read
//! them.

use kinematics::{Pose, WheelRates};

/// One instant.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthSample {
    /// Virtual time, ns.
    pub time_ns: u64,
    /// Pose of the group frame in the world, m and rad, heading unwrapped.
    pub group: Pose<f64>,
    /// Distance of the robot that is farthest from its place in the group, mm.
    pub shape_error_mm: f64,
    /// Part of the time since the last sample in which the bus was taken, 0..=1.
    pub bus_load: f64,
    /// One entry a robot, in the order of the group file.
    pub robots: Vec<RobotTruth>,
}

/// One robot at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotTruth {
    /// CANopen node.
    pub node: u8,
    /// Pose in the world, m and rad, heading unwrapped.
    pub pose: Pose<f64>,
    /// Wheel angles, rad, front left, front right, rear left, rear right; positive rolls forward.
    pub wheel_angles: [f64; 4],
    /// Wheel rates, rad/s, positive rolls the base forward.
    pub wheel_rates: WheelRates<f64>,
    /// Bridge voltage over supply voltage, -1..=1, same order; 0 while the drivers are off.
    pub duties: [f64; 4],
    /// Whether the bridges conduct.
    pub drivers_enabled: bool,
    /// Whether the holding brake is open.
    pub brake_released: bool,
}
