//! A log of records in two sectors of flash: what a robot retains over a power loss.
//!
//! # Theory of operation
//!
//! One sector is in use. Records are appended to it until one does not fit; then the other sector
//! is erased, what still counts is copied there together with the new record, and its header is
//! written last. Of two sectors with a header the one of the higher generation is in use. So a
//! power loss at any operation leaves the old state or the new one, and there is nothing to repair:
//! [`RecordStore::open`] only reads, every record once, and never writes. How often and what has
//! been saved makes no difference to the time a start takes.
//!
//! # Layout
//!
//! | sector, in words | |
//! |---|---|
//! | 1 | magic, with the version of this layout |
//! | 5 | generation, and the counts at its beginning: saves, erases, cut saves, starts |
//! | 1 | CRC-32 of those five |
//! | 1 | 0 when the other sector has taken over |
//! | | records |
//!
//! | record, in words | |
//! |---|---|
//! | 1 | kind (4 bits) and length in bytes (12 bits), and the complement of both in the upper half |
//! | | content, filled up with zeros |
//! | 1 | CRC-32 of the content |
//! | 1 | 0, written last: the record is whole |
//!
//! # Damage
//!
//! An unfinished record is the last one in its sector: nothing is appended behind it, and the next
//! write goes to the other sector. A record that is whole but whose CRC fails has decayed. A
//! decayed fault is ignored; a decayed newest image is reported as [`Image::Unreadable`], and no
//! older one replaces it.
//!
//! The flash of a robot that has run a version before this one is read as it is (`legacy`) until
//! the first write.

mod legacy;

use protocol::crc32;

use crate::counters::StoreWear;
use crate::lock::{KEY_LENGTH, Key, NO_KEY};

/// Two sectors of flash, as words at offsets in bytes from the first one.
pub trait Flash {
    /// Length of a sector, bytes.
    const SECTOR: u32;

    /// Reads a word.
    fn word(&self, at: u32) -> u32;

    /// Programs a word: bits that are 0 in it become 0.
    ///
    /// # Errors
    /// When the flash refuses.
    fn program(&mut self, at: u32, word: u32) -> Result<(), StoreError>;

    /// Erases the sector that begins at `at`.
    ///
    /// # Errors
    /// When the flash refuses.
    fn erase(&mut self, at: u32) -> Result<(), StoreError>;
}

/// The flash cannot be written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StoreError;

/// Where the newest image is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Image {
    /// There has never been one.
    Nothing,
    /// At this offset, of this length; neither needs to be a multiple of four.
    At(u32, u16),
    /// It has decayed.
    Unreadable,
}

/// Faults that are kept.
pub const FAULTS: usize = protocol::address::history::DEPTH as usize;

/// Room that is left for faults when a start is noted, bytes: an erase is due before a robot moves,
/// not after.
const RESERVE: u32 = 1024;

const BLANK: u32 = u32::MAX;
const WORD: u32 = 4;
/// The layout's version, and "OMN".
const MAGIC: u32 = u32::from_le_bytes([3, b'O', b'M', b'N']);
const COUNTS: u32 = 5;
const RETIRED: u32 = (COUNTS + 2) * WORD;
const HEADER: u32 = RETIRED + WORD;

/// Kinds of records.
mod kind {
    /// A saved image.
    pub const IMAGE: u16 = 1;
    /// An image copied from the other sector; empty when there it was unreadable.
    pub const COPY: u16 = 2;
    /// A fault.
    pub const FAULT: u16 = 3;
    /// A start.
    pub const START: u16 = 4;
    /// The key of the lock.
    pub const KEY: u16 = 5;
}

/// What a record is filled from.
#[derive(Clone, Copy)]
enum Content<'a> {
    Bytes(&'a [u8]),
    /// Flash, from this offset on.
    Flash(u32),
}

/// A record in flash.
#[derive(Clone, Copy)]
struct Record {
    at: u32,
    kind: u16,
    length: u16,
}

