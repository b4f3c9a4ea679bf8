//! How long a frame is on the wire, in bits.
//!
//! A classic base frame (ISO 11898-1): start, 11 identifier bits, RTR, IDE, reserved, 4 length bits, data,
//! 15 CRC bits; all of this is stuffed: after five equal bits one opposite bit is inserted, and the
//! inserted bit counts for what follows. Then CRC delimiter, acknowledge slot and delimiter, and seven
//! end-of-frame bits, unstuffed. Three bits of intermission separate frames. The count is exact, not a
//! worst case: bus load follows the data that was really sent.

use canopen::Frame;

/// Unstuffed bits after the CRC: delimiter, acknowledge slot, its delimiter, end of frame.
const TAIL: u32 = 1 + 1 + 1 + 7;
/// Bits that must pass before another frame may start.
pub const INTERMISSION: u32 = 3;

/// Bits of a frame from its start to the end of its end-of-frame field, stuffing included,
/// intermission excluded.
#[must_use]
pub fn frame_bits(frame: &Frame) -> u32 {
    let mut wire = Stuffer::default();
    let mut crc = 0;
    let data = frame.data();
    // Start, identifier, RTR, IDE and reserved bit: all but the identifier are dominant.
    let head = (u32::from(frame.id()) << 3, 15);
    // At most 8, four bits.
    let length = (data.len() as u32, 4);
    let bytes = data.iter().map(|byte| (u32::from(*byte), 8));
    for (value, width) in [head, length].into_iter().chain(bytes) {
        for bit in (0..width).rev().map(|n| value >> n & 1 == 1) {
            crc = crc15(crc, bit);
            wire.push(bit);
        }
    }
    for n in (0..15).rev() {
        wire.push(crc >> n & 1 == 1);
    }
    wire.count + TAIL
}

/// One step of the CRC of ISO 11898-1, polynomial 0x4599.
fn crc15(crc: u16, bit: bool) -> u16 {
    let out = (crc >> 14 & 1 == 1) != bit;
    (crc << 1 & 0x7FFF) ^ if out { 0x4599 } else { 0 }
}

/// Counts bits as they go out, stuff bits included.
#[derive(Default)]
struct Stuffer {
    count: u32,
    level: Option<bool>,
    run: u32,
}

impl Stuffer {
    fn push(&mut self, bit: bool) {
        self.count += 1;
        self.run = if self.level == Some(bit) {
            self.run + 1
        } else {
            1
        };
        self.level = Some(bit);
        if self.run == 5 {
            self.count += 1;
            self.run = 1;
            self.level = Some(!bit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(id: u16, data: &[u8]) -> u32 {
        frame_bits(&Frame::new(id, data).unwrap())
    }

    /// The check value of CRC-15/CAN in every catalogue of CRCs.
    #[test]
    fn crc_of_the_catalogue() {
        let crc = b"123456789"
            .iter()
            .flat_map(|byte| (0..8).rev().map(move |n| byte >> n & 1 == 1))
            .fold(0, crc15);
        assert_eq!(crc, 0x059E);
    }

    /// Identifier 0, no data: 19 dominant bits, and the CRC of zeros is zero, so 34 dominant bits in a
    /// row; a stuff bit after every fifth makes 6.
    #[test]
    fn nothing_but_dominant_bits() {
        assert_eq!(bits(0, &[]), 34 + 6 + 10);
    }

    /// Frames written out bit by bit, the CRC by long division of the bit string.
    ///
    /// 0x555: `0 10101010101 000 0000`, CRC `110011101001100`. Five dominant bits end at the second bit
    /// of the length: one stuff bit, three dominant follow. One stuff bit in all.
    ///
    /// 0x080 with 01: `0 00010000000 000 0001 00000001`, CRC `000011000000001`; stuffed
    /// `00001000001000001000100000100100001100000(1)0001`: four.
    #[test]
    fn frames_counted_by_hand() {
        for (id, data, stuffed) in [
            (0x555, &[][..], 1),
            (0x080, &[1], 4),
            (0x000, &[1, 2], 5),
            (0x181, &[0; 8], 15),
            (0x7FF, &[0xFF; 8], 15),
            (0x181, &[0xE8, 3, 0, 0, 0, 0, 7, 1], 11),
        ] {
            let unstuffed = 44 + 8 * u32::try_from(data.len()).unwrap();
            assert_eq!(bits(id, data), unstuffed + stuffed, "{id:03X}");
        }
    }
}
