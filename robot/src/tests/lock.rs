//! The lock: what a locked robot refuses and what not, who can unlock it, and when it locks itself.

use std::vec;
use std::vec::Vec;

use boot::Slot;
use canopen::{Frame, NmtCommand};
use kinematics::Twist;
use protocol::{Access, Address, ENTRIES, Kind, address as at};

use super::update::bench::{Bench, File, NODE, hmac};
use super::world::World;
use crate::State;
use crate::lock::{CODE_LENGTH, Key, NO_KEY};
use crate::update::order;

const KEY: Key = [7; 32];

const LOCKED: Result<(), u32> = Err(0x0800_0021);
const NOT_NOW: Result<(), u32> = Err(0x0800_0022);
const WRONG: Result<(), u32> = Err(0x0609_0030);

/// A robot whose start is kept in its flash, with a key, locked.
fn locked() -> Bench {
    let mut bench = open();
    bench.write(at::LOCK_KEY, &KEY).unwrap();
    assert_eq!((bench.read(at::LOCK_STATE), bench.key), (2, KEY));
    bench.write(at::LOCK_STATE, &[1]).unwrap();
    assert_eq!(bench.read(at::LOCK_STATE), 1);
    bench
}

fn open() -> Bench {
    let mut bench = Bench::new();
    bench.restart();
    bench.pass(3_000, false);
    bench
}

/// The response under a key to the challenge of this moment.
fn response(bench: &mut Bench, key: &Key) -> Vec<u8> {
    let mut message = bench.read_bytes(at::LOCK_CHALLENGE).unwrap();
    assert_eq!(message.len(), CODE_LENGTH);
    message.push(NODE);
    let mut code = [0; CODE_LENGTH];
    hmac(key, &message, &mut code);
    code.to_vec()
}

fn unlock(bench: &mut Bench, key: &Key) -> Result<(), u32> {
    let response = response(bench, key);
    bench.write(at::LOCK_RESPONSE, &response)
}

fn set_half_track(bench: &mut Bench) -> Result<(), u32> {
    bench.write(at::HALF_TRACK, &0.4_f32.to_le_bytes())
}

#[test]
fn without_a_key_nothing_is_locked_and_there_is_no_challenge() {
    let mut bench = open();
    assert_eq!(bench.read(at::LOCK_STATE), 0);
    assert_eq!(bench.read_bytes(at::LOCK_CHALLENGE), Err(0x0800_0024));
    assert_eq!(
        bench.write(at::LOCK_RESPONSE, &[0; CODE_LENGTH]),
        Err(0x0800_0024)
    );
    bench.write(at::LOCK_STATE, &[1]).unwrap();
    assert_eq!(bench.read(at::LOCK_STATE), 0);
    assert_eq!(set_half_track(&mut bench), Ok(()));
    bench.pass(700_000, false);
    assert_eq!(set_half_track(&mut bench), Ok(()));
}

#[test]
fn a_locked_robot_refuses_every_guarded_object_and_nothing_has_changed() {
    let mut bench = locked();
    let before = *bench.bus.parameters();
    let mut refused = 0;
    for entry in ENTRIES.iter().filter(|entry| entry.is_guarded()) {
        // Another value than before, which would be taken: an object that is refused for its value
        // would be refused by an unlocked robot, too.
        let [low, high] = [entry.min(), entry.max()].map(|value| value.to_bytes());
        let length = usize::from(entry.kind.bytes());
        for bytes in [low, high] {
            let data = match entry.kind {
                Kind::Domain => &[1; 32][..],
                _ => &bytes[..length],
            };
            // What is streamed is refused by its sink.
            assert_eq!(
                bench.write(entry.address, data),
                LOCKED,
                "{:?}",
                entry.address
            );
        }
        refused += 1;
    }
    assert!(refused > 100, "{refused}");
    let communication = [
        (Address::new(0x1017, 0), &[200, 0][..]),
        (Address::new(0x1400, 2), &[255]),
        (Address::new(0x1F80, 0), &[0; 4]),
        (Address::new(0x1010, 1), b"save"),
        (Address::new(0x1011, 1), b"load"),
    ];
    for (address, data) in communication {
        assert_eq!(bench.write(address, data), LOCKED, "{address:?}");
    }
    assert_eq!(*bench.bus.parameters(), before);
    assert_eq!(bench.bus.image_to_store(), None);
    assert_eq!(bench.key, KEY);
    assert_eq!(bench.read(at::PROGRAM_CONTROL), 1, "no update has begun");
    assert_eq!(bench.read_bytes(at::LOCK_KEY), Err(0x0601_0001));
    unlock(&mut bench, &KEY).unwrap();
    for (address, data) in communication.into_iter().take(2) {
        assert_eq!(bench.write(address, data), Ok(()), "{address:?}");
    }
    assert_eq!(set_half_track(&mut bench), Ok(()));
    assert_ne!(*bench.bus.parameters(), before);
}

