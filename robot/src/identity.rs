//! Who the robot is on the bus, and which PDOs it has.

use boot::Slot;
use canopen::{CobId, Config, Mapping, NodeId, PdoConfig};
use protocol::ENTRIES;
use protocol::pdos::{PDOS, Pdo};
use protocol::timing::{HEARTBEAT_MS, SYNC_OVERFLOW};

use crate::hardware::Hardware;

/// What the platform knows about this robot before it is configured.
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
    /// Device and revision of the microcontroller, object 0x2001:6; 0 where it does not tell.
    pub chip: u32,
    /// How long the start waited for clock and supply, ms, object 0x2127:1.
    pub clock_wait_ms: u16,
    /// Level of the brown-out reset, object 0x2127:2.
    pub brown_out_level: u8,
    /// Whether the platform stores images, see [`crate::BusSide::image_to_store`]. Without that
    /// there are no objects 0x1010 and 0x1011.
    pub storage: bool,
    /// What the board has.
    pub hardware: Hardware,
    /// The board has a gyro, and TPDO5 is sent.
    pub has_gyro: bool,
    /// Slot of flash that the program runs from; `None` for a robot that has none and takes no
    /// update over the bus.
    pub slot: Option<Slot>,
    /// What images have to be made for.
    pub device_of_images: boot::header::Device,
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
            chip: 0,
            clock_wait_ms: 0,
            brown_out_level: 3,
            storage: false,
            hardware: Hardware::NUCLEO_F446RE,
            has_gyro: false,
            slot: None,
            device_of_images: boot::header::Device {
                board: boot::header::Board::NUCLEO_F446RE,
                hardware: boot::release::HARDWARE_REVISION,
                security_counter: boot::release::SECURITY_COUNTER,
            },
        }
    }

    /// What the CANopen device of this robot starts from.
    #[must_use]
    pub const fn device(&self) -> Config {
        Config {
            node: Some(self.node),
            lowest_node: protocol::FIRST_ROBOT,
            highest_node: protocol::LAST_ROBOT,
            identity: canopen::Identity {
                vendor: 0,
                product: protocol::PRODUCT,
                revision: (protocol::WIRE_VERSION as u32) << 16,
                serial: self.serial,
            },
            name: protocol::NAME,
            heartbeat_ms: HEARTBEAT_MS,
            sync_overflow: SYNC_OVERFLOW,
            // What another member must know at once is in an emergency message.
            longest_emergency_inhibit_100us: 0,
            fixed_in_operation: true,
            storage: self.storage,
            rpdos: &RPDOS,
            tpdos: if self.has_gyro { &WITH_GYRO } else { &TPDOS },
            ..Config::DEFAULT
        }
    }
}

/// The mapping of a PDO that carries the record at this index.
#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn mapping<const N: usize>(index: u16) -> [Mapping; N] {
    let mut out = [Mapping::new(0, 0, 0); N];
    let (mut at, mut next) = (0, 0);
    while at < ENTRIES.len() {
        let (address, kind) = (ENTRIES[at].address, ENTRIES[at].kind);
        if address.index == index && ENTRIES[at].is_mappable() {
            out[next] = Mapping::new(index, address.sub, kind.bytes() * 8);
            next += 1;
        }
        at += 1;
    }
    assert!(next == N, "the record has more or fewer objects");
    out
}

/// A PDO as the protocol declares it.
#[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
const fn declared(nth: usize) -> &'static Pdo {
    &PDOS[nth]
}

static SETPOINT: [Mapping; 5] = mapping(declared(0).index);
static ALONE: [Mapping; 5] = mapping(declared(1).index);
static STATUS: [Mapping; 6] = mapping(declared(2).index);
static MEASURED: [Mapping; 5] = mapping(declared(3).index);
static POSE: [Mapping; 3] = mapping(declared(4).index);
static RATES: [Mapping; 4] = mapping(declared(5).index);
static YAW_RATE: [Mapping; 2] = mapping(declared(6).index);

const fn pdo(declared: &Pdo, mapping: &'static [Mapping]) -> PdoConfig {
    let cob_id = if declared.broadcast {
        CobId::Fixed(declared.cob_base)
    } else {
        CobId::PlusNode(declared.cob_base)
    };
    PdoConfig {
        cob_id,
        mapping,
        ..PdoConfig::DEFAULT
    }
}

static RPDOS: [PdoConfig; 2] = [pdo(declared(0), &SETPOINT), pdo(declared(1), &ALONE)];

const fn tpdos(yaw_rate: PdoConfig) -> [PdoConfig; 5] {
    [
        pdo(declared(2), &STATUS),
        pdo(declared(3), &MEASURED),
        pdo(declared(4), &POSE),
        pdo(declared(5), &RATES),
        yaw_rate,
    ]
}

static TPDOS: [PdoConfig; 5] = tpdos(PdoConfig {
    cob_id: CobId::Disabled,
    ..pdo(declared(6), &YAW_RATE)
});

static WITH_GYRO: [PdoConfig; 5] = tpdos(pdo(declared(6), &YAW_RATE));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pdos_are_those_of_the_table() {
        let all = [(true, &RPDOS[..]), (false, &WITH_GYRO[..])];
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
        let off = PdoConfig {
            cob_id: CobId::Disabled,
            ..WITH_GYRO[4]
        };
        assert!(TPDOS[..4] == WITH_GYRO[..4] && TPDOS[4] == off);
    }
}
