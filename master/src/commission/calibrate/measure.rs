//! Drives the motions and compares each as the wheels report it with what was measured.
//!
//! The reference is not the setpoint but the displacement that the robots compute from their
//! wheels, without the compensation in force. So ramps, delays and a scaled-down speed do not
//! matter, and both are read at rest. Robots bolted to one load are one body with the pose of the
//! group; each robot apart is a body of its own.
//!
//! Bolted robots may face differently. Let `theta_j` be the heading of robot `j`, and let all
//! robots carry the same load. Each achieves the share `a` of its commanded motion ahead and `b`
//! sideways, so it would move by `R_j diag(a, b) R_j^T`, and the group moves by the mean of these.
//! That mean is `(a + b) / 2 + alignment (a - b) / 2` along the mean direction of `2 theta_j`,
//! halved, `(a + b) / 2 - alignment (a - b) / 2` across it, and nothing from one to the other;
//! `alignment` is the length of the mean of `exp(2 i theta_j)`. So both shares follow from motions
//! along these two axes, unless the alignment is near zero. Then translation does not depend on the
//! difference of the shares, which is not estimated.

use std::f64::consts::{PI, TAU};

use group::GroupFile;
use kinematics::{Pose, Twist};
use serde::{Deserialize, Serialize};

use super::manoeuvre::{AVERAGE, Manoeuvre, SETTLE, Way};
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::monitor::average::mean_pose;
use crate::monitor::rows::MemberRow;
use crate::session::Group;

/// From this alignment on robots count as facing one way: half a degree apart.
const ALIKE: f64 = 0.9999;

/// What moves as one body: a bolted group, or one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Places of its robots in the group file.
    pub robots: Vec<usize>,
    /// Its pose in the group frame: it has the mean heading of its robots.
    frame: [f64; 3],
    /// Its pose in the frame of what the source of poses tracks, which for bolted robots is the
    /// group.
    tracked: [f64; 3],
    /// 1 where all robots face one way or the opposite, 0 where ahead of some is sideways of as
    /// many others.
    pub alignment: f64,
    /// Share of a turn that its robots' turning makes, the rest being what they do sideways.
    pub turning: f64,
}

impl Body {
    /// The subjects of a group.
    #[must_use]
    pub fn all(file: &GroupFile) -> Vec<Self> {
        let place = |pose: Pose| [pose.x, pose.y, pose.heading].map(f64::from);
        if !file.simulation.rigid {
            let robots = file.robots.iter().enumerate();
            return robots
                .map(|(n, robot)| Self {
                    robots: vec![n],
                    frame: place(robot.mount),
                    tracked: [0.0; 3],
                    alignment: 1.0,
                    turning: 1.0,
                })
                .collect();
        }
        let headings = file.robots.iter().map(|robot| place(robot.mount)[2]);
        let (facing, alignment) = mean_axis(headings);
        let count = file.robots.len().max(1) as f64;
        let centre = file.robots.iter().fold([0.0; 2], |[x, y], robot| {
            let [px, py, _] = place(robot.mount);
            [x + px / count, y + py / count]
        });
        let (mut own, mut all) = (0.0, 0.0);
        for robot in &file.robots {
            let [x, y, _] = place(robot.mount);
            let g = robot.geometry;
            let wheels = f64::from(g.half_track()).powi(2) + f64::from(g.half_wheelbase()).powi(2);
            own += wheels;
            all += wheels + (x - centre[0]).powi(2) + (y - centre[1]).powi(2);
        }
        vec![Self {
            robots: (0..file.robots.len()).collect(),
            frame: [0.0, 0.0, facing],
            tracked: [0.0, 0.0, facing],
            alignment,
            turning: if all > 0.0 { own / all } else { 1.0 },
        }]
    }

    /// Whether its robots face different ways.
    #[must_use]
    pub fn is_mixed(&self) -> bool {
        self.alignment < ALIKE
    }

    /// Its nodes.
    #[must_use]
    pub fn nodes(&self, file: &GroupFile) -> Vec<u8> {
        let robots = self.robots.iter().filter_map(|n| file.robots.get(*n));
        robots.map(|robot| robot.node).collect()
    }

    /// Mean heading of the robots in the group frame, rad.
    #[must_use]
    pub fn heading(&self) -> f64 {
        self.frame[2]
    }

    /// Its pose by its own wheels.
    fn believed(&self, members: &[MemberRow]) -> Option<[f64; 3]> {
        let mine = self.robots.iter().filter_map(|n| members.get(*n)?.pose);
        let pose = mean_pose(mine)?;
        Some(compose(
            [pose.x, pose.y, pose.heading].map(f64::from),
            self.frame,
        ))
    }
}

