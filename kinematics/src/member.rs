//! One robot in a group, ready for the control loop: `J C K` of equation (19) in twelve numbers.
//!
//! Built once from the geometry, the mount and the compensation; used every millisecond. The inverse takes
//! twelve multiplications, the forward path the same: the least-squares inverse of the same product,
//! with the same `C`, so that `forward(inverse(twist))` is `twist` and nothing is compensated twice.
//!
//! Four wheels measure three velocities, so one combination of wheel rates must always be zero. What is left
//! in it is slip, a dead encoder or a wrong wheel radius: the [`MemberKinematics::slip_residual`].

use crate::arithmetic::Real;
use crate::compensation::VelocityCompensation;
use crate::error::GeometryError;
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::Twist;
use crate::mount::Mount;
use crate::platform::Platform;
use crate::wheel::Wheel;

/// Kinematics of one four-wheel robot in its group, compensation included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MemberKinematics<S = f32> {
    /// Rows front left, front right, rear left, rear right of `J C K`.
    inverse: [[S; 3]; 4],
    /// Rows vx, vy, omega of its least-squares inverse.
    forward: [[S; 4]; 3],
    /// Unit vector that is orthogonal to every wheel-rate vector a rigid motion makes.
    slip: [S; 4],
}

impl<S: Real> MemberKinematics<S> {
    /// Folds geometry, mount and compensation.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] when the wheels leave a motion uncontrolled, which a [`FourWheelGeometry`] with
    /// sensible dimensions does not.
    pub fn new(
        geometry: &FourWheelGeometry<S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        Self::from_wheels(&geometry.wheels()?, mount, compensation)
    }

    /// The same from four wheels of any kind; the names front left to rear right are then just an order.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] when the wheels leave a motion uncontrolled.
    pub fn from_wheels(
        wheels: &[Wheel<S>; 4],
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Result<Self, GeometryError> {
        let platform = Platform::new(wheels)?;
        let j = platform.jacobian();
        let back = platform.jacobian_inverse();

        // J C K: each row of J, scaled by C, applied to the columns of K.
        let [kx, ky, kw] = mount.matrix();
        let row = |jx: S, jy: S, jw: S| {
            let asked = compensation.apply(Twist::new(jx, jy, jw));
            let entry = |x: S, y: S, w: S| asked.vx * x + asked.vy * y + asked.omega * w;
            let ([kxx, kxy, kxw], [kyx, kyy, kyw], [kwx, kwy, kww]) = (kx, ky, kw);
            [
                entry(kxx, kyx, kwx),
                entry(kxy, kyy, kwy),
                entry(kxw, kyw, kww),
            ]
        };
        // K^-1 C^-1 J^+: each column of J^+ is a twist, taken back the same way.
        let column = |x: S, y: S, w: S| mount.to_group(compensation.remove(Twist::new(x, y, w)));
        let columns = [
            column(back.m11, back.m21, back.m31),
            column(back.m12, back.m22, back.m32),
            column(back.m13, back.m23, back.m33),
            column(back.m14, back.m24, back.m34),
        ];
        Ok(Self {
            inverse: [
                row(j.m11, j.m12, j.m13),
                row(j.m21, j.m22, j.m23),
                row(j.m31, j.m32, j.m33),
                row(j.m41, j.m42, j.m43),
            ],
            forward: [
                columns.map(|c| c.vx),
                columns.map(|c| c.vy),
                columns.map(|c| c.omega),
            ],
            slip: null_vector(&platform),
        })
    }

    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    #[must_use]
    #[inline]
    pub fn inverse(&self, group: Twist<S>) -> WheelRates<S> {
        let rate = |[x, y, w]: [S; 3]| x * group.vx + y * group.vy + w * group.omega;
        let [front_left, front_right, rear_left, rear_right] = self.inverse;
        WheelRates {
            front_left: rate(front_left),
            front_right: rate(front_right),
            rear_left: rate(rear_left),
            rear_right: rate(rear_right),
        }
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean, by least squares.
    #[must_use]
    #[inline]
    pub fn forward(&self, rates: &WheelRates<S>) -> Twist<S> {
        let [vx, vy, omega] = self.forward;
        Twist {
            vx: dot(vx, rates),
            vy: dot(vy, rates),
            omega: dot(omega, rates),
        }
    }

    /// What no rigid motion explains in these wheel rates, rad/s.
    ///
    /// The component along the one direction in wheel-rate space that no twist produces; its magnitude is the
    /// root of the summed squares of the least-squares residuals. On the symmetric robot it is
    /// `(front_left + front_right - rear_left - rear_right) / 2`. Compensation does not enter it.
    #[must_use]
    #[inline]
    pub fn slip_residual(&self, rates: &WheelRates<S>) -> S {
        dot(self.slip, rates)
    }
}

#[inline]
fn dot<S: Real>([a, b, c, d]: [S; 4], rates: &WheelRates<S>) -> S {
    a * rates.front_left + b * rates.front_right + c * rates.rear_left + d * rates.rear_right
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
    let unit = raw.normalize();
    let sign = if unit.x < S::zero() {
        -S::one()
    } else {
        S::one()
    };
    [unit.x * sign, unit.y * sign, unit.z * sign, unit.w * sign]
}
