//! Real adapters: a thread reads, a channel carries, the master waits on the channel.
//!
//! The reading thread stamps every frame with this machine's monotonic clock as soon as the adapter
//! hands it over, so times are late by the adapter's own delay (about a millisecond over USB) and
//! by nothing of the master's. It blocks in the adapter and ends when the adapter fails or the
//! master has gone. The channel is unbounded: a bus at 1 Mbit/s brings at most some 9000 frames a
//! second, and a master that does not look for a minute holds 20 MB. Sending blocks until the
//! system has taken the frame. SYNC has a thread of its own, see [`pace`].

use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use canopen::{Frame, Micros};

use crate::bus::address::BusAddress;
use crate::bus::link::{Link, LinkError, Schedule};
use crate::bus::punctuality::Lateness;
use crate::bus::punctuality::Punctuality;
use diagnosis::Diagnosis;

mod diagnosis;
mod lockstep;
mod pace;
pub mod slcan;
#[cfg(all(feature = "adapters", target_os = "linux"))]
mod socket_can;
pub mod socketcand;

/// What a thread says: a frame on the bus, or why there will be no more.
type Received = io::Result<OnBus>;

/// A frame on the bus.
enum OnBus {
    Received(Micros, Frame),
    /// By the SYNC thread.
    Sent(Micros, Frame),
}

/// Hands a frame to the adapter.
type Write = dyn FnMut(&Frame) -> io::Result<()> + Send;

/// A link over an adapter.
pub struct AdapterLink {
    bus: String,
    /// What to check when frames stop.
    lost: &'static str,
    started: Instant,
    received: Receiver<Received>,
    sender: Sender<Received>,
    output: pace::SharedWrite,
    lateness: Arc<Mutex<Lateness>>,
    pacer: Option<pace::Pacer>,
    /// What the SYNC thread has sent.
    sent: VecDeque<(Micros, Frame)>,
    diagnosis: Diagnosis,
    /// Asks the adapter how the bus is; the answer comes through the reading thread.
    inquiry: Option<Box<dyn FnMut() -> io::Result<()> + Send>>,
}

/// How long an adapter may take to say how the bus is.
const INQUIRY: Duration = Duration::from_millis(200);
/// How often an adapter is asked to find how long that takes.
const INQUIRIES: usize = 9;

impl AdapterLink {
    /// Starts the reading thread. `read` blocks until a frame has come; `write` until one is taken.
    fn start(
        bus: &BusAddress,
        mut read: impl FnMut() -> io::Result<Frame> + Send + 'static,
        write: impl FnMut(&Frame) -> io::Result<()> + Send + 'static,
    ) -> Self {
        let started = Instant::now();
        let (sender, received): (Sender<Received>, _) = channel();
        let from_adapter = sender.clone();
        std::thread::spawn(move || {
            loop {
                let frame = read();
                let failed = frame.is_err();
                let stamped = frame.map(|frame| OnBus::Received(time_since(started), frame));
                if from_adapter.send(stamped).is_err() || failed {
                    return;
                }
            }
        });
        Self {
            bus: bus.to_string(),
            lost: match bus {
                BusAddress::SlcanTcp(_) | BusAddress::Socketcand(..) => {
                    "check that the server still runs, and the network to it"
                }
                _ => {
                    "check the adapter's plug, the termination, and that another node is on the \
                     bus to acknowledge frames"
                }
            },
            started,
            received,
            sender,
            output: Arc::new(Mutex::new(Box::new(write))),
            lateness: Arc::default(),
            pacer: None,
            sent: VecDeque::new(),
            diagnosis: Diagnosis::default(),
            inquiry: None,
        }
    }

