//! Recovery of the CAN controller after bus-off.
//!
//! At bus-off all frames waiting to be sent are dropped, object 0x1029 determines the NMT state,
//! and after a pause the application is asked to restart the controller. The pause is 100 ms at
//! first and doubles each time up to 3.2 s, so that a broken node does not keep disturbing the
//! others; after ten seconds without bus-off it is 100 ms again. Back on the bus the device sends
//! an emergency message, 0x8140. Every bus-off is counted.

use super::Core;
use crate::time::Timer;
use crate::{Event, Micros};

const FIRST_PAUSE: Micros = Micros::from_millis(100);
const LONGEST_PAUSE: Micros = Micros::from_millis(3_200);
/// So long without bus-off, and the next pause is the first again.
const GOOD: Micros = Micros::from_millis(10_000);

#[derive(Clone)]
pub(super) struct BusOff {
    is_off: bool,
    pause: Micros,
    /// When the application is to be asked.
    timer: Timer,
    /// When the device came back last.
    recovered: Micros,
}

impl BusOff {
    pub const fn new() -> Self {
        Self {
            is_off: false,
            pause: FIRST_PAUSE,
            timer: Timer::OFF,
            recovered: Micros::ZERO,
        }
    }
}

impl Core {
    pub(super) fn on_bus_off(&mut self, now: Micros) {
        let bus = &mut self.bus_off;
        if bus.is_off {
            return;
        }
        bus.is_off = true;
        if now.since(bus.recovered) >= GOOD {
            bus.pause = FIRST_PAUSE;
        }
        bus.timer = Timer::at(now + bus.pause);
        self.out.wake(bus.timer);
        bus.pause = (bus.pause + bus.pause).min(LONGEST_PAUSE);
        self.out.count(|counters| &mut counters.bus_off);
        self.out.clear_frames();
        self.out.set_muted(true);
        self.out.emit(Event::BusOff);
        self.react_to_communication_error(now);
    }

    pub(super) fn poll_bus_off(&mut self, now: Micros) {
        let bus = &mut self.bus_off;
        if bus.timer.due(now) {
            bus.timer = Timer::OFF;
            self.out.emit(Event::RecoverBus);
        }
        self.out.wake(bus.timer);
    }

    pub(super) fn on_bus_recovered(&mut self, now: Micros) {
        let bus = &mut self.bus_off;
        if !bus.is_off {
            return;
        }
        (bus.is_off, bus.timer, bus.recovered) = (false, Timer::OFF, now);
        self.out.set_muted(false);
        self.out.emit(Event::BusRecovered);
        self.announce_recovery(now);
    }
}
