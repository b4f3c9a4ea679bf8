//! What a wheel does when its encoder is wrong: its true rate, not the one that the robot measures.

use kinematics::Twist;
use protocol::address::{self as at, motor};
use protocol::{Fault, Value};

use super::world::{COUNTS, SPEED, World};
use crate::state::State;

/// No wheel may turn faster than this, times what is asked of it, while its encoder is dead.
const OVERSPEED: f64 = 1.5;

/// Counts on the open input of a dead encoder.
#[derive(Clone, Copy, Debug)]
enum Stray {
    /// None.
    Quiet,
    /// Three at once, forward or back, every 150 to 300 ms.
    Bunches,
    /// One, forward or back, 20 times a second.
    Hum,
    /// One, forward or back, at each edge of channel A: channel B is open.
    Chance,
}

const STRAYS: [Stray; 4] = [Stray::Quiet, Stray::Bunches, Stray::Hum, Stray::Chance];

/// A generator of numbers that are the same in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }

    fn sign(&mut self) -> i64 {
        if self.below(2) == 0 { 1 } else { -1 }
    }
}

/// Of the wheels, m.
const RADIUS: f32 = 0.1524;

/// What came of a dead encoder.
#[derive(Debug)]
struct Course {
    /// From its death to the ramp, ms.
    noticed: Option<u32>,
    /// Fastest true rate after it, rad/s.
    fastest: f64,
    fault: Option<Fault>,
}

/// Runs on with the encoder of a wheel dead, at most `millis`, to the end of the ramp.
fn die(world: &mut World, wheel: usize, stray: Stray, seed: u64, millis: u32) -> Course {
    world.robots[0].encoder_sign[wheel] = 0.0;
    let mut random = Random(seed);
    let mut next = 0;
    // Of channel A, which has half of all edges.
    let mut edges = 0.0;
    let mut course = Course {
        noticed: None,
        fastest: 0.0,
        fault: None,
    };
    for now in 0..millis {
        if now == next {
            let (counts, pause) = match stray {
                Stray::Quiet | Stray::Chance => (0, 1_000),
                Stray::Bunches => (3, 150 + random.below(151)),
                Stray::Hum => (1, 25 + random.below(51)),
            };
            let counts = counts * random.sign();
            if now > 0 {
                world.robots[0].stray[wheel] += counts;
            }
            next = now + u32::try_from(pause).unwrap();
        }
        if let Stray::Chance = stray {
            let robot = &mut world.robots[0];
            edges +=
                robot.rates[wheel].abs() * 1e-3 * f64::from(COUNTS / core::f32::consts::TAU) / 2.0;
            while edges >= 1.0 {
                edges -= 1.0;
                robot.stray[wheel] += random.sign();
            }
        }
        world.step();
        let robot = &world.robots[0];
        course.fastest = course.fastest.max(robot.rates[wheel].abs());
        if course.noticed.is_none() && robot.bus.state() != State::Moving {
            course.noticed = Some(now + 1);
        }
        course.fault = course.fault.or(robot.control.report().fault);
        if !robot.outputs.drivers_enabled {
            break;
        }
    }
    course
}

/// At most so many milliseconds may pass until the ramp, at this speed in m/s.
fn promised(speed: f32) -> u32 {
    if speed >= 0.3 { 50 } else { 300 }
}

/// The same, and what no wheel may turn faster than over what is asked of it: counts by chance may
/// look like a wheel's for half as long again.
fn promised_beside(stray: Stray, speed: f32) -> (u32, f64) {
    match stray {
        Stray::Chance => (promised(speed) * 3 / 2, 2.0),
        _ => (promised(speed), OVERSPEED),
    }
}

