//! One number that stands for a whole run.
//!
//! The standard library's hash of every frame with the time it ended and every change of a bridge
//! with the time the world saw it. Two runs of one build with the same digest said and did the
//! same; it is no protection against malice.

use std::hash::{DefaultHasher, Hasher as _};

use canopen::Frame;

use crate::motor::Bridge;

/// A running hash.
#[derive(Debug, Clone, Default)]
pub(crate) struct Digest(DefaultHasher);

impl Digest {
    pub fn frame(&mut self, end_ns: u64, frame: &Frame) {
        self.0.write_u64(end_ns);
        self.0.write_u16(frame.id());
        self.0.write(frame.data());
    }

    pub fn error_frame(&mut self, end_ns: u64) {
        self.0.write_u64(end_ns);
        self.0.write(b"error");
    }

    pub fn bridges(&mut self, now_ns: u64, node: u8, drives: &[Bridge; 4]) {
        // In one piece, which the hash takes faster than many.
        let mut bytes = [0; 44];
        let (head, tail) = bytes.split_at_mut(40);
        head[..8].copy_from_slice(&now_ns.to_ne_bytes());
        let mut switches = u32::from(node);
        for (drive, place) in drives.iter().zip(head[8..].chunks_mut(8)) {
            switches =
                switches << 2 | u32::from(drive.enabled) << 1 | u32::from(drive.brake_released);
            place.copy_from_slice(&drive.duty.to_ne_bytes());
        }
        tail.copy_from_slice(&switches.to_ne_bytes());
        self.0.write(&bytes);
    }

    pub fn value(&self) -> u64 {
        self.0.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIVE: Bridge = Bridge {
        duty: 0.5,
        enabled: true,
        brake_released: true,
    };

    fn of(now_ns: u64, node: u8, drives: [Bridge; 4]) -> u64 {
        let mut digest = Digest::default();
        digest.bridges(now_ns, node, &drives);
        digest.value()
    }

    #[test]
    fn whatever_differs_is_another_digest() {
        let one = of(7, 2, [LIVE; 4]);
        assert_eq!(one, of(7, 2, [LIVE; 4]));
        assert_ne!(one, of(8, 2, [LIVE; 4]));
        assert_ne!(one, of(7, 3, [LIVE; 4]));
        for wheel in 0..4 {
            for other in [
                Bridge { duty: 0.25, ..LIVE },
                Bridge {
                    enabled: false,
                    ..LIVE
                },
                Bridge {
                    brake_released: false,
                    ..LIVE
                },
            ] {
                let mut drives = [LIVE; 4];
                drives[wheel] = other;
                assert_ne!(one, of(7, 2, drives), "{wheel}: {other:?}");
            }
        }
        let frame = |id, data: &[u8]| {
            let mut digest = Digest::default();
            digest.frame(7, &Frame::new(id, data).unwrap());
            digest.value()
        };
        assert_ne!(frame(1, &[1]), frame(1, &[2]));
        assert_ne!(frame(1, &[1]), frame(2, &[1]));
    }
}
