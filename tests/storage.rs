//! Parameters over a power loss: the release image on an emulated board, spoken to by SDO as a master would.
//!
//! `OMNIBUS_ELF` names the image (`cargo xtask test` builds it and says so). A power cycle is a new board with the flash
//! of the old one; the power can fail in the middle of any flash operation.

use std::collections::BTreeSet;

use emulator::{Board, BoardConfig, CanFrame, Firmware, Port, Stop, StopKind};
use protocol::address as at;
use protocol::{Access, Address, ENTRIES};

const NODE: u16 = 2;
/// Longest time for an answer: two erases at 400 ms each, and what is programmed.
const ANSWER_NS: u64 = 1_500_000_000;
/// Object 0x1017, the one of the communication objects that is tried.
const HEARTBEAT: Address = Address::new(0x1017, 0);
const SAVE: Address = Address::new(0x1010, 1);
const RESTORE: Address = Address::new(0x1011, 1);
/// CiA 301: "data cannot be transferred or stored because of the present device state".
const DEVICE_STATE: u32 = 0x0800_0022;

fn firmware() -> Firmware {
    let path =
        std::env::var("OMNIBUS_ELF").expect("OMNIBUS_ELF names the firmware's release image");
    Firmware::load(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

struct Robot {
    board: Board,
    /// Every frame it sent.
    sent: Vec<CanFrame>,
}

impl Robot {
    /// A robot that has just been switched on, and is waiting in PRE-OPERATIONAL.
    fn power_on(firmware: &Firmware, flash: &[u8]) -> Self {
        let mut board = Board::with_flash(firmware, BoardConfig::default(), flash);
        board.set_input(Port::B, 12, false);
        board.set_input(Port::B, 13, true);
        let sent = Vec::new();
        let mut robot = Self { board, sent };
        let boot_up = 0x700 + NODE;
        let end = robot.board.now_ns() + ANSWER_NS;
        robot.run(end, |frame| frame.id_is(boot_up)).unwrap();
        let log = robot.board.take_log();
        let sent = &robot.sent;
        assert!(sent.iter().any(|frame| frame.id_is(boot_up)), "{log:#?}");
        robot
    }

    /// Runs until a time or until the robot has sent a frame that is waited for.
    fn run(
        &mut self,
        end_ns: u64,
        waited_for: impl Fn(&CanFrame) -> bool,
    ) -> Result<Option<CanFrame>, Stop> {
        while self.board.now_ns() < end_ns {
            self.board.run_until_request(end_ns)?;
            while let Some(frame) = self.board.can().begin() {
                self.board.can().transmitted();
                self.sent.push(frame);
                if waited_for(&frame) {
                    return Ok(Some(frame));
                }
            }
        }
        Ok(None)
    }

    fn send(&mut self, id: u16, data: &[u8]) {
        let frame = CanFrame::new(id, data).unwrap();
        self.board.can().receive(&frame);
    }

    fn wait_ms(&mut self, ms: u64) {
        let end = self.board.now_ns() + ms * 1_000_000;
        self.run(end, |_| false).unwrap();
    }

    fn request(&mut self, request: [u8; 8]) -> Result<[u8; 8], Stop> {
        self.send(0x600 + NODE, &request);
        let end = self.board.now_ns() + ANSWER_NS;
        let answer = self.run(end, |frame| frame.id_is(0x580 + NODE))?;
        let Some(answer) = answer else {
            panic!("no answer: {:#?}", self.board.take_log());
        };
        Ok(answer.data().try_into().unwrap())
    }

    /// Writes up to four bytes; an abort comes back as its code.
    fn write(&mut self, to: Address, value: &[u8]) -> Result<Result<(), u32>, Stop> {
        let [low, high] = to.index.to_le_bytes();
        let mut request = [
            0x23 | (4 - value.len() as u8) << 2,
            low,
            high,
            to.sub,
            0,
            0,
            0,
            0,
        ];
        request[4..4 + value.len()].copy_from_slice(value);
        let [command, _, _, _, a, b, c, d] = self.request(request)?;
        Ok(match command {
            0x60 => Ok(()),
            _ => Err(u32::from_le_bytes([a, b, c, d])),
        })
    }

    fn read(&mut self, from: Address) -> u32 {
        let [low, high] = from.index.to_le_bytes();
        let answer = self
            .request([0x40, low, high, from.sub, 0, 0, 0, 0])
            .unwrap();
        let [command, _, _, _, a, b, c, d] = answer;
        assert_eq!(command & 0xE3, 0x43, "{from:?}: expedited, with its length");
        let length = 4 - u32::from(command >> 2 & 3);
        u32::from_le_bytes([a, b, c, d]) & (u32::MAX >> (32 - 8 * length))
    }

    fn set(&mut self, set: Set) {
        for (address, value) in set.values() {
            let length = if address == HEARTBEAT { 2 } else { 4 };
            let value = value.to_le_bytes();
            self.write(address, &value[..length]).unwrap().unwrap();
        }
    }

    fn save(&mut self) -> Result<(), Stop> {
        self.write(SAVE, b"save").map(|answer| answer.unwrap())
    }

    /// Which of the two sets it has; a mixture fails.
    fn found(&mut self) -> Option<Set> {
        let found = Set::default_values().map(|(address, _)| (address, self.read(address)));
        [Some(Set(1)), Some(Set(2)), None]
            .into_iter()
            .find(|set| match set {
                Some(set) => found == set.values(),
                None => found == Set::default_values(),
            })
            .unwrap_or_else(|| panic!("a mixture: {found:x?}"))
    }
}

trait Id {
    fn id_is(&self, id: u16) -> bool;
}

impl Id for CanFrame {
    fn id_is(&self, id: u16) -> bool {
        self.standard_id() == Some(id)
    }
}

/// Values that differ from each other and from the defaults in every object: a parameter near the beginning, one near
/// the end of the table, and a communication object.
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
        let default = |address| protocol::entry(address).unwrap().default.to_bits();
        [
            (at::HALF_TRACK, default(at::HALF_TRACK)),
            (at::STRAIN_FAULT, default(at::STRAIN_FAULT)),
            (HEARTBEAT, 100),
        ]
    }
}

