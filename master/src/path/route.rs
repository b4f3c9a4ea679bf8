//! A way that can change while it is driven: it is extended, held, and driven on.
//!
//! A [`Route`] is geometry first: poses close to each other, with the speed that each permits. From
//! that it works out a *time law*, s(t) along the way, no further ahead than it is asked. What is
//! asked for never changes any more; a change of the route (more of it, a hold) begins behind that.
//! So a route is a [`Trajectory`] like any other, and the follower of `omnibus follow` drives it
//! with the same preview and the same feedback.
//!
//! The speed at every pose is bounded by the limits of the group, by the way's own, by curvature
//! (the change of the velocity in the group's axes, v² b'), by corners (a step of the velocity must
//! fit into one SYNC period or so) and, from the end backwards, by braking. Shares of the limits
//! are left for the feedback.
//!
//! Distance along the way counts turning too, as `hypot(dx, dy, r dθ)` with the radius at which the
//! fastest turn moves as fast as the fastest drive, so a turn on the spot has a length.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use group::Limits;
use kinematics::trajectory::Trajectory;
use kinematics::{Pose, Twist};

/// Step of the time law, s.
const STEP: f64 = 0.005;
/// Share of the group's speeds that a way uses.
const SPEED_SHARE: f64 = 0.9;
/// Share of its accelerations for braking and driving off, and the same for curves: together
/// they stay below one.
const ACCELERATION_SHARE: f64 = 0.6;
/// A step of the velocity is spread over so long, s.
const CORNER: f64 = 0.02;
/// A change of direction between two poses beyond which they are a corner.
const SHARP: f64 = 0.2;
/// Corners are passed at least this fast, m/s.
const CRAWL: f64 = 0.005;
/// Poses that are closer are one, m.
const SAME: f64 = 1e-9;
/// This close to the end it is reached, m.
const ARRIVED: f64 = 2e-5;
/// How much of the past is kept for late sightings, s.
const MEMORY: f64 = 2.0;

/// A part of a way.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// Poses close to each other, m and rad, headings without jumps.
    pub poses: Vec<Pose<f64>>,
    /// Speed at most, m/s.
    pub speed: Option<f64>,
    /// Yaw rate at most, rad/s.
    pub turn: Option<f64>,
    /// Mark that is passed at its end.
    pub mark: Option<u32>,
}

/// What a way may ask of the group.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    speed: f64,
    turn: f64,
    acceleration: f64,
    turn_acceleration: f64,
}

impl Bounds {
    fn of(limits: &Limits) -> Self {
        Self {
            speed: SPEED_SHARE * f64::from(limits.linear_speed),
            turn: SPEED_SHARE * f64::from(limits.yaw_rate),
            acceleration: ACCELERATION_SHARE * f64::from(limits.linear_acceleration),
            turn_acceleration: ACCELERATION_SHARE * f64::from(limits.yaw_acceleration),
        }
    }

    fn radius(&self) -> f64 {
        self.speed / self.turn
    }
}

/// A pose of the way. What lies between it and the next one belongs to it.
#[derive(Clone, Copy, Debug)]
struct Knot {
    s: f64,
    pose: Pose<f64>,
    /// Change of the pose per distance.
    slope: Twist<f64>,
    /// Speed and yaw rate that were asked for up to here.
    asked: (f64, f64),
    /// Acceleration along the way from here on, m/s².
    acceleration: f64,
    /// Speed that this pose permits, m/s.
    limit: f64,
    /// Square of the speed here from which everything ahead can be done.
    reach: f64,
}

/// Distance and speed at one moment.
#[derive(Clone, Copy, Debug)]
struct Moment {
    s: f64,
    v: f64,
}

struct Route {
    bounds: Bounds,
    knots: Vec<Knot>,
    /// Distance of each mark that is not passed yet.
    marks: VecDeque<(f64, u32)>,
    /// The time law from step `first` on.
    law: VecDeque<Moment>,
    first: u64,
    /// The latest time that was asked for, s.
    asked: f64,
    /// What is asked for lies this far ahead of what is done, s.
    lead: f64,
    held: bool,
    /// It ends where it comes to rest.
    cut: bool,
    /// When it came to its end.
    ended: Option<f64>,
    closed: bool,
}

