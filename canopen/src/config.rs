//! The initial configuration of a device: identity and the defaults of its communication objects.
//!
//! A `Config` is small and `Copy`, its lists are `'static`: on a microcontroller all of it is a
//! constant in flash. Write one as `Config { node: Some(id), ..Config::DEFAULT }`, so that fields
//! added later do not break it.

use crate::NodeId;

/// Object 0x1018.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Vendor-ID given by CiA; 0 for none.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision: major in the upper half, minor in the lower.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
}

/// The identifier a PDO has by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CobId {
    /// This one, whatever the node-ID.
    Fixed(u16),
    /// This base plus the node-ID.
    PlusNode(u16),
    /// The PDO exists but is off until a master gives it an identifier.
    Disabled,
}

/// One object in a PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapping {
    /// Index of the object.
    pub index: u16,
    /// Sub-index of the object.
    pub sub: u8,
    /// Length in bits, a multiple of 8.
    pub bits: u8,
}

impl Mapping {
    /// An object of `bits` bits.
    #[must_use]
    pub const fn new(index: u16, sub: u8, bits: u8) -> Self {
        Self { index, sub, bits }
    }

    /// As in objects 0x1600 and 0x1A00: index, sub-index and length from the top down.
    #[must_use]
    pub const fn packed(self) -> u32 {
        (self.index as u32) << 16 | (self.sub as u32) << 8 | self.bits as u32
    }
}

/// The default of one PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoConfig {
    /// Identifier.
    pub cob_id: CobId,
    /// Transmission type: 0 to 240, 254 or 255.
    pub transmission: u8,
    /// Event timer in ms; of a receive PDO, its deadline. 0 for none.
    pub event_ms: u16,
    /// Inhibit time of a transmit PDO in units of 100 us.
    pub inhibit_100us: u16,
    /// What is mapped; at most eight objects in at most eight bytes.
    pub mapping: &'static [Mapping],
}

impl PdoConfig {
    /// Off, synchronous (type 1), nothing mapped.
    pub const DEFAULT: Self = Self {
        cob_id: CobId::Disabled,
        transmission: 1,
        event_ms: 0,
        inhibit_100us: 0,
        mapping: &[],
    };
}

/// Everything a [`Device`](crate::Device) starts from.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// The node-ID; without one the device stays off the bus.
    pub node: Option<NodeId>,
    /// Lowest node-ID that LSS may give it; lower ones are refused. A network whose master or tools
    /// have numbers of their own leaves those out.
    pub lowest_node: u8,
    /// Highest node-ID that LSS may give it.
    pub highest_node: u8,
    /// Object 0x1000.
    pub device_type: u32,
    /// Object 0x1018.
    pub identity: Identity,
    /// Object 0x1008, device name.
    pub name: &'static str,
    /// Object 0x1009, hardware version.
    pub hardware_version: &'static str,
    /// Object 0x100A, software version.
    pub software_version: &'static str,
    /// Object 0x1017, heartbeat period in ms; 0 for none.
    pub heartbeat_ms: u16,
    /// Object 0x1016, whose heartbeat is expected within how many ms; at most
    /// [`MAX_CONSUMERS`](crate::MAX_CONSUMERS).
    pub consumers: &'static [(NodeId, u16)],
    /// Object 0x1006, SYNC period in us; 0 for none.
    pub sync_period_us: u32,
    /// Object 0x1007, how long after a SYNC its PDOs are good, in us; 0 for any time.
    pub sync_window_us: u32,
    /// Object 0x1019, highest value of the SYNC counter; 0 for SYNC without counter.
    pub sync_overflow: u8,
    /// Object 0x1015, shortest time between two emergency messages in units of 100 us.
    pub emergency_inhibit_100us: u16,
    /// Longest such time that a master may set, in the same units: other nodes may rely on the
    /// messages.
    pub longest_emergency_inhibit_100us: u16,
    /// Object 0x1029, sub-index 1: what a lost heartbeat or bus-off does to an operational device:
    /// 0 brings it to PRE-OPERATIONAL, 1 nothing, 2 to STOPPED.
    pub error_behaviour: u8,
    /// Object 0x1F80, bit 2 clear: goes to OPERATIONAL by itself after boot-up. Other bits must be
    /// 0.
    pub startup: u32,
    /// Whether what a group relies on, the objects of communication, can be written in
    /// PRE-OPERATIONAL only: SYNC, emergency message, heartbeats, error behaviour, start-up and
    /// PDOs. CiA 301 permits writing them in OPERATIONAL as well.
    pub fixed_in_operation: bool,
    /// Whether there is a [`Storage`](crate::Storage): objects 0x1010 and 0x1011.
    pub storage: bool,
    /// Objects 0x1400 and 0x1600 on. Their number cannot change at run time; those past
    /// [`MAX_RPDO`](crate::MAX_RPDO) do not exist.
    pub rpdos: &'static [PdoConfig],
    /// Objects 0x1800 and 0x1A00 on. Their number cannot change at run time; those past
    /// [`MAX_TPDO`](crate::MAX_TPDO) do not exist.
    pub tpdos: &'static [PdoConfig],
}

impl Config {
    /// The value of object 0x1F80 of a device that waits for the NMT master to start it.
    pub const STARTUP_BY_MASTER: u32 = 1 << 2;

    /// No node-ID, no heartbeat, no PDOs.
    pub const DEFAULT: Self = Self {
        node: None,
        lowest_node: 1,
        highest_node: 127,
        device_type: 0,
        identity: Identity {
            vendor: 0,
            product: 0,
            revision: 0,
            serial: 0,
        },
        name: "",
        hardware_version: "",
        software_version: "",
        heartbeat_ms: 0,
        consumers: &[],
        sync_period_us: 0,
        sync_window_us: 0,
        sync_overflow: 0,
        emergency_inhibit_100us: 0,
        longest_emergency_inhibit_100us: u16::MAX,
        error_behaviour: 0,
        startup: Self::STARTUP_BY_MASTER,
        fixed_in_operation: false,
        storage: false,
        rpdos: &[],
        tpdos: &[],
    };
}

impl Config {
    /// Whether LSS may give this node-ID.
    pub(crate) const fn permits_node(&self, node: u8) -> bool {
        node >= self.lowest_node && node <= self.highest_node
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::DEFAULT
    }
}
