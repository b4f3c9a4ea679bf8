//! The emulated board as a bench: a bus at 1 Mbit/s with the master at its other end, the wires of
//! level 1, and mutations.

pub mod mutation;
mod second;

use canopen::Frame;
use emulator::{Board, BoardConfig, CanError, CanFrame, Firmware, Port};

use crate::bench::{Bench, Debugger, Image};
use crate::wires::{self, WIRES, Wire};
pub use mutation::Mutation;
use second::Second;

const US: u64 = 1_000;
/// A bit on the bus, ns.
const BIT_NS: u64 = 1_000;
/// How long the board is off in a power cycle.
const OFF_NS: u64 = 500_000 * US;
/// Node number of the board with all switches open.
pub const NODE: u8 = protocol::FIRST_ROBOT;

/// The images.
pub struct Images {
    /// Self-test.
    pub self_test: Firmware,
    /// As shipped.
    pub shipped: Firmware,
}

/// An emulated board on its bus.
pub struct EmulatedBench<'a> {
    images: &'a Images,
    config: BoardConfig,
    wires: Vec<Wire>,
    /// What is wrong outside the chip.
    faults: Faults,
    sent: u32,
    image: Image,
    board: Board,
    second: Option<Second>,
    /// World time at which the board was switched on.
    on_ns: u64,
}

/// What is wrong outside the chip, or in what its program does.
#[derive(Debug, Clone, Copy)]
pub struct Faults {
    /// Every so many frames of the board is damaged on the wire.
    pub damaged_every: Option<u32>,
    /// How long the bits of the other node are, over what they should be.
    pub bit_time_of_others: f64,
    /// A word that a stray write of the shipped program changes.
    pub stray_write: Option<u32>,
    /// The number of the start is lost in a power cycle, with all that is stored.
    pub forgets: bool,
    /// The second board hears frames this much later than the first, ns.
    pub second_late_ns: u64,
    /// The wire from the second board is not in.
    pub second_wire_missing: bool,
}

impl Default for Faults {
    fn default() -> Self {
        Self {
            damaged_every: None,
            bit_time_of_others: 1.0,
            stray_write: None,
            forgets: false,
            second_late_ns: 0,
            second_wire_missing: false,
        }
    }
}

fn port(pin: u8) -> (Port, u8) {
    (Port::ALL[usize::from(pin >> 4)], pin & 15)
}

impl<'a> EmulatedBench<'a> {
    /// A board with all wires, and what a mutation does to it.
    #[must_use]
    pub fn new(images: &'a Images, mutation: Option<&Mutation>) -> Self {
        let mut config = BoardConfig::default();
        let mut faults = Faults::default();
        if let Some(mutation) = mutation {
            mutation.apply(&mut config, &mut faults);
        }
        Self::with_wires(images, config, faults, WIRES.to_vec())
    }

    /// A board with something wrong outside it.
    #[must_use]
    pub fn with_faults(images: &'a Images, faults: Faults) -> Self {
        Self::with_wires(images, BoardConfig::default(), faults, WIRES.to_vec())
    }

    /// A board without defects and with these wires.
    #[must_use]
    pub fn wired(images: &'a Images, wires: Vec<Wire>) -> Self {
        Self::with_wires(images, BoardConfig::default(), Faults::default(), wires)
    }

    fn with_wires(
        images: &'a Images,
        config: BoardConfig,
        faults: Faults,
        wires: Vec<Wire>,
    ) -> Self {
        let board = Board::new(&images.self_test, config.clone());
        let mut bench = Self {
            images,
            config,
            wires,
            faults,
            sent: 0,
            image: Image::SelfTest,
            board,
            second: None,
            on_ns: 0,
        };
        bench.attach();
        bench
    }

    fn attach(&mut self) {
        for wire in &self.wires {
            self.board.connect(port(wire.from), port(wire.to));
        }
    }

    fn now_ns(&self) -> u64 {
        self.on_ns + self.board.now_ns()
    }

    /// Runs the board until a world time, and the second one first: its edges come by wire.
    fn run(&mut self, world_ns: u64) -> anyhow::Result<()> {
        if let Some(second) = &mut self.second {
            let edges = second.run(world_ns)?;
            for (at_ns, high) in edges {
                if !self.faults.second_wire_missing {
                    self.run_first(at_ns)?;
                    let (to, pin) = port(wires::SECOND.to);
                    self.board.set_input(to, pin, high);
                }
            }
        }
        self.run_first(world_ns)
    }

    fn run_first(&mut self, world_ns: u64) -> anyhow::Result<()> {
        let local = world_ns.saturating_sub(self.on_ns);
        self.board
            .run_until(local)
            .map_err(|stop| anyhow::anyhow!("{stop}"))
    }

    /// A board that has just been switched on, with this content of its flash, or only the image.
    fn switch_on(&mut self, content: Option<&[u8]>) {
        self.on_ns = self.now_ns() + OFF_NS;
        let firmware = match self.image {
            Image::SelfTest => &self.images.self_test,
            Image::Shipped => &self.images.shipped,
        };
        let config = self.config.clone();
        self.board = match content {
            Some(content) => Board::with_flash(firmware, config, content),
            None => Board::new(firmware, config),
        };
        self.attach();
    }

