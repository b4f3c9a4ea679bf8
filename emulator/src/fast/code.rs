//! The decoded code: each instruction of the flash as it was when code near it was first executed.
//!
//! Pages whose content is the image's are decoded once for all boards that run it: several boards then share what the
//! host's caches hold.

use std::sync::{Arc, OnceLock};

use rsemu::core::space::RamStore;
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
const PAGE: usize = 4096;
/// Pages of the flash.
const PAGES: usize = flash::SIZE as usize / PAGE;

/// One entry per halfword; none where the flash ends in the middle of an instruction.
type Page = [Option<Entry>; PAGE / 2];

/// An image with what has been decoded of it.
pub(crate) struct Programmed {
    content: Vec<u8>,
    pages: [OnceLock<Arc<Page>>; PAGES],
}

impl Programmed {
    /// The content of the whole flash.
    pub(crate) fn new(content: Vec<u8>) -> Self {
        Self {
            content,
            pages: [const { OnceLock::new() }; PAGES],
        }
    }

    pub(crate) fn content(&self) -> &[u8] {
        &self.content
    }
}

/// The code of one board.
pub(super) struct Code {
    image: Arc<Programmed>,
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
            pages: Box::new([const { None }; PAGES]),
            version: 0,
        }
    }

    /// Forgets everything when the content of the flash is another.
    pub(super) fn check(&mut self, version: u64) {
        if version != self.version {
            self.version = version;
            self.pages.fill(None);
        }
    }

    /// The instruction at an address.
    #[inline]
    pub(super) fn at(&mut self, pc: u32, flash: &RamStore) -> Result<&Entry, Leave> {
        let offset = pc.wrapping_sub(FLASH_BASE) as usize;
        let page = self.pages.get_mut(offset / PAGE).ok_or(Leave)?;
        let page = match page {
            Some(page) => page,
            None => page.insert(decoded(&self.image, offset / PAGE, flash)?),
        };
        page[offset % PAGE / 2].as_ref().ok_or(Leave)
    }
}

/// A page of the flash, and the image's own if it is that.
#[cold]
fn decoded(image: &Programmed, number: usize, flash: &RamStore) -> Result<Arc<Page>, Leave> {
    // An instruction may reach into the next page.
    let begin = number * PAGE;
    let mut bytes = vec![0; (PAGE + 2).min(flash::SIZE as usize - begin)];
    flash.read_at(begin as u64, &mut bytes).map_err(|_| Leave)?;
    if image.content.get(begin..begin + bytes.len()) == Some(&bytes[..]) {
        let page = image.pages[number].get_or_init(|| Arc::new(decode_page(&bytes)));
        return Ok(Arc::clone(page));
    }
    Ok(Arc::new(decode_page(&bytes)))
}

fn decode_page(bytes: &[u8]) -> Page {
    let half = |at: usize| Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
    std::array::from_fn(|index| {
        let first = half(2 * index)?;
        let (second, length) = if is_32bit(first) {
            (half(2 * index + 2)?, 4)
        } else {
            (0, 2)
        };
        let insn = decode(first, second);
        Some(Entry { insn, length })
    })
}