/// Forward, sideways, both, turning: each so that the wheels that turn roll at about this many m/s.
fn directions(speed: f32) -> [Twist; 4] {
    [
        Twist::new(speed, 0.0, 0.0),
        Twist::new(0.0, -speed, 0.0),
        Twist::new(0.5 * speed, 0.5 * speed, 0.0),
        // Half track and half wheelbase together are 0.72 m.
        Twist::new(0.0, 0.0, speed / 0.72),
    ]
}

#[test]
fn a_dead_encoder_is_noticed_before_its_wheel_runs_away() {
    for speed in [0.05, 0.1, 0.3, 0.6] {
        for stray in STRAYS {
            for (seed, twist) in (1..).zip(directions(speed)) {
                for wheel in [0, 1] {
                    let mut world = World::started(&[2]);
                    world.drive(twist, 1_500);
                    let asked = world.robots[0].rates[wheel].abs();
                    if asked < 0.1 {
                        // This one stands in oblique motion.
                        continue;
                    }
                    let what = std::format!("{twist:?}, wheel {wheel}, {stray:?}");
                    let course = die(&mut world, wheel, stray, seed, 4_000);
                    let noticed = course.noticed.expect(&what);
                    let (soon, overspeed) = promised_beside(stray, speed);
                    assert!(noticed <= soon, "{what}: {course:?}");
                    assert_eq!(course.fault, Some(Fault::EncoderDead), "{what}");
                    let most = overspeed * asked;
                    let ran = speed < 0.1 || course.fastest <= most;
                    assert!(ran, "{what}: {course:?}, asked for {asked}");
                    assert_eq!(world.robots[0].rates, [0.0; 4], "{what}");
                }
            }
        }
    }
}

#[test]
fn an_encoder_that_is_dead_from_the_start_lets_no_wheel_run_away() {
    for speed in [0.1, 0.3, 0.6] {
        let mut world = World::started(&[2]);
        world.robots[0].encoder_sign[2] = 0.0;
        world.release();
        world.twist = Some(Twist::new(speed, 0.0, 0.0));
        assert_eq!(world.robots[0].bus.state(), State::Moving);
        let course = die(&mut world, 2, Stray::Hum, 7, 4_000);
        assert_eq!(course.fault, Some(Fault::EncoderDead), "{speed} m/s");
        let asked = f64::from(speed) / 0.1524;
        let most = OVERSPEED * asked;
        assert!(course.fastest <= most, "{speed} m/s: {course:?}");
    }
}

/// A robot whose feedforward is that of another motor, driving.
fn mismatched(factor: f32, twist: Twist) -> World {
    let mut world = World::new(&[2]);
    world.configure();
    for wheel in 0..4 {
        let value = Value::F32(SPEED * factor);
        world.write(2, motor::speed(wheel), value).unwrap();
    }
    world.start();
    world.run(30);
    world.drive(twist, 1_500);
    world
}

#[test]
fn a_model_that_is_wrong_by_a_third_is_no_dead_encoder_and_hides_none() {
    for factor in [0.7, 1.3] {
        for speed in [0.02, 0.1, 0.3, 0.6] {
            let mut world = mismatched(factor, Twist::new(speed, 0.0, 0.0));
            for twist in directions(speed) {
                world.drive(twist, 1_000);
                world.drive(twist * -1.0, 1_000);
            }
            assert_eq!(
                world.robots[0].bus.state(),
                State::Moving,
                "{factor}, {speed}"
            );
        }
        let mut world = mismatched(factor, Twist::new(0.3, 0.0, 0.0));
        let course = die(&mut world, 1, Stray::Bunches, 3, 4_000);
        assert!(course.noticed.unwrap() <= promised(0.3), "{course:?}");
        assert!(course.fastest <= OVERSPEED * 0.3 / 0.1524, "{course:?}");
    }
}

