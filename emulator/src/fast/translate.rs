//! From decoded instructions to micro-operations.
//!
//! An instruction that does more than these can express gives none: the program counter as an
//! operand or a result, unusual forms, unpredictable encodings.

use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn, UnaryOp};
use rsemu::cpu::arm::v7m::isa::{
    BitfieldOp, Cond, DpOp, ExtendOp, HintOp, Insn, MemOffset, MiscOp, Operand, Shift, ShiftType,
    Size,
};

use super::dsp::is_signal;
use super::execute::PRIMASK;
use super::micro::{AND, FLAGS, NOTHING, Op, UNREAD, WITH_C, XOR, Z, ZERO};

/// Bytes of code per page.
pub(super) const PAGE: usize = 4096;

/// What is around an instruction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) address: u32,
    pub(super) length: u32,
    /// In an IT block, where 16-bit instructions set no flags.
    pub(super) in_it: bool,
    /// The page, for constants.
    pub(super) page: &'a [u8],
}

impl Place<'_> {
    /// The program counter as the instruction reads it.
    fn pc(self) -> u32 {
        self.address.wrapping_add(4)
    }

    /// Where a branch leads, in halfwords from the page's beginning.
    fn target(self, by: i32) -> u32 {
        let to = self.pc().wrapping_add_signed(by);
        to.wrapping_sub(self.address / PAGE as u32 * PAGE as u32) >> 1
    }

    /// A word of the page at an address relative to the aligned program counter: its offset and its
    /// value.
    fn constant(self, by: i32) -> Option<(u16, u32)> {
        let at = (self.pc() & !3).wrapping_add_signed(by);
        let offset = at.wrapping_sub(self.address / PAGE as u32 * PAGE as u32);
        let word = self.page.get(offset as usize..)?.first_chunk()?;
        Some((u16::try_from(offset).ok()?, u32::from_le_bytes(*word)))
    }
}

fn signed(by: u32, add: bool) -> i32 {
    if add {
        by as i32
    } else {
        (by as i32).wrapping_neg()
    }
}

fn all_plain(registers: &[u8]) -> bool {
    registers.iter().all(|register| *register < 15)
}

/// The micro-operation of an instruction.
pub(super) fn translate(insn: &Insn, place: Place<'_>) -> Op {
    special(insn, place).unwrap_or(Op::Other)
}

