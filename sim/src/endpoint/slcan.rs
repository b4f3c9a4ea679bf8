//! slcan, the protocol of serial CAN adapters ([`can_text::slcan`]), for one client at a port of
//! the bus.
//!
//! [`slcan_tcp`](super::slcan_tcp) and [`pty`](super::pty) carry it.

use can_text::slcan::{self, STAMP_PERIOD_MS, Step};
use canopen::Micros;

use crate::world::{Port, World};

/// Serial number of every adapter here.
const NUMBER: u32 = 0x0051;

/// One client's channel: a node of its own on the bus, which hears the others' frames and not its
/// own.
#[derive(Debug)]
pub struct Channel {
    port: Port,
    line: slcan::Channel,
}

impl Channel {
    /// A closed channel at this port.
    pub fn new(port: Port) -> Self {
        let line = slcan::Channel::new(NUMBER);
        Self { port, line }
    }

    /// Its port, for the next client.
    pub fn port(&self) -> Port {
        self.port
    }

    /// Closes it, and forgets what else the client has said.
    pub fn close(&mut self) {
        *self = Self::new(self.port);
    }

    /// Answers the commands that are complete, and prints the frames that have come.
    pub fn exchange(&mut self, input: &mut Vec<u8>, output: &mut Vec<u8>, world: &mut World) {
        for byte in input.drain(..) {
            match self.line.push(byte) {
                Some(Step::Answer(answer)) => output.extend_from_slice(answer.as_bytes()),
                Some(Step::Send(frame)) => {
                    world.send_from(self.port, frame);
                    output.extend_from_slice(slcan::SENT);
                }
                Some(Step::Flags) => {
                    output.extend_from_slice(slcan::flags_answer(0).as_bytes());
                }
                None => {}
            }
        }
        while let Some((at, frame)) = world.take_received(self.port) {
            if self.line.is_open() {
                let stamp = self.line.stamps().then(|| stamp(at));
                output.extend_from_slice(slcan::frame(&frame, stamp).as_bytes());
            }
        }
    }
}

/// A time as a time stamp.
fn stamp(at: Micros) -> u16 {
    (at.0 / 1_000 % u64::from(STAMP_PERIOD_MS)) as u16
}
