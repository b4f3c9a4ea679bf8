//! A device, what happens to it, and what must hold whatever happens.
//!
//! Streams of any identifier, length and bytes reach little, so most frames here are nearly right:
//! services of the device with plausible commands, real objects, transfers carried on. In between
//! come whole transfers over a bus that loses frames, and remapped PDOs. Nothing may panic, every
//! frame sent must be one of the device's own, and a poll must leave no deadline behind (else the
//! caller would spin).
//!
//! Two programs share this file: the example beside it draws from a generator, the libFuzzer target
//! in `fuzz/` from the bytes that libFuzzer makes up.

use std::mem::Discriminant;

use canopen::client::{Outcome, SdoClient};
use canopen::{
    AbortCode, Application, CobId, Config, Device, ErrorClass, Errors, Event, Frame, Identity,
    Mapping, Micros, NmtState, NodeId, PdoConfig, PdoDirection, ReceivedSync, Sink, Storage,
    StoreProgress, StoreScope,
};

/// Where decisions come from.
#[allow(dead_code, reason = "each of the two programs uses one")]
pub enum Source<'a> {
    /// SplitMix64 from a seed, without end.
    Seed(u64),
    /// Bytes from outside, then zeros.
    Bytes(&'a [u8]),
}

impl Source<'_> {
    fn next(&mut self, bytes: usize) -> u64 {
        match self {
            Self::Seed(state) => {
                *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
                let mut z = *state;
                z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
                z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
                z ^ (z >> 31)
            }
            Self::Bytes(rest) => {
                let (now, behind) = rest.split_at(bytes.min(rest.len()));
                *rest = behind;
                now.iter()
                    .fold(0, |value, byte| value << 8 | u64::from(*byte))
            }
        }
    }

    fn below(&mut self, end: u64) -> u64 {
        let bytes = match end {
            0..=0x100 => 1,
            0x101..=0x1_0000 => 2,
            _ => 4,
        };
        self.next(bytes) % end
    }

    fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len() as u64) as usize]
    }

    fn byte(&mut self) -> u8 {
        self.next(1) as u8
    }

    /// Nothing is left to decide with.
    fn is_dry(&self) -> bool {
        matches!(self, Self::Bytes([]))
    }
}

#[derive(Default)]
struct Objects {
    values: [Vec<u8>; 4],
    image: Vec<u8>,
    /// Object 0x2004, while it is written; what was written last.
    stream: Option<Vec<u8>>,
    streamed: Vec<u8>,
    pending: bool,
    /// How it has been called: bit 0 for a SYNC, 1 for an RPDO, 2 for a heartbeat, 3 for a frame.
    calls: u8,
}

impl Application for Objects {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        let value = match (index, sub) {
            (0x2000..=0x2003, 0) => &self.values[usize::from(index - 0x2000)],
            (0x2000..=0x2003, _) => return Err(AbortCode::NoSubIndex),
            _ => return Err(AbortCode::NoObject),
        };
        let out = out.get_mut(..value.len()).ok_or(AbortCode::OutOfMemory)?;
        out.copy_from_slice(value);
        Ok(value.len())
    }

    fn write(&mut self, index: u16, sub: u8, data: &[u8], _: NmtState) -> Result<(), AbortCode> {
        match (index, sub) {
            (0x2000, 0) if data == [13] => return Err(AbortCode::InvalidValue),
            (0x2000..=0x2003, 0) => self.values[usize::from(index - 0x2000)] = data.to_vec(),
            (0x2000..=0x2003, _) => return Err(AbortCode::NoSubIndex),
            _ => return Err(AbortCode::NoObject),
        }
        Ok(())
    }

    fn mappable(&self, index: u16, sub: u8, _: PdoDirection) -> Result<u8, AbortCode> {
        match (index, sub) {
            (0x2000, 0) => Ok(8),
            (0x2001, 0) => Ok(16),
            (0x2002, 0) => Ok(32),
            _ => Err(AbortCode::NotMappable),
        }
    }

    fn on_sync(&mut self, sync: ReceivedSync, errors: &mut Errors<'_>) {
        self.calls |= 1;
        match sync.counter {
            Some(counter) if counter % 2 == 1 => errors.raise(0xFF01, ErrorClass::Generic, [0; 5]),
            _ => errors.clear(0xFF01, 0),
        }
    }

    fn on_rpdo(&mut self, _: u8, data: &[u8]) -> bool {
        self.calls |= 2;
        data.first() != Some(&13)
    }

    fn on_heartbeat(&mut self, _: Micros, _: NodeId, _: NmtState) {
        self.calls |= 4;
    }

    fn on_frame(&mut self, _: Micros, _: &Frame, _: NmtState) {
        self.calls |= 8;
    }

    fn storage(&mut self) -> Option<&mut dyn Storage> {
        Some(self)
    }

    fn sink(&mut self, index: u16, sub: u8) -> Option<&mut dyn Sink> {
        ((index, sub) == (0x2004, 0)).then_some(self as &mut dyn Sink)
    }
}

