//! A checksum over what a member is about to do.
//!
//! Members that echo one sequence may still mean different things by it: one decodes the setpoint
//! through another PDO mapping, has another acceleration limit, or has heard another twist. So each
//! publishes eight bits over all of that ([`crate::MemberStatus::plan`]), and members whose eight
//! bits differ stop the group.
//!
//! The checksum is the top byte of a hash over sixteen bytes: the group CRC (object 0x2002:3), the
//! CRC of the communication objects, and the setpoint as the robot understood it, laid out as on
//! the bus. The hash is FNV-1a (32 bits) with the finish of MurmurHash3. Both multiply, so two
//! members with a lasting difference have new checksums with every setpoint: they agree by chance
//! in one of 256, and not for long. (The difference of two CRCs over equally changing data would
//! stay what it is.)

use crate::crc::crc32;

/// FNV-1a, 32 bits.
const OFFSET: u32 = 0x811C_9DC5;
const PRIME: u32 = 0x0100_0193;

/// What is part of every checksum of one member, and changes at a start only.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Plan(u32);

impl Plan {
    /// Of a member that has not been started.
    pub const NONE: Self = Self(OFFSET);

    /// With these group parameters (object 0x2002:3), and the words of these communication objects.
    #[must_use]
    pub fn new(group_crc: u32, communication: impl Iterator<Item = u32>) -> Self {
        let communication = crc32(communication.flat_map(u32::to_le_bytes));
        let words = [group_crc, communication].into_iter();
        Self(words.flat_map(u32::to_le_bytes).fold(OFFSET, mix))
    }

    /// The checksum of a setpoint, as its eight bytes on the bus.
    #[must_use]
    pub fn checksum(self, setpoint: &[u8; 8]) -> u8 {
        let [.., top] = finish(setpoint.iter().copied().fold(self.0, mix)).to_le_bytes();
        top
    }
}

const fn mix(hash: u32, byte: u8) -> u32 {
    (hash ^ byte as u32).wrapping_mul(PRIME)
}

/// Spreads every bit over the whole word: `fmix32` of MurmurHash3.
const fn finish(mut hash: u32) -> u32 {
    hash ^= hash >> 16;
    hash = hash.wrapping_mul(0x85EB_CA6B);
    hash ^= hash >> 13;
    hash = hash.wrapping_mul(0xC2B2_AE35);
    hash ^ hash >> 16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GroupTwist;
    use kinematics::Twist;

    fn setpoint(vx: f32, sequence: u8) -> [u8; 8] {
        GroupTwist {
            twist: Twist::new(vx, 0.0, 0.0),
            sequence,
            group: 1,
        }
        .encode()
    }

    /// The published test vector of FNV-1a for "foobar" is 0xBF9CF968.
    #[test]
    fn mixes_as_fnv_1a() {
        assert_eq!(b"foobar".iter().copied().fold(OFFSET, mix), 0xBF9C_F968);
    }

    /// Two members with a lasting difference, over all sequences: chance is one in 256, and one
    /// after the other in 65 536.
    #[test]
    fn a_lasting_difference_is_seen_at_the_next_setpoint_at_the_latest() {
        for other in 1..200_u32 {
            let pairs = [
                (
                    Plan::new(7, [1].into_iter()),
                    Plan::new(7 ^ other, [1].into_iter()),
                ),
                (
                    Plan::new(7, [1].into_iter()),
                    Plan::new(7, [1 + other].into_iter()),
                ),
            ];
            for (a, b) in pairs {
                let equal = |sequence: u8| {
                    let bytes = setpoint(0.0, sequence);
                    a.checksum(&bytes) == b.checksum(&bytes)
                };
                let count = (0..=255).filter(|sequence| equal(*sequence)).count();
                assert!(count < 8, "{other}: {count}");
            }
        }
    }

    #[test]
    fn every_byte_of_a_setpoint_counts() {
        let plan = Plan::new(0x1234_5678, [0x80, 0x181].into_iter());
        let bytes = setpoint(0.5, 9);
        for place in 0..8 {
            let mut seen = std::collections::BTreeSet::new();
            for value in 0..=255 {
                let mut bytes = bytes;
                bytes[place] = value;
                seen.insert(plan.checksum(&bytes));
            }
            // 256 values thrown into 256 places reach 162 of them on average.
            assert!(seen.len() > 130, "byte {place}: {}", seen.len());
        }
    }
}
