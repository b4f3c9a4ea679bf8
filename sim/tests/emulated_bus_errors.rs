//! Errors on the bus and what the emulated bxCAN makes of them under the release image: ISO
//! 11898-1's counters, and that the firmware comes back. Needs the image: `cargo xtask test` builds
//! it, switches these tests on and names it in `OMNIBUS_ELF`. Native robots have the same in
//! `bus_errors.rs`.

mod common;

use canopen::Frame;
use common::{all, counters, received, run};
use emulator::Firmware;
use group::GroupFile;
use omnibus_sim::bus::disturb::Share;
use omnibus_sim::bus::errors::ErrorState;
use omnibus_sim::{Backend, MASTER, Options, World};
use protocol::Fault;

fn world(name: &str) -> World {
    let path = std::env::var("OMNIBUS_ELF")
        .expect("OMNIBUS_ELF names a release image; cargo xtask test sets it");
    let folder = env!("CARGO_MANIFEST_DIR");
    let group = GroupFile::load(format!("{folder}/../groups/{name}.toml")).unwrap();
    let image = Firmware::load(path).unwrap();
    World::new(&group, Backend::Emulator(image), Options::default()).unwrap()
}

/// 16 failures to error passive, 32 to bus-off; then silence, recovery, and an announcement by the
/// firmware.
#[test]
fn destroyed_frames_lead_off_the_bus_and_the_firmware_comes_back() {
    let mut world = world("single");
    world.set_corruption(all(0x702));
    let mut states = Vec::new();
    for tenth_ms in 1..150 {
        run(&mut world, tenth_ms * 100);
        let (state, counters) = world.robot_errors(0);
        if states.last().is_none_or(|(last, _)| *last != state) {
            states.push((state, counters.transmit));
        }
    }
    let [
        (ErrorState::Active, 0),
        (ErrorState::Passive, passive),
        (ErrorState::BusOff, off),
        ..,
    ] = &*states
    else {
        panic!("{states:?}");
    };
    assert!((128..256).contains(passive) && *off >= 248, "{states:?}");
    world.set_corruption(Share::NONE);
    run(&mut world, 1_500_000);
    assert_eq!(world.robot_errors(0), Default::default());
    let (mut emergencies, mut heartbeats) = (Vec::new(), 0);
    while let Some((_, frame)) = world.take_received(MASTER) {
        match frame.id() {
            0x082 => emergencies.push(u16::from_le_bytes([frame.data()[0], frame.data()[1]])),
            0x702 => heartbeats += 1,
            other => panic!("0x{other:03X}"),
        }
    }
    let code = Fault::BusOff.code();
    assert!(emergencies.contains(&code), "{emergencies:X?}");
    assert!(heartbeats > 5, "{heartbeats}");
}

/// An error-active transmitter without acknowledgement counts 8 each time until it is error
/// passive, then no more.
#[test]
fn a_lost_acknowledge_makes_it_passive_and_it_sends_again() {
    let mut world = world("single");
    world.set_lost_acknowledge(all(0x702));
    // The firmware is on the bus some 9 ms after power-on; a repetition takes 0.08 ms. It looks at
    // the error counters every 5 ms at the latest when nothing else happens.
    run(&mut world, 20_000);
    assert_eq!(world.error_frames(), 16);
    let passive = (ErrorState::Passive, counters(128, 0));
    assert_eq!(world.robot_errors(0), passive);
    let again = received(&mut world);
    assert!(again.len() > 50 && again.iter().all(|(_, id)| *id == 0x702));
    world.set_lost_acknowledge(Share::NONE);
    run(&mut world, 30_000);
    // The repetition under way when acknowledges came back, still lost or not, one that stands,
    // which takes one off, and the emergency message that it was error passive, which takes another
    // off.
    let ids: Vec<u16> = received(&mut world).iter().map(|(_, id)| *id).collect();
    assert!(
        (2..=3).contains(&ids.len()) && ids.ends_with(&[0x702, 0x082]),
        "{ids:X?}"
    );
    let active = (ErrorState::Active, counters(126, 0));
    assert_eq!(world.robot_errors(0), active);
}

/// One repetition takes 0.1 ms and a frame that stands makes the node error active again: a spell
/// far shorter than the 5 ms after which the firmware looks at the counters anyway, and as short as
/// a turn of the bus task or a control tick that is under way. So it is tried at every moment of a
/// tick.
#[test]
fn a_spell_of_error_passive_shorter_than_a_millisecond_is_announced() {
    for phase_us in (0..1_000).step_by(20) {
        spell_is_announced(phase_us);
    }
}

