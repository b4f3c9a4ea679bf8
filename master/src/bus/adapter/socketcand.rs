//! A CAN interface of another machine, by the socketcand protocol ([`can_text::socketcand`]).
//!
//! The server greets with `< hi >`, the client asks `< open can0 >` and `< rawmode >`, each
//! answered with `< ok >` or `< error .. >`; then frames go to and fro. Whatever else the server
//! says is passed over. The server's time stamps are not used: they are of another clock. The bit
//! rate is the server's business.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::{Duration, Instant};

use can_text::socketcand::{Messages, parse_frame, send};
use canopen::Frame;

use super::AdapterLink;
use crate::bus::address::BusAddress;

/// How long connecting and each answer while opening may take.
const PATIENCE: Duration = Duration::from_secs(3);

/// Reads messages from a stream, blocking.
struct Reader {
    stream: TcpStream,
    messages: Messages,
    buffer: [u8; 1024],
    filled: usize,
    consumed: usize,
}

impl Reader {
    fn next(&mut self) -> io::Result<String> {
        loop {
            while self.consumed < self.filled {
                self.consumed += 1;
                if let Some(message) = self.messages.push(self.buffer[self.consumed - 1]) {
                    return Ok(message.to_owned());
                }
            }
            self.consumed = 0;
            self.filled = match self.stream.read(&mut self.buffer) {
                Ok(0) => {
                    let closed = "the server has closed the connection";
                    return Err(io::Error::new(io::ErrorKind::UnexpectedEof, closed));
                }
                Ok(count) => count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => 0,
                Err(error) => return Err(error),
            };
        }
    }

    /// Waits for a message, or for the server to refuse.
    fn expect(&mut self, wanted: &str, asked: &str) -> io::Result<()> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let message = self.next().map_err(|error| match error.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => io::Error::new(
                    io::ErrorKind::TimedOut,
                    format!(
                        "the server did not answer {asked} with '< {wanted} >'; check that it \
                             is socketcand"
                    ),
                ),
                _ => error,
            })?;
            if message == wanted {
                return Ok(());
            }
            if message.starts_with("error") || Instant::now() > deadline {
                return Err(io::Error::other(format!(
                    "the server answered {asked} with '< {message} >'"
                )));
            }
        }
    }
}

/// Connects to a server and opens a bus of it.
pub(super) fn open(bus: &BusAddress, address: &str, interface: &str) -> io::Result<AdapterLink> {
    let address = address
        .to_socket_addrs()?
        .next()
        .ok_or_else(|| io::Error::other("the host has no address"))?;
    let mut output = TcpStream::connect_timeout(&address, PATIENCE)?;
    output.set_nodelay(true)?;
    let input = output.try_clone()?;
    input.set_read_timeout(Some(PATIENCE))?;
    let mut reader = Reader {
        stream: input,
        messages: Messages::new(),
        buffer: [0; 1024],
        filled: 0,
        consumed: 0,
    };
    reader.expect("hi", "the connection")?;
    let open = format!("< open {interface} >");
    output.write_all(open.as_bytes())?;
    reader.expect("ok", &open)?;
    output.write_all(b"< rawmode >")?;
    reader.expect("ok", "< rawmode >")?;
    reader.stream.set_read_timeout(None)?;
    let read = move || {
        loop {
            if let Some(frame) = parse_frame(&reader.next()?) {
                return Ok(frame);
            }
        }
    };
    let write = move |frame: &Frame| output.write_all(send(frame).as_bytes());
    Ok(AdapterLink::start(bus, read, write))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::link::Link as _;
    use canopen::Micros;
    use std::net::{SocketAddr, TcpListener};
    use std::thread::JoinHandle;

    /// A server that plays a script: what it says, what it then wants to hear.
    fn scripted(script: Vec<(&'static str, &'static str)>) -> (SocketAddr, JoinHandle<()>) {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap();
        let played = std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            for (says, wants) in script {
                stream.write_all(says.as_bytes()).unwrap();
                let mut received = vec![0; wants.len()];
                stream.read_exact(&mut received).unwrap();
                assert_eq!(String::from_utf8(received).unwrap(), wants);
            }
        });
        (address, played)
    }

    fn link(address: SocketAddr) -> io::Result<AdapterLink> {
        let text = address.to_string();
        let bus = BusAddress::Socketcand(text.clone(), "can0".into());
        open(&bus, &text, "can0")
    }

    #[test]
    fn opens_a_bus_and_exchanges_frames() {
        let (address, played) = scripted(vec![
            ("< hi >", "< open can0 >"),
            ("< ok >", "< rawmode >"),
            ("< ok >", "< send 601 3 01 02 03 >"),
            ("< echo >< frame 602 1.5 010203 >", ""),
        ]);
        let mut link = link(address).unwrap();
        link.send(&Frame::of(0x601, [1, 2, 3])).unwrap();
        let answer = link.receive(Micros(link.now().0 + 5_000_000)).unwrap();
        assert_eq!(answer.unwrap().1, Frame::of(0x602, [1, 2, 3]));
        played.join().unwrap();
        let gone = link.receive(Micros(link.now().0 + 5_000_000));
        assert!(gone.is_err(), "the server has hung up");
    }

    #[test]
    fn a_bus_that_the_server_does_not_have_is_named() {
        let (address, played) = scripted(vec![
            ("< hi >", "< open can0 >"),
            ("< error could not open bus >", ""),
        ]);
        let error = link(address).err().unwrap().to_string();
        assert!(error.contains("< open can0 >"), "{error}");
        assert!(error.contains("could not open bus"), "{error}");
        played.join().unwrap();
    }
}
