//! An emulated robot behind its boot code, and a client of its SDO server.

use boot::{Flash, FlashError, Slot, slots};
use canopen::client::{Outcome, SdoClient, SdoError};
use canopen::{Frame, Micros, NodeId};
use emulator::{Board, BoardConfig, CanFrame, Firmware, Stop, StopKind};
use protocol::{Address, address as at, cob};
use sim::robot::emulated::ready_board_with;

pub const MS: u64 = 1_000_000;
/// A robot with all switches open, or without any.
pub const NODE: u8 = 2;
/// A frame of eight bytes on the bus.
const FRAME_NS: u64 = 130_000;
/// Longest time from power or reset to the boot-up message, with a checksum of both images.
const BOOT_UP_NS: u64 = 60 * MS;
/// Timeouts of python-canopen and of Zephyr's client.
pub const SHORT_US: u64 = 300_000;
pub const LONG_US: u64 = 1_000_000;

/// Why a transfer came to nothing.
#[derive(Debug, PartialEq, Eq)]
pub enum Failure {
    /// The robot refused with this code.
    Refused(u32),
    /// It did not answer in time.
    Silent,
    /// The power failed in a flash operation.
    PowerCut,
}

/// The content of a chip's flash.
#[derive(Clone, PartialEq)]
pub struct Content(pub Vec<u8>);

impl Flash for Content {
    fn word(&self, address: u32) -> u32 {
        let at = (address - slots::BOOT) as usize;
        u32::from_le_bytes(*self.0[at..].first_chunk().unwrap())
    }

    fn program(&mut self, _: u32, _: u32) -> Result<(), FlashError> {
        unreachable!("the robot writes its flash")
    }

    fn erase(&mut self, _: u8) -> Result<(), FlashError> {
        unreachable!("the robot writes its flash")
    }
}

/// See the [module](self).
#[derive(Clone)]
pub struct Robot {
    pub board: Board,
    /// What the robot has sent, with the time in ns.
    pub received: Vec<(u64, Frame)>,
    /// How long the client waits for an answer, us.
    pub timeout_us: u64,
    /// The master speaks: its heartbeat and SYNC come every 10 ms.
    pub master: bool,
    next_sync: u64,
}

impl Robot {
    /// A robot with this content of its flash, at power-on.
    pub fn new(firmware: &Firmware, content: Option<&Content>) -> Self {
        Self::with(firmware, content, BoardConfig::default())
    }

    pub fn with(firmware: &Firmware, content: Option<&Content>, config: BoardConfig) -> Self {
        let flashed;
        let flash = match content {
            Some(content) => &content.0,
            None => {
                flashed = Board::new(firmware, BoardConfig::default()).flash();
                &flashed
            }
        };
        let board = ready_board_with(firmware, flash, config).unwrap();
        Self {
            board,
            received: Vec::new(),
            timeout_us: LONG_US,
            master: false,
            next_sync: 0,
        }
    }

    pub fn content(&self) -> Content {
        Content(self.board.flash())
    }

    /// The slot that it runs from.
    pub fn slot(&mut self) -> Option<Slot> {
        match self.read(at::RUNNING_SLOT) {
            Ok(1) => Some(Slot::A),
            Ok(2) => Some(Slot::B),
            _ => None,
        }
    }

    /// Runs until its next boot-up message; `false` if none comes.
    pub fn boots(&mut self) -> Result<bool, Failure> {
        self.boots_within(BOOT_UP_NS)
    }

