//! What several robots say about one body, as one: means, and how far they disagree.

use kinematics::{Pose, Twist};

/// The mean of poses; `None` of none. Headings are averaged about the first one's, so that +-pi does
/// no harm.
#[must_use]
pub fn mean_pose(poses: impl Iterator<Item = Pose> + Clone) -> Option<Pose> {
    let first = poses.clone().next()?;
    let mut sum = (0.0, 0.0, 0.0);
    let mut count = 0.0;
    for pose in poses {
        let (sin, cos) = (pose.heading - first.heading).sin_cos();
        sum = (sum.0 + pose.x, sum.1 + pose.y, sum.2 + sin.atan2(cos));
        count += 1.0;
    }
    Some(Pose {
        x: sum.0 / count,
        y: sum.1 / count,
        heading: first.heading + sum.2 / count,
    })
}

/// The mean of twists; `None` of none.
#[must_use]
pub fn mean_twist(twists: impl Iterator<Item = Twist>) -> Option<Twist> {
    let (mut sum, mut count) = (Twist::ZERO, 0.0);
    for twist in twists {
        sum = Twist::new(
            sum.vx + twist.vx,
            sum.vy + twist.vy,
            sum.omega + twist.omega,
        );
        count += 1.0;
    }
    (count > 0.0).then(|| Twist::new(sum.vx / count, sum.vy / count, sum.omega / count))
}

/// Largest disagreement about the velocity of the group's origin, in m/s; `None` of fewer than two.
#[must_use]
pub fn strain(twists: impl Iterator<Item = Twist> + Clone) -> Option<f32> {
    let pairs = twists.clone().enumerate().flat_map(|(n, a)| {
        let others = twists.clone().skip(n + 1);
        others.map(move |b| (a.vx - b.vx).hypot(a.vy - b.vy))
    });
    pairs.reduce(f32::max)
}