impl Sink for Objects {
    fn begin(&mut self, size: Option<u32>, _: NmtState) -> Result<(), AbortCode> {
        assert!(self.stream.is_none(), "two transfers at a time");
        if size == Some(13) {
            return Err(AbortCode::InvalidValue);
        }
        self.stream = Some(Vec::new());
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        let stream = self.stream.as_mut().expect("a transfer has begun");
        stream.extend(bytes);
        match bytes {
            [13, ..] => Err(AbortCode::Hardware),
            _ => Ok(()),
        }
    }

    fn finish(&mut self) -> Result<(), AbortCode> {
        if self.stream.as_ref().expect("a transfer has begun").len() == 77 {
            return Err(AbortCode::CannotStore);
        }
        self.streamed = self.stream.take().expect("a transfer has begun");
        Ok(())
    }

    fn cancel(&mut self) {
        self.stream.take().expect("a transfer has begun");
    }
}

impl Storage for Objects {
    fn save(&mut self, _: StoreScope, communication: &[u8]) -> Result<StoreProgress, AbortCode> {
        self.image = communication.to_vec();
        self.pending = !self.pending;
        Ok(match self.pending {
            true => StoreProgress::Pending,
            false => StoreProgress::Done,
        })
    }

    fn restore(&mut self, _: StoreScope) -> Result<StoreProgress, AbortCode> {
        self.image.clear();
        Ok(StoreProgress::Done)
    }

    fn load(&mut self, out: &mut [u8]) -> usize {
        out[..self.image.len()].copy_from_slice(&self.image);
        self.image.len()
    }

    fn save_node(&mut self, _: Option<NodeId>) -> Result<StoreProgress, AbortCode> {
        Ok(StoreProgress::Pending)
    }
}

const MAPPED: &[Mapping] = &[Mapping::new(0x2000, 0, 8), Mapping::new(0x2001, 0, 16)];

const CONFIG: Config = Config {
    node: NodeId::new(5),
    identity: Identity {
        vendor: 1,
        product: 2,
        revision: 3,
        serial: 4,
    },
    name: "a name that takes segments",
    heartbeat_ms: 100,
    storage: true,
    rpdos: &[PdoConfig {
        cob_id: CobId::PlusNode(0x200),
        mapping: MAPPED,
        ..PdoConfig::DEFAULT
    }; 4],
    tpdos: &[PdoConfig {
        cob_id: CobId::PlusNode(0x180),
        mapping: MAPPED,
        ..PdoConfig::DEFAULT
    }; 4],
    ..Config::DEFAULT
};

const INDICES: &[u16] = &[
    0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x1008, 0x1010, 0x1011, 0x1014, 0x1015, 0x1016,
    0x1017, 0x1018, 0x1019, 0x1029, 0x1F80, 0x1400, 0x1403, 0x1404, 0x1600, 0x1603, 0x1800, 0x1803,
    0x1A00, 0x1A03, 0x2000, 0x2001, 0x2002, 0x2003, 0x2004, 0x2005,
];

const VALUES: &[u32] = &[
    0,
    1,
    2,
    5,
    254,
    255,
    0x80,
    0x185,
    0x205,
    0x4000_0080,
    0x8000_0185,
    0x8000_0205,
    0x2000_0008,
    0x2001_0010,
    0x2002_0020,
    0x0005_0008,
    0x6576_6173,
    0x6461_6F6C,
    10_000,
    0x0001_0064,
];

