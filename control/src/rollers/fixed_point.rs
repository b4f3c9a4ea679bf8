//! The arithmetic of rollers: fixed point.

use kinematics::{FourWheelGeometry, GeometryError, Mount, VelocityCompensation};

pub use kinematics::FixedPhaseMember as Wheels;
/// Secants of a wheel.
pub type Secant = kinematics::FixedSecant;
/// One of them, with [`kinematics::FixedSecant::FRACTION`] fractional bits.
pub type Value = i32;

pub fn wheels(geometry: &FourWheelGeometry) -> Result<Wheels, GeometryError> {
    Wheels::new(geometry, &Mount::IDENTITY, &VelocityCompensation::NONE)
}

pub fn secant(rollers: u16) -> Result<Secant, GeometryError> {
    Secant::new(&kinematics::Secant::<f32>::for_count(rollers)?)
}

/// `share` of `whole` from one to the other. Divided first, so that any share fits.
#[inline]
pub const fn between(from: Value, to: Value, share: u16, whole: u16) -> Value {
    from + (to - from) / whole as i32 * share as i32
}

#[inline]
pub const fn middle(a: Value, b: Value) -> Value {
    a + (b - a) / 2
}
