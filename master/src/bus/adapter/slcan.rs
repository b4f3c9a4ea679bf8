//! slcan: CAN frames as lines of text over a serial line (the LAWICEL protocol), or over TCP.
//!
//! `tIIILDD..` is a frame: identifier in three hex digits, length, data; a carriage return ends a
//! line. Adapters answer commands with a carriage return or, refusing, a bell; `z` acknowledges a
//! frame; `F` asks for status flags. Anything else (extended and remote frames, other status lines)
//! is passed over. A bell is no error by itself (closing a closed channel rings one), many in a row
//! are: then the adapter takes no frames.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use canopen::Frame;

use super::AdapterLink;
use super::diagnosis::{self, Diagnosis};
use crate::bus::address::BusAddress;

/// Close, 1 Mbit/s, open.
const OPEN: &[u8] = b"C\rS8\rO\r";
/// Speed of the serial line; adapters on USB ignore it.
const BAUD: u32 = 1_000_000;
/// How long a read may block before it is tried again.
const READ_TIMEOUT: Duration = Duration::from_millis(100);
/// Longest line that can hold a frame, with a time stamp.
const LONGEST: usize = 32;

/// The line of a frame, with its end.
#[must_use]
pub fn encode(frame: &Frame) -> String {
    let mut line = format!("t{:03X}{}", frame.id(), frame.data().len());
    for byte in frame.data() {
        line.push_str(&format!("{byte:02X}"));
    }
    line.push('\r');
    line
}

/// The frame on a line, without its end; `None` for every other line.
#[must_use]
pub fn decode(line: &str) -> Option<Frame> {
    let rest = line.strip_prefix('t')?;
    if !rest.is_ascii() {
        return None;
    }
    let id = u16::from_str_radix(rest.get(..3)?, 16).ok()?;
    let length = usize::from_str_radix(rest.get(3..4)?, 16).ok()?;
    let digits = rest.get(4..4 + 2 * length)?;
    let bytes: Option<Vec<u8>> = (0..length)
        .map(|n| u8::from_str_radix(digits.get(2 * n..2 * n + 2)?, 16).ok())
        .collect();
    Frame::new(id, &bytes?)
}

/// Puts lines together from what arrives in pieces.
#[derive(Default)]
struct Lines {
    line: String,
    /// Refusals since the last sign of success.
    bells: u32,
    diagnosis: Diagnosis,
}

/// So many refusals in a row mean that the adapter takes no frames.
const BELLS: u32 = 10;

impl Lines {
    /// Takes one byte; returns the frame that it completes.
    fn push(&mut self, byte: u8) -> Option<Frame> {
        match byte {
            b'\r' | b'\n' => {
                let frame = decode(&self.line);
                if let Some(flags) = self.line.strip_prefix('F')
                    && let Ok(flags) = u8::from_str_radix(flags, 16)
                {
                    self.diagnosis.report(diagnosis::of_slcan_flags(flags));
                }
                if frame.is_some() || self.line == "z" {
                    self.bells = 0;
                    self.diagnosis.report(None);
                }
                self.line.clear();
                frame
            }
            // A bell ends whatever was going on.
            0x07 => {
                self.line.clear();
                self.bells += 1;
                if self.bells == BELLS {
                    self.diagnosis.report(Some(diagnosis::REFUSES));
                }
                None
            }
            _ => {
                if self.line.len() < LONGEST {
                    self.line.push(char::from(byte));
                }
                None
            }
        }
    }
}

/// A link over a pair of ends of one connection.
fn start(
    bus: &BusAddress,
    mut input: impl Read + Send + 'static,
    mut output: impl Write + Send + 'static,
    mut inquiry: impl Write + Send + 'static,
) -> io::Result<AdapterLink> {
    output.write_all(OPEN)?;
    let mut lines = Lines::default();
    let diagnosis = lines.diagnosis.clone();
    let (mut buffer, mut filled, mut taken) = ([0; 256], 0, 0);
    let read = move || {
        loop {
            while taken < filled {
                taken += 1;
                if let Some(frame) = lines.push(buffer[taken - 1]) {
                    return Ok(frame);
                }
            }
            taken = 0;
            filled = match input.read(&mut buffer) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(count) => count,
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::TimedOut
                            | io::ErrorKind::WouldBlock
                            | io::ErrorKind::Interrupted
                    ) =>
                {
                    0
                }
                Err(error) => return Err(error),
            };
        }
    };
    let write = move |frame: &Frame| {
        output.write_all(encode(frame).as_bytes())?;
        output.flush()
    };
    let mut link = AdapterLink::start(bus, read, write);
    link.diagnosis = diagnosis;
    link.inquiry = Some(Box::new(move || inquiry.write_all(b"F\r")));
    Ok(link)
}

