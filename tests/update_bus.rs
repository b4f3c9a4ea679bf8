//! Whole updates over the bus: the release image behind its boot code on an emulated board, and a
//! client that walks the sequence of Zephyr's.
//!
//! `OMNIBUS_ELF` names the image for slot A, which has the boot code with it, and
//! `OMNIBUS_ELF_SLOT_B` the one for slot B; `OMNIBUS_ELF_BOARD_C` and `OMNIBUS_ELF_BOARD_C_SLOT_B`
//! those of RoboMaster's Board C, and `OMNIBUS_ELF_DRIVES` the reference board's with smart drives
//! (`cargo xtask test` builds them and says so).

mod common;

use std::sync::Mutex;

use boot::Slot;
use boot::header::Board as ImageBoard;
use boot::records::{ATTEMPTS, State};
use canopen::{AbortCode, Frame};
use emulator::{BoardConfig, Defect, ResetCause};
use protocol::{Address, address as at, cob};
use robot::update::{Problem, order};

#[path = "update/file.rs"]
mod file;
#[path = "update/power.rs"]
mod power;
#[path = "update/robot.rs"]
mod robot_on_bus;

use file::{BOARD_C, DRIVES, File, NEW, REFERENCE, Robots};
use power::power_lost_at_every_operation_and_again_in_the_repair;
use robot_on_bus::{Content, Failure, LONG_US, MS, NODE, Robot, SHORT_US};

/// Object 0x1017.
const HEARTBEAT: Address = Address::new(0x1017, 0);

