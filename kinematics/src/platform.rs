//! A robot as a set of wheels: its inverse Jacobian `J`, checked, and the least-squares way back.
//!
//! With three wheels or more the wheel rates follow from the twist (`J`, N rows of three). The way back has
//! more equations than unknowns, so the twist is the one that leaves the smallest sum of squared wheel-rate
//! errors, `(J^T J)^-1 J^T`, worked out once. Whether that inverse exists is a question about the wheels,
//! and is answered when the robot is built, by an error that says what is wrong with them.

use nalgebra::{SMatrix, SVector};

use crate::arithmetic::Real;
use crate::error::GeometryError;
use crate::wheel::Wheel;

/// A robot with `N` Mecanum wheels anywhere on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Platform<const N: usize, S: Real = f32> {
    jacobian: SMatrix<S, N, 3>,
    inverse: SMatrix<S, 3, N>,
}

impl<const N: usize, S: Real> Platform<N, S> {
    /// A robot from its wheels.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] when there are fewer than three wheels, or when the wheels leave a motion
    /// uncontrolled: [`GeometryError::TranslationUncontrolled`], [`GeometryError::YawUncontrolled`].
    pub fn new(wheels: &[Wheel<S>; N]) -> Result<Self, GeometryError> {
        if N < 3 {
            return Err(GeometryError::TooFewWheels);
        }
        let rows = wheels.map(|wheel| wheel.jacobian_row());
        let jacobian = SMatrix::<S, N, 3>::from_fn(|i, j| {
            rows.get(i)
                .and_then(|row| row.get(j))
                .copied()
                .unwrap_or_else(S::zero)
        });
        // The most yaw these wheels could control, were every roller axle square to its lever arm.
        let lever = wheels
            .iter()
            .zip(&rows)
            .map(|(wheel, [x, y, _])| {
                (*x * *x + *y * *y) * (wheel.x() * wheel.x() + wheel.y() * wheel.y())
            })
            .fold(S::zero(), |sum, term| sum + term);
        let inverse = least_squares(&jacobian, lever)?;
        Ok(Self { jacobian, inverse })
    }

    /// `J`: wheel rates (rad/s) = J times twist (m/s, m/s, rad/s), robot frame.
    #[must_use]
    pub const fn jacobian(&self) -> &SMatrix<S, N, 3> {
        &self.jacobian
    }

    /// The least-squares inverse of `J`: twist = this times wheel rates.
    #[must_use]
    pub const fn jacobian_inverse(&self) -> &SMatrix<S, 3, N> {
        &self.inverse
    }

    /// The part of these wheel rates that no rigid motion explains, per wheel, rad/s.
    #[must_use]
    pub fn residual(&self, rates: &SVector<S, N>) -> SVector<S, N> {
        rates - self.jacobian * (self.inverse * rates)
    }
}

/// `(J^T J)^-1 J^T`, or what the wheels leave uncontrolled.
fn least_squares<const N: usize, S: Real>(
    jacobian: &SMatrix<S, N, 3>,
    lever: S,
) -> Result<SMatrix<S, 3, N>, GeometryError> {
    // These are squares: in f32 this is 1/360 of the motion the best placed wheels would give.
    let negligible = S::default_epsilon() * S::constant(64.0);
    let normal = jacobian.transpose() * jacobian;
    let [xx, xy, yy] = [normal.m11, normal.m12, normal.m22];
    let plane = xx * yy - xy * xy;
    let translation = plane > negligible * xx.max(yy) * xx.max(yy);
    if !translation {
        return Err(GeometryError::TranslationUncontrolled);
    }
    let yaw = normal.determinant() > negligible * plane * lever;
    if !yaw {
        return Err(GeometryError::YawUncontrolled);
    }
    let inverted = normal.try_inverse().ok_or(GeometryError::YawUncontrolled)?;
    Ok(inverted * jacobian.transpose())
}
