//! Robots whose node switches are set alike, on a bus that treats their frames as copper does.

use canopen::{Emergency, Frame, Micros, NmtCommand, NmtTarget, NodeId, client};
use group::GroupFile;
use omnibus_sim::robot::Robot;
use omnibus_sim::robot::native::NativeRobot;
use omnibus_sim::{MASTER, Options, World, plant};
use protocol::{Fault, cob};

/// A group of three on the bus, in which robots have these node numbers.
fn world(nodes: [u8; 3]) -> World {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    let file = GroupFile::load(path).unwrap();
    let mut robots: Vec<Box<dyn Robot>> = Vec::new();
    for (n, node) in (0_u32..).zip(nodes) {
        // Serial numbers as they come from a factory, and crystals that are alike.
        let serial = 0x1A2B_3C00 + n;
        robots.push(Box::new(
            NativeRobot::with_serial(node, serial, 0.0).unwrap(),
        ));
    }
    let options = Options::default();
    let plant = plant::build(&file, options.start).unwrap();
    World::with_parts(&file, robots, plant, options).unwrap()
}

fn run(world: &mut World, millis: u64) -> Vec<Frame> {
    let until = Micros(world.now().0 + millis * 1_000);
    world.run_until(until).unwrap();
    std::iter::from_fn(|| world.take_received(MASTER))
        .map(|(_, frame)| frame)
        .collect()
}

fn emergencies(frames: &[Frame], node: u8) -> Vec<u16> {
    let sent = frames.iter().filter(|f| f.id() == cob::emergency(node));
    sent.map(|f| u16::from_le_bytes([f.data()[0], f.data()[1]]))
        .collect()
}

/// Their boot-up frames are one frame, in the same bits. Their first heartbeats are not.
#[test]
fn robots_switched_on_together_notice_that_they_are_one_node() {
    for nodes in [[2, 3, 3], [3, 3, 3]] {
        let mut world = world(nodes);
        let first = run(&mut world, 45);
        let boots = first.iter().filter(|f| f.id() == cob::heartbeat(3));
        assert_eq!(boots.count(), 1, "{nodes:?}: one boot-up on the wire");
        assert!(emergencies(&first, 3).is_empty());
        let next = run(&mut world, 75);
        let codes = emergencies(&next, 3);
        assert!(codes.contains(&Fault::DuplicateNode.code()), "{codes:X?}");
        assert!(emergencies(&next, 2).is_empty());
        // Whether a start would have been accepted otherwise: they are not configured, which is the
        // next cause.
        world.send(client::nmt(
            NmtCommand::Start,
            NodeId::new(3).map_or(NmtTarget::All, NmtTarget::Node),
        ));
        run(&mut world, 100);
        for robot in (0..3).filter(|robot| nodes[*robot] == 3) {
            let enabled = world.truth().robots[robot].drivers_enabled;
            assert!(!enabled);
        }
    }
}

/// Answers of two robots that differ (their serial numbers) destroy each other sixteen times, 8
/// each, until both are error passive. Both announce that in the same bits: one frame that stands,
/// which takes 1 off and makes them error active again, 127. So the answers destroy each other once
/// more; then the dominant bit wins, and the other follows.
#[test]
fn answers_that_differ_collide_on_the_wire() {
    let mut world = world([2, 3, 3]);
    run(&mut world, 300);
    let before = world.error_frames();
    // 0x2001:1, serial number.
    world.send(Frame::of(
        cob::sdo_request(3),
        [0x40, 0x01, 0x20, 1, 0, 0, 0, 0],
    ));
    let frames = run(&mut world, 20);
    let answers: Vec<&Frame> = frames
        .iter()
        .filter(|f| f.id() == cob::sdo_response(3))
        .collect();
    assert_eq!(emergencies(&frames, 3), [Emergency::CAN_PASSIVE]);
    assert_eq!(world.error_frames() - before, 16 + 1);
    let serials: Vec<u8> = answers.iter().map(|f| f.data()[4]).collect();
    assert_eq!(serials, [0x01, 0x02], "the one with the dominant bit first");
}
