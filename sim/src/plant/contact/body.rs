//! Robots that move as one, and the friction that moves them.
//!
//! In a step the velocity goes from `v0` to the `v` at which momentum and friction agree, `M (v -
//! v0) = -dt sum(row F(row . v - rest))`, with `F` proportional to slip up to the friction limit.
//! That is where a convex function of the three velocities has its minimum; Newton's method finds
//! it, exactly as soon as it knows which contacts are at their limit, which is mostly at once.

use group::{Patch, Payload};
use kinematics::{Pose, Wheel};

use super::wheel::{Push, Pushes, Stand, Wheels};
use super::{Contact, GRAVITY, Part};
use crate::error::SimError;
use crate::four::{Four, Signs};

/// Most Newton steps, and most halvings of one.
const STEPS: usize = 40;
const HALVINGS: usize = 30;

/// Robots that move as one.
#[derive(Debug, Clone)]
pub(super) struct Body {
    robots: Vec<Wheels>,
    /// Mass twice, and inertia about the centre of mass.
    inertia: [f64; 3],
    /// Centre of mass and heading in the world.
    pose: Pose<f64>,
    /// World frame.
    velocity: [f64; 3],
    /// In this step: for each robot what its first rollers can do, and its second where it stands
    /// on such.
    pushes: Vec<Pushes>,
    /// How many of them.
    touches: usize,
    friction: f64,
    floor: Vec<Patch>,
    /// The centre of mass in the frame the members' places are given in.
    centre: (f64, f64),
    step: Step,
}

/// A step under way. Velocities are in the body's frame.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Sine and cosine of the heading halfway.
    direction: (f64, f64),
    /// Over the step's length.
    inertia: [f64; 3],
    before: [f64; 3],
    /// At that velocity.
    derivatives: Derivatives,
    /// Where the first of Newton's steps leads.
    after: [f64; 3],
}

impl Body {
    /// Robots and what they carry, in a frame that stands at `frame` in the world.
    pub fn new(
        contact: &Contact,
        parts: &[Part],
        payload: Option<Payload>,
        floor: &[Patch],
        frame: Pose<f64>,
    ) -> Result<Self, SimError> {
        let robots = parts.iter().map(|p| (contact.mass, p.place.x, p.place.y));
        let masses = robots.chain(payload.map(|p| (p.mass, p.x, p.y)));
        let sum = masses.fold((0.0, 0.0, 0.0), |(mass, x, y), (m, mx, my)| {
            (mass + m, x + m * mx, y + m * my)
        });
        let (mass, centre) = (sum.0, (sum.1 / sum.0, sum.2 / sum.0));
        let mut inertia = payload.map_or(0.0, |p| {
            p.mass * ((p.x - centre.0).powi(2) + (p.y - centre.1).powi(2))
        });
        let mut robots = Vec::with_capacity(parts.len());
        for part in parts {
            let (w, h) = half_sizes(&part.wheels);
            let (x, y) = (part.place.x - centre.0, part.place.y - centre.1);
            // An even rectangle of 2 w by 2 h about the robot's place, and that about the centre.
            inertia += contact.mass * ((w * w + h * h) / 3.0 + x * x + y * y);
            robots.push(Wheels::of(contact, part, (x, y)));
        }
        share_load(&mut robots, mass * GRAVITY, contact.friction)?;
        Ok(Self {
            pushes: vec![Pushes::NONE; 2 * robots.len()],
            touches: 0,
            robots,
            inertia: [mass, mass, inertia],
            pose: frame.compose(Pose::new(centre.0, centre.1, 0.0)),
            velocity: [0.0; 3],
            friction: contact.friction,
            floor: floor.to_vec(),
            centre,
            step: Step {
                direction: (0.0, 1.0),
                inertia: [0.0; 3],
                before: [0.0; 3],
                derivatives: Derivatives::NONE,
                after: [0.0; 3],
            },
        })
    }

    /// Pose of the centre of mass: of a robot alone its own pose.
    pub fn pose(&self) -> Pose<f64> {
        self.pose
    }

    /// Pose of the frame that the members' places are given in.
    pub fn frame(&self) -> Pose<f64> {
        self.pose
            .compose(Pose::new(-self.centre.0, -self.centre.1, 0.0))
    }

    /// Velocity of the centre of mass, world frame.
    pub fn velocity(&self) -> [f64; 3] {
        self.velocity
    }

    /// What the floor does to a robot's wheels, N·m.
    pub fn floor_torques(&self, robot: usize) -> [f64; 4] {
        let own = self.robots.iter().find(|wheels| wheels.robot == robot);
        own.map_or([0.0; 4], |wheels| wheels.torques.0)
    }

