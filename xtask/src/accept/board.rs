//! A real board as a bench: a bus of the master, and hands.
//!
//! The hands are a person who switches power and shorts the bus when asked, so the moments of both
//! are unknown here, and what would have to be timed from them is not tried. A probe flashes, and
//! reads memory; without one the person flashes as well. Behind an emulated adapter the hands are
//! its own ([`super::adapter`]).

use std::io::BufRead as _;
use std::path::PathBuf;

use acceptance::{Bench, Debugger, Image, Reading, wires};
use anyhow::{Context as _, bail};
use canopen::{Frame, Micros};
use omnibus::bus::link::Link;

use crate::flash::Probe;

/// Where the images are.
#[derive(Clone)]
pub struct Paths {
    /// Self-test.
    pub self_test: PathBuf,
    /// As shipped.
    pub shipped: PathBuf,
}

/// What is done to a board beside its bus, as in [`Bench`].
pub trait Hands {
    /// Writes an image into the board and starts it.
    fn flash(&mut self, image: Image) -> anyhow::Result<()>;

    /// Switches the board off and on.
    fn power_cycle(&mut self) -> anyhow::Result<()>;

    /// Shorts the bus for a second.
    fn short_the_bus(&mut self) -> anyhow::Result<()>;

    /// Takes wires out of the board.
    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()>;

    /// Puts a second board on the bus, as [`Bench::join_second`].
    fn join_second(&mut self) -> anyhow::Result<Option<u8>> {
        Ok(None)
    }

    /// The debugger, if there is one.
    fn debugger(&mut self) -> Option<&mut dyn Debugger>;
}

/// A board at the end of a link.
pub struct BoardBench {
    /// The bus.
    pub link: Box<dyn Link>,
    /// Who does the rest.
    pub hands: Box<dyn Hands>,
}

/// A person at the terminal, with a probe or without.
pub struct Person {
    /// What flashes; a person does without it.
    pub probe: Option<Probe>,
    /// What is flashed.
    pub paths: Paths,
    /// Whether there is a second board.
    pub second: bool,
}

impl Person {
    /// Asks for something to be done, and waits for Enter.
    fn ask(&mut self, request: &str) -> anyhow::Result<()> {
        eprintln!("{request}, then press Enter");
        let mut line = String::new();
        if std::io::stdin().lock().read_line(&mut line)? == 0 {
            bail!("this needs a person at a terminal, to {request}");
        }
        Ok(())
    }
}

impl Hands for Person {
    fn flash(&mut self, image: Image) -> anyhow::Result<()> {
        let path = match image {
            Image::SelfTest => self.paths.self_test.clone(),
            Image::Shipped => self.paths.shipped.clone(),
        };
        match &self.probe {
            Some(probe) => probe.write(&path).context("cannot flash the board"),
            None => self.ask(&format!(
                "write {} into the board and reset it",
                path.display()
            )),
        }
    }

    fn power_cycle(&mut self) -> anyhow::Result<()> {
        self.ask("switch the board off, wait a second, switch it on")
    }

    fn short_the_bus(&mut self) -> anyhow::Result<()> {
        self.ask("connect CAN high with CAN low for a second, take them apart again")
    }

    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()> {
        let one = |place: &u8| format!("{} ({})", place + 1, wires::at(*place).what);
        let all: Vec<String> = wires.iter().map(one).collect();
        self.ask(&format!("take out wires {}", all.join(" and ")))
    }

    fn join_second(&mut self) -> anyhow::Result<Option<u8>> {
        if !self.second {
            return Ok(None);
        }
        let stay = wires::WITH_SECOND.map(|place| (place + 1).to_string());
        let end = |pin| format!("{} ({})", wires::name(pin), wires::connector(pin));
        self.ask(&format!(
            "take out all wires but {}; write {} into a second board; join the grounds and the CAN \
             of both boards, on the second PC8, PB12 and PA6 with its ground, and {} of the second \
             with {} of the first (wire {}); switch the second on",
            stay.join(", "),
            self.paths.shipped.display(),
            end(wires::SECOND.from),
            end(wires::SECOND.to),
            wires::SECOND_NUMBER
        ))?;
        self.flash(Image::Shipped)?;
        Ok(Some(protocol::FIRST_ROBOT + 1))
    }

    fn debugger(&mut self) -> Option<&mut dyn Debugger> {
        let probe = self.probe.as_mut()?;
        Some(probe)
    }
}

impl Debugger for Probe {
    fn read(&mut self, address: u32, words: usize) -> anyhow::Result<Vec<u32>> {
        Probe::read(self, address, words)
    }

    fn write(&mut self, address: u32, word: u32) -> anyhow::Result<()> {
        self.poke(address, word)
    }

    fn read_meanwhile(&mut self, address: u32, words: usize) -> anyhow::Result<Reading> {
        let (answer, reading) = std::sync::mpsc::channel();
        let probe = self.clone();
        std::thread::spawn(move || answer.send(Probe::read(&probe, address, words)));
        Ok(reading)
    }
}

impl Bench for BoardBench {
    fn now_us(&self) -> u64 {
        self.link.now().0
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        Ok(self.link.send(frame)?)
    }

    fn receive(&mut self, until_us: u64) -> anyhow::Result<Option<(u64, Frame)>> {
        let received = self.link.receive(Micros(until_us))?;
        Ok(received.map(|(at, frame)| (at.0, frame)))
    }

    fn flash(&mut self, image: Image) -> anyhow::Result<()> {
        self.hands.flash(image)
    }

    fn power_cycle(&mut self) -> anyhow::Result<()> {
        self.hands.power_cycle()
    }

    fn force_bus_off(&mut self) -> anyhow::Result<()> {
        self.hands.short_the_bus()
    }

    fn take_out(&mut self, wires: &[u8]) -> anyhow::Result<()> {
        self.hands.take_out(wires)
    }

    fn join_second(&mut self) -> anyhow::Result<Option<u8>> {
        self.hands.join_second()
    }

    fn debugger(&mut self) -> Option<&mut dyn Debugger> {
        self.hands.debugger()
    }

    fn hands_are_timed(&self) -> bool {
        false
    }
}
