//! Each kind of motor driver on the release image: the robot drives straight, every stop leaves the
//! bridges without voltage, and a driver of another kind than the robot was told is found by the
//! wheel test. What a driver makes of the board's pins is `sim::bridge`.
//!
//! `OMNIBUS_ELF` names the image, `OMNIBUS_ELF_TWO_PWMS` that with two PWMs a wheel (`cargo xtask
//! test` builds both and says so).

mod common;

use emulator::{Board, PinLevel, Port};
use group::{Driver, GroupFile, StageKind};
use kinematics::Twist;
use omnibus::commission::wheel_test::{Finding, test_wheels};
use omnibus::error::MasterError;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Kind, Value, address};
use sim::{Backend, Crash, Options, World};

/// The kinds that the reference board drives, with a driver that fits each.
const FITTING: [(StageKind, Driver); 6] = [
    (StageKind::PwmDirection, Driver::PwmDirection),
    (StageKind::PwmDirection, Driver::PwmIn1In2),
    (StageKind::InInSlow, Driver::HalfBridges),
    (StageKind::LockedAntiphase, Driver::LockedAntiphase),
    (StageKind::InInFast, Driver::HalfBridges),
    (StageKind::InInBrake, Driver::HalfBridges),
];

/// The image for a kind.
fn image(told: StageKind) -> emulator::Firmware {
    common::image(if told.has_two_pwms() {
        "OMNIBUS_ELF_TWO_PWMS"
    } else {
        "OMNIBUS_ELF"
    })
}

/// A single robot that was told a kind, with a driver.
fn group(told: StageKind, driver: Driver) -> GroupFile {
    let mut group = common::group("single");
    group.robots[0].output.kind = told;
    group.robots[0].output.enable_wired = told.needs_enable();
    group.simulation.driver = Some(driver);
    group
}

fn link(group: &GroupFile) -> SimLink {
    link_with(image(group.robots[0].output.kind), group)
}

fn link_with(image: emulator::Firmware, group: &GroupFile) -> SimLink {
    let world = World::new(group, Backend::Emulator(image), Options::default()).unwrap();
    SimLink::new(world, "test")
}

/// A robot that drives at a twist.
fn driving<'a>(link: &'a mut SimLink, group: &'a GroupFile, vx: f32) -> Group<&'a mut SimLink> {
    let mut session = Group::connect(link, group).unwrap();
    session.configure(true).unwrap();
    session.start().unwrap();
    for _ in 0..30 {
        session.cycle(Twist::ZERO).unwrap();
    }
    for _ in 0..100 {
        session.cycle(Twist::new(vx, 0.0, 0.0)).unwrap();
    }
    session
}

/// 0.3 m/s for a second in either direction: the wheels keep their rate, all four the same, and the
/// motors get the same voltage by any kind of driver.
#[test]
fn each_kind_drives_straight() {
    // 0.3 m/s over the radius, and the compensation of the group file.
    let rate = 0.3 / 0.1524 * 1.002;
    for vx in [0.3, -0.3] {
        let mut duties = Vec::new();
        for (told, driver) in FITTING {
            let group = group(told, driver);
            let mut link = link(&group);
            let mut session = driving(&mut link, &group, vx);
            let robot = session.link().world.truth().robots[0];
            let rates: [f64; 4] = robot.wheel_rates.into();
            for got in rates {
                let want = f64::from(vx).signum() * rate;
                assert!(
                    (got / want - 1.0).abs() < 0.01,
                    "{driver:?}: {rates:?}, {want}"
                );
            }
            assert!(robot.drivers_enabled && robot.duties[0] * f64::from(vx) > 0.0);
            duties.push(robot.duties);
        }
        let [first, others @ ..] = &duties[..] else {
            unreachable!("four drivers")
        };
        for (one, other) in others.iter().flat_map(|run| first.iter().zip(run)) {
            assert!((one - other).abs() < 0.02 * one.abs(), "{duties:?}");
        }
    }
}

/// Robots without an image have the same kinds.
#[test]
fn native_robots_drive_by_two_pwms() {
    for told in [StageKind::InInFast, StageKind::InInBrake] {
        let group = group(told, Driver::HalfBridges);
        let world = World::new(&group, Backend::Native, Options::default()).unwrap();
        let mut link = SimLink::new(world, "test");
        let mut session = driving(&mut link, &group, -0.3);
        let robot = session.link().world.truth().robots[0];
        let rates: [f64; 4] = robot.wheel_rates.into();
        let want = -0.3 / 0.1524 * 1.002;
        for got in rates {
            assert!((got / want - 1.0).abs() < 0.01, "{told:?}: {rates:?}");
        }
    }
}

