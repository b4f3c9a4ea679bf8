//! A pseudo terminal under a name of the caller's.
//!
//! A symbolic link at a path of the caller's leads to the terminal; it goes when the endpoint does.
//! The terminal is in raw mode, like the line of a real adapter; bit rates of the line change
//! nothing. One program at a time has it open.

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

use super::stream::Pipe;

/// Where the system keeps pseudo terminals.
const TERMINALS: &str = "/dev/pts";

/// The terminal and its link.
#[derive(Debug)]
pub struct Terminal {
    path: PathBuf,
    terminal: PathBuf,
    pipe: Pipe<File>,
    /// Whether a program has the terminal open.
    is_open: bool,
}

impl Terminal {
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
            is_open: false,
        })
    }

    /// Its name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads what has come. Whether a program has the terminal open, or had.
    pub fn fill(&mut self) -> bool {
        // As long as no program has the terminal open, reading it is an error, which is no reason
        // to give up.
        let was_open = std::mem::replace(&mut self.is_open, self.pipe.fill().is_ok());
        if was_open && !self.is_open {
            // What the last program did not read is not for the next one.
            let _ = tcflush(self.pipe.stream(), QueueSelector::IOFlush);
        }
        self.is_open
    }

    /// What has come and what is to go.
    pub fn bytes(&mut self) -> (&mut Vec<u8>, &mut Vec<u8>) {
        (&mut self.pipe.input, &mut self.pipe.output)
    }

    /// Writes what can be written now; `false` when there is no program, or it has read nothing for
    /// long. Then what waits is dropped.
    pub fn flush(&mut self) -> bool {
        let works = self.is_open && self.pipe.flush().is_ok();
        if !works {
            self.pipe.output.clear();
        }
        works
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

impl Drop for Terminal {
    fn drop(&mut self) {
        // Another run may have put its own link there.
        if std::fs::read_link(&self.path).is_ok_and(|to| to == self.terminal) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}
