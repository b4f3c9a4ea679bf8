//! A copy of a world does what the world does: to the frame's nanosecond and the bridge's count.

use kinematics::Twist;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use sim::test_master::TestMaster;
use sim::{Backend, Options, TruthSample, World};

use crate::robots::{BOARD_C, KIT, REFERENCE, Robots};

/// How long a copy and its original go on, ms.
const ON_MS: u64 = 30;

/// What shows that two worlds are in one state.
fn state(world: &World) -> (u64, u64, u64, TruthSample) {
    let (digest, frames) = (world.digest(), world.frames());
    (digest, frames, world.instructions(), world.truth())
}

/// Copies the world, lets both go on, the copy first, and leaves the original.
fn copy_at(world: &mut World) {
    let end = canopen::Micros(world.now().0 + ON_MS * 1_000);
    let mut copy = world.try_clone().unwrap();
    copy.run_until(end).unwrap();
    world.run_until(end).unwrap();
    assert_eq!(state(world), state(&copy), "at {end:?}");
}

/// From power-on to driving, with copies all the way; what happens to one leaves the other alone.
fn copies_go_on_alike(group: &group::GroupFile, backend: Backend) {
    let mut world = World::new(group, backend, Options::default()).unwrap();
    copy_at(&mut world);
    // In the boot code, at the first frames, and with the node's flash being read.
    for _ in 0..8 {
        let odd = canopen::Micros(world.now().0 + 7_013);
        world.run_until(odd).unwrap();
        copy_at(&mut world);
    }
    let mut link = SimLink::new(world, "copies");
    Group::connect(&mut link, group)
        .unwrap()
        .configure(true)
        .unwrap();
    let mut master = TestMaster::new(link.world, group);
    master.run_to_phase(10, 0).unwrap();
    master.run(100).unwrap();
    master.command(canopen::NmtCommand::Start, None);
    master.run(300).unwrap();
    master.twist = Some(Twist::new(0.3, 0.1, 0.2));
    for _ in 0..10 {
        master.run(17).unwrap();
        let (mut copy, mut stopped) = (master.try_clone().unwrap(), master.try_clone().unwrap());
        stopped.world.set_emergency_stop(0, true);
        stopped.run(ON_MS).unwrap();
        copy.run(ON_MS).unwrap();
        master.run(ON_MS).unwrap();
        assert_eq!(state(&master.world), state(&copy.world));
        assert_ne!(stopped.world.digest(), copy.world.digest());
    }
    assert!(master.world.truth().group.x > 0.05, "it has not moved");
}

fn emulated(robots: &Robots) {
    copies_go_on_alike(&robots.group("tcc-2"), robots.backend());
}

#[test]
fn of_emulated_robots() {
    emulated(&REFERENCE);
}

/// With their gyros, and drives on a second bus.
#[test]
fn of_emulated_board_cs() {
    emulated(&BOARD_C);
}

#[test]
fn of_emulated_kits() {
    emulated(&KIT);
}

#[test]
fn of_native_robots_on_rollers() {
    let mut group = REFERENCE.group("tcc-3");
    group.simulation.plant = group::Plant::Contact { rollers: 8 };
    group.simulation.contact.scattered = true;
    copies_go_on_alike(&group, Backend::Native);
}

#[test]
fn of_native_robots_with_smart_drives() {
    copies_go_on_alike(&BOARD_C.group("tcc-2"), Backend::Native);
}