/// The nodes a device here may have been given by LSS.
const NODES: &[u8] = &[5, 6, 127];

fn frame(random: &mut Source<'_>, node: u8) -> Frame {
    let mut data = [0; 8];
    data.iter_mut().for_each(|byte| *byte = random.byte());
    let of = |base: u16| base + u16::from(node);
    let (id, len) = match random.below(16) {
        0 => {
            data[0] = random.one_of(&[1, 1, 1, 2, 128, 129, 130, 77]);
            data[1] = random.one_of(&[0, node, 1]);
            (0, random.one_of(&[2, 2, 2, 1]))
        }
        1 | 2 => (0x080, random.one_of(&[0, 0, 1, 2])),
        3 => {
            // 13 is refused, wherever 0x2000 is mapped to.
            let byte = random.one_of(&[data[1], 13]);
            data[1..3].fill(byte);
            (of(0x200), random.one_of(&[3, 3, 8, 2]))
        }
        4 => {
            data[0] = random.one_of(&[0, 4, 5, 127, 9]);
            (0x701 + random.below(3) as u16, 1)
        }
        5 => {
            data[0] = random.one_of(&[
                0x04, 0x11, 0x13, 0x17, 0x40, 0x41, 0x42, 0x43, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B,
                0x4C, 0x51, 0x5A, 0x5E,
            ]);
            data[1..5].copy_from_slice(&(random.below(5) as u32).to_le_bytes());
            if data[0] == 0x11 {
                data[1] = random.one_of(NODES);
            }
            data[5] = random.one_of(&[0, 0, 1, 31, 32, 0x80]);
            data[6] = random.below(5) as u8;
            data[7] = random.below(5) as u8;
            (0x7E5, 8)
        }
        6 => (random.below(0x800) as u16, random.below(9) as usize),
        7..=9 => {
            // Transfers carried on.
            data[0] = random.one_of(&[
                0x00, 0x10, 0x01, 0x11, 0x60, 0x70, 0x60, 0x70, 0xA1, 0xA2, 0xA3, 0xC1, 0xD5, 0x80,
                1, 2, 3, 0x81, 0x82, 32, 0xA0,
            ]);
            data[1] = random.one_of(&[0, 1, 2, 3, 73, 127]);
            data[2] = random.one_of(&[0, 1, 2, 127, 128]);
            (of(0x600), 8)
        }
        _ => {
            data[0] = random.one_of(&[
                0x40, 0x40, 0x2F, 0x2B, 0x23, 0x23, 0x22, 0x21, 0x20, 0xA0, 0xA4, 0xC0, 0xC6, 0xE0,
            ]);
            data[1..3].copy_from_slice(&random.one_of(INDICES).to_le_bytes());
            data[3] = random.one_of(&[0, 0, 1, 1, 2, 3, 5, 6, 8, 9, 17, 18]);
            data[4..].copy_from_slice(&random.one_of(VALUES).to_le_bytes());
            (of(0x600), random.one_of(&[8, 8, 8, 8, 8, 7]))
        }
    };
    Frame::new(id, &data[..len]).expect("an identifier of 11 bits and at most 8 bytes")
}

