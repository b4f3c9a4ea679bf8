//! An SDO client for one device: one transfer at a time.
//!
//! Start a transfer with [`upload`](SdoClient::upload) or [`download`](SdoClient::download), send
//! what [`pop_frame`](SdoClient::pop_frame) gives, hand over every frame received, and call
//! [`poll`](SdoClient::poll) when [`next_deadline`](SdoClient::next_deadline) has passed. Each
//! transfer ends in exactly one [`Outcome`].

use crate::time::Timer;
use crate::{AbortCode, Frame, Micros, NodeId};

const REQUEST: u16 = 0x600;
const RESPONSE: u16 = 0x580;

/// The most bytes one transfer can carry.
const CAPACITY: usize = 4;

/// The client has a transfer in progress, or the value is too long for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Busy;

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SdoError {
    /// The device refused with this code; [`AbortCode::from_code`] knows the standard ones.
    Aborted(u32),
    /// The device did not answer in time.
    Timeout,
    /// The device sent something that is no answer to the request; the transfer has been aborted.
    Protocol(AbortCode),
}

impl core::fmt::Display for SdoError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Aborted(code) => match AbortCode::from_code(*code) {
                Some(known) => write!(f, "refused: {known}"),
                None => write!(f, "refused: 0x{code:08X}"),
            },
            Self::Timeout => f.write_str("no answer in time"),
            Self::Protocol(code) => write!(f, "wrong answer: {code}"),
        }
    }
}

impl core::error::Error for SdoError {}

/// How a transfer ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The value has been read and is in [`SdoClient::data`].
    Uploaded,
    /// The value has been written.
    Downloaded,
    /// Neither.
    Failed(SdoError),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Idle,
    Uploading,
    Downloading,
}

/// An SDO client.
pub struct SdoClient {
    server: NodeId,
    timeout: Micros,
    state: State,
    index: u16,
    sub: u8,
    timer: Timer,
    outgoing: Option<Frame>,
    data: [u8; CAPACITY],
    len: usize,
}

impl SdoClient {
    /// Makes a client of `server` that waits `timeout` for every answer.
    #[must_use]
    pub const fn new(server: NodeId, timeout: Micros) -> Self {
        Self {
            server,
            timeout,
            state: State::Idle,
            index: 0,
            sub: 0,
            timer: Timer::OFF,
            outgoing: None,
            data: [0; CAPACITY],
            len: 0,
        }
    }

    /// The device it talks to.
    #[must_use]
    pub const fn server(&self) -> NodeId {
        self.server
    }

    /// Whether no transfer is in progress.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// Starts to read an object.
    ///
    /// # Errors
    /// [`Busy`] if a transfer is in progress.
    pub fn upload(&mut self, now: Micros, index: u16, sub: u8) -> Result<(), Busy> {
        self.start(now, State::Uploading, index, sub)?;
        self.len = 0;
        self.request(0x40, [0; 4]);
        Ok(())
    }

    /// Starts to write an object: `data` is its value, little-endian.
    ///
    /// # Errors
    /// [`Busy`] if a transfer is in progress or the data are empty or too long.
    pub fn download(&mut self, now: Micros, index: u16, sub: u8, data: &[u8]) -> Result<(), Busy> {
        let unused = match data.len() {
            1 => 3,
            2 => 2,
            3 => 1,
            4 => 0,
            _ => return Err(Busy),
        };
        self.start(now, State::Downloading, index, sub)?;
        let mut value = [0; 4];
        for (to, from) in value.iter_mut().zip(data) {
            *to = *from;
        }
        self.request(0x23 | unused << 2, value);
        Ok(())
    }

    /// Hands over a received frame; those of other services and devices are ignored.
    pub fn on_frame(&mut self, now: Micros, frame: &Frame) -> Option<Outcome> {
        let _ = now;
        if frame.id() != self.server.cob_id(RESPONSE) || self.is_idle() || frame.len() != 8 {
            return None;
        }
        let [command, low, high, sub, a, b, c, d] = *frame.padded();
        let same = u16::from_le_bytes([low, high]) == self.index && sub == self.sub;
        if command >> 5 == 4 {
            // Some devices leave the multiplexer of an abort empty.
            let code = u32::from_le_bytes([a, b, c, d]);
            return Some(self.finish(Outcome::Failed(SdoError::Aborted(code))));
        }
        match (self.state, command >> 5) {
            (State::Uploading, 2) if same && command & 0b10 != 0 => {
                self.data = [a, b, c, d];
                self.len = match command & 1 {
                    1 => 4 - usize::from(command >> 2 & 0b11),
                    _ => 4,
                };
                Some(self.finish(Outcome::Uploaded))
            }
            (State::Downloading, 3) if same => Some(self.finish(Outcome::Downloaded)),
            (State::Idle | State::Uploading | State::Downloading, _) => {
                let code = AbortCode::CommandSpecifier;
                self.request(0x80, code.code().to_le_bytes());
                Some(self.finish(Outcome::Failed(SdoError::Protocol(code))))
            }
        }
    }

