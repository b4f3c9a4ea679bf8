//! A log of the bus as `candump -L` writes it: `(seconds.microseconds) can0 ID#DATA`.
//!
//! The time is that of the frame's end, when receivers have it. `canplayer`, `log2asc`, cantools
//! and Wireshark read this form. Writing errors (a full disk) are kept, not thrown: a lost log must
//! not stop a moving robot; [`Candump::finish`] reports the first one.

use std::fmt::Write as _;
use std::io::{self, Write};

use canopen::Frame;

use super::Fate;

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
        self.write(|line| format_line(line, end_ns, frame));
    }

    fn write(&mut self, format: impl FnOnce(&mut String)) {
        if self.failed.is_some() {
            return;
        }
        self.line.clear();
        format(&mut self.line);
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
        self.write(|line| {
            let us = end_ns / 1_000;
            let (s, us) = (us / 1_000_000, us % 1_000_000);
            // Writing into a string cannot fail.
            let _ = writeln!(
                line,
                "({s}.{us:06}) can0 200000{class:02X}#0000{violation:02X}0000000000"
            );
        });
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

/// What a line of a log is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Line {
    /// A classic base frame with its time, ns.
    Frame(u64, Frame),
    /// A frame that this bus does not carry: extended, remote, error, CAN FD.
    Foreign,
    /// Nothing.
    Empty,
    /// No line of `candump -L`.
    Bad,
}

/// Reads a line of `candump -L`, with or without the direction at its end.
#[must_use]
pub fn parse_line(line: &str) -> Line {
    let mut words = line.split_ascii_whitespace();
    let (time, frame) = match (words.next(), words.next(), words.next()) {
        (None, _, _) => return Line::Empty,
        (Some(time), Some(_), Some(frame)) => (time, frame),
        (Some(_), _, _) => return Line::Bad,
    };
    let direction = words.next().is_none_or(|word| word == "R" || word == "T");
    match (time_ns(time), frame.split_once('#')) {
        (Some(at), Some((id, data))) if direction && words.next().is_none() => {
            frame_or_foreign(at, id, data)
        }
        _ => Line::Bad,
    }
}

fn frame_or_foreign(at_ns: u64, id: &str, data: &str) -> Line {
    let is_hex = |text: &str| text.bytes().all(|byte| byte.is_ascii_hexdigit());
    // `#` begins the flags of CAN FD, `R` a remote frame and its length.
    let rest = data.trim_start_matches(['#', 'R']);
    if !is_hex(id) || !is_hex(rest) {
        return Line::Bad;
    }
    match id.len() {
        8 => return Line::Foreign,
        3 if rest.len() != data.len() => return Line::Foreign,
        3 => {}
        _ => return Line::Bad,
    }
    let bytes: Option<Vec<u8>> = (0..data.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(data.get(at..at + 2)?, 16).ok())
        .collect();
    let id = u16::from_str_radix(id, 16).ok();
    match id.zip(bytes).and_then(|(id, bytes)| Frame::new(id, &bytes)) {
        Some(frame) => Line::Frame(at_ns, frame),
        None => Line::Bad,
    }
}

/// `(SECONDS.FRACTION)`, exactly.
fn time_ns(text: &str) -> Option<u64> {
    let text = text.strip_prefix('(')?.strip_suffix(')')?;
    let (seconds, fraction) = text.split_once('.')?;
    let digits = fraction.get(..fraction.len().min(9))?;
    let scale = 10_u64.pow(9 - u32::try_from(digits.len()).ok()?);
    let nanos = digits.parse::<u64>().ok()?.checked_mul(scale)?;
    let seconds: u64 = seconds.parse().ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
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

    #[test]
    fn what_is_written_is_read() {
        for data in [&[][..], &[0xE8, 0x03], &[0; 8]] {
            let frame = Frame::new(0x7FF, data).unwrap();
            let mut line = String::new();
            format_line(&mut line, 12_000_345_000, &frame);
            assert_eq!(parse_line(&line), Line::Frame(12_000_345_000, frame));
        }
    }
}
