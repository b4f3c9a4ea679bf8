//! From edges to poses on the map.
//!
//! An edge becomes one [`Leg`] or several: a turn on the spot before it if the edge forbids
//! turning, the path along its trajectory or a straight line, and a turn on the spot at its end if
//! the node asks for another heading than the edge (6.7). A leg is a sequence of closely spaced
//! poses whose headings have no jumps of a whole turn. Its speed is decided by the caller that
//! drives it.
//!
//! Where an edge has an orientation that the vehicle does not have yet and turning is allowed, the
//! difference fades over the first half of the edge. Without an orientation the vehicle turns
//! evenly towards the heading of the next node, or keeps its own where that has none.

use std::f64::consts::{PI, TAU};

use kinematics::Pose;

use crate::message::order::{Edge, NodePosition, OrientationType};
use crate::nurbs::Nurbs;

/// Poses of a line or a turn are at most so far apart, m.
const LINE_STEP: f64 = 0.01;
/// Poses of a curve are so far apart, measured along its control points, m.
const CURVE_STEP: f64 = 0.002;
/// Radians of a turn between two poses.
const TURN_STEP: f64 = 0.01;
/// Fewest and most poses of one leg.
const FEWEST: f64 = 32.0;
const MOST: f64 = 50_000.0;
/// A line shorter than this is a place, m.
const PLACE: f64 = 1e-3;
/// A derivative that is smaller has no direction, m per parameter.
const STANDSTILL: f64 = 1e-9;
/// A heading that differs by less is the same, rad.
const SAME_HEADING: f64 = 1e-3;

/// A stretch of way.
#[derive(Clone, Debug, PartialEq)]
pub struct Leg {
    /// Where it leads: m, m, rad, on the map.
    pub poses: Vec<Pose<f64>>,
    /// Speed at most, m/s.
    pub max_speed: Option<f64>,
    /// Yaw rate at most, rad/s.
    pub max_turn: Option<f64>,
    /// Sequence number of the node that is reached at its end.
    pub arrives: Option<u32>,
}

impl Leg {
    /// Where it ends.
    #[must_use]
    pub fn end(&self) -> Option<Pose<f64>> {
        self.poses.last().copied()
    }
}

/// `angle` within a half turn of zero.
#[must_use]
pub fn wrapped(angle: f64) -> f64 {
    let turns = (angle / TAU).round();
    (angle - turns * TAU).clamp(-PI, PI)
}

/// The legs of an edge, from `start` to the node at `to`, whose number is `arrives`. `tolerance` is
/// how far from a node the vehicle may be at least, m.
///
/// # Errors
/// With what is wrong with the trajectory.
pub fn legs(
    edge: &Edge,
    from: &NodePosition,
    to: &NodePosition,
    start: Pose<f64>,
    arrives: u32,
    tolerance: f64,
) -> Result<Vec<Leg>, String> {
    let towards = to.theta.filter(|_| !edge.turns_before());
    let mut way = Way {
        edge,
        at: start,
        towards: towards.map(|theta| wrapped(theta - start.heading)),
        legs: Vec::new(),
    };
    let points = match &edge.trajectory {
        Some(trajectory) => {
            let curve = Nurbs::new(trajectory).map_err(|why| format!("trajectory.{why}"))?;
            let points = along(&curve);
            check_end("begins", points.first(), from, tolerance)?;
            check_end("ends", points.last(), to, tolerance)?;
            if let Some(&Point { x, y, .. }) = points.first()
                && (x - start.x).hypot(y - start.y) > PLACE
            {
                way.line(x, y);
            }
            points
        }
        None => straight(way.at, to.x, to.y),
    };
    way.follow(&points);
    if let Some(theta) = to.theta {
        let off = wrapped(theta - way.at.heading);
        let allowed = to.allowed_deviation_theta.unwrap_or(0.0);
        if off.abs() > allowed.max(SAME_HEADING) {
            way.turn(off);
        }
    }
    if let Some(last) = way.legs.last_mut() {
        last.arrives = Some(arrives);
    }
    Ok(way.legs)
}

/// A turn on the spot to the heading of a node; nothing where it has none.
#[must_use]
pub fn turn_at(start: Pose<f64>, node: &NodePosition) -> Option<Leg> {
    let off = wrapped(node.theta? - start.heading);
    let allowed = node.allowed_deviation_theta.unwrap_or(0.0);
    (off.abs() > allowed.max(SAME_HEADING)).then(|| Leg {
        poses: turning(start, off),
        max_speed: None,
        max_turn: None,
        arrives: None,
    })
}

fn check_end(
    verb: &str,
    point: Option<&Point>,
    node: &NodePosition,
    tolerance: f64,
) -> Result<(), String> {
    let &Point { x, y, .. } = point.ok_or("trajectory: it is empty")?;
    let (dx, dy) = (x - node.x, y - node.y);
    let allowed = node.allowed_deviation_xy;
    if dx.hypot(dy) <= tolerance || allowed.is_some_and(|d| d.holds(dx, dy, tolerance)) {
        return Ok(());
    }
    Err(format!(
        "trajectory {verb} at ({x:.3}, {y:.3}), {:.3} m from its node; let it {} at the node",
        dx.hypot(dy),
        verb.trim_end_matches('s')
    ))
}