fn special(insn: &Insn, place: Place<'_>) -> Option<Op> {
    let sets_flags = |s: bool| s && !(place.in_it && place.length == 2);
    Some(match *insn {
        Insn::DataProc {
            op,
            s,
            rd,
            rn,
            operand,
        } => {
            let flags = sets_flags(s) || op.is_test();
            let rm = match operand {
                Operand::Imm { .. } => 0,
                Operand::Reg { rm, .. } => rm,
            };
            let rd = if op.is_test() { 0 } else { rd };
            let rn = if op.is_unary() { 0 } else { rn };
            if !all_plain(&[rd, rn, rm]) {
                return address(op, s, rd, rn, operand, place);
            }
            data(op, flags, rd, rn, operand).unwrap_or(Op::Plain)
        }
        Insn::Adr { rd, imm, add } if rd < 15 => {
            Op::set(rd, (place.pc() & !3).wrapping_add_signed(signed(imm, add)))
        }
        Insn::MovImm16 {
            top: false,
            rd,
            imm,
        } if rd < 15 => Op::set(rd, u32::from(imm)),
        Insn::MovImm16 { top: true, rd, imm } if rd < 15 => Op::SetTop { d: rd, value: imm },
        Insn::Branch { cond, offset } => {
            let to = place.target(offset);
            match cond {
                None | Some(Cond(14..)) => Op::branch(ZERO, false, to),
                Some(Cond(0)) => Op::branch(Z, false, to),
                Some(Cond(1)) => Op::branch(Z, true, to),
                Some(Cond(cond)) => Op::BranchIf { cond, to },
            }
        }
        Insn::BranchLink { offset } => Op::BranchLink {
            to: place.target(offset),
        },
        Insn::Bx { rm } if rm < 15 => Op::BranchTo { m: rm },
        Insn::Blx { rm } if rm < 15 => Op::BranchLinkTo { m: rm },
        Insn::Cbz {
            nonzero,
            rn,
            offset,
        } if rn < 15 => Op::branch(rn, nonzero, place.target(offset as i32)),
        // One in a block is unpredictable.
        Insn::It { cond, mask } if !place.in_it => Op::It { cond: cond.0, mask },
        Insn::LoadStore {
            unpriv: false,
            rt,
            rn,
            offset,
            ..
        } if all_plain(&[rt, rn]) => {
            if matches!(offset, MemOffset::Reg { rm: 15, .. }) {
                return None;
            }
            return memory(insn);
        }
        Insn::LoadLiteral {
            size: Size::Word,
            signed: false,
            rt,
            imm,
            add,
        } if rt < 15 => {
            let (from, value) = place.constant(signed(imm, add))?;
            let t = rt;
            Op::Constant { t, from, value }
        }
        Insn::LoadStoreDual {
            load,
            rt,
            rt2,
            rn,
            imm,
            index: true,
            add,
            wback: false,
        } if all_plain(&[rt, rt2, rn]) => {
            let by = i16::try_from(signed(imm, add)).ok()?;
            let (t, t2, n) = (rt, rt2, rn);
            if load {
                Op::LoadTwo { t, t2, n, by }
            } else {
                Op::StoreTwo { t, t2, n, by }
            }
        }
        Insn::LoadStoreMultiple {
            load,
            rn,
            list,
            wback,
            before,
        } if rn < 15 => Op::Multiple {
            load,
            n: rn,
            wback,
            before,
            list,
        },
        Insn::Mul {
            rd,
            rn,
            rm,
            ra: None,
            s,
            ..
        } if all_plain(&[rd, rn, rm]) && !sets_flags(s) => Op::Mul {
            d: rd,
            n: rn,
            m: rm,
        },
        Insn::Mul {
            rd,
            rn,
            rm,
            ra: Some(a),
            sub: false,
            s: false,
        } if all_plain(&[rd, rn, rm, a]) => Op::MulAdd {
            d: rd,
            n: rn,
            m: rm,
            a,
        },
        Insn::MulLong {
            signed: false,
            accumulate: false,
            rdlo,
            rdhi,
            rn,
            rm,
            umaal: false,
        } if all_plain(&[rdlo, rdhi, rn, rm]) => Op::Umull {
            low: rdlo,
            high: rdhi,
            n: rn,
            m: rm,
        },
        Insn::MulLong {
            rdlo,
            rdhi,
            rn,
            rm,
            umaal: true,
            ..
        } if all_plain(&[rdlo, rdhi, rn, rm]) => Op::Umaal {
            low: rdlo,
            high: rdhi,
            n: rn,
            m: rm,
        },
        Insn::Extend {
            op,
            rd,
            rn: 15,
            rm,
            rotate: 0,
        } if all_plain(&[rd, rm]) => {
            let (d, m) = (rd, rm);
            match op {
                ExtendOp::Sxtb => Op::shifted_signed(d, m, 24, 24),
                ExtendOp::Sxth => Op::shifted_signed(d, m, 16, 16),
                ExtendOp::Uxtb => Op::shifted(d, m, 24, 24),
                ExtendOp::Uxth => Op::shifted(d, m, 16, 16),
                _ => return None,
            }
        }
        Insn::Misc {
            op: MiscOp::Clz,
            rd,
            rm,
        } if all_plain(&[rd, rm]) => Op::CountZeros { d: rd, m: rm },
        Insn::Bitfield {
            op,
            rd,
            rn,
            lsb,
            width,
        } if rd < 15 && (1..=32).contains(&width) && lsb < 32 && lsb + width <= 32 => match op {
            BitfieldOp::Ubfx if rn < 15 => Op::shifted(rd, rn, 32 - lsb - width, 32 - width),
            BitfieldOp::Sbfx if rn < 15 => Op::shifted_signed(rd, rn, 32 - lsb - width, 32 - width),
            BitfieldOp::Bfi if rn < 15 => Op::Insert {
                d: rd,
                n: rn,
                lsb,
                width,
            },
            BitfieldOp::Bfc => Op::logic(rd, rd, ZERO, !(u32::MAX >> (32 - width) << lsb), AND),
            _ => return None,
        },
        Insn::Mrs { rd, sysm: PRIMASK } if rd < 15 => Op::Primask { d: rd },
        Insn::Msr {
            rn, sysm: PRIMASK, ..
        } if rn < 15 => Op::SetPrimask { n: rn },
        Insn::Cps {
            enable,
            i: true,
            f: false,
        } => Op::Interrupts { enable },
        Insn::Barrier { .. }
        | Insn::Hint {
            op: HintOp::Nop | HintOp::Yield | HintOp::Preload | HintOp::Dbg(_),
        } => NOTHING,
        Insn::ShiftReg {
            ty: ShiftType::Lsl,
            s,
            rd: d,
            rn: n,
            rm: m,
        } if all_plain(&[d, n, m]) && !sets_flags(s) => Op::LslBy { d, n, m },
        Insn::ShiftReg {
            ty: ShiftType::Lsr,
            s,
            rd: d,
            rn: n,
            rm: m,
        } if all_plain(&[d, n, m]) && !sets_flags(s) => Op::LsrBy { d, n, m },
        Insn::ShiftReg { rd, rn, rm, .. } if all_plain(&[rd, rn, rm]) => Op::Plain,
        Insn::Mul { rd, rn, rm, ra, .. } if all_plain(&[rd, rn, rm, ra.unwrap_or(0)]) => Op::Plain,
        Insn::MulLong {
            rdlo, rdhi, rn, rm, ..
        } if all_plain(&[rdlo, rdhi, rn, rm]) => Op::Plain,
        Insn::Div { rd, rn, rm, .. } if all_plain(&[rd, rn, rm]) => Op::Plain,
        Insn::Misc { rd, rm, .. } if all_plain(&[rd, rm]) => Op::Plain,
        _ if is_signal(insn) => Op::Plain,
        Insn::Fp(insn) if !insn.needs_v5() => float(insn, place).unwrap_or(Op::Float),
        _ => return None,
    })
}

