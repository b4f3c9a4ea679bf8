//! The bus side: the CANopen device, the robot's application behind it, and the way in and out.
//!
//! A frame goes to the device, which finds the service that it belongs to and calls the application
//! for a SYNC, a setpoint, a heartbeat, a frame of another member, or the value of an object. This
//! module does what needs both device and application: a start, a change of the NMT state,
//! emergency messages, the store.
//!
//! Frames must come in the order of their reception, each with its time. All timeouts are checked
//! before a frame is, so a frame that comes too late does not end a timeout. The owner has three
//! duties:
//!
//! - after every control tick (or at least once per SYNC) hand over the newest [`Report`];
//! - after every call take the [`Configuration`] if there is one, then the [`Command`];
//! - call [`BusSide::poll`] at [`BusSide::next_deadline`], which is never further than 10 ms away,
//!   because the control side treats a silent bus side as failed.
//!
//! Queues that can fill up: the device's frames and events, and the events here; all drop the
//! newest, and the device counts it.

use boot::{Crypto, Flash};
use canopen::{Device, Emergency, ErrorClass, Frame, NmtCommand, NmtState};
use control::configuration::Configuration;
use control::interface::{Command, Report};
use control::time::Micros;
use identification::Outcome;
use protocol::{Fault, StoredFault, cob};

use crate::application::{Application, device_time, local_time};
use crate::can::{CanChange, CanErrors};
use crate::counters::Counters;
use crate::event::Event;
use crate::fault_memory::Memorable;
use crate::identity::Identity;
use crate::lock::{Hmac, Key};
use crate::parameters::Parameters;
use crate::state::State;
use crate::store::{IMAGE_MAX, Stored};
use crate::update::{Done, Job, StandIn};

/// Longest time between two polls, us.
const ALIVE_US: u64 = 10_000;

/// The bus side of one robot.
#[cfg_attr(feature = "copies", derive(Clone))]
pub struct BusSide {
    device: Device,
    robot: Application,
}

impl BusSide {
    /// A robot that has not been on the bus yet.
    #[must_use]
    #[inline(always)]
    pub fn new(identity: Identity) -> Self {
        Self {
            device: Device::new(identity.device()),
            robot: Application::new(identity),
        }
    }

    /// Takes in a frame received at `at`.
    #[inline]
    pub fn on_frame(&mut self, at: Micros, frame: &Frame) {
        self.begin(at);
        self.device
            .on_frame(device_time(at), frame, &mut self.robot);
        self.finish(at);
    }

    /// Does what is due at `now`.
    #[inline]
    pub fn poll(&mut self, now: Micros) {
        self.begin(now);
        self.robot.note_limit_at_rest(now);
        self.robot.supervise_trial(now);
        self.device.poll(device_time(now), &mut self.robot);
        self.finish(now);
    }

    /// Of the function codes it wants to see, those whose frames may be kept from it for a
    /// millisecond, if the order and the times at which frames were received stay what they are.
    /// They mean nothing before the next SYNC; or, as votes, before the last of them
    /// ([`BusSide::votes_missing`]).
    pub const CAN_WAIT: u16 = canopen::function_code_bit(cob::member_status(0))
        | canopen::function_code_bit(cob::measured_twist(0))
        | canopen::function_code_bit(cob::GROUP_TWIST)
        | canopen::function_code_bit(cob::MASTER_HEARTBEAT);

    /// How many statuses of members a decision waits for: with the last of them it is due at once.
    /// 0 when it waits for none.
    #[inline]
    #[must_use]
    pub fn votes_missing(&self) -> u32 {
        self.robot.votes_missing()
    }

    /// Function codes of the frames it wants to see, one bit for each (bit n: identifiers from 128
    /// n on); the others may be kept from it. What a master changes is in it before the answer to
    /// that is sent.
    #[inline]
    #[must_use]
    pub fn function_codes(&self) -> u16 {
        const OWN: u16 = canopen::function_code_bit(cob::emergency(0))
            | canopen::function_code_bit(cob::member_status(0))
            | canopen::function_code_bit(cob::measured_twist(0))
            | canopen::function_code_bit(cob::GROUP_TWIST)
            | canopen::function_code_bit(cob::MASTER_HEARTBEAT);
        self.device.function_codes() | OWN
    }

    /// Takes in what the control side did and saw.
    #[inline]
    pub fn on_report(&mut self, report: &Report) {
        self.robot.on_report(report);
        self.announce(report.at);
    }

    /// Takes in what the control side has found out about the motors.
    pub fn on_identification(&mut self, now: Micros, outcome: &Outcome) {
        self.robot.on_identification(now, outcome);
    }

