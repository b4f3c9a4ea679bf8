//! The SDO server, through which a client reads and writes every object (CiA 301, 7.2.4).
//!
//! Requests arrive on 0x600 plus node-ID, and answers are sent on 0x580 plus node-ID. Values of up
//! to four bytes are in the request or answer itself; longer ones in segments (`segmented`) or
//! blocks with CRC (`block`), and are collected in one buffer, so that the application sees a value
//! whole or not at all. A value that does not fit into the buffer is refused, unless the
//! application has a [`Sink`](crate::Sink) for the object: then each piece is passed on as soon as
//! the next one shows that it was not the last (`stream`).
//!
//! There is one transfer at a time. While it lasts, the start of another one is refused with
//! 0x060A0023 and the first continues; it is aborted when its client is silent for `TIMEOUT`.

mod block;
mod segmented;
mod stream;

use super::Core;
use crate::time::Timer;
use crate::{AbortCode, Application, Event, Frame, Micros, NmtState, NodeId};

/// The longest value, in bytes, that can be read or written: 73 segments.
pub const MAX_SDO: usize = 511;

/// How long a transfer waits for the client.
const TIMEOUT: Micros = Micros::from_millis(1_000);

const SDO_RESPONSE: u16 = 0x580;

/// Client command specifiers, bits 5 to 7 of the first byte.
const DOWNLOAD_SEGMENT: u8 = 0;
const DOWNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const UPLOAD_SEGMENT: u8 = 3;
const ABORT: u8 = 4;
const BLOCK_UPLOAD: u8 = 5;
const BLOCK_DOWNLOAD: u8 = 6;

/// Bits of an initiate request or response.
const EXPEDITED: u8 = 0b10;
const SIZE_INDICATED: u8 = 0b01;

/// An answer, or none, or the reason to abort.
type Answer = Result<Option<[u8; 8]>, AbortCode>;

#[derive(Clone, Copy)]
enum State {
    Idle,
    /// Expects the next segment with this toggle bit.
    Download {
        toggle: bool,
    },
    /// Expects the request for the next segment with this toggle bit.
    Upload {
        toggle: bool,
    },
    /// Expects segments; `seq` is the last one in order.
    BlockDownload {
        seq: u8,
    },
    /// Has acknowledged the last segment and expects the end request.
    BlockDownloadEnd,
    /// Expects the client to start the block upload.
    BlockUploadStart,
    /// Sends segments whenever nothing else is to be sent; `seq` is the last one sent.
    BlockUpload {
        seq: u8,
    },
    /// Has sent the end of the block upload and expects its confirmation.
    BlockUploadEnd,
    /// The application is saving or restoring; this is the answer when it is done.
    Storing {
        answer: [u8; 8],
    },
}

#[derive(Clone)]
pub(super) struct Server {
    state: State,
    index: u16,
    sub: u8,
    /// The length the client announced for a download.
    announced: Option<usize>,
    /// Segments per block in an upload.
    block_size: u8,
    with_crc: bool,
    /// The download goes to a sink of the application.
    streams: bool,
    /// Of what the sink has got.
    crc: u16,
    timer: Timer,
    /// How much of the buffer is the value, or what is held back from the sink.
    len: usize,
    /// How much of the value the client has sent, or has confirmed.
    at: usize,
    buffer: [u8; MAX_SDO],
}

/// What a request needs to reach the objects.
struct Access<'a> {
    now: Micros,
    core: &'a mut Core,
    app: &'a mut (dyn Application + 'a),
}

impl Access<'_> {
    fn read(&self, index: u16, sub: u8, out: &mut [u8]) -> Result<usize, AbortCode> {
        self.core.read(index, sub, out, self.app)
    }

    fn write(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        self.core.write(self.now, index, sub, data, self.app)?;
        self.core.out.emit(Event::ObjectWritten { index, sub });
        Ok(())
    }
}

impl Server {
    pub const fn new() -> Self {
        Self {
            state: State::Idle,
            index: 0,
            sub: 0,
            announced: None,
            block_size: 0,
            with_crc: false,
            streams: false,
            crc: 0,
            timer: Timer::OFF,
            len: 0,
            at: 0,
            buffer: [0; MAX_SDO],
        }
    }

