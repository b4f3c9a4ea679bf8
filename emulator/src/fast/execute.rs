//! The plain integer instructions (ARMv7-M Architecture Reference Manual, section A7.7).
//!
//! Every arm either completes or returns [`Leave`] before it has changed anything: it checks
//! addresses and values that could be refused first.

use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::isa::{
    BitfieldOp, Cond, DpOp, ExtendOp, HintOp, Insn, MemOffset, MiscOp, Operand, Shift, ShiftType,
    Size,
};
use rsemu::cpu::arm::v7m::xpsr;

use super::micro::{REGISTERS, Z};
use super::{Core, Done, Leave, Memory, exchangeable};

/// PRIMASK's number for MRS and MSR.
pub(super) const PRIMASK: u8 = 16;

fn width(size: Size) -> Width {
    match size {
        Size::Byte => Width::U8,
        Size::Half => Width::U16,
        Size::Word => Width::U32,
    }
}

fn extend(value: u32, size: Size, signed: bool) -> u32 {
    match (size, signed) {
        (Size::Byte, true) => value as u8 as i8 as u32,
        (Size::Half, true) => value as u16 as i16 as u32,
        _ => value,
    }
}

/// Shift by a register's or an instruction's amount: value and carry out (A2.2.1). RRX is rotate by
/// one through the carry.
pub(super) fn shift(kind: ShiftType, value: u32, amount: u32, carry: bool) -> (u32, bool) {
    let wide = u64::from(value);
    match (kind, amount) {
        (ShiftType::Rrx, _) => (u32::from(carry) << 31 | value >> 1, value & 1 != 0),
        (_, 0) => (value, carry),
        (ShiftType::Lsl, 1..=32) => ((wide << amount) as u32, wide << amount >> 32 & 1 != 0),
        (ShiftType::Lsr, 1..=32) => ((wide >> amount) as u32, wide >> (amount - 1) & 1 != 0),
        (ShiftType::Lsl | ShiftType::Lsr, _) => (0, false),
        (ShiftType::Asr, _) => {
            let (amount, wide) = (amount.min(32), i64::from(value as i32));
            ((wide >> amount) as u32, wide >> (amount - 1) & 1 != 0)
        }
        (ShiftType::Ror, _) => {
            let value = value.rotate_right(amount % 32);
            (value, value >> 31 != 0)
        }
    }
}

impl Core {
    pub(super) fn carry(&self) -> bool {
        self.c
    }

    /// The flags as in xPSR and FPSCR.
    pub(super) fn flags(&self) -> u32 {
        let zero = if self.z() == 0 { xpsr::Z } else { 0 };
        let carry = if self.c { xpsr::C } else { 0 };
        let overflow = if self.v >> 31 != 0 { xpsr::V } else { 0 };
        self.n & xpsr::N | zero | carry | overflow
    }

    /// Takes them over from there.
    pub(super) fn set_flags(&mut self, from: u32) {
        self.n = from;
        self.r[usize::from(Z)] = !from & xpsr::Z;
        self.c = from & xpsr::C != 0;
        self.v = from << 3;
    }

    /// Whether a condition holds (ARMv7-M ARM, A7.3); 14 and 15 always do.
    #[inline(always)]
    pub(super) fn passes(&self, cond: u8) -> bool {
        let holds = match cond >> 1 {
            0 => self.z() == 0,
            1 => self.c,
            2 => self.n >> 31 != 0,
            3 => self.v >> 31 != 0,
            4 => self.c && self.z() != 0,
            5 => (self.n ^ self.v) >> 31 == 0,
            6 => (self.n ^ self.v) >> 31 == 0 && self.z() != 0,
            _ => return true,
        };
        holds != (cond & 1 != 0)
    }

    #[inline(always)]
    pub(super) fn set_nz(&mut self, result: u32) {
        (self.n, self.r[usize::from(Z)]) = (result, result);
    }

    #[inline(always)]
    fn z(&self) -> u32 {
        self.r[usize::from(Z)]
    }

    /// Sets them or leaves them, without a branch.
    #[inline(always)]
    pub(super) fn set_nz_if(&mut self, flags: bool, result: u32) {
        let mask = u32::from(flags).wrapping_neg();
        self.n ^= (self.n ^ result) & mask;
        self.r[usize::from(Z)] ^= (self.z() ^ result) & mask;
    }

    #[inline(always)]
    pub(super) fn set_c(&mut self, carry: bool) {
        self.c = carry;
    }

    /// A sum with all its flags (A2.2.1, AddWithCarry).
    #[inline(always)]
    pub(super) fn sum_with_flags(&mut self, x: u32, y: u32, carry: bool) -> u32 {
        let wide = u64::from(x) + u64::from(y) + u64::from(carry);
        let result = wide as u32;
        self.set_nz(result);
        self.c = wide >> 32 != 0;
        self.v = (x ^ result) & (y ^ result);
        result
    }

