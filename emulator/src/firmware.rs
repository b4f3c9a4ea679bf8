//! The image: what is flashed, its symbols, its table of log strings, its debug information.
//!
//! Segments are placed by their physical address, as a programmer does it, so that initial values
//! of variables are in flash for the start-up code to copy. Debug information is searched only when
//! the source line of an address is needed, which is when something has gone wrong.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use addr2line::gimli;
use defmt_decoder::{Locations, Table};
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::chip::{Chip, F446};
use crate::fast::Programmed;
use crate::memory_map::FLASH_BASE;

/// Why an image cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("cannot be read ({0})")]
    Io(std::io::Error),
    /// Not an ELF file for a 32-bit little-endian Arm.
    #[error("not an ELF file for a 32-bit little-endian Arm: {0}")]
    NotArmElf(String),
    /// Bytes outside the flash.
    #[error(
        "{length} bytes at {address:#010x} are outside the flash of an {} ({} KiB at 0x08000000)",
        chip.name,
        chip.flash_size() / 1024
    )]
    OutsideFlash {
        /// The chip that the image is for.
        chip: &'static Chip,
        /// Where they should go.
        address: u32,
        /// How many.
        length: u32,
    },
    /// The image is for a chip that is not emulated.
    #[error("the image is for a chip with the device number {0:#x}, which is not emulated")]
    UnknownChip(u32),
    /// Nothing at the start of flash: the linker script was missing.
    #[error("no vector table at 0x08000000: was the linker script used?")]
    NoVectorTable,
    /// The log table was written by another version of defmt.
    #[error("defmt table: {0}")]
    Defmt(String),
}

/// A function or variable of the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Symbol {
    /// Name, demangled.
    pub name: String,
    /// First address; without the Thumb bit.
    pub address: u32,
    /// Bytes.
    pub size: u32,
}

struct Image {
    chip: &'static Chip,
    elf: Vec<u8>,
    code: Arc<Programmed>,
    functions: Vec<Symbol>,
    variables: HashMap<String, Symbol>,
    table: Option<Table>,
    /// Where the log's statements are: they are looked for in the whole of the debug information,
    /// and most runs never read the log.
    locations: OnceLock<Locations>,
}

/// A firmware image, shared by all boards that run it.
#[derive(Clone)]
pub struct Firmware {
    image: Arc<Image>,
}

impl std::fmt::Debug for Firmware {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Firmware({} functions)", self.image.functions.len())
    }
}

