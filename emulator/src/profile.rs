//! Instructions and cycles per function, counted exactly.

use std::collections::{BTreeMap, VecDeque};

use crate::firmware::Firmware;

/// What one function used, without the functions it called.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// How often its first instruction was executed.
    pub calls: u64,
    /// Instructions executed.
    pub instructions: u64,
    /// Cycles, by the core's simple timing (no wait states).
    pub cycles: u64,
}

/// Counts per function, by the function's address.
#[derive(Debug, Clone, Default)]
pub struct Profile {
    functions: BTreeMap<u32, Usage>,
    exceptions: Usage,
    /// The function of the last instruction: first address and end.
    last: (u32, u32),
    recent: VecDeque<(u32, u32)>,
}

/// Changes from function to function that are remembered.
const RECENT: usize = 64;

impl Profile {
    pub(crate) fn count(
        &mut self,
        firmware: &Firmware,
        (pc, sp): (u32, u32),
        cycles: u64,
        exception_entry: bool,
    ) {
        if exception_entry {
            self.exceptions.calls += 1;
            self.exceptions.cycles += cycles;
            return;
        }
        if !(self.last.0..self.last.1).contains(&pc) {
            self.last = firmware
                .function_at(pc)
                .map_or((pc, pc), |f| (f.address, f.address + f.size));
            if self.recent.len() == RECENT {
                self.recent.pop_front();
            }
            self.recent.push_back((pc, sp));
        }
        let usage = self.functions.entry(self.last.0).or_default();
        usage.calls += u64::from(pc == self.last.0);
        usage.instructions += 1;
        usage.cycles += cycles;
    }

    /// Functions with what they used, the most instructions first.
    #[must_use]
    pub fn functions<'a>(&self, firmware: &'a Firmware) -> Vec<(&'a str, Usage)> {
        let mut all: Vec<_> = self
            .functions
            .iter()
            .map(|(address, usage)| {
                (
                    firmware
                        .function_at(*address)
                        .map_or("?", |f| f.name.as_str()),
                    *usage,
                )
            })
            .collect();
        all.sort_by_key(|(_, usage)| std::cmp::Reverse(usage.instructions));
        all
    }

    /// The last changes from one function to another: program counter and stack pointer on arrival, the latest
    /// last.
    pub fn recent(&self) -> impl Iterator<Item = (u32, u32)> {
        self.recent.iter().copied()
    }

    /// Use of the function at an address.
    #[must_use]
    pub fn at(&self, address: u32) -> Usage {
        self.functions
            .get(&(address & !1))
            .copied()
            .unwrap_or_default()
    }

    /// Entries into exceptions: how many, and the cycles of stacking.
    #[must_use]
    pub fn exceptions(&self) -> Usage {
        self.exceptions
    }

    /// Sum over all functions whose address is in a range.
    #[must_use]
    pub fn total(&self, addresses: std::ops::Range<u32>) -> Usage {
        self.functions
            .range(addresses)
            .fold(Usage::default(), |sum, (_, usage)| Usage {
                calls: sum.calls + usage.calls,
                instructions: sum.instructions + usage.instructions,
                cycles: sum.cycles + usage.cycles,
            })
    }
}
