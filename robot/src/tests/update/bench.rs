//! A robot with 512 KiB of flash, its boot code, and a client of SDO.

use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use boot::header::{Board, Device, Header, Link};
use boot::records::{BLANK, candidates};
use boot::{Crypto, Flash, FlashError, Slot, Software, sign};
use canopen::client::{Outcome, SdoClient, SdoError};
use canopen::{Frame, NodeId};
use control::interface::Report;
use control::time::Micros;
use protocol::{Address, address as at, cob};

use crate::lock::{Code, Key, NO_KEY, hmac_sha512};
use crate::update::{Done, Job, order};
use crate::{BusSide, IMAGE_MAX, Identity, Memorable, Stored};

const BASE: u32 = 0x0800_0000;

/// 512 KiB by word, as the chip has it.
pub struct Chip {
    words: Vec<u32>,
    /// Operations until one fails.
    pub left: Option<u32>,
    pub erased: Vec<u8>,
}

impl Chip {
    /// Slot A was written by cable.
    pub fn new() -> Self {
        let mut chip = Self {
            words: vec![BLANK; 0x8_0000 / 4],
            left: None,
            erased: Vec::new(),
        };
        *chip.at(boot::slots::MARK) = boot::records::CABLE;
        *chip.at(Slot::A.address()) = 0x2000_8000;
        *chip.at(Slot::A.address() + 4) = Slot::A.address() + 0x201;
        chip
    }

    fn at(&mut self, address: u32) -> &mut u32 {
        &mut self.words[((address - BASE) / 4) as usize]
    }

    fn spend(&mut self) -> Result<(), FlashError> {
        match &mut self.left {
            Some(0) => return Err(FlashError),
            Some(left) => *left -= 1,
            None => {}
        }
        Ok(())
    }
}

impl Flash for Chip {
    fn word(&self, address: u32) -> u32 {
        self.words[((address - BASE) / 4) as usize]
    }

    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError> {
        self.spend()?;
        *self.at(address) &= word;
        Ok(())
    }

    fn erase(&mut self, sector: u8) -> Result<(), FlashError> {
        self.spend()?;
        let slot = Slot::ALL
            .into_iter()
            .find(|slot| slot.sectors().iter().any(|(one, _)| *one == sector))
            .expect("only slots are erased");
        let mut start = slot.address();
        for (one, length) in slot.sectors() {
            if one == sector {
                for address in (start..start + length).step_by(4) {
                    *self.at(address) = BLANK;
                }
            }
            start += length;
        }
        self.erased.push(sector);
        Ok(())
    }
}

/// What an image file has.
#[derive(Clone)]
pub struct File {
    pub header: Vec<u8>,
    pub a: Vec<u8>,
    pub b: Vec<u8>,
}

impl File {
    /// Signed with the development key; `change` may change the header before.
    pub fn new(change: impl FnOnce(&mut Header)) -> Self {
        Self::signed(&boot::key::DEVELOPMENT_PRIVATE, change)
    }

    pub fn signed(key: &[u8; 32], change: impl FnOnce(&mut Header)) -> Self {
        let image = |slot: Slot, length: u32| -> Vec<u8> {
            let mut bytes: Vec<u8> = (0..length).map(|at| (at * 31 + at / 256) as u8).collect();
            bytes[..4].copy_from_slice(&0x2000_8000_u32.to_le_bytes());
            bytes[4..8].copy_from_slice(&(slot.address() + 0x201).to_le_bytes());
            bytes
        };
        let (a, b) = (image(Slot::A, 2_000), image(Slot::B, 2_004));
        let link = |bytes: &[u8]| {
            let crypto = Software::default();
            let mut hash = crypto.begin();
            crypto.update(&mut hash, bytes);
            Link {
                length: bytes.len() as u32,
                hash: crypto.finish(hash),
            }
        };
        let mut header = Header {
            board: Board::NUCLEO_F446RE,
            hardware: 1,
            wire_version: protocol::WIRE_VERSION,
            version: 0x0002_0000,
            security_counter: 3,
            a: link(&a),
            b: link(&b),
        };
        change(&mut header);
        let mut bytes = header.to_bytes().to_vec();
        let signature = sign(key, &bytes);
        bytes.extend(signature);
        Self {
            header: bytes,
            a,
            b,
        }
    }

