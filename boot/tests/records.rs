//! What is known about the slots: which one is started, and a loss of power at every word.

use std::collections::BTreeMap;

use omnibus_boot::records::{self, BLANK, CABLE, Candidate, Reason, Seal, State};
use omnibus_boot::slots::MARK;
use omnibus_boot::{Checksum, Flash, FlashError, Slot};
use proptest::prelude::*;

/// What a word holds that power was lost in.
#[derive(Clone, Copy, Debug)]
enum Torn {
    Nothing,
    LowerHalf,
    Random(u32),
}

/// Flash whose power fails at an operation.
#[derive(Clone, Default)]
struct Chip {
    words: BTreeMap<u32, u32>,
    operations: u32,
    cut: Option<(u32, u32, Torn)>,
}

impl Chip {
    fn fails(&mut self) -> Option<Torn> {
        self.operations += 1;
        let (from, to, torn) = self.cut?;
        (from..to).contains(&self.operations).then_some(torn)
    }
}

impl Flash for Chip {
    fn word(&self, address: u32) -> u32 {
        assert!(address.is_multiple_of(4));
        self.words.get(&address).copied().unwrap_or(BLANK)
    }

    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError> {
        let old = self.word(address);
        let new = match self.fails() {
            None => word,
            Some(torn) => {
                let kept = match torn {
                    Torn::Nothing => BLANK,
                    Torn::LowerHalf => 0xFFFF_0000,
                    Torn::Random(bits) => bits,
                };
                self.words.insert(address, old & (word | kept));
                return Err(FlashError);
            }
        };
        self.words.insert(address, old & new);
        Ok(())
    }

    fn erase(&mut self, sector: u8) -> Result<(), FlashError> {
        let mut found = None;
        for slot in Slot::ALL {
            let mut start = slot.address();
            for (nth, length) in slot.sectors() {
                if nth == sector {
                    found = Some(start..start + length);
                }
                start += length;
            }
        }
        let range = found.unwrap_or(MARK..MARK + 0x4000);
        let is_cut = self.fails().is_some();
        let end = if is_cut {
            range.start + (range.end - range.start) / 2
        } else {
            range.end
        };
        self.words.retain(|at, _| !(range.start..end).contains(at));
        if is_cut { Err(FlashError) } else { Ok(()) }
    }
}

const LENGTH: u32 = 512;

/// Words of an image that can be in a slot.
fn image(slot: Slot, version: u32) -> Vec<u32> {
    let mut words = vec![version; LENGTH as usize / 4];
    words[0] = 0x2000_8000;
    words[1] = slot.address() + 0x201;
    words
}

/// A chip as a programmer leaves it.
fn flashed() -> Chip {
    let mut chip = Chip::default();
    chip.words.insert(MARK, CABLE);
    write(&mut chip, Slot::A, 1).unwrap();
    chip.operations = 0;
    chip
}

fn write(chip: &mut Chip, slot: Slot, version: u32) -> Result<(), FlashError> {
    for (at, word) in (slot.address()..).step_by(4).zip(image(slot, version)) {
        chip.program(at, word)?;
    }
    Ok(())
}

fn erase(chip: &mut Chip, slot: Slot) -> Result<(), FlashError> {
    // The last sector first: it has the tail.
    for (sector, _) in slot.sectors().into_iter().rev() {
        chip.erase(sector)?;
    }
    Ok(())
}

/// Receives an image and seals it.
fn receive(chip: &mut Chip, slot: Slot, version: u32) -> Result<(), FlashError> {
    let sequence = records::next_sequence(chip);
    records::discard(chip, slot)?;
    erase(chip, slot)?;
    records::begin(chip, slot)?;
    write(chip, slot, version)?;
    let seal = Seal {
        length: LENGTH,
        checksum: Checksum::NEW.over(image(slot, version)).value(),
        version,
        security_counter: 1,
        sequence,
    };
    records::seal(chip, slot, &seal)
}

fn install(chip: &mut Chip, slot: Slot, version: u32) -> Result<(), FlashError> {
    receive(chip, slot, version)?;
    records::request_trial(chip, slot)?;
    assert_eq!(boots(chip), Some((slot, Reason::Trial)));
    records::confirm(chip, slot)
}

fn checksum(chip: &Chip, address: u32, length: u32) -> u32 {
    let words = (address..address + length).step_by(4);
    Checksum::NEW.over(words.map(|at| chip.word(at))).value()
}

fn first(chip: &Chip) -> Option<Candidate> {
    let whole = |candidate: &Candidate| {
        candidate.is_whole(chip, |address, length| checksum(chip, address, length))
    };
    records::candidates(chip).into_iter().flatten().find(whole)
}

/// What the boot code does.
fn boots(chip: &mut Chip) -> Option<(Slot, Reason)> {
    let Candidate { slot, reason, .. } = first(chip)?;
    if reason == Reason::Trial {
        let _ = records::count_attempt(chip, slot);
    }
    Some((slot, reason))
}

