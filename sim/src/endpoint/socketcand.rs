//! socketcand's protocol in raw mode, over TCP: CAN frames as text between angle brackets.
//!
//! ```text
//! server  < hi >
//! client  < open can0 >              < ok >
//! client  < rawmode >                < ok >
//! client  < send 181 2 e8 3 >
//! server  < frame 182 12.345678 0102A0 >
//! ```
//!
//! The bus is called whatever the client calls it; there is only one. Identifiers and bytes are
//! hexadecimal, times are virtual seconds. `< echo >` is echoed. The broadcast manager's commands
//! (before `rawmode`) and extended identifiers are refused with `< error .. >`. Every client is a
//! node of its own, and is dropped when [`BACKLOG`](super::stream::BACKLOG) bytes wait for it.
//!
//! python-can takes the answer to `rawmode` for itself only when nothing follows it at once; so the
//! first frames wait for [`QUIET`].

use std::io::{self, Write as _};
use std::net::TcpStream;

use canopen::{Frame, Micros};

use super::Endpoint;
use super::stream::{Listener, Pipe};
use crate::world::{Port, World};

/// How long frames wait after the answer to `rawmode`.
const QUIET: Micros = Micros(50_000);
/// Longest command, with room to spare.
const LONGEST: usize = 256;

/// How far a client has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Greeted.
    Connected,
    /// Has opened the bus.
    Open,
    /// Sends, and from this time on receives, frames.
    Raw(Micros),
}

/// What a command asks for.
#[derive(Debug, PartialEq, Eq)]
enum Request {
    Open,
    Raw,
    Send(Frame),
    Echo,
    Refuse(&'static str),
}

/// A listening endpoint and its clients.
#[derive(Debug)]
pub struct SocketcandServer {
    listener: Listener,
    clients: Vec<Client>,
    /// Ports of clients that have gone.
    spare: Vec<Port>,
}

#[derive(Debug)]
struct Client {
    pipe: Pipe<TcpStream>,
    port: Port,
    stage: Stage,
}

impl SocketcandServer {
    /// Listens; port 0 picks a free one.
    ///
    /// # Errors
    /// When the address cannot be had.
    pub fn bind(address: &str) -> io::Result<Self> {
        Ok(Self {
            listener: Listener::bind(address)?,
            clients: Vec::new(),
            spare: Vec::new(),
        })
    }
}

impl Endpoint for SocketcandServer {
    fn announce(&self) -> String {
        format!("socketcand {}", self.listener.address())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        while let Some(mut pipe) = self.listener.accept() {
            pipe.output.extend_from_slice(b"< hi >");
            self.clients.push(Client {
                pipe,
                port: self.spare.pop().unwrap_or_else(|| world.add_port()),
                stage: Stage::Connected,
            });
        }
        let spare = &mut self.spare;
        self.clients.retain_mut(|client| {
            let came = client.pipe.fill();
            client.exchange(world);
            let alive = came.and_then(|()| client.pipe.flush()).is_ok();
            if !alive {
                world.set_listening(client.port, false);
                spare.push(client.port);
            }
            alive
        });
        Ok(())
    }
}

impl Client {
    fn exchange(&mut self, world: &mut World) {
        while let Some(end) = self.pipe.input.iter().position(|byte| *byte == b'>') {
            let command: Vec<u8> = self.pipe.input.drain(..=end).collect();
            self.answer(parse(&command), world);
        }
        if self.pipe.input.len() > LONGEST {
            self.pipe.input.clear();
            self.say("< error command is too long >");
        }
        let Stage::Raw(from) = self.stage else { return };
        if world.now() < from {
            return;
        }
        while let Some((at, frame)) = world.take_received(self.port) {
            print(&mut self.pipe.output, at, &frame);
        }
    }

    fn answer(&mut self, request: Request, world: &mut World) {
        match (request, self.stage) {
            (Request::Echo, _) => self.say("< echo >"),
            (Request::Refuse(why), _) => self.say(&format!("< error {why} >")),
            (Request::Open, Stage::Connected) => {
                self.stage = Stage::Open;
                self.say("< ok >");
            }
            (Request::Raw, Stage::Open) => {
                world.set_listening(self.port, true);
                self.stage = Stage::Raw(world.now() + QUIET);
                self.say("< ok >");
            }
            (Request::Send(frame), Stage::Raw(_)) => world.send_from(self.port, frame),
            (Request::Raw | Request::Send(_), Stage::Connected) => {
                self.say("< error open a bus first >");
            }
            (Request::Send(_), Stage::Open) => self.say("< error only rawmode is served >"),
            (Request::Open, Stage::Open | Stage::Raw(_)) | (Request::Raw, Stage::Raw(_)) => {
                self.say("< error is already so >");
            }
        }
    }