/// The levels of the pins that a robot without torque must have: driver enable low, and all inputs
/// of the bridges low beside it, but for directions that only the program takes back.
fn is_safe(board: &Board, directions_too: bool) -> bool {
    const DIRECTIONS: [(Port, u8); 8] = [
        (Port::C, 0),
        (Port::C, 1),
        (Port::C, 2),
        (Port::C, 3),
        (Port::B, 2),
        (Port::B, 4),
        (Port::B, 5),
        (Port::D, 2),
    ];
    let low = |pin| is_low(board, pin);
    low((Port::B, 0)) && are_pwms_low(board) && (!directions_too || DIRECTIONS.into_iter().all(low))
}

fn is_low(board: &Board, (port, pin): (Port, u8)) -> bool {
    board.output(port, pin) != PinLevel::High
}

/// Whether no input of a bridge that has a PWM is high.
fn are_pwms_low(board: &Board) -> bool {
    // The second four are inputs where a wheel has one PWM.
    const PWM: [(Port, u8); 8] = [
        (Port::A, 8),
        (Port::A, 9),
        (Port::A, 10),
        (Port::A, 11),
        (Port::C, 6),
        (Port::C, 7),
        (Port::C, 8),
        (Port::C, 9),
    ];
    PWM.into_iter().all(|pin| is_low(board, pin))
}

/// After the reset the log shows the calls of the panic: the first is inside it, all are in
/// functions.
fn assert_panic_is_named(world: &mut World, image: &emulator::Firmware, what: &str) {
    let lines = world.take_logs().into_iter().map(|(_, line)| line.text);
    let lines: Vec<String> = lines.filter(|line| line.contains("Panic([")).collect();
    assert!(
        lines.iter().any(|line| line.contains("the last run ended")),
        "{what}: {lines:?}"
    );
    for line in &lines {
        let numbers = line.split("0x").skip(1).map(|text| {
            let end = text.find([',', ']']).expect("a list");
            u32::from_str_radix(&text[..end], 16).expect("an address")
        });
        let calls: Vec<u32> = numbers.filter(|address| *address != 0).collect();
        let names: Vec<&str> = calls
            .iter()
            .map(|call| {
                let functions = image.functions();
                // A call that does not return may be the last of a function.
                let holds =
                    |f: &&emulator::Symbol| (f.address..f.address + f.size).contains(&(call - 1));
                functions.iter().find(holds).map_or("", |f| &f.name)
            })
            .collect();
        assert!(names[0].contains("panic"), "{what}: {line} {names:?}");
        assert!(!names.contains(&""), "{what}: {line} {names:?}");
    }
}

/// A program that fails while it reverses, when PWM low is no safe state for most kinds: the
/// bridges are off and every input low within a tick, and stay so over the reset.
#[test]
fn a_crash_while_reversing_leaves_the_bridges_safe() {
    for (told, driver) in FITTING {
        let group = group(told, driver);
        let mut link = link(&group);
        let mut session = driving(&mut link, &group, -0.3);
        for how in [Crash::Nowhere, Crash::Panic, Crash::StackOverflow] {
            let world = &mut session.link().world.try_clone().unwrap();
            let what = format!("{driver:?}, {how:?}");
            let mut crashed = world.crash(0, how);
            // Some need a program that sleeps.
            for _ in 0..1_000 {
                if crashed {
                    break;
                }
                let next = world.now().0 + 7;
                world.run_until(canopen::Micros(next)).unwrap();
                crashed = world.crash(0, how);
            }
            assert!(crashed, "{what}");
            let at = world.now().0;
            for later_us in [1_100, 10_000, 60_000, 120_000] {
                world.run_until(canopen::Micros(at + later_us)).unwrap();
                let robot = world.truth().robots[0];
                assert!(!robot.drivers_enabled && !robot.brake_released, "{what}");
                assert_eq!(robot.duties, [0.0; 4], "{what} after {later_us} us");
                assert!(
                    is_safe(world.board(2).unwrap(), true),
                    "{what} after {later_us} us"
                );
            }
            if how == Crash::Panic {
                assert_panic_is_named(world, &image(told), &what);
            }
        }
    }
}

