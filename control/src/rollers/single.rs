//! The arithmetic of rollers: single precision.

use kinematics::{
    FourWheelGeometry, GeometryError, Mount, Twist, VelocityCompensation, WheelRates,
};

use crate::quantity::{Angle, Rate};
use crate::twist::{quantities, single};

pub use kinematics::PhaseMember as Wheels;
/// Secants of a wheel.
pub type Secant = kinematics::Secant<f32>;
/// One of them.
pub type Value = f32;

pub fn wheels(geometry: &FourWheelGeometry) -> Result<Wheels, GeometryError> {
    Wheels::new(geometry, &Mount::IDENTITY, &VelocityCompensation::NONE)
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

/// The rates for what the wheels are asked for.
#[inline]
pub fn inverse(wheels: &Wheels, asked: Twist<Rate>, secants: &[Value; 4]) -> [Rate; 4] {
    <[f32; 4]>::from(wheels.inverse(single(asked), secants)).map(Rate::new)
}

/// What these rates mean, and what no rigid motion explains in them.
#[inline]
pub fn measure(wheels: &Wheels, rates: [Rate; 4], secants: &[Value; 4]) -> (Twist<Rate>, Rate) {
    let rates = WheelRates::from(rates.map(Rate::to_f32));
    let (twist, residual) = wheels.measure(&rates, secants);
    (quantities(twist), Rate::new(residual))
}

/// The displacement that these angles of the wheels mean.
#[inline]
pub fn displacement(wheels: &Wheels, turned: [Angle; 4], secants: &[Value; 4]) -> Twist<Angle> {
    let turned = WheelRates::from(turned.map(Angle::to_f32));
    quantities(wheels.displacement(&turned, secants))
}

/// Steps of a roller angle for a radian of the wheel; 0 for ideal rollers.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Pitch(f32);

impl Pitch {
    /// Of ideal rollers.
    pub const NONE: Self = Self(0.0);

    /// So many rad from one roller to the next.
    pub const fn new(pitch: f32) -> Self {
        Self(4_294_967_296.0 / pitch)
    }

    /// Whether the rollers are ideal.
    pub fn is_none(self) -> bool {
        self.0 == 0.0
    }

    /// Steps of a roller angle by which a wheel turns; beyond half a roller it saturates.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a tick's part of a roller; beyond half a roller it saturates"
    )]
    #[inline]
    pub const fn steps(self, turned: Angle) -> i32 {
        (turned.to_f32() * self.0) as i32
    }

    /// The angle of so many steps.
    #[inline]
    pub const fn sweep(self, steps: i32) -> Angle {
        Angle::new(steps as f32 / self.0)
    }
}
