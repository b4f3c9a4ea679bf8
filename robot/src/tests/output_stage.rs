//! Torque, supply and bridge: what a robot commands at its outputs, and which parameters it
//! refuses.

use kinematics::Twist;
use protocol::address::{self as at, motor, rollers};
use protocol::{Address, Fault, Limit, Value};

use super::world::{ANY_DRIVES, SPEED, SUPPLY, World};
use crate::Hardware;
use crate::configuration::build;
use crate::state::State;
use control::interface::Outputs;
use control::quantity::InputVoltage;
use control::smart_drive::index::index_error;

const FORWARD: Twist = Twist::new(0.6, 0.0, 0.0);
/// Of a motor of these tests.
const RESISTANCE: f32 = 0.3;
const CURRENT: f32 = 15.0;

/// A robot with these parameters besides the usual ones, started.
fn world_with(parameters: &[(Address, Value)]) -> World {
    let mut world = World::new(&[2]);
    world.configure();
    for (address, value) in parameters {
        assert_eq!(world.write(2, *address, *value), Ok(()), "{address:?}");
    }
    world
}

fn started(parameters: &[(Address, Value)]) -> World {
    let mut world = world_with(parameters);
    assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(0));
    world.robots[0].set_supply(SUPPLY);
    world.start();
    world.run(30);
    world
}

fn torque() -> [(Address, Value); 2] {
    [
        (at::WINDING_RESISTANCE, Value::F32(RESISTANCE)),
        (at::CURRENT_MAX, Value::F32(CURRENT)),
    ]
}

/// Current of a wheel's motor, A: what is left of the voltage beside the back EMF, over the
/// resistance.
fn current(world: &World, wheel: usize) -> f64 {
    let robot = &world.robots[0];
    let voltage = f64::from(robot.outputs.given()[wheel] * SUPPLY);
    (voltage - f64::from(SPEED) * robot.rates[wheel]) / f64::from(RESISTANCE)
}

/// A kerb stops all four wheels at once, so that the slip residual tells nothing: only the torque
/// bound helps.
#[test]
fn a_stall_is_no_more_than_the_largest_current() {
    let mut world = started(&torque());
    world.drive(FORWARD, 1_000);
    let rate = world.robots[0].rates[0];
    world.robots[0].blocked = [true; 4];
    let mut limited = false;
    for millis in 0..1_500 {
        world.step();
        if !world.robots[0].outputs.drivers_enabled {
            break;
        }
        let amperes = current(&world, 0);
        // The rate estimate trails a wheel that is stopped short.
        let trail = if millis < 120 {
            f64::from(SPEED) * rate / f64::from(RESISTANCE)
        } else {
            0.1 * f64::from(CURRENT)
        };
        let most = f64::from(CURRENT) + trail;
        assert!(amperes.abs() <= most, "{amperes} A after {millis} ms");
        let code = world.robots[0].control.report().limit;
        limited |= code == Some(Limit::Torque);
    }
    assert!(limited, "the limit is reported");
    assert_eq!(world.robots[0].outputs, Outputs::SAFE);
}

#[test]
fn without_a_largest_current_the_bound_is_half_of_the_supply() {
    let mut world = started(&[]);
    world.drive(FORWARD, 1_000);
    world.robots[0].blocked = [true; 4];
    world.run(60);
    assert!(world.robots[0].outputs.drivers_enabled);
    for duty in world.robots[0].outputs.given() {
        assert!(duty.abs() <= 0.5 + 0.01, "{duty}");
    }
}

/// Both motions of a group's day stay below the bound: it must not cost tracking.
#[test]
fn the_bound_is_not_met_in_ordinary_motion() {
    let mut world = started(&torque());
    for twist in [FORWARD, FORWARD * -1.0, Twist::new(0.0, 0.5, 0.3)] {
        world.twist = Some(twist);
        for _ in 0..2_000 {
            world.step();
            let limit = world.robots[0].control.report().limit;
            assert_ne!(limit, Some(Limit::Torque), "{twist:?}");
        }
    }
}

