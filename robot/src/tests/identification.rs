//! Identification over the bus: asked for, refused, stopped, accepted.

use canopen::NmtCommand;
use protocol::address as at;
use protocol::{Fault, Value};

use super::world::{ACCELERATION, SPEED, STATIC_FRICTION, World};
use crate::state::State;
use control::interface::Outputs;

const DEVICE_STATE: u32 = 0x0800_0022;
const RUNNING: u32 = 1;

/// One robot, started and standing, without a setpoint.
fn armed() -> World {
    let world = World::started(&[2]);
    assert_eq!(world.robots[0].bus.state(), State::Armed);
    world
}

fn ask(world: &mut World) -> Result<(), u32> {
    world.write(2, at::COMMISSIONING, Value::U8(1))?;
    world.write(2, at::IDENTIFY, Value::U8(1))
}

fn status(world: &mut World) -> u32 {
    world.read(2, at::IDENTIFY_STATUS).unwrap() & 0xFF
}

fn result(world: &mut World, wheel: u16, sub: u8) -> f32 {
    f32::from_bits(world.read(2, at::identified::value(wheel, sub)).unwrap())
}

/// Until it is over; a run takes some 4 s with these motors.
fn finish(world: &mut World) -> u32 {
    world.until(20_000, |world| !world.robots[0].outputs.drivers_enabled);
    world.run(5);
    status(world)
}

#[test]
fn constants_of_the_motors_are_found_over_the_bus() {
    let mut world = armed();
    ask(&mut world).unwrap();
    world.run(100);
    assert_eq!(status(&mut world), RUNNING);
    assert_eq!(finish(&mut world), 2);
    for wheel in 0..4 {
        let near = |found: f32, known: f32, share: f32| {
            assert!(
                (found / known - 1.0).abs() < share,
                "{found} instead of {known}"
            );
        };
        // Euler steps of 0.1 ms in the test's motors are good to 0.1 ms of a time constant of 100
        // ms.
        near(result(&mut world, wheel, 2), SPEED, 0.01);
        near(result(&mut world, wheel, 3), ACCELERATION, 0.02);
        // 1 % of the ramp's voltage, 8 V.
        assert!((result(&mut world, wheel, 1) - STATIC_FRICTION).abs() < 0.08);
        // 2 * 10 rad/s * kA - kV, and kA * (10 rad/s)^2.
        near(
            result(&mut world, wheel, 4),
            2.0 * 10.0 * ACCELERATION - SPEED,
            0.05,
        );
        near(result(&mut world, wheel, 5), 100.0 * ACCELERATION, 0.02);
    }
    // At rest, well, and off until the next start; and nothing has taken effect.
    assert_eq!(world.robots[0].bus.state(), State::Ready);
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    let before = f32::from_bits(world.read(2, at::motor::proportional(0)).unwrap());
    assert_eq!(before.to_bits(), 2.0_f32.to_bits());
    world.run(500);
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    world.start();
    world.run(20);
    assert_eq!(world.robots[0].bus.state(), State::Armed);
}

#[test]
fn it_is_refused_unless_wheels_are_declared_free_and_the_robot_stands_started() {
    // Started, but nothing declared.
    let mut world = armed();
    assert_eq!(
        world.write(2, at::IDENTIFY, Value::U8(1)),
        Err(DEVICE_STATE)
    );
    // Declared, but not started.
    world.nmt(NmtCommand::EnterPreOperational, 2);
    assert_eq!(ask(&mut world), Err(DEVICE_STATE));
    // Declared, but moving with its group.
    let mut world = World::started(&[2]);
    world.drive(kinematics::Twist::new(0.3, 0.0, 0.0), 500);
    assert_eq!(ask(&mut world), Err(DEVICE_STATE));
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    assert_eq!(status(&mut world), 0);
}

/// What ends it in the middle, and the status it then has.
fn ends(change: impl Fn(&mut World)) -> (u32, World) {
    let mut world = armed();
    ask(&mut world).unwrap();
    world.run(1_500);
    assert!(world.robots[0].rates[0] > 0.5, "it turns");
    change(&mut world);
    world.run(1_000);
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
    assert_eq!(world.robots[0].rates, [0.0; 4]);
    (status(&mut world), world)
}

