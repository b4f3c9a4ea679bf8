//! One robot moved alone: what it does after a start, and when its permission is taken back.

use kinematics::Twist;
use protocol::{Value, address as at};

use super::neighbours::ask_alone;
use super::world::World;
use crate::state::State;

const SLOWLY: Twist = Twist::new(0.25, 0.0, 0.0);

/// One robot that is permitted to move alone.
fn permitted(parameters: &[(protocol::Address, Value)]) -> World {
    let mut world = World::new(&[2]);
    world.configure();
    for (address, value) in parameters {
        world.write(2, *address, *value).unwrap();
    }
    world.start();
    world.run(180);
    world.write(2, at::COMMISSIONING, Value::U8(1)).unwrap();
    world
}

/// A lever that is held while the emergency stop is pressed, let go and the robot started: nothing
/// moves until the lever has been in its middle at three SYNCs.
#[test]
fn after_a_start_a_lever_has_to_be_let_go_first() {
    let mut world = permitted(&[]);
    let mut sequence = 0;
    for stopped in [false, true] {
        if stopped {
            world.robots[0].inputs.emergency_stop = true;
            ask_alone(&mut world, SLOWLY, 5, &mut sequence);
            assert!(world.robots[0].bus.state().fault().is_some());
            world.robots[0].inputs.emergency_stop = false;
            ask_alone(&mut world, SLOWLY, 30, &mut sequence);
            world.start();
            world.write(2, at::COMMISSIONING, Value::U8(1)).unwrap();
        }
        ask_alone(&mut world, SLOWLY, 60, &mut sequence);
        assert_eq!(world.robots[0].bus.state(), State::Armed, "{stopped}");
        assert_eq!(world.robots[0].rates, [0.0; 4]);
        ask_alone(&mut world, Twist::ZERO, 2, &mut sequence);
        ask_alone(&mut world, SLOWLY, 5, &mut sequence);
        assert_eq!(world.robots[0].bus.state(), State::Armed, "too short");
        ask_alone(&mut world, Twist::ZERO, 3, &mut sequence);
        ask_alone(&mut world, SLOWLY, 80, &mut sequence);
        assert_eq!(world.robots[0].bus.state(), State::Alone, "{stopped}");
        assert!((world.robots[0].moves().vx - SLOWLY.vx).abs() < 2e-3);
    }
}

/// A permission that is taken back ends the motion as one that has run out: with a ramp at once,
/// from 0.25 m/s with 1.5 m/s^2 and 20 m/s^3 in some 0.3 s and 4 cm, whatever is asked for since.
#[test]
fn without_its_permission_it_stops() {
    for timeout in [100, 5_000] {
        let mut world = permitted(&[(at::SETPOINT_TIMEOUT, Value::U16(timeout))]);
        let mut sequence = 0;
        ask_alone(&mut world, Twist::ZERO, 5, &mut sequence);
        ask_alone(&mut world, SLOWLY, 80, &mut sequence);
        assert_eq!(world.robots[0].bus.state(), State::Alone);
        world.write(2, at::COMMISSIONING, Value::U8(0)).unwrap();
        let mut way = 0.0;
        for _ in 0..60 {
            ask_alone(&mut world, SLOWLY, 1, &mut sequence);
            way += world.robots[0].moves().vx * 0.01;
        }
        assert_eq!(world.robots[0].bus.state(), State::Ready);
        assert_eq!(world.robots[0].rates, [0.0; 4]);
        assert!(way < 0.06, "{way} m");
        assert!(world.emergencies(2).is_empty());
    }
}
