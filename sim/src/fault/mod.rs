//! Timed faults: action, place, time and duration, as text and as a schedule.
//!
//! [`FaultSpec`] is one fault, read from `t=5:node=3:power-cycle` (see [`spec`]). A [`Schedule`]
//! holds the pending faults and advances a world's time in pieces that end where a fault begins or
//! ends, so that runs with the same faults are equal to the nanosecond. The world implements the
//! faults themselves (`World::set_power` and its neighbours).

mod action;
pub mod spec;

use std::collections::BTreeMap;

use canopen::Micros;

use crate::error::SimError;
use crate::world::World;

pub use action::Action;
pub use spec::{FaultSpec, SpecError};

/// A fault that could not take place yet is tried again after this time.
const AGAIN_NS: u64 = 10_000;

/// Faults still to come, in the order of their times; those of one time in the order they were
/// added.
#[derive(Debug, Default)]
pub struct Schedule {
    coming: BTreeMap<(u64, u64), Action>,
    added: u64,
}

impl Schedule {
    /// Adds a fault, and its end if it has one. Without a time of its own it begins now; one that
    /// lies in the past does, too.
    pub fn add(&mut self, fault: &FaultSpec, now_ns: u64) {
        let begin = fault.at_ns.unwrap_or(now_ns).max(now_ns);
        let end = fault
            .action
            .undone()
            .zip(fault.lasts_ns.or(fault.action.lasts_ns()));
        self.insert(begin, fault.action);
        if let Some((undone, lasts)) = end {
            self.insert(begin.saturating_add(lasts), undone);
        }
    }

    /// Advances time to `until_ns`, applies every fault that is due and calls `report` for it.
    ///
    /// # Errors
    /// When a robot or the plant stops.
    pub fn run_until(
        &mut self,
        world: &mut World,
        until_ns: u64,
        report: &mut dyn FnMut(u64, &Action),
    ) -> Result<(), SimError> {
        loop {
            self.apply_due(world, report);
            let next = self.coming.keys().next().map_or(until_ns, |(at, _)| *at);
            // The world counts in microseconds; a fault comes at the first that is not before its
            // time.
            let to = Micros(next.min(until_ns).div_ceil(1_000));
            world.run_until(to)?;
            if world.now_ns() >= until_ns {
                return Ok(());
            }
        }
    }

    fn insert(&mut self, at_ns: u64, action: Action) {
        self.coming.insert((at_ns, self.added), action);
        self.added += 1;
    }

    fn apply_due(&mut self, world: &mut World, report: &mut dyn FnMut(u64, &Action)) {
        while let Some(entry) = self.coming.first_entry()
            && entry.key().0 <= world.now_ns()
        {
            let action = entry.remove();
            if action.apply(world) {
                report(world.now_ns(), &action);
            } else {
                self.insert(world.now_ns() + AGAIN_NS, action);
            }
        }
    }
}
