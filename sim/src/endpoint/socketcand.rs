//! socketcand's protocol in raw mode ([`can_text::socketcand`]), over TCP.
//!
//! The bus is called whatever the client calls it; there is only one. Identifiers and bytes are
//! hexadecimal, times are virtual seconds. `< echo >` is echoed. The broadcast manager's commands
//! (before `rawmode`) are refused with `< error .. >`; extended frames are dropped without a word,
//! because socketcand answers no `send` and python-can takes an answer for a failure of the bus.
//! Every client is a node of its own, and is dropped when [`BACKLOG`](super::stream::BACKLOG) bytes
//! wait for it.
//!
//! python-can takes the answer to `rawmode` for itself only when nothing follows it at once; so the
//! first frames wait for [`QUIET`].

use std::net::TcpStream;

use can_text::socketcand::{Messages, Request, write_frame};
use canopen::Micros;

use super::stream::{Client, Pipe, Server};
use crate::world::{Port, World};

/// How long frames wait after the answer to `rawmode`.
const QUIET: Micros = Micros(50_000);

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

/// A listening endpoint and its clients.
pub type SocketcandServer = Server<Session>;

/// One client.
#[derive(Debug)]
pub struct Session {
    messages: Messages,
    port: Port,
    stage: Stage,
}

impl Client for Session {
    const NAME: &'static str = "socketcand";

    fn connect(output: &mut Vec<u8>, port: Port, _: &mut World) -> Self {
        output.extend_from_slice(b"< hi >");
        Self {
            messages: Messages::new(),
            port,
            stage: Stage::Connected,
        }
    }

    fn port(&self) -> Port {
        self.port
    }

    fn exchange(&mut self, pipe: &mut Pipe<TcpStream>, world: &mut World) -> bool {
        for byte in std::mem::take(&mut pipe.input) {
            let request = self.messages.push(byte).map(Request::parse);
            let answer = request.and_then(|request| self.answer(request, world));
            pipe.output
                .extend_from_slice(answer.unwrap_or_default().as_bytes());
        }
        let Stage::Raw(from) = self.stage else {
            return true;
        };
        if world.now() < from {
            return true;
        }
        while let Some((at, frame)) = world.take_received(self.port) {
            let mut text = String::new();
            // Writing into a string cannot fail.
            let _ = write_frame(&mut text, at.0, &frame);
            pipe.output.extend_from_slice(text.as_bytes());
        }
        true
    }
}

impl Session {
    fn answer(&mut self, request: Request, world: &mut World) -> Option<String> {
        let answer = match (request, self.stage) {
            (Request::Echo, _) => "< echo >",
            (Request::Refuse(why), _) => return Some(format!("< error {why} >")),
            (Request::Open, Stage::Connected) => {
                self.stage = Stage::Open;
                "< ok >"
            }
            (Request::Raw, Stage::Open) => {
                world.set_listening(self.port, true);
                self.stage = Stage::Raw(world.now() + QUIET);
                "< ok >"
            }
            (Request::SendForeign, Stage::Raw(_)) => return None,
            (Request::Send(frame), Stage::Raw(_)) => {
                world.send_from(self.port, frame);
                return None;
            }
            (Request::Raw | Request::Send(_) | Request::SendForeign, Stage::Connected) => {
                "< error open a bus first >"
            }
            (Request::Send(_) | Request::SendForeign, Stage::Open) => {
                "< error only rawmode is served >"
            }
            (Request::Open, Stage::Open | Stage::Raw(_)) | (Request::Raw, Stage::Raw(_)) => {
                "< error is already so >"
            }
        };
        Some(answer.to_owned())
    }
}
