//! The cable of one emulated robot on a pseudo terminal: the serial port of its ST-LINK.
//!
//! Between terminal and chip lie a line of 1 Mbaud and USB, which carries bytes once a millisecond
//! in either direction. A program that sends faster than the line waits, as the ST-LINK's buffer
//! makes it; unread bytes are lost. While the fault `cable-cut` is there, so is no terminal: a
//! program that has it open finds that out as it does with a serial port that goes.

use std::io;
use std::path::{Path, PathBuf};

use super::Endpoint;
use super::terminal::Terminal;
use crate::world::World;

/// Time between two transfers over USB at full speed.
const USB_NS: u64 = 1_000_000;
/// Bytes that the ST-LINK may have ahead of the line: two milliseconds.
const AHEAD: usize = 200;

/// The terminal of a robot.
#[derive(Debug)]
pub struct Cable {
    node: u8,
    path: PathBuf,
    /// `None` while the cable is pulled.
    terminal: Option<Terminal>,
    /// The USB frame of the last exchange.
    frame: u64,
}

impl Cable {
    /// Opens a terminal for the robot with this node and links it here.
    ///
    /// # Errors
    /// When there are no terminals, or something else is at the path.
    pub fn open(path: &Path, node: u8) -> io::Result<Self> {
        Ok(Self {
            node,
            path: path.to_owned(),
            terminal: Some(Terminal::open(path)?),
            frame: 0,
        })
    }
}

impl Endpoint for Cable {
    fn announce(&self) -> String {
        let path = self.path.display();
        format!("cable {path} of node {}", self.node)
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let frame = world.now_ns() / USB_NS;
        if std::mem::replace(&mut self.frame, frame) == frame {
            return Ok(());
        }
        if !world.is_plugged(self.node) {
            self.terminal = None;
            return Ok(());
        }
        if self.terminal.is_none() {
            self.terminal = Some(Terminal::open(&self.path)?);
        }
        let Some(terminal) = &mut self.terminal else {
            return Ok(());
        };
        terminal.fill();
        let (input, output) = terminal.bytes();
        let room = AHEAD.saturating_sub(world.on_cable(self.node));
        let now: Vec<u8> = input.drain(..room.min(input.len())).collect();
        world.send_cable(self.node, &now);
        let came = world.take_cable(self.node);
        output.extend(came.into_iter().map(|(_, byte)| byte));
        terminal.flush();
        Ok(())
    }
}