    /// Forgets any transfer without a word to its client.
    pub fn give_up(&mut self, app: &mut dyn Application) {
        if core::mem::take(&mut self.streams)
            && let Some(sink) = app.sink(self.index, self.sub)
        {
            sink.cancel();
        }
        self.reset();
    }

    fn reset(&mut self) {
        self.state = State::Idle;
        self.timer = Timer::OFF;
    }

    #[inline(never)]
    pub fn on_request(
        &mut self,
        now: Micros,
        frame: &Frame,
        core: &mut Core,
        app: &mut dyn Application,
    ) {
        let speaks = matches!(core.state, NmtState::PreOperational | NmtState::Operational);
        if !speaks || frame.len() != 8 {
            return;
        }
        let request = *frame.padded();
        let was_storing = core.storing;
        let mut access = Access { now, core, app };
        let handled = self.handle(request, &mut access);
        let Access { core, app, .. } = access;
        let answer = match handled {
            Ok(Some(answer)) if core.storing && !was_storing => {
                // The client waits as long as it takes; the application always comes back.
                self.timer = Timer::OFF;
                self.state = State::Storing { answer };
                return;
            }
            Ok(answer) => answer,
            Err(code) => {
                let [_, low, high, sub, ..] = request;
                // A refused start leaves the running transfer alone.
                let running = !self.is_idle() && code != AbortCode::NoResource;
                let (index, sub) = match running {
                    true => (self.index, self.sub),
                    false => (u16::from_le_bytes([low, high]), sub),
                };
                if code != AbortCode::NoResource {
                    self.give_up(app);
                }
                Some(abort(core, index, sub, code))
            }
        };
        if !matches!(self.state, State::Idle | State::Storing { .. }) {
            self.timer = Timer::at(now + TIMEOUT);
            core.out.wake(self.timer);
        }
        if let Some(answer) = answer {
            send(core, answer);
        }
    }

    /// Gives up a transfer whose client has fallen silent.
    pub fn poll(&mut self, now: Micros, core: &mut Core, app: &mut dyn Application) {
        if self.timer.due(now) {
            self.give_up(app);
            let answer = abort(core, self.index, self.sub, AbortCode::Timeout);
            send(core, answer);
        }
        core.out.wake(self.timer);
    }

    /// The application has saved or restored, or failed to.
    pub fn finish_store(&mut self, core: &mut Core, result: Result<(), AbortCode>) {
        core.storing = false;
        let State::Storing { answer } = self.state else {
            return;
        };
        self.reset();
        let answer = match result {
            Ok(()) => answer,
            Err(code) => abort(core, self.index, self.sub, code),
        };
        send(core, answer);
    }

    /// The next segment of a block upload.
    pub fn pop_frame(&mut self, node: Option<NodeId>) -> Option<Frame> {
        let id = node?.cob_id(SDO_RESPONSE);
        Some(Frame::of(id, self.next_segment()?))
    }

    fn handle(&mut self, request: [u8; 8], access: &mut Access<'_>) -> Answer {
        let [command, low, high, sub, a, b, c, d] = request;
        if let State::BlockDownload { seq } = self.state {
            return self.on_block_segment(seq, request, access);
        }
        if let State::Storing { .. } = self.state
            && command >> 5 != ABORT
        {
            return Err(AbortCode::NoResource);
        }
        let index = u16::from_le_bytes([low, high]);
        match command >> 5 {
            ABORT => {
                self.give_up(access.app);
                Ok(None)
            }
            DOWNLOAD => {
                self.start(index, sub)?;
                self.download(command, [a, b, c, d], access)
            }
            UPLOAD => {
                self.start(index, sub)?;
                self.upload(access)
            }
            DOWNLOAD_SEGMENT => self.on_download_segment(request, access),
            UPLOAD_SEGMENT => self.on_upload_segment(command),
            BLOCK_DOWNLOAD if command & 1 == 0 => {
                self.start(index, sub)?;
                self.start_block_download(command, u32::from_le_bytes([a, b, c, d]), access)
            }
            BLOCK_DOWNLOAD => self.end_block_download(command, [low, high], access),
            BLOCK_UPLOAD => match command & 0b11 {
                0 => {
                    self.start(index, sub)?;
                    self.start_block_upload(command, a, access)
                }
                1 => self.end_block_upload(),
                2 => self.on_block_acknowledge(low, high),
                _ => self.on_block_start(),
            },
            _ => Err(AbortCode::CommandSpecifier),
        }
    }

