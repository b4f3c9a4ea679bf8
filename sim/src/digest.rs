//! One number that stands for a whole run.
//!
//! FNV-1a over every frame with the time it ended and every change of a bridge with the time the
//! world saw it. Two runs with the same digest said and did the same; it is no protection against
//! malice.

use canopen::Frame;

use crate::motor::Bridge;

const OFFSET: u64 = 0xCBF2_9CE4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01B3;

/// A running hash.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(OFFSET)
    }
}

impl Digest {
    pub fn frame(&mut self, end_ns: u64, frame: &Frame) {
        self.bytes(&end_ns.to_le_bytes());
        self.bytes(&frame.id().to_le_bytes());
        self.bytes(frame.data());
    }

    pub fn error_frame(&mut self, end_ns: u64) {
        self.bytes(&end_ns.to_le_bytes());
        self.bytes(b"error");
    }

    pub fn bridges(&mut self, now_ns: u64, node: u8, drives: &[Bridge; 4]) {
        self.bytes(&now_ns.to_le_bytes());
        for drive in drives {
            self.bytes(&[
                node,
                u8::from(drive.enabled),
                u8::from(drive.brake_released),
            ]);
            self.bytes(&drive.duty.to_bits().to_le_bytes());
        }
    }

    pub fn value(self) -> u64 {
        self.0
    }

    fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(PRIME);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published FNV-1a value of "foobar".
    #[test]
    fn is_fnv_1a() {
        let mut digest = Digest::default();
        digest.bytes(b"foobar");
        assert_eq!(digest.value(), 0x8594_4171_F739_67E8);
    }
}
