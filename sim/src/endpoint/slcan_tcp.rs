//! slcan over TCP, for any number of clients; each is a node of its own.
//!
//! A client that does not read is dropped when [`BACKLOG`] bytes wait for it.

use std::io;
use std::net::TcpStream;

use super::Endpoint;
use super::slcan::Channel;
pub use super::stream::BACKLOG;
use super::stream::{Listener, Pipe};
use crate::world::{Port, World};

/// A listening endpoint and its clients.
#[derive(Debug)]
pub struct SlcanServer {
    listener: Listener,
    clients: Vec<(Pipe<TcpStream>, Channel)>,
    /// Ports of clients that have gone.
    spare: Vec<Port>,
}

impl SlcanServer {
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

impl Endpoint for SlcanServer {
    fn announce(&self) -> String {
        format!("slcan-tcp {}", self.listener.address())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        while let Some(pipe) = self.listener.accept() {
            let port = self.spare.pop().unwrap_or_else(|| world.add_port());
            world.set_listening(port, true);
            self.clients.push((pipe, Channel::new(port)));
        }
        let spare = &mut self.spare;
        self.clients.retain_mut(|(pipe, channel)| {
            // What came before the end still counts.
            let came = pipe.fill();
            channel.exchange(&mut pipe.input, &mut pipe.output, world);
            let alive = came.and_then(|()| pipe.flush()).is_ok();
            if !alive {
                world.set_listening(channel.port(), false);
                spare.push(channel.port());
            }
            alive
        });
        Ok(())
    }
}
