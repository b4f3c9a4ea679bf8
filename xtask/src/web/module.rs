//! The WebAssembly module without what only tools read.

use anyhow::Context as _;

/// Magic number and version.
const HEAD: usize = 8;
/// The number of custom sections, which change nothing of what a module does.
const CUSTOM: u8 = 0;

/// The module without its custom sections.
pub fn without_custom_sections(module: &[u8]) -> anyhow::Result<Vec<u8>> {
    let (head, mut rest) = module.split_at_checked(HEAD).context("no module")?;
    let mut out = head.to_vec();
    while let Some((kind, after)) = rest.split_first() {
        let (length, digits) = number(after).context("a section without a length")?;
        let section = rest.split_at_checked(1 + digits + length);
        let (section, next) = section.context("a section beyond the end of the module")?;
        if *kind != CUSTOM {
            out.extend_from_slice(section);
        }
        rest = next;
    }
    Ok(out)
}

/// A number in LEB128, and its bytes.
fn number(bytes: &[u8]) -> Option<(usize, usize)> {
    let mut value = 0;
    for (at, byte) in bytes.iter().enumerate().take(5) {
        value |= usize::from(byte & 0x7F) << (7 * at);
        if byte & 0x80 == 0 {
            return Some((value, at + 1));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn custom_sections_go_and_the_rest_stays() {
        let mut module = b"\0asm\x01\0\0\0".to_vec();
        let types = [1, 4, 1, 0x60, 0, 0];
        let mut custom = vec![0, 0x81, 1];
        custom.extend([7; 129]);
        let plain: Vec<u8> = module.iter().chain(&types).copied().collect();
        module.extend(custom.iter().chain(&types).chain(&custom));
        assert_eq!(without_custom_sections(&module).unwrap(), plain);
        assert!(without_custom_sections(&module[..20]).is_err());
    }
}
