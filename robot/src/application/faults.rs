//! Deadlines, and how a fault is announced.

use canopen::{ErrorClass, Errors};
use control::configuration::Configuration;
use control::time::Micros;
use protocol::Fault;
use protocol::code::FaultClass;

use super::Application;
use crate::event::Event;
use crate::sequence::Setpoints;
use crate::state::{self, State};

/// Emergency messages that are due, and faults that have been announced and not yet declared over:
/// one bit for each fault.
#[derive(Clone, Copy, Default)]
pub(super) struct Announcements {
    present: u64,
    appeared: u64,
    gone: u64,
}

impl Announcements {
    fn appear(&mut self, fault: Fault) {
        self.present |= bit(fault);
        self.appeared |= bit(fault);
    }

    /// Everything announced is over.
    pub fn clear_all(&mut self) {
        self.gone |= core::mem::take(&mut self.present);
    }
}

/// The bit of a fault.
fn bit(fault: Fault) -> u64 {
    let place = Fault::ALL.iter().position(|one| *one == fault);
    place.map_or(0, |place| 1 << place)
}

/// Every fault has a bit of its own.
const _: () = assert!(Fault::ALL.len() <= u64::BITS as usize);

impl Application {
    /// What runs out, since when, and what it means.
    fn timers(&self, configuration: &Configuration) -> [Option<(Micros, u64, Fault)>; 4] {
        let times = &configuration.times;
        let heartbeat = Some((
            self.last_heartbeat,
            times.heartbeat_timeout_us,
            Fault::MasterSilent,
        ));
        let sync = Some((self.last_sync, times.sync_timeout_us, Fault::SyncLost));
        // Whoever misses a status at the next SYNC stops there; without a SYNC it is as certain a
        // moment later.
        let members = self.is_undecided.then_some((
            self.last_sync,
            configuration.times.silence_us(),
            Fault::MemberSilent,
        ));
        let setpoint = |setpoints: &Setpoints| {
            let fault = if setpoints.is_invalid() {
                Fault::SetpointInvalid
            } else {
                Fault::SetpointOverdue
            };
            Some((setpoints.fresh_at(), times.setpoint_timeout_us, fault))
        };
        match self.state {
            State::Ready | State::Ramping(_) | State::Faulted(_) => [None; 4],
            State::Armed => [heartbeat, None, None, None],
            State::Moving => [heartbeat, sync, setpoint(&self.setpoints), members],
            State::Alone if self.identification.is_running => [heartbeat, sync, None, None],
            State::Alone => [heartbeat, sync, setpoint(&self.alone.setpoints), None],
        }
    }

    /// Rule 4: what has run out by `now`.
    #[inline(always)]
    pub fn supervise(&mut self, now: Micros) {
        self.expire_alone(now);
        if now >= self.runs_out {
            self.run_out(now);
        }
    }

    /// Something may have run out.
    #[inline(never)]
    fn run_out(&mut self, now: Micros) {
        let first = self.configuration.as_ref().and_then(|configuration| {
            let timers = self.timers(configuration).into_iter().flatten();
            timers
                .map(|(since, timeout, fault)| (since + Micros(timeout), fault))
                .min_by_key(|(at, _)| *at)
        });
        match first {
            Some((at, fault)) if at <= now => self.transition(state::Event::Failed(fault), now),
            Some((at, _)) => self.runs_out = at,
            None => self.runs_out = Micros::MAX,
        }
    }

    /// Keeps a fault in the history, to be announced by an emergency message.
    pub(super) fn record(&mut self, fault: Fault, now: Micros) {
        let time_ms = u32::try_from(now.0 / 1000).unwrap_or(u32::MAX);
        self.faults.push(fault.code(), time_ms);
        let (supply, rates) = (self.report.supply(), self.report.rates().into());
        self.memory.push(fault.code(), time_ms, supply, rates);
        self.announcements.appear(fault);
        self.emit(Event::Fault(fault));
    }

    /// The device has forgotten its errors in an NMT reset: what is still present is due once more.
    pub fn repeat_announcements(&mut self) {
        self.announcements.appeared |= self.announcements.present;
    }

    /// Whether there is something to announce.
    #[inline]
    pub const fn has_news(&self) -> bool {
        self.announcements.appeared | self.announcements.gone != 0
    }

    /// Sends the emergency messages that are due: first what is over, then what is new.
    #[inline(never)]
    pub fn announce(&mut self, errors: &mut Errors<'_>) {
        let gone = core::mem::take(&mut self.announcements.gone);
        let appeared = core::mem::take(&mut self.announcements.appeared);
        for fault in Fault::ALL.iter().filter(|fault| gone & bit(**fault) != 0) {
            errors.clear(fault.code(), 0);
        }
        for fault in Fault::ALL {
            if appeared & bit(*fault) == 0 {
                continue;
            }
            let class = match fault.error_class() {
                FaultClass::Generic => ErrorClass::Generic,
                FaultClass::Voltage => ErrorClass::Voltage,
                FaultClass::Temperature => ErrorClass::Temperature,
                FaultClass::Communication => ErrorClass::Communication,
                FaultClass::Manufacturer => ErrorClass::Manufacturer,
            };
            let info = match self.store.corrupt {
                Some(address) if *fault == Fault::ParametersCorrupt => {
                    let [low, high] = address.index.to_le_bytes();
                    [0, low, high, address.sub, 0]
                }
                _ => [0; 5],
            };
            errors.raise(fault.code(), class, info);
        }
    }
}