impl Record {
    /// Parses the first word of a record.
    fn parse(at: u32, word: u32) -> Option<Self> {
        let [a, b, c, d] = word.to_le_bytes();
        let (tag, complement) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
        (tag == !complement).then_some(Self {
            at,
            kind: tag >> 12,
            length: tag & 0xFFF,
        })
    }

    const fn content(self) -> u32 {
        self.at + WORD
    }

    /// Where its CRC is.
    fn crc(self) -> u32 {
        self.content() + u32::from(self.length).next_multiple_of(WORD)
    }

    /// Where the word is that makes it whole.
    fn seal(self) -> u32 {
        self.crc() + WORD
    }

    /// Where the next record begins.
    fn end(self) -> u32 {
        self.seal() + WORD
    }
}

/// The counts in a sector's header.
#[derive(Clone, Copy, Default)]
struct Header {
    generation: u32,
    wear: StoreWear,
    starts: u32,
}

impl Header {
    const fn words(&self) -> [u32; COUNTS as usize] {
        let StoreWear { saves, erases, cut } = self.wear;
        [self.generation, saves, erases, cut, self.starts]
    }

    fn crc(&self) -> u32 {
        crc32(self.words().into_iter().flat_map(u32::to_le_bytes))
    }
}

/// The log.
pub struct RecordStore<F> {
    flash: F,
    /// Beginning of the sector in use; none before the first write.
    sector: Option<u32>,
    /// Beginning of the sector that must not be erased next, although it has no header: an older
    /// version's.
    legacy: Option<u32>,
    counts: Header,
    /// Where the next record goes; none when it goes to the other sector.
    end: Option<u32>,
    image: Image,
    /// The newest faults, the oldest of them first, and how many.
    faults: [Option<Record>; FAULTS],
    /// The newest key.
    key: Option<Record>,
    cut: bool,
}

impl<F: Flash> RecordStore<F> {
    /// Reads what there is.
    pub fn open(flash: F) -> Self {
        let mut store = Self {
            flash,
            sector: None,
            legacy: None,
            counts: Header::default(),
            end: None,
            image: Image::Nothing,
            faults: [None; FAULTS],
            key: None,
            cut: false,
        };
        let headers = [0, F::SECTOR].map(|sector| (sector, store.header(sector)));
        let newest = headers
            .into_iter()
            .filter_map(|(sector, header)| Some((sector, header?)))
            .max_by_key(|(_, header)| header.generation);
        match newest {
            Some((sector, header)) => store.adopt(sector, header),
            None => store.adopt_legacy(),
        }
        store
    }

    /// Whether power was lost during the last write. It is said at every start until something has
    /// been written since.
    pub const fn was_cut(&self) -> bool {
        self.cut
    }

    /// What the store has been through.
    pub const fn wear(&self) -> StoreWear {
        self.counts.wear
    }

    /// Starts that have been noted.
    pub const fn starts(&self) -> u32 {
        self.counts.starts
    }