/// The direction along which robots with these headings do what they do ahead, rad, and how alike
/// they face: see [`Body::alignment`]. Within a quarter turn of where the first one faces.
fn mean_axis(headings: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let first = headings.clone().next().unwrap_or(0.0);
    // Counted from the first, so that robots that face alike give its heading exactly.
    let (sin, cos, count) = headings.fold((0.0, 0.0, 0.0), |(sin, cos, count), heading| {
        let (s, c) = (2.0 * (heading - first)).sin_cos();
        (sin + s, cos + c, count + 1.0)
    });
    let alignment = f64::hypot(sin, cos) / f64::max(count, 1.0);
    if alignment < 1e-6 {
        return (first, alignment);
    }
    (first + 0.5 * f64::atan2(sin, cos), alignment)
}

fn compose([x, y, heading]: [f64; 3], [dx, dy, turn]: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = heading.sin_cos();
    [
        x + cos * dx - sin * dy,
        y + sin * dx + cos * dy,
        heading + turn,
    ]
}

/// The way from one pose to another in the frame of the body half-way; `turn` is about how far it
/// has turned.
fn way(from: [f64; 3], to: [f64; 3], turn: f64) -> [f64; 3] {
    let off = (to[2] - from[2] - turn + PI).rem_euclid(TAU) - PI;
    let turned = turn + off;
    let (sin, cos) = (from[2] + 0.5 * turned).sin_cos();
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    [cos * dx + sin * dy, cos * dy - sin * dx, turned]
}

/// One motion of one subject.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// What the motion shows.
    pub way: Way,
    /// How fast it was, m/s or rad/s.
    pub speed: f64,
    /// What the robots work out from their wheels, in the robots' frame: m, m, rad.
    pub believed: [f64; 3],
    /// What was measured: m, m, rad.
    pub measured: [f64; 3],
}

impl Observation {
    /// The same with these shares taken from what the robots believe, axis by axis.
    #[must_use]
    pub(super) fn without(mut self, shares: [f64; 3]) -> Self {
        for (believed, share) in self.believed.iter_mut().zip(shares) {
            *believed *= 1.0 - share;
        }
        self
    }
}

/// Poses of the subjects now: m, m, rad in any fixed frame.
pub type Poses<'a, L> = &'a mut dyn FnMut(&mut L) -> Result<Vec<[f64; 3]>, MasterError>;

/// Asks a person how far the only subject has come, in its frame at the start: m, m, rad; `None` to
/// leave the motion out. The group stands and the one who asks must keep listening to it.
pub type Ask<'a, L> =
    &'a mut dyn FnMut(&mut Group<L>, &Manoeuvre) -> Result<Option<[f64; 3]>, MasterError>;