impl Route {
    fn end(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.s)
    }

    fn append(&mut self, stretches: &[Stretch]) {
        let radius = self.bounds.radius();
        let joint = self.knots.len();
        for stretch in stretches {
            let speed = stretch
                .speed
                .unwrap_or(f64::INFINITY)
                .min(self.bounds.speed);
            let turn = stretch.turn.unwrap_or(f64::INFINITY).min(self.bounds.turn);
            for pose in &stretch.poses {
                let way = self.knots.last().map_or(0.0, |last| {
                    let (dx, dy) = (pose.x - last.pose.x, pose.y - last.pose.y);
                    dx.hypot(dy)
                        .hypot(radius * (pose.heading - last.pose.heading))
                });
                if way < SAME && !self.knots.is_empty() {
                    continue;
                }
                self.knots.push(Knot {
                    s: self.end() + way,
                    pose: *pose,
                    slope: Twist::new(0.0, 0.0, 0.0),
                    asked: (speed, turn),
                    acceleration: 0.0,
                    limit: 0.0,
                    reach: 0.0,
                });
            }
            if let Some(mark) = stretch.mark {
                self.marks.push_back((self.end(), mark));
            }
        }
        self.measure(joint.saturating_sub(2));
        self.brake();
    }

    /// The direction from one pose to the next, per distance: on the map.
    fn direction(&self, from: usize) -> Option<Twist<f64>> {
        let (a, b) = (self.knots.get(from)?, self.knots.get(from + 1)?);
        let way = b.s - a.s;
        let turned = b.pose.heading - a.pose.heading;
        Some(Twist::new(
            (b.pose.x - a.pose.x) / way,
            (b.pose.y - a.pose.y) / way,
            turned / way,
        ))
    }

    /// Slopes and permitted speeds from a pose on.
    fn measure(&mut self, from: usize) {
        let mut corners = Vec::new();
        for index in from..self.knots.len() {
            let before = index
                .checked_sub(1)
                .and_then(|before| self.direction(before));
            let after = self.direction(index);
            let (Some(into), Some(out)) = (before.or(after), after.or(before)) else {
                return;
            };
            let around = |index: usize| self.knots.get(index).map_or(0.0, |knot| knot.s);
            let (here, next) = (around(index), around(index + 1).max(around(index)));
            let (back, ahead) = (here - around(index.saturating_sub(1)), next - here);
            // Weighted so that a parabola through the three poses has this slope.
            let share = if back + ahead > 0.0 {
                back / (back + ahead)
            } else {
                0.5
            };
            let slope = into * (1.0 - share) + out * share;
            let Some(knot) = self.knots.get(index).copied() else {
                return;
            };
            let asked = self.knots.get(index + 1).map_or(knot.asked, |next| {
                (
                    knot.asked.0.min(next.asked.0),
                    knot.asked.1.min(next.asked.1),
                )
            });
            let heading = knot.pose.heading;
            let change = out.to_body(heading + 0.5 * out.omega * ahead)
                - into.to_body(heading - 0.5 * into.omega * back);
            let way = (0.5 * (back + ahead)).max(SAME);
            let (limit, beside) = self.bounds.permitted(asked, [into, out], change, way);
            corners.extend(beside.map(|beside| (index, beside)));
            let acceleration = self.bounds.along(out);
            if let Some(knot) = self.knots.get_mut(index) {
                (knot.slope, knot.limit, knot.acceleration) = (slope, limit, acceleration);
            }
        }
        // The cubics on both sides of a corner already turn into it.
        for (index, beside) in corners {
            for near in [index.saturating_sub(1), index + 1] {
                if let Some(knot) = self.knots.get_mut(near) {
                    knot.limit = knot.limit.min(beside);
                }
            }
        }
    }

    /// From the end backwards: how fast each pose may be passed so that what follows can be braked
    /// for.
    fn brake(&mut self) {
        let mut next: Option<(f64, f64)> = None;
        for knot in self.knots.iter_mut().rev() {
            let limit = knot.limit.max(CRAWL).powi(2);
            knot.reach = next.map_or(0.0, |(s, reach)| {
                limit.min(reach + 2.0 * knot.acceleration * (s - knot.s))
            });
            next = Some((knot.s, knot.reach));
        }
    }

    /// The last knot before a distance.
    fn place(&self, s: f64) -> usize {
        let after = self.knots.partition_point(|knot| knot.s <= s);
        after
            .saturating_sub(1)
            .min(self.knots.len().saturating_sub(2))
    }

    /// The speed from which everything ahead can be done, and the acceleration there.
    fn envelope(&self, s: f64) -> (f64, f64) {
        let index = self.place(s);
        let (Some(a), Some(b)) = (self.knots.get(index), self.knots.get(index + 1)) else {
            return (0.0, self.bounds.acceleration);
        };
        let share = ((s - a.s) / (b.s - a.s)).clamp(0.0, 1.0);
        let square = a.reach + share * (b.reach - a.reach);
        (square.max(0.0).sqrt(), a.acceleration)
    }

    /// One more step of the time law.
    fn advance(&mut self) {
        let now = self
            .law
            .back()
            .copied()
            .unwrap_or(Moment { s: 0.0, v: 0.0 });
        let end = self.end();
        let (_, acceleration) = self.envelope(now.s);
        let faster = now.v + acceleration * STEP;
        let slower = (now.v - acceleration * STEP).max(0.0);
        let (ahead, _) = self.envelope(now.s + now.v * STEP);
        let v = if self.held {
            slower.min(ahead)
        } else {
            faster.min(ahead.max(slower))
        };
        let mut next = Moment {
            s: (now.s + 0.5 * (now.v + v) * STEP).min(end),
            v,
        };
        if end - next.s < ARRIVED {
            next = Moment { s: end, v: 0.0 };
        }
        self.law.push_back(next);
        let at = (self.first + self.law.len() as u64 - 1) as f64 * STEP;
        if self.ended.is_none() && next.v == 0.0 && (next.s >= end || (self.held && self.cut)) {
            self.ended = Some(at);
        }
        let kept = ((self.asked - MEMORY) / STEP).max(0.0);
        while (self.first as f64) < kept && self.law.len() > 2 {
            self.law.pop_front();
            self.first += 1;
        }
    }

    /// Distance, speed at a time.
    fn moment(&mut self, t: f64) -> Moment {
        self.asked = self.asked.max(t);
        let step = (t / STEP).max(self.first as f64);
        while self.ended.is_none() && (self.first + self.law.len() as u64) as f64 <= step + 1.0 {
            self.advance();
        }
        // The end is a step of the law, which division need not hit.
        let end = self.ended.filter(|ended| t >= *ended).map(|_| usize::MAX);
        #[expect(clippy::cast_possible_truncation, reason = "some hundreds")]
        #[expect(clippy::cast_sign_loss, reason = "not before the first")]
        let index = end.unwrap_or((step - self.first as f64) as usize);
        match (self.law.get(index), self.law.get(index.saturating_add(1))) {
            (Some(a), Some(b)) => {
                let passed = (step.fract() * STEP).clamp(0.0, STEP);
                let change = (b.v - a.v) / STEP;
                let s = a.s + a.v * passed + 0.5 * change * passed * passed;
                Moment {
                    s: s.clamp(a.s, b.s.max(a.s)),
                    v: a.v + change * passed,
                }
            }
            _ => Moment {
                v: 0.0,
                ..self
                    .law
                    .back()
                    .copied()
                    .unwrap_or(Moment { s: 0.0, v: 0.0 })
            },
        }
    }

    /// How far it has been driven. A route that was driven to its end was asked for no later time.
    fn done(&mut self) -> f64 {
        let now = match self.ended {
            Some(ended) if self.closed => ended,
            _ => (self.asked - self.lead).max(0.0),
        };
        self.moment(now).s
    }

    /// Forgets the time law behind what was asked for.
    fn change(&mut self) {
        let kept = (self.asked / STEP).ceil() - self.first as f64 + 2.0;
        #[expect(clippy::cast_possible_truncation, reason = "some hundreds")]
        #[expect(clippy::cast_sign_loss, reason = "asked is not before the first")]
        self.law.truncate(kept.max(1.0) as usize);
        let known = (self.first + self.law.len() as u64) as f64 * STEP;
        self.ended = self.ended.filter(|ended| *ended < known);
    }

    /// Pose and its change per distance, cubic between two poses.
    fn pose(&self, s: f64) -> (Pose<f64>, Twist<f64>) {
        let index = self.place(s);
        let (Some(a), Some(b)) = (self.knots.get(index), self.knots.get(index + 1)) else {
            let pose = self
                .knots
                .first()
                .map_or_else(Pose::default, |knot| knot.pose);
            return (pose, Twist::new(0.0, 0.0, 0.0));
        };
        let way = b.s - a.s;
        let u = ((s - a.s) / way).clamp(0.0, 1.0);
        let cubic = |p: f64, m: f64, q: f64, n: f64| {
            let (m, n) = (m * way, n * way);
            let (c, d) = (3.0 * (q - p) - 2.0 * m - n, 2.0 * (p - q) + m + n);
            (
                p + u * (m + u * (c + u * d)),
                (m + u * (2.0 * c + 3.0 * u * d)) / way,
            )
        };
        let (x, dx) = cubic(a.pose.x, a.slope.vx, b.pose.x, b.slope.vx);
        let (y, dy) = cubic(a.pose.y, a.slope.vy, b.pose.y, b.slope.vy);
        let (heading, turn) = cubic(a.pose.heading, a.slope.omega, b.pose.heading, b.slope.omega);
        (Pose::new(x, y, heading), Twist::new(dx, dy, turn))
    }
}

