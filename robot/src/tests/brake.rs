//! The holding brake, which takes its time: between robots that release it at different times, in a
//! start while it engages, after a ramp, and around an identification.

use std::vec::Vec;

use canopen::NmtCommand;
use control::interface::Outputs;
use kinematics::Twist;
use protocol::{Fault, Value, address as at};

use super::world::World;
use crate::state::State;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

/// Robots with a brake that takes so long to let go and to hold, ms, started.
fn with_brakes(nodes: &[u8], release: u16, engage: u16) -> World {
    let mut world = World::new(nodes);
    world.configure();
    for node in nodes {
        let times = [
            (at::BRAKE_RELEASE, Value::U16(release)),
            (at::BRAKE_ENGAGE, Value::U16(engage)),
            // Any wheel that is judged against a closed brake shows.
            (at::BLOCKED_RATE, Value::F32(0.5)),
            (at::WHEEL_FAULT_TIME, Value::U16(20)),
        ];
        for (address, value) in times {
            world.write(*node, address, value).unwrap();
        }
    }
    world.start();
    world.run(30);
    world
}

/// A brake that takes 80 ms to let go and 120 ms to hold.
fn braked() -> World {
    with_brakes(&[2], 80, 120)
}

fn states(world: &World) -> Vec<State> {
    world.robots.iter().map(|robot| robot.bus.state()).collect()
}

#[test]
fn nothing_is_followed_and_no_wheel_judged_until_the_brake_has_let_go() {
    let mut world = braked();
    // Stopped, and started again with a master that asks for standstill first, as it has to.
    world.nmt(canopen::NmtCommand::EnterPreOperational, 0);
    world.run(300);
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    world.twist = Some(Twist::ZERO);
    world.start();
    let released = world.until(50, |world| world.robots[0].outputs.brake_released);
    // The brake is still closed.
    world.robots[0].blocked = [true; 4];
    for _ in released..released + 78 {
        world.step();
        let report = *world.robots[0].control.report();
        assert_eq!(report.twist_ref(), Twist::ZERO);
        assert!(world.robots[0].outputs.drivers_enabled);
    }
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    world.robots[0].blocked = [false; 4];
    world.drive(FORWARD, 1_500);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    assert!((world.robots[0].moves().vx - 0.6).abs() < 0.01);
}

/// After a ramp, and when it is told to leave while it stands, the drivers hold until the brake
/// does.
#[test]
fn the_drivers_hold_until_the_brake_does() {
    for ramps in [true, false] {
        let mut world = braked();
        world.run(200);
        if ramps {
            world.drive(FORWARD, 1_000);
        }
        world.nmt(canopen::NmtCommand::EnterPreOperational, 0);
        world.until(2_000, |world| !world.robots[0].outputs.brake_released);
        let outputs = world.robots[0].outputs;
        assert!(outputs.drivers_enabled, "{outputs:?}");
        let held = world.until(200, |world| !world.robots[0].outputs.drivers_enabled);
        assert!((119..=121).contains(&held), "{held} ms");
        world.run(20);
        assert_eq!(world.robots[0].bus.state(), State::Ready);
        assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    }
}

/// A cut waits for nothing: not while the robot moves, not while the brake engages.
#[test]
fn a_cut_does_not_wait_for_the_brake() {
    for engaging in [false, true] {
        let mut world = braked();
        world.run(200);
        if engaging {
            world.nmt(canopen::NmtCommand::EnterPreOperational, 0);
            world.until(100, |world| !world.robots[0].outputs.brake_released);
            world.run(50);
            assert!(world.robots[0].outputs.drivers_enabled);
        } else {
            world.drive(FORWARD, 1_000);
        }
        world.robots[0].inputs.emergency_stop = true;
        world.step();
        assert_eq!(world.robots[0].outputs, Outputs::SAFE, "{engaging}");
    }
}