/// A place on the way, and the direction of travel there, rad; `None` where the way stands still.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    x: f64,
    y: f64,
    along: Option<f64>,
}

struct Way<'a> {
    edge: &'a Edge,
    at: Pose<f64>,
    /// Turn to the heading of the next node, where the edge leaves that open, rad.
    towards: Option<f64>,
    legs: Vec<Leg>,
}

impl Way<'_> {
    fn push(&mut self, poses: Vec<Pose<f64>>) {
        self.at = poses.last().copied().unwrap_or(self.at);
        self.legs.push(Leg {
            poses,
            max_speed: self.edge.max_speed,
            max_turn: self.edge.max_rotation_speed,
            arrives: None,
        });
    }

    fn turn(&mut self, by: f64) {
        self.push(turning(self.at, by));
    }

    fn line(&mut self, x: f64, y: f64) {
        let heading = self.at.heading;
        let points = straight(self.at, x, y);
        self.push(
            points
                .into_iter()
                .map(|point| Pose::new(point.x, point.y, heading))
                .collect(),
        );
    }

    /// Follows the points with the heading that the edge wants.
    fn follow(&mut self, points: &[Point]) {
        let kind = self.edge.orientation_type.unwrap_or_default();
        let moves = points.iter().any(|point| point.along.is_some());
        let wanted: Option<Vec<f64>> = self.edge.orientation.map(|orientation| match kind {
            OrientationType::Global => vec![orientation; points.len()],
            OrientationType::Tangential if moves => directions(points)
                .into_iter()
                .map(|along| along + orientation)
                .collect(),
            // A place has no direction.
            OrientationType::Tangential => vec![self.at.heading; points.len()],
        });
        let Some(wanted) = wanted else {
            self.follow_freely(points);
            return;
        };
        let entry = wanted.first().copied().unwrap_or(self.at.heading);
        let mut off = wrapped(entry - self.at.heading);
        if self.edge.turns_before() && off.abs() > SAME_HEADING {
            self.turn(off);
            off = 0.0;
        }
        let base = self.at.heading + off - entry;
        let last = (points.len() - 1).max(1) as f64;
        let poses =
            points
                .iter()
                .zip(wanted)
                .enumerate()
                .map(|(index, (&Point { x, y, .. }, heading))| {
                    let fading = 1.0 - smooth(2.0 * index as f64 / last);
                    Pose::new(x, y, base + heading - off * fading)
                });
        let poses = poses.collect();
        self.push(poses);
    }

    /// Turns towards the next node's heading on the way, where the edge says nothing.
    fn follow_freely(&mut self, points: &[Point]) {
        let from = self.at.heading;
        let last = (points.len() - 1).max(1) as f64;
        let by = self.towards.unwrap_or(0.0);
        let poses = points
            .iter()
            .enumerate()
            .map(|(index, &Point { x, y, .. })| {
                Pose::new(x, y, from + by * smooth(index as f64 / last))
            });
        let poses = poses.collect();
        self.push(poses);
    }
}

/// 0 to 1 without a corner.
fn smooth(share: f64) -> f64 {
    let share = share.clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

fn steps(length: f64, step: f64) -> f64 {
    (length / step).ceil().clamp(FEWEST, MOST)
}

fn turning(from: Pose<f64>, by: f64) -> Vec<Pose<f64>> {
    let count = steps(by.abs(), TURN_STEP);
    shares(count)
        .map(|share| Pose::new(from.x, from.y, from.heading + by * share))
        .collect()
}

fn straight(from: Pose<f64>, x: f64, y: f64) -> Vec<Point> {
    let (dx, dy) = (x - from.x, y - from.y);
    let length = dx.hypot(dy);
    let (dx, dy) = if length < PLACE { (0.0, 0.0) } else { (dx, dy) };
    shares(steps(length, LINE_STEP))
        .map(|share| Point {
            x: from.x + dx * share,
            y: from.y + dy * share,
            along: direction(dx, dy),
        })
        .collect()
}

fn along(curve: &Nurbs) -> Vec<Point> {
    let (low, high) = curve.domain();
    shares(steps(curve.span_length(), CURVE_STEP))
        .map(|share| {
            let ([x, y], [dx, dy]) = curve.at(low + (high - low) * share);
            let along = direction(dx, dy);
            Point { x, y, along }
        })
        .collect()
}

fn direction(dx: f64, dy: f64) -> Option<f64> {
    (dx.hypot(dy) > STANDSTILL).then(|| dy.atan2(dx))
}

#[expect(clippy::cast_possible_truncation, reason = "at most 50 000")]
#[expect(clippy::cast_sign_loss, reason = "at least 32")]
fn shares(count: f64) -> impl Iterator<Item = f64> {
    (0..=count as u32).map(move |index| f64::from(index) / count)
}

/// The direction of travel at every point, without jumps. A point that has none keeps the one
/// before, and at the beginning the one after.
fn directions(points: &[Point]) -> Vec<f64> {
    let mut last = points.iter().find_map(|point| point.along).unwrap_or(0.0);
    points
        .iter()
        .map(|point| {
            last += point.along.map_or(0.0, |along| wrapped(along - last));
            last
        })
        .collect()
}
