//! One four-wheel robot in a group, for the control loop.
//!
//! [`WheelKinematics`] for the usual number of wheels, with names instead of an order, and with the
//! one combination of wheel rates that must always be zero: four wheels measure three velocities.
//! If it is not zero, the cause is slip, a dead encoder or a wrong wheel radius;
//! [`MemberKinematics::slip_residual`] returns it.

use crate::arithmetic::{Real, Scalar};
use crate::compensation::VelocityCompensation;
use crate::error::{GeometryError, RangeError};
use crate::folded::WheelKinematics;
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::Twist;
use crate::mount::Mount;
use crate::platform::Platform;
use crate::wheel::Wheel;

/// Fractional bits of the slip vector in fixed point; its entries are at most 1.
const SLIP_SHIFT: u32 = 28;

/// Kinematics of one four-wheel robot in its group, compensation included.
///
/// ```
/// use mecanum_kinematics::{
///     FourWheelGeometry, MemberKinematics, Mount, Pose, Twist, VelocityCompensation,
/// };
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let mount = Mount::new(Pose::new(1.0, 0.0, 0.0))?; // 1 m ahead of the group's origin
/// let slip = VelocityCompensation::new(1.002, 1.033, 1.0195)?;
/// let kinematics = MemberKinematics::new(&robot, &mount, &slip)?;
///
/// let twist = Twist { vx: 0.5, vy: -0.2, omega: 0.1 };
/// let rates = kinematics.inverse(twist);
/// assert!((kinematics.forward(&rates).vx - 0.5).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MemberKinematics<S: Scalar = f32> {
    wheels: WheelKinematics<4, S>,
    /// Unit vector that is orthogonal to every wheel-rate vector a rigid motion makes.
    slip: [S::Coefficient; 4],
}

impl<S: Real> MemberKinematics<S> {
    /// Folds geometry, mount and compensation.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] when the wheels leave a motion uncontrolled, which a [`FourWheelGeometry`]
    /// with sensible dimensions does not.
    pub fn new(
        geometry: &FourWheelGeometry<S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        Self::from_wheels(&geometry.wheels()?, mount, compensation)
    }

    /// The same from four wheels of any kind; the names front left to rear right are then just an
    /// order.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] when the wheels leave a motion uncontrolled.
    pub fn from_wheels(
        wheels: &[Wheel<S>; 4],
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        Ok(Self::from_platform(
            &Platform::new(wheels)?,
            mount,
            compensation,
        ))
    }

    /// The same from a platform, whose weights go into the way back.
    #[must_use]
    pub fn from_platform(
        platform: &Platform<4, S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Self {
        Self {
            wheels: WheelKinematics::new(platform, mount, compensation),
            slip: null_vector(platform),
        }
    }

    /// The same for another scalar.
    ///
    /// ```
    /// use fixed::types::I16F16;
    /// use mecanum_kinematics::{
    ///     FourWheelGeometry, MemberKinematics, Mount, Twist, VelocityCompensation,
    /// };
    ///
    /// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
    /// let single = MemberKinematics::new(&robot, &Mount::IDENTITY, &VelocityCompensation::NONE)?;
    /// let fixed = single.convert::<I16F16>()?;
    ///
    /// let rates = fixed.inverse(Twist { vx: 0.5, vy: 0.0, omega: 0.0 }.convert());
    /// assert!(!rates.is_saturated());
    /// // One step of 2^-16.
    /// assert!((rates.front_left.to_num::<f64>() - 0.5 / 0.1524).abs() < 1.6e-5);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`RangeError`] as for [`WheelKinematics::convert`].
    pub fn convert<T: Scalar>(&self) -> Result<MemberKinematics<T>, RangeError> {
        Ok(MemberKinematics {
            wheels: self.wheels.convert()?,
            slip: T::row::<SLIP_SHIFT, 4>(self.slip.map(Scalar::widen))
                .ok_or(RangeError::Forward)?,
        })
    }
}

impl<S: Scalar> MemberKinematics<S> {
    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    #[must_use]
    #[inline]
    pub fn inverse(&self, group: Twist<S>) -> WheelRates<S> {
        WheelRates::from(self.wheels.inverse(group))
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean, by least squares.
    #[must_use]
    #[inline]
    pub fn forward(&self, rates: &WheelRates<S>) -> Twist<S> {
        self.wheels.forward(&(*rates).into())
    }

    /// The displacement of the group (group frame; m, m, rad) that these wheel-angle increments
    /// (rad) mean: the same linear relation as [`MemberKinematics::forward`].
    #[must_use]
    #[inline]
    pub fn displacement(&self, increments: &WheelRates<S>) -> Twist<S> {
        self.forward(increments)
    }

    /// What no rigid motion explains in these wheel rates, rad/s.
    ///
    /// The component along the one direction in wheel-rate space that no twist produces; its
    /// magnitude is the root of the summed squares of the least-squares residuals. On the symmetric
    /// robot it is `(front_left + front_right - rear_left - rear_right) / 2`. Compensation does not
    /// enter it.
    #[must_use]
    #[inline]
    pub fn slip_residual(&self, rates: &WheelRates<S>) -> S {
        S::dot::<SLIP_SHIFT, true, 4>(&self.slip, &(*rates).into())
    }

    /// The same by wheel order instead of by name.
    #[must_use]
    pub const fn wheels(&self) -> &WheelKinematics<4, S> {
        &self.wheels
    }
}

/// The unit vector orthogonal to the three columns of `J`, front-left component not negative.
fn null_vector<S: Real>(platform: &Platform<4, S>) -> [S; 4] {
    let j = platform.jacobian();
    let row = |i: usize| j.fixed_rows::<1>(i).transpose();
    let (a, b, c, d) = (row(0), row(1), row(2), row(3));
    // Cofactors: the determinant of J with one row left out, signs alternating.
    let volume = |p: &nalgebra::Vector3<S>, q: &nalgebra::Vector3<S>, r: &nalgebra::Vector3<S>| {
        p.dot(&q.cross(r))
    };
    let raw = nalgebra::Vector4::new(
        volume(&b, &c, &d),
        -volume(&a, &c, &d),
        volume(&a, &b, &d),
        -volume(&a, &b, &c),
    );
    let unit = raw / raw.dot(&raw).root();
    let sign = if unit.x < S::zero() {
        -S::one()
    } else {
        S::one()
    };
    [unit.x * sign, unit.y * sign, unit.z * sign, unit.w * sign]
}