fn measured() -> [(Address, Value); 3] {
    [
        (at::SUPPLY_MINIMUM, Value::F32(18.0)),
        (at::SUPPLY_MAXIMUM, Value::F32(30.0)),
        (at::SUPPLY_MARGIN, Value::F32(1.0)),
    ]
}

#[test]
fn a_high_supply_cuts() {
    for volts in [30.5, 36.3] {
        let mut world = started(&measured());
        world.drive(FORWARD, 1_000);
        world.robots[0].set_supply(volts);
        let took = world.until(50, |world| !world.robots[0].outputs.drivers_enabled);
        assert!((10..=12).contains(&took), "{took} ms");
        world.run(5);
        let state = world.robots[0].bus.state();
        assert_eq!(state, State::Faulted(Fault::SupplyHigh));
        assert_eq!(world.emergencies(2), [0x3210]);
    }
}

/// The divider's ground is open: the input shows the end of its range, whatever is allowed.
#[test]
fn an_input_at_the_end_of_its_range_cuts_without_a_maximum() {
    let mut world = started(&[(at::SUPPLY_MINIMUM, Value::F32(18.0))]);
    world.drive(FORWARD, 1_000);
    world.robots[0].set_supply(36.29);
    world.until(50, |world| !world.robots[0].outputs.drivers_enabled);
    let fault = world.robots[0].control.report().fault;
    assert_eq!(fault, Some(Fault::SupplyHigh));
}

#[test]
fn a_supply_close_to_its_minimum_is_reported() {
    let mut world = started(&measured());
    world.drive(FORWARD, 1_000);
    assert_eq!(world.status(2).code, protocol::Code::None);
    world.robots[0].set_supply(18.5);
    world.run(50);
    let low = protocol::Code::Limit(Limit::Supply);
    assert_eq!(world.status(2).code, low);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
}

/// One Hall sensor of 40 A/V around 1.65 V that sees all motors: 4 x 15 A x 1.25 are 75 A, and it
/// shows 65.9 A. Two branches show 131.8 A.
fn sensed() -> [(Address, Value); 5] {
    let [resistance, largest] = torque();
    [
        resistance,
        largest,
        (at::CURRENT_SCALE, Value::F32(40.0)),
        (at::CURRENT_OFFSET, Value::F32(1.65)),
        (at::CURRENT_INPUTS, Value::U8(2)),
    ]
}

/// What two sensors show, V, when each sees this, A; nothing is connected to the third input.
fn shown(amperes: f32) -> Option<[f32; 3]> {
    let volts = 1.65 + amperes / 40.0;
    Some([volts, volts, 0.0])
}

#[test]
fn too_much_current_cuts_after_20_ms_and_not_before() {
    for amperes in [38.0, -38.0] {
        let mut world = started(&sensed());
        world.robots[0].inputs.current_inputs = shown(37.0);
        world.drive(FORWARD, 1_000);
        assert_eq!(world.robots[0].bus.state(), State::Moving, "74 of 75 A");
        let read = f32::from_bits(world.read(2, at::CURRENT).unwrap());
        assert!((read - 74.0).abs() < 1e-3, "{read} A");
        world.robots[0].inputs.current_inputs = shown(amperes);
        world.run(19);
        assert!(world.robots[0].outputs.drivers_enabled);
        world.robots[0].inputs.current_inputs = shown(0.0);
        world.run(1);
        world.robots[0].inputs.current_inputs = shown(amperes);
        let took = world.until(50, |world| !world.robots[0].outputs.drivers_enabled);
        assert!((20..=22).contains(&took), "{took} ms");
        world.run(5);
        let state = world.robots[0].bus.state();
        assert_eq!(state, State::Faulted(Fault::OverCurrent));
        assert_eq!(world.emergencies(2), [0xFF20]);
    }
}

