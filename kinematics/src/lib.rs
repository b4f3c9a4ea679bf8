//! Kinematics of Mecanum-wheeled robots and of groups of them that move as one body.
//!
//! A robot is a set of [`Wheel`]s; the usual four-wheel robot is a [`FourWheelGeometry`]. A robot
//! in a group has a [`Mount`], its pose in the group frame. [`VelocityCompensation`] gives the
//! factors by which the wheels must turn faster than geometry alone requires. [`MemberKinematics`]
//! folds the three into one 4x3 matrix `J C K`, so that the conversion of a group twist into wheel
//! rates costs twelve multiplications, and into its least-squares inverse for the forward
//! direction. Trigonometric functions and inverses are computed only once, when these objects are
//! built.
//!
//! # Where to start
//!
//! | to | use |
//! |---|---|
//! | drive the usual robot, alone or in a group | [`FourWheelGeometry`], [`Mount`], [`MemberKinematics`] |
//! | drive any other | [`Wheel`], [`Platform`], [`WheelKinematics`] |
//! | keep wheels within their limits | [`desaturate`], [`group_scale`] |
//! | arrange several robots and measure the motion of the group | [`Formation`], [`Group`] |
//! | compensate slip | [`VelocityCompensation`], [`SpeedCompensation`], [`DirectionalCompensation`], [`estimate`] |
//! | detect slip | [`MemberKinematics::slip_residual`], [`Platform::suspect`], [`TwistUncertainty`] |
//! | track the robot's pose | [`Odometry`], [`UncertainOdometry`] |
//! | follow a curve | [`trajectory`] |
//! | model the rollers | [`Rollers`], [`Wheel::swept`], [`roller_angle_correction`] |
//! | correct the effect of the rollers by the wheels' angles | [`RollerTrack`], [`Secant`], [`PhaseMember`], [`PhasePlatform`] |
//! | write code for any of these models | [`Kinematics`] |
//! | do without a floating-point unit | [`FixedMember`], [`MemberKinematics::convert`] |
//!
//! # Frames, units, signs
//!
//! REP-103 throughout: x forward, y left, heading counter-clockwise, metres, seconds, radians. A
//! positive wheel rate rolls the base forward. The frame of the source paper ("Kinematic Modeling
//! of a Combined System of Multiple Mecanum-Wheeled Robots with Velocity Compensation") exists only
//! in [`paper`].
//!
//! # Scalars
//!
//! Every type takes its scalar as a parameter that defaults to `f32`. `f64` works everywhere; fixed
//! point ([`fixed::types::I16F16`]) in what a control loop calls, by way of
//! [`MemberKinematics::convert`].
//!
//! # Limits
//!
//! The crate does not model mass or friction, and its only time is the `dt` that it is given.
//! Wheels are assumed to roll without slip along their ground roller's axle; deviations from that
//! appear only in the compensation or in the [`MemberKinematics::slip_residual`].
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

#[cfg(test)]
extern crate std;

pub mod arithmetic;
mod compensated;
mod compensation;
mod covariance;
mod error;
mod fixed_member;
mod folded;
mod four_wheel;
mod frame;
mod group;
mod kinematics;
mod member;
mod mount;
mod odometry;
pub mod paper;
mod phase;
mod platform;
mod roller;
mod slip;
pub mod trajectory;
mod wheel;

pub use arithmetic::{Real, Scalar};
pub use compensated::CompensatedMember;
pub use compensation::{
    AxisTable, Compensation, DirectionalCompensation, SpeedCompensation, VelocityCompensation,
    estimate,
};
pub use covariance::{Covariance, TwistUncertainty, Uncertainty};
pub use error::{CompensationError, GeometryError, GroupError, MountError, RangeError};
pub use fixed_member::FixedMember;
pub use folded::WheelKinematics;
pub use four_wheel::{FourWheelGeometry, WheelRates, desaturate};
pub use frame::{Pose, Twist};
pub use group::{Disagreement, Formation, Group, Member, group_scale};
pub use kinematics::{AtPhase, Kinematics};
pub use member::MemberKinematics;
pub use mount::Mount;
pub use odometry::{Odometry, UncertainOdometry};
pub use phase::{
    FixedPhaseMember, FixedSecant, PhaseMember, PhasePlatform, RollerAngle, RollerTrack, Secant,
    SecantEstimate,
};
pub use platform::Platform;
pub use roller::Rollers;
pub use slip::Suspect;
pub use wheel::{Wheel, roller_angle_correction};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
