//! The RAM of one board: words that the fast path reads and writes without a search or a lock.
//!
//! The reference core reaches the same words through the address map. Addresses here are offsets
//! into the RAM. Accesses of every width and alignment are allowed; an aligned one is a single
//! load, or for a narrow store a load and a store. A board is run by one thread at a time, so no
//! other access can occur between these two.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use rsemu::core::BusError;
use rsemu::core::space::{AccessConstraints, MemAttrs, MemOps, MemResult};
use rsemu::core::value::Width;

use crate::chip::Chip;

/// Words of the largest RAM of all chips: SRAM1 of 112 KiB and SRAM2 of 16 KiB behind it (RM0390
/// section 2.2.3). A power of two, so that an index needs no check.
const WORDS: usize = 128 * 1024 / 4;

/// See the [module](self).
pub(crate) struct Ram {
    words: Box<[AtomicU32; WORDS]>,
    size: u32,
}

impl Clone for Ram {
    fn clone(&self) -> Self {
        let words = Box::new([const { AtomicU32::new(0) }; WORDS]);
        for (to, from) in words.iter().zip(self.words.iter()) {
            to.store(from.load(Relaxed), Relaxed);
        }
        Self {
            words,
            size: self.size,
        }
    }
}

impl std::fmt::Debug for Ram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Ram({} bytes)", self.size)
    }
}

impl Ram {
    /// RAM of a chip that holds zeros.
    pub(crate) fn new(chip: &Chip) -> Self {
        Self {
            size: chip.ram,
            words: Box::new([const { AtomicU32::new(0) }; WORDS]),
        }
    }

    /// Bytes.
    #[inline(always)]
    pub(crate) fn size(&self) -> u32 {
        self.size
    }

    #[inline(always)]
    fn at(&self, offset: u32) -> &AtomicU32 {
        &self.words[offset as usize / 4 % WORDS]
    }

    /// The word at an aligned offset in the RAM.
    #[inline(always)]
    pub(crate) fn word(&self, offset: u32) -> u32 {
        self.at(offset).load(Relaxed)
    }

    /// Writes the word at an aligned offset in the RAM.
    #[inline(always)]
    pub(crate) fn set_word(&self, offset: u32, word: u32) {
        self.at(offset).store(word, Relaxed);
    }

    /// Reads `width` bytes at an aligned offset, extended with zeros; `None` when unaligned or
    /// outside.
    #[inline(always)]
    pub(crate) fn read_aligned(&self, offset: u32, width: Width) -> Option<u32> {
        let bytes = bytes(width);
        if offset >= self.size || offset & (bytes - 1) != 0 {
            return None;
        }
        let word = self.at(offset).load(Relaxed);
        Some(word >> (8 * (offset & 3)) & ones(bytes))
    }

    /// Writes the low `width` bytes of a value at an aligned offset; `None` when unaligned or
    /// outside.
    #[inline(always)]
    pub(crate) fn write_aligned(&self, offset: u32, width: Width, value: u32) -> Option<()> {
        let bytes = bytes(width);
        if offset >= self.size || offset & (bytes - 1) != 0 {
            return None;
        }
        let cell = self.at(offset);
        let (shift, mask) = (8 * (offset & 3), ones(bytes));
        let unchanged = cell.load(Relaxed) & !(mask << shift);
        cell.store(unchanged | (value & mask) << shift, Relaxed);
        Some(())
    }

    /// Reads `width` bytes at any offset.
    #[inline]
    pub(crate) fn read(&self, offset: u32, width: Width) -> Option<u32> {
        self.read_aligned(offset, width).or_else(|| {
            let mut bytes = [0; 4];
            let read = bytes.get_mut(..width.bytes() as usize)?;
            self.read_at(u64::from(offset), read).ok()?;
            Some(u32::from_le_bytes(bytes))
        })
    }

    /// Writes the low `width` bytes of a value at any offset.
    #[inline]
    pub(crate) fn write(&self, offset: u32, width: Width, value: u32) -> Option<()> {
        self.write_aligned(offset, width, value).or_else(|| {
            let bytes = value.to_le_bytes();
            let written = bytes.get(..width.bytes() as usize)?;
            self.write_at(u64::from(offset), written).ok()
        })
    }

