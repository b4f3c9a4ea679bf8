//! A candump log onto the bus: every frame at its time after the first, from the moment the world
//! begins.
//!
//! What is no classic base frame (extended or remote frames, error frames, CAN FD) is left out and
//! counted; what is no candump line at all is refused with its number. The log's sender is one more
//! node: its frames take part in arbitration and may be late by what the bus is busy with.

use std::collections::VecDeque;
use std::io;

use can_text::candump::{Line, parse_line};
use canopen::Frame;

use super::Endpoint;
use crate::world::{Port, World};

/// How far ahead frames are queued, ns. The world sends each at its own time.
const AHEAD_NS: u64 = 10_000_000;

/// A log that is being played.
#[derive(Debug)]
pub struct Replay {
    name: String,
    frames: VecDeque<(u64, Frame)>,
    left_out: usize,
    port: Option<Port>,
}

impl Replay {
    /// A log, by its name and text.
    ///
    /// # Errors
    /// A line that is no candump line, by its number.
    pub fn new(name: &str, text: &str) -> Result<Self, String> {
        let mut frames = Vec::new();
        let mut left_out = 0;
        for (number, line) in text.lines().enumerate() {
            match parse_line(line) {
                Line::Frame { at_ns, frame, .. } => frames.push((at_ns, frame)),
                Line::Foreign { .. } => left_out += 1,
                Line::Empty => {}
                Line::Bad => {
                    return Err(format!(
                        "line {}: `{line}` is not a line of `candump -L`; write \
                         (SECONDS.MICROSECONDS) can0 ID#DATA",
                        number + 1
                    ));
                }
            }
        }
        // Logs of several interfaces are not always in order.
        frames.sort_by_key(|(at, _)| *at);
        let first = frames.first().map_or(0, |(at, _)| *at);
        Ok(Self {
            name: name.to_owned(),
            frames: frames.into_iter().map(|(at, f)| (at - first, f)).collect(),
            left_out,
            port: None,
        })
    }
}

impl Endpoint for Replay {
    fn announce(&self) -> String {
        let left_out = match self.left_out {
            0 => String::new(),
            n => format!(", {n} left out: not classic base frames"),
        };
        format!(
            "replay {}: {} frames{left_out}",
            self.name,
            self.frames.len()
        )
    }

    fn exchange(&mut self, world: &mut World) -> io::Result<()> {
        let port = *self.port.get_or_insert_with(|| world.add_port());
        world.set_listening(port, false);
        let until = world.now_ns() + AHEAD_NS;
        while let Some((at, frame)) = self.frames.pop_front_if(|(at, _)| *at < until) {
            world.send_at(port, at, frame);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_count_from_the_first_frame() {
        let log = "(1700000000.000100) can0 181#E803\n\n(1700000000.000350) can0 080#01\n";
        let replay = Replay::new("log", log).unwrap();
        let wanted = [
            (0, Frame::new(0x181, &[0xE8, 3]).unwrap()),
            (250_000, Frame::new(0x80, &[1]).unwrap()),
        ];
        assert_eq!(replay.frames, wanted);
        assert_eq!(replay.announce(), "replay log: 2 frames");
    }

    #[test]
    fn what_the_bus_does_not_carry_is_left_out_and_counted() {
        let log = "(1.0) can0 00000181#00\n(1.1) can0 181#R\n(1.2) can0 20000080#0000000000000000\n\
                   (1.3) can0 181##100\n(1.4) can0 181#00 R\n";
        let replay = Replay::new("log", log).unwrap();
        assert_eq!(
            replay.announce(),
            "replay log: 1 frames, 4 left out: not classic base frames"
        );
    }

    #[test]
    fn a_line_that_is_none_is_named() {
        for line in [
            "hello",
            "(1.0) can0",
            "(x) can0 181#",
            "(1.0) can0 181#0",
            "(1.0) can0 1811",
        ] {
            let error = Replay::new("log", &format!("(1.0) can0 181#\n{line}")).unwrap_err();
            assert!(error.starts_with("line 2: `"), "{error}");
        }
    }
}
