//! Averages over what several robots report about one body, and their disagreement.

use kinematics::{Pose, Twist};

/// The mean of poses; `None` of none. Headings are averaged about the first one's, so that +-pi
/// does no harm.
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

/// `pose` with its heading, which may have been taken off a turn, counted on from `before`: less
/// than half a turn away.
#[must_use]
pub fn counted_on(before: f32, pose: Pose) -> Pose {
    let (sin, cos) = (pose.heading - before).sin_cos();
    Pose {
        heading: before + sin.atan2(cos),
        ..pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn headings_are_counted_on_over_half_a_turn() {
        let seen = [0.0, -1.5, -3.0, PI - 0.1, 0.3, -1.0];
        let mut before = 0.0;
        for (heading, want) in
            seen.into_iter()
                .zip([0.0, -1.5, -3.0, -PI - 0.1, 0.3 - 2.0 * PI, -1.0 - 2.0 * PI])
        {
            before = counted_on(before, Pose::new(0.0, 0.0, heading)).heading;
            assert!((before - want).abs() < 1e-5, "{before} {want}");
        }
    }
}
