//! Receive PDOs: latched until the next SYNC (types 0 to 240) or written at once (254, 255).
//!
//! RPDOs are received only in OPERATIONAL; every change of the NMT state discards latched data. A
//! later frame of the same PDO replaces an earlier one that no SYNC has applied.

use super::Core;
use super::pdo::{self, LAST_SYNCHRONOUS, Map};
use crate::time::Timer;
use crate::{
    Application, Config, Emergency, ErrorClass, Event, Frame, Micros, NmtState, NodeId, PdoConfig,
    RpdoSet,
};

/// How many receive PDOs a device can have: each takes some 130 bytes of RAM, used or not.
pub const MAX_RPDO: usize = 4;

const MAX_RPDO_NUMBER: u8 = 4;
const _: () = assert!(MAX_RPDO == MAX_RPDO_NUMBER as usize && MAX_RPDO <= 32);

/// No frame has this identifier.
const NOT_LISTENING: u16 = u16::MAX;

#[derive(Clone, Copy)]
pub(super) struct Rpdo {
    /// 0x1400, sub-index 1.
    pub cob_id: u32,
    /// Sub-index 2.
    pub transmission: u8,
    /// Sub-index 5: the longest time between two frames.
    pub deadline_ms: u16,
    /// 0x1600.
    pub map: Map,
    data: [u8; 8],
    /// Runs from one frame to the next.
    pub deadline: Timer,
}

#[derive(Clone)]
pub(super) struct Rpdos {
    list: [Rpdo; MAX_RPDO],
    count: usize,
    /// The identifiers of those that are on, side by side to be searched fast.
    listening: [u16; MAX_RPDO],
    /// Bit n: number n + 1 holds a frame for the next SYNC.
    latched: u32,
}

impl Rpdo {
    const OFF: Self = Self {
        cob_id: pdo::OFF,
        transmission: 1,
        deadline_ms: 0,
        map: Map::EMPTY,
        data: [0; 8],
        deadline: Timer::OFF,
    };

    pub fn new(config: &PdoConfig, node: Option<NodeId>) -> Self {
        Self {
            cob_id: pdo::default_cob_id(config, node),
            transmission: config.transmission,
            deadline_ms: config.event_ms,
            map: Map::new(config.mapping),
            ..Self::OFF
        }
    }

    /// Writes the content to the application's objects.
    fn apply(
        &self,
        number: u8,
        state: NmtState,
        out: &mut super::Outbox,
        app: &mut dyn Application,
    ) {
        let mut rest = self.data.get(..usize::from(self.map.bytes)).unwrap_or(&[]);
        if self.map.is_default && app.rpdo(number, rest) {
            return;
        }
        for (index, sub, len) in self.map.objects() {
            let Some((value, behind)) = rest.split_at_checked(usize::from(len)) else {
                return;
            };
            rest = behind;
            // Indices below 0x20 are the data types: a gap in the mapping.
            if index < 0x20 {
                continue;
            }
            if let Err(code) = app.write(index, sub, value, state) {
                out.count(|counters| &mut counters.rpdo_refused);
                out.emit(Event::RpdoRefused { number, code });
            }
        }
    }
}

impl Rpdos {
    pub fn new(config: &Config, node: Option<NodeId>) -> Self {
        let mut rpdos = Self {
            list: [Rpdo::OFF; MAX_RPDO],
            count: config.rpdos.len().min(MAX_RPDO),
            listening: [NOT_LISTENING; MAX_RPDO],
            latched: 0,
        };
        for (rpdo, config) in rpdos.list.iter_mut().zip(config.rpdos) {
            *rpdo = Rpdo::new(config, node);
        }
        rpdos.listen();
        rpdos
    }

    /// The PDO at 0x1400 plus `at`.
    pub fn get(&self, at: u16) -> Option<&Rpdo> {
        self.list.get(..self.count)?.get(usize::from(at))
    }

    pub fn get_mut(&mut self, at: u16) -> Option<&mut Rpdo> {
        self.list.get_mut(..self.count)?.get_mut(usize::from(at))
    }