    /// See [`velocity`](Self::velocity).
    pub fn set_velocity(&mut self, velocity: [f64; 3]) {
        self.velocity = velocity;
    }

    /// Begins a step of `dt` in which the wheels turn by `turned` and the robots stand so: finds
    /// what the floor can do.
    #[inline(always)]
    pub fn begin(&mut self, dt: f64, stands: &[Stand], turned: &[[f64; 4]]) {
        let (sin, cos) = libm::sincos(self.pose.heading + 0.5 * dt * self.velocity[2]);
        let per_dt = 1.0 / dt;
        let most = self.pushes.len();
        let mut pushes = self.pushes.iter_mut();
        for wheels in &mut self.robots {
            if !self.floor.is_empty() {
                wheels.rub(Four::from_fn(|n| {
                    let x = self.pose.x + cos * wheels.x.0[n] - sin * wheels.y.0[n];
                    let y = self.pose.y + sin * wheels.x.0[n] + cos * wheels.y.0[n];
                    friction_at(&self.floor, x, y).unwrap_or(self.friction)
                }));
            }
            let rates = Four(turned[wheels.robot]) * per_dt;
            let stand = &stands[wheels.robot];
            wheels.stand(stand, rates, dt, &mut pushes);
        }
        self.touches = most - pushes.len();
        let [vx, vy, omega] = self.velocity;
        let before = [cos * vx + sin * vy, cos * vy - sin * vx, omega];
        self.step = Step {
            direction: (sin, cos),
            inertia: self.inertia.map(|m| m * per_dt),
            before,
            derivatives: Derivatives::of(&mut self.pushes[..self.touches], before),
            after: before,
        };
    }

    /// Continues the step: takes the first of Newton's steps.
    #[inline(always)]
    pub fn approach(&mut self) {
        let step = &mut self.step;
        let newton = step
            .derivatives
            .newton(step.inertia, step.before, step.before);
        step.after = along(step.before, newton, 1.0);
    }

    /// Ends the step: moves.
    #[inline(always)]
    pub fn finish(&mut self, dt: f64, stands: &[Stand]) {
        let Step {
            direction: (sin, cos),
            inertia,
            before,
            mut after,
            ..
        } = self.step;
        let pushes = &mut self.pushes[..self.touches];
        if !all_as_limited(pushes, after) {
            after = settle(pushes, inertia, before);
        }
        let mut pushes = pushes.iter();
        for wheels in &mut self.robots {
            wheels.turn_rollers(&stands[wheels.robot], &mut pushes, dt);
        }
        let [vx, vy, omega] = after;
        self.velocity = [cos * vx - sin * vy, sin * vx + cos * vy, omega];
        self.pose.x += dt * self.velocity[0];
        self.pose.y += dt * self.velocity[1];
        self.pose.heading += dt * omega;
    }
}

/// Half of the width and length over which the wheels of a robot stand, m.
fn half_sizes(wheels: &[Wheel<f64>; 4]) -> (f64, f64) {
    let half = |of: fn(&Wheel<f64>) -> f64| {
        let (low, high) = wheels
            .iter()
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
                (low.min(at), high.max(at))
            });
        0.5 * (high - low)
    };
    (half(|wheel| wheel.y()), half(|wheel| wheel.x()))
}

/// Friction of the last patch that holds a place.
fn friction_at(floor: &[Patch], x: f64, y: f64) -> Option<f64> {
    let holds = |p: &&Patch| (p.x.0..=p.x.1).contains(&x) && (p.y.0..=p.y.1).contains(&y);
    floor.iter().rev().find(holds).map(|patch| patch.friction)
}

/// Shares a weight whose centre is the origin among wheels on a floor with this friction as equal
/// springs under a rigid body do: `a + b x + c y` each.
fn share_load(robots: &mut [Wheels], weight: f64, friction: f64) -> Result<(), SimError> {
    let mut sums = [[0.0; 3]; 3];
    for wheels in robots.iter() {
        let row = [Four::ONE, wheels.x, wheels.y];
        for (sums, a) in sums.iter_mut().zip(row) {
            for (sum, b) in sums.iter_mut().zip(row) {
                *sum += (a * b).sum();
            }
        }
    }
    let [a, b, c] = solve(sums, [weight, 0.0, 0.0]);
    for wheels in robots {
        let load = Four::all(a) + wheels.x * b + wheels.y * c;
        if load.0.iter().any(|load| load.is_nan() || *load <= 0.0) {
            return Err(SimError::Plant {
                problem: "simulation.payload: tips the group over; put it between the wheels, or \
                          make it lighter"
                    .to_owned(),
            });
        }
        wheels.carry(load, friction);
    }
    Ok(())
}

