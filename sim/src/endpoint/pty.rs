//! slcan over a pseudo terminal: for programs that want a serial adapter.
//!
//! A symbolic link at a path of the caller's leads to the terminal; it goes when the endpoint does.
//! The terminal is in raw mode, like the line of a real adapter; bit rates of the line change
//! nothing. One program at a time has it open. What is not read is kept up to the backlog of the
//! TCP endpoints; then the channel closes, as a real adapter's does when it is unplugged.

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::Endpoint;
use super::slcan::Channel;
use super::stream::Pipe;
use crate::world::World;

/// Where the system keeps pseudo terminals.
const TERMINALS: &str = "/dev/pts";

/// The terminal, its link, and the channel of whoever has it open.
#[derive(Debug)]
pub struct Pty {
    path: PathBuf,
    terminal: PathBuf,
    pipe: Pipe<File>,
    channel: Option<Channel>,
    /// Whether a program has the terminal open.
    taken: bool,
}

impl Pty {
    /// Opens a terminal and links it. A link to a terminal that is already there is replaced: a run
    /// that was killed leaves one behind.
    ///
    /// # Errors
    /// When there are no terminals, or something else is at the path.
    pub fn open(path: &Path) -> io::Result<Self> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let controller = openpt(flags)?;
        grantpt(&controller)?;
        unlockpt(&controller)?;
        let name = ptsname(&controller, Vec::new())?;
        let terminal = PathBuf::from(OsStr::from_bytes(name.as_bytes()));
        make_raw(&terminal)?;
        rustix::fs::fcntl_setfl(&controller, OFlags::RDWR | OFlags::NONBLOCK)?;
        if std::fs::read_link(path).is_ok_and(|to| to.starts_with(TERMINALS)) {
            std::fs::remove_file(path)?;
        }
        std::os::unix::fs::symlink(&terminal, path)?;
        Ok(Self {
            path: path.to_owned(),
            terminal,
            pipe: Pipe::new(File::from(controller)),
            channel: None,
            taken: false,
        })
    }
}

/// What the line of a real adapter does with bytes: nothing. It outlives the closing of the
/// terminal.
fn make_raw(terminal: &Path) -> io::Result<()> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let line: OwnedFd = rustix::fs::open(terminal, flags, Mode::empty())?;
    let mut settings = tcgetattr(&line)?;
    settings.make_raw();
    Ok(tcsetattr(&line, OptionalActions::Now, &settings)?)
}

impl Drop for Pty {
    fn drop(&mut self) {
        // Another run may have put its own link there.
        if std::fs::read_link(&self.path).is_ok_and(|to| to == self.terminal) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Endpoint for Pty {
    fn announce(&self) -> String {
        format!("pty {}", self.path.display())
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let channel = self
            .channel
            .get_or_insert_with(|| Channel::new(world.add_port()));
        // As long as nobody has the terminal open, reading it is an error, which is no reason to
        // give up.
        let was_taken = std::mem::replace(&mut self.taken, self.pipe.fill().is_ok());
        let waits = !self.pipe.input.is_empty();
        world.set_listening(channel.port(), self.taken);
        if self.taken || waits {
            channel.exchange(&mut self.pipe.input, &mut self.pipe.output, world);
        }
        if !self.taken || self.pipe.flush().is_err() {
            channel.close();
            self.pipe.output.clear();
            self.pipe.input.clear();
        }
        if was_taken && !self.taken {
            // What the last program did not read is not for the next one.
            let _ = rustix::termios::tcflush(
                self.pipe.stream(),
                rustix::termios::QueueSelector::IOFlush,
            );
        }
        Ok(())
    }
}
