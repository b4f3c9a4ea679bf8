//! A fast path for the core: plain instructions, decoded once into micro-operations and executed
//! here.
//!
//! The reference core ([`rsemu`]) implements the whole ARMv7E-M processor and takes some 80 ns for
//! an instruction. Nearly all instructions are plain: arithmetic, branches, loads, stores, floating
//! point. The fast path executes those on a copy of the registers, in *sessions*. A session begins
//! when no interrupt can be taken. It ends before any instruction that is not plain, without having
//! changed anything for it: sleep, special registers, an access that would fault, one to the core's
//! own peripherals other than the interrupt controller, ICSR and the cycle counter, the return from
//! a handler where anything but the main stack's frame is to be looked at. The reference core then
//! executes that one step, and it enters the handlers.
//!
//! Interrupts can only come from a peripheral or from a write to the interrupt controller.
//! Peripherals change only at the limit that the caller gives or by an access of the session, which
//! ends when an access has changed an interrupt line or the controller; the next session begins
//! unless an interrupt can be taken. Cycles are counted as the reference core counts them: the two
//! give the same results to the cycle, which tests compare instruction by instruction and run by
//! run.

mod code;
mod dsp;
mod exception;
mod execute;
mod float;
mod micro;
mod run;
#[cfg(test)]
mod tests;
mod transfer;
mod translate;

use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use rsemu::core::space::RamStore;
use rsemu::core::value::{Endian, Width};
use rsemu::cpu::arm::v7m::fp::Fpu;
use rsemu::cpu::arm::v7m::isa::Insn;
use rsemu::cpu::arm::v7m::sys::{DWT_CYCCNT, Exception, Sys};
use rsemu::cpu::arm::v7m::{ArmV7m, Regs, xpsr};

use self::micro::REGISTERS;
use crate::address_space::Shared;
use crate::chip::LARGEST_FLASH;
use crate::defect::Defects;
use crate::family::Family;
use crate::fetch::Fetch;
use crate::memory_map::{FLASH_BASE, RAM_BASE};
use crate::ram::Ram;
pub(crate) use code::Programmed;
use code::{Code, Entry};

/// Not for the fast path; nothing has been changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Leave;

type Done = Result<(), Leave>;

/// Why a session ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// An interrupt may have to be taken; otherwise the next session continues.
    Interrupts,
    /// The limit, an event for the board, or an instruction for the reference core.
    ToOthers,
}

/// What a session can reach.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Memory<'a> {
    pub(crate) cpu: &'a ArmV7m,
    pub(crate) ram: &'a Ram,
    pub(crate) flash: &'a RamStore,
    pub(crate) shared: &'a Shared,
}

/// FPCCR.LSPACT: the interrupted code's floating-point registers still have to be stacked.
const LSPACT: u32 = 1;
/// CONTROL.FPCA: the floating-point unit is in use, and CONTROL.nPRIV.
const FPCA: u32 = 1 << 2;
const NPRIV: u32 = 1;
/// CCR: traps on unaligned accesses and on division by zero.
const UNALIGN_TRP: u32 = 1 << 3;
const DIV_0_TRP: u32 = 1 << 4;
/// The registers of the interrupt controller (ARMv7-M ARM, table B3-8), and the one of them that
/// lies elsewhere: writing makes an interrupt pending.
const NVIC: RangeInclusive<u32> = 0xE000_E100..=0xE000_E4EF;
const STIR: u32 = 0xE000_EF00;
/// Which exceptions wait, and which one is active.
pub(crate) const ICSR: u32 = 0xE000_ED04;
/// Cycles of a division or a square root in floating point (Cortex-M4 TRM, table 7-1).
const DIVISION: u64 = 14;

/// The fast path of one board.
#[derive(Debug, Clone)]
pub(crate) struct Fast {
    code: Code,
    core: Core,
}

/// The registers of a session.
#[derive(Debug, Clone)]
struct Core {
    /// What the reference core had when the session began.
    given: Regs,
    /// R0 to R15 and, for micro-operations, one that is zero, one that nothing reads and flag Z.
    r: [u32; REGISTERS],
    /// xPSR without ITSTATE and without the flags N, Z, C and V, which are: bit 31, whether it is
    /// zero, whether it is set, bit 31. An instruction therefore stores its result for both N and Z
    /// and computes neither.
    psr: u32,
    n: u32,
    c: bool,
    v: u32,
    it: u8,
    primask: bool,
    fetch: Fetch,
    fpu: Fpu,
    fp_usable: bool,
    /// Whether `fpu` is what the reference core has, but for what has been done in this session;
    /// and what it has.
    fp_loaded: bool,
    fp_given: Fpu,
    /// Cycles of a division or a square root beyond the first.
    division: u64,
    exclusive: Option<u32>,
    /// An exception waits for its turn, and PRIMASK was cleared.
    waiting: bool,
    unmasked: bool,
    /// Up to when the cycle counter has counted.
    ticked: u64,
    // Of the instruction under way:
    now: u64,
    address: u32,
    cycles: u64,
    branched: bool,
    io: bool,
}

