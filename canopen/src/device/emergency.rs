//! The emergency service: active errors, past errors, and the messages about them.
//!
//! An error is identified by its code and the first byte of its data (for an RPDO error, the number
//! of the RPDO). It is announced once when it appears and once when it has gone. Messages wait
//! while the device is STOPPED or the inhibit time runs; if too many wait, the oldest are dropped.
//!
//! Limit: of more errors than `ACTIVE` the newest takes the place of the one before it, which is
//! then neither in 0x1001 nor declared over.

use heapless::{Deque, Vec};

use super::Core;
use super::heartbeat::MAX_CONSUMERS;
use super::objects::Value;
use crate::bytes::{low_u8, low_u16};
use crate::emergency::{EMERGENCY, Emergency, ErrorClass};
use crate::time::Timer;
use crate::{AbortCode, Config, Event, Frame, Micros, NmtState, NodeId};

use super::pdo::{OFF, is_restricted};
use super::rpdo::MAX_RPDO;

/// Largest number of distinct errors that can be present at the same time: all that the device
/// itself can find (every node it monitors is lost, every RPDO is too short and late, SYNC is lost
/// and of two wrong lengths, the transmit queue has overflowed), and some of the application's.
const ACTIVE: usize = MAX_CONSUMERS + 2 * MAX_RPDO + 4 + 11;
/// Entries of the error history, object 0x1003.
const HISTORY: usize = 8;
/// Messages that can wait.
const WAITING: usize = 8;

/// An error that is present.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Active {
    code: u16,
    detail: u8,
    class: u8,
}

#[derive(Clone)]
pub(super) struct Emergencies {
    /// 0x1014.
    pub cob_id: u32,
    /// 0x1015.
    pub inhibit_100us: u16,
    /// 0x1029, sub-index 1.
    pub behaviour: u8,
    active: Vec<Active, ACTIVE, u8>,
    /// 0x1003, newest first.
    history: [u32; HISTORY],
    history_len: u8,
    waiting: Deque<[u8; 8], WAITING>,
    inhibited_until: Micros,
    /// When the transmit queue counts as healthy again.
    overrun: Timer,
}

/// 0x1014 as it is by default.
pub(super) fn default_cob_id(node: Option<NodeId>) -> u32 {
    node.map_or(OFF, |node| u32::from(node.cob_id(EMERGENCY)))
}

impl Emergencies {
    pub fn new(config: &Config, node: Option<NodeId>) -> Self {
        Self {
            cob_id: default_cob_id(node),
            inhibit_100us: config.emergency_inhibit_100us,
            behaviour: config.error_behaviour,
            active: Vec::new(),
            history: [0; HISTORY],
            history_len: 0,
            waiting: Deque::new(),
            inhibited_until: Micros::ZERO,
            overrun: Timer::OFF,
        }
    }

    /// After an NMT reset the parameters are new and the history is kept.
    pub fn reset(&mut self, config: &Config, node: Option<NodeId>) {
        let (history, history_len) = (self.history, self.history_len);
        *self = Self::new(config, node);
        (self.history, self.history_len) = (history, history_len);
    }

    /// 0x1001.
    pub fn register(&self) -> u8 {
        self.active.iter().fold(0, |register, error| {
            register | error.class | ErrorClass::Generic as u8
        })
    }

    fn announce(&mut self, code: u16, register: u8, info: [u8; 5]) {
        let message = Emergency {
            code,
            register,
            info,
        };
        if self.waiting.is_full() {
            self.waiting.pop_front();
        }
        // There is room now.
        let _ = self.waiting.push_back(message.encode());
    }

    fn remember(&mut self, code: u16, info: [u8; 5]) {
        let [a, b, ..] = info;
        self.history.rotate_right(1);
        if let Some(newest) = self.history.first_mut() {
            *newest = u32::from(code) | u32::from(u16::from_le_bytes([a, b])) << 16;
        }
        self.history_len = self.history_len.saturating_add(1).min(8);
    }

    /// An entry of 0x1003; sub-index 0 is how many there are.
    pub fn entry(&self, sub: u8) -> Result<Value, AbortCode> {
        let (value, len, writable) = match usize::from(sub).checked_sub(1) {
            None => (u32::from(self.history_len), 1, true),
            Some(at) => {
                let entry = self.history.get(at).ok_or(AbortCode::NoSubIndex)?;
                if sub > self.history_len {
                    return Err(AbortCode::NoData);
                }
                (*entry, 4, false)
            }
        };
        Ok(Value::Number {
            value,
            len,
            writable,
        })
    }

    /// Takes a new value of one of the objects that can be written.
    pub fn set(&mut self, index: u16, value: u32) -> Result<(), AbortCode> {
        match (index, value) {
            (0x1003, 0) => self.history_len = 0,
            (0x1014, _) => self.cob_id = self.check_cob_id(value)?,
            (0x1015, _) => self.inhibit_100us = low_u16(value),
            (0x1029, 0..=2) => self.behaviour = low_u8(value),
            _ => return Err(AbortCode::InvalidValue),
        }
        Ok(())
    }

    /// The identifier can be changed only while the service is off.
    fn check_cob_id(&self, new: u32) -> Result<u32, AbortCode> {
        let moves_while_on = self.cob_id & OFF == 0 && new & OFF == 0 && new != self.cob_id;
        let wrong = new & OFF == 0 && (new > 0x7FF || is_restricted(low_u16(new)));
        match moves_while_on || wrong {
            true => Err(AbortCode::InvalidValue),
            false => Ok(new),
        }
    }
}