/// With the core halted, the break inputs alone cut: PWM and driver enable, without any
/// instruction.
#[test]
fn the_emergency_stop_needs_no_program() {
    for (told, driver) in FITTING {
        let group = group(told, driver);
        let mut link = link(&group);
        let mut session = driving(&mut link, &group, -0.3);
        let world = &mut session.link().world;
        assert!(world.halt(0, true));
        assert!(world.truth().robots[0].drivers_enabled);
        world.set_emergency_stop(0, true);
        let next = world.now().0 + 10;
        world.run_until(canopen::Micros(next)).unwrap();
        let robot = world.truth().robots[0];
        assert_eq!(robot.duties, [0.0; 4], "{told:?}");
        let board = world.board(2).unwrap();
        if told.has_two_pwms() {
            // Enable and brake are the program's, and both inputs low is no voltage.
            assert!(are_pwms_low(board), "{told:?}");
        } else {
            assert!(!robot.drivers_enabled, "{told:?}");
            assert!(is_safe(board, false), "{told:?}");
        }
    }
}

/// Either wire of the emergency stop alone, which is that of one timer: the program cuts the other,
/// enable and brake in its next tick.
#[test]
fn one_wire_of_the_stop_cuts_both_pwms_within_a_tick() {
    for told in [StageKind::InInFast, StageKind::InInBrake] {
        let group = group(told, Driver::HalfBridges);
        let mut link = link(&group);
        let mut session = driving(&mut link, &group, 0.3);
        for (port, pin) in [(Port::B, 12), (Port::A, 6)] {
            let world = &mut session.link().world.try_clone().unwrap();
            assert!(world.truth().robots[0].duties[0] > 0.0);
            world.board(2).unwrap().set_input(port, pin, true);
            let next = world.now().0 + 1_100;
            world.run_until(canopen::Micros(next)).unwrap();
            let robot = world.truth().robots[0];
            let what = format!("{told:?}, {port:?}{pin}");
            assert_eq!(robot.duties, [0.0; 4], "{what}");
            assert!(!robot.drivers_enabled && !robot.brake_released, "{what}");
            assert!(is_safe(world.board(2).unwrap(), true), "{what}");
        }
    }
}

/// From power-on to the configuration, and after a stop, no bridge conducts and no input is high.
#[test]
fn a_robot_that_is_not_started_holds_all_inputs_low() {
    for (told, driver) in FITTING {
        let group = group(told, driver);
        let mut link = link(&group);
        for _ in 0..200 {
            let next = link.world.now().0 + 100;
            link.world.run_until(canopen::Micros(next)).unwrap();
            assert!(
                is_safe(link.world.board(2).unwrap(), true),
                "{driver:?} at {next} us"
            );
        }
        let mut session = driving(&mut link, &group, -0.3);
        session.stop().unwrap();
        let world = &mut session.link().world;
        let next = world.now().0 + 400_000;
        world.run_until(canopen::Micros(next)).unwrap();
        assert!(is_safe(world.board(2).unwrap(), true), "{driver:?}");
    }
}

/// Half of the period high is the only level without voltage of a locked antiphase driver: the
/// enable must not be there before it, nor after it.
#[test]
fn a_locked_antiphase_driver_is_never_enabled_without_its_pwm() {
    let group = group(StageKind::LockedAntiphase, Driver::LockedAntiphase);
    let mut link = link(&group);
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    session.link().world.board(2).unwrap().start_trace();
    session.start().unwrap();
    for _ in 0..40 {
        session.cycle(Twist::ZERO).unwrap();
    }
    session.stop().unwrap();
    let world = &mut session.link().world;
    let next = world.now().0 + 400_000;
    world.run_until(canopen::Micros(next)).unwrap();
    let (mut enabled, mut driven, mut seen) = (false, [false; 4], 0);
    for traced in world.board(2).unwrap().take_trace() {
        match traced.change {
            emulator::Change::Pin {
                port: Port::B,
                pin: 0,
                level,
            } => {
                enabled = level == PinLevel::High;
                seen += 1;
            }
            emulator::Change::Pwm {
                timer: 1,
                channel,
                state,
            } => {
                driven[channel - 1] = state.active && (state.duty - 0.5).abs() < 0.05;
            }
            _ => {}
        }
        assert!(!enabled || driven == [true; 4], "{traced:?}");
    }
    assert!(seen >= 2, "it was switched on and off");
}