/// A transfer by an honest client, over a bus that loses or bends a frame now and then.
/// Returns whether it came through.
fn transfer(
    random: &mut Source<'_>,
    device: &mut Device,
    objects: &mut Objects,
    now: &mut Micros,
) -> bool {
    let Some(node) = device.node() else {
        return false;
    };
    let (index, sub) = random.one_of(&[
        (0x2003, 0),
        (0x2003, 0),
        (0x1008, 0),
        (0x1016, 1),
        (0x2004, 0),
    ]);
    let longest = random.one_of(&[600, 600, 3_000]);
    let data = vec![random.byte(); random.below(longest) as usize];
    let mut client = SdoClient::new(node, Micros::from_millis(50));
    let started = match random.below(4) {
        0 => client.upload(*now, index, sub),
        1 => client.upload_block(*now, index, sub),
        2 if data.len() <= SdoClient::CAPACITY => client.download(*now, index, sub, &data),
        3 if index == 0x2004 => client.download_block_of(*now, index, sub, &data),
        _ if data.len() <= SdoClient::CAPACITY => client.download_block(*now, index, sub, &data),
        _ => client.download_block_of(*now, index, sub, &data),
    };
    started.expect("the client is new and the value fits");
    let fault = random.one_of(&[u64::MAX, u64::MAX, 20, 200]);
    let bend = |random: &mut Source<'_>, frame: Frame| match random.below(fault) {
        0 => None,
        1 => {
            let mut data = *frame.padded();
            data[random.below(8) as usize] = random.byte();
            Frame::new(frame.id(), &data)
        }
        _ => Some(frame),
    };
    loop {
        if let Some(frame) = client.pop_frame() {
            if let Some(frame) = bend(random, frame) {
                device.on_frame(*now, &frame, objects);
            }
        } else if let Some(frame) = device.pop_frame() {
            let frame = bend(random, frame);
            if let Some(end) = frame.and_then(|frame| client.on_frame(*now, &frame)) {
                return !matches!(end, Outcome::Failed(_));
            }
        } else {
            *now = client.next_deadline().unwrap_or(*now).max(*now);
            device.poll(*now, objects);
            if let Some(end) = client.poll(*now) {
                return !matches!(end, Outcome::Failed(_));
            }
        }
    }
}

/// A PDO remapped by the rules, with objects that may not be allowed or not fit.
fn remap(random: &mut Source<'_>, device: &mut Device, objects: &mut Objects, now: Micros) {
    let at = random.below(5) as u16 + random.one_of(&[0x1400, 0x1800]);
    let mut write = |index: u16, sub: u8, value: &[u8]| {
        let _ = device.write(now, index, sub, value, objects);
    };
    let cob_id = random.one_of(&[0x181u32, 0x185, 0x205, 0x080, 0x585, 0x605]);
    write(at, 1, &(cob_id | 1 << 31).to_le_bytes());
    write(
        at,
        2,
        &[random.one_of(&[0, 1, 1, 3, 240, 241, 252, 254, 255])],
    );
    write(at, 3, &[random.one_of(&[0, 0, 10]), 0]);
    write(at, 5, &[random.one_of(&[0, 0, 20]), 0]);
    write(at, 6, &[random.one_of(&[0, 0, 7])]);
    write(at + 0x200, 0, &[0]);
    let count = random.below(10) as u8;
    for sub in 1..=count {
        let entry = random.one_of(&[0x2000_0008, 0x2001_0010, 0x2002_0020, 0x0005_0008, 0]);
        write(at + 0x200, sub, &u32::to_le_bytes(entry));
    }
    write(at + 0x200, 0, &[count]);
    write(at, 1, &cob_id.to_le_bytes());
}

/// Kinds of events there are; in ten million frames all of them are seen.
#[allow(dead_code, reason = "only one of the two programs uses it")]
pub const EVENTS: usize = 16;

/// All ways in which the application is called.
#[allow(dead_code, reason = "only one of the two programs uses it")]
pub const CALLS: u8 = 0b1111;

/// What the device answered.
pub struct Totals {
    /// Frames.
    pub answers: u64,
    /// FNV-1a over them.
    pub digest: u64,
    /// Kinds of events.
    pub events: Vec<Discriminant<Event>>,
    /// Ways in which the application has been called.
    pub calls: u8,
    /// Codes of SDO aborts.
    pub aborts: Vec<u32>,
    /// Whole values that came through in a transfer of the honest client, segmented or block, up or
    /// down.
    pub transfers: u64,
}

impl Totals {
    /// Of nothing.
    pub const NONE: Self = Self {
        answers: 0,
        digest: 0xCBF2_9CE4_8422_2325,
        events: Vec::new(),
        calls: 0,
        aborts: Vec::new(),
        transfers: 0,
    };

    fn event(&mut self, event: &Event) {
        let kind = std::mem::discriminant(event);
        if !self.events.contains(&kind) {
            self.events.push(kind);
        }
    }

    fn frame(&mut self, frame: &Frame) {
        self.answers += 1;
        for byte in [frame.id() as u8, frame.len()].iter().chain(frame.data()) {
            self.digest = (self.digest ^ u64::from(*byte)).wrapping_mul(0x100_0000_01B3);
        }
        if frame.id() & 0x780 == 0x580 && frame.len() == 8 {
            let [command, _, _, _, a, b, c, d] = *frame.padded();
            let code = u32::from_le_bytes([a, b, c, d]);
            if command == 0x80 && !self.aborts.contains(&code) {
                self.aborts.push(code);
            }
        }
    }
}