/// One member's brake is released already, and the other's only now: motion begins when both have
/// let go. Robots that accelerate with 1.5 m/s^2 keep their distance to what one SYNC's jitter
/// makes, 3 mm.
#[test]
fn the_group_waits_for_the_last_brake() {
    for (release, node) in [(0, 0), (80, 0), (300, 0), (300, 3), (1_000, 0)] {
        let mut world = with_brakes(&[2, 3], release, 0);
        world.run(1_500);
        world.robots[1].inputs.emergency_stop = true;
        world.run(20);
        world.robots[1].inputs.emergency_stop = false;
        world.run(200);
        assert_eq!(world.robots[0].bus.state(), State::Armed);
        assert!(world.robots[1].bus.state().fault().is_some());
        world.nmt(NmtCommand::Start, node);
        world.twist = Some(Twist::ZERO);
        let moving = |world: &World| states(world) == [State::Moving; 2];
        let took = world.until(1_200, moving);
        assert!(took >= u32::from(release), "{took} of {release} ms");
        // Three SYNCs at standstill, and what is decided at the next.
        assert!(took <= u32::from(release) + 60, "{took} of {release} ms");
        let (mut speed, mut apart) = (0.0_f32, 0.0_f32);
        for millis in 0..1_500 {
            if millis % 10 == 0 {
                speed = (speed + 0.015).min(FORWARD.vx);
                world.twist = Some(Twist::new(speed, 0.0, 0.0));
            }
            world.step();
            let [a, b] = [0, 1].map(|robot: usize| world.robots[robot].moves().vx);
            apart += (a - b) * 1e-3;
            assert!(apart.abs() < 3e-3, "{release} ms: {apart} m apart");
        }
        assert_eq!(states(&world), [State::Moving; 2]);
        assert!((world.robots[1].moves().vx - FORWARD.vx).abs() < 0.01);
    }
}

/// A member leaves and is started again at any time while its brake engages, and after: it drives
/// with the other or not at all.
#[test]
fn a_start_while_the_brake_engages_releases_it_again() {
    for wait in (0..400).step_by(20) {
        let mut world = with_brakes(&[2, 3], 80, 120);
        world.run(300);
        world.nmt(NmtCommand::EnterPreOperational, 3);
        world.run(wait);
        world.nmt(NmtCommand::Start, 3);
        world.run(30);
        // While the ramp to the end is not over, a start is ignored.
        if world.robots[1].bus.state() != State::Armed {
            world.nmt(NmtCommand::Start, 3);
            world.run(300);
            world.nmt(NmtCommand::Start, 3);
        }
        world.twist = Some(Twist::ZERO);
        world.until(400, |world| states(world) == [State::Moving; 2]);
        world.twist = Some(FORWARD);
        for _ in 0..1_500 {
            world.step();
            let [a, b] = [0, 1].map(|robot: usize| world.robots[robot].moves().vx);
            assert!((a - b).abs() < 0.05, "{wait} ms: {a} and {b} m/s");
        }
        assert!((world.robots[1].moves().vx - FORWARD.vx).abs() < 0.01);
        assert!(world.robots[1].outputs.brake_released);
    }
}

/// No bus side takes note of the end of the ramp when it hangs; the drivers stay off all the same.
#[test]
fn after_the_ramp_of_a_starved_robot_the_drivers_stay_off() {
    let mut world = braked();
    world.run(200);
    world.drive(FORWARD, 1_000);
    world.robots[0].bus_runs = false;
    world.until(2_000, |world| !world.robots[0].outputs.drivers_enabled);
    for _ in 0..1_000 {
        world.step();
        assert_eq!(world.robots[0].outputs, Outputs::SAFE);
        assert!(world.robots[0].control.report().standstill);
    }
}