    pub fn boots_within(&mut self, ns: u64) -> Result<bool, Failure> {
        let before = self.received.len();
        let end = self.board.now_ns() + ns;
        let boot_up = Frame::of(cob::heartbeat(NODE), [0]);
        while self.board.now_ns() < end {
            self.step(end)?;
            if self.received[before..]
                .iter()
                .any(|(_, frame)| *frame == boot_up)
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Runs for so long.
    pub fn pass(&mut self, ns: u64) -> Result<(), Failure> {
        let end = self.board.now_ns() + ns;
        while self.board.now_ns() < end {
            self.step(end)?;
        }
        Ok(())
    }

    /// Runs until it sends something, or to the end; its master speaks when it is time to.
    fn step(&mut self, end: u64) -> Result<(), Failure> {
        let now = self.board.now_ns();
        let mut until = end;
        if self.master {
            if now >= self.next_sync {
                self.next_sync = now + 10 * MS;
                self.send(&Frame::of(cob::MASTER_HEARTBEAT, [5]))?;
                self.send(&Frame::of(cob::SYNC, []))?;
            }
            until = until.min(self.next_sync);
        }
        power(self.board.run_until_request(until))?;
        while let Some(frame) = self.board.can().begin() {
            power(self.board.run_until(self.board.now_ns() + FRAME_NS))?;
            self.board.can().transmitted();
            let id = frame.standard_id().expect("a robot sends nothing else");
            let frame = Frame::new(id, frame.data()).unwrap();
            self.received.push((self.board.now_ns(), frame));
        }
        Ok(())
    }

    /// Sends a frame to the robot.
    pub fn send(&mut self, frame: &Frame) -> Result<(), Failure> {
        power(self.board.run_until(self.board.now_ns() + FRAME_NS))?;
        let frame = CanFrame::new(frame.id(), frame.data()).unwrap();
        self.board.can().receive(&frame);
        Ok(())
    }

    fn now(&self) -> Micros {
        Micros(self.board.now_ns() / 1_000)
    }

    fn client(&self) -> SdoClient<'static> {
        SdoClient::new(NodeId::new(NODE).unwrap(), Micros(self.timeout_us))
    }

    /// Until the client has an outcome; after `frames` of its frames it says nothing any more.
    fn transfer(
        &mut self,
        client: &mut SdoClient<'_>,
        mut frames: usize,
    ) -> Result<Vec<u8>, Failure> {
        let mut seen = self.received.len();
        let outcome = loop {
            while frames > 0
                && let Some(frame) = client.pop_frame()
            {
                self.send(&frame)?;
                frames -= 1;
            }
            self.step(self.board.now_ns() + MS / 2)?;
            let now = self.now();
            let mut outcome = None;
            for (_, frame) in &self.received[seen..] {
                outcome = outcome.or(client.on_frame(now, frame));
            }
            seen = self.received.len();
            if let Some(outcome) = outcome.or_else(|| client.poll(now)) {
                break outcome;
            }
        };
        match outcome {
            Outcome::Uploaded | Outcome::Downloaded => Ok(client.data().to_vec()),
            Outcome::Failed(SdoError::Aborted(code)) => Err(Failure::Refused(code)),
            Outcome::Failed(SdoError::Timeout) => {
                // The client's word that it has given up.
                while let Some(frame) = client.pop_frame() {
                    self.send(&frame)?;
                }
                Err(Failure::Silent)
            }
            Outcome::Failed(error) => panic!("{error}"),
        }
    }

    pub fn read(&mut self, address: Address) -> Result<u32, Failure> {
        let mut client = self.client();
        client
            .upload(self.now(), address.index, address.sub)
            .unwrap();
        let bytes = self.transfer(&mut client, usize::MAX)?;
        Ok(bytes
            .iter()
            .rev()
            .fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    pub fn write(&mut self, address: Address, data: &[u8]) -> Result<(), Failure> {
        let mut client = self.client();
        client
            .download(self.now(), address.index, address.sub, data)
            .unwrap();
        self.transfer(&mut client, usize::MAX).map(|_| ())
    }

    pub fn control(&mut self, order: u8) -> Result<(), Failure> {
        self.write(at::PROGRAM_CONTROL, &[order])
    }

    /// Downloads into 0x1F50 in blocks.
    pub fn download(&mut self, value: &[u8]) -> Result<(), Failure> {
        self.download_part(value, usize::MAX)
    }

    /// The same, but the client falls silent after so many frames.
    pub fn download_part(&mut self, value: &[u8], frames: usize) -> Result<(), Failure> {
        let mut client: SdoClient<'_> =
            SdoClient::new(NodeId::new(NODE).unwrap(), Micros(self.timeout_us));
        let Address { index, sub } = at::PROGRAM_DATA;
        client
            .download_block_of(self.now(), index, sub, value)
            .unwrap();
        self.transfer(&mut client, frames).map(|_| ())
    }

    /// Polls 0x1F57 until it is not busy, and returns it; each answer has to come in time.
    pub fn ready(&mut self) -> Result<u32, Failure> {
        for _ in 0..1_000 {
            let status = self.read(at::FLASH_STATUS)?;
            if status & 1 == 0 {
                return Ok(status);
            }
            self.pass(20 * MS)?;
        }
        panic!("busy for 20 s")
    }
}

fn power<T>(result: Result<T, Stop>) -> Result<T, Failure> {
    match result {
        Ok(done) => Ok(done),
        Err(stop) if matches!(stop.kind, StopKind::PowerCut) => Err(Failure::PowerCut),
        Err(stop) => panic!("{stop}"),
    }
}
