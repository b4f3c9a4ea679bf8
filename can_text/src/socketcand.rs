//! socketcand in raw mode: messages between `<` and `>`, words between blanks.
//!
//! ```text
//! server  < hi >
//! client  < open can0 >              < ok >
//! client  < rawmode >                < ok >
//! client  < send 181 2 e8 3 >
//! server  < frame 182 12.345678 0102A0 >
//! ```
//!
//! Identifiers and bytes are hexadecimal; an extended identifier is one of eight digits.
//! [`Messages`] finds messages in what arrives; [`Request`] is what a client asks, [`send`] how it
//! sends; [`write_frame`] is what a server says and [`parse_frame`] how a client reads it. Source:
//! doc/protocol.md and the sources of linux-can/socketcand.

use core::fmt::{self, Write};

use canopen::Frame;

use crate::hex;

/// Longest message, with room to spare: a frame of eight bytes takes some 50.
pub const LONGEST: usize = 256;

/// The message that sends a frame.
#[must_use]
pub fn send(frame: &Frame) -> heapless::String<48> {
    let mut text = heapless::String::new();
    // The longest takes 40 bytes.
    let _ = write!(text, "< send {:X} {}", frame.id(), frame.data().len());
    for byte in frame.data() {
        let _ = write!(text, " {byte:02x}");
    }
    let _ = text.push_str(" >");
    text
}

/// Writes the message of a received frame, which came at this time. Without data two blanks are
/// left, as socketcand leaves them.
///
/// # Errors
/// Those of the writer.
pub fn write_frame(out: &mut impl Write, at_us: u64, frame: &Frame) -> fmt::Result {
    let (seconds, micros) = (at_us / 1_000_000, at_us % 1_000_000);
    write!(out, "< frame {:03X} {seconds}.{micros:06} ", frame.id())?;
    for byte in frame.data() {
        write!(out, "{byte:02X}")?;
    }
    out.write_str(" >")
}

/// The frame in a message without its brackets; `None` for every other message, and for extended
/// frames. The time stamp is passed over: it is of the server's clock.
#[must_use]
pub fn parse_frame(message: &str) -> Option<Frame> {
    let mut words = message.split_ascii_whitespace();
    if words.next() != Some("frame") {
        return None;
    }
    let id = base_identifier(words.next()?)?;
    let _time = words.next()?;
    let mut digits = heapless::Vec::<u8, 16>::new();
    for word in words {
        digits.extend_from_slice(word.as_bytes()).ok()?;
    }
    hex::frame(id, &digits)
}

/// What a client asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// To open a bus.
    Open,
    /// To switch to raw mode.
    Raw,
    /// To send a frame.
    Send(Frame),
    /// To send an extended frame, which this bus does not carry.
    SendForeign,
    /// A sign of life.
    Echo,
    /// Something to refuse, and why.
    Refuse(&'static str),
}

impl Request {
    /// What a message without its brackets asks for.
    #[must_use]
    pub fn parse(message: &str) -> Self {
        let mut words = message.split_ascii_whitespace();
        match words.next() {
            Some("open") if words.clone().count() == 1 => Self::Open,
            Some("rawmode") => Self::Raw,
            Some("echo") => Self::Echo,
            Some("send") if words.clone().next().is_some_and(|id| id.len() == 8) => {
                Self::SendForeign
            }
            Some("send") => frame_to_send(words).map_or(
                Self::Refuse("send takes identifier, length and bytes, all hexadecimal"),
                Self::Send,
            ),
            Some("open") | None => Self::Refuse("syntax"),
            Some(_) => Self::Refuse("unknown command"),
        }
    }
}

/// Identifier, length, bytes of one or two digits.
fn frame_to_send<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Frame> {
    let id = base_identifier(words.next()?)?;
    let length = usize::from(hex::number(words.next()?.as_bytes())?);
    let mut data = heapless::Vec::<u8, 8>::new();
    for word in words {
        data.push(u8::try_from(hex::number(word.as_bytes())?).ok()?)
            .ok()?;
    }
    (data.len() == length).then(|| Frame::new(id, &data))?
}

fn base_identifier(digits: &str) -> Option<u16> {
    hex::number(digits.as_bytes()).filter(|_| digits.len() <= 3)
}

/// Puts messages together from bytes.
#[derive(Debug, Clone, Default)]
pub struct Messages {
    text: heapless::Vec<u8, LONGEST>,
    /// Whether a bracket is open.
    inside: bool,
}

impl Messages {
    /// With nothing received.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            text: heapless::Vec::new(),
            inside: false,
        }
    }

    /// Takes one byte; returns the message that it completes, without brackets and blanks around
    /// it. One that is too long or no text comes back empty. What stands outside of brackets is
    /// passed over, an opening bracket starts a new message.
    pub fn push(&mut self, byte: u8) -> Option<&str> {
        match byte {
            b'<' => {
                self.text.clear();
                self.inside = true;
            }
            b'>' if self.inside => {
                self.inside = false;
                let whole = self.text.len() < LONGEST;
                let text = core::str::from_utf8(&self.text).ok().filter(|_| whole);
                return Some(text.unwrap_or_default().trim());
            }
            // A full one stays full, which marks it as too long.
            _ if self.inside => drop(self.text.push(byte)),
            _ => {}
        }
        None
    }
}
