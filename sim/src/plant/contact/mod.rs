//! The contact plant: rigid bodies on rollers with friction.
//!
//! # Contacts
//!
//! A Mecanum wheel touches the ground with a roller. The roller turns freely about its axle, so the
//! ground can only push along the axle's horizontal projection, and with no more than dry friction
//! allows. While the wheel turns by `phi` away from a roller's lowest position, the axle tilts: its
//! projection is `(sin g cos phi)` along the wheel and `(cos g)` along the wheel's axle, `g` the
//! roller angle; the point of contact wanders along the wheel's axle by `(r - r_roller) tan phi cot
//! g`. With `n` rollers `phi` runs from `-pi/n` to `pi/n` again and again: that alone is why
//! strafing loses `1 - sin(pi/n)/(pi/n)` and ripples. A wheel that settles under its load stands on
//! two rollers while one takes over from the other ([`footprint`]).
//!
//! # Bodies
//!
//! All robots of a rigid group are one body with `4 m` wheels, all with their own roller phase;
//! free robots are bodies of their own. In every step the friction of all wheels of a body is found
//! together ([`body`]): below its limit rubber creeps, a contact slips in proportion to its force.
//! Rollers resist their own turning in proportion to it, and have inertia: one that comes down
//! hardly turns, and what brings it up to speed is a jolt ([`roller`]). A payload shifts the centre
//! of mass and loads the wheels as equal springs would share it; parts of the floor may have a
//! friction of their own.
//!
//! # Motors
//!
//! The motors are velocity sources here: their inertia already contains the robot's. With a
//! `wheel_inertia` they are not: each wheel then turns under its motor and the floor, so that one
//! that runs away pushes the body and, through it, all other wheels. Motors and floor alternate: a
//! motor turns for a step under the floor's force of the previous step, and that force is computed
//! with the wheel's compliance over a step, `1 / (1 / k + r^2 dt / J)` in place of a contact's
//! stiffness `k`, which prevents chatter between the two for every `k`.
//!
//! # Limits
//!
//! It does not model wheel load transfer under acceleration, unequal springs in the suspension,
//! springs in the coupling, or one limit of friction for both directions together.

mod body;
mod footprint;
mod roller;
mod wheel;

use std::f64::consts::{PI, TAU};

use group::GroupFile;
use kinematics::{Pose, Wheel};

use super::Plant;
use super::formation::Formation;
use super::table::members;
use crate::error::SimError;
use crate::four::Four;
use crate::random::Random;
use body::Body;
use wheel::{Stand, Underside};

const GRAVITY: f64 = 9.81;
/// Bodies that take each part of a step together. Within a body one part waits for the other, but
/// the processor computes several bodies at the same time; what more of them leave behind in one
/// part would no longer be in its cache in the next.
const AT_ONCE: usize = 8;

/// A robot as part of a body.
#[derive(Debug, Clone, Copy)]
struct Part {
    /// Place in the group file.
    robot: usize,
    /// Pose in the frame of the body.
    place: Pose<f64>,
    wheels: [Wheel<f64>; 4],
    /// Roller phases at wheel angle 0, rad.
    phases: [f64; 4],
}

/// Sizes and materials that the group file does not hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Rollers of a wheel, three or more.
    pub rollers: u8,
    /// Radius of a roller at its middle over the wheel's.
    pub roller_ratio: f64,
    /// Density of a roller as if it were solid, kg/m^3. 0 is rollers without inertia.
    pub roller_density: f64,
    /// Dry friction between roller and floor, a ratio of forces.
    pub friction: f64,
    /// Resistance to a roller's own turning: force at the floor over the wheel's load, per m/s at
    /// which the roller rolls, s/m.
    pub roller_damping: f64,
    /// Slip velocity at which friction is fully developed, m/s; below, it grows in proportion, as
    /// rubber creeps. 0 is ideal dry friction.
    pub creep: f64,
    /// By which fraction of the radius a loaded wheel settles, and so over which angle it touches
    /// the floor.
    pub settling: f64,
    /// Mass of a robot, kg, spread evenly over the rectangle of its wheels.
    pub mass: f64,
    /// What turns with a wheel, kg m^2, where the floor's forces act on the motors.
    pub wheel_inertia: Option<f64>,
    /// Each wheel begins at a roller phase of its own, from the seed; else all begin on a roller.
    pub scattered: bool,
}

