//! The slow jobs of an update: erasing, programming, checking. The platform does them between
//! frames, with its flash and its cryptography.

use boot::header::Header;
use boot::records::{self, Seal};
use boot::{Checksum, Crypto, Flash, FlashError, Slot};
use heapless::Vec;

use super::{Phase, Problem, Update};

/// What the platform has to do, when its answers are on the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Job {
    /// Erase the nth sector of the slot; a second or two without any program.
    Erase(u8),
    /// Program what has come, a few words.
    Program,
    /// Check and seal the image; a tenth of a second.
    Verify,
    /// Order the new image to be started, and reset.
    Start,
    /// Confirm the running image, two words.
    Confirm,
    /// Reject the running image, and reset.
    GoBack,
    /// Reset.
    Reset,
}

/// What a job has led to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Done {
    /// The program goes on.
    GoOn,
    /// The platform resets the processor now.
    Reset,
}

impl Update {
    /// Does what is to be done.
    pub fn work(&mut self, flash: &mut impl Flash, crypto: &impl Crypto) -> Done {
        let (Some(job), Some(running)) = (self.job(), self.running()) else {
            return Done::GoOn;
        };
        self.ordered = None;
        let done = self.execute(job, running, flash, crypto);
        if let Err(problem) = done {
            self.problem = problem;
            self.phase = Phase::Stopped;
        }
        if job != Job::Program {
            self.survey(flash);
        }
        match done {
            Ok(done) => done,
            Err(_) => Done::GoOn,
        }
    }

    fn execute(
        &mut self,
        job: Job,
        running: Slot,
        flash: &mut impl Flash,
        crypto: &impl Crypto,
    ) -> Result<Done, Problem> {
        let failed = |_: FlashError| Problem::Flash;
        let slot = running.other();
        match job {
            Job::Erase(nth) => self.erase(nth, slot, flash)?,
            Job::Program => self.program(flash)?,
            Job::Verify => {
                let seal = self.verify(slot, flash, crypto)?;
                records::seal(flash, slot, &seal).map_err(failed)?;
                self.phase = Phase::Ready;
            }
            Job::Start => {
                records::request_trial(flash, slot).map_err(failed)?;
                return Ok(Done::Reset);
            }
            Job::Confirm => records::confirm(flash, running).map_err(failed)?,
            Job::GoBack => {
                records::reject(flash, running).map_err(failed)?;
                return Ok(Done::Reset);
            }
            Job::Reset => return Ok(Done::Reset),
        }
        Ok(Done::GoOn)
    }

    /// The slot is [discarded](records::discard) first, so that one that is partly erased never
    /// looks whole; the sector with what is known about it goes before the other.
    fn erase(&mut self, nth: u8, slot: Slot, flash: &mut impl Flash) -> Result<(), Problem> {
        let failed = |_| Problem::Flash;
        let mut sectors = slot.sectors().into_iter().rev();
        if nth == 0 {
            records::discard(flash, slot).map_err(failed)?;
        }
        if let Some((sector, _)) = sectors.nth(usize::from(nth)) {
            flash.erase(sector).map_err(failed)?;
        }
        self.phase = if sectors.next().is_some() {
            Phase::Erasing(nth.saturating_add(1))
        } else {
            records::begin(flash, slot).map_err(failed)?;
            Phase::Cleared
        };
        Ok(())
    }

    fn program(&mut self, flash: &mut impl Flash) -> Result<(), Problem> {
        let mut words = self.waiting.chunks_exact(4);
        for bytes in &mut words {
            let word = bytes.try_into().map_or(0, u32::from_le_bytes);
            flash
                .program(self.address, word)
                .map_err(|_| Problem::Flash)?;
            self.address = self.address.saturating_add(4);
        }
        // An image is whole words, so at its end there is no rest.
        self.waiting = Vec::from_slice(words.remainder()).unwrap_or_default();
        Ok(())
    }

    /// The image as it lies in flash: whether it is the one that the header is signed for.
    fn verify(
        &self,
        slot: Slot,
        flash: &impl Flash,
        crypto: &impl Crypto,
    ) -> Result<Seal, Problem> {
        let header = Header::parse(&self.header).map_err(|_| Problem::Header)?;
        if !Header::is_signed(&self.header, crypto) {
            return Err(Problem::Signature);
        }
        let link = header.link(slot);
        let (mut hash, mut checksum) = (crypto.begin(), Checksum::NEW);
        let words = slot.address()..slot.address().saturating_add(link.length);
        for address in words.step_by(4) {
            let word = flash.word(address);
            crypto.update(&mut hash, &word.to_le_bytes());
            checksum = checksum.with(word);
        }
        if crypto.finish(hash) != link.hash {
            return Err(Problem::Hash);
        }
        let (stack, entry) = (flash.word(slot.address()), flash.word(slot.address() + 4));
        if !slot.has_vectors(stack, entry) {
            return Err(Problem::Header);
        }
        Ok(Seal {
            length: link.length,
            checksum: checksum.value(),
            version: header.version,
            security_counter: header.security_counter,
            sequence: records::next_sequence(flash),
        })
    }
}