    pub fn download(&self, slot: Slot) -> Vec<u8> {
        let image = match slot {
            Slot::A => &self.a,
            Slot::B => &self.b,
        };
        [&self.header[..], image].concat()
    }
}

/// A robot with its flash and a client.
pub struct Bench {
    pub bus: BusSide,
    pub chip: Chip,
    pub now: Micros,
    /// Jobs that were done.
    pub jobs: Vec<Job>,
    pub resets: usize,
    /// The platform does its jobs.
    pub works: bool,
    /// What is in its flash besides programs.
    pub key: Key,
    pub starts: u32,
    /// The image of parameters, which an update leaves alone; empty for none.
    pub stored: Vec<u8>,
}

/// HMAC-SHA-512, as a robot has it of its boot code.
pub fn hmac(key: &Key, message: &[u8], out: &mut Code) -> bool {
    *out = hmac_sha512(&Software::default(), key, message);
    true
}

pub const NODE: u8 = 2;

/// A program that the boot code has started from this slot.
fn side(chip: &Chip, slot: Slot, now: Micros, stored: &[u8]) -> BusSide {
    let mut bus = BusSide::new(Identity {
        storage: true,
        slot: Some(slot),
        device_of_images: Device {
            board: Board::NUCLEO_F446RE,
            hardware: 1,
            security_counter: 2,
        },
        ..Identity::new(NodeId::new(NODE).unwrap(), 1)
    });
    bus.survey(chip);
    let memory = Box::leak(Box::new([0; IMAGE_MAX]));
    let stored = match stored {
        [] => Stored::Nothing,
        image => Stored::Image(image),
    };
    bus.load(now, memory, stored);
    bus.poll(now);
    while bus.pop_frame().is_some() {}
    bus
}

impl Bench {
    pub fn new() -> Self {
        let chip = Chip::new();
        Self {
            bus: side(&chip, Slot::A, Micros(1), &[]),
            chip,
            now: Micros(1_000),
            jobs: Vec::new(),
            resets: 0,
            works: true,
            key: NO_KEY,
            starts: 0,
            stored: Vec::new(),
        }
    }

    /// Does what is to be done after a frame, as the bus task does.
    pub fn work(&mut self) {
        while self.works
            && let Some(job) = self.bus.update_job()
        {
            self.jobs.push(job);
            let done = self
                .bus
                .work_on_update(&mut self.chip, &Software::default());
            if done == Done::Reset {
                self.resets += 1;
                self.restart();
            }
        }
    }

    /// The boot code counts an attempt and starts what is to be started.
    pub fn restart(&mut self) {
        let first = candidates(&self.chip)[0].expect("there is an image");
        if first.reason == boot::records::Reason::Trial {
            boot::records::count_attempt(&mut self.chip, first.slot).unwrap();
        }
        self.now = Micros(1_000);
        self.bus = side(&self.chip, first.slot, self.now, &self.stored);
        self.bus.load_lock(self.key, hmac);
        self.bus.recall(self.starts, core::iter::empty());
    }

    /// Puts into flash what waits for that.
    fn remember(&mut self) {
        while let Some(next) = self.bus.to_remember(self.now) {
            match next {
                Memorable::Key => self.key = *self.bus.new_key(),
                Memorable::Start => self.starts += 1,
                Memorable::Fault(_) => {}
            }
            self.bus.remembered(self.now, true);
        }
    }

    pub fn transfer(&mut self, client: &mut SdoClient<'_>) -> Result<Vec<u8>, u32> {
        self.transfer_beside(client, &[], 0)
    }