#[test]
fn a_locked_robot_takes_no_node_id_by_lss() {
    let mut bench = locked();
    let answer = |bench: &mut Bench, data: [u8; 8]| {
        bench
            .bus
            .on_frame(bench.now, &Frame::new(0x7E5, &data).unwrap());
        core::iter::from_fn(|| bench.bus.pop_frame()).find(|frame| frame.id() == 0x7E4)
    };
    let set = |bench: &mut Bench| {
        answer(bench, [0x04, 1, 0, 0, 0, 0, 0, 0]);
        let set = answer(bench, [0x11, 9, 0, 0, 0, 0, 0, 0]).unwrap();
        answer(bench, [0x04, 0, 0, 0, 0, 0, 0, 0]);
        set.data()[1]
    };
    assert_ne!(set(&mut bench), 0);
    unlock(&mut bench, &KEY).unwrap();
    assert_eq!(set(&mut bench), 0);
}

#[test]
fn only_the_key_unlocks_and_a_response_serves_once() {
    let mut bench = locked();
    let old = response(&mut bench, &KEY);
    assert_eq!(bench.write(at::LOCK_RESPONSE, &old), Ok(()));
    assert_eq!(bench.read(at::LOCK_STATE), 2);
    bench.write(at::LOCK_STATE, &[1]).unwrap();
    // Recorded, and sent again.
    assert_eq!(bench.write(at::LOCK_RESPONSE, &old), WRONG);
    bench.pass(3_000, false);
    let other = [8; 32];
    assert_eq!(unlock(&mut bench, &other), WRONG);
    bench.pass(4_000, false);
    // To a challenge that another attempt has used up.
    let stale = response(&mut bench, &KEY);
    assert_eq!(bench.write(at::LOCK_RESPONSE, &[0; CODE_LENGTH]), WRONG);
    bench.pass(6_000, false);
    assert_eq!(bench.write(at::LOCK_RESPONSE, &stale), WRONG);
    assert_eq!(bench.read(at::LOCK_STATE), 1);
    assert_eq!(
        bench.write(at::LOCK_RESPONSE, &stale),
        NOT_NOW,
        "barred for ten seconds"
    );
    bench.pass(12_000, false);
    for length in [63, 65] {
        assert_eq!(
            bench.write(at::LOCK_RESPONSE, &vec![0; length]),
            Err(0x0607_0010)
        );
    }
    assert_eq!(unlock(&mut bench, &KEY), Ok(()));
}

/// A second, then twice as long each time, up to 64 s; in units of 1.05 s, of which one has begun.
#[test]
fn wrong_responses_bar_further_ones_for_longer_and_longer() {
    let mut bench = locked();
    for (nth, wait_s) in [1, 2, 4, 8, 16, 32, 64, 64].into_iter().enumerate() {
        assert_eq!(unlock(&mut bench, &NO_KEY), WRONG);
        bench.pass(wait_s * 1_000, false);
        // A reset does not help.
        if nth == 3 {
            bench.nmt(0x81);
            bench.nmt(0x82);
        }
        assert_eq!(unlock(&mut bench, &KEY), NOT_NOW, "after {wait_s} s");
        bench.pass(wait_s * 49 + 1_050, false);
    }
    assert_eq!(unlock(&mut bench, &KEY), Ok(()));
    // And from the beginning.
    bench.write(at::LOCK_STATE, &[1]).unwrap();
    assert_eq!(unlock(&mut bench, &NO_KEY), WRONG);
    bench.pass(2_100, false);
    assert_eq!(unlock(&mut bench, &KEY), Ok(()));
}