impl Fast {
    pub(crate) fn new(image: Arc<Programmed>, defects: &Defects) -> Self {
        let family = image.chip().family;
        Self {
            code: Code::new(image),
            core: Core::new(family, defects),
        }
    }

    /// The reference core may have changed floating-point registers. Between two sessions without
    /// such a step the copy stays valid.
    pub(crate) fn forget_floats(&mut self) {
        self.core.fp_loaded = false;
    }

    /// An exception came or went: what was reserved for an exclusive store no longer is (ARMv7-M
    /// ARM, A3.4.1).
    pub(crate) fn forget_reservation(&mut self) {
        self.core.exclusive = None;
    }

    /// Cycles that either core has waited for the flash so far.
    pub(crate) fn waited(&self) -> u64 {
        self.core.fetch.waited()
    }

    /// What the reference core waited for the instruction that it has executed.
    pub(crate) fn wait_for(&mut self, pc: u32, memory: Memory<'_>, now: u64) -> u64 {
        let Self { code, core } = self;
        code.set_version(memory.shared.flash_version.load(Relaxed), memory.flash);
        core.configure_fetch(memory.shared);
        match code.at(pc, memory.flash) {
            Ok(entry) => core.fetch.instruction(pc - FLASH_BASE, entry.length, now),
            Err(Leave) => 0, // not in flash
        }
    }

    /// Runs until cycle `limit`, an instruction that is not plain, or something that needs
    /// attention. Returns the cycle reached and the instructions executed.
    pub(crate) fn run(&mut self, memory: Memory<'_>, now: u64, limit: u64) -> (u64, u64) {
        let Self { code, core } = self;
        let mut reached = now;
        let mut instructions = 0;
        while reached < limit && core.enter(memory.cpu, memory.shared) {
            code.set_version(memory.shared.flash_version.load(Relaxed), memory.flash);
            core.configure_fetch(memory.shared);
            (core.now, core.ticked) = (reached, reached);
            let (executed, end) = core.session(code, memory, limit);
            if executed > 0 {
                core.leave(memory.cpu);
                memory.shared.now.store(core.now, Relaxed);
            }
            reached = core.now;
            instructions += executed;
            if end == End::ToOthers {
                break;
            }
        }
        (reached, instructions)
    }
}

impl Core {
    fn new(family: Family, defects: &Defects) -> Self {
        Self {
            given: Regs::new(),
            r: [0; REGISTERS],
            psr: 0,
            n: 0,
            c: false,
            v: 0,
            it: 0,
            primask: false,
            fetch: Fetch::new(family),
            fpu: Fpu::new(),
            fp_usable: false,
            fp_loaded: false,
            fp_given: Fpu::new(),
            division: DIVISION * defects.division_factor() - 1,
            exclusive: None,
            waiting: false,
            unmasked: false,
            ticked: 0,
            now: 0,
            address: 0,
            cycles: 0,
            branched: false,
            io: false,
        }
    }

    fn configure_fetch(&mut self, shared: &Shared) {
        let version = shared.flash_version.load(Relaxed);
        self.fetch
            .configure(shared.flash_acr.load(Relaxed), version);
    }

