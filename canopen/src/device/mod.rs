//! The device: passes every frame to its service.
//!
//! A frame is routed once, by `Core::service`. `Core` holds the communication objects and the
//! independent services (one file each); the SDO server is beside it, because it needs all of them
//! at once. Each frame is processed completely before the next, so a setpoint and a SYNC keep their
//! order.
//!
//! The methods that reach the application's objects are generic for the caller's sake only: inside,
//! the application is a trait object, so that this code is compiled once, in this crate, with
//! this crate's optimisation; `inline(never)` keeps it from being copied into callers that are
//! built for speed.
//!
//! Cost: the service is found by comparing identifiers, SYNC first. `poll` returns at once
//! until the earliest of all timers is due: every timer that is set lowers `Outbox::next`, and only
//! a `poll` that has checked all of them raises it again. The deadline may therefore be early, but
//! never late.

mod bus_off;
pub mod eds;
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
    AbortCode, Application, Config, Counters, Event, Frame, Micros, NmtCommand, NmtState, NodeId,
    ResetScope,
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

pub use emergency::Errors;
pub use heartbeat::MAX_CONSUMERS;
pub use pdo::MAX_MAPPED;
pub use rpdo::MAX_RPDO;
pub use sdo::MAX_SDO;
pub use tpdo::MAX_TPDO;

const SDO_REQUEST: u16 = 0x600;
const HEARTBEAT: u16 = 0x700;

/// A CANopen device.
#[derive(Clone)]
pub struct Device {
    core: Core,
    sdo: sdo::Server,
}

