//! The errors that end a calibration.

use crate::error::MasterError;
use roller_phase::PhaseError;

/// Why no coefficients can be given.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// Driving, or the source of poses.
    #[error(transparent)]
    Master(#[from] MasterError),
    /// No speed is left within the limits.
    #[error(
        "no speed to calibrate at is within the group's limits; give --speeds and --rates below \
         limits.linear_speed and limits.yaw_rate"
    )]
    NoSpeeds,
    /// Bolted robots that face so differently that their losses ahead and sideways cannot be
    /// separated, and that turn their group because of it.
    #[error(
        "with the new coefficients {motion} motion turns the group by {degrees:.2} degrees per \
         metre: the robots face so differently that their losses ahead and sideways cannot be \
         separated while they are bolted together; nothing is written. Unbolt them, calibrate \
         with simulation.rigid = false in the group file, then bolt them again"
    )]
    NotToldApart {
        /// Which motion.
        motion: &'static str,
        /// By how much, counter-clockwise.
        degrees: f64,
    },
    /// A motion that was left out.
    #[error(
        "{motion} motion was not measured; nothing is written. Measure at least one speed, \
         both ways"
    )]
    NotMeasured {
        /// Which motion.
        motion: &'static str,
    },
    /// Bad or too few data.
    #[error(
        "{motion} at {speed} {unit}: {reason}; nothing is written. Look for slip, play and a \
         source of poses that jumps, then measure again"
    )]
    NotDetermined {
        /// Which motion.
        motion: &'static str,
        /// How fast.
        speed: f64,
        /// Unit of it.
        unit: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The axes of the source of poses are turned against the robots'.
    #[error(
        "every motion deviates by {degrees:.1} degrees to the left (negative: right): the source \
         of poses and the robots disagree about the direction ahead; turn the \
         tracked body's axes by that angle and measure again"
    )]
    Askew {
        /// By how much, counter-clockwise.
        degrees: f64,
    },
    /// One motion went in another direction.
    #[error(
        "{motion} at {speed} m/s deviated by {degrees:.1} degrees; look for a wheel that does not \
         turn, slips, or is mounted in the place of another (`omnibus wheel-test`)"
    )]
    Sidelong {
        /// Which motion.
        motion: &'static str,
        /// How fast.
        speed: f64,
        /// By how much, counter-clockwise.
        degrees: f64,
    },
    /// A straight motion turned the group.
    #[error(
        "{motion} at {speed} m/s turned by {degrees:.1} degrees; look for a wheel of another \
         size, one that slips, or a load far from the centre"
    )]
    Turned {
        /// Which motion.
        motion: &'static str,
        /// How fast.
        speed: f64,
        /// By how much, counter-clockwise.
        degrees: f64,
    },
    /// Coefficients that no robot takes.
    #[error(
        "the coefficients cannot be used: {0}; nothing is written. Look for a wheel that slips or \
         does not turn"
    )]
    Unusable(String),
    /// Driven again, the group is not where it should be.
    #[error(
        "with the new coefficients {motion} motion is still off by {percent:.2} %, more than 1 %; \
         nothing is written. Measure again with more --repeats, and over a longer --distance"
    )]
    DoesNotHold {
        /// Which motion.
        motion: &'static str,
        /// By how much.
        percent: f64,
    },
    /// Bolted robots whose roller phases are asked for.
    #[error(
        "the robots of {0} are bolted to one load, which hides the ripple of each behind that of \
         the others; calibrate them apart, with simulation.rigid = false in the group file"
    )]
    Bolted(String),
    /// Phases that the data do not determine.
    #[error("node {node}: {reason}")]
    Phases {
        /// The robot.
        node: u8,
        /// Why.
        reason: PhaseError,
    },
    /// A file to be read or written.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// What is wrong, and what to do.
        problem: String,
    },
}
