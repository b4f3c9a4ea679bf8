//! The application behind the CANopen device: one robot as a member of its group.
//!
//! It holds the state of the bus side, and the device calls it (`service`): when an object is read,
//! to compute its value; when one is written, to take the value over; and at a SYNC, after the
//! setpoint is latched and before the status is sent.
//!
//! # Files
//!
//! | file | |
//! |---|---|
//! | `service` | what the device calls |
//! | `objects` | the value of every object, and what a write does |
//! | `start` | NMT start, the only way into motion; changes of the NMT state |
//! | `others` | heartbeat of the master, frames of the other members |
//! | `agree` | at SYNC: the vote on the next setpoint; with the last vote: the decision |
//! | `alone` | one robot moved alone |
//! | `identification` | identification of the motors |
//! | `faults` | timeouts, and how faults are announced |
//! | `publish` | what the robot reports about itself |
//! | `plan` | what the members compare before they move |
//! | `storage` | saving parameters |
//! | `update` | a new image over the bus |
//! | `lock` | who may change what the robot keeps |
//!
//! Time is that of the last frame or poll, [`Application::now`].

mod agree;
mod alone;
mod faults;
mod identification;
mod lock;
mod objects;
mod others;
mod plan;
mod publish;
mod service;
mod start;
mod storage;
mod update;

use canopen::NmtState;
use control::clock::SyncClock;
use control::configuration::Configuration;
use control::interface::{Command, Mode, Report};
use control::time::Micros;
use heapless::Deque;
use kinematics::Twist;
use protocol::{Fault, Limit, Plan, Scale};

use crate::agreement::{Agreement, Own};
use crate::can::CanRecord;
use crate::counters::Counters;
use crate::event::Event;
use crate::fault_memory::FaultMemory;
use crate::history::History;
use crate::identity::Identity;
use crate::interlock::Interlock;
use crate::lock::Lock;
use crate::parameters::Parameters;
use crate::rhythm::Rhythm;
use crate::sequence::Setpoints;
use crate::state::{self, State};
use crate::store::Store;
use crate::strain::Strain;
use crate::update::Update;
use alone::Alone;
use faults::Announcements;
use identification::Identification;

/// What a setpoint's object holds: the frame as received, and whether it came since the last SYNC.
#[derive(Clone, Copy, Default)]
struct Received {
    bytes: [u8; 8],
    is_fresh: bool,
}

impl Received {
    /// The frame, if there has been one since the last call.
    fn take(&mut self) -> Option<[u8; 8]> {
        core::mem::take(&mut self.is_fresh).then_some(self.bytes)
    }
}

/// See the [module](self).
#[cfg_attr(feature = "copies", derive(Clone))]
pub(crate) struct Application {
    pub identity: Identity,
    nmt: NmtState,
    pub state: State,
    pub parameters: Parameters,
    pub store: Store,
    pub update: Update,
    pub lock: Lock,
    configuration: Option<Configuration>,
    /// The control side has not been given the configuration yet.
    to_hand: bool,

    agreement: Agreement,
    /// Votes on the latched setpoint are missing.
    is_undecided: bool,
    /// The votes of the last decision came too late for its setpoint to take effect in time.
    is_late: bool,
    /// Published about the setpoint that is latched.
    own: Own,
    /// What is part of every checksum of `own`.
    plan: Plan,
    interlock: Interlock,
    clock: SyncClock,
    rhythm: Rhythm,
    strain: Strain,
    /// The group twist as the bus writes it.
    group_twist: Received,
    setpoints: Setpoints,
    /// Which byte of a group twist names its group, as RPDO1 is mapped; fixed while OPERATIONAL.
    group_byte: Option<usize>,
    /// In force.
    pub scale: Scale,
    scale_is_own: bool,
    /// What this robot's own scale is due to.
    own_limit: Limit,
    /// Why this member, though started, permits no motion.
    waits: Option<Limit>,

    alone: Alone,
    identification: Identification,

    last_sync: Micros,
    last_heartbeat: Micros,
    /// Earliest deadline. Fresh frames can only postpone it, so it is computed again only when it
    /// is due.
    pub runs_out: Micros,
    /// Until when it has listened for a robot of the same node.
    listened: Micros,
    /// Until when a robot of the same node counts as there.
    doubled_until: Micros,
    /// When its LED has shown long enough which robot it is.
    blinks_until: Micros,

    report: Report,
    pub command: Command,

    pub can: CanRecord,
    pub counters: Counters,
    announcements: Announcements,
    faults: History,
    limits: History,
    /// Code of the limit that was active at the last SYNC; 0 for none.
    limit: u16,
    pub memory: FaultMemory,
    pub events: Deque<Event, 8>,
}

