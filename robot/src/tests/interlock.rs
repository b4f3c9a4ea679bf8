//! What a start waits for before anything moves, and what the master does to start a group and to
//! keep it moving.

use kinematics::Twist;
use protocol::address as at;
use protocol::{Code, Limit, Value, cob};

use super::world::World;
use crate::state::State;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

fn moving(nodes: &[u8]) -> World {
    let mut world = World::started(nodes);
    world.drive(FORWARD, 1000);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world
}

fn all_are(world: &World, state: State) -> bool {
    world.robots.iter().all(|robot| robot.bus.state() == state)
}

/// After an emergency stop the master goes on asking for 0.6 m/s, with new sequences. One NMT start
/// must not move anything.
#[test]
fn a_start_while_a_speed_is_streamed_moves_nothing() {
    let mut world = moving(&[2, 3]);
    world.robots[0].inputs.emergency_stop = true;
    world.run(1500);
    world.robots[0].inputs.emergency_stop = false;
    world.run(20);
    world.start();
    for _ in 0..1000 {
        world.step();
        for robot in &world.robots {
            assert_eq!(robot.control.report().twist_ref(), Twist::ZERO);
        }
    }
    assert!(all_are(&world, State::Armed));
    for node in [2, 3] {
        assert_eq!(
            world.status(node).code,
            Code::Limit(Limit::AwaitingStandstill)
        );
    }
}

/// Two SYNCs near standstill are not enough, the third is: at the same SYNC for all.
#[test]
fn three_syncs_near_standstill_release_all_members_at_once() {
    let mut world = World::started(&[2, 3, 4]);
    world.until(20, |world| world.now % 10_000 == 1_000);
    // Below both thresholds, but not zero: a joystick's neutral position.
    world.twist = Some(Twist::new(0.006, 0.006, 0.009));
    // Agreed on at the next SYNC, and twice more.
    let took = world.until(100, |world| all_are(world, State::Moving));
    assert_eq!(took, 30);
    // Never one without the other.
    let mut world = World::started(&[2, 3, 4]);
    world.twist = Some(Twist::ZERO);
    while !all_are(&world, State::Moving) {
        world.step();
        assert!(all_are(&world, State::Armed) || all_are(&world, State::Moving));
    }
    // What is too fast restarts the count.
    for twist in [
        Twist::new(0.008, 0.008, 0.0),
        Twist::new(0.0, 0.0, 0.011),
        Twist::new(-0.011, 0.0, 0.0),
    ] {
        let mut world = World::started(&[2, 3, 4]);
        world.until(20, |world| world.now % 10_000 == 1_000);
        for _ in 0..20 {
            world.twist = Some(Twist::ZERO);
            world.run(20);
            world.twist = Some(twist);
            world.run(10);
            assert!(all_are(&world, State::Armed));
        }
    }
}

#[test]
fn how_many_syncs_is_a_parameter_of_the_group() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    for node in [2, 3] {
        world
            .write(node, at::STANDSTILL_SYNCS, Value::U8(20))
            .unwrap();
    }
    world.start();
    world.run(30);
    world.until(20, |world| world.now % 10_000 == 1_000);
    world.twist = Some(Twist::ZERO);
    let took = world.until(400, |world| all_are(world, State::Moving));
    assert_eq!(took, 200);
}

/// A member that is started once more restarts its count; no member follows a speed before it is
/// ready.
#[test]
fn a_member_started_late_holds_the_others_back() {
    let mut world = World::started(&[2, 3]);
    world.until(20, |world| world.now % 10_000 == 1_000);
    world.twist = Some(Twist::ZERO);
    world.run(20);
    world.nmt(canopen::NmtCommand::Start, 3);
    world.twist = Some(FORWARD);
    for _ in 0..500 {
        world.step();
        for robot in &world.robots {
            assert_eq!(robot.control.report().twist_ref(), Twist::ZERO);
        }
    }
}

/// Frames of the master's heartbeat that do not say OPERATIONAL feed nothing.
#[test]
fn a_master_that_is_not_operational_is_silent() {
    for data in [&[4_u8][..], &[127], &[], &[5, 5]] {
        let mut world = moving(&[2]);
        world.heartbeat = false;
        for _ in 0..60 {
            world.send(1, cob::MASTER_HEARTBEAT, data);
            world.run(10);
        }
        let fault = world.robots[0].bus.state().fault();
        assert_eq!(fault, Some(protocol::Fault::MasterSilent), "{data:?}");
    }
}

/// A boot-up message says that the master has just restarted: a stop at once, whatever it sends
/// next.
#[test]
fn a_master_that_boots_has_restarted() {
    let mut world = moving(&[2, 3]);
    world.send(1, cob::MASTER_HEARTBEAT, &[0]);
    world.send(1, cob::MASTER_HEARTBEAT, &[5]);
    world.run(2);
    for robot in &world.robots {
        let state = robot.bus.state();
        assert_eq!(state.fault(), Some(protocol::Fault::MasterSilent));
        assert!(matches!(state, State::Ramping(_)));
    }
}

/// Drivers are not switched on while wheels turn with more than 0.2 rad/s.
#[test]
fn a_start_is_refused_while_wheels_turn() {
    let mut world = moving(&[2]);
    world.robots[0].inputs.emergency_stop = true;
    world.step();
    world.robots[0].inputs.emergency_stop = false;
    world.twist = None;
    world.run(50);
    // The brake has no grip and the floor slopes.
    for _ in 0..20 {
        let robot = &mut world.robots[0];
        (0..4).for_each(|wheel| robot.angles[wheel] += 4.0e-3);
        world.step();
    }
    world.start();
    world.step();
    assert_eq!(
        world.robots[0].bus.state(),
        State::Faulted(protocol::Fault::WheelsTurn)
    );
    assert!(!world.robots[0].outputs.drivers_enabled);
    assert_eq!(
        world.emergencies(2).last(),
        Some(&protocol::Fault::WheelsTurn.code())
    );
    // As soon as they stand it starts.
    world.run(100);
    world.start();
    world.step();
    assert_eq!(world.robots[0].bus.state(), State::Armed);
}

/// 2 ms in the robot under a master at 10 ms: it does not follow, and says why.
#[test]
fn another_sync_period_is_named_and_not_followed() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    for node in [2, 3] {
        world
            .write(node, at::SYNC_PERIOD, Value::U32(2_000))
            .unwrap();
    }
    world.start();
    world.twist = Some(Twist::ZERO);
    world.run(300);
    world.twist = Some(FORWARD);
    for _ in 0..300 {
        world.step();
        assert!(all_are(&world, State::Armed));
        assert_eq!(world.robots[0].control.report().twist_ref(), Twist::ZERO);
    }
    assert_eq!(world.status(2).code, Code::Limit(Limit::SyncPeriod));
}
