//! The device: passes every frame to its service.
//!
//! `Core` holds the communication objects and the independent services (one file each); the SDO
//! server is beside it, because it needs all of them at once. Each frame is processed completely
//! before the next, so a setpoint and a SYNC keep their order.
//!
//! The methods that reach the application's objects are generic for the caller's sake only: inside,
//! the object dictionary is a trait object, so that this code is compiled once, in this crate, with
//! this crate's optimisation; `inline(never)` keeps it from being copied into callers that are
//! built for speed.
//!
//! Cost: a SYNC or PDO frame is found by comparing identifiers, SYNC first. `poll` returns at once
//! until the earliest of all timers is due: every timer that is set lowers `Outbox::next`, and only
//! a `poll` that has checked all of them raises it again. The deadline may therefore be early, but
//! never late.

mod bus_off;
mod emergency;
mod heartbeat;
mod lss;
mod objects;
mod outbox;
mod pdo;
mod rpdo;
mod sdo;
mod store;
mod sync;
mod tpdo;

use crate::nmt;
use crate::{
    AbortCode, Config, Counters, ErrorClass, Event, Frame, Micros, NmtCommand, NmtState, NodeId,
    ObjectDictionary, ResetScope,
};

use bus_off::BusOff;
use emergency::Emergencies;
use heartbeat::Heartbeat;
use lss::Lss;
use outbox::Outbox;
use pdo::PdoIndex;
use rpdo::Rpdos;
use sync::Sync;
use tpdo::Tpdos;

pub use heartbeat::MAX_CONSUMERS;
pub use pdo::MAX_MAPPED;
pub use rpdo::MAX_RPDO;
pub use sdo::MAX_SDO;
pub use tpdo::MAX_TPDO;

const SDO_REQUEST: u16 = 0x600;
const HEARTBEAT: u16 = 0x700;

/// A CANopen device.
pub struct Device {
    core: Core,
    sdo: sdo::Server,
}

/// All of the device but the SDO server.
struct Core {
    config: Config,
    node: Option<NodeId>,
    state: NmtState,
    out: Outbox,
    /// 0x1F80.
    startup: u32,
    emergencies: Emergencies,
    bus_off: BusOff,
    lss: Lss,
    /// The application is saving or restoring.
    storing: bool,
    heartbeat: Heartbeat,
    sync: Sync,
    rpdos: Rpdos,
    tpdos: Tpdos,
}

impl Device {
    /// Makes a device that is not on the bus yet: the first [`poll`](Self::poll) sends the boot-up
    /// frame and enters PRE-OPERATIONAL.
    #[must_use]
    #[inline(always)]
    pub fn new(config: Config) -> Self {
        Self {
            core: Core {
                config,
                node: config.node,
                state: NmtState::Initialising,
                out: Outbox::new(),
                startup: config.startup,
                emergencies: Emergencies::new(&config, config.node),
                bus_off: BusOff::new(),
                lss: Lss::new(config.node),
                storing: false,
                heartbeat: Heartbeat::new(&config),
                sync: Sync::new(&config),
                rpdos: Rpdos::new(&config, config.node),
                tpdos: Tpdos::new(&config, config.node),
            },
            sdo: sdo::Server::new(),
        }
    }

    /// Handles a received frame. `now` is the time of its reception; frames must come in the order
    /// they were received.
    pub fn on_frame<O: ObjectDictionary>(&mut self, now: Micros, frame: &Frame, od: &mut O) {
        self.handle(now, frame, od);
    }

    /// Does what is due: boot-up, heartbeats, time-outs, and the synchronous TPDOs if
    /// [`on_sync_done`](Self::on_sync_done) has not been called since the last SYNC.
    pub fn poll<O: ObjectDictionary>(&mut self, now: Micros, od: &mut O) {
        self.poll_all(now, od);
    }

    /// The application has brought its objects up to date after a SYNC: reads and queues the
    /// synchronous TPDOs. Does nothing if no SYNC is waiting for that.
    pub fn on_sync_done<O: ObjectDictionary>(&mut self, now: Micros, od: &mut O) {
        self.core.on_sync_done(now, od);
    }

    /// The next frame to send.
    pub fn pop_frame(&mut self) -> Option<Frame> {
        let node = self.core.node;
        let queued = self.core.out.pop_frame();
        queued.or_else(|| self.sdo.pop_frame(node))
    }

    /// The next event.
    pub fn pop_event(&mut self) -> Option<Event> {
        self.core.out.pop_event()
    }

