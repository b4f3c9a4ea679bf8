//! Micro-operations: the frequent instructions with everything precomputed that does not depend on
//! the registers.
//!
//! An instruction becomes a micro-operation when it is decoded, once for all boards that run the
//! image. Branches know their place in the page here, in halfwords, other addresses relative to the
//! program counter are absolute, constants from flash are values, and whether the flags are set is
//! part of the operation. No register of a micro-operation is the program counter. An instruction
//! without a micro-operation of its own is [`Op::Other`], the decoded instruction, executed by
//! `execute.rs`, `transfer.rs` and `float.rs`.
//!
//! A micro-operation stands for as many instructions as it can: a move is the sum with a register
//! that is always zero, a comparison a difference that nothing reads. What comes next is predicted
//! the better the fewer kinds there are (docs/adr/0003-emulated-core.md), and that costs more than
//! an addition of zero.

use rsemu::core::value::Width;

use crate::memory_map::FLASH_BASE;

/// Registers: `d` result, `n` and `m` operands, `t` transferred.
#[rustfmt::skip] // one line each, as a table
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Op {
    /// The decoded instruction; this too where there is none.
    Other,
    /// A decoded instruction on registers other than the program counter, that neither branches nor
    /// reaches memory.
    Plain,
    /// A decoded floating-point instruction of the same kind, or one that loads or stores.
    Float,
    It { cond: u8, mask: u8 },
    Interrupts { enable: bool },
    SetPrimask { n: u8 },
    Primask { d: u8 },

    /// `n` plus a constant, and a move of either. `flags`: sets N and Z.
    AddImm { d: u8, n: u8, flags: bool, value: u32 },
    SetTop { d: u8, value: u16 },
    Sub { d: u8, n: u8, m: u8 },
    /// `n` plus (`m` xor `flip`) with all four flags, and 1 more if `m` says [`WITH_ONE`], flag C
    /// more if it says [`WITH_C`]. A difference is the sum with all bits flipped, and 1.
    Sum { d: u8, n: u8, m: u8, flip: u32 },
    RsbImm { d: u8, n: u8, value: u32 },
    /// `n` with (`m` xor `flip`): what both have if `m` says [`AND`], what one has if it says
    /// [`XOR`], what either has if it says both; N and Z if it says [`FLAGS`].
    Logic { d: u8, n: u8, m: u8, flip: u32 },
    /// Two registers and an amount of at most 31: `n` op (`m` shifted).
    AddLsl { d: u8, n: u8, m: u8, by: u8 },
    OrrLsl { d: u8, n: u8, m: u8, by: u8 },
    OrrLsr { d: u8, n: u8, m: u8, by: u8 },
    EorLsl { d: u8, n: u8, m: u8, by: u8 },
    EorLsr { d: u8, n: u8, m: u8, by: u8 },
    /// To the left, then to the right: shifts, extensions, fields of bits.
    Shift { d: u8, n: u8, up: u8, down: u8 },
    ShiftSigned { d: u8, n: u8, up: u8, down: u8 },
    /// Flags N and Z, and one bit as C.
    ShiftNzc { d: u8, n: u8, up: u8, down: u8, carry: u8 },
    /// By the low byte of a register.
    LslBy { d: u8, n: u8, m: u8 },
    LsrBy { d: u8, n: u8, m: u8 },
    Mul { d: u8, n: u8, m: u8 },
    MulAdd { d: u8, n: u8, m: u8, a: u8 },
    Umull { low: u8, high: u8, n: u8, m: u8 },
    /// Adds both halves, each for itself.
    Umaal { low: u8, high: u8, n: u8, m: u8 },
    Insert { d: u8, n: u8, lsb: u8, width: u8 },
    CountZeros { d: u8, m: u8 },

    BranchIf { cond: u8, to: u32 },
    BranchLink { to: u32 },
    BranchTo { m: u8 },
    BranchLinkTo { m: u8 },
    /// Also on flag Z, which is a register here, and always, as one is always zero.
    BranchZero { n: u8, nonzero: bool, to: u32 },

    /// A constant from this page: its offset there, and the value.
    Constant { t: u8, from: u16, value: u32 },
    /// At `n` plus `by` plus (`m` shifted to the left).
    Load { t: u8, n: u8, m: u8, lsl: u8, width: Width, by: i16 },
    LoadSigned { t: u8, n: u8, width: Width, by: i16 },
    Store { t: u8, n: u8, m: u8, lsl: u8, width: Width, by: i16 },
    /// Writes the address back: before the access when `index`, otherwise after it.
    LoadMove { t: u8, n: u8, width: Width, index: bool, by: i16 },
    StoreMove { t: u8, n: u8, width: Width, index: bool, by: i16 },
    LoadTwo { t: u8, t2: u8, n: u8, by: i16 },
    StoreTwo { t: u8, t2: u8, n: u8, by: i16 },
    Multiple { load: bool, n: u8, wback: bool, before: bool, list: u16 },

    FloatAdd { d: u8, n: u8, m: u8, subtracts: bool },
    FloatMul { d: u8, n: u8, m: u8 },
    /// With its sign, without it, or with the other one.
    FloatMove { d: u8, m: u8, clears: bool, flips: bool },
    FloatSet { d: u8, value: u32 },
    FloatFrom { d: u8, t: u8 },
    FloatTo { t: u8, m: u8 },
    FloatLoad { d: u8, n: u8, by: i16 },
    FloatStore { d: u8, n: u8, by: i16 },
    FloatConstant { d: u8, from: u16, value: u32 },
    FloatCompare { d: u8, m: u8 },
    FloatCompareZero { d: u8 },
    /// `d` plus the product, or minus it, each rounded.
    FloatMulAdd { d: u8, n: u8, m: u8, negates: bool },
    FloatFlags,
}