    #[inline(always)]
    pub(super) fn set(&mut self, register: u8, value: u32) {
        self.r[usize::from(register) % REGISTERS] = value;
    }

    /// Writes a register and the flags N and Z.
    #[inline(always)]
    pub(super) fn set_with_nz(&mut self, d: u8, value: u32) {
        self.set(d, value);
        self.set_nz(value);
    }

    #[inline(always)]
    pub(super) fn get(&self, register: u8) -> u32 {
        self.r[usize::from(register) % REGISTERS]
    }

    /// Executes one instruction. `keep_flags`: a 16-bit instruction in an IT block, which sets no
    /// flags.
    pub(super) fn execute(&mut self, memory: Memory<'_>, insn: &Insn, keep_flags: bool) -> Done {
        match *insn {
            Insn::DataProc {
                op,
                s,
                rd,
                rn,
                operand,
            } => {
                return self.data(op, s && (!keep_flags || op.is_test()), rd, rn, operand);
            }
            Insn::ShiftReg { ty, s, rd, rn, rm } => {
                plain(&[rd])?;
                let (result, carry) = shift(ty, self.get(rn), self.get(rm) & 0xFF, self.carry());
                self.set(rd, result);
                if s && !keep_flags {
                    self.set_nz(result);
                    self.set_c(carry);
                }
            }
            Insn::Adr { rd, imm, add } => {
                plain(&[rd])?;
                let base = self.r[15] & !3;
                self.set(rd, offset(base, imm, add));
            }
            Insn::MovImm16 { top, rd, imm } => {
                plain(&[rd])?;
                let imm = u32::from(imm);
                self.set(
                    rd,
                    if top {
                        self.get(rd) & 0xFFFF | imm << 16
                    } else {
                        imm
                    },
                );
            }
            Insn::Branch { cond, offset } => {
                if cond.is_none_or(|cond: Cond| self.passes(cond.0)) {
                    self.branch(self.r[15].wrapping_add(offset as u32));
                }
            }
            Insn::BranchLink { offset } => {
                self.r[14] = self.address.wrapping_add(4) | 1;
                self.branch(self.r[15].wrapping_add(offset as u32));
            }
            Insn::Bx { rm } => return self.branch_exchange(self.get(rm)),
            Insn::Blx { rm } => {
                let target = self.get(rm);
                exchangeable(target)?;
                self.r[14] = self.address.wrapping_add(2) | 1;
                self.branch(target);
            }
            Insn::Cbz {
                nonzero,
                rn,
                offset,
            } => {
                if (self.get(rn) != 0) == nonzero {
                    self.branch(self.r[15].wrapping_add(offset));
                }
            }
            Insn::TableBranch { rn, rm, half } => {
                let (scale, size) = if half {
                    (2, Width::U16)
                } else {
                    (1, Width::U8)
                };
                let at = self.get(rn).wrapping_add(self.get(rm).wrapping_mul(scale));
                if at % scale != 0 {
                    return Err(Leave);
                }
                let entry = self.read(memory, at, size)?;
                self.branch(self.r[15].wrapping_add(2 * entry));
            }
            Insn::It { cond, mask } => {
                // The step advances ITSTATE after every instruction in a block; this one starts the
                // block.
                self.it = 0;
                self.r[15] = self.address.wrapping_add(2);
                self.branched = true;
                self.start_it(cond, mask);
            }
            Insn::LoadStore {
                load,
                size,
                signed,
                rt,
                rn,
                offset: by,
                index,
                add,
                wback,
                unpriv,
            } => {
                if unpriv || rn == 15 || (wback && rn == 13 && rt == 13) {
                    return Err(Leave);
                }
                let base = self.get(rn);
                let by = match by {
                    MemOffset::Imm(value) => value,
                    MemOffset::Reg { rm, lsl } => self.get(rm) << lsl,
                };
                let moved = offset(base, by, add);
                let at = if index { moved } else { base };
                if load {
                    if rt == 15 {
                        exchangeable(self.read_plain(memory, at, width(size))?)?;
                    }
                    let value = extend(self.read(memory, at, width(size))?, size, signed);
                    if wback {
                        self.set(rn, moved);
                    }
                    if rt == 15 {
                        return self.branch_exchange(value);
                    }
                    self.set(rt, value);
                } else {
                    plain(&[rt])?;
                    self.write(memory, at, width(size), self.get(rt))?;
                    if wback {
                        self.set(rn, moved);
                    }
                }
            }
            Insn::LoadLiteral {
                size,
                signed,
                rt,
                imm,
                add,
            } => {
                plain(&[rt])?;
                let at = offset(self.r[15] & !3, imm, add);
                let value = self.read(memory, at, width(size))?;
                self.set(rt, extend(value, size, signed));
            }
            Insn::LoadStoreDual {
                load,
                rt,
                rt2,
                rn,
                imm,
                index,
                add,
                wback,
            } => {
                plain(&[rt, rt2])?;
                let base = if rn == 15 {
                    self.r[15] & !3
                } else {
                    self.get(rn)
                };
                let moved = offset(base, imm, add);
                let at = if index { moved } else { base };
                self.words(memory, at, 2, load)?;
                if load {
                    let low = self.read(memory, at, Width::U32)?;
                    let high = self.read(memory, at.wrapping_add(4), Width::U32)?;
                    self.set(rt, low);
                    self.set(rt2, high);
                } else {
                    self.write(memory, at, Width::U32, self.get(rt))?;
                    self.write(memory, at.wrapping_add(4), Width::U32, self.get(rt2))?;
                }
                if wback && rn != 15 {
                    self.set(rn, moved);
                }
            }
            Insn::LoadStoreExclusive {
                load,
                size,
                rd,
                rt,
                rn,
                imm,
            } => {
                plain(&[if load { rt } else { rd }, rt, rn])?;
                let at = self.get(rn).wrapping_add(imm);
                let size = width(size);
                if !size.is_aligned(u64::from(at)) {
                    return Err(Leave);
                }
                self.read_plain(memory, at, size)?;
                if load {
                    let value = self.read(memory, at, size)?;
                    self.exclusive = Some(at);
                    self.set(rt, value);
                } else {
                    let succeeds = self.exclusive == Some(at);
                    if succeeds {
                        self.write(memory, at, size, self.get(rt))?;
                    }
                    self.exclusive = None;
                    self.set(rd, u32::from(!succeeds));
                }
            }
            Insn::LoadStoreMultiple {
                load,
                rn,
                list,
                wback,
                before,
            } => {
                return self.multiple(memory, load, rn, list, wback, before);
            }
            Insn::Mul {
                rd,
                rn,
                rm,
                ra,
                sub,
                s,
            } => {
                plain(&[rd])?;
                let product = self.get(rn).wrapping_mul(self.get(rm));
                let result = match ra {
                    None => product,
                    Some(ra) if sub => self.get(ra).wrapping_sub(product),
                    Some(ra) => self.get(ra).wrapping_add(product),
                };
                self.set(rd, result);
                if s && !keep_flags {
                    self.set_nz(result);
                }
            }
            Insn::MulLong {
                signed,
                accumulate,
                rdlo,
                rdhi,
                rn,
                rm,
                umaal,
            } => {
                plain(&[rdlo, rdhi])?;
                let (a, b) = (self.get(rn), self.get(rm));
                let product = if signed {
                    (i64::from(a as i32) * i64::from(b as i32)) as u64
                } else {
                    u64::from(a) * u64::from(b)
                };
                let (high, low) = (u64::from(self.get(rdhi)), u64::from(self.get(rdlo)));
                let addend = match (umaal, accumulate) {
                    (true, _) => high + low,
                    (false, true) => high << 32 | low,
                    (false, false) => 0,
                };
                let result = product.wrapping_add(addend);
                self.set(rdlo, result as u32);
                self.set(rdhi, (result >> 32) as u32);
                self.cycles += 1;
            }
            Insn::Div { signed, rd, rn, rm } => {
                plain(&[rd])?;
                let (a, b) = (self.get(rn), self.get(rm));
                let quotient = match (b, signed) {
                    (0, _) => 0,
                    (_, true) => (a as i32).wrapping_div(b as i32) as u32,
                    (_, false) => a / b,
                };
                self.set(rd, quotient);
                self.cycles += 2;
            }
            Insn::Extend {
                op,
                rd,
                rn: 15,
                rm,
                rotate,
            } => {
                plain(&[rd])?;
                let value = self.get(rm).rotate_right(u32::from(rotate));
                let value = match op {
                    ExtendOp::Sxtb => value as u8 as i8 as u32,
                    ExtendOp::Sxth => value as u16 as i16 as u32,
                    ExtendOp::Uxtb => value & 0xFF,
                    ExtendOp::Uxth => value & 0xFFFF,
                    _ => return Err(Leave),
                };
                self.set(rd, value);
            }
            Insn::Misc { op, rd, rm } => {
                plain(&[rd])?;
                let value = self.get(rm);
                let result = match op {
                    MiscOp::Clz => value.leading_zeros(),
                    MiscOp::Rbit => value.reverse_bits(),
                    MiscOp::Rev => value.swap_bytes(),
                    MiscOp::Rev16 => value.swap_bytes().rotate_left(16),
                    MiscOp::Revsh => (value as u16).swap_bytes() as i16 as u32,
                };
                self.set(rd, result);
            }
            Insn::Bitfield {
                op,
                rd,
                rn,
                lsb,
                width,
            } => {
                plain(&[rd])?;
                if width == 0 || u32::from(lsb) + u32::from(width) > 32 {
                    return Err(Leave);
                }
                let (lsb, width) = (u32::from(lsb), u32::from(width));
                let mask = u32::MAX >> (32 - width);
                let (from, old) = (self.get(rn), self.get(rd));
                let result = match op {
                    BitfieldOp::Ubfx => from >> lsb & mask,
                    BitfieldOp::Sbfx => {
                        ((from << (32 - width - lsb)) as i32 >> (32 - width)) as u32
                    }
                    BitfieldOp::Bfi => old & !(mask << lsb) | (from & mask) << lsb,
                    BitfieldOp::Bfc => old & !(mask << lsb),
                };
                self.set(rd, result);
            }
            Insn::Mrs { rd, sysm: PRIMASK } => {
                plain(&[rd])?;
                self.set(rd, u32::from(self.primask));
            }
            Insn::Msr {
                rn, sysm: PRIMASK, ..
            } => {
                plain(&[rn])?;
                self.set_primask(self.get(rn) & 1 != 0);
            }
            Insn::Cps {
                enable,
                i: true,
                f: false,
            } => {
                self.set_primask(!enable);
            }
            // Accesses happen one at a time and in order.
            Insn::Barrier { .. } => {}
            Insn::Hint {
                op: HintOp::Nop | HintOp::Yield | HintOp::Preload | HintOp::Dbg(_),
            } => {}
            Insn::Fp(insn) => {
                if self.fp_usable && !self.fp_loaded {
                    self.load_float(memory.cpu);
                }
                return self.float(memory, insn);
            }
            _ => return self.signal(insn),
        }
        Ok(())
    }