    /// Takes the registers over, unless the next step is the reference core's.
    fn enter(&mut self, cpu: &ArmV7m, shared: &Shared) -> bool {
        let regs = cpu.regs();
        self.given = regs;
        if !(FLASH_BASE..FLASH_BASE + LARGEST_FLASH as u32).contains(&regs.r[15])
            || regs.control & NPRIV != 0
            || regs.faultmask
            || regs.xpsr & xpsr::T == 0
            || cpu.is_asleep()
            || cpu.reset_pending()
        {
            return false;
        }
        shared.lines_changed.store(false, Relaxed);
        let lines = shared.lines();
        let (plain, pending) = cpu.with_sys(|sys| {
            // A line makes its exception pending, unless that is active (ARMv7-M ARM, B3.4.1).
            for (word, mut bits) in lines.into_iter().enumerate() {
                while bits != 0 {
                    let number = Exception((32 * word as u32 + bits.trailing_zeros() + 16) as u16);
                    bits &= bits - 1;
                    if !sys.is_active(number) {
                        sys.set_pending(number, true);
                    }
                }
            }
            self.fp_usable =
                sys.fp_enabled(true) && sys.fpccr & LSPACT == 0 && regs.control & FPCA != 0;
            let plain = sys.syst_csr & 1 == 0
                && sys.mpu_ctrl & 1 == 0
                && sys.ccr & (UNALIGN_TRP | DIV_0_TRP) == 0;
            (plain, sys.highest_pending())
        });
        self.waiting = pending.is_some();
        if !plain || pending.is_some_and(|(_, urgency)| urgency < cpu.execution_priority()) {
            return false;
        }
        self.r[..16].copy_from_slice(&regs.r);
        self.set_status(regs.xpsr);
        self.primask = regs.primask;
        self.unmasked = false;
        self.io = false;
        true
    }

    /// Takes xPSR over.
    fn set_status(&mut self, status: u32) {
        self.psr = status & !(xpsr::IT_MASK | FLAGS);
        self.set_flags(status);
        self.it = ((status >> 10 & 0x3F) << 2 | status >> 25 & 3) as u8;
    }

    /// Instructions up to the limit or to what ends the session: how many, and what it was.
    fn session(&mut self, code: &mut Code, memory: Memory<'_>, limit: u64) -> (u64, End) {
        let mut instructions = 0;
        while self.now < limit {
            let page = code.page(self.r[15], memory.flash);
            let left = page
                .and_then(|page| self.run_in(page, memory, limit, &mut instructions))
                .is_err();
            if left {
                return (instructions, End::ToOthers);
            }
            if self.io {
                self.io = false;
                self.configure_fetch(memory.shared);
                if memory.shared.attention.load(Relaxed) {
                    return (instructions, End::ToOthers);
                }
                if memory.shared.lines_changed.load(Relaxed) {
                    return (instructions, End::Interrupts);
                }
            }
            if self.waiting && self.unmasked {
                return (instructions, End::Interrupts);
            }
        }
        (instructions, End::ToOthers)
    }

    /// Gives the registers back.
    fn leave(&mut self, cpu: &ArmV7m) {
        let before = self.given;
        let uses_psp = before.control & 2 != 0 && !before.in_handler();
        let it = u32::from(self.it);
        let mut regs = Regs {
            xpsr: self.psr | self.flags() | (it >> 2) << 10 | (it & 3) << 25,
            primask: self.primask,
            ..before
        };
        regs.r.copy_from_slice(&self.r[..16]);
        if uses_psp {
            regs.psp = self.r[13];
        } else {
            regs.msp = self.r[13];
        }
        cpu.set_regs(regs);
        if self.fp_loaded {
            self.store_float(cpu);
        }
        cpu.with_sys(|sys| self.tick(sys));
    }

    /// One instruction.
    #[inline]
    fn step(&mut self, memory: Memory<'_>, entry: &Entry) -> Done {
        let pc = self.r[15];
        let &Entry { ref insn, length } = entry;
        self.address = pc;
        self.cycles = 1;
        self.branched = false;
        let it = self.it;
        if it != 0 && matches!(insn, Insn::It { .. }) {
            return Err(Leave); // a block in a block: unpredictable
        }
        if it == 0 || self.passes(it >> 4) {
            // The program counter reads as the instruction's address plus four.
            self.r[15] = pc.wrapping_add(4);
            if self.execute(memory, insn, it != 0 && length == 2).is_err() {
                self.r[15] = pc;
                return Err(Leave);
            }
        }
        if it != 0 {
            self.it = advanced(it);
        }
        if !self.branched {
            self.r[15] = pc.wrapping_add(length);
        }
        self.cycles += self.fetch.instruction(pc - FLASH_BASE, length, self.now);
        self.now += self.cycles;
        Ok(())
    }

    /// Reads memory or a peripheral.
    #[inline]
    fn read(&mut self, memory: Memory<'_>, address: u32, width: Width) -> Result<u32, Leave> {
        let value = match self.read_plain(memory, address, width) {
            Ok(value) => {
                if address < RAM_BASE {
                    self.cycles += self.fetch.constant(address - FLASH_BASE);
                }
                value
            }
            Err(Leave) if is_peripheral(address, width) => {
                memory.shared.now.store(self.now, Relaxed);
                self.io = true;
                memory
                    .shared
                    .with(|soc| soc.read(address, width.bytes() as u32))
            }
            Err(Leave) => self.read_core(memory, address, width)?,
        };
        self.cycles += 1;
        Ok(value)
    }

