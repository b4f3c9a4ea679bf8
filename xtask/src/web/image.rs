//! The release image without its debug information, which is most of the file.
//!
//! What is flashed, the symbols and the strings of the log stay as they are, and where they are:
//! the debug sections become empty and their bytes zero, which compresses to nothing.

use anyhow::Context as _;
use object::read::elf::{ElfFile32, FileHeader as _};
use object::{LittleEndian, Object as _, ObjectSection as _};

/// Offset of a section's size in its header, and the size of a header (ELF-32).
const SIZE_AT: usize = 20;
const HEADER: usize = 40;

/// Empties the debug sections of an ELF file.
pub fn without_debug(mut elf: Vec<u8>) -> anyhow::Result<Vec<u8>> {
    let file = ElfFile32::<LittleEndian>::parse(&*elf).context("not a 32-bit ELF file")?;
    let headers = file.elf_header().e_shoff(LittleEndian) as usize;
    let debug = file.sections().filter(|section| {
        let name = section.name().unwrap_or_default();
        name.starts_with(".debug_")
    });
    let places: Vec<_> = debug
        .filter_map(|section| Some((section.index().0, section.file_range()?)))
        .collect();
    for (index, (start, length)) in places {
        let size = headers + index * HEADER + SIZE_AT;
        for (from, count) in [(start as usize, length as usize), (size, 4)] {
            elf.get_mut(from..from + count)
                .context("a section outside the file")?
                .fill(0);
        }
    }
    Ok(elf)
}
