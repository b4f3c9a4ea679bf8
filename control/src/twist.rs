//! Twists of quantities.

use kinematics::Twist;

use crate::quantity::Quantity;

/// Standing still.
#[must_use]
pub const fn still<const FRACTION: u32>() -> Twist<Quantity<FRACTION>> {
    Twist {
        vx: Quantity::ZERO,
        vy: Quantity::ZERO,
        omega: Quantity::ZERO,
    }
}

/// The same for each component.
#[inline(always)]
pub fn each<A, B>(twist: Twist<A>, one: impl Fn(A) -> B) -> Twist<B> {
    Twist {
        vx: one(twist.vx),
        vy: one(twist.vy),
        omega: one(twist.omega),
    }
}

/// In the tick's own numbers.
#[inline]
pub fn quantities<const FRACTION: u32>(twist: Twist) -> Twist<Quantity<FRACTION>> {
    each(twist, Quantity::new)
}

/// As floats.
#[inline]
pub fn single<const FRACTION: u32>(twist: Twist<Quantity<FRACTION>>) -> Twist {
    each(twist, Quantity::to_f32)
}

/// In another resolution.
#[inline(always)]
pub fn to<const A: u32, const B: u32>(twist: Twist<Quantity<A>>) -> Twist<Quantity<B>> {
    each(twist, Quantity::to)
}

/// A twist times a number.
#[inline(always)]
pub fn scaled<const A: u32, const B: u32, const C: u32>(
    twist: Twist<Quantity<A>>,
    factor: Quantity<B>,
) -> Twist<Quantity<C>> {
    each(twist, |one| one.times(factor))
}

/// Whether each component is smaller than this.
#[inline(always)]
pub fn within<const A: u32>(twist: Twist<Quantity<A>>, bound: Quantity<A>) -> bool {
    twist.vx.abs() < bound && twist.vy.abs() < bound && twist.omega.abs() < bound
}
