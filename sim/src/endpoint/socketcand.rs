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

use std::io;
use std::net::TcpStream;

use can_text::socketcand::{Messages, Request, write_frame};
use canopen::Micros;

use super::Endpoint;
use super::stream::{Listener, Pipe};
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
    messages: Messages,
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
                messages: Messages::new(),
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
        for byte in std::mem::take(&mut self.pipe.input) {
            let request = self.messages.push(byte).map(Request::parse);
            if let Some(request) = request {
                self.answer(request, world);
            }
        }
        let Stage::Raw(from) = self.stage else { return };
        if world.now() < from {
            return;
        }
        while let Some((at, frame)) = world.take_received(self.port) {
            let mut text = String::new();
            // Writing into a string cannot fail.
            let _ = write_frame(&mut text, at.0, &frame);
            self.send(&text);
        }
    }

    fn answer(&mut self, request: Request, world: &mut World) {
        match (request, self.stage) {
            (Request::Echo, _) => self.send("< echo >"),
            (Request::Refuse(why), _) => self.send(&format!("< error {why} >")),
            (Request::Open, Stage::Connected) => {
                self.stage = Stage::Open;
                self.send("< ok >");
            }
            (Request::Raw, Stage::Open) => {
                world.set_listening(self.port, true);
                self.stage = Stage::Raw(world.now() + QUIET);
                self.send("< ok >");
            }
            (Request::SendForeign, Stage::Raw(_)) => {}
            (Request::Send(frame), Stage::Raw(_)) => world.send_from(self.port, frame),
            (Request::Raw | Request::Send(_) | Request::SendForeign, Stage::Connected) => {
                self.send("< error open a bus first >");
            }
            (Request::Send(_) | Request::SendForeign, Stage::Open) => {
                self.send("< error only rawmode is served >")
            }
            (Request::Open, Stage::Open | Stage::Raw(_)) | (Request::Raw, Stage::Raw(_)) => {
                self.send("< error is already so >");
            }
        }
    }

    fn send(&mut self, text: &str) {
        self.pipe.output.extend_from_slice(text.as_bytes());
    }
}
