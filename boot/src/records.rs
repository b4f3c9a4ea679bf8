//! The state of each slot, and the decision which slot is started.
//!
//! # Theory of operation
//!
//! Sixteen words at the end of each slot, which are written one after the other and erased with
//! the slot; before that, words 0 and 1 [discard] it:
//!
//! | word | written | |
//! |---|---|---|
//! | 0 | before the erase, and again before the first word of the image | an update is received |
//! | 1 to 7 | once the image is checked | the [seal](Seal), its own checksum last |
//! | 8 | at the order to start it | on trial |
//! | 9 to 11 | by the boot code before it starts a trial | one attempt each |
//! | 12, 13 | by the image when it works | confirmed |
//! | 14 | by the order to go back | rejected |
//! | 15 | | |
//!
//! The sector before slot A has the *mark of the cable*: a programmer writes this sector with the
//! program. It means that slot A is started whatever the states of the slots, until an update
//! [begins](begin).
//!
//! # Loss of power
//!
//! A word whose writing was interrupted may have any bits, and may read differently the next time.
//! So a word counts as written when it is not blank. Only confirmation needs two words: the first
//! has to be 0 and the second not blank. An image that finds itself [confirmed but not
//! settled](State) writes both again.
//!
//! # Limits
//!
//! Nothing here erases; the program that updates a slot erases it.

use crate::Checksum;
use crate::slots::{self, Slot};

/// Flash by address, a word at a time. A word that is erased reads as [`BLANK`].
pub trait Flash {
    /// Reads a word.
    fn word(&self, address: u32) -> u32;

    /// Programs a word: bits that are 0 in it become 0.
    ///
    /// # Errors
    /// When the flash refuses.
    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError>;

    /// Erases a sector.
    ///
    /// # Errors
    /// When the flash refuses.
    fn erase(&mut self, sector: u8) -> Result<(), FlashError>;
}

/// The flash cannot be written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FlashError;

/// A word of erased flash.
pub const BLANK: u32 = u32::MAX;

/// How often an image on trial is started.
pub const ATTEMPTS: u8 = 3;

/// First word of the mark of the cable, which `memory/` has too. The second word is blank until an
/// update begins.
pub const CABLE: u32 = u32::from_le_bytes(*b"OMCB");

const WORD: u32 = 4;
const SEAL_MAGIC: u32 = u32::from_le_bytes(*b"OMS1");

/// Words of a slot's tail.
mod at {
    pub const BEGUN: u32 = 0;
    pub const SEAL: u32 = 1;
    pub const TRIAL: u32 = 8;
    pub const ATTEMPTS: u32 = 9;
    pub const CONFIRMED: u32 = 12;
    pub const REJECTED: u32 = 14;
}

/// A whole image in a slot, whose signature and hash were right when it was received.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Seal {
    /// Bytes of the image.
    pub length: u32,
    /// [`Checksum`] of its words.
    pub checksum: u32,
    /// Version of the firmware, as object 0x2001:2 has it.
    pub version: u32,
    /// Security counter of the image.
    pub security_counter: u32,
    /// Grows with every image; see [`next_sequence`].
    pub sequence: u32,
}

impl Seal {
    const fn words(&self) -> [u32; 6] {
        [
            SEAL_MAGIC,
            self.length,
            self.checksum,
            self.version,
            self.security_counter,
            self.sequence,
        ]
    }

    /// The seal of a slot that has one.
    #[must_use]
    pub fn read(flash: &impl Flash, slot: Slot) -> Option<Self> {
        let word = |nth| flash.word(tail(slot, at::SEAL + nth));
        let seal = Self {
            length: word(1),
            checksum: word(2),
            version: word(3),
            security_counter: word(4),
            sequence: word(5),
        };
        let words = seal.words();
        let is_whole = word(0) == SEAL_MAGIC && word(6) == Checksum::NEW.over(words).value();
        (is_whole && slot.holds(seal.length)).then_some(seal)
    }
}

/// What is known about a slot.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum State {
    /// Nothing: it is empty, or was written by cable.
    Unknown,
    /// An update of it began and has not ended.
    Receiving,
    /// A whole image that has not been ordered to start.
    Ready(Seal),
    /// To be started until it is confirmed, at most [`ATTEMPTS`] times.
    Trial {
        /// The image.
        seal: Seal,
        /// How often it has been started.
        attempts: u8,
    },
    /// It works.
    Confirmed {
        /// The image.
        seal: Seal,
        /// Whether both words are whole; if not, [`confirm`] writes them again.
        is_settled: bool,
    },
    /// It is not to be started again.
    Rejected(Seal),
}

