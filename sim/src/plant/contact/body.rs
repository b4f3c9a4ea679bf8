//! Robots that move as one, and the friction that moves them.
//!
//! In a step the velocity goes from `v0` to the `v` at which momentum and friction agree, `M (v -
//! v0) = -dt sum(row F(row . v - rest))`, with `F` proportional to slip up to the friction limit.
//! That is where a convex function of the three velocities has its minimum; Newton's method finds
//! it, exactly as soon as it knows which contacts are at their limit, which is mostly at once.

use group::{Patch, Payload};
use kinematics::Pose;

use super::wheel::{Push, Wheel};
use super::{Contact, GRAVITY, Part};
use crate::error::SimError;

/// Most Newton steps, and most halvings of one.
const STEPS: usize = 40;
const HALVINGS: usize = 30;

/// Robots that move as one.
#[derive(Debug, Clone)]
pub(super) struct Body {
    wheels: Vec<Wheel>,
    /// Mass twice, and inertia about the centre of mass.
    inertia: [f64; 3],
    /// Centre of mass and heading in the world.
    pose: Pose<f64>,
    /// World frame.
    velocity: [f64; 3],
    /// Of every roller on the floor, along its axle and across.
    pushes: Vec<[Push; 2]>,
    friction: f64,
    floor: Vec<Patch>,
    /// The centre of mass in the frame the members' places are given in.
    centre: (f64, f64),
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
        let mut wheels = Vec::with_capacity(4 * parts.len());
        for part in parts {
            let (w, h) = (part.geometry.half_track(), part.geometry.half_wheelbase());
            let (x, y) = (part.place.x - centre.0, part.place.y - centre.1);
            // An even rectangle of 2 w by 2 h about its middle, and that middle about the centre.
            inertia += contact.mass * ((w * w + h * h) / 3.0 + x * x + y * y);
            wheels.extend(Wheel::of(contact, part, (x, y)));
        }
        share_load(&mut wheels, mass * GRAVITY)?;
        Ok(Self {
            pushes: Vec::with_capacity(2 * wheels.len()),
            wheels,
            inertia: [mass, mass, inertia],
            pose: frame.compose(Pose::new(centre.0, centre.1, 0.0)),
            velocity: [0.0; 3],
            friction: contact.friction,
            floor: floor.to_vec(),
            centre,
        })
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
        let mut torques = [0.0; 4];
        for wheel in self.wheels.iter().filter(|wheel| wheel.robot == robot) {
            torques[wheel.index] = wheel.floor_torque;
        }
        torques
    }

    /// See [`velocity`](Self::velocity).
    pub fn set_velocity(&mut self, velocity: [f64; 3]) {
        self.velocity = velocity;
    }

    /// Advances by `dt` in which the wheels turned by `turned` from `angles`.
    pub fn step(&mut self, dt: f64, angles: &[[f64; 4]], turned: &[[f64; 4]]) {
        let (sin, cos) = libm::sincos(self.pose.heading + 0.5 * dt * self.velocity[2]);
        self.pushes.clear();
        for wheel in &mut self.wheels {
            let moved = turned[wheel.robot][wheel.index];
            let angle = angles[wheel.robot][wheel.index] + 0.5 * moved;
            let friction = if self.floor.is_empty() {
                self.friction
            } else {
                let x = self.pose.x + cos * wheel.x - sin * wheel.y;
                let y = self.pose.y + sin * wheel.x + cos * wheel.y;
                friction_at(&self.floor, x, y).unwrap_or(self.friction)
            };
            wheel.stand(angle, moved / dt, friction, dt, &mut self.pushes);
        }
        let [vx, vy, omega] = self.velocity;
        let before = [cos * vx + sin * vy, cos * vy - sin * vx, omega];
        let after = settle(
            self.pushes.as_flattened(),
            self.inertia.map(|m| m / dt),
            before,
        );
        let mut forces = self.pushes.iter().map(|[_, across]| across.force(after));
        for wheel in &mut self.wheels {
            wheel.turn_rollers(forces.by_ref(), dt);
        }
        let mut pushes = self.pushes.iter();
        for wheel in &mut self.wheels {
            let own = pushes.by_ref().take(wheel.feet_down());
            wheel.floor_torque = own
                .flatten()
                .map(|push| push.lever * push.force(after))
                .sum();
        }
        let [vx, vy, omega] = after;
        self.velocity = [cos * vx - sin * vy, sin * vx + cos * vy, omega];
        self.pose.x += dt * self.velocity[0];
        self.pose.y += dt * self.velocity[1];
        self.pose.heading += dt * omega;
    }
}

/// Friction of the last patch that holds a place.
fn friction_at(floor: &[Patch], x: f64, y: f64) -> Option<f64> {
    let holds = |p: &&Patch| (p.x.0..=p.x.1).contains(&x) && (p.y.0..=p.y.1).contains(&y);
    floor.iter().rev().find(holds).map(|patch| patch.friction)
}