/// The emergency service for the application: it tells of errors of its own.
pub struct Errors<'a> {
    core: &'a mut Core,
    now: Micros,
}

impl<'a> Errors<'a> {
    pub(super) fn new(core: &'a mut Core, now: Micros) -> Self {
        Self { core, now }
    }

    /// An error has appeared: sends an emergency message with this code and sets the bit of its
    /// class in 0x1001, until [`clear`](Self::clear). Errors with the same code and the same first
    /// byte of `info` are the same error and announced once.
    pub fn raise(&mut self, code: u16, class: ErrorClass, info: [u8; 5]) {
        self.core.raise(self.now, code, class, info);
    }

    /// The error with this code and this first byte of `info` has gone.
    pub fn clear(&mut self, code: u16, detail: u8) {
        self.core.clear(self.now, code, detail);
    }
}

impl Core {
    /// An error has appeared. If it is present already, nothing happens.
    pub(super) fn raise(&mut self, now: Micros, code: u16, class: ErrorClass, info: [u8; 5]) {
        let [detail, ..] = info;
        let error = Active {
            code,
            detail,
            class: class as u8,
        };
        let errors = &mut self.emergencies;
        if errors.active.contains(&error) {
            return;
        }
        // It takes a place in any case: what comes with every frame is announced once.
        if errors.active.is_full() {
            errors.active.pop();
        }
        let _ = errors.active.push(error);
        let register = errors.register();
        errors.announce(code, register, info);
        errors.remember(code, info);
        self.poll_emergencies(now);
    }

    /// The same for an error of communication that is known by its code and one byte.
    #[inline(never)]
    pub(super) fn raise_communication(&mut self, now: Micros, code: u16, detail: u8) {
        let info = [detail, 0, 0, 0, 0];
        self.raise(now, code, ErrorClass::Communication, info);
    }

    /// An error has gone. If it was not present, nothing happens.
    pub(super) fn clear(&mut self, now: Micros, code: u16, detail: u8) {
        let errors = &mut self.emergencies;
        let is_it = |error: &Active| error.code == code && error.detail == detail;
        let Some(place) = errors.active.iter().position(is_it) else {
            return;
        };
        errors.active.swap_remove(place);
        let [low, high] = code.to_le_bytes();
        let register = errors.register();
        errors.announce(0, register, [low, high, detail, 0, 0]);
        self.poll_emergencies(now);
    }

    /// Whether any error is present: cheap, for paths taken by every frame.
    pub(super) fn has_errors(&self) -> bool {
        !self.emergencies.active.is_empty()
    }

    /// Tells that the device is back on the bus; there is nothing to take back later.
    pub(super) fn announce_recovery(&mut self, now: Micros) {
        let code = Emergency::BUS_OFF_RECOVERED;
        let errors = &mut self.emergencies;
        let class = ErrorClass::Communication as u8 | ErrorClass::Generic as u8;
        errors.announce(code, errors.register() | class, [0; 5]);
        errors.remember(code, [0; 5]);
        self.poll_emergencies(now);
    }

    /// Sends the messages that may go out now.
    pub(super) fn poll_emergencies(&mut self, now: Micros) {
        match self.state {
            NmtState::Initialising | NmtState::Stopped => return,
            NmtState::PreOperational | NmtState::Operational if self.out.is_muted() => return,
            NmtState::PreOperational | NmtState::Operational => {}
        }
        let errors = &mut self.emergencies;
        while now >= errors.inhibited_until {
            if self.out.is_full() && !errors.waiting.is_empty() {
                errors.inhibited_until = now + Micros::from_millis(1);
                break;
            }
            let Some(message) = errors.waiting.pop_front() else {
                return;
            };
            if errors.cob_id & OFF == 0 {
                self.out.send(Frame::of(low_u16(errors.cob_id), message));
                let inhibit = u64::from(errors.inhibit_100us).saturating_mul(100);
                errors.inhibited_until = now + Micros(inhibit);
                if inhibit == 0 {
                    errors.inhibited_until = Micros::ZERO;
                }
            }
        }
        if !errors.waiting.is_empty() {
            self.out.wake(Timer::at(errors.inhibited_until));
        }
    }

    /// Reports a transmit queue that has overflowed; a second without overflow ends the error.
    pub(super) fn poll_overflow(&mut self, now: Micros) {
        if self.out.take_overflowed() {
            self.emergencies.overrun = Timer::at(now + Micros::from_millis(1_000));
            self.raise_communication(now, Emergency::CAN_OVERRUN, 0);
        } else if self.emergencies.overrun.due(now) {
            self.emergencies.overrun = Timer::OFF;
            self.clear(now, Emergency::CAN_OVERRUN, 0);
        }
        self.out.wake(self.emergencies.overrun);
    }

    /// Does what object 0x1029 asks for when communication has failed.
    pub(super) fn react_to_communication_error(&mut self, now: Micros) {
        let to = match (self.emergencies.behaviour, self.state) {
            (0, NmtState::Operational) => NmtState::PreOperational,
            (2, NmtState::Operational | NmtState::PreOperational) => NmtState::Stopped,
            _ => return,
        };
        self.enter(now, to);
        self.out.emit(Event::CommunicationError);
    }
}
