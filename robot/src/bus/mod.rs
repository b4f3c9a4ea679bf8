//! The bus side: frames in, frames out, and what the control side is asked to do.
//!
//! It owns the CANopen device, the object dictionary, the state machine and the agreement with the
//! other members. Frames must come in the order they were received; with each comes the time of its
//! reception, and all time-outs are looked at before a frame is, so a frame that comes too late
//! revives nothing. The owner keeps it going:
//!
//! - after every control tick (or at least once per SYNC) hand over the newest [`Report`];
//! - after every call take the [`Configuration`] if there is one, then the [`Command`];
//! - call [`BusSide::poll`] at [`BusSide::next_deadline`], which is never further than 10 ms away:
//!   the control side takes a bus side without sign of life for dead.
//!
//! Queues that can fill up: the device's frames and events, and the events here; all drop the
//! newest, and the device counts it.

mod can;
mod faults;
mod identification;
mod members;
mod publish;
mod storage;

pub use can::CanErrors;
pub(crate) use can::CanRecord;
pub(crate) use identification::Record;

use canopen::{Device, Frame, NmtCommand, NmtState};
use control::time::Micros;
use heapless::Deque;
use kinematics::Twist;
use protocol::address::SYNC_PERIOD;
use protocol::timing::{APPLY_DELAY_US, HEARTBEAT_MS};
use protocol::{Fault, Limit, Plan, Scale, cob};

use crate::agreement::{Agreement, Own};
use control::clock::SyncClock;
use control::configuration::Configuration;

use crate::configuration;
use crate::dictionary::{Counters, Dictionary};
use crate::identity::{self, Identity};
use crate::interlock::Interlock;
use crate::parameters::Parameters;
use crate::rhythm::{Beat, Rhythm};
use crate::sequence::{Reception, Setpoints};
use crate::state::{self, State};
use crate::strain::Strain;
use control::interface::{Command, Mode, Report};
use control::math::sqrt;
use members::permitted;

/// Longest time between two polls, us.
const ALIVE_US: u64 = 10_000;

/// How long a robot listens after its boot-up before it moves, us: the longest a robot of the same
/// node that has booted in the same instant can take to its first heartbeat, and as much as a tick
/// and a frame take.
const LISTEN_US: u64 = HEARTBEAT_MS as u64 * 1_000 + 20_000;
/// How long a second robot with the same node counts as there after it was last heard, us: ten
/// heartbeats.
const DOUBLE_US: u64 = HEARTBEAT_MS as u64 * 10_000;

/// Fastest commissioning twist, m/s: the reduced speed of ISO 10218-1, 250 mm/s.
const ALONE_SPEED: f32 = 0.25;
/// The same about the vertical axis, rad/s: a corner half a metre from the centre then has that
/// speed.
const ALONE_YAW_RATE: f32 = 0.5;

/// Something the platform may want to log or show.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Event {
    /// The state machine moved.
    State {
        /// From here.
        from: State,
        /// To here.
        to: State,
    },
    /// A fault was latched; an emergency message is on its way.
    Fault(Fault),
    /// The NMT state changed.
    Nmt(NmtState),
    /// The platform should bring the CAN controller back on the bus.
    RecoverBus,
    /// A SYNC was received.
    Sync {
        /// Its counter.
        counter: Option<u8>,
        /// When it came in.
        at: Micros,
    },
}

/// The bus side of one robot.
pub struct BusSide {
    identity: Identity,
    device: Device,
    dictionary: Dictionary,
    state: State,
    configuration: Option<Configuration>,
    /// The control side has not been given the configuration yet.
    to_hand: bool,
    agreement: Agreement,
    /// Published about the setpoint that is latched.
    own: Own,
    /// What is part of every checksum of `own`.
    plan: Plan,
    interlock: Interlock,
    clock: SyncClock,
    rhythm: Rhythm,
    strain: Strain,
    setpoints: Setpoints,
    own_setpoints: Setpoints,
    /// In force.
    scale: Scale,
    scale_is_own: bool,
    /// Why this member, though started, permits no motion.
    waits: Option<Limit>,
    last_sync: Micros,
    last_heartbeat: Micros,
    /// Nothing runs out before. Signs of life only move that further off, so it need not follow
    /// them at once.
    runs_out: Micros,
    report: Report,
    command: Command,
    /// The commissioning motion is an identification.
    identifying: bool,
    /// When its LED has shown long enough which robot it is.
    blinks_until: Micros,
    /// Until when it has listened for a robot of the same node.
    listened: Micros,
    /// Until when a robot of the same node counts as there.
    doubled_until: Micros,
    /// Which byte of a group twist names its group, as RPDO1 is mapped; fixed while OPERATIONAL.
    group_byte: Option<usize>,
    /// Until when it may move alone.
    permitted_until: Micros,
    /// Started as its own only member, which it is not by its parameters.
    alone_for_now: bool,
    /// Code of the limit that was active at the last SYNC; 0 for none.
    limit: u16,
    /// Faults announced and not yet declared over, one bit each.
    announced: u64,
    events: Deque<Event, 8>,
}

