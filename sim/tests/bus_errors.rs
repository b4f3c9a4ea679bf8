//! Errors on the bus and what native robots' CAN controllers make of them: ISO 11898-1's counters,
//! bit for bit.

mod common;

use canopen::Frame;
use common::{all, counters, received, run};
use group::GroupFile;
use omnibus_sim::bus::disturb::Share;
use omnibus_sim::bus::errors::ErrorState;
use omnibus_sim::{Backend, MASTER, Options, World};
use protocol::Fault;

/// Time from power to a robot's boot-up frame, us.
const BOOT_US: u64 = 3_000;

fn group(name: &str) -> GroupFile {
    GroupFile::load(format!(
        "{}/../groups/{name}.toml",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap()
}

fn world(name: &str) -> World {
    World::new(&group(name), Backend::Native, Options::default()).unwrap()
}

fn frame(id: u16) -> Frame {
    Frame::new(id, &[]).unwrap()
}

/// A frame of 45 bits (`frames_counted_by_hand`), 35 of them up to the end of its checksum. An
/// error-active sender destroys it after the acknowledge slot: 37 bits, a flag of 1 and 6,
/// delimiter 8, intermission 3, so 55; that 16 times. Then it is error passive, begins 8 bits later
/// than others could, and the frame stands, again and again.
#[test]
fn a_lost_acknowledge_makes_the_sender_passive_and_the_receivers_get_it_again() {
    let mut world = world("single");
    let sender = world.add_port();
    world.set_lost_acknowledge(all(0x555));
    world.send_from(sender, frame(0x555));
    run(&mut world, 1_050);
    assert_eq!(world.error_frames(), 16);
    assert_eq!(world.port_errors(sender).0, ErrorState::Passive);
    assert_eq!(world.port_errors(sender).1, counters(128, 0));
    // 16 errors and three good frames.
    assert_eq!(world.port_errors(MASTER).1, counters(0, 13));
    let first = 16 * 55 + 8 + 45;
    let again = 3 + 8 + 45;
    let wanted = [first, first + again, first + 2 * again].map(|at| (at, 0x555));
    assert_eq!(received(&mut world), wanted);
    // The fourth one is acknowledged: that is all.
    world.set_lost_acknowledge(Share::NONE);
    run(&mut world, 2_000);
    assert_eq!(received(&mut world).len(), 1);
    assert_eq!(world.port_errors(sender).1, counters(127, 0));
    let busy = 16 * 55 + 4 * (45 + 3);
    let load = world.truth().bus_load;
    assert!((load - f64::from(busy) / 2_000.0).abs() < 1e-9, "{load}");
}

/// 16 failures to error passive, of which it tells the others, and 17 more to bus-off, because what
/// it told was a good frame; then silence, 128 times 11 bits, and an announcement.
#[test]
fn a_robot_whose_frames_are_destroyed_goes_off_the_bus_and_comes_back() {
    let mut world = world("single");
    world.set_corruption(all(0x702));
    let mut states = Vec::new();
    for tenth_ms in 300..700 {
        run(&mut world, tenth_ms * 10);
        let (state, counters) = world.robot_errors(0);
        if states.last().is_none_or(|(last, _)| *last != state) {
            states.push((state, counters.transmit));
        }
    }
    let wanted = [
        (ErrorState::Active, 0),
        (ErrorState::Passive, 128),
        (ErrorState::Active, 127),
        (ErrorState::Passive, 135),
        (ErrorState::BusOff, 263),
    ];
    assert_eq!(states, wanted);
    assert_eq!(world.error_frames(), 33);
    assert_eq!(world.port_errors(MASTER).1, counters(0, 32));
    let ids: Vec<u16> = received(&mut world).iter().map(|(_, id)| *id).collect();
    assert_eq!(ids, [0x082]);
    world.set_corruption(Share::NONE);
    run(&mut world, 1_000_000);
    assert_eq!(world.robot_errors(0), Default::default());
    let mut emergencies = Vec::new();
    let mut heartbeats = 0;
    while let Some((_, frame)) = world.take_received(MASTER) {
        match frame.id() {
            0x082 => emergencies.push(u16::from_le_bytes([frame.data()[0], frame.data()[1]])),
            0x702 => heartbeats += 1,
            other => panic!("0x{other:03X}"),
        }
    }
    assert!(
        emergencies.contains(&Fault::BusOff.code()),
        "{emergencies:X?}"
    );
    assert!(heartbeats > 5);
}

/// The bad receiver counts 9 for every frame it destroys and is error passive after 15; from then
/// on it can only fail to hear, and counts 1. The others count 1 each time and take that back with
/// a good frame, the sender 8. The second good frame is the emergency message that the bad receiver
/// is error passive.
#[test]
fn a_bad_receiver_destroys_fifteen_frames_and_then_only_misses_them() {
    let mut world = world("tcc-2");
    // Before the first heartbeats.
    run(&mut world, 20_000);
    world.set_bad_receiver(1, all(0x7F0));
    world.send(frame(0x7F0));
    run(&mut world, 30_000);
    assert_eq!(world.error_frames(), 15);
    assert_eq!(
        world.robot_errors(1),
        (ErrorState::Passive, counters(0, 136))
    );
    assert_eq!(world.robot_errors(0), (ErrorState::Active, counters(0, 13)));
    assert_eq!(world.port_errors(MASTER).1, counters(119, 0));
    assert_eq!(passives(&mut world), [0x8120], "it says so, once");
}

/// Codes of the emergency messages of node 3.
fn passives(world: &mut World) -> Vec<u16> {
    let frames = std::iter::from_fn(|| world.take_received(MASTER));
    frames
        .filter(|(_, frame)| frame.id() == 0x083)
        .map(|(_, frame)| u16::from_le_bytes([frame.data()[0], frame.data()[1]]))
        .collect()
}

#[test]
fn a_babbling_node_fills_the_bus_and_only_higher_priorities_get_through() {
    let mut world = world("tcc-2");
    let sender = world.add_port();
    world.set_babbler(Some(0x001));
    run(&mut world, 150_000);
    let load = world.bus_load();
    assert!((load.largest - 1.0).abs() < 1e-9, "{load:?}");
    assert!(received(&mut world).iter().all(|(_, id)| *id == 0x001));
    world.send_from(sender, frame(0x000));
    run(&mut world, 151_000);
    assert_eq!(
        received(&mut world)
            .iter()
            .filter(|(_, id)| *id == 0)
            .count(),
        1
    );
    world.set_babbler(None);
    run(&mut world, 200_000);
    let robots: Vec<_> = received(&mut world)
        .iter()
        .map(|(_, id)| *id)
        .filter(|id| *id > 1)
        .collect();
    // They have waited, the lower identifier's heartbeats before the higher one's.
    assert!(
        robots.starts_with(&[0x702]) && robots.contains(&0x703),
        "{robots:X?}"
    );
}

#[test]
fn a_robot_that_babbles_does_not_say_what_it_has_to_say() {
    let mut world = world("tcc-2");
    world.set_babbling(1, Some(0x7FE));
    run(&mut world, 50_000);
    let ids: Vec<_> = received(&mut world).iter().map(|(_, id)| *id).collect();
    assert!(ids.contains(&0x702) && ids.contains(&0x7FE) && !ids.contains(&0x703));
}

/// The boot-up frame is on the wire when the connector is pulled: an error frame ends it. The robot
/// then sends to no node until it is error passive, and its frame goes out when the connector is
/// back.
#[test]
fn a_connector_pulled_in_the_middle_of_a_frame_destroys_it() {
    let mut world = world("single");
    run(&mut world, BOOT_US + 30);
    assert_eq!(world.frames(), 1, "on the wire");
    world.set_connected(0, false);
    run(&mut world, 20_000);
    assert_eq!((world.frames(), world.error_frames()), (0, 1));
    assert_eq!(world.port_errors(MASTER).1, counters(0, 1));
    assert_eq!(
        world.robot_errors(0),
        (ErrorState::Passive, counters(128, 0))
    );
    world.set_connected(0, true);
    run(&mut world, 21_000);
    // And the emergency message that it was error passive.
    let ids: Vec<u16> = received(&mut world).iter().map(|(_, id)| *id).collect();
    assert_eq!(ids, [0x082, 0x702]);
    assert_eq!(
        world.robot_errors(0),
        (ErrorState::Active, counters(126, 0))
    );
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
    let mut world = world("single");
    let sender = world.add_port();
    world.set_port_delay(1_500_000);
    world.send_from(sender, frame(0x555));
    run(&mut world, 2_000);
    assert_eq!(received(&mut world), [(1_500 + 45, 0x555)]);
}

#[test]
fn chance_comes_from_the_seed_alone() {
    let digest = |seed, of| {
        let mut group = group("tcc-3");
        group.simulation.seed = seed;
        let mut world = World::new(&group, Backend::Native, Options::default()).unwrap();
        world.set_corruption(Share { of, id: None });
        run(&mut world, 1_000_000);
        (world.digest(), world.error_frames())
    };
    assert_eq!(digest(1, 0.3), digest(1, 0.3));
    assert_ne!(digest(1, 0.3), digest(2, 0.3));
    assert_eq!(digest(1, 0.0), digest(2, 0.0));
    // 30 frames in a second, and 0.3 / 0.7 of that again: some.
    assert!((3..40).contains(&digest(1, 0.3).1));
}
