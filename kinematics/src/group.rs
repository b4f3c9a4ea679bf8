//! Several robots as one body: equations (9) to (15), (20), (21).
//!
//! Inverse kinematics needs no group object: every member computes its own rates from the group
//! twist, and members exchange no data. Forward kinematics does: each member measures the group's
//! twist, and the best estimate weighs these measurements by the information of each member's
//! wheels. This weighted mean equals the least-squares solution over all wheels of all members
//! (tested), including members with different numbers of wheels, and it needs from each member only
//! the twist that it sends on the bus.
//!
//! The remaining difference between a member's twist and the group's is slip, or strain in the
//! connection.
//!
//! Information about yaw grows with the square of the distance from where it is counted: 50 m from
//! the group's origin it is 5000 times what the wheels of a robot know, and an `f32` has no digits
//! left for these. So the shares are of the twist of the members' own middle, and only differences
//! of measurements are shifted there and back. In `f32` that leaves the rounding of the velocities
//! themselves: 4e-6 m/s, 70 m from the axis of a turn with 0.2 rad/s.

use nalgebra::{Matrix3, Vector3};

use crate::arithmetic::Real;
use crate::compensation::VelocityCompensation;
use crate::error::GroupError;
use crate::frame::{Pose, Twist};
use crate::mount::Mount;
use crate::platform::{Platform, shift};

/// What a group needs to know of one member.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Member<S: Real = f32> {
    mount: Mount<S>,
    /// About the member's own origin, along the axes of the group frame.
    information: Matrix3<S>,
}

impl<S: Real> Member<S> {
    /// From the member's wheels (with their weights), mount and compensation.
    ///
    /// In `f32` the wheels should stand within a few metres of the robot's own origin; the mount
    /// may be as far from the group's as it is.
    #[must_use]
    pub fn new<const N: usize>(
        platform: &Platform<N, S>,
        mount: &Mount<S>,
        compensation: &VelocityCompensation<S>,
    ) -> Self {
        // K without its lever.
        let [[xx, xy, _], [yx, yy, _], _] = mount.matrix();
        let (zero, one) = (S::ZERO, S::ONE);
        let k = Matrix3::new(xx, xy, zero, yx, yy, zero, zero, zero, one);
        let c = Matrix3::from_diagonal(&Vector3::new(
            compensation.longitudinal(),
            compensation.lateral(),
            compensation.yaw(),
        ));
        let ck = c * k;
        Self {
            mount: *mount,
            information: ck.transpose() * platform.information() * ck,
        }
    }
}

/// The largest differences between what a member measures and what the group does, at the member.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disagreement<S = f32> {
    /// Of the velocity, m/s.
    pub speed: S,
    /// Of the angular velocity, rad/s.
    pub omega: S,
}

/// `M` members moving as one body.
///
/// ```
/// use mecanum_kinematics::{
///     Formation, FourWheelGeometry, Group, Member, Platform, Twist, VelocityCompensation,
/// };
///
/// let robot = FourWheelGeometry::new(0.370, 0.350, 0.1524, 45_f32.to_radians())?;
/// let platform = Platform::new(&robot.wheels()?)?;
/// let pair = Formation::<2>::tcc_2(1.2)?;
/// let members = pair.mounts.map(|m| Member::new(&platform, &m, &VelocityCompensation::NONE));
/// let group = Group::new(&members)?;
/// // The front robot measures 10 mm/s more than the rear one.
/// let measured = [Twist::new(0.505, 0.0, 0.0), Twist::new(0.495, 0.0, 0.0)];
/// assert!((group.forward(&measured).vx - 0.5).abs() < 1e-6);
/// assert!((group.strain_rate(0, 1, &measured).unwrap() - 0.010).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Group<const M: usize, S: Real = f32> {
    mounts: [Mount<S>; M],
    /// The members' middle, by how much they know of translation, m, group frame.
    middle: (S, S),
    /// What each member's measurement of the middle's twist counts; they sum to the unit matrix.
    shares: [Matrix3<S>; M],
}

