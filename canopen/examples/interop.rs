//! A device with every service, for tests by foreign masters: `interop ADDRESS [NODE] [FILE]`.
//!
//! Without NODE it has no node-ID and waits for an LSS master. FILE is its non-volatile memory. A
//! reset of the node ends the process with status 0, as a power cycle would.

mod slcan;

use std::collections::BTreeMap;
use std::path::PathBuf;

use canopen::{
    AbortCode, Application, CobId, Config, Device, Errors, Event, Identity, Mapping, NmtCommand,
    NmtState, NodeId, PdoConfig, PdoDirection, ReceivedSync, Storage, StoreProgress, StoreScope,
};

/// 0x2000 u16 setpoint, 0x2001 u32 up to 1000 and not while operational, 0x2002 u16 the setpoint as
/// it was at the last SYNC, 0x2003 a read-only text, 0x2004 any bytes, 0x2005 u8 write-only.
struct Objects {
    values: BTreeMap<u16, Vec<u8>>,
    file: Option<PathBuf>,
}

const TEXT: &[u8] = b"a value that is longer than four bytes";

impl Application for Objects {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        let value = match (index, sub) {
            (0x2003, 0) => TEXT,
            (0x2005, 0) => return Err(AbortCode::WriteOnly),
            (0x2000..=0x2004, 0) => &self.values[&index],
            (0x2000..=0x2005, _) => return Err(AbortCode::NoSubIndex),
            _ => return Err(AbortCode::NoObject),
        };
        let out = out.get_mut(..value.len()).ok_or(AbortCode::OutOfMemory)?;
        out.copy_from_slice(value);
        Ok(value.len())
    }

    fn write(
        &mut self,
        index: u16,
        sub: u8,
        data: &[u8],
        state: NmtState,
    ) -> Result<(), AbortCode> {
        let len = match (index, sub) {
            (0x2002 | 0x2003, 0) => return Err(AbortCode::ReadOnly),
            (0x2000, 0) => 2,
            (0x2001, 0) => 4,
            (0x2005, 0) => 1,
            (0x2004, 0) => data.len(),
            (0x2000..=0x2005, _) => return Err(AbortCode::NoSubIndex),
            _ => return Err(AbortCode::NoObject),
        };
        match data.len() {
            longer if longer > len => return Err(AbortCode::TooLong),
            shorter if shorter < len => return Err(AbortCode::TooShort),
            _ => {}
        }
        if index == 0x2001 {
            if state == NmtState::Operational {
                return Err(AbortCode::DeviceState);
            }
            if u32::from_le_bytes([data[0], data[1], data[2], data[3]]) > 1000 {
                return Err(AbortCode::ValueTooHigh);
            }
        }
        self.values.insert(index, data.to_vec());
        Ok(())
    }

    fn mappable(&self, index: u16, sub: u8, direction: PdoDirection) -> Result<u8, AbortCode> {
        match (index, sub, direction) {
            (0x2000, 0, PdoDirection::Receive) => Ok(16),
            (0x2000 | 0x2002, 0, PdoDirection::Transmit) => Ok(16),
            (0x2000..=0x2005, 0, _) => Err(AbortCode::NotMappable),
            (0x2000..=0x2005, _, _) => Err(AbortCode::NoSubIndex),
            _ => Err(AbortCode::NoObject),
        }
    }

    fn on_sync(&mut self, _: ReceivedSync, _: &mut Errors<'_>) {
        let setpoint = self.values[&0x2000].clone();
        self.values.insert(0x2002, setpoint);
    }

    fn storage(&mut self) -> Option<&mut dyn Storage> {
        Some(self)
    }
}

/// The file holds, each with its length before it, the image, 0x2001 and the node-ID.
impl Objects {
    fn memory(&self) -> [Vec<u8>; 3] {
        let bytes = self.file.as_ref().and_then(|path| std::fs::read(path).ok());
        let mut parts = [Vec::new(), Vec::new(), Vec::new()];
        let mut rest = bytes.unwrap_or_default();
        for part in &mut parts {
            if rest.len() < 2 {
                break;
            }
            let len = usize::from(u16::from_le_bytes([rest[0], rest[1]]));
            *part = rest[2..2 + len].to_vec();
            rest.drain(..2 + len);
        }
        parts
    }