    /// Takes in a fault that only the platform can see: bus-off, overrun, a crash before this
    /// start.
    ///
    /// A robot at rest stays in the state it is in, but the fault is announced and kept in the
    /// history.
    pub fn on_fault(&mut self, now: Micros, fault: Fault) {
        self.robot.on_fault(now, fault);
        self.announce(now);
    }

    /// The CAN controller went off the bus: ramps down; nothing is sent until
    /// [`BusSide::on_bus_recovered`]. [`Event::RecoverBus`] says when to try.
    pub fn on_bus_off(&mut self, now: Micros) {
        self.on_fault(now, Fault::BusOff);
        self.device.on_bus_off(device_time(now));
        self.robot.can.off = true;
        self.robot.can.bus_offs = self.device.counters().bus_off;
        self.finish(now);
    }

    /// The CAN controller is back on the bus.
    pub fn on_bus_recovered(&mut self, now: Micros) {
        self.robot.can.off = false;
        self.device.on_bus_recovered(device_time(now));
        self.finish(now);
    }

    /// Takes in the error counters of the CAN controller; nothing happens when they have not
    /// changed.
    #[inline]
    pub fn on_can_errors(&mut self, now: Micros, errors: &CanErrors) {
        match self.robot.can.update(errors) {
            None => {}
            Some(CanChange::Passive) => self.announce_passive(now),
            Some(CanChange::Active) => {
                let mut emergencies = self.device.errors(device_time(now));
                emergencies.clear(Emergency::CAN_PASSIVE, 0);
            }
        }
    }