    /// The identifiers may have changed.
    pub fn listen(&mut self) {
        for (id, rpdo) in self.listening.iter_mut().zip(&self.list) {
            *id = match rpdo.cob_id & pdo::OFF == 0 {
                true => crate::bytes::low_u16(rpdo.cob_id) & 0x7FF,
                false => NOT_LISTENING,
            };
        }
    }

    /// The identifiers of those that are on.
    pub fn listening(&self) -> impl Iterator<Item = u16> {
        let on = |id: &u16| *id != NOT_LISTENING;
        self.listening.into_iter().filter(on)
    }

    /// Forgets everything latched, and the deadlines.
    pub fn clear(&mut self) {
        self.latched = 0;
        for rpdo in &mut self.list {
            rpdo.deadline = Timer::OFF;
        }
    }
}

impl Core {
    pub(super) fn on_rpdo(&mut self, now: Micros, frame: &Frame, app: &mut dyn Application) {
        if self.state != NmtState::Operational {
            return;
        }
        for (at, id) in self.rpdos.listening.into_iter().enumerate() {
            if id == frame.id() {
                self.receive_rpdo(now, at, frame, app);
            }
        }
    }

    /// Takes a frame of the PDO at 0x1400 plus `at`.
    fn receive_rpdo(&mut self, now: Micros, at: usize, frame: &Frame, app: &mut dyn Application) {
        let number = u8::try_from(at).unwrap_or(u8::MAX).saturating_add(1);
        if !app.on_rpdo(number, frame.data()) {
            return;
        }
        let late = self.sync.window_is_over(now);
        let Some(rpdo) = self.rpdos.list.get_mut(at) else {
            return;
        };
        if frame.len() < rpdo.map.bytes {
            self.out.count(|counters| &mut counters.rpdo_too_short);
            self.out.emit(Event::RpdoTooShort { number });
            let info = [number, frame.len(), rpdo.map.bytes, 0, 0];
            let class = ErrorClass::Communication;
            return self.raise(now, Emergency::PDO_LENGTH, class, info);
        }
        rpdo.deadline = Timer::after_millis(now, rpdo.deadline_ms);
        self.out.wake(rpdo.deadline);
        if rpdo.transmission > LAST_SYNCHRONOUS {
            rpdo.data = *frame.padded();
            rpdo.apply(number, self.state, &mut self.out, app);
            self.out.emit(Event::RpdoApplied { number });
        } else if late {
            // Past the window of 0x1007 nothing is taken until the next SYNC.
            self.out.count(|counters| &mut counters.pdos_late);
        } else {
            rpdo.data = *frame.padded();
            self.rpdos.latched |= 1u32.checked_shl(u32::from(number - 1)).unwrap_or(0);
        }
        if self.has_errors() {
            self.clear(now, Emergency::PDO_LENGTH, number);
            self.clear(now, Emergency::RPDO_TIMEOUT, number);
        }
    }

    /// Reports the PDOs that have not come in time.
    pub(super) fn poll_rpdos(&mut self, now: Micros) {
        for number in 1..=MAX_RPDO_NUMBER {
            let Some(rpdo) = self.rpdos.get_mut(u16::from(number - 1)) else {
                break;
            };
            if !rpdo.deadline.due(now) {
                self.out.wake(rpdo.deadline);
                continue;
            }
            rpdo.deadline = Timer::OFF;
            self.out.count(|counters| &mut counters.pdos_late);
            self.out.emit(Event::RpdoLate { number });
            self.raise_communication(now, Emergency::RPDO_TIMEOUT, number);
        }
    }

    /// Writes what has been latched since the last SYNC.
    pub(super) fn apply_rpdos(&mut self, app: &mut dyn Application) -> RpdoSet {
        let latched = core::mem::take(&mut self.rpdos.latched);
        let mut left = latched;
        let mut number: u8 = 1;
        for rpdo in &self.rpdos.list {
            if left == 0 {
                break;
            }
            if left & 1 == 1 {
                rpdo.apply(number, self.state, &mut self.out, app);
            }
            left >>= 1;
            number = number.wrapping_add(1);
        }
        RpdoSet(latched)
    }
}
