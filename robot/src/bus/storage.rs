//! The way between the bus side and the platform's memory.

use canopen::{AbortCode, NmtState};
use control::time::Micros;
use protocol::{Fault, StoredFault};

use super::BusSide;
use crate::fault_memory::Memorable;
use crate::state::{self, State};
use crate::store::{IMAGE_MAX, Stored};
use control::interface::Mode;

impl BusSide {
    /// Takes in what the platform has stored, at start, before anything else, and the memory it may
    /// keep an image in. The parameters take effect if
    /// all of them are good; otherwise they have their defaults, and the robot is in fault and
    /// refuses to start until a master has saved or restored.
    pub fn load(&mut self, now: Micros, memory: &'static mut [u8; IMAGE_MAX], stored: Stored<'_>) {
        self.dictionary.store.give(memory);
        self.dictionary.store.keep(stored);
        self.dictionary.parameters = self.dictionary.store.parameters();
        if self.dictionary.store.corrupt.is_some() {
            self.transition(state::Event::StartRefused(Fault::ParametersCorrupt), now);
        }
    }

    /// An image that the platform must store now, in place of the one it has; then it calls
    /// [`BusSide::finish_store`]. Outputs are off and stay off until then.
    #[must_use]
    pub fn image_to_store(&self) -> Option<&[u8]> {
        let store = &self.dictionary.store;
        store.asked.then(|| store.image())
    }

    /// The image has been stored; or it has not, and this is what the platform has.
    pub fn finish_store(&mut self, outcome: Result<(), Stored<'_>>) {
        let store = &mut self.dictionary.store;
        store.asked = false;
        let answer = match outcome {
            Ok(()) => {
                store.corrupt = None;
                Ok(())
            }
            Err(stored) => {
                store.keep(stored);
                Err(AbortCode::Hardware)
            }
        };
        self.device.finish_store(answer);
    }

    /// Takes in the starts that the platform has counted and the faults that it has stored, the
    /// newest last; at start, before there is a new one.
    pub fn recall(&mut self, starts: u32, faults: impl Iterator<Item = [u8; StoredFault::LENGTH]>) {
        self.dictionary.memory.recall(starts, faults);
    }

    /// What the platform is to add to its fault memory now; then it calls [`BusSide::remembered`]
    /// and asks again. Outputs are off. It may take half a second; a start that comes meanwhile
    /// takes effect after that.
    #[must_use]
    pub fn to_remember(&self, now: Micros) -> Option<Memorable> {
        let may_write = self.is_off() && !self.dictionary.store.asked;
        self.dictionary.memory.next(now).filter(|_| may_write)
    }

    /// What was to be remembered is stored, or cannot be.
    pub fn remembered(&mut self, now: Micros, is_stored: bool) {
        self.dictionary.memory.stored(now, is_stored);
    }

    /// Whether the outputs are off, by both sides.
    pub(super) fn is_off(&self) -> bool {
        matches!(self.state, State::Ready | State::Faulted(_))
            && self.report.mode == Mode::Off
            && self.report.start == self.command.start
    }

    /// Whether the outputs are off and nothing has been asked that would change that.
    pub(super) fn is_at_rest(&self) -> bool {
        self.device.state() != NmtState::Operational && self.is_off()
    }
}