/// The velocity at which momentum and friction agree; `inertia` is over the step's length.
#[inline(always)]
fn settle(pushes: &mut [Pushes], inertia: [f64; 3], before: [f64; 3]) -> [f64; 3] {
    let mut v = before;
    let mut cost = None;
    for _ in 0..STEPS {
        let step = Derivatives::of(pushes, v).newton(inertia, before, v);
        let mut part = 1.0;
        let mut next = along(v, step, part);
        if all_as_limited(pushes, next) {
            // All the way on one quadratic piece: this is its minimum.
            return next;
        }
        let least = *cost.get_or_insert_with(|| value(pushes, inertia, before, v));
        let mut reached = value(pushes, inertia, before, next);
        for _ in 0..HALVINGS {
            if reached <= least {
                break;
            }
            part *= 0.5;
            next = along(v, step, part);
            reached = value(pushes, inertia, before, next);
        }
        (v, cost) = (next, Some(reached));
    }
    Derivatives::of(pushes, v);
    v
}

/// Whether all contacts are as limited at this velocity as at the one they were last looked at:
/// friction is below its limit, or at the same of the two. It has been looked at this one then.
#[inline(always)]
fn all_as_limited(pushes: &mut [Pushes], v: [f64; 3]) -> bool {
    for pushes in pushes {
        let [along, across] = pushes.each();
        let before = pushes.wanted;
        pushes.wanted = [along.wanted(v), across.wanted(v)];
        let changes = along.changes(before[0], pushes.wanted[0], Signs::EQUAL);
        let changes = across.changes(before[1], pushes.wanted[1], changes);
        if !changes.all_equal() {
            return false;
        }
    }
    true
}

fn along(v: [f64; 3], step: [f64; 3], part: f64) -> [f64; 3] {
    [
        v[0] - part * step[0],
        v[1] - part * step[1],
        v[2] - part * step[2],
    ]
}

impl Push {
    /// Force without limit.
    #[inline(always)]
    fn wanted(&self, v: [f64; 3]) -> Four {
        self.stiffness * self.slip(v)
    }

    #[inline(always)]
    fn slip(&self, v: [f64; 3]) -> Four {
        self.row[0] * v[0] + self.row[1] * v[1] + self.row[2] * v[2] - self.rest
    }

    #[inline(always)]
    pub fn held(&self, wanted: Four) -> Four {
        wanted.max(-self.limit).min(self.limit)
    }

    /// And in which wheels one of these forces is limited otherwise than the other.
    #[inline(always)]
    fn changes(&self, a: Four, b: Four, changes: Signs) -> Signs {
        let limit = self.limit;
        changes.or(limit - a, limit - b).or(limit + a, limit + b)
    }
}

/// What the right velocity makes least.
fn value(pushes: &[Pushes], inertia: [f64; 3], before: [f64; 3], v: [f64; 3]) -> f64 {
    let momentum: f64 = (0..3)
        .map(|k| 0.5 * inertia[k] * (v[k] - before[k]).powi(2))
        .sum();
    let friction = pushes
        .iter()
        .flat_map(Pushes::each)
        .fold(Four::ZERO, |sum, push| {
            let slip = push.slip(v).abs();
            let excess = push.stiffness * slip - push.limit;
            let knee = push.limit / push.stiffness;
            sum + excess.where_positive(
                push.limit * (slip - knee * 0.5),
                push.stiffness * slip * slip * 0.5,
            )
        });
    momentum + friction.sum()
}

/// Its first and second derivatives without the momentum's part, one lane for each wheel of a
/// robot; of the second what is on and below the diagonal, row by row.
///
/// Adding up the lanes is for later: next to the loop over the contacts the compiler would make
/// vectors across the sums rather than of wheels there, and spend its time on moving lanes.
#[derive(Debug, Clone, Copy)]
struct Derivatives {
    gradient: [Four; 3],
    curvature: [Four; 6],
}

impl Derivatives {
    const NONE: Self = Self {
        gradient: [Four::ZERO; 3],
        curvature: [Four::ZERO; 6],
    };

    #[inline(always)]
    fn of(pushes: &mut [Pushes], v: [f64; 3]) -> Self {
        let mut sums = Self::NONE;
        for pushes in pushes {
            sums.add(pushes, v);
        }
        sums
    }

