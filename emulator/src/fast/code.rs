//! The decoded code: each instruction of the flash as it was when it was first executed.

use rsemu::core::space::RamStore;
use rsemu::core::value::{Endian, Width};
use rsemu::cpu::arm::v7m::isa::{Insn, decode, is_32bit};

use super::Leave;
use crate::firmware::FLASH_BASE;
use crate::system::flash;

/// A decoded instruction with its length in bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    pub(super) insn: Insn,
    pub(super) length: u32,
}

/// Bytes of code per page.
const PAGE: u32 = 4096;
/// Pages of the flash.
const PAGES: usize = (flash::SIZE as u32 / PAGE) as usize;

/// One entry per halfword.
type Page = [Option<Entry>; PAGE as usize / 2];

/// Pages of one entry per halfword, made when code in them is first executed.
#[derive(Debug)]
pub(super) struct Code {
    pages: Box<[Option<Box<Page>>; PAGES]>,
    version: u64,
}

impl Code {
    pub(super) fn new() -> Self {
        Self {
            pages: Box::new([const { None }; PAGES]),
            version: 0,
        }
    }

    /// Forgets everything when the content of the flash is another.
    pub(super) fn check(&mut self, version: u64) {
        if version != self.version {
            self.version = version;
            self.pages.fill_with(|| None);
        }
    }

    /// The instruction at an address.
    #[inline]
    pub(super) fn at(&mut self, pc: u32, flash: &RamStore) -> Result<&Entry, Leave> {
        let offset = pc.wrapping_sub(FLASH_BASE);
        let page = self.pages.get_mut((offset / PAGE) as usize).ok_or(Leave)?;
        let slot = &mut page.get_or_insert_with(blank)[(offset % PAGE / 2) as usize];
        match slot {
            Some(entry) => Ok(entry),
            None => Ok(slot.insert(load(offset, flash)?)),
        }
    }
}

#[cold]
fn blank() -> Box<Page> {
    Box::new([const { None }; PAGE as usize / 2])
}

#[cold]
fn load(offset: u32, flash: &RamStore) -> Result<Entry, Leave> {
    let half = |offset: u32| {
        let half = flash.read_value(u64::from(offset), Width::U16, Endian::Little);
        half.map(|half| half as u16).map_err(|_| Leave)
    };
    let first = half(offset)?;
    let (second, length) = if is_32bit(first) {
        (half(offset + 2)?, 4)
    } else {
        (0, 2)
    };
    let insn = decode(first, second);
    Ok(Entry { insn, length })
}