#[test]
fn a_robot_locks_itself_when_idle_and_at_every_reset() {
    let mut bench = locked();
    unlock(&mut bench, &KEY).unwrap();
    bench.pass(590_000, false);
    assert_eq!(
        set_half_track(&mut bench),
        Ok(()),
        "which restarts the count"
    );
    bench.pass(590_000, false);
    assert_eq!(bench.read(at::LOCK_STATE), 2, "which does not");
    bench.pass(12_000, false);
    assert_eq!(bench.read(at::LOCK_STATE), 1);
    assert_eq!(set_half_track(&mut bench), LOCKED);
    for reset in [0x81, 0x82] {
        unlock(&mut bench, &KEY).unwrap();
        bench.nmt(reset);
        assert_eq!(bench.read(at::LOCK_STATE), 1);
    }
    unlock(&mut bench, &KEY).unwrap();
    bench.restart();
    assert_eq!(bench.read(at::LOCK_STATE), 1);
    assert_eq!(set_half_track(&mut bench), LOCKED);
}

/// No challenge comes again at a later start, which would make a recorded response good.
#[test]
fn each_start_has_challenges_of_its_own() {
    let mut bench = locked();
    let mut seen = Vec::new();
    for _ in 0..5 {
        let old = response(&mut bench, &KEY);
        assert!(!seen.contains(&old));
        seen.push(old.clone());
        bench.restart();
        // Its number could be lost yet.
        assert_eq!(bench.read_bytes(at::LOCK_CHALLENGE), Err(0x0800_0022));
        assert_eq!(bench.write(at::LOCK_RESPONSE, &old), NOT_NOW);
        bench.pass(3_000, false);
        assert_eq!(bench.write(at::LOCK_RESPONSE, &old), WRONG);
        bench.pass(3_000, false);
    }
}

#[test]
fn the_key_is_changed_and_removed_by_who_has_it() {
    let mut bench = locked();
    assert_eq!(bench.write(at::LOCK_KEY, &[8; 32]), LOCKED);
    unlock(&mut bench, &KEY).unwrap();
    for length in [31, 33] {
        let wrong = bench.write(at::LOCK_KEY, &vec![1; length]);
        assert_eq!(wrong, Err(0x0607_0010));
    }
    bench.write(at::LOCK_KEY, &[8; 32]).unwrap();
    bench.restart();
    bench.pass(3_000, false);
    assert_eq!(unlock(&mut bench, &KEY), WRONG);
    bench.pass(3_000, false);
    assert_eq!(unlock(&mut bench, &[8; 32]), Ok(()));
    // Restoring the defaults leaves it alone.
    bench.write(at::LOCK_KEY, &NO_KEY).unwrap();
    assert_eq!(bench.read(at::LOCK_STATE), 0);
    bench.restart();
    assert_eq!(set_half_track(&mut bench), Ok(()));
}

/// The start of a new image locks the robot; its trial can be ended all the same.
#[test]
fn a_trial_is_ended_while_locked() {
    for end in [order::CONFIRM, 0x81] {
        let mut bench = locked();
        let file = File::new(|_| ()).download(Slot::B);
        assert_eq!(bench.control(order::STOP), LOCKED);
        unlock(&mut bench, &KEY).unwrap();
        bench.control(order::STOP).unwrap();
        bench.control(order::CLEAR).unwrap();
        bench.download(&file).unwrap();
        bench.control(order::START).unwrap();
        assert_eq!(bench.read(at::PROGRAM_CONTROL), 0x80, "on trial");
        assert_eq!(bench.read(at::LOCK_STATE), 1);
        assert_eq!(bench.control(order::STOP), LOCKED);
        assert_eq!(bench.control(end), Ok(()));
        assert_eq!(bench.control(end), LOCKED, "it is over");
    }
}

#[test]
fn a_locked_robot_drives_and_stops_as_any_other() {
    let mut world = World::new(&[2]);
    world.configure();
    world.robots[0].bus.load_lock(KEY, hmac);
    assert_eq!(world.read(2, at::LOCK_STATE).map(|word| word & 0xFF), Ok(1));
    world.start();
    world.drive(Twist::new(0.3, 0.0, 0.0), 1_000);
    assert!((world.robots[0].moves().vx - 0.3).abs() < 0.03);
    assert_eq!(
        world.read_block(2, at::LOCK_CHALLENGE),
        Err(0x0800_0022),
        "not while it moves"
    );
    world.nmt(NmtCommand::EnterPreOperational, 2);
    world.run(3_000);
    assert_eq!(world.robots[0].bus.state(), State::Ready);
    assert!(!world.robots[0].outputs.drivers_enabled);
    // What may be written at any time may be still.
    let free = ENTRIES
        .iter()
        .filter(|entry| entry.access() == Access::ReadWrite && !entry.is_guarded());
    assert!(free.count() > 10);
    assert_eq!(world.write(2, at::BLINK, protocol::Value::U8(1)), Ok(()));
}
