//! Power that is lost at every flash operation of an update, and at every one of the update that
//! repairs it, with the release image on an emulated robot.
//!
//! The update brings the shortest image there is, so that every word of it can be cut. The image
//! does nothing but sleep: started on trial, it is ended by the watchdog three times, and the old
//! image is back. So the attempts that the boot code notes are cut as well.
//!
//! The emulator notes during a whole update what a cut in each operation would leave. What the
//! robot does next follows from that content alone, so a content that came before is not tried
//! again. The second cut comes in the repair after every cut in an erase or a word of the records,
//! and after one in eight words of the image: after the others the slot is erased as well, and what
//! is left is the same.

use super::*;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

const SAVE: Address = Address::new(0x1010, 1);
/// A parameter that is stored before the update, half the track in m; 0.2 if nothing is stored.
const STORED: f32 = 0.25;
/// Words of the small image.
const WORDS: u32 = boot::slots::SHORTEST_IMAGE / 4;
/// Three times the watchdog's three seconds, with its slowest oscillator, and the starts.
const TRIALS_NS: u64 = 20_000 * MS;

/// What a robot has to be after its power was lost in an operation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Expected {
    /// What it says of the image in the other slot: 0 until that is whole and checked.
    other_version: u32,
    /// How often the watchdog ends the new image until the old one runs.
    resets: u32,
}

/// What power cuts have left, in the order of the operations.
type Left = Vec<(Content, Expected)>;

/// Of so many words of the image, one is cut once more in the repair.
const ONE_IN: usize = 8;

/// A robot that is flashed by cable and updated so often, its power off.
fn before(file: &File, updates: u32) -> Content {
    let mut robot = flashed(file);
    robot.write(at::HALF_TRACK, &STORED.to_le_bytes()).unwrap();
    robot.write(SAVE, b"save").unwrap();
    for _ in 0..updates {
        let download = match robot.slot() {
            Some(Slot::A) => file.download(|_| ()),
            _ => file.download_a(),
        };
        update(&mut robot, &download).unwrap();
    }
    robot.content()
}

/// Brings the small image, which fails on trial; returns what is left by a power cut in each
/// operation.
fn cut_everywhere(robot: &mut Robot, download: &[u8], old: Slot) -> Left {
    let operations = |robot: &Robot| {
        let done = robot.board.flash_operations();
        (done.programs + done.erases) as u32
    };
    let begun = operations(robot);
    robot.board.record_power_cuts();
    receive(robot, download).unwrap();
    let sealed = operations(robot) - begun;
    robot.control(order::START).unwrap();
    assert!(robot.boots_within(TRIALS_NS).unwrap());
    assert_eq!(robot.slot(), Some(old));
    let cuts = robot.board.take_power_cuts();
    // The order to start, and the attempts.
    let ordered = sealed + 1;
    assert_eq!(cuts.len() as u32, ordered + u32::from(ATTEMPTS));
    assert!(sealed > WORDS, "a word is an operation");
    let expected = (1..).map(|nth| Expected {
        other_version: if nth > sealed { NEW } else { 0 },
        resets: match nth >= ordered {
            true => u32::from(ATTEMPTS) - (nth - ordered),
            false => 0,
        },
    });
    cuts.into_iter().map(Content).zip(expected).collect()
}

/// The robot at its next power-on: it runs the old image, has its parameters, and says what it has
/// lost.
fn starts(file: &File, content: &Content, old: Slot, expected: Expected) -> Robot {
    let mut robot = Robot::new(&file.firmware, Some(content));
    assert!(robot.boots_within(TRIALS_NS).unwrap(), "dead: {expected:?}");
    assert_eq!(robot.slot(), Some(old), "{expected:?}");
    assert_eq!(robot.board.resets(), expected.resets, "{expected:?}");
    let found = robot.read(at::OTHER_VERSION);
    assert_eq!(found, Ok(expected.other_version), "{expected:?}");
    assert_eq!(robot.read(at::HALF_TRACK), Ok(STORED.to_bits()));
    // It does not offer to go back to what is in pieces, or has failed.
    let refused = Err(Failure::Refused(AbortCode::DeviceState.code()));
    assert_eq!(robot.control(order::GO_BACK), refused, "{expected:?}");
    robot
}

/// Does something with all that is left, on both cores.
fn on_both_cores(left: &Left, work: impl Fn(usize, &Content, Expected) + Sync) {
    let all = Mutex::new(left.iter().enumerate());
    let next = || all.lock().unwrap().next();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some((nth, (content, expected))) = next() {
                    work(nth, content, *expected);
                }
            });
        }
    });
}

/// See the [module](self). Slot A as the cable has left it; slot B with that of the cable to
/// replace; slot A with an image in slot B that was confirmed, where the second cut comes as well.
pub fn power_lost_at_every_operation_and_again_in_the_repair(robots: &Robots) {
    let file = File::new(robots);
    for (updates, old) in [(0, Slot::A), (1, Slot::B), (2, Slot::A)] {
        let download = file.download_that_sleeps(old.other());
        let content = before(&file, updates);
        let mut robot = Robot::new(&file.firmware, Some(&content));
        assert!(robot.boots().unwrap());
        let first = cut_everywhere(&mut robot, &download, old);
        println!("{updates} updates before: {} cuts", first.len());
        // Before the image: a word or two that discard the slot, two erases, a word or two that
        // begin it.
        let image = 6..6 + WORDS as usize;
        let second = Mutex::new(BTreeMap::new());
        on_both_cores(&first, |nth, content, expected| {
            let mut robot = starts(&file, content, old, expected);
            if updates < 2 || image.contains(&nth) && nth % ONE_IN != 0 {
                return;
            }
            let left = cut_everywhere(&mut robot, &download, old);
            for (content, expected) in left {
                match second.lock().unwrap().entry(content.0) {
                    Entry::Occupied(same) => assert_eq!(*same.get(), expected, "{nth}"),
                    Entry::Vacant(free) => {
                        free.insert(expected);
                    }
                }
            }
        });
        let second = second.into_inner().unwrap().into_iter();
        let second: Left = second.map(|(bytes, cut)| (Content(bytes), cut)).collect();
        println!("and in the repair: {} contents", second.len());
        on_both_cores(&second, |_, content, expected| {
            starts(&file, content, old, expected);
        });
    }
}
