//! The CAN controllers for their connectors, [`crate::can::port`].

use super::Board;
use crate::can::port::Which;
use crate::can::{Can, CanFrame};
use crate::soc::Soc;
use crate::trace::Change;

/// A controller, brought to the present.
fn present(soc: &mut Soc, which: Which) -> &mut Can {
    let can = match which {
        Which::First => &mut soc.can,
        Which::Second => &mut soc.can2,
    };
    can.sync(soc.now);
    can
}

impl Board {
    /// What a controller is like now. Interrupt lines and the next event are as they were: it is
    /// brought to the present by events, too, which come first.
    pub(crate) fn see_can<T>(&self, which: Which, f: impl FnOnce(&Can) -> T) -> T {
        self.shared.look(|soc| f(present(soc, which)))
    }

    pub(crate) fn with_can<T>(&self, which: Which, f: impl FnOnce(&mut Can, u64) -> T) -> T {
        self.shared.with(|soc| {
            let now = soc.now;
            let result = f(present(soc, which), now);
            soc.settle();
            result
        })
    }

    /// Records a frame on the bus in the trace.
    pub(crate) fn trace_arrival(&mut self, frame: &CanFrame) {
        let change = Change::Arrival(*frame);
        self.shared.look(|soc| {
            let now = soc.now;
            if let Some(trace) = &mut soc.trace {
                trace.changes.push((now, change));
            }
        });
    }

    pub(crate) fn can_bit_rate(&self, which: Which) -> Option<u32> {
        self.shared.look(|soc| soc.can_bit_rate(which))
    }

    pub(crate) fn can_receive(&self, which: Which, frame: &CanFrame, bits: u32) {
        self.shared.with(|soc| {
            soc.can_receive(which, frame, bits);
            soc.settle();
        });
    }
}