impl Firmware {
    /// Loads an ELF file.
    ///
    /// # Errors
    /// [`LoadError`] states what is wrong with the file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, LoadError> {
        Self::from_elf(std::fs::read(path).map_err(LoadError::Io)?)
    }

    /// Loads the content of an ELF file.
    ///
    /// # Errors
    /// [`LoadError`] states what is wrong with it.
    pub fn from_elf(elf: Vec<u8>) -> Result<Self, LoadError> {
        let not_elf = |error: object::Error| LoadError::NotArmElf(error.to_string());
        let file = ElfFile32::<object::LittleEndian>::parse(&*elf).map_err(not_elf)?;
        if file.architecture() != object::Architecture::Arm {
            return Err(LoadError::NotArmElf(format!("{:?}", file.architecture())));
        }
        let chip = match chip_id(&file) {
            Some(device) => Chip::with_device(device).ok_or(LoadError::UnknownChip(device))?,
            None => &F446,
        };
        let mut flash = vec![0xFF; chip.flash_size() as usize];
        let mut vectors = false;
        for (address, data) in programmed(&elf)? {
            let start = address.wrapping_sub(FLASH_BASE) as usize;
            let Some(place) = start
                .checked_add(data.len())
                .and_then(|end| flash.get_mut(start..end))
            else {
                return Err(LoadError::OutsideFlash {
                    chip,
                    address,
                    length: data.len() as u32,
                });
            };
            place.copy_from_slice(&data);
            vectors |= start == 0;
        }
        if !vectors {
            return Err(LoadError::NoVectorTable);
        }

        let mut functions = Vec::new();
        let mut variables = HashMap::new();
        for symbol in file.symbols() {
            let Ok(raw) = symbol.name() else { continue };
            let address = symbol.address() as u32;
            let entry = Symbol {
                name: demangle(raw),
                address: address & !1,
                size: symbol.size() as u32,
            };
            match symbol.kind() {
                SymbolKind::Text if entry.size > 0 => functions.push(entry),
                SymbolKind::Data | SymbolKind::Tls | SymbolKind::Unknown => {
                    variables.insert(raw.to_owned(), Symbol { address, ..entry });
                }
                _ => {}
            }
        }
        functions.sort_by_key(|symbol| (symbol.address, symbol.size));
        functions.dedup_by_key(|symbol| symbol.address);

        let bad_table = |error: &dyn std::fmt::Display| LoadError::Defmt(error.to_string());
        let table = Table::parse(&elf).map_err(|error| bad_table(&error))?;
        drop(file);
        Ok(Self {
            image: Arc::new(Image {
                chip,
                elf,
                code: Arc::new(Programmed::new(chip, flash)),
                functions,
                variables,
                table,
                locations: OnceLock::new(),
            }),
        })
    }

    /// Loads a raw image for the STM32F446: bytes from the start of flash on, without symbols, log
    /// or debug information.
    ///
    /// # Errors
    /// [`LoadError`] when the image is empty or larger than the flash.
    pub fn from_flash(image: &[u8]) -> Result<Self, LoadError> {
        Self::for_chip(&F446, image)
    }

    /// The same for any chip.
    ///
    /// # Errors
    /// As [`Firmware::from_flash`].
    pub fn for_chip(chip: &'static Chip, image: &[u8]) -> Result<Self, LoadError> {
        let mut flash = vec![0xFF; chip.flash_size() as usize];
        let Some(place) = flash.get_mut(..image.len()) else {
            let length = image.len() as u32;
            return Err(LoadError::OutsideFlash {
                chip,
                address: FLASH_BASE,
                length,
            });
        };
        place.copy_from_slice(image);
        if image.is_empty() {
            return Err(LoadError::NoVectorTable);
        }
        Ok(Self {
            image: Arc::new(Image {
                chip,
                elf: Vec::new(),
                code: Arc::new(Programmed::new(chip, flash)),
                functions: Vec::new(),
                variables: HashMap::new(),
                table: None,
                locations: OnceLock::new(),
            }),
        })
    }

    /// The chip that the image is for.
    #[must_use]
    pub fn chip(&self) -> &'static Chip {
        self.image.chip
    }

    /// Content of the flash after programming.
    pub(crate) fn flash(&self) -> &[u8] {
        self.image.code.content()
    }

    pub(crate) fn code(&self) -> &Arc<Programmed> {
        &self.image.code
    }

    pub(crate) fn defmt_table(&self) -> Option<&Table> {
        self.image.table.as_ref()
    }

    pub(crate) fn defmt_locations(&self) -> &Locations {
        let Image { table, elf, .. } = &*self.image;
        self.image.locations.get_or_init(|| match table {
            Some(table) if DEBUG_INFO => table.get_locations(elf).unwrap_or_default(),
            _ => Locations::new(),
        })
    }

    /// A variable or linker symbol by its exact name.
    #[must_use]
    pub fn variable(&self, name: &str) -> Option<&Symbol> {
        self.image.variables.get(name)
    }

    /// All functions, by address.
    #[must_use]
    pub fn functions(&self) -> &[Symbol] {
        &self.image.functions
    }

    /// The function that contains an address.
    #[must_use]
    pub fn function_at(&self, address: u32) -> Option<&Symbol> {
        self.function_index(address)
            .map(|index| &self.image.functions[index])
    }

    pub(crate) fn function_index(&self, address: u32) -> Option<usize> {
        let next = self
            .image
            .functions
            .partition_point(|symbol| symbol.address <= address);
        let index = next.checked_sub(1)?;
        let symbol = &self.image.functions[index];
        (address - symbol.address < symbol.size).then_some(index)
    }

    /// Function, file and line of an address: "function (file:line)", with the functions inlined
    /// there, innermost first.
    #[must_use]
    pub fn location(&self, address: u32) -> Option<String> {
        let file = ElfFile32::<object::LittleEndian>::parse(&*self.image.elf).ok()?;
        let parts = frames(&debug_information(&file)?, address, |name, at| match at {
            Some(at) => format!(
                "{name} ({}:{})",
                at.file.unwrap_or("?"),
                at.line.unwrap_or(0)
            ),
            None => name,
        });
        (!parts.is_empty()).then(|| parts.join(" < "))
    }

    /// The function at each address with those that it is inlined into, innermost first; without
    /// debug information the function alone.
    #[must_use]
    pub fn names(&self, addresses: &[u32]) -> Vec<Vec<String>> {
        let file = ElfFile32::<object::LittleEndian>::parse(&*self.image.elf).ok();
        let context = file.as_ref().and_then(debug_information);
        let one = |address: &u32| {
            let inlined = context
                .as_ref()
                .map(|context| frames(context, *address, |name, _| name));
            let symbol = || self.function_at(*address).map(|found| found.name.clone());
            match inlined {
                Some(names) if !names.is_empty() => names,
                _ => symbol().into_iter().collect(),
            }
        };
        addresses.iter().map(one).collect()
    }
}

