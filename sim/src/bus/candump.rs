//! A log of the bus as `candump -L` writes it: `(seconds.microseconds) can0 ID#DATA`.
//!
//! The time is that of the frame's end, when receivers have it. `canplayer`, `log2asc`, cantools
//! and Wireshark read this form. Write errors (a full disk) are stored instead of returned, because
//! a lost log must not stop a moving robot; [`Candump::finish`] reports the first one.

use std::fmt;
use std::io::{self, Write};

use can_text::candump::{write_error, write_line};
use canopen::Frame;

use super::Fate;

/// Name of the virtual bus in logs.
const INTERFACE: &str = "can0";

/// The writer of a log.
pub struct Candump {
    out: Box<dyn Write + Send>,
    line: String,
    failed: Option<io::Error>,
}

impl Candump {
    /// A log into this writer; give it a buffered one.
    #[must_use]
    pub fn new(out: Box<dyn Write + Send>) -> Self {
        Self {
            out,
            line: String::new(),
            failed: None,
        }
    }

    /// Appends one frame that ended at this time, ns.
    pub fn frame(&mut self, end_ns: u64, frame: &Frame) {
        self.write(|line| write_line(line, end_ns, INTERFACE, frame));
    }

    fn write(&mut self, format: impl FnOnce(&mut String) -> fmt::Result) {
        if self.failed.is_some() {
            return;
        }
        self.line.clear();
        // Writing into a string cannot fail.
        let _ = format(&mut self.line);
        if let Err(error) = self.out.write_all(self.line.as_bytes()) {
            self.failed = Some(error);
        }
    }

    /// Appends an error frame that ended at this time, ns, as `candump -L -e` writes those of a
    /// controller that reports them: a bus error, with the missing acknowledge or the kind of
    /// violation.
    pub fn error(&mut self, end_ns: u64, fate: Fate) {
        // linux/can/error.h: CAN_ERR_FLAG; classes bus error 0x80, protocol violation 0x08,
        // acknowledge 0x20; byte 2 of a protocol violation: 1 is a bit, 2 the form, 4 the stuffing.
        let (class, violation) = match fate {
            Fate::Good => return,
            Fate::Unacknowledged { .. } => (0xA0, 0),
            Fate::Corrupt { .. } => (0x88, 1),
            Fate::Refused { .. } => (0x88, 2),
            Fate::CutOff => (0x88, 4),
            Fate::Collided { .. } => (0x88, 1),
        };
        let data = [0, 0, violation, 0, 0, 0, 0, 0];
        self.write(|line| write_error(line, end_ns, INTERFACE, class, data));
    }

    /// Writes out what is buffered.
    ///
    /// # Errors
    /// The first error since the log was opened.
    pub fn finish(&mut self) -> io::Result<()> {
        self.failed.take().map_or_else(|| self.out.flush(), Err)
    }
}

impl std::fmt::Debug for Candump {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Candump")
            .field("failed", &self.failed)
            .finish_non_exhaustive()
    }
}
