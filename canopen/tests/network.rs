//! Several devices in one process, joined by nothing but frames.

use canopen::{
    AbortCode, Application, CobId, Config, Device, Errors, Event, Mapping, Micros, NmtCommand,
    NmtState, NmtTarget, NodeId, PdoConfig, PdoDirection, ReceivedSync, client,
};

/// 0x2000: what came in, 0x2001: what goes out, both u16, and how many SYNCs.
#[derive(Default)]
struct Objects {
    input: u16,
    output: u16,
    syncs: u32,
}

impl Application for Objects {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        let value = match (index, sub) {
            (0x2000, 0) => self.input,
            (0x2001, 0) => self.output,
            _ => return Err(AbortCode::NoObject),
        };
        out[..2].copy_from_slice(&value.to_le_bytes());
        Ok(2)
    }

    fn write(&mut self, index: u16, sub: u8, data: &[u8], _: NmtState) -> Result<(), AbortCode> {
        match (index, sub, data) {
            (0x2000, 0, &[low, high]) => self.input = u16::from_le_bytes([low, high]),
            _ => return Err(AbortCode::NoObject),
        }
        Ok(())
    }

    fn on_sync(&mut self, _: ReceivedSync, _: &mut Errors<'_>) {
        self.output = self.input + 1;
        self.syncs += 1;
    }

    fn mappable(&self, index: u16, sub: u8, direction: PdoDirection) -> Result<u8, AbortCode> {
        match (index, sub, direction) {
            (0x2000, 0, PdoDirection::Receive) | (0x2001, 0, PdoDirection::Transmit) => Ok(16),
            _ => Err(AbortCode::NotMappable),
        }
    }
}

fn node(id: u8) -> NodeId {
    NodeId::new(id).expect("a node-ID")
}

/// In a ring of three, node `id` receives the value of the node before it and sends that value plus
/// one. Node 1 produces SYNC, and each node monitors the heartbeat of the one before.
fn ring(id: u8) -> Device {
    const INPUT: &[Mapping] = &[Mapping::new(0x2000, 0, 16)];
    const OUTPUT: &[Mapping] = &[Mapping::new(0x2001, 0, 16)];
    let before = if id == 1 { 3 } else { id - 1 };
    Device::new(Config {
        node: Some(node(id)),
        heartbeat_ms: 20,
        consumers: vec![(node(before), 50)].leak(),
        rpdos: vec![PdoConfig {
            cob_id: CobId::Fixed(0x180 + u16::from(before)),
            mapping: INPUT,
            ..PdoConfig::DEFAULT
        }]
        .leak(),
        tpdos: &[PdoConfig {
            cob_id: CobId::PlusNode(0x180),
            mapping: OUTPUT,
            ..PdoConfig::DEFAULT
        }],
        ..Config::DEFAULT
    })
}

#[test]
fn three_devices_in_a_ring_count_in_step_with_sync() {
    let mut devices = [1, 2, 3].map(|id| (ring(id), Objects::default()));
    let mut events = Vec::new();
    let mut now = Micros::ZERO;
    let mut commands = Vec::from([client::nmt(NmtCommand::Start, NmtTarget::All)]);
    let sync = [(0x1006, 10_000u32), (0x1005, 0x4000_0080)];
    while now < Micros::from_millis(1_000) {
        for (device, objects) in &mut devices {
            device.poll(now, objects);
            if device.state() == NmtState::PreOperational && device.node() == Some(node(1)) {
                for (index, value) in sync {
                    let value = value.to_le_bytes();
                    device
                        .write(now, index, 0, &value, objects)
                        .expect("a SYNC producer");
                }
            }
        }
        let mut frames = std::mem::take(&mut commands);
        for (device, _) in &mut devices {
            frames.extend(std::iter::from_fn(|| device.pop_frame()));
        }
        // The master is not one of them, so its command reaches all; the rest is for the others.
        for frame in &frames {
            for (device, objects) in &mut devices {
                let own = NodeId::of_cob_id(frame.id()) == device.node() && frame.id() != 0;
                let sync = frame.id() == 0x80 && device.node() == Some(node(1));
                if !own && !sync {
                    device.on_frame(now, frame, objects);
                }
            }
        }
        for (device, _) in &mut devices {
            while let Some(event) = device.pop_event() {
                events.push((device.node().map_or(0, NodeId::get), event));
            }
        }
        if frames.is_empty() {
            let next = devices
                .iter()
                .filter_map(|(device, _)| device.next_deadline());
            now = now.max(next.min().expect("heartbeats never end"));
        }
    }
    let syncs = devices.each_ref().map(|(_, objects)| objects.syncs);
    assert_eq!(syncs, [99; 3]);
    // One hop a SYNC: what node 3 sent at SYNC n is what node 1 applies at SYNC n + 1.
    let outputs = devices.each_ref().map(|(_, objects)| objects.output);
    assert_eq!(outputs, [99; 3]);
    let lost = |(_, event): &(u8, Event)| matches!(event, Event::HeartbeatLost { .. });
    assert!(!events.iter().any(lost));
    let started = |(_, event): &&(u8, Event)| matches!(event, Event::HeartbeatStarted { .. });
    assert_eq!(events.iter().filter(started).count(), 3);
}
