//! Exceptions, where nothing is left to decide: the return from a handler to what it interrupted,
//! and a handler's first use of the floating-point unit (ARMv7-M ARM, B1.5.7 and B1.5.8).
//!
//! The reference core enters handlers, goes from one to the next without a return in between, and
//! does whatever fails.

use std::sync::atomic::Ordering::Relaxed;

use rsemu::cpu::arm::v7m::fp::fpscr;
use rsemu::cpu::arm::v7m::sys::{Exception, ccr, control, exc_return, fpccr};
use rsemu::cpu::arm::v7m::xpsr;

use super::{Core, Leave, Memory};

/// Words of a frame, and of one with room for floating-point registers: S0 to S15 and FPSCR follow,
/// and a word that is unused.
const BASIC_WORDS: u32 = 8;
const EXTENDED_WORDS: u32 = 26;
const FLOATS: u32 = 16;
/// Stacked xPSR: a word lies unused above the frame.
const ALIGNED: u32 = 1 << 9;
/// Cycles of a return beside those of its accesses.
const RETURN: u64 = 10;

/// A return with nothing in its way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Return {
    handler: Exception,
    /// Where the frame begins, and its offset in RAM.
    sp: u32,
    frame: u32,
    is_extended: bool,
}

impl Core {
    /// The return to a frame on the main stack. The reference core's are those to the process stack
    /// or with another exception that waits, and all that would fail.
    pub(super) fn return_by(
        &self,
        memory: Memory<'_>,
        code: u32,
        sp: u32,
    ) -> Result<Return, Leave> {
        let to_handler = match code | exc_return::FP_FRAME {
            exc_return::HANDLER_MSP => true,
            exc_return::THREAD_MSP => false,
            _ => return Err(Leave),
        };
        let is_extended = code & exc_return::FP_FRAME == 0;
        let words = if is_extended {
            EXTENDED_WORDS
        } else {
            BASIC_WORDS
        };
        let frame = Self::in_ram(memory.ram, sp, words).ok_or(Leave)?;
        let handler = Exception((self.psr & xpsr::EXCEPTION) as u16);
        // A line that is still up makes its exception pending again.
        let is_up = handler.0.checked_sub(16).is_some_and(|line| {
            let lines = memory.shared.lines();
            let word = lines.get(usize::from(line / 32)).copied();
            word.unwrap_or(0) >> (line % 32) & 1 != 0
        });
        let is_plain = memory.cpu.with_sys(|sys| {
            sys.is_active(handler)
                && (sys.active_count() > 1) == to_handler
                && sys.highest_pending().is_none()
                && (!is_extended || sys.fp_enabled(true))
        });
        if is_up || !is_plain || self.given.control & control::SPSEL != 0 {
            return Err(Leave);
        }
        Ok(Return {
            handler,
            sp,
            frame,
            is_extended,
        })
    }

    /// Takes the registers from the frame. The session ends, as lower exceptions may now be taken.
    pub(super) fn take_frame(&mut self, memory: Memory<'_>, from: Return) {
        let word = |index: u32| memory.ram.word(from.frame + 4 * index);
        for (index, register) in (0..).zip([0, 1, 2, 3, 12, 14]) {
            self.r[register] = word(index);
        }
        self.r[15] = word(6) & !1;
        self.branched = true;
        let status = word(7);
        self.set_status(status & (xpsr::WRITABLE | xpsr::EXCEPTION));
        self.cycles += u64::from(BASIC_WORDS) + RETURN;
        let (restores, aligns) = memory.cpu.with_sys(|sys| {
            sys.set_active(from.handler, false);
            let is_saved = sys.fpccr & fpccr::LSPACT == 0;
            if from.is_extended {
                sys.fpccr &= !fpccr::LSPACT;
            }
            let aligns = from.is_extended || sys.ccr & ccr::STKALIGN != 0;
            (from.is_extended && is_saved, aligns)
        });
        if restores {
            if !self.fp_loaded {
                self.load_float(memory.cpu);
            }
            for (index, value) in (BASIC_WORDS..).zip(&mut self.fpu.s[..FLOATS as usize]) {
                *value = word(index);
            }
            self.fpu.fpscr = word(BASIC_WORDS + FLOATS) & fpscr::WRITABLE;
            self.cycles += u64::from(FLOATS) + 1;
        }
        self.given.control &= !control::FPCA;
        let mut words = BASIC_WORDS;
        if from.is_extended {
            self.given.control |= control::FPCA;
            words = EXTENDED_WORDS;
        }
        if aligns && status & ALIGNED != 0 {
            words += 1;
        }
        self.r[13] = from.sp.wrapping_add(4 * words);
        self.exclusive = None;
        self.io = true;
        memory.shared.lines_changed.store(true, Relaxed);
    }

    /// Makes the floating-point unit the present code's: saves the registers of the interrupted one
    /// if that has not been done, for which the cycles are returned.
    pub(super) fn claim_float(&mut self, memory: Memory<'_>) -> Result<u64, Leave> {
        let (state, enabled, at) = memory
            .cpu
            .with_sys(|sys| (sys.fpccr, sys.fp_enabled(true), sys.fpcar));
        if !enabled || state & fpccr::ASPEN == 0 {
            return Err(Leave);
        }
        let frame = if state & fpccr::LSPACT == 0 {
            None
        } else if state & fpccr::USER == 0 {
            Some(Self::in_ram(memory.ram, at, FLOATS + 1).ok_or(Leave)?)
        } else {
            return Err(Leave);
        };
        if !self.fp_loaded {
            self.load_float(memory.cpu);
        }
        let mut cycles = 0;
        if let Some(frame) = frame {
            let status = [self.fpu.fpscr];
            let words = self.fpu.s[..FLOATS as usize].iter().chain(&status);
            for (index, value) in (0..).zip(words) {
                memory.ram.set_word(frame + 4 * index, *value);
                cycles += 1;
            }
            memory.cpu.with_sys(|sys| sys.fpccr &= !fpccr::LSPACT);
        }
        self.given.control |= control::FPCA;
        self.fp_usable = true;
        Ok(cycles)
    }
}
