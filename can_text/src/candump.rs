//! Logs of the bus as `candump -L` writes them: `(seconds.microseconds) can0 ID#DATA`.
//!
//! `canplayer`, `log2asc`, cantools and Wireshark read this form. An identifier of eight digits is
//! an extended one (or, with bit 29 set, an error frame); `##` begins the flags of CAN FD, `#R` a
//! remote frame; `_9` to `_F` behind the data is a DLC above 8; a last word `R` or `T` is the
//! direction. Source: lib.c and candump.c of can-utils.

use core::fmt::{self, Write};

use canopen::Frame;

use crate::hex;

/// Writes the line of a frame that ended at this time on this interface, with its end.
///
/// # Errors
/// Those of the writer.
pub fn write_line(out: &mut impl Write, at_ns: u64, interface: &str, frame: &Frame) -> fmt::Result {
    write_time(out, at_ns)?;
    write!(out, " {interface} {:03X}#", frame.id())?;
    for byte in frame.data() {
        write!(out, "{byte:02X}")?;
    }
    out.write_char('\n')
}

/// Writes the line of an error frame (linux/can/error.h) with these classes.
///
/// # Errors
/// Those of the writer.
pub fn write_error(
    out: &mut impl Write,
    at_ns: u64,
    interface: &str,
    classes: u32,
    data: [u8; 8],
) -> fmt::Result {
    const ERROR_FLAG: u32 = 0x2000_0000;
    write_time(out, at_ns)?;
    write!(out, " {interface} {:08X}#", ERROR_FLAG | classes)?;
    for byte in data {
        write!(out, "{byte:02X}")?;
    }
    out.write_char('\n')
}

fn write_time(out: &mut impl Write, at_ns: u64) -> fmt::Result {
    let us = at_ns / 1_000;
    write!(out, "({}.{:06})", us / 1_000_000, us % 1_000_000)
}

/// What a line of a log is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Line<'a> {
    /// A frame with its time, ns.
    Frame {
        /// When it ended, ns.
        at_ns: u64,
        /// The interface.
        interface: &'a str,
        /// The frame.
        frame: Frame,
    },
    /// A frame that the bus does not carry: extended, remote, error, CAN FD, or with a DLC above 8.
    Foreign {
        /// When it ended, ns.
        at_ns: u64,
        /// The interface.
        interface: &'a str,
    },
    /// Nothing.
    Empty,
    /// No line of `candump -L`.
    Bad,
}

/// Reads a line, with or without its end.
#[must_use]
pub fn parse_line(line: &str) -> Line<'_> {
    if line.trim().is_empty() {
        return Line::Empty;
    }
    whole(line).unwrap_or(Line::Bad)
}

fn whole(line: &str) -> Option<Line<'_>> {
    let mut words = line.split_ascii_whitespace();
    let (at_ns, interface) = (time_ns(words.next()?)?, words.next()?);
    let (id, data) = words.next()?.split_once('#')?;
    let direction = words.next().is_none_or(|word| word == "R" || word == "T");
    if !direction || words.next().is_some() {
        return None;
    }
    let foreign = Line::Foreign { at_ns, interface };
    let is_hex = |text: &str| text.bytes().all(|byte| hex::digit(byte).is_some());
    let digits = match data.split_once('_') {
        Some((digits, dlc)) if matches!(dlc.as_bytes(), [b'9' | b'A'..=b'F']) => digits,
        Some(_) => return None,
        None => data,
    };
    let digits = digits.trim_start_matches(['#', 'R']);
    match id.len() {
        8 if is_hex(id) && is_hex(digits) => Some(foreign),
        3 if is_hex(id) && is_hex(digits) && digits.len() != data.len() => Some(foreign),
        3 => Some(Line::Frame {
            at_ns,
            interface,
            frame: hex::frame(hex::number(id.as_bytes())?, data.as_bytes())?,
        }),
        _ => None,
    }
}

/// `(SECONDS.FRACTION)`, exactly: one to nine digits of fraction.
fn time_ns(text: &str) -> Option<u64> {
    let text = text.strip_prefix('(')?.strip_suffix(')')?;
    let (seconds, fraction) = text.split_once('.')?;
    let number = |digits: &str| {
        let plain = digits.bytes().all(|byte| byte.is_ascii_digit());
        plain.then(|| digits.parse::<u64>().ok())?
    };
    let places = u32::try_from(fraction.len()).ok()?;
    let nanos = number(fraction)? * 10_u64.pow(9_u32.checked_sub(places)?);
    number(seconds)?
        .checked_mul(1_000_000_000)?
        .checked_add(nanos)
}
