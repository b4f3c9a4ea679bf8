//! Frame sequences in, golden bytes out. The bytes follow CiA 301 and were computed by hand.

mod bus_off;
mod emergency;
mod lss;
mod network;
mod pdo;
mod sdo;
mod store;
mod stream;

use std::vec::Vec;

use proptest::prelude::*;

use crate::*;

pub(super) const NODE: NodeId = match NodeId::new(5) {
    Some(node) => node,
    None => NodeId::MIN,
};

/// Non-volatile memory of the bench.
#[derive(Default, Clone)]
pub(super) struct Memory {
    pub image: Vec<u8>,
    pub saved: Vec<StoreScope>,
    pub restored: Vec<StoreScope>,
    pub node: Option<Option<NodeId>>,
    pub progress: Option<StoreProgress>,
    /// Saving the node-ID takes its time.
    pub slow_node: bool,
}

impl Storage for Memory {
    fn save(
        &mut self,
        scope: StoreScope,
        communication: &[u8],
    ) -> Result<StoreProgress, AbortCode> {
        self.saved.push(scope);
        if scope.has_communication() {
            self.image = communication.to_vec();
        }
        self.progress.ok_or(AbortCode::Hardware)
    }

    fn restore(&mut self, scope: StoreScope) -> Result<StoreProgress, AbortCode> {
        self.restored.push(scope);
        if scope.has_communication() {
            self.image.clear();
        }
        self.progress.ok_or(AbortCode::Hardware)
    }

    fn load(&mut self, out: &mut [u8]) -> usize {
        out[..self.image.len()].copy_from_slice(&self.image);
        self.image.len()
    }

    fn save_node(&mut self, node: Option<NodeId>) -> Result<StoreProgress, AbortCode> {
        self.node = Some(node);
        Ok(match self.slow_node {
            true => StoreProgress::Pending,
            false => StoreProgress::Done,
        })
    }
}

/// What the sink of the bench has been called with.
#[derive(Default, Debug, PartialEq, Eq)]
pub(super) struct Received {
    pub begun: Vec<(Option<u32>, NmtState)>,
    pub bytes: Vec<u8>,
    pub finished: usize,
    pub cancelled: usize,
    /// It refuses a value of more than so many bytes, when they come.
    pub room: Option<usize>,
    /// It refuses the end.
    pub spoils: bool,
}

impl Sink for Received {
    fn begin(&mut self, size: Option<u32>, state: NmtState) -> Result<(), AbortCode> {
        if size == Some(0) {
            return Err(AbortCode::TooShort);
        }
        self.begun.push((size, state));
        self.bytes.clear();
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        assert!((1..=7).contains(&bytes.len()), "{bytes:?}");
        self.bytes.extend(bytes);
        match self.room {
            Some(room) if self.bytes.len() > room => Err(AbortCode::Hardware),
            _ => Ok(()),
        }
    }

    fn finish(&mut self) -> Result<(), AbortCode> {
        if self.spoils {
            return Err(AbortCode::CannotStore);
        }
        self.finished += 1;
        Ok(())
    }

    fn cancel(&mut self) {
        self.cancelled += 1;
    }
}

/// Application objects: 0x2000 u16 setpoint, 0x2001 u32 in 0..=1000 and not while operational,
/// 0x2002 u16 measurement, 0x2003 twelve bytes, read-only, 0x2004 u8 write-only, 0x2005 any bytes,
/// 0x2006:1 a sink, and 0x2006:2 the same with two bytes that can be read.
#[derive(Default)]
pub(super) struct Objects {
    pub setpoint: u16,
    pub limited: u32,
    pub measured: u16,
    pub write_only: u8,
    pub long: Vec<u8>,
    pub resets: Vec<ResetScope>,
    pub syncs: Vec<ReceivedSync>,
    /// What it makes of a SYNC.
    pub at_sync: Option<fn(&mut Self, &mut Errors<'_>)>,
    /// Frames of RPDO 1 with this first byte are for others.
    pub refused: Option<u8>,
    pub heartbeats: Vec<(NodeId, NmtState)>,
    pub others: Vec<(Frame, NmtState)>,
    pub memory: Memory,
    pub received: Received,
}

pub(super) const LONG: &[u8] = b"twelve bytes";

/// Exactly `N` bytes.
fn exact<const N: usize>(data: &[u8]) -> Result<[u8; N], AbortCode> {
    data.try_into().map_err(|_| match data.len() < N {
        true => AbortCode::TooShort,
        false => AbortCode::TooLong,
    })
}

impl Application for Objects {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        match (index, sub) {
            (0x2000, 0) => bytes::put(out, &self.setpoint.to_le_bytes()),
            (0x2001, 0) => bytes::put(out, &self.limited.to_le_bytes()),
            (0x2002, 0) => bytes::put(out, &self.measured.to_le_bytes()),
            (0x2003, 0) => bytes::put(out, LONG),
            (0x2004, 0) => Err(AbortCode::WriteOnly),
            (0x2005, 0) => bytes::put(out, &self.long),
            (0x2006, 1) => Err(AbortCode::WriteOnly),
            (0x2006, 2) => bytes::put(out, &[0xAA, 0xBB]),
            (0x2000..=0x2005, _) => Err(AbortCode::NoSubIndex),
            _ => Err(AbortCode::NoObject),
        }
    }

