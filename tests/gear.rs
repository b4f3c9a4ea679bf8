//! Rollers behind a gear: the encoder on the motor's shaft, the index on the wheel, a turn of the
//! wheel no whole number of counts.

mod common;

use common::{LOST, references};
use group::GroupFile;
use omnibus::abort::Abort;
use omnibus::path::course::Course;
use omnibus::path::curve::Curve;
use omnibus::run::Drive;
use omnibus::session::Group;
use omnibus::session::roller_index::KNOWN;
use omnibus::simulation::contact;
use omnibus::simulation::link::SimLink;
use omnibus::simulation::run::simulated;
use sim::{Backend, Options, World};

/// Counts of the shaft's turn, and turns of the shaft in one of the wheel: 1718.4 counts.
const COUNTS: f32 = 64.0;
const GEAR: f32 = 26.85;
/// Standard deviation of the lateral speed, per cent.
const RIPPLE: f64 = 0.6;

/// A robot with such an encoder on the contact plant, eight rollers at random phases, half a degree
/// of play in the gear.
fn geared() -> GroupFile {
    let mut group = common::group("single");
    for robot in &mut group.robots {
        robot.encoder = group::Encoder {
            counts_per_revolution: COUNTS,
            gear_ratio: GEAR,
        };
    }
    group.simulation.backlash = 0.5_f64.to_radians();
    contact::with_phases(&contact::on_contact(&group, 8))
}

fn ripple(group: &GroupFile, elf: Option<&std::path::Path>) -> f64 {
    let drive = Drive {
        group,
        course: Course::of(Curve::Lateral),
        feedback: None,
        compensation: true,
        elf,
        candump: None,
        log: None,
        abort: Abort::default(),
        record: None,
        index_search: Some(&|_| {}),
    };
    let run = simulated(&drive, &mut |_, _| {}).unwrap();
    println!("{:?} {:?}", run.errors, run.evenness);
    run.evenness.ripple_percent
}

/// How the wheels stand with their references after a course, and whether a reference was ever
/// lost: the robot is told what `configured` says, the world is what `truth` says.
fn after(
    truth: &GroupFile,
    configured: &GroupFile,
    backend: Backend,
    course: &Course,
) -> ([u8; 4], bool) {
    let world = World::new(truth, backend, Options::default()).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, configured).unwrap();
    session.configure(true).unwrap();
    session.start().unwrap();
    session
        .follow(&course.plan().unwrap(), &mut |_, _| {})
        .unwrap();
    references(&mut session, configured.robots[0].node)
}

#[test]
fn native_robots_keep_their_rollers_behind_a_gear() {
    let group = geared();
    let found = ripple(&group, None);
    assert!(found <= RIPPLE, "{found}");
    // Four minutes there and back and around, some 250 turns of a wheel.
    let course = Course {
        repeats: 8,
        ..Course::of(Curve::FigureEight)
    };
    let plan = course.plan().unwrap();
    assert!(plan.duration() > 120.0, "{}", plan.duration());
    let (states, lost) = after(&group, &group, Backend::Native, &course);
    assert_eq!((states, lost), ([KNOWN; 4], false));
}

/// A tooth more on a wheel of 60.
#[test]
fn a_wrong_gear_is_noticed() {
    let truth = geared();
    let mut configured = truth.clone();
    configured.robots[0].encoder.gear_ratio = GEAR * 61.0 / 60.0;
    let course = Course::of(Curve::Lateral);
    let (states, lost) = after(&truth, &configured, Backend::Native, &course);
    assert_eq!((states, lost), ([LOST; 4], true));
}

/// The release image that `OMNIBUS_ELF` names (`cargo xtask test` builds it).
#[cfg(feature = "emulated")]
#[test]
fn emulated_robots_keep_their_rollers_behind_a_gear() {
    let elf = std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names a release image");
    let elf = std::path::PathBuf::from(elf);
    let group = geared();
    let found = ripple(&group, Some(&elf));
    assert!(found <= RIPPLE, "{found}");
    let image = common::image("OMNIBUS_ELF");
    let course = Course {
        repeats: 4,
        ..Course::of(Curve::FigureEight)
    };
    let (states, lost) = after(&group, &group, Backend::Emulator(image), &course);
    assert_eq!((states, lost), ([KNOWN; 4], false));
}