    /// Function codes of the frames it listens to, one bit for each (bit n: identifiers from 128 n
    /// on), for an acceptance filter. Whatever changes them changes them before the answer to it is
    /// sent.
    #[must_use]
    pub fn function_codes(&self) -> u16 {
        let fixed = [0, self.core.sync.id(), SDO_REQUEST, HEARTBEAT, lss::REQUEST];
        fixed
            .into_iter()
            .chain(self.core.rpdos.listening())
            .fold(0, |codes, id| codes | crate::function_code_bit(id))
    }

    /// When [`poll`](Self::poll) has something to do, at the earliest; it may turn out to be
    /// nothing. `None` if only a frame can make it so.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Micros> {
        let booting = self.core.state == NmtState::Initialising && self.core.node.is_some();
        if booting || self.core.sync.waits_for_application() {
            return Some(Micros::ZERO);
        }
        Some(self.core.out.next()).filter(|next| *next != Micros::MAX)
    }

    /// The NMT state.
    #[must_use]
    pub const fn state(&self) -> NmtState {
        self.core.state
    }

    /// The node-ID, if it has one.
    #[must_use]
    pub const fn node(&self) -> Option<NodeId> {
        self.core.node
    }

    /// What went wrong so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.core.out.counters()
    }

    /// The value in TPDO `number` (1 is 0x1800) has changed: sends it at the next SYNC (type 0) or
    /// as soon as its inhibit time allows (types 254 and 255).
    pub fn trigger_tpdo(&mut self, number: u8) {
        self.core.trigger_tpdo(number);
    }

    /// An error has appeared: sends an emergency message with this code and sets the bit of its
    /// class in 0x1001, until [`clear_error`](Self::clear_error). Errors with the same code and the
    /// same first byte of `info` are the same error and announced once.
    pub fn raise_error(&mut self, now: Micros, code: u16, class: ErrorClass, info: [u8; 5]) {
        self.core.raise(now, code, class, info);
    }

    /// The error with this code and this first byte of `info` has gone.
    pub fn clear_error(&mut self, now: Micros, code: u16, detail: u8) {
        self.core.clear(now, code, detail);
    }

    /// The error register, object 0x1001.
    #[must_use]
    pub fn error_register(&self) -> u8 {
        self.core.emergencies.register()
    }

    /// The CAN controller has gone bus-off. Nothing is sent until
    /// [`on_bus_recovered`](Self::on_bus_recovered); [`Event::RecoverBus`] says when to try.
    pub fn on_bus_off(&mut self, now: Micros) {
        self.core.on_bus_off(now);
    }

    /// The CAN controller is back on the bus.
    pub fn on_bus_recovered(&mut self, now: Micros) {
        self.core.on_bus_recovered(now);
    }

    /// Saving or restoring that was [pending](crate::StoreProgress::Pending) has ended: reports the
    /// result to the SDO client or the LSS master that waits for it.
    pub fn finish_store(&mut self, result: Result<(), AbortCode>) {
        if !self.core.finish_lss_store(result) {
            self.sdo.finish_store(&mut self.core, result);
        }
    }

    /// Reads any object, as an SDO client would.
    ///
    /// # Errors
    /// Those of [`ObjectDictionary::read`].
    pub fn read<O: ObjectDictionary>(
        &self,
        index: u16,
        sub: u8,
        out: &mut [u8],
        od: &O,
    ) -> Result<usize, AbortCode> {
        self.core.read(index, sub, out, od)
    }

    /// Writes any object, as an SDO client would.
    ///
    /// # Errors
    /// Those of [`ObjectDictionary::write`].
    pub fn write<O: ObjectDictionary>(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        data: &[u8],
        od: &mut O,
    ) -> Result<(), AbortCode> {
        self.core.write(now, index, sub, data, od)
    }

    #[inline(never)]
    fn handle(&mut self, now: Micros, frame: &Frame, od: &mut dyn ObjectDictionary) {
        let core = &mut self.core;
        if frame.id() == lss::REQUEST {
            return core.on_lss(now, frame, od);
        }
        if frame.id() == lss::RESPONSE {
            return core.hear_lss();
        }
        let (Some(node), true) = (core.node, core.state != NmtState::Initialising) else {
            return;
        };
        let id = frame.id();
        if id == core.sync.id() {
            core.on_sync(now, frame, od);
        } else if id == 0 {
            self.on_nmt(now, frame, node, od);
        } else if core.state == NmtState::Stopped {
            if let Some(sender) = heartbeat_sender(id) {
                core.on_heartbeat(now, sender, frame);
            }
        } else if id == node.cob_id(SDO_REQUEST) {
            self.sdo.on_request(now, frame, core, od);
        } else if let Some(sender) = heartbeat_sender(id) {
            core.on_heartbeat(now, sender, frame);
        } else {
            core.on_rpdo(now, frame, od);
        }
    }

    #[inline(never)]
    fn poll_all(&mut self, now: Micros, od: &mut dyn ObjectDictionary) {
        if self.core.state == NmtState::Initialising {
            self.core.boot(now, od);
        }
        self.core.on_sync_done(now, od);
        if now < self.core.out.next() {
            return;
        }
        self.core.out.clear_next();
        self.core.poll_bus_off(now);
        self.core.poll_heartbeat(now);
        self.core.poll_sync(now, od);
        self.core.poll_rpdos(now);
        self.core.poll_tpdos(now, od);
        self.sdo.poll(now, &mut self.core);
        self.core.poll_overflow(now);
        self.core.poll_emergencies(now);
    }

    fn on_nmt(&mut self, now: Micros, frame: &Frame, node: NodeId, od: &mut dyn ObjectDictionary) {
        let Some((command, target)) = nmt::parse(frame) else {
            return;
        };
        if !target.includes(node) {
            return;
        }
        let core = &mut self.core;
        core.out.emit(Event::NmtCommand(command));
        match command {
            NmtCommand::Start => core.enter(now, NmtState::Operational),
            NmtCommand::Stop => core.enter(now, NmtState::Stopped),
            NmtCommand::EnterPreOperational => core.enter(now, NmtState::PreOperational),
            NmtCommand::ResetNode => core.reset(now, ResetScope::Application, od),
            NmtCommand::ResetCommunication => core.reset(now, ResetScope::Communication, od),
        }
        match self.core.state {
            NmtState::Initialising | NmtState::Stopped => self.sdo.reset(),
            NmtState::PreOperational | NmtState::Operational => {}
        }
        if matches!(
            command,
            NmtCommand::ResetNode | NmtCommand::ResetCommunication
        ) {
            self.sdo.reset();
        }
    }
}