    /// The next frame to send.
    #[inline]
    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.device.pop_frame()
    }

    /// The next event.
    #[inline]
    pub fn pop_event(&mut self) -> Option<Event> {
        self.robot.events.pop_front()
    }

    /// When [`BusSide::poll`] has something to do, at the latest.
    #[inline]
    #[must_use]
    pub fn next_deadline(&self) -> Option<Micros> {
        let alive = self.robot.command.alive + Micros(ALIVE_US);
        let device = self.device.next_deadline().map_or(Micros::MAX, local_time);
        Some(alive.min(device).min(self.robot.runs_out))
    }

    /// What the control side is asked to do.
    #[must_use]
    pub const fn command(&self) -> &Command {
        &self.robot.command
    }

    /// A configuration the control side must take over before the next command; given once.
    #[inline]
    pub fn take_configuration(&mut self) -> Option<&Configuration> {
        self.robot.take_configuration()
    }

    /// What the robot is doing.
    #[must_use]
    pub const fn state(&self) -> State {
        self.robot.state
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
        self.robot.identity.node.get()
    }

    /// The group scale in force, 0 to 1.
    #[must_use]
    pub fn group_scale(&self) -> f32 {
        self.robot.scale.factor()
    }

    /// Whether a client has asked which robot this is: the LED shall answer.
    #[inline]
    #[must_use]
    pub fn blinks(&self) -> bool {
        self.robot.blinks()
    }

    /// The parameters as they have been written.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.robot.parameters
    }

    /// What the robot counts; the platform adds what only it can see.
    pub const fn counters_mut(&mut self) -> &mut Counters {
        &mut self.robot.counters
    }

    /// Takes in what the platform has stored, at start, before anything else, and the memory it may
    /// keep an image in. The parameters take effect if all of them are good; otherwise they have
    /// their defaults, and the robot is in fault and refuses to start until a master has saved or
    /// restored.
    pub fn load(&mut self, now: Micros, memory: &'static mut [u8; IMAGE_MAX], stored: Stored<'_>) {
        self.robot.load(now, memory, stored);
        self.announce(now);
    }

    /// An image that the platform must store now, in place of the one it has; then it calls
    /// [`BusSide::finish_store`]. Outputs are off and stay off until then.
    #[inline]
    #[must_use]
    pub fn image_to_store(&self) -> Option<&[u8]> {
        self.robot.store.image_to_store()
    }

    /// The image has been stored; or it has not, and this is what the platform has.
    pub fn finish_store(&mut self, outcome: Result<(), Stored<'_>>) {
        let answer = self.robot.store.finish(outcome);
        self.device.finish_store(answer);
    }

    /// Takes in the key of the lock that the platform has stored, and a hash; at start, before
    /// anything else. Without it the lock is off and takes no key.
    pub fn load_lock(&mut self, key: Key, hmac: Hmac) {
        self.robot.lock.give(key, hmac);
    }

    /// Takes in the starts that the platform has counted and the faults that it has stored, the
    /// newest last; at start, before there is a new one.
    pub fn recall(&mut self, starts: u32, faults: impl Iterator<Item = [u8; StoredFault::LENGTH]>) {
        self.robot.memory.recall(starts, faults);
    }

    /// Whether the platform may write to its flash: outputs are off, and no image waits.
    /// [`BusSide::to_remember`] says nothing otherwise.
    #[inline]
    #[must_use]
    pub fn may_write(&self) -> bool {
        self.robot.is_off() && !self.robot.store.asked
    }

    /// What the platform is to add to its flash now, a key or an entry of its fault memory; then it
    /// calls [`BusSide::remembered`] and asks again. Outputs are off. It may take half a second; a
    /// start that comes meanwhile takes effect after that.
    #[must_use]
    pub fn to_remember(&self, now: Micros) -> Option<Memorable> {
        if !self.may_write() {
            return None;
        }
        let key = self.robot.lock.is_key_new.then_some(Memorable::Key);
        key.or_else(|| self.robot.memory.next(now))
    }

    /// The key to store when [`BusSide::to_remember`] says so.
    #[must_use]
    pub const fn new_key(&self) -> &Key {
        &self.robot.lock.new_key
    }

    /// What was to be remembered is stored, or cannot be.
    pub fn remembered(&mut self, now: Micros, is_stored: bool) {
        if !self.robot.lock.stored(now, is_stored) {
            self.robot.memory.stored(now, is_stored);
        }
    }

    /// Reads what is known about the slots of flash; at start, before anything else.
    pub fn survey(&mut self, flash: &impl Flash) {
        self.robot.update.start(flash);
    }

    /// Whether an update is under way, and [`BusSide::update_job`] may say what to do.
    #[inline(always)]
    #[must_use]
    pub fn is_updating(&self) -> bool {
        self.robot.update.is_busy()
    }

    /// What the platform must do for an update now, once the frames of [`BusSide::pop_frame`] are
    /// on the bus: [`BusSide::work_on_update`] does it. Outputs are off.
    #[must_use]
    pub fn update_job(&self) -> Option<Job> {
        self.robot.update_job()
    }

    /// Does what [`BusSide::update_job`] says. After [`Done::Reset`] the platform resets the
    /// processor.
    pub fn work_on_update(&mut self, flash: &mut impl Flash, crypto: &impl Crypto) -> Done {
        self.robot.work_on_update(flash, crypto)
    }

    /// What is to be said for this robot while its program cannot run, in its present state.
    #[must_use]
    pub fn stand_in(&self) -> Option<StandIn> {
        let node = self.device.node()?;
        let heartbeat_ms = self.device.heartbeat_ms();
        let (status, state) = (self.robot.update.flash_status(), self.device.state().code());
        Some(StandIn::new(
            node,
            status.to_le_bytes(),
            state,
            heartbeat_ms,
        ))
    }

    /// Before a frame, or what is due, is handled.
    #[inline(always)]
    fn begin(&mut self, now: Micros) {
        self.robot.supervise(now);
        self.announce(now);
        self.robot.command.alive = now;
    }

    /// Does what the device's events ask for, and sends what there is to announce.
    #[inline(always)]
    fn finish(&mut self, now: Micros) {
        if self.device.has_events() {
            self.on_events(now);
        }
        self.announce(now);
    }

    /// Does what the device's events ask for.
    #[inline(never)]
    fn on_events(&mut self, now: Micros) {
        while let Some(event) = self.device.pop_event() {
            match event {
                canopen::Event::NmtCommand(NmtCommand::Start) => {
                    self.robot.start(now, &self.device);
                }
                canopen::Event::NmtChanged { from, to } => {
                    self.robot.on_nmt(now, from, to, self.device.node());
                    if from == NmtState::Initialising {
                        // What the device has announced already it does not announce twice.
                        self.robot.repeat_announcements();
                        if self.robot.can.passive {
                            self.announce_passive(now);
                        }
                    }
                }
                canopen::Event::SyncGap { .. } => {
                    let lost = &mut self.robot.counters.lost_syncs;
                    *lost = lost.wrapping_add(1);
                }
                canopen::Event::RecoverBus => self.robot.emit(Event::RecoverBus),
                _ => {}
            }
        }
    }

    /// Sends emergency messages about what is new since the last time.
    #[inline(always)]
    fn announce(&mut self, now: Micros) {
        if self.robot.has_news() {
            self.announce_news(now);
        }
    }

    #[cold]
    #[inline(never)]
    fn announce_news(&mut self, now: Micros) {
        self.robot
            .announce(&mut self.device.errors(device_time(now)));
    }

    /// The CAN controller is error passive; said once more after a reset of the communication.
    fn announce_passive(&mut self, now: Micros) {
        let mut emergencies = self.device.errors(device_time(now));
        emergencies.raise(
            Emergency::CAN_PASSIVE,
            ErrorClass::Communication,
            Default::default(),
        );
    }
}