/// What an IN/IN bridge gets wrongly while its inputs change one after the other, at every change
/// of direction: at most what docs/bring-up.md says.
#[test]
fn direction_and_duty_change_together() {
    const APART_NS: u64 = 400;
    let group = group(StageKind::InInSlow, Driver::HalfBridges);
    let mut link = link(&group);
    let mut session = driving(&mut link, &group, 0.3);
    session.link().world.board(2).unwrap().start_trace();
    for vx in [-0.3, 0.3] {
        for _ in 0..80 {
            session.cycle(Twist::new(vx, 0.0, 0.0)).unwrap();
        }
    }
    let changes = session.link().world.board(2).unwrap().take_trace();
    for wheel in 0..4_u8 {
        let at = |is: &dyn Fn(&emulator::Change) -> bool| -> Vec<u64> {
            let ours = changes.iter().filter(|traced| is(&traced.change));
            ours.map(|traced| traced.t_ns).collect()
        };
        let duties = at(&|change| match change {
            emulator::Change::Pwm { timer, channel, .. } => {
                (*timer, *channel) == (1, usize::from(wheel) + 1)
            }
            _ => false,
        });
        let turns = at(&|change| match change {
            emulator::Change::Pin { port, pin, .. } => (*port, *pin) == (Port::C, wheel),
            _ => false,
        });
        assert!(turns.len() >= 2, "wheel {wheel} reversed twice");
        for at in turns {
            let apart = duties.iter().map(|duty| duty.abs_diff(at)).min();
            assert!(apart.unwrap() <= APART_NS, "wheel {wheel}: {apart:?} ns");
        }
    }
}

/// What the robot says about its configuration, object 0x2002:1, with these values written.
fn objection(values: &[(protocol::Address, Value)]) -> u32 {
    objection_of(StageKind::PwmDirection, values)
}

/// The same of the image that is for a kind.
fn objection_of(told: StageKind, values: &[(protocol::Address, Value)]) -> u32 {
    let group = group(told, Driver::from(told));
    let mut link = link(&group);
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    let wire = session.wire();
    for (at, value) in values {
        wire.write(2, *at, *value).unwrap();
    }
    let at = address::CONFIGURATION_STATUS;
    wire.read(2, at, Kind::U32).unwrap().to_bits()
}

/// A kind without its safe state, one that this board has no pins for, and one that starves a high
/// side: the robot names the object (reason 2) and does not start.
#[test]
fn a_kind_that_cannot_be_safe_is_refused() {
    let stage = |kind| (address::OUTPUT_STAGE, Value::U8(kind));
    let [unwired, wired] = [0, 1].map(|is| (address::ENABLE_WIRED, Value::U8(is)));
    let inconsistent = |at: protocol::Address| at.packed() << 8 | 2;
    for kind in [1, 3] {
        assert_eq!(objection(&[stage(kind), wired]), 0);
        let wanted = inconsistent(address::ENABLE_WIRED);
        assert_eq!(objection(&[stage(kind), unwired]), wanted, "{kind}");
    }
    assert_eq!(objection(&[stage(0), unwired]), 0);
    for kind in [2, 6] {
        let wanted = inconsistent(address::OUTPUT_STAGE);
        assert_eq!(objection(&[stage(kind)]), wanted, "{kind}");
    }
    let pauses = (address::DUTY_MAX, Value::F32(0.95));
    assert_eq!(
        objection(&[stage(1), wired, pauses]),
        inconsistent(address::DUTY_MAX)
    );
    assert_eq!(objection(&[stage(3), wired, pauses]), 0);
}