impl<const M: usize, S: Real> Group<M, S> {
    /// From its members.
    ///
    /// # Errors
    ///
    /// [`GroupError::Empty`] without members; [`GroupError::Undetermined`] when their information
    /// cannot be inverted or is no number, which happens only when dimensions are absurd.
    pub fn new(members: &[Member<S>; M]) -> Result<Self, GroupError> {
        if M == 0 {
            return Err(GroupError::Empty);
        }
        let (mut x, mut y, mut sum) = (S::ZERO, S::ZERO, S::ZERO);
        for member in members {
            let pose = member.mount.pose();
            let weight = member.information.m11 + member.information.m22;
            x += weight * pose.x;
            y += weight * pose.y;
            sum += weight;
        }
        let middle = (x / sum, y / sum);
        let about_middle = members.map(|member| {
            let pose = member.mount.pose();
            let to_member = shift(pose.x - middle.0, pose.y - middle.1);
            to_member.transpose() * member.information * to_member
        });
        let total = about_middle
            .iter()
            .fold(Matrix3::zeros(), |sum, information| sum + information);
        let inverse = total
            .try_inverse()
            .filter(|inverse| inverse.iter().all(|entry| entry.is_finite()))
            .ok_or(GroupError::Undetermined)?;
        Ok(Self {
            mounts: members.map(|member| member.mount),
            middle,
            shares: about_middle.map(|information| inverse * information),
        })
    }

    /// The group's twist from what each member measures of it, all in the group frame.
    #[must_use]
    pub fn forward(&self, measured: &[Twist<S>; M]) -> Twist<S> {
        let Some(first) = measured.first() else {
            return Twist::default();
        };
        let (x, y) = self.middle;
        let (there, back) = (shift(x, y), shift(-x, -y));
        let sum = self
            .shares
            .iter()
            .zip(measured)
            .fold(Vector3::zeros(), |sum, (share, twist)| {
                let more = *twist - *first;
                sum + share * (there * Vector3::new(more.vx, more.vy, more.omega))
            });
        let sum = back * sum;
        *first + Twist::new(sum.x, sum.y, sum.z)
    }

    /// How each member moves against the group, in the member's own frame.
    #[must_use]
    pub fn deviations(&self, measured: &[Twist<S>; M]) -> [Twist<S>; M] {
        let group = self.forward(measured);
        let mut deviations = *measured;
        for (deviation, mount) in deviations.iter_mut().zip(&self.mounts) {
            *deviation = mount.to_member(*deviation - group);
        }
        deviations
    }

    /// The largest of [`Group::deviations`].
    #[must_use]
    pub fn disagreement(&self, measured: &[Twist<S>; M]) -> Disagreement<S> {
        let mut worst = Disagreement {
            speed: S::ZERO,
            omega: S::ZERO,
        };
        for Twist { vx, vy, omega } in self.deviations(measured) {
            worst.speed = worst.speed.max((vx * vx + vy * vy).root());
            worst.omega = worst.omega.max(omega.abs());
        }
        worst
    }

    /// How fast two members' origins move apart (m/s, together negative): what stretches the load
    /// between them.
    ///
    /// `None` when there is no such member, or both stand in the same place.
    #[must_use]
    pub fn strain_rate(&self, one: usize, other: usize, measured: &[Twist<S>; M]) -> Option<S> {
        let at = |index: usize| -> Option<(Pose<S>, Twist<S>)> {
            let pose = self.mounts.get(index)?.pose();
            let twist = *measured.get(index)?;
            let velocity = Twist::new(
                twist.vx - twist.omega * pose.y,
                twist.vy + twist.omega * pose.x,
                twist.omega,
            );
            Some((pose, velocity))
        };
        let ((from, start), (to, end)) = (at(one)?, at(other)?);
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let distance = (dx * dx + dy * dy).root();
        let apart = (end.vx - start.vx) * dx + (end.vy - start.vy) * dy;
        (distance > S::ZERO).then(|| apart / distance)
    }
}

/// The scale at which all members can follow: the smallest of theirs, within 0 to 1. No members, or
/// a NaN, yield 0.
///
/// A member's own scale is the one [`crate::desaturate`] returns for its rates and its limit.
///
/// ```
/// use mecanum_kinematics::group_scale;
///
/// assert_eq!(group_scale([1.0, 0.6, 0.9]), 0.6);
/// assert_eq!(group_scale([1.0, f32::NAN]), 0.0);
/// ```
#[must_use]
pub fn group_scale<S: Real>(scales: impl IntoIterator<Item = S>) -> S {
    let mut smallest = None;
    for scale in scales {
        let within = scale >= S::ZERO;
        let scale = if within { scale } else { S::ZERO };
        smallest = Some(match smallest {
            None => scale.min(S::ONE),
            Some(least) => scale.min(least),
        });
    }
    smallest.unwrap_or(S::ZERO)
}

