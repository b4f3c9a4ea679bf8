//! The plain floating-point instructions: single precision as the FPv4-SP unit computes it.
//!
//! The arithmetic is the reference core's own, so that rounding, NaN and the flags in FPSCR are the same. Only sums,
//! differences and products of ordinary numbers are computed by the host, and only when the flag "inexact", the one
//! they can raise, is set already.

use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::fp::{self, fpscr};
use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn, UnaryOp};
use rsemu::cpu::arm::v7m::{ArmV7m, xpsr};
use rsemu::float::Round;

use super::{Core, Done, Leave, Memory};

/// FPSCR: cumulative "inexact", and the mode bits (AHP, DN, FZ, RMode).
const IXC: u32 = 1 << 4;
const MODES: u32 = 0x07C0_0000;

/// A number whose exponent is far from both ends, so that no single operation on two of them leaves the normal
/// range unnoticed; zero does not count.
fn ordinary(bits: u32) -> bool {
    (1..255).contains(&(bits >> 23 & 0xFF))
}

impl Core {
    /// Copies the floating-point registers at their first use since the reference core's last step.
    pub(super) fn load_float(&mut self, cpu: &ArmV7m) {
        for (index, value) in (0..).zip(&mut self.fpu.s) {
            *value = cpu.s(index);
        }
        self.fpu.fpscr = cpu.fpscr();
        self.fp_given.clone_from(&self.fpu);
        self.fp_loaded = true;
    }

    /// Gives back those that have changed.
    pub(super) fn store_float(&mut self, cpu: &ArmV7m) {
        for (index, (value, given)) in (0..).zip(self.fpu.s.iter().zip(&mut self.fp_given.s)) {
            if value != given {
                *given = *value;
                cpu.set_s(index, *value);
            }
        }
        if self.fpu.fpscr != self.fp_given.fpscr {
            self.fp_given.fpscr = self.fpu.fpscr;
            cpu.set_fpscr(self.fpu.fpscr);
        }
    }

    /// The host's result of an operation, if it is certain to be the unit's.
    fn by_host(&self, a: u32, b: u32, operation: impl FnOnce(f32, f32) -> f32) -> Option<u32> {
        if self.fpu.fpscr & (MODES | IXC) != IXC || !ordinary(a) || !ordinary(b) {
            return None;
        }
        let result = operation(f32::from_bits(a), f32::from_bits(b)).to_bits();
        ordinary(result).then_some(result)
    }

    fn sum(&mut self, a: u32, b: u32) -> u32 {
        self.by_host(a, b, |a, b| a + b).unwrap_or_else(|| {
            let (value, flags) = fp::add(a, b, self.fpu.env());
            fp::accumulate(&mut self.fpu.fpscr, flags);
            value
        })
    }

    fn product(&mut self, a: u32, b: u32) -> u32 {
        self.by_host(a, b, |a, b| a * b).unwrap_or_else(|| {
            let (value, flags) = fp::mul(a, b, self.fpu.env());
            fp::accumulate(&mut self.fpu.fpscr, flags);
            value
        })
    }

