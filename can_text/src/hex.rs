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
