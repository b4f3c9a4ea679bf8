//! The pose of a member in its group: the paper's `K_j`, equation (11).
//!
//! A group moves as one body, so every member's velocity follows from the group's: the same angular
//! velocity, plus the contribution of the lever arm, in the member's own frame.

use crate::arithmetic::Real;
use crate::error::MountError;
use crate::frame::{Pose, Rotation, Twist};

/// Pose of a member in the group frame, with its sine and cosine precomputed.
///
/// ```
/// use mecanum_kinematics::{Mount, Pose, Twist};
///
/// let mount = Mount::new(Pose::new(2.0_f64, 0.0, 0.0))?; // 2 m ahead of the group's origin
/// let member = mount.to_member(Twist::new(0.0, 0.0, 0.5)); // the group turns left
/// assert!((member.vy - 1.0).abs() < 1e-12); // so this one moves left
/// # Ok::<(), mecanum_kinematics::MountError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount<S = f32> {
    pose: Pose<S>,
    rotation: Rotation<S>,
}

impl Mount {
    /// At the origin of the group frame: a robot alone is a group of one.
    pub const IDENTITY: Self = Self {
        pose: Pose::ZERO,
        rotation: Rotation { sin: 0.0, cos: 1.0 },
    };
}

impl<S: Real> Mount<S> {
    /// [`Mount::IDENTITY`] for any scalar.
    #[must_use]
    pub const fn at_origin() -> Self {
        Self {
            pose: Pose::new(S::ZERO, S::ZERO, S::ZERO),
            rotation: Rotation {
                sin: S::ZERO,
                cos: S::ONE,
            },
        }
    }

    /// A member whose own frame has this pose in the group frame (m, m, rad).
    ///
    /// # Errors
    ///
    /// [`MountError`] naming the component that is NaN or infinite.
    pub fn new(pose: Pose<S>) -> Result<Self, MountError> {
        for (value, field) in [(pose.x, "x"), (pose.y, "y"), (pose.heading, "heading")] {
            if !value.is_finite() {
                return Err(MountError::NotFinite(field));
            }
        }
        let rotation = Rotation::by(pose.heading);
        if !rotation.sin.is_finite() {
            return Err(MountError::NotFinite("heading"));
        }
        Ok(Self { pose, rotation })
    }

    /// Pose of the member's frame in the group frame.
    #[must_use]
    pub const fn pose(&self) -> Pose<S> {
        self.pose
    }

    /// The member's velocity, in its own frame, when the group moves with `group` (group frame).
    #[must_use]
    pub fn to_member(&self, group: Twist<S>) -> Twist<S> {
        Twist {
            vx: group.vx - group.omega * self.pose.y,
            vy: group.vy + group.omega * self.pose.x,
            omega: group.omega,
        }
        .rotated(self.rotation.inverse())
    }

    /// The group's velocity, in the group frame, when the member moves with `member` (its own
    /// frame).
    #[must_use]
    pub fn to_group(&self, member: Twist<S>) -> Twist<S> {
        let turned = member.rotated(self.rotation);
        Twist {
            vx: turned.vx + turned.omega * self.pose.y,
            vy: turned.vy - turned.omega * self.pose.x,
            omega: turned.omega,
        }
    }

    /// `K_j` in rows: member twist = K_j times group twist.
    #[must_use]
    pub fn matrix(&self) -> [[S; 3]; 3] {
        let Self {
            pose,
            rotation: Rotation { sin, cos },
        } = *self;
        [
            [cos, sin, sin * pose.x - cos * pose.y],
            [-sin, cos, cos * pose.x + sin * pose.y],
            [S::zero(), S::zero(), S::one()],
        ]
    }
}
