//! SYNC: applies the waiting RPDOs, gives the application its turn, sends the synchronous TPDOs.
//!
//! As a consumer (the usual case) the device watches the counter (0x1019) for gaps and, while
//! OPERATIONAL, the period (0x1006) for silence. As the producer (bit 30 of 0x1005) it sends SYNC
//! itself and processes its own as if it had received it. Its counter starts at 1 when the device
//! leaves STOPPED, as CiA 301, 7.2.5.3.2 asks.

use super::Core;
use super::emergency::Errors;
use super::pdo::is_restricted;
use crate::bytes::{low_u8, low_u16};
use crate::time::Timer;
use crate::{AbortCode, Application, Config, Emergency, Event, Frame, Micros, NmtState};

/// The pre-defined identifier.
pub(super) const SYNC: u32 = 0x80;

/// Bit 30 of 0x1005: the device produces SYNC.
const PRODUCER: u32 = 1 << 30;

/// Bit 31 of 0x1005 has no meaning and reads 0 here (CiA 301, 7.5.2.5: "do not care"), so devices
/// that differ in nothing else have the same value.
const MEANINGLESS: u32 = 1 << 31;

/// No frame has this identifier.
const NONE: u16 = u16::MAX;

#[derive(Clone)]
pub(super) struct Sync {
    /// 0x1005.
    pub cob_id: u32,
    /// The identifier to listen for.
    id: u16,
    /// 0x1006.
    pub period_us: u32,
    /// 0x1007.
    pub window_us: u32,
    /// 0x1019: highest counter, 0 for none.
    pub overflow: u8,
    /// Counter of the last SYNC, if it had one.
    counter: Option<u8>,
    /// When synchronous PDOs of the last SYNC are too late.
    window: Timer,
    /// Of a consumer when SYNC is missing, of the producer when the next one is due.
    timer: Timer,
}

impl Sync {
    pub const fn new(config: &Config) -> Self {
        Self {
            cob_id: SYNC,
            id: low_u16(SYNC),
            period_us: config.sync_period_us,
            window_us: config.sync_window_us,
            overflow: config.sync_overflow,
            counter: None,
            window: Timer::OFF,
            timer: Timer::OFF,
        }
    }

    /// The identifier to listen for.
    pub const fn id(&self) -> u16 {
        self.id
    }

    pub const fn counter(&self) -> Option<u8> {
        self.counter
    }

    /// Whether a synchronous PDO comes too late for the last SYNC.
    pub fn window_is_over(&self, now: Micros) -> bool {
        self.window.due(now)
    }

    const fn is_producer(&self) -> bool {
        self.cob_id & PRODUCER != 0
    }

    fn period(&self) -> Micros {
        Micros(u64::from(self.period_us))
    }

    /// Takes a new counter; returns the event if SYNCs are missing.
    fn advance(&mut self, counter: Option<u8>) -> Option<Event> {
        let last = self.counter;
        self.counter = counter;
        let (last, received) = last.zip(counter)?;
        let expected = match self.overflow {
            // Without 0x1019 the turn-over is not known; every 1 could be one.
            0 if received == 1 => 1,
            overflow if overflow != 0 && last >= overflow => 1,
            _ => last.saturating_add(1),
        };
        (received != expected).then_some(Event::SyncGap { expected, received })
    }

    /// The producer's next frame.
    fn produce(&self) -> Frame {
        let last = self.counter.unwrap_or(0);
        let id = low_u16(self.cob_id);
        match self.overflow {
            0 => Frame::of(id, []),
            overflow if last >= overflow => Frame::of(id, [1]),
            _ => Frame::of(id, [last.saturating_add(1)]),
        }
    }
}