/// The two counters run together: less than a tenth of a microsecond apart, whatever the frequency.
#[test]
fn both_pwms_begin_their_pulses_together() {
    /// RM0390 rev 6, table 1 and 17.4.10.
    const COUNTERS: [u32; 2] = [0x4001_0024, 0x4001_0424];
    const PER_US: i64 = 180;
    for hz in [8_000, 20_000, 40_000] {
        let mut group = group(StageKind::InInFast, Driver::HalfBridges);
        group.robots[0].output.pwm_frequency = hz;
        let mut link = link(&group);
        let mut session = driving(&mut link, &group, 0.3);
        let board = session.link().world.board(2).unwrap();
        let period = 1_000_000 * PER_US / i64::from(hz);
        let mut seen = Vec::new();
        for _ in 0..20 {
            let next = board.now_ns() + 1_237;
            board.run_until(next).unwrap();
            let [first, second] = COUNTERS.map(|at| i64::from(board.read_register(at)));
            let apart = (first - second).rem_euclid(period);
            assert!(apart < PER_US / 10, "{hz} Hz: {first}, {second}");
            seen.push(first);
        }
        assert!(seen.iter().any(|count| *count != seen[0]), "it counts");
    }
}

/// With two PWMs a wheel both low is safe, so that no enable has to be wired, and there is no
/// direction for the others.
#[test]
fn two_pwms_are_safe_without_an_enable_and_nothing_else() {
    let of = |values: &[_]| objection_of(StageKind::InInFast, values);
    let stage = |kind| (address::OUTPUT_STAGE, Value::U8(kind));
    let unwired = (address::ENABLE_WIRED, Value::U8(0));
    let inconsistent = |at: protocol::Address| at.packed() << 8 | 2;
    for kind in [2, 6] {
        assert_eq!(of(&[stage(kind), unwired]), 0, "{kind}");
    }
    for kind in [0, 1, 3, 4] {
        let wanted = inconsistent(address::OUTPUT_STAGE);
        assert_eq!(of(&[stage(kind)]), wanted, "{kind}");
    }
    // Both high between the pulses keeps high sides on.
    let pauses = (address::DUTY_MAX, Value::F32(0.95));
    assert_eq!(of(&[stage(2), pauses]), 0);
    assert_eq!(of(&[stage(6), pauses]), inconsistent(address::DUTY_MAX));
}

/// While it is OPERATIONAL nothing changes its kind.
#[test]
fn the_kind_is_fixed_while_armed() {
    let group = group(StageKind::InInSlow, Driver::HalfBridges);
    let mut link = link(&group);
    let mut session = driving(&mut link, &group, 0.3);
    for at in [address::OUTPUT_STAGE, address::ENABLE_WIRED] {
        let refused = session.wire().write(2, at, Value::U8(0));
        assert!(refused.is_err(), "{at:?}");
    }
}

fn wheel_test(told: StageKind, driver: Driver) -> Result<Vec<Finding>, MasterError> {
    let group = group(told, driver);
    let mut link = link(&group);
    let mut session = Group::connect(&mut link, &group)?;
    session.configure(true)?;
    let period_us = session.period_us();
    test_wheels(
        session.wire(),
        2,
        period_us,
        &mut |_, _| Ok(None),
        &mut |_| Ok(()),
    )
}

/// Every kind with every driver: the wheel test passes where they fit, and names the object where
/// they do not.
#[test]
fn the_wheel_test_names_a_driver_of_another_kind() {
    for told in [
        StageKind::PwmDirection,
        StageKind::InInSlow,
        StageKind::LockedAntiphase,
        StageKind::InInFast,
        StageKind::InInBrake,
    ] {
        for driver in [
            Driver::PwmDirection,
            Driver::PwmIn1In2,
            Driver::HalfBridges,
            Driver::LockedAntiphase,
        ] {
            let what = format!("{told:?} with {driver:?}");
            let findings = wheel_test(told, driver).unwrap_or_else(|e| panic!("{what}: {e}"));
            let problems: Vec<_> = findings
                .iter()
                .filter_map(|f| f.problem.as_deref())
                .collect();
            if FITTING.contains(&(told, driver)) {
                assert_eq!((findings.len(), &problems[..]), (4, &[][..]), "{what}");
            } else if (told, driver) == (StageKind::InInFast, Driver::PwmIn1In2) {
                // Nothing is wired to its second direction, so it never drives.
                let silent = |problem: &&str| problem.contains("no encoder counts");
                assert!(
                    problems.len() == 4 && problems.iter().all(silent),
                    "{what}: {problems:?}"
                );
            } else {
                let [problem] = problems[..] else {
                    panic!("{what}: {problems:?}")
                };
                let kind = format!("2027:6 = {}", told as u8);
                assert!(problem.contains(&kind), "{what}: {problem}");
            }
        }
    }
}
