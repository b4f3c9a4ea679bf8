//! A trait over all models of a member, for code that works with any of them.
//!
//! [`MemberKinematics`], [`FixedMember`] and [`CompensatedMember`] implement [`Kinematics`] as they
//! are. The models that use the roller phase need four secants with every call; [`PhaseMember::at`]
//! and [`FixedPhaseMember::at`] bind them, and the [`AtPhase`] that results implements the trait
//! too.
//!
//! The methods carry the names of the inherent ones and do the same, so a control loop that names
//! its type pays nothing for the trait.

use crate::arithmetic::{Real, Scalar};
use crate::compensated::CompensatedMember;
use crate::compensation::Compensation;
use crate::fixed_member::FixedMember;
use crate::four_wheel::WheelRates;
use crate::frame::Twist;
use crate::member::MemberKinematics;
use crate::phase::{FixedPhaseMember, PhaseMember};

/// Kinematics of one four-wheel robot in its group, whatever model stands behind.
///
/// ```
/// use mecanum_kinematics::{
///     FourWheelGeometry, Kinematics, MemberKinematics, Mount, PhaseMember, RollerAngle, Rollers,
///     Secant,
///     Twist, VelocityCompensation,
/// };
///
/// /// How far (m/s) the way back is from the way there.
/// fn error(model: &impl Kinematics<Scalar = f32>, twist: Twist) -> f32 {
///     let back = model.forward(&model.inverse(twist));
///     (back.vx - twist.vx).abs().max((back.vy - twist.vy).abs())
/// }
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let (mount, slip) = (Mount::IDENTITY, VelocityCompensation::NONE);
/// let twist = Twist::new(0.5, -0.2, 0.1);
/// assert!(error(&MemberKinematics::new(&robot, &mount, &slip)?, twist) < 1e-6);
///
/// let secant = Secant::new(Some(&Rollers::new(8)?));
/// let angles = [0, 1 << 28, 1 << 29, 1 << 30].map(RollerAngle::from_bits);
/// let secants = angles.map(|angle| secant.at(angle));
/// assert!(error(&PhaseMember::new(&robot, &mount, &slip)?.at(secants), twist) < 1e-6);
/// # Ok::<(), mecanum_kinematics::GeometryError>(())
/// ```
pub trait Kinematics {
    /// Scalar of the twists and wheel rates.
    type Scalar: Scalar;

    /// Wheel rates (rad/s) that make the group move with this twist (group frame).
    #[must_use]
    fn inverse(&self, group: Twist<Self::Scalar>) -> WheelRates<Self::Scalar>;

    /// The group twist (group frame) these wheel rates (rad/s) mean, by least squares.
    #[must_use]
    fn forward(&self, rates: &WheelRates<Self::Scalar>) -> Twist<Self::Scalar>;

    /// What no rigid motion explains in these wheel rates, rad/s; see
    /// [`MemberKinematics::slip_residual`].
    #[must_use]
    fn slip_residual(&self, rates: &WheelRates<Self::Scalar>) -> Self::Scalar;
}

impl<S: Scalar> Kinematics for MemberKinematics<S> {
    type Scalar = S;

    fn inverse(&self, group: Twist<S>) -> WheelRates<S> {
        self.inverse(group)
    }

    fn forward(&self, rates: &WheelRates<S>) -> Twist<S> {
        self.forward(rates)
    }

    fn slip_residual(&self, rates: &WheelRates<S>) -> S {
        self.slip_residual(rates)
    }
}

impl Kinematics for FixedMember {
    type Scalar = f32;

    fn inverse(&self, group: Twist) -> WheelRates {
        self.inverse(group)
    }

    fn forward(&self, rates: &WheelRates) -> Twist {
        self.forward(rates)
    }

    fn slip_residual(&self, rates: &WheelRates) -> f32 {
        self.slip_residual(rates)
    }
}

impl<S: Real, C: Compensation<S>> Kinematics for CompensatedMember<C, S> {
    type Scalar = S;

    fn inverse(&self, group: Twist<S>) -> WheelRates<S> {
        self.inverse(group)
    }

    fn forward(&self, rates: &WheelRates<S>) -> Twist<S> {
        self.forward(rates)
    }

    fn slip_residual(&self, rates: &WheelRates<S>) -> S {
        self.slip_residual(rates)
    }
}

/// A model with its wheels' rollers where they stand now: [`PhaseMember::at`],
/// [`FixedPhaseMember::at`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtPhase<'a, M, P> {
    pub(crate) member: &'a M,
    /// Front left, front right, rear left, rear right.
    pub(crate) secants: [P; 4],
}

impl<S: Real> Kinematics for AtPhase<'_, PhaseMember<S>, S> {
    type Scalar = S;

    fn inverse(&self, group: Twist<S>) -> WheelRates<S> {
        self.member.inverse(group, &self.secants)
    }

    fn forward(&self, rates: &WheelRates<S>) -> Twist<S> {
        self.member.forward(rates, &self.secants)
    }

    fn slip_residual(&self, rates: &WheelRates<S>) -> S {
        self.member.measure(rates, &self.secants).1
    }
}

impl Kinematics for AtPhase<'_, FixedPhaseMember, i32> {
    type Scalar = f32;

    fn inverse(&self, group: Twist) -> WheelRates {
        self.member.inverse(group, &self.secants)
    }

    fn forward(&self, rates: &WheelRates) -> Twist {
        self.member.forward(rates, &self.secants)
    }

    fn slip_residual(&self, rates: &WheelRates) -> f32 {
        self.member.measure(rates, &self.secants).1
    }
}