/// One device, from power-on, for so many frames or until there is nothing left to decide with.
pub fn life(random: &mut Source<'_>, frames: u64, totals: &mut Totals) {
    let long = vec![7; random.below(520) as usize];
    let mut objects = Objects {
        values: [vec![0], vec![0; 2], vec![0; 4], long],
        ..Objects::default()
    };
    let node = random.one_of(&[CONFIG.node, CONFIG.node, None]);
    let mut device = Device::new(Config { node, ..CONFIG });
    let mut now = Micros(random.below(1_000_000));
    device.poll(now, &mut objects);
    for _ in 0..frames {
        if random.is_dry() {
            break;
        }
        let node = device.node().map_or(5, NodeId::get);
        let pause = random.one_of(&[0, 0, 0, 0, 100, 100, 1_000, 20_000, 1_100_000]);
        now = now + Micros(random.below(pause + 1));
        device.on_frame(now, &frame(random, node), &mut objects);
        match random.below(64) {
            0 => device
                .errors(now)
                .raise(random.byte().into(), ErrorClass::Generic, [0; 5]),
            1 => device.errors(now).clear(random.byte().into(), 0),
            2 => device.on_bus_off(now),
            3 | 4 => device.on_bus_recovered(now),
            5 => device.finish_store(random.one_of(&[Ok(()), Err(AbortCode::Hardware)])),
            6 => device.trigger_tpdo(random.byte()),
            7 if random.below(4) == 0 => {
                let done = transfer(random, &mut device, &mut objects, &mut now);
                totals.transfers += u64::from(done);
            }
            8 => remap(random, &mut device, &mut objects, now),
            _ => {}
        }
        if random.below(4) == 0 {
            continue;
        }
        settle(&mut device, &mut objects, now);
        if random.below(4) == 0 {
            continue;
        }
        while let Some(frame) = own_frame(&mut device) {
            totals.frame(&frame);
        }
        while let Some(event) = device.pop_event() {
            totals.event(&event);
        }
        totals.calls |= objects.calls;
    }
}

/// Polls, and checks that nothing is left to do.
fn settle(device: &mut Device, objects: &mut Objects, now: Micros) {
    // A second time, because a poll that changes the NMT state asks for one more.
    device.poll(now, objects);
    device.poll(now, objects);
    assert!(
        device.next_deadline().is_none_or(|next| next > now),
        "a poll has left something to do"
    );
}

/// The next frame, which must be one that this device may send.
fn own_frame(device: &mut Device) -> Option<Frame> {
    let frame = device.pop_frame()?;
    let own = [0x7E4, 0x080].contains(&frame.id())
        || frame.id() & 0x7F != 0 && NodeId::of_cob_id(frame.id()).is_some();
    assert!(own, "{frame:?} is not this device's");
    Some(frame)
}

/// One device, from power-on, and these bytes as frames: two bytes of identifier and length, two of
/// time since the last one in 16 us, the data.
#[allow(dead_code, reason = "only one of the two programs uses it")]
pub fn raw(mut bytes: &[u8]) {
    let mut objects = Objects {
        values: [vec![0], vec![0; 2], vec![0; 4], vec![7; 300]],
        ..Objects::default()
    };
    let mut device = Device::new(CONFIG);
    let mut now = Micros(0);
    device.poll(now, &mut objects);
    while let Some((&[a, b, c, d], rest)) = bytes.split_first_chunk() {
        let (id, length) = (u16::from_le_bytes([a, b & 7]), usize::from(b >> 3).min(8));
        let (data, behind) = rest.split_at(length.min(rest.len()));
        bytes = behind;
        now = now + Micros(u64::from(u16::from_le_bytes([c, d])) * 16);
        if let Some(frame) = Frame::new(id, data) {
            device.on_frame(now, &frame, &mut objects);
        }
        settle(&mut device, &mut objects, now);
        while own_frame(&mut device).is_some() {}
        while device.pop_event().is_some() {}
    }
}
