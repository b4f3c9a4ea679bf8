//! The contact plant: rigid bodies on rollers with friction.
//!
//! A Mecanum wheel touches the ground with one roller at a time. The roller turns freely about its
//! axle, so the ground can only push along the axle's horizontal projection, and with no more than dry
//! friction allows. While the wheel turns by `phi` away from a roller's lowest position, the axle tilts:
//! its projection is `(sin g cos phi)` along the wheel and `(cos g)` along the wheel's axle, `g` the
//! roller angle; the point of contact wanders along the wheel's axle by `(r - r_roller) tan phi cot g`.
//! With `n` rollers `phi` runs from `-pi/n` to `pi/n` again and again: that alone is why strafing loses
//! `1 - sin(pi/n)/(pi/n)` and ripples.
//!
//! All robots of a rigid group are one body with `4 m` wheels, all with their own roller phase; free
//! robots are bodies of their own. In every step the friction impulses of all wheels of a body are
//! found together (projected Gauss-Seidel: each brings its contact to rest, or is at its limit). Below
//! that limit rubber creeps: a contact slips in proportion to its force.
//!
//! The motors are velocity sources here: their inertia already contains the robot's. What it cannot do:
//! wheel load transfer under acceleration, and springs in the suspension or the coupling.

use std::f64::consts::{PI, TAU};

use group::GroupFile;
use kinematics::{FourWheelGeometry, Pose};

use super::Plant;
use super::formation::Formation;
use super::table::members;
use crate::error::SimError;
use crate::random::Random;

const GRAVITY: f64 = 9.81;
/// Most sweeps over the contacts of a body in one step, and the change of velocity (m/s) below which
/// they have settled.
const SWEEPS: usize = 100;
const SETTLED: f64 = 1e-10;
/// Softens what wheels that contradict each other would fight about, 1/kg.
const SOFTNESS: f64 = 1e-6;

/// Sizes and materials that the group file does not hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Rollers of a wheel.
    pub rollers: u8,
    /// Radius of a roller at its middle, m.
    pub roller_radius: f64,
    /// Dry friction between roller and floor.
    pub friction: f64,
    /// Friction against a roller's own turning, as a friction coefficient at the floor.
    pub roller_friction: f64,
    /// Slip velocity at which friction is fully developed, m/s; below, it grows in proportion, as rubber
    /// creeps. 0 is ideal dry friction.
    pub creep: f64,
    /// By which part of the radius a loaded wheel settles.
    pub settling: f64,
    /// Mass of a robot, kg, spread evenly over the rectangle of its wheels.
    pub mass: f64,
    /// Each wheel begins at a roller phase of its own, from the seed; else all begin on a roller.
    pub scattered: bool,
}

impl Default for Contact {
    /// The paper's virtual robot: 8 rollers with a radius of 33.5 mm and friction 0.35 (section 3.1).
    /// The settling is Table 3's longitudinal loss; creep and roller friction are chosen so that every
    /// row of Tables 3 and 5 is met within half a point; the mass is an assumption.
    fn default() -> Self {
        Self {
            rollers: 8,
            roller_radius: 0.0335,
            friction: 0.35,
            roller_friction: 0.006,
            creep: 0.02,
            settling: 0.0022,
            mass: 60.0,
            scattered: false,
        }
    }
}

/// A wheel as a contact of a body.
#[derive(Debug, Clone)]
struct Wheel {
    robot: usize,
    index: usize,
    /// Hub in the body's frame, from its centre of mass, m.
    x: f64,
    y: f64,
    /// Direction of the robot in the body's frame.
    heading: f64,
    /// +1 on the diagonal front left to rear right, -1 on the other.
    hand: f64,
    sin_roller: f64,
    cos_roller: f64,
    /// Rolling radius, settled, m.
    radius: f64,
    /// Height of the roller's axle above the ground below the hub, from the hub, m.
    axle_drop: f64,
    /// Roller phase at wheel angle 0, rad.
    phase: f64,
    /// Largest friction force along the roller's axle, and across it, N.
    grip: f64,
    drag: f64,
    /// Slip velocity at which they are reached, m/s.
    creep: f64,
}

/// One direction in which the ground pushes a body through a wheel.
#[derive(Debug, Clone, Copy)]
struct Push {
    /// Direction in the world, and moment arm about the centre of mass.
    row: [f64; 3],
    /// Velocity along it at which the contact would rest, m/s.
    rest: f64,
    /// Largest impulse, N·s.
    limit: f64,
    impulse: f64,
    /// Slip velocity an impulse leaves, 1/kg.
    creep: f64,
}

/// Robots that move as one.
#[derive(Debug, Clone)]
struct Body {
    wheels: Vec<Wheel>,
    mass: f64,
    inertia: f64,
    /// Centre of mass and heading in the world.
    pose: Pose<f64>,
    velocity: [f64; 3],
    pushes: Vec<Push>,
    /// The centre of mass in the frame the members' places are given in.
    centre: (f64, f64),
}

