//! Transmit PDOs: at every n-th SYNC (types 1 to 240), at a SYNC after a change (0), or by event
//! with event and inhibit timer (254, 255).
//!
//! An event-driven PDO is also sent once on entering OPERATIONAL, so that its consumers know the
//! initial value.

use super::Core;
use super::pdo::{self, LAST_SYNCHRONOUS, Map};
use crate::time::Timer;
use crate::{Application, Config, Frame, Micros, NmtState, NodeId, PdoConfig};

/// How many transmit PDOs a device can have.
pub const MAX_TPDO: usize = 8;

#[derive(Clone, Copy)]
pub(super) struct Tpdo {
    /// 0x1800, sub-index 1.
    pub cob_id: u32,
    /// Sub-index 2.
    pub transmission: u8,
    /// Sub-index 3: the shortest time between two frames, in 100 us.
    pub inhibit_100us: u16,
    /// Sub-index 5: the longest time between two frames.
    pub event_ms: u16,
    /// Sub-index 6: the SYNC counter to start with, 0 for any.
    pub sync_start: u8,
    /// 0x1A00.
    pub map: Map,
    /// SYNCs since it was last sent.
    syncs: u8,
    /// The application has something new.
    triggered: bool,
    /// It has been sent in step with `sync_start`.
    started: bool,
    event: Timer,
    inhibited_until: Micros,
}

#[derive(Clone)]
pub(super) struct Tpdos {
    list: [Tpdo; MAX_TPDO],
    count: usize,
}

impl Tpdo {
    const OFF: Self = Self {
        cob_id: pdo::OFF,
        transmission: 1,
        inhibit_100us: 0,
        event_ms: 0,
        sync_start: 0,
        map: Map::EMPTY,
        syncs: 0,
        triggered: false,
        started: false,
        event: Timer::OFF,
        inhibited_until: Micros::ZERO,
    };

    fn new(config: &PdoConfig, node: Option<NodeId>) -> Self {
        Self {
            cob_id: pdo::default_cob_id(config, node),
            transmission: config.transmission,
            inhibit_100us: config.inhibit_100us,
            event_ms: config.event_ms,
            map: Map::new(config.mapping),
            ..Self::OFF
        }
    }

    pub const fn is_on(&self) -> bool {
        self.cob_id & pdo::OFF == 0
    }

    const fn is_synchronous(&self) -> bool {
        self.transmission <= LAST_SYNCHRONOUS
    }

    /// Starts counting SYNCs and timers afresh.
    pub fn restart(&mut self, now: Micros) {
        self.syncs = 0;
        self.started = false;
        self.inhibited_until = Micros::ZERO;
        self.triggered = !self.is_synchronous();
        self.event = match self.is_synchronous() {
            true => Timer::OFF,
            false => Timer::after_millis(now, self.event_ms),
        };
    }

    /// Whether it goes out at this SYNC.
    fn is_due_at_sync(&mut self, counter: Option<u8>) -> bool {
        if self.transmission == 0 {
            return core::mem::take(&mut self.triggered);
        }
        if !self.started && self.sync_start != 0 && counter.is_some() {
            // The SYNC with that counter is the first one.
            if counter != Some(self.sync_start) {
                return false;
            }
            self.syncs = self.transmission.wrapping_sub(1);
        }
        self.started = true;
        self.syncs = self.syncs.saturating_add(1);
        let due = self.syncs >= self.transmission;
        if due {
            self.syncs = 0;
        }
        due
    }

    /// Reads the objects and makes the frame.
    fn frame(&self, number: u8, app: &dyn Application) -> Frame {
        let id = crate::bytes::low_u16(self.cob_id);
        let mut data = [0; 8];
        if self.map.is_default
            && let Some(len) = app.tpdo(number, &mut data)
        {
            return Frame::prefix(id, data, u8::try_from(len).unwrap_or(8));
        }
        let mut rest = data.as_mut_slice();
        for (index, sub, len) in self.map.objects() {
            let Some((value, behind)) = rest.split_at_mut_checked(usize::from(len)) else {
                break;
            };
            // An object that cannot be read leaves zeros.
            if app.read(index, sub, value).is_err() {
                value.fill(0);
            }
            rest = behind;
        }
        Frame::prefix(id, data, self.map.bytes)
    }
}

impl Tpdos {
    pub fn new(config: &Config, node: Option<NodeId>) -> Self {
        let mut list = [Tpdo::OFF; MAX_TPDO];
        for (tpdo, config) in list.iter_mut().zip(config.tpdos) {
            *tpdo = Tpdo::new(config, node);
        }
        Self {
            list,
            count: config.tpdos.len().min(MAX_TPDO),
        }
    }

    /// The PDO at 0x1800 plus `at`.
    pub fn get(&self, at: u16) -> Option<&Tpdo> {
        self.list.get(..self.count)?.get(usize::from(at))
    }

    pub fn get_mut(&mut self, at: u16) -> Option<&mut Tpdo> {
        self.list.get_mut(..self.count)?.get_mut(usize::from(at))
    }
}

impl Core {
    /// The NMT state has changed.
    pub(super) fn enter_tpdos(&mut self, now: Micros) {
        for tpdo in &mut self.tpdos.list {
            tpdo.restart(now);
        }
        self.out.wake(Timer::at(now));
    }

    pub(super) fn trigger_tpdo(&mut self, number: u8) {
        let tpdo = u16::from(number).checked_sub(1);
        if let Some(tpdo) = tpdo.and_then(|at| self.tpdos.get_mut(at)) {
            tpdo.triggered = true;
            if !tpdo.is_synchronous() {
                self.out.wake(Timer::at(Micros::ZERO));
            }
        }
    }

    pub(super) fn send_synchronous_tpdos(&mut self, app: &dyn Application) {
        if self.state != NmtState::Operational {
            return;
        }
        let counter = self.sync.counter();
        let mut number: u8 = 0;
        for tpdo in &mut self.tpdos.list {
            number = number.wrapping_add(1);
            if tpdo.is_on() && tpdo.is_synchronous() && tpdo.is_due_at_sync(counter) {
                self.out.send(tpdo.frame(number, app));
            }
        }
    }

    pub(super) fn poll_tpdos(&mut self, now: Micros, app: &dyn Application) {
        if self.state != NmtState::Operational {
            return;
        }
        let mut number: u8 = 0;
        for tpdo in &mut self.tpdos.list {
            number = number.wrapping_add(1);
            if !tpdo.is_on() || tpdo.is_synchronous() {
                continue;
            }
            if tpdo.event.due(now) {
                tpdo.event = Timer::OFF;
                tpdo.triggered = true;
            }
            if tpdo.triggered && now >= tpdo.inhibited_until {
                tpdo.triggered = false;
                let inhibit = u64::from(tpdo.inhibit_100us).saturating_mul(100);
                tpdo.inhibited_until = now + Micros(inhibit);
                tpdo.event = Timer::after_millis(now, tpdo.event_ms);
                self.out.send(tpdo.frame(number, app));
            }
            if tpdo.triggered {
                self.out.wake(Timer::at(tpdo.inhibited_until));
            }
            self.out.wake(tpdo.event);
        }
    }
}
