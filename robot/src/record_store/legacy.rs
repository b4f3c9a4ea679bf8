//! The store of earlier versions: a map by `sequential-storage` 8, with the image under one key and
//! the counters of the store under another. It is only read; the first write begins a log in the
//! sector that the map does not use.
//!
//! A sector in use begins with a word that is 0 and ends with another one once it is full. In
//! between lie items: CRC-32C of the content, its length and the CRC-16 of the length, then the
//! content in whole words: a key and a value. The newest item of a key counts; it is in the sector
//! that is not full yet, if it is in both. An item whose CRC fails was cut off by a power loss.
//! Where no length can be read, the next word is tried, as the map did.

use super::{BLANK, Flash, WORD, byte};
use crate::counters::StoreWear;

/// Key of the image.
const IMAGE: u8 = 1;
/// Key of the record: whether a save is under way, then saves, erases and cut saves.
const RECORD: u8 = 2;
const RECORD_LENGTH: u16 = 1 + 13;
const ITEM_HEADER: u32 = 8;

/// What is left of the old store.
#[derive(Clone, Copy)]
pub struct Found {
    /// The sector that holds the image.
    pub sector: u32,
    /// Offset and length of the image.
    pub image: Option<(u32, u16)>,
    pub wear: StoreWear,
    /// The last save was cut off.
    pub was_cut: bool,
}

/// Looks for it.
pub fn find<F: Flash>(flash: &F) -> Option<Found> {
    let is_marked = |at| byte(flash, at).count_zeros() >= 4;
    let mut sectors = [0, F::SECTOR];
    let is_full = |sector| is_marked(sector + F::SECTOR - 1);
    if is_full(F::SECTOR) && !is_full(0) {
        sectors = [F::SECTOR, 0];
    }
    // The one that is not full comes last, so that what it holds replaces what the other does.
    let mut found: Option<Found> = None;
    for sector in sectors {
        if is_marked(sector) {
            let found = found.get_or_insert(Found {
                sector,
                image: None,
                wear: StoreWear::default(),
                was_cut: false,
            });
            scan(flash, sector, found);
        }
    }
    let mut found = found?;
    let other = F::SECTOR - found.sector;
    let is_blank = |at| flash.word(at) == BLANK;
    let is_log_begun = !is_marked(other)
        && !(other..other + F::SECTOR)
            .step_by(WORD as usize)
            .all(is_blank);
    // An erase, or the first log, that was cut off.
    found.was_cut |= is_log_begun;
    Some(found)
}

/// Takes up the items of one sector.
fn scan<F: Flash>(flash: &F, sector: u32, found: &mut Found) {
    let mut at = sector + WORD;
    let end = sector + F::SECTOR - WORD;
    while at + ITEM_HEADER <= end {
        let (crc, length) = (flash.word(at), flash.word(at + WORD));
        if (crc, length) == (BLANK, BLANK) {
            return;
        }
        let [a, b, c, d] = length.to_le_bytes();
        let length = u16::from_le_bytes([a, b]);
        let content = at + ITEM_HEADER;
        let next = content + u32::from(length).next_multiple_of(WORD);
        if crc16([a, b]) != u16::from_le_bytes([c, d]) || next > end {
            at += WORD;
            continue;
        }
        at = next;
        let bytes = (content..).take(usize::from(length));
        if crc32c(bytes.map(|at| byte(flash, at))) != crc {
            continue;
        }
        match (byte(flash, content), length) {
            (IMAGE, 2..) => {
                found.sector = sector;
                found.image = Some((content + 1, length - 1));
            }
            (RECORD, RECORD_LENGTH) => {
                let count =
                    |nth| u32::from_le_bytes([0, 1, 2, 3].map(|n| byte(flash, content + nth + n)));
                found.was_cut = byte(flash, content + 1) != 0;
                let cut = u32::from(found.was_cut);
                // Whether it had come to an erase is not known: it counts as one.
                found.wear = StoreWear {
                    saves: count(2),
                    erases: count(6).saturating_add(cut),
                    cut: count(10).saturating_add(cut),
                };
            }
            _ => {}
        }
    }
}

/// CRC-16F/4.2, as `sequential-storage` has it.
fn crc16(bytes: [u8; 2]) -> u16 {
    let crc = bytes.into_iter().fold(0xFFFF_u16, |crc, byte| {
        (0..8).fold(crc ^ u16::from(byte), |crc, _| {
            crc >> 1 ^ if crc & 1 == 1 { 0x1A2E } else { 0 }
        })
    });
    // All ones would look blank.
    if crc == 0 { 0xFFFE } else { !crc }
}

/// CRC-32C with the start value and the exceptions of `sequential-storage`.
fn crc32c(bytes: impl Iterator<Item = u8>) -> u32 {
    let crc = !bytes.fold(0xEEEE_EEEE_u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            crc >> 1 ^ if crc & 1 == 1 { 0x82F6_3B78 } else { 0 }
        })
    });
    match crc & 0xFF {
        0 | 0xFF if crc != 0 => crc ^ 1,
        0 => 1,
        _ => crc,
    }
}