/// See the [module](self).
#[derive(Debug)]
pub struct ContactPlant {
    contact: Contact,
    formation: Formation,
    /// The load with all robots, when they are connected.
    joined: Option<Body>,
    /// Every robot for itself: what it does when free, and what its wheels would do when not.
    single: Vec<Body>,
    angles: Vec<[f64; 4]>,
    group: Pose<f64>,
    poses: Vec<Pose<f64>>,
    alone: Vec<Pose<f64>>,
}

impl ContactPlant {
    /// The robots of a group with the group frame at `start`, on these contacts.
    ///
    /// # Errors
    /// When a robot's geometry has no solution.
    pub fn new(group: &GroupFile, contact: Contact, start: Pose<f64>) -> Result<Self, SimError> {
        let members = members(group)?;
        let formation = Formation::new(&members);
        let poses: Vec<_> = formation.places(start).collect();
        let mut random = Random::new(group.simulation.seed);
        let pitch = TAU / f64::from(contact.rollers);
        let phases: Vec<[f64; 4]> = members
            .iter()
            .map(|_| {
                std::array::from_fn(|_| {
                    if contact.scattered {
                        pitch * random.unit()
                    } else {
                        0.0
                    }
                })
            })
            .collect();
        let here = Pose::new(0.0, 0.0, 0.0);
        let single = members
            .iter()
            .zip(&poses)
            .enumerate()
            .map(|(n, ((_, geometry), pose))| {
                Body::new(&contact, &[(n, here, *geometry, phases[n])], *pose)
            });
        let parts = members
            .iter()
            .enumerate()
            .map(|(n, (place, g))| (n, *place, *g, phases[n]));
        let joined = group
            .simulation
            .rigid
            .then(|| Body::new(&contact, &parts.collect::<Vec<_>>(), start));
        Ok(Self {
            contact,
            single: single.collect(),
            joined,
            formation,
            angles: vec![[0.0; 4]; poses.len()],
            group: start,
            alone: poses.clone(),
            poses,
        })
    }

    /// Velocity of the body that carries a robot, at its centre of mass: world frame, m/s, m/s, rad/s.
    #[must_use]
    pub fn velocity(&self, robot: usize) -> Option<[f64; 3]> {
        self.joined
            .as_ref()
            .or(self.single.get(robot))
            .map(|body| body.velocity)
    }

    /// Pushes the body that carries a robot to a velocity, as [`velocity`](Self::velocity) gives it.
    pub fn set_velocity(&mut self, robot: usize, velocity: [f64; 3]) {
        if let Some(body) = self.joined.as_mut().or(self.single.get_mut(robot)) {
            body.velocity = velocity;
        }
    }
}

impl Plant for ContactPlant {
    fn step(&mut self, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError> {
        let pitch = TAU / f64::from(self.contact.rollers);
        for body in self.joined.iter_mut().chain(&mut self.single) {
            body.step(dt, pitch, &self.angles, turned);
        }
        for (angles, turned) in self.angles.iter_mut().zip(turned) {
            for (angle, turned) in angles.iter_mut().zip(turned) {
                *angle += turned;
            }
        }
        for (pose, body) in self.alone.iter_mut().zip(&self.single) {
            *pose = body.frame();
        }
        if let Some(body) = &self.joined {
            self.group = body.frame();
            for (pose, place) in self.poses.iter_mut().zip(self.formation.places(self.group)) {
                *pose = place;
            }
        } else {
            self.poses.copy_from_slice(&self.alone);
            self.group = self.formation.fit_poses(&self.poses);
        }
        Ok(())
    }

    fn poses(&self) -> &[Pose<f64>] {
        &self.poses
    }

    fn group(&self) -> Pose<f64> {
        self.group
    }

    fn shape_error_mm(&self) -> f64 {
        self.formation.shape_error_mm(self.group, &self.alone)
    }
}

type Part = (usize, Pose<f64>, FourWheelGeometry<f64>, [f64; 4]);

impl Body {
    /// Robots at these places in a frame that stands at `frame` in the world.
    fn new(contact: &Contact, parts: &[Part], frame: Pose<f64>) -> Self {
        let count = parts.len().max(1) as f64;
        let sum = parts
            .iter()
            .fold((0.0, 0.0), |(x, y), (_, p, ..)| (x + p.x, y + p.y));
        let centre = (sum.0 / count, sum.1 / count);
        let load = contact.mass * GRAVITY / 4.0;
        let mut wheels = Vec::with_capacity(4 * parts.len());
        let mut inertia = 0.0;
        for (robot, place, geometry, phases) in parts {
            let (w, h) = (geometry.half_track(), geometry.half_wheelbase());
            let (px, py) = (place.x - centre.0, place.y - centre.1);
            // An even rectangle of 2 w by 2 h about its middle, and that middle about the centre.
            inertia += contact.mass * ((w * w + h * h) / 3.0 + px * px + py * py);
            let (sin, cos) = place.heading.sin_cos();
            for (index, (x, y, hand)) in [(h, w, 1.0), (h, -w, -1.0), (-h, w, -1.0), (-h, -w, 1.0)]
                .into_iter()
                .enumerate()
            {
                let r = geometry.wheel_radius();
                wheels.push(Wheel {
                    robot: *robot,
                    index,
                    x: px + cos * x - sin * y,
                    y: py + sin * x + cos * y,
                    heading: place.heading,
                    hand,
                    sin_roller: geometry.roller_angle().sin(),
                    cos_roller: geometry.roller_angle().cos(),
                    radius: r * (1.0 - contact.settling),
                    axle_drop: (r - contact.roller_radius).max(0.0),
                    phase: phases[index],
                    grip: contact.friction * load,
                    drag: contact.roller_friction * load,
                    creep: contact.creep,
                });
            }
        }
        Self {
            wheels,
            mass: contact.mass * count,
            inertia,
            pose: frame.compose(Pose::new(centre.0, centre.1, 0.0)),
            velocity: [0.0; 3],
            pushes: Vec::new(),
            centre,
        }
    }

