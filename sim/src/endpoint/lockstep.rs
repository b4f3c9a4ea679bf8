//! A bus whose time waits for its clients: `omnibus --bus lockstep://HOST:PORT`.
//!
//! A client says until when it waits; the world goes there, or to the next frame for that client,
//! and no further until the client waits again. With several clients time goes as far as the most
//! impatient one. So nothing is ever late, however busy the machine is: a master that stalls for a
//! second finds the world as it left it. While no client is connected time stands, once the robots
//! have booted.
//!
//! # Protocol
//!
//! Lines of text over TCP, times in µs of virtual time:
//!
//! ```text
//! server  omnibus-lockstep 1
//! server  n100000                     it is 100000 us
//! client  t1812E803                   a frame, as in slcan
//! client  w110000                     waits until 110000 us
//! server  f100350 t1828...            frames that came, each with its time
//! server  n100500                     it is 100500 us, and the client's turn
//! ```
//!
//! A client that says something else is dropped. One that hangs holds the time for all.
//!
//! # At a cable
//!
//! Where the world says so ([`World::set_adapter`]), clients are not on the bus but at the cable of
//! an emulated robot, which is their adapter: their frames go through its firmware in either
//! direction, as lines of slcan at 1 Mbaud, without the delays of USB.

use std::io::Write as _;
use std::net::TcpStream;

use can_text::slcan::{self, Answer, Answers, Command};
use canopen::{Frame, Micros};

use super::stream::{Client, Pipe, Server};
use crate::world::{Port, World};

/// What the server says first.
const GREETING: &[u8] = b"omnibus-lockstep 1\n";
/// When the robots have said that they are there: before that, time does not wait, and clients wait
/// for it.
const BOOTED: Micros = Micros(100_000);
/// Longest line, with room to spare.
const LONGEST: usize = 64;
/// What opens a robot's channel, whatever it was left in.
const OPEN: &[u8] = b"\rC\rS8\rO\r";

/// A listening endpoint and its clients.
pub type LockstepServer = Server<Session>;

/// One client.
#[derive(Debug)]
pub struct Session {
    port: Port,
    /// The robot that is its adapter, and what that says.
    cable: Option<(u8, Answers)>,
    /// Until when it waits; `None` while it is its turn.
    until: Option<Micros>,
}

impl Client for Session {
    const NAME: &'static str = "lockstep";

    fn accepts(now: Micros) -> bool {
        now >= BOOTED
    }

    fn connect(output: &mut Vec<u8>, port: Port, world: &mut World) -> Self {
        let cable = world.adapter().map(|node| (node, Answers::new()));
        world.set_listening(port, cable.is_none());
        if let Some((node, _)) = &cable {
            world.send_cable(*node, OPEN);
        }
        output.extend_from_slice(GREETING);
        send_time(output, world.now());
        Self {
            port,
            cable,
            until: None,
        }
    }

    fn port(&self) -> Port {
        self.port
    }

    fn may_talk(&self) -> bool {
        self.until.is_none()
    }

    /// Receives the client's lines and answers when its time has come; `false` for a line that is
    /// not part of the protocol.
    fn exchange(&mut self, pipe: &mut Pipe<TcpStream>, world: &mut World) -> bool {
        while let Some(end) = pipe.input.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = pipe.input.drain(..=end).collect();
            let Some(line) = line.strip_suffix(b"\n") else {
                return false;
            };
            if let Some(until) = waits(line) {
                self.until = Some(until);
            } else if let Command::Send(frame) = Command::parse(line) {
                self.send(frame, world);
            } else {
                return false;
            }
        }
        if let Some(until) = self.until {
            let before = pipe.output.len();
            for (at, frame) in self.received(world) {
                let text = slcan::frame(&frame, None);
                // Writing into a vector cannot fail.
                let _ = writeln!(pipe.output, "f{} {}", at.0, text.trim_end());
            }
            if pipe.output.len() > before || world.now() >= until {
                send_time(&mut pipe.output, world.now());
                self.until = None;
            }
        }
        pipe.input.len() <= LONGEST
    }

    fn limit<'a>(clients: impl Iterator<Item = &'a Self>, now: Micros) -> Option<Micros> {
        let waits = clients.map(|client| client.until.unwrap_or(now)).min();
        Some(waits.unwrap_or(now).max(BOOTED))
    }
}

impl Session {
    fn send(&self, frame: Frame, world: &mut World) {
        match &self.cable {
            Some((node, _)) => {
                let line = slcan::frame(&frame, None);
                world.send_cable(*node, line.as_bytes());
            }
            None => world.send_from(self.port, frame),
        }
    }

    /// What has come, with its time: that of the bus, or at which the cable has brought it.
    fn received(&mut self, world: &mut World) -> Vec<(Micros, Frame)> {
        let Some((node, answers)) = &mut self.cable else {
            return std::iter::from_fn(|| world.take_received(self.port)).collect();
        };
        let now = world.now();
        let bytes = world.take_cable(*node).into_iter();
        let frames = bytes.filter_map(|(_, byte)| match answers.push(byte)? {
            Answer::Frame(frame, _) => Some((now, frame)),
            _ => None,
        });
        frames.collect()
    }
}

fn waits(line: &[u8]) -> Option<Micros> {
    let digits = std::str::from_utf8(line.strip_prefix(b"w")?).ok()?;
    Some(Micros(digits.parse().ok()?))
}

fn send_time(output: &mut Vec<u8>, now: Micros) {
    let _ = writeln!(output, "n{}", now.0);
}
