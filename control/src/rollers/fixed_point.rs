//! The arithmetic of rollers: fixed point.

use kinematics::{FourWheelGeometry, GeometryError, Mount, Twist, VelocityCompensation};

use crate::quantity::{Angle, Quantity, Rate};
use crate::twist::each;

pub use kinematics::FixedPhaseMember as Wheels;
/// Secants of a wheel.
pub type Secant = kinematics::FixedSecant;
/// One of them, with [`kinematics::FixedSecant::FRACTION`] fractional bits.
pub type Value = i32;

/// Fractional bits of the angles from which a displacement is found: those of an [`Angle`] less
/// one, so that ±16 rad fit.
const FINE: u32 = Angle::FRACTION - 1;

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

/// The rates for what the wheels are asked for.
#[inline]
pub fn inverse(wheels: &Wheels, asked: Twist<Rate>, secants: &[Value; 4]) -> [Rate; 4] {
    let bits = |one: Rate| one.to::<{ Wheels::TWIST_FRACTION }>().to_bits();
    let twist = [bits(asked.vx), bits(asked.vy), bits(asked.omega)];
    let rates = wheels.inverse_bits(twist, secants);
    rates.map(|rate| Quantity::resampled(rate, wheels.rates_fraction()))
}

/// What these rates mean, and what no rigid motion explains in them.
#[inline]
pub fn measure(wheels: &Wheels, rates: [Rate; 4], secants: &[Value; 4]) -> (Twist<Rate>, Rate) {
    let bits = rates.map(|rate| rate.to::<{ Wheels::RATE_FRACTION }>().to_bits());
    let (twist, residual) = wheels.measure_bits(bits, secants);
    let residual = Quantity::<{ Wheels::RATE_FRACTION + 1 }>::from_bits(residual);
    (of(twist, wheels.twist_fraction()), residual.to())
}

/// The displacement that these angles of the wheels mean.
#[inline]
pub fn displacement(wheels: &Wheels, turned: [Angle; 4], secants: &[Value; 4]) -> Twist<Angle> {
    // To the nearest: a tick's rounding adds up.
    let bits = turned.map(|angle| (angle.to_bits() >> 1) + (angle.to_bits() & 1));
    let (twist, _) = wheels.measure_bits(bits, secants);
    of(
        twist,
        wheels.twist_fraction() + FINE - Wheels::RATE_FRACTION,
    )
}

/// Numbers with so many fractional bits.
#[inline]
fn of<const FRACTION: u32>([vx, vy, omega]: [i32; 3], bits: u32) -> Twist<Quantity<FRACTION>> {
    each(Twist { vx, vy, omega }, |one| {
        Quantity::resampled(one, bits)
    })
}

/// The angle of a wheel from one roller to the next.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Pitch {
    /// Nothing for ideal rollers.
    angle: Angle,
    /// Steps of a roller angle in one of an [`Angle`], with 16 fractional bits.
    steps: i64,
}

impl Pitch {
    /// Of ideal rollers.
    pub const NONE: Self = Self {
        angle: Angle::ZERO,
        steps: 0,
    };

    /// So many rad.
    pub fn new(pitch: f32) -> Self {
        /// Fractional bits with which a pitch is exact: it is between 0.02 rad, of 255 rollers, and
        /// 2.1.
        const EXACT: u32 = 29;
        /// Fractional bits of one over it.
        const INVERSE: u32 = 32 + 16 - Angle::FRACTION;
        let bits = Quantity::<EXACT>::new(pitch).to_bits().unsigned_abs();
        // In whole numbers: double precision would be in software.
        let inverse = ((1 << 63) / u64::from(bits.max(1))) >> (63 - EXACT - INVERSE);
        Self {
            angle: Angle::new(pitch),
            steps: inverse.cast_signed(),
        }
    }

    /// Whether the rollers are ideal.
    pub fn is_none(self) -> bool {
        self.angle == Angle::ZERO
    }

    /// Steps of a roller angle by which a wheel turns; beyond half a roller it saturates.
    #[inline]
    pub fn steps(self, turned: Angle) -> i32 {
        let steps = i64::from(turned.to_bits()).wrapping_mul(self.steps) >> 16;
        i32::try_from(steps).unwrap_or(if steps < 0 { i32::MIN } else { i32::MAX })
    }

    /// The angle of so many steps.
    #[inline]
    pub fn sweep(self, steps: i32) -> Angle {
        self.angle.times(Quantity::<32>::from_bits(steps))
    }
}
