//! The last eight faults, saved over power losses: each with the number of the start, the time
//! since then, the supply voltage and the wheel rates.
//!
//! This module holds them. The platform saves them to flash and returns them at start-up, the
//! newest last. The program stops while flash is written, so this is done only at rest, when the
//! outputs have been off for [`REST_US`].
//!
//! Two times bound the wear. The first write is [`FIRST_US`] after start-up, so a robot that is
//! reset repeatedly sooner writes nothing. [`PAUSE_US`] lie between two rounds of writing, and a
//! round writes at most eight faults, because older ones are no longer among the last eight. A
//! fault that repeats while the robot stands, such as a refused start, is saved once. If the flash
//! fails, nothing more is written until the next start-up.

use control::time::Micros;
use protocol::StoredFault;
use protocol::address::history::DEPTH;

/// How long the outputs have been off when the robot is at rest, us.
const REST_US: u64 = 500_000;
/// Time from start-up to the first write, us.
const FIRST_US: u64 = 1_000_000;
/// Time between two turns of writing, us.
const PAUSE_US: u64 = 10_000_000;
/// A wheel that turns slower stands, rad/s.
const STANDS: f32 = 0.01;

/// What is to be put into flash next.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Memorable {
    /// That there was a start.
    Start,
    /// The key of the lock, in place of the last one.
    Key,
    /// A fault.
    Fault([u8; StoredFault::LENGTH]),
}

/// See the [module](self).
#[derive(Clone)]
pub(crate) struct FaultMemory {
    /// Newest first; only the first `known` count.
    faults: [[u8; StoredFault::LENGTH]; DEPTH as usize],
    known: u8,
    /// How many of the newest are not in flash yet.
    unstored: u8,
    /// Number of this start.
    pub start: u32,
    is_start_stored: bool,
    /// Since when the outputs have been off.
    off_since: Option<Micros>,
    /// Not before.
    earliest: Micros,
    has_failed: bool,
}

impl FaultMemory {
    pub const fn new() -> Self {
        Self {
            faults: [[0; StoredFault::LENGTH]; DEPTH as usize],
            known: 0,
            unstored: 0,
            start: 1,
            is_start_stored: false,
            off_since: None,
            earliest: Micros(FIRST_US),
            has_failed: false,
        }
    }

    /// Takes in what the platform has: starts before this one, and faults, the newest last.
    pub fn recall(&mut self, starts: u32, faults: impl Iterator<Item = [u8; StoredFault::LENGTH]>) {
        self.start = starts.saturating_add(1);
        for fault in faults {
            self.put(fault);
        }
    }

    fn put(&mut self, fault: [u8; StoredFault::LENGTH]) {
        self.faults.rotate_right(1);
        if let Some(first) = self.faults.first_mut() {
            *first = fault;
        }
        self.known = self.known.saturating_add(1).min(DEPTH);
    }

    /// Keeps a fault of this start.
    pub fn push(&mut self, code: u16, time_ms: u32, supply: Option<f32>, rates: [f32; 4]) {
        let fault = StoredFault {
            code,
            start: self.start,
            time_ms,
            supply,
            rates,
        };
        let stands = |fault: &StoredFault| fault.rates.iter().all(|rate| rate.abs() < STANDS);
        let newest = self.faults.first().filter(|_| self.known > 0);
        let newest = newest.map(StoredFault::decode);
        let is_repeated = newest.is_some_and(|newest| {
            (newest.code, newest.start) == (code, self.start) && stands(&newest) && stands(&fault)
        });
        if !is_repeated {
            self.put(fault.encode());
            self.unstored = self.unstored.saturating_add(1).min(DEPTH);
        }
    }

    /// Notes whether the outputs are off.
    pub fn record_off(&mut self, now: Micros, is_off: bool) {
        self.off_since = is_off.then(|| self.off_since.unwrap_or(now));
    }

    /// What is to be put into flash now.
    pub fn next(&self, now: Micros) -> Option<Memorable> {
        let is_at_rest = self
            .off_since
            .is_some_and(|since| now >= since + Micros(REST_US));
        if !is_at_rest || now < self.earliest || self.has_failed {
            None
        } else if !self.is_start_stored {
            Some(Memorable::Start)
        } else {
            let oldest = usize::from(self.unstored.checked_sub(1)?);
            self.faults.get(oldest).copied().map(Memorable::Fault)
        }
    }

    /// What was to be put into flash is there, or cannot be.
    pub fn stored(&mut self, now: Micros, is_stored: bool) {
        self.has_failed |= !is_stored;
        if !self.is_start_stored {
            self.is_start_stored = true;
        } else {
            self.unstored = self.unstored.saturating_sub(1);
        }
        if self.unstored == 0 {
            self.earliest = now + Micros(PAUSE_US);
        }
    }

