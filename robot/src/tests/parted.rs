//! Stops of the group: a member's emergency message, a bus that is cut in two, a stop of all.

use kinematics::Twist;
use protocol::address as at;
use protocol::{Fault, Value, cob};

use super::world::World;
use crate::state::{After, State};

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

fn configured(nodes: &[u8], objects: &[(protocol::Address, Value)]) -> World {
    let mut world = World::new(nodes);
    world.configure();
    for node in nodes {
        for (address, value) in objects {
            world.write(*node, *address, *value).unwrap();
        }
    }
    world
}

fn drive(mut world: World) -> World {
    world.start();
    world.run(30);
    world.drive(FORWARD, 1500);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world
}

/// A driver fault in one, in every phase of SYNC: the others ramp within 3 ms.
#[test]
fn a_members_emergency_message_is_a_stop() {
    let mut slowest = 0;
    for phase in 0..10 {
        let mut world = drive(configured(&[2, 3, 4], &[]));
        world.until(20, |world| world.now % 10_000 == phase * 1_000);
        world.robots[2].inputs.drive_fault = Some(Fault::DriverFault);
        let took = world.until(100, |world| {
            let others = world.robots[..2].iter();
            let ramping = State::Ramping(After::Faulted(Fault::MemberStopped));
            others
                .map(|robot| robot.bus.state())
                .all(|state| state == ramping)
        });
        slowest = slowest.max(took);
    }
    std::println!("a member's emergency message: ramp after {slowest} ms");
    assert!(slowest <= 3, "{slowest} ms");
}

/// A gentle fault of one: all go down together.
#[test]
fn a_fault_that_ramps_tears_nothing() {
    let mut world = configured(&[2, 3], &[(at::SUPPLY_MINIMUM, Value::F32(18.0))]);
    for robot in &mut world.robots {
        robot.set_supply(24.0);
    }
    let mut world = drive(world);
    world.robots[1].set_supply(17.0);
    let mut torn = 0.0_f32;
    for _ in 0..2000 {
        world.step();
        let speed = |robot: usize| world.robots[robot].control.report().twist_ref().vx;
        torn += (speed(0) - speed(1)) * 1e-3;
    }
    std::println!("supply low in one: {:.2} mm torn", torn * 1e3);
    // One tick at 0.6 m/s is 0.6 mm, and the bus side sees a report a tick later.
    assert!(torn.abs() < 2e-3, "{torn} m");
}

#[test]
fn only_faults_of_members_stop_anything() {
    for (node, code) in [
        // No member, the master, no fault but its end, a limit, a warning of CANopen's own.
        (9, Fault::DriverFault.code()),
        (1, Fault::DriverFault.code()),
        (3, 0),
        (3, protocol::Limit::Strain.code()),
        (3, 0x8210),
    ] {
        let mut world = drive(configured(&[2, 3], &[]));
        let [low, high] = code.to_le_bytes();
        world.send(node, cob::emergency(node), &[low, high, 1, 0, 0, 0, 0, 0]);
        // Too short to be one.
        world.send(3, cob::emergency(3), &[0x0E]);
        world.run(200);
        for robot in &world.robots {
            assert_eq!(robot.bus.state(), State::Moving, "{node} {code:04x}");
        }
    }
}

/// The half with the master, and who is in it.
fn near(node: u8) -> bool {
    node <= 3
}

/// How far apart the halves go after the bus has come apart in the given phase.
fn torn(phase: u64, cut_votes: bool) -> f32 {
    let mut world = drive(configured(&[2, 3, 4, 5], &[]));
    world.until(20, |world| world.now % 10_000 == phase * 1_000);
    if cut_votes {
        // SYNC still comes through, the votes on it no longer do.
        world.passes = |from, to| from == 1 || near(from) == near(to);
        world.step();
    }
    world.passes = |from, to| near(from) == near(to);
    let mut torn = 0.0_f32;
    for _ in 0..2000 {
        world.step();
        let speed = |robot: usize| world.robots[robot].control.report().twist_ref().vx;
        assert_eq!(speed(0), speed(1));
        assert_eq!(speed(2), speed(3));
        torn += (speed(2) - speed(0)) * 1e-3;
    }
    for robot in &world.robots {
        assert!(matches!(robot.bus.state(), State::Faulted(_)));
    }
    torn
}

