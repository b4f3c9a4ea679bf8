//! RoboMaster C620 drives on CAN2, with the image that is built for them: it drives, alone and in a
//! group with a robot that has bridges, names what is wrong with its drives in the promised time,
//! and leaves them without current when it fails.
//!
//! `OMNIBUS_ELF_DRIVES` names that image, `OMNIBUS_ELF` the reference board's for bridges, and
//! `OMNIBUS_ELF_BOARD_C` that of RoboMaster's Development Board C (`cargo xtask test` builds all).
//! What a drive does is `sim::smart_drive`.

mod common;

use canopen::Micros;
use group::GroupFile;
use kinematics::Twist;
use omnibus::commission::motors::turn_wheel;
use omnibus::commission::wheel_test::{Observed, test_wheels};
use omnibus::monitor::telemetry::Telemetry;
use omnibus::path::curve::Curve;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Code, Fault, Kind, Value, address};
use sim::smart_drive::DriveChange;
use sim::test_master::TestMaster;
use sim::{Backend, Crash, Options, World};

const NODE: u8 = 2;

/// Robots of the image that a variable names, or native ones.
fn backend(image: &str) -> Backend {
    match image {
        "native" => Backend::Native,
        variable => Backend::Emulator(common::image(variable)),
    }
}

/// These tests with the image that a variable names, or with native robots.
macro_rules! tests {
    ($variable:literal, $($test:ident)*) => {
        $(#[test] fn $test() { super::$test($variable); })*
    };
}

mod reference {
    tests! { "OMNIBUS_ELF_DRIVES",
        it_drives_straight
        a_crash_leaves_the_drives_without_current
        a_robot_that_says_nothing_is_noticed_by_its_drives
        a_fault_of_a_drive_is_named_in_time
        a_start_is_refused_with_the_name_of_the_fault
        the_other_kind_of_drive_is_refused_by_name
        no_drive_has_current_after_any_stop
        crossed_identifiers_are_a_matter_of_the_group_file
        the_wheel_test_finds_exchanged_drives
    }
}

/// Robots without an image, whose bus of drives is the same model.
mod native {
    tests! { "native",
        it_drives_straight
        a_fault_of_a_drive_is_named_in_time
        a_start_is_refused_with_the_name_of_the_fault
        the_other_kind_of_drive_is_refused_by_name
        no_drive_has_current_after_any_stop
        crossed_identifiers_are_a_matter_of_the_group_file
        the_wheel_test_finds_exchanged_drives
    }
}

/// The board that has nothing but smart drives: a sample.
mod board_c {
    tests! { "OMNIBUS_ELF_BOARD_C",
        it_drives_straight
        a_crash_leaves_the_drives_without_current
        a_robot_that_says_nothing_is_noticed_by_its_drives
        a_fault_of_a_drive_is_named_in_time
        a_start_is_refused_with_the_name_of_the_fault
        no_drive_has_current_after_any_stop
    }
}

fn link(group: &GroupFile, image: &str) -> SimLink {
    let world = World::new(group, backend(image), Options::default()).unwrap();
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

/// The same, with a master that does not end when the robot stops.
fn moving(group: &GroupFile, image: &str) -> TestMaster {
    let mut link = link(group, image);
    let mut session = Group::connect(&mut link, group).unwrap();
    session.configure(false).unwrap();
    let mut master = TestMaster::new(link.world, group);
    master.run(60).unwrap();
    master.command(canopen::NmtCommand::Start, None);
    master.run(60).unwrap();
    master.twist = Some(Twist::new(0.6, 0.0, 0.0));
    master.run(600).unwrap();
    assert_eq!(code(&master), Code::None);
    master
}

fn code(master: &TestMaster) -> Code {
    master.status(NODE).unwrap().code
}

fn run_us(world: &mut World, us: u64) {
    let until = world.now().0 + us;
    world.run_until(Micros(until)).unwrap();
}

/// 0.3 m/s over the radius is the rate of every wheel, in either direction, and a steady wheel
/// takes the current of its friction: (0.15 + 0.002 w) N m over 0.3 N m/A.
fn it_drives_straight(image: &str) {
    let group = common::group("c620");
    for vx in [0.3_f32, -0.3] {
        let mut link = link(&group, image);
        let mut session = driving(&mut link, &group, vx);
        let robot = session.link().world.truth().robots[0];
        let want = f64::from(vx) / 0.076;
        let rates: [f64; 4] = robot.wheel_rates.into();
        for (rate, current) in rates.into_iter().zip(robot.currents) {
            assert!((rate / want - 1.0).abs() < 0.01, "{rates:?}, {want}");
            let friction = (0.15 + 0.002 * want.abs()) / 0.3 * want.signum();
            assert!(
                (current - friction).abs() < 0.2,
                "{current} A, {friction} A"
            );
        }
    }
}

/// A program that fails: its last words are no current, and then it is silent. Long before the
/// drives would have noticed by themselves there is none.
fn a_crash_leaves_the_drives_without_current(image: &str) {
    let group = common::group("c620");
    let mut link = link(&group, image);
    let mut session = driving(&mut link, &group, 0.6);
    let moving = &session.link().world;
    assert!(moving.truth().robots[0].currents[0] > 0.3);
    for how in [Crash::Nowhere, Crash::Panic, Crash::StackOverflow] {
        let mut world = moving.try_clone().unwrap();
        while !world.crash(0, how) {
            run_us(&mut world, 7);
        }
        for later_us in [1_500, 10_000, 60_000, 60_000] {
            run_us(&mut world, later_us);
            let robot = world.truth().robots[0];
            assert_eq!(robot.currents, [0.0; 4], "{how:?} after {later_us} us");
            assert!(!robot.brake_released, "{how:?}");
        }
    }
}

/// A halted core says no last words: the drives' own timeout, assumed to be 100 ms, counts.
fn a_robot_that_says_nothing_is_noticed_by_its_drives(image: &str) {
    let group = common::group("c620");
    let mut link = link(&group, image);
    let mut session = driving(&mut link, &group, 0.6);
    let world = &mut session.link().world;
    assert!(world.halt(0, true));
    run_us(world, 20_000);
    assert!(world.truth().robots[0].currents[0] > 0.0);
    run_us(world, 82_000);
    assert_eq!(world.truth().robots[0].currents, [0.0; 4]);
}

/// What happens to a drive in motion, and the fault that names it.
const IN_MOTION: [(DriveChange, Fault); 4] = [
    (DriveChange::Power(false), Fault::DriveSilent),
    (DriveChange::Identifier(7), Fault::DriveIdentifier),
    // Silent under its own identifier before it has doubled the other.
    (DriveChange::Identifier(1), Fault::DriveSilent),
    (DriveChange::Temperature(81), Fault::DriveHot),
];

/// The same before the start.
const AT_REST: [(DriveChange, Fault); 3] = [
    (DriveChange::Power(false), Fault::DriveSilent),
    (DriveChange::Identifier(7), Fault::DriveIdentifier),
    (DriveChange::Identifier(1), Fault::DriveDoubled),
];

/// What docs/safety.md promises, ms.
fn promised(fault: Fault) -> u64 {
    let page = include_str!("../docs/safety.md");
    let row = format!("| 0x{:04X} {} |", fault.code(), fault.name());
    let row = page.lines().find(|line| line.contains(&row)).unwrap();
    let (before, _) = row.split_once(" ms with smart drives").unwrap();
    before.rsplit(' ').next().unwrap().parse().unwrap()
}

/// Cut within the promise; a hot motor is not cut, its robot ramps and is named as fast.
fn a_fault_of_a_drive_is_named_in_time(image: &str) {
    let group = common::group("c620");
    let moving = moving(&group, image);
    for (change, fault) in IN_MOTION {
        let mut master = moving.try_clone().unwrap();
        master.world.set_smart_drive(0, 1, change);
        let live = |world: &World| world.truth().robots[0].brake_released;
        let cuts = fault.reaction() == protocol::Reaction::Cut;
        for _ in 0..promised(fault) {
            master.run(1).unwrap();
        }
        assert_eq!(live(&master.world), !cuts, "{change:?}");
        master.run(10).unwrap();
        assert_eq!(code(&master), Code::Fault(fault), "{change:?}");
        master.run(1_500).unwrap();
        assert!(!live(&master.world), "{change:?}");
    }
}

/// A start is refused, and the fault names the cause.
fn a_start_is_refused_with_the_name_of_the_fault(image: &str) {
    let group = common::group("c620");
    for (change, fault) in AT_REST {
        let mut link = link(&group, image);
        link.world.set_smart_drive(0, 1, change);
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(false).unwrap();
        let mut master = TestMaster::new(link.world, &group);
        master.run(200).unwrap();
        master.command(canopen::NmtCommand::Start, None);
        master.run(60).unwrap();
        assert_eq!(code(&master), Code::Fault(fault), "{change:?}");
        assert!(!master.world.truth().robots[0].brake_released);
    }
}

/// Every way in which a robot in motion comes to a stop, with what does it and how long a drive may
/// have current after it, ms: after a cut what naming it and one command take; after a ramp what
/// 0.6 m/s at 2.4 m/s2 and the jerk take, the silence that begins it and the brake. A drive that
/// has taken another identifier hears no command: its own timeout counts.
const STOPS: [(&str, Stop, u64); 10] = [
    ("emergency stop", |m| m.world.set_emergency_stop(0, true), 3),
    ("driver fault", |m| m.world.set_driver_fault(0, true), 3),
    (
        "a drive is off",
        |m| change(m, DriveChange::Power(false)),
        7,
    ),
    (
        "a drive has identifier 7",
        |m| change(m, DriveChange::Identifier(7)),
        TIME_OUT,
    ),
    (
        "a drive has that of another",
        |m| change(m, DriveChange::Identifier(1)),
        7,
    ),
    (
        "a motor is hot",
        |m| change(m, DriveChange::Temperature(81)),
        RAMP,
    ),
    ("power", |m| m.world.set_power(0, false), 1),
    (
        "NMT stop",
        |m| m.command(canopen::NmtCommand::Stop, None),
        RAMP,
    ),
    (
        "NMT reset",
        |m| m.command(canopen::NmtCommand::ResetNode, None),
        RAMP,
    ),
    (
        "its bus is pulled",
        |m| m.world.set_connected(0, false),
        RAMP,
    ),
];

type Stop = fn(&mut TestMaster);

const RAMP: u64 = 900;
const TIME_OUT: u64 = sim::smart_drive::TIME_OUT_NS / 1_000_000 + 3;

fn change(master: &mut TestMaster, change: DriveChange) {
    master.world.set_smart_drive(0, 1, change);
}

fn no_drive_has_current_after_any_stop(image: &str) {
    let group = common::group("c620");
    let moving = moving(&group, image);
    let currents = |master: &TestMaster| master.world.truth().robots[0].currents;
    assert!(currents(&moving).iter().any(|a| a.abs() > 0.3));
    for (name, stop, ms) in STOPS {
        let mut master = moving.try_clone().unwrap();
        stop(&mut master);
        master.run(ms).unwrap();
        for later_ms in 0..300 {
            assert_eq!(currents(&master), [0.0; 4], "{name}, {ms} + {later_ms} ms");
            master.run(1).unwrap();
        }
        assert!(!master.world.truth().robots[0].brake_released, "{name}");
    }
}

/// The drives' identifiers are the group file's: the master writes them, and a robot drives as any
/// other.
fn crossed_identifiers_are_a_matter_of_the_group_file(image: &str) {
    let mut group = common::group("c620");
    group.robots[0].output.drive_identifiers = [3, 1, 4, 2];
    let mut link = link(&group, image);
    let mut session = driving(&mut link, &group, 0.3);
    for (wheel, address) in [
        address::DRIVE_FRONT_LEFT,
        address::DRIVE_FRONT_RIGHT,
        address::DRIVE_REAR_LEFT,
        address::DRIVE_REAR_RIGHT,
    ]
    .into_iter()
    .enumerate()
    {
        let identifier = group.robots[0].output.drive_identifiers[wheel];
        let stored = session.wire().read(NODE, address, Kind::U8).unwrap();
        assert_eq!(stored, Value::U8(identifier));
    }
    // A drive reports 30 degrees until it is told otherwise; the hottest counts.
    for hot in [30, 47] {
        session
            .link()
            .world
            .set_smart_drive(0, 2, DriveChange::Temperature(hot));
        for _ in 0..3 {
            session.cycle(Twist::new(0.3, 0.0, 0.0)).unwrap();
        }
        let read = session.wire().read(NODE, address::TEMPERATURE, Kind::U8);
        assert_eq!(read.unwrap(), Value::U8(hot));
    }
    // The session asks in turn, without waiting, and observers get the answer.
    session
        .link()
        .world
        .set_smart_drive(0, 2, DriveChange::Temperature(52));
    let stream = session.telemetry();
    for _ in 0..260 {
        session.cycle(Twist::new(0.3, 0.0, 0.0)).unwrap();
    }
    let mut published = None;
    while let Some(item) = stream.try_next() {
        if let Telemetry::Snapshot(now) = item {
            published = now.members[0].motor_temperature;
        }
    }
    assert_eq!(published, Some(52));
    let robot = session.link().world.truth().robots[0];
    for rate in <[f64; 4]>::from(robot.wheel_rates) {
        assert!((rate * 0.076 / 0.3 - 1.0).abs() < 0.01, "{rate}");
    }
    assert!(
        robot.pose.x > 0.1 && robot.pose.y.abs() < 0.01,
        "{:?}",
        robot.pose
    );
}

/// Two drives with each other's identifiers: the robot sees nothing wrong, an eye does, and the
/// test of the wheels says what the group file's key has to be. With that key all is well.
fn the_wheel_test_finds_exchanged_drives(image: &str) {
    let mut group = common::group("c620");
    for (identifiers, wrong) in [([1, 2, 3, 4], 2), ([1, 4, 3, 2], 0)] {
        let mut link = link(&group, image);
        link.world.set_smart_drive(0, 1, DriveChange::Identifier(4));
        link.world.set_smart_drive(0, 3, DriveChange::Identifier(2));
        group.robots[0].output.drive_identifiers = identifiers;
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(true).unwrap();
        let period_us = session.period_us();
        // The eye: which wheel of the world goes farthest while one is to turn.
        let seen = [0, 1, 2, 3].map(|wheel| {
            let before = session.link().world.truth().robots[0].wheel_angles;
            turn_wheel(session.wire(), NODE, period_us, wheel, &mut |_| Ok(())).unwrap();
            let after = session.link().world.truth().robots[0].wheel_angles;
            let way = |n: &usize| (after[*n] - before[*n]).abs();
            (0..4).max_by(|a, b| way(a).total_cmp(&way(b))).unwrap()
        });
        let mut problems = |eyes: bool| {
            let mut look = |wheel: usize, _: &_| {
                let (wheel, forward) = (seen[wheel], true);
                Ok(eyes.then_some(Observed::Wheel { wheel, forward }))
            };
            let wire = session.wire();
            let found = test_wheels(wire, NODE, period_us, &mut look, &mut |_| Ok(())).unwrap();
            found
                .into_iter()
                .filter_map(|finding| finding.problem)
                .collect::<Vec<_>>()
        };
        assert_eq!(problems(false), [""; 0]);
        let problems = problems(true);
        assert_eq!(problems.len(), wrong, "{problems:?}");
        for problem in problems {
            let key = "drive_identifiers = [1, 4, 3, 2]";
            assert!(problem.contains(key), "{problem}");
        }
    }
}

/// An image for smart drives has no bridges, and says which object is wrong.
fn the_other_kind_of_drive_is_refused_by_name(image: &str) {
    let file = common::group("c620");
    let mut link = link(&file, image);
    let mut session = Group::connect(&mut link, &file).unwrap();
    session.configure(false).unwrap();
    let wire = session.wire();
    let mut status = |kind: u8| {
        wire.write(NODE, address::OUTPUT_STAGE, Value::U8(kind))
            .unwrap();
        wire.read(NODE, address::CONFIGURATION_STATUS, Kind::U32)
            .unwrap()
    };
    assert_eq!(status(4), Value::U32(0));
    let inconsistent = address::OUTPUT_STAGE.packed() << 8 | 2;
    assert_eq!(status(0), Value::U32(inconsistent));
}

/// The robots of a file, with motors that 20 A are enough for, and so many of them, from the last,
/// with smart drives in place of bridges.
fn group_with(name: &str, smart: usize) -> GroupFile {
    let mut group = common::group(name);
    for robot in &mut group.robots {
        robot.output.largest_current = Some(20.0);
        robot.motor.inertia = 0.2;
    }
    for robot in group.robots.iter_mut().rev().take(smart) {
        common::fit_smart_drives(robot);
    }
    group
}

fn images() -> Backend {
    Backend::Images(
        ["OMNIBUS_ELF", "OMNIBUS_ELF_DRIVES"]
            .map(common::image)
            .to_vec(),
    )
}

/// The same robot with either kind of drive is at the same place all the time, at 1 m/s within what
/// a tick of delay is: a report and a command take a tick between them.
#[test]
fn it_follows_a_figure_eight_as_bridges_do() {
    let runs = [0, 1].map(|smart| {
        let group = group_with("single", smart);
        let drive = common::quick_drive(&group, images(), Curve::FigureEight, true);
        assert_eq!(drive.result, Ok(()));
        drive.truth
    });
    let [bridges, smart] = &runs;
    assert_eq!(bridges.len(), smart.len());
    let mut worst = 0.0_f64;
    for (one, other) in bridges.iter().zip(smart) {
        let (one, other) = (one.robots[0].pose, other.robots[0].pose);
        worst = worst.max((one.x - other.x).hypot(one.y - other.y));
    }
    println!("{worst} m apart");
    assert!(worst < 1e-3, "{worst} m apart");
}

/// One load on two robots, one with bridges and one with smart drives.
#[test]
fn a_mixed_group_carries_its_load_along_a_figure_eight() {
    let [alike, mixed] = [0, 1].map(|smart| {
        let group = group_with("tcc-2", smart);
        let drive = common::quick_drive(&group, images(), Curve::FigureEight, true);
        assert_eq!(drive.result, Ok(()));
        drive.world.worst_shape_error_mm()
    });
    println!("{mixed} mm, {alike} mm alike");
    assert!(mixed < alike + 1.0, "{mixed} mm, {alike} mm alike");
}

/// One load on three robots of different kinds, as `cargo xtask demo --config mixed` drives it: a
/// reference board with bridges, one with C620 drives, and Board C. Its shape is kept as by robots
/// that are alike.
#[test]
fn three_kinds_of_robots_carry_one_load() {
    let all = || ["OMNIBUS_ELF", "OMNIBUS_ELF_DRIVES", "OMNIBUS_ELF_BOARD_C"].map(common::image);
    let mixed = common::group("mixed");
    let mut alike = mixed.clone();
    for robot in &mut alike.robots[1..] {
        robot.board = mixed.robots[0].board;
        robot.output = mixed.robots[0].output;
        robot.encoder = mixed.robots[0].encoder;
    }
    let [alike, mixed] = [alike, mixed].map(|group| {
        let backend = Backend::Images(all().to_vec());
        let drive = common::quick_drive(&group, backend, Curve::FigureEight, true);
        assert_eq!(drive.result, Ok(()));
        drive.world.worst_shape_error_mm()
    });
    println!("{mixed} mm, {alike} mm alike");
    assert!(mixed < alike + 1.0, "{mixed} mm, {alike} mm alike");
}

/// An image is found by board and drives; a robot that none is for is refused by name.
#[test]
fn a_robot_without_an_image_of_its_own_is_refused() {
    let mixed = common::group("mixed");
    let images = Backend::Images(
        ["OMNIBUS_ELF", "OMNIBUS_ELF_DRIVES"]
            .map(common::image)
            .to_vec(),
    );
    let refused = World::new(&mixed, images, Options::default()).err();
    let refused = refused.map(|error| error.to_string()).unwrap_or_default();
    assert!(refused.contains("RobomasterC"), "{refused}");
}
