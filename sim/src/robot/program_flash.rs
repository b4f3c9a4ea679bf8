//! The two slots of a native robot's flash.
//!
//! A native robot is not run from them: it is the simulator's own program. But it keeps an image
//! that it is sent, starts it on trial and goes back as a robot with boot code does, and says that
//! it has the version of the image that would run. Erasing and programming take no time.

use std::collections::HashMap;

#[cfg(feature = "host")]
pub use boot::Software as Signatures;
use boot::records::{self, BLANK, CABLE, Candidate, Reason, Seal};
use boot::{Checksum, Flash, FlashError, Slot, slots};

/// Words that are not blank, by address.
#[derive(Clone)]
pub struct ProgramFlash(HashMap<u32, u32>);

impl ProgramFlash {
    /// As a cable leaves it: an image in slot A.
    pub fn new() -> Self {
        let start = Slot::A.address();
        let vectors = [(start, 0x2000_8000), (start + 4, start + 0x201)];
        Self(vectors.into_iter().chain([(slots::MARK, CABLE)]).collect())
    }

    /// What the boot code does at a start: the slot that is started, and what is known about it.
    pub fn start(&mut self) -> (Slot, Option<Seal>) {
        let checksum = |address: u32, length: u32| {
            let words = (address..address + length).step_by(4);
            let words = words.map(|address| self.word(address));
            Checksum::NEW.over(words).value()
        };
        let whole = |one: &Candidate| one.is_whole(self, checksum);
        let candidates = records::candidates(self);
        let Some(first) = candidates.into_iter().flatten().find(whole) else {
            return (Slot::A, None);
        };
        if first.reason == Reason::Trial {
            // It is a trial because there is an attempt left.
            let _ = records::count_attempt(self, first.slot);
        }
        (first.slot, first.seal)
    }
}

impl Flash for ProgramFlash {
    fn word(&self, address: u32) -> u32 {
        self.0.get(&address).copied().unwrap_or(BLANK)
    }

    fn program(&mut self, address: u32, word: u32) -> Result<(), FlashError> {
        *self.0.entry(address).or_insert(BLANK) &= word;
        Ok(())
    }

    fn erase(&mut self, sector: u8) -> Result<(), FlashError> {
        for slot in Slot::ALL {
            let mut start = slot.address();
            for (one, length) in slot.sectors() {
                let range = start..start + length;
                if one == sector {
                    self.0.retain(|address, _| !range.contains(address));
                    return Ok(());
                }
                start = range.end;
            }
        }
        Err(FlashError)
    }
}

/// A page in a browser has no client that updates robots, and has no room for what checks images:
/// none is signed.
#[cfg(not(feature = "host"))]
#[derive(Clone, Copy, Debug, Default)]
pub struct Signatures;

#[cfg(not(feature = "host"))]
impl boot::Crypto for Signatures {
    type Hash = ();

    fn begin(&self) {}

    fn update(&self, (): &mut (), _bytes: &[u8]) {}

    fn finish(&self, (): ()) -> [u8; 64] {
        [0; 64]
    }

    fn is_signed(&self, _message: &[u8], _signature: &[u8; 64]) -> bool {
        false
    }
}
