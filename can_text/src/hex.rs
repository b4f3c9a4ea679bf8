//! Hexadecimal digits.

use canopen::Frame;

/// The value of a digit, in either case.
pub fn digit(byte: u8) -> Option<u8> {
    match byte {
        b'0'..=b'9' => Some(byte - b'0'),
        b'A'..=b'F' => Some(byte - b'A' + 10),
        b'a'..=b'f' => Some(byte - b'a' + 10),
        _ => None,
    }
}

/// The digit of the lower four bits of a value, in upper case.
pub fn upper(value: u8) -> u8 {
    match value & 0xF {
        low @ 0..=9 => b'0' + low,
        high => b'A' + high - 10,
    }
}

/// The four digits of two bytes, in upper case. All four at once in one word: every frame of a full
/// bus is printed by a robot that has other things to do.
#[inline(always)]
pub fn four([first, second]: [u8; 2]) -> [u8; 4] {
    let pair = u32::from(first) | u32::from(second) << 16;
    // One digit a byte, the first in the lowest.
    let digits = (pair >> 4 & 0x000F_000F) | (pair << 8 & 0x0F00_0F00);
    // From ten on a digit plus six has bit 4 set; letters lie seven behind where the row goes on.
    let letters = digits.wrapping_add(0x0606_0606) >> 4 & 0x0101_0101;
    let ascii = digits.wrapping_add(0x3030_3030);
    // Seven times.
    ascii
        .wrapping_add((letters << 3).wrapping_sub(letters))
        .to_le_bytes()
}

/// The number that these digits are: one to four of them.
pub fn number(digits: &[u8]) -> Option<u16> {
    if digits.is_empty() || digits.len() > 4 {
        return None;
    }
    digits
        .iter()
        .try_fold(0, |value, byte| Some(value << 4 | u16::from(digit(*byte)?)))
}

/// The frame with this identifier and the data of these digits, two a byte.
pub fn frame(id: u16, digits: &[u8]) -> Option<Frame> {
    let (pairs, rest) = digits.as_chunks::<2>();
    let mut data = [0; 8];
    for (byte, [high, low]) in data.get_mut(..pairs.len())?.iter_mut().zip(pairs) {
        *byte = digit(*high)? << 4 | digit(*low)?;
    }
    if !rest.is_empty() {
        return None;
    }
    Frame::new(id, data.get(..pairs.len())?)
}