impl State {
    /// Reads it.
    #[must_use]
    pub fn read(flash: &impl Flash, slot: Slot) -> Self {
        let word = |nth| flash.word(tail(slot, nth));
        let is_marked = |nth| word(nth) != BLANK;
        let Some(seal) = Seal::read(flash, slot) else {
            return if is_marked(at::BEGUN) {
                Self::Receiving
            } else {
                Self::Unknown
            };
        };
        if is_marked(at::REJECTED) {
            return Self::Rejected(seal);
        }
        if word(at::CONFIRMED) == 0 && is_marked(at::CONFIRMED + 1) {
            let is_settled = word(at::CONFIRMED + 1) == 0;
            return Self::Confirmed { seal, is_settled };
        }
        if !is_marked(at::TRIAL) {
            return Self::Ready(seal);
        }
        let mut attempts = 0;
        for nth in 0..ATTEMPTS {
            attempts += u8::from(is_marked(at::ATTEMPTS + u32::from(nth)));
        }
        Self::Trial { seal, attempts }
    }

    /// The image, if there is a whole one.
    #[must_use]
    pub const fn seal(&self) -> Option<&Seal> {
        match self {
            Self::Unknown | Self::Receiving => None,
            Self::Ready(seal)
            | Self::Trial { seal, .. }
            | Self::Confirmed { seal, .. }
            | Self::Rejected(seal) => Some(seal),
        }
    }
}

/// Whether slot A was written by cable, and no update has begun since.
#[must_use]
pub fn is_from_cable(flash: &impl Flash) -> bool {
    flash.word(slots::MARK) == CABLE && flash.word(slots::MARK + WORD) == BLANK
}

/// Whether a slot may be erased for an update: not while the image in the other one, which is
/// running, is on trial, because this one is what a failed trial goes back to.
#[must_use]
pub fn may_be_replaced(flash: &impl Flash, slot: Slot) -> bool {
    let running = State::read(flash, slot.other());
    is_from_cable(flash) || !matches!(running, State::Trial { .. })
}

/// Notes that a slot is about to be erased. An erase that loses its power leaves any part of what
/// was there: without this, a seal beside half an image, or half an image about which nothing is
/// known.
///
/// # Errors
/// When the flash refuses.
pub fn discard(flash: &mut impl Flash, slot: Slot) -> Result<(), FlashError> {
    for nth in [at::BEGUN, at::SEAL] {
        if flash.word(tail(slot, nth)) != 0 {
            flash.program(tail(slot, nth), 0)?;
        }
    }
    Ok(())
}

/// Notes that a slot is being received. To be called between the erase of its sectors and its
/// first word; from here on, the mark of the cable no longer counts.
///
/// # Errors
/// When the flash refuses.
pub fn begin(flash: &mut impl Flash, slot: Slot) -> Result<(), FlashError> {
    flash.program(tail(slot, at::BEGUN), 0)?;
    if flash.word(slots::MARK + WORD) != 0 {
        flash.program(slots::MARK + WORD, 0)?;
    }
    Ok(())
}

/// The sequence number of the next image.
#[must_use]
pub fn next_sequence(flash: &impl Flash) -> u32 {
    let seals = Slot::ALL.map(|slot| Seal::read(flash, slot));
    let highest = seals.iter().flatten().map(|seal| seal.sequence).max();
    highest.unwrap_or(0).saturating_add(1)
}

/// Seals a slot whose image has been checked.
///
/// # Errors
/// When the flash refuses, or the slot cannot have such an image.
pub fn seal(flash: &mut impl Flash, slot: Slot, seal: &Seal) -> Result<(), FlashError> {
    if !slot.holds(seal.length) {
        return Err(FlashError);
    }
    let words = seal.words();
    let check = Checksum::NEW.over(words).value();
    for (nth, word) in (at::SEAL..).zip(words.into_iter().chain([check])) {
        flash.program(tail(slot, nth), word)?;
    }
    if Seal::read(flash, slot) == Some(*seal) {
        Ok(())
    } else {
        Err(FlashError)
    }
}

