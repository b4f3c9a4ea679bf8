//! Instructions and cycles per function, per exception handler and per call, counted exactly.
//!
//! A function's [`Usage`] excludes the functions it called. A [`Call`] of a watched function
//! includes them, but excludes the handlers that interrupted it.

use std::collections::{BTreeMap, HashMap, VecDeque};

use crate::firmware::Firmware;

/// The cost of one function, without the functions it called.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// How often its first instruction was executed.
    pub calls: u64,
    /// Instructions executed.
    pub instructions: u64,
    /// Cycles, those included that it waited for the flash.
    pub cycles: u64,
    /// Cycles that it waited for the flash.
    pub waited: u64,
}

/// One call of a watched function, from its first instruction to the return to its caller.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Call {
    /// Core cycle since power-on at which it began.
    pub began: u64,
    /// Instructions, those of the functions it called included, those of interrupting handlers not.
    pub instructions: u64,
    /// Cycles of the same.
    pub cycles: u64,
}

/// A call that has not returned yet.
#[derive(Debug, Clone, Copy)]
struct Open {
    function: u32,
    call: Call,
    /// Where it will return to, and with which stack pointer.
    back: (u32, u32),
    exception: u16,
}

/// Where the core is before an instruction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct At {
    pub pc: u32,
    pub sp: u32,
    pub lr: u32,
    /// Number of the exception it handles; 0 in thread mode.
    pub exception: u16,
    /// Core cycles since power-on.
    pub cycle: u64,
}

/// The cost of one instruction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cost {
    pub cycles: u64,
    /// Of these, waiting for the flash.
    pub waited: u64,
}

impl Usage {
    fn add(&mut self, cost: Cost) {
        self.instructions += 1;
        self.cycles += cost.cycles;
        self.waited += cost.waited;
    }
}

impl std::ops::AddAssign for Usage {
    fn add_assign(&mut self, other: Self) {
        self.calls += other.calls;
        self.instructions += other.instructions;
        self.cycles += other.cycles;
        self.waited += other.waited;
    }
}

/// Counts per function, by the function's address.
#[derive(Debug, Clone, Default)]
pub struct Profile {
    functions: BTreeMap<u32, Usage>,
    /// By the address of the instruction.
    instructions: HashMap<u32, Usage>,
    exceptions: Usage,
    handlers: BTreeMap<u16, Usage>,
    watched: BTreeMap<u32, Vec<Call>>,
    open: Vec<Open>,
    /// Lowest stack pointer seen, by exception number.
    lowest: BTreeMap<u16, u32>,
    /// The function of the last instruction: first address and end.
    last: (u32, u32),
    recent: VecDeque<(u32, u32)>,
}

/// Changes from function to function that are remembered.
const RECENT: usize = 64;

impl Profile {
    pub(crate) fn count(&mut self, firmware: &Firmware, at: At, cost: Cost, exception_entry: bool) {
        let At { pc, sp, .. } = at;
        let cycles = cost.cycles;
        let lowest = self.lowest.entry(at.exception).or_insert(u32::MAX);
        *lowest = sp.min(*lowest);
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
        usage.add(cost);
        self.instructions.entry(pc).or_default().add(cost);
        self.handlers.entry(at.exception).or_default().add(cost);
        if !self.watched.is_empty() {
            self.count_calls(at, cycles);
        }
    }

    fn count_calls(&mut self, at: At, cycles: u64) {
        while let Some(open) = self.open.last()
            && open.exception == at.exception
            && open.back == (at.pc, at.sp)
        {
            let calls = self.watched.entry(open.function).or_default();
            calls.push(open.call);
            self.open.pop();
        }
        if self.watched.contains_key(&at.pc) {
            self.open.push(Open {
                function: at.pc,
                call: Call {
                    began: at.cycle,
                    ..Call::default()
                },
                back: (at.lr & !1, at.sp),
                exception: at.exception,
            });
        }
        for open in &mut self.open {
            if open.exception == at.exception {
                open.call.instructions += 1;
                open.call.cycles += cycles;
            }
        }
    }

    /// Watches the calls of the function at an address from now on. For functions that do not call
    /// themselves.
    pub fn watch(&mut self, address: u32) {
        self.watched.entry(address & !1).or_default();
    }

    /// Calls of a watched function that have returned, in the order of their returns.
    #[must_use]
    pub fn calls(&self, address: u32) -> &[Call] {
        self.watched.get(&(address & !1)).map_or(&[], Vec::as_slice)
    }

    /// What each exception handler used, by exception number; thread mode is 0.
    #[must_use]
    pub fn handlers(&self) -> &BTreeMap<u16, Usage> {
        &self.handlers
    }

    /// The lowest stack pointer seen in each exception handler, by exception number; thread mode is
    /// 0.
    #[must_use]
    pub fn lowest_stack(&self) -> &BTreeMap<u16, u32> {
        &self.lowest
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

    /// Functions of the source with what they used, the most cycles first: those that the compiler
    /// has inlined count, too. First what a function used itself, then with the functions that are
    /// inlined into it.
    #[must_use]
    pub fn inlined(&self, firmware: &Firmware) -> Vec<(String, Usage, Usage)> {
        let mut all: HashMap<String, (Usage, Usage)> = HashMap::new();
        let (addresses, usages): (Vec<u32>, Vec<Usage>) = self.instructions.iter().unzip();
        for (mut names, usage) in firmware.names(&addresses).into_iter().zip(usages) {
            if let Some(innermost) = names.first() {
                all.entry(innermost.clone()).or_default().0 += usage;
            }
            // One that is inlined into itself counts once.
            names.sort_unstable();
            names.dedup();
            for name in names {
                all.entry(name).or_default().1 += usage;
            }
        }
        let mut all: Vec<_> = all
            .into_iter()
            .map(|(name, (own, whole))| (name, own, whole))
            .collect();
        all.sort_by(|a, b| (b.2.cycles, &a.0).cmp(&(a.2.cycles, &b.0)));
        all
    }

    /// The last changes from one function to another: program counter and stack pointer on arrival,
    /// the latest last.
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
        let mut sum = Usage::default();
        for (_, usage) in self.functions.range(addresses) {
            sum += *usage;
        }
        sum
    }
}