    /// Pose of the frame that the members' places are given in.
    fn frame(&self) -> Pose<f64> {
        self.pose
            .compose(Pose::new(-self.centre.0, -self.centre.1, 0.0))
    }

    fn step(&mut self, dt: f64, pitch: f64, angles: &[[f64; 4]], turned: &[[f64; 4]]) {
        let middle = self.pose.heading + 0.5 * dt * self.velocity[2];
        self.pushes.clear();
        for wheel in &self.wheels {
            let moved = turned[wheel.robot][wheel.index];
            let angle = angles[wheel.robot][wheel.index] + 0.5 * moved;
            self.pushes
                .extend(wheel.pushes(middle, angle, moved / dt, dt, pitch));
        }
        let weights = [1.0 / self.mass, 1.0 / self.mass, 1.0 / self.inertia];
        for _ in 0..SWEEPS {
            let mut largest: f64 = 0.0;
            for push in &mut self.pushes {
                let slip = dot(push.row, self.velocity) - push.rest;
                let give = push
                    .row
                    .iter()
                    .zip(weights)
                    .map(|(r, w)| r * r * w)
                    .sum::<f64>()
                    + push.creep;
                let wanted = push.impulse - (slip + push.creep * push.impulse) / give;
                let impulse = wanted.clamp(-push.limit, push.limit);
                let change = impulse - push.impulse;
                push.impulse = impulse;
                largest = largest.max(change.abs());
                for ((v, r), w) in self.velocity.iter_mut().zip(push.row).zip(weights) {
                    *v += r * w * change;
                }
            }
            if largest < SETTLED * self.mass {
                break;
            }
        }
        self.pose.x += dt * self.velocity[0];
        self.pose.y += dt * self.velocity[1];
        self.pose.heading += dt * self.velocity[2];
    }
}

impl Wheel {
    /// What the ground can do to a wheel at this angle that turns at `rate`: push along the roller's
    /// axle, and a little across it.
    fn pushes(&self, body_heading: f64, angle: f64, rate: f64, dt: f64, pitch: f64) -> [Push; 2] {
        let phi = (angle + self.phase + 0.5 * pitch).rem_euclid(pitch) - 0.5 * pitch;
        // The roller's axle over the ground, in the robot's frame: ahead, left.
        let (ahead, left) = (self.sin_roller * phi.cos(), -self.hand * self.cos_roller);
        let length = ahead.hypot(left);
        let (ahead, left) = (ahead / length, left / length);
        let wander = -self.hand * self.axle_drop * phi.tan() * self.cos_roller / self.sin_roller;
        let robot = self.heading.sin_cos();
        let (x, y) = (self.x - robot.0 * wander, self.y + robot.1 * wander);
        let body = body_heading.sin_cos();
        let arm = (body.1 * x - body.0 * y, body.0 * x + body.1 * y);
        let (sin, cos) = (body_heading + self.heading).sin_cos();
        let push = |ahead: f64, left: f64, force: f64| {
            let (dx, dy) = (cos * ahead - sin * left, sin * ahead + cos * left);
            Push {
                row: [dx, dy, arm.0 * dy - arm.1 * dx],
                rest: rate * self.radius * ahead,
                limit: force * dt,
                impulse: 0.0,
                creep: SOFTNESS
                    + if force > 0.0 {
                        self.creep / (force * dt)
                    } else {
                        0.0
                    },
            }
        };
        [push(ahead, left, self.grip), push(-left, ahead, self.drag)]
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Mean lateral velocity over what the wheels ask for, all wheels in one phase: `sin(pi/n) / (pi/n)`.
#[must_use]
pub fn mean_lateral_ratio(rollers: u8) -> f64 {
    let half = PI / f64::from(rollers);
    half.sin() / half
}