/// Version of the image in a slot.
fn version(chip: &Chip, slot: Slot) -> u32 {
    chip.word(slot.address() + LENGTH - 4)
}

#[test]
fn the_chip_computes_this_checksum() {
    // CRC-32/MPEG-2 of "123456789abc", each word from its highest bit; the value of the first
    // eight bytes is that of the catalogue's algorithm computed bit by bit elsewhere.
    let words = [0x3132_3334, 0x3536_3738];
    assert_eq!(Checksum::NEW.value(), 0xFFFF_FFFF);
    // STM32 CRC unit, word 0x00000000 after reset: 0xC704DD7B.
    assert_eq!(Checksum::NEW.with(0).value(), 0xC704_DD7B);
    // CRC-32/MPEG-2 of "123456789" is 0x0376E6E7: the eight bytes before, then the last one.
    let mut crc = Checksum::NEW.over(words).value() ^ u32::from(b'9') << 24;
    for _ in 0..8 {
        crc = if crc >> 31 == 1 {
            crc << 1 ^ 0x04C1_1DB7
        } else {
            crc << 1
        };
    }
    assert_eq!(crc, 0x0376_E6E7);
}

#[test]
fn an_empty_chip_has_nothing_to_start_and_a_flashed_one_starts_slot_a() {
    assert_eq!(boots(&mut Chip::default()), None);
    assert_eq!(boots(&mut flashed()), Some((Slot::A, Reason::Cable)));
    // Written by a tool that knows no mark.
    let mut bare = flashed();
    bare.words.remove(&MARK);
    assert_eq!(boots(&mut bare), Some((Slot::A, Reason::Unknown)));
}

#[test]
fn an_image_is_started_three_times_on_trial_and_then_the_other_one() {
    let mut chip = flashed();
    receive(&mut chip, Slot::B, 2).unwrap();
    assert_eq!(
        boots(&mut chip),
        Some((Slot::A, Reason::Unknown)),
        "no order to start"
    );
    records::request_trial(&mut chip, Slot::B).unwrap();
    for _ in 0..records::ATTEMPTS {
        assert_eq!(boots(&mut chip), Some((Slot::B, Reason::Trial)));
    }
    assert_eq!(boots(&mut chip), Some((Slot::A, Reason::Unknown)));
    assert_eq!(records::count_attempt(&mut chip, Slot::B), Err(FlashError));
}

#[test]
fn a_confirmed_image_stays_and_the_later_one_wins() {
    let mut chip = flashed();
    install(&mut chip, Slot::B, 2).unwrap();
    assert_eq!(boots(&mut chip), Some((Slot::B, Reason::Confirmed)));
    install(&mut chip, Slot::A, 3).unwrap();
    assert_eq!(boots(&mut chip), Some((Slot::A, Reason::Confirmed)));
    records::reject(&mut chip, Slot::A).unwrap();
    assert_eq!(boots(&mut chip), Some((Slot::B, Reason::Confirmed)));
}

#[test]
fn the_cable_wins_over_what_was_before_it() {
    let mut chip = flashed();
    install(&mut chip, Slot::B, 2).unwrap();
    // A programmer erases the mark's sector and those of slot A.
    chip.erase(3).unwrap();
    erase(&mut chip, Slot::A).unwrap();
    chip.words.insert(MARK, CABLE);
    write(&mut chip, Slot::A, 3).unwrap();
    assert_eq!(boots(&mut chip), Some((Slot::A, Reason::Cable)));
    // It was pulled before the image was whole.
    chip.words.remove(&Slot::A.address());
    assert_eq!(boots(&mut chip), Some((Slot::B, Reason::Confirmed)));
}

#[test]
fn a_decayed_image_is_not_started_while_there_is_another() {
    let mut chip = flashed();
    install(&mut chip, Slot::B, 2).unwrap();
    install(&mut chip, Slot::A, 3).unwrap();
    *chip.words.get_mut(&(Slot::A.address() + 300)).unwrap() ^= 1 << 9;
    assert_eq!(boots(&mut chip), Some((Slot::B, Reason::Confirmed)));
    records::reject(&mut chip, Slot::B).unwrap();
    assert_eq!(boots(&mut chip), Some((Slot::B, Reason::LastResort(2))));
}

#[test]
fn a_seal_that_does_not_fit_is_refused() {
    let mut chip = flashed();
    let seal = |length| Seal {
        length,
        checksum: 0,
        version: 0,
        security_counter: 0,
        sequence: 0,
    };
    for wrong in [0, 508, 514, Slot::A.longest_image() + 4, u32::MAX - 3] {
        assert_eq!(
            records::seal(&mut chip, Slot::A, &seal(wrong)),
            Err(FlashError)
        );
    }
    assert_eq!(State::read(&chip, Slot::A), State::Unknown);
    // Over something else.
    chip.words.insert(Slot::A.tail() + 8, 0);
    assert_eq!(
        records::seal(&mut chip, Slot::A, &seal(512)),
        Err(FlashError)
    );
}

