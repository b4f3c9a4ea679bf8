//! slcan: the LAWICEL protocol of serial CAN adapters.
//!
//! A command is a line that ends in a carriage return; the answer also ends in one, or is the
//! character BEL (7) for a refusal. [`Channel`] is the adapter's end, [`Answers`] that of the
//! program that uses it, and [`frame`] the line of a frame for both. Sources: LAWICEL CAN232 manual
//! 1.4 (commands and status flags), slcan.c of Linux and python-can (what is sent in practice).
//!
//! # Commands
//!
//! | command | meaning | answer |
//! |---|---|---|
//! | `O` | opens the channel | CR |
//! | `L` | opens it to listen only: `t` is refused | CR |
//! | `C` | closes it | CR |
//! | `S8` | 1 Mbit/s, the rate of the bus | CR; other rates are refused |
//! | `tIIILDD..` | sends a frame | `z` CR |
//! | `T`, `r`, `R` | sends an extended or a remote frame, which this bus does not carry | BEL |
//! | `F` | reads and clears the status [`flags`] | `F` two digits CR |
//! | `V`, `N` | version, serial number | text, CR |
//! | `Z0`, `Z1` | time stamps off, on: four digits after the data, ms modulo 60 000 | CR |
//! | `s`, `M`, `m`, `W` and empty lines | bit timing, filters: change nothing | CR |
//!
//! A line that is too long, or holds anything else, is refused as a whole.

use canopen::Frame;

use crate::hex;

/// Longest line: an extended frame of eight bytes with a time stamp, without its end.
pub const LONGEST: usize = 1 + 8 + 1 + 16 + 4;

/// Room for any line with its end.
pub const LINE: usize = LONGEST + 1;

/// End of every line, and the answer to a command that is accepted.
pub const ACCEPTED: u8 = b'\r';
/// The answer to a command that is refused.
pub const REFUSED: u8 = 7;
/// The answer to a frame that is accepted.
pub const SENT: &[u8] = b"z\r";

/// Time stamps count from 0 to this many milliseconds, this one not included.
pub const STAMP_PERIOD_MS: u16 = 60_000;

/// A line with its end.
#[derive(Debug, Clone)]
pub struct Line {
    text: [u8; LINE],
    length: usize,
}

impl Line {
    const fn new() -> Self {
        Self {
            text: [0; LINE],
            length: 0,
        }
    }

    /// Appends a byte. A line holds the longest of all: none is too many.
    fn push(&mut self, byte: u8) {
        if let Some(slot) = self.text.get_mut(self.length) {
            *slot = byte;
            self.length += 1;
        }
    }

    /// Appends a digit of the lower four bits.
    fn digit(&mut self, value: u8) {
        self.push(hex::upper(value));
    }

    fn pair(&mut self, byte: u8) {
        self.digit(byte >> 4);
        self.digit(byte);
    }

    fn hex_field(&mut self, letter: u8, bytes: &[u8]) {
        self.push(letter);
        bytes.iter().for_each(|byte| self.pair(*byte));
    }

    /// Its text, with its end.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.text.get(..self.length).unwrap_or_default()
    }
}

impl core::ops::Deref for Line {
    type Target = str;

    fn deref(&self) -> &str {
        // ASCII, all of it.
        core::str::from_utf8(self.as_bytes()).unwrap_or_default()
    }
}

/// Bits of the answer to `F`.
pub mod flags {
    /// Frames from the bus found no room on their way to the program.
    pub const RECEIVE_FULL: u8 = 1 << 0;
    /// Frames of the program found no room on their way to the bus.
    pub const TRANSMIT_FULL: u8 = 1 << 1;
    /// An error counter is at 96 or more.
    pub const WARNING: u8 = 1 << 2;
    /// Bytes of the serial line were lost, or frames in the CAN controller.
    pub const OVERRUN: u8 = 1 << 3;
    /// Error passive: usually no other node acknowledges.
    pub const PASSIVE: u8 = 1 << 5;
    /// Bus error: here, bus-off.
    pub const BUS_ERROR: u8 = 1 << 7;
}

