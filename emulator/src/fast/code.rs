//! The decoded code: each instruction of the flash, decoded and as a micro-operation, as of the
//! first execution of code near it.
//!
//! Pages with the same content are decoded once for all boards with an image, so that several
//! boards share the host's caches.

use std::sync::{Arc, Mutex, PoisonError};

use rsemu::core::space::RamStore;
use rsemu::cpu::arm::v7m::isa::{ExtendOp, Insn, decode, is_32bit};

use super::Leave;
use super::micro::Op;
use super::translate::{PAGE, Place, translate};
use crate::chip::{Chip, LARGEST_FLASH};
use crate::memory_map::FLASH_BASE;

/// A decoded instruction with its length in bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    pub(super) insn: Insn,
    pub(super) length: u32,
}

/// Halfwords of a page, a power of two so that an index needs no check.
const HALVES: usize = PAGE / 2;
/// Pages of the largest flash.
const PAGES: usize = LARGEST_FLASH as usize / PAGE;
/// Contents of one page that are remembered: that of the image, and of updates.
const CONTENTS: usize = 4;

/// A page of code, by halfwords. The tables lie apart from each other, so that what is executed
/// takes few lines of the host's caches, and in one piece, so that one address leads to all.
pub(super) struct Page {
    ops: [Op; HALVES],
    lengths: [u8; HALVES],
    /// What the instructions are in an IT block.
    in_it: [Op; HALVES],
    /// None where the flash ends in the middle of an instruction, and for one that the core lacks.
    entries: [Option<Entry>; HALVES],
    /// What was decoded: the page's content and, because an instruction may reach into the next
    /// page, the halfword behind it.
    bytes: Vec<u8>,
}

impl Page {
    /// The operation at a place in the page, counted in halfwords, and how many of these its
    /// instruction has.
    #[inline(always)]
    pub(super) fn op(&self, at: u32) -> Option<(&Op, u32)> {
        let at = at as usize;
        Some((self.ops.get(at)?, (*self.lengths.get(at)?).into()))
    }

    #[inline(always)]
    pub(super) fn in_it(&self, at: u32) -> &Op {
        &self.in_it[at as usize % HALVES]
    }

    #[inline(always)]
    pub(super) fn entry(&self, at: u32) -> Result<&Entry, Leave> {
        self.entries[at as usize % HALVES].as_ref().ok_or(Leave)
    }
}

/// An image, with what has been decoded of the flash of the boards that run it.
pub(crate) struct Programmed {
    chip: &'static Chip,
    content: Vec<u8>,
    pages: [Mutex<Vec<Arc<Page>>>; PAGES],
}

impl Programmed {
    /// The content of the whole flash.
    pub(crate) fn new(chip: &'static Chip, content: Vec<u8>) -> Self {
        Self {
            chip,
            content,
            pages: [const { Mutex::new(Vec::new()) }; PAGES],
        }
    }

    pub(crate) fn chip(&self) -> &'static Chip {
        self.chip
    }

    pub(crate) fn content(&self) -> &[u8] {
        &self.content
    }
}

/// The code of one board.
#[derive(Clone)]
pub(super) struct Code {
    image: Arc<Programmed>,
    /// What has been executed since its content changed.
    pages: Box<[Option<Arc<Page>>; PAGES]>,
    version: u64,
}

impl std::fmt::Debug for Code {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Code(version {})", self.version)
    }
}

impl Code {
    pub(super) fn new(image: Arc<Programmed>) -> Self {
        Self {
            image,
            pages: boxed(|_| None),
            version: 0,
        }
    }

    /// Takes note of the version of the flash's content: pages that have changed are looked up
    /// again before they are executed.
    #[inline]
    pub(super) fn set_version(&mut self, version: u64, flash: &RamStore) {
        if version != self.version {
            self.version = version;
            self.forget(flash);
        }
    }

    #[cold]
    fn forget(&mut self, flash: &RamStore) {
        let size = flash.page_size();
        flash.for_each_dirty_page(|changed| {
            // With the page before, whose last instruction may reach into this one.
            let first = (changed * size).saturating_sub(2) as usize / PAGE;
            let last = ((changed + 1) * size - 1) as usize / PAGE;
            let pages = self.pages.iter_mut().take(last + 1).skip(first);
            pages.for_each(|page| *page = None);
        });
        flash.clear_dirty();
    }

    /// The page that an address is in.
    #[inline]
    pub(super) fn page(&mut self, pc: u32, flash: &RamStore) -> Result<&Page, Leave> {
        let number = pc.wrapping_sub(FLASH_BASE) as usize / PAGE;
        let page = self.pages.get_mut(number).ok_or(Leave)?;
        if page.is_none() {
            *page = Some(decoded(&self.image, number, flash)?);
        }
        page.as_deref().ok_or(Leave)
    }