    fn error(&self, problem: impl ToString) -> LinkError {
        LinkError {
            bus: self.bus.clone(),
            problem: problem.to_string(),
            remedy: if let Some(diagnosis) = self.diagnosis.read() {
                diagnosis.into()
            } else {
                self.lost.into()
            },
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
        pace::write(&self.output, frame).map_err(|error| self.error(error))
    }

    fn receive(&mut self, until: Micros) -> Result<Option<(Micros, Frame)>, LinkError> {
        loop {
            let left = until.since(self.now());
            return match self.received.recv_timeout(Duration::from_micros(left.0)) {
                Ok(Ok(OnBus::Received(at, frame))) => Ok(Some((at, frame))),
                Ok(Ok(OnBus::Sent(at, sync))) => {
                    self.sent.push_back((at, sync));
                    continue;
                }
                Ok(Err(error)) => Err(self.error(error)),
                Err(RecvTimeoutError::Timeout) => Ok(None),
                Err(RecvTimeoutError::Disconnected) => {
                    Err(self.error("the adapter was disconnected"))
                }
            };
        }
    }

    fn take_sent(&mut self) -> Option<(Micros, Frame)> {
        self.sent.pop_front()
    }

    fn diagnosis(&mut self) -> Option<String> {
        if let Some(inquire) = &mut self.inquiry
            && inquire().is_ok()
        {
            std::thread::sleep(INQUIRY);
        }
        self.diagnosis.read().map(Into::into)
    }

    fn latency(&mut self) -> Option<Duration> {
        let inquire = self.inquiry.as_mut()?;
        let mut took = Vec::new();
        for _ in 0..INQUIRIES {
            let (asked, seen) = (Instant::now(), self.diagnosis.inquiries());
            inquire().ok()?;
            while self.diagnosis.inquiries() == seen {
                if asked.elapsed() > INQUIRY {
                    return None;
                }
                std::thread::sleep(Duration::from_micros(20));
            }
            took.push(asked.elapsed());
        }
        took.sort_unstable();
        took.get(took.len() / 2).copied()
    }

    fn pace(&mut self, schedule: Option<Schedule>) -> bool {
        // The old thread ends before a new one starts: two SYNC counters would be two masters.
        self.pacer = None;
        self.pacer = schedule.map(|schedule| {
            pace::Pacer::start(
                schedule,
                self.started,
                Arc::clone(&self.output),
                Arc::clone(&self.lateness),
                self.sender.clone(),
            )
        });
        true
    }

    fn punctuality(&self) -> Option<Punctuality> {
        let lateness = self.lateness.lock();
        Some(lateness.unwrap_or_else(PoisonError::into_inner).read())
    }
}

/// Opens a bus that is not in this process.
///
/// # Errors
/// When it cannot be opened; the error says what to check.
pub fn open(bus: &BusAddress) -> Result<Box<dyn Link>, LinkError> {
    let opened: io::Result<Box<dyn Link>> = match bus {
        #[cfg(feature = "adapters")]
        BusAddress::Auto => return open(&crate::bus::auto::find()?),
        BusAddress::Sim(_) => Err(io::ErrorKind::Unsupported.into()),
        #[cfg(not(feature = "adapters"))]
        BusAddress::Auto | BusAddress::Slcan(_) | BusAddress::SocketCan(_) => {
            Err(io::Error::other(
                "this program was built without serial ports and SocketCAN (cargo feature adapters)",
            ))
        }
        #[cfg(feature = "adapters")]
        BusAddress::Slcan(device) => slcan::open_serial(bus, device).map(boxed),
        BusAddress::SlcanTcp(address) => slcan::open_tcp(bus, address).map(boxed),
        BusAddress::Lockstep(address) => lockstep::open(bus.to_string(), address).map(boxed),
        BusAddress::Socketcand(address, interface) => {
            socketcand::open(bus, address, interface).map(boxed)
        }
        #[cfg(all(feature = "adapters", target_os = "linux"))]
        BusAddress::SocketCan(interface) => socket_can::open(bus, interface).map(boxed),
        #[cfg(all(feature = "adapters", not(target_os = "linux")))]
        BusAddress::SocketCan(_) => Err(io::ErrorKind::Unsupported.into()),
    };
    opened.map_err(|error| LinkError {
        bus: bus.to_string(),
        problem: error.to_string(),
        remedy: remedy(bus, error.kind()),
    })
}

fn boxed(link: impl Link + 'static) -> Box<dyn Link> {
    Box::new(link)
}

/// What to check when a bus cannot be opened.
fn remedy(bus: &BusAddress, kind: io::ErrorKind) -> String {
    let refused = kind == io::ErrorKind::ConnectionRefused;
    match bus {
        BusAddress::Sim(_) => "a simulated bus has no adapter".into(),
        BusAddress::Auto => "give slcan:DEVICE".into(),
        BusAddress::Slcan(device) => match kind {
            io::ErrorKind::PermissionDenied => format!(
                "you have no permission to use {}; on Linux add yourself to the group dialout \
                 (sudo usermod -aG dialout $USER) and log in again",
                device.display()
            ),
            _ => "check the device's name (ls /dev/ttyACM* /dev/ttyUSB*), its plug, that no other \
                program has it open, and that you have permission to use it (group dialout on \
                Linux)"
                .into(),
        },
        BusAddress::SlcanTcp(_) | BusAddress::Socketcand(..) | BusAddress::Lockstep(_)
            if refused =>
        {
            "nothing listens there; start the server (omnibus-sim serve prints its addresses) or \
             correct the port"
                .into()
        }
        BusAddress::Lockstep(_) => {
            "check host and port, and that omnibus-sim serve was started with --lockstep".into()
        }
        BusAddress::SlcanTcp(_) => "check host and port, and that the server speaks slcan".into(),
        BusAddress::Socketcand(_, interface) => {
            format!("check host and port, and that socketcand was started with {interface} (-i)")
        }
        BusAddress::SocketCan(interface) if cfg!(target_os = "linux") => format!(
            "check the name (ip link show type can); bring it up with: \
             sudo ip link set {interface} up type can bitrate 1000000"
        ),
        BusAddress::SocketCan(_) => {
            "only Linux has SocketCAN; use slcan:DEVICE or socketcand://HOST:PORT/INTERFACE".into()
        }
    }
}