/// Both parities of an update: from the image of the cable to slot B, and from there to slot A.
fn chips() -> [(Chip, Slot); 2] {
    let mut later = flashed();
    install(&mut later, Slot::B, 2).unwrap();
    later.operations = 0;
    [(flashed(), Slot::B), (later, Slot::A)]
}

#[test]
fn power_lost_at_any_operation_of_an_update_leaves_the_old_image_or_the_new_one() {
    for (chip, slot) in chips() {
        let old = version(&chip, slot.other());
        let mut whole = chip.clone();
        install(&mut whole, slot, 9).unwrap();
        for operation in 1..=whole.operations {
            for torn in [Torn::Nothing, Torn::LowerHalf, Torn::Random(0x5A3C_9999)] {
                let mut cut = chip.clone();
                cut.cut = Some((operation, operation + 1, torn));
                // The boot code's attempt, before the two words of the confirmation, may fail.
                let is_attempt = operation == whole.operations - 2;
                assert!(install(&mut cut, slot, 9).is_err() || is_attempt);
                let (started, _) = boots(&mut cut).expect("something is started");
                let is_old = started == slot.other() && version(&cut, started) == old;
                let is_new = started == slot && version(&cut, started) == 9;
                assert!(
                    is_old || is_new,
                    "{slot:?} {operation} {torn:?}: {started:?}"
                );
                // The next update works, once what runs is confirmed.
                if !records::may_be_replaced(&cut, started.other()) {
                    records::confirm(&mut cut, started).unwrap();
                }
                let next = started.other();
                install(&mut cut, next, 10).unwrap();
                assert_eq!(boots(&mut cut), Some((next, Reason::Confirmed)));
            }
        }
    }
}

#[test]
fn power_lost_in_the_boot_code_costs_an_attempt_at_most() {
    for torn in [Torn::Nothing, Torn::LowerHalf] {
        let mut chip = flashed();
        receive(&mut chip, Slot::B, 2).unwrap();
        records::request_trial(&mut chip, Slot::B).unwrap();
        let next = chip.operations + 1;
        chip.cut = Some((next, next + 1, torn));
        let starts = (0..6).map(|_| boots(&mut chip).map(|(slot, _)| slot));
        let in_b = starts.filter(|slot| *slot == Some(Slot::B)).count();
        assert!((3..=4).contains(&in_b), "{in_b}");
    }
}

#[test]
fn a_confirmation_that_was_cut_is_made_whole() {
    for operation in [0, 1] {
        let mut chip = flashed();
        receive(&mut chip, Slot::B, 2).unwrap();
        records::request_trial(&mut chip, Slot::B).unwrap();
        let at = chip.operations + 1 + operation;
        chip.cut = Some((at, at + 1, Torn::LowerHalf));
        assert!(records::confirm(&mut chip, Slot::B).is_err());
        let state = State::read(&chip, Slot::B);
        let is_settled = matches!(
            state,
            State::Confirmed {
                is_settled: true,
                ..
            }
        );
        assert!(!is_settled, "{state:?}");
        assert_eq!(boots(&mut chip).unwrap().0, Slot::B);
        records::confirm(&mut chip, Slot::B).unwrap();
        let state = State::read(&chip, Slot::B);
        assert!(matches!(
            state,
            State::Confirmed {
                is_settled: true,
                ..
            }
        ));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100_000))]

    /// Garbage in everything that is known, with whole images in both slots: something that is
    /// whole is started unless both slots say that they were being written.
    #[test]
    fn any_records_lead_to_a_whole_image(
        mark in proptest::array::uniform2(words()),
        a in proptest::array::uniform16(words()),
        b in proptest::array::uniform16(words()),
    ) {
        let mut chip = Chip::default();
        for (slot, tail) in Slot::ALL.into_iter().zip([a, b]) {
            write(&mut chip, slot, 3).unwrap();
            chip.words.extend((slot.tail()..).step_by(4).zip(tail));
        }
        chip.words.extend([(MARK, mark[0]), (MARK + 4, mark[1])]);
        let receiving = Slot::ALL.map(|slot| State::read(&chip, slot) == State::Receiving);
        let started = first(&chip);
        if receiving == [true, true] && !records::is_from_cable(&chip) {
            prop_assert_eq!(started, None);
        } else {
            let started = started.expect("something is started");
            prop_assert_eq!(version(&chip, started.slot), 3);
        }
    }
}

/// Words of records: blank, zero, magic ones, half ones, any.
fn words() -> impl Strategy<Value = u32> {
    prop_oneof![
        4 => Just(BLANK),
        2 => Just(0),
        1 => Just(CABLE),
        1 => Just(0xFFFF_0000),
        1 => Just(u32::from_le_bytes(*b"OMS1")),
        1 => any::<u32>(),
    ]
}
