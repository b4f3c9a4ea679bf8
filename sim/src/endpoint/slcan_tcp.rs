//! slcan over TCP, for any number of clients; each is a node of its own.
//!
//! A client that does not read is dropped when [`BACKLOG`] bytes wait for it.

use std::net::TcpStream;

use super::slcan::Channel;
pub use super::stream::BACKLOG;
use super::stream::{Client, Pipe, Server};
use crate::world::{Port, World};

/// A listening endpoint and its clients.
pub type SlcanServer = Server<Channel>;

impl Client for Channel {
    const NAME: &'static str = "slcan-tcp";

    fn connect(_: &mut Vec<u8>, port: Port, world: &mut World) -> Self {
        world.set_listening(port, true);
        Self::new(port)
    }

    fn port(&self) -> Port {
        self.port()
    }

    fn exchange(&mut self, pipe: &mut Pipe<TcpStream>, world: &mut World) -> bool {
        self.exchange(&mut pipe.input, &mut pipe.output, world);
        true
    }
}
