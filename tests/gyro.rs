//! A robot with a gyro: RoboMaster's Development Board C with its BMI088 on SPI, emulated with its
//! release image, and native.
//!
//! `OMNIBUS_ELF_BOARD_C` names the image (`cargo xtask test` builds it).

mod common;

use emulator::GyroDefect;
use group::{GroupFile, Plant};
use kinematics::Twist;
use omnibus::commission::calibrate::journal::Journal;
use omnibus::commission::calibrate::recorded_motions::Source;
use omnibus::commission::calibrate::rollers;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::{Address, Code, GyroState, Kind, Limit, RobotReport, Value, address as at};
use sim::{Backend, Options, World};

const NODE: u8 = 2;

/// Seeds of the rollers and indexes of which the phases are looked for.
const SEEDS: u64 = 3;

/// A count of the sensor, rad/s: 1 / 16.384 degrees/s (BST-BMI088-DS001-13, 5.5.4).
const COUNT: f64 = 0.001_065_264_4;

/// These tests with Board C's image, and with native robots.
macro_rules! tests {
    ($robots:ident: $($test:ident)*) => {
        mod $robots {
            $(#[test] fn $test() { super::$test(&super::$robots()); })*
        }
    };
}

tests! { board_c:
    the_yaw_rate_is_that_of_the_robot
    turns_are_the_gyros_where_wheels_slip
    a_gyro_that_fails_is_named_and_the_robot_drives_on
    a_gyro_that_is_not_there_does_not_keep_a_robot_from_driving
    a_pdo_carries_the_yaw_rate_while_the_wheels_slip
    a_pdo_says_that_a_gyro_is_not_used
    the_gyro_shows_how_the_rollers_stand
}

tests! { native:
    the_yaw_rate_is_that_of_the_robot
    turns_are_the_gyros_where_wheels_slip
    a_gyro_that_is_not_there_does_not_keep_a_robot_from_driving
    a_pdo_carries_the_yaw_rate_while_the_wheels_slip
    a_pdo_says_that_a_gyro_is_not_used
    the_gyro_shows_how_the_rollers_stand
}

fn board_c() -> Backend {
    Backend::Emulator(common::image("OMNIBUS_ELF_BOARD_C"))
}

fn native() -> Backend {
    Backend::Native
}

fn file() -> GroupFile {
    let mut group = common::group("c620");
    group.robots[0].board = group::Board::RobomasterC;
    group
}

/// On a floor where its wheels slip.
fn slippery() -> GroupFile {
    let mut group = file();
    group.simulation.plant = Plant::Contact { rollers: 8 };
    group.simulation.contact.friction = Some(0.1);
    group
}

fn link(group: &GroupFile, robots: &Backend) -> SimLink {
    SimLink::new(
        World::new(group, robots.clone(), Options::default()).unwrap(),
        "test",
    )
}

type Session<'a> = Group<&'a mut SimLink>;

/// A robot that has stood for these seconds, configured and started.
fn started<'a>(link: &'a mut SimLink, group: &'a GroupFile, seconds: u32) -> Session<'a> {
    let mut session = Group::connect(link, group).unwrap();
    session.configure(false).unwrap();
    session.start().unwrap();
    drive(&mut session, Twist::ZERO, 100 * seconds);
    session
}

/// Cycles of 10 ms.
fn drive(session: &mut Session, twist: Twist, cycles: u32) {
    for _ in 0..cycles {
        session.cycle(twist).unwrap();
    }
}

fn read(session: &mut Session, address: Address, kind: Kind) -> f64 {
    match session.wire().read(NODE, address, kind).unwrap() {
        Value::U8(value) => value.into(),
        Value::U16(value) => value.into(),
        Value::I16(value) => value.into(),
        Value::F32(value) => value.into(),
        other => panic!("{other:?}"),
    }
}

fn state(session: &mut Session) -> GyroState {
    let number = read(session, at::GYRO_STATE, Kind::U8) as u8;
    GyroState::from_number(number).unwrap()
}

fn code(session: &mut Session) -> Code {
    let number = read(session, at::STATUS_CODE, Kind::U16) as u16;
    Code::from_code(number).unwrap()
}

fn heading(session: &mut Session) -> f64 {
    session.link().world.truth().group.heading
}

/// How far the odometry's heading is from the truth, rad.
fn heading_error(session: &mut Session) -> f64 {
    let reported = read(session, at::POSE_HEADING, Kind::I16) * 1e-4;
    let error = reported - heading(session);
    error - (error / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

/// Within one count of the sensor, over a second of a turn at 0.8 rad/s, and its bias of 0.5
/// degrees/s within half of one: five windows of 500 samples with a noise of 0.005
/// degrees/s/sqrt(Hz), 1.8 counts in 500 Hz.
fn the_yaw_rate_is_that_of_the_robot(robots: &Backend) {
    let group = file();
    let mut link = link(&group, robots);
    let mut session = started(&mut link, &group, 6);
    assert_eq!(state(&mut session), GyroState::InUse);
    let bias = read(&mut session, at::GYRO_BIAS, Kind::F32);
    let error = bias - 0.5_f64.to_radians();
    assert!(error.abs() < COUNT / 2.0, "{} counts", error / COUNT);

    let twist = Twist::new(0.0, 0.0, 0.8);
    drive(&mut session, twist, 150);
    let (from, begin) = (heading(&mut session), session.link().world.now_ns());
    let mut sum = 0.0;
    for _ in 0..100 {
        session.cycle(twist).unwrap();
        sum += read(&mut session, at::GYRO_RATE, Kind::F32);
    }
    let seconds = (session.link().world.now_ns() - begin) as f64 * 1e-9;
    let turned = heading(&mut session) - from;
    let turned = turned - (turned / std::f64::consts::TAU).floor() * std::f64::consts::TAU;
    let rate = turned / seconds;
    println!("{} counts off {rate} rad/s", (sum / 100.0 - rate) / COUNT);
    assert!(rate > 0.7);
    assert!((sum / 100.0 - rate).abs() < COUNT, "{} {rate}", sum / 100.0);
    assert_eq!(code(&mut session), Code::None);
}

/// Turns to and fro and drives between, on a floor where the wheels slip; how far the odometry's
/// heading is off at the end.
fn drift(robots: &Backend, defect: Option<GyroDefect>) -> f64 {
    let group = slippery();
    let mut link = link(&group, robots);
    link.world.set_gyro_defect(0, defect);
    let mut session = started(&mut link, &group, 4);
    for twist in [
        Twist::new(0.0, 0.0, 1.0),
        Twist::new(0.5, 0.3, 0.0),
        Twist::new(0.3, 0.0, 1.0),
        Twist::new(0.0, 0.5, 0.5),
    ] {
        drive(&mut session, twist, 200);
        drive(&mut session, Twist::ZERO, 60);
    }
    let used = state(&mut session) == GyroState::InUse;
    assert_eq!(used, defect.is_none());
    heading_error(&mut session)
}

/// At most a tenth of what the wheels alone are off.
fn turns_are_the_gyros_where_wheels_slip(robots: &Backend) {
    let wheels = drift(robots, Some(GyroDefect::Absent)).to_degrees();
    let gyro = drift(robots, None).to_degrees();
    println!("heading error: wheels {wheels:.3}, gyro {gyro:.3} degrees");
    assert!(wheels.abs() > 1.0, "the wheels slip: {wheels}");
    assert!(gyro.abs() <= wheels.abs() / 10.0, "{gyro} of {wheels}");
}

/// Named within half a second of a turn, as a limit: the robot drives on, and its odometry is the
/// wheels'.
fn a_gyro_that_fails_is_named_and_the_robot_drives_on(robots: &Backend) {
    for (defect, named) in [
        (GyroDefect::Stuck, GyroState::Stuck),
        (GyroDefect::Jumps, GyroState::Implausible),
        // The wire stays high: every sample is -1.
        (GyroDefect::Absent, GyroState::Stuck),
    ] {
        let group = file();
        let mut link = link(&group, robots);
        let mut session = started(&mut link, &group, 2);
        let twist = Twist::new(0.0, 0.0, 0.5);
        drive(&mut session, twist, 100);
        assert_eq!(state(&mut session), GyroState::InUse);
        session.link().world.set_gyro_defect(0, Some(defect));
        drive(&mut session, twist, 50);
        assert_eq!(state(&mut session), named, "{defect:?}");
        assert_eq!(code(&mut session), Code::Limit(Limit::Gyro), "{defect:?}");
        assert_eq!(read(&mut session, at::GYRO_RATE, Kind::F32), 0.0);
        let before = (heading_error(&mut session), heading(&mut session));
        drive(&mut session, twist, 100);
        let after = (heading_error(&mut session), heading(&mut session));
        assert!(after.1 - before.1 > 0.4, "{defect:?}: it turns on");
        // Ideal wheels on the table's plant: as good as the gyro.
        assert!((after.0 - before.0).abs() < 0.02, "{before:?} {after:?}");
        // It is whole again, and not believed before the next start.
        session.link().world.set_gyro_defect(0, None);
        drive(&mut session, twist, 50);
        assert_eq!(state(&mut session), named, "{defect:?}");
    }
}

/// TPDO5 comes with every SYNC. From rest to rest, on a floor where the wheels slip, its yaw rates
/// add up to the turn of the robot, within five deviations of the noise (1.8 counts each), and
/// those of MeasuredTwist, which are the wheels', do not.
fn a_pdo_carries_the_yaw_rate_while_the_wheels_slip(robots: &Backend) {
    let group = slippery();
    let mut link = link(&group, robots);
    let mut session = started(&mut link, &group, 4);
    let from = heading(&mut session);
    let port = session.link().world.add_port();
    drive(&mut session, Twist::new(0.0, 0.0, 1.0), 100);
    drive(&mut session, Twist::ZERO, 100);
    let turned = heading(&mut session) - from;
    let (mut wheels, mut rates) = (0.0, Vec::new());
    while let Some((_, frame)) = session.link().world.take_received(port) {
        match RobotReport::decode(frame.id(), frame.data()) {
            Some((NODE, RobotReport::Measured(measured))) => {
                wheels += f64::from(measured.twist.omega) * 0.01;
            }
            Some((NODE, RobotReport::YawRate(report))) => {
                rates.push(f64::from(report.yaw_rate.unwrap()));
            }
            _ => {}
        }
    }
    assert!(rates.len() >= 199, "{}", rates.len());
    let gyro = rates.iter().sum::<f64>() * 0.01;
    let noise = 5.0 * 1.8 * COUNT * 0.01 * 200_f64.sqrt();
    println!("turned {turned}, by the PDO {gyro}, by the wheels {wheels}, noise {noise} rad");
    assert!((gyro - turned).abs() < noise, "{gyro} {turned}");
    assert!((wheels - turned).abs() > 10.0 * noise, "{wheels} {turned}");
}

/// The PDO of a gyro that has failed has no yaw rate.
fn a_pdo_says_that_a_gyro_is_not_used(robots: &Backend) {
    let group = file();
    let mut link = link(&group, robots);
    link.world.set_gyro_defect(0, Some(GyroDefect::Absent));
    let mut session = started(&mut link, &group, 1);
    let port = session.link().world.add_port();
    drive(&mut session, Twist::ZERO, 10);
    let mut reports = 0;
    while let Some((_, frame)) = session.link().world.take_received(port) {
        if let Some((NODE, RobotReport::YawRate(report))) =
            RobotReport::decode(frame.id(), frame.data())
        {
            assert_eq!(report.yaw_rate, None);
            reports += 1;
        }
    }
    assert!(reports >= 9, "{reports}");
}

/// Nothing at the other end, or another chip (0x1E is the number of the accelerometer beside it).
fn a_gyro_that_is_not_there_does_not_keep_a_robot_from_driving(robots: &Backend) {
    for defect in [GyroDefect::Absent, GyroDefect::Identifier(0x1E)] {
        let group = file();
        let mut link = link(&group, robots);
        link.world.set_gyro_defect(0, Some(defect));
        let mut session = started(&mut link, &group, 1);
        assert_eq!(state(&mut session), GyroState::Missing, "{defect:?}");
        drive(&mut session, Twist::new(0.3, 0.0, 0.0), 200);
        let x = session.link().world.truth().group.x;
        assert!(x > 0.4, "{defect:?}: {x} m");
        assert_eq!(code(&mut session), Code::Limit(Limit::Gyro), "{defect:?}");
    }
}

/// `calibrate --phase --gyro robot`, with nothing plugged in: an index for each wheel, smart drives
/// and the gyro on the board. The robot is that of `master/tests/phase.rs` but for its drives, and
/// so is the bound, 0.19 degrees: four deviations of the gyro's noise and of the headings' steps,
/// and a thousandth of a pitch. The drives add what the count at an index is off at the rims'
/// fastest, 1.8 rad/s: 7 counts, 0.017 degrees.
fn the_gyro_shows_how_the_rollers_stand(robots: &Backend) {
    const BOUND_DEG: f64 = 0.19 + 0.017;
    for seed in 1..=SEEDS {
        let mut group = common::group("single-rollers");
        group.simulation.seed = seed;
        group.robots[0].board = group::Board::RobomasterC;
        common::fit_smart_drives(&mut group.robots[0]);
        let truth = sim::index::roller_phases(&group).unwrap()[0];
        let group = rollers::without_phases(&group, 8).unwrap();
        let mut link = link(&group, robots);
        let mut session = Group::connect(&mut link, &group).unwrap();
        let journal = &mut Journal::new(|_| {});
        let found = rollers::find(&mut session, 2, &mut Source::Board, journal).unwrap();
        let errors = [0, 1, 2, 3].map(|wheel: usize| {
            let error = (found[0].found.phases[wheel] - truth[wheel]).to_degrees();
            error - (error / 45.0).round() * 45.0
        });
        println!("seed {seed}: phases off by {errors:.3?} degrees");
        for error in errors {
            assert!(error.abs() < BOUND_DEG, "seed {seed}: {errors:?}");
        }
    }
}
