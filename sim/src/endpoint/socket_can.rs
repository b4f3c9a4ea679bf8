//! A Linux CAN interface, usually a virtual one: `ip link add vcan0 type vcan; ip link set vcan0
//! up`.
//!
//! All programs on the interface together are one node of the simulated bus. A frame that the
//! interface does not take at once waits, up to [`WAITING`] of them; then the oldest is dropped and
//! counted, as a real interface drops frames that no program fetches.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};

use canopen::Frame;
use socketcan::{CanDataFrame, CanFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};

use super::Endpoint;
use crate::world::{Port, World};

/// Frames that may wait for the interface.
pub const WAITING: usize = 10_000;

/// A socket on the interface.
#[derive(Debug)]
pub struct SocketCan {
    interface: String,
    socket: CanSocket,
    port: Option<Port>,
    waiting: VecDeque<Frame>,
    dropped: u64,
}

impl SocketCan {
    /// Opens an interface that is up.
    ///
    /// # Errors
    /// When there is none of this name, or the kernel has no CAN.
    pub fn open(interface: &str) -> io::Result<Self> {
        let socket = CanSocket::open(interface)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            interface: interface.to_owned(),
            socket,
            port: None,
            waiting: VecDeque::new(),
            dropped: 0,
        })
    }

    /// Frames that the interface did not take in time.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

impl Endpoint for SocketCan {
    fn announce(&self) -> String {
        format!("socketcan {}", self.interface)
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let port = *self.port.get_or_insert_with(|| world.add_port());
        loop {
            match self.socket.read_frame() {
                Ok(frame) => {
                    if let Some(frame) = ours(&frame) {
                        world.send_from(port, frame);
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        while let Some((_, frame)) = world.take_received(port) {
            self.waiting.push_back(frame);
        }
        while let Some(frame) = self.waiting.front().and_then(theirs) {
            match self.socket.write_frame(&frame) {
                Ok(()) => drop(self.waiting.pop_front()),
                Err(error) if is_full(&error) => break,
                Err(error) => return Err(error),
            }
        }
        let surplus = self.waiting.len().saturating_sub(WAITING);
        self.waiting.drain(..surplus);
        self.dropped += surplus as u64;
        Ok(())
    }
}

/// Whether the interface only has no room at the moment.
fn is_full(error: &io::Error) -> bool {
    /// Linux: no buffer space available.
    const ENOBUFS: i32 = 105;
    error.kind() == ErrorKind::WouldBlock || error.raw_os_error() == Some(ENOBUFS)
}

/// A frame that the simulated bus carries: 11-bit data frames only.
fn ours(frame: &CanFrame) -> Option<Frame> {
    let CanFrame::Data(frame) = frame else {
        return None;
    };
    match frame.id() {
        socketcan::Id::Standard(id) => Frame::new(id.as_raw(), frame.data()),
        socketcan::Id::Extended(_) => None,
    }
}

fn theirs(frame: &Frame) -> Option<CanDataFrame> {
    CanDataFrame::new(StandardId::new(frame.id())?, frame.data())
}
