//! From decoded instructions to micro-operations.
//!
//! An instruction that does more than these can express gives none: the program counter as an
//! operand or a result, unusual forms, unpredictable encodings.

use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn, UnaryOp};
use rsemu::cpu::arm::v7m::isa::{
    BitfieldOp, Cond, DpOp, ExtendOp, HintOp, Insn, MemOffset, MiscOp, Operand, Shift, ShiftType,
    Size,
};

use super::dsp::is_signal;
use super::execute::PRIMASK;
use super::micro::Op;

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
        Insn::Adr { rd, imm, add } if rd < 15 => Op::Set {
            d: rd,
            value: (place.pc() & !3).wrapping_add_signed(signed(imm, add)),
        },
        Insn::MovImm16 {
            top: false,
            rd,
            imm,
        } if rd < 15 => Op::Set {
            d: rd,
            value: u32::from(imm),
        },
        Insn::MovImm16 { top: true, rd, imm } if rd < 15 => Op::SetTop { d: rd, value: imm },
        Insn::Branch { cond, offset } => {
            let to = place.target(offset);
            match cond {
                None | Some(Cond(14..)) => Op::Branch { to },
                Some(Cond(0)) => Op::BranchEqual { to },
                Some(Cond(1)) => Op::BranchUnequal { to },
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
        } if rn < 15 => {
            let to = place.target(offset as i32);
            if nonzero {
                Op::BranchNonzero { n: rn, to }
            } else {
                Op::BranchZero { n: rn, to }
            }
        }
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
                ExtendOp::Sxtb => Op::SignedByte { d, m },
                ExtendOp::Sxth => Op::SignedHalf { d, m },
                ExtendOp::Uxtb => Op::UnsignedByte { d, m },
                ExtendOp::Uxth => Op::UnsignedHalf { d, m },
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
            BitfieldOp::Ubfx if rn < 15 => Op::Extract {
                d: rd,
                n: rn,
                lsb,
                width,
            },
            BitfieldOp::Bfi if rn < 15 => Op::Insert {
                d: rd,
                n: rn,
                lsb,
                width,
            },
            BitfieldOp::Bfc => Op::AndImm {
                d: rd,
                n: rd,
                value: !(u32::MAX >> (32 - width) << lsb),
            },
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
        } => Op::Nop,
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
        ) if rm < 15 => Some(Op::AddImm {
            d,
            n: rm,
            value: place.pc(),
        }),
        (
            DpOp::Add,
            _,
            Operand::Reg {
                rm: 15,
                shift: Shift::NONE,
            },
        ) if n < 15 => Some(Op::AddImm {
            d,
            n,
            value: place.pc(),
        }),
        (
            DpOp::Mov,
            _,
            Operand::Reg {
                rm: 15,
                shift: Shift::NONE,
            },
        ) => Some(Op::Set {
            d,
            value: place.pc(),
        }),
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
        (DpOp::Mov, false) => Op::Set { d, value },
        (DpOp::Mov, true) if !sets_c => Op::SetNz { d, value },
        (DpOp::Mvn, false) => Op::Set { d, value: !value },
        (DpOp::Add, false) => Op::AddImm { d, n, value },
        (DpOp::Sub, false) => Op::AddImm {
            d,
            n,
            value: value.wrapping_neg(),
        },
        (DpOp::Add, true) => Op::AddImmNzcv { d, n, value },
        (DpOp::Sub, true) => Op::SubImmNzcv { d, n, value },
        (DpOp::Rsb, false) => Op::RsbImm { d, n, value },
        (DpOp::Cmp, _) => Op::CompareImm { n, value },
        (DpOp::And, false) => Op::AndImm { d, n, value },
        (DpOp::Bic, false) => Op::AndImm {
            d,
            n,
            value: !value,
        },
        (DpOp::Orr, false) => Op::OrrImm { d, n, value },
        (DpOp::Orn, false) => Op::OrrImm {
            d,
            n,
            value: !value,
        },
        (DpOp::Eor, false) => Op::EorImm { d, n, value },
        (DpOp::Tst, _) if !sets_c => Op::TestImm { n, value },
        _ => return None,
    })
}

