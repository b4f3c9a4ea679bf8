//! A CAN bus over TCP: the ASCII protocol of LAWICEL adapters (slcan), as one client at a time
//! speaks it to us. Only data frames with 11-bit identifiers are passed on.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use canopen::{Frame, Micros};

/// The bus, and the clock beside it.
pub struct Slcan {
    listener: TcpListener,
    stream: Option<TcpStream>,
    line: Vec<u8>,
    received: std::collections::VecDeque<Frame>,
    start: Instant,
}

impl Slcan {
    /// Waits for a client on the address in the program's first argument, or else on this one.
    pub fn listen(address: &str) -> std::io::Result<Self> {
        let given = std::env::args().nth(1);
        let listener = TcpListener::bind(given.as_deref().unwrap_or(address))?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            listener,
            stream: None,
            line: Vec::new(),
            received: Default::default(),
            start: Instant::now(),
        })
    }

    /// Waits for a client; what it sends is received afterwards.
    #[allow(dead_code)] // Not every example waits.
    pub fn wait_for_client(&mut self) {
        while self.stream.is_none() && self.received.is_empty() {
            self.read();
        }
    }

    /// Time since the start.
    pub fn now(&self) -> Micros {
        Micros(
            self.start
                .elapsed()
                .as_micros()
                .try_into()
                .unwrap_or(u64::MAX),
        )
    }

    /// Sends a frame, if there is a client.
    pub fn send(&mut self, frame: &Frame) {
        let mut text = format!("t{:03X}{}", frame.id(), frame.len());
        for byte in frame.data() {
            text += &format!("{byte:02X}");
        }
        self.write(format!("{text}\r").as_bytes());
    }

    /// The next frame, or `None` after a millisecond without one.
    pub fn receive(&mut self) -> Option<Frame> {
        if self.received.is_empty() {
            self.read();
        }
        self.received.pop_front()
    }

    fn write(&mut self, bytes: &[u8]) {
        if let Some(stream) = &mut self.stream
            && stream.write_all(bytes).is_err()
        {
            self.stream = None;
        }
    }

    fn read(&mut self) {
        if let Ok((stream, _)) = self.listener.accept() {
            // A later client takes the place of an earlier one.
            let ready = stream
                .set_nonblocking(false)
                .and_then(|()| stream.set_nodelay(true))
                .and_then(|()| stream.set_read_timeout(Some(Duration::from_millis(1))));
            self.stream = ready.ok().map(|()| stream);
            self.line.clear();
        }
        let mut bytes = [0; 512];
        let Some(stream) = &mut self.stream else {
            return std::thread::sleep(Duration::from_millis(1));
        };
        match stream.read(&mut bytes) {
            Ok(0) => self.stream = None,
            Ok(len) => bytes.iter().take(len).for_each(|byte| self.take(*byte)),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => self.stream = None,
        }
    }

    fn take(&mut self, byte: u8) {
        if byte != b'\r' {
            return self.line.push(byte);
        }
        let line = std::mem::take(&mut self.line);
        if let Some(frame) = parse(&line) {
            self.received.push_back(frame);
        }
        self.write(b"\r");
    }
}

/// `t`, three digits of identifier, one of length, two for each byte.
fn parse(line: &[u8]) -> Option<Frame> {
    let digits = std::str::from_utf8(line).ok()?.strip_prefix('t')?;
    let id = u16::from_str_radix(digits.get(..3)?, 16).ok()?;
    let len: usize = digits.get(3..4)?.parse().ok()?;
    let data: Option<Vec<u8>> = (0..len)
        .map(|at| u8::from_str_radix(digits.get(4 + 2 * at..6 + 2 * at)?, 16).ok())
        .collect();
    Frame::new(id, &data?)
}