    /// An axle's direction has length 1, so its second part's square follows from the first's.
    #[inline(always)]
    fn add(&mut self, pushes: &mut Pushes, v: [f64; 3]) {
        let [along, across] = pushes.each();
        pushes.wanted = [along.wanted(v), across.wanted(v)];
        let along = self.push(&along, pushes.wanted[0]);
        let across = self.push(&across, pushes.wanted[1]);
        let ([x, y], [arm, lever]) = (pushes.axle, pushes.arms);
        let more = (along - across) * x;
        let c = &mut self.curvature;
        c[0] = c[0] + across + more * x;
        c[2] = c[2] + along - more * x;
        c[1] = c[1] + more * y;
        let along = along * arm;
        c[3] = c[3] + along * x;
        c[4] = c[4] + along * y;
        c[5] = c[5] + along * arm;
        let across = across * lever;
        c[3] = c[3] - across * y;
        c[4] = c[4] + across * x;
        c[5] = c[5] + across * lever;
    }

    #[inline(always)]
    fn push(&mut self, push: &Push, wanted: Four) -> Four {
        let held = push.held(wanted);
        let [x, y, turn] = push.row;
        let g = &mut self.gradient;
        (g[0], g[1], g[2]) = (g[0] + x * held, g[1] + y * held, g[2] + turn * held);
        held.where_equal(wanted, push.stiffness)
    }

    /// Newton's step from the velocity `v`.
    #[inline(always)]
    fn newton(&self, inertia: [f64; 3], before: [f64; 3], v: [f64; 3]) -> [f64; 3] {
        let [a, b, c] = self.gradient;
        let [d, e, f, g, h, i] = self.curvature;
        let [a, b] = Four::two_sums(a, b);
        let [c, d] = Four::two_sums(c, d);
        let [e, f] = Four::two_sums(e, f);
        let [g, h] = Four::two_sums(g, h);
        let (mut gradient, mut curvature) =
            ([a, b, c], [[d, 0.0, 0.0], [e, f, 0.0], [g, h, i.sum()]]);
        for k in 0..3 {
            gradient[k] += inertia[k] * (v[k] - before[k]);
            curvature[k][k] += inertia[k];
        }
        solve(curvature, gradient)
    }
}

/// Solves a symmetric positive definite system from what is on and below the diagonal, by Cramer's
/// rule: its one division is the only one to wait for.
fn solve([[a, ..], [b, c, _], [d, e, f]]: [[f64; 3]; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let (aa, ab, ad) = (c * f - e * e, d * e - b * f, b * e - c * d);
    let (bb, bd, dd) = (a * f - d * d, b * d - a * e, a * c - b * b);
    let per_determinant = 1.0 / (a * aa + b * ab + d * ad);
    [
        (aa * x + ab * y + ad * z) * per_determinant,
        (ab * x + bb * y + bd * z) * per_determinant,
        (ad * x + bd * y + dd * z) * per_determinant,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (2, -1, 0.5) under a matrix with small whole numbers.
    #[test]
    fn solves_what_it_is_given() {
        let x = solve(
            [[4.0, 1.0, 2.0], [1.0, 5.0, 1.0], [2.0, 1.0, 6.0]],
            [8.0, -2.5, 6.0],
        );
        for (found, expected) in x.into_iter().zip([2.0, -1.0, 0.5]) {
            assert!((found - expected).abs() < 1e-14, "{x:?}");
        }
    }

    /// One contact that wants 1 m/s of 10 kg in a second: at its limit of 3 N it gives 0.3 m/s; far
    /// below it, with 90 N s/m against 10, it gives 0.9.
    #[test]
    fn a_contact_gives_its_limit_and_no_more() {
        let only = |value: f64| Four([0.0, value, 0.0, 0.0]);
        let push = Pushes {
            axle: [only(1.0), Four::ZERO],
            arms: [Four::ZERO; 2],
            rest: [only(1.0), Four::ZERO],
            limit: only(3.0),
            stiffness: [only(90.0), Four::ZERO],
            ..Pushes::NONE
        };
        let v = settle(&mut [push], [10.0, 10.0, 1.0], [0.0; 3]);
        assert!((v[0] - 0.3).abs() < 1e-12, "{v:?}");
        let strong = Pushes {
            limit: only(1e3),
            ..push
        };
        let v = settle(&mut [strong], [10.0, 10.0, 1.0], [0.0; 3]);
        assert!((v[0] - 0.9).abs() < 1e-12, "{v:?}");
    }
}