impl Application {
    #[inline(always)]
    pub fn new(identity: Identity) -> Self {
        Self {
            identity,
            nmt: NmtState::Initialising,
            state: State::Ready,
            parameters: Parameters::new(),
            store: Store::new(),
            update: Update::new(identity.slot, identity.device_of_images),
            lock: Lock::new(),
            configuration: None,
            to_hand: false,
            agreement: Agreement::new(),
            is_undecided: false,
            is_late: false,
            own: Own::NONE,
            plan: Plan::NONE,
            interlock: Interlock::new(u8::MAX),
            clock: SyncClock::new(),
            rhythm: Rhythm::new(),
            strain: Strain::new(),
            group_twist: Received::default(),
            setpoints: Setpoints::new(),
            group_byte: None,
            scale: Scale::ZERO,
            scale_is_own: false,
            own_limit: Limit::WheelRate,
            waits: None,
            alone: Alone::new(),
            identification: Identification::new(),
            last_sync: Micros::ZERO,
            last_heartbeat: Micros::ZERO,
            runs_out: Micros::ZERO,
            listened: Micros::MAX,
            doubled_until: Micros::ZERO,
            blinks_until: Micros::ZERO,
            report: Report::NONE,
            command: Command::NONE,
            can: CanRecord::default(),
            counters: Counters::default(),
            announcements: Announcements::default(),
            faults: History::new(),
            limits: History::new(),
            limit: 0,
            memory: FaultMemory::new(),
            events: Deque::new(),
        }
    }

    /// The time of the last frame or poll.
    const fn now(&self) -> Micros {
        self.command.alive
    }

    /// Takes in what the control side did and saw.
    pub fn on_report(&mut self, report: &Report) {
        self.report = *report;
        // What it says about an earlier start is no longer true.
        if report.start != self.command.start {
            return;
        }
        if let Some(fault) = report.fault {
            self.transition(state::Event::Failed(fault), report.at);
        }
        if report.standstill && matches!(self.state, State::Ramping(_)) {
            self.transition(state::Event::Standstill, report.at);
        }
        let is_off = self.is_off();
        self.memory.record_off(report.at, is_off);
    }

    #[inline]
    pub fn take_configuration(&mut self) -> Option<&Configuration> {
        let to_hand = core::mem::take(&mut self.to_hand);
        self.configuration.as_ref().filter(|_| to_hand)
    }

    /// Whether the LED shall show which robot it is.
    #[inline]
    pub fn blinks(&self) -> bool {
        self.now() < self.blinks_until
    }

    /// Whether the outputs are off, by both sides.
    #[inline]
    pub fn is_off(&self) -> bool {
        matches!(self.state, State::Ready | State::Faulted(_))
            && self.report.mode == Mode::Off
            && self.report.start == self.command.start
    }

    /// Whether the outputs are off and nothing has been asked that would change that.
    fn is_at_rest(&self) -> bool {
        self.nmt != NmtState::Operational && self.is_off()
    }

    /// The configuration with which the control side does what it is asked; `None` if it does not.
    fn able(&self) -> Option<&Configuration> {
        let able = self.last_sync >= self.listened
            && self.report.start == self.command.start
            && self.report.fault.is_none()
            && matches!(self.report.mode, Mode::Hold | Mode::Follow);
        self.configuration
            .as_ref()
            .filter(|known| able && self.report.configuration == known.crc)
    }

    /// The same, once the brake has let go: until then no setpoint would be followed.
    fn able_to_move(&self) -> Option<&Configuration> {
        self.able().filter(|_| self.report.brake_is_free)
    }

    /// Asks the control side for this twist.
    fn aim(&mut self, at: Micros, twist_cmd: Twist, sequence: u8) {
        if matches!(self.state, State::Moving | State::Alone) {
            self.command.twist_cmd = twist_cmd;
            self.command.sequence = sequence;
            let times = self.configuration.as_ref().map(|known| known.times);
            let delay_us = times.map_or(0, |times| times.agreement_delay_us);
            self.command.at = self.clock.estimate().unwrap_or(at) + Micros(delay_us.into());
            self.command.update = self.command.update.wrapping_add(1);
        }
    }

    /// Moves the state machine and does what that brings with it.
    fn transition(&mut self, event: state::Event, now: Micros) {
        let from = self.state;
        let to = from.after(event);
        if to == from {
            return;
        }
        self.state = to;
        self.runs_out = now;
        self.command.mode = match to {
            State::Ready | State::Faulted(_) => Mode::Off,
            State::Armed => Mode::Hold,
            State::Alone if self.identification.is_running => Mode::Identify,
            State::Moving | State::Alone => Mode::Follow,
            State::Ramping(_) => Mode::Ramp,
        };
        self.identification.is_running &= to == State::Alone;
        if let Some(fault) = to.fault()
            && from.fault() != Some(fault)
        {
            let stops = &mut self.counters.stops;
            *stops = stops.wrapping_add(1);
            self.record(fault, now);
        } else if to == State::Armed {
            self.announcements.clear_all();
        }
        self.emit(Event::State { from, to });
    }

    pub fn emit(&mut self, event: Event) {
        let _ = self.events.push_back(event);
    }

    pub fn on_fault(&mut self, now: Micros, fault: Fault) {
        if matches!(self.state, State::Ready | State::Faulted(_)) {
            self.record(fault, now);
        } else {
            self.transition(state::Event::Failed(fault), now);
        }
    }
}

/// Time as the CANopen device has it.
pub(crate) const fn device_time(at: Micros) -> canopen::Micros {
    canopen::Micros(at.0)
}

/// Time as the robot has it.
pub(crate) const fn local_time(at: canopen::Micros) -> Micros {
    Micros(at.0)
}
