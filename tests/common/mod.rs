//! One drive of a group through a simulated world, for the tests of the whole system.

#![allow(dead_code, reason = "every test uses a part")]

use group::GroupFile;
use omnibus::curve::Curve;
use omnibus::session::Group;
use omnibus::sim_link::SimLink;
use sim::{Backend, Options, TruthSample, World};

/// A group file of the workspace.
pub fn group(name: &str) -> GroupFile {
    let path = format!("{}/groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    GroupFile::load(path).unwrap_or_else(|error| panic!("{error}"))
}

/// What a drive left behind.
pub struct Drive {
    /// The world after it.
    pub world: World,
    /// The truth at every SYNC.
    pub truth: Vec<TruthSample>,
    /// How it ended.
    pub result: Result<(), String>,
}

/// Boots, configures and starts a group and drives it along the first seconds of a curve.
pub fn quick_drive(group: &GroupFile, backend: Backend, curve: Curve, compensation: bool) -> Drive {
    let plan = curve.plan(true);
    let options = Options {
        truth_period_ns: u64::from(group.sync_period_us) * 1_000,
        start: plan.start(),
        ..Options::default()
    };
    let world = World::new(group, backend, options).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut truth = Vec::new();
    let mut drive = || -> Result<(), Box<dyn std::error::Error>> {
        let mut session = Group::connect(&mut link, group)?;
        session.configure(compensation)?;
        session.start()?;
        session.link().world.take_truth();
        session.link().world.reset_worst_shape_error();
        session.follow(&plan, &mut |link, _| truth.extend(link.world.take_truth()))?;
        Ok(())
    };
    let result = drive().map_err(|error| error.to_string());
    Drive {
        world: link.world,
        truth,
        result,
    }
}
