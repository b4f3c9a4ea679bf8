//! The CRC of SDO block transfers (CiA 301, 7.2.4.3.16): x^16 + x^12 + x^5 + 1, starting from 0.
//!
//! Bit by bit: about 60 instructions a byte, and no table in flash.

/// Carries a CRC on over more bytes; starts from 0.
pub(crate) fn crc16(start: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(start, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc, _| match crc & 0x8000 {
            0 => crc << 1,
            _ => crc << 1 ^ 0x1021,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_value_of_cia_301() {
        assert_eq!(crc16(0, b"123456789"), 0x31C3);
        assert_eq!(crc16(crc16(0, b"1234"), b"56789"), 0x31C3);
    }
}