/// The flash with the first set saved, and every other parameter too, so that the image is as long as it gets.
fn with_first_set(firmware: &Firmware) -> Vec<u8> {
    let blank = Board::new(firmware, BoardConfig::default()).flash();
    let mut robot = Robot::power_on(firmware, &blank);
    assert_eq!(robot.found(), None);
    for entry in ENTRIES.iter().filter(|e| e.access == Access::Parameter) {
        let length = usize::from(entry.kind.bytes());
        let value = entry.default.to_bytes();
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

#[test]
fn saved_parameters_are_back_after_a_power_cycle() {
    let firmware = firmware();
    let flash = with_first_set(&firmware);
    let mut robot = Robot::power_on(&firmware, &flash);
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
    assert_eq!(Robot::power_on(&firmware, &flash).found(), None);
}

#[test]
fn nothing_is_stored_while_operational_or_without_the_signature() {
    let firmware = firmware();
    let flash = with_first_set(&firmware);
    let mut robot = Robot::power_on(&firmware, &flash);
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
#[test]
fn an_image_that_has_decayed_is_not_used() {
    let firmware = firmware();
    let mut flash = with_first_set(&firmware);
    // The map checks its items by CRC: it does not give out what has lost bits.
    let half_track = Set(1).values()[0].1.to_le_bytes();
    let place = flash[0x4000..0xC000]
        .windows(4)
        .position(|bytes| bytes == half_track)
        .expect("it is in the sectors of the parameters");
    flash[0x4000 + place] ^= 0x01;
    let mut robot = Robot::power_on(&firmware, &flash);
    assert_eq!(robot.found(), None, "nothing of it is used");
}

/// Cuts the power in these flash operations of saving the second set over `flash`, which holds the first.
fn cut_at(firmware: &Firmware, flash: &[u8], cuts: impl Iterator<Item = u64>) -> (usize, usize) {
    let mut found = Vec::new();
    for cut in cuts {
        let mut robot = Robot::power_on(firmware, flash);
        robot.set(Set(2));
        robot.board.cut_power_at_flash_operation(cut);
        let stop = robot.save().expect_err("the power fails before it answers");
        assert_eq!(stop.kind, StopKind::PowerCut);
        let left = robot.board.flash();
        let mut robot = Robot::power_on(firmware, &left);
        assert_eq!(robot.board.resets(), 0, "cut {cut}");
        let set = robot
            .found()
            .unwrap_or_else(|| panic!("cut {cut}: nothing"));
        found.push(set.0);
        // And it goes on working.
        robot.set(Set(2));
        robot.save().unwrap();
    }
    let old = found.iter().filter(|set| **set == 1).count();
    assert!(found.is_sorted(), "first the old ones, then the new ones");
    (old, found.len() - old)
}

fn operations(board: &Board) -> u64 {
    let done = board.flash_operations();
    done.programs + done.erases
}

#[test]
fn a_power_cut_in_any_operation_of_a_save_leaves_the_old_or_the_new_set() {
    let firmware = firmware();
    let flash = with_first_set(&firmware);
    let mut robot = Robot::power_on(&firmware, &flash);
    robot.set(Set(2));
    robot.save().unwrap();
    let cuts = operations(&robot.board);
    let (old, new) = cut_at(&firmware, &flash, 1..=cuts);
    println!("{cuts} operations: {old} times the old set, {new} times the new one");
    assert!(old > 0 && cuts > 50);
}

/// The same for the save that finds its sector full, copies the image to the other one and erases. It takes a second of
/// computing on the robot, so only every 24th operation is tried, and all from the end of the copy to behind the erase;
/// `tests/store.rs` tries every one on the host.
#[test]
fn a_power_cut_in_a_save_that_erases_leaves_the_old_or_the_new_set() {
    let firmware = firmware();
    let mut robot = Robot::power_on(&firmware, &with_first_set(&firmware));
    let mut counts = BTreeSet::new();
    let (flash, cuts) = loop {
        let before = (robot.board.flash(), robot.board.flash_operations());
        let started = operations(&robot.board);
        robot.save().unwrap();
        let erases = robot.board.flash_operations().erases - before.1.erases;
        counts.insert(operations(&robot.board) - started);
        if erases > 0 {
            // The watchdog has been given the time, and got its own back.
            robot.wait_ms(200);
            assert_eq!(robot.board.resets(), 0);
            break (before.0, operations(&robot.board) - started);
        }
        assert!(counts.len() < 4, "every save is like the others");
    };
    let sample = (1..=cuts).filter(|n| n % 24 == 1 || (97..=104).contains(n) || *n == cuts);
    let (old, new) = cut_at(&firmware, &flash, sample);
    println!("of {cuts} operations: {old} times the old set, {new} times the new one");
    assert!(old > 0);
}