/// Shares a weight whose centre is the origin among wheels as equal springs under a rigid body do:
/// `a + b x + c y` each.
fn share_load(wheels: &mut [Wheel], weight: f64) -> Result<(), SimError> {
    let mut sums = [[0.0; 3]; 3];
    for wheel in wheels.iter() {
        let row = [1.0, wheel.x, wheel.y];
        for (sums, a) in sums.iter_mut().zip(row) {
            for (sum, b) in sums.iter_mut().zip(row) {
                *sum += a * b;
            }
        }
    }
    let [a, b, c] = solve(sums, [weight, 0.0, 0.0]);
    for wheel in wheels {
        wheel.load = a + b * wheel.x + c * wheel.y;
        if wheel.load.is_nan() || wheel.load <= 0.0 {
            return Err(SimError::Plant {
                problem: "simulation.payload: tips the group over; put it between the wheels, or \
                          make it lighter"
                    .to_owned(),
            });
        }
    }
    Ok(())
}

/// The velocity at which momentum and friction agree; `inertia` is over the step's length.
fn settle(pushes: &[Push], inertia: [f64; 3], before: [f64; 3]) -> [f64; 3] {
    let mut v = before;
    let mut cost = None;
    for _ in 0..STEPS {
        let (gradient, curvature) = derivatives(pushes, inertia, before, v);
        let step = solve(curvature, gradient);
        let mut part = 1.0;
        let mut next = along(v, step, part);
        if pushes.iter().all(|push| push.state(v) == push.state(next)) {
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
    v
}

fn along(v: [f64; 3], step: [f64; 3], part: f64) -> [f64; 3] {
    [
        v[0] - part * step[0],
        v[1] - part * step[1],
        v[2] - part * step[2],
    ]
}

impl Push {
    fn slip(&self, v: [f64; 3]) -> f64 {
        self.row[0] * v[0] + self.row[1] * v[1] + self.row[2] * v[2] - self.rest
    }

    /// What the body pushes the floor with, N.
    fn force(&self, v: [f64; 3]) -> f64 {
        (self.stiffness * self.slip(v)).clamp(-self.limit, self.limit)
    }

    /// -1 or 1 when friction is at its limit, else 0.
    fn state(&self, v: [f64; 3]) -> i8 {
        let force = self.stiffness * self.slip(v);
        i8::from(force > self.limit) - i8::from(force < -self.limit)
    }
}

/// What the right velocity makes least.
fn value(pushes: &[Push], inertia: [f64; 3], before: [f64; 3], v: [f64; 3]) -> f64 {
    let momentum: f64 = (0..3)
        .map(|k| 0.5 * inertia[k] * (v[k] - before[k]).powi(2))
        .sum();
    pushes.iter().fold(momentum, |sum, push| {
        let slip = push.slip(v).abs();
        let knee = push.limit / push.stiffness;
        sum + if slip <= knee {
            0.5 * push.stiffness * slip * slip
        } else {
            push.limit * (slip - 0.5 * knee)
        }
    })
}

/// Its first and second derivatives; of the second what is on and below the diagonal.
fn derivatives(
    pushes: &[Push],
    inertia: [f64; 3],
    before: [f64; 3],
    v: [f64; 3],
) -> ([f64; 3], [[f64; 3]; 3]) {
    let mut gradient: [f64; 3] = std::array::from_fn(|k| inertia[k] * (v[k] - before[k]));
    let mut curvature = [
        [inertia[0], 0.0, 0.0],
        [0.0, inertia[1], 0.0],
        [0.0, 0.0, inertia[2]],
    ];
    for push in pushes {
        let force = push.stiffness * push.slip(v);
        let row = push.row;
        let held = force.clamp(-push.limit, push.limit);
        for k in 0..3 {
            gradient[k] += row[k] * held;
        }
        if force.abs() <= push.limit {
            for k in 0..3 {
                let scaled = push.stiffness * row[k];
                for other in 0..=k {
                    curvature[k][other] += scaled * row[other];
                }
            }
        }
    }
    (gradient, curvature)
}

/// Solves a symmetric positive definite system by Cholesky's method, from what is on and below the
/// diagonal.
fn solve(a: [[f64; 3]; 3], b: [f64; 3]) -> [f64; 3] {
    let l00 = a[0][0].sqrt();
    let (l10, l20) = (a[1][0] / l00, a[2][0] / l00);
    let l11 = (a[1][1] - l10 * l10).sqrt();
    let l21 = (a[2][1] - l20 * l10) / l11;
    let l22 = (a[2][2] - l20 * l20 - l21 * l21).sqrt();
    let y0 = b[0] / l00;
    let y1 = (b[1] - l10 * y0) / l11;
    let y2 = (b[2] - l20 * y0 - l21 * y1) / l22;
    let x2 = y2 / l22;
    let x1 = (y1 - l21 * x2) / l11;
    [(y0 - l10 * x1 - l20 * x2) / l00, x1, x2]
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
        let push = Push {
            row: [1.0, 0.0, 0.0],
            rest: 1.0,
            lever: 0.0,
            limit: 3.0,
            stiffness: 90.0,
        };
        let v = settle(&[push], [10.0, 10.0, 1.0], [0.0; 3]);
        assert!((v[0] - 0.3).abs() < 1e-12, "{v:?}");
        let strong = Push { limit: 1e3, ..push };
        let v = settle(&[strong], [10.0, 10.0, 1.0], [0.0; 3]);
        assert!((v[0] - 0.9).abs() < 1e-12, "{v:?}");
    }
}
