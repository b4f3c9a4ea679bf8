//! Saturation and the instructions of the DSP extension that compiled Rust has: saturating sums,
//! sums with an extended or doubled operand, packing, the upper half of a product (ARMv7-M
//! Architecture Reference Manual, section A7.7). The others are the reference core's.

use rsemu::cpu::arm::v7m::isa::{DualMulOp, ExtendOp, Insn, SatQOp, SimdMode, SimdShape};
use rsemu::cpu::arm::v7m::xpsr;

use super::execute::{plain, shift};
use super::{Core, Done, Leave};

/// Whether [`Core::signal`] executes an instruction.
pub(super) fn is_signal(insn: &Insn) -> bool {
    match *insn {
        Insn::Sat {
            halves: false,
            rd,
            rn,
            ..
        } => plain(&[rd, rn]).is_ok(),
        Insn::SatQ { rd, rn, rm, .. } | Insn::Pkh { rd, rn, rm, .. } => {
            plain(&[rd, rn, rm]).is_ok()
        }
        Insn::Simd {
            mode: SimdMode::UnsignedSat,
            shape: SimdShape::Add8 | SimdShape::Sub8,
            rd,
            rn,
            rm,
        } => plain(&[rd, rn, rm]).is_ok(),
        Insn::Extend {
            op: ExtendOp::Sxtb | ExtendOp::Sxth | ExtendOp::Uxtb | ExtendOp::Uxth,
            rd,
            rn,
            rm,
            ..
        } => plain(&[rd, rn, rm]).is_ok(),
        Insn::DualMul {
            op: DualMulOp::Smmul,
            rd,
            rn,
            rm,
            ra: 15,
            ..
        } => plain(&[rd, rn, rm]).is_ok(),
        _ => false,
    }
}

impl Core {
    /// Executes one of these instructions.
    pub(super) fn signal(&mut self, insn: &Insn) -> Done {
        if !is_signal(insn) {
            return Err(Leave);
        }
        match *insn {
            Insn::Sat {
                unsigned,
                rd,
                rn,
                imm,
                shift: by,
                ..
            } => {
                let value = shift(by.ty, self.get(rn), by.amount.into(), self.c).0 as i32;
                let (least, most) = if unsigned {
                    (0, (1_i64 << imm) - 1)
                } else {
                    let limit = 1_i64 << (imm - 1);
                    (-limit, limit - 1)
                };
                self.saturate(rd, value.into(), least, most);
            }
            Insn::SatQ { op, rd, rn, rm } => {
                let (n, m) = (self.get(rn) as i32, self.get(rm) as i32);
                let other = if matches!(op, SatQOp::Qdadd | SatQOp::Qdsub) {
                    self.saturate(rd, 2 * i64::from(n), MIN, MAX)
                } else {
                    n.into()
                };
                let sum = if matches!(op, SatQOp::Qadd | SatQOp::Qdadd) {
                    i64::from(m) + other
                } else {
                    i64::from(m) - other
                };
                self.saturate(rd, sum, MIN, MAX);
            }
            Insn::Simd {
                shape, rd, rn, rm, ..
            } => {
                let lanes = if shape == SimdShape::Add8 {
                    u8::saturating_add
                } else {
                    u8::saturating_sub
                };
                let (a, b) = (self.get(rn).to_le_bytes(), self.get(rm).to_le_bytes());
                let result = std::array::from_fn(|lane| lanes(a[lane], b[lane]));
                self.set(rd, u32::from_le_bytes(result));
            }
            Insn::Extend {
                op,
                rd,
                rn,
                rm,
                rotate,
            } => {
                let value = self.get(rm).rotate_right(rotate.into());
                let value = match op {
                    ExtendOp::Sxtb => value as i8 as u32,
                    ExtendOp::Sxth => value as i16 as u32,
                    ExtendOp::Uxtb => value & 0xFF,
                    _ => value & 0xFFFF,
                };
                self.set(rd, self.get(rn).wrapping_add(value));
            }
            Insn::Pkh {
                tb,
                rd,
                rn,
                rm,
                shift: by,
            } => {
                let shifted = shift(by.ty, self.get(rm), by.amount.into(), self.c).0;
                let upper = if tb { self.get(rn) } else { shifted };
                let lower = if tb { shifted } else { self.get(rn) };
                self.set(rd, upper & 0xFFFF_0000 | lower & 0xFFFF);
            }
            Insn::DualMul { rd, rn, rm, x, .. } => {
                let product = i64::from(self.get(rn) as i32) * i64::from(self.get(rm) as i32);
                let half = if x { 1 << 31 } else { 0 };
                self.set(rd, (product.wrapping_add(half) >> 32) as u32);
                self.cycles += 1;
            }
            _ => return Err(Leave),
        }
        Ok(())
    }

    /// Stores a value within limits and sets the flag Q where it was beyond them. Returns what is
    /// stored.
    fn saturate(&mut self, rd: u8, value: i64, least: i64, most: i64) -> i64 {
        let result = value.clamp(least, most);
        if result != value {
            self.psr |= xpsr::Q;
        }
        self.set(rd, result as u32);
        result
    }
}

const MIN: i64 = i32::MIN as i64;
const MAX: i64 = i32::MAX as i64;
