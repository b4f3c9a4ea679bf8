//! One Mecanum wheel, anywhere on a robot.
//!
//! The roller on the ground turns freely about its axle and grips along it. So the ground speed of
//! the wheel's centre, taken along that axle, must equal the rim speed taken along it: `rate *
//! radius * (d . a) = v . a`, with `d` the rolling direction and `a` the roller axle. This is
//! equation (2) of the paper in vectors; [`crate::paper`] has it as printed.

use crate::arithmetic::Real;
use crate::error::GeometryError;
use crate::frame::Twist;

/// A Mecanum wheel: where it is, how it is mounted, how its rollers stand.
///
/// ```
/// use mecanum_kinematics::Wheel;
///
/// // Front left on the usual robot: 0.35 m ahead, 0.37 m left, rollers at 45 degrees.
/// let wheel = Wheel::new(0.35, 0.37, 0.0, 45_f64.to_radians(), 0.1524)?;
/// let [vx, vy, omega] = wheel.jacobian_row();
/// assert!((vx * 0.1524 - 1.0).abs() < 1e-12); // 1 m/s forward: 1/r
/// assert!((vy * 0.1524 + 1.0).abs() < 1e-12); // 1 m/s to the left: -1/r
/// assert!((omega * 0.1524 + 0.72).abs() < 1e-12);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheel<S = f32> {
    x: S,
    y: S,
    mounting_angle: S,
    roller_angle: S,
    radius: S,
    reversed: bool,
}

impl<S: Real> Wheel<S> {
    /// A wheel with its centre at (`x`, `y`) m in the robot frame.
    ///
    /// `mounting_angle` (rad) is the direction the wheel rolls in at a positive rate, 0 along x.
    /// `roller_angle` (rad) is the angle of the ground roller's axle against the wheel's axle, seen
    /// from above, counter-clockwise positive, between 0 and 90 degrees either way; its sign is the
    /// wheel's handedness. On the usual robot it is positive front left and rear right, negative on
    /// the others. `radius` in m.
    ///
    /// # Errors
    ///
    /// [`GeometryError`] naming the field that is not finite, a radius that is not positive, or a
    /// roller angle outside the open interval.
    pub fn new(
        x: S,
        y: S,
        mounting_angle: S,
        roller_angle: S,
        radius: S,
    ) -> Result<Self, GeometryError> {
        for (value, field) in [
            (x, "x"),
            (y, "y"),
            (mounting_angle, "mounting_angle"),
            (roller_angle, "roller_angle"),
            (radius, "wheel_radius"),
        ] {
            if !value.is_finite() {
                return Err(GeometryError::NotFinite(field));
            }
        }
        if radius <= S::zero() {
            return Err(GeometryError::NotPositive("wheel_radius"));
        }
        if roller_angle == S::zero() || roller_angle.abs() >= S::frac_pi_2() {
            return Err(GeometryError::RollerAngle);
        }
        Ok(Self {
            x,
            y,
            mounting_angle,
            roller_angle,
            radius,
            reversed: false,
        })
    }

    /// The same wheel with the sign of its rate turned around: positive now rolls backwards.
    #[must_use]
    pub const fn reversed(self) -> Self {
        Self {
            reversed: !self.reversed,
            ..self
        }
    }

    /// Whether a positive rate rolls against the mounting angle.
    #[must_use]
    pub const fn is_reversed(&self) -> bool {
        self.reversed
    }

    /// Position of the centre along x, forward positive, m.
    #[must_use]
    pub const fn x(&self) -> S {
        self.x
    }

    /// Position of the centre along y, left positive, m.
    #[must_use]
    pub const fn y(&self) -> S {
        self.y
    }

    /// Direction of rolling at a positive rate, rad.
    #[must_use]
    pub const fn mounting_angle(&self) -> S {
        self.mounting_angle
    }

