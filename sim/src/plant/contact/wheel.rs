//! One wheel as a contact of a body: where the floor can push it, and how hard.

use kinematics::FourWheelGeometry;

use super::footprint::{Foot, Footprint};
use super::roller::Rollers;
use super::{Contact, Part};

/// A wheel. Directions and places are in the body's frame, from its centre of mass.
#[derive(Debug, Clone)]
pub(super) struct Wheel {
    pub robot: usize,
    pub index: usize,
    /// Hub, m.
    pub x: f64,
    pub y: f64,
    /// Direction of the robot: sine and cosine.
    sin: f64,
    cos: f64,
    /// +1 on the diagonal front left to rear right, -1 on the other.
    hand: f64,
    sin_roller: f64,
    cos_roller: f64,
    /// Rolling radius, settled, m.
    radius: f64,
    /// By how much the contact wanders along the wheel's axle, over the tangent of the roller's
    /// tilt, m.
    wander: f64,
    /// Slip velocity at which friction is fully developed, m/s.
    creep: f64,
    /// Force across the roller's axle over load and velocity, s/m.
    damping: f64,
    /// What it carries, N.
    pub load: f64,
    footprint: Footprint,
    feet: (Foot, Option<Foot>),
    rollers: Rollers,
    /// What turns with it, kg m^2, if its rate is not its motor's alone.
    inertia: Option<f64>,
    /// What the floor did to it in the last step, N·m.
    pub floor_torque: f64,
}

/// One direction in which the floor pushes a body through a wheel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Push {
    /// Direction, and moment arm about the centre of mass.
    pub row: [f64; 3],
    /// Velocity along it at which the contact would rest, m/s.
    pub rest: f64,
    /// Over what lever the force turns the wheel, m.
    pub lever: f64,
    /// Largest force, N.
    pub limit: f64,
    /// Force over slip velocity below the limit, N s/m.
    pub stiffness: f64,
}

/// Stiffest contact, N s/m: what wheels that contradict each other fight about is shared by it.
const STIFFEST: f64 = 4e9;

/// Wheels of a robot: ahead, left, hand.
const CORNERS: [(f64, f64, f64); 4] = [
    (1.0, 1.0, 1.0),
    (1.0, -1.0, -1.0),
    (-1.0, 1.0, -1.0),
    (-1.0, -1.0, 1.0),
];

impl Wheel {
    /// The wheels of a robot whose centre is at (`x`, `y`) from the body's centre of mass; no load
    /// yet.
    pub fn of(contact: &Contact, part: &Part, (x, y): (f64, f64)) -> [Self; 4] {
        let geometry: &FourWheelGeometry<f64> = &part.geometry;
        let (sin, cos) = libm::sincos(part.place.heading);
        let r = geometry.wheel_radius();
        let (sin_roller, cos_roller) = libm::sincos(geometry.roller_angle());
        std::array::from_fn(|index| {
            let footprint = Footprint::new(contact.rollers, part.phases[index], contact.settling);
            let (ahead, left, hand) = CORNERS[index];
            let (ahead, left) = (
                ahead * geometry.half_wheelbase(),
                left * geometry.half_track(),
            );
            Self {
                robot: part.robot,
                index,
                x: x + cos * ahead - sin * left,
                y: y + sin * ahead + cos * left,
                sin,
                cos,
                hand,
                sin_roller,
                cos_roller,
                radius: r * (1.0 - contact.settling),
                wander: -hand * r * (1.0 - contact.roller_ratio) * cos_roller / sin_roller,
                creep: contact.creep,
                damping: contact.roller_damping,
                load: 0.0,
                feet: footprint.feet(0.0),
                footprint,
                rollers: Rollers::new(contact, geometry),
                inertia: contact.wheel_inertia,
                floor_torque: 0.0,
            }
        })
    }

    /// Puts the wheel at this angle, turning at `rate`, and adds to `pushes` what the floor can do
    /// to it in the next `dt`: along the axle of a roller that carries it and across, and the same
    /// again where two do.
    pub fn stand(
        &mut self,
        angle: f64,
        rate: f64,
        friction: f64,
        dt: f64,
        pushes: &mut Vec<[Push; 2]>,
    ) {
        let (first, other) = self.footprint.feet(angle);
        let down = (first.roller, other.map(|foot| foot.roller));
        self.rollers.stand_on(down, self.damping * self.load);
        pushes.push(self.pushes(&first, rate, friction, dt));
        if let Some(other) = &other {
            pushes.push(self.pushes(other, rate, friction, dt));
        }
        self.feet = (first, other);
    }

    fn pushes(&self, foot: &Foot, rate: f64, friction: f64, dt: f64) -> [Push; 2] {
        // The roller's axle over the floor, in the robot's frame: ahead, left.
        let (ahead, left) = (self.sin_roller * foot.tilt, -self.hand * self.cos_roller);
        let shorter = 1.0 / (ahead * ahead + left * left).sqrt();
        let (ahead, left) = (ahead * shorter, left * shorter);
        let wander = self.wander * foot.tan;
        let (x, y) = (self.x - self.sin * wander, self.y + self.cos * wander);
        let limit = friction * self.load * foot.share;
        let push = |ahead: f64, left: f64, rest: f64, stiffness: f64| {
            let dx = self.cos * ahead - self.sin * left;
            let dy = self.sin * ahead + self.cos * left;
            let lever = self.radius * ahead;
            // By what the wheel gives way to a newton in this step, as far as it stands on this
            // foot.
            let gives = self
                .inertia
                .map_or(0.0, |inertia| lever * lever * dt / (inertia * foot.share));
            Push {
                row: [dx, dy, x * dy - y * dx],
                rest: rate * lever + rest,
                lever,
                limit,
                stiffness: stiffness / (1.0 + stiffness * gives),
            }
        };
        let grip = (limit / self.creep).min(STIFFEST);
        let drag = self.damping * self.load;
        let (rest, resistance) = self.rollers.resistance(foot, grip, drag, dt);
        [
            push(ahead, left, 0.0, grip),
            push(-left, ahead, rest, resistance),
        ]
    }

    /// Rollers that carry it.
    pub fn feet_down(&self) -> usize {
        1 + usize::from(self.feet.1.is_some())
    }

    /// Turns the rollers on the floor for `dt`, each by what the floor did across its axle, N.
    pub fn turn_rollers(&mut self, forces: impl Iterator<Item = f64>, dt: f64) {
        let drag = self.damping * self.load;
        let (first, other) = &self.feet;
        for (foot, force) in std::iter::once(first).chain(other).zip(forces) {
            self.rollers.turn(foot, force, drag, dt);
        }
        self.rollers.pass(dt);
    }
}
