//! Numbers of fixed point that do not fit are counted, and floats have none.

use kinematics::Twist;
use protocol::address as at;

use super::world::World;

/// Of the group, m/s: half of what the wheels can.
const SPEED: f32 = 0.75;

const IS_FIXED: bool = cfg!(feature = "fixed-point");

/// Every direction at full speed, each reached from the opposite one, and the ramp of a stop.
#[test]
fn ordinary_driving_saturates_nothing() {
    let mut world = World::started(&[2]);
    world.release();
    let directions = [
        Twist::new(SPEED, 0.0, 0.0),
        Twist::new(0.0, SPEED, 0.0),
        Twist::new(0.0, 0.0, 0.5),
        Twist::new(0.5 * SPEED, -0.5 * SPEED, 0.3),
    ];
    for twist in directions {
        world.drive(twist, 1_000);
        world.drive(twist * -1.0, 1_000);
    }
    world.robots[0].inputs.emergency_stop = true;
    world.run(500);
    assert_eq!(world.read(2, at::SATURATED_TICKS), Ok(0));
}

/// A counter that jumps by half its range: the wheel's rate does not fit for a few ticks.
#[test]
fn an_encoder_that_jumps_is_counted_until_its_rate_fits_again() {
    let mut world = World::started(&[2]);
    world.release();
    world.drive(Twist::new(SPEED, 0.0, 0.0), 1_000);
    assert_eq!(world.read(2, at::SATURATED_TICKS), Ok(0));
    world.robots[0].stray[0] += 32_000;
    world.run(1_000);
    let counted = world.read(2, at::SATURATED_TICKS).unwrap();
    assert_eq!(counted > 0, IS_FIXED, "{counted}");
    assert!(counted < 100, "{counted}");
    world.run(1_000);
    assert_eq!(world.read(2, at::SATURATED_TICKS), Ok(counted));
}