    /// Ends the transfer if the device has not answered in time.
    pub fn poll(&mut self, now: Micros) -> Option<Outcome> {
        if !self.timer.due(now) {
            return None;
        }
        self.request(0x80, AbortCode::Timeout.code().to_le_bytes());
        Some(self.finish(Outcome::Failed(SdoError::Timeout)))
    }

    /// The next frame to send.
    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.outgoing.take()
    }

    /// When [`poll`](Self::poll) has something to do.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Micros> {
        self.timer.is_on().then(|| self.timer.moment())
    }

    /// The value read last, little-endian.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.data.get(..self.len).unwrap_or(&[])
    }

    fn start(&mut self, now: Micros, state: State, index: u16, sub: u8) -> Result<(), Busy> {
        if !self.is_idle() {
            return Err(Busy);
        }
        (self.state, self.index, self.sub) = (state, index, sub);
        self.timer = Timer::at(now + self.timeout);
        Ok(())
    }

    fn request(&mut self, command: u8, value: [u8; 4]) {
        let [low, high] = self.index.to_le_bytes();
        let [a, b, c, d] = value;
        let bytes = [command, low, high, self.sub, a, b, c, d];
        self.outgoing = Some(Frame::of(self.server.cob_id(REQUEST), bytes));
    }

    fn finish(&mut self, outcome: Outcome) -> Outcome {
        self.state = State::Idle;
        self.timer = Timer::OFF;
        outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client() -> SdoClient {
        SdoClient::new(NodeId::new(5).unwrap(), Micros::from_millis(100))
    }

    #[test]
    fn reads_what_the_device_answers() {
        let mut client = client();
        client.upload(Micros(0), 0x1000, 0).unwrap();
        assert_eq!(client.upload(Micros(0), 0x1000, 0), Err(Busy));
        assert_eq!(
            client.pop_frame(),
            Some(Frame::of(0x605, [0x40, 0x00, 0x10, 0, 0, 0, 0, 0]))
        );
        let foreign = Frame::of(0x586, [0x43, 0x00, 0x10, 0, 1, 2, 3, 4]);
        assert_eq!(client.on_frame(Micros(1), &foreign), None);
        let answer = Frame::of(0x585, [0x4B, 0x00, 0x10, 0, 1, 2, 0, 0]);
        assert_eq!(client.on_frame(Micros(1), &answer), Some(Outcome::Uploaded));
        assert_eq!(client.data(), &[1, 2]);
        assert!(client.is_idle());
    }

    #[test]
    fn writes_with_the_size_indicated() {
        let mut client = client();
        for (len, command) in [(1, 0x2F), (2, 0x2B), (3, 0x27), (4, 0x23)] {
            let data = [0x11, 0x22, 0x33, 0x44];
            client.download(Micros(0), 0x2001, 3, &data[..len]).unwrap();
            let sent = client.pop_frame().unwrap();
            assert_eq!(sent.data()[..4], [command, 0x01, 0x20, 3]);
            assert_eq!(sent.data()[4..4 + len], data[..len]);
            let answer = Frame::of(0x585, [0x60, 0x01, 0x20, 3, 0, 0, 0, 0]);
            assert_eq!(
                client.on_frame(Micros(1), &answer),
                Some(Outcome::Downloaded)
            );
        }
    }

    #[test]
    fn tells_a_refusal_from_silence_and_from_nonsense() {
        let mut client = client();
        client.upload(Micros(0), 0x2001, 0).unwrap();
        let refusal = Frame::of(0x585, [0x80, 0x01, 0x20, 0, 0, 0, 0x02, 0x06]);
        assert_eq!(
            client.on_frame(Micros(1), &refusal),
            Some(Outcome::Failed(SdoError::Aborted(0x0602_0000)))
        );
        client.upload(Micros(0), 0x2001, 0).unwrap();
        assert_eq!(client.next_deadline(), Some(Micros(100_000)));
        assert_eq!(client.poll(Micros(99_999)), None);
        assert_eq!(
            client.poll(Micros(100_000)),
            Some(Outcome::Failed(SdoError::Timeout))
        );
        assert_eq!(client.pop_frame().unwrap().data()[0], 0x80);
        client.upload(Micros(0), 0x2001, 0).unwrap();
        let other = Frame::of(0x585, [0x43, 0x02, 0x20, 0, 0, 0, 0, 0]);
        assert_eq!(
            client.on_frame(Micros(1), &other),
            Some(Outcome::Failed(SdoError::Protocol(
                AbortCode::CommandSpecifier
            )))
        );
        assert_eq!(client.poll(Micros(u64::MAX - 1)), None);
    }
}
