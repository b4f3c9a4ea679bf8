//! `scan` on a bus whose frames collide as on copper, with robots that are one node by mistake.

use group::GroupFile;
use omnibus::bus::wire::Wire;
use omnibus::commission::survey::Survey;
use omnibus::simulation::link::SimLink;
use sim::robot::Robot;
use sim::robot::native::NativeRobot;
use sim::{Options, World, plant};

/// Five robots with these node numbers and with serial numbers far apart.
fn bus(nodes: [u8; 5]) -> SimLink {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../groups/tcc-3.toml");
    let mut file = GroupFile::load(path).unwrap();
    // Where they stand does not matter: none of them moves.
    for node in [5, 6] {
        let mut robot = file.robots[0].clone();
        robot.node = node;
        file.robots.push(robot);
        file.simulation.crystal_ppm.push(0.0);
    }
    let mut robots: Vec<Box<dyn Robot>> = Vec::new();
    for (n, node) in (0_u32..).zip(nodes) {
        let robot = NativeRobot::with_serial(node, serial(n), 0.0).unwrap();
        robots.push(Box::new(robot));
    }
    let options = Options::default();
    let plant = plant::build(&file, options.start).unwrap();
    SimLink::new(
        World::with_parts(&file, robots, plant, options).unwrap(),
        "simulated",
    )
}

/// As a hash of a chip's identifier would be.
fn serial(n: u32) -> u32 {
    (n + 1).wrapping_mul(0x9E37_79B9)
}

#[test]
fn doubles_among_five_robots_are_named_by_serial_number() {
    for (nodes, doubles) in [
        ([2, 3, 4, 5, 6], &[][..]),
        ([2, 3, 3, 4, 5], &[(3, &[1, 2][..])][..]),
        ([2, 3, 3, 3, 4], &[(3, &[1, 2, 3][..])][..]),
        ([2, 2, 3, 4, 4], &[(2, &[0, 1][..]), (4, &[3, 4][..])][..]),
    ] {
        let mut link = bus(nodes);
        let survey = Survey::take(&mut Wire::visiting(&mut link), None).unwrap();
        let answered: u32 = survey.found.iter().map(|robot| robot.answers).sum();
        assert_eq!(answered, 5, "{nodes:?}: {:?}", survey.found);
        assert_eq!(survey.conflicts.len(), doubles.len(), "{nodes:?}");
        for ((node, robots), text) in doubles.iter().zip(&survey.conflicts) {
            let many = format!("{} robots answer as node {node}", robots.len());
            assert!(text.contains(&many), "{text}");
            for robot in *robots {
                let serial = format!("{:08X}", serial(*robot));
                assert!(text.contains(&serial), "{serial} in {text}");
            }
        }
    }
}

/// Two that have been talked to until they keep quiet on the SDO channel are still found by LSS.
#[test]
fn robots_nobody_knows_are_found_by_their_serial_number() {
    let mut link = bus([2, 3, 3, 4, 5]);
    let mut wire = Wire::visiting(&mut link);
    let until = wire.now() + canopen::Micros(300_000);
    while wire.next(until).unwrap().is_some() {}
    let mut known: Vec<u32> = [0, 3, 4].map(serial).to_vec();
    known.sort_unstable();
    let found = omnibus::commission::lss::unknown(&mut wire, &known).unwrap();
    let mut wanted = [1, 2].map(|n| (serial(n), canopen::NodeId::new(3)));
    wanted.sort_unstable_by_key(|(serial, _)| *serial);
    assert_eq!(found, wanted);
}
