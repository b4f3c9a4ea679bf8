//! Parameters over a power loss: the release image on an emulated board, spoken to by SDO as a
//! master would.
//!
//! `OMNIBUS_ELF` names the image, `OMNIBUS_ELF_BOARD_C` that of RoboMaster's Board C and
//! `OMNIBUS_ELF_KIT` that of the kit (`cargo xtask test` builds all and says so). A power cycle is
//! a new board with the flash of the old one; the power can fail in the middle of any flash
//! operation.

mod common;

use emulator::{Board, BoardConfig, CanFrame, Firmware, FlashOperations, Stop, StopKind};
use protocol::address::{self as at, history};
use protocol::compensation::{LENGTH_MAX, ObliqueRow, Row, Tables};
use protocol::{Access, Address, ENTRIES, Fault, Kind, StoredFault};

#[path = "storage/robot.rs"]
mod robot;

use robot::Robot;

const NODE: u16 = 2;
/// Longest time for an answer: an erase at 250 ms, and what is programmed. Two erases over a store
/// of the version before.
const ANSWER_NS: u64 = 600_000_000;
/// Longest time from power to the boot-up, whatever the store holds.
const BOOT_NS: u64 = 60_000_000;
/// Object 0x1017, the one of the communication objects that is tried.
const HEARTBEAT: Address = Address::new(0x1017, 0);
const SAVE: Address = Address::new(0x1010, 1);
const RESTORE: Address = Address::new(0x1011, 1);
/// CiA 301: "data cannot be transferred or stored because of the present device state".
const DEVICE_STATE: u32 = 0x0800_0022;
/// Bytes of the kit's flash.
const KIT_FLASH: usize = 0x4_0000;