/// Who measures.
pub enum Instrument<'a, L> {
    /// A source of poses.
    Poses(Poses<'a, L>),
    /// A tape measure.
    Tape(Ask<'a, L>),
}

/// Drives one motion of a started group and returns what is known of it for every subject.
///
/// # Errors
/// When driving or measuring fails.
pub fn observe<L: Link>(
    group: &mut Group<L>,
    bodies: &[Body],
    manoeuvre: &Manoeuvre,
    instrument: &mut Instrument<'_, L>,
) -> Result<Vec<Option<Observation>>, MasterError> {
    let heading = bodies.first().map_or(0.0, Body::heading);
    let plan = manoeuvre.plan(heading);
    let before = rest(group, bodies, instrument)?;
    group.drive(&plan, None, &mut |_, _| {})?;
    let after = rest(group, bodies, instrument)?;
    let answer = match instrument {
        Instrument::Poses(_) => None,
        Instrument::Tape(ask) => Some(ask(group, manoeuvre)?),
    };
    let turn = manoeuvre.twist.omega * manoeuvre.seconds;
    let each = before.into_iter().zip(after).map(|(before, after)| {
        let believed = way(before.believed?, after.believed?, turn);
        let measured = match answer {
            Some(answer) => answer?,
            None => way(before.measured?, after.measured?, turn),
        };
        Some(Observation {
            way: manoeuvre.way,
            speed: manoeuvre.speed,
            believed,
            measured,
        })
    });
    Ok(each.collect())
}

/// A subject at rest.
#[derive(Clone, Copy, Default)]
struct Standing {
    believed: Option<[f64; 3]>,
    measured: Option<[f64; 3]>,
}

/// Lets the group stand, and reads where.
fn rest<L: Link>(
    group: &mut Group<L>,
    bodies: &[Body],
    instrument: &mut Instrument<'_, L>,
) -> Result<Vec<Standing>, MasterError> {
    let period = group.period_us() as f64 * 1e-6;
    let cycles = |seconds: f64| (seconds / period).ceil() as u32;
    for _ in 0..cycles(SETTLE) {
        group.cycle(Twist::ZERO)?;
    }
    let mut believed = vec![Mean::default(); bodies.len()];
    let mut measured = believed.clone();
    for _ in 0..cycles(AVERAGE) {
        group.cycle(Twist::ZERO)?;
        let rows = group.recorder().rows();
        // The row of this SYNC is being filled still; the one before is complete.
        if let Some(row) = rows.len().checked_sub(2).and_then(|n| rows.get(n)) {
            for (mean, body) in believed.iter_mut().zip(bodies) {
                mean.add(body.believed(&row.members));
            }
        }
        if let Instrument::Poses(poses) = instrument {
            let seen = poses(group.link())?.into_iter().zip(bodies);
            for (mean, (pose, body)) in measured.iter_mut().zip(seen) {
                mean.add(Some(compose(pose, body.tracked)));
            }
        }
    }
    let pairs = believed.into_iter().zip(measured);
    Ok(pairs
        .map(|(believed, measured)| Standing {
            believed: believed.get(),
            measured: measured.get(),
        })
        .collect())
}

/// A mean of poses about the first one.
#[derive(Clone, Copy, Default)]
struct Mean {
    first: Option<[f64; 3]>,
    sum: [f64; 3],
    count: f64,
}

impl Mean {
    fn add(&mut self, pose: Option<[f64; 3]>) {
        let Some(pose) = pose else { return };
        let first = *self.first.get_or_insert(pose);
        let turn = (pose[2] - first[2] + PI).rem_euclid(TAU) - PI;
        let off = [pose[0] - first[0], pose[1] - first[1], turn];
        for (sum, off) in self.sum.iter_mut().zip(off) {
            *sum += off;
        }
        self.count += 1.0;
    }

    fn get(&self) -> Option<[f64; 3]> {
        let first = self.first?;
        Some([0, 1, 2].map(|n| first[n] + self.sum[n] / self.count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_are_seen_from_the_body() {
        // Facing left (90 degrees), one metre towards +y is one metre ahead.
        let ahead = way([1.0, 1.0, PI / 2.0], [1.0, 2.0, PI / 2.0], 0.0);
        assert!((ahead[0] - 1.0).abs() < 1e-12 && ahead[1].abs() < 1e-12);
        // One and a half turns, read from headings within half a turn.
        let turned = way([0.0; 3], [0.0, 0.0, PI - 0.1], 3.0 * PI);
        assert!((turned[2] - (3.0 * PI - 0.1)).abs() < 1e-12, "{turned:?}");
    }

    #[test]
    fn a_mean_across_half_a_turn_stays_there() {
        let mut mean = Mean::default();
        mean.add(Some([0.0, 0.0, PI - 0.01]));
        mean.add(Some([0.002, 0.0, 0.01 - PI]));
        let [x, _, heading] = mean.get().unwrap();
        assert!((x - 0.001).abs() < 1e-12 && (heading - PI).abs() < 1e-12);
    }

    /// By hand: 1.2 m to either side and wheels at (0.35, 0.37).
    #[test]
    fn bolted_robots_turn_mostly_by_going_sideways() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
        let file = GroupFile::load(path).unwrap();
        let bodies = Body::all(&file);
        let own = 3.0 * (0.35_f64.powi(2) + 0.37_f64.powi(2));
        assert_eq!(bodies[0].robots, [0, 1, 2]);
        assert!((bodies[0].turning - own / (own + 2.0 * 1.44)).abs() < 1e-6);
        let mut apart = file.clone();
        apart.simulation.rigid = false;
        assert_eq!(Body::all(&apart).len(), 3);
    }

    /// By hand: two robots 30 degrees apart have their axis between them and cos(30 degrees) of
    /// alignment; two a quarter turn apart have none; half a turn is no difference.
    #[test]
    fn robots_that_face_differently_have_a_mean_axis() {
        let axis = |degrees: &[f64]| {
            let (heading, alignment) = mean_axis(degrees.iter().map(|d| d.to_radians()));
            (heading.to_degrees(), alignment)
        };
        let near = |(a, b): (f64, f64), (c, d): (f64, f64)| {
            assert!((a - c).abs() < 1e-9 && (b - d).abs() < 1e-9, "{a} {b}");
        };
        near(axis(&[0.0, 30.0]), (15.0, 0.75_f64.sqrt()));
        near(axis(&[90.0, 90.0, 270.0]), (90.0, 1.0));
        near(axis(&[180.0, 0.0]), (180.0, 1.0));
        assert!(axis(&[0.0, 90.0, 180.0, 270.0]).1 < 1e-9);
    }
}
