//! An SDO client for one device: one transfer at a time.
//!
//! Start a transfer with [`upload`](SdoClient::upload) or [`download`](SdoClient::download), send
//! the frames of [`pop_frame`](SdoClient::pop_frame), pass every received frame to the client, and
//! call [`poll`](SdoClient::poll) when [`next_deadline`](SdoClient::next_deadline) has passed. Each
//! transfer ends in exactly one [`Outcome`].
//!
//! Values of up to four bytes are written expedited, longer ones in segments; `upload_block` and
//! `download_block` use the block protocol with CRC, which is several times faster for long values.
//! The device chooses the form of an upload; the client handles all of them.

mod block;
mod segmented;

use crate::time::Timer;
use crate::{AbortCode, Frame, Micros, NodeId};

/// The most bytes the client holds.
const CAPACITY: usize = 1022;

const REQUEST: u16 = 0x600;
const RESPONSE: u16 = 0x580;

/// In an initiate request or answer.
const EXPEDITED: u8 = 0b10;
const SIZE_INDICATED: u8 = 0b01;

/// The client has a transfer in progress, or the value is too long for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Busy;

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
    /// Expects the answer to the start of an upload.
    Upload,
    /// Expects a segment with this toggle bit.
    UploadSegment {
        toggle: bool,
    },
    /// Expects the answer to the start of a download.
    Download,
    /// Expects the confirmation of a segment with this toggle bit.
    DownloadSegment {
        toggle: bool,
    },
    /// Expects the answer to the start of a block upload.
    BlockUpload,
    /// Expects segments; `seq` is the last one in order.
    BlockUploadSegment {
        seq: u8,
    },
    /// Has the last segment and expects the end.
    BlockUploadEnd,
    /// Expects the answer to the start of a block download.
    BlockDownload,
    /// Sends segments; `seq` is the last one sent.
    BlockDownloadSegment {
        seq: u8,
    },
    /// Expects the confirmation of the end.
    BlockDownloadEnd,
}

/// An SDO client. It borrows the values of
/// [`download_block_of`](SdoClient::download_block_of) and copies all others.
pub struct SdoClient<'v> {
    server: NodeId,
    timeout: Micros,
    state: State,
    index: u16,
    sub: u8,
    timer: Timer,
    outgoing: Option<Frame>,
    /// Segments per block in a download.
    block_size: u8,
    with_crc: bool,
    /// The length the device announced for an upload.
    announced: Option<usize>,
    /// How much of the value has been received, or sent and confirmed.
    at: usize,
    /// How much of the buffer is the value, or how long the borrowed one is.
    len: usize,
    data: [u8; CAPACITY],
    /// The value to write, unless it is in the buffer.
    borrowed: Option<&'v [u8]>,
}

