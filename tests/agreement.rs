//! Emulated robots agree within the SYNC period, however late their SYNC is within the allowance.
//!
//! They run the release image that `OMNIBUS_ELF` names (`cargo xtask test` builds it and says so).

mod common;

use canopen::NmtCommand;
use kinematics::Twist;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Kind, MemberState, Value, address};
use sim::test_master::TestMaster;
use sim::{Backend, Options, World};

/// Eight robots, whose votes take longest, and a SYNC that is half a millisecond late: all begin at
/// the tick that follows the agreement delay after SYNC as it should have come. The votes take no
/// longer than their bits explain.
#[test]
fn eight_robots_agree_in_time_on_a_late_sync() {
    let mut group = common::group("tcc-3");
    group.robots = (0..8_u8)
        .map(|place| group::Robot {
            node: group::FIRST_NODE + place,
            mount: kinematics::Pose::new(1.2 * f32::from(place), 0.0, 0.0),
            ..group.robots[0].clone()
        })
        .collect();
    group.simulation.crystal_ppm = vec![50.0, -50.0, 20.0, 0.0, -10.0, 30.0, -40.0, 10.0];
    let backend = Backend::Emulator(common::image("OMNIBUS_ELF"));
    let mut link = SimLink::new(
        World::new(&group, backend, Options::default()).unwrap(),
        "test",
    );
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    drop(session);
    let mut master = TestMaster::new(link.world, &group);
    master.run(60).unwrap();
    master.command(NmtCommand::Start, None);
    master.run(500).unwrap();
    assert!(master.all_are(MemberState::Moving));
    master.run_to_phase(10, 5).unwrap();
    master.world.start_trace();
    master.twist = Some(Twist::new(0.2, 0.0, 0.0));
    master.sync_late_us = 500;
    master.run(5).unwrap();
    let due_ns = master.world.now_ns();
    // One later than the others: the estimate moves by a 32nd of it.
    master.run(5).unwrap();
    let tick_us = f64::from(group::agreement_delay_us(&group)) + 200.0;
    for robot in 0..group.robots.len() {
        let changes = master.world.take_duty_changes(robot);
        let first = changes.into_iter().find(|at| *at > due_ns).unwrap();
        let after_us = (first - due_ns) as f64 * 1e-3;
        // SYNC takes 60 us on the wire, the tick some 20 us.
        assert!(
            (tick_us..tick_us + 120.0).contains(&after_us),
            "{after_us} us"
        );
    }
    master.run(100).unwrap();
    assert!(master.all_are(MemberState::Moving));
    let mut link = SimLink::new(master.world, "test");
    let mut session = Group::connect(&mut link, &group).unwrap();
    for node in group.robots.iter().map(|robot| robot.node) {
        let mut read = |at| session.wire().read(node, at, Kind::U32).unwrap();
        assert_eq!(read(address::LATE_VOTES), Value::U32(0));
        let Value::U32(latest_us) = read(address::LATEST_VOTE) else {
            panic!("a time has 32 bits")
        };
        let known_us = protocol::timing::votes_known_us(9, protocol::timing::BIT_RATE);
        println!("node {node}: latest vote {latest_us} us after SYNC, {known_us} us at worst");
        assert!(
            latest_us < known_us && latest_us > 8 * 111,
            "{latest_us} us"
        );
    }
}