fn spell_is_announced(phase_us: u64) {
    let mut world = world("single");
    run(&mut world, 30_000 + phase_us);
    // 0x2001:1, serial number: what is answered does not get its acknowledge.
    world.set_lost_acknowledge(all(0x582));
    world.send(Frame::of(0x602, [0x40, 0x01, 0x20, 1, 0, 0, 0, 0]));
    let mut spell_us = (0, 0);
    for at_us in (30_000 + phase_us..50_000).step_by(10) {
        run(&mut world, at_us);
        let passive = world.robot_errors(0).0 == ErrorState::Passive;
        if passive && spell_us.0 == 0 {
            spell_us.0 = at_us;
            world.set_lost_acknowledge(Share::NONE);
        } else if !passive && spell_us.0 > 0 {
            spell_us.1 = at_us;
            break;
        }
    }
    let (from, until) = spell_us;
    assert!(
        (50..1_000).contains(&(until - from)),
        "{from} to {until} us"
    );
    // The bus is sound from here on, so what comes is the announcement.
    run(&mut world, until + 2_000);
    let emergencies = received(&mut world);
    let announced = emergencies.iter().find(|(_, id)| *id == 0x082);
    assert!(
        announced.is_some(),
        "{phase_us} us: {from} to {until} us: {emergencies:X?}"
    );
}

/// Fifteen times 9 for what it is the first to see; error passive it destroys nothing more and
/// counts 1.
#[test]
fn a_bad_receiver_destroys_fifteen_frames_and_then_only_misses_them() {
    let mut world = world("tcc-2");
    // Before the first heartbeats.
    run(&mut world, 20_000);
    world.set_bad_receiver(1, all(0x7F0));
    world.send(Frame::new(0x7F0, &[]).unwrap());
    run(&mut world, 30_000);
    assert_eq!(world.error_frames(), 15);
    let (state, errors) = world.robot_errors(1);
    assert_eq!((state, errors), (ErrorState::Passive, counters(0, 136)));
    // 15 up, and down with the frame that stands and with the emergency message of the other.
    let active = (ErrorState::Active, counters(0, 13));
    assert_eq!(world.robot_errors(0), active);
}

/// Lost arbitration is no error: frames wait for a babbler of high priority and come afterwards,
/// the lower first.
#[test]
fn frames_that_lose_arbitration_wait_and_count_nothing() {
    let mut world = world("tcc-2");
    world.set_babbler(Some(0x001));
    run(&mut world, 150_000);
    assert!((world.bus_load().largest - 1.0).abs() < 1e-9);
    assert!(received(&mut world).iter().all(|(_, id)| *id == 0x001));
    for robot in 0..2 {
        let none = (ErrorState::Active, counters(0, 0));
        assert_eq!(world.robot_errors(robot), none);
    }
    world.set_babbler(None);
    // Those that have waited, and none of the next.
    run(&mut world, 155_000);
    let ids = received(&mut world).into_iter().map(|(_, id)| id);
    let robots: Vec<_> = ids.filter(|id| *id > 1).collect();
    assert!(
        robots.is_sorted() && robots.contains(&0x702) && robots.contains(&0x703),
        "{robots:X?}"
    );
}

/// Cut off, it sends to no node until it is error passive; connected again, the frame goes out.
#[test]
fn a_node_that_is_cut_off_sends_when_it_is_back() {
    let mut world = world("single");
    world.set_connected(0, false);
    run(&mut world, 20_000);
    assert_eq!(world.frames(), 0);
    let passive = (ErrorState::Passive, counters(128, 0));
    assert_eq!(world.robot_errors(0), passive);
    world.set_connected(0, true);
    run(&mut world, 21_000);
    // And the emergency message that it was error passive.
    let ids: Vec<u16> = received(&mut world).iter().map(|(_, id)| *id).collect();
    assert_eq!(ids, [0x702, 0x082]);
    let active = (ErrorState::Active, counters(126, 0));
    assert_eq!(world.robot_errors(0), active);
}

#[test]
fn what_is_delayed_comes_later_by_just_that() {
    let boot_up = |delay_ns| {
        let mut world = world("single");
        world.set_delay(0, delay_ns);
        run(&mut world, 50_000);
        received(&mut world)[0].0
    };
    assert_eq!(boot_up(20_000_000), boot_up(0) + 20_000);
}