/// 50 counts a second are 0.077 rad/s, 12 mm/s: one count in 20 ticks.
#[test]
fn a_crawl_of_one_count_in_twenty_ticks_is_no_fault() {
    let speed = 50.0 / COUNTS * core::f32::consts::TAU * 0.1524;
    for twist in directions(speed) {
        let mut world = World::started(&[2]);
        world.drive(twist, 5_000);
        world.drive(twist * -1.0, 5_000);
        assert_eq!(world.robots[0].bus.state(), State::Moving, "{twist:?}");
    }
}

/// One wheel needs twice the voltage to come loose that the model says, the others half of it.
#[test]
fn one_sticky_wheel_among_four_is_no_dead_encoder() {
    for speed in [0.02, 0.1, 0.3] {
        let mut world = World::new(&[2]);
        world.configure();
        let friction = Value::F32(super::world::STATIC_FRICTION * 0.5);
        world.write(2, motor::static_friction(1), friction).unwrap();
        world.start();
        world.run(30);
        for _ in 0..5 {
            world.drive(Twist::new(speed, 0.0, 0.0), 1_000);
            world.drive(Twist::ZERO, 500);
            world.drive(Twist::new(-speed, 0.0, 0.0), 1_000);
        }
        assert_eq!(world.robots[0].bus.state(), State::Moving, "{speed}");
    }
}

/// The threshold that says what a blocked wheel is turns this off as well.
#[test]
fn without_a_wheel_check_nothing_is_noticed() {
    let mut world = World::new(&[2]);
    world.configure();
    world.write(2, at::BLOCKED_RATE, Value::F32(0.0)).unwrap();
    world.start();
    world.run(30);
    world.drive(Twist::new(0.1, 0.0, 0.0), 1_000);
    let course = die(&mut world, 0, Stray::Quiet, 1, 1_000);
    assert_eq!((course.noticed, course.fault), (None, None));
}

/// Armed and standing, a wheel is given a push of this rate: whether it was cut, and when, ms; its
/// fastest rate.
fn push(rate: f64, sign: f64) -> (Option<(u32, Fault)>, f64) {
    let mut world = World::started(&[2]);
    world.run(300);
    world.robots[0].encoder_sign[1] = sign;
    world.robots[0].rates[1] = rate;
    let mut fastest = 0.0_f64;
    for now in 1..=600 {
        world.step();
        let robot = &world.robots[0];
        fastest = fastest.max(robot.rates[1].abs());
        if !robot.outputs.drivers_enabled {
            return (Some((now, robot.control.report().fault.unwrap())), fastest);
        }
    }
    (None, fastest)
}

#[test]
fn a_reversed_encoder_is_cut_at_standstill_too() {
    for rate in [-1.5, 1.5, 2.0] {
        let (cut, _) = push(rate, -1.0);
        let (took, fault) = cut.unwrap();
        assert_eq!(fault, Fault::EncoderInverted, "{rate} rad/s");
        assert!(took <= 60, "{rate} rad/s: {took} ms");
    }
    // A gentler push takes longer to tell from a load, a harder one meets the torque bound first:
    // the wheel does not become faster than it was pushed.
    for rate in [0.3, 0.5, 0.7, 1.0, 3.0, 4.0, 8.0] {
        let (cut, fastest) = push(rate, -1.0);
        assert!(fastest <= rate, "up to {fastest} rad/s from {rate}");
        let known = cut.is_some_and(|(took, _)| took <= 300);
        assert!(known || rate < 0.5, "{rate} rad/s: {cut:?}");
    }
}

#[test]
fn a_wheel_that_is_pushed_at_standstill_comes_back() {
    for rate in [0.3, 0.5, -1.0, 2.0, 4.0, 8.0] {
        assert_eq!(push(rate, 1.0).0, None, "{rate} rad/s");
    }
}

/// How long a motion is steady before something happens to it, ms. Where between two counts a wheel
/// is then decides cases that are close, so there are several.
const STEADY_MS: [u32; 8] = [1_990, 1_993, 1_996, 1_999, 2_002, 2_005, 2_008, 2_011];

