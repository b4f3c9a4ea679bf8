//! The source paper's own frame and equations, as it prints them.
//!
//! No other module of this crate uses this frame; tests use it to compare the crate with the paper,
//! and reports may use it to show the paper's axes. Here x points right, y forward, heading is
//! counter-clockwise, wheels 1 to 4 are front right, front left, rear left, rear right, W and H are
//! half track and half wheelbase, and wheel rates are right-handed about +x: driving forward is
//! *negative*. `x = y_paper`, `y = -x_paper`, `rate = -rate_paper`.
//!
//! Sines come from `libm` through the scalar's own functions: these are reference forms, not for a
//! control loop.

use crate::arithmetic::Real;
use crate::four_wheel::{FourWheelGeometry, WheelRates};
use crate::frame::{Pose, Twist};

/// A 3x3 matrix in rows.
pub type Matrix3<S> = [[S; 3]; 3];

/// Velocity in the paper's frame: x to the right, y forward.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PaperTwist<S = f32> {
    /// To the right, m/s.
    pub x: S,
    /// Forward, m/s.
    pub y: S,
    /// Counter-clockwise, rad/s.
    pub theta: S,
}

/// Into the paper's frame.
#[must_use]
pub fn from_twist<S: Real>(twist: Twist<S>) -> PaperTwist<S> {
    PaperTwist {
        x: -twist.vy,
        y: twist.vx,
        theta: twist.omega,
    }
}

/// Out of the paper's frame.
#[must_use]
pub fn to_twist<S: Real>(twist: PaperTwist<S>) -> Twist<S> {
    Twist::new(twist.y, -twist.x, twist.theta)
}

/// A position in the paper's frame (right, forward; m) of a pose in ours.
#[must_use]
pub fn from_position<S: Real>(pose: Pose<S>) -> (S, S) {
    (-pose.y, pose.x)
}

/// Wheel rates 1 to 4 in the paper's sign, rad/s.
#[must_use]
pub fn from_rates<S: Real>(rates: WheelRates<S>) -> [S; 4] {
    [
        -rates.front_right,
        -rates.front_left,
        -rates.rear_left,
        -rates.rear_right,
    ]
}

/// A row times a twist.
#[must_use]
pub fn times<S: Real>([a, b, c]: [S; 3], twist: PaperTwist<S>) -> S {
    a * twist.x + b * twist.y + c * twist.theta
}

/// Three rows times a twist.
#[must_use]
pub fn transform<S: Real>([a, b, c]: Matrix3<S>, twist: PaperTwist<S>) -> PaperTwist<S> {
    PaperTwist {
        x: times(a, twist),
        y: times(b, twist),
        theta: times(c, twist),
    }
}

/// One wheel as the paper describes it (its Figure 1): polar position, attitude, roller angle,
/// radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaperWheel<S = f32> {
    /// Distance from the origin, m.
    pub l: S,
    /// Bearing from the origin, rad.
    pub alpha: S,
    /// Attitude of the wheel's axis against that bearing, rad.
    pub beta: S,
    /// Roller angle, rad.
    pub gamma: S,
    /// Wheel radius, m.
    pub radius: S,
}

/// Equation (1), solved for wheel rate and roller speed: both lines of it, no elimination.
///
/// Returns (wheel rate rad/s, roller contact speed m/s).
#[must_use]
pub fn eq_01<S: Real>(wheel: PaperWheel<S>, twist: PaperTwist<S>) -> (S, S) {
    let PaperWheel {
        l,
        alpha,
        beta,
        gamma,
        radius,
    } = wheel;
    let axis = alpha + beta;
    let roller =
        -(twist.x * axis.cos() + twist.y * axis.sin() + l * twist.theta * beta.sin()) / gamma.sin();
    let rolling = twist.x * axis.sin() - twist.y * axis.cos() - l * twist.theta * beta.cos();
    ((rolling + roller * gamma.cos()) / radius, roller)
}

/// The row of equation (3): wheel rate = row times twist.
#[must_use]
pub fn eq_03<S: Real>(wheel: PaperWheel<S>) -> [S; 3] {
    let PaperWheel {
        l,
        alpha,
        beta,
        gamma,
        radius,
    } = wheel;
    let gain = -S::ONE / (radius * gamma.sin());
    let sum = alpha + beta + gamma;
    [
        gain * sum.cos(),
        gain * sum.sin(),
        gain * l * (beta + gamma).sin(),
    ]
}

/// `R(theta)` of equation (4): world velocity into the body frame.
#[must_use]
pub fn rotation<S: Real>(theta: S) -> Matrix3<S> {
    let (sin, cos) = theta.sin_cos();
    let (zero, one) = (S::ZERO, S::ONE);
    [[cos, sin, zero], [-sin, cos, zero], [zero, zero, one]]
}

/// The Jacobian of equation (6), rows for wheels 1 to 4, any roller angle.
#[must_use]
pub fn eq_06<S: Real>(geometry: &FourWheelGeometry<S>) -> [[S; 3]; 4] {
    let cot = S::ONE / geometry.roller_angle().tan();
    let arm = geometry.half_track() + geometry.half_wheelbase() * cot;
    let gain = -S::ONE / geometry.wheel_radius();
    [
        [gain * -cot, gain, gain * arm],
        [gain * cot, gain, gain * -arm],
        [gain * -cot, gain, gain * -arm],
        [gain * cot, gain, gain * arm],
    ]
}

/// `K_j` of equation (11): robot `distance` m from the group's origin at bearing `psi`, heading
/// `delta` (rad).
#[must_use]
pub fn eq_11<S: Real>(delta: S, distance: S, psi: S) -> Matrix3<S> {
    let (sin, cos) = delta.sin_cos();
    let (zero, one) = (S::ZERO, S::ONE);
    [
        [cos, sin, distance * (delta - psi).sin()],
        [-sin, cos, distance * (delta - psi).cos()],
        [zero, zero, one],
    ]
}

/// `C_j` of equation (18): lateral (f), longitudinal (g), yaw (u).
#[must_use]
pub fn eq_18<S: Real>(f: S, g: S, u: S) -> Matrix3<S> {
    let zero = S::ZERO;
    [[f, zero, zero], [zero, g, zero], [zero, zero, u]]
}

/// The paper's relative error of displacement (its RED, in Tables 6 and 9): the mean of the largest
/// displacements either way over the nominal one, less 1.
#[must_use]
pub fn relative_displacement_error<S: Real>(most: S, least: S, nominal: S) -> S {
    (most.abs() + least.abs()) / (nominal + nominal) - S::ONE
}