/// A named arrangement of robots, as in the paper's Figure 19.
///
/// The group's origin is the middle of the members' origins. The paper's distances stand in its
/// figure only, so they are arguments here.
///
/// ```
/// use mecanum_kinematics::Formation;
///
/// let train = Formation::<3>::tcc_3(1.2)?;
/// assert_eq!(train.name, "TCC-3");
/// assert_eq!(train.mounts.map(|mount| mount.pose().x), [1.2, 0.0, -1.2]);
/// # Ok::<(), mecanum_kinematics::MountError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Formation<const M: usize, S = f32> {
    /// The paper's abbreviation, or "custom".
    pub name: &'static str,
    /// Whether the members are joined rigidly, or hold their places by driving alike.
    pub connected: bool,
    /// Where the members stand.
    pub mounts: [Mount<S>; M],
}

impl<const M: usize, S: Real> Formation<M, S> {
    /// Members one behind the other, the first ahead, `spacing` m from origin to origin, all
    /// heading along x.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn tandem(spacing: S, connected: bool) -> Result<Self, crate::MountError> {
        Self::row("custom", connected, |along| {
            Pose::new(along * spacing, S::ZERO, S::ZERO)
        })
    }

    /// Members side by side, the first leftmost, `spacing` m from origin to origin, all heading
    /// along x.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn side_by_side(spacing: S, connected: bool) -> Result<Self, crate::MountError> {
        Self::row("custom", connected, |along| {
            Pose::new(S::ZERO, along * spacing, S::ZERO)
        })
    }

    /// Members anywhere, heading anywhere.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when a pose is not finite.
    pub fn arbitrary(poses: [Pose<S>; M], connected: bool) -> Result<Self, crate::MountError> {
        let mut mounts = [Mount::at_origin(); M];
        for (mount, pose) in mounts.iter_mut().zip(poses) {
            *mount = Mount::new(pose)?;
        }
        Ok(Self {
            name: "custom",
            connected,
            mounts,
        })
    }

    /// Members at places (M - 1)/2, ..., 0, ..., -(M - 1)/2 of a line.
    fn row(
        name: &'static str,
        connected: bool,
        place: impl Fn(S) -> Pose<S>,
    ) -> Result<Self, crate::MountError> {
        let mut mounts = [Mount::at_origin(); M];
        let mut last = S::ZERO;
        for _ in 1..M {
            last += S::ONE;
        }
        let mut along = last / S::constant(2.0);
        for mount in &mut mounts {
            *mount = Mount::new(place(along))?;
            along -= S::ONE;
        }
        Ok(Self {
            name,
            connected,
            mounts,
        })
    }

    fn named(self, name: &'static str) -> Self {
        Self { name, ..self }
    }
}

impl<S: Real> Formation<2, S> {
    /// Side by side, connected, two robots.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn scc_2(spacing: S) -> Result<Self, crate::MountError> {
        Ok(Self::side_by_side(spacing, true)?.named("SCC-2"))
    }

    /// Side by side, unconnected, two robots.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn suc_2(spacing: S) -> Result<Self, crate::MountError> {
        Ok(Self::side_by_side(spacing, false)?.named("SUC-2"))
    }

    /// Tandem, connected, two robots.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn tcc_2(spacing: S) -> Result<Self, crate::MountError> {
        Ok(Self::tandem(spacing, true)?.named("TCC-2"))
    }

    /// Tandem, unconnected, two robots.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn tuc_2(spacing: S) -> Result<Self, crate::MountError> {
        Ok(Self::tandem(spacing, false)?.named("TUC-2"))
    }

    /// Arbitrary, unconnected, two robots at an angle of 30 degrees: side by side, the right one
    /// turned left.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn auc_2(spacing: S) -> Result<Self, crate::MountError> {
        Self::at_an_angle(spacing, false, "AUC-2")
    }

    /// The same two robots, connected.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn acc_2(spacing: S) -> Result<Self, crate::MountError> {
        Self::at_an_angle(spacing, true, "ACC-2")
    }

    fn at_an_angle(
        spacing: S,
        connected: bool,
        name: &'static str,
    ) -> Result<Self, crate::MountError> {
        let half = spacing / S::constant(2.0);
        let poses = [
            Pose::new(S::ZERO, half, S::ZERO),
            Pose::new(S::ZERO, -half, S::frac_pi_6()),
        ];
        Ok(Self::arbitrary(poses, connected)?.named(name))
    }
}

impl<S: Real> Formation<3, S> {
    /// Tandem, connected, three robots.
    ///
    /// # Errors
    ///
    /// [`crate::MountError`] when the spacing is not finite.
    pub fn tcc_3(spacing: S) -> Result<Self, crate::MountError> {
        Ok(Self::tandem(spacing, true)?.named("TCC-3"))
    }
}