/// These tests with the image that a variable names.
macro_rules! tests {
    ($variable:literal, $($test:ident)*) => {
        $(#[test] fn $test() { super::$test(&crate::common::image($variable)); })*
    };
}

mod reference {
    tests! { "OMNIBUS_ELF",
        saved_parameters_are_back_after_a_power_cycle
        nothing_is_stored_while_operational_or_without_the_signature
        an_image_that_has_decayed_is_not_used
        a_power_cut_in_any_operation_of_a_save_leaves_the_old_or_the_new_set
        a_power_cut_in_any_operation_of_a_save_that_erases_leaves_the_old_or_the_new_set
        a_node_stored_by_lss_outlives_a_power_cycle
        a_store_full_of_small_images_is_no_different
        a_robot_with_the_store_of_the_version_before_has_its_parameters
        three_hundred_random_saves_and_power_cuts
        faults_outlive_a_power_cycle
        a_power_cut_while_faults_are_written_costs_those_faults_only
    }
}

/// The other board's, with its own sectors and clocks.
mod board_c {
    tests! { "OMNIBUS_ELF_BOARD_C",
        saved_parameters_are_back_after_a_power_cycle
        nothing_is_stored_while_operational_or_without_the_signature
        an_image_that_has_decayed_is_not_used
        a_power_cut_in_any_operation_of_a_save_leaves_the_old_or_the_new_set
        a_power_cut_in_any_operation_of_a_save_that_erases_leaves_the_old_or_the_new_set
        a_node_stored_by_lss_outlives_a_power_cycle
        a_store_full_of_small_images_is_no_different
        a_robot_with_the_store_of_the_version_before_has_its_parameters
        three_hundred_random_saves_and_power_cuts
        faults_outlive_a_power_cycle
        a_power_cut_while_faults_are_written_costs_those_faults_only
    }
}

/// The kit's, with pages that are programmed by half-words. It has no version before.
mod kit {
    tests! { "OMNIBUS_ELF_KIT",
        saved_parameters_are_back_after_a_power_cycle
        nothing_is_stored_while_operational_or_without_the_signature
        an_image_that_has_decayed_is_not_used
        a_power_cut_in_any_operation_of_a_save_leaves_the_old_or_the_new_set
        a_power_cut_in_any_operation_of_a_save_that_erases_leaves_the_old_or_the_new_set
        a_node_stored_by_lss_outlives_a_power_cycle
        a_store_full_of_small_images_is_no_different
        three_hundred_random_saves_and_power_cuts
        faults_outlive_a_power_cycle
        a_power_cut_while_faults_are_written_costs_those_faults_only
    }
}

/// Values that differ from each other and from the defaults in every object: a parameter near the
/// beginning, one near the end of the table, and a communication object.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Set(u16);

impl Set {
    fn values(self) -> [(Address, u32); 3] {
        let n = u32::from(self.0);
        [
            (at::HALF_TRACK, (0.3 + 0.1 * f32::from(self.0)).to_bits()),
            (at::STRAIN_FAULT, (0.5 + 0.1 * f32::from(self.0)).to_bits()),
            (HEARTBEAT, 100 + 50 * n),
        ]
    }

    fn default_values() -> [(Address, u32); 3] {
        let default = |address| protocol::entry(address).unwrap().default().to_bits();
        [
            (at::HALF_TRACK, default(at::HALF_TRACK)),
            (at::STRAIN_FAULT, default(at::STRAIN_FAULT)),
            (HEARTBEAT, 100),
        ]
    }
}

/// A compensation set with all the rows it may have.
fn longest_set() -> Vec<u8> {
    let rows = (1..=8_u8).map(|n| Row::new(f32::from(n) * 0.1, 1.05));
    let rows: Vec<Row> = rows.collect();
    let oblique = rows.iter().map(|row| ObliqueRow {
        speed: row.speed,
        longitudinal: row.coefficient,
        lateral: row.coefficient,
    });
    let oblique: Vec<ObliqueRow> = oblique.collect();
    let mut bytes = [0; LENGTH_MAX];
    let length = Tables {
        version: 20_261_121,
        longitudinal: &rows,
        lateral: &rows,
        oblique: &oblique,
        yaw: &rows,
    }
    .encode(&mut bytes)
    .unwrap();
    bytes[..length].to_vec()
}

/// The flash with the first set saved, and every other parameter too, so that the image is as long
/// as it gets.
fn with_first_set(firmware: &Firmware) -> Vec<u8> {
    let blank = Board::new(firmware, BoardConfig::default()).flash();
    let mut robot = Robot::power_on(firmware, &blank);
    assert_eq!(robot.found(), None);
    for entry in ENTRIES.iter().filter(|e| e.access() == Access::Parameter) {
        if entry.kind == Kind::Domain {
            robot.write_block(entry.address, &longest_set());
            continue;
        }
        let length = usize::from(entry.kind.bytes());
        let value = entry.default().to_bytes();
        robot
            .write(entry.address, &value[..length])
            .unwrap()
            .unwrap();
    }
    robot.set(Set(1));
    robot.save().unwrap();
    assert_eq!(robot.board.resets(), 0);
    robot.board.flash()
}

fn saved_parameters_are_back_after_a_power_cycle(firmware: &Firmware) {
    let flash = with_first_set(firmware);
    let mut robot = Robot::power_on(firmware, &flash);
    assert_eq!(robot.found(), Some(Set(1)));
    // What is not saved is gone, here by an NMT reset of the node.
    robot.set(Set(2));
    robot.send(0, &[0x81, 0]);
    robot.wait_ms(50);
    assert_eq!(robot.found(), Some(Set(1)));
    // "load" takes the defaults back from the next start on, and not before.
    robot.write(RESTORE, b"load").unwrap().unwrap();
    assert_eq!(robot.found(), Some(Set(1)));
    let flash = robot.board.flash();
    assert_eq!(Robot::power_on(firmware, &flash).found(), None);
}

fn nothing_is_stored_while_operational_or_without_the_signature(firmware: &Firmware) {
    let flash = with_first_set(firmware);
    let mut robot = Robot::power_on(firmware, &flash);
    let before = robot.board.flash_operations();
    assert!(robot.write(SAVE, b"evas").unwrap().is_err());
    robot.send(0, &[1, 0]);
    robot.wait_ms(20);
    assert_eq!(robot.write(SAVE, b"save").unwrap(), Err(DEVICE_STATE));
    assert_eq!(robot.write(RESTORE, b"load").unwrap(), Err(DEVICE_STATE));
    assert_eq!(robot.board.flash_operations(), before);
    assert_eq!(robot.board.flash(), flash);
}

/// Flash that has lost a bit of the only image.
fn an_image_that_has_decayed_is_not_used(firmware: &Firmware) {
    let mut flash = with_first_set(firmware);
    let half_track = Set(1).values()[0].1.to_le_bytes();
    let sectors = sim::robot::emulated::parameters(firmware).unwrap();
    let place = flash[sectors.clone()]
        .windows(4)
        .position(|bytes| bytes == half_track)
        .expect("it is in the sectors of the parameters");
    flash[sectors.start + place] ^= 0x01;
    let mut robot = Robot::power_on(firmware, &flash);
    assert_eq!(robot.found(), None, "nothing of it is used");
    let corrupt = u32::from(Fault::ParametersCorrupt.code());
    assert_eq!(robot.read(history::code(1)), corrupt);
    // A save puts it right.
    robot.set(Set(2));
    robot.save().unwrap();
    let flash = robot.board.flash();
    assert_eq!(Robot::power_on(firmware, &flash).found(), Some(Set(2)));
}

/// What the robot finds after each way to lose power in the save of the second set over `flash`,
/// which holds the first: one way for each operation. Returns how many there are, and how often it
/// was the old set.
///
/// The save runs once, and the emulator notes what each operation would leave; that this is what a
/// cut leaves is tried for some of them.
fn cut_everywhere(firmware: &Firmware, flash: &[u8]) -> (usize, usize) {
    let mut robot = Robot::power_on(firmware, flash);
    robot.set(Set(2));
    let before = operations(&robot.board);
    robot.board.record_power_cuts();
    robot.save().unwrap();
    let left = robot.board.take_power_cuts();
    assert_eq!(left.len() as u64, operations(&robot.board) - before);
    for (nth, left) in (1..).zip(&left).step_by(left.len() / 3) {
        let mut robot = Robot::power_on(firmware, flash);
        robot.set(Set(2));
        robot.board.cut_power_at_flash_operation(nth);
        let stop = robot.save().expect_err("the power fails before it answers");
        assert_eq!(stop.kind, StopKind::PowerCut);
        assert!(robot.board.flash() == *left, "operation {nth}");
    }
    // Two cores are what a machine that runs this has.
    let half = left.len() / 2;
    let (first, second) = std::thread::scope(|scope| {
        let first = scope.spawn(|| find(firmware, &left[..half]));
        let second = find(firmware, &left[half..]);
        (first.join().unwrap(), second)
    });
    let found = [first, second].concat();
    assert!(found.is_sorted(), "first the old ones, then the new ones");
    (left.len(), found.iter().filter(|set| **set == 1).count())
}

/// Which set robots find that are switched on with these flashes; each says so if its save was cut
/// off, once.
fn find(firmware: &Firmware, flashes: &[Vec<u8>]) -> Vec<u16> {
    let mut found = Vec::new();
    for (nth, flash) in flashes.iter().enumerate() {
        let mut robot = Robot::power_on(firmware, flash);
        assert_eq!(robot.board.resets(), 0, "cut {nth}");
        let set = robot
            .found()
            .unwrap_or_else(|| panic!("cut {nth}: nothing"));
        found.push(set.0);
        let announced = robot.read(history::code(1)) == u32::from(Fault::StoreInterrupted.code());
        assert_eq!(robot.read(at::CUT_SAVES), u32::from(announced));
        // Cut in the very last word, a save may be found complete; half-words are two operations.
        let word = if flash.len() == KIT_FLASH { 2 } else { 1 };
        let last = nth + word >= flashes.len();
        assert!(
            announced || last || set == Set(1),
            "cut {nth}: a new set without a word"
        );
        if nth % 16 == 0 {
            // It goes on working, and does not tell twice.
            robot.set(Set(2));
            robot.save().unwrap();
            let flash = robot.board.flash();
            let mut robot = Robot::power_on(firmware, &flash);
            assert_eq!(robot.found(), Some(Set(2)));
            assert_eq!(robot.read(history::code(1)), 0);
        }
    }
    found
}

fn operations(board: &Board) -> u64 {
    let done = board.flash_operations();
    done.programs + done.erases
}

fn a_power_cut_in_any_operation_of_a_save_leaves_the_old_or_the_new_set(firmware: &Firmware) {
    let flash = with_first_set(firmware);
    let (cuts, old) = cut_everywhere(firmware, &flash);
    println!("{cuts} operations, {old} times the old set");
    assert!(old > 0 && cuts > 50);
}

/// The same for the save that finds its sector full, copies what is stored to the other one and
/// erases.
fn a_power_cut_in_any_operation_of_a_save_that_erases_leaves_the_old_or_the_new_set(
    firmware: &Firmware,
) {
    let mut robot = Robot::power_on(firmware, &with_first_set(firmware));
    let mut saves = 1;
    let flash = loop {
        let before = (robot.board.flash(), robot.board.flash_operations());
        robot.save().unwrap();
        saves += 1;
        let erases = robot.board.flash_operations().erases - before.1.erases;
        if erases > 0 {
            // The watchdog has been given the time, and got its own back.
            robot.wait_ms(200);
            assert_eq!(robot.board.resets(), 0);
            break before.0;
        }
        assert!(saves < 100, "the sectors fill up");
    };
    assert_eq!(robot.read(at::SAVES), saves);
    let erases = robot.board.flash_operations().erases;
    assert!(robot.read(at::ERASES) > 0, "of {erases} since power-on");
    let (cuts, old) = cut_everywhere(firmware, &flash);
    println!("{cuts} operations, {old} times the old set; save {saves} is the first that erases");
    assert!(old > 0 && cuts > 100);
}

/// A node-ID given by LSS is stored, comes before the switches at the next power-on, and can be
/// taken away again.
fn a_node_stored_by_lss_outlives_a_power_cycle(firmware: &Firmware) {
    let flash = with_first_set(firmware);
    let mut robot = Robot::power_on(firmware, &flash);
    robot.send(0x7E5, &[0x04, 1, 0, 0, 0, 0, 0, 0]);
    robot.send(0x7E5, &[0x11, 9, 0, 0, 0, 0, 0, 0]);
    robot.lss([0x17, 0, 0, 0, 0, 0, 0, 0]);
    let flash = robot.board.flash();
    let mut robot = Robot::power_on_as(firmware, &flash, 9);
    assert_eq!(robot.found(), Some(Set(1)));
    assert_eq!(robot.read(at::NODE_SWITCHES), 2);
    assert_eq!(robot.read(at::NODE_STORED), 9);
    robot.send(0x7E5, &[0x04, 1, 0, 0, 0, 0, 0, 0]);
    robot.send(0x7E5, &[0x11, 0xFF, 0, 0, 0, 0, 0, 0]);
    robot.lss([0x17, 0, 0, 0, 0, 0, 0, 0]);
    let flash = robot.board.flash();
    assert_eq!(Robot::power_on(firmware, &flash).found(), Some(Set(1)));
}

/// Saves of the shortest image there is, more than fit into both sectors.
fn a_store_full_of_small_images_is_no_different(firmware: &Firmware) {
    let blank = Board::new(firmware, BoardConfig::default()).flash();
    let mut robot = Robot::power_on(firmware, &blank);
    let mut longest_ns = 0;
    for save in 1..=1_000 {
        let before = robot.board.now_ns();
        let answer = robot.write(RESTORE, b"load").unwrap();
        assert_eq!((save, answer), (save, Ok(())));
        longest_ns = longest_ns.max(robot.board.now_ns() - before);
        assert_eq!(robot.board.resets(), 0, "save {save}");
    }
    println!("longest save {} ms", longest_ns / 1_000_000);
    assert!(longest_ns < 1_000_000_000);
    let flash = robot.board.flash();
    Robot::power_on(firmware, &flash);
}

/// Flashes as the version before left them (`robot/tests/data`), the last of them on a robot that
/// did not start any more; the name of the set they hold.
fn a_robot_with_the_store_of_the_version_before_has_its_parameters(firmware: &Firmware) {
    let blank = Board::new(firmware, BoardConfig::default()).flash();
    let before: [(&[u8], Set); 5] = [
        (include_bytes!("../robot/tests/data/one-image.bin"), Set(1)),
        (
            include_bytes!("../robot/tests/data/second-sector.bin"),
            Set(2),
        ),
        (
            include_bytes!("../robot/tests/data/cut-in-the-copy.bin"),
            Set(1),
        ),
        (
            include_bytes!("../robot/tests/data/cut-in-the-record.bin"),
            Set(1),
        ),
        (include_bytes!("../robot/tests/data/stuck.bin"), Set(1)),
    ];
    for (bytes, set) in before {
        let mut flash = blank.clone();
        flash[0x4000..][..bytes.len()].copy_from_slice(bytes);
        let mut robot = Robot::power_on(firmware, &flash);
        assert_eq!(robot.found(), Some(set));
        assert_eq!(robot.board.flash_operations(), FlashOperations::default());
        let saves = robot.read(at::SAVES);
        robot.save().unwrap();
        let flash = robot.board.flash();
        let mut robot = Robot::power_on(firmware, &flash);
        assert_eq!(robot.found(), Some(set));
        assert_eq!(robot.read(at::SAVES), saves + 1);
        assert_eq!(robot.board.resets(), 0);
    }
}

/// Numbers that look random (xorshift).
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state >> 16
}

