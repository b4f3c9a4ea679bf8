//! Any wheels with their rollers: `J` for the secants they have now, weighted least squares,
//! covariance.
//!
//! This type is not for a control loop: building and solving the normal equations costs several
//! hundred instructions. [`PhaseMember`](super::PhaseMember) is the fast implementation for the
//! usual robot, and is tested against this one.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::secant::Secant;
use crate::arithmetic::Real;
use crate::covariance::Covariance;
use crate::error::GeometryError;
use crate::frame::Twist;
use crate::platform::Platform;
use crate::roller::Rollers;
use crate::wheel::Wheel;

/// A secant and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecantEstimate<S = f32> {
    /// The secant to compute with.
    pub value: S,
    /// Its standard deviation: 0 when the wheel's angle is known.
    pub deviation: S,
}

impl<S: Real> SecantEstimate<S> {
    /// Of a wheel whose roller angle is known.
    #[must_use]
    pub fn known(value: S) -> Self {
        Self {
            value,
            deviation: S::ZERO,
        }
    }

    /// Of a wheel with these rollers whose angle may be anything: the value is right on average
    /// over whole rollers, the deviation is the secant's about it, at a random time.
    ///
    /// Its square is `tan(a)/a - 2 m asinh(tan a)/a + m^2` with `a = pi/n` and `m = a / sin a`.
    #[must_use]
    pub fn unknown(rollers: &Rollers<S>) -> Self {
        let half = rollers.pitch() / S::constant(2.0);
        let value = Secant::new(Some(rollers)).unknown();
        let (sin, cos) = half.sine_cosine();
        let tan = sin / cos;
        let mean = tan.asinh() / half;
        let square = tan / half - S::constant(2.0) * value * mean + value * value;
        Self {
            value,
            deviation: square.root(),
        }
    }
}

/// A robot with `N` wheels of any kind whose rollers lean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhasePlatform<const N: usize, S: Real = f32> {
    straight: SMatrix<S, N, 3>,
    across: SMatrix<S, N, 3>,
    weights: [S; N],
}

impl<const N: usize, S: Real> PhasePlatform<N, S> {
    /// A robot from its wheels, all trusted alike.
    ///
    /// # Errors
    ///
    /// As [`Platform::new`] for the same wheels.
    pub fn new(wheels: &[Wheel<S>; N]) -> Result<Self, GeometryError> {
        Self::weighted(wheels, &[S::ONE; N])
    }

    /// A robot whose wheel rates are trusted differently on the way back, as
    /// [`Platform::weighted`].
    ///
    /// # Errors
    ///
    /// As [`Platform::weighted`].
    pub fn weighted(wheels: &[Wheel<S>; N], weights: &[S; N]) -> Result<Self, GeometryError> {
        Platform::weighted(wheels, weights)?;
        let mut straight = SMatrix::<S, N, 3>::zeros();
        let mut across = SMatrix::<S, N, 3>::zeros();
        let rows = straight.row_iter_mut().zip(across.row_iter_mut());
        for ((mut straight, mut across), wheel) in rows.zip(wheels) {
            let ([x, y, w], [lx, ly, lw]) = wheel.jacobian_parts();
            straight.copy_from(&nalgebra::RowVector3::new(x, y, w));
            across.copy_from(&nalgebra::RowVector3::new(lx, ly, lw));
        }
        Ok(Self {
            straight,
            across,
            weights: *weights,
        })
    }

    /// `J` with these secants.
    #[must_use]
    pub fn jacobian(&self, secants: &[S; N]) -> SMatrix<S, N, 3> {
        let mut leaning = self.across;
        for (mut row, secant) in leaning.row_iter_mut().zip(secants) {
            row *= *secant;
        }
        self.straight + leaning
    }

    /// Wheel rates (rad/s) for this twist (robot frame).
    #[must_use]
    pub fn rates(&self, twist: Twist<S>, secants: &[S; N]) -> [S; N] {
        crate::platform::array(
            &(self.jacobian(secants) * Vector3::new(twist.vx, twist.vy, twist.omega)),
        )
    }

    /// The twist (robot frame) these wheel rates (rad/s) mean, by weighted least squares.
    ///
    /// # Errors
    ///
    /// [`GeometryError::YawUncontrolled`] for secants that are not those of real wheels.
    pub fn twist(&self, rates: &[S; N], secants: &[S; N]) -> Result<Twist<S>, GeometryError> {
        let back = self.back(secants)?;
        let twist = back * nalgebra::SVector::from(*rates);
        Ok(Twist::new(twist.x, twist.y, twist.z))
    }

    /// Covariance of that twist, robot frame, when each wheel rate is known to `rate` rad/s and
    /// each secant as its estimate says: a wheel of unknown phase is unsure in proportion to its
    /// sideways speed.
    ///
    /// The phase's part does not average out from tick to tick: it stays the same until the roller
    /// has moved on.
    ///
    /// # Errors
    ///
    /// As [`PhasePlatform::twist`].
    pub fn covariance(
        &self,
        rates: &[S; N],
        secants: &[SecantEstimate<S>; N],
        rate: S,
    ) -> Result<Covariance<S>, GeometryError> {
        let values = secants.map(|secant| secant.value);
        let back = self.back(&values)?;
        let twist = back * nalgebra::SVector::from(*rates);
        let sideways = self.across * twist;
        let mut spread = back;
        for ((mut column, secant), sideways) in
            spread.column_iter_mut().zip(secants).zip(sideways.iter())
        {
            let lean = secant.deviation * *sideways;
            column *= rate * rate + lean * lean;
        }
        Ok(Covariance::from_matrix(&(spread * back.transpose())))
    }

    /// `(J^T W J)^-1 J^T W`.
    fn back(&self, secants: &[S; N]) -> Result<SMatrix<S, 3, N>, GeometryError> {
        let jacobian = self.jacobian(secants);
        let mut weighted = jacobian;
        for (mut row, weight) in weighted.row_iter_mut().zip(&self.weights) {
            row *= *weight;
        }
        let information: Matrix3<S> = weighted.transpose() * jacobian;
        let inverse = information
            .try_inverse()
            .ok_or(GeometryError::YawUncontrolled)?;
        Ok(inverse * weighted.transpose())
    }
}