/// Opens a serial adapter.
pub(super) fn open_serial(bus: &BusAddress, device: &Path) -> io::Result<AdapterLink> {
    let output = serialport::new(device.to_string_lossy(), BAUD)
        .timeout(READ_TIMEOUT)
        .open()?;
    let (input, inquiry) = (output.try_clone()?, output.try_clone()?);
    start(bus, input, output, inquiry)
}

/// Connects to a server that speaks slcan.
pub(super) fn open_tcp(bus: &BusAddress, address: &str) -> io::Result<AdapterLink> {
    let output = TcpStream::connect(address)?;
    output.set_nodelay(true)?;
    let (input, inquiry) = (output.try_clone()?, output.try_clone()?);
    start(bus, input, output, inquiry)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::link::Link as _;
    use canopen::Micros;

    #[test]
    fn golden_lines() {
        let frame = Frame::of(0x181, [0x10, 0xFF, 0x00]);
        assert_eq!(encode(&frame), "t181310FF00\r");
        assert_eq!(decode("t181310FF00"), Some(frame));
        assert_eq!(encode(&Frame::of(0x80, [])), "t0800\r");
        // A time stamp after the data is passed over.
        assert_eq!(decode("t181310FF001234"), Some(frame));
    }

    #[test]
    fn anything_that_is_no_frame_is_none() {
        for line in [
            "",
            "z",
            "t",
            "t18",
            "t181",
            "t1812A",
            "t8001FF",
            "T0000018110",
            "r1810",
            "t18x1FF",
            "tüüü",
            "t1819000000000000000000",
        ] {
            assert_eq!(decode(line), None, "{line}");
        }
    }

    #[test]
    fn lines_arrive_in_pieces_and_after_noise() {
        let mut lines = Lines::default();
        let text = b"\rz\r\x07V1013\rt0801";
        assert!(text.iter().all(|byte| lines.push(*byte).is_none()));
        assert!(lines.push(b'0').is_none());
        assert!(lines.push(b'5').is_none());
        assert_eq!(lines.push(b'\r'), Some(Frame::of(0x80, [5])));
    }

    /// SYNC comes from the link's own thread while nobody calls the link, counted without gaps, and
    /// stops when the schedule is taken back.
    #[test]
    fn sync_goes_out_while_the_session_does_something_else() {
        const SYNCS: usize = 20;
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let served = std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            let mut hello = [0; OPEN.len()];
            stream.read_exact(&mut hello).unwrap();
            let (mut lines, mut frames) = (Lines::default(), Vec::new());
            let mut byte = [0];
            while frames.len() < SYNCS {
                stream.read_exact(&mut byte).unwrap();
                frames.extend(lines.push(byte[0]));
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
            let mut lines = Lines::default();
            let mut byte = [0];
            loop {
                stream.read_exact(&mut byte).unwrap();
                if let Some(frame) = lines.push(byte[0]) {
                    let answer = Frame::new(frame.id() + 1, frame.data()).unwrap();
                    stream.write_all(encode(&answer).as_bytes()).unwrap();
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
        assert!(error.contains("termination"), "{error}");
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
            let mut lines = Lines::default();
            let mut byte = [0];
            loop {
                adapter.read_exact(&mut byte).unwrap();
                if let Some(frame) = lines.push(byte[0]) {
                    let answer = Frame::new(frame.id() + 1, frame.data()).unwrap();
                    adapter.write_all(b"z\r").unwrap();
                    adapter.write_all(encode(&answer).as_bytes()).unwrap();
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

    #[test]
    fn refusals_in_a_row_are_trouble_until_a_frame_goes_through() {
        let mut lines = Lines::default();
        for _ in 0..BELLS - 1 {
            lines.push(7);
        }
        assert_eq!(lines.diagnosis.read(), None);
        lines.push(7);
        assert_eq!(lines.diagnosis.read(), Some(diagnosis::REFUSES));
        for byte in b"z\r" {
            lines.push(*byte);
        }
        assert_eq!(lines.diagnosis.read(), None);
    }
}