fn data_reg(op: DpOp, flags: bool, d: u8, n: u8, m: u8) -> Option<Op> {
    Some(match (op, flags) {
        (DpOp::Mov, false) => Op::Move { d, m },
        (DpOp::Mov, true) => Op::MoveNz { d, m },
        (DpOp::Add, false) => Op::Add { d, n, m },
        (DpOp::Add, true) => Op::AddNzcv { d, n, m },
        (DpOp::Sub, false) => Op::Sub { d, n, m },
        (DpOp::Sub, true) => Op::SubNzcv { d, n, m },
        (DpOp::Cmp, _) => Op::Compare { n, m },
        (DpOp::And, false) => Op::And { d, n, m },
        (DpOp::Orr, false) => Op::Orr { d, n, m },
        (DpOp::Eor, false) => Op::Eor { d, n, m },
        (DpOp::Bic, false) => Op::Bic { d, n, m },
        (DpOp::And, true) => Op::AndNz { d, n, m },
        (DpOp::Orr, true) => Op::OrrNz { d, n, m },
        (DpOp::Eor, true) => Op::EorNz { d, n, m },
        (DpOp::Bic, true) => Op::BicNz { d, n, m },
        _ => return None,
    })
}

fn data_shifted(op: DpOp, flags: bool, d: u8, n: u8, m: u8, shift: Shift) -> Option<Op> {
    let by = shift.amount;
    if !(1..32).contains(&by) {
        return None;
    }
    Some(match (op, flags, shift.ty) {
        (DpOp::Mov, false, ShiftType::Lsl) => Op::Lsl { d, m, by },
        (DpOp::Mov, false, ShiftType::Lsr) => Op::Lsr { d, m, by },
        (DpOp::Mov, false, ShiftType::Asr) => Op::Asr { d, m, by },
        (DpOp::Mov, true, ShiftType::Lsl) => Op::LslNzc { d, m, by },
        (DpOp::Mov, true, ShiftType::Lsr) => Op::LsrNzc { d, m, by },
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
    Some(match offset {
        MemOffset::Imm(imm) if index && !wback => {
            let by = signed(imm, add);
            match (load, size, extends) {
                (true, Size::Word, _) => Op::Load { t, n, by },
                (true, Size::Byte, false) => Op::LoadByte { t, n, by },
                (true, Size::Half, false) => Op::LoadHalf { t, n, by },
                (true, Size::Byte, true) => Op::LoadSignedByte { t, n, by },
                (true, Size::Half, true) => Op::LoadSignedHalf { t, n, by },
                (false, Size::Word, _) => Op::Store { t, n, by },
                (false, Size::Byte, _) => Op::StoreByte { t, n, by },
                (false, Size::Half, _) => Op::StoreHalf { t, n, by },
            }
        }
        MemOffset::Imm(imm) if wback && n != t => {
            let by = i16::try_from(signed(imm, add)).ok()?;
            match (load, size, extends) {
                (true, Size::Word, _) => Op::LoadMove { t, n, index, by },
                (true, Size::Byte, false) => Op::LoadByteMove { t, n, index, by },
                (false, Size::Word, _) => Op::StoreMove { t, n, index, by },
                (false, Size::Byte, _) => Op::StoreByteMove { t, n, index, by },
                _ => return None,
            }
        }
        MemOffset::Reg { rm: m, lsl } if index && !wback && add && lsl < 4 => {
            match (load, size, extends) {
                (true, Size::Word, _) => Op::LoadAt { t, n, m, lsl },
                (true, Size::Byte, false) => Op::LoadByteAt { t, n, m, lsl },
                (true, Size::Half, false) => Op::LoadHalfAt { t, n, m, lsl },
                (false, Size::Word, _) => Op::StoreAt { t, n, m, lsl },
                (false, Size::Byte, _) => Op::StoreByteAt { t, n, m, lsl },
                (false, Size::Half, _) => Op::StoreHalfAt { t, n, m, lsl },
                _ => return None,
            }
        }
        _ => return None,
    })
}

fn float(insn: FpInsn, place: Place<'_>) -> Option<Op> {
    Some(match insn {
        FpInsn::Data { op, d, n, m } => match op {
            DataOp::Add => Op::FloatAdd { d, n, m },
            DataOp::Sub => Op::FloatSub { d, n, m },
            DataOp::Mul => Op::FloatMul { d, n, m },
            DataOp::Mla => Op::FloatMulAdd { d, n, m },
            DataOp::Mls => Op::FloatMulSub { d, n, m },
            _ => return None,
        },
        FpInsn::Unary { op, d, m } => match op {
            UnaryOp::Mov => Op::FloatMove { d, m },
            UnaryOp::Neg => Op::FloatNeg { d, m },
            UnaryOp::Abs => Op::FloatAbs { d, m },
            _ => return None,
        },
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
