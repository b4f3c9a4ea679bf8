//! The checksum of an image: what the chip's CRC unit computes.
//!
//! RM0390 rev 6, section 4: the polynomial 0x04C11DB7, a word at a time from its highest bit, from
//! 0xFFFF_FFFF on, without a final inversion. The reversed form of CRC-32 that files use is
//! another one.

const POLYNOMIAL: u32 = 0x04C1_1DB7;

/// A checksum over words, as they come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Checksum(u32);

impl Checksum {
    /// Of no words.
    pub const NEW: Self = Self(u32::MAX);

    /// With one more word.
    #[must_use]
    pub const fn with(self, word: u32) -> Self {
        let mut crc = self.0 ^ word;
        let mut bit = 0;
        while bit < u32::BITS {
            crc = if crc >> 31 == 1 {
                crc << 1 ^ POLYNOMIAL
            } else {
                crc << 1
            };
            bit += 1;
        }
        Self(crc)
    }

    /// With all of these words.
    #[must_use]
    pub fn over(self, words: impl IntoIterator<Item = u32>) -> Self {
        words.into_iter().fold(self, Self::with)
    }

    /// The value.
    #[must_use]
    pub const fn value(self) -> u32 {
        self.0
    }
}
