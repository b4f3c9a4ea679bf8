//! *Judge*: detects faults. The first fault is kept until the bus side's next start.

use protocol::{Fault, Reaction};

use super::motion::Motion;
use super::{OVERDUE_US, Supervision, Tick, span};
use crate::interface::{Command, Inputs, Mode};
use crate::quantity::Rate;
use crate::time::Micros;
use crate::wheel_drive::WheelDrive;

/// Longest time between two signs of life of the bus side, us. Well below the shortest time of a
/// watchdog that the bus side fails to feed (34 ms on the reference board): the ramp must have
/// begun by then.
const BUS_SILENT_US: u32 = 25_000;

/// A robot whose wheels turn faster is not started, rad/s: well above the rate that a step of a
/// coarse encoder causes, and slow enough that the loops bring it to rest without full voltage.
pub(super) const TURNING_RATE: Rate = Rate::new(0.2);

impl Supervision {
    /// A new start clears latched faults; a cause that is still present is latched again in the
    /// same tick.
    #[cold]
    pub(super) fn acknowledge(&mut self, start: u16, motion: Option<&mut Motion>) {
        self.report.start = start;
        self.report.fault = None;
        self.supply.acknowledge();
        self.slip_fault.reset();
        for wheel in motion.into_iter().flat_map(|motion| &mut motion.wheels) {
            wheel.watch.reset();
            wheel.silence.reset();
        }
    }

    /// Looks for faults while the robot drives. The first is kept; only one that cuts replaces one
    /// that ramps, because a robot with a shorted bridge or a reversed encoder cannot ramp down.
    // Always: both ways to tick contain it, and an image has only one of them.
    #[inline(always)]
    pub(super) fn judge(&mut self, motion: &Motion, command: &Command, tick: &Tick) {
        let latched = self.report.fault;
        let wheel = motion.wheel_fault();
        let cut = self
            .report
            .obstacle
            .or_else(|| wheel.filter(|fault| fault.reaction() == Reaction::Cut))
            .or_else(|| self.supply.too_high(&motion.configuration.supply, tick.now));
        self.report.fault = match latched.map(reaction) {
            Some(Reaction::Cut) => latched,
            Some(Reaction::Ramp) => cut.or(latched),
            None => cut
                .or_else(|| {
                    let asked = self.report.protective_stop && motion.configuration.protective_stop;
                    asked.then_some(Fault::ProtectiveStop)
                })
                .or(wheel)
                .or_else(|| late(tick.elapsed_us, tick.now, command.alive))
                .or_else(|| self.lasting_fault(motion, command, tick.now)),
        };
    }

    /// Causes that have to last before they are a fault.
    #[inline]
    fn lasting_fault(&mut self, motion: &Motion, command: &Command, now: Micros) -> Option<Fault> {
        let low = self.supply.too_low(&motion.configuration.supply, now);
        if low.is_some() {
            return low;
        }
        let bound = motion.configuration.thresholds.slip_fault;
        // Wheels that turn one by one are not rolling on a floor.
        let rolls = command.mode != Mode::Identify;
        let slips = rolls && bound > Rate::ZERO && self.report.slip_residual.abs() > bound;
        if !slips {
            self.slip_fault.reset();
            return None;
        }
        let lasting_us = motion.configuration.times.consequence_us();
        let lasts = self.slip_fault.update(slips, now, lasting_us);
        lasts.then_some(Fault::SlipExcess)
    }
}

impl Motion {
    /// Confirmed faults of the wheels; one that cuts comes first.
    #[inline]
    fn wheel_fault(&self) -> Option<Fault> {
        let [a, b, c, d] = &self.wheels;
        let faults = [a, b, c, d].map(|wheel| wheel.watch.fault());
        if faults.iter().all(Option::is_none) {
            return None;
        }
        first_that_cuts(faults)
    }
}

/// The first fault that cuts; without one, the first.
#[cold]
#[inline(never)]
fn first_that_cuts(faults: [Option<Fault>; 4]) -> Option<Fault> {
    let mut first = None;
    for fault in faults.into_iter().flatten() {
        if fault.reaction() == Reaction::Cut {
            return Some(fault);
        }
        first.get_or_insert(fault);
    }
    first
}

/// The reaction to a fault. In most ticks there is none.
#[cold]
#[inline(never)]
pub(super) fn reaction(fault: Fault) -> Reaction {
    fault.reaction()
}

/// A fault that is present now, in any mode.
pub(super) fn live_fault<D: WheelDrive>(inputs: &Inputs) -> Option<Fault> {
    if inputs.emergency_stop {
        Some(Fault::EmergencyStop)
    } else if D::MAY_RAMP {
        inputs
            .drive_fault
            .filter(|fault| fault.reaction() == Reaction::Cut)
    } else {
        inputs.drive_fault
    }
}

/// Whether any wheel turns too fast for a start.
pub(super) fn turns(rates: &[Rate; 4]) -> bool {
    rates.iter().any(|rate| rate.abs() > TURNING_RATE)
}

fn late(elapsed: u32, now: Micros, alive: Micros) -> Option<Fault> {
    if elapsed > OVERDUE_US {
        Some(Fault::ControlLate)
    } else if span(alive, now) > BUS_SILENT_US {
        Some(Fault::BusStarved)
    } else {
        None
    }
}
