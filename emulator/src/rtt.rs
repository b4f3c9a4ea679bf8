//! The log: SEGGER RTT's ring buffer in the guest's RAM, decoded with the image's defmt table.
//!
//! The control block is found by its symbol. It holds, after an identifier of 16 bytes and the
//! numbers of up and down channels, one descriptor per channel: name, buffer, size, write offset,
//! read offset, flags. Draining does what a debug probe does: it copies the bytes between the two
//! offsets and then advances the read offset.

use std::fmt;
use std::sync::Arc;

use crate::ram::Ram;
use defmt_decoder::{DecodeError, Encoding};

use crate::firmware::Firmware;
use crate::memory_map::RAM_BASE;

/// Severity of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Level {
    Trace,
    Debug,
    Info,
    Warn,
    Error,
    /// `defmt::println!`, which has no level.
    Print,
}

/// One decoded line of the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogLine {
    /// World time in microseconds at which it was taken out of the buffer.
    pub time_us: u64,
    /// Severity.
    pub level: Level,
    /// The firmware's own time stamp, if it makes one.
    pub timestamp: Option<String>,
    /// The message.
    pub text: String,
    /// "file:line" of the log statement.
    pub location: Option<String>,
}

impl fmt::Display for LogLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.timestamp {
            Some(timestamp) => write!(f, "{timestamp} ")?,
            None => write!(f, "{:.6} ", self.time_us as f64 * 1e-6)?,
        }
        write!(f, "{:?} {}", self.level, self.text)?;
        match &self.location {
            Some(location) => write!(f, " [{location}]"),
            None => Ok(()),
        }
    }
}

/// Reads one board's log.
#[derive(Debug, Clone)]
pub(crate) struct Log {
    ram: Arc<Ram>,
    control: Option<u32>,
    bytes: Vec<u8>,
    /// With the statement that each comes from; only who takes a line needs its location.
    lines: Vec<(Option<u64>, LogLine)>,
    /// Whether a debug probe reads the channel.
    attached: bool,
}

const UP_CHANNEL_0: u32 = 24;
/// Offset of a channel's flags; their low two bits say what happens when the buffer is full.
const FLAGS: u32 = 20;
const MODE_MASK: u32 = 3;
const BLOCK_IF_FULL: u32 = 2;

impl Log {
    pub(crate) fn new(ram: Arc<Ram>, firmware: &Firmware) -> Self {
        let control = firmware
            .variable("_SEGGER_RTT")
            .map(|symbol| symbol.address);
        Self {
            ram,
            control,
            bytes: Vec::new(),
            lines: Vec::new(),
            attached: true,
        }
    }

    /// The same log of another RAM.
    pub(crate) fn with_ram(&self, ram: &Arc<Ram>) -> Self {
        Self {
            ram: Arc::clone(ram),
            ..self.clone()
        }
    }

    /// Reads no longer, and leaves the channel in the mode in which a probe puts it: block if full.
    pub(crate) fn unplug(&mut self) -> Option<()> {
        self.attached = false;
        let at = self.control? + UP_CHANNEL_0 + FLAGS;
        let flags = (self.word(at)? & !MODE_MASK) | BLOCK_IF_FULL;
        let offset = u64::from(at.checked_sub(RAM_BASE)?);
        self.ram.write_at(offset, &flags.to_le_bytes()).ok()
    }

    fn word(&self, address: u32) -> Option<u32> {
        let mut word = [0; 4];
        self.ram
            .read_at(u64::from(address.checked_sub(RAM_BASE)?), &mut word)
            .ok()?;
        Some(u32::from_le_bytes(word))
    }

    /// Drops an unfinished frame: after a reset the encoder restarts.
    pub(crate) fn reset(&mut self) {
        self.bytes.clear();
    }

    /// Copies and decodes what the firmware has written.
    pub(crate) fn drain(
        &mut self,
        firmware: &Firmware,
        time_us: impl FnOnce() -> u64,
    ) -> Option<()> {
        if !self.attached {
            return None;
        }
        let channel = self.control? + UP_CHANNEL_0;
        let (write, read) = (self.word(channel + 12)?, self.word(channel + 16)?);
        if write == read {
            return Some(());
        }
        let (buffer, size) = (self.word(channel + 4)?, self.word(channel + 8)?);
        // Before the start-up code has run, the control block is whatever the RAM holds.
        if write >= size || read >= size || size > 0x2_0000 {
            return None;
        }
        let mut at = read;
        while at != write {
            let mut byte = [0];
            self.ram
                .read_at(u64::from((buffer + at).checked_sub(RAM_BASE)?), &mut byte)
                .ok()?;
            self.bytes.push(byte[0]);
            at = (at + 1) % size;
        }
        self.ram
            .write_at(u64::from(channel + 16 - RAM_BASE), &write.to_le_bytes())
            .ok()?;
        self.decode(firmware, time_us());
        Some(())
    }

    fn decode(&mut self, firmware: &Firmware, time_us: u64) {
        let Some(table) = firmware.defmt_table() else {
            return;
        };
        // Whole frames only: in the rzCOBS encoding a zero ends each.
        let complete = match table.encoding() {
            Encoding::Rzcobs => self
                .bytes
                .iter()
                .rposition(|byte| *byte == 0)
                .map_or(0, |at| at + 1),
            _ => self.bytes.len(),
        };
        let mut decoder = table.new_stream_decoder();
        decoder.received(&self.bytes[..complete]);
        loop {
            match decoder.decode() {
                Ok(frame) => {
                    let level = match frame.level().map(|level| level.as_str()) {
                        Some("trace") => Level::Trace,
                        Some("debug") => Level::Debug,
                        Some("info") => Level::Info,
                        Some("warn") => Level::Warn,
                        Some(_) => Level::Error,
                        None => Level::Print,
                    };
                    let line = LogLine {
                        time_us,
                        level,
                        timestamp: frame
                            .display_timestamp()
                            .map(|timestamp| timestamp.to_string()),
                        text: frame.display_message().to_string(),
                        location: None,
                    };
                    self.lines.push((Some(frame.index()), line));
                }
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => {
                    let line = LogLine {
                        time_us,
                        level: Level::Error,
                        timestamp: None,
                        text: "malformed log frame".to_owned(),
                        location: None,
                    };
                    self.lines.push((None, line));
                    if !table.encoding().can_recover() {
                        break;
                    }
                }
            }
        }
        self.bytes.drain(..complete);
    }

    pub(crate) fn take(&mut self, firmware: &Firmware) -> Vec<LogLine> {
        let lines = std::mem::take(&mut self.lines).into_iter();
        let located = lines.map(|(statement, line)| {
            let at = statement.and_then(|statement| firmware.defmt_locations().get(&statement));
            let location = at.map(|at| format!("{}:{}", at.file.display(), at.line));
            LogLine { location, ..line }
        });
        located.collect()
    }
}
