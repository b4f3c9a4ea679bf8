//! Values into slices, and the parts of a word.

use crate::AbortCode;

/// Copies `value` to the front of `out`; returns its length.
pub(crate) fn put(out: &mut [u8], value: &[u8]) -> Result<usize, AbortCode> {
    out.get_mut(..value.len())
        .ok_or(AbortCode::OutOfMemory)?
        .copy_from_slice(value);
    Ok(value.len())
}

/// The low byte and the low half of a word, where more would not fit.
pub(crate) const fn low_u8(value: u32) -> u8 {
    let [byte, ..] = value.to_le_bytes();
    byte
}

pub(crate) const fn low_u16(value: u32) -> u16 {
    let [a, b, ..] = value.to_le_bytes();
    u16::from_le_bytes([a, b])
}

pub(crate) const fn high_u16(value: u32) -> u16 {
    low_u16(value >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_a_word() {
        assert_eq!(put(&mut [0; 2], &[1, 2, 3]), Err(AbortCode::OutOfMemory));
        assert_eq!(high_u16(0x1234_5678), 0x1234);
        assert_eq!(low_u16(0x1234_5678), 0x5678);
        assert_eq!(low_u8(0x1234_5678), 0x78);
    }
}