/// Voltage comes when the brake has let go; at the end the drivers hold, without voltage, until the
/// brake does.
#[test]
fn an_identification_waits_for_the_brake_and_ends_with_it() {
    let mut world = with_brakes(&[2], 200, 150);
    world.write(2, at::COMMISSIONING, Value::U8(1)).unwrap();
    let before = world.now;
    let released = world.robots[0].outputs.brake_released;
    // Since the nine ticks in which a new configuration only measures; the start was 30 ms ago.
    assert!(released);
    world.write(2, at::IDENTIFY, Value::U8(1)).unwrap();
    let drives = |world: &World| world.robots[0].outputs.given() != [0.0; 4];
    world.until(400, drives);
    let took = (world.now - before) / 1_000;
    assert!((175..=185).contains(&took), "{took} ms");
    world.until(20_000, |world| !world.robots[0].outputs.brake_released);
    let held = world.until(300, |world| {
        assert_eq!(world.robots[0].outputs.given(), [0.0; 4]);
        !world.robots[0].outputs.drivers_enabled
    });
    assert!((149..=151).contains(&held), "{held} ms");
    world.run(5);
    assert_eq!(world.robots[0].bus.state(), State::Ready);
    let status = world.read(2, at::IDENTIFY_STATUS).unwrap() & 0xFF;
    assert_eq!(status, 2, "done");
}

/// Before the first start it has not been measured whether the wheels turn: with a slope and a
/// brake that is too weak, the start is refused and the brake stays engaged.
#[test]
fn the_first_start_is_refused_while_wheels_turn() {
    let mut world = World::new(&[2]);
    world.configure();
    // One wheel at a quarter of a radian a second, or all faster.
    for (wheels, step) in [(1, 0.25e-3), (4, 4e-3)] {
        let mut world = World::new(&[2]);
        world.configure();
        let turn = |world: &mut World| {
            let robot = &mut world.robots[0];
            (0..wheels).for_each(|wheel| robot.angles[wheel] += step);
            world.step();
            assert_eq!(world.robots[0].outputs, Outputs::SAFE);
        };
        (0..200).for_each(|_| turn(&mut world));
        world.start();
        (0..200).for_each(|_| turn(&mut world));
        let state = world.robots[0].bus.state();
        assert_eq!(state, State::Faulted(Fault::WheelsTurn));
    }
    // Slower ones do not turn, and neither does one that rests on an edge of its encoder.
    for millis in 0..200 {
        let robot = &mut world.robots[0];
        robot.angles[0] += 0.1e-3;
        robot.stray[1] = i64::from(millis & 1);
        world.step();
    }
    world.start();
    world.run(30);
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    world.nmt(NmtCommand::EnterPreOperational, 0);
    // At rest it starts.
    world.run(200);
    world.start();
    world.drive(FORWARD, 1_500);
    assert!((world.robots[0].moves().vx - FORWARD.vx).abs() < 0.01);
}

/// A ramp that begins in an acceleration makes nothing faster: from speed v it lasts v/d + d/j, as
/// the check of the parameters has it, also with so low a jerk limit.
#[test]
fn a_ramp_begins_at_once() {
    let (deceleration, jerk) = (1.0_f32, 1.0_f32);
    let mut world = World::new(&[2]);
    world.configure();
    for (address, value) in [
        (at::JERK, jerk),
        (at::DECELERATION, deceleration),
        (at::ACCELERATION, 2.0),
        (at::SPEED_MAX, 1.4),
    ] {
        world.write(2, address, Value::F32(value)).unwrap();
    }
    world.start();
    world.run(60);
    world.drive(Twist::new(1.4, 0.0, 0.0), 1_100);
    let before = world.robots[0].moves().vx;
    assert!(before > 0.4, "{before} m/s");
    world.robots[0].bus_runs = false;
    // 25 ms without the bus side until the ramp.
    world.run(30);
    let reference = world.robots[0].control.report().twist_ref().vx;
    let stands = |world: &World| world.robots[0].control.report().standstill;
    let mut fastest = 0.0_f32;
    let mut took = 0;
    while !stands(&world) {
        world.step();
        took += 1;
        fastest = fastest.max(world.robots[0].control.report().twist_ref().vx);
        assert!(took < 5_000);
    }
    assert!(
        fastest <= reference + 1e-6,
        "{reference}, then {fastest} m/s"
    );
    // Within the time that the wheels take to settle.
    let promised = reference / deceleration + deceleration / jerk;
    assert!(
        took as f32 * 1e-3 < promised + 0.1,
        "{took} ms, {promised} s"
    );
}
