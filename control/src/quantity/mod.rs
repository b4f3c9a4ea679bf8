//! The numbers of the control tick: single precision, or fixed point with the feature of that name.
//!
//! # Theory of operation
//!
//! The tick is written once, in [`Quantity`]. Its parameter is the number of fractional bits in
//! fixed point; single precision ignores it. A product names the quantity of its result by its
//! type, and the fractional bits of all three are known to the compiler, so a product is one
//! multiplication and at most one constant shift. Nothing wraps: sums, products and conversions
//! that do not fit end at [`Quantity::MAX`] or [`Quantity::MIN`].
//!
//! Each physical quantity has a name here, whose range and resolution `docs/numbers.md` derives
//! from the range of the robot's parameters.
//!
//! # Interface
//!
//! A configuration is built with [`Quantity::new`]; results leave the tick with
//! [`Quantity::to_f32`]. Both convert a float, which a core without a floating-point unit does in
//! software, so neither belongs in a tick.
//!
//! # Limits
//!
//! The type knows how many bits a number has, not what its unit is: a [`Voltage`] of 15 bits and
//! any other quantity of 15 bits are the same type.

#[cfg(feature = "fixed-point")]
mod fixed_point;
#[cfg(feature = "fixed-point")]
use fixed_point as scalar;
#[cfg(feature = "fixed-point")]
pub(crate) mod root;
#[cfg(not(feature = "fixed-point"))]
mod single;
#[cfg(not(feature = "fixed-point"))]
use single as scalar;
#[cfg(test)]
mod tests;

pub use scalar::{Count, Ends, Half, Integral, Part, Quantity, Sign, Steps, polar};

/// Rate of a wheel, rad/s.
pub type Rate = Quantity<23>;
/// Angle of a wheel in one tick, or of an observer to its encoder, rad.
pub type Angle = Quantity<27>;
/// Acceleration of a wheel, rad/s^2.
pub type Acceleration = Quantity<19>;
/// Time of one tick, s.
pub type Time = Quantity<36>;
/// Time of a suspicion, s.
pub type Duration = Quantity<20>;
/// V at a motor.
pub type Voltage = Quantity<15>;
/// V s/rad.
pub type RateGain = Quantity<24>;
/// V s^2/rad.
pub type AccelerationGain = Quantity<28>;
/// V/rad.
pub type AngleGain = Quantity<20>;
/// Bandwidth of an observer, rad/s.
pub type Bandwidth = Quantity<22>;
/// A bandwidth in ticks, or another number of the order of 1.
pub type Ratio = Quantity<27>;
/// Where a robot is mounted in its group, m.
pub type Lever = Quantity<25>;
/// What is divided by a small one: counts in a radian, or 1/s.
pub type Large = Quantity<10>;
/// Velocity of a group, m/s or rad/s.
pub type Velocity = Quantity<27>;
/// Acceleration of a group within its limits, m/s^2 or rad/s^2.
pub type Change = Quantity<24>;
/// Jerk of a group, m/s^3 or rad/s^3; also one over a time, 1/s.
pub type Jerk = Quantity<18>;
/// One over a time, 1/s.
pub type PerSecond = Quantity<18>;
/// V at an input of the processor.
pub type InputVoltage = Quantity<27>;
/// V of the supply for 1 V at its input.
pub type Divider = Quantity<22>;
/// What a drive is given: a duty, or A.
pub type Drive = Quantity<24>;
/// 1/ohm.
pub type Conductance = Quantity<20>;
