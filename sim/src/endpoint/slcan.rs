//! slcan: CAN frames as lines of text, the LAWICEL protocol of serial CAN adapters.
//!
//! A client opens its channel with `O`, closes it with `C`, and sends `tIIILDD..`; every command
//! ends in a carriage return and is answered with one, or with a bell when it is refused. Bit rates
//! are accepted and ignored: the bus has the one it has. Extended and remote frames are refused.
//!
//! This is the protocol alone; [`slcan_tcp`](super::slcan_tcp) and [`pty`](super::pty) carry it.

use std::io::Write as _;

use canopen::Frame;

use crate::world::{Port, World};

/// Longest command, with room to spare.
const LONGEST: usize = 64;
const OK: u8 = b'\r';
const BELL: u8 = 7;

/// One client's channel: a node of its own on the bus, which hears the others' frames and not its
/// own.
#[derive(Debug)]
pub(super) struct Channel {
    port: Port,
    open: bool,
}

impl Channel {
    /// A closed channel at this port.
    pub fn new(port: Port) -> Self {
        Self { port, open: false }
    }

    /// Its port, for the next client.
    pub fn port(&self) -> Port {
        self.port
    }

    /// Closes it, as after `C`.
    pub fn close(&mut self) {
        self.open = false;
    }

    /// Answers the commands that are complete, and prints the frames that have come.
    pub fn exchange(&mut self, input: &mut Vec<u8>, output: &mut Vec<u8>, world: &mut World) {
        while let Some(end) = input.iter().position(|byte| *byte == OK) {
            let line: Vec<u8> = input.drain(..=end).take(end).collect();
            self.answer(&line, output, world);
        }
        if input.len() > LONGEST {
            input.clear();
            output.push(BELL);
        }
        while let Some((_, frame)) = world.take_received(self.port) {
            if self.open {
                print(output, &frame);
            }
        }
    }

    fn answer(&mut self, line: &[u8], output: &mut Vec<u8>, world: &mut World) {
        match parse(line) {
            Request::Open => self.open = true,
            Request::Close => self.open = false,
            Request::Send(frame) if self.open => {
                world.send_from(self.port, frame);
                output.push(b'z');
            }
            Request::Say(text) => output.extend_from_slice(text.as_bytes()),
            Request::Accept => {}
            Request::Send(_) | Request::Refuse => return output.push(BELL),
        }
        output.push(OK);
    }
}

/// What a line asks for.
#[derive(Debug, PartialEq, Eq)]
enum Request {
    Open,
    Close,
    Send(Frame),
    /// Something to be answered with this text.
    Say(&'static str),
    /// Something that makes no difference here.
    Accept,
    Refuse,
}

fn parse(line: &[u8]) -> Request {
    match line.split_first() {
        // An empty line clears an adapter's buffer; bit rates, filters and time stamps change
        // nothing.
        None | Some((b'S' | b's' | b'M' | b'm' | b'Z' | b'W', _)) => Request::Accept,
        Some((b'O', _)) => Request::Open,
        Some((b'C', _)) => Request::Close,
        Some((b'V', _)) => Request::Say("V1013"),
        Some((b'N', _)) => Request::Say("NOMNI"),
        Some((b'F', _)) => Request::Say("F00"),
        Some((b't', rest)) => frame(rest).map_or(Request::Refuse, Request::Send),
        Some(_) => Request::Refuse,
    }
}

/// `IIILDD..`, hexadecimal.
fn frame(text: &[u8]) -> Option<Frame> {
    let digits: Vec<u16> = text
        .iter()
        .map(|byte| char::from(*byte).to_digit(16).map(|digit| digit as u16))
        .collect::<Option<_>>()?;
    let (head, data) = digits.split_at_checked(4)?;
    let id = head[0] << 8 | head[1] << 4 | head[2];
    let bytes: Vec<u8> = data
        .chunks_exact(2)
        .map(|pair| (pair[0] << 4 | pair[1]) as u8)
        .collect();
    (data.len() == 2 * usize::from(head[3])).then(|| Frame::new(id, &bytes))?
}

fn print(output: &mut Vec<u8>, frame: &Frame) {
    // Writing into a vector cannot fail.
    let _ = write!(output, "t{:03X}{}", frame.id(), frame.data().len());
    for byte in frame.data() {
        let _ = write!(output, "{byte:02X}");
    }
    output.push(OK);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_goes_there_and_back() {
        let sent = Frame::new(0x181, &[0xE8, 0x03]).unwrap();
        assert_eq!(parse(b"t1812E803"), Request::Send(sent));
        let mut line = Vec::new();
        print(&mut line, &sent);
        assert_eq!(line, b"t1812E803\r");
        assert_eq!(
            parse(b"t0800"),
            Request::Send(Frame::new(0x80, &[]).unwrap())
        );
    }

    #[test]
    fn what_no_classic_base_frame_is_gets_refused() {
        for line in [
            "t181",
            "t1812E8",
            "t1812E80304",
            "t8000",
            "t181900112233445566778",
            "T000001811",
            "r1810",
            "x",
            "t18\u{e9}0",
        ] {
            assert_eq!(parse(line.as_bytes()), Request::Refuse, "{line}");
        }
    }
}
