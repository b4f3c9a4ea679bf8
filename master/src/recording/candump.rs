//! candump logs (`(seconds.microseconds) interface ID#DATA`), in and out: what `candump -L` writes
//! and `canplayer`, cantools and Wireshark read.

use std::io::{BufRead, Write};

use canopen::Frame;

use super::read::{Recorded, Recording};
use super::{Header, from_hex, to_hex};

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CandumpError {
    /// The file itself.
    #[error("cannot be read: {0}")]
    Io(#[from] std::io::Error),
    /// A line that is not one of a log.
    #[error(
        "line {line}: '{text}' is not a frame; a line is (seconds.microseconds) interface ID#DATA, \
         as `candump -L` writes it"
    )]
    Line {
        /// Its number, from 1.
        line: usize,
        /// What it says.
        text: String,
    },
}

/// Reads a log. Extended, remote and error frames are left out: no robot sends any.
///
/// # Errors
/// At the first line that is not one of a log.
pub fn read(input: impl BufRead) -> Result<Recording, CandumpError> {
    let mut recording = Recording {
        header: Header {
            activity: "candump".into(),
            ..Header::default()
        },
        ..Recording::default()
    };
    let mut epoch = None;
    for (line, text) in input.lines().enumerate() {
        let text = text?;
        if text.trim().is_empty() {
            continue;
        }
        let parsed = parse(text.trim()).ok_or_else(|| CandumpError::Line {
            line: line + 1,
            text: text.chars().take(80).collect(),
        })?;
        let Parsed { t_ns, bus, frame } = parsed;
        if recording.header.bus.is_empty() {
            recording.header.bus = bus;
        }
        // Logs count from 1970 or from 0; the whole second of the first frame is taken for the
        // start.
        let epoch = *epoch.get_or_insert(t_ns - t_ns % 1_000_000_000);
        recording.header.epoch_ns = epoch;
        recording.frames.extend(frame.map(|frame| Recorded {
            t_ns: t_ns.saturating_sub(epoch),
            frame,
            sent: false,
        }));
    }
    recording.frames.sort_by_key(|recorded| recorded.t_ns);
    Ok(recording)
}

/// Writes a log.
///
/// # Errors
/// When it cannot be written.
pub fn write(recording: &Recording, out: &mut impl Write) -> std::io::Result<()> {
    for recorded in &recording.frames {
        let us = (recording.header.epoch_ns + recorded.t_ns) / 1_000;
        writeln!(
            out,
            "({}.{:06}) can0 {:03X}#{}",
            us / 1_000_000,
            us % 1_000_000,
            recorded.frame.id(),
            to_hex(recorded.frame.data())
        )?;
    }
    out.flush()
}

struct Parsed {
    t_ns: u64,
    bus: String,
    /// `None` for a frame of a kind that is left out.
    frame: Option<Frame>,
}

fn parse(line: &str) -> Option<Parsed> {
    let (time, rest) = line.strip_prefix('(')?.split_once(')')?;
    let (seconds, micros) = time.trim().split_once('.')?;
    if micros.len() != 6 {
        return None;
    }
    let digits = |text: &str| {
        text.bytes()
            .all(|b| b.is_ascii_digit())
            .then(|| text.parse::<u64>().ok())?
    };
    let t_us = digits(seconds)?
        .checked_mul(1_000_000)?
        .checked_add(digits(micros)?)?;
    let mut words = rest.split_whitespace();
    let (bus, frame) = (words.next()?.to_owned(), words.next()?);
    let (id, data) = frame.split_once('#')?;
    let number = u32::from_str_radix(id, 16).ok()?;
    let frame = if data.starts_with('R') || data.starts_with('#') || id.len() == 8 {
        None
    } else if id.len() == 3 {
        Some(Frame::new(u16::try_from(number).ok()?, &from_hex(data)?)?)
    } else {
        return None;
    };
    Some(Parsed {
        t_ns: t_us.checked_mul(1_000)?,
        bus,
        frame,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "(1700000000.250000) can0 181#E8030000000007A1\n\
                       (1700000000.252001) can0 080#01\n\
                       (1700000001.000000) can0 12345678#00\n\
                       (1700000001.100000) can0 702#R\n\
                       (1700000001.200000) can0 000#\n";

    #[test]
    fn a_log_comes_back_as_it_was() {
        let recording = read(LOG.as_bytes()).unwrap();
        assert_eq!(recording.header.epoch_ns, 1_700_000_000_000_000_000);
        assert_eq!(recording.frames[1].t_ns, 252_001_000);
        assert_eq!(recording.frames[1].frame, Frame::of(0x080, [1]));
        let mut out = Vec::new();
        write(&recording, &mut out).unwrap();
        // All but the extended and the remote frame.
        let kept: Vec<_> = LOG
            .lines()
            .filter(|l| !l.contains("12345678") && !l.contains('R'))
            .collect();
        assert_eq!(
            String::from_utf8(out).unwrap().lines().collect::<Vec<_>>(),
            kept
        );
    }

    #[test]
    fn anything_else_is_refused_with_its_line() {
        for bad in [
            "hello",
            "(1.5) can0 080#",
            "(1.000000) can0",
            "(1.000000) can0 080",
            "(1.000000) can0 800#",
            "(1.000000) can0 080#0",
            "(1.000000) can0 080#000000000000000000",
            "(99999999999999999999.000000) can0 080#",
            "(+1.000000) can0 080#",
        ] {
            let error = read(format!("(1.000000) can0 080#\n{bad}\n").as_bytes()).unwrap_err();
            assert!(error.to_string().starts_with("line 2: "), "{bad}: {error}");
        }
    }
}
