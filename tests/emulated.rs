//! Native robots and emulated ones do the same: how close they are is measured here.
//!
//! The emulated ones run the release image that `OMNIBUS_ELF` names (`cargo xtask test` builds it
//! and says so). Both are driven by the same master over the same kind of bus.

mod common;
#[path = "emulated/copies.rs"]
mod copies;
#[path = "emulated/identity.rs"]
mod identity;
#[path = "emulated/robots.rs"]
mod robots;

use canopen::Frame;
use common::{Drive, quick_drive};
use emulator::Port;
use identity::{a_robot_reports_its_chip, robots_that_are_one_node_notice_it};
use kinematics::{MemberKinematics, Mount};
use omnibus::commission::motors;
use omnibus::path::curve::Curve;
use omnibus::session::Group;
use omnibus::simulation::link::SimLink;
use protocol::address::{self, history};
use protocol::{Fault, Kind, Value, cob};
use robots::{BOARD_C, KIT, REFERENCE, Robots};
use sim::bus::disturb::Share;
use sim::bus::errors::ErrorState;
use sim::{Backend, Options, World};

/// Largest distance between the two groups at any SYNC over the first eight seconds of the circle,
/// 5 m of way. The emulated robots answer later within a tick and see their encoders at other
/// moments.
const POSITION_MM: f64 = 0.5;
/// Largest difference in heading.
const HEADING_MRAD: f64 = 0.3;
/// Mean difference in a wheel's true rate, rad/s; the circle asks for up to 5.
const MEAN_RATE: f64 = 0.002;
/// Largest strain either may put on the load; 70 ppm lie between the robots' crystals.
const SHAPE_MM: f64 = 1.0;

/// Largest difference in displacement between f32 and fixed-point kinematics: 0.05 % of the
/// farthest point.
const SCALAR_SHARE: f64 = 5e-4;

fn image() -> emulator::Firmware {
    common::image("OMNIBUS_ELF")
}