    /// Lets the board's next frame pass, or be damaged; `None` if there is none before a time.
    fn next_frame(&mut self, until_ns: u64) -> anyhow::Result<Option<CanFrame>> {
        loop {
            if let Some(frame) = self.next_of_second()? {
                return Ok(Some(frame));
            }
            if self.board.can().pending().is_none() {
                if self.second.is_some() {
                    if self.now_ns() >= until_ns {
                        return Ok(None);
                    }
                    self.run(until_ns.min(self.now_ns() + second::SLICE_NS))?;
                    continue;
                }
                let local = until_ns.saturating_sub(self.on_ns);
                if self.board.now_ns() >= local {
                    return Ok(None);
                }
                let ran = self.board.run_until_request(local);
                ran.map_err(|stop| anyhow::anyhow!("{stop}"))?;
                continue;
            }
            let Some(frame) = self.board.can().begin() else {
                continue;
            };
            let end = self.now_ns() + u64::from(frame.bits()) * BIT_NS;
            self.run(end)?;
            self.sent += 1;
            if let Some(address) = self.faults.stray_write
                && self.image == Image::Shipped
            {
                let written = self.board.write_ram(address, &[0; 4]);
                anyhow::ensure!(written.is_some(), "there is no RAM at {address:#010x}");
            }
            if self
                .faults
                .damaged_every
                .is_some_and(|every| self.sent.is_multiple_of(every))
            {
                self.board.can().error(CanError::BitRecessive);
                continue;
            }
            self.board.can().transmitted();
            self.pass_to_second(&frame)?;
            return Ok(Some(frame));
        }
    }
}

fn to_emulator(frame: &Frame) -> Option<CanFrame> {
    CanFrame::new(frame.id(), frame.data())
}

fn from_emulator(frame: &CanFrame) -> Option<Frame> {
    Frame::new(frame.standard_id()?, frame.data())
}

impl Debugger for EmulatedBench<'_> {
    fn read(&mut self, address: u32, words: usize) -> anyhow::Result<Vec<u32>> {
        const PERIPHERALS: u32 = 0x4000_0000;
        let of = |place: usize| {
            let address = address + 4 * place as u32;
            match address {
                PERIPHERALS.. => Some(self.board.read_register(address)),
                _ => self.board.read_word(address),
            }
        };
        let read: Option<Vec<u32>> = (0..words).map(of).collect();
        read.ok_or_else(|| anyhow::anyhow!("there is no memory at {address:#010x}"))
    }

    fn write(&mut self, address: u32, word: u32) -> anyhow::Result<()> {
        self.board.write_register(address, word);
        Ok(())
    }
}

impl Bench for EmulatedBench<'_> {
    fn now_us(&self) -> u64 {
        self.now_ns() / US
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        if let Some(frame) = to_emulator(frame) {
            let end = self.now_ns() + u64::from(frame.bits()) * BIT_NS;
            let bit_time = self.faults.bit_time_of_others;
            self.board.can().arrives(&frame, bit_time);
            self.run(end)?;
            self.board.can().receive(&frame);
            self.pass_to_second(&frame)?;
        }
        Ok(())
    }

    fn receive(&mut self, until_us: u64) -> anyhow::Result<Option<(u64, Frame)>> {
        while let Some(frame) = self.next_frame(until_us * US)? {
            if let Some(frame) = from_emulator(&frame) {
                return Ok(Some((self.now_us(), frame)));
            }
        }
        Ok(None)
    }

    fn flash(&mut self, image: Image) -> anyhow::Result<()> {
        self.image = image;
        self.switch_on(None);
        Ok(())
    }

    fn power_cycle(&mut self) -> anyhow::Result<()> {
        let content = self.board.flash();
        let kept = (!self.faults.forgets).then_some(&content[..]);
        self.switch_on(kept);
        Ok(())
    }

    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()> {
        let out: Vec<Wire> = wires.iter().map(|place| wires::at(*place)).collect();
        self.wires.retain(|wire| !out.contains(wire));
        Ok(())
    }

    fn join_second(&mut self) -> anyhow::Result<Option<u8>> {
        self.wires = wires::WITH_SECOND.map(wires::at).to_vec();
        self.flash(Image::Shipped)?;
        self.second = Some(Second::start(&self.images.shipped, self.now_ns()));
        Ok(Some(NODE + 1))
    }

    fn debugger(&mut self) -> Option<&mut dyn Debugger> {
        Some(self)
    }

    fn force_bus_off(&mut self) -> anyhow::Result<()> {
        let end = self.now_ns() + 10_000_000 * US;
        while !self.board.can().bus_off() {
            anyhow::ensure!(self.now_ns() < end, "the board sends nothing");
            if self.board.can().begin().is_none() {
                let ran = self.board.run_until_request(end - self.on_ns);
                ran.map_err(|stop| anyhow::anyhow!("{stop}"))?;
                continue;
            }
            let next = self.now_ns() + 20 * BIT_NS;
            self.run(next)?;
            self.board.can().error(CanError::BitRecessive);
        }
        Ok(())
    }
}