#[test]
fn it_ends_at_once_when_the_master_says_so_or_is_gone() {
    let stop = |world: &mut World| world.write(2, at::IDENTIFY, Value::U8(0)).unwrap();
    assert_eq!(ends(stop).0, 3);
    let forbid = |world: &mut World| world.write(2, at::COMMISSIONING, Value::U8(0)).unwrap();
    assert_eq!(ends(forbid).0, 3);
    let leave = |world: &mut World| world.nmt(NmtCommand::EnterPreOperational, 2);
    assert_eq!(ends(leave).0, 3);
    let (_, world) = ends(|world| world.heartbeat = false);
    assert_eq!(
        world.robots[0].bus.state().fault(),
        Some(Fault::MasterSilent)
    );
    let (_, world) = ends(|world| world.sync = false);
    assert_eq!(world.robots[0].bus.state().fault(), Some(Fault::SyncLost));
}

#[test]
fn any_fault_ends_it() {
    type Cause = fn(&mut World);
    let causes: [(Cause, Fault); 3] = [
        (
            |world| world.robots[0].inputs.emergency_stop = true,
            Fault::EmergencyStop,
        ),
        (
            |world| world.robots[0].inputs.drive_fault = Some(Fault::DriverFault),
            Fault::DriverFault,
        ),
        (
            |world| {
                world.robots[0].ticking = false;
                world.run(25);
                world.robots[0].ticking = true;
            },
            Fault::ControlLate,
        ),
    ];
    for (cause, fault) in causes {
        let (status, world) = ends(cause);
        assert_eq!(status, 4, "{fault:?}");
        assert_eq!(world.robots[0].bus.state().fault(), Some(fault));
    }
}

#[test]
fn a_dead_encoder_ends_it_and_names_the_wheel() {
    let mut world = armed();
    world.robots[0].encoder_sign[3] = 0.0;
    ask(&mut world).unwrap();
    assert_eq!(finish(&mut world), 8);
    assert_eq!(world.read(2, at::IDENTIFY_WHEEL).unwrap() & 0xFF, 3);
    // A quarter of 24 V is reached after 2.5 s; the wheels that turn are then at (6 - 0.5) / 1.5
    // rad/s.
    assert!(world.now < 3_500_000, "{} us", world.now);
}

#[test]
fn a_reversed_motor_ends_it_before_it_is_fast() {
    let mut world = armed();
    world.robots[0].encoder_sign[1] = -1.0;
    ask(&mut world).unwrap();
    let fastest = core::cell::Cell::new(0.0_f64);
    world.until(5_000, |world| {
        fastest.set(fastest.get().max(world.robots[0].rates[1].abs()));
        !world.robots[0].outputs.drivers_enabled
    });
    assert_eq!(status(&mut world), 9);
    assert!(fastest.get() < 1.0, "{} rad/s", fastest.get());
}

#[test]
fn measured_supply_is_corrected_for() {
    // 20 V instead of 24 V: duties a fifth larger, the same volts, the same result.
    let mut world = World::new(&[2]);
    world.configure();
    world
        .write(2, at::SUPPLY_MINIMUM, Value::F32(15.0))
        .unwrap();
    world.robots[0].set_supply(20.0);
    world.start();
    world.run(30);
    ask(&mut world).unwrap();
    assert_eq!(finish(&mut world), 2);
    let speed = result(&mut world, 0, 2);
    assert!((speed / SPEED - 1.0).abs() < 0.01, "{speed}");
}

/// Who is asked which robot it is blinks for so long, in any state, and says how much is left.
#[test]
fn blinks_when_asked() {
    let mut world = World::new(&[2, 3]);
    let blinks = |world: &World| [0, 1].map(|n: usize| world.robots[n].bus.blinks());
    world.write(2, at::BLINK, Value::U8(3)).unwrap();
    world.run(1_500);
    assert_eq!(blinks(&world), [true, false]);
    assert_eq!(world.read(2, at::BLINK).unwrap() & 0xFF, 2);
    world.run(1_600);
    assert_eq!(blinks(&world), [false, false]);
    world.write(2, at::BLINK, Value::U8(200)).unwrap();
    world.write(2, at::BLINK, Value::U8(0)).unwrap();
    world.run(20);
    assert_eq!(blinks(&world), [false, false]);
}