/// ADD and MOV with the program counter as an operand.
fn address(op: DpOp, s: bool, d: u8, n: u8, operand: Operand, place: Place<'_>) -> Option<Op> {
    if s || d >= 15 {
        return None;
    }
    match (op, n, operand) {
        (
            DpOp::Add,
            15,
            Operand::Reg {
                rm,
                shift: Shift::NONE,
            },
        ) if rm < 15 => Some(Op::add(d, rm, place.pc(), false)),
        (
            DpOp::Add,
            _,
            Operand::Reg {
                rm: 15,
                shift: Shift::NONE,
            },
        ) if n < 15 => Some(Op::add(d, n, place.pc(), false)),
        (
            DpOp::Mov,
            _,
            Operand::Reg {
                rm: 15,
                shift: Shift::NONE,
            },
        ) => Some(Op::set(d, place.pc())),
        _ => None,
    }
}

fn data(op: DpOp, flags: bool, d: u8, n: u8, operand: Operand) -> Option<Op> {
    match operand {
        Operand::Imm { value, carry } => data_imm(op, flags, d, n, value, carry.is_some()),
        Operand::Reg {
            rm: m,
            shift: Shift::NONE,
        } => data_reg(op, flags, d, n, m),
        Operand::Reg { rm: m, shift } => data_shifted(op, flags, d, n, m, shift),
    }
}

