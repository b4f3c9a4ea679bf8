//! What robots tell about themselves, for a report: chip, its revision, and firmware.

use std::collections::BTreeMap;

use acceptance::chip;
use protocol::{Kind, Value, address};

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::error::MasterError;
use crate::report::nodes;

/// Both in words, with the nodes that tell the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identities {
    /// `STM32F446, revision 0x1000 (nodes 2, 3)`.
    pub chip: String,
    /// `firmware 0.1.0 (nodes 2, 3)`.
    pub firmware: String,
}

impl Identities {
    /// Asks robots, which are real ones or those of a simulator.
    ///
    /// # Errors
    /// When a robot does not answer.
    pub fn read<L: Link>(
        wire: &mut Wire<L>,
        nodes: impl IntoIterator<Item = u8>,
        is_simulated: bool,
    ) -> Result<Self, MasterError> {
        let (mut chips, mut versions) = (BTreeMap::new(), BTreeMap::new());
        for node in nodes {
            let code = wire
                .read(node, address::CHIP, Kind::U32)
                .map(Value::to_bits);
            let chip = match code {
                Ok(0) if is_simulated => "none, a native robot".to_owned(),
                Ok(code) if is_simulated => format!("{}, emulated", chip::describe(code)),
                Ok(code) => chip::describe(code),
                // Older firmware.
                Err(MasterError::Refused { .. }) => "not told by its firmware".to_owned(),
                Err(error) => return Err(error),
            };
            chips.entry(chip).or_insert_with(Vec::new).push(node);
            let version = wire.read(node, address::FIRMWARE_VERSION, Kind::U32)?;
            let [_, patch, minor, major] = version.to_bits().to_le_bytes();
            let version = format!("firmware {major}.{minor}.{patch}");
            versions.entry(version).or_insert_with(Vec::new).push(node);
        }
        Ok(Self {
            chip: with_nodes(&chips),
            firmware: with_nodes(&versions),
        })
    }
}

fn with_nodes(values: &BTreeMap<String, Vec<u8>>) -> String {
    let one = values
        .iter()
        .map(|(text, of)| format!("{text} ({})", nodes(of)));
    one.collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fake::FakeBus;

    #[test]
    fn every_robot_is_named_with_its_chip_and_its_firmware() {
        let mut bus = FakeBus::new(&[2, 3, 4, 5]);
        let f446 = 0x1000_6421_u32.to_le_bytes().to_vec();
        let unknown = vec![0; 4];
        let chips = [Some(f446.clone()), Some(f446), Some(unknown), None];
        for (robot, chip) in bus.robots.iter_mut().zip(chips) {
            robot.store.remove(&address::CHIP);
            robot.store.extend(chip.map(|chip| (address::CHIP, chip)));
            let version = (address::FIRMWARE_VERSION, vec![0, 3, 2, 1]);
            robot.store.extend([version]);
        }
        let mut wire = Wire::visiting(&mut bus);
        let found = Identities::read(&mut wire, 2..=5, false).unwrap();
        assert_eq!(
            found.chip,
            "STM32F446, revision 0x1000 (nodes 2, 3); not told by its firmware (node 5); not told \
             by the chip (node 4)"
        );
        assert_eq!(found.firmware, "firmware 1.2.3 (nodes 2, 3, 4, 5)");
        let found = Identities::read(&mut wire, [2, 4], true).unwrap();
        assert_eq!(
            found.chip,
            "STM32F446, revision 0x1000, emulated (node 2); none, a native robot (node 4)"
        );
    }
}