/// Saves of images short and long, and power that fails in the middle of some: the robot always
/// starts, within the same time, answers on the bus and has the set before or the new one.
fn three_hundred_random_saves_and_power_cuts(firmware: &Firmware) {
    let mut state = 0x00C0_FFEE;
    let mut flash = with_first_set(firmware);
    let mut robot = Robot::power_on(firmware, &flash);
    let mut stored = Some(Set(1));
    let (mut cuts, mut slowest_ns) = (0, 0);
    for step in 0..300 {
        let new = match random(&mut state) % 3 {
            0 => None,
            n => Some(Set(n as u16)),
        };
        let is_cut = !random(&mut state).is_multiple_of(3);
        if is_cut {
            let at = 1 + random(&mut state) % 24;
            robot
                .board
                .cut_power_at_flash_operation(operations(&robot.board) + at);
        }
        // The defaults are an image of eight bytes.
        let done = match new {
            None => robot.write(RESTORE, b"load").map(|answer| answer.unwrap()),
            Some(set) => {
                robot.set(set);
                robot.save()
            }
        };
        match &done {
            Ok(()) => stored = new,
            Err(stop) => assert_eq!(stop.kind, StopKind::PowerCut, "step {step}"),
        }
        if done.is_err() || random(&mut state).is_multiple_of(8) {
            cuts += u32::from(done.is_err());
            flash = robot.board.flash();
            robot = Robot::power_on(firmware, &flash);
            slowest_ns = slowest_ns.max(robot.board.now_ns());
            let found = robot.found();
            assert!(
                found == stored || (done.is_err() && found == new),
                "step {step}: {found:?}"
            );
            stored = found;
        } else {
            // A cut that has not come does not come later.
            robot.board.cut_power_at_flash_operation(u64::MAX);
        }
        assert_eq!(robot.board.resets(), 0, "step {step}");
    }
    println!("{cuts} cuts, slowest start {} us", slowest_ns / 1_000);
    assert!(cuts > 50);
}

