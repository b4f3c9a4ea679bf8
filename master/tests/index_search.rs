//! The motion that brings the indexes of wheels by: told before anything moves, with the room it
//! needs, slow, and left out on request.

mod common;

use std::path::PathBuf;

use group::{GroupFile, Rollers};
use kinematics::{Pose, VelocityCompensation};
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::world;

use common::omnibus;

/// What any person can step away from, m/s.
const SLOW: f64 = 0.2;

fn robot() -> GroupFile {
    let mut file = GroupFile::load(common::root().join("groups/single-rollers.toml")).unwrap();
    file.robots[0].rollers = Some(Rollers {
        count: 8,
        phases: [0.0; 4],
        index_tolerance: None,
        compensation: VelocityCompensation::NONE,
    });
    file
}

#[test]
fn it_is_announced_with_the_room_it_needs_and_slow() {
    let file = robot();
    let world = world(&file, None, Pose::new(0.0, 0.0, 0.0)).unwrap();
    let mut group = Group::connect(SimLink::new(world, "sim"), &file).unwrap();
    group.configure(false).unwrap();
    group.link().world.take_truth();
    let mut announced = Vec::new();
    group
        .find_rollers(&mut |search| announced.push(*search))
        .unwrap();
    let [search] = announced[..] else {
        panic!("{announced:?}")
    };
    // A wheel of 0.1524 m: a turn is 0.958 m.
    let turn = std::f64::consts::TAU * 0.1524;
    assert!((turn..1.1 * turn).contains(&search.distance), "{search:?}");
    assert!((search.speed - SLOW).abs() < 0.001, "{search:?}");
    let seen = group.link().world.take_truth();
    let furthest = seen.iter().map(|s| s.group.x).fold(0.0, f64::max);
    let nearest = seen.iter().map(|s| s.group.x).fold(0.0, f64::min);
    assert!(furthest > turn * 0.99 && furthest < search.distance + 0.005);
    assert!(nearest > -0.005, "{nearest}");
    let fastest = seen.windows(20).map(|all| {
        let (a, b) = (&all[0], &all[19]);
        (b.group.x - a.group.x).abs() / ((b.time_ns - a.time_ns) as f64 * 1e-9)
    });
    let fastest = fastest.fold(0.0, f64::max);
    assert!((0.9 * SLOW..1.03 * SLOW).contains(&fastest), "{fastest}");
    // All wheels know their angles now: nothing moves, and nothing is announced.
    group.find_rollers(&mut |_| panic!("again")).unwrap();
}

/// A group file on disk, because the program reads one.
fn on_disk() -> PathBuf {
    let text = std::fs::read_to_string(common::root().join("groups/single-rollers.toml")).unwrap();
    let text = text.replace("node = 2\n", "node = 2\nrollers = { count = 8 }\n");
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("index-search.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn follow_says_so_and_leaves_it_out_on_request() {
    let bus = format!("sim:{}", on_disk().display());
    let follow = ["follow", "lateral", "--quick", "--bus", &bus];
    let output = omnibus(&follow);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(message.contains("keep 1.03 m free"), "{message}");
    assert!(message.contains("--no-seek"), "{message}");
    let output = omnibus(&[&follow[..], &["--no-seek"]].concat());
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(!message.contains("free"), "{message}");
}