impl BusSide {
    /// A robot that has not been on the bus yet.
    #[must_use]
    #[inline(always)]
    pub fn new(identity: Identity) -> Self {
        Self {
            identity,
            device: Device::new(identity::config(&identity)),
            dictionary: Dictionary::new(identity::device(&identity)),
            state: State::Ready,
            configuration: None,
            to_hand: false,
            clock: SyncClock::new(),
            rhythm: Rhythm::new(),
            strain: Strain::new(),
            agreement: Agreement::new(),
            own: Own::NONE,
            plan: Plan::NONE,
            interlock: Interlock::new(u8::MAX),
            setpoints: Setpoints::new(),
            own_setpoints: Setpoints::new(),
            scale: Scale::ZERO,
            scale_is_own: false,
            waits: None,
            last_sync: Micros::ZERO,
            last_heartbeat: Micros::ZERO,
            runs_out: Micros::ZERO,
            report: Report::NONE,
            command: Command::NONE,
            identifying: false,
            blinks_until: Micros::ZERO,
            listened: Micros::MAX,
            doubled_until: Micros::ZERO,
            group_byte: None,
            permitted_until: Micros::ZERO,
            alone_for_now: false,
            limit: 0,
            announced: 0,
            events: Deque::new(),
        }
    }

    /// Takes in a frame received at `at`.
    pub fn on_frame(&mut self, at: Micros, frame: &Frame) {
        self.supervise(at);
        self.dictionary.store.at_rest = self.is_at_rest();
        self.dictionary.identification.permitted = self.may_identify();
        self.command.alive = at;
        let id = frame.id();
        if cob::is_sent_by(id, self.identity.node.get()) {
            return self.on_double(at);
        }
        if id == cob::GROUP_TWIST && self.is_for_another_group(frame) {
            return;
        }
        if id == cob::sdo_request(self.identity.node.get()) {
            // Who asks wants to know what is, not what was at the last SYNC.
            self.publish(at);
        }
        if id == cob::MASTER_HEARTBEAT {
            self.on_master_heartbeat(at, frame.data());
        } else if self.device.state() == NmtState::Operational {
            self.on_member_frame(at, frame);
        }
        self.device
            .on_frame(device_time(at), frame, &mut self.dictionary);
        self.drain(at);
    }

    /// Does what is due at `now`.
    pub fn poll(&mut self, now: Micros) {
        self.supervise(now);
        self.command.alive = now;
        self.device.poll(device_time(now), &mut self.dictionary);
        self.drain(now);
    }

    /// Of the function codes it wants to see, those whose frames mean nothing before the next SYNC:
    /// they may be kept from it for a millisecond, if the order and the times at which frames were
    /// received stay what they are.
    pub const CAN_WAIT: u16 = canopen::function_code_bit(cob::member_status(0))
        | canopen::function_code_bit(cob::measured_twist(0))
        | canopen::function_code_bit(cob::GROUP_TWIST)
        | canopen::function_code_bit(cob::MASTER_HEARTBEAT);

    /// Function codes of the frames it wants to see, one bit for each (bit n: identifiers from 128
    /// n on); the others may be kept from it. What a master changes is in it before the answer to
    /// that is sent.
    #[must_use]
    pub fn function_codes(&self) -> u16 {
        [
            cob::emergency(0),
            cob::member_status(0),
            cob::measured_twist(0),
            cob::GROUP_TWIST,
            cob::MASTER_HEARTBEAT,
        ]
        .into_iter()
        .fold(self.device.function_codes(), |codes, id| {
            codes | canopen::function_code_bit(id)
        })
    }