/// Writes the line of a frame, with its end and, if there is one, its time stamp in milliseconds,
/// into the room for one; returns its length. What lies behind that is of no meaning.
// In place and without a loop: a robot prints every frame of a full bus, in an interrupt.
#[inline]
pub fn print(frame: &Frame, stamp_ms: Option<u16>, line: &mut [u8; LINE]) -> usize {
    let [kind, rest @ ..] = line;
    *kind = b't';
    // Identifier and length are four digits, each pair of data bytes four more. All eight bytes are
    // printed, and what there is no data for is overwritten by what follows.
    let head = frame.id() << 4 | u16::from(frame.len());
    let [a, b, c, d, e, f, g, h] = *frame.padded();
    if let ([at_0, at_1, at_2, at_3, at_4, ..], _) = rest.as_chunks_mut::<4>() {
        *at_0 = hex::four(head.to_be_bytes());
        *at_1 = hex::four([a, b]);
        *at_2 = hex::four([c, d]);
        *at_3 = hex::four([e, f]);
        *at_4 = hex::four([g, h]);
    }
    let mut end = 5 + 2 * usize::from(frame.len());
    if let Some(stamp) = stamp_ms
        && let Some(place) = line.get_mut(end..).and_then(<[u8]>::first_chunk_mut)
    {
        *place = hex::four(stamp.to_be_bytes());
        end += 4;
    }
    if let Some(place) = line.get_mut(end) {
        *place = ACCEPTED;
    }
    end + 1
}

/// The line of a frame, as [`print`] writes it.
#[must_use]
pub fn frame(frame: &Frame, stamp_ms: Option<u16>) -> Line {
    let mut line = Line::new();
    line.length = print(frame, stamp_ms, &mut line.text);
    line
}

/// The answer to `F`.
#[must_use]
pub fn flags_answer(flags: u8) -> Line {
    let mut line = Line::new();
    line.hex_field(b'F', &[flags]);
    line.push(ACCEPTED);
    line
}

/// What a program asks of an adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Open the channel.
    Open,
    /// Open it to listen only.
    Listen,
    /// Close it.
    Close,
    /// Send a frame.
    Send(Frame),
    /// Tell the status flags.
    Flags,
    /// Tell the version.
    Version,
    /// Tell the serial number.
    Serial,
    /// Send time stamps, or do not.
    Stamps(bool),
    /// Something to accept that changes nothing.
    Accept,
    /// Something to refuse.
    Refuse,
}

impl Command {
    /// What a line without its end asks for.
    #[must_use]
    pub fn parse(line: &[u8]) -> Self {
        match line {
            b"O" => Self::Open,
            b"L" => Self::Listen,
            b"C" => Self::Close,
            b"F" => Self::Flags,
            b"V" => Self::Version,
            b"N" => Self::Serial,
            b"Z0" => Self::Stamps(false),
            b"Z1" => Self::Stamps(true),
            b"" | b"S8" | [b's' | b'M' | b'm' | b'W', ..] => Self::Accept,
            [b't', rest @ ..] => match data_frame(rest) {
                Some((frame, [])) => Self::Send(frame),
                _ => Self::Refuse,
            },
            _ => Self::Refuse,
        }
    }
}

/// `IIILDD..` and what follows it.
fn data_frame(text: &[u8]) -> Option<(Frame, &[u8])> {
    let (id, rest) = text.split_at_checked(3)?;
    let (length, rest) = rest.split_first()?;
    let (data, rest) = rest.split_at_checked(2 * usize::from(hex::digit(*length)?))?;
    Some((hex::frame(hex::number(id)?, data)?, rest))
}

/// The answer to `V`: hardware and software 1.3, as a CAN232 of the manual says.
const VERSION: &[u8] = b"V1013";

/// How far a channel is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Closed,
    /// Frames come, none go.
    Listening,
    Open,
}

/// The adapter's end of the line: its channel, and what is to be done for it.
#[derive(Debug, Clone)]
pub struct Channel {
    commands: Commands,
    mode: Mode,
    stamps: bool,
    /// What `N` tells the lower half of.
    number: u32,
}

/// What a command has come to.
#[derive(Debug, Clone)]
pub enum Step {
    /// Answer with this.
    Answer(Line),
    /// Send this frame, and answer [`SENT`] or [`REFUSED`].
    Send(Frame),
    /// Answer with the [`flags`].
    Flags,
}

impl Channel {
    /// A closed channel of an adapter with this serial number.
    #[must_use]
    pub const fn new(number: u32) -> Self {
        Self {
            commands: Commands::new(),
            mode: Mode::Closed,
            stamps: false,
            number,
        }
    }

