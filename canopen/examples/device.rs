//! Node 5 with one object, 0x2000: the brightness of a lamp in percent. The bus is slcan over TCP.
mod slcan;
use canopen::{AbortCode, Application, Config, Device, NmtState, NodeId};

struct Lamp(u8);

impl Application for Lamp {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        match (index, sub) {
            (0x2000, 0) => out[0] = self.0,
            _ => return Err(AbortCode::NoObject),
        }
        Ok(1)
    }
    fn write(&mut self, index: u16, sub: u8, data: &[u8], _: NmtState) -> Result<(), AbortCode> {
        match (index, sub, data) {
            (0x2000, 0, &[percent @ 0..=100]) => self.0 = percent,
            (0x2000, 0, _) => return Err(AbortCode::InvalidValue),
            _ => return Err(AbortCode::NoObject),
        }
        println!("{} %", self.0);
        Ok(())
    }
}

fn main() -> std::io::Result<()> {
    let mut bus = slcan::Slcan::listen("127.0.0.1:29536")?;
    let (mut lamp, mut config) = (Lamp(0), Config::DEFAULT);
    config.node = NodeId::new(5);
    let mut device = Device::new(config);
    loop {
        device.poll(bus.now(), &mut lamp);
        if let Some(frame) = bus.receive() {
            device.on_frame(bus.now(), &frame, &mut lamp);
        }
        while let Some(frame) = device.pop_frame() {
            bus.send(&frame);
        }
    }
}
