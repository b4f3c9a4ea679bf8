//! A member whose compensation depends on the motion, so that it cannot be folded.
//!
//! It applies `J C(v) K` in three steps instead of one: the mount converts the group's twist to the
//! member's, the compensation scales it, and the wheel kinematics give the rates. It costs about
//! three times as much as [`MemberKinematics`] with a constant compensation, and in the forward
//! direction also the inversion of the tables.

use crate::arithmetic::Real;
use crate::compensation::{Compensation, VelocityCompensation};
use crate::error::GeometryError;
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::Twist;
use crate::member::MemberKinematics;
use crate::mount::Mount;

/// Kinematics of one four-wheel robot in its group with any [`Compensation`].
///
/// ```
/// use mecanum_kinematics::{
///     AxisTable, CompensatedMember, FourWheelGeometry, Mount, SpeedCompensation, Twist,
/// };
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let table = |slow, fast| AxisTable::new(&[(0.1, slow), (0.5, fast)]);
/// let compensation = SpeedCompensation {
///     longitudinal: table(1.022, 1.027)?,
///     lateral: table(1.141, 1.157)?,
///     yaw: table(1.025, 1.026)?,
/// };
/// let kinematics = CompensatedMember::new(&robot, &Mount::IDENTITY, compensation)?;
/// let rates = kinematics.inverse(Twist::new(0.3, 0.2, 0.1));
/// assert!((kinematics.forward(&rates).vy - 0.2).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CompensatedMember<C, S: Real = f32> {
    wheels: MemberKinematics<S>,
    mount: Mount<S>,
    compensation: C,
}

impl<S: Real, C: Compensation<S>> CompensatedMember<C, S> {
    /// From geometry, mount and compensation.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] as for [`MemberKinematics::new`].
    pub fn new(
        geometry: &FourWheelGeometry<S>,
        mount: &Mount<S>,
        compensation: C,
    ) -> Result<Self, GeometryError> {
        let alone = Mount::at_origin();
        let none = VelocityCompensation::none();
        Ok(Self {
            wheels: MemberKinematics::new(geometry, &alone, &none)?,
            mount: *mount,
            compensation,
        })
    }

    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    #[must_use]
    pub fn inverse(&self, group: Twist<S>) -> WheelRates<S> {
        let member = self.mount.to_member(group);
        self.wheels.inverse(self.compensation.apply(member))
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean, by least squares.
    #[must_use]
    pub fn forward(&self, rates: &WheelRates<S>) -> Twist<S> {
        let asked = self.wheels.forward(rates);
        self.mount.to_group(self.compensation.remove(asked))
    }

    /// What no rigid motion explains in these wheel rates, rad/s, as
    /// [`MemberKinematics::slip_residual`].
    #[must_use]
    pub fn slip_residual(&self, rates: &WheelRates<S>) -> S {
        self.wheels.slip_residual(rates)
    }
}
