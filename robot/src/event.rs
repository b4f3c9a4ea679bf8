//! The events that a robot's bus side reports to its owner.

use canopen::NmtState;
use control::time::Micros;
use protocol::Fault;

use crate::state::State;

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
