//! The length of a frame on the wire, in bits.
//!
//! A classic base frame (ISO 11898-1): start, 11 identifier bits, RTR, IDE, reserved, 4 length
//! bits, data, 15 CRC bits; all of this is stuffed: after five equal bits one opposite bit is
//! inserted, and the inserted bit counts for what follows. Then CRC delimiter, acknowledge slot and
//! delimiter, and seven end-of-frame bits, unstuffed. Three bits of intermission separate frames.
//! The count is exact, not a worst case: bus load depends on the data that is actually sent.
//!
//! A frame with an error ends with an error flag of six equal bits, which violates the stuffing
//! rule for nodes that have not detected the error yet; these then send their own flags. Eight bits
//! of delimiter end the error frame.

use crate::frame::Frame;

/// Unstuffed bits after the CRC: delimiter, acknowledge slot, its delimiter, end of frame.
const TAIL: u32 = 1 + 1 + 1 + 7;
/// Bits that must pass before another frame may start.
pub const INTERMISSION: u32 = 3;

/// Bits of an error flag.
pub const FLAG: u32 = 6;
/// Bits after the last flag.
pub const ERROR_DELIMITER: u32 = 8;

/// Bits of a frame from its start to the end of its end-of-frame field, stuffing included,
/// intermission excluded.
#[must_use]
pub fn frame_bits(frame: &Frame) -> u32 {
    Wire::of(frame).bits()
}

/// A frame as it is on the wire.
#[derive(Debug, Clone, Copy)]
pub struct Wire {
    /// Bits from the start to the end of the CRC without stuff bits, the first one highest.
    bits: u128,
    /// How many.
    count: u32,
    /// Those that a stuff bit follows.
    stuffed: u128,
}

impl Wire {
    /// The bits of a frame.
    #[must_use]
    pub fn of(frame: &Frame) -> Self {
        // Start, identifier, RTR, IDE and reserved bit: all but the identifier are dominant.
        let head = u32::from(frame.id()) << 7 | u32::from(frame.len());
        let [_, head @ ..] = head.to_be_bytes();
        let mut bits = 0;
        let mut crc = 0;
        // Dominant bits in front of the first one leave the CRC of nothing at zero.
        for byte in head.iter().chain(frame.data()) {
            bits = bits << 8 | u128::from(*byte);
            crc = crc15(crc, *byte);
        }
        let bits = bits << 15 | u128::from(crc);
        Self::stuffed_from(bits, 34 + 8 * u32::from(frame.len()))
    }

    /// The lowest `count` of these bits, at most 98, with stuff bits.
    fn stuffed_from(bits: u128, count: u32) -> Self {
        let bits = bits << (u128::BITS - count);
        // Where so many equal bits begin.
        let two = !(bits ^ bits << 1);
        let four = two & two << 1 & two << 2;
        let five = four & four << 1;
        // Where a bit is the opposite of the one before: a stuff bit between them is like it.
        let changes = !two >> 1;
        let (mut stuffed, mut after) = (0, 0);
        loop {
            let joins = after > 0 && (changes & four) << after >> (u128::BITS - 1) == 1;
            after += if joins {
                4
            } else {
                (five << after).leading_zeros() + 5
            };
            if after > count {
                return Self {
                    bits,
                    count,
                    stuffed,
                };
            }
            stuffed |= 1 << (u128::BITS - after);
        }
    }

    /// Bits up to the end of the CRC, stuffing included: at most 122.
    #[must_use]
    pub fn stuffed(&self) -> u32 {
        self.count + self.stuffed.count_ones()
    }

    /// Bits up to the end of the end-of-frame field.
    #[must_use]
    pub fn bits(&self) -> u32 {
        self.stuffed() + TAIL
    }

    /// Bits up to the end of the error delimiter when bit `n`, counted from 0, is inverted.
    /// `active`: the sender's flag is dominant. It begins with the bit after; the others notice at
    /// the sixth equal bit and send theirs.
    #[must_use]
    pub fn bits_when_corrupt(&self, n: u32, active: bool) -> u32 {
        // Recessive is 1.
        Self::bits_with_flags(n, |at| (self.level(at) != (at == n)) != active)
    }

    /// Bits up to the end of the error delimiter when another sender of the same identifier, whose
    /// bit `n` is recessive where this one is dominant, begins its dominant flag after it.
    #[must_use]
    pub fn bits_when_collided(&self, n: u32) -> u32 {
        Self::bits_with_flags(n, |at| !self.level(at))
    }

    /// The others see the flag that begins after bit `n` when six bits in a row are like it.
    fn bits_with_flags(n: u32, like_flag: impl Fn(u32) -> bool) -> u32 {
        let run = (0..=n).rev().take_while(|at| like_flag(*at));
        let seen = u32::try_from(run.count()).unwrap_or(FLAG).min(FLAG);
        n + 1 + (FLAG - seen) + FLAG + ERROR_DELIMITER
    }

    /// Bit `n`, counted from 0, of those up to the end of the CRC; recessive is `true`, and what
    /// follows is recessive.
    #[must_use]
    pub fn level(&self, n: u32) -> bool {
        let bit = |place: u32| self.bits << place >> (u128::BITS - 1) == 1;
        // Stuff bits move the rest on by one each.
        let (mut place, mut left) = (n, self.stuffed);
        while left != 0 {
            let before = left.leading_zeros();
            if place <= before {
                break;
            }
            if place == before + 1 {
                return !bit(before);
            }
            place -= 1;
            left &= !(1 << (u128::BITS - 1 - before));
        }
        place >= self.count || bit(place)
    }