/// All of the device but the SDO server.
#[derive(Clone)]
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
    pub fn on_frame<O: Application>(&mut self, now: Micros, frame: &Frame, app: &mut O) {
        self.handle(now, frame, app);
    }

    /// Does what is due: boot-up, heartbeats, timeouts, transmit PDOs by time.
    pub fn poll<O: Application>(&mut self, now: Micros, app: &mut O) {
        self.poll_all(now, app);
    }

    /// The next frame to send.
    #[inline]
    pub fn pop_frame(&mut self) -> Option<Frame> {
        let node = self.core.node;
        let queued = self.core.out.pop_frame();
        queued.or_else(|| self.sdo.pop_frame(node))
    }

    /// The next event.
    pub fn pop_event(&mut self) -> Option<Event> {
        self.core.out.pop_event()
    }

    /// Whether there is an event.
    #[must_use]
    #[inline]
    pub fn has_events(&self) -> bool {
        self.core.out.has_events()
    }

    /// Function codes of the frames it listens to, one bit for each (bit n: identifiers from 128 n
    /// on), for an acceptance filter. Whatever changes them changes them before the answer to it is
    /// sent.
    #[must_use]
    pub fn function_codes(&self) -> u16 {
        const FIXED: u16 = crate::function_code_bit(0)
            | crate::function_code_bit(SDO_REQUEST)
            | crate::function_code_bit(HEARTBEAT)
            | crate::function_code_bit(lss::REQUEST);
        let first = FIXED | crate::function_code_bit(self.core.sync.id());
        let listening = self.core.rpdos.listening();
        listening.fold(first, |codes, id| codes | crate::function_code_bit(id))
    }

    /// When [`poll`](Self::poll) has something to do, at the earliest; it may turn out to be
    /// nothing. `None` if only a frame can make it so.
    #[must_use]
    #[inline]
    pub fn next_deadline(&self) -> Option<Micros> {
        let booting = self.core.state == NmtState::Initialising && self.core.node.is_some();
        if booting {
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

    /// The period of its heartbeat in ms, object 0x1017; 0 for none.
    #[must_use]
    pub const fn heartbeat_ms(&self) -> u16 {
        self.core.heartbeat.period_ms
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

    /// The emergency service, to tell of the application's own errors.
    pub fn errors(&mut self, now: Micros) -> Errors<'_> {
        Errors::new(&mut self.core, now)
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
    /// Those of [`Application::read`].
    pub fn read<O: Application>(
        &self,
        index: u16,
        sub: u8,
        out: &mut [u8],
        app: &O,
    ) -> Result<usize, AbortCode> {
        self.core.read(index, sub, out, app)
    }

    /// Writes any object, as an SDO client would.
    ///
    /// # Errors
    /// Those of [`Application::write`].
    pub fn write<O: Application>(
        &mut self,
        now: Micros,
        index: u16,
        sub: u8,
        data: &[u8],
        app: &mut O,
    ) -> Result<(), AbortCode> {
        self.core.write(now, index, sub, data, app)
    }

    #[inline(never)]
    fn handle(&mut self, now: Micros, frame: &Frame, app: &mut dyn Application) {
        let core = &mut self.core;
        match core.service(frame) {
            Service::Sync => core.on_sync(now, frame, app),
            Service::Nmt => self.on_nmt(now, frame, app),
            Service::Sdo => self.sdo.on_request(now, frame, core, app),
            Service::Heartbeat(sender, state) => {
                app.on_heartbeat(now, sender, state);
                core.on_heartbeat(now, sender, state);
            }
            Service::Lss => core.on_lss(now, frame, app),
            Service::LssAnswer => core.on_lss_answer(),
            Service::Other => {
                app.on_frame(now, frame, core.state);
                core.on_rpdo(now, frame, app);
            }
        }
    }

    #[inline(never)]
    fn poll_all(&mut self, now: Micros, app: &mut dyn Application) {
        if self.core.state == NmtState::Initialising {
            self.core.boot(now, app);
        }
        if now < self.core.out.next() {
            return;
        }
        self.core.out.clear_next();
        self.core.poll_bus_off(now);
        self.core.poll_heartbeat(now);
        self.core.poll_sync(now, app);
        self.core.poll_rpdos(now);
        self.core.poll_tpdos(now, app);
        self.sdo.poll(now, &mut self.core, app);
        self.core.poll_overflow(now);
        self.core.poll_emergencies(now);
    }

    fn on_nmt(&mut self, now: Micros, frame: &Frame, app: &mut dyn Application) {
        let core = &mut self.core;
        let (Some((command, target)), Some(node)) = (nmt::parse(frame), core.node) else {
            return;
        };
        if core.state == NmtState::Initialising || !target.includes(node) {
            return;
        }
        core.out.emit(Event::NmtCommand(command));
        match command {
            NmtCommand::Start => core.enter(now, NmtState::Operational),
            NmtCommand::Stop => core.enter(now, NmtState::Stopped),
            NmtCommand::EnterPreOperational => core.enter(now, NmtState::PreOperational),
            NmtCommand::ResetNode => core.reset(now, ResetScope::Application, app),
            NmtCommand::ResetCommunication => core.reset(now, ResetScope::Communication, app),
        }
        match self.core.state {
            NmtState::Initialising | NmtState::Stopped => self.sdo.give_up(app),
            NmtState::PreOperational | NmtState::Operational => {}
        }
        if matches!(
            command,
            NmtCommand::ResetNode | NmtCommand::ResetCommunication
        ) {
            self.sdo.give_up(app);
        }
    }
}

/// What a frame is for. Each service knows for itself in which NMT states it works.
enum Service {
    Sync,
    Nmt,
    /// A request to this device.
    Sdo,
    /// Of this node, in this state.
    Heartbeat(NodeId, NmtState),
    /// A request of an LSS master.
    Lss,
    /// Another device answers one.
    LssAnswer,
    /// For the application, and for those receive PDOs that listen.
    Other,
}

impl Core {
    fn service(&self, frame: &Frame) -> Service {
        let id = frame.id();
        if id == self.sync.id() {
            return Service::Sync;
        }
        if self.node.is_some_and(|node| id == node.cob_id(SDO_REQUEST)) {
            return Service::Sdo;
        }
        match id {
            0 => Service::Nmt,
            lss::REQUEST => Service::Lss,
            lss::RESPONSE => Service::LssAnswer,
            _ => heartbeat::parse(frame).map_or(Service::Other, |(sender, state)| {
                Service::Heartbeat(sender, state)
            }),
        }
    }

    /// Goes on the bus: boot-up frame, then PRE-OPERATIONAL. Not without a node-ID.
    fn boot(&mut self, now: Micros, app: &mut dyn Application) {
        let Some(node) = self.node else {
            return;
        };
        self.load(now, app);
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
    fn reset(&mut self, now: Micros, scope: ResetScope, app: &mut dyn Application) {
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
        app.reset(scope);
        self.boot(now, app);
    }
}

/// RAM is counted on the targets where it is scarce.
#[cfg(target_pointer_width = "32")]
const _: () = assert!(size_of::<Device>() <= 3 * 1024);

#[cfg(test)]
mod tests;
