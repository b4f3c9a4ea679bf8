//! CRC-32 of IEEE 802.3, bit by bit, without a table: it is computed rarely and over short inputs.

/// The CRC-32 of some bytes.
pub fn crc32(bytes: impl Iterator<Item = u8>) -> u32 {
    !bytes.fold(u32::MAX, step)
}

/// The same where the compiler has to work it out.
#[must_use]
pub const fn crc32_of(mut bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    while let Some((first, rest)) = bytes.split_first() {
        crc = step(crc, *first);
        bytes = rest;
    }
    !crc
}

const fn step(mut crc: u32, byte: u8) -> u32 {
    crc ^= byte as u32;
    let mut bit = 0;
    while bit < 8 {
        let carry = crc & 1;
        crc >>= 1;
        if carry != 0 {
            crc ^= 0xEDB8_8320;
        }
        bit += 1;
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_is_that_of_ieee_802_3() {
        // The check value of the standard.
        assert_eq!(crc32(b"123456789".iter().copied()), 0xCBF4_3926);
        assert_eq!(crc32_of(b"123456789"), 0xCBF4_3926);
    }
}
