//! What the boot code starts: release images in either slot of an emulated board, whatever is known
//! about them.
//!
//! `OMNIBUS_ELF` names the image for slot A, which has the boot code with it, and
//! `OMNIBUS_ELF_SLOT_B` the one for slot B (`cargo xtask test` builds them and says so).

mod common;

use boot::records::{self, BLANK, Seal, State};
use boot::{Checksum, Flash, FlashError, Slot, services, slots};
use emulator::{Board, BoardConfig, Firmware, PinLevel, Port, ResetCause, StopKind, programmed};

const MS: u64 = 1_000_000;
/// Boot-up message of a robot with all switches open.
const BOOT_UP: u16 = 0x702;
/// Longest time from power to the first frame.
const FIRST_FRAME_NS: u64 = 40 * MS;
/// Longest time that the boot code may take, with a checksum of a whole image.
const BOOT_CODE_NS: u64 = 10 * MS;

fn elf(variable: &str) -> Vec<u8> {
    let path = std::env::var(variable)
        .unwrap_or_else(|_| panic!("{variable} names a release image; cargo xtask test sets it"));
    std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The content of a chip's flash.
#[derive(Clone, PartialEq)]
struct Content(Vec<u8>);

impl Content {
    fn place(&mut self, address: u32, bytes: &[u8]) {
        let at = (address - slots::BOOT) as usize;
        self.0[at..at + bytes.len()].copy_from_slice(bytes);
    }

    fn set(&mut self, address: u32, word: u32) {
        self.place(address, &word.to_le_bytes());
    }

    /// Seals what is in a slot.
    fn seal(&mut self, slot: Slot, sequence: u32) {
        let length = LENGTH;
        let words = (slot.address()..slot.address() + length).step_by(4);
        let seal = Seal {
            length,
            checksum: Checksum::NEW.over(words.map(|at| self.word(at))).value(),
            version: sequence,
            security_counter: 1,
            sequence,
        };
        records::begin(self, slot).unwrap();
        records::seal(self, slot, &seal).unwrap();
    }
}

impl Flash for Content {
    fn word(&self, address: u32) -> u32 {
        let at = (address - slots::BOOT) as usize;
        u32::from_le_bytes(*self.0[at..].first_chunk().unwrap())
    }

    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError> {
        self.set(address, self.word(address) & word);
        Ok(())
    }

    fn erase(&mut self, _: u8) -> Result<(), FlashError> {
        unreachable!("the tests set what they want")
    }
}

/// Bytes of either slot that are sealed: more than the image has.
const LENGTH: u32 = 128 * 1024;

/// The images, and a chip with the one for slot A flashed by cable and the one for slot B written
/// but not sealed.
struct Bench {
    firmware: Firmware,
    content: Content,
}

impl Bench {
    fn new() -> Self {
        let b = programmed(&elf("OMNIBUS_ELF_SLOT_B")).unwrap();
        let firmware = common::image("OMNIBUS_ELF");
        let board = Board::new(&firmware, BoardConfig::default());
        let mut content = Content(board.flash());
        for (address, bytes) in b {
            content.place(address, &bytes);
        }
        Self { firmware, content }
    }

    /// A chip on which the image of slot A is confirmed and that of slot B on trial.
    fn on_trial(&self) -> Content {
        let mut content = self.content.clone();
        content.seal(Slot::A, 1);
        records::confirm(&mut content, Slot::A).unwrap();
        content.seal(Slot::B, 2);
        records::request_trial(&mut content, Slot::B).unwrap();
        content
    }

    fn board(&self, content: &Content) -> Board {
        let mut board = Board::with_flash(&self.firmware, BoardConfig::default(), &content.0);
        for (port, pin, level) in [
            (Port::B, 12, false),
            (Port::A, 6, false),
            (Port::B, 13, true),
        ] {
            board.set_input(port, pin, level);
        }
        board
    }

    /// The slot that a chip starts, once it has sent its boot-up message.
    fn starts(&self, content: &Content) -> Option<Slot> {
        started(&mut self.board(content))
    }
}

/// Runs until the boot-up message and says in which slot the program is.
fn started(board: &mut Board) -> Option<Slot> {
    let end = board.now_ns() + FIRST_FRAME_NS;
    while board.now_ns() < end {
        board.run_until_request(end).unwrap();
        while let Some(frame) = board.can().begin() {
            board.can().transmitted();
            if frame.standard_id() == Some(BOOT_UP) {
                return running(board);
            }
        }
    }
    None
}

/// The slot whose vectors are in use: the interrupt handlers' code is where the core is.
fn running(board: &mut Board) -> Option<Slot> {
    Slot::containing(board.registers().r[15])
}

/// Runs until the core is in a slot.
fn to_image(board: &mut Board) -> (Slot, u64) {
    let from = board.now_ns();
    loop {
        board.run_until(board.now_ns() + MS / 100).unwrap();
        if let Some(slot) = running(board) {
            return (slot, board.now_ns() - from);
        }
        assert!(board.now_ns() < from + 100 * MS, "nothing is started");
    }
}

fn content(board: &Board) -> Content {
    Content(board.flash())
}

#[test]
fn the_cable_starts_slot_a_and_a_confirmed_image_slot_b() {
    let bench = Bench::new();
    assert_eq!(bench.starts(&bench.content), Some(Slot::A));
    let mut content = bench.content.clone();
    content.seal(Slot::B, 1);
    assert_eq!(
        bench.starts(&content),
        Some(Slot::A),
        "not ordered to start"
    );
    records::confirm(&mut content, Slot::B).unwrap();
    assert_eq!(bench.starts(&content), Some(Slot::B));
    records::reject(&mut content, Slot::B).unwrap();
    assert_eq!(bench.starts(&content), Some(Slot::A));
}

#[test]
fn the_boot_code_is_done_within_ten_milliseconds() {
    let bench = Bench::new();
    let (slot, ns) = to_image(&mut bench.board(&bench.content));
    println!("boot code, from cable: {} us", ns / 1000);
    assert!(slot == Slot::A && ns < MS, "{ns} ns");
    let mut content = bench.on_trial();
    records::confirm(&mut content, Slot::B).unwrap();
    let mut board = bench.board(&content);
    let (slot, ns) = to_image(&mut board);
    println!("boot code, {LENGTH} bytes sealed: {} us", ns / 1000);
    assert!(slot == Slot::B && ns < BOOT_CODE_NS, "{ns} ns");
    // What it used is as after a reset: the image runs from the 16 MHz oscillator.
    assert_eq!(board.hclk_hz(), 16_000_000);
}

#[test]
fn an_image_on_trial_is_started_three_times() {
    let bench = Bench::new();
    let mut board = bench.board(&bench.on_trial());
    for attempt in 1..=records::ATTEMPTS {
        assert_eq!(started(&mut board), Some(Slot::B));
        let state = State::read(&content(&board), Slot::B);
        assert!(matches!(state, State::Trial { attempts, .. } if attempts == attempt));
        board.press_reset();
    }
    assert_eq!(started(&mut board), Some(Slot::A));
    let mut confirmed = bench.on_trial();
    records::confirm(&mut confirmed, Slot::B).unwrap();
    assert_eq!(bench.starts(&confirmed), Some(Slot::B));
}

/// Programs that fail at their first instruction, as their sealed images would.
#[test]
fn an_image_that_hangs_or_faults_before_it_starts_gives_way_to_the_old_one() {
    let bench = Bench::new();
    // A branch to itself; an undefined instruction; one that jumps out of flash.
    for (name, code) in [
        ("hangs", 0xE7FE_u16),
        ("faults", 0xDE00),
        ("sleeps", 0xBF30),
    ] {
        let mut chip = bench.content.clone();
        chip.seal(Slot::A, 1);
        records::confirm(&mut chip, Slot::A).unwrap();
        let entry = chip.word(Slot::B.address() + 4) & !1;
        // All exceptions lead to a branch to itself, the entry to the code.
        let own = Slot::B.address() + 0x1_8000;
        chip.place(own, &[0xFE, 0xE7]);
        (2..16).for_each(|nth| chip.set(Slot::B.address() + 4 * nth, own + 1));
        chip.place(entry, &code.to_le_bytes());
        chip.place(entry + 2, &[0xFC, 0xE7]);
        chip.seal(Slot::B, 2);
        records::request_trial(&mut chip, Slot::B).unwrap();
        let mut board = bench.board(&chip);
        for _ in 0..records::ATTEMPTS {
            assert_eq!(to_image(&mut board).0, Slot::B, "{name}");
            let before = board.resets();
            while board.resets() == before {
                board.run_until(board.now_ns() + 10 * MS).unwrap();
                assert!(board.now_ns() < 20_000 * MS, "{name}: no watchdog");
            }
            assert_eq!(board.reset_cause(), ResetCause::Watchdog, "{name}");
        }
        assert_eq!(started(&mut board), Some(Slot::A), "{name}");
    }
}

#[test]
fn an_image_that_is_not_whole_is_not_started() {
    let bench = Bench::new();
    let mut confirmed = bench.on_trial();
    records::confirm(&mut confirmed, Slot::B).unwrap();
    // One bit anywhere: at its ends, and every few kilobytes.
    for at in (0..LENGTH).step_by(9_973).chain([LENGTH - 1]) {
        let mut chip = confirmed.clone();
        chip.0[(Slot::B.address() - slots::BOOT + at) as usize] ^= 0x10;
        assert_eq!(bench.starts(&chip), Some(Slot::A), "byte {at}");
    }
    // A slot that was wiped, with and without its tail.
    let mut chip = confirmed.clone();
    chip.place(Slot::B.address(), &vec![0xFF; LENGTH as usize]);
    assert_eq!(bench.starts(&chip), Some(Slot::A));
    let mut chip = confirmed;
    chip.place(Slot::B.address(), &vec![0xFF; Slot::B.length() as usize]);
    assert_eq!(bench.starts(&chip), Some(Slot::A));
}

/// The boot code programs one word, and only before a trial.
#[test]
fn power_that_fails_while_an_attempt_is_noted_costs_that_attempt() {
    let bench = Bench::new();
    let chip = bench.on_trial();
    let mut board = bench.board(&chip);
    board.cut_power_at_flash_operation(1);
    let stop = loop {
        if let Err(stop) = board.run_until(board.now_ns() + MS) {
            break stop;
        }
    };
    assert!(matches!(stop.kind, StopKind::PowerCut));
    let cut = content(&board);
    assert!(cut != chip);
    let mut board = bench.board(&cut);
    assert_eq!(started(&mut board), Some(Slot::B));
    assert_eq!(board.flash_operations().programs, 1);
    // Nothing is written for any other reason to start.
    let mut board = bench.board(&bench.content);
    to_image(&mut board);
    assert_eq!(board.flash_operations().programs, 0);
}

/// Each word of what is known about a slot, as a loss of power may leave it.
#[test]
fn any_word_of_the_records_may_be_torn() {
    let bench = Bench::new();
    let mut confirmed = bench.on_trial();
    records::confirm(&mut confirmed, Slot::B).unwrap();
    for (name, chip) in [("trial", bench.on_trial()), ("confirmed", confirmed)] {
        for slot in Slot::ALL {
            for at in (slot.tail()..slot.tail() + slots::TAIL_LENGTH).step_by(4) {
                for torn in [BLANK, 0xFFFF_0000, 0] {
                    let mut torn_chip = chip.clone();
                    torn_chip.set(at, torn);
                    let found = bench.starts(&torn_chip);
                    assert!(found.is_some(), "{name}: {at:#x} as {torn:#x}");
                    let first = records::candidates(&torn_chip).into_iter().flatten().next();
                    assert_eq!(found, first.map(|candidate| candidate.slot));
                }
            }
        }
    }
}

/// Random records: the boot code agrees with what the library says on the host.
#[test]
fn garbage_for_records_starts_what_the_library_says() {
    let bench = Bench::new();
    let mut state = 0x1234_5678_9ABC_DEF1_u64;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u32
    };
    for round in 0..100 {
        let mut chip = bench.on_trial();
        for slot in Slot::ALL {
            for nth in 0..16 {
                if random() % 4 == 0 {
                    let word = [0, BLANK, random()][random() as usize % 3];
                    chip.set(slot.tail() + 4 * nth, word);
                }
            }
        }
        if random() % 3 == 0 {
            chip.set(slots::MARK + 4, BLANK);
        }
        let first = records::candidates(&chip).into_iter().flatten().next();
        let mut board = bench.board(&chip);
        match first {
            Some(candidate) => assert_eq!(to_image(&mut board).0, candidate.slot, "{round}"),
            None => {
                board.run_until(50 * MS).unwrap();
                assert_eq!(running(&mut board), None, "{round}");
            }
        }
    }
}

