//! One step of the reference core, and what rsemu 0.0.7 leaves out of it.
//!
//! - An exception can come between the instructions of an IT block. The rest of the block (ITSTATE)
//!   is then kept in the stacked xPSR, and the return continues with it (ARMv7-M ARM, B1.5.6).
//!   rsemu stacks it as zero, after which the rest would run regardless of its condition: the
//!   stacked value is corrected.
//! - It can also come between a comparison of floats and the instruction that reads its flags out
//!   of FPSCR. Entry leaves FPSCR alone; the handler's first floating-point instruction saves it
//!   (B1.5.7). rsemu overwrites it on entry, before it is saved: it is restored. The handler should
//!   then have the modes of FPDSCR, which are zero in both.
//! - ICSR has the number of the active exception (VECTACTIVE, B3.2.4), by which a program knows in
//!   which handler it is. rsemu reads zero: what a load of it into one register gives is corrected.

use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::isa::{self, Cond, Insn, MemOffset, Size};
use rsemu::cpu::arm::v7m::{Regs, xpsr};

use super::Board;
use crate::fast::{ICSR, Memory};
use crate::memory_map::RAM_BASE;

/// EXC_RETURN: the frame lies on the process stack.
const EXC_RETURN_PSP: u32 = 1 << 2;
/// Where xPSR lies in the frame of an exception.
const STACKED_XPSR: u32 = 28;

impl Board {
    /// One step of the reference core: an instruction or the entry into an exception handler.
    /// Returns which of the two it was.
    pub(super) fn step(&mut self) -> (u64, bool) {
        let before = self.cpu.regs();
        let (left, pc) = (before.xpsr & xpsr::IT_MASK, before.r[15]);
        let fpscr = self.cpu.fpscr();
        let active = || self.cpu.with_sys(|sys| sys.active_count());
        let active_before = before.in_handler().then(active);
        let mut cycles = self.cpu.step();
        let after = self.cpu.regs();
        // A handler that was interrupted at its first address looks entered when it goes on.
        let entered = cycles >= 12
            && self.entered_exception(&after)
            && active_before.is_none_or(|before| active() >= before);
        // An instruction that is followed by the next one has not left a handler. An exclusive
        // load, store or clear would be plain but for its operands; an earlier reservation is then
        // gone.
        let follows = (1..=4).contains(&after.r[15].wrapping_sub(pc));
        let half = self.instruction(pc);
        if entered || !follows || half.is_none_or(is_exclusive) {
            self.fast.forget_reservation();
        }
        // An entry only reserves room for the floating-point registers. A return may restore them,
        // and one that fails enters a handler, too.
        let returned = !follows && (!entered || before.in_handler());
        if returned || half.is_none_or(is_coprocessor) {
            self.fast.forget_floats();
        }
        if entered {
            self.cpu.set_fpscr(fpscr);
        } else if after.r[15] != pc {
            let waited = self.wait_for(pc);
            if waited > 0 {
                self.cpu.with_sys(|sys| sys.tick_cyccnt(waited));
            }
            cycles += waited;
        }
        if let Some((register, mask)) = self.loads_icsr(&before, half.filter(|_| follows)) {
            let value = after.r[register] | u32::from(after.exception().0) & mask;
            self.cpu.set_reg(register as u8, value);
        }
        if left != 0 && entered {
            let on_psp = after.r[14] & EXC_RETURN_PSP != 0;
            let frame = if on_psp { after.psp } else { after.msp };
            let at = frame.wrapping_sub(RAM_BASE).saturating_add(STACKED_XPSR);
            // A frame outside RAM was never stacked.
            if let Some(word) = self.ram.read(at, Width::U32) {
                let _ = self.ram.write(at, Width::U32, word | left);
            }
        }
        (cycles, entered)
    }

    /// Cycles that the core waited for the instruction that it has just read from flash.
    fn wait_for(&mut self, pc: u32) -> u64 {
        let memory = Memory {
            cpu: &self.cpu,
            ram: &self.ram,
            flash: &self.flash,
            shared: &self.shared,
        };
        self.fast.wait_for(pc, memory, self.now)
    }

    /// The first halfword of the instruction at an address.
    fn instruction(&self, pc: u32) -> Option<u16> {
        let word = self.read_word(pc & !3)?;
        Some(if pc & 2 == 0 { word } else { word >> 16 } as u16)
    }

    /// The register that an instruction in a handler loads from ICSR, and the bits that it can get.
    fn loads_icsr(&self, regs: &Regs, half: Option<u16>) -> Option<(usize, u32)> {
        let first = half.filter(|_| regs.in_handler())?;
        let passes = Cond((regs.xpsr >> 12 & 0xF) as u8).passes(regs.xpsr);
        if regs.xpsr & xpsr::IT_MASK != 0 && !passes {
            return None;
        }
        let Insn::LoadStore {
            load: true,
            size,
            rt,
            rn,
            offset,
            index,
            add,
            ..
        } = isa::decode(first, self.instruction(regs.r[15] + 2)?)
        else {
            return None;
        };
        let register = |number: u8| regs.r[usize::from(number)];
        let by = match offset {
            _ if !index => 0,
            MemOffset::Imm(value) => value,
            MemOffset::Reg { rm, lsl } => register(rm) << lsl,
        };
        let base = register(rn);
        let at = if add {
            base.wrapping_add(by)
        } else {
            base.wrapping_sub(by)
        };
        let mask = if size == Size::Byte {
            0xFF
        } else {
            xpsr::EXCEPTION
        };
        (at == ICSR && rn < 15 && rt < 15).then_some((usize::from(rt), mask))
    }

    /// Whether the last step was the entry into an exception handler and not an instruction: the
    /// link register holds a return code and the program counter the handler's first address.
    fn entered_exception(&self, regs: &Regs) -> bool {
        let vector = self.cpu.vtor() + 4 * u32::from(regs.exception().0);
        regs.in_handler()
            && regs.r[14] >= 0xFFFF_FFE0
            && self
                .read_word(vector)
                .is_some_and(|to| to & !1 == regs.r[15])
    }
}

/// Whether an instruction is one of LDREX, STREX and CLREX, by its first halfword (ARMv7-M ARM,
/// A5.3).
fn is_exclusive(half: u16) -> bool {
    matches!(half & 0xFFE0, 0xE840 | 0xE8C0) || half == 0xF3BF
}

/// Whether an instruction is a coprocessor's, as those of the floating-point unit are (A5.3.18).
fn is_coprocessor(half: u16) -> bool {
    half & 0xEC00 == 0xEC00
}