    #[inline(always)]
    pub(super) fn set_primask(&mut self, masked: bool) {
        self.primask = masked;
        self.unmasked |= !masked;
    }

    fn start_it(&mut self, cond: Cond, mask: u8) {
        self.it = cond.0 << 4 | mask;
    }

    fn data(&mut self, op: DpOp, flags: bool, rd: u8, rn: u8, operand: Operand) -> Done {
        let carry = self.carry();
        let (b, shifted_out) = match operand {
            Operand::Imm { value, carry: out } => (value, out.unwrap_or(carry)),
            Operand::Reg {
                rm,
                shift: Shift { ty, amount },
            } => shift(ty, self.get(rm), u32::from(amount), carry),
        };
        let a = self.get(rn);
        // Sums are a + b + carry with one operand perhaps inverted (A2.2.1, AddWithCarry).
        let (x, y, carry_in) = match op {
            DpOp::Add | DpOp::Cmn => (a, b, false),
            DpOp::Adc => (a, b, carry),
            DpOp::Sub | DpOp::Cmp => (a, !b, true),
            DpOp::Sbc => (a, !b, carry),
            DpOp::Rsb => (!a, b, true),
            _ => {
                let result = match op {
                    DpOp::And | DpOp::Tst => a & b,
                    DpOp::Bic => a & !b,
                    DpOp::Orr => a | b,
                    DpOp::Orn => a | !b,
                    DpOp::Eor | DpOp::Teq => a ^ b,
                    DpOp::Mov => b,
                    _ => !b,
                };
                self.result(op, rd, result)?;
                if flags {
                    self.set_nz(result);
                    self.set_c(shifted_out);
                }
                return Ok(());
            }
        };
        let wide = u64::from(x) + u64::from(y) + u64::from(carry_in);
        let result = wide as u32;
        self.result(op, rd, result)?;
        if flags {
            self.set_nz(result);
            self.set_c(wide >> 32 != 0);
            self.v = (x ^ result) & (y ^ result);
        }
        Ok(())
    }

    fn result(&mut self, op: DpOp, rd: u8, result: u32) -> Done {
        match (op.is_test(), rd) {
            (true, _) => {}
            (false, 15) => self.branch(result),
            (false, _) => self.set(rd, result),
        }
        Ok(())
    }
}

fn offset(base: u32, by: u32, add: bool) -> u32 {
    if add {
        base.wrapping_add(by)
    } else {
        base.wrapping_sub(by)
    }
}

/// Leaves what would write or read the program counter where that has a meaning of its own.
pub(super) fn plain(registers: &[u8]) -> Done {
    if registers.iter().all(|register| *register < 15) {
        Ok(())
    } else {
        Err(Leave)
    }
}
