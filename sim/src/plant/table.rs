//! The table plant: every robot loses on each axis what the paper measured at that speed.
//!
//! The wheels' motion asks for a twist (ideal rolling, least squares over the four wheels, no
//! compensation of any kind); each axis of it, in the robot's own frame, is multiplied by the ratio
//! of measured to asked speed that the table has for that speed. Connected robots then move as the
//! best fit of all, see [`super::formation`].
//!
//! What it cannot do: the ratio is per axis, so the oblique case of Table 4 (about 1.7 % on both
//! axes) comes out as 0.2 % and 3.2 %; there is no ripple, no acceleration, no friction limit, and
//! turning while translating loses as if each were alone. The contact plant is for that.

use group::{GroupFile, Tables};
use kinematics::{
    GeometryError, MemberKinematics, Mount, Pose, Twist, VelocityCompensation, Wheel, WheelRates,
};

use super::Plant;
use super::formation::{Formation, advance};
use super::tables::{IDEAL, Losses, PHYSICAL, VIRTUAL};
use crate::error::SimError;

const MM_PER_M: f64 = 1e3;

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct TablePlant {
    losses: Losses,
    rigid: bool,
    wheels: Vec<MemberKinematics<f64>>,
    formation: Formation,
    group: Pose<f64>,
    poses: Vec<Pose<f64>>,
    /// Where each robot's own wheels would have taken it.
    alone: Vec<Pose<f64>>,
    twists: Vec<Twist<f64>>,
}

impl TablePlant {
    /// The robots of a group with the group frame at `start`, and these losses.
    ///
    /// # Errors
    /// When a robot's geometry has no solution.
    pub fn new(group: &GroupFile, tables: Tables, start: Pose<f64>) -> Result<Self, SimError> {
        let members = members(group)?;
        let formation = Formation::new(&members);
        let poses: Vec<_> = formation.places(start).collect();
        Ok(Self {
            losses: match tables {
                Tables::Virtual => VIRTUAL,
                Tables::Physical => PHYSICAL,
                Tables::Ideal => IDEAL,
            },
            rigid: group.simulation.rigid,
            wheels: members
                .iter()
                .map(|(_, g)| rolling(g))
                .collect::<Result<_, _>>()?,
            formation,
            group: start,
            alone: poses.clone(),
            twists: vec![Twist::new(0.0, 0.0, 0.0); poses.len()],
            poses,
        })
    }

    /// What a robot does whose wheels ask for `asked` (robot frame).
    #[must_use]
    pub fn achieved(losses: &Losses, asked: Twist<f64>) -> Twist<f64> {
        Twist {
            vx: asked.vx * losses.longitudinal.ratio(asked.vx * MM_PER_M),
            vy: asked.vy * losses.lateral.ratio(asked.vy * MM_PER_M),
            omega: asked.omega * losses.yaw.ratio(asked.omega),
        }
    }
}

impl Plant for TablePlant {
    fn step(&mut self, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError> {
        for ((twist, wheels), turned) in self.twists.iter_mut().zip(&self.wheels).zip(turned) {
            let rates = WheelRates::from(turned.map(|angle| angle / dt));
            *twist = Self::achieved(&self.losses, wheels.forward(&rates));
        }
        for (pose, twist) in self.alone.iter_mut().zip(&self.twists) {
            *pose = advance(*pose, *twist, dt);
        }
        if self.rigid {
            self.group = advance(self.group, self.formation.fit(&self.twists), dt);
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

    fn try_clone(&self) -> Option<Box<dyn Plant>> {
        Some(Box::new(self.clone()))
    }
}

/// A robot's place in the group frame, and its wheels.
pub(crate) type Member = (Pose<f64>, [Wheel<f64>; 4]);

/// The members' places and wheels in double precision, with exactly the values that the robots are
/// given.
pub(crate) fn members(group: &GroupFile) -> Result<Vec<Member>, SimError> {
    let of = |robot: &group::Robot| {
        let place = Pose::new(
            f64::from(robot.mount.x),
            f64::from(robot.mount.y),
            f64::from(robot.mount.heading),
        );
        let wheels = wheels(robot).map_err(|error| SimError::geometry(robot.node, error))?;
        Ok((place, wheels))
    };
    group.robots.iter().map(of).collect()
}

fn wheels(robot: &group::Robot) -> Result<[Wheel<f64>; 4], GeometryError> {
    let wide = f64::from;
    let one = |wheel: group::Wheel| {
        let (x, y, radius) = (wide(wheel.x), wide(wheel.y), wide(wheel.radius));
        Wheel::new(x, y, 0.0, wide(wheel.roller_angle), radius)
    };
    let [a, b, c, d] = robot.each_wheel();
    Ok([one(a)?, one(b)?, one(c)?, one(d)?])
}

/// Wheel rates to robot twist without any compensation.
pub(crate) fn rolling(wheels: &[Wheel<f64>; 4]) -> Result<MemberKinematics<f64>, SimError> {
    let here = Mount::new(Pose::new(0.0, 0.0, 0.0)).map_err(SimError::wheels)?;
    let none = VelocityCompensation::new(1.0, 1.0, 1.0).map_err(SimError::wheels)?;
    MemberKinematics::from_wheels(wheels, &here, &none).map_err(SimError::wheels)
}
