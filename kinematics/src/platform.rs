//! A robot as a set of wheels: its inverse Jacobian `J`, checked, and the least-squares inverse.
//!
//! With three wheels or more the wheel rates follow from the twist (`J`, N rows of three). The
//! forward direction has more equations than unknowns, so the result is the twist with the smallest
//! weighted sum of squared wheel-rate errors; its matrix `(J^T W J)^-1 J^T W` is computed once. The
//! arrangement of the wheels determines whether that inverse exists and is well conditioned; if
//! not, the constructor returns an error that names the cause.

use nalgebra::{Matrix3, RowVector3, SMatrix};

use crate::arithmetic::Real;
use crate::error::GeometryError;
use crate::frame::Twist;
use crate::wheel::Wheel;

/// Share of the information in the best direction below which the worst one is refused: as these
/// are squares, a motion 100 times harder to control than the easiest.
const POOR: f64 = 1e-4;

/// A robot with `N` Mecanum wheels anywhere on it.
///
/// ```
/// use mecanum_kinematics::{Platform, Twist, Wheel};
///
/// // Three wheels, 120 degrees apart, 0.3 m from the centre, each rolling along its own circle.
/// let third = core::f64::consts::TAU / 3.0;
/// let wheels = [0.0, 1.0, 2.0].map(|i| {
///     let (sin, cos) = (i * third).sin_cos();
///     Wheel::new(0.3 * cos, 0.3 * sin, i * third + third, 0.785, 0.1).unwrap()
/// });
/// let robot = Platform::new(&wheels)?;
/// let twist = Twist::new(0.5, -0.2, 0.3);
/// let back = robot.twist(&robot.rates(twist));
/// assert!((back.vy - twist.vy).abs() < 1e-12);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Platform<const N: usize, S: Real = f32> {
    jacobian: SMatrix<S, N, 3>,
    inverse: SMatrix<S, 3, N>,
    /// `J^T W J`: what the wheels say about the twist, in the robot's frame.
    information: Matrix3<S>,
}

impl<const N: usize, S: Real> Platform<N, S> {
    /// A robot from its wheels, all trusted alike.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] when there are fewer than three wheels, or when the wheels leave a motion
    /// uncontrolled or all but uncontrolled.
    pub fn new(wheels: &[Wheel<S>; N]) -> Result<Self, GeometryError> {
        Self::weighted(wheels, &[S::ONE; N])
    }

