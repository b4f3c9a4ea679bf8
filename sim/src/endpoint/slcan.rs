//! slcan, the protocol of serial CAN adapters ([`can_text::slcan`]): the adapter's end of one
//! channel.
//!
//! [`slcan_tcp`](super::slcan_tcp) and [`pty`](super::pty) carry it.

use can_text::slcan::{self, Command, Commands, STAMP_PERIOD_MS};
use canopen::Micros;

use crate::world::{Port, World};

/// What `V` and `N` are answered with.
const VERSION: &[u8] = b"V1013";
const SERIAL: &[u8] = b"NOMNI";

/// How far a channel is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Closed,
    /// Frames come, none go.
    Listening,
    Open,
}

/// One client's channel: a node of its own on the bus, which hears the others' frames and not its
/// own.
#[derive(Debug)]
pub(super) struct Channel {
    port: Port,
    mode: Mode,
    stamps: bool,
    commands: Commands,
}

impl Channel {
    /// A closed channel at this port.
    pub fn new(port: Port) -> Self {
        Self {
            port,
            mode: Mode::Closed,
            stamps: false,
            commands: Commands::new(),
        }
    }

    /// Its port, for the next client.
    pub fn port(&self) -> Port {
        self.port
    }

    /// Closes it, as after `C`, and forgets what else the client has set.
    pub fn close(&mut self) {
        *self = Self::new(self.port);
    }

    /// Answers the commands that are complete, and prints the frames that have come.
    pub fn exchange(&mut self, input: &mut Vec<u8>, output: &mut Vec<u8>, world: &mut World) {
        for byte in input.drain(..) {
            if let Some(command) = self.commands.push(byte) {
                self.answer(command, output, world);
            }
        }
        while let Some((at, frame)) = world.take_received(self.port) {
            if self.mode != Mode::Closed {
                let stamp = self.stamps.then(|| stamp(at));
                output.extend_from_slice(slcan::frame(&frame, stamp).as_bytes());
            }
        }
    }

    fn answer(&mut self, command: Command, output: &mut Vec<u8>, world: &mut World) {
        match command {
            Command::Open => self.mode = Mode::Open,
            Command::Listen => self.mode = Mode::Listening,
            Command::Close => self.mode = Mode::Closed,
            Command::Stamps(on) => self.stamps = on,
            Command::Send(frame) if self.mode == Mode::Open => {
                world.send_from(self.port, frame);
                return output.extend_from_slice(slcan::SENT);
            }
            Command::Version => output.extend_from_slice(VERSION),
            Command::Serial => output.extend_from_slice(SERIAL),
            Command::Flags => {
                return output.extend_from_slice(slcan::flags_answer(0).as_bytes());
            }
            Command::Accept => {}
            Command::Send(_) | Command::Refuse => return output.push(slcan::REFUSED),
        }
        output.push(slcan::ACCEPTED);
    }
}

/// A time as a time stamp.
fn stamp(at: Micros) -> u16 {
    (at.0 / 1_000 % u64::from(STAMP_PERIOD_MS)) as u16
}
