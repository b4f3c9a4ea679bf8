//! Plants: how turning wheels become moving robots.
//!
//! The world tells a plant at every plant step by how much each wheel's motor has turned; the plant
//! says where the robots are then. A plant knows floors and rollers; it knows no bus, no controller
//! and no compensation, and above all it does not know what was commanded.
//!
//! - [`table`]: the losses the paper measured, interpolated over speed.
//! - [`contact`]: rollers, friction, rigid bodies.
//! - [`external`]: another program, over TCP.
//! - [`formation`]: what connected robots do with motions that do not quite agree, and how far they
//!   disagree.

pub mod contact;
#[cfg(feature = "host")]
pub mod external;
pub mod formation;
pub mod table;
pub mod tables;

use group::{GroupFile, Plant as Kind};
use kinematics::Pose;

use crate::error::SimError;

/// Something that turns wheel angles into poses.
pub trait Plant: Send {
    /// Advances by `dt` (s), in which the motors turned the wheels by these angles (rad, order
    /// front left, front right, rear left, rear right; one row a robot).
    ///
    /// # Errors
    /// When the plant lives outside and is gone.
    fn step(&mut self, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError>;

    /// Advances by so many steps, in each of which the motors turned the wheels by these angles;
    /// the poses are those after the last.
    ///
    /// # Errors
    /// As [`Plant::step`].
    fn steps(&mut self, count: u32, dt: f64, turned: &[[f64; 4]]) -> Result<(), SimError> {
        (0..count).try_for_each(|_| self.step(dt, turned))
    }

    /// Poses of the robots in the world, m and rad, heading unwrapped.
    fn poses(&self) -> &[Pose<f64>];

    /// Pose of the group frame in the world: of the body when the robots are connected, of the
    /// formation that fits them best when they are not.
    fn group(&self) -> Pose<f64>;

    /// How far the robot farthest from its place in the group is now, mm. For connected robots: how
    /// far its wheels would have taken it, had it been alone.
    fn shape_error_mm(&self) -> f64;

    /// Angles of a robot's wheels, rad, if the plant turns them itself; `None` when they are where
    /// the motors turned them.
    fn wheel_angles(&self, robot: usize) -> Option<[f64; 4]> {
        let _ = robot;
        None
    }

    /// What turns with each wheel, kg m², if the floor's forces act on the motors; `None` when the
    /// motors' inertia contains the robot's.
    fn wheel_inertia(&self) -> Option<f64> {
        None
    }

    /// What the floor has done to a robot's wheels in the last step, N·m, positive rolls the base
    /// forward.
    fn floor_torques(&self, robot: usize) -> [f64; 4] {
        let _ = robot;
        [0.0; 4]
    }

    /// What a robot's motors do to its wheels now, N·m, for a plant that wants to know.
    fn drive(&mut self, robot: usize, torques: [f64; 4]) {
        let _ = (robot, torques);
    }

    /// The period it wants to be stepped with, ns.
    fn period_ns(&self) -> u64 {
        250_000
    }

    /// The same plant in the same state, which goes on by itself; `None` of one outside.
    fn try_clone(&self) -> Option<Box<dyn Plant>> {
        None
    }
}

/// The plant that a group file asks for, with the group frame at `start`.
///
/// # Errors
/// When it cannot be built from the group, or is not to be had.
pub fn build(group: &GroupFile, start: Pose<f64>) -> Result<Box<dyn Plant>, SimError> {
    match &group.simulation.plant {
        Kind::Table(tables) => Ok(Box::new(table::TablePlant::new(group, *tables, start)?)),
        #[cfg(feature = "host")]
        Kind::External { address } => Ok(Box::new(external::ExternalPlant::connect(
            group, address, start,
        )?)),
        #[cfg(not(feature = "host"))]
        Kind::External { .. } => Err(SimError::Plant {
            problem: "an external plant needs a network, and this build has none".to_owned(),
        }),
        Kind::Contact { rollers } => {
            let contact = contact::Contact::of(group, *rollers);
            Ok(Box::new(contact::ContactPlant::new(group, contact, start)?))
        }
    }
}
