//! A stub in place of the device, to measure the size of the device (`cargo xtask size --canopen`).
//!
//! It does the minimum that keeps the application unchanged: frames lead to the same calls of the
//! object dictionary, so that the compiler cannot remove these methods and their size is not
//! attributed to the device. It is not a CANopen device and must not be used on a bus.

use crate::{
    AbortCode, Application, Config, Counters, ErrorClass, Event, Frame, Micros, NmtState, NodeId,
    PdoDirection, ResetScope, StoreScope,
};

/// As the device has it.
pub const MAX_RPDO: usize = 4;
/// As the device has it.
pub const MAX_TPDO: usize = 8;
/// As the device has it.
pub const MAX_MAPPED: usize = 8;
/// As the device has it.
pub const MAX_CONSUMERS: usize = 17;
/// As the device has it.
pub const MAX_SDO: usize = 511;

/// Stands where the device would be.
pub struct Device {
    config: Config,
    state: NmtState,
    event: Option<Event>,
    frame: Option<Frame>,
}

impl Device {
    /// As the device has it.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self {
            config,
            state: NmtState::PreOperational,
            event: None,
            frame: None,
        }
    }

    /// The state last entered.
    #[must_use]
    pub const fn state(&self) -> NmtState {
        self.state
    }

    /// As configured.
    #[must_use]
    pub const fn node(&self) -> Option<NodeId> {
        self.config.node
    }

    /// As configured.
    #[must_use]
    pub const fn heartbeat_ms(&self) -> u16 {
        self.config.heartbeat_ms
    }

    /// All of them.
    #[must_use]
    pub const fn function_codes(&self) -> u16 {
        u16::MAX
    }

    /// Passes each kind of frame to the method it is for.
    pub fn on_frame<O: Application>(&mut self, at: Micros, frame: &Frame, app: &mut O) {
        self.take(at, frame, app);
    }

    fn take(&mut self, at: Micros, frame: &Frame, app: &mut dyn Application) {
        let [a, b, c, d, e, f, g, h] = *frame.padded();
        let mut out = [a, b, c, d, e, f, g, h];
        let index = u16::from_le_bytes([b, c]);
        match (frame.id(), a) {
            (0, _) => {
                let Some((command, _)) = crate::nmt::parse(frame) else {
                    return;
                };
                let from = core::mem::replace(&mut self.state, NmtState::Operational);
                app.reset(ResetScope::Application);
                self.event = Some(match b {
                    0 => Event::NmtCommand(command),
                    _ => Event::NmtChanged {
                        from,
                        to: self.state,
                    },
                });
                return;
            }
            (0x80, 0) => {
                self.event = Some(Event::SyncGap {
                    expected: 1,
                    received: a,
                });
            }
            (0x80, _) => {
                let sync = crate::ReceivedSync {
                    counter: Some(a),
                    at,
                    applied: crate::RpdoSet::default(),
                };
                app.on_sync(sync, &mut Errors(self));
                self.transmit(app);
            }
            (0x181, _) => {
                if app.on_rpdo(1, &out) {
                    app.rpdo(1, &out);
                }
            }
            (0x701, state) => {
                let state = NmtState::from_code(state).unwrap_or_default();
                app.on_heartbeat(at, NodeId::MIN, state);
            }
            (0x180..0x300, _) => app.on_frame(at, frame, self.state),
            (_, 0) => {
                let _ = app.mappable(index, d, PdoDirection::Receive);
            }
            (_, 1) => {
                let _ = app.write(index, d, &[e, f, g, h], self.state);
            }
            (_, 2) => {
                if let Some(storage) = app.storage() {
                    let _ = storage.save(StoreScope::All, &[e]);
                    let _ = storage.restore(StoreScope::Application);
                    let _ = storage.save_node(NodeId::new(e));
                    let _ = storage.load(&mut out);
                }
            }
            (_, 3) => self.event = Some(Event::RecoverBus),
            _ => {
                let _ = app.read(index, d, &mut out);
            }
        }
        self.frame = Frame::new(0x580, &out);
    }

    /// Asks for a transmit PDO.
    pub fn poll<O: Application>(&mut self, _: Micros, app: &mut O) {
        self.transmit(app);
    }

    fn transmit(&mut self, app: &mut dyn Application) {
        let mut data = [0; 8];
        if app.tpdo(1, &mut data).is_some() {
            self.frame = Frame::new(0x180, &data);
        }
    }

    /// The last frame made.
    pub fn pop_frame(&mut self) -> Option<Frame> {
        self.frame.take()
    }

    /// The last event.
    pub fn pop_event(&mut self) -> Option<Event> {
        self.event.take()
    }

    /// Whether there is an event.
    #[must_use]
    pub const fn has_events(&self) -> bool {
        self.event.is_some()
    }

    /// Nothing is ever due.
    #[must_use]
    pub const fn next_deadline(&self) -> Option<Micros> {
        None
    }

    /// The application's objects only.
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
        app.read(index, sub, out)
    }

    /// Counts nothing.
    #[must_use]
    pub fn counters(&self) -> Counters {
        Counters::default()
    }

    /// Reports nothing.
    pub fn finish_store(&mut self, result: Result<(), AbortCode>) {
        let code = result.err().map_or(0, AbortCode::code);
        self.frame = Frame::new(0x580, &code.to_le_bytes());
    }

    /// Reports nothing.
    pub fn errors(&mut self, _: Micros) -> Errors<'_> {
        Errors(self)
    }

    /// Reports nothing.
    pub fn on_bus_off(&mut self, _: Micros) {
        self.event = None;
    }

    /// Reports nothing.
    pub fn on_bus_recovered(&mut self, _: Micros) {
        self.frame = None;
    }
}

/// In place of the emergency service.
pub struct Errors<'a>(&'a mut Device);

impl Errors<'_> {
    /// Reports nothing.
    pub fn raise(&mut self, code: u16, class: ErrorClass, info: [u8; 5]) {
        let [a, b] = code.to_le_bytes();
        let [c, d, e, f, _] = info;
        self.0.frame = Frame::new(0x80, &[a, b, class as u8, c, d, e, f]);
    }

    /// Reports nothing.
    pub fn clear(&mut self, code: u16, detail: u8) {
        self.raise(code, ErrorClass::Generic, [detail; 5]);
    }
}
