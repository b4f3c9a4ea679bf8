//! Real adapters: a thread reads, a channel carries, the master waits on the channel.
//!
//! The reading thread stamps every frame with this machine's monotonic clock as soon as the adapter
//! hands it over, so times are late by the adapter's own delay (about a millisecond over USB) and by
//! nothing of the master's. It blocks in the adapter and ends when the adapter fails or the master
//! has gone. The channel is unbounded: a bus at 1 Mbit/s brings at most some 9000 frames a second,
//! and a master that does not look for a minute holds 20 MB. Sending blocks until the system has
//! taken the frame.

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use canopen::{Frame, Micros};

use crate::bus::BusAddress;
use crate::link::{Link, LinkError};

pub mod slcan;
#[cfg(target_os = "linux")]
mod socket_can;

/// What a reading thread says: a frame, or why there will be no more.
type Heard = io::Result<(Micros, Frame)>;
/// Hands a frame to the adapter.
type Write = dyn FnMut(&Frame) -> io::Result<()>;

/// A link over an adapter.
pub struct AdapterLink {
    bus: String,
    started: Instant,
    heard: Receiver<Heard>,
    write: Box<Write>,
}

impl AdapterLink {
    /// Starts the reading thread. `read` blocks until a frame has come; `write` until one is taken.
    fn start(
        bus: &BusAddress,
        mut read: impl FnMut() -> io::Result<Frame> + Send + 'static,
        write: impl FnMut(&Frame) -> io::Result<()> + 'static,
    ) -> Self {
        let started = Instant::now();
        let (say, heard): (Sender<Heard>, _) = channel();
        std::thread::spawn(move || {
            loop {
                let frame = read();
                let failed = frame.is_err();
                let stamped = frame.map(|frame| (time_since(started), frame));
                if say.send(stamped).is_err() || failed {
                    return;
                }
            }
        });
        Self {
            bus: bus.to_string(),
            started,
            heard,
            write: Box::new(write),
        }
    }

    fn error(&self, problem: impl ToString) -> LinkError {
        LinkError {
            bus: self.bus.clone(),
            problem: problem.to_string(),
            remedy:
                "check the adapter's plug, the termination, and that another node is on the bus \
                     to acknowledge frames"
                    .into(),
        }
    }
}

/// Time on the link's clock, which starts with it.
fn time_since(started: Instant) -> Micros {
    Micros(u64::try_from(started.elapsed().as_micros()).unwrap_or(u64::MAX))
}

impl Link for AdapterLink {
    fn now(&self) -> Micros {
        time_since(self.started)
    }

    fn send(&mut self, frame: &Frame) -> Result<(), LinkError> {
        (self.write)(frame).map_err(|error| self.error(error))
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        let left = until.since(self.now());
        match self.heard.recv_timeout(Duration::from_micros(left.0)) {
            Ok(Ok(stamped)) => Ok(Some(stamped)),
            Ok(Err(error)) => Err(self.error(error)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(self.error("the adapter has gone")),
        }
    }
}

/// Opens a real bus.
///
/// # Errors
/// When the adapter cannot be opened; the error says what to check.
pub fn open(bus: &BusAddress) -> Result<AdapterLink, LinkError> {
    let refused = |error: io::Error, remedy: &str| LinkError {
        bus: bus.to_string(),
        problem: error.to_string(),
        remedy: remedy.into(),
    };
    match bus {
        BusAddress::Sim(_) => Err(refused(
            io::ErrorKind::Unsupported.into(),
            "a simulated bus has no adapter",
        )),
        BusAddress::Slcan(device) => slcan::open_serial(bus, device).map_err(|error| {
            refused(
                error,
                "check the device's name, that nothing else has it open, and that you may use it \
                 (group dialout on Linux)",
            )
        }),
        BusAddress::SlcanTcp(address) => slcan::open_tcp(bus, address)
            .map_err(|error| refused(error, "check host, port and that a server listens there")),
        #[cfg(target_os = "linux")]
        BusAddress::SocketCan(interface) => socket_can::open(bus, interface).map_err(|error| {
            refused(
                error,
                &format!("ip link set {interface} up type can bitrate 1000000"),
            )
        }),
        #[cfg(not(target_os = "linux"))]
        BusAddress::SocketCan(_) => Err(refused(
            io::ErrorKind::Unsupported.into(),
            "SocketCAN is Linux only; use slcan:DEVICE",
        )),
    }
}
