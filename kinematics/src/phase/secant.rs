//! The secant of a roller's sweep, as an even polynomial.
//!
//! A wheel's ground roller sweeps by ± pi/n only, and the secant is even, so a cubic in the square
//! of the sweep is enough. Its coefficients are computed once for each number of rollers, by
//! interpolation in the four Chebyshev points, which spread the error evenly. Because it is even,
//! it has the same value on both sides of a roller transition.
//!
//! Largest error, relative: 2e-7 from eight rollers up, 2e-6 at six, 7e-5 at four, 2e-3 at three
//! (tested).

use super::angle::RollerAngle;
use crate::arithmetic::Real;
use crate::error::GeometryError;
use crate::roller::Rollers;

/// Gives a wheel's secant for a roller angle.
///
/// ```
/// use mecanum_kinematics::{RollerAngle, Rollers, Secant};
///
/// let eight = Rollers::<f32>::new(8)?;
/// let secant = Secant::new(Some(&eight));
/// // At the roller transition, 22.5 degrees.
/// assert!((secant.at(RollerAngle::from_bits(i32::MIN)) - 1.0823922).abs() < 1e-6);
/// // Of infinitely many rollers none ever leans.
/// assert_eq!(Secant::<f32>::new(None).at(RollerAngle::from_bits(i32::MIN)), 1.0);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Secant<S = f32> {
    /// Coefficients of the powers of the squared angle in pitches.
    powers: [S; 4],
    /// Reciprocal of the mean lateral ratio.
    unknown: S,
    /// Pitches in a radian.
    per_radian: S,
}

impl<S: Real> Secant<S> {
    /// For a wheel with these rollers, or with infinitely many.
    #[must_use]
    pub fn new(rollers: Option<&Rollers<S>>) -> Self {
        let Some(rollers) = rollers else {
            return Self {
                powers: [S::ONE, S::ZERO, S::ZERO, S::ZERO],
                unknown: S::ONE,
                per_radian: S::ZERO,
            };
        };
        Self {
            powers: coefficients(rollers.pitch()),
            unknown: S::ONE / rollers.mean_lateral_ratio(),
            per_radian: S::ONE / rollers.pitch(),
        }
    }

    /// For a wheel with this many rollers; 0 stands for infinitely many.
    ///
    /// # Errors
    ///
    /// [`GeometryError::NotPositive`] for one or two.
    pub fn for_count(rollers: u16) -> Result<Self, GeometryError> {
        if rollers == 0 {
            return Ok(Self::new(None));
        }
        Rollers::new(rollers).map(|rollers| Self::new(Some(&rollers)))
    }

    /// `sec(sweep)`.
    #[must_use]
    #[inline]
    pub fn at(&self, angle: RollerAngle) -> S {
        let x = S::from_fraction(angle.to_bits());
        let z = x * x;
        let [k0, k1, k2, k3] = self.powers;
        k0 + z * (k1 + z * (k2 + z * k3))
    }

    /// What stands for the secant of a wheel whose angle is not known: with it, the wheel's mean
    /// over whole rollers is right.
    #[must_use]
    pub const fn unknown(&self) -> S {
        self.unknown
    }

    /// The largest secant, at the roller transition.
    #[must_use]
    pub fn largest(&self) -> S {
        self.at(RollerAngle::from_bits(i32::MIN))
    }

    pub(super) const fn powers(&self) -> &[S; 4] {
        &self.powers
    }
}

/// Coefficients of a cubic in `x^2` that is `sec(pitch x)` for `x` within ± 1/2.
fn coefficients<S: Real>(pitch: S) -> [S; 4] {
    /// `cos((2k + 1) pi / 8)`, the zeros of the fourth Chebyshev polynomial, brought to 0..1/4: the
    /// values of `x^2`.
    const NODES: [f64; 4] = [
        0.240_484_941_563_910_84,
        0.172_835_429_045_636_23,
        0.077_164_570_954_363_78,
        0.009_515_058_436_089_158,
    ];
    let nodes = NODES.map(<S as crate::Scalar>::constant);
    let values = nodes.map(|z| S::ONE / (pitch * z.root()).sine_cosine().1);
    // Newton's divided differences, then multiplied out.
    let [z0, z1, z2, z3] = nodes;
    let [f0, f1, f2, f3] = values;
    let (d01, d12, d23) = (
        (f1 - f0) / (z1 - z0),
        (f2 - f1) / (z2 - z1),
        (f3 - f2) / (z3 - z2),
    );
    let (d012, d123) = ((d12 - d01) / (z2 - z0), (d23 - d12) / (z3 - z1));
    let d = (d123 - d012) / (z3 - z0);
    [
        f0 - z0 * (d01 - z1 * (d012 - z2 * d)),
        d01 - d012 * (z0 + z1) + d * (z0 * z1 + z0 * z2 + z1 * z2),
        d012 - d * (z0 + z1 + z2),
        d,
    ]
}