    const fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    /// A transfer of this object is to begin.
    fn start(&mut self, index: u16, sub: u8) -> Result<(), AbortCode> {
        if !self.is_idle() {
            return Err(AbortCode::NoResource);
        }
        (self.index, self.sub) = (index, sub);
        (self.len, self.at, self.announced) = (0, 0, None);
        (self.streams, self.crc) = (false, 0);
        Ok(())
    }

    /// Reads the object into the buffer.
    fn fetch(&mut self, access: &Access<'_>) -> Result<(), AbortCode> {
        let len = access.read(self.index, self.sub, &mut self.buffer)?;
        self.len = len.min(MAX_SDO);
        Ok(())
    }

    /// Checks what can be checked before the data of a download come.
    fn announce(
        &mut self,
        announced: Option<u32>,
        access: &mut Access<'_>,
    ) -> Result<(), AbortCode> {
        if self.begin_stream(announced, access)? {
            return Ok(());
        }
        let probe = access.read(self.index, self.sub, &mut self.buffer);
        if let Err(code @ (AbortCode::NoObject | AbortCode::NoSubIndex)) = probe {
            return Err(code);
        }
        self.announced = announced.and_then(|len| usize::try_from(len).ok());
        match self.announced {
            Some(len) if len > MAX_SDO => Err(AbortCode::OutOfMemory),
            Some(_) | None => Ok(()),
        }
    }

    /// Adds received bytes to the buffer, or passes on those that came before.
    fn collect(&mut self, bytes: &[u8], access: &mut Access<'_>) -> Result<(), AbortCode> {
        if self.streams {
            return self.stream(bytes, access);
        }
        let end = self.at.saturating_add(bytes.len());
        self.buffer
            .get_mut(self.at..end)
            .ok_or(AbortCode::OutOfMemory)?
            .copy_from_slice(bytes);
        self.at = end;
        Ok(())
    }

    /// Writes the object, if it is as long as announced.
    fn deliver(&mut self, len: usize, access: &mut Access<'_>) -> Result<(), AbortCode> {
        match self.announced {
            Some(announced) if len > announced => return Err(AbortCode::TooLong),
            Some(announced) if len < announced => return Err(AbortCode::TooShort),
            Some(_) | None => {}
        }
        if self.streams {
            self.finish_stream(access)?;
        } else {
            let value = self.buffer.get(..len).ok_or(AbortCode::OutOfMemory)?;
            access.write(self.index, self.sub, value)?;
        }
        self.reset();
        Ok(())
    }

    /// A frame with up to seven bytes of the value from `at` on behind its first one, and how many
    /// are unused.
    fn segment(&self, at: usize) -> ([u8; 8], u8) {
        let mut bytes = [0; 8];
        let mut unused = 7u8;
        let rest = self
            .buffer
            .get(..self.len)
            .and_then(|value| value.get(at..));
        for (to, from) in bytes.iter_mut().skip(1).zip(rest.unwrap_or(&[])) {
            *to = *from;
            unused = unused.saturating_sub(1);
        }
        (bytes, unused)
    }

    /// A frame that starts with the object's index and sub-index.
    fn reply(&self, command: u8, value: [u8; 4]) -> [u8; 8] {
        let [low, high] = self.index.to_le_bytes();
        let [a, b, c, d] = value;
        [command, low, high, self.sub, a, b, c, d]
    }

    fn len_bytes(&self) -> [u8; 4] {
        u32::try_from(self.len).unwrap_or(0).to_le_bytes()
    }
}

fn send(core: &mut Core, answer: [u8; 8]) {
    if let Some(node) = core.node {
        core.out.send(Frame::of(node.cob_id(SDO_RESPONSE), answer));
    }
}

fn abort(core: &mut Core, index: u16, sub: u8, code: AbortCode) -> [u8; 8] {
    core.out.count(|counters| &mut counters.sdo_aborts);
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = code.code().to_le_bytes();
    [0x80, low, high, sub, a, b, c, d]
}