impl Bounds {
    /// Acceleration along a direction that keeps within the limits.
    fn along(&self, direction: Twist<f64>) -> f64 {
        let linear = self.acceleration / direction.vx.hypot(direction.vy).max(SAME);
        linear.min(self.turn_acceleration / direction.omega.abs().max(SAME))
    }

    /// Speed at which a pose may be passed: `change` of the direction in the group's axes within
    /// `way`. At a corner also the speed for the poses beside it.
    fn permitted(
        &self,
        asked: (f64, f64),
        directions: [Twist<f64>; 2],
        change: Twist<f64>,
        way: f64,
    ) -> (f64, Option<f64>) {
        let (mut limit, mut beside) = (f64::INFINITY, None);
        for direction in directions {
            limit = limit.min(asked.0 / direction.vx.hypot(direction.vy).max(SAME));
            limit = limit.min(asked.1 / direction.omega.abs().max(SAME));
        }
        for (change, acceleration) in [
            (change.vx.hypot(change.vy), self.acceleration),
            (change.omega.abs(), self.turn_acceleration),
        ] {
            let change = change.max(SAME * way);
            let curve = (acceleration * way / change).sqrt();
            limit = limit.min(curve);
            if change > SHARP {
                limit = limit.min(acceleration * CORNER / change);
                beside = Some(beside.map_or(curve, |other: f64| other.min(curve)));
            }
        }
        (limit, beside)
    }
}

