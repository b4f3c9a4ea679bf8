//! The arithmetic of rollers: single precision.

use kinematics::{FourWheelGeometry, GeometryError, Mount, VelocityCompensation};

pub use kinematics::PhaseMember as Wheels;
/// Secants of a wheel.
pub type Secant = kinematics::Secant<f32>;
/// One of them.
pub type Value = f32;

#[expect(
    clippy::unnecessary_wraps,
    reason = "as in fixed point, where it may not fit"
)]
pub fn wheels(geometry: &FourWheelGeometry) -> Result<Wheels, GeometryError> {
    Ok(Wheels::new(
        geometry,
        &Mount::IDENTITY,
        &VelocityCompensation::NONE,
    ))
}

pub fn secant(rollers: u16) -> Result<Secant, GeometryError> {
    Secant::for_count(rollers)
}

/// `share` of `whole` from one to the other.
#[inline]
pub fn between(from: Value, to: Value, share: u16, whole: u16) -> Value {
    from + (to - from) * (f32::from(share) / f32::from(whole))
}

#[inline]
pub fn middle(a: Value, b: Value) -> Value {
    0.5 * (a + b)
}
