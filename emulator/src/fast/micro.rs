//! Micro-operations: the frequent instructions with everything precomputed that does not depend on
//! the registers.
//!
//! An instruction becomes a micro-operation when it is decoded, once for all boards that run the
//! image. Branches know their place in the page here, in halfwords, other addresses relative to the
//! program counter are absolute, constants from flash are values, and whether the flags are set is
//! part of the operation. No register of a micro-operation is the program counter. An instruction
//! without a micro-operation of its own is [`Op::Other`], the decoded instruction, executed by
//! `execute.rs`, `transfer.rs` and `float.rs`.

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
    Nop,
    It { cond: u8, mask: u8 },
    Interrupts { enable: bool },
    SetPrimask { n: u8 },
    Primask { d: u8 },

    Set { d: u8, value: u32 },
    /// Flags N and Z.
    SetNz { d: u8, value: u32 },
    SetTop { d: u8, value: u16 },
    Move { d: u8, m: u8 },
    MoveNz { d: u8, m: u8 },
    Add { d: u8, n: u8, m: u8 },
    AddImm { d: u8, n: u8, value: u32 },
    Sub { d: u8, n: u8, m: u8 },
    /// All four flags.
    AddNzcv { d: u8, n: u8, m: u8 },
    AddImmNzcv { d: u8, n: u8, value: u32 },
    SubNzcv { d: u8, n: u8, m: u8 },
    SubImmNzcv { d: u8, n: u8, value: u32 },
    RsbImm { d: u8, n: u8, value: u32 },
    Compare { n: u8, m: u8 },
    CompareImm { n: u8, value: u32 },
    And { d: u8, n: u8, m: u8 },
    AndImm { d: u8, n: u8, value: u32 },
    Orr { d: u8, n: u8, m: u8 },
    OrrImm { d: u8, n: u8, value: u32 },
    Eor { d: u8, n: u8, m: u8 },
    EorImm { d: u8, n: u8, value: u32 },
    Bic { d: u8, n: u8, m: u8 },
    AndNz { d: u8, n: u8, m: u8 },
    OrrNz { d: u8, n: u8, m: u8 },
    EorNz { d: u8, n: u8, m: u8 },
    BicNz { d: u8, n: u8, m: u8 },
    /// Two registers and an amount from 1 to 31: `n` op (`m` shifted left).
    AddLsl { d: u8, n: u8, m: u8, by: u8 },
    OrrLsl { d: u8, n: u8, m: u8, by: u8 },
    OrrLsr { d: u8, n: u8, m: u8, by: u8 },
    EorLsl { d: u8, n: u8, m: u8, by: u8 },
    EorLsr { d: u8, n: u8, m: u8, by: u8 },
    TestImm { n: u8, value: u32 },
    /// By 1 to 31.
    Lsl { d: u8, m: u8, by: u8 },
    Lsr { d: u8, m: u8, by: u8 },
    Asr { d: u8, m: u8, by: u8 },
    LslNzc { d: u8, m: u8, by: u8 },
    LsrNzc { d: u8, m: u8, by: u8 },
    /// By the low byte of a register.
    LslBy { d: u8, n: u8, m: u8 },
    LsrBy { d: u8, n: u8, m: u8 },
    Mul { d: u8, n: u8, m: u8 },
    MulAdd { d: u8, n: u8, m: u8, a: u8 },
    Umull { low: u8, high: u8, n: u8, m: u8 },
    /// Adds both halves, each for itself.
    Umaal { low: u8, high: u8, n: u8, m: u8 },
    UnsignedByte { d: u8, m: u8 },
    UnsignedHalf { d: u8, m: u8 },
    SignedByte { d: u8, m: u8 },
    SignedHalf { d: u8, m: u8 },
    Extract { d: u8, n: u8, lsb: u8, width: u8 },
    Insert { d: u8, n: u8, lsb: u8, width: u8 },
    CountZeros { d: u8, m: u8 },

    Branch { to: u32 },
    BranchEqual { to: u32 },
    BranchUnequal { to: u32 },
    BranchIf { cond: u8, to: u32 },
    BranchLink { to: u32 },
    BranchTo { m: u8 },
    BranchLinkTo { m: u8 },
    BranchZero { n: u8, to: u32 },
    BranchNonzero { n: u8, to: u32 },

    /// A constant from this page: its offset there, and the value.
    Constant { t: u8, from: u16, value: u32 },
    Load { t: u8, n: u8, by: i32 },
    LoadByte { t: u8, n: u8, by: i32 },
    LoadHalf { t: u8, n: u8, by: i32 },
    LoadSignedByte { t: u8, n: u8, by: i32 },
    LoadSignedHalf { t: u8, n: u8, by: i32 },
    Store { t: u8, n: u8, by: i32 },
    StoreByte { t: u8, n: u8, by: i32 },
    StoreHalf { t: u8, n: u8, by: i32 },
    LoadAt { t: u8, n: u8, m: u8, lsl: u8 },
    LoadByteAt { t: u8, n: u8, m: u8, lsl: u8 },
    LoadHalfAt { t: u8, n: u8, m: u8, lsl: u8 },
    StoreAt { t: u8, n: u8, m: u8, lsl: u8 },
    StoreByteAt { t: u8, n: u8, m: u8, lsl: u8 },
    StoreHalfAt { t: u8, n: u8, m: u8, lsl: u8 },
    /// Writes the address back: before the access when `index`, otherwise after it.
    LoadMove { t: u8, n: u8, index: bool, by: i16 },
    LoadByteMove { t: u8, n: u8, index: bool, by: i16 },
    StoreMove { t: u8, n: u8, index: bool, by: i16 },
    StoreByteMove { t: u8, n: u8, index: bool, by: i16 },
    LoadTwo { t: u8, t2: u8, n: u8, by: i16 },
    StoreTwo { t: u8, t2: u8, n: u8, by: i16 },
    Multiple { load: bool, n: u8, wback: bool, before: bool, list: u16 },

    FloatAdd { d: u8, n: u8, m: u8 },
    FloatSub { d: u8, n: u8, m: u8 },
    FloatMul { d: u8, n: u8, m: u8 },
    FloatMove { d: u8, m: u8 },
    FloatNeg { d: u8, m: u8 },
    FloatAbs { d: u8, m: u8 },
    FloatSet { d: u8, value: u32 },
    FloatFrom { d: u8, t: u8 },
    FloatTo { t: u8, m: u8 },
    FloatLoad { d: u8, n: u8, by: i16 },
    FloatStore { d: u8, n: u8, by: i16 },
    FloatConstant { d: u8, from: u16, value: u32 },
    FloatCompare { d: u8, m: u8 },
    FloatCompareZero { d: u8 },
    /// `d` plus the product, or minus it, each rounded.
    FloatMulAdd { d: u8, n: u8, m: u8 },
    FloatMulSub { d: u8, n: u8, m: u8 },
    FloatFlags,
}

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