    /// The instruction at an address.
    pub(super) fn at(&mut self, pc: u32, flash: &RamStore) -> Result<&Entry, Leave> {
        self.page(pc, flash)?.entry(pc / 2)
    }
}

/// A page of the flash, decoded now unless a board with this image has had the same.
#[cold]
fn decoded(image: &Programmed, number: usize, flash: &RamStore) -> Result<Arc<Page>, Leave> {
    let begin = number * PAGE;
    let left = (flash.len() as usize).checked_sub(begin);
    let left = left.filter(|left| *left > 0).ok_or(Leave)?;
    let mut bytes = vec![0; (PAGE + 2).min(left)];
    flash.read_at(begin as u64, &mut bytes).map_err(|_| Leave)?;
    let mut known = image.pages[number]
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    if let Some(page) = known.iter().find(|page| page.bytes == bytes) {
        return Ok(Arc::clone(page));
    }
    let address = FLASH_BASE + begin as u32;
    let page = Arc::new(decode_page(image.chip, address, bytes));
    if known.len() == CONTENTS {
        known.remove(0);
    }
    known.push(Arc::clone(&page));
    Ok(page)
}

fn decode_page(chip: &Chip, address: u32, bytes: Vec<u8>) -> Page {
    let half = |at: usize| Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    let entry = |index: usize| {
        let first = half(2 * index)?;
        let (second, length) = if is_32bit(first) {
            (half(2 * index + 2)?, 4)
        } else {
            (0, 2)
        };
        let insn = decode(first, second);
        if !chip.core.ext.dsp && is_dsp(&insn) {
            return None;
        }
        Some(Entry { insn, length })
    };
    let entries: [Option<Entry>; HALVES] = std::array::from_fn(entry);
    let op = |index: usize, in_it| match entries[index] {
        // After an instruction that is not a micro-operation the page is looked up again.
        Some(Entry { insn, length }) if 2 * index + (length as usize) < PAGE => {
            let place = Place {
                address: address + 2 * index as u32,
                length,
                in_it,
                page: &bytes,
            };
            translate(&insn, place)
        }
        _ => Op::Other,
    };
    let length = |index: usize| entries[index].map_or(1, |entry| entry.length as u8 / 2);
    Page {
        ops: std::array::from_fn(|index| op(index, false)),
        lengths: std::array::from_fn(length),
        in_it: std::array::from_fn(|index| op(index, true)),
        entries,
        bytes,
    }
}

/// Whether an instruction that the fast path executes belongs to the DSP extension, which a
/// Cortex-M3 lacks (ARMv7-M ARM, A1.2 and table A4-10).
fn is_dsp(insn: &Insn) -> bool {
    match insn {
        Insn::SatQ { .. } | Insn::Pkh { .. } | Insn::Simd { .. } | Insn::DualMul { .. } => true,
        Insn::MulLong { umaal, .. } => *umaal,
        // Those that also add, or that take two bytes.
        Insn::Extend { op, rn, .. } => {
            matches!(op, ExtendOp::Sxtb16 | ExtendOp::Uxtb16) || *rn != 15
        }
        _ => false,
    }
}

fn boxed<T, const N: usize>(make: impl FnMut(usize) -> T) -> Box<[T; N]> {
    let all: Box<[T]> = (0..N).map(make).collect();
    match all.try_into() {
        Ok(all) => all,
        Err(_) => unreachable!("as many as were made"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::F446;

    /// MOV.W R0, #imm8 (ARMv7-M ARM, A7.7.76), which is its second halfword here.
    const MOV_W: u16 = 0xF04F;

    /// An instruction that lies across two pages is decoded again when its second half changes, and
    /// the page is the old one when the old content is back.
    #[test]
    fn a_change_reaches_the_instruction_before_its_page() {
        const LAST: usize = PAGE - 2;
        let flash = RamStore::new(F446.flash_size());
        let put = |offset: usize, half: u16| {
            flash.write_at(offset as u64, &half.to_le_bytes()).unwrap();
        };
        put(LAST, MOV_W);
        put(PAGE, 1);
        let mut code = Code::new(Arc::new(Programmed::new(&F446, Vec::new())));
        let pc = FLASH_BASE + LAST as u32;
        let decoded = |code: &mut Code| format!("{:?}", code.at(pc, &flash).unwrap().insn);
        let first = decoded(&mut code);
        put(PAGE, 2);
        code.set_version(1, &flash);
        assert_ne!(decoded(&mut code), first);
        // Another page, far away: nothing of this one is looked up again.
        let page = Arc::clone(code.pages[0].as_ref().unwrap());
        put(8 * PAGE, 3);
        code.set_version(2, &flash);
        assert!(Arc::ptr_eq(code.pages[0].as_ref().unwrap(), &page));
        put(PAGE, 1);
        code.set_version(3, &flash);
        assert_eq!(decoded(&mut code), first);
        assert_eq!(code.image.pages[0].lock().unwrap().len(), 2);
    }
}
