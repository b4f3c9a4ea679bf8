//! slcan: CAN frames as lines of text over a serial line (the LAWICEL protocol), or over TCP.
//!
//! [`can_text::slcan`] has the protocol. `F` asks for status flags. A refusal is no error by itself
//! (closing a closed channel is refused by some adapters), many in a row are: then the adapter
//! takes no frames.

use std::io::{self, Read, Write};
use std::net::TcpStream;

use can_text::slcan::{Answer, Answers, frame as line_of};
use canopen::Frame;

use super::AdapterLink;
use super::diagnosis::{self, Diagnosis};
use crate::bus::address::BusAddress;

/// Close, 1 Mbit/s, open.
const OPEN: &[u8] = b"C\rS8\rO\r";
/// Speed of the serial line; adapters on USB ignore it.
#[cfg(feature = "adapters")]
const BAUD: u32 = 1_000_000;
/// How long a read may block before it is tried again.
#[cfg(feature = "adapters")]
const READ_TIMEOUT: std::time::Duration = std::time::Duration::from_millis(100);

/// What the adapter says, byte by byte: its frames, and what it lets know about the bus.
#[derive(Default)]
struct Hearing {
    answers: Answers,
    /// Refusals since the last sign of success.
    refusals: u32,
    diagnosis: Diagnosis,
}

/// So many refusals in a row mean that the adapter takes no frames.
const REFUSALS: u32 = 10;

impl Hearing {
    /// Takes one byte; returns the frame that it completes.
    fn push(&mut self, byte: u8) -> Option<Frame> {
        match self.answers.push(byte)? {
            Answer::Frame(frame, _) => {
                self.succeeded();
                return Some(frame);
            }
            Answer::Sent => self.succeeded(),
            Answer::Flags(flags) => {
                self.diagnosis.report(diagnosis::of_slcan_flags(flags));
                self.diagnosis.answered();
            }
            Answer::Refused => {
                self.refusals += 1;
                if self.refusals == REFUSALS {
                    self.diagnosis.report(Some(diagnosis::REFUSES));
                }
            }
            Answer::Other => {}
        }
        None
    }

    fn succeeded(&mut self) {
        self.refusals = 0;
        self.diagnosis.report(None);
    }
}

/// A failure of the connection, in words: `gone` says what it means for this kind.
fn broken(error: &io::Error, gone: &str) -> io::Error {
    io::Error::new(error.kind(), format!("{gone} ({error})"))
}