/// These tests with robots of a kind.
macro_rules! tests {
    ($robots:ident: $($test:ident)*) => {
        $(#[test] fn $test() { super::$test(&super::$robots); })*
    };
}

mod reference {
    tests! { REFERENCE:
        a_poll_is_answered_while_a_sector_is_erased
        what_else_is_asked_while_a_sector_is_erased_is_answered_after_it
        power_lost_anywhere_in_an_update_leaves_a_robot_that_boots_and_takes_the_next
        power_lost_at_every_operation_and_again_in_the_repair
        an_image_that_fails_gives_way_to_the_old_one
        an_image_that_is_never_confirmed_gives_way_to_the_old_one
        an_image_that_confirms_itself_and_dies_is_started_again_and_can_be_sent_back
        a_transfer_that_is_wrong_is_refused_and_the_next_one_taken
        the_same_image_again_and_an_older_one_are_taken
        an_image_for_other_robots_is_refused
    }
}

/// Another chip with the same sectors.
mod board_c {
    tests! { BOARD_C:
        a_poll_is_answered_while_a_sector_is_erased
        what_else_is_asked_while_a_sector_is_erased_is_answered_after_it
        power_lost_anywhere_in_an_update_leaves_a_robot_that_boots_and_takes_the_next
        an_image_that_fails_gives_way_to_the_old_one
        an_image_that_is_never_confirmed_gives_way_to_the_old_one
        an_image_that_confirms_itself_and_dies_is_started_again_and_can_be_sent_back
        a_transfer_that_is_wrong_is_refused_and_the_next_one_taken
        the_same_image_again_and_an_older_one_are_taken
        an_image_for_other_robots_is_refused
    }
}

mod smart_drives {
    tests! { DRIVES: an_image_for_other_robots_is_refused }
}

/// A robot as it was flashed by cable, on the bus.
fn flashed(file: &File) -> Robot {
    let mut robot = Robot::new(&file.firmware, None);
    assert!(robot.boots().unwrap());
    robot
}

/// The client's steps until the new image is checked.
fn receive(robot: &mut Robot, download: &[u8]) -> Result<(), Failure> {
    robot.ready()?;
    robot.control(order::STOP)?;
    robot.control(order::CLEAR)?;
    robot.ready()?;
    robot.download(download)?;
    assert_eq!(robot.ready()?, 0);
    Ok(())
}

/// The same, and the order to start it.
fn bring(robot: &mut Robot, download: &[u8]) -> Result<(), Failure> {
    receive(robot, download)?;
    robot.control(order::START)
}

/// The whole sequence.
fn update(robot: &mut Robot, download: &[u8]) -> Result<(), Failure> {
    bring(robot, download)?;
    assert!(robot.boots()?, "the new image starts");
    robot.control(order::CONFIRM)?;
    robot.ready().map(|_| ())
}

/// A robot that has just been ordered to start the new image: a copy of one for all tests.
fn brought(file: &File) -> Robot {
    static BROUGHT: Mutex<Vec<(ImageBoard, Robot)>> = Mutex::new(Vec::new());
    let mut all = BROUGHT.lock().unwrap();
    if let Some((_, robot)) = all.iter().find(|(board, _)| *board == file.board) {
        return robot.clone();
    }
    let mut robot = flashed(file);
    bring(&mut robot, &file.download(|_| ())).unwrap();
    all.push((file.board, robot.clone()));
    robot
}

/// Power-on with this content: the slot that is on the bus. The robot stays.
fn slot_after(file: &File, content: &Content) -> (Robot, Option<Slot>) {
    let mut robot = Robot::new(&file.firmware, Some(content));
    if !robot.boots().unwrap() {
        return (robot, None);
    }
    let slot = robot.slot();
    (robot, slot)
}

/// A client whose timeout is a sixth of the longest erase is answered all the time, on slow flash
/// and with the fastest oscillator of the watchdog as well; and the heartbeat goes on.
fn a_poll_is_answered_while_a_sector_is_erased(robots: &Robots) {
    let file = File::new(robots);
    for (times, lsi_hz) in [(1, 32_000), (2, 47_000)] {
        let config = BoardConfig {
            lsi_hz,
            defects: vec![Defect::FlashSlow(times)],
            ..BoardConfig::default()
        };
        let mut robot = Robot::with(&file.firmware, None, config);
        assert!(robot.boots().unwrap());
        robot.timeout_us = SHORT_US;
        let period_ms = u64::from(robot.read(HEARTBEAT).unwrap());
        robot.control(order::STOP).unwrap();
        robot.control(order::CLEAR).unwrap();
        let (from, before) = (robot.board.now_ns(), robot.received.len());
        assert_eq!(robot.ready(), Ok(0));
        let erased_ms = (robot.board.now_ns() - from) / MS;
        // DS10693 rev 10, table 49: a second for each of two sectors typically, and two at most.
        assert!(erased_ms > times * 1_900, "{erased_ms} ms");
        assert_eq!(robot.board.flash_operations().erases, 2);
        assert_eq!(robot.board.resets(), 0);
        let beat = Frame::of(cob::heartbeat(NODE), [0x7F]);
        let beats = robot.received[before..]
            .iter()
            .filter(|(_, one)| *one == beat);
        let promised = erased_ms / period_ms;
        let beats = beats.count() as u64;
        assert!(
            beats.abs_diff(promised) <= 3,
            "{beats} heartbeats, {promised} were due"
        );
    }
}

/// Another request than the poll, and one of NMT, wait for the end of the sector, and are not lost.
fn what_else_is_asked_while_a_sector_is_erased_is_answered_after_it(robots: &Robots) {
    let file = File::new(robots);
    let mut robot = flashed(&file);
    robot.control(order::STOP).unwrap();
    robot.control(order::CLEAR).unwrap();
    robot.pass(100 * MS).unwrap();
    robot.timeout_us = 2 * LONG_US;
    let from = robot.board.now_ns();
    let period_ms = robot.read(HEARTBEAT).unwrap();
    assert!(period_ms > 0);
    let waited_ms = (robot.board.now_ns() - from) / MS;
    assert!((800..1_000).contains(&waited_ms), "{waited_ms} ms");
    // In the next sector: NMT stops the robot, which ends the update.
    robot.pass(100 * MS).unwrap();
    assert_eq!(robot.board.flash_operations().erases, 2);
    robot.send(&Frame::of(cob::NMT, [2, NODE])).unwrap();
    robot.pass(1_500 * MS).unwrap();
    let stopped = Frame::of(cob::heartbeat(NODE), [4]);
    assert!(robot.received.iter().any(|(_, frame)| *frame == stopped));
}

/// Power lost in every erase, in every word of what is known about the slots, and in some of the
/// image: the robot then runs the old image or, once that was ordered, the new one, and takes
/// another update.
fn power_lost_anywhere_in_an_update_leaves_a_robot_that_boots_and_takes_the_next(robots: &Robots) {
    let file = File::new(robots);
    let download = file.download(|_| ());
    let operations = |robot: &Robot| {
        let done = robot.board.flash_operations();
        done.programs + done.erases
    };
    // How many operations have been begun after each step.
    let mut robot = flashed(&file);
    robot.control(order::STOP).unwrap();
    robot.control(order::CLEAR).unwrap();
    robot.ready().unwrap();
    let cleared = operations(&robot);
    robot.download(&download).unwrap();
    let whole = operations(&robot);
    assert!(whole > cleared + 20_000, "a word is an operation");
    // The words of the seal, the order to start, the attempt, the confirmation: noted on the way.
    robot.board.record_power_cuts();
    robot.ready().unwrap();
    let sealed = operations(&robot);
    robot.control(order::START).unwrap();
    assert!(robot.boots().unwrap());
    let started = operations(&robot);
    robot.control(order::CONFIRM).unwrap();
    robot.ready().unwrap();
    let noted = robot.board.take_power_cuts();
    assert_eq!(operations(&robot) - whole, noted.len() as u64);
    assert!(sealed - whole >= 7 && sealed < started);
    assert_eq!(robot.slot(), Some(Slot::B));

    // The erases, and some words of the image with its last: cut.
    let cuts = (1..=cleared + 1).chain((1..=4).map(|part| cleared + part * (whole - cleared) / 4));
    let left = cuts.map(|cut| {
        let mut robot = flashed(&file);
        robot.board.cut_power_at_flash_operation(cut);
        let ended = update(&mut robot, &download);
        assert_eq!(ended, Err(Failure::PowerCut), "{cut}");
        (cut, robot.content())
    });
    let noted = noted.into_iter().map(Content);
    for (nth, (cut, content)) in left.chain((whole + 1..).zip(noted)).enumerate() {
        let (mut robot, slot) = slot_after(&file, &content);
        let may_be_new = cut > sealed;
        let must_be_new = cut > started;
        assert!(
            slot == Some(Slot::A) && !must_be_new || slot == Some(Slot::B) && may_be_new,
            "cut {cut} (sealed {sealed}, started {started}): {slot:?}"
        );
        if slot == Some(Slot::B) {
            // A confirmation that was cut is settled before long; a trial is confirmed.
            robot.control(order::CONFIRM).unwrap();
            robot.ready().unwrap();
            let state = State::read(&robot.content(), Slot::B);
            assert!(
                matches!(
                    state,
                    State::Confirmed {
                        is_settled: true,
                        ..
                    }
                ),
                "{cut}: {state:?}"
            );
            continue;
        }
        // The recovery is cut as well, in its own erase or after it; then it succeeds.
        let again = 1 + cut % (cleared + 3);
        robot.board.cut_power_at_flash_operation(again);
        assert_eq!(
            bring(&mut robot, &download),
            Err(Failure::PowerCut),
            "{cut}"
        );
        let content = robot.content();
        let (mut robot, slot) = slot_after(&file, &content);
        assert_eq!(slot, Some(Slot::A), "cut {cut}, then {again}");
        if nth % 5 == 0 {
            update(&mut robot, &download).unwrap();
            assert_eq!(robot.slot(), Some(Slot::B), "cut {cut}, then {again}");
        }
    }
}

/// A way for a new image to fail.
struct Bad {
    name: &'static str,
    /// A function of the image and the code that it begins with instead.
    code: Option<(&'static str, [u16; 2])>,
    /// What happens to it once it is on the bus.
    on_bus: Option<fn(&mut Robot, &File)>,
}

/// The robot's program panics.
fn panic(robot: &mut Robot, file: &File) {
    robot.board.jump(file.address("_defmt_panic"));
}

fn hang(robot: &mut Robot, _: &File) {
    robot.board.halt(true);
}

/// The new image is started three times, and fails every time; then the old one runs.
fn an_image_that_fails_gives_way_to_the_old_one(robots: &Robots) {
    const ITSELF: [u16; 2] = [0xE7FE, 0xE7FE];
    const UNDEFINED: [u16; 2] = [0xDE00, 0xE7FE];
    for bad in [
        Bad {
            name: "hangs before CAN",
            code: Some(("main", ITSELF)),
            on_bus: None,
        },
        Bad {
            name: "panics before its first frame",
            code: Some(("node_stored", UNDEFINED)),
            on_bus: None,
        },
        Bad {
            name: "panics on the bus",
            code: None,
            on_bus: Some(panic),
        },
        Bad {
            name: "hangs on the bus",
            code: None,
            on_bus: Some(hang),
        },
    ] {
        let mut file = File::new(robots);
        let mut robot = match bad.code {
            Some((function, code)) => {
                file = file.replace(function, &code);
                let mut robot = flashed(&file);
                bring(&mut robot, &file.download(|_| ())).unwrap();
                robot
            }
            None => brought(&file),
        };
        if let Some(fail) = bad.on_bus {
            for _ in 0..ATTEMPTS {
                assert!(robot.boots_within(500 * MS).unwrap(), "{}", bad.name);
                assert_eq!(robot.slot(), Some(Slot::B), "{}", bad.name);
                fail(&mut robot, &file);
            }
        }
        assert!(robot.boots_within(20_000 * MS).unwrap(), "{}", bad.name);
        assert_eq!(robot.slot(), Some(Slot::A), "{}", bad.name);
        let state = State::read(&robot.content(), Slot::B);
        assert!(
            matches!(
                state,
                State::Trial {
                    attempts: ATTEMPTS,
                    ..
                }
            ),
            "{}: {state:?}",
            bad.name
        );
    }
}

/// The image is not confirmed, and receives no master: it starts again after a minute.
fn an_image_that_is_never_confirmed_gives_way_to_the_old_one(robots: &Robots) {
    let mut robot = brought(&File::new(robots));
    assert!(robot.boots().unwrap());
    for _ in 0..ATTEMPTS {
        assert_eq!(robot.slot(), Some(Slot::B));
        let resets = robot.board.resets();
        robot.pass(59_000 * MS).unwrap();
        assert_eq!(robot.board.resets(), resets, "it is still there");
        assert!(robot.boots_within(1_100 * MS).unwrap());
    }
    assert_eq!(robot.slot(), Some(Slot::A));
    assert_eq!(robot.board.reset_cause(), ResetCause::Software);
}

/// An image that hears SYNC and its master confirms itself. If it fails after that, it is started
/// again, and the client can have the old one back.
fn an_image_that_confirms_itself_and_dies_is_started_again_and_can_be_sent_back(robots: &Robots) {
    let file = File::new(robots);
    let mut robot = brought(&file);
    robot.master = true;
    assert!(robot.boots().unwrap());
    robot.pass(4_000 * MS).unwrap();
    let state = State::read(&robot.content(), Slot::B);
    assert!(matches!(state, State::Trial { .. }), "{state:?}");
    robot.pass(2_000 * MS).unwrap();
    let state = State::read(&robot.content(), Slot::B);
    assert!(matches!(state, State::Confirmed { .. }), "{state:?}");
    for _ in 0..=ATTEMPTS {
        panic(&mut robot, &file);
        assert!(robot.boots_within(500 * MS).unwrap());
        assert_eq!(robot.slot(), Some(Slot::B));
    }
    robot.control(order::GO_BACK).unwrap();
    assert!(robot.boots().unwrap());
    assert_eq!(robot.slot(), Some(Slot::A));
}

/// Transfers that are not what they should be, each followed by the right one.
fn a_transfer_that_is_wrong_is_refused_and_the_next_one_taken(robots: &Robots) {
    let file = File::new(robots);
    let good = file.download(|_| ());
    let mut robot = flashed(&file);
    let clear = |robot: &mut Robot| {
        robot.control(order::STOP).unwrap();
        robot.control(order::CLEAR).unwrap();
        robot.ready().unwrap();
    };
    let problem = |robot: &mut Robot| robot.read(at::UPDATE_PROBLEM).unwrap();
    // Before anything is erased.
    assert!(robot.download(&good).is_err());
    let mut long = good.clone();
    long.resize(good.len() + 4, 0xFF);
    let below = file.download(|header| header.security_counter = 0);
    for (name, bytes, expected) in [
        ("size 0", &[][..], Problem::Length),
        ("too long", &long[..], Problem::Length),
        ("too short", &good[..good.len() - 4], Problem::Length),
        ("the header alone", &good[..256], Problem::Length),
        ("a lower security counter", &below[..], Problem::Downgrade),
    ] {
        clear(&mut robot);
        assert!(robot.download(bytes).is_err(), "{name}");
        assert_eq!(problem(&mut robot), expected as u32, "{name}");
        assert!(
            robot.control(order::START).is_ok(),
            "{name}: goes on with the old one"
        );
        assert_eq!(robot.slot(), Some(Slot::A), "{name}");
    }
    // The link for the slot that runs, as long as the right one.
    clear(&mut robot);
    let mut other_link = file.download_a();
    other_link.resize(good.len(), 0xFF);
    robot.download(&other_link).unwrap();
    robot.ready().unwrap();
    assert_eq!(problem(&mut robot), Problem::Hash as u32);
    // A client that falls silent in the middle of it. The next begins from the start.
    clear(&mut robot);
    assert_eq!(robot.download_part(&good, 5_000), Err(Failure::Silent));
    assert_eq!(problem(&mut robot), Problem::Transfer as u32);
    assert!(
        robot.download(&good[100_000..]).is_err(),
        "nothing is resumed"
    );
    clear(&mut robot);
    robot.download(&good).unwrap();
    assert_eq!(robot.ready(), Ok(0));
    // A second one over the first.
    assert!(robot.download(&good).is_err());
    assert_eq!(robot.read(at::OTHER_VERSION), Ok(NEW));
    robot.control(order::START).unwrap();
    assert!(robot.boots().unwrap());
    assert_eq!(robot.slot(), Some(Slot::B));
}

/// Every other kind of robot has its own file, whatever else fits: the board, and the drives.
fn an_image_for_other_robots_is_refused(robots: &Robots) {
    let file = File::new(robots);
    let mut robot = flashed(&file);
    assert_eq!(robot.read(at::BOARD), Ok(robots.board.0.into()));
    robot.control(order::STOP).unwrap();
    robot.control(order::CLEAR).unwrap();
    robot.ready().unwrap();
    let kinds = [REFERENCE, BOARD_C, DRIVES].map(|one| one.board);
    let others = kinds.into_iter().filter(|board| *board != robots.board);
    for board in others.chain([ImageBoard(4), ImageBoard(0)]) {
        let other = file.download(|header| header.board = board);
        let refused = Failure::Refused(AbortCode::ParameterIncompatible.code());
        assert_eq!(robot.download(&other), Err(refused), "{board:?}");
        let problem = robot.read(at::UPDATE_PROBLEM);
        assert_eq!(problem, Ok(Problem::Board as u32), "{board:?}");
        robot.control(order::STOP).unwrap();
        robot.control(order::CLEAR).unwrap();
        robot.ready().unwrap();
    }
    assert_eq!(robot.slot(), Some(Slot::A));
}

/// Equal and lower versions with a security counter that is not lower.
fn the_same_image_again_and_an_older_one_are_taken(robots: &Robots) {
    let file = File::new(robots);
    let mut robot = flashed(&file);
    update(&mut robot, &file.download(|_| ())).unwrap();
    assert_eq!(robot.slot(), Some(Slot::B));
    update(&mut robot, &file.download_a()).unwrap();
    assert_eq!(robot.slot(), Some(Slot::A));
    let older = file.download(|header| header.version = 1);
    update(&mut robot, &older).unwrap();
    assert_eq!(robot.slot(), Some(Slot::B));
    // Flashed by cable while slot B is confirmed: what was flashed runs.
    let mut content = robot.content();
    for (address, bytes) in file.by_cable() {
        let at = (address - boot::slots::BOOT) as usize;
        content.0[at..at + bytes.len()].copy_from_slice(&bytes);
    }
    let (mut robot, slot) = slot_after(&file, &content);
    assert_eq!(slot, Some(Slot::A));
    // And it erases slot B for the next update, when one comes.
    robot.control(order::STOP).unwrap();
    robot.control(order::CLEAR).unwrap();
    assert_eq!(robot.ready(), Ok(0));
}
