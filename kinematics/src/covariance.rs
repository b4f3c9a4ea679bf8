//! The uncertainty of a twist or a pose.
//!
//! The twist's uncertainty has three sources: noise of the wheel rates (encoder steps), slip, which
//! shows as a residual of the wheel rates, and the compensation, which is known only to a few
//! tenths of a per cent. The first two enter through the least-squares inverse, the third in
//! proportion to the speed.

use nalgebra::{Matrix3, SMatrix};

use crate::arithmetic::Real;
use crate::compensation::VelocityCompensation;
use crate::folded::WheelKinematics;
use crate::frame::Twist;
use crate::mount::Mount;
use crate::platform::Platform;

/// Covariance of a twist ((m/s)^2, (rad/s)^2 and products) or of a pose (m^2, rad^2 and products);
/// symmetric.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Covariance<S = f32> {
    /// Variance along x.
    pub xx: S,
    /// Covariance of x and y.
    pub xy: S,
    /// Covariance of x and the angular part.
    pub xw: S,
    /// Variance along y.
    pub yy: S,
    /// Covariance of y and the angular part.
    pub yw: S,
    /// Variance of the angular part.
    pub ww: S,
}

impl<S: Real> Covariance<S> {
    /// From three independent standard deviations.
    #[must_use]
    pub fn from_deviations(x: S, y: S, angular: S) -> Self {
        Self {
            xx: x * x,
            yy: y * y,
            ww: angular * angular,
            ..Self::default()
        }
    }

    pub(crate) fn matrix(&self) -> Matrix3<S> {
        let Self {
            xx,
            xy,
            xw,
            yy,
            yw,
            ww,
        } = *self;
        Matrix3::new(xx, xy, xw, xy, yy, yw, xw, yw, ww)
    }

    pub(crate) fn from_matrix(m: &Matrix3<S>) -> Self {
        Self {
            xx: m.m11,
            xy: m.m12,
            xw: m.m13,
            yy: m.m22,
            yw: m.m23,
            ww: m.m33,
        }
    }

    /// The covariance of a linear image `map` of what this is the covariance of.
    pub(crate) fn through(&self, map: &Matrix3<S>) -> Self {
        Self::from_matrix(&(map * self.matrix() * map.transpose()))
    }

    /// The same covariance times a factor, such as `dt^2`.
    #[must_use]
    pub fn scaled(&self, factor: S) -> Self {
        Self::from_matrix(&(self.matrix() * factor))
    }
}

/// What is known about the errors of a robot's measurement of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Uncertainty<S = f32> {
    /// Standard deviation of one wheel rate, rad/s.
    pub wheel_rate: S,
    /// Relative standard deviation of the longitudinal coefficient, 0.01 for one percent.
    pub longitudinal: S,
    /// The same of the lateral one.
    pub lateral: S,
    /// The same of the yaw one.
    pub yaw: S,
}

/// Works out the covariance of a forward-kinematics result.
///
/// ```
/// use mecanum_kinematics::{
///     FourWheelGeometry, Mount, Platform, TwistUncertainty, Uncertainty, VelocityCompensation,
/// };
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let platform = Platform::new(&robot.wheels()?)?;
/// let known = Uncertainty { wheel_rate: 0.02, longitudinal: 0.002, lateral: 0.01, yaw: 0.01 };
/// let uncertainty =
///     TwistUncertainty::new(&platform, &Mount::IDENTITY, &VelocityCompensation::NONE, &known);
/// let even = uncertainty.covariance(&[3.0, 3.0, 3.0, 3.0]);
/// let slipping = uncertainty.covariance(&[3.5, 3.0, 3.0, 3.0]);
/// assert!(slipping.yy > even.yy);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwistUncertainty<const N: usize, S: Real = f32> {
    platform: Platform<N, S>,
    kinematics: WheelKinematics<N, S>,
    /// `C^-1 J^+`: member twist per wheel rate.
    per_rate: SMatrix<S, 3, N>,
    /// `K^-1`.
    to_group: Matrix3<S>,
    mount: Mount<S>,
    uncertainty: Uncertainty<S>,
}

impl<const N: usize, S: Real> TwistUncertainty<N, S> {
    /// For the robot whose [`WheelKinematics`] are built from the same three.
    #[must_use]
    pub fn new(
        platform: &Platform<N, S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
        uncertainty: &Uncertainty<S>,
    ) -> Self {
        let mut per_rate = *platform.jacobian_inverse();
        for mut column in per_rate.column_iter_mut() {
            let member = compensation.remove(Twist::new(column.x, column.y, column.z));
            column.copy_from(&nalgebra::Vector3::new(member.vx, member.vy, member.omega));
        }
        let (zero, one) = (S::ZERO, S::ONE);
        let columns = [
            Twist::new(one, zero, zero),
            Twist::new(zero, one, zero),
            Twist::new(zero, zero, one),
        ]
        .map(|axis| {
            let group = mount.to_group(axis);
            nalgebra::Vector3::new(group.vx, group.vy, group.omega)
        });
        Self {
            platform: *platform,
            kinematics: WheelKinematics::new(platform, mount, compensation),
            per_rate,
            to_group: Matrix3::from_columns(&columns),
            mount: *mount,
            uncertainty: *uncertainty,
        }
    }

    /// Covariance of the group twist that these wheel rates (rad/s) mean, group frame.
    ///
    /// The residual of N wheels has N - 3 degrees of freedom; its mean square is added to the wheel
    /// rates' own variance. Three wheels have no residual, so their slip stays unseen.
    #[must_use]
    pub fn covariance(&self, rates: &[S; N]) -> Covariance<S> {
        let Uncertainty {
            wheel_rate,
            longitudinal,
            lateral,
            yaw,
        } = self.uncertainty;
        let residual = self.platform.slip_residual(rates);
        let mut spare = S::ZERO;
        for _ in 3..N {
            spare += S::ONE;
        }
        let slip = if spare > S::ZERO {
            residual * residual / spare
        } else {
            S::ZERO
        };
        let rate_variance = wheel_rate * wheel_rate + slip;
        let member = self.mount.to_member(self.kinematics.forward(rates));
        let from_rates = self.per_rate * self.per_rate.transpose() * rate_variance;
        let from_compensation = Covariance::from_deviations(
            longitudinal * member.vx,
            lateral * member.vy,
            yaw * member.omega,
        );
        Covariance::from_matrix(&(from_rates + from_compensation.matrix())).through(&self.to_group)
    }
}