/// The half without the master misses SYNC a quarter of a period after the half with it misses the
/// votes: 2.5 ms at 0.6 m/s are 1.5 mm, and the tick adds one of 0.6 mm.
#[test]
fn a_bus_that_comes_apart_tears_less_than_three_millimetres() {
    let mut worst = 0.0_f32;
    for phase in 0..10 {
        worst = worst.max(torn(phase, false).abs());
    }
    worst = worst.max(torn(0, true).abs());
    std::println!("bus parted: {:.2} mm torn", worst * 1e3);
    assert!(worst < 3e-3, "{} mm", worst * 1e3);
}

/// The protective stop of one: it ramps, the others with it within 3 ms; release starts nothing.
#[test]
fn a_protective_stop_ramps_the_group_down() {
    let enabled = [(at::PROTECTIVE_STOP, Value::U8(1))];
    let mut world = configured(&[2, 3, 4], &[]);
    world.write(4, enabled[0].0, enabled[0].1).unwrap();
    let mut world = drive(world);
    // Where none is configured the input means nothing.
    world.robots[0].inputs.protective_stop = true;
    world.run(100);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world.robots[2].inputs.protective_stop = true;
    world.run(3);
    let ramping = |fault| State::Ramping(After::Faulted(fault));
    let state = |world: &World, robot: usize| world.robots[robot].bus.state();
    assert_eq!(state(&world, 2), ramping(Fault::ProtectiveStop));
    assert_eq!(state(&world, 0), ramping(Fault::MemberStopped));
    assert!(world.robots[2].outputs.drivers_enabled);
    assert_eq!(world.emergencies(4), [0xFF1D]);
    world.run(1000);
    for robot in &world.robots {
        assert_eq!(robot.outputs, control::interface::Outputs::SAFE);
    }
    // Held, it refuses a start; released, it waits for one.
    world.start();
    world.run(5);
    assert_eq!(state(&world, 2), State::Faulted(Fault::ProtectiveStop));
    world.robots[2].inputs.protective_stop = false;
    world.run(500);
    assert_eq!(state(&world, 2), State::Faulted(Fault::ProtectiveStop));
    world.start();
    world.drive(FORWARD, 300);
    assert_eq!(state(&world, 2), State::Moving);
}

/// A start with the protective stop open is refused from power-on on.
#[test]
fn a_protective_stop_refuses_the_first_start() {
    let mut world = configured(&[2], &[(at::PROTECTIVE_STOP, Value::U8(1))]);
    world.robots[0].inputs.protective_stop = true;
    world.run(2);
    world.start();
    for _ in 0..50 {
        world.step();
        assert_eq!(world.robots[0].outputs, control::interface::Outputs::SAFE);
    }
    let state = world.robots[0].bus.state();
    assert_eq!(state, State::Faulted(Fault::ProtectiveStop));
}

/// How far the others go on after the emergency stop of one, m.
fn pulled(objects: &[(protocol::Address, Value)]) -> f64 {
    let mut world = drive(configured(&[2, 3], objects));
    world.robots[1].inputs.emergency_stop = true;
    let mut pulled = 0.0;
    for _ in 0..2000 {
        world.step();
        pulled += (world.robots[0].rates[0] - world.robots[1].rates[0]) * 0.1524 * 1e-3;
    }
    let state = world.robots[0].bus.state();
    assert_eq!(state, State::Faulted(Fault::MemberStopped));
    pulled
}

/// By default the others ramp: 0.6^2 / 2 m and what the jerk limit adds, 0.20 m in all. Cut
/// together, it is 3 ms at 0.6 m/s.
#[test]
fn an_emergency_stop_of_one_can_cut_all() {
    let alone = pulled(&[]);
    let linked = pulled(&[(at::CUTS_TOGETHER, Value::U8(1))]);
    std::println!(
        "emergency stop of one: {:.0} mm, cut together {:.1} mm",
        alone * 1e3,
        linked * 1e3
    );
    assert!(alone > 0.18, "{alone} m");
    assert!(linked < 2e-3, "{linked} m");
}
