//! A wheel's index that breaks on the way: its robot notices, says so, goes on with the mean of
//! that wheel, and ends where it should. On boards with counters behind their encoders, and with
//! smart drives that report where they are.

mod common;

use common::{LOST, references};
use group::{Board, GroupFile};
use omnibus::path::course::Course;
use omnibus::path::curve::{Curve, Plan};
use omnibus::session::Group;
use omnibus::session::roller_index::KNOWN;
use omnibus::simulation::contact;
use omnibus::simulation::link::SimLink;
use sim::index::IndexState;
use sim::{Backend, Options, World};

/// The rear left one's breaks.
const BROKEN: usize = 2;

/// Eight rollers at random phases. To the left for 4 m, four turns of every wheel, with indexes
/// that work; then the same again with one that does not. A wheel with the mean of its rollers is
/// off by 3.3 % at most at any instant, and by nothing in the mean; the 0.5 % that rollers lose
/// besides are not compensated for here.
fn a_broken_index_is_noticed(backend: &Backend, group: &GroupFile) {
    let group = contact::with_phases(&contact::on_contact(group, 8));
    let node = group.robots[0].node;
    let plan = Course::of(Curve::Lateral).plan().unwrap();
    for fault in [IndexState::Missing, IndexState::Double, IndexState::Noisy] {
        let world = World::new(&group, backend.clone(), Options::default()).unwrap();
        let mut link = SimLink::new(world, "test");
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(true).unwrap();
        session.start().unwrap();
        session.follow(&plan, &mut |_, _| {}).unwrap();
        assert_eq!(references(&mut session, node), ([KNOWN; 4], false));

        session.link().world.set_index(0, BROKEN, fault);
        session.start().unwrap();
        let before = session.link().world.truth().group;
        session.follow(&plan, &mut |_, _| {}).unwrap();
        let after = session.link().world.truth().group;
        let mut states = [KNOWN; 4];
        states[BROKEN] = LOST;
        assert_eq!(references(&mut session, node), (states, true), "{fault:?}");
        let went = (after.x - before.x).hypot(after.y - before.y);
        let asked = 4.0;
        println!("{fault:?}: {went:.3} m of {asked}");
        assert!((went / asked - 1.0).abs() < 0.01, "{fault:?}: {went}");
    }
}

/// Ahead and back three times, at 1.4 m/s at most, where a millisecond is 461 counts: no index is
/// taken for a wrong one.
fn a_fast_robot_keeps_its_references(backend: &Backend, board: Board) {
    let mut group = common::group("c620");
    group.robots[0].board = board;
    let group = contact::with_phases(&contact::on_contact(&group, 8));
    let node = group.robots[0].node;
    let plan = Plan::there_and_back(3.0, 1.4, &group.limits);
    let world = World::new(&group, backend.clone(), Options::default()).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    session.start().unwrap();
    for _ in 0..3 {
        session.follow(&plan, &mut |_, _| {}).unwrap();
        session.start().unwrap();
        assert_eq!(references(&mut session, node), ([KNOWN; 4], false));
    }
}

/// Its wheels are turned by smart drives.
fn driven(board: Board) -> GroupFile {
    let mut group = common::group("single");
    group.robots[0].board = board;
    common::fit_smart_drives(&mut group.robots[0]);
    group
}

#[test]
fn native_robots_notice_a_broken_index() {
    a_broken_index_is_noticed(&Backend::Native, &common::group("single"));
}

#[test]
fn native_robots_with_smart_drives_notice_a_broken_index() {
    a_broken_index_is_noticed(&Backend::Native, &driven(Board::RobomasterC));
}

#[test]
fn a_fast_native_robot_keeps_its_references() {
    a_fast_robot_keeps_its_references(&Backend::Native, Board::RobomasterC);
}

/// The release image that a variable names (`cargo xtask test` builds it).
#[cfg(feature = "emulated")]
fn image(variable: &str) -> Backend {
    Backend::Emulator(common::image(variable))
}

#[cfg(feature = "emulated")]
#[test]
fn emulated_robots_notice_a_broken_index() {
    a_broken_index_is_noticed(&image("OMNIBUS_ELF"), &common::group("single"));
}

#[cfg(feature = "emulated")]
#[test]
fn emulated_robots_with_smart_drives_notice_a_broken_index() {
    let group = driven(Board::NucleoF446re);
    a_broken_index_is_noticed(&image("OMNIBUS_ELF_DRIVES"), &group);
}

#[cfg(feature = "emulated")]
mod board_c {
    use super::*;

    #[test]
    fn emulated_robots_notice_a_broken_index() {
        let group = driven(Board::RobomasterC);
        a_broken_index_is_noticed(&image("OMNIBUS_ELF_BOARD_C"), &group);
    }

    #[test]
    fn a_fast_emulated_robot_keeps_its_references() {
        a_fast_robot_keeps_its_references(&image("OMNIBUS_ELF_BOARD_C"), Board::RobomasterC);
    }
}