    /// Takes in what the control side did and saw.
    pub fn on_report(&mut self, report: &Report) {
        self.report = *report;
        self.dictionary.supply = report.supply;
        self.dictionary.current = report.current;
        self.dictionary.slip = report.slip_residual;
        self.dictionary.roller_states = report.roller_states.map(|state| state as u8);
        self.dictionary.roller_sweeps = report.roller_sweeps;
        self.dictionary.counters.late_ticks = report.late_ticks;
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
        self.dictionary.memory.record_off(report.at, is_off);
    }

    /// Takes in a fault that only the platform can see: bus-off, overrun, a crash before this
    /// start.
    ///
    /// A robot at rest stays in the state it is in, but the fault is announced and kept in the
    /// history.
    pub fn on_fault(&mut self, now: Micros, fault: Fault) {
        if matches!(self.state, State::Ready | State::Faulted(_)) {
            self.record(fault, now);
        } else {
            self.transition(state::Event::Failed(fault), now);
        }
    }

    /// The CAN controller went off the bus: ramps down; nothing is sent until
    /// [`BusSide::on_bus_recovered`]. [`Event::RecoverBus`] says when to try.
    pub fn on_bus_off(&mut self, now: Micros) {
        self.on_fault(now, Fault::BusOff);
        self.device.on_bus_off(device_time(now));
        self.dictionary.can.off = true;
        self.dictionary.can.bus_offs = self.device.counters().bus_off;
        self.drain(now);
    }

    /// The CAN controller is back on the bus.
    pub fn on_bus_recovered(&mut self, now: Micros) {
        self.dictionary.can.off = false;
        self.device.on_bus_recovered(device_time(now));
        self.drain(now);
    }

