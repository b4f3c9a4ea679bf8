//! What runs out, and how a fault is announced.

use canopen::ErrorClass;
use control::time::Micros;
use protocol::Fault;
use protocol::code::FaultClass;

use super::{BusSide, Event, device_time};
use crate::sequence::Setpoints;
use crate::state::{self, State};
use control::configuration::Configuration;

impl BusSide {
    /// What runs out, since when, and what it means.
    pub(super) fn timers(
        &self,
        configuration: &Configuration,
    ) -> [Option<(Micros, u64, Fault)>; 4] {
        let times = &configuration.times;
        let heartbeat = Some((
            self.last_heartbeat,
            times.heartbeat_timeout_us,
            Fault::MasterSilent,
        ));
        let sync = Some((self.last_sync, times.sync_timeout_us, Fault::SyncLost));
        // Whoever misses a status at the next SYNC stops there; without a SYNC it is as certain a
        // moment later.
        let members = (!self.has_all_votes(configuration)).then_some((
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
            State::Alone if self.identifying => [heartbeat, sync, None, None],
            State::Alone => [heartbeat, sync, setpoint(&self.own_setpoints), None],
        }
    }

    /// Rule 4: what has run out by `now`.
    pub(super) fn supervise(&mut self, now: Micros) {
        if now < self.runs_out {
            return;
        }
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

    /// Announces a fault by an emergency message and keeps it in the history.
    pub(super) fn record(&mut self, fault: Fault, now: Micros) {
        let time_ms = u32::try_from(now.0 / 1000).unwrap_or(u32::MAX);
        self.dictionary.history.push(fault.code(), time_ms);
        let (supply, rates) = (self.report.supply, self.report.rates.into());
        let memory = &mut self.dictionary.memory;
        memory.push(fault.code(), time_ms, supply, rates);
        let class = match fault.error_class() {
            FaultClass::Generic => ErrorClass::Generic,
            FaultClass::Voltage => ErrorClass::Voltage,
            FaultClass::Communication => ErrorClass::Communication,
            FaultClass::Manufacturer => ErrorClass::Manufacturer,
        };
        let info = match self.dictionary.store.corrupt {
            Some(address) if fault == Fault::ParametersCorrupt => {
                let [low, high] = address.index.to_le_bytes();
                [0, low, high, address.sub, 0]
            }
            _ => [0; 5],
        };
        self.device
            .raise_error(device_time(now), fault.code(), class, info);
        self.announced |= announced_bit(fault);
        self.emit(Event::Fault(fault));
    }

    /// Says that everything announced is over.
    pub(super) fn clear_record(&mut self, now: Micros) {
        for fault in Fault::ALL {
            if self.announced & announced_bit(*fault) != 0 {
                self.device.clear_error(device_time(now), fault.code(), 0);
            }
        }
        self.announced = 0;
    }
}

/// The bit of a fault in [`BusSide::announced`].
fn announced_bit(fault: Fault) -> u64 {
    let place = Fault::ALL.iter().position(|one| *one == fault);
    place.map_or(0, |place| 1 << place)
}

/// Every fault has a bit of its own.
const _: () = assert!(Fault::ALL.len() <= u64::BITS as usize);
