//! Who the robot is on the bus, and which PDOs it has.

use canopen::{CobId, Config, Mapping, NodeId, PdoConfig};
use protocol::timing::{HEARTBEAT_MS, SYNC_OVERFLOW};

/// What the platform knows about this robot before anybody has configured it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Identity {
    /// Node number, 2 to 17.
    pub node: NodeId,
    /// Node by the switches on the board, object 0x2001:4.
    pub node_switches: u8,
    /// Serial number, objects 0x1018:4 and 0x2001:1.
    pub serial: u32,
    /// Firmware version, object 0x2001:2.
    pub firmware: u32,
    /// Why the processor started, object 0x2001:3.
    pub reset_cause: u8,
    /// How long the start waited for clock and supply, ms, object 0x2127:1.
    pub clock_wait_ms: u16,
    /// Level of the brown-out reset, object 0x2127:2.
    pub brown_out_level: u8,
    /// Whether the platform stores images, see [`crate::BusSide::image_to_store`]. Without that
    /// there are no objects 0x1010 and 0x1011.
    pub storage: bool,
}

impl Identity {
    /// This version, as object 0x2001:2 has it.
    pub const FIRMWARE: u32 = 0x0001_0000;

    /// A robot with this node and serial number, after power-on.
    #[must_use]
    pub const fn new(node: NodeId, serial: u32) -> Self {
        Self {
            node,
            node_switches: node.get(),
            serial,
            firmware: Self::FIRMWARE,
            reset_cause: 0,
            clock_wait_ms: 0,
            brown_out_level: 3,
            storage: false,
        }
    }
}

const TWIST_BITS: [u8; 5] = [16, 16, 16, 8, 8];

const fn five(index: u16, bits: [u8; 5]) -> [Mapping; 5] {
    let [a, b, c, d, e] = bits;
    [
        Mapping::new(index, 1, a),
        Mapping::new(index, 2, b),
        Mapping::new(index, 3, c),
        Mapping::new(index, 4, d),
        Mapping::new(index, 5, e),
    ]
}

static SETPOINT: [Mapping; 5] = five(0x2100, TWIST_BITS);
static ALONE: [Mapping; 5] = five(0x2101, TWIST_BITS);
static STATUS: [Mapping; 6] = [
    Mapping::new(0x2110, 1, 8),
    Mapping::new(0x2110, 2, 8),
    Mapping::new(0x2110, 3, 16),
    Mapping::new(0x2110, 4, 8),
    Mapping::new(0x2110, 5, 16),
    Mapping::new(0x2110, 6, 8),
];
static MEASURED: [Mapping; 5] = five(0x2111, TWIST_BITS);
static POSE: [Mapping; 3] = [
    Mapping::new(0x2112, 1, 24),
    Mapping::new(0x2112, 2, 24),
    Mapping::new(0x2112, 3, 16),
];
static RATES: [Mapping; 4] = [
    Mapping::new(0x2113, 1, 16),
    Mapping::new(0x2113, 2, 16),
    Mapping::new(0x2113, 3, 16),
    Mapping::new(0x2113, 4, 16),
];

const fn pdo(cob_id: CobId, mapping: &'static [Mapping]) -> PdoConfig {
    PdoConfig {
        cob_id,
        mapping,
        ..PdoConfig::DEFAULT
    }
}

static RPDOS: [PdoConfig; 2] = [
    pdo(CobId::Fixed(protocol::cob::GROUP_TWIST), &SETPOINT),
    pdo(
        CobId::PlusNode(protocol::cob::commissioning_twist(0)),
        &ALONE,
    ),
];

static TPDOS: [PdoConfig; 4] = [
    pdo(CobId::PlusNode(protocol::cob::member_status(0)), &STATUS),
    pdo(CobId::PlusNode(protocol::cob::measured_twist(0)), &MEASURED),
    pdo(CobId::PlusNode(protocol::cob::pose(0)), &POSE),
    pdo(CobId::PlusNode(protocol::cob::wheel_rates(0)), &RATES),
];

pub(crate) fn config(identity: &Identity) -> Config {
    Config {
        node: Some(identity.node),
        node_ids: (protocol::FIRST_ROBOT, protocol::LAST_ROBOT),
        identity: canopen::Identity {
            vendor: 0,
            product: protocol::PRODUCT,
            revision: u32::from(protocol::WIRE_VERSION) << 16,
            serial: identity.serial,
        },
        name: "Omnibus robot",
        heartbeat_ms: HEARTBEAT_MS,
        sync_overflow: SYNC_OVERFLOW,
        fixed_in_operation: true,
        storage: identity.storage,
        rpdos: &RPDOS,
        tpdos: &TPDOS,
        ..Config::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::pdos::PDOS;

    #[test]
    fn pdos_are_those_of_the_table() {
        let all = [(true, &RPDOS[..]), (false, &TPDOS[..])];
        for (receive, pdos) in all {
            let declared = PDOS.iter().filter(|pdo| pdo.receive == receive);
            assert_eq!(declared.clone().count(), pdos.len());
            for (declared, pdo) in declared.zip(pdos) {
                let cob_id = if declared.broadcast {
                    CobId::Fixed(declared.cob_base)
                } else {
                    CobId::PlusNode(declared.cob_base)
                };
                assert_eq!(pdo.cob_id, cob_id);
                let mapping: std::vec::Vec<Mapping> = declared
                    .objects()
                    .map(|object| {
                        let address = object.address;
                        Mapping::new(address.index, address.sub, object.kind.bytes() * 8)
                    })
                    .collect();
                assert_eq!(pdo.mapping, mapping, "{}", declared.name);
            }
        }
    }
}