    /// The newest image, copied to the beginning of `out`; `None` when there has never been one.
    ///
    /// # Errors
    /// When it has decayed, or is longer than `out`.
    pub fn image<'b>(&self, out: &'b mut [u8]) -> Result<Option<&'b [u8]>, StoreError> {
        let (at, length) = match self.image {
            Image::Nothing => return Ok(None),
            Image::Unreadable => return Err(StoreError),
            Image::At(at, length) => (at, length),
        };
        let out = out.get_mut(..usize::from(length)).ok_or(StoreError)?;
        for (to, at) in out.iter_mut().zip(at..) {
            *to = byte(&self.flash, at);
        }
        Ok(Some(out))
    }

    /// The last faults that can be read, the oldest first.
    pub fn faults<const N: usize>(&self) -> impl Iterator<Item = [u8; N]> {
        let records = self.faults.iter().flatten();
        records.filter_map(|record| {
            if usize::from(record.length) != N || !self.is_good(record.content(), record.length) {
                return None;
            }
            let mut out = [0; N];
            for (to, at) in out.iter_mut().zip(record.content()..) {
                *to = byte(&self.flash, at);
            }
            Some(out)
        })
    }

    /// Stores an image in place of the last one.
    ///
    /// # Errors
    /// When the flash fails; the last image is still there, or the new one is.
    pub fn save(&mut self, image: &[u8]) -> Result<(), StoreError> {
        self.append(kind::IMAGE, image, 0)
    }

    /// The newest key; zeros for none. One that has decayed is another: a robot stays locked.
    pub fn key(&self) -> Key {
        self.key.map_or(NO_KEY, |record| {
            let mut at = record.content()..;
            NO_KEY.map(|_| at.next().map_or(0, |at| byte(&self.flash, at)))
        })
    }

    /// Stores a key in place of the last one.
    ///
    /// # Errors
    /// As [`RecordStore::save`].
    pub fn set_key(&mut self, key: &Key) -> Result<(), StoreError> {
        self.append(kind::KEY, key, 0)
    }

    /// Stores a fault behind the others.
    ///
    /// # Errors
    /// When the flash fails.
    pub fn add_fault(&mut self, fault: &[u8]) -> Result<(), StoreError> {
        self.append(kind::FAULT, fault, 0)
    }

    /// Counts a start.
    ///
    /// # Errors
    /// When the flash fails.
    pub fn add_start(&mut self) -> Result<(), StoreError> {
        self.append(kind::START, &[], RESERVE)
    }

    /// The header of a sector that has one.
    fn header(&self, sector: u32) -> Option<Header> {
        let word = |nth: u32| self.flash.word(sector + nth * WORD);
        let header = Header {
            generation: word(1),
            wear: StoreWear {
                saves: word(2),
                erases: word(3),
                cut: word(4),
            },
            starts: word(5),
        };
        (word(0) == MAGIC && word(COUNTS + 1) == header.crc()).then_some(header)
    }

    /// Takes over what a sector in use holds.
    fn adopt(&mut self, sector: u32, header: Header) {
        self.sector = Some(sector);
        self.counts = header;
        let last = sector + F::SECTOR;
        let mut at = sector + HEADER;
        while at < last {
            let word = self.flash.word(at);
            if word == BLANK {
                self.end = Some(at);
                break;
            }
            let record = Record::parse(at, word);
            // One that reaches beyond the sector was never written.
            let record = record.filter(|record| record.end() <= last);
            match record {
                Some(record) if self.flash.word(record.seal()) == 0 => {
                    self.record(record);
                    at = record.end();
                }
                torn => {
                    self.stop(torn, torn.map_or(at + WORD, Record::end), last);
                    break;
                }
            }
        }
        let other = F::SECTOR - sector;
        if self.flash.word(sector + RETIRED) == 0 {
            // The other sector had taken over, and has lost its header.
            self.image = Image::Unreadable;
            self.end = None;
        } else if self.header(other).is_none() && !self.is_blank(other, other + F::SECTOR) {
            // An erase or a copy that did not end.
            self.count_cut();
            self.counts.wear.erases = self.counts.wear.erases.saturating_add(1);
        }
        if let Image::At(at, length) = self.image
            && !self.is_good(at, length)
        {
            self.image = Image::Unreadable;
        }
    }

    /// The log ends in a record that is not whole. With something behind it, it was whole once.
    fn stop(&mut self, torn: Option<Record>, behind: u32, last: u32) {
        self.end = None;
        if !self.is_blank(behind, last) {
            self.image = Image::Unreadable;
        } else if torn.is_some_and(|record| record.kind == kind::IMAGE) {
            self.count_cut();
        }
    }

    fn count_cut(&mut self) {
        self.end = None;
        self.cut = true;
        self.counts.wear.cut = self.counts.wear.cut.saturating_add(1);
    }

    /// Takes over what an older version has left, or finds the flash empty.
    fn adopt_legacy(&mut self) {
        if let Some(found) = legacy::find(&self.flash) {
            self.legacy = Some(found.sector);
            self.counts.wear = found.wear;
            self.cut = found.was_cut;
            if let Some((at, length)) = found.image {
                self.image = Image::At(at, length);
            }
        } else if !self.is_blank(0, 2 * F::SECTOR) {
            // The very first write was cut off, which has written no header yet; or nothing that is
            // known.
            if self.flash.word(RETIRED - WORD) == BLANK && self.is_blank(F::SECTOR, 2 * F::SECTOR) {
                self.count_cut();
            } else {
                self.image = Image::Unreadable;
            }
        }
    }

    /// Counts a record that is whole.
    fn record(&mut self, record: Record) {
        match record.kind {
            kind::COPY if record.length == 0 => self.image = Image::Unreadable,
            kind::IMAGE | kind::COPY => self.image = Image::At(record.content(), record.length),
            kind::FAULT => {
                self.faults.rotate_left(1);
                if let Some(last) = self.faults.last_mut() {
                    *last = Some(record);
                }
            }
            kind::KEY if usize::from(record.length) == KEY_LENGTH => self.key = Some(record),
            _ => {}
        }
        let count = match record.kind {
            kind::IMAGE => &mut self.counts.wear.saves,
            kind::START => &mut self.counts.starts,
            _ => return,
        };
        *count = count.saturating_add(1);
    }

    /// Appends a record where `reserve` bytes are left behind it, or begins the other sector with
    /// it.
    #[inline(never)]
    fn append(&mut self, kind: u16, content: &[u8], reserve: u32) -> Result<(), StoreError> {
        let length = u16::try_from(content.len()).map_err(|_| StoreError)?;
        if length > 0xFFF {
            return Err(StoreError);
        }
        let record = |at| Record { at, kind, length };
        if let (Some(sector), Some(end)) = (self.sector, self.end)
            && record(end).end() + reserve <= sector + F::SECTOR
        {
            // Should it fail, what is there is not blank any more.
            self.end = None;
            if self.write(record(end), Content::Bytes(content)).is_ok() {
                self.record(record(end));
                self.end = Some(record(end).end());
                self.cut = false;
                return Ok(());
            }
        }
        self.change(record(0), content)
    }

    /// Begins the other sector with what counts and a new record.
    fn change(&mut self, new: Record, content: &[u8]) -> Result<(), StoreError> {
        let (old, is_old_ours) = match (self.sector, self.legacy) {
            (Some(sector), _) => (sector, true),
            (None, Some(sector)) => (sector, false),
            (None, None) => (F::SECTOR, false),
        };
        let target = F::SECTOR - old;
        self.end = None;
        let mut counts = self.counts;
        counts.generation = counts.generation.saturating_add(1);
        // A chip that is new, or was erased as a whole, needs no erase.
        if self.sector.is_some() || !self.is_blank(0, 2 * F::SECTOR) {
            counts.wear.erases = counts.wear.erases.saturating_add(1);
            self.flash.erase(target)?;
        }
        let mut next = target + HEADER;
        let mut faults = self.faults;
        if new.kind == kind::FAULT {
            // The oldest one makes room.
            if let Some(oldest) = faults.first_mut() {
                *oldest = None;
            }
        }
        for fault in faults.iter_mut() {
            let Some(from) = fault.filter(|record| self.is_good(record.content(), record.length))
            else {
                *fault = None;
                continue;
            };
            *fault = Some(self.copy(from, &mut next)?);
        }
        let key = self.key.filter(|_| new.kind != kind::KEY);
        let key = key.map(|from| self.copy(from, &mut next)).transpose()?;
        let mut image = self.image;
        if new.kind != kind::IMAGE && image != Image::Nothing {
            let (at, length) = match image {
                Image::At(at, length) => (at, length),
                Image::Nothing | Image::Unreadable => (0, 0),
            };
            let to = Record {
                at: next,
                kind: kind::COPY,
                length,
            };
            self.write(to, Content::Flash(at))?;
            next = to.end();
            if length != 0 {
                image = Image::At(to.content(), length);
            }
        }
        let new = Record { at: next, ..new };
        if new.end() > target + F::SECTOR {
            return Err(StoreError);
        }
        self.write(new, Content::Bytes(content))?;
        self.write_header(target, &counts)?;
        // From here on the new sector counts.
        self.sector = Some(target);
        self.legacy = None;
        self.counts = counts;
        self.faults = faults;
        self.key = key;
        self.image = image;
        self.cut = false;
        self.record(new);
        self.end = Some(new.end());
        // What is left to do is not needed for what has been stored.
        let _ = if is_old_ours {
            self.flash.program(old + RETIRED, 0)
        } else if self.is_blank(old, old + F::SECTOR) {
            Ok(())
        } else {
            self.flash.erase(old)
        };
        Ok(())
    }

    /// Copies a record to where the next one goes.
    fn copy(&mut self, from: Record, next: &mut u32) -> Result<Record, StoreError> {
        let to = Record { at: *next, ..from };
        self.write(to, Content::Flash(from.content()))?;
        *next = to.end();
        Ok(to)
    }

    fn write_header(&mut self, sector: u32, header: &Header) -> Result<(), StoreError> {
        self.program(sector, MAGIC)?;
        for (word, at) in header.words().into_iter().zip(1..) {
            self.program(sector + at * WORD, word)?;
        }
        self.program(sector + (COUNTS + 1) * WORD, header.crc())
    }

    fn write(&mut self, record: Record, content: Content<'_>) -> Result<(), StoreError> {
        let tag = u32::from(record.kind << 12 | record.length);
        self.program(record.at, tag | !tag << 16)?;
        let crc = crc32((0..record.length).map(|nth| self.content(content, nth)));
        for offset in (0..record.length).step_by(WORD as usize) {
            let mut word = [0; WORD as usize];
            for (to, nth) in word.iter_mut().zip(offset..record.length) {
                *to = self.content(content, nth);
            }
            let at = record.content() + u32::from(offset);
            self.program(at, u32::from_le_bytes(word))?;
        }
        self.program(record.crc(), crc)?;
        self.program(record.seal(), 0)
    }

    fn content(&self, content: Content<'_>, nth: u16) -> u8 {
        match content {
            Content::Bytes(bytes) => bytes.get(usize::from(nth)).copied().unwrap_or(0),
            Content::Flash(from) => byte(&self.flash, from + u32::from(nth)),
        }
    }

    /// Programs a word and looks whether it is there.
    fn program(&mut self, at: u32, word: u32) -> Result<(), StoreError> {
        self.flash.program(at, word)?;
        if self.flash.word(at) == word {
            Ok(())
        } else {
            Err(StoreError)
        }
    }

    /// Whether the CRC behind some content is right.
    fn is_good(&self, at: u32, length: u16) -> bool {
        let crc = crc32((0..length).map(|nth| self.content(Content::Flash(at), nth)));
        self.flash
            .word(at + u32::from(length).next_multiple_of(WORD))
            == crc
    }

    fn is_blank(&self, from: u32, to: u32) -> bool {
        let mut words = (from..to).step_by(WORD as usize);
        words.all(|at| self.flash.word(at) == BLANK)
    }
}

fn byte(flash: &impl Flash, at: u32) -> u8 {
    let [a, b, c, d] = flash.word(at & !3).to_le_bytes();
    match at & 3 {
        0 => a,
        1 => b,
        2 => c,
        _ => d,
    }
}
