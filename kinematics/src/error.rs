//! Errors in the numbers that describe a robot.
//!
//! Every error names the field, so that the reader of a configuration file can report the line to
//! correct. All errors are found while an object is built; later calls cannot fail.

use core::fmt;

/// Why a wheel or a robot cannot be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GeometryError {
    /// The named field is NaN or infinite.
    NotFinite(&'static str),
    /// The named field must be greater than zero.
    NotPositive(&'static str),
    /// The roller angle is 0 or ±90 degrees or beyond: such a wheel is an ordinary wheel, or cannot
    /// drive.
    RollerAngle,
    /// Fewer than three wheels.
    TooFewWheels,
    /// A weight is negative or not finite.
    Weight,
    /// Wheels too small or levers too long for fixed point.
    Range,
    /// The roller axles are so nearly parallel that motion across them is 100 times harder to
    /// control.
    TranslationPoor,
    /// The roller axles so nearly meet in one point that yaw is 100 times harder to control than it
    /// could be.
    YawPoor,
    /// No wheel resists motion along some direction: all roller axles are parallel.
    TranslationUncontrolled,
    /// All roller axles meet in one point, about which the robot turns freely.
    YawUncontrolled,
}

impl fmt::Display for GeometryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite(field) => write!(f, "{field} is not a finite number"),
            Self::NotPositive(field) => write!(f, "{field} must be greater than zero"),
            Self::RollerAngle => {
                f.write_str("roller_angle must be between 0 and 90 degrees, both excluded")
            }
            Self::TooFewWheels => f.write_str("a robot needs at least three wheels"),
            Self::Range => f.write_str("wheels are too small or levers too long for fixed point"),
            Self::Weight => f.write_str("weights must be finite and not negative"),
            Self::TranslationPoor => f.write_str(
                "all roller axles are nearly parallel: motion across them is poorly controlled",
            ),
            Self::YawPoor => {
                f.write_str("all roller axles nearly meet in one point: yaw is poorly controlled")
            }
            Self::TranslationUncontrolled => f.write_str(
                "all roller axles are parallel: motion across them cannot be controlled",
            ),
            Self::YawUncontrolled => {
                f.write_str("all roller axles meet in one point: yaw cannot be controlled")
            }
        }
    }
}

impl core::error::Error for GeometryError {}

/// Why a mount is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MountError {
    /// The named field is NaN or infinite.
    NotFinite(&'static str),
}

impl fmt::Display for MountError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite(field) => write!(f, "{field} is not a finite number"),
        }
    }
}

impl core::error::Error for MountError {}

/// Why a velocity compensation is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CompensationError {
    /// The named coefficient is NaN or infinite.
    NotFinite(&'static str),
    /// The named coefficient is zero or negative: it would delete or reverse the motion.
    NotPositive(&'static str),
    /// A table has no rows.
    Empty,
    /// The speed of this row (counted from 0) is not larger than that of the row before.
    NotIncreasing(usize),
    /// Between this row (counted from 0) and the one before, the coefficient changes so fast that
    /// two speeds might ask the wheels for the same.
    TooSteep(usize),
    /// The coefficients for oblique motion are too far from the axial ones to be distinguished on
    /// the way back.
    TooOblique,
}

impl fmt::Display for CompensationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite(field) => write!(f, "{field} is not a finite number"),
            Self::NotPositive(field) => {
                write!(
                    f,
                    "{field} must be greater than zero (1 is no compensation)"
                )
            }
            Self::Empty => f.write_str("a compensation table needs at least one row"),
            Self::NotIncreasing(row) => {
                write!(
                    f,
                    "row {row}: speeds must be finite, positive and increasing"
                )
            }
            Self::TooSteep(row) => write!(
                f,
                "row {row}: the coefficient changes too fast with speed to be inverted"
            ),
            Self::TooOblique => f.write_str(
                "oblique and axial coefficients differ too much for the tables to be inverted",
            ),
        }
    }
}

impl core::error::Error for CompensationError {}

/// Why a matrix cannot be kept in another scalar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RangeError {
    /// The matrix to the wheels has entries too large: wheels too small or levers too long.
    Inverse,
    /// The matrix back has entries too large: wheels too large or levers too long.
    Forward,
}

impl fmt::Display for RangeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Inverse => "wheel rates per velocity are too large for fixed point",
            Self::Forward => "velocities per wheel rate are too large for fixed point",
        })
    }
}

impl core::error::Error for RangeError {}

/// Why members do not make a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GroupError {
    /// There are none.
    Empty,
    /// The information of their wheels about the group's motion cannot be inverted.
    Undetermined,
}

impl fmt::Display for GroupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Empty => "a group needs at least one member",
            Self::Undetermined => "the members' wheels do not determine the group's motion",
        })
    }
}

impl core::error::Error for GroupError {}