    /// Reads RAM or flash, without counting the cycle.
    #[inline]
    fn read_plain(&self, memory: Memory<'_>, address: u32, width: Width) -> Result<u32, Leave> {
        match address {
            RAM_BASE..0x3000_0000 => memory.ram.read(address - RAM_BASE, width).ok_or(Leave),
            FLASH_BASE..0x1000_0000 => {
                let offset = u64::from(address - FLASH_BASE);
                let value = memory.flash.read_value(offset, width, Endian::Little);
                value.map(|value| value as u32).map_err(|_| Leave)
            }
            _ => Err(Leave),
        }
    }

    /// Writes RAM or a peripheral.
    #[inline]
    fn write(&mut self, memory: Memory<'_>, address: u32, width: Width, value: u32) -> Done {
        if let Err(Leave) = self.write_plain(memory, address, width, value) {
            if !is_peripheral(address, width) {
                self.write_core(memory, address, width, value)?;
                self.cycles += 1;
                return Ok(());
            }
            memory.shared.now.store(self.now, Relaxed);
            self.io = true;
            let bytes = width.bytes() as u32;
            let value = if bytes < 4 {
                value & ((1 << (8 * bytes)) - 1)
            } else {
                value
            };
            memory.shared.with(|soc| soc.write(address, bytes, value));
        }
        self.cycles += 1;
        Ok(())
    }

    /// Reads a word of the interrupt controller, ICSR or the cycle counter.
    fn read_core(&mut self, memory: Memory<'_>, address: u32, width: Width) -> Result<u32, Leave> {
        if width != Width::U32
            || !(NVIC.contains(&address) || matches!(address, DWT_CYCCNT | ICSR))
            || address & 3 != 0
        {
            return Err(Leave);
        }
        let value = memory.cpu.with_sys(|sys| {
            self.tick(sys);
            sys.read_word(address, false)
        });
        let active = if address == ICSR {
            self.psr & xpsr::EXCEPTION
        } else {
            0
        };
        value.map(|value| value | active).ok_or(Leave)
    }

    /// Writes a word of the interrupt controller, after which an interrupt may have to be taken.
    fn write_core(&mut self, memory: Memory<'_>, address: u32, width: Width, value: u32) -> Done {
        if width != Width::U32 || !(NVIC.contains(&address) || address == STIR) || address & 3 != 0
        {
            return Err(Leave);
        }
        memory.cpu.with_sys(|sys| sys.write_word(address, value));
        self.io = true;
        memory.shared.lines_changed.store(true, Relaxed);
        Ok(())
    }

    /// Lets the cycle counter count up to the instruction under way.
    fn tick(&mut self, sys: &mut Sys) {
        sys.tick_cyccnt(self.now - self.ticked);
        self.ticked = self.now;
    }

    /// Writes RAM, without counting the cycle.
    #[inline]
    fn write_plain(&self, memory: Memory<'_>, address: u32, width: Width, value: u32) -> Done {
        let offset = address.wrapping_sub(RAM_BASE);
        memory.ram.write(offset, width, value).ok_or(Leave)
    }

    fn branch(&mut self, target: u32) {
        self.r[15] = target & !1;
        self.branched = true;
        self.cycles += 2;
    }

    /// A branch to an address from a register or memory, bit 0 of which has to be set. Exception
    /// returns and changes to a state that does not exist are left.
    fn branch_exchange(&mut self, target: u32) -> Done {
        exchangeable(target)?;
        self.branch(target);
        Ok(())
    }
}

/// The flags of xPSR.
const FLAGS: u32 = xpsr::N | xpsr::Z | xpsr::C | xpsr::V;

/// ITSTATE after an instruction in a block (ARMv7-M ARM, A7.3.3).
fn advanced(it: u8) -> u8 {
    if it & 7 == 0 {
        0
    } else {
        it & 0xE0 | it << 1 & 0x1F
    }
}

/// Whether a branch to a loaded address is plain.
fn exchangeable(target: u32) -> Done {
    if target & 1 == 0 || target >= 0xF000_0000 {
        Err(Leave)
    } else {
        Ok(())
    }
}

/// Whether an access goes to a peripheral as [`crate::address_space`] maps them, aligned and
/// outside the bit-band alias.
fn is_peripheral(address: u32, width: Width) -> bool {
    let mapped = matches!(address, 0x4000_0000..=0x41FF_FFFF | 0x5000_0000..=0x500F_FFFF);
    mapped && width.is_aligned(u64::from(address))
}
