//! slcan over a pseudo terminal: for programs that want a serial adapter.
//!
//! What is not read is kept up to the backlog of the TCP endpoints; then the channel closes, as a
//! real adapter's does when it is unplugged.

use std::io;
use std::path::Path;

use super::Endpoint;
use super::slcan::Channel;
use super::terminal::Terminal;
use crate::world::World;

/// The terminal, and the channel of the program that has it open.
#[derive(Debug)]
pub struct Pty {
    terminal: Terminal,
    channel: Option<Channel>,
}

impl Pty {
    /// Opens a terminal and links it here.
    ///
    /// # Errors
    /// When there are no terminals, or something else is at the path.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self {
            terminal: Terminal::open(path)?,
            channel: None,
        })
    }
}

impl Endpoint for Pty {
    fn announce(&self) -> String {
        format!("pty {}", self.terminal.path().display())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let channel = self
            .channel
            .get_or_insert_with(|| Channel::new(world.add_port()));
        let is_open = self.terminal.fill();
        let (input, output) = self.terminal.bytes();
        world.set_listening(channel.port(), is_open);
        if is_open || !input.is_empty() {
            channel.exchange(input, output, world);
        }
        if !self.terminal.flush() {
            channel.close();
        }
        Ok(())
    }
}
