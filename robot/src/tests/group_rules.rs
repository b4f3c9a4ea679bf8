//! The group rules, one test for each sentence.

use canopen::NmtCommand;
use kinematics::Twist;
use protocol::address as at;
use protocol::{Code, Fault, Limit, MemberState, MemberStatus, Scale, Value, cob};

use super::world::{DECELERATION, JERK, World};
use crate::state::State;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);

fn reference(world: &World, robot: usize) -> Twist {
    world.robots[robot].control.report().twist_ref()
}

/// Largest difference between any two members' references since the last call's end.
fn spread(world: &World) -> f32 {
    let first = reference(world, 0);
    let mut worst = 0.0_f32;
    for robot in 1..world.robots.len() {
        let difference = reference(world, robot) - first;
        worst = worst
            .max(difference.vx.abs())
            .max(difference.vy.abs())
            .max(difference.omega.abs());
    }
    worst
}

#[test]
fn rule_1_twist_is_latched_at_sync_and_published_with_its_sequence() {
    let mut world = World::started(&[2, 3]);
    world.drive(FORWARD, 100);
    world.until(10, |world| world.now % 10_000 == 2_000);
    let sequence = world.sequence;
    assert_eq!(world.status(2).sequence, sequence);
    // A setpoint that comes after SYNC is not latched before the next one.
    let frame = protocol::GroupTwist {
        twist: FORWARD,
        sequence: sequence + 1,
        group: super::world::GROUP,
    };
    world.send(1, cob::GROUP_TWIST, &frame.encode());
    world.run(5);
    assert_eq!(world.status(2).sequence, sequence);
}

#[test]
fn rule_1_permitted_scale_is_that_of_its_own_wheels() {
    let mut world = World::started(&[2, 3]);
    // 1 m/s forward is 6.562 rad/s; robot 3 can do 3.281.
    world.nmt(NmtCommand::EnterPreOperational, 0);
    world
        .write(3, at::WHEEL_RATE_MAX, Value::F32(0.5 / 0.1524))
        .unwrap();
    world.start();
    world.run(20);
    world.drive(Twist::new(1.0, 0.0, 0.0), 100);
    assert_eq!(world.status(2).scale, Scale::ONE);
    let scale = world.status(3).scale.factor();
    assert!((scale - 0.5).abs() < 1e-4, "scale {scale}");
}