/// Whether a read has only to be tried again.
fn is_for_now(kind: io::ErrorKind) -> bool {
    matches!(
        kind,
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

/// A link over a pair of ends of one connection.
fn start(
    bus: &BusAddress,
    gone: &'static str,
    mut input: impl Read + Send + 'static,
    mut output: impl Write + Send + 'static,
    mut inquiry: impl Write + Send + 'static,
) -> io::Result<AdapterLink> {
    output.write_all(OPEN)?;
    let mut hearing = Hearing::default();
    let diagnosis = hearing.diagnosis.clone();
    let (mut buffer, mut filled, mut taken) = ([0; 256], 0, 0);
    let read = move || {
        loop {
            while taken < filled {
                taken += 1;
                if let Some(frame) = hearing.push(buffer[taken - 1]) {
                    return Ok(frame);
                }
            }
            taken = 0;
            filled = match input.read(&mut buffer) {
                Ok(0) => return Err(broken(&io::ErrorKind::UnexpectedEof.into(), gone)),
                Ok(count) => count,
                Err(error) if is_for_now(error.kind()) => 0,
                Err(error) => return Err(broken(&error, gone)),
            };
        }
    };
    let write = move |frame: &Frame| {
        let written = output.write_all(line_of(frame, None).as_bytes());
        written.and_then(|()| output.flush()).map_err(|error| {
            if is_for_now(error.kind()) {
                error
            } else {
                broken(&error, gone)
            }
        })
    };
    let mut link = AdapterLink::start(bus, read, write);
    link.diagnosis = diagnosis;
    link.inquiry = Some(Box::new(move || inquiry.write_all(b"F\r")));
    Ok(link)
}

/// Whether an adapter that speaks slcan is at a port: it says its version when asked.
#[cfg(feature = "adapters")]
pub fn answers(device: &str) -> bool {
    const PATIENCE: std::time::Duration = std::time::Duration::from_millis(300);
    let port = serialport::new(device, BAUD).timeout(READ_TIMEOUT).open();
    port.is_ok_and(|port| answers_version(port, PATIENCE).unwrap_or(false))
}

#[cfg(feature = "adapters")]
fn answers_version(mut port: impl Read + Write, patience: std::time::Duration) -> io::Result<bool> {
    // The first ends whatever line it is in.
    port.write_all(b"\rC\rV\r")?;
    let deadline = std::time::Instant::now() + patience;
    let mut received = Vec::new();
    let mut buffer = [0; 256];
    while std::time::Instant::now() < deadline {
        match port.read(&mut buffer) {
            Ok(count) => received.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {}
            Err(error) => return Err(error),
        }
        // V and four digits; what was under way may stand before it.
        let is_version = |line: &[u8]| match line {
            [.., b'V', a, b, c, d] => [a, b, c, d]
                .iter()
                .all(|digit| digit.is_ascii_alphanumeric()),
            _ => false,
        };
        if received.split(|byte| *byte == b'\r').any(is_version) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Opens a serial adapter.
#[cfg(feature = "adapters")]
pub(super) fn open_serial(bus: &BusAddress, device: &std::path::Path) -> io::Result<AdapterLink> {
    let output = serialport::new(device.to_string_lossy(), BAUD)
        .timeout(READ_TIMEOUT)
        .open()?;
    let (input, inquiry) = (output.try_clone()?, output.try_clone()?);
    const GONE: &str = "the cable is gone: the serial port has closed; the robots ramp down by \
                        themselves. Plug it in and try again";
    start(bus, GONE, input, output, inquiry)
}

/// Connects to a server that speaks slcan.
pub(super) fn open_tcp(bus: &BusAddress, address: &str) -> io::Result<AdapterLink> {
    let output = TcpStream::connect(address)?;
    output.set_nodelay(true)?;
    let (input, inquiry) = (output.try_clone()?, output.try_clone()?);
    start(
        bus,
        "the server has closed the connection",
        input,
        output,
        inquiry,
    )
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use super::*;
    use crate::bus::link::Link as _;
    use canopen::Micros;

    /// SYNC comes from the link's own thread while the link is not called, counted without gaps,
    /// and stops when the schedule is taken back.
    #[test]
    fn sync_goes_out_while_the_session_does_something_else() {
        const SYNCS: usize = 20;
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let served = std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            let mut hello = [0; OPEN.len()];
            stream.read_exact(&mut hello).unwrap();
            let (mut hearing, mut frames) = (Hearing::default(), Vec::new());
            let mut byte = [0];
            while frames.len() < SYNCS {
                stream.read_exact(&mut byte).unwrap();
                frames.extend(hearing.push(byte[0]));
            }
            frames
        });
        let bus = BusAddress::SlcanTcp(address.clone());
        let mut link = open_tcp(&bus, &address).unwrap();
        let schedule = crate::bus::link::Schedule {
            first: Micros(link.now().0 + 1_000),
            period_us: 1_000,
            counter: 236,
            overflow: 240,
        };
        assert!(link.pace(Some(schedule)));
        let frames = served.join().unwrap();
        let counters = [236, 237, 238, 239, 240].into_iter().chain(1..);
        for (frame, counter) in frames.iter().zip(counters) {
            assert_eq!(*frame, Frame::of(0x80, [counter]));
        }
        link.pace(None);
        let sent = link.punctuality().unwrap();
        assert!(sent.count >= SYNCS as u64 && sent.worst_us > 0.0, "{sent}");
    }

    /// A server on this machine: it answers each frame with one of the next identifier.
    #[test]
    fn frames_go_out_and_come_in_over_tcp() {
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let served = std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            let mut hello = [0; OPEN.len()];
            stream.read_exact(&mut hello).unwrap();
            assert_eq!(hello, OPEN);
            let mut hearing = Hearing::default();
            let mut byte = [0];
            loop {
                stream.read_exact(&mut byte).unwrap();
                if let Some(frame) = hearing.push(byte[0]) {
                    let answer = Frame::new(frame.id() + 1, frame.data()).unwrap();
                    stream.write_all(line_of(&answer, None).as_bytes()).unwrap();
                    return;
                }
            }
        });
        let bus = BusAddress::SlcanTcp(address.clone());
        let mut link = open_tcp(&bus, &address).unwrap();
        link.send(&Frame::of(0x601, [1, 2, 3])).unwrap();
        let answer = link.receive(Micros(link.now().0 + 5_000_000)).unwrap();
        assert_eq!(answer.unwrap().1, Frame::of(0x602, [1, 2, 3]));
        served.join().unwrap();
        let error = link
            .receive(Micros(link.now().0 + 5_000_000))
            .unwrap_err()
            .to_string();
        assert!(error.contains("closed the connection"), "{error}");
        assert!(error.contains("the server still runs"), "{error}");
        assert!(!error.contains("termination"), "{error}");
    }

    /// An adapter at the other end of a pseudo terminal: it echoes frames with the next identifier,
    /// then refuses everything and says that it is error passive.
    #[test]
    #[cfg(unix)]
    fn a_serial_adapter_over_a_pseudo_terminal() {
        use serialport::SerialPort as _;
        let (mut adapter, slave) = serialport::TTYPort::pair().unwrap();
        let device = slave.name().unwrap();
        // It is locked for as long as it is open.
        drop(slave);
        let bus = BusAddress::Slcan(device.clone().into());
        let mut link = open_serial(&bus, Path::new(&device)).unwrap();
        adapter.set_timeout(Duration::from_secs(10)).unwrap();
        let served = std::thread::spawn(move || {
            let mut hello = [0; OPEN.len()];
            adapter.read_exact(&mut hello).unwrap();
            assert_eq!(hello, OPEN);
            adapter.write_all(b"\r\r\r").unwrap();
            let mut hearing = Hearing::default();
            let mut byte = [0];
            loop {
                adapter.read_exact(&mut byte).unwrap();
                if let Some(frame) = hearing.push(byte[0]) {
                    let answer = Frame::new(frame.id() + 1, frame.data()).unwrap();
                    adapter.write_all(b"z\r").unwrap();
                    adapter
                        .write_all(line_of(&answer, None).as_bytes())
                        .unwrap();
                    break;
                }
            }
            let mut inquiry = [0; 2];
            adapter.read_exact(&mut inquiry).unwrap();
            assert_eq!(&inquiry, b"F\r");
            adapter.write_all(b"F20\r").unwrap();
            adapter
        });
        link.send(&Frame::of(0x601, [1, 2, 3])).unwrap();
        let answer = link.receive(Micros(link.now().0 + 5_000_000)).unwrap();
        assert_eq!(answer.unwrap().1, Frame::of(0x602, [1, 2, 3]));
        let diagnosis = link.diagnosis().unwrap();
        assert!(diagnosis.contains("acknowledges"), "{diagnosis}");
        drop(served.join().unwrap());
    }

    /// A device that answers nothing but what is asked for in `knows`, each time after a while.
    #[cfg(all(unix, feature = "adapters"))]
    fn device(knows: &'static [(&'static [u8], &'static [u8])]) -> String {
        use serialport::SerialPort as _;
        let (mut device, slave) = serialport::TTYPort::pair().unwrap();
        let name = slave.name().unwrap();
        device.set_timeout(Duration::from_secs(10)).unwrap();
        std::thread::spawn(move || {
            let (mut line, mut byte) = (Vec::new(), [0]);
            let began = std::time::Instant::now();
            while began.elapsed() < Duration::from_secs(10) {
                // As long as no program has the terminal open, reading it is an error.
                if device.read_exact(&mut byte).is_err() {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
                line.push(byte[0]);
                if byte[0] == b'\r' {
                    std::thread::sleep(DELAY);
                    for (_, answer) in knows.iter().filter(|(asked, _)| *asked == line) {
                        let _ = device.write_all(answer);
                    }
                    line.clear();
                }
            }
        });
        name
    }

    /// How long a device of these tests takes for an answer.
    #[cfg(all(unix, feature = "adapters"))]
    const DELAY: Duration = Duration::from_millis(2);

    #[test]
    #[cfg(all(unix, feature = "adapters"))]
    fn an_adapter_is_one_that_says_its_version() {
        assert!(answers(&device(&[(b"\r", b"\x07"), (b"V\r", b"V1013\r")])));
        assert!(!answers(&device(&[(b"V\r", b"ERROR\r\n")])));
        assert!(!answers("/dev/there-is-none"));
    }

    #[test]
    #[cfg(all(unix, feature = "adapters"))]
    fn the_latency_is_that_of_the_answer() {
        let name = device(&[(b"F\r", b"F00\r")]);
        let bus = BusAddress::Slcan(name.clone().into());
        let mut link = open_serial(&bus, std::path::Path::new(&name)).unwrap();
        assert!(link.latency().unwrap() >= DELAY);
    }

    #[test]
    fn refusals_in_a_row_are_trouble_until_a_frame_goes_through() {
        let mut hearing = Hearing::default();
        for _ in 0..REFUSALS - 1 {
            hearing.push(7);
        }
        assert_eq!(hearing.diagnosis.read(), None);
        hearing.push(7);
        assert_eq!(hearing.diagnosis.read(), Some(diagnosis::REFUSES));
        for byte in b"z\r" {
            hearing.push(*byte);
        }
        assert_eq!(hearing.diagnosis.read(), None);
    }
}
