//! Drives a simulated group along the sides of a square, from the library instead of the command.
//!
//! `cargo run -p omnibus-master --example square`

use group::GroupFile;
use kinematics::Twist;
use omnibus::monitor::telemetry::Telemetry;

fn main() -> anyhow::Result<()> {
    let config = GroupFile::load("groups/tcc-3.toml")?;
    let bus = omnibus::bus::address::open(&"sim:groups/tcc-3.toml".parse()?, &config)?;
    let mut group = omnibus::Group::connect(bus, &config)?;
    let telemetry = group.telemetry();
    group.start()?;
    for (vx, vy) in [(0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5)] {
        group.set_twist(Twist::new(vx, vy, 0.0))?;
        group.run(2.0)?;
    }
    group.stop()?;
    drop(group);
    for item in telemetry {
        if let Telemetry::Snapshot(now) = item
            && let Some(pose) = now.pose
            && now.sequence.is_multiple_of(50)
        {
            println!("{:5.2} s  x {:.3} m  y {:.3} m", now.t, pose.x, pose.y);
        }
    }
    Ok(())
}
