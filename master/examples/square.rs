//! Drives a simulated group along the sides of a square, from the library instead of the command.
//!
//! `cargo run -p omnibus --example square`

use group::GroupFile;
use kinematics::{Pose, Twist};
use omnibus::session::Group;
use omnibus::sim_link::SimLink;

fn main() -> anyhow::Result<()> {
    let file = GroupFile::load("groups/tcc-3.toml")?;
    let start = Pose::new(0.0, 0.0, 0.0);
    let world = omnibus::drive::world(&file, None, start)?;
    let mut group = Group::connect(SimLink::new(world, "sim"), &file)?;
    group.configure(true)?;
    group.start()?;
    for (vx, vy) in [(0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5)] {
        // One call is one SYNC period; 200 of them are two seconds.
        for _ in 0..200 {
            group.cycle(Twist::new(vx, vy, 0.0))?;
        }
    }
    group.ramp_down(3_000_000)?;
    for (robot, member) in file.robots.iter().zip(group.members()) {
        println!("node {}: {:?}", robot.node, member.status);
    }
    let truth = group.link().world.truth().group;
    println!("the group came to ({:.3}, {:.3}) m", truth.x, truth.y);
    Ok(())
}