    /// The first bit in which two frames with one identifier differ; `None` when they are the same.
    #[must_use]
    pub fn first_difference(&self, other: &Self) -> Option<u32> {
        (0..self.stuffed().max(other.stuffed())).find(|n| self.level(*n) != other.level(*n))
    }

    /// Bits up to the end of the error delimiter when the acknowledge is missing and the sender's
    /// flag begins with the acknowledge delimiter. The others see at its first bit that the form is
    /// wrong.
    #[must_use]
    pub fn bits_when_unacknowledged(&self) -> u32 {
        let acknowledge = self.stuffed() + 2;
        acknowledge + 1 + FLAG + ERROR_DELIMITER
    }

    /// Bits up to the end of the error delimiter when one receiver refuses the checksum: its flag
    /// begins after the acknowledge delimiter, the others see at its first bit that the form is
    /// wrong.
    #[must_use]
    pub fn bits_when_refused(&self) -> u32 {
        let delimiter = self.stuffed() + 3;
        delimiter + 1 + FLAG + ERROR_DELIMITER
    }
}

/// Eight bits of the CRC of ISO 11898-1, polynomial 0x4599.
fn crc15(crc: u16, byte: u8) -> u16 {
    let [high, _] = (crc << 1).to_be_bytes();
    let change = CRC.get(usize::from(high ^ byte)).copied().unwrap_or(0);
    (crc << 8 ^ change) & 0x7FFF
}

/// What eight bits change in the CRC that leaves with them.
#[expect(
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    reason = "the compiler evaluates it; all indices are below 256"
)]
const CRC: [u16; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < table.len() {
        let mut crc = (byte as u16) << 7;
        let mut bit = 0;
        while bit < 8 {
            let out = crc >> 14 & 1 == 1;
            crc = (crc << 1 & 0x7FFF) ^ if out { 0x4599 } else { 0 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(id: u16, data: &[u8]) -> u32 {
        frame_bits(&Frame::new(id, data).unwrap())
    }

    /// The check value of CRC-15/CAN in every catalogue of CRCs.
    #[test]
    fn crc_of_the_catalogue() {
        let crc = b"123456789".iter().copied().fold(0, crc15);
        assert_eq!(crc, 0x059E);
    }

    /// Identifier 0, no data: 19 dominant bits, and the CRC of zeros is zero, so 34 dominant bits
    /// in a row; a stuff bit after every fifth makes 6.
    #[test]
    fn nothing_but_dominant_bits() {
        assert_eq!(bits(0, &[]), 34 + 6 + 10);
    }

    /// Frames written out bit by bit, the CRC by long division of the bit string.
    ///
    /// 0x555: `0 10101010101 000 0000`, CRC `110011101001100`. Five dominant bits end at the second
    /// bit of the length: one stuff bit, three dominant follow. One stuff bit in all.
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

    /// After five equal bits comes an opposite one, which a receiver drops; it counts for the next
    /// five. What is left is the frame.
    #[test]
    fn a_receiver_finds_the_frame_without_stuff_bits() {
        let mut seed: u64 = 1;
        for length in (0..=8).cycle().take(9_000) {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // Few different bits, so that there is much to stuff.
            let data = (seed & seed << 7 & seed << 19).to_be_bytes();
            let frame = Frame::new((seed >> 50) as u16 & 0x7FF, &data[..length]).unwrap();
            let wire = Wire::of(&frame);
            let (mut run, mut level, mut bits, mut count) = (0, None, 0u128, 0);
            for n in 0..wire.stuffed() {
                let bit = wire.level(n);
                if run == 5 {
                    assert_ne!(Some(bit), level, "{frame:?}");
                } else {
                    (bits, count) = (bits << 1 | u128::from(bit), count + 1);
                }
                run = if level == Some(bit) { run + 1 } else { 1 };
                level = Some(bit);
            }
            assert_eq!(count, 34 + 8 * length, "{frame:?}");
            let sent = data[..length]
                .iter()
                .fold(0, |sent, byte| sent << 8 | u128::from(*byte));
            assert_eq!(bits >> 15 & ((1 << (8 * length)) - 1), sent, "{frame:?}");
            let head = u128::from(frame.id()) << 7 | length as u128;
            assert_eq!(bits >> (15 + 8 * length), head, "{frame:?}");
        }
    }

    /// Identifier 0 without data: five dominant bits and a recessive stuff bit, six times, then
    /// four dominant. So bits 5, 11, 17 .. are recessive.
    #[test]
    fn an_error_frame_is_as_long_as_the_bits_before_it_make_it() {
        let wire = Wire::of(&Frame::new(0, &[]).unwrap());
        assert_eq!((wire.stuffed(), wire.bits()), (40, 50));
        // Bit 12 inverted is recessive, so no other node has detected the error when the flag
        // begins: six bits of flag, then six of the others'.
        assert_eq!(wire.bits_when_corrupt(12, true), 13 + 12 + 8);
        // Stuff bit 11, inverted, is the sixth dominant bit in a row: all notice at once.
        assert_eq!(wire.bits_when_corrupt(11, true), 12 + 6 + 8);
        assert_eq!(wire.bits_when_corrupt(17, true), 18 + 6 + 8);
        // A passive sender's flag is recessive: bit 12 inverted follows a recessive bit, so two of
        // six are there.
        assert_eq!(wire.bits_when_corrupt(12, false), 13 + 4 + 6 + 8);
        // 40 bits to the end of the checksum; delimiter, acknowledge; flag of one bit and then six;
        // delimiter.
        assert_eq!(wire.bits_when_unacknowledged(), 42 + 7 + 8);
        assert_eq!(wire.bits_when_refused(), 43 + 7 + 8);
    }
}