/// A bound on a current that is not measured would protect nothing.
#[test]
fn a_current_sensor_is_refused_where_the_board_has_no_input() {
    let hardware = Hardware {
        current_inputs: 0,
        ..ANY_DRIVES
    };
    let mut world = World::on(hardware, &[2]);
    world.configure();
    let refused = at::CURRENT_SCALE.packed() << 8 | 2;
    for (parameters, status) in [(&sensed()[..2], 0), (&sensed()[2..], refused)] {
        for (address, value) in parameters {
            assert_eq!(world.write(2, *address, *value), Ok(()), "{address:?}");
        }
        assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(status));
    }
    world.robots[0].set_supply(SUPPLY);
    world.start();
    world.run(30);
    assert_eq!(
        world.robots[0].bus.state(),
        State::Faulted(Fault::Unconfigured)
    );
}

/// A wire that is off or shorted refuses a start, too: what is not measured is not bounded.
#[test]
fn a_current_sensor_at_the_end_of_its_range_refuses_a_start() {
    for volts in [0.0, 3.3] {
        let mut world = world_with(&sensed());
        world.robots[0].inputs.current_inputs = Some([1.65, volts, 0.0]);
        world.run(30);
        world.start();
        for _ in 0..30 {
            world.step();
            assert_eq!(world.robots[0].outputs, Outputs::SAFE, "{volts} V");
        }
        assert_eq!(world.emergencies(2), [0xFF20]);
    }
}

#[test]
fn without_a_scale_no_current_is_too_much() {
    let mut world = started(&torque());
    world.robots[0].inputs.current_inputs = Some([3.3; 3]);
    world.drive(FORWARD, 1_000);
    assert_eq!(world.robots[0].bus.state(), State::Moving);
    assert_eq!(world.read(2, at::CURRENT), Ok(0));
}

#[test]
fn another_divider_measures_another_supply() {
    let mut world = world_with(&[
        (at::SUPPLY_NOMINAL, Value::F32(48.0)),
        (at::SUPPLY_MINIMUM, Value::F32(40.0)),
        (at::SUPPLY_DIVIDER, Value::F32(22.0)),
    ]);
    assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(0));
    world.robots[0].inputs.supply_input = Some(InputVoltage::new(48.0 / 22.0));
    world.start();
    world.run(50);
    let volts = f32::from_bits(world.read(2, at::SUPPLY).unwrap());
    assert!((volts - 48.0).abs() < 1e-3, "{volts} V");
}

#[test]
fn no_duty_is_larger_than_the_largest() {
    let mut world = started(&[(at::DUTY_MAX, Value::F32(0.3))]);
    world.release();
    // 24 V * 0.3 are good for 4.5 rad/s.
    world.twist = Some(Twist::new(0.9, 0.0, 0.0));
    let mut most = 0.0_f32;
    for _ in 0..2_000 {
        world.step();
        let duty = world.robots[0].outputs.given()[0];
        most = most.max(duty);
        assert!(duty <= 0.3 + 1e-6, "{duty}");
    }
    assert!(most > 0.299, "{most}");
    assert_eq!(world.robots[0].control.report().limit, Some(Limit::Voltage));
}

#[test]
fn a_bridge_rests_before_it_changes_its_direction_if_asked() {
    for (pause, wanted) in [(0, false), (1, true)] {
        let mut world = started(&[(at::DIRECTION_PAUSE, Value::U8(pause))]);
        world.release();
        let mut last = [0.0_f32; 4];
        let mut straight = 0;
        for period in 0..6 {
            let sign = if period % 2 == 0 { 1.0 } else { -1.0 };
            world.twist = Some(FORWARD * sign);
            for _ in 0..1_000 {
                world.step();
                let duty = world.robots[0].outputs.given();
                for (now, before) in duty.iter().zip(last) {
                    straight += u32::from(now * before < 0.0);
                }
                last = duty;
            }
        }
        assert_eq!(straight == 0, wanted, "{straight} changes without a pause");
        let vx = world.robots[0].moves().vx;
        assert!((vx + 0.6).abs() < 0.01, "{vx}");
    }
}