    /// Whether a span lies in the RAM, and if so where it begins.
    fn span(&self, offset: u64, length: usize) -> MemResult<u32> {
        match offset.checked_add(length as u64) {
            Some(end) if end <= u64::from(self.size) => Ok(offset as u32),
            _ => Err(BusError::BadAccess),
        }
    }

    /// Reads bytes.
    pub(crate) fn read_at(&self, offset: u64, to: &mut [u8]) -> MemResult {
        let begin = self.span(offset, to.len())?;
        if let (Ok(word), 0) = (<&mut [u8; 4]>::try_from(&mut *to), begin & 3) {
            *word = self.word(begin).to_le_bytes();
            return Ok(());
        }
        for (at, byte) in (begin..).zip(to) {
            *byte = (self.at(at).load(Relaxed) >> (8 * (at & 3))) as u8;
        }
        Ok(())
    }

    /// Writes bytes.
    pub(crate) fn write_at(&self, offset: u64, from: &[u8]) -> MemResult {
        let begin = self.span(offset, from.len())?;
        if let (Ok(word), 0) = (<[u8; 4]>::try_from(from), begin & 3) {
            self.set_word(begin, u32::from_le_bytes(word));
            return Ok(());
        }
        for (at, byte) in (begin..).zip(from) {
            let (cell, shift) = (self.at(at), 8 * (at & 3));
            let word = cell.load(Relaxed) & !(0xFF << shift) | u32::from(*byte) << shift;
            cell.store(word, Relaxed);
        }
        Ok(())
    }
}

/// How the reference core reaches it.
impl MemOps for Ram {
    fn read(&self, offset: u64, to: &mut [u8], _: MemAttrs) -> MemResult {
        self.read_at(offset, to)
    }

    fn write(&self, offset: u64, from: &[u8], _: MemAttrs) -> MemResult {
        self.write_at(offset, from)
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}

/// Bytes of an access. Neither this nor the next one has a branch for each width: accesses of all
/// widths pass here in one loop.
#[inline(always)]
fn bytes(width: Width) -> u32 {
    1 << (width as u32 & 3)
}

/// Ones in the lowest bytes of a word, in all of it from 4 on.
#[inline(always)]
fn ones(bytes: u32) -> u32 {
    u32::MAX >> (32_u32.wrapping_sub(8 * bytes) & 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::F103;

    /// Every width at every offset of two words, beside bytes in a row.
    #[test]
    fn any_width_at_any_offset_is_its_bytes_with_the_lowest_first() {
        for width in [Width::U8, Width::U16, Width::U32] {
            let length = width.bytes() as usize;
            for offset in 0..5_u32 {
                let ram = Ram::new(&F103);
                let mut expected = *b"abcdefghij";
                ram.write_at(0, &expected).unwrap();
                let at = offset as usize;
                let mut word = [0; 4];
                word[..length].copy_from_slice(&expected[at..at + length]);
                assert_eq!(ram.read(offset, width), Some(u32::from_le_bytes(word)));
                ram.write(offset, width, 0xF3F2_F1F0).unwrap();
                expected[at..at + length].copy_from_slice(&[0xF0, 0xF1, 0xF2, 0xF3][..length]);
                let mut after = [0; 10];
                ram.read_at(0, &mut after).unwrap();
                assert_eq!(after, expected, "{length} bytes at {offset}");
            }
        }
    }

    #[test]
    fn nothing_is_beyond_the_end() {
        let (ram, end) = (Ram::new(&F103), 48 << 10);
        assert_eq!(ram.read(end - 4, Width::U32), Some(0));
        for at in [end - 3, end, u32::MAX] {
            assert_eq!(ram.read(at, Width::U32), None);
            assert_eq!(ram.write(at, Width::U32, 1), None);
        }
        assert_eq!(ram.read(end - 4, Width::U32), Some(0), "left as it was");
    }
}