/// The node a heartbeat or boot-up frame comes from.
fn heartbeat_sender(id: u16) -> Option<NodeId> {
    match id & 0x780 {
        HEARTBEAT => NodeId::of_cob_id(id),
        _ => None,
    }
}

impl Core {
    /// Goes on the bus: boot-up frame, then PRE-OPERATIONAL. Not without a node-ID.
    fn boot(&mut self, now: Micros, od: &mut dyn ObjectDictionary) {
        let Some(node) = self.node else {
            return;
        };
        self.load(now, od);
        self.out.send(Frame::of(node.cob_id(HEARTBEAT), [0]));
        self.start_heartbeat(now);
        self.enter(now, NmtState::PreOperational);
        if self.startup & Config::STARTUP_BY_MASTER == 0 {
            self.enter(now, NmtState::Operational);
        }
    }

    /// Changes the NMT state, if it is another one.
    fn enter(&mut self, now: Micros, to: NmtState) {
        let from = self.state;
        if from == to {
            return;
        }
        self.state = to;
        self.rpdos.clear();
        self.enter_tpdos(now);
        self.enter_sync(now, from, to);
        if to == NmtState::Stopped {
            self.out.clear_frames();
        }
        self.out.emit(Event::NmtChanged { from, to });
    }

    /// Brings the communication objects, and the application's if it is in the scope, back to their
    /// power-on values and boots again.
    fn reset(&mut self, now: Micros, scope: ResetScope, od: &mut dyn ObjectDictionary) {
        self.enter(now, NmtState::Initialising);
        self.out.clear_frames();
        self.out.clear_next();
        self.node = self.lss.node;
        self.lss.crowded = false;
        self.startup = self.config.startup;
        self.emergencies.reset(&self.config, self.node);
        self.heartbeat = Heartbeat::new(&self.config);
        self.sync = Sync::new(&self.config);
        self.rpdos = Rpdos::new(&self.config, self.node);
        self.tpdos = Tpdos::new(&self.config, self.node);
        od.reset(scope);
        self.boot(now, od);
    }
}

/// RAM is counted on the targets where it is scarce.
#[cfg(target_pointer_width = "32")]
const _: () = assert!(size_of::<Device>() <= 3 * 1024);

#[cfg(test)]
mod tests;