#[test]
fn parameters_that_do_not_fit_are_refused_by_name() {
    let real = Value::F32;
    let cases: &[(&[(Address, Value)], Address)] = &[
        (&[(at::CURRENT_MAX, real(20.0))], at::WINDING_RESISTANCE),
        (&[(at::WINDING_RESISTANCE, real(0.3))], at::CURRENT_MAX),
        // 0.3 V do not turn a wheel that needs 0.5 V.
        (
            &[
                (at::WINDING_RESISTANCE, real(0.3)),
                (at::CURRENT_MAX, real(1.0)),
            ],
            at::CURRENT_MAX,
        ),
        (&[(at::SUPPLY_MAXIMUM, real(23.0))], at::SUPPLY_MAXIMUM),
        // A bound is needed, and a sensor that shows more: 65.9 A are less than 75 A.
        (&[(at::CURRENT_SCALE, real(40.0))], at::CURRENT_SCALE),
        (
            &[
                (at::WINDING_RESISTANCE, real(RESISTANCE)),
                (at::CURRENT_MAX, real(CURRENT)),
                (at::CURRENT_SCALE, real(40.0)),
                (at::CURRENT_OFFSET, real(1.65)),
            ],
            at::CURRENT_SCALE,
        ),
        (
            &[
                (at::SUPPLY_MINIMUM, real(18.0)),
                (at::SUPPLY_DIVIDER, real(6.0)),
            ],
            at::SUPPLY_DIVIDER,
        ),
        // 1.5 m/s and 0.4 m/s^2: 3.8 s; the watchdog waits for 3 s.
        (&[(at::DECELERATION, real(0.4))], at::DECELERATION),
        // 0.89 rad/s about a point 1 m away, and 0.25 rad/s^2: 3.5 s.
        (&[(at::DECELERATION_YAW, real(0.25))], at::DECELERATION_YAW),
        // What the group may do is less than its wheels can, and still too much: 0.8 rad/s.
        (
            &[
                (at::DECELERATION_YAW, real(0.25)),
                (at::YAW_RATE_MAX, real(0.8)),
            ],
            at::DECELERATION_YAW,
        ),
        // 11 rad/s, a million counts: 35 000 counts in 20 ms.
        (
            &[
                (at::WHEEL_RATE_MAX, real(11.0)),
                (at::ENCODER_COUNTS, real(40_000.0)),
                (at::GEAR_RATIO, real(25.0)),
            ],
            at::ENCODER_COUNTS,
        ),
        (
            &[
                (motor::speed(2), real(0.0)),
                (motor::proportional(2), real(0.0)),
                (motor::integral(2), real(0.0)),
            ],
            motor::proportional(2),
        ),
        (&[(at::SYNC_PERIOD, Value::U32(10_500))], at::SYNC_PERIOD),
    ];
    for (parameters, blamed) in cases {
        let mut world = world_with(parameters);
        let status = world.read(2, at::CONFIGURATION_STATUS);
        assert_eq!(status, Ok(blamed.packed() << 8 | 2), "{parameters:?}");
        world.start();
        world.run(50);
        assert_eq!(world.robots[0].outputs, Outputs::SAFE, "{parameters:?}");
    }
    // A group that turns slowly, 0.6 rad/s, stands after 2.4 s.
    let slow = [
        (at::DECELERATION_YAW, real(0.25)),
        (at::YAW_RATE_MAX, real(0.6)),
    ];
    let status = world_with(&slow).read(2, at::CONFIGURATION_STATUS);
    assert_eq!(status, Ok(0));
}

/// What C620 drives need to be told beside their kind.
fn smart(changed: &[(Address, Value)]) -> std::vec::Vec<(Address, Value)> {
    let mut parameters = std::vec![
        (at::OUTPUT_STAGE, Value::U8(4)),
        (at::ENCODER_COUNTS, Value::F32(8192.0)),
        (at::GEAR_RATIO, Value::F32(3591.0 / 187.0)),
        (at::WINDING_RESISTANCE, Value::F32(RESISTANCE)),
        (at::CURRENT_MAX, Value::F32(CURRENT)),
    ];
    parameters.extend_from_slice(changed);
    parameters
}