#[test]
fn rule_2_twist_takes_effect_the_agreement_delay_after_its_sync() {
    // One robot needs nobody's vote, two lie in one class with eight, ten take a millisecond more;
    // a world's ticks come at whole milliseconds.
    let ten = [2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
    for (nodes, first_tick) in [(&[2][..], 2), (&[2, 3], 3), (&ten, 4)] {
        let mut world = World::started(nodes);
        world.release();
        world.run(10 - (world.now / 1000 % 10) as u32);
        world.twist = Some(FORWARD);
        // SYNC is in the first of these milliseconds, its tick at 0.
        for millis in 0..10 {
            world.step();
            for robot in 0..nodes.len() {
                let moves = reference(&world, robot).vx > 0.0;
                assert_eq!(moves, millis >= first_tick, "{nodes:?} {millis} ms");
            }
        }
    }
}

/// The group's own parameter, when it is given.
#[test]
fn rule_2_the_agreement_delay_is_a_parameter_of_the_group() {
    let mut world = World::new(&[2, 3]);
    world.configure();
    for node in [2, 3] {
        let delay = Value::U16(6_300);
        world.write(node, at::AGREEMENT_DELAY, delay).unwrap();
    }
    world.start();
    world.run(30);
    world.release();
    world.run(10 - (world.now / 1000 % 10) as u32);
    world.twist = Some(FORWARD);
    for millis in 0..10 {
        world.step();
        assert_eq!(reference(&world, 0).vx > 0.0, millis >= 7, "{millis} ms");
    }
    // As long as the period leaves.
    for (delay, fits) in [(9_300, true), (9_301, false)] {
        let mut world = World::new(&[2]);
        world.configure();
        let given = Value::U16(delay);
        world.write(2, at::AGREEMENT_DELAY, given).unwrap();
        let status = world.read(2, at::CONFIGURATION_STATUS).unwrap();
        assert_eq!(status == 0, fits, "{delay}: {status:#x}");
    }
}

/// The statuses of one member reach the others `late_us` after they were sent.
fn delayed(world: &mut World, late_us: u64, syncs: u32) {
    for _ in 0..syncs {
        world.until(10, |world| world.now.is_multiple_of(10_000));
        world.robots[2].holds = Some(late_us);
        world.run(10);
    }
    world.robots[2].holds = None;
}

/// A vote that comes after the agreement delay, but before the next SYNC: counted, reported, and
/// the group goes on. All are at the setpoint when the line to it ends.
#[test]
fn rule_2_a_late_vote_is_counted_and_stops_nothing() {
    let mut world = World::started(&[2, 3, 4]);
    world.drive(Twist::new(0.3, 0.0, 0.0), 1_000);
    assert_eq!(world.read(2, at::LATE_VOTES), Ok(0));
    // In time: 2 ms are less than the delay.
    delayed(&mut world, 2_000, 3);
    assert_eq!(world.read(2, at::LATE_VOTES), Ok(0));
    assert_eq!(world.read(2, at::LATEST_VOTE), Ok(2_000));
    for k in 0..5 {
        world.twist = Some(Twist::new(0.3 + 0.005 * k as f32, 0.0, 0.0));
        delayed(&mut world, 5_000, 1);
        // The line ends 2.3 ms after the next SYNC; by the next late vote all have been there.
        assert!(spread(&world) < 2e-3, "{}", spread(&world));
    }
    assert_eq!(world.read(2, at::LATE_VOTES), Ok(5));
    assert_eq!(world.read(3, at::LATE_VOTES), Ok(5));
    assert_eq!(world.read(2, at::LATEST_VOTE), Ok(5_000));
    // Whose vote it was has heard the others in time.
    assert_eq!(world.read(4, at::LATE_VOTES), Ok(0));
    world.run(10);
    let reported = |world: &World| {
        let statuses = world.log.iter().map(|(_, frame)| frame);
        let statuses = statuses.filter(|frame| frame.id() == cob::member_status(2));
        let codes = statuses.map(|frame| MemberStatus::try_from(frame.data()).unwrap().code);
        codes
            .filter(|code| *code == Code::Limit(Limit::LateVote))
            .count()
    };
    assert!(reported(&world) >= 4, "{}", reported(&world));
    world.run(100);
    assert!(spread(&world) < 1e-6);
    for robot in &world.robots {
        assert_eq!(robot.bus.state(), State::Moving);
    }
    assert_eq!(world.status(2).code, Code::None);
}

/// A vote that does not come before the next SYNC is a member that is silent.
#[test]
fn rule_3_a_vote_after_the_next_sync_stops_the_group() {
    let mut world = World::started(&[2, 3, 4]);
    world.drive(Twist::new(0.3, 0.0, 0.0), 1_000);
    delayed(&mut world, 10_000, 1);
    world.run(20);
    let fault = world.robots[0].bus.state().fault();
    assert_eq!(fault, Some(Fault::MemberSilent));
}

/// Until the next SYNC the others hold the setpoint in force.
#[test]
fn rule_3_a_setpoint_that_is_not_agreed_on_is_not_followed() {
    let mut world = World::started(&[2, 3, 4]);
    world.drive(Twist::new(0.3, 0.0, 0.0), 1_000);
    world.until(10, |world| world.now.is_multiple_of(10_000));
    world.robots[2].mute = true;
    world.twist = Some(Twist::new(0.32, 0.0, 0.0));
    for _ in 0..10 {
        world.step();
        for robot in 0..2 {
            let held = reference(&world, robot).vx;
            assert!((held - 0.3).abs() < 1e-4, "{held}");
        }
    }
    world.step();
    assert!(matches!(world.robots[0].bus.state(), State::Ramping(_)));
}

#[test]
fn rule_2_one_slow_member_slows_the_whole_body_and_the_body_keeps_its_shape() {
    let mut world = World::new(&[2, 3, 4]);
    world.configure();
    world
        .write(4, at::WHEEL_RATE_MAX, Value::F32(0.3 / 0.1524))
        .unwrap();
    world.start();
    world.run(30);
    world.release();
    world.twist = Some(FORWARD);
    for _ in 0..2000 {
        world.step();
        assert!(
            spread(&world) < 1e-6,
            "members differ by {}",
            spread(&world)
        );
    }
    for robot in &world.robots {
        assert!((robot.moves().vx - 0.3).abs() < 2e-3);
    }
    assert_eq!(world.status(4).code, Code::Limit(Limit::WheelRate));
    assert_eq!(world.status(2).code, Code::Limit(Limit::GroupScale));
}

/// A setpoint faster than the group may be is made slower, in its direction, whatever the wheels
/// could do; both limits count.
#[test]
fn rule_2_a_setpoint_beyond_the_groups_limits_is_scaled_down() {
    let asked = Twist::new(0.3, 0.4, 0.2);
    for (speed, yaw_rate, expected) in [
        (0.25, 0.0, 0.5),
        (0.0, 0.05, 0.25),
        (0.4, 0.1, 0.5),
        (0.5, 0.2, 1.0),
        (0.0, 0.0, 1.0),
    ] {
        let mut world = World::new(&[2, 3, 4]);
        world.configure();
        for node in [2, 3, 4] {
            for (address, limit) in [(at::SPEED_MAX, speed), (at::YAW_RATE_MAX, yaw_rate)] {
                world.write(node, address, Value::F32(limit)).unwrap();
            }
        }
        world.start();
        world.run(30);
        world.release();
        world.drive(asked, 2000);
        let held = reference(&world, 0);
        for (held, asked) in [
            (held.vx, asked.vx),
            (held.vy, asked.vy),
            (held.omega, asked.omega),
        ] {
            assert!((held - expected * asked).abs() < 1e-4, "{held} of {asked}");
        }
        let code = match expected < 1.0 {
            true => Code::Limit(Limit::GroupSpeed),
            false => Code::None,
        };
        assert_eq!(world.status(3).code, code, "{speed} {yaw_rate}");
    }
}

/// Drives, lets something happen, and checks that all that still drive ramp down together, along
/// the direction of motion, with the common deceleration, and hold.
fn ramps_down(happen: impl Fn(&mut World), still_drive: &[usize], fault: Fault) {
    let mut world = World::started(&[2, 3, 4]);
    let twist = Twist::new(0.6, 0.3, 0.2);
    world.drive(twist, 1500);
    happen(&mut world);
    let mut before = twist;
    let mut began = None;
    let mut worst_spread = 0.0_f32;
    for millis in 0..2500 {
        world.step();
        let now = reference(&world, still_drive[0]);
        if began.is_none() && now.vx < 0.599 {
            began = Some(millis);
        }
        if now.vx > 1e-3 {
            assert!((now.vy / now.vx - 0.5).abs() < 5e-3, "left its direction");
            assert!((now.omega / now.vx - 1.0 / 3.0).abs() < 5e-3);
            let speed = |twist: Twist| (twist.vx * twist.vx + twist.vy * twist.vy).sqrt();
            let deceleration = (speed(before) - speed(now)) / 1e-3;
            // f32 speeds near 0.67 have steps of 6e-8: 1e-3 of acceleration, with some to spare.
            assert!(deceleration < DECELERATION + 2e-3, "{deceleration}");
        }
        before = now;
        for robot in still_drive {
            let difference = reference(&world, *robot) - now;
            worst_spread = worst_spread.max(difference.vx.abs());
        }
    }
    // Those that notice one SYNC later are at most one period of deceleration behind.
    assert!(worst_spread < DECELERATION * 0.011, "spread {worst_spread}");
    for robot in still_drive {
        let robot = &world.robots[*robot];
        assert_eq!(robot.rates, [0.0; 4]);
        assert!(matches!(robot.bus.state(), State::Faulted(_)));
        assert!(!robot.outputs.brake_released && !robot.outputs.drivers_enabled);
    }
    let first = world.robots[still_drive[0]].node;
    assert_eq!(world.emergencies(first), [fault.code()]);
    // 0.671 m/s down at 1 m/s^2, and the jerk limit at both ends: 0.671 + 0.05 s.
    let began = began.expect("a ramp");
    assert!(began < 600, "began after {began} ms");
}

#[test]
fn rule_3_a_missing_member_stops_the_others_by_ramp() {
    ramps_down(
        |world| world.robots[2].mute = true,
        &[0, 1],
        Fault::MemberSilent,
    );
}

#[test]
fn rule_3_a_member_that_is_not_operational_stops_the_others_by_ramp() {
    ramps_down(
        |world| world.nmt(NmtCommand::EnterPreOperational, 4),
        &[0, 1],
        Fault::MemberSilent,
    );
}

#[test]
fn rule_3_a_member_in_fault_stops_the_others_by_ramp() {
    ramps_down(
        |world| world.robots[2].inputs.drive_fault = Some(Fault::DriverFault),
        &[0, 1],
        Fault::MemberStopped,
    );
}

#[test]
fn rule_3_a_member_with_another_sequence_stops_the_others_by_ramp() {
    ramps_down(
        |world| {
            // It misses one setpoint, and only that.
            world.run(5);
            world.until(10, |world| world.now.is_multiple_of(10_000));
            world.robots[2].deaf = true;
            world.sequence = world.sequence.wrapping_add(1);
            let frame = protocol::GroupTwist {
                twist: Twist::new(0.6, 0.3, 0.2),
                sequence: world.sequence,
                group: super::world::GROUP,
            };
            world.send(1, cob::GROUP_TWIST, &frame.encode());
            world.robots[2].deaf = false;
            let twist = world.twist.take();
            world.step();
            world.twist = twist;
        },
        &[0, 1],
        Fault::SequenceMismatch,
    );
}

#[test]
fn rule_3_emergency_stop_cuts_its_own_drivers_and_stops_the_rest_by_ramp() {
    ramps_down(
        |world| {
            world.robots[2].inputs.emergency_stop = true;
            world.step();
            let robot = &world.robots[2];
            assert!(!robot.outputs.drivers_enabled, "cut in the next tick");
            assert!(!robot.outputs.brake_released);
            assert_eq!(robot.outputs.given(), [0.0; 4]);
        },
        &[0, 1],
        Fault::MemberStopped,
    );
}

#[test]
fn rule_4_loss_of_the_masters_heartbeat_is_the_same_ramp() {
    ramps_down(
        |world| world.heartbeat = false,
        &[0, 1, 2],
        Fault::MasterSilent,
    );
}

#[test]
fn rule_4_loss_of_sync_is_the_same_ramp() {
    ramps_down(|world| world.sync = false, &[0, 1, 2], Fault::SyncLost);
}

#[test]
fn rule_4_an_overdue_setpoint_is_the_same_ramp() {
    ramps_down(
        |world| world.twist = None,
        &[0, 1, 2],
        Fault::SetpointOverdue,
    );
}

#[test]
fn rule_4_restart_needs_an_nmt_start() {
    let mut world = World::started(&[2, 3]);
    world.drive(FORWARD, 500);
    world.sync = false;
    world.run(1000);
    world.sync = true;
    // Everything is well again, and the master goes on as if nothing had been.
    world.run(500);
    for robot in &world.robots {
        assert_eq!(robot.bus.state(), State::Faulted(Fault::SyncLost));
        assert_eq!(robot.rates, [0.0; 4]);
    }
    world.start();
    world.drive(FORWARD, 500);
    for robot in &world.robots {
        assert_eq!(robot.bus.state(), State::Moving);
    }
}

#[test]
fn rule_4_restart_needs_a_new_sequence() {
    let mut world = World::started(&[2]);
    world.drive(FORWARD, 500);
    let old = world.sequence;
    world.twist = None;
    world.run(1000);
    world.start();
    for _ in 0..10 {
        let frame = protocol::GroupTwist {
            twist: FORWARD,
            sequence: old,
            group: super::world::GROUP,
        };
        world.send(1, cob::GROUP_TWIST, &frame.encode());
        world.run(10);
    }
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    world.drive(FORWARD, 100);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
}

#[test]
fn a_start_while_moving_or_ramping_changes_nothing() {
    let mut world = World::started(&[2, 3]);
    world.drive(FORWARD, 500);
    world.start();
    world.run(50);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    world.sync = false;
    world.run(100);
    world.sync = true;
    world.start();
    world.step();
    assert!(matches!(world.robots[0].bus.state(), State::Ramping(_)));
}

#[test]
fn leaving_operational_ramps_down_first() {
    let mut world = World::started(&[2]);
    world.drive(FORWARD, 1000);
    world.nmt(NmtCommand::Stop, 0);
    world.run(100);
    assert!(world.robots[0].outputs.drivers_enabled, "still braking");
    assert!(reference(&world, 0).vx > 0.4);
    world.run(900);
    assert_eq!(world.robots[0].bus.state(), State::Ready);
    assert_eq!(world.robots[0].outputs, control::interface::Outputs::SAFE);
    assert!(world.emergencies(2).is_empty());
}

#[test]
fn acceleration_and_jerk_are_bounded_and_the_same_in_every_member() {
    let mut world = World::started(&[2, 3, 4]);
    let mut velocity = Twist::ZERO;
    let mut acceleration = 0.0;
    for millis in 0..3000 {
        // The master asks for the impossible: full steps back and forth.
        world.twist = Some(if millis / 700 % 2 == 0 {
            Twist::new(0.9, 0.0, 0.0)
        } else {
            Twist::new(-0.9, 0.0, 0.0)
        });
        world.step();
        let now = reference(&world, 0);
        let slope = (now.vx - velocity.vx) / 1e-3;
        // Rounding of f32 near 1: 6e-8 a step.
        assert!(slope.abs() < super::world::MAX_ACCELERATION + 1e-3);
        assert!((slope - acceleration).abs() / 1e-3 < JERK + 0.5);
        assert!(spread(&world) < 1e-6);
        velocity = now;
        acceleration = slope;
    }
}

#[test]
fn a_member_that_restarts_never_jumps() {
    let mut world = World::started(&[2, 3]);
    world.drive(FORWARD, 1000);
    // Robot 3 leaves and is started again while the master goes on asking for full speed.
    world.nmt(NmtCommand::EnterPreOperational, 3);
    world.run(1500);
    world.start();
    let mut last = 0.0;
    for millis in 0..1100 {
        if millis == 100 {
            world.drive(FORWARD, 0);
        }
        world.step();
        for robot in 0..2 {
            let now = reference(&world, robot).vx;
            assert!((now - last).abs() < 0.002);
            assert!(spread(&world) < 1e-6);
        }
        last = reference(&world, 0).vx;
    }
    assert!((last - 0.6).abs() < 1e-3);
    assert_eq!(world.status(3).state, MemberState::Moving);
}
