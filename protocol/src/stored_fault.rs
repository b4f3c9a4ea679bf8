//! A fault as a robot keeps it over a power loss, and as object 0x2128 tells it: eight words,
//! little-endian.
//!
//! | bytes | |
//! |---|---|
//! | 0-1 | fault code |
//! | 2-3 | 0 |
//! | 4-7 | number of the start in which it appeared |
//! | 8-11 | time since that start, ms |
//! | 12-15 | supply voltage, V, FLOAT32; not a number where it is not measured |
//! | 16-31 | wheel rates front left, front right, rear left, rear right, rad/s, FLOAT32 |

/// A fault and what the robot was like.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StoredFault {
    /// Code of the fault.
    pub code: u16,
    /// Number of the start; starts that last a second are counted, from 1.
    pub start: u32,
    /// Time since that start, ms.
    pub time_ms: u32,
    /// Supply voltage, V, where it is measured.
    pub supply: Option<f32>,
    /// Measured wheel rates, rad/s, positive forward: front left, front right, rear left, rear
    /// right.
    pub rates: [f32; 4],
}

impl StoredFault {
    /// Bytes of one.
    pub const LENGTH: usize = 32;

    /// The bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LENGTH] {
        let [a, b, c, d] = self.rates.map(f32::to_bits);
        let supply = self.supply.unwrap_or(f32::NAN).to_bits();
        let words = [
            u32::from(self.code),
            self.start,
            self.time_ms,
            supply,
            a,
            b,
            c,
            d,
        ];
        let mut bytes = [0; Self::LENGTH];
        for (to, from) in bytes
            .iter_mut()
            .zip(words.into_iter().flat_map(u32::to_le_bytes))
        {
            *to = from;
        }
        bytes
    }

    /// What the bytes say.
    #[must_use]
    pub fn decode(bytes: &[u8; Self::LENGTH]) -> Self {
        let mut words = [0; Self::LENGTH / 4];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_le_bytes(*bytes);
        }
        let [code, start, time_ms, supply, a, b, c, d] = words;
        let [low, high, ..] = code.to_le_bytes();
        Self {
            code: u16::from_le_bytes([low, high]),
            start,
            time_ms,
            supply: Some(f32::from_bits(supply)).filter(|supply| !supply.is_nan()),
            rates: [a, b, c, d].map(f32::from_bits),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_decoded_is_what_was_encoded() {
        for supply in [None, Some(23.5)] {
            let fault = StoredFault {
                code: 0xFF0B,
                start: 0x0102_0304,
                time_ms: 5_000,
                supply,
                rates: [1.0, -2.0, 3.5, 0.0],
            };
            let bytes = fault.encode();
            assert_eq!(bytes[..8], [0x0B, 0xFF, 0, 0, 4, 3, 2, 1]);
            assert_eq!(StoredFault::decode(&bytes), fault);
        }
    }
}
