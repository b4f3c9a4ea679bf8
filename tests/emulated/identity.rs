//! Which robot it is: its chip, and its node when another has the same.

use omnibus::bus::wire::Wire;
use omnibus::simulation::link::SimLink;
use protocol::{Fault, Kind, Value, address, cob};
use sim::robot::{Robot, emulated::EmulatedRobot};
use sim::{Options, World};

use crate::robots::Robots;

/// Device and revision, as the image's chip has them (DBGMCU_IDCODE).
pub fn a_robot_reports_its_chip(robots: &Robots) {
    let group = robots.group("tcc-2");
    let world = World::new(&group, robots.backend(), Options::default()).unwrap();
    let mut link = SimLink::new(world, "test");
    link.world.run_until(canopen::Micros(400_000)).unwrap();
    let mut wire = Wire::visiting(&mut link);
    let code = wire.read(2, address::CHIP, Kind::U32).unwrap();
    assert_eq!(code, Value::U32(robots.image().chip().id_code));
}

/// Two boards whose switches are set alike, switched on together with a third. Their boot-up frames
/// are the same bits; their first heartbeats come at different times, by the chips' unique numbers.
pub fn robots_that_are_one_node_notice_it(robots: &Robots) {
    let group = robots.group("tcc-3");
    let image = robots.image();
    let boards = [
        (2, b"OMNIBUS-DBL1"),
        (3, b"OMNIBUS-DBL2"),
        (3, b"OMNIBUS-DBL3"),
    ];
    let built = boards
        .into_iter()
        .map(|(node, uid)| EmulatedRobot::with_uid(&image, node, *uid, 0.0).unwrap())
        .map(|robot| Box::new(robot) as Box<dyn Robot>);
    let options = Options::default();
    let plant = sim::plant::build(&group, options.start).unwrap();
    let mut world = World::with_parts(&group, built.collect(), plant, options).unwrap();
    world.run_until(canopen::Micros(400_000)).unwrap();
    let frames: Vec<_> = std::iter::from_fn(|| world.take_received(sim::MASTER)).collect();
    let codes = |node| {
        let of_node = frames
            .iter()
            .filter(move |(_, frame)| frame.id() == cob::emergency(node));
        of_node.map(|(_, f)| u16::from_le_bytes([f.data()[0], f.data()[1]]))
    };
    let mut boots = frames
        .iter()
        .filter(|(_, frame)| frame.id() == cob::heartbeat(3) && frame.data() == [0]);
    assert!(
        boots.next().is_some() && boots.next().is_none(),
        "one boot-up"
    );
    assert!(codes(3).any(|code| code == Fault::DuplicateNode.code()));
    assert_eq!(codes(2).count(), 0);
}