    fn say(&mut self, text: &str) {
        self.pipe.output.extend_from_slice(text.as_bytes());
    }
}

/// A command with its brackets.
fn parse(command: &[u8]) -> Request {
    const SYNTAX: Request = Request::Refuse("syntax");
    let Ok(text) = std::str::from_utf8(command) else {
        return SYNTAX;
    };
    let Some((_, inside)) = text.trim_end_matches('>').split_once('<') else {
        return SYNTAX;
    };
    let mut words = inside.split_ascii_whitespace();
    match words.next() {
        Some("open") if words.clone().count() == 1 => Request::Open,
        Some("rawmode") => Request::Raw,
        Some("echo") => Request::Echo,
        Some("send") => frame(words).map_or(
            Request::Refuse("send takes a base frame: < send ID LENGTH BYTE .. >"),
            Request::Send,
        ),
        Some("open") | None => SYNTAX,
        Some(_) => Request::Refuse("unknown command"),
    }
}

/// Identifier, length, bytes, each hexadecimal.
fn frame<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Frame> {
    let id = words.next().filter(|text| text.len() <= 3)?;
    let id = u16::from_str_radix(id, 16).ok()?;
    let length = usize::from_str_radix(words.next()?, 16).ok()?;
    let bytes: Vec<u8> = words
        .map(|text| u8::from_str_radix(text, 16).ok())
        .collect::<Option<_>>()?;
    (bytes.len() == length).then(|| Frame::new(id, &bytes))?
}

fn print(output: &mut Vec<u8>, at: Micros, frame: &Frame) {
    let (seconds, micros) = (at.0 / 1_000_000, at.0 % 1_000_000);
    // Writing into a vector cannot fail. Without data two blanks are left, as socketcand leaves
    // them.
    let _ = write!(output, "< frame {:03X} {seconds}.{micros:06} ", frame.id());
    for byte in frame.data() {
        let _ = write!(output, "{byte:02X}");
    }
    output.extend_from_slice(b" >");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_as_clients_write_them() {
        let sent = Frame::new(0x181, &[0xE8, 0x03]).unwrap();
        for (text, wanted) in [
            ("< open can0 >", Request::Open),
            ("<open vcan0>", Request::Open),
            ("< rawmode >", Request::Raw),
            ("< echo >", Request::Echo),
            ("< send 181 2 e8 3 >", Request::Send(sent)),
            ("\n< send 181 2 E8 03 >", Request::Send(sent)),
            (
                "< send 080 0  >",
                Request::Send(Frame::new(0x80, &[]).unwrap()),
            ),
        ] {
            assert_eq!(parse(text.as_bytes()), wanted, "{text}");
        }
    }

    #[test]
    fn what_no_classic_base_frame_is_gets_refused() {
        for text in [
            "< send 00000181 0 >",
            "< send 800 0 >",
            "< send 181 2 1 >",
            "< send 181 1 100 >",
            "< send 181 9 1 2 3 4 5 6 7 8 9 >",
            "< send 181 >",
            "< send >",
            "< add 1 0 123 1 0 >",
            "send 181 0 >",
            "< open >",
            "< \u{e9} >",
            "<>",
        ] {
            assert!(
                matches!(parse(text.as_bytes()), Request::Refuse(_)),
                "{text}"
            );
        }
    }

    /// The form of socketcand's own source, blanks included.
    #[test]
    fn frames_as_socketcand_prints_them() {
        let mut text = Vec::new();
        print(
            &mut text,
            Micros(12_000_345),
            &Frame::new(0x81, &[0xE8, 3]).unwrap(),
        );
        print(&mut text, Micros(0), &Frame::new(0x80, &[]).unwrap());
        assert_eq!(text, b"< frame 081 12.000345 E803 >< frame 080 0.000000  >");
    }
}
