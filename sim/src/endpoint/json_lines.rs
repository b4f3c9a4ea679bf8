//! JSON lines over TCP, the same to any number of clients; input from them is ignored.
//!
//! A client gets the latest line when it connects and every line from then on. One that does not
//! read loses lines once [`WAITING`] bytes wait for it, whole ones only.

use std::io;
use std::net::{SocketAddr, TcpStream};

use canopen::Micros;
use serde::Serialize;

use super::stream::{Listener, Pipe};

/// Bytes that may wait for a client: some seconds of a large group.
pub const WAITING: usize = 256 * 1024;

/// A listening server and its clients.
#[derive(Debug)]
pub(super) struct JsonLines {
    listener: Listener,
    clients: Vec<Pipe<TcpStream>>,
    latest: String,
}

impl JsonLines {
    /// Listens; port 0 picks a free one.
    pub fn bind(address: &str) -> io::Result<Self> {
        Ok(Self {
            listener: Listener::bind(address)?,
            clients: Vec::new(),
            latest: String::new(),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.listener.address()
    }

    /// Where clients connect.
    pub fn listener(&self) -> &Listener {
        &self.listener
    }

    /// Hands these lines to all, and the last one to new clients. It is `now`.
    pub fn send(&mut self, lines: impl Iterator<Item = String>, now: Micros) {
        let lines: Vec<String> = lines.collect();
        for pipe in &mut self.clients {
            for line in &lines {
                if pipe.output.len() + line.len() <= WAITING {
                    pipe.output.extend_from_slice(line.as_bytes());
                }
            }
        }
        if let Some(latest) = lines.into_iter().last() {
            self.latest = latest;
        }
        // Where time waits, the next line may not come before a new client has seen this one.
        let looks = self.listener.is_time_to_look(now);
        while let Some(mut pipe) = looks.then(|| self.listener.accept()).flatten() {
            pipe.output.extend_from_slice(self.latest.as_bytes());
            self.clients.push(pipe);
        }
        self.clients.retain_mut(|pipe| {
            let came = if looks { pipe.fill() } else { Ok(()) };
            pipe.input.clear();
            came.and_then(|()| pipe.flush()).is_ok()
        });
    }
}

/// A value as a line, with its end.
pub(super) fn line(value: &impl Serialize) -> String {
    // Numbers and fixed names: a line cannot fail. A number that is not finite would be `null`.
    let mut text = serde_json::to_string(value).unwrap_or_default();
    text.push('\n');
    text
}
