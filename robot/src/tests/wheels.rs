//! Robots whose wheels differ, gears, and the history of limits.

use kinematics::Twist;
use protocol::address::{self as at, history, wheel};
use protocol::{Limit, Value};

use super::world::{COUNTS, World};
use crate::Hardware;
use crate::configuration::build;

/// Half the ordinary robot of the tests; the rest comes from the table.
const X: f32 = 0.35;
const Y: f32 = 0.37;
const RADIUS: f32 = 0.1524;
const ANGLE: f32 = core::f32::consts::FRAC_PI_4;

fn describe(world: &mut World, wheels: [[f32; 5]; 4]) {
    for (place, [x, y, radius, angle, counts]) in (0..).zip(wheels) {
        for (address, value) in [
            (wheel::x(place), x),
            (wheel::y(place), y),
            (wheel::radius(place), radius),
            (wheel::roller_angle(place), angle),
            (wheel::encoder_counts(place), counts),
        ] {
            world.write(2, address, Value::F32(value)).unwrap();
        }
    }
    world.write(2, at::INDIVIDUAL_WHEELS, Value::U8(1)).unwrap();
}

const ORDINARY: [[f32; 5]; 4] = [
    [X, Y, RADIUS, ANGLE, 0.0],
    [X, -Y, RADIUS, -ANGLE, 0.0],
    [-X, Y, RADIUS, -ANGLE, 0.0],
    [-X, -Y, RADIUS, ANGLE, 0.0],
];

/// The ordinary robot, described wheel by wheel, is the same robot.
#[test]
fn wheels_described_one_by_one_make_the_same_robot() {
    let twist = Twist::new(0.3, -0.2, 0.4);
    let rates = [false, true].map(|individual| {
        let mut world = World::new(&[2]);
        world.configure();
        if individual {
            describe(&mut world, ORDINARY);
        }
        assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(0));
        world.start();
        world.run(30);
        world.drive(twist, 1500);
        <[f32; 4]>::from(world.robots[0].control.report().rates_ref())
    });
    for (one, other) in rates[0].iter().zip(rates[1]) {
        assert!((one - other).abs() < 1e-4, "{rates:?}");
    }
}

/// A front left wheel of half the radius turns twice as fast; one with half the counts is still
/// measured right.
#[test]
fn a_wheel_of_another_size_turns_at_another_rate() {
    let mut world = World::new(&[2]);
    world.configure();
    let mut wheels = ORDINARY;
    wheels[0][2] = RADIUS / 2.0;
    describe(&mut world, wheels);
    world.start();
    world.run(30);
    world.drive(Twist::new(0.3, 0.0, 0.0), 1500);
    let rates = world.robots[0].control.report().rates_ref();
    assert!((rates.front_left - 2.0 * 0.3 / RADIUS).abs() < 1e-3);
    assert!((rates.front_right - 0.3 / RADIUS).abs() < 1e-3);
}

#[test]
fn counts_and_gear_make_the_step() {
    let mut world = World::new(&[2]);
    world.configure();
    let step = |world: &World, place: usize| {
        let parameters = world.robots[0].bus.parameters();
        build(parameters, 2, Hardware::NUCLEO_F446RE)
            .unwrap()
            .wheels[place]
            .step
    };
    let turn = core::f32::consts::TAU;
    assert!((step(&world, 1) / (turn / COUNTS) - 1.0).abs() < 1e-6);
    world.write(2, at::GEAR_RATIO, Value::F32(20.0)).unwrap();
    let counts = wheel::encoder_counts(1);
    world.write(2, counts, Value::F32(1000.0)).unwrap();
    // 4096 and 1000 counts a revolution of the shaft, 20 of those in one of the wheel.
    assert!((step(&world, 0) / (turn / (COUNTS * 20.0)) - 1.0).abs() < 1e-6);
    assert!((step(&world, 1) / (turn / 20_000.0) - 1.0).abs() < 1e-6);
}

#[test]
fn wheels_that_make_no_robot_are_named() {
    let object = |address: protocol::Address| address.packed() << 8 | 2;
    for (place, field, value, blamed) in [
        (2, 2, 0.0, wheel::radius(2)),
        (3, 3, 0.0, wheel::roller_angle(3)),
        // Rollers all alike leave a direction without control.
        (0, 3, -ANGLE, at::INDIVIDUAL_WHEELS),
    ] {
        let mut world = World::new(&[2]);
        world.configure();
        let mut wheels = ORDINARY;
        wheels[place][field] = value;
        if blamed == at::INDIVIDUAL_WHEELS {
            wheels[3][3] = -ANGLE;
        }
        describe(&mut world, wheels);
        assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(object(blamed)));
    }
}

/// A limit is kept once, with its time, however long it lasts; the next one goes in front.
#[test]
fn limits_are_remembered_with_their_time() {
    let mut world = World::started(&[2]);
    let code = |world: &mut World, nth| world.read(2, history::limit_code(nth)).unwrap();
    let before = code(&mut world, 1);
    // The wheels of the tests end at 10 rad/s: 1.52 m/s.
    world.drive(Twist::new(2.0, 0.0, 0.0), 3000);
    let limit = u32::from(Limit::WheelRate.code());
    assert_eq!(code(&mut world, 1), limit);
    let first = world.read(2, history::limit_time(1)).unwrap();
    let now = u32::try_from((world.now + world.robots[0].offset) / 1000).unwrap();
    assert!(first > 0 && first < now);
    world.run(500);
    assert_eq!(world.read(2, history::limit_time(1)), Ok(first));
    assert!(before != limit || code(&mut world, 2) != limit);
}