/// The device number of the chip that an image is linked for, if it says so.
fn chip_id(file: &ElfFile32<'_, object::LittleEndian>) -> Option<u32> {
    let symbol = file.symbol_by_name("_chip_id")?;
    Some(symbol.address() as u32)
}

/// What a programmer writes of an ELF file: bytes by address, in the order of the file.
///
/// # Errors
/// [`LoadError`] when it is no ELF file for a 32-bit little-endian Arm.
pub fn programmed(elf: &[u8]) -> Result<Vec<(u32, Vec<u8>)>, LoadError> {
    let not_elf = |error: object::Error| LoadError::NotArmElf(error.to_string());
    let file = ElfFile32::<object::LittleEndian>::parse(elf).map_err(not_elf)?;
    let endian = object::LittleEndian;
    let mut parts = Vec::new();
    for header in file.elf_program_headers() {
        let data = header.data(endian, elf).unwrap_or(&[]);
        if header.p_type(endian) == object::elf::PT_LOAD && !data.is_empty() {
            parts.push((header.p_paddr(endian), data.to_vec()));
        }
    }
    Ok(parts)
}

/// Whether images may have debug information. In a browser they have none, so that what reads it
/// need not be loaded.
const DEBUG_INFO: bool = cfg!(not(target_family = "wasm"));

type Slice<'a> = gimli::EndianSlice<'a, gimli::LittleEndian>;

fn debug_information<'a>(
    file: &ElfFile32<'a, object::LittleEndian>,
) -> Option<addr2line::Context<Slice<'a>>> {
    if !DEBUG_INFO {
        return None;
    }
    let load = |id: gimli::SectionId| -> Result<_, gimli::Error> {
        let data = file
            .section_by_name(id.name())
            .and_then(|section| section.data().ok());
        Ok(Slice::new(data.unwrap_or(&[]), gimli::LittleEndian))
    };
    addr2line::Context::from_dwarf(gimli::Dwarf::load(load).ok()?).ok()
}

/// What is made of the name and the place of each function inlined at an address, innermost first.
fn frames<T>(
    context: &addr2line::Context<Slice<'_>>,
    address: u32,
    make: impl Fn(String, Option<addr2line::Location<'_>>) -> T,
) -> Vec<T> {
    let mut found = Vec::new();
    let frames = context.find_frames(u64::from(address)).skip_all_loads();
    let Ok(mut frames) = frames else { return found };
    while let Ok(Some(frame)) = frames.next() {
        let name = frame
            .function
            .as_ref()
            .and_then(|function| function.raw_name().ok());
        let name = name.map_or_else(|| "?".into(), |name| demangle(&name));
        found.push(make(name, frame.location));
    }
    found
}

/// The readable part of a mangled name: path segments of the legacy scheme; other names stay.
fn demangle(raw: &str) -> String {
    rustc_demangle::demangle(raw).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_an_image_is_refused() {
        assert!(matches!(
            Firmware::from_elf(b"hello".to_vec()),
            Err(LoadError::NotArmElf(_))
        ));
        assert!(matches!(
            Firmware::load("/nonexistent"),
            Err(LoadError::Io(_))
        ));
    }
}