/// `sets_c`: the constant's expansion gives the carry where the operation itself does not.
fn data_imm(op: DpOp, flags: bool, d: u8, n: u8, value: u32, sets_c: bool) -> Option<Op> {
    Some(match (op, flags) {
        (DpOp::Mov, false) => Op::set(d, value),
        (DpOp::Mov, true) if !sets_c => Op::add(d, ZERO, value, true),
        (DpOp::Mvn, false) => Op::set(d, !value),
        (DpOp::Add, false) => Op::add(d, n, value, false),
        (DpOp::Sub, false) => Op::add(d, n, value.wrapping_neg(), false),
        (DpOp::Add, true) => Op::sum(d, n, ZERO, value),
        (DpOp::Sub, true) => Op::difference(d, n, ZERO, value),
        (DpOp::Adc, true) => Op::sum(d, n, ZERO | WITH_C, value),
        (DpOp::Sbc, true) => Op::sum(d, n, ZERO | WITH_C, !value),
        (DpOp::Rsb, false) => Op::RsbImm { d, n, value },
        (DpOp::Cmp, _) => Op::difference(UNREAD, n, ZERO, value),
        (DpOp::And, false) => Op::logic(d, n, ZERO, value, AND),
        (DpOp::Bic, false) => Op::logic(d, n, ZERO, !value, AND),
        (DpOp::Orr, false) => Op::logic(d, n, ZERO, value, AND | XOR),
        (DpOp::Orn, false) => Op::logic(d, n, ZERO, !value, AND | XOR),
        (DpOp::Eor, false) => Op::logic(d, n, ZERO, value, XOR),
        (DpOp::Tst, _) if !sets_c => Op::logic(UNREAD, n, ZERO, value, AND | FLAGS),
        _ => return None,
    })
}

fn data_reg(op: DpOp, flags: bool, d: u8, n: u8, m: u8) -> Option<Op> {
    Some(match (op, flags) {
        (DpOp::Mov, false) => Op::add(d, m, 0, false),
        (DpOp::Mov, true) => Op::add(d, m, 0, true),
        (DpOp::Add, false) => Op::AddLsl { d, n, m, by: 0 },
        (DpOp::Add, true) => Op::sum(d, n, m, 0),
        (DpOp::Sub, false) => Op::Sub { d, n, m },
        (DpOp::Sub, true) => Op::difference(d, n, m, 0),
        (DpOp::Adc, true) => Op::sum(d, n, m | WITH_C, 0),
        (DpOp::Sbc, true) => Op::sum(d, n, m | WITH_C, !0),
        (DpOp::Cmp, _) => Op::difference(UNREAD, n, m, 0),
        (DpOp::And, false) => Op::logic(d, n, m, 0, AND),
        (DpOp::Orr, false) => Op::logic(d, n, m, 0, AND | XOR),
        (DpOp::Eor, false) => Op::logic(d, n, m, 0, XOR),
        (DpOp::Bic, false) => Op::logic(d, n, m, !0, AND),
        (DpOp::And, true) => Op::logic(d, n, m, 0, AND | FLAGS),
        (DpOp::Orr, true) => Op::logic(d, n, m, 0, AND | XOR | FLAGS),
        (DpOp::Eor, true) => Op::logic(d, n, m, 0, XOR | FLAGS),
        (DpOp::Bic, true) => Op::logic(d, n, m, !0, AND | FLAGS),
        _ => return None,
    })
}

fn data_shifted(op: DpOp, flags: bool, d: u8, n: u8, m: u8, shift: Shift) -> Option<Op> {
    let by = shift.amount;
    if !(1..32).contains(&by) {
        return None;
    }
    Some(match (op, flags, shift.ty) {
        (DpOp::Mov, false, ShiftType::Lsl) => Op::shifted(d, m, by, 0),
        (DpOp::Mov, false, ShiftType::Lsr) => Op::shifted(d, m, 0, by),
        (DpOp::Mov, false, ShiftType::Asr) => Op::shifted_signed(d, m, 0, by),
        (DpOp::Mov, true, ShiftType::Lsl) => Op::ShiftNzc {
            d,
            n: m,
            up: by,
            down: 0,
            carry: 32 - by,
        },
        (DpOp::Mov, true, ShiftType::Lsr) => Op::ShiftNzc {
            d,
            n: m,
            up: 0,
            down: by,
            carry: by - 1,
        },
        (DpOp::Add, false, ShiftType::Lsl) => Op::AddLsl { d, n, m, by },
        (DpOp::Orr, false, ShiftType::Lsl) => Op::OrrLsl { d, n, m, by },
        (DpOp::Orr, false, ShiftType::Lsr) => Op::OrrLsr { d, n, m, by },
        (DpOp::Eor, false, ShiftType::Lsl) => Op::EorLsl { d, n, m, by },
        (DpOp::Eor, false, ShiftType::Lsr) => Op::EorLsr { d, n, m, by },
        _ => return None,
    })
}