impl Default for Contact {
    /// The paper's virtual robot: 8 rollers with a radius of 33.5 mm, friction 0.35, 200 kg
    /// (section 3.1). The settling is Table 3's longitudinal loss; creep and roller damping are
    /// chosen so that every row of Tables 3 to 6 is met within half a point. Rollers are as hard to
    /// turn as solid ones of 2800 kg/m^3: steel (7850) to seven tenths of the radius and rubber
    /// (1200) around, for inertia goes with the fourth power of the radius.
    fn default() -> Self {
        Self {
            rollers: 8,
            roller_ratio: 0.0335 / 0.1524,
            roller_density: 2800.0,
            friction: 0.35,
            roller_damping: 0.013,
            creep: 0.016,
            settling: 0.0022,
            mass: 200.0,
            wheel_inertia: None,
            scattered: false,
        }
    }
}

impl Contact {
    /// The default with what a group file says.
    #[must_use]
    pub fn of(group: &GroupFile, rollers: u8) -> Self {
        let given = &group.simulation.contact;
        let default = Self::default();
        Self {
            rollers,
            friction: given.friction.unwrap_or(default.friction),
            mass: given.robot_mass.unwrap_or(default.mass),
            wheel_inertia: given.wheel_inertia,
            scattered: given.scattered,
            ..default
        }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct ContactPlant {
    formation: Formation,
    wheel_inertia: Option<f64>,
    /// Of every robot, and how it stood in the last step.
    undersides: Vec<Underside>,
    stands: Vec<Stand>,
    /// When the robots are connected, first the load with all of them; then every robot for itself:
    /// what it does when free, and what its wheels would do when not.
    bodies: Vec<Body>,
    rigid: bool,
    angles: Vec<[f64; 4]>,
    group: Pose<f64>,
    poses: Vec<Pose<f64>>,
    alone: Vec<Pose<f64>>,
}

impl ContactPlant {
    /// The robots of a group with the group frame at `start`, on these contacts. Payload and floor
    /// are the group file's.
    ///
    /// # Errors
    /// When a robot's geometry has no solution, or the payload lifts a wheel off the floor.
    pub fn new(group: &GroupFile, contact: Contact, start: Pose<f64>) -> Result<Self, SimError> {
        let members = members(group)?;
        let formation = Formation::new(&members);
        let poses: Vec<_> = formation.places(start).collect();
        let phases = phases(group, &contact);
        let parts =
            members
                .iter()
                .zip(phases)
                .enumerate()
                .map(|(robot, ((place, wheels), phases))| Part {
                    robot,
                    place: *place,
                    wheels: *wheels,
                    phases,
                });
        let parts: Vec<Part> = parts.collect();
        let floor = &group.simulation.contact.floor;
        let here = Pose::new(0.0, 0.0, 0.0);
        let single = parts.iter().zip(&poses).map(|(part, pose)| {
            Body::new(
                &contact,
                &[Part {
                    place: here,
                    ..*part
                }],
                None,
                floor,
                *pose,
            )
        });
        let payload = group.simulation.contact.payload;
        let joined = group
            .simulation
            .rigid
            .then(|| Body::new(&contact, &parts, payload, floor, start));
        let undersides = parts.iter().map(|part| Underside::new(&contact, part));
        let undersides: Vec<_> = undersides.collect();
        let stands = undersides.iter().map(|robot| robot.stand(Four::ZERO));
        Ok(Self {
            stands: stands.collect(),
            undersides,
            wheel_inertia: contact.wheel_inertia,
            rigid: joined.is_some(),
            bodies: joined.into_iter().chain(single).collect::<Result<_, _>>()?,
            formation,
            angles: vec![[0.0; 4]; poses.len()],
            group: start,
            alone: poses.clone(),
            poses,
        })
    }

    /// Velocity of the body that carries a robot, at its centre of mass: world frame, m/s, m/s,
    /// rad/s.
    #[must_use]
    pub fn velocity(&self, robot: usize) -> Option<[f64; 3]> {
        self.body(robot).map(Body::velocity)
    }

    /// Pushes the body that carries a robot to a velocity, as [`velocity`](Self::velocity) gives
    /// it.
    pub fn set_velocity(&mut self, robot: usize, velocity: [f64; 3]) {
        let place = self.place_of_body(robot);
        if let Some(body) = self.bodies.get_mut(place) {
            body.set_velocity(velocity);
        }
    }
}

impl ContactPlant {
    /// Which body carries a robot.
    fn place_of_body(&self, robot: usize) -> usize {
        if self.rigid { 0 } else { robot }
    }

    fn body(&self, robot: usize) -> Option<&Body> {
        self.bodies.get(self.place_of_body(robot))
    }

    /// Lets the wheels turn and the bodies move, with vectors of four where the processor has them.
    /// The results are the same with and without: every operation is IEEE 754's.
    fn turn(&mut self, dt: f64, turned: &[[f64; 4]]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            #[target_feature(enable = "avx2")]
            fn turn_avx2(plant: &mut ContactPlant, dt: f64, turned: &[[f64; 4]]) {
                plant.turn_wheels(dt, turned);
            }
            #[expect(unsafe_code, reason = "the processor was asked for the feature")]
            // SAFETY: the only requirement is that the processor has AVX2, as asked above.
            unsafe {
                turn_avx2(self, dt, turned);
            }
            return;
        }
        self.turn_wheels(dt, turned);
    }

    #[inline(always)]
    fn turn_wheels(&mut self, dt: f64, turned: &[[f64; 4]]) {
        let robots = self.undersides.iter().zip(&mut self.stands);
        for ((underside, stand), (angles, turned)) in robots.zip(self.angles.iter_mut().zip(turned))
        {
            let (before, turned) = (Four(*angles), Four(*turned));
            *angles = (before + turned).0;
            *stand = underside.stand(before + turned * 0.5);
        }
        for bodies in self.bodies.chunks_mut(AT_ONCE) {
            for body in &mut *bodies {
                body.begin(dt, &self.stands, turned);
            }
            for body in &mut *bodies {
                body.approach();
            }
            for body in &mut *bodies {
                body.finish(dt, &self.stands);
            }
        }
    }
}

impl Plant for ContactPlant {
    fn step(&mut self, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError> {
        self.steps(1, dt, turned)
    }

    fn steps(&mut self, count: u32, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError> {
        for _ in 0..count {
            self.turn(dt, turned);
        }
        let (load, single) = self.bodies.split_at(usize::from(self.rigid));
        for (pose, body) in self.alone.iter_mut().zip(single) {
            *pose = body.pose();
        }
        if let [load] = load {
            self.group = load.frame();
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

    fn wheel_inertia(&self) -> Option<f64> {
        self.wheel_inertia
    }

    fn try_clone(&self) -> Option<Box<dyn Plant>> {
        Some(Box::new(self.clone()))
    }

    fn floor_torques(&self, robot: usize) -> [f64; 4] {
        self.body(robot)
            .map_or([0.0; 4], |body| body.floor_torques(robot))
    }

    fn shape_error_mm(&self) -> f64 {
        self.formation.shape_error_mm(self.group, &self.alone)
    }
}

/// How far each wheel has rolled on past a roller's middle at the beginning, one row a robot, rad.
#[must_use]
pub fn phases(group: &GroupFile, contact: &Contact) -> Vec<[f64; 4]> {
    let mut random = Random::new(group.simulation.seed);
    let pitch = TAU / f64::from(contact.rollers);
    let mut phase = || {
        if contact.scattered {
            pitch * random.unit()
        } else {
            0.0
        }
    };
    let robots = group.robots.iter();
    robots.map(|_| std::array::from_fn(|_| phase())).collect()
}

/// Mean lateral velocity over what the wheels ask for, all wheels in one phase: `sin(pi/n) /
/// (pi/n)`.
#[must_use]
pub fn mean_lateral_ratio(rollers: u8) -> f64 {
    let half = PI / f64::from(rollers);
    libm::sin(half) / half
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Robots at different places on different rollers, with and without vector instructions; on a
    /// processor that has none this compares nothing.
    #[test]
    fn vectors_change_no_bit() {
        let mut group = GroupFile::load("../groups/tcc-3.toml").unwrap();
        group.simulation.contact.scattered = true;
        let contact = Contact::of(&group, 8);
        let start = Pose::new(0.3, -0.2, 0.1);
        let mut plant = ContactPlant::new(&group, contact, start).unwrap();
        let mut plain = ContactPlant::new(&group, contact, start).unwrap();
        let turned = [[0.004, 0.005, 0.006, 0.0055]; 3];
        for _ in 0..2_000 {
            plant.turn(1e-3, &turned);
            plain.turn_wheels(1e-3, &turned);
        }
        for (body, plain) in plant.bodies.iter().zip(&plain.bodies) {
            let bits = |body: &Body| body.velocity().map(f64::to_bits);
            assert_eq!(bits(body), bits(plain));
            assert!(body.velocity()[0].abs() > 0.1, "{:?}", body.velocity());
        }
    }
}
