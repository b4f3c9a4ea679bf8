//! One drive of a group through a simulated world, for the tests of the whole system.

#![allow(dead_code, reason = "every test uses a part")]

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use emulator::Firmware;
use group::GroupFile;
use omnibus::path::curve::Curve;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::address::{history, rollers};
use protocol::{Kind, Limit, Value};
use sim::{Backend, Options, TruthSample, World};

/// A group file of the workspace.
pub fn group(name: &str) -> GroupFile {
    let path = format!("{}/groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    GroupFile::load(path).unwrap_or_else(|error| panic!("{error}"))
}

/// The image that a variable of the environment names, which `cargo xtask test` builds. All tests
/// of a program share it, and what has been decoded of it.
pub fn image(variable: &str) -> Firmware {
    static LOADED: Mutex<Option<HashMap<String, Firmware>>> = Mutex::new(None);
    let path = std::env::var(variable)
        .unwrap_or_else(|_| panic!("{variable} names a release image; cargo xtask test sets it"));
    // A test that panicked in here has left the others' images as they were.
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    let loaded = loaded.get_or_insert_default().entry(path);
    let image = loaded.or_insert_with_key(|path| {
        Firmware::load(path).unwrap_or_else(|error| panic!("{path}: {error}"))
    });
    image.clone()
}

/// Gives a robot C620 drives with M3508 motors' encoders in place of bridges, as strong as those
/// are.
pub fn fit_smart_drives(robot: &mut group::Robot) {
    robot.output.kind = group::StageKind::C620;
    robot.output.largest_current = Some(20.0);
    robot.encoder.counts_per_revolution = 8192.0;
    robot.encoder.gear_ratio = 3591.0 / 187.0;
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
    drive(group, backend, curve, true, compensation)
}

/// The same along the whole of a curve, or its first seconds.
pub fn drive(
    group: &GroupFile,
    backend: Backend,
    curve: Curve,
    quick: bool,
    compensation: bool,
) -> Drive {
    let plan = curve.plan(quick);
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

/// A wheel whose reference is lost is in this roller state.
pub const LOST: u8 = 3;

/// Roller states of a robot's wheels, and whether the limit of lost references stands in its
/// history.
pub fn references(session: &mut Group<&mut SimLink>, node: u8) -> ([u8; 4], bool) {
    let mut read = |address, kind| session.wire().read(node, address, kind).unwrap();
    let states = [0, 1, 2, 3].map(|wheel| {
        let Value::U8(state) = read(rollers::state(wheel), Kind::U8) else {
            panic!("a state is a byte")
        };
        state
    });
    let lost = (1..=8).any(|nth| {
        read(history::limit_code(nth), Kind::U16) == Value::U16(Limit::RollerPhase.code())
    });
    (states, lost)
}