/// A start that is refused is a fault: it is in flash a second after power-on, and nothing is
/// before.
fn faults_outlive_a_power_cycle(firmware: &Firmware) {
    let blank = Board::new(firmware, BoardConfig::default()).flash();
    let mut robot = Robot::power_on(firmware, &blank);
    robot.wait_ms(100);
    robot.send(0, &[1, 0]);
    robot.wait_ms(10);
    let unconfigured = Fault::Unconfigured.code();
    assert_eq!(robot.stored_faults()[0].code, unconfigured);
    assert_eq!(robot.read(at::UNSTORED_FAULTS), 1);
    let now_ms = robot.board.now_ns() / 1_000_000;
    robot.wait_ms(990 - now_ms);
    assert_eq!(robot.board.flash_operations(), FlashOperations::default());
    robot.wait_ms(50);
    assert_eq!(robot.read(at::UNSTORED_FAULTS), 0);
    let stored = robot.stored_faults();

    let mut robot = Robot::power_on(firmware, &robot.board.flash());
    assert_eq!(robot.stored_faults(), stored);
    let [fault] = stored[..] else {
        panic!("{stored:?}");
    };
    assert_eq!((fault.code, fault.start), (unconfigured, 1));
    assert!((90..130).contains(&fault.time_ms), "{fault:?}");
    assert_eq!((fault.supply, fault.rates), (None, [0.0; 4]));
    assert_eq!(robot.read(at::START_NUMBER), 2);
    // A robot that is switched off within the second has not counted that start.
    let mut robot = Robot::power_on(firmware, &robot.board.flash());
    assert_eq!(robot.read(at::START_NUMBER), 2);
}