    /// Whether this start's number is in flash, so that no later start has it.
    pub const fn has_stored_start(&self) -> bool {
        self.is_start_stored && !self.has_failed
    }

    /// How many faults are not in flash yet.
    pub const fn unstored(&self) -> u8 {
        self.unstored
    }

    /// All of them, the newest first.
    pub fn bytes(&self) -> &[u8] {
        let known = usize::from(self.known);
        self.faults.get(..known).unwrap_or(&[]).as_flattened()
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    const MOVING: [f32; 4] = [1.0; 4];

    fn codes(memory: &FaultMemory) -> Vec<u16> {
        let faults = memory.bytes().as_chunks().0.iter();
        faults
            .map(|fault| StoredFault::decode(fault).code)
            .collect()
    }

    /// Stores what is due, and how many that were.
    fn store(memory: &mut FaultMemory, now: Micros) -> usize {
        let mut stored = 0;
        while memory.next(now).is_some() {
            memory.stored(now, true);
            stored += 1;
        }
        stored
    }

    #[test]
    fn nothing_is_stored_while_outputs_are_on_or_just_off_or_at_start_up() {
        let mut memory = FaultMemory::new();
        memory.push(7, 0, None, MOVING);
        memory.record_off(Micros(0), true);
        assert_eq!(memory.next(Micros(FIRST_US - 1)), None);
        assert_eq!(memory.next(Micros(FIRST_US)), Some(Memorable::Start));
        memory.record_off(Micros(FIRST_US), false);
        assert_eq!(memory.next(Micros(2 * FIRST_US)), None);
        let off = Micros(3 * FIRST_US);
        memory.record_off(off, true);
        memory.record_off(off + Micros(1), true);
        assert_eq!(memory.next(off + Micros(REST_US - 1)), None);
        assert_eq!(store(&mut memory, off + Micros(REST_US)), 2);
    }

    /// A fault every millisecond for an hour, each different from the one before: 8 are written
    /// every 10 s.
    #[test]
    fn a_storm_of_faults_writes_eight_every_ten_seconds() {
        let mut memory = FaultMemory::new();
        let mut written = 0;
        for ms in 0..3_600_000_u32 {
            let now = Micros(u64::from(ms) * 1_000);
            memory.record_off(now, true);
            memory.push((ms & 1) as u16, ms, None, MOVING);
            written += store(&mut memory, now);
        }
        assert_eq!(written, 1 + 360 * usize::from(DEPTH));
    }

    #[test]
    fn the_last_eight_are_stored_in_the_order_they_came() {
        let mut memory = FaultMemory::new();
        let before = (1..=3).map(|code| StoredFault {
            code,
            start: 4,
            time_ms: 0,
            supply: None,
            rates: MOVING,
        });
        memory.recall(4, before.map(|fault| fault.encode()));
        assert_eq!((memory.start, codes(&memory)), (5, Vec::from([3, 2, 1])));
        for code in 10..16 {
            memory.push(code, 0, Some(24.0), MOVING);
        }
        assert_eq!(codes(&memory), [15, 14, 13, 12, 11, 10, 3, 2]);
        memory.record_off(Micros(0), true);
        let now = Micros(FIRST_US);
        let mut order = Vec::new();
        while let Some(next) = memory.next(now) {
            if let Memorable::Fault(fault) = next {
                let fault = StoredFault::decode(&fault);
                assert_eq!((fault.start, fault.supply), (5, Some(24.0)));
                order.push(fault.code);
            }
            memory.stored(now, true);
        }
        assert_eq!(order, [10, 11, 12, 13, 14, 15]);
    }

    #[test]
    fn a_fault_that_comes_again_at_rest_is_kept_once() {
        let mut memory = FaultMemory::new();
        memory.push(7, 1, None, MOVING);
        memory.push(7, 2, None, MOVING);
        memory.push(8, 3, None, [0.0; 4]);
        memory.push(8, 4, None, [0.0; 4]);
        assert_eq!(codes(&memory), [8, 7, 7]);
    }

    #[test]
    fn flash_that_fails_is_left_alone() {
        let mut memory = FaultMemory::new();
        memory.record_off(Micros(0), true);
        memory.push(7, 1, None, MOVING);
        let now = Micros(FIRST_US);
        assert_eq!(memory.next(now), Some(Memorable::Start));
        memory.stored(now, false);
        assert_eq!(memory.next(now + Micros(100 * PAUSE_US)), None);
        assert_eq!(codes(&memory), [7]);
    }
}