/// These tests with these robots.
macro_rules! tests {
    ($robots:ident: $($test:ident)*) => {
        $(#[test] fn $test() { super::$test(&super::$robots); })*
    };
}

mod reference {
    tests! { REFERENCE:
        wheels_follow_the_figure_eight_within_one_percent_of_their_peak
        the_led_tells_the_cause_from_what_follows
        the_supply_is_measured_whatever_the_chips_supply_is
        a_spell_of_error_passive_during_an_nmt_start_is_announced
        motors_are_identified_over_the_bus
        a_robot_reports_its_chip
        robots_that_are_one_node_notice_it
    }
}

/// The other board: what is not about bridges, encoder pins and current sensors.
mod board_c {
    tests! { BOARD_C:
        wheels_follow_the_figure_eight_within_one_percent_of_their_peak
        the_led_tells_the_cause_from_what_follows
        the_supply_is_measured_whatever_the_chips_supply_is
        a_spell_of_error_passive_during_an_nmt_start_is_announced
        motors_are_identified_over_the_bus
        a_robot_reports_its_chip
        robots_that_are_one_node_notice_it
    }
}

/// A kit without floating-point unit: the same, but for the supply, which it measures against its
/// own.
mod kit {
    tests! { KIT:
        wheels_follow_the_figure_eight_within_one_percent_of_their_peak
        the_led_tells_the_cause_from_what_follows
        a_spell_of_error_passive_during_an_nmt_start_is_announced
        motors_are_identified_over_the_bus
        a_robot_reports_its_chip
        robots_that_are_one_node_notice_it
    }
}

fn driven(backend: Backend) -> Drive {
    let mut drive = quick_drive(&common::group("tcc-3"), backend, Curve::Circle, true);
    if let Err(error) = &drive.result {
        for (node, line) in drive.world.take_logs() {
            println!(
                "node {node} {:>10} us {} {}",
                line.time_us, line.level, line.text
            );
        }
        panic!("{error}");
    }
    drive
}

#[test]
fn native_and_emulated_robots_agree() {
    let native = driven(Backend::Native);
    let emulated = driven(Backend::Emulator(image()));
    assert_eq!(native.truth.len(), emulated.truth.len());
    let (mut position, mut heading, mut rate) = (0.0f64, 0.0f64, 0.0f64);
    for (n, e) in native.truth.iter().zip(&emulated.truth) {
        position = position.max((n.group.x - e.group.x).hypot(n.group.y - e.group.y) * 1e3);
        heading = heading.max((n.group.heading - e.group.heading).abs() * 1e3);
        let rates = |truth: &sim::TruthSample| -> Vec<f64> {
            truth
                .robots
                .iter()
                .flat_map(|r| <[f64; 4]>::from(r.wheel_rates))
                .collect()
        };
        let wheels = rates(n);
        let sum: f64 = wheels
            .iter()
            .zip(rates(e))
            .map(|(n, e)| (n - e).abs())
            .sum();
        rate += sum / wheels.len() as f64;
    }
    rate /= native.truth.len() as f64;
    let far = native
        .truth
        .iter()
        .map(|t| t.group.x.hypot(t.group.y))
        .fold(0.0, f64::max);
    println!(
        "native against emulated over {} SYNCs, {far:.2} m from the origin: position \
         {position:.3} mm, heading {heading:.4} mrad, mean wheel rate {rate:.4} rad/s, shape \
         {:.2} and {:.2} mm",
        native.truth.len(),
        native.world.worst_shape_error_mm(),
        emulated.world.worst_shape_error_mm(),
    );
    assert!(position < POSITION_MM, "{position} mm");
    assert!(heading < HEADING_MRAD, "{heading} mrad");
    assert!(rate < MEAN_RATE, "{rate} rad/s");
    for drive in [native, emulated] {
        assert!(drive.world.worst_shape_error_mm() < SHAPE_MM);
    }
}

/// The image whose kinematics run in fixed point goes where the one in f32 goes.
#[test]
fn fixed_point_and_f32_agree() {
    let single = driven(Backend::Emulator(image()));
    let fixed = driven(Backend::Emulator(common::image("OMNIBUS_ELF_FIXED")));
    assert_eq!(single.truth.len(), fixed.truth.len());
    let (mut apart, mut far) = (0.0f64, 0.0f64);
    let from = single.truth[0].group;
    for (s, f) in single.truth.iter().zip(&fixed.truth) {
        apart = apart.max((s.group.x - f.group.x).hypot(s.group.y - f.group.y));
        far = far.max((s.group.x - from.x).hypot(s.group.y - from.y));
    }
    println!(
        "f32 against fixed point: {:.3} mm apart, {far:.2} m from the start",
        apart * 1e3
    );
    assert!(
        apart > 0.0,
        "two images that move alike to the bit are one image"
    );
    assert!(apart < SCALAR_SHARE * far, "{apart} m of {far} m");
}

/// The paper's figure-eight, its first seconds with the peak of all wheel rates in them, wheel by
/// wheel.
fn wheels_follow_the_figure_eight_within_one_percent_of_their_peak(robots: &Robots) {
    let group = robots.group("tcc-3");
    let plan = Curve::FigureEight.plan(true);
    let options = Options {
        truth_period_ns: u64::from(group.sync_period_us) * 1_000,
        start: plan.start(),
        ..Options::default()
    };
    let world = World::new(&group, robots.backend(), options).unwrap();
    let mut link = SimLink::new(world, "test");
    let members: Vec<MemberKinematics> = group
        .robots
        .iter()
        .map(|robot| {
            let mount = Mount::new(robot.mount).unwrap();
            MemberKinematics::new(&robot.geometry, &mount, &robot.compensation).unwrap()
        })
        .collect();
    let (mut sum, mut count, mut peak) = (0.0_f64, 0.0, 0.0_f64);
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    session.start().unwrap();
    session
        .follow(&plan, &mut |link, instant| {
            let seen = link.world.truth().robots;
            let body = instant.twist.to_world(-instant.pose.heading);
            for (robot, member) in seen.iter().zip(&members) {
                let wanted: [f32; 4] = member.inverse(body).into();
                let rates: [f64; 4] = robot.wheel_rates.into();
                for (wanted, rate) in wanted.map(f64::from).into_iter().zip(rates) {
                    sum += (rate - wanted).powi(2);
                    count += 1.0;
                    peak = peak.max(wanted.abs());
                }
            }
        })
        .unwrap();
    let rms = (sum / count).sqrt();
    println!(
        "wheel tracking in the figure-eight: {rms:.4} rad/s rms, {:.2} % of the peak {peak:.2} \
         rad/s",
        rms / peak * 100.0
    );
    assert!(peak > 5.0, "{peak} rad/s is no figure-eight");
    assert!(rms < 0.01 * peak, "{rms} of {peak} rad/s");
}

/// The board measures what its motors take, by the sensor that it is told of, and is cut when the
/// sensor's wire comes off and the input goes to the end of its range.
#[test]
fn the_motors_current_is_measured_and_a_sensor_that_fails_cuts() {
    for backend in [Backend::Native, Backend::Emulator(image())] {
        let group = common::group("single");
        let mut world = World::new(&group, backend, Options::default()).unwrap();
        world.set_current_sensor(0, Some((160.0, 1.65)));
        let mut link = SimLink::new(world, "test");
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(true).unwrap();
        for (at, value) in [
            (address::CURRENT_SCALE, 160.0),
            (address::CURRENT_OFFSET, 1.65),
        ] {
            session.wire().write(2, at, Value::F32(value)).unwrap();
        }
        session.start().unwrap();
        let read = |session: &mut Group<&mut SimLink>| {
            let value = session.wire().read(2, address::CURRENT, Kind::F32).unwrap();
            let Value::F32(amperes) = value else {
                panic!("{value:?}")
            };
            amperes
        };
        // Four motors of 40 A and a quarter are 200 A; a step of the converter is 0.13 A, and it
        // rounds down.
        let still = read(&mut session);
        assert!((-0.14..=0.001).contains(&still), "{still} A");
        let sees = Some((160.0, 1.85));
        session.link().world.set_current_sensor(0, sees);
        let now = session.link().world.now().0;
        let soon = canopen::Micros(now + 15_000);
        session.link().world.run_until(soon).unwrap();
        let more = read(&mut session);
        assert!((more - 32.0).abs() < 0.15, "{more} A");
        assert!(session.link().world.truth().robots[0].drivers_enabled);
        // Open: pulled up to the reference.
        session
            .link()
            .world
            .set_current_sensor(0, Some((160.0, 3.3)));
        let soon = canopen::Micros(session.link().world.now().0 + 25_000);
        session.link().world.run_until(soon).unwrap();
        assert!(!session.link().world.truth().robots[0].drivers_enabled);
        let fault = session.wire().read(2, history::code(1), Kind::U16).unwrap();
        assert_eq!(fault, Value::U16(Fault::OverCurrent.code()));
    }
}

/// Three sensors, a motor or two each, are added up, each from its own pin.
#[test]
fn the_currents_of_all_sensors_are_added() {
    const SCALE: f32 = 160.0;
    const OFFSET: f32 = 0.5;
    /// Channels of PA7, PC4 and PC5, and the voltages there.
    const PINS: [(Port, u8, f64); 3] = [(Port::A, 7, 0.6), (Port::C, 4, 0.7), (Port::C, 5, 0.9)];
    for (inputs, amperes) in [(1, 0.1 * SCALE), (2, 0.3 * SCALE), (3, 0.7 * SCALE)] {
        let group = common::group("single");
        let world = World::new(&group, Backend::Emulator(image()), Options::default()).unwrap();
        let mut link = SimLink::new(world, "test");
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(true).unwrap();
        for (at, value) in [
            (address::CURRENT_SCALE, Value::F32(SCALE)),
            (address::CURRENT_OFFSET, Value::F32(OFFSET)),
            (address::CURRENT_INPUTS, Value::U8(inputs)),
        ] {
            session.wire().write(2, at, value).unwrap();
        }
        for (port, pin, volts) in PINS {
            let board = session.link().world.board(2).unwrap();
            board.set_analog(port, pin, volts);
        }
        session.start().unwrap();
        let value = session.wire().read(2, address::CURRENT, Kind::F32).unwrap();
        let Value::F32(sum) = value else {
            panic!("{value:?}")
        };
        // A step of the converter is 0.13 A at each.
        let rounding = 0.13 * f32::from(inputs);
        assert!((sum - amperes).abs() <= rounding, "{inputs}: {sum} A");
    }
}

/// Flashes of the LEDs of these robots over so many milliseconds: for how long it is on and then
/// off, in tens of milliseconds. What has begun before and what has not ended is left out.
fn flashes<const N: usize>(
    world: &mut World,
    nodes: [u8; N],
    (port, pin): (Port, u8),
    millis: u64,
) -> [Vec<(u32, u32)>; N] {
    let mut spells = [const { Vec::<(bool, u32)>::new() }; N];
    for _ in 0..millis / 10 {
        world
            .run_until(canopen::Micros(world.now().0 + 10_000))
            .unwrap();
        for (node, spells) in nodes.into_iter().zip(&mut spells) {
            let board = world.board(node).unwrap();
            let is_on = board.output(port, pin) == emulator::PinLevel::High;
            match spells.last_mut() {
                Some((was_on, length)) if *was_on == is_on => *length += 1,
                _ => spells.push((is_on, 1)),
            }
        }
    }
    spells.map(|spells| {
        let begin = spells.iter().skip(1).position(|(is_on, _)| *is_on);
        let whole = &spells[begin.map_or(spells.len(), |at| at + 1)..spells.len() - 1];
        let pairs = whole.chunks_exact(2);
        pairs.map(|pair| (pair[0].1, pair[1].1)).collect()
    })
}

/// The LED tells a robot's own fault from one that follows from another robot's
/// (docs/bring-up.md): three flashes, or a second on; two are an emergency stop.
fn the_led_tells_the_cause_from_what_follows(robots: &Robots) {
    const FLASH: (u32, u32) = (20, 20);
    const LAST: (u32, u32) = (20, 100);
    const LONG: (u32, u32) = (100, 20);
    let group = robots.group("tcc-2");
    let nodes = [group.robots[0].node, group.robots[1].node];
    let world = World::new(&group, robots.backend(), Options::default()).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    session.start().unwrap();
    for _ in 0..200 {
        session
            .cycle(kinematics::Twist::new(0.1, 0.0, 0.0))
            .unwrap();
    }
    for (is_stop, own) in [(false, &[FLASH, FLASH, LAST][..]), (true, &[FLASH, LAST])] {
        let mut world = session.link().world.try_clone().unwrap();
        if is_stop {
            world.set_emergency_stop(1, true);
        } else {
            world.set_driver_fault(1, true);
        }
        // The ramp, and the pattern that was under way.
        let soon = canopen::Micros(world.now().0 + 3_000_000);
        world.run_until(soon).unwrap();
        let near = |found: &[(u32, u32)], wanted: &[(u32, u32)]| {
            let each = found.iter().zip(wanted.iter().cycle());
            found.len() >= wanted.len()
                && each
                    .clone()
                    .all(|(a, b)| a.0.abs_diff(b.0) <= 1 && a.1.abs_diff(b.1) <= 1)
        };
        let [follows, cause] = flashes(&mut world, nodes, robots.led, 6_000);
        assert!(near(&follows, &[LONG]), "follows: {follows:?}");
        let begin = cause.iter().position(|flash| flash.1.abs_diff(LAST.1) <= 1);
        let after = begin.map_or(&[][..], |at| &cause[at + 1..]);
        assert!(near(after, own), "its own: {cause:?}");
    }
}

/// The converter's reference is the chip's supply, and a regulator's is 3.3 V within some per cent.
/// The chip measures it by its VREFINT. Rounding: one step of 1501 in the calibration and in the
/// reading of VREFINT, one of 2500 in the supply's own: 0.18 %.
fn the_supply_is_measured_whatever_the_chips_supply_is(robots: &Robots) {
    const VOLTS: f32 = 24.0;
    const ROUNDING: f32 = 1.8e-3;
    for vdd in [3.2, 3.3, 3.4] {
        let group = robots.group("single");
        let world = World::new(&group, robots.backend(), Options::default()).unwrap();
        let mut link = SimLink::new(world, "test");
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(true).unwrap();
        let minimum = Value::F32(16.0);
        session
            .wire()
            .write(2, address::SUPPLY_MINIMUM, minimum)
            .unwrap();
        session.start().unwrap();
        // At the start, and after a drift.
        for vdd in [vdd, vdd - 0.05] {
            session.link().world.set_supply(0, f64::from(VOLTS));
            session.link().world.board(2).unwrap().set_vdd(vdd);
            let now = session.link().world.now().0;
            let later = canopen::Micros(now + 2_200_000);
            session.link().world.run_until(later).unwrap();
            let value = session.wire().read(2, address::SUPPLY, Kind::F32).unwrap();
            let Value::F32(volts) = value else {
                panic!("{value:?}")
            };
            assert!((volts / VOLTS - 1.0).abs() < ROUNDING, "{vdd} V: {volts} V");
        }
    }
}

/// PWM of 8 kHz to 40 kHz: the period on the pins is the one asked for, and a duty is the same
/// share of it: the loops ask for the same duty to drive as fast.
#[test]
fn the_bridges_switch_at_the_frequency_asked_for() {
    let mut duties = Vec::new();
    for (hz, period_ns) in [(20_000, 50_000), (8_000, 125_000), (40_000, 25_000)] {
        let group = common::group("single");
        let world = World::new(&group, Backend::Emulator(image()), Options::default()).unwrap();
        let mut link = SimLink::new(world, "test");
        let mut session = Group::connect(&mut link, &group).unwrap();
        session.configure(true).unwrap();
        let at = address::PWM_FREQUENCY;
        session.wire().write(2, at, Value::U16(hz)).unwrap();
        session.start().unwrap();
        // While it follows, it stays what it is.
        assert!(session.wire().write(2, at, Value::U16(10_000)).is_err());
        for _ in 0..100 {
            session.cycle(kinematics::Twist::ZERO).unwrap();
        }
        for _ in 0..200 {
            session
                .cycle(kinematics::Twist::new(0.3, 0.0, 0.0))
                .unwrap();
        }
        let world = &mut session.link().world;
        for channel in 1..=4 {
            let pwm = world.board(2).unwrap().pwm(1, channel);
            assert_eq!((pwm.period_ns, pwm.active), (period_ns, true), "{hz} Hz");
        }
        duties.push(world.truth().robots[0].duties);
    }
    let [first, others @ ..] = &duties[..] else {
        unreachable!("three runs")
    };
    for (one, other) in others.iter().flat_map(|run| first.iter().zip(run)) {
        assert!((one - other).abs() < 0.01 * one.abs(), "{duties:?}");
    }
}

/// A spell of error passive that begins and ends while the bus task is at work on something else,
/// here on the configuration at an NMT start, is announced as well.
fn a_spell_of_error_passive_during_an_nmt_start_is_announced(robots: &Robots) {
    let group = robots.group("single");
    let world = World::new(&group, robots.backend(), Options::default()).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    let world = &mut session.link().world;
    while world.take_received(sim::MASTER).is_some() {}
    // What it answers gets no acknowledge, until the next failure makes it error passive.
    let answers = Share {
        of: 1.0,
        id: Some(cob::sdo_response(2)),
    };
    world.set_lost_acknowledge(answers);
    let serial = [0x40, 0x01, 0x20, 1, 0, 0, 0, 0];
    world.send(Frame::of(cob::sdo_request(2), serial));
    let mut until = |done: &dyn Fn(ErrorState, u32) -> bool, start: bool| {
        let begin = world.now().0;
        while !done(world.robot_errors(0).0, world.robot_errors(0).1.transmit) {
            let now = world.now().0;
            assert!(now < begin + 20_000, "{now} us");
            world.run_until(canopen::Micros(now + 5)).unwrap();
        }
        if start {
            world.send(Frame::of(cob::NMT, [1, 0]));
        }
        world.now().0
    };
    until(&|_, transmit| transmit >= 120, true);
    let from = until(&|state, _| state == ErrorState::Passive, false);
    session.link().world.set_lost_acknowledge(Share::NONE);
    let world = &mut session.link().world;
    while world.robot_errors(0).0 == ErrorState::Passive {
        let now = world.now().0;
        world.run_until(canopen::Micros(now + 5)).unwrap();
    }
    let spell_us = world.now().0 - from;
    assert!(spell_us < 200, "{spell_us} us");
    let soon = canopen::Micros(world.now().0 + 20_000);
    world.run_until(soon).unwrap();
    let codes: Vec<u16> = std::iter::from_fn(|| world.take_received(sim::MASTER))
        .filter(|(_, frame)| frame.id() == cob::emergency(2))
        .map(|(_, frame)| u16::from_le_bytes([frame.data()[0], frame.data()[1]]))
        .collect();
    assert!(
        codes.contains(&canopen::Emergency::CAN_PASSIVE),
        "{codes:X?}"
    );
}

/// The release image finds the constants of the simulated motors, and gains that drive them.
fn motors_are_identified_over_the_bus(robots: &Robots) {
    let group = robots.group("tcc-3");
    let options = Options {
        truth_period_ns: 0,
        ..Options::default()
    };
    let world = World::new(&group, robots.backend(), options).unwrap();
    let mut link = SimLink::new(world, "test");
    let mut session = Group::connect(&mut link, &group).unwrap();
    session.configure(true).unwrap();
    let period_us = session.period_us();
    let settings = motors::Settings::default();
    let wire = session.wire();
    let motors = motors::identify_motors(wire, 3, period_us, &settings, &mut |_| Ok(())).unwrap();
    let motor = &group.robots[1].motor;
    let forward = motor.feedforward();
    for found in &motors {
        println!("{found:?}");
        let near = |found: f32, duty: f32, share: f32| {
            let known = duty * motor.supply;
            assert!(
                (found / known - 1.0).abs() < share,
                "{found} V instead of {known} V"
            );
        };
        near(found.speed, forward.duty_per_rate, 0.01);
        near(found.acceleration, forward.duty_per_acceleration, 0.02);
        // 1 % of the ramp's 4.4 V.
        let friction = found.static_friction - forward.duty_static * motor.supply;
        assert!(friction.abs() < 0.05, "{friction} V");
    }
    motors::accept(wire, 3, &motors).unwrap();
    session.start().unwrap();
}
