//! The two slots of flash that programs lie in, and what the boot code lends to a program.
//!
//! Only the slot that is not running is erased or programmed, but for the words at the end of the
//! running one that say what is known about it, and the mark of the cable. Erasing 128 KiB takes a
//! second typically and two at most at 32 bits (DS10693 rev 10, table 49), during which only code
//! in RAM runs: `can::away` says what [`ProgramFlash::saying`] was given.
//!
//! Signatures and hashes are functions of the boot code, found by a table at a fixed address. A
//! program without that table, or one that runs from neither slot, takes no update over the bus.

#![expect(
    unsafe_code,
    reason = "flash is memory that is read and written by address, and so are the boot code's \
              functions"
)]

use boot::services::{ADDRESS, HASH_BYTES, HashMemory, MAGIC, Services};
use boot::slots::{MARK, Slot};
use boot::{Crypto, Flash, FlashError};

use robot::update::StandIn;

use super::flash;
use crate::board::stm32::can::away;

/// Words of the mark of the cable.
const MARK_WORDS: u32 = 2;

/// Both slots, for a program that runs from one of them.
pub struct ProgramFlash {
    running: Slot,
}

/// Their flash, to be read and written.
pub struct Slots {
    running: Slot,
    stand_in: Option<StandIn>,
}

/// The boot code's signatures and hashes.
pub struct BootCode(&'static Services);

impl ProgramFlash {
    /// The flash and the functions of the boot code; `None` for a program that is in no slot, or
    /// without boot code.
    pub fn find() -> Option<(Self, BootCode)> {
        let vectors = cortex_m::peripheral::SCB::PTR;
        // SAFETY: a read of one register, which every Cortex-M4 has.
        let vectors = unsafe { (*vectors).vtor.read() };
        let running = Slot::containing(vectors)?;
        Some((Self { running }, BootCode::find()?))
    }

    /// Their flash. Sectors are erased only with something to say meanwhile; the mailboxes have to
    /// be empty then.
    pub fn saying(&mut self, stand_in: Option<StandIn>) -> Slots {
        Slots {
            running: self.running,
            stand_in,
        }
    }

    /// The slot that the program runs from.
    pub const fn running(&self) -> Slot {
        self.running
    }
}

impl BootCode {
    /// The functions of the boot code; `None` where there is none.
    pub fn find() -> Option<Self> {
        let table = ADDRESS as *const Services;
        // SAFETY: the address is aligned and in flash, which is always readable; of what is there
        // only a word is read, of which any bits are valid.
        let magic = unsafe { table.cast::<u32>().read() };
        if magic != MAGIC {
            return None;
        }
        // SAFETY: the magic word, whose last byte is the version, says that the boot code has put
        // its table here; `may_program` and `erase` leave sector 0 alone.
        let services = unsafe { &*table };
        Some(Self(services))
    }
}

impl Slots {
    fn may_program(&self, address: u32) -> bool {
        let running = self.running;
        address.is_multiple_of(4)
            && (running.other().range().contains(&address)
                || (running.tail()..running.range().end).contains(&address)
                || (MARK..MARK + 4 * MARK_WORDS).contains(&address))
    }
}

impl Flash for Slots {
    fn word(&self, address: u32) -> u32 {
        let is_mark = (MARK..MARK + 4 * MARK_WORDS).contains(&address);
        if !address.is_multiple_of(4) || !is_mark && Slot::containing(address).is_none() {
            return boot::records::BLANK;
        }
        // SAFETY: an aligned word of flash, which is always readable.
        unsafe { (address as *const u32).read_volatile() }
    }

    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError> {
        if !self.may_program(address) {
            return Err(FlashError);
        }
        // SAFETY: `may_program` admits words of the slot that does not run and of the records. The
        // program has nothing there but the static of the mark, which it only reads by address.
        unsafe { flash::program(address as *mut u32, word) }.map_err(|_| FlashError)
    }

    fn erase(&mut self, sector: u8) -> Result<(), FlashError> {
        let mut sectors = self.running.other().sectors().into_iter();
        if !sectors.any(|(one, _)| one == sector) {
            return Err(FlashError);
        }
        let Some(stand_in) = &self.stand_in else {
            return Err(FlashError);
        };
        flash::erase(sector, &mut || away::erase(stand_in)).map_err(|_| FlashError)
    }
}

impl Crypto for BootCode {
    type Hash = HashMemory;

    fn begin(&self) -> HashMemory {
        let mut hash = HashMemory([0; HASH_BYTES]);
        // SAFETY: the function is the boot code's, and the memory is this function's own.
        unsafe { (self.0.begin)(&raw mut hash) };
        hash
    }

    fn update(&self, hash: &mut HashMemory, bytes: &[u8]) {
        // SAFETY: `HashMemory` comes from `begin` alone; the bytes are those of the slice.
        unsafe { (self.0.update)(hash, bytes.as_ptr(), bytes.len()) };
    }

    fn finish(&self, mut hash: HashMemory) -> [u8; 64] {
        let mut result = [0; 64];
        // SAFETY: as above; the hash is taken by value and ends here, and the result has the length
        // that the function writes.
        unsafe { (self.0.finish)(&raw mut hash, &raw mut result) };
        result
    }

    fn is_signed(&self, message: &[u8], signature: &[u8; 64]) -> bool {
        // SAFETY: the message is a slice, the signature has the length that the function reads.
        unsafe { (self.0.is_signed)(message.as_ptr(), message.len(), signature) == 1 }
    }
}