    /// The same; after so many of the client's frames come those of another client.
    pub fn transfer_beside(
        &mut self,
        client: &mut SdoClient<'_>,
        others: &[Frame],
        after: usize,
    ) -> Result<Vec<u8>, u32> {
        let mut sent = 0;
        let outcome = loop {
            self.now = self.now + Micros(100);
            if let Some(frame) = self.bus.pop_frame() {
                match client.on_frame(canopen::Micros(self.now.0), &frame) {
                    Some(outcome) => break outcome,
                    None => continue,
                }
            }
            let frame = client.pop_frame().expect("one of the two has to speak");
            self.bus.on_frame(self.now, &frame);
            sent += 1;
            if sent == after {
                for other in others {
                    self.bus.on_frame(self.now, other);
                }
            }
            // Only while the bus is quiet, as the bus task does it.
            if self.bus.update_job() == Some(Job::Program) {
                self.work();
            }
        };
        self.work();
        self.remember();
        match outcome {
            Outcome::Uploaded | Outcome::Downloaded => Ok(client.data().to_vec()),
            Outcome::Failed(SdoError::Aborted(code)) => Err(code),
            Outcome::Failed(error) => panic!("{error}"),
        }
    }

    pub fn client() -> SdoClient<'static> {
        SdoClient::new(NodeId::new(NODE).unwrap(), canopen::Micros(1_000_000))
    }

    pub fn write(&mut self, address: Address, data: &[u8]) -> Result<(), u32> {
        let mut client = Self::client();
        let now = canopen::Micros(self.now.0);
        client
            .download(now, address.index, address.sub, data)
            .unwrap();
        self.transfer(&mut client).map(|_| ())
    }

    pub fn read(&mut self, address: Address) -> u32 {
        let bytes = self.read_bytes(address).unwrap();
        bytes
            .iter()
            .rev()
            .fold(0, |value, byte| value << 8 | u32::from(*byte))
    }

    pub fn read_bytes(&mut self, address: Address) -> Result<Vec<u8>, u32> {
        let mut client = Self::client();
        let now = canopen::Micros(self.now.0);
        client.upload(now, address.index, address.sub).unwrap();
        self.transfer(&mut client)
    }

    pub fn control(&mut self, value: u8) -> Result<(), u32> {
        self.write(at::PROGRAM_CONTROL, &[value])
    }

    pub fn download(&mut self, value: &[u8]) -> Result<(), u32> {
        let mut client: SdoClient<'_> =
            SdoClient::new(NodeId::new(NODE).unwrap(), canopen::Micros(1_000_000));
        let now = canopen::Micros(self.now.0);
        client
            .download_block_of(now, at::PROGRAM_DATA.index, at::PROGRAM_DATA.sub, value)
            .unwrap();
        self.transfer(&mut client).map(|_| ())
    }

    pub fn problem(&mut self) -> u32 {
        self.read(at::UPDATE_PROBLEM)
    }

    pub fn nmt(&mut self, command: u8) {
        self.bus
            .on_frame(self.now, &Frame::new(0, &[command, NODE]).unwrap());
        self.bus.poll(self.now);
        while self.bus.pop_frame().is_some() {}
    }

    /// Ready for a download.
    pub fn cleared() -> Self {
        let mut bench = Self::new();
        bench.control(order::STOP).unwrap();
        bench.control(order::CLEAR).unwrap();
        bench
    }

    /// Runs a new image on trial in slot B.
    pub fn on_trial() -> Self {
        let mut bench = Self::cleared();
        bench
            .download(&File::new(|_| ()).download(Slot::B))
            .unwrap();
        bench.control(order::START).unwrap();
        bench
    }

    /// Time passes; SYNC and the master's heartbeat come if they shall.
    pub fn pass(&mut self, ms: u64, hears: bool) {
        for _ in 0..ms / 10 {
            self.now = self.now + Micros(10_000);
            if hears {
                let sync = Frame::new(0x80, &[]).unwrap();
                self.bus.on_frame(self.now, &sync);
                let heartbeat = Frame::new(cob::MASTER_HEARTBEAT, &[5]).unwrap();
                self.bus.on_frame(self.now, &heartbeat);
            }
            let report = Report {
                at: self.now,
                ..Report::NONE
            };
            self.bus.on_report(&report);
            self.bus.poll(self.now);
            while self.bus.pop_frame().is_some() {}
            self.work();
            self.remember();
        }
    }

    pub fn is_unchanged(&self) -> bool {
        candidates(&self.chip)[0].is_some_and(|first| first.slot == Slot::A) && self.resets == 0
    }
}