/// A route that one thread drives and others change.
#[derive(Clone)]
pub struct SharedRoute(Arc<Mutex<Route>>);

impl SharedRoute {
    /// A route for a group with these limits. `lead` is how far ahead of what is done its driver
    /// asks, s. `held`: it does not begin before [`SharedRoute::resume`].
    #[must_use]
    pub fn new(limits: &Limits, stretches: &[Stretch], lead: f64, held: bool) -> Self {
        let mut route = Route {
            bounds: Bounds::of(limits),
            knots: Vec::new(),
            marks: VecDeque::new(),
            law: VecDeque::from([Moment { s: 0.0, v: 0.0 }]),
            first: 0,
            asked: 0.0,
            lead,
            held,
            cut: false,
            ended: None,
            closed: false,
        };
        route.append(stretches);
        if route.end() <= 0.0 {
            route.ended = Some(0.0);
        }
        Self(Arc::new(Mutex::new(route)))
    }

    /// A thread that panicked has not left it half changed.
    fn lock(&self) -> MutexGuard<'_, Route> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts more behind it. `false` when it has come to its end or is being stopped.
    #[must_use]
    pub fn extend(&self, stretches: &[Stretch]) -> bool {
        let mut route = self.lock();
        route.change();
        if route.closed || route.cut || route.ended.is_some() {
            return false;
        }
        route.append(stretches);
        true
    }

    /// Comes to rest on the way.
    pub fn hold(&self) {
        let mut route = self.lock();
        route.held = true;
        route.change();
    }

    /// Drives on.
    pub fn resume(&self) {
        let mut route = self.lock();
        route.held = route.cut;
        route.change();
    }

    /// Comes to rest on the way and ends there.
    pub fn cut(&self) {
        let mut route = self.lock();
        (route.held, route.cut) = (true, true);
        route.change();
        let rests = route.law.back().is_none_or(|last| last.v == 0.0);
        if rests && route.ended.is_none() {
            route.ended = Some(route.asked);
        }
    }

    /// It is not driven any more.
    pub fn close(&self) {
        self.lock().closed = true;
    }

    /// Whether it is driven no more, to its end or not.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Whether no mark that has been passed waits for [`SharedRoute::passed`].
    #[must_use]
    pub fn is_reported(&self) -> bool {
        let mut route = self.lock();
        let s = route.done() + SAME;
        route.marks.front().is_none_or(|(at, _)| *at > s)
    }

    /// Whether it stands at this moment because it is held.
    #[must_use]
    pub fn stands(&self) -> bool {
        let mut route = self.lock();
        let now = (route.asked - route.lead).max(0.0);
        route.held && route.moment(now).v == 0.0
    }

    /// Marks that have been passed since the last call.
    #[must_use]
    pub fn passed(&self) -> Vec<u32> {
        let mut route = self.lock();
        let s = route.done() + SAME;
        let mut passed = Vec::new();
        while let Some((at, mark)) = route.marks.front().copied() {
            if at > s {
                break;
            }
            passed.push(mark);
            route.marks.pop_front();
        }
        passed
    }
}

impl Trajectory<f64> for SharedRoute {
    fn at(&self, time: f64) -> (Pose<f64>, Twist<f64>) {
        let mut route = self.lock();
        let Moment { s, v } = route.moment(time.max(0.0));
        let (pose, slope) = route.pose(s);
        (pose, slope * v)
    }

    /// Without an end as long as that may still change.
    fn duration(&self) -> f64 {
        self.lock().ended.unwrap_or(f64::INFINITY)
    }
}

impl PartialEq for SharedRoute {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl std::fmt::Debug for SharedRoute {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedRoute").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests;