    /// A robot whose wheel-rate measurements are trusted differently on the way back: each squared
    /// error counts `weights` times. A weight of zero leaves a wheel's measurement out (a dead
    /// encoder); the wheel still drives.
    ///
    /// # Errors
    ///
    /// As [`Platform::new`], for the wheels with a weight above zero; and for a weight that is
    /// negative or not finite.
    pub fn weighted(wheels: &[Wheel<S>; N], weights: &[S; N]) -> Result<Self, GeometryError> {
        for weight in weights {
            if !weight.is_finite() || *weight < S::ZERO {
                return Err(GeometryError::Weight);
            }
        }
        if weights.iter().filter(|weight| **weight > S::ZERO).count() < 3 {
            return Err(GeometryError::TooFewWheels);
        }
        let mut jacobian = SMatrix::<S, N, 3>::zeros();
        let mut weighted = SMatrix::<S, N, 3>::zeros();
        // The most yaw these wheels could control, were every roller axle square to its lever arm
        // about the wheels' own middle.
        let middle = |along: fn(&Wheel<S>) -> S| {
            let (sum, total) = wheels
                .iter()
                .zip(weights)
                .fold((S::ZERO, S::ZERO), |(sum, total), (wheel, weight)| {
                    (sum + along(wheel) * *weight, total + *weight)
                });
            sum / total
        };
        let (middle_x, middle_y) = (middle(Wheel::x), middle(Wheel::y));
        // The inverse is found about that middle and shifted to the origin. About an origin that is
        // far from the wheels, yaw is the small difference of entries that have the square of the
        // distance.
        let mut central = SMatrix::<S, N, 3>::zeros();
        let mut lever = S::ZERO;
        let rows = jacobian.row_iter_mut().zip(central.row_iter_mut());
        let rows = rows.zip(weighted.row_iter_mut());
        for (((mut row, mut central_row), mut weighted_row), (wheel, weight)) in
            rows.zip(wheels.iter().zip(weights))
        {
            let [x, y, w] = wheel.jacobian_row();
            row.copy_from(&RowVector3::new(x, y, w));
            let (dx, dy) = (wheel.x() - middle_x, wheel.y() - middle_y);
            let entries = RowVector3::new(x, y, dx * y - dy * x);
            central_row.copy_from(&entries);
            weighted_row.copy_from(&(entries * *weight));
            lever += *weight * (x * x + y * y) * (dx * dx + dy * dy);
        }
        let about_middle = weighted.transpose() * central;
        let mut inverse = invert(&about_middle, lever)? * weighted.transpose();
        for mut column in inverse.column_iter_mut() {
            let omega = column.z;
            column.x += omega * middle_y;
            column.y -= omega * middle_x;
        }
        let to_middle = shift(middle_x, middle_y);
        Ok(Self {
            jacobian,
            inverse,
            information: to_middle.transpose() * about_middle * to_middle,
        })
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

    /// `J^T W J`, robot frame: the inverse of the twist's covariance for wheel rates known to 1
    /// rad/s.
    #[must_use]
    pub const fn information(&self) -> &Matrix3<S> {
        &self.information
    }

    /// Condition number: how much less accurately the wheel rates determine the worst motion than
    /// the best, 1 or more.
    ///
    /// The ratio of the largest to the smallest singular value of `J`, with yaw taken per metre of
    /// the wheels' typical lever arm so that the unit of length does not matter.
    #[must_use]
    pub fn conditioning(&self) -> S {
        let n = &self.information;
        let translation = (n.m11 + n.m22) / S::constant(2.0);
        let lever = (n.m33 / translation).root();
        let scale = Matrix3::from_diagonal(&nalgebra::Vector3::new(S::ONE, S::ONE, S::ONE / lever));
        let values = (scale * n * scale).symmetric_eigenvalues();
        (values.max() / values.min()).root()
    }

    /// Wheel rates (rad/s) for this twist (robot frame), uncompensated.
    #[must_use]
    pub fn rates(&self, twist: Twist<S>) -> [S; N] {
        let rates = self.jacobian * nalgebra::Vector3::new(twist.vx, twist.vy, twist.omega);
        array(&rates)
    }

    /// The twist (robot frame) these wheel rates (rad/s) mean, by least squares, uncompensated.
    #[must_use]
    pub fn twist(&self, rates: &[S; N]) -> Twist<S> {
        let twist = self.inverse * nalgebra::SVector::from(*rates);
        Twist::new(twist.x, twist.y, twist.z)
    }

    /// The part of these wheel rates that no rigid motion explains, per wheel, rad/s.
    #[must_use]
    pub fn residual(&self, rates: &[S; N]) -> [S; N] {
        let rates = nalgebra::SVector::from(*rates);
        array(&(rates - self.jacobian * (self.inverse * rates)))
    }

    /// Root of the summed squares of [`Platform::residual`], rad/s. With three wheels always zero:
    /// they explain anything.
    #[must_use]
    pub fn slip_residual(&self, rates: &[S; N]) -> S {
        let sum = self
            .residual(rates)
            .iter()
            .fold(S::ZERO, |sum, error| sum + *error * *error);
        sum.root()
    }
}

/// Takes the twist of one point to the point that stands (x, y) m from it.
pub(crate) fn shift<S: Real>(x: S, y: S) -> Matrix3<S> {
    let (zero, one) = (S::ZERO, S::ONE);
    Matrix3::new(one, zero, -y, zero, one, x, zero, zero, one)
}

/// A column vector as an array.
pub(crate) fn array<const N: usize, S: Real>(vector: &nalgebra::SVector<S, N>) -> [S; N] {
    (*vector).into()
}

/// The inverse of `J^T W J`, or what the wheels leave uncontrolled. `lever` is what its yaw entry
/// could be at most.
fn invert<S: Real>(information: &Matrix3<S>, lever: S) -> Result<Matrix3<S>, GeometryError> {
    let [xx, xy, yy] = [information.m11, information.m12, information.m22];
    // Below this share a determinant is rounding.
    let rounding = S::default_epsilon() * S::constant(64.0);
    let poor = S::constant(POOR);
    let best = xx.max(yy) * xx.max(yy);
    let plane = xx * yy - xy * xy;
    let determinant = information.determinant();
    for (share, of, uncontrolled, hard) in [
        (
            plane,
            best,
            GeometryError::TranslationUncontrolled,
            GeometryError::TranslationPoor,
        ),
        (
            determinant,
            plane * lever,
            GeometryError::YawUncontrolled,
            GeometryError::YawPoor,
        ),
    ] {
        let controlled = share > rounding * of;
        if !controlled {
            return Err(uncontrolled);
        }
        if share < poor * of {
            return Err(hard);
        }
    }
    information
        .try_inverse()
        .ok_or(GeometryError::YawUncontrolled)
}
