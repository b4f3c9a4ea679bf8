//! `J C K` of equation (19), folded into one matrix, and its least-squares inverse, for any number
//! of wheels.
//!
//! The matrices are built once from the wheels, the mount and the compensation. Both directions are
//! one matrix times one vector. The forward direction is the inverse of the same product with the
//! same `C`, so that `forward(inverse(twist))` is `twist` and compensation is applied only once.

use crate::arithmetic::{Real, Scalar};
use crate::compensation::VelocityCompensation;
use crate::error::RangeError;
use crate::frame::Twist;
use crate::mount::Mount;
use crate::platform::Platform;

/// Fractional bits of the matrix to the wheels in fixed point: its rows may sum to 2048.
const INVERSE_SHIFT: u32 = 20;
/// Fractional bits of the matrix back, whose entries are a fraction of a wheel radius: rows may sum
/// to 8.
const FORWARD_SHIFT: u32 = 28;

/// Kinematics of one robot with `N` wheels in its group, compensation included.
///
/// ```
/// use mecanum_kinematics::{Mount, Platform, Twist, VelocityCompensation, Wheel, WheelKinematics};
///
/// // A carrier with three wheels on each side.
/// let wheels = [(0.9, 1.0), (0.0, -1.0), (-0.9, 1.0)].map(|(x, hand)| {
///     [0.5, -0.5].map(|y: f32| Wheel::new(x, y, 0.0, hand * 0.785 * y.signum(), 0.1).unwrap())
/// });
/// let [[a, b], [c, d], [e, f]] = wheels;
/// let platform = Platform::new(&[a, b, c, d, e, f])?;
/// let kinematics = WheelKinematics::new(&platform, &Mount::IDENTITY, &VelocityCompensation::NONE);
/// let rates: [f32; 6] = kinematics.inverse(Twist::new(0.4, 0.1, -0.2));
/// assert!((kinematics.forward(&rates).omega + 0.2).abs() < 1e-5);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelKinematics<const N: usize, S: Scalar = f32> {
    /// Rows of `J C K`, one per wheel.
    inverse: [[S::Coefficient; 3]; N],
    /// Rows vx, vy, omega of its least-squares inverse.
    forward: [[S::Coefficient; N]; 3],
}

impl<const N: usize, S: Real> WheelKinematics<N, S> {
    /// Folds wheels, mount and compensation; the platform's weights go into the way back.
    #[must_use]
    pub fn new(
        platform: &Platform<N, S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Self {
        // J C K: each row of J, scaled by C, times K.
        let k = mount.matrix();
        let mut inverse = [[S::ZERO; 3]; N];
        for (row, j) in inverse
            .iter_mut()
            .zip(platform.jacobian().transpose().column_iter())
        {
            let asked = compensation.apply(Twist::new(j.x, j.y, j.z));
            let [kx, ky, kw] = k;
            for (entry, ((x, y), w)) in row.iter_mut().zip(kx.iter().zip(ky).zip(kw)) {
                *entry = asked.vx * *x + asked.vy * y + asked.omega * w;
            }
        }
        // K^-1 C^-1 J^+: each column of J^+ is a twist, taken back the same way.
        let mut forward = [[S::ZERO; N]; 3];
        let [vx, vy, omega] = &mut forward;
        let rows = vx.iter_mut().zip(vy).zip(omega);
        for (((vx, vy), omega), column) in rows.zip(platform.jacobian_inverse().column_iter()) {
            let member = compensation.remove(Twist::new(column.x, column.y, column.z));
            let group = mount.to_group(member);
            (*vx, *vy, *omega) = (group.vx, group.vy, group.omega);
        }
        Self { inverse, forward }
    }

    /// The same matrices for another scalar, such as fixed point.
    ///
    /// # Errors
    ///
    /// [`RangeError`] when a coefficient does not fit: in fixed point when a row to the wheels sums
    /// to 2048 rad/m or more, or a row back to 8 m or more.
    pub fn convert<T: Scalar>(&self) -> Result<WheelKinematics<N, T>, RangeError> {
        let mut inverse = [T::row::<INVERSE_SHIFT, 3>([0.0; 3]).ok_or(RangeError::Inverse)?; N];
        for (to, from) in inverse.iter_mut().zip(self.inverse) {
            let entries = from.map(Scalar::widen);
            *to = T::row::<INVERSE_SHIFT, 3>(entries).ok_or(RangeError::Inverse)?;
        }
        let [vx, vy, omega] = self
            .forward
            .map(|row| T::row::<FORWARD_SHIFT, N>(row.map(Scalar::widen)));
        Ok(WheelKinematics {
            inverse,
            forward: [
                vx.ok_or(RangeError::Forward)?,
                vy.ok_or(RangeError::Forward)?,
                omega.ok_or(RangeError::Forward)?,
            ],
        })
    }
}

impl<const N: usize, S: Scalar> WheelKinematics<N, S> {
    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    #[must_use]
    #[inline]
    pub fn inverse(&self, group: Twist<S>) -> [S; N] {
        let twist = [group.vx, group.vy, group.omega];
        S::product::<INVERSE_SHIFT, false, 3, N>(&self.inverse, &twist)
    }

    /// The group twist (group frame) these wheel rates (rad/s) mean, by least squares.
    #[must_use]
    #[inline]
    pub fn forward(&self, rates: &[S; N]) -> Twist<S> {
        let [vx, vy, omega] = S::product::<FORWARD_SHIFT, true, N, 3>(&self.forward, rates);
        Twist { vx, vy, omega }
    }

    /// Largest possible error of [`WheelKinematics::inverse`] for this twist, rad/s, against exact
    /// arithmetic on the exact matrices, as long as the result does not saturate. Zero for floating
    /// point, whose errors are relative.
    #[must_use]
    pub fn inverse_bound(twist: Twist<S>) -> f64 {
        Self::bound::<INVERSE_SHIFT, 3>(1.0, &[twist.vx, twist.vy, twist.omega])
    }

    /// Largest possible error of each component of [`WheelKinematics::forward`] for these rates,
    /// m/s and rad/s; as [`WheelKinematics::inverse_bound`].
    #[must_use]
    pub fn forward_bound(rates: &[S; N]) -> f64 {
        Self::bound::<FORWARD_SHIFT, N>(0.5, rates)
    }

    /// One cut to the steps of the result, half a step of a coefficient for every unit of input.
    fn bound<const SHIFT: u32, const M: usize>(steps: f64, inputs: &[S; M]) -> f64 {
        let inputs = inputs.iter().fold(0.0, |sum, v| sum + v.widen().abs());
        S::RESOLUTION * steps + S::coefficient_step::<SHIFT>() / 2.0 * inputs
    }
}
