//! Little-endian values in and out of slices, with the abort codes SDO wants for wrong lengths.

use crate::AbortCode;

/// Copies `value` to the front of `out`; returns its length.
pub(crate) fn put(out: &mut [u8], value: &[u8]) -> Result<usize, AbortCode> {
    out.get_mut(..value.len())
        .ok_or(AbortCode::OutOfMemory)?
        .copy_from_slice(value);
    Ok(value.len())
}

/// Exactly `N` bytes.
fn exact<const N: usize>(data: &[u8]) -> Result<[u8; N], AbortCode> {
    data.try_into().map_err(|_| match data.len() < N {
        true => AbortCode::TooShort,
        false => AbortCode::TooLong,
    })
}

pub(crate) fn u8_of(data: &[u8]) -> Result<u8, AbortCode> {
    exact(data).map(|[byte]| byte)
}

pub(crate) fn u16_of(data: &[u8]) -> Result<u16, AbortCode> {
    exact(data).map(u16::from_le_bytes)
}

pub(crate) fn u32_of(data: &[u8]) -> Result<u32, AbortCode> {
    exact(data).map(u32::from_le_bytes)
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
    fn wrong_lengths_get_the_code_that_says_which() {
        assert_eq!(u16_of(&[1]), Err(AbortCode::TooShort));
        assert_eq!(u16_of(&[1, 2, 3]), Err(AbortCode::TooLong));
        assert_eq!(u16_of(&[0x34, 0x12]), Ok(0x1234));
        assert_eq!(put(&mut [0; 2], &[1, 2, 3]), Err(AbortCode::OutOfMemory));
        assert_eq!(high_u16(0x1234_5678), 0x1234);
    }
}
