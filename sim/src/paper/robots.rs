//! The paper's robots as group files.
//!
//! The virtual robot is `groups/single.toml`: its wheels, wheelbase and coefficients are the
//! paper's; motor, encoder and gains are assumptions there. The physical robot has the paper's 450
//! mm track and 400 mm wheelbase; its wheel radius is not given, [`PHYSICAL_RADIUS`] is an
//! assumption that no result depends on. Distances between robots are in figure 19 only: 1.2 m is
//! an assumption.

use group::{GroupFile, Plant, Tables};
use kinematics::{FourWheelGeometry, Pose, VelocityCompensation};

use super::OnPlant;
use crate::error::SimError;

/// Wheel radius of the physical robot, m.
pub const PHYSICAL_RADIUS: f32 = 0.0762;
/// Distance between neighbours, m.
pub const SPACING: f32 = 1.2;

const SINGLE: &str = include_str!("../../../groups/single.toml");
/// Crystal errors of the robots, ppm.
const CRYSTALS: [f64; 3] = [-30.0, 5.0, 40.0];

/// The virtual robot, at these places.
///
/// # Errors
/// When the file that comes with the program is damaged.
pub fn virtual_robots(
    name: &str,
    mounts: &[Pose],
    connected: bool,
    plant: OnPlant,
) -> Result<GroupFile, SimError> {
    let problem = |error: group::GroupError| SimError::Plant {
        problem: error.to_string(),
    };
    let mut file = GroupFile::parse("groups/single.toml", SINGLE).map_err(problem)?;
    name.clone_into(&mut file.name);
    let robot = file.robots.remove(0);
    file.robots = mounts
        .iter()
        .zip(group::FIRST_NODE..)
        .map(|(mount, node)| group::Robot {
            node,
            mount: *mount,
            ..robot.clone()
        })
        .collect();
    file.simulation.crystal_ppm = (0..mounts.len()).map(|n| CRYSTALS[n % 3]).collect();
    file.simulation.rigid = connected;
    file.simulation.plant = match plant {
        OnPlant::Table => Plant::Table(Tables::Virtual),
        OnPlant::Contact => Plant::Contact { rollers: 8 },
    };
    Ok(file)
}

/// One virtual robot.
///
/// # Errors
/// As [`virtual_robots`].
pub fn virtual_robot(plant: OnPlant) -> Result<GroupFile, SimError> {
    virtual_robots("virtual robot", &[Pose::new(0.0, 0.0, 0.0)], true, plant)
}

/// The physical robot. The contact plant knows nothing of what made it slip.
///
/// # Errors
/// As [`virtual_robots`].
pub fn physical_robot(plant: OnPlant) -> Result<GroupFile, SimError> {
    let mut file = virtual_robot(plant)?;
    "physical robot".clone_into(&mut file.name);
    if plant == OnPlant::Table {
        file.simulation.plant = Plant::Table(Tables::Physical);
    }
    for robot in &mut file.robots {
        let angle = robot.geometry.roller_angle();
        robot.geometry = FourWheelGeometry::new(0.225, 0.2, PHYSICAL_RADIUS, angle)
            .map_err(|error| SimError::geometry(robot.node, error))?;
    }
    Ok(file)
}

/// Gives all robots a compensation: longitudinal, lateral, yaw.
///
/// # Errors
/// When a coefficient is none.
pub fn compensate(
    file: &mut GroupFile,
    longitudinal: f32,
    lateral: f32,
    yaw: f32,
) -> Result<(), SimError> {
    for robot in &mut file.robots {
        robot.compensation = VelocityCompensation::new(longitudinal, lateral, yaw)
            .map_err(|error| SimError::geometry(robot.node, error))?;
    }
    Ok(())
}