/// The encoder of a wheel counts backwards, after so many ms of a steady motion or from before the
/// first one: how long until the drivers were off, and the fastest rate until then. None in 4 s.
fn reverse(rate: f64, steady: Option<u32>) -> (Option<(u32, Fault)>, f64) {
    let mut world = World::started(&[2]);
    let twist = Twist::new(rate as f32 * RADIUS, 0.0, 0.0);
    if let Some(millis) = steady {
        world.drive(twist, millis);
        world.robots[0].encoder_sign[1] = -1.0;
    } else {
        world.robots[0].encoder_sign[1] = -1.0;
        world.release();
        world.twist = Some(twist);
    }
    let mut fastest = 0.0_f64;
    for now in 1..=4_000 {
        world.step();
        let robot = &world.robots[0];
        fastest = fastest.max(robot.rates[1].abs());
        if !robot.outputs.drivers_enabled {
            return (Some((now, robot.control.report().fault.unwrap())), fastest);
        }
    }
    (None, fastest)
}

/// What docs/safety.md promises of a wheel with this rate, rad/s: when it is off, ms, and its
/// fastest rate.
fn reversed_promise(rate: f64) -> (u32, f64) {
    let page = include_str!("../../../docs/safety.md");
    let rows = page.lines().filter_map(|line| {
        let mut cells = line.split('|').map(str::trim).skip(1);
        let (from, _) = cells.next()?.strip_prefix("from ")?.split_once(" rad/s")?;
        let millis = cells.next()?.strip_suffix(" ms")?.parse().ok()?;
        let fastest = cells.next()?;
        let fastest = match fastest.strip_suffix(" times its rate") {
            Some(factor) => factor.parse::<f64>().ok()? * rate,
            None => fastest.strip_suffix(" rad/s")?.parse().ok()?,
        };
        Some((from.parse::<f64>().ok()?, (millis, fastest)))
    });
    let mut rows = rows.filter(|(from, _)| rate >= *from);
    rows.next().expect("a row for this rate").1
}

#[test]
fn a_reversed_encoder_is_cut_however_slowly_its_wheel_turns() {
    for rate in [
        0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 4.0, 6.0,
    ] {
        let (within, most) = reversed_promise(rate);
        for (sign, steady) in STEADY_MS.into_iter().flat_map(|ms| [(1.0, ms), (-1.0, ms)]) {
            let (cut, fastest) = reverse(sign * rate, Some(steady));
            let (took, fault) = cut.unwrap();
            assert_eq!(fault, Fault::EncoderInverted, "{rate} rad/s");
            assert!(took <= within, "{rate} rad/s: {took} ms");
            assert!(fastest <= most, "{rate}: {fastest} rad/s");
        }
    }
}

/// The usual way to have one: it is wired like that.
#[test]
fn a_reversed_encoder_is_cut_at_the_first_motion() {
    for rate in [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0] {
        for sign in [1.0, -1.0] {
            let (cut, fastest) = reverse(sign * rate, None);
            assert_eq!(cut.unwrap().1, Fault::EncoderInverted, "{rate} rad/s");
            let most = (2.0 * rate).clamp(0.3, 2.5);
            assert!(fastest <= most, "{rate}: {fastest} rad/s");
        }
    }
}

/// A robot at a crawl that its load pushes back for a moment goes on.
#[test]
fn a_robot_that_is_pushed_back_at_a_crawl_is_not_reversed() {
    for asked in [0.05, 0.1, 0.3, 0.5] {
        for pushed in [0.1, 0.3, 0.6] {
            for steady in STEADY_MS {
                let mut world = World::started(&[2]);
                world.drive(Twist::new(asked * RADIUS, 0.0, 0.0), steady);
                world.robots[0].rates = [-pushed; 4];
                world.run(1_000);
                let state = world.robots[0].bus.state();
                assert_eq!(state, State::Moving, "{asked} asked, {pushed} rad/s");
            }
        }
    }
}