#[test]
fn a_chip_without_an_image_waits_with_its_outputs_as_the_reset_left_them() {
    let bench = Bench::new();
    let mut chip = bench.content.clone();
    for slot in Slot::ALL {
        chip.place(slot.address(), &vec![0xFF; slot.length() as usize]);
    }
    let mut board = bench.board(&chip);
    board.run_until(500 * MS).unwrap();
    assert_eq!(running(&mut board), None);
    assert_eq!(board.resets(), 0);
    // PA8 is the PWM of a wheel.
    assert_eq!(board.output(Port::A, 8), PinLevel::Floating);
}

/// The function of the boot code that images call, with arguments in flash, and the time it takes.
#[test]
fn the_boot_code_lends_the_check_of_signatures() {
    let bench = Bench::new();
    let mut chip = bench.content.clone();
    // Without an image the boot code waits, and no interrupt comes in between.
    for slot in Slot::ALL {
        chip.place(slot.address(), &vec![0xFF; slot.length() as usize]);
    }
    let message = [0x5A; 192];
    let place = Slot::B.address() + 0x3_0000;
    let mut check = |signature: [u8; 64]| {
        chip.place(place, &message);
        chip.place(place + 192, &signature);
        // Where it returns to.
        chip.place(place + 256, &[0xFE, 0xE7]);
        let mut board = bench.board(&chip);
        board.run_until(MS).unwrap();
        let table = |nth: u32| chip.word(services::ADDRESS + 4 * nth);
        assert_eq!(table(0), services::MAGIC);
        assert_eq!(table(5), 1, "built with the development key");
        let mut registers = board.registers();
        registers.r[0] = place;
        registers.r[1] = 192;
        registers.r[2] = place + 192;
        registers.r[13] = 0x2000_8000;
        registers.r[14] = place + 257;
        registers.r[15] = table(4) & !1;
        board.set_registers(&registers);
        let from = board.now_ns();
        while board.registers().r[15] & !1 != place + 256 {
            board.run_until(board.now_ns() + MS / 10).unwrap();
            assert!(board.now_ns() < from + 2_000 * MS);
        }
        (board.registers().r[0], board.now_ns() - from)
    };
    let good = boot::sign(&boot::key::DEVELOPMENT_PRIVATE, &message);
    let (answer, ns) = check(good);
    println!("signature checked in {} cycles", ns * 16 / 1000);
    assert_eq!(answer, 1);
    let mut bent = good;
    bent[40] ^= 1;
    assert_eq!(check(bent).0, 0);
}