    fn write(
        &mut self,
        index: u16,
        sub: u8,
        data: &[u8],
        state: NmtState,
    ) -> Result<(), AbortCode> {
        match (index, sub) {
            (0x2000, 0) => self.setpoint = u16::from_le_bytes(exact(data)?),
            (0x2001, 0) => match u32::from_le_bytes(exact(data)?) {
                _ if state == NmtState::Operational => return Err(AbortCode::DeviceState),
                value @ 0..=1000 => self.limited = value,
                _ => return Err(AbortCode::ValueTooHigh),
            },
            (0x2002 | 0x2003, 0) => return Err(AbortCode::ReadOnly),
            (0x2004, 0) => self.write_only = u8::from_le_bytes(exact(data)?),
            (0x2005, 0) => self.long = data.to_vec(),
            (0x2000..=0x2005, _) => return Err(AbortCode::NoSubIndex),
            _ => return Err(AbortCode::NoObject),
        }
        Ok(())
    }

    fn mappable(&self, index: u16, sub: u8, direction: PdoDirection) -> Result<u8, AbortCode> {
        match (index, sub, direction) {
            (0x2000, 0, PdoDirection::Receive) | (0x2002, 0, PdoDirection::Transmit) => Ok(16),
            (0x2000..=0x2005, 0, _) => Err(AbortCode::NotMappable),
            (0x2000..=0x2005, _, _) => Err(AbortCode::NoSubIndex),
            _ => Err(AbortCode::NoObject),
        }
    }

    fn on_sync(&mut self, sync: ReceivedSync, errors: &mut Errors<'_>) {
        self.syncs.push(sync);
        if let Some(act) = self.at_sync {
            act(self, errors);
        }
    }

    fn on_rpdo(&mut self, number: u8, data: &[u8]) -> bool {
        number != 1
            || self
                .refused
                .is_none_or(|first| data.first() != Some(&first))
    }

    fn on_heartbeat(&mut self, _: Micros, node: NodeId, state: NmtState) {
        self.heartbeats.push((node, state));
    }

    fn on_frame(&mut self, _: Micros, frame: &Frame, state: NmtState) {
        self.others.push((*frame, state));
    }

    fn storage(&mut self) -> Option<&mut dyn Storage> {
        Some(&mut self.memory)
    }

    fn sink(&mut self, index: u16, sub: u8) -> Option<&mut dyn Sink> {
        matches!((index, sub), (0x2006, 1 | 2)).then_some(&mut self.received as &mut dyn Sink)
    }

    fn reset(&mut self, scope: ResetScope) {
        self.resets.push(scope);
    }
}

pub(super) const CONFIG: Config = Config {
    node: Some(NODE),
    device_type: 0x0001_0203,
    identity: Identity {
        vendor: 1,
        product: 2,
        revision: 3,
        serial: 0x1234_5678,
    },
    name: "Test",
    heartbeat_ms: 100,
    consumers: &[(NodeId::MIN, 250)],
    rpdos: &[
        PdoConfig {
            cob_id: CobId::Fixed(0x181),
            transmission: 1,
            mapping: &[Mapping::new(0x2000, 0, 16)],
            ..PdoConfig::DEFAULT
        },
        PdoConfig {
            cob_id: CobId::PlusNode(0x200),
            transmission: 255,
            mapping: &[Mapping::new(0x2000, 0, 16)],
            ..PdoConfig::DEFAULT
        },
    ],
    tpdos: &[PdoConfig {
        cob_id: CobId::PlusNode(0x180),
        transmission: 1,
        mapping: &[Mapping::new(0x2002, 0, 16)],
        ..PdoConfig::DEFAULT
    }],
    ..Config::DEFAULT
};

/// A device with its objects and a clock.
pub(super) struct Bench {
    pub device: Device,
    pub app: Objects,
    pub now: Micros,
}

impl Bench {
    /// Off the bus yet.
    pub fn cold(config: Config) -> Self {
        Self {
            device: Device::new(config),
            app: Objects::default(),
            now: Micros(1_000),
        }
    }

    /// Booted into PRE-OPERATIONAL, boot-up frame and events taken.
    pub fn booted(config: Config) -> Self {
        let mut bench = Self::cold(config);
        bench.poll();
        bench.frames();
        bench.events();
        bench
    }

    /// In OPERATIONAL, events taken.
    pub fn operational(config: Config) -> Self {
        let mut bench = Self::booted(config);
        bench.receive(0, [1, 0]);
        bench.poll();
        bench.frames();
        bench.events();
        bench
    }

    pub fn receive<const N: usize>(&mut self, id: u16, data: [u8; N]) {
        self.device
            .on_frame(self.now, &Frame::of(id, data), &mut self.app);
    }

