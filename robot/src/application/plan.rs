//! What the members compare before they move: the group's parameters, and the communication objects
//! that say what the frames of the group are and carry.

use canopen::Device;
use protocol::Plan;
use protocol::address::SETPOINT_GROUP;

use super::Application;

/// What of an object is part of a plan.
#[derive(Clone, Copy)]
enum Part {
    /// Its value, the same in all members.
    Same,
    /// An identifier of the robot's own: its value less the node number.
    OwnIdentifier,
    /// The number of a PDO's entries, and then these.
    Map,
}

/// The communication objects that are part of a plan: SYNC, emergency message, and the PDOs that
/// carry group twist, status and measured twist. Every other PDO is a member's own matter.
static PARTS: [(u16, u8, Part); 20] = [
    (0x1005, 0, Part::Same),
    (0x1006, 0, Part::Same),
    (0x1007, 0, Part::Same),
    (0x1014, 0, Part::OwnIdentifier),
    (0x1400, 1, Part::Same),
    (0x1400, 2, Part::Same),
    (0x1400, 5, Part::Same),
    (0x1600, 0, Part::Map),
    (0x1800, 1, Part::OwnIdentifier),
    (0x1800, 2, Part::Same),
    (0x1800, 3, Part::Same),
    (0x1800, 5, Part::Same),
    (0x1800, 6, Part::Same),
    (0x1A00, 0, Part::Map),
    (0x1801, 1, Part::OwnIdentifier),
    (0x1801, 2, Part::Same),
    (0x1801, 3, Part::Same),
    (0x1801, 5, Part::Same),
    (0x1801, 6, Part::Same),
    (0x1A01, 0, Part::Map),
];

/// Most words that they have: eight entries a map.
const WORDS: usize = PARTS.len() + 3 * canopen::MAX_MAPPED;

impl Application {
    /// What is part of every checksum from this start on.
    #[inline(never)]
    pub(super) fn make_plan(&self, device: &Device) -> Plan {
        let node = u32::from(self.identity.node.get());
        let mut words = heapless::Vec::<u32, WORDS>::new();
        for (index, sub, part) in PARTS.iter().copied() {
            let word = self.object(device, index, sub);
            let _ = words.push(match part {
                Part::OwnIdentifier => word.wrapping_sub(node),
                Part::Same | Part::Map => word,
            });
            let mapped = match part {
                Part::Map => word.to_le_bytes()[0],
                Part::Same | Part::OwnIdentifier => 0,
            };
            for sub in 1..=mapped {
                let _ = words.push(self.object(device, index, sub));
            }
        }
        Plan::new(self.parameters.group_crc(), words.into_iter())
    }

    /// Which byte of a frame with the group twist is the group, by the mapping of RPDO1 (0x1600).
    pub(super) fn group_byte(&self, device: &Device) -> Option<usize> {
        const GROUP: u32 = SETPOINT_GROUP.packed() << 8 | 8;
        let mut bits = 0;
        let [mapped, ..] = self.object(device, 0x1600, 0).to_le_bytes();
        for sub in 1..=mapped {
            let entry = self.object(device, 0x1600, sub);
            if entry == GROUP && bits % 8 == 0 {
                return Some(bits / 8);
            }
            bits += (entry & 0xFF) as usize;
        }
        None
    }

    /// An object of the device, as a number; 0 for none.
    #[inline(never)]
    fn object(&self, device: &Device, index: u16, sub: u8) -> u32 {
        let mut bytes = [0; 4];
        let read = device.read(index, sub, &mut bytes, self);
        read.map_or(0, |_| u32::from_le_bytes(bytes))
    }
}
