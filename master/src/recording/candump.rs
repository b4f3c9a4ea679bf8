//! candump logs (`(seconds.microseconds) interface ID#DATA`), in and out: what `candump -L` writes
//! and `canplayer`, cantools and Wireshark read.

use std::io::{BufRead, Write};

use can_text::candump::{Line, parse_line, write_line};

use super::Header;
use super::content::{Recorded, Recording};

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CandumpError {
    /// The file itself.
    #[error("cannot be read: {0}")]
    Io(std::io::Error),
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
        let text = text.map_err(CandumpError::Io)?;
        let (t_ns, bus, frame) = match parse_line(&text) {
            Line::Empty => continue,
            Line::Frame {
                at_ns,
                interface,
                frame,
            } => (at_ns, interface, Some(frame)),
            Line::Foreign { at_ns, interface } => (at_ns, interface, None),
            Line::Bad => {
                return Err(CandumpError::Line {
                    line: line + 1,
                    text: text.chars().take(80).collect(),
                });
            }
        };
        if recording.header.bus.is_empty() {
            recording.header.bus = bus.to_owned();
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
    let mut line = String::new();
    for recorded in &recording.frames {
        line.clear();
        let at_ns = recording.header.epoch_ns + recorded.t_ns;
        write_line(&mut line, at_ns, "can0", &recorded.frame).map_err(std::io::Error::other)?;
        out.write_all(line.as_bytes())?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::Frame;

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
        let frames: Vec<_> = LOG
            .lines()
            .filter(|l| !l.contains("12345678") && !l.contains('R'))
            .collect();
        assert_eq!(
            String::from_utf8(out).unwrap().lines().collect::<Vec<_>>(),
            frames
        );
    }

    #[test]
    fn anything_else_is_refused_with_its_line() {
        for bad in [
            "hello",
            "(1.) can0 080#",
            "(1.0000000001) can0 080#",
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
