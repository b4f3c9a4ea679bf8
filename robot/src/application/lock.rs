//! The objects of the lock, and what a locked robot refuses.

use canopen::{AbortCode, NmtState};
use protocol::address as at;
use protocol::{Address, Entry};

use super::Application;
use crate::lock::{CODE_LENGTH, Code};

impl Application {
    /// Lets something guarded happen, unless the robot is locked. What ends a trial of an image is
    /// let through: the start of that image has locked the robot, and either end is an image that
    /// was signed.
    pub(super) fn pass_lock(&mut self, entry: &Entry, data: &[u8]) -> Result<(), AbortCode> {
        let ends_trial = entry.address == at::PROGRAM_CONTROL
            && self.update.is_on_trial()
            && matches!(data, [0x80 | 0x81]);
        if entry.is_guarded() && !ends_trial {
            self.lock.pass(self.now())
        } else {
            Ok(())
        }
    }

    /// Writes what the response of the next attempt is to; only where it cannot come again at a
    /// later start, and where computing it delays no decision.
    #[inline(never)]
    pub(super) fn challenge(&self, out: &mut Code) -> Result<(), AbortCode> {
        if self.nmt == NmtState::Operational || !self.memory.has_stored_start() {
            return Err(AbortCode::DeviceState);
        }
        let (serial, start) = (self.identity.serial, self.memory.start);
        self.lock.challenge(serial, start, out)
    }

    /// Takes the response or a key. Not inlined, so that its stack is released.
    #[inline(never)]
    pub(super) fn write_lock(&mut self, address: Address, data: &[u8]) -> Result<(), AbortCode> {
        if address == at::LOCK_RESPONSE {
            let mut message = [self.identity.node.get(); CODE_LENGTH + 1];
            let challenge = message.first_chunk_mut().ok_or(AbortCode::General)?;
            self.challenge(challenge)?;
            return self.lock.respond(self.now(), &message, data);
        }
        if !self.identity.storage || !self.is_at_rest() || self.store.asked {
            return Err(AbortCode::DeviceState);
        }
        self.lock.change(data)
    }
}
