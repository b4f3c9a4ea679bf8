//! The path of a group as its own wheels say it, where there is no observer.
//!
//! Every member reports the pose of the *group* as it works it out from its own wheels, in the
//! frame in which it was configured. Bolted to one load they should all report the same; the mean
//! is taken for the group's pose. The shape error is what the simulator measures, too: the distance
//! of a robot from its place in the group, here of where its own wheels take it. Instants at which
//! no member reported are left out.

use kinematics::{Pose, WheelRates};

use crate::monitor::average::counted_on;
use crate::monitor::rows::{RobotTruth, Row, TruthRow};
use crate::path::curve::Instant;

/// `pose` in the frame that `frame` is.
#[must_use]
pub fn relative_to(frame: Pose, pose: Pose) -> Pose {
    let (sin, cos) = frame.heading.sin_cos();
    let (dx, dy) = (pose.x - frame.x, pose.y - frame.y);
    Pose {
        x: cos * dx + sin * dy,
        y: cos * dy - sin * dx,
        heading: pose.heading - frame.heading,
    }
}

/// What was seen at every instant of a drive that began at `start` of the curve, by robots with
/// these places in the group.
#[must_use]
pub fn rows(start: Pose, mounts: &[Pose], instants: &[Instant], rows: &[Row]) -> Vec<TruthRow> {
    let begun = instants
        .first()
        .and_then(|instant| rows.get(instant.row)?.pose());
    let Some(begun) = begun else {
        return Vec::new();
    };
    // Poses are reported since configuration; the curve begins where the group stood then.
    let place = |pose: Pose| start.compose(relative_to(begun, pose));
    let one = |instant: &Instant| {
        let members = &rows.get(instant.row)?.members;
        let group = rows.get(instant.row)?.pose()?;
        let places = members.iter().zip(mounts).filter_map(|(member, mount)| {
            let (own, place) = (member.pose?.compose(*mount), group.compose(*mount));
            Some((own.x - place.x).hypot(own.y - place.y))
        });
        Some(TruthRow {
            t: instant.t,
            theory: instant.pose,
            theory_twist: instant.twist,
            group: place(group),
            shape_error_mm: f64::from(places.fold(0.0, f32::max)) * 1000.0,
            bus_load: 0.0,
            robots: members
                .iter()
                .map(|member| RobotTruth {
                    pose: place(member.pose.unwrap_or(group)),
                    wheel_rates: member.wheel_rates.unwrap_or(WheelRates::ZERO),
                })
                .collect(),
        })
    };
    // Robots report headings within half a turn.
    let mut heading = start.heading;
    let mut rows: Vec<TruthRow> = instants.iter().filter_map(one).collect();
    for row in &mut rows {
        row.group = counted_on(heading, row.group);
        heading = row.group.heading;
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::rows::MemberRow;
    use kinematics::Twist;

    fn row(poses: &[(f32, f32)]) -> Row {
        let member = |(x, y): &(f32, f32)| MemberRow {
            pose: Some(Pose::new(*x, *y, 0.0)),
            ..MemberRow::default()
        };
        Row {
            t: 0.0,
            sequence: 0,
            command: Twist::default(),
            members: poses.iter().map(member).collect(),
        }
    }

    fn instant(row: usize) -> Instant {
        Instant {
            t: row as f64,
            row,
            duration: 1.0,
            pose: Pose::new(0.0, 0.0, 0.0),
            twist: Twist::default(),
        }
    }

    #[test]
    fn seen_from_undoes_compose() {
        let (frame, inner) = (Pose::new(1.0, -2.0, 0.7), Pose::new(0.3, 0.4, -1.1));
        let back = relative_to(frame, frame.compose(inner));
        assert!((back.x - inner.x).abs() < 1e-6 && (back.y - inner.y).abs() < 1e-6);
        assert!((back.heading - inner.heading).abs() < 1e-6);
    }

    #[test]
    fn the_path_begins_where_the_curve_does_and_disagreement_shows() {
        let recorded = [
            row(&[(1.0, 1.0), (1.0, 1.0)]),
            row(&[]),
            row(&[(2.0, 1.002), (2.0, 0.998)]),
        ];
        let start = Pose::new(2.5, 0.0, 0.0);
        let mounts = [Pose::new(0.5, 0.0, 0.0), Pose::new(-0.5, 0.0, 0.0)];
        let instants = [instant(0), instant(1), instant(2)];
        let seen = rows(start, &mounts, &instants, &recorded);
        assert_eq!(seen.len(), 2, "nobody reported at the second instant");
        assert_eq!(seen[0].group, start);
        assert!((seen[1].group.x - 3.5).abs() < 1e-6);
        assert!((seen[1].shape_error_mm - 2.0).abs() < 1e-3);
    }

    /// Two robots half a metre from the centre, whose headings differ by 0.02 rad: each is half of
    /// it from the mean, which is 5 mm at its place, though both put the centre where it is.
    #[test]
    fn a_heading_of_its_own_takes_a_robot_from_its_place() {
        let mut turned = row(&[(0.0, 0.0), (0.0, 0.0)]);
        for (member, heading) in turned.members.iter_mut().zip([0.01, -0.01]) {
            member.pose = Some(Pose::new(0.0, 0.0, heading));
        }
        let mounts = [Pose::new(0.5, 0.0, 0.0), Pose::new(-0.5, 0.0, 0.0)];
        let straight = row(&[(0.0, 0.0), (0.0, 0.0)]);
        let instants = [instant(0), instant(1)];
        let seen = rows(Pose::default(), &mounts, &instants, &[straight, turned]);
        assert!((seen[1].shape_error_mm - 5.0).abs() < 1e-3);
    }

    /// A whole turn to the right in quarters, as robots report it.
    #[test]
    fn a_turn_is_counted_on() {
        let quarter = std::f32::consts::FRAC_PI_2;
        let turns = [0.0, -quarter, 2.0 * quarter, quarter, 0.0];
        let recorded = turns.map(|heading| {
            let mut one = row(&[(0.0, 0.0)]);
            one.members[0].pose = Some(Pose::new(0.0, 0.0, heading));
            one
        });
        let instants = [0, 1, 2, 3, 4].map(instant);
        let seen = rows(Pose::default(), &[Pose::default()], &instants, &recorded);
        let end = seen.last().unwrap().group.heading;
        assert!((end + 4.0 * quarter).abs() < 1e-5, "{end}");
    }
}
