//! slcan over TCP: CAN frames as lines of text (the LAWICEL protocol), for any number of clients.
//!
//! A client opens its channel with `O`, closes it with `C`, and sends `tIIILDD..`; every command ends in a
//! carriage return and is answered with one, or with a bell when it is refused. Bit rates are accepted
//! and ignored: the bus has the one it has. Extended and remote frames are refused. Every client is a
//! node of its own: it hears the others' frames and not its own.
//!
//! Nothing here waits. What a client does not read is kept up to [`BACKLOG`] bytes; then the client is
//! dropped, because a bus does not wait for slow listeners either.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};

use canopen::Frame;

use crate::world::{Port, World};

/// Bytes that may wait for a client: some 40 000 frames.
pub const BACKLOG: usize = 1 << 20;
/// Longest command, with room to spare.
const LONGEST: usize = 64;
const OK: u8 = b'\r';
const BELL: u8 = 7;

/// A listening endpoint and its clients.
#[derive(Debug)]
pub struct SlcanServer {
    listener: TcpListener,
    clients: Vec<Client>,
    /// Ports of clients that have gone.
    spare: Vec<Port>,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    port: Port,
    open: bool,
    input: Vec<u8>,
    output: Vec<u8>,
}

/// What a line asks for.
#[derive(Debug, PartialEq, Eq)]
enum Request {
    Open,
    Close,
    Send(Frame),
    /// Something to be answered with this text.
    Say(&'static str),
    /// Something that makes no difference here.
    Accept,
    Refuse,
}

impl SlcanServer {
    /// Listens; port 0 picks a free one.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn bind(address: &str) -> std::io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            listener,
            clients: Vec::new(),
            spare: Vec::new(),
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// When the system does not say.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Takes in what clients have sent and hands out what the bus has brought. To be called often.
    pub fn exchange(&mut self, world: &mut World) {
        while let Ok((stream, _)) = self.listener.accept() {
            if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
                let port = self.spare.pop().unwrap_or_else(|| world.add_port());
                self.clients.push(Client {
                    stream,
                    port,
                    open: false,
                    input: Vec::new(),
                    output: Vec::new(),
                });
            }
        }
        for port in &self.spare {
            while world.take_received(*port).is_some() {}
        }
        let mut gone = Vec::new();
        for (n, client) in self.clients.iter_mut().enumerate() {
            if !client.exchange(world) {
                gone.push(n);
            }
        }
        for n in gone.into_iter().rev() {
            self.spare.push(self.clients.remove(n).port);
        }
    }
}

impl Client {
    /// `false` when the client has gone.
    fn exchange(&mut self, world: &mut World) -> bool {
        let mut bytes = [0; 4096];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return false,
                Ok(count) => self.input.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => return false,
            }
        }
        while let Some(end) = self.input.iter().position(|byte| *byte == OK) {
            let line: Vec<u8> = self.input.drain(..=end).take(end).collect();
            self.answer(&line, world);
        }
        if self.input.len() > LONGEST {
            self.input.clear();
            self.output.push(BELL);
        }
        while let Some((_, frame)) = world.take_received(self.port) {
            if self.open {
                print(&mut self.output, &frame);
            }
        }
        match self.stream.write(&self.output) {
            Ok(count) => drop(self.output.drain(..count)),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return false,
        }
        self.output.len() <= BACKLOG
    }

    fn answer(&mut self, line: &[u8], world: &mut World) {
        match parse(line) {
            Request::Open => self.open = true,
            Request::Close => self.open = false,
            Request::Send(frame) if self.open => {
                world.send_from(self.port, frame);
                self.output.push(b'z');
            }
            Request::Say(text) => self.output.extend_from_slice(text.as_bytes()),
            Request::Accept => {}
            Request::Send(_) | Request::Refuse => return self.output.push(BELL),
        }
        self.output.push(OK);
    }
}

fn parse(line: &[u8]) -> Request {
    match line.split_first() {
        // An empty line clears an adapter's buffer; bit rates, filters and time stamps change nothing.
        None | Some((b'S' | b's' | b'M' | b'm' | b'Z' | b'W', _)) => Request::Accept,
        Some((b'O', _)) => Request::Open,
        Some((b'C', _)) => Request::Close,
        Some((b'V', _)) => Request::Say("V1013"),
        Some((b'N', _)) => Request::Say("NOMNI"),
        Some((b'F', _)) => Request::Say("F00"),
        Some((b't', rest)) => frame(rest).map_or(Request::Refuse, Request::Send),
        Some(_) => Request::Refuse,
    }
}

/// `IIILDD..`, hexadecimal.
fn frame(text: &[u8]) -> Option<Frame> {
    let digits: Vec<u16> = text
        .iter()
        .map(|byte| char::from(*byte).to_digit(16).map(|digit| digit as u16))
        .collect::<Option<_>>()?;
    let (head, data) = digits.split_at_checked(4)?;
    let id = head[0] << 8 | head[1] << 4 | head[2];
    let bytes: Vec<u8> = data
        .chunks_exact(2)
        .map(|pair| (pair[0] << 4 | pair[1]) as u8)
        .collect();
    (data.len() == 2 * usize::from(head[3])).then(|| Frame::new(id, &bytes))?
}

fn print(output: &mut Vec<u8>, frame: &Frame) {
    // Writing into a vector cannot fail.
    let _ = write!(output, "t{:03X}{}", frame.id(), frame.data().len());
    for byte in frame.data() {
        let _ = write!(output, "{byte:02X}");
    }
    output.push(OK);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_goes_there_and_back() {
        let sent = Frame::new(0x181, &[0xE8, 0x03]).unwrap();
        assert_eq!(parse(b"t1812E803"), Request::Send(sent));
        let mut line = Vec::new();
        print(&mut line, &sent);
        assert_eq!(line, b"t1812E803\r");
        assert_eq!(
            parse(b"t0800"),
            Request::Send(Frame::new(0x80, &[]).unwrap())
        );
    }

    #[test]
    fn what_no_classic_base_frame_is_gets_refused() {
        for line in [
            "t181",
            "t1812E8",
            "t1812E80304",
            "t8000",
            "t181900112233445566778",
            "T000001811",
            "r1810",
            "x",
            "t18\u{e9}0",
        ] {
            assert_eq!(parse(line.as_bytes()), Request::Refuse, "{line}");
        }
    }
}