    fn keep(&self, parts: [Vec<u8>; 3]) -> Result<StoreProgress, AbortCode> {
        let mut bytes = Vec::new();
        for part in parts {
            bytes.extend(u16::try_from(part.len()).unwrap_or(0).to_le_bytes());
            bytes.extend(part);
        }
        let path = self.file.as_ref().ok_or(AbortCode::Hardware)?;
        std::fs::write(path, bytes).map_err(|_| AbortCode::Hardware)?;
        Ok(StoreProgress::Done)
    }
}

impl Storage for Objects {
    fn save(
        &mut self,
        scope: StoreScope,
        communication: &[u8],
    ) -> Result<StoreProgress, AbortCode> {
        let [mut image, mut value, node] = self.memory();
        if scope.has_communication() {
            image = communication.to_vec();
        }
        if scope.has_application() {
            value = self.values[&0x2001].clone();
        }
        self.keep([image, value, node])
    }

    fn restore(&mut self, scope: StoreScope) -> Result<StoreProgress, AbortCode> {
        let [mut image, mut value, node] = self.memory();
        if scope.has_communication() {
            image.clear();
        }
        if scope.has_application() {
            value.clear();
        }
        self.keep([image, value, node])
    }

    fn load(&mut self, out: &mut [u8]) -> usize {
        let [image, ..] = self.memory();
        out[..image.len()].copy_from_slice(&image);
        image.len()
    }

    fn save_node(&mut self, node: Option<NodeId>) -> Result<StoreProgress, AbortCode> {
        let [image, value, _] = self.memory();
        let node = node.map(|node| vec![node.get()]).unwrap_or_default();
        self.keep([image, value, node])
    }
}

const SETPOINT: &[Mapping] = &[Mapping::new(0x2000, 0, 16)];
const APPLIED: &[Mapping] = &[Mapping::new(0x2002, 0, 16)];

const CONFIG: Config = Config {
    device_type: 0x0001_0203,
    identity: Identity {
        vendor: 0x0011_2233,
        product: 0x4455_6677,
        revision: 0x0001_0002,
        serial: 0x8899_AABB,
    },
    name: "Interop device",
    hardware_version: "host",
    software_version: env!("CARGO_PKG_VERSION"),
    heartbeat_ms: 100,
    storage: true,
    rpdos: &[
        PdoConfig {
            cob_id: CobId::PlusNode(0x200),
            transmission: 1,
            mapping: SETPOINT,
            ..PdoConfig::DEFAULT
        },
        PdoConfig {
            cob_id: CobId::PlusNode(0x300),
            transmission: 255,
            mapping: SETPOINT,
            ..PdoConfig::DEFAULT
        },
    ],
    tpdos: &[
        PdoConfig {
            cob_id: CobId::PlusNode(0x180),
            transmission: 1,
            mapping: APPLIED,
            ..PdoConfig::DEFAULT
        },
        PdoConfig {
            transmission: 255,
            mapping: SETPOINT,
            ..PdoConfig::DEFAULT
        },
    ],
    ..Config::DEFAULT
};

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(2);
    let node = arguments.next().and_then(|node| node.parse().ok());
    let mut bus = slcan::Slcan::listen("127.0.0.1:29536")?;
    let mut objects = Objects {
        values: BTreeMap::from([
            (0x2000, vec![0; 2]),
            (0x2001, vec![0; 4]),
            (0x2002, vec![0; 2]),
            (0x2004, Vec::new()),
        ]),
        file: arguments.next().map(PathBuf::from),
    };
    let [_, value, saved] = objects.memory();
    if value.len() == 4 {
        objects.values.insert(0x2001, value);
    }
    let node = saved.first().copied().or(node).and_then(NodeId::new);
    let mut device = Device::new(Config { node, ..CONFIG });
    loop {
        if let Some(frame) = bus.receive() {
            device.on_frame(bus.now(), &frame, &mut objects);
        }
        while let Some(event) = device.pop_event() {
            match event {
                Event::NmtCommand(NmtCommand::ResetNode) => return Ok(()),
                Event::ObjectWritten { index: 0x2000, .. } => device.trigger_tpdo(2),
                _ => {}
            }
        }
        device.poll(bus.now(), &mut objects);
        while let Some(frame) = device.pop_frame() {
            bus.send(&frame);
        }
    }
}