/// A load or store of one register.
fn memory(insn: &Insn) -> Option<Op> {
    let Insn::LoadStore {
        load,
        size,
        signed: extends,
        rt: t,
        rn: n,
        offset,
        index,
        add,
        wback,
        ..
    } = *insn
    else {
        return None;
    };
    let width = match size {
        Size::Byte => Width::U8,
        Size::Half => Width::U16,
        Size::Word => Width::U32,
    };
    let (m, lsl, by) = match offset {
        MemOffset::Imm(imm) => (ZERO, 0, i16::try_from(signed(imm, add)).ok()?),
        MemOffset::Reg { rm: m, lsl } if add && lsl < 4 && !wback => (m, lsl, 0),
        MemOffset::Reg { .. } => return None,
    };
    let extends = load && extends && size != Size::Word;
    Some(match (load, extends, wback) {
        (true, false, false) if index => Op::Load {
            t,
            n,
            m,
            lsl,
            width,
            by,
        },
        (false, false, false) if index => Op::Store {
            t,
            n,
            m,
            lsl,
            width,
            by,
        },
        (true, true, false) if index && m == ZERO => Op::LoadSigned { t, n, width, by },
        (true, false, true) if n != t => Op::LoadMove {
            t,
            n,
            width,
            index,
            by,
        },
        (false, false, true) if n != t => Op::StoreMove {
            t,
            n,
            width,
            index,
            by,
        },
        _ => return None,
    })
}

fn float(insn: FpInsn, place: Place<'_>) -> Option<Op> {
    Some(match insn {
        FpInsn::Data { op, d, n, m } => match op {
            DataOp::Add | DataOp::Sub => {
                let subtracts = op == DataOp::Sub;
                Op::FloatAdd { d, n, m, subtracts }
            }
            DataOp::Mul => Op::FloatMul { d, n, m },
            DataOp::Mla | DataOp::Mls => {
                let negates = op == DataOp::Mls;
                Op::FloatMulAdd { d, n, m, negates }
            }
            _ => return None,
        },
        FpInsn::Unary { op, d, m } => {
            let (clears, flips) = match op {
                UnaryOp::Mov => (false, false),
                UnaryOp::Neg => (false, true),
                UnaryOp::Abs => (true, false),
                _ => return None,
            };
            Op::FloatMove {
                d,
                m,
                clears,
                flips,
            }
        }
        FpInsn::MovImm { d, imm } => Op::FloatSet { d, value: imm },
        FpInsn::MovCore { to_fp: true, rt, n } if rt < 15 => Op::FloatFrom { d: n, t: rt },
        FpInsn::MovCore {
            to_fp: false,
            rt,
            n,
        } if rt < 15 => Op::FloatTo { t: rt, m: n },
        FpInsn::Cmp {
            d,
            m,
            with_zero: false,
            signal_all: false,
        } => Op::FloatCompare { d, m },
        FpInsn::Cmp {
            d,
            with_zero: true,
            signal_all: false,
            ..
        } => Op::FloatCompareZero { d },
        FpInsn::Sys {
            to_core: true,
            rt: 15,
            reg: 1,
        } => Op::FloatFlags,
        FpInsn::Mem {
            load: true,
            d,
            rn: 15,
            imm,
            add,
            double: false,
        } => match place.constant(signed(imm, add)) {
            Some((from, value)) => Op::FloatConstant { d, from, value },
            None => Op::Other,
        },
        // Relative to the program counter.
        FpInsn::Mem { rn: 15, .. } => return Some(Op::Other),
        FpInsn::Mem {
            load,
            d,
            rn: n,
            imm,
            add,
            double: false,
        } => {
            let by = i16::try_from(signed(imm, add)).ok()?;
            if load {
                Op::FloatLoad { d, n, by }
            } else {
                Op::FloatStore { d, n, by }
            }
        }
        _ => return None,
    })
}