/// Their enable is not wired, and identifiers may be in any order.
#[test]
fn smart_drives_are_refused_without_what_they_need() {
    let real = Value::F32;
    let crossed = [
        (at::DRIVE_FRONT_LEFT, Value::U8(4)),
        (at::DRIVE_REAR_RIGHT, Value::U8(1)),
    ];
    let c610 = [
        (at::OUTPUT_STAGE, Value::U8(5)),
        (at::CURRENT_MAX, real(10.0)),
    ];
    for fits in [&[][..], &crossed, &c610] {
        let world = &mut world_with(&smart(fits));
        assert_eq!(world.read(2, at::CONFIGURATION_STATUS), Ok(0), "{fits:?}");
    }
    let cases: [(&[_], _); 5] = [
        (
            &[
                (at::WINDING_RESISTANCE, real(0.0)),
                (at::CURRENT_MAX, real(0.0)),
            ],
            at::WINDING_RESISTANCE,
        ),
        (&[(at::CURRENT_MAX, real(20.5))], at::CURRENT_MAX),
        // 15 A are more than a C610 gives.
        (&[(at::OUTPUT_STAGE, Value::U8(5))], at::CURRENT_MAX),
        (&[(at::ENCODER_COUNTS, real(2048.0))], at::ENCODER_COUNTS),
        (&[(at::DRIVE_REAR_LEFT, Value::U8(1))], at::DRIVE_REAR_LEFT),
    ];
    for (changed, blamed) in cases {
        let mut world = world_with(&smart(changed));
        let status = world.read(2, at::CONFIGURATION_STATUS);
        assert_eq!(status, Ok(blamed.packed() << 8 | 2), "{changed:?}");
    }
}

/// The counts of an index come from a report and a time: two of them may be off by more the faster
/// the wheel may turn, beside the play that a robot is told.
#[test]
fn two_indexes_of_a_smart_drive_may_differ_by_what_their_counts_are_off() {
    let tolerance = |parameters: &[_]| {
        let mut world = world_with(parameters);
        let wanted = [
            (rollers::count(0), Value::U8(8)),
            (at::ROLLER_REFERENCE, Value::U8(1)),
            (at::INDEX_TOLERANCE, Value::U16(80)),
        ];
        for (address, value) in wanted {
            world.write(2, address, value).unwrap();
        }
        let parameters = world.robots[0].bus.parameters();
        let configuration = build(parameters, 2, ANY_DRIVES).unwrap();
        let rolling = configuration.drivetrain.rolling().unwrap();
        (
            rolling.rollers().tolerance(),
            parameters.real(at::WHEEL_RATE_MAX),
        )
    };
    let (with_counters, _) = tolerance(&[]);
    assert_eq!(with_counters, 64, "a 64th of a turn of 4096 counts");
    let (with_drives, rate) = tolerance(&smart(&[]));
    let counts_per_rad = 8192.0 * 3591.0 / 187.0 / core::f32::consts::TAU;
    let error = index_error(rate * counts_per_rad);
    assert!(error > 20.0, "{error} counts at {rate} rad/s");
    assert!(
        (with_drives as f32 - 80.0 - 2.0 * error).abs() <= 1.0,
        "{with_drives}"
    );
}

/// Fixed point has less room than the object dictionary (docs/numbers.md); what does not fit is
/// refused by name. Single precision takes all of it.
#[test]
fn what_the_tick_has_no_numbers_for_is_refused_by_name() {
    let refused = |address: Address| {
        let code = address.packed() << 8 | 2;
        if cfg!(feature = "fixed-point") {
            code
        } else {
            0
        }
    };
    for wheel in 0..4 {
        let gain = motor::acceleration(wheel);
        for (value, status) in [(7.9, 0), (8.0, refused(gain)), (50.0, refused(gain))] {
            let mut world = world_with(&[(gain, Value::F32(value))]);
            assert_eq!(
                world.read(2, at::CONFIGURATION_STATUS),
                Ok(status),
                "{value}"
            );
        }
    }
    // 16 counts a turn of a shaft that turns once in fifty of the wheel: 20 rad.
    let coarse = [
        (at::ENCODER_COUNTS, Value::F32(16.0)),
        (at::GEAR_RATIO, Value::F32(0.02)),
    ];
    let mut world = world_with(&coarse);
    let status = world.read(2, at::CONFIGURATION_STATUS);
    assert_eq!(status, Ok(refused(at::GEAR_RATIO)));
}