/// Registers of micro-operations: the core's and, from 16 on, what no instruction can name. A power
/// of two, so that an index needs no check; bits of a number beyond it are ignored.
pub(super) const REGISTERS: usize = 32;
/// Always zero.
pub(super) const ZERO: u8 = 16;
/// For results that nothing reads.
pub(super) const UNREAD: u8 = 17;
/// The result that flag Z derives from: set when this is zero.
pub(super) const Z: u8 = 18;

/// With the register `m` of a sum: 1 is added, or flag C.
pub(super) const WITH_ONE: u8 = 0x40;
pub(super) const WITH_C: u8 = 0x80;

/// With the register `m` of a logical operation.
pub(super) const AND: u8 = 0x20;
pub(super) const XOR: u8 = 0x40;
pub(super) const FLAGS: u8 = 0x80;

impl Op {
    /// A register is set to a value.
    pub(super) fn set(d: u8, value: u32) -> Self {
        Self::add(d, ZERO, value, false)
    }

    /// A register plus a value; `flags`: sets N and Z.
    pub(super) fn add(d: u8, n: u8, value: u32, flags: bool) -> Self {
        Self::AddImm { d, n, flags, value }
    }

    /// A sum with all flags, of two registers with a `flip` of zero, or of one and [`ZERO`] with
    /// the other operand as `flip`.
    pub(super) fn sum(d: u8, n: u8, m: u8, flip: u32) -> Self {
        Self::Sum { d, n, m, flip }
    }

    /// The same of a difference.
    pub(super) fn difference(d: u8, n: u8, m: u8, value: u32) -> Self {
        Self::sum(d, n, m | WITH_ONE, !value)
    }

    /// What [`AND`], [`XOR`] and [`FLAGS`] say.
    pub(super) fn logic(d: u8, n: u8, m: u8, flip: u32, what: u8) -> Self {
        let m = m | what;
        Self::Logic { d, n, m, flip }
    }

    pub(super) fn shifted(d: u8, n: u8, up: u8, down: u8) -> Self {
        Self::Shift { d, n, up, down }
    }

    pub(super) fn shifted_signed(d: u8, n: u8, up: u8, down: u8) -> Self {
        Self::ShiftSigned { d, n, up, down }
    }

    /// A branch if a register is zero, or if it is not.
    pub(super) fn branch(n: u8, nonzero: bool, to: u32) -> Self {
        Self::BranchZero { n, nonzero, to }
    }
}

/// All ones if a logical operation's `m` says this, otherwise zero.
#[inline(always)]
pub(super) fn chosen(m: u8, what: u8) -> u32 {
    u32::from(m & what != 0).wrapping_neg()
}

/// Changes nothing.
pub(super) const NOTHING: Op = Op::AddImm {
    d: UNREAD,
    n: ZERO,
    flags: false,
    value: 0,
};

/// So many ones, 1 to 32.
#[inline(always)]
pub(super) fn mask(width: u8) -> u32 {
    u32::MAX >> (32_u8.wrapping_sub(width) & 31)
}

/// Offset in the flash of one in the page that begins at `base`.
#[inline(always)]
pub(super) fn offset(base: u32, at: u16) -> u32 {
    base.wrapping_sub(FLASH_BASE).wrapping_add(u32::from(at))
}
