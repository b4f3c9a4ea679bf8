//! The size of the release image: flash by crate, variables, stack.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use emulator::Firmware;
use object::{Object as _, ObjectSection as _};

use super::figure::Figure;

const FLASH: std::ops::Range<u64> = 0x0800_0000..0x0808_0000;

/// Bytes of the image in flash and of its variables in RAM.
pub fn sizes(elf: &Path) -> anyhow::Result<(u64, u64)> {
    let bytes = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let file = object::File::parse(&*bytes).context("not an ELF file")?;
    let (mut flash, mut ram) = (0, 0);
    for section in file.sections() {
        match section.name().unwrap_or_default() {
            ".vector_table" | ".text" | ".rodata" => flash += section.size(),
            ".data" => {
                flash += section.size();
                ram += section.size();
            }
            ".bss" | ".uninit" => ram += section.size(),
            _ => {}
        }
    }
    Ok((flash, ram))
}

/// Code by crate, from the names of the functions; constants are not in it.
pub fn by_crate(firmware: &Firmware) -> Vec<(String, u32)> {
    let mut crates: BTreeMap<String, u32> = BTreeMap::new();
    for function in firmware.functions() {
        if FLASH.contains(&u64::from(function.address)) {
            *crates.entry(crate_of(&function.name)).or_default() += function.size;
        }
    }
    let mut crates: Vec<_> = crates.into_iter().collect();
    crates.sort_by_key(|(_, size)| std::cmp::Reverse(*size));
    crates
}

/// The crate a function belongs to: of `<a::B as c::D>::e` it is `a`. Names without a path are the
/// compiler's library and interrupt handlers.
fn crate_of(name: &str) -> String {
    let path = name.trim_start_matches(['<', '&', '[', '(']);
    match path.split_once("::") {
        Some((first, _)) if first.chars().all(|c| c.is_alphanumeric() || c == '_') => {
            first.to_owned()
        }
        _ => "other".to_owned(),
    }
}

/// Bytes that are reserved for the stack.
pub fn stack(firmware: &Firmware) -> Option<u32> {
    let symbols = firmware.variable("_stack_start");
    let symbols = symbols.zip(firmware.variable("_stack_end"));
    symbols.map(|(start, end)| start.address - end.address)
}

/// Figures of the image.
pub fn figures(elf: &Path, firmware: &Firmware) -> anyhow::Result<Vec<Figure>> {
    let (flash, ram) = sizes(elf)?;
    let stack = stack(firmware).context("the image has no symbols of its stack")?;
    let mut figures = vec![
        Figure::new("memory.flash", flash as f64, "bytes")
            .budget(FLASH_LIMIT)
            .ceiling(FLASH_LIMIT),
        Figure::new("memory.variables", ram as f64, "bytes")
            .budget(VARIABLES_LIMIT)
            .ceiling(VARIABLES_LIMIT),
        Figure::new("memory.stack.reserved", f64::from(stack), "bytes"),
    ];
    for (name, size) in by_crate(firmware).into_iter().take(14) {
        figures.push(Figure::new(
            format!("memory.flash.{name}"),
            f64::from(size),
            "bytes",
        ));
    }
    Ok(figures)
}

/// The image that ships is held to this; the linker's own limit (`memory/`) is that of the largest
/// image.
const FLASH_LIMIT: f64 = 128.0 * 1024.0;
/// The linker's own limit.
const VARIABLES_LIMIT: f64 = 16.0 * 1024.0;

#[cfg(test)]
mod tests {
    use super::crate_of;

    #[test]
    fn a_function_belongs_to_the_crate_its_path_begins_with() {
        assert_eq!(
            crate_of("omnibus_control::tick::ControlSide::tick"),
            "omnibus_control"
        );
        assert_eq!(
            crate_of("<omnibus_robot::D as canopen::od::O>::read"),
            "omnibus_robot"
        );
        assert_eq!(crate_of("__aeabi_memcpy"), "other");
    }
}