/// Every way to lose power while a start and a fault are written: a robot that boots, with the set
/// it had.
fn a_power_cut_while_faults_are_written_costs_those_faults_only(firmware: &Firmware) {
    let flash = with_first_set(firmware);
    let mut robot = Robot::power_on(firmware, &flash);
    robot.set(Set(1));
    robot
        .write(at::HALF_TRACK, &0.0_f32.to_le_bytes())
        .unwrap()
        .unwrap_err();
    robot.send(0, &[1, 0]);
    robot.wait_ms(500);
    robot.board.record_power_cuts();
    robot.wait_ms(1_000);
    let left = robot.board.take_power_cuts();
    println!("{} operations", left.len());
    assert!(left.len() >= 3 + 11, "a start and a fault");
    let whole = robot.stored_faults();
    for (nth, flash) in left.iter().enumerate() {
        let mut robot = Robot::power_on(firmware, flash);
        assert_eq!(robot.found(), Some(Set(1)), "cut {nth}");
        let stored = robot.stored_faults();
        assert!(
            stored.is_empty() || stored == whole,
            "cut {nth}: {stored:?}"
        );
        // It goes on remembering.
        robot.send(0, &[1, 0]);
        robot.wait_ms(1_600);
        assert_eq!(robot.read(at::UNSTORED_FAULTS), 0, "cut {nth}");
        assert_eq!(robot.board.resets(), 0);
    }
}