    /// Ground roller's axle against the wheel's axle, counter-clockwise positive, rad.
    #[must_use]
    pub const fn roller_angle(&self) -> S {
        self.roller_angle
    }

    /// Radius, m.
    #[must_use]
    pub const fn radius(&self) -> S {
        self.radius
    }

    /// The wheel's row of the inverse Jacobian: rate (rad/s) for a unit of vx, vy (1/m) and omega
    /// (1).
    #[must_use]
    pub fn jacobian_row(&self) -> [S; 3] {
        // The wheel's axle stands a quarter turn left of the rolling direction, the roller's axle
        // roller_angle further: a = (-sin, cos) of the sum, and d . a = -sin(roller_angle).
        let (sin, cos) = (self.mounting_angle + self.roller_angle).sine_cosine();
        let (along_rolling, _) = self.roller_angle.sine_cosine();
        let sign = if self.reversed { -S::one() } else { S::one() };
        let gain = sign / (self.radius * along_rolling);
        let row_x = sin * gain;
        let row_y = -cos * gain;
        // The centre moves with omega x (x, y) = (-omega y, omega x).
        [row_x, row_y, self.x * row_y - self.y * row_x]
    }

    /// The same row in two: the part that does not depend on the rollers, and the part in
    /// proportion to the cotangent of the angle they stand at. A ground roller that has swept past
    /// its middle makes the row the first plus `sec(sweep)` times the second.
    #[must_use]
    pub fn jacobian_parts(&self) -> ([S; 3], [S; 3]) {
        let (sin, cos) = self.mounting_angle.sine_cosine();
        let (sin_roller, cos_roller) = self.roller_angle.sine_cosine();
        let sign = if self.reversed { -S::one() } else { S::one() };
        let gain = sign / self.radius;
        let lean = gain * cos_roller / sin_roller;
        let row = |x: S, y: S| [x, y, self.x * y - self.y * x];
        (row(cos * gain, sin * gain), row(sin * lean, -cos * lean))
    }

    /// How that row changes with the roller angle, per rad: equation (16), for any wheel.
    ///
    /// Along the rolling direction not at all, along the axle with `1/(r sin^2)`.
    #[must_use]
    pub fn roller_angle_sensitivity(&self) -> [S; 3] {
        let (sin, cos) = self.mounting_angle.sine_cosine();
        let (across, _) = self.roller_angle.sine_cosine();
        let sign = if self.reversed { -S::one() } else { S::one() };
        let gain = sign / (self.radius * across * across);
        let (x, y) = (-sin * gain, cos * gain);
        [x, y, self.x * y - self.y * x]
    }
}

/// Equation (17): by how much each wheel's rate (rad/s) must change so that the robot still moves
/// with `twist` (robot frame) when its roller angles are off by `deviations` (rad), to first order.
///
/// A wheel whose roller angle was measured is better built with that angle; this is for what is
/// found later.
///
/// ```
/// use mecanum_kinematics::{FourWheelGeometry, Twist, roller_angle_correction};
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f64.to_radians())?;
/// // The front left wheel's rollers stand one degree too far.
/// let deviations = [1_f64.to_radians(), 0.0, 0.0, 0.0];
/// let sideways = Twist::new(0.0, 0.5, 0.0);
/// let [front_left, ..] = roller_angle_correction(&robot.wheels()?, &deviations, sideways);
/// assert!((front_left - 0.5 / 0.1524 * 2.0 * 1_f64.to_radians()).abs() < 1e-9);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
#[must_use]
pub fn roller_angle_correction<const N: usize, S: Real>(
    wheels: &[Wheel<S>; N],
    deviations: &[S; N],
    twist: Twist<S>,
) -> [S; N] {
    let mut corrections = *deviations;
    for (correction, wheel) in corrections.iter_mut().zip(wheels) {
        let [x, y, w] = wheel.roller_angle_sensitivity();
        *correction *= x * twist.vx + y * twist.vy + w * twist.omega;
    }
    corrections
}