/// Orders that the image is started at the next reset.
///
/// # Errors
/// When the flash refuses.
pub fn request_trial(flash: &mut impl Flash, slot: Slot) -> Result<(), FlashError> {
    flash.program(tail(slot, at::TRIAL), 0)
}

/// Counts an attempt to start an image on trial; the boot code does that.
///
/// # Errors
/// When the flash refuses, or there is no attempt left.
pub fn count_attempt(flash: &mut impl Flash, slot: Slot) -> Result<(), FlashError> {
    let mut marks = (0..ATTEMPTS).map(|nth| tail(slot, at::ATTEMPTS + u32::from(nth)));
    let free = marks.find(|mark| flash.word(*mark) == BLANK);
    flash.program(free.ok_or(FlashError)?, 0)
}

/// Confirms the image: it is started from now on.
///
/// # Errors
/// When the flash refuses.
pub fn confirm(flash: &mut impl Flash, slot: Slot) -> Result<(), FlashError> {
    flash.program(tail(slot, at::CONFIRMED), 0)?;
    flash.program(tail(slot, at::CONFIRMED + 1), 0)
}

/// Rejects the image: the other one is started from the next reset on.
///
/// # Errors
/// When the flash refuses.
pub fn reject(flash: &mut impl Flash, slot: Slot) -> Result<(), FlashError> {
    flash.program(tail(slot, at::REJECTED), 0)
}

/// Why a slot is started; the first reason wins.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Reason {
    /// It was written by cable, and no update has begun since.
    Cable,
    /// It is on trial and has attempts left.
    Trial,
    /// It is confirmed. Of two, the later one.
    Confirmed,
    /// Nothing is known about it: it was written by cable before an update of the other slot
    /// began.
    Unknown,
    /// It is whole, and there is nothing better: not ordered to start, then without attempts left,
    /// then rejected.
    LastResort(u8),
}

/// A slot that may be started.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Candidate {
    /// The slot.
    pub slot: Slot,
    /// Why.
    pub reason: Reason,
    /// What its image has to agree with; without one only the vectors can be checked.
    pub seal: Option<Seal>,
}

impl Candidate {
    fn of(flash: &impl Flash, slot: Slot) -> Option<Self> {
        let state = State::read(flash, slot);
        if slot == Slot::A && is_from_cable(flash) {
            let reason = Reason::Cable;
            let seal = None;
            return Some(Self { slot, reason, seal });
        }
        let reason = match state {
            State::Receiving => return None,
            State::Unknown => Reason::Unknown,
            State::Ready(_) => Reason::LastResort(0),
            State::Trial { attempts, .. } if attempts < ATTEMPTS => Reason::Trial,
            State::Trial { .. } => Reason::LastResort(1),
            State::Confirmed { .. } => Reason::Confirmed,
            State::Rejected(_) => Reason::LastResort(2),
        };
        let seal = state.seal().copied();
        Some(Self { slot, reason, seal })
    }

    /// What comes first among candidates.
    fn rank(&self) -> (Reason, u32) {
        let sequence = self.seal.map_or(0, |seal| seal.sequence);
        (self.reason, !sequence)
    }

    /// Whether the image is whole, as far as that can be known: its vectors can be those of an
    /// image, and where it is sealed, `checksum` of so many bytes from the slot's address on is
    /// that of the seal.
    pub fn is_whole(&self, flash: &impl Flash, checksum: impl FnOnce(u32, u32) -> u32) -> bool {
        let address = self.slot.address();
        let (stack, entry) = (flash.word(address), flash.word(address + WORD));
        self.slot.has_vectors(stack, entry)
            && self
                .seal
                .is_none_or(|seal| checksum(address, seal.length) == seal.checksum)
    }
}

/// The slots that may be started, the best one first. The first that is
/// [whole](Candidate::is_whole) is to be started, after [`count_attempt`] if it is on trial.
pub fn candidates(flash: &impl Flash) -> [Option<Candidate>; 2] {
    let [a, b] = Slot::ALL.map(|slot| Candidate::of(flash, slot));
    match (a, b) {
        (Some(first), Some(second)) if second.rank() < first.rank() => [b, a],
        (None, _) => [b, a],
        _ => [a, b],
    }
}

const fn tail(slot: Slot, nth: u32) -> u32 {
    slot.tail() + nth * WORD
}
