//! The plain floating-point instructions: single precision as the FPv4-SP unit computes it.
//!
//! The arithmetic is the reference core's own, so that rounding, NaN and the flags in FPSCR are the
//! same. Once the flag "inexact" is set, the host computes operations that can raise no other flag,
//! because IEEE 754 allows only one result.

use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::ArmV7m;
use rsemu::cpu::arm::v7m::fp::{self, fpscr};
use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn, UnaryOp};
use rsemu::float::{Env, Flags, Round};

use super::{Core, Done, Leave, Memory};

/// FPSCR: cumulative "inexact", and the mode bits (AHP, DN, FZ, RMode).
const IXC: u32 = 1 << 4;
const MODES: u32 = 0x07C0_0000;

/// FPSCR: numbers below the normal range count as zero.
const FZ: u32 = 1 << 24;
const EXPONENT: u32 = 0xFF << 23;
/// The sign of a number.
pub(super) const SIGN: u32 = 1 << 31;

/// Neither infinite nor NaN.
#[inline(always)]
fn finite(bits: u32) -> bool {
    bits & EXPONENT != EXPONENT
}

/// Finite and in the normal range, which zero is not.
#[inline(always)]
fn normal(bits: u32) -> bool {
    finite(bits) && bits & EXPONENT != 0
}

#[inline(always)]
fn zero(bits: u32) -> bool {
    bits & !SIGN == 0
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

    /// Whether the host computes as the unit does: it rounds to nearest, keeps small numbers, and
    /// of the flags that ordinary numbers can raise "inexact" is set already.
    #[inline(always)]
    fn like_host(&self) -> bool {
        self.fpu.fpscr & (MODES | IXC) == IXC
    }

    /// A sum or a difference. Between finite numbers whose result is finite it can only be inexact:
    /// what is below the normal range is exact.
    #[inline(always)]
    fn sum_by_host(&self, a: u32, b: u32, result: f32) -> Option<u32> {
        let result = result.to_bits();
        (self.like_host() && finite(a) && finite(b) && finite(result)).then_some(result)
    }

    /// A sum, or `a` less `b`.
    #[inline(always)]
    pub(super) fn sum(&mut self, a: u32, b: u32, subtracts: bool) -> u32 {
        let result = f32::from_bits(a) + f32::from_bits(b ^ u32::from(subtracts) << 31);
        self.sum_by_host(a, b, result).unwrap_or_else(|| {
            let operation = if subtracts { fp::sub } else { fp::add };
            self.by_unit(a, b, operation)
        })
    }

    #[inline(always)]
    pub(super) fn product(&mut self, a: u32, b: u32) -> u32 {
        let result = (f32::from_bits(a) * f32::from_bits(b)).to_bits();
        let certain = normal(result) || (zero(a) || zero(b));
        if self.like_host() && finite(a) && finite(b) && certain {
            result
        } else {
            self.by_unit(a, b, fp::mul)
        }
    }

    fn quotient(&mut self, a: u32, b: u32) -> u32 {
        let result = (f32::from_bits(a) / f32::from_bits(b)).to_bits();
        if self.like_host() && normal(a) && normal(b) && normal(result) {
            result
        } else {
            self.by_unit(a, b, fp::div)
        }
    }

    fn square_root(&mut self, a: u32) -> u32 {
        if self.like_host() && normal(a) && a & SIGN == 0 {
            return f32::from_bits(a).sqrt().to_bits();
        }
        let (value, flags) = fp::sqrt(a, self.fpu.env());
        fp::accumulate(&mut self.fpu.fpscr, flags);
        value
    }

    /// An operation as the reference core computes it.
    #[inline(never)]
    fn by_unit(
        &mut self,
        a: u32,
        b: u32,
        operation: impl Fn(u32, u32, Env) -> (u32, Flags),
    ) -> u32 {
        let (value, flags) = operation(a, b, self.fpu.env());
        fp::accumulate(&mut self.fpu.fpscr, flags);
        value
    }

    /// A comparison; between numbers it raises nothing.
    #[inline(always)]
    pub(super) fn compare(&mut self, a: u32, b: u32, signal_all: bool) {
        let (x, y) = (f32::from_bits(a), f32::from_bits(b));
        let nzcv = if self.fpu.fpscr & FZ != 0 || x.is_nan() || y.is_nan() {
            let (nzcv, flags) = fp::compare(a, b, signal_all, self.fpu.env());
            fp::accumulate(&mut self.fpu.fpscr, flags);
            nzcv
        } else if x == y {
            fpscr::Z | fpscr::C
        } else if x < y {
            fpscr::N
        } else {
            fpscr::C
        };
        self.fpu.fpscr = self.fpu.fpscr & !fpscr::FLAGS | nzcv;
    }

    /// An integer of a number towards zero, if that is in range.
    fn integer_by_host(&self, a: u32, signed: bool) -> Option<u32> {
        let x = f32::from_bits(a);
        if !self.like_host() {
            None
        } else if signed {
            (-2_147_483_648.0..2_147_483_648.0)
                .contains(&x)
                .then_some(x as i32 as u32)
        } else {
            (0.0..4_294_967_296.0).contains(&x).then_some(x as u32)
        }
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
                        let value = self.square_root(a);
                        self.fpu.set_s(d, value);
                        self.cycles += self.division;
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
                self.compare(self.fpu.s(d), b, signal_all);
            }
            FpInsn::CvtInt {
                d,
                m,
                to_int,
                signed,
                round_zero,
            } => {
                let a = self.fpu.s(m);
                let by_host = match (to_int, round_zero) {
                    (true, true) => self.integer_by_host(a, signed),
                    (false, _) if self.like_host() && signed => Some((a as i32 as f32).to_bits()),
                    (false, _) if self.like_host() => Some((a as f32).to_bits()),
                    _ => None,
                };
                if let Some(value) = by_host {
                    self.fpu.set_s(d, value);
                    return Ok(());
                }
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
                self.set_flags(self.fpu.fpscr);
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
            DataOp::Add => self.sum(b, c, false),
            DataOp::Sub => self.sum(b, c, true),
            DataOp::Mul => self.product(b, c),
            DataOp::Nmul => fp::neg(self.product(b, c)),
            DataOp::Div => {
                self.cycles += self.division;
                self.quotient(b, c)
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
                self.sum(a, product, false)
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

    pub(super) fn float_words(
        &mut self,
        memory: Memory<'_>,
        load: bool,
        d: u8,
        at: u32,
        count: u32,
    ) -> Done {
        let Some(offset) = Self::in_ram(memory.ram, at, count) else {
            // Loads from flash: words() lets nothing else pass.
            self.words(memory, at, count, load)?;
            for index in 0..count {
                let value = self.read(memory, at.wrapping_add(4 * index), Width::U32)?;
                self.fpu.set_s(d.wrapping_add(index as u8), value);
            }
            return Ok(());
        };
        for index in 0..count {
            let (offset, register) = (offset + 4 * index, d.wrapping_add(index as u8));
            if load {
                self.fpu.set_s(register, memory.ram.word(offset));
            } else {
                memory.ram.set_word(offset, self.fpu.s(register));
            }
        }
        self.cycles += u64::from(count);
        Ok(())
    }
}