    pub(super) fn float(&mut self, memory: Memory<'_>, insn: FpInsn) -> Done {
        if !self.fp_usable || insn.needs_v5() {
            return Err(Leave);
        }
        let env = self.fpu.env();
        match insn {
            FpInsn::Data { op, d, n, m } => self.arithmetic(op, d, n, m)?,
            FpInsn::Unary { op, d, m } => {
                let a = self.fpu.s(m);
                match op {
                    UnaryOp::Mov => self.fpu.set_s(d, a),
                    UnaryOp::Abs => self.fpu.set_s(d, fp::abs(a)),
                    UnaryOp::Neg => self.fpu.set_s(d, fp::neg(a)),
                    UnaryOp::Sqrt => {
                        let (value, flags) = fp::sqrt(a, env);
                        self.fpu.finish(d, value, flags);
                        self.cycles += 13;
                    }
                    _ => return Err(Leave),
                }
            }
            FpInsn::MovImm { d, imm } => self.fpu.set_s(d, imm),
            FpInsn::Cmp {
                d,
                m,
                with_zero,
                signal_all,
            } => {
                let b = if with_zero { 0 } else { self.fpu.s(m) };
                let (nzcv, flags) = fp::compare(self.fpu.s(d), b, signal_all, env);
                self.fpu.fpscr = self.fpu.fpscr & !fpscr::FLAGS | nzcv;
                fp::accumulate(&mut self.fpu.fpscr, flags);
            }
            FpInsn::CvtInt {
                d,
                m,
                to_int,
                signed,
                round_zero,
            } => {
                let a = self.fpu.s(m);
                let (value, flags) = match (to_int, round_zero) {
                    (true, true) => fp::to_fixed(a, 32, !signed, 0, env.round(Round::TowardZero)),
                    (true, false) => fp::to_fixed(a, 32, !signed, 0, env),
                    (false, _) => fp::from_fixed(a, 32, !signed, 0, env),
                };
                self.fpu.finish(d, value, flags);
            }
            FpInsn::MovCore { to_fp, rt, n } if rt < 15 => {
                if to_fp {
                    self.fpu.set_s(n, self.r[usize::from(rt)]);
                } else {
                    self.r[usize::from(rt)] = self.fpu.s(n);
                }
            }
            FpInsn::MovCore2 {
                to_fp, rt, rt2, m, ..
            } if rt < 15 && rt2 < 15 => {
                let (rt, rt2) = (usize::from(rt), usize::from(rt2));
                if to_fp {
                    self.fpu.set_s(m, self.r[rt]);
                    self.fpu.set_s(m.wrapping_add(1), self.r[rt2]);
                } else {
                    self.r[rt] = self.fpu.s(m);
                    self.r[rt2] = self.fpu.s(m.wrapping_add(1));
                }
                self.cycles += 1;
            }
            // VMRS APSR_nzcv, FPSCR.
            FpInsn::Sys {
                to_core: true,
                rt: 15,
                reg: 1,
            } => {
                let nzcv = xpsr::N | xpsr::Z | xpsr::C | xpsr::V;
                self.psr = self.psr & !nzcv | self.fpu.fpscr & nzcv;
            }
            FpInsn::Mem {
                load,
                d,
                rn,
                imm,
                add,
                double,
            } => {
                let base = if rn == 15 {
                    self.r[15] & !3
                } else {
                    self.r[usize::from(rn)]
                };
                let at = if add {
                    base.wrapping_add(imm)
                } else {
                    base.wrapping_sub(imm)
                };
                self.float_words(memory, load, d, at, if double { 2 } else { 1 })?;
            }
            FpInsn::Multi {
                load,
                d,
                rn,
                count,
                add,
                writeback,
                ..
            } if rn < 15 && count > 0 => {
                let (base, bytes) = (self.r[usize::from(rn)], 4 * u32::from(count));
                let start = if add { base } else { base.wrapping_sub(bytes) };
                self.float_words(memory, load, d, start, u32::from(count))?;
                if writeback {
                    self.r[usize::from(rn)] = if add { base.wrapping_add(bytes) } else { start };
                }
            }
            _ => return Err(Leave),
        }
        Ok(())
    }

    fn arithmetic(&mut self, op: DataOp, d: u8, n: u8, m: u8) -> Done {
        let (a, b, c) = (self.fpu.s(d), self.fpu.s(n), self.fpu.s(m));
        let value = match op {
            DataOp::Add => self.sum(b, c),
            DataOp::Sub => match self.by_host(b, c, |b, c| b - c) {
                Some(value) => value,
                None => {
                    let (value, flags) = fp::sub(b, c, self.fpu.env());
                    fp::accumulate(&mut self.fpu.fpscr, flags);
                    value
                }
            },
            DataOp::Mul => self.product(b, c),
            DataOp::Nmul => fp::neg(self.product(b, c)),
            DataOp::Div => {
                let (value, flags) = fp::div(b, c, self.fpu.env());
                fp::accumulate(&mut self.fpu.fpscr, flags);
                self.cycles += 13;
                value
            }
            // Two operations, each rounded.
            DataOp::Mla | DataOp::Mls | DataOp::Nmla | DataOp::Nmls => {
                let product = self.product(b, c);
                let (a, product) = match op {
                    DataOp::Mla => (a, product),
                    DataOp::Mls => (a, fp::neg(product)),
                    DataOp::Nmla => (fp::neg(a), fp::neg(product)),
                    _ => (fp::neg(a), product),
                };
                self.cycles += 2;
                self.sum(a, product)
            }
            DataOp::Fma | DataOp::Fms | DataOp::Fnma | DataOp::Fnms => {
                let (a, b) = match op {
                    DataOp::Fma => (a, b),
                    DataOp::Fms => (a, fp::neg(b)),
                    DataOp::Fnma => (fp::neg(a), fp::neg(b)),
                    _ => (fp::neg(a), b),
                };
                let (value, flags) = fp::mul_add(a, b, c, self.fpu.env());
                fp::accumulate(&mut self.fpu.fpscr, flags);
                self.cycles += 2;
                value
            }
            _ => return Err(Leave),
        };
        self.fpu.set_s(d, value);
        Ok(())
    }

    fn float_words(&mut self, memory: Memory<'_>, load: bool, d: u8, at: u32, count: u32) -> Done {
        self.words(memory, at, count, load)?;
        for index in 0..count {
            let (at, register) = (at.wrapping_add(4 * index), d.wrapping_add(index as u8));
            if load {
                let value = self.read(memory, at, Width::U32)?;
                self.fpu.set_s(register, value);
            } else {
                self.write(memory, at, Width::U32, self.fpu.s(register))?;
            }
        }
        Ok(())
    }
}
