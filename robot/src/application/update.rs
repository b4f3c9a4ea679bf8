//! The objects of an update, and when one is permitted: in PRE-OPERATIONAL, with the outputs off
//! and nothing being stored.

use boot::{Crypto, Flash};
use canopen::{AbortCode, NmtState, Sink};
use control::time::Micros;
use protocol::{Address, Value, address as at};

use super::Application;
use crate::update::{Done, Job};

/// How long after the last SYNC, and the last heartbeat of its master, an image on trial still
/// counts as connected, us.
const RECENT_US: u64 = 1_000_000;

impl Application {
    /// The value of an object of an update; `None` for every other object.
    pub(super) fn update_value(&self, address: Address) -> Option<Value> {
        let update = &self.update;
        Some(match address {
            at::PROGRAM_CONTROL => Value::U8(update.control_state()),
            at::PROGRAM_IDENTIFICATION => Value::U32(update.identification(self.identity.firmware)),
            at::FLASH_STATUS => Value::U32(update.flash_status()),
            at::RUNNING_SLOT => Value::U8(update.running_slot()),
            at::WANTED_SLOT => Value::U8(update.wanted_slot()),
            at::UPDATE_PROBLEM => Value::U8(update.problem() as u8),
            at::SECURITY_COUNTER => Value::U32(update.security_counter()),
            at::OTHER_VERSION => Value::U32(update.other_version()),
            at::BOARD => Value::U16(update.device().board.0),
            at::HARDWARE_REVISION => Value::U16(update.device().hardware),
            _ => return None,
        })
    }

    pub(super) fn control_update(&mut self, value: u8, nmt: NmtState) -> Result<(), AbortCode> {
        let may = self.may_update();
        self.update.control(value, nmt, may)
    }

    /// What the platform has to do for an update now.
    pub fn update_job(&self) -> Option<Job> {
        self.update.job().filter(|_| self.may_update())
    }

    pub fn work_on_update(&mut self, flash: &mut impl Flash, crypto: &impl Crypto) -> Done {
        if self.may_update() {
            self.update.work(flash, crypto)
        } else {
            Done::GoOn
        }
    }

    #[inline]
    pub fn supervise_trial(&mut self, now: Micros) {
        if self.update.is_on_trial() {
            self.judge_trial(now);
        }
    }

    #[inline(never)]
    fn judge_trial(&mut self, now: Micros) {
        let is_recent = |last: Micros| last != Micros::ZERO && now.since(last).0 < RECENT_US;
        let is_on_bus = is_recent(self.last_sync) && is_recent(self.last_heartbeat);
        // The image before may be able to read what this one cannot.
        let is_readable = self.store.corrupt.is_none();
        self.update.supervise(now, is_on_bus && is_readable);
    }

    fn may_update(&self) -> bool {
        self.is_at_rest() && !self.store.asked
    }
}

impl Sink for Application {
    fn begin(&mut self, size: Option<u32>, state: NmtState) -> Result<(), AbortCode> {
        self.lock.pass(self.now())?;
        let may = self.may_update();
        self.update.begin(size, state, may)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        self.update.receive(bytes)
    }

    fn finish(&mut self) -> Result<(), AbortCode> {
        self.update.finish()
    }

    fn cancel(&mut self) {
        self.update.cancel();
    }
}
