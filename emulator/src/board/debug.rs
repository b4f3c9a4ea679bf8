//! The debugger's access to a board: breakpoints, single steps, registers and memory.
//!
//! On a board that the debugger has stopped only the core is halted: while the world's time
//! advances, timers, CAN controller and watchdog keep running, as on the chip with DBGMCU at its
//! reset value. To freeze them too, stop the world.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::Ordering::Relaxed;

use crate::ram::Ram;
use rsemu::cpu::arm::v7m::Regs;

use super::Board;
use crate::memory_map::{FLASH_BASE, RAM_BASE};

/// The debugger's side of a board.
#[derive(Debug, Clone, Default)]
pub(super) struct Debugger {
    breakpoints: BTreeSet<u32>,
    pub(super) stopped: bool,
    /// Stop again after one instruction.
    single: bool,
    /// The core resumes here: the first instruction does not trigger a breakpoint.
    leaving: Option<u32>,
    /// Ranges of RAM, each with what it last held.
    watched: BTreeMap<(u32, usize), Vec<u8>>,
    /// What stopped the core was a change of this address.
    changed: Option<u32>,
}

impl Debugger {
    /// Whether every instruction has to be examined.
    pub(super) fn is_watching(&self) -> bool {
        self.single || !self.breakpoints.is_empty() || !self.watched.is_empty()
    }

    /// Looks at the instruction that comes next; whether the core stops before it.
    pub(super) fn stops_before(&mut self, pc: u32) -> bool {
        let leaving = self.leaving.take() == Some(pc);
        self.stopped = !leaving && self.breakpoints.contains(&pc);
        self.stopped
    }

    /// An instruction, or the entry into a handler, is done.
    pub(super) fn done(&mut self, ram: &Ram) -> bool {
        self.stopped |= std::mem::take(&mut self.single);
        for ((address, _), last) in &mut self.watched {
            let mut now = vec![0; last.len()];
            if ram.read_at(u64::from(address - RAM_BASE), &mut now).is_ok() && now != *last {
                *last = now;
                self.changed = Some(*address);
                self.stopped = true;
            }
        }
        self.stopped
    }
}

/// The core's registers as a debugger sees them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoreRegisters {
    /// r0 to r12, the stack pointer in use, the link register, the program counter.
    pub r: [u32; 16],
    /// Flags, IT state and the number of the active exception.
    pub xpsr: u32,
}

impl Board {
    /// Stops the core before it executes the instruction at an address. Runs are several times
    /// slower while there is a breakpoint.
    pub fn add_breakpoint(&mut self, address: u32) {
        self.debugger.breakpoints.insert(address & !1);
    }

    /// Whether there was one.
    pub fn remove_breakpoint(&mut self, address: u32) -> bool {
        self.debugger.breakpoints.remove(&(address & !1))
    }

    /// Stops the core after an instruction that changes any of these bytes of RAM; `None` where
    /// there is no RAM.
    pub fn add_watchpoint(&mut self, address: u32, length: usize) -> Option<()> {
        let mut now = vec![0; length];
        let at = u64::from(address.checked_sub(RAM_BASE)?);
        self.ram.read_at(at, &mut now).ok()?;
        self.debugger.watched.insert((address, length), now);
        Some(())
    }

    /// Whether there was one.
    pub fn remove_watchpoint(&mut self, address: u32, length: usize) -> bool {
        self.debugger.watched.remove(&(address, length)).is_some()
    }

    /// The watched address whose change stopped the core, if that did; asked for once.
    pub fn take_watched_change(&mut self) -> Option<u32> {
        self.debugger.changed.take()
    }

    /// Stops the core where it is. One that has not begun yet first fetches its stack pointer and
    /// its first address.
    pub fn debug_stop(&mut self) {
        if self.cpu.reset_pending() {
            self.now += self.cpu.step();
            self.shared.now.store(self.now, Relaxed);
        }
        self.debugger.stopped = true;
    }

    /// Resumes a stopped core, for one instruction or until it is stopped again. A core that sleeps
    /// first wakes.
    pub fn debug_resume(&mut self, single: bool) {
        self.debugger.stopped = false;
        self.debugger.single = single;
        self.debugger.changed = None;
        self.debugger.leaving = Some(self.cpu.pc());
    }

    /// Writes RAM, as a program that has gone astray may; `None` where there is none.
    pub fn write_ram(&mut self, address: u32, bytes: &[u8]) -> Option<()> {
        let at = u64::from(address.checked_sub(RAM_BASE)?);
        self.ram.write_at(at, bytes).ok()
    }

    /// Reads a peripheral's register, as a debugger would.
    #[must_use]
    pub fn read_register(&self, address: u32) -> u32 {
        self.shared.with(|soc| soc.read(address, 4))
    }

    /// Writes a word to a peripheral's register, as a program that has gone astray may.
    pub fn write_register(&mut self, address: u32, value: u32) {
        self.shared.with(|soc| soc.write(address, 4, value));
    }

    /// Unplugs the debug probe: the log is no longer read, and its channel stays in the mode in
    /// which probe-rs puts it, block if full. `None` when the image has no log.
    pub fn unplug_debugger(&mut self) -> Option<()> {
        self.drain_log();
        self.log.unplug()
    }

    /// Whether the debugger has stopped the core.
    #[must_use]
    pub fn is_debug_stopped(&self) -> bool {
        self.debugger.stopped
    }

    /// The core's registers.
    #[must_use]
    pub fn registers(&self) -> CoreRegisters {
        let regs = self.cpu.regs();
        CoreRegisters {
            r: regs.r,
            xpsr: regs.xpsr,
        }
    }

    /// Sets the core's registers. The stack pointer set is the one in use.
    pub fn set_registers(&mut self, registers: &CoreRegisters) {
        let before = self.cpu.regs();
        let sp = registers.r[13] & !3;
        let mut regs = Regs {
            r: registers.r,
            xpsr: registers.xpsr,
            ..before
        };
        regs.r[13] = sp;
        regs.r[15] &= !1;
        if before.control & 2 != 0 && !before.in_handler() {
            regs.psp = sp;
        } else {
            regs.msp = sp;
        }
        self.cpu.set_regs(regs);
    }

    /// Reads a byte of RAM or flash, or of a peripheral's register. Reading a register has the
    /// effects that it has for the program; `None` where nothing is, or nothing is modelled.
    #[must_use]
    pub fn debug_read(&self, address: u32) -> Option<u8> {
        let mut byte = [0];
        match address {
            FLASH_BASE..0x4000_0000 => self.read_memory(address, &mut byte),
            0..FLASH_BASE => None,
            _ => self.shared.look(|soc| {
                let before = soc.stop.take();
                byte[0] = soc.read(address, 1) as u8;
                let failed = soc.stop.is_some();
                soc.stop = before;
                (!failed).then_some(())
            }),
        }?;
        Some(byte[0])
    }

    /// Writes to RAM. Flash and registers are refused: a debugger that programs the chip writes
    /// another image.
    pub fn debug_write(&mut self, address: u32, bytes: &[u8]) -> Option<()> {
        let at = address.checked_sub(RAM_BASE)?;
        self.ram.write_at(u64::from(at), bytes).ok()
    }
}