impl Core {
    pub(super) fn on_sync(&mut self, now: Micros, frame: &Frame, app: &mut dyn Application) {
        match self.state {
            NmtState::Initialising | NmtState::Stopped => return,
            NmtState::PreOperational | NmtState::Operational => {}
        }
        let counter = match *frame.data() {
            [] => None,
            [counter] => Some(counter),
            _ => return,
        };
        let applied = self.apply_rpdos(app);
        if let Some(gap) = self.sync.advance(counter) {
            self.out.count(|counters| &mut counters.sync_gaps);
            self.out.emit(gap);
        }
        let sync = &mut self.sync;
        if sync.window_us != 0 {
            sync.window = Timer::at(now + Micros(u64::from(sync.window_us)));
        }
        if sync.period_us != 0 && !sync.is_producer() && self.state == NmtState::Operational {
            let silence = Micros(u64::from(sync.period_us).saturating_mul(3) / 2);
            sync.timer = Timer::at(now + silence);
            self.out.wake(sync.timer);
        }
        let wrong_length = counter.is_some() != (sync.overflow != 0);
        if wrong_length {
            // Taken all the same: to miss it would be worse for what depends on it.
            self.raise_communication(now, Emergency::SYNC_LENGTH, frame.len());
        } else if self.has_errors() {
            self.clear(now, Emergency::SYNC_LENGTH, 1 - frame.len().min(1));
            self.clear(now, Emergency::SYNC_LOST, 0);
        }
        let sync = crate::ReceivedSync {
            counter,
            at: now,
            applied,
        };
        app.on_sync(sync, &mut Errors::new(self, now));
        self.send_synchronous_tpdos(app);
    }

    /// The NMT state has changed.
    pub(super) fn enter_sync(&mut self, now: Micros, from: NmtState, to: NmtState) {
        let sync = &mut self.sync;
        match to {
            NmtState::Initialising | NmtState::Stopped => {
                sync.counter = None;
                sync.timer = Timer::OFF;
                sync.window = Timer::OFF;
            }
            // A producer stays in step.
            NmtState::PreOperational | NmtState::Operational if sync.is_producer() => {
                if matches!(from, NmtState::Initialising | NmtState::Stopped) {
                    self.start_sync(now);
                }
            }
            NmtState::PreOperational | NmtState::Operational => sync.timer = Timer::OFF,
        }
    }

    /// The producer begins a period now.
    fn start_sync(&mut self, now: Micros) {
        let sync = &mut self.sync;
        sync.timer = match sync.is_producer() && sync.period_us != 0 {
            true => Timer::at(now + sync.period()),
            false => Timer::OFF,
        };
        self.out.wake(sync.timer);
    }

    pub(super) fn poll_sync(&mut self, now: Micros, app: &mut dyn Application) {
        if self.sync.timer.due(now) {
            if self.sync.is_producer() {
                let frame = self.sync.produce();
                self.out.send(frame);
                let on_time = Timer::at(self.sync.timer.moment() + self.sync.period());
                self.sync.timer = match on_time.due(now) {
                    true => Timer::at(now + self.sync.period()),
                    false => on_time,
                };
                self.on_sync(now, &frame, app);
            } else {
                self.sync.timer = Timer::OFF;
                self.out.count(|counters| &mut counters.syncs_lost);
                self.out.emit(Event::SyncLost);
                self.raise_communication(now, Emergency::SYNC_LOST, 0);
            }
        }
        self.out.wake(self.sync.timer);
    }

    /// Takes a new value of 0x1005, 0x1006, 0x1007 or 0x1019.
    pub(super) fn set_sync(
        &mut self,
        now: Micros,
        index: u16,
        value: u32,
    ) -> Result<(), AbortCode> {
        let sync = &mut self.sync;
        match index {
            0x1005 => {
                let value = value & !MEANINGLESS;
                let id = value & !PRODUCER;
                let moves = id != sync.cob_id & !PRODUCER;
                if id > 0x7FF || is_restricted(low_u16(id)) || (moves && sync.is_producer()) {
                    return Err(AbortCode::InvalidValue);
                }
                sync.cob_id = value;
                // A producer does not listen: there is one per bus.
                sync.id = match sync.is_producer() {
                    true => NONE,
                    false => low_u16(value),
                };
                self.start_sync(now);
            }
            0x1006 => {
                sync.period_us = value;
                self.start_sync(now);
                self.clear(now, Emergency::SYNC_LOST, 0);
            }
            0x1007 => {
                sync.window_us = value;
                sync.window = Timer::OFF;
            }
            _ => match value {
                1 => return Err(AbortCode::ValueTooLow),
                241.. => return Err(AbortCode::ValueTooHigh),
                // Producer and consumers must not change it while SYNC runs.
                _ if sync.period_us != 0 => return Err(AbortCode::DeviceState),
                _ => sync.overflow = low_u8(value),
            },
        }
        Ok(())
    }
}
