//! A log of the bus as `candump -L` writes it: `(seconds.microseconds) can0 ID#DATA`.
//!
//! The time is that of the frame's end, when receivers have it. `canplayer`, `log2asc`, cantools and
//! Wireshark read this form. Writing errors (a full disk) are kept, not thrown: a lost log must not stop
//! a moving robot; [`Candump::finish`] reports the first one.

use std::fmt::Write as _;
use std::io::{self, Write};

use canopen::Frame;

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
        if self.failed.is_some() {
            return;
        }
        self.line.clear();
        format_line(&mut self.line, end_ns, frame);
        if let Err(error) = self.out.write_all(self.line.as_bytes()) {
            self.failed = Some(error);
        }
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

fn format_line(line: &mut String, end_ns: u64, frame: &Frame) {
    let us = end_ns / 1_000;
    // Writing into a string cannot fail.
    let _ = write!(
        line,
        "({}.{:06}) can0 {:03X}#",
        us / 1_000_000,
        us % 1_000_000,
        frame.id()
    );
    for byte in frame.data() {
        let _ = write!(line, "{byte:02X}");
    }
    line.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_what_candump_writes() {
        let mut line = String::new();
        format_line(
            &mut line,
            12_000_345_678,
            &Frame::new(0x81, &[0xE8, 0x03]).unwrap(),
        );
        assert_eq!(line, "(12.000345) can0 081#E803\n");
        line.clear();
        format_line(&mut line, 0, &Frame::new(0x80, &[]).unwrap());
        assert_eq!(line, "(0.000000) can0 080#\n");
    }
}