impl<'v> SdoClient<'v> {
    /// The most bytes one transfer can carry, except for values that are borrowed: 146 segments.
    pub const CAPACITY: usize = CAPACITY;

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
            block_size: 0,
            with_crc: false,
            announced: None,
            at: 0,
            len: 0,
            data: [0; CAPACITY],
            borrowed: None,
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
        self.start(now, State::Upload, index, sub)?;
        self.request(0x40, [0; 4]);
        Ok(())
    }

    /// Starts to read an object by block transfer.
    ///
    /// # Errors
    /// [`Busy`] if a transfer is in progress.
    pub fn upload_block(&mut self, now: Micros, index: u16, sub: u8) -> Result<(), Busy> {
        self.start(now, State::BlockUpload, index, sub)?;
        self.request_block_upload();
        Ok(())
    }

    /// Starts to write an object: `data` is its value, little-endian.
    ///
    /// # Errors
    /// [`Busy`] if a transfer is in progress or the data are longer than
    /// [`CAPACITY`](Self::CAPACITY).
    pub fn download(&mut self, now: Micros, index: u16, sub: u8, data: &[u8]) -> Result<(), Busy> {
        self.start_with(now, State::Download, index, sub, data)?;
        match *data {
            [a] => self.request(0x2F, [a, 0, 0, 0]),
            [a, b] => self.request(0x2B, [a, b, 0, 0]),
            [a, b, c] => self.request(0x27, [a, b, c, 0]),
            [a, b, c, d] => self.request(0x23, [a, b, c, d]),
            _ => self.request(0x20 | SIZE_INDICATED, self.len_bytes()),
        }
        Ok(())
    }

    /// Starts to write an object by block transfer.
    ///
    /// # Errors
    /// [`Busy`] if a transfer is in progress or the data are longer than
    /// [`CAPACITY`](Self::CAPACITY).
    pub fn download_block(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        data: &[u8],
    ) -> Result<(), Busy> {
        self.start_with(now, State::BlockDownload, index, sub, data)?;
        self.request_block_download();
        Ok(())
    }

    /// Starts to write an object of any length by block transfer, from where `value` lies.
    ///
    /// # Errors
    /// [`Busy`] if a transfer is in progress.
    pub fn download_block_of(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        value: &'v [u8],
    ) -> Result<(), Busy> {
        self.start(now, State::BlockDownload, index, sub)?;
        (self.borrowed, self.len) = (Some(value), value.len());
        self.request_block_download();
        Ok(())
    }

    /// How many bytes of the value the device has confirmed, or has sent.
    #[must_use]
    pub const fn progress(&self) -> usize {
        self.at
    }

    /// Hands over a received frame; those of other services and devices are ignored.
    pub fn on_frame(&mut self, now: Micros, frame: &Frame) -> Option<Outcome> {
        if frame.id() != self.server.cob_id(RESPONSE) || self.is_idle() || frame.len() != 8 {
            return None;
        }
        if self.is_stale(*frame.padded()) {
            return None;
        }
        self.timer = Timer::at(now + self.timeout);
        match self.handle(*frame.padded()) {
            Ok(None) => None,
            Ok(Some(outcome)) => Some(self.finish(outcome)),
            Err(code) => {
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
        let segment = self.outgoing.take();
        segment.or_else(|| {
            let bytes = self.next_block_segment()?;
            Some(Frame::of(self.server.cob_id(REQUEST), bytes))
        })
    }

    /// When [`poll`](Self::poll) has something to do.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Micros> {
        self.timer.is_on().then(|| self.timer.moment())
    }

    /// The value read last, little-endian.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.borrowed
            .unwrap_or_else(|| self.data.get(..self.len).unwrap_or(&[]))
    }

    /// Whether a frame answers another request, one that was given up before the device answered.
    /// The answer to a segment (0 and 1) does not say of which object it is; it is never the answer
    /// to the start of a transfer.
    fn is_stale(&self, answer: [u8; 8]) -> bool {
        let [command, low, high, sub, ..] = answer;
        let starts = matches!(
            self.state,
            State::Upload | State::Download | State::BlockUpload | State::BlockDownload
        );
        let same = u16::from_le_bytes([low, high]) == self.index && sub == self.sub;
        match command >> 5 {
            0 | 1 => starts,
            2 | 3 | 5 | 6 => starts && !same,
            _ => false,
        }
    }

    /// Takes an answer of the device.
    fn handle(&mut self, answer: [u8; 8]) -> Result<Option<Outcome>, AbortCode> {
        let [command, low, high, sub, a, b, c, d] = answer;
        if let State::BlockUploadSegment { seq } = self.state {
            return self.on_block_segment(seq, answer);
        }
        if command >> 5 == 4 {
            // Some devices leave the index of an abort empty, so it is not compared.
            let code = u32::from_le_bytes([a, b, c, d]);
            return Ok(Some(Outcome::Failed(SdoError::Aborted(code))));
        }
        let same = u16::from_le_bytes([low, high]) == self.index && sub == self.sub;
        match (self.state, command >> 5) {
            (State::Upload, 2) if same => self.on_upload(command, [a, b, c, d]),
            (State::UploadSegment { toggle }, 0) => self.on_upload_segment(toggle, answer),
            (State::Download, 3) if same => Ok(self.on_download()),
            (State::DownloadSegment { toggle }, 1) => self.on_download_segment(toggle, command),
            (State::BlockUpload, 6) if same => self.on_block_upload(command, [a, b, c, d]),
            // A device may answer the request for a block transfer with a plain one.
            (State::BlockUpload, 2) if same => self.on_upload(command, [a, b, c, d]),
            (State::BlockUploadEnd, 6) => self.on_block_upload_end(command, [low, high]),
            (State::BlockDownload, 5) if same => self.on_block_download(command, a),
            (State::BlockDownloadSegment { seq }, 5) => self.on_block_ack(seq, command, low, high),
            (State::BlockDownloadEnd, 5) if command & 0b11 == 1 => Ok(Some(Outcome::Downloaded)),
            _ => Err(AbortCode::CommandSpecifier),
        }
    }

    fn start(&mut self, now: Micros, state: State, index: u16, sub: u8) -> Result<(), Busy> {
        if !self.is_idle() {
            return Err(Busy);
        }
        (self.state, self.index, self.sub) = (state, index, sub);
        (self.at, self.len, self.announced) = (0, 0, None);
        self.borrowed = None;
        self.timer = Timer::at(now + self.timeout);
        Ok(())
    }

    fn start_with(
        &mut self,
        now: Micros,
        state: State,
        index: u16,
        sub: u8,
        data: &[u8],
    ) -> Result<(), Busy> {
        if data.len() > Self::CAPACITY {
            return Err(Busy);
        }
        self.start(now, state, index, sub)?;
        self.len = data.len();
        for (to, from) in self.data.iter_mut().zip(data) {
            *to = *from;
        }
        Ok(())
    }

    /// Adds received bytes to the value.
    fn collect(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        let end = self.at.saturating_add(bytes.len());
        self.data
            .get_mut(self.at..end)
            .ok_or(AbortCode::OutOfMemory)?
            .copy_from_slice(bytes);
        self.at = end;
        Ok(())
    }

    /// The value is complete, if it is as long as announced.
    fn uploaded(&mut self, len: usize) -> Result<Option<Outcome>, AbortCode> {
        match self.announced {
            Some(announced) if len > announced => Err(AbortCode::TooLong),
            Some(announced) if len < announced => Err(AbortCode::TooShort),
            Some(_) | None => {
                self.len = len;
                Ok(Some(Outcome::Uploaded))
            }
        }
    }

    /// Up to seven bytes of the value from `at` on, and how many are unused.
    fn segment(&self, at: usize) -> ([u8; 7], u8) {
        let mut bytes = [0; 7];
        let mut unused = 7u8;
        let rest = self.data().get(at..);
        for (to, from) in bytes.iter_mut().zip(rest.unwrap_or(&[])) {
            *to = *from;
            unused = unused.saturating_sub(1);
        }
        (bytes, unused)
    }

    fn len_bytes(&self) -> [u8; 4] {
        u32::try_from(self.len).unwrap_or(0).to_le_bytes()
    }

    /// Queues a request that starts with the object's index and sub-index.
    fn request(&mut self, command: u8, value: [u8; 4]) {
        let [low, high] = self.index.to_le_bytes();
        let [a, b, c, d] = value;
        self.queue([command, low, high, self.sub, a, b, c, d]);
    }

    fn queue(&mut self, bytes: [u8; 8]) {
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

    fn client() -> SdoClient<'static> {
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
        let other = Frame::of(0x585, [0x60, 0x01, 0x20, 0, 0, 0, 0, 0]);
        assert_eq!(
            client.on_frame(Micros(1), &other),
            Some(Outcome::Failed(SdoError::Protocol(
                AbortCode::CommandSpecifier
            )))
        );
        assert_eq!(client.poll(Micros(u64::MAX - 1)), None);
    }

    /// It answers a request that was given up before, and does not keep this one waiting either.
    #[test]
    fn an_answer_about_another_object_is_passed_over() {
        let mut client = client();
        client.upload(Micros(0), 0x2001, 0).unwrap();
        let other = Frame::of(0x585, [0x43, 0x02, 0x20, 0, 0, 0, 0, 0]);
        assert_eq!(client.on_frame(Micros(50_000), &other), None);
        assert_eq!(client.next_deadline(), Some(Micros(100_000)));
        let answer = Frame::of(0x585, [0x4F, 0x01, 0x20, 0, 7, 0, 0, 0]);
        assert_eq!(
            client.on_frame(Micros(60_000), &answer),
            Some(Outcome::Uploaded)
        );
        assert_eq!(client.data(), &[7]);
    }

    /// A device that has answered a segment too late answers the next request all the same.
    #[test]
    fn a_late_segment_is_passed_over_at_the_start_of_a_transfer() {
        type Start = fn(&mut SdoClient) -> Result<(), Busy>;
        // The segment's bytes may even look like the object.
        let late = [
            [0x00, 0x01, 0x20, 3, 4, 5, 6, 7],
            [0x11, 1, 2, 3, 4, 5, 6, 7],
            [0x20, 0, 0, 0, 0, 0, 0, 0],
            [0x30, 0, 0, 0, 0, 0, 0, 0],
        ];
        let starts: [Start; 4] = [
            |client| client.upload(Micros(0), 0x2001, 3),
            |client| client.upload_block(Micros(0), 0x2001, 3),
            |client| client.download(Micros(0), 0x2001, 3, &[7]),
            |client| client.download_block(Micros(0), 0x2001, 3, &[7]),
        ];
        for start in starts {
            let mut client = client();
            start(&mut client).unwrap();
            for bytes in late {
                let frame = Frame::of(0x585, bytes);
                assert_eq!(
                    client.on_frame(Micros(50_000), &frame),
                    None,
                    "{bytes:02X?}"
                );
            }
            assert!(!client.is_idle());
            assert_eq!(client.next_deadline(), Some(Micros(100_000)));
        }
    }

    #[test]
    fn a_toggle_bit_that_does_not_alternate_ends_the_transfer() {
        let wrong = Some(Outcome::Failed(SdoError::Protocol(AbortCode::ToggleBit)));
        let answer = |client: &mut SdoClient, bytes: [u8; 8]| {
            while client.pop_frame().is_some() {}
            client.on_frame(Micros(1), &Frame::of(0x585, bytes))
        };
        let mut client = client();
        client.upload(Micros(0), 0x2001, 3).unwrap();
        let start = [0x41, 0x01, 0x20, 3, 14, 0, 0, 0];
        assert_eq!(answer(&mut client, start), None);
        assert_eq!(answer(&mut client, [0x00, 1, 2, 3, 4, 5, 6, 7]), None);
        assert_eq!(answer(&mut client, [0x00, 1, 2, 3, 4, 5, 6, 7]), wrong);
        let abort = Frame::of(0x605, [0x80, 0x01, 0x20, 3, 0, 0, 3, 5]);
        assert_eq!(client.pop_frame(), Some(abort));
        client.download(Micros(0), 0x2001, 3, &[0; 14]).unwrap();
        let start = [0x60, 0x01, 0x20, 3, 0, 0, 0, 0];
        assert_eq!(answer(&mut client, start), None);
        assert_eq!(answer(&mut client, [0x20, 0, 0, 0, 0, 0, 0, 0]), None);
        assert_eq!(answer(&mut client, [0x20, 0, 0, 0, 0, 0, 0, 0]), wrong);
    }
}