    pub fn poll(&mut self) {
        self.device.poll(self.now, &mut self.app);
    }

    /// Lets time pass, polling at every deadline.
    pub fn pass(&mut self, millis: u64) {
        let end = self.now + Micros::from_millis(millis);
        while let Some(deadline) = self.device.next_deadline().filter(|at| *at <= end) {
            self.now = self.now.max(deadline);
            self.poll();
        }
        self.now = end;
    }

    pub fn frames(&mut self) -> Vec<Frame> {
        core::iter::from_fn(|| self.device.pop_frame()).collect()
    }

    pub fn events(&mut self) -> Vec<Event> {
        core::iter::from_fn(|| self.device.pop_event()).collect()
    }

    /// The answer to one SDO request.
    pub fn sdo(&mut self, request: [u8; 8]) -> [u8; 8] {
        self.receive(0x605, request);
        self.poll();
        let answers: Vec<_> = self
            .frames()
            .into_iter()
            .filter(|frame| frame.id() == 0x585)
            .collect();
        assert_eq!(answers.len(), 1, "{request:02X?} got {answers:?}");
        *answers[0].padded()
    }

    /// Writes by SDO; the abort code, if it was refused.
    pub fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), u32> {
        let [low, high] = index.to_le_bytes();
        let mut request = [0x23, low, high, sub, 0, 0, 0, 0];
        request[0] |= (4 - data.len() as u8) << 2;
        request[4..4 + data.len()].copy_from_slice(data);
        let answer = self.sdo(request);
        assert_eq!(answer[1..4], request[1..4]);
        match answer[0] {
            0x60 => Ok(()),
            0x80 => Err(u32::from_le_bytes(answer[4..].try_into().unwrap())),
            other => panic!("{other:#x}"),
        }
    }

    /// Reads by SDO, expedited.
    pub fn read(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, u32> {
        let [low, high] = index.to_le_bytes();
        let answer = self.sdo([0x40, low, high, sub, 0, 0, 0, 0]);
        assert_eq!(answer[1..4], [low, high, sub]);
        match answer[0] {
            0x80 => Err(u32::from_le_bytes(answer[4..].try_into().unwrap())),
            command => Ok(answer[4..8 - usize::from(command >> 2 & 3)].to_vec()),
        }
    }
}

fn any_frame() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        Just(0u16),
        Just(0x80),
        Just(0x181),
        Just(0x205),
        Just(0x605),
        Just(0x701),
        0..0x800u16,
    ];
    (id, prop::collection::vec(any::<u8>(), 0..=8))
        .prop_map(|(id, data)| Frame::new(id, &data).unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Whatever comes in, at whatever time: no panic, and no frame that is not the device's own.
    #[test]
    fn any_frames_never_panic(
        frames in prop::collection::vec((any_frame(), 0..300_000u64, any::<bool>()), 1..200),
    ) {
        let mut bench = Bench::cold(CONFIG);
        bench.poll();
        for (frame, pause, take) in frames {
            bench.now = bench.now + Micros(pause);
            bench.device.on_frame(bench.now, &frame, &mut bench.app);
            bench.poll();
            prop_assert!(bench.device.next_deadline() > Some(bench.now));
            if take {
                bench.events();
                for frame in bench.frames() {
                    prop_assert!(matches!(frame.id(), 0x085 | 0x185 | 0x585 | 0x705), "{:?}", frame);
                }
            }
        }
    }

    /// What a device says it does not listen to makes no difference to it, whatever has been
    /// written to it before.
    #[test]
    fn frames_of_other_function_codes_change_nothing(
        frames in prop::collection::vec((any_frame(), 0..20_000u64), 1..100),
        cob_id in 0x181..0x580u32,
    ) {
        let mut benches = [Bench::booted(CONFIG), Bench::booted(CONFIG)];
        for bench in &mut benches {
            bench.write(0x1400, 1, &0x8000_0181_u32.to_le_bytes()).unwrap();
            bench.write(0x1400, 1, &cob_id.to_le_bytes()).unwrap();
            bench.receive(0, [1, 0]);
        }
        let codes = benches[0].device.function_codes();
        prop_assert!(codes & function_code_bit(u16::try_from(cob_id).unwrap()) != 0);
        prop_assert!(codes & function_code_bit(0x5FF) == 0);
        for (frame, pause) in frames {
            let [all, some] = &mut benches;
            all.device.on_frame(all.now, &frame, &mut all.app);
            if some.device.function_codes() & function_code_bit(frame.id()) != 0 {
                some.device.on_frame(some.now, &frame, &mut some.app);
            }
            for bench in &mut benches {
                bench.now = bench.now + Micros(pause);
                bench.poll();
            }
            let [all, some] = &mut benches;
            prop_assert_eq!(all.frames(), some.frames());
            prop_assert_eq!(all.events(), some.events());
            prop_assert_eq!(all.device.counters(), some.device.counters());
        }
    }
}
