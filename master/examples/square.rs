//! Drives a simulated group along the sides of a square, from the library instead of the command.
//! Ctrl-C ramps it down.
//!
//! `cargo run -p omnibus-master --example square`. A program of your own needs the dependency
//! `omnibus = { package = "omnibus-master", ... }`, and `ctrlc` for its Ctrl-C.

use omnibus::Group;
use omnibus::error::MasterError;
use omnibus::group::GroupFile;
use omnibus::kinematics::Twist;
use omnibus::monitor::telemetry::Telemetry;

/// Velocities of the four sides, m/s, and how long each takes, s.
const SIDES: [(f32, f32); 4] = [(0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5)];
const SIDE: f64 = 2.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = GroupFile::load("groups/tcc-3.toml")?;
    let bus = omnibus::bus::open(&"sim:groups/tcc-3.toml".parse()?, &file)?;
    let mut group = Group::connect(bus, &file)?;
    let abort = group.abort();
    ctrlc::set_handler(move || abort.ask())?;
    let telemetry = group.telemetry();
    group.start()?;
    let driven = SIDES.into_iter().try_for_each(|(vx, vy)| {
        group.set_twist(Twist::new(vx, vy, 0.0))?;
        group.run(SIDE)
    });
    // However it went, the group comes to rest.
    group.stop()?;
    match driven {
        Err(MasterError::Aborted) => println!("stopped on request"),
        driven => driven?,
    }
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