    /// The next frame to send.
    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.device.pop_frame()
    }

    /// The next event.
    pub fn pop_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// When [`BusSide::poll`] has something to do, at the latest.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Micros> {
        let alive = self.command.alive + Micros(ALIVE_US);
        let device = self.device.next_deadline().map_or(Micros::MAX, local_time);
        Some(alive.min(device).min(self.runs_out))
    }

    /// What the control side is asked to do.
    #[must_use]
    pub const fn command(&self) -> &Command {
        &self.command
    }

    /// A configuration the control side must take over before the next command; given once.
    pub fn take_configuration(&mut self) -> Option<&Configuration> {
        let to_hand = core::mem::take(&mut self.to_hand);
        self.configuration.as_ref().filter(|_| to_hand)
    }

    /// What the robot is doing.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The NMT state.
    #[must_use]
    pub const fn nmt_state(&self) -> NmtState {
        self.device.state()
    }

    /// Its node number. Frames that end in it are for it, or from another robot with the same
    /// number: it wants to see them whatever their function code.
    #[must_use]
    pub const fn node(&self) -> u8 {
        self.identity.node.get()
    }

    /// The group scale in force, 0 to 1.
    #[must_use]
    pub fn group_scale(&self) -> f32 {
        self.scale.factor()
    }

    /// Whether somebody has asked which robot this is: the LED shall answer.
    #[must_use]
    pub const fn blinks(&self) -> bool {
        self.dictionary.blinks > 0
    }

    /// The parameters as they have been written.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.dictionary.parameters
    }

    /// What the robot counts; the platform adds what only it can see.
    pub const fn counters_mut(&mut self) -> &mut Counters {
        &mut self.dictionary.counters
    }

    /// A frame with an identifier that only this robot uses: there is another one with its node
    /// number. Two of them are one node for everybody else, and both follow the group with one
    /// vote.
    #[inline(never)]
    fn on_double(&mut self, at: Micros) {
        let known = at < self.doubled_until;
        self.doubled_until = at + Micros(DOUBLE_US);
        if !known {
            self.on_fault(at, Fault::DuplicateNode);
        }
        self.drain(at);
    }

    /// Groups share the bus, its SYNC and its master's heartbeat. A twist for another one is
    /// neither taken nor counted.
    fn is_for_another_group(&self, frame: &Frame) -> bool {
        let group = self.configuration.as_ref().map(|known| known.group);
        let addressed = self.group_byte.and_then(|byte| frame.data().get(byte));
        let (Some(group), Some(addressed)) = (group, addressed) else {
            return false;
        };
        *addressed != group
    }

    fn drain(&mut self, now: Micros) {
        self.update_permission(now);
        self.update_identification(now);
        self.update_blinking(now);
        while let Some(event) = self.device.pop_event() {
            match event {
                canopen::Event::NmtCommand(NmtCommand::Start) => self.on_start(now),
                canopen::Event::NmtChanged { from, to } => {
                    self.dictionary.commissioning = false;
                    if from == NmtState::Operational {
                        self.dictionary.alone_for_now = false;
                        self.transition(state::Event::Left, now);
                    }
                    if from == NmtState::Initialising {
                        self.listened = now + Micros(LISTEN_US);
                        self.announce_passive(now);
                    }
                    self.follow_node();
                    self.emit(Event::Nmt(to));
                }
                canopen::Event::Sync { counter, at, .. } => {
                    self.on_sync(local_time(at), counter);
                    self.device.on_sync_done(at, &mut self.dictionary);
                    self.emit(Event::Sync {
                        counter,
                        at: local_time(at),
                    });
                }
                canopen::Event::SyncGap { .. } => {
                    let lost = &mut self.dictionary.counters.lost_syncs;
                    *lost = lost.wrapping_add(1);
                }
                canopen::Event::RecoverBus => self.emit(Event::RecoverBus),
                _ => {}
            }
        }
    }

    /// A node-ID given by LSS takes effect with a reset of the communication.
    fn follow_node(&mut self) {
        if let Some(node) = self.device.node() {
            self.identity.node = node;
            self.dictionary.device.node = node.get();
        }
    }

    /// NMT start: the only way into motion. Everything that speaks against it is looked at here.
    /// Not inlined: it has a configuration on its stack, a kilobyte.
    #[inline(never)]
    fn on_start(&mut self, now: Micros) {
        if !matches!(self.state, State::Ready | State::Armed | State::Faulted(_)) {
            return;
        }
        if self.dictionary.store.asked {
            // Outputs stay off until it is over; the master has not had its answer yet.
            return;
        }
        if self.dictionary.store.corrupt.is_some() {
            return self.transition(state::Event::StartRefused(Fault::ParametersCorrupt), now);
        }
        let node = self.identity.node.get();
        // Looked at where it is: on the stack it is a kilobyte each time it moves.
        let mut built = configuration::build(&self.dictionary.parameters, node);
        let Ok(configuration) = &mut built else {
            return self.transition(state::Event::StartRefused(Fault::Unconfigured), now);
        };
        if self.dictionary.alone_for_now {
            configuration.members = 1 << node;
        }
        let configuration = &*configuration;
        if now < self.doubled_until {
            return self.transition(state::Event::StartRefused(Fault::DuplicateNode), now);
        }
        let protective = configuration.protective_stop && self.report.protective_stop;
        let obstacle = self.report.obstacle;
        if let Some(fault) = obstacle.or(protective.then_some(Fault::ProtectiveStop)) {
            return self.transition(state::Event::StartRefused(fault), now);
        }
        if self.configuration.as_ref() != Some(configuration) {
            self.configuration = Some(*configuration);
            self.to_hand = true;
        }
        self.alone_for_now = self.dictionary.alone_for_now;
        self.command.configuration = configuration.crc;
        self.group_byte = self.group_byte();
        self.command.start = self.command.start.wrapping_add(1);
        self.last_heartbeat = now;
        self.runs_out = now;
        self.setpoints.restart();
        self.own_setpoints.restart();
        self.strain.restart();
        self.own = Own::NONE;
        self.agreement = Agreement::new();
        self.interlock = Interlock::new(configuration.standstill_syncs);
        self.plan = self.make_plan();
        self.transition(state::Event::Started, now);
    }

    /// SYNC: first the decision on the last setpoint, then the next one, then the vote on it.
    #[inline(never)]
    fn on_sync(&mut self, at: Micros, counter: Option<u8>) {
        self.last_sync = at;
        let period_us = self.dictionary.parameters.unsigned(SYNC_PERIOD);
        self.clock.on_sync(at, period_us as f32);
        let beat = self.rhythm.on_sync(at, counter, period_us);
        let Some(configuration) = &self.configuration else {
            return self.publish(at);
        };
        let (members, group) = (configuration.members, configuration.group);
        // From now on the votes of this SYNC are missing.
        self.runs_out = self
            .runs_out
            .min(at + Micros(configuration.times.silence_us()));
        self.decide(at, members);
        let before = self.setpoints.ignored();
        let received =
            core::mem::take(&mut self.dictionary.setpoint.1).then_some(self.dictionary.setpoint.0);
        let reception = self.setpoints.on_sync(at, beat, received.as_ref(), group);
        let ignored = self.setpoints.ignored().wrapping_sub(before);
        let counter = &mut self.dictionary.counters.ignored_setpoints;
        *counter = counter.wrapping_add(ignored);
        if reception == Reception::TwoMasters {
            self.transition(state::Event::Failed(Fault::TwoMasters), at);
        }
        if let Some(configuration) = &self.configuration
            && let Some(fault) = self.strain.on_sync(at, self.report.measured, configuration)
            && self.state == State::Moving
        {
            self.transition(state::Event::Failed(fault), at);
        }
        self.vote(beat);
        self.follow_alone(at, beat);
        self.publish(at);
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

    /// The commissioning twist: nobody else to agree with, so it takes effect at once.
    ///
    /// It is for tests with a person near the robot, so it is slow whatever is asked for.
    fn follow_alone(&mut self, at: Micros, beat: Beat) {
        let received =
            core::mem::take(&mut self.dictionary.alone.1).then_some(self.dictionary.alone.0);
        let permitted_now = self.dictionary.commissioning
            && !self.identifying
            && matches!(self.state, State::Armed | State::Alone)
            && self.able().is_some();
        let only_itself = 1 << self.identity.node.get();
        let configuration = self.configuration.as_ref();
        let alone = |known: &&Configuration| permitted_now && known.members == only_itself;
        let Some(configuration) = configuration.filter(alone) else {
            return;
        };
        let reception =
            self.own_setpoints
                .on_sync(at, beat, received.as_ref(), configuration.group);
        let (Reception::Fresh, Some(latched)) = (reception, self.own_setpoints.latched()) else {
            return;
        };
        let twist = configuration.mount.to_group(slowly(latched.twist));
        self.scale = permitted(configuration, twist);
        self.scale_is_own = true;
        self.transition(state::Event::OwnSetpoint, at);
        self.aim(at, twist * self.scale.factor(), latched.sequence);
    }

    fn aim(&mut self, at: Micros, target: Twist, sequence: u8) {
        if matches!(self.state, State::Moving | State::Alone) {
            self.command.twist_cmd = target;
            self.command.sequence = sequence;
            self.command.at = self.clock.estimate().unwrap_or(at) + Micros(APPLY_DELAY_US);
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
            State::Alone if self.identifying => Mode::Identify,
            State::Moving | State::Alone => Mode::Follow,
            State::Ramping(_) => Mode::Ramp,
        };
        self.identifying &= to == State::Alone;
        if let Some(fault) = to.fault()
            && from.fault() != Some(fault)
        {
            let stops = &mut self.dictionary.counters.stops;
            *stops = stops.wrapping_add(1);
            self.record(fault, now);
        } else if to == State::Armed {
            self.clear_record(now);
        }
        self.emit(Event::State { from, to });
    }

    fn emit(&mut self, event: Event) {
        let _ = self.events.push_back(event);
    }
}

/// Time as the CANopen device has it.
pub(super) const fn device_time(at: Micros) -> canopen::Micros {
    canopen::Micros(at.0)
}

/// Time as the robot has it.
const fn local_time(at: canopen::Micros) -> Micros {
    Micros(at.0)
}

/// A twist in the robot's frame, brought down to what is safe beside a person.
fn slowly(twist: Twist) -> Twist {
    let speed = sqrt(twist.vx * twist.vx + twist.vy * twist.vy);
    let over = (speed / ALONE_SPEED).max(twist.omega.abs() / ALONE_YAW_RATE);
    twist * (1.0 / over.max(1.0))
}