    /// Takes one byte; returns what is to be done when it ends a command.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Step> {
        let command = self.commands.push(byte)?;
        Some(self.step(command))
    }

    // Not inlined: its caller is built for speed.
    #[inline(never)]
    fn step(&mut self, command: Command) -> Step {
        let mut line = Line::new();
        match command {
            Command::Send(frame) if self.mode == Mode::Open => return Step::Send(frame),
            Command::Flags => return Step::Flags,
            Command::Open => self.mode = Mode::Open,
            Command::Listen => self.mode = Mode::Listening,
            Command::Close => self.close(),
            Command::Stamps(on) => self.stamps = on,
            Command::Version => VERSION.iter().for_each(|byte| line.push(*byte)),
            Command::Serial => {
                let [.., high, low] = self.number.to_be_bytes();
                line.hex_field(b'N', &[high, low]);
            }
            Command::Accept => {}
            Command::Send(_) | Command::Refuse => {
                line.push(REFUSED);
                return Step::Answer(line);
            }
        }
        line.push(ACCEPTED);
        Step::Answer(line)
    }

    /// Something was lost here: what has come of this line is refused at its end.
    pub fn spoil(&mut self) {
        self.commands.spoil();
    }

    /// Closes it, as after `C`, and switches time stamps off.
    pub fn close(&mut self) {
        self.mode = Mode::Closed;
        self.stamps = false;
    }

    /// Whether it is open, if only to listen.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.mode != Mode::Closed
    }

    /// Whether it wants time stamps.
    #[must_use]
    pub const fn stamps(&self) -> bool {
        self.stamps
    }
}

/// Puts commands together from bytes.
#[derive(Debug, Clone, Default)]
pub struct Commands(Lines);

impl Commands {
    /// With nothing received.
    #[must_use]
    pub const fn new() -> Self {
        Self(Lines::new())
    }

    /// Takes one byte; returns the command that it completes.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Command> {
        if byte != b'\r' {
            self.0.add(byte);
            return None;
        }
        Some(self.complete())
    }

    #[inline(never)]
    fn complete(&mut self) -> Command {
        let command = self.0.content().map_or(Command::Refuse, Command::parse);
        self.0.clear();
        command
    }

    /// Something was lost here: what has come of this line is refused at its end.
    pub fn spoil(&mut self) {
        self.0.spoilt = true;
    }
}

/// What an adapter says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// A frame of the bus, with its time stamp in milliseconds if it has one.
    Frame(Frame, Option<u16>),
    /// A frame was accepted.
    Sent,
    /// A command was refused.
    Refused,
    /// The status flags.
    Flags(u8),
    /// The version or the serial number, or the bare end of a command that was accepted; extended
    /// and remote frames, too.
    Other,
}

impl Answer {
    /// What a line without its end says.
    #[must_use]
    pub fn parse(line: &[u8]) -> Self {
        match line {
            b"z" => Some(Self::Sent),
            [b'F', high, low] => hex::digit(*high)
                .zip(hex::digit(*low))
                .map(|(high, low)| Self::Flags(high << 4 | low)),
            [b't', rest @ ..] => match data_frame(rest) {
                Some((frame, [])) => Some(Self::Frame(frame, None)),
                Some((frame, stamp)) if stamp.len() == 4 => {
                    hex::number(stamp).map(|stamp| Self::Frame(frame, Some(stamp)))
                }
                _ => None,
            },
            _ => None,
        }
        .unwrap_or(Self::Other)
    }
}

/// Puts answers together from bytes: the program's end.
#[derive(Debug, Clone, Default)]
pub struct Answers(Lines);

impl Answers {
    /// With nothing received.
    #[must_use]
    pub const fn new() -> Self {
        Self(Lines::new())
    }

    /// Takes one byte; returns the answer that it completes. A bell ends whatever line it stands
    /// in.
    pub fn push(&mut self, byte: u8) -> Option<Answer> {
        let answer = match byte {
            b'\r' | b'\n' => self.0.content().map_or(Answer::Other, Answer::parse),
            REFUSED => Answer::Refused,
            _ => {
                self.0.add(byte);
                return None;
            }
        };
        self.0.clear();
        Some(answer)
    }
}

/// A line that is being received.
#[derive(Debug, Clone)]
struct Lines {
    text: [u8; LONGEST],
    length: usize,
    /// Too long, or something of it was lost.
    spoilt: bool,
}

impl Default for Lines {
    fn default() -> Self {
        Self::new()
    }
}

impl Lines {
    const fn new() -> Self {
        Self {
            text: [0; LONGEST],
            length: 0,
            spoilt: false,
        }
    }

    #[inline]
    fn add(&mut self, byte: u8) {
        match self.text.get_mut(self.length) {
            Some(slot) => {
                *slot = byte;
                self.length += 1;
            }
            None => self.spoilt = true,
        }
    }

    fn content(&self) -> Option<&[u8]> {
        self.text.get(..self.length).filter(|_| !self.spoilt)
    }

    fn clear(&mut self) {
        self.length = 0;
        self.spoilt = false;
    }
}
