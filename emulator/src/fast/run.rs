//! The loop over micro-operations.
//!
//! The state that passes from one instruction to the next is in local variables: program counter,
//! time, instructions counted. An instruction after which the session has to check its state (a
//! peripheral was accessed, interrupts were enabled, the program moved to another page) sets the
//! time of the loop's end to zero, so all other instructions need only one comparison. An arm that
//! leaves the loop has not changed anything.

use rsemu::core::value::Width;

use super::code::Page;
use super::micro::Op;
use super::translate::PAGE;
use super::{Core, Done, Leave, Memory, advanced, exchangeable};
use crate::memory_map::{FLASH_BASE, RAM_BASE};

/// The page of an address.
const PAGE_OF: u32 = !(PAGE as u32 - 1);

impl Core {
    /// Executes instructions of one page, until the limit, until the session has to check its
    /// state, or until the program is in another page. Fails before an instruction that is not
    /// plain.
    pub(super) fn run_in(
        &mut self,
        page: &Page,
        memory: Memory<'_>,
        limit: u64,
        instructions: &mut u64,
    ) -> Done {
        let mut pc = self.r[15];
        let mut now = self.now;
        // Zero once the loop is to end after the instruction under way.
        let mut until = limit;
        let mut executed: u64 = 0;
        // What is read from the flash without a wait.
        let (line_bytes, mut line) = self.fetch.in_use();
        let result = 'run: loop {
            if now >= until {
                break Ok(());
            }
            let mut op = page.op(pc);
            let length = page.length(pc);
            let it = self.it;
            if it != 0 {
                op = page.in_it(pc);
                if !matches!(op, Op::Other) {
                    if !self.passes(it >> 4) {
                        op = &Op::Nop;
                    }
                    self.it = advanced(it);
                }
            }
            let mut cycles: u64 = 1;
            let mut next = pc.wrapping_add(length);

            macro_rules! leave {
                () => {{
                    self.it = it;
                    break 'run Err(Leave);
                }};
            }
            macro_rules! jump {
                ($to:expr) => {{
                    next = $to;
                    cycles = cycles.wrapping_add(2);
                    if (next ^ pc) & PAGE_OF != 0 {
                        until = 0;
                    }
                }};
            }
            // Accesses other than aligned ones to RAM take the slow path.
            macro_rules! load {
                ($at:expr, $width:expr) => {{
                    let at: u32 = $at;
                    match memory.ram.read_aligned(at.wrapping_sub(RAM_BASE), $width) {
                        Some(value) => {
                            cycles = cycles.wrapping_add(1);
                            value
                        }
                        None => match self.read_slowly(memory, at, $width, now) {
                            Ok(value) => {
                                cycles = cycles.wrapping_add(self.cycles);
                                if self.io {
                                    until = 0;
                                }
                                value
                            }
                            Err(Leave) => leave!(),
                        },
                    }
                }};
            }
            macro_rules! store {
                ($at:expr, $width:expr, $value:expr) => {{
                    let (at, value): (u32, u32) = ($at, $value);
                    let offset = at.wrapping_sub(RAM_BASE);
                    match memory.ram.write_aligned(offset, $width, value) {
                        Some(()) => cycles = cycles.wrapping_add(1),
                        None => match self.write_slowly(memory, at, $width, value, now) {
                            Ok(()) => {
                                cycles = cycles.wrapping_add(self.cycles);
                                if self.io {
                                    until = 0;
                                }
                            }
                            Err(Leave) => leave!(),
                        },
                    }
                }};
            }
            // The floating-point registers, if the unit can be used.
            macro_rules! float {
                () => {
                    if !self.fp_loaded || !self.fp_usable {
                        if !self.fp_usable {
                            leave!();
                        }
                        self.load_float(memory.cpu);
                    }
                };
            }

            match *op {
                Op::Other => {
                    (self.r[15], self.now) = (pc, now);
                    let done = match page.entry(pc) {
                        Ok(entry) => self.step(memory, entry),
                        Err(Leave) => Err(Leave),
                    };
                    if done.is_err() {
                        break Err(Leave);
                    }
                    executed = executed.wrapping_add(1);
                    (pc, now) = (self.r[15], self.now);
                    // The program may be anywhere, and the session has to check its state.
                    break Ok(());
                }
                Op::Plain => {
                    self.cycles = 0;
                    let keep_flags = it != 0 && length == 2;
                    let done = match page.entry(pc) {
                        Ok(entry) => self.execute(memory, &entry.insn, keep_flags),
                        Err(Leave) => Err(Leave),
                    };
                    if done.is_err() {
                        leave!();
                    }
                    cycles = cycles.wrapping_add(self.cycles);
                }
                Op::Float => {
                    float!();
                    (self.cycles, self.now) = (0, now);
                    let done = match page.entry(pc) {
                        Ok(entry) => self.execute(memory, &entry.insn, false),
                        Err(Leave) => Err(Leave),
                    };
                    if done.is_err() {
                        leave!();
                    }
                    cycles = cycles.wrapping_add(self.cycles);
                }
                Op::Nop => {}
                Op::It { cond, mask } => self.it = cond << 4 | mask,
                Op::Interrupts { enable } => {
                    self.set_primask(!enable);
                    if self.waiting && self.unmasked {
                        until = 0;
                    }
                }
                Op::SetPrimask { n } => {
                    self.set_primask(self.get(n) & 1 != 0);
                    if self.waiting && self.unmasked {
                        until = 0;
                    }
                }
                Op::Primask { d } => self.set(d, u32::from(self.primask)),

                Op::Set { d, value } => self.set(d, value),
                Op::SetNz { d, value } => {
                    self.set(d, value);
                    self.set_nz(value);
                }
                Op::SetTop { d, value } => {
                    self.set(d, self.get(d) & 0xFFFF | u32::from(value) << 16);
                }
                Op::Move { d, m } => self.set(d, self.get(m)),
                Op::MoveNz { d, m } => self.set_with_nz(d, self.get(m)),
                Op::Add { d, n, m } => self.set(d, self.get(n).wrapping_add(self.get(m))),
                Op::AddImm { d, n, value } => self.set(d, self.get(n).wrapping_add(value)),
                Op::Sub { d, n, m } => self.set(d, self.get(n).wrapping_sub(self.get(m))),
                Op::AddNzcv { d, n, m } => {
                    let sum = self.sum_with_flags(self.get(n), self.get(m), false);
                    self.set(d, sum);
                }
                Op::AddImmNzcv { d, n, value } => {
                    let sum = self.sum_with_flags(self.get(n), value, false);
                    self.set(d, sum);
                }
                Op::SubNzcv { d, n, m } => {
                    let difference = self.sum_with_flags(self.get(n), !self.get(m), true);
                    self.set(d, difference);
                }
                Op::SubImmNzcv { d, n, value } => {
                    let difference = self.sum_with_flags(self.get(n), !value, true);
                    self.set(d, difference);
                }
                Op::RsbImm { d, n, value } => self.set(d, value.wrapping_sub(self.get(n))),
                Op::Compare { n, m } => {
                    self.sum_with_flags(self.get(n), !self.get(m), true);
                }
                Op::CompareImm { n, value } => {
                    self.sum_with_flags(self.get(n), !value, true);
                }
                Op::And { d, n, m } => self.set(d, self.get(n) & self.get(m)),
                Op::AndImm { d, n, value } => self.set(d, self.get(n) & value),
                Op::Orr { d, n, m } => self.set(d, self.get(n) | self.get(m)),
                Op::OrrImm { d, n, value } => self.set(d, self.get(n) | value),
                Op::Eor { d, n, m } => self.set(d, self.get(n) ^ self.get(m)),
                Op::EorImm { d, n, value } => self.set(d, self.get(n) ^ value),
                Op::Bic { d, n, m } => self.set(d, self.get(n) & !self.get(m)),
                Op::AndNz { d, n, m } => self.set_with_nz(d, self.get(n) & self.get(m)),
                Op::OrrNz { d, n, m } => self.set_with_nz(d, self.get(n) | self.get(m)),
                Op::EorNz { d, n, m } => self.set_with_nz(d, self.get(n) ^ self.get(m)),
                Op::BicNz { d, n, m } => self.set_with_nz(d, self.get(n) & !self.get(m)),
                Op::AddLsl { d, n, m, by } => {
                    self.set(d, self.get(n).wrapping_add(self.get(m) << (by & 31)));
                }
                Op::OrrLsl { d, n, m, by } => self.set(d, self.get(n) | self.get(m) << (by & 31)),
                Op::OrrLsr { d, n, m, by } => self.set(d, self.get(n) | self.get(m) >> (by & 31)),
                Op::EorLsl { d, n, m, by } => self.set(d, self.get(n) ^ self.get(m) << (by & 31)),
                Op::EorLsr { d, n, m, by } => self.set(d, self.get(n) ^ self.get(m) >> (by & 31)),
                Op::TestImm { n, value } => self.set_nz(self.get(n) & value),
                Op::Lsl { d, m, by } => self.set(d, self.get(m) << (by & 31)),
                Op::Lsr { d, m, by } => self.set(d, self.get(m) >> (by & 31)),
                Op::Asr { d, m, by } => self.set(d, (self.get(m) as i32 >> (by & 31)) as u32),
                Op::LslNzc { d, m, by } => {
                    let value = self.get(m);
                    self.set_c(value << (by.wrapping_sub(1) & 31) >> 31 != 0);
                    self.set_with_nz(d, value << (by & 31));
                }
                Op::LsrNzc { d, m, by } => {
                    let value = self.get(m);
                    self.set_c(value >> (by.wrapping_sub(1) & 31) & 1 != 0);
                    self.set_with_nz(d, value >> (by & 31));
                }
                Op::LslBy { d, n, m } => {
                    let shifted = self.get(n).checked_shl(self.get(m) & 0xFF);
                    self.set(d, shifted.unwrap_or(0));
                }
                Op::LsrBy { d, n, m } => {
                    let shifted = self.get(n).checked_shr(self.get(m) & 0xFF);
                    self.set(d, shifted.unwrap_or(0));
                }
                Op::Mul { d, n, m } => self.set(d, self.get(n).wrapping_mul(self.get(m))),
                Op::MulAdd { d, n, m, a } => {
                    let product = self.get(n).wrapping_mul(self.get(m));
                    self.set(d, self.get(a).wrapping_add(product));
                }
                Op::Umull { low, high, n, m } => {
                    let product = u64::from(self.get(n)) * u64::from(self.get(m));
                    self.set(low, product as u32);
                    self.set(high, (product >> 32) as u32);
                    cycles = cycles.wrapping_add(1);
                }
                Op::Umaal { low, high, n, m } => {
                    let product = u64::from(self.get(n)) * u64::from(self.get(m));
                    let sum = product + u64::from(self.get(low)) + u64::from(self.get(high));
                    self.set(low, sum as u32);
                    self.set(high, (sum >> 32) as u32);
                    cycles = cycles.wrapping_add(1);
                }
                Op::UnsignedByte { d, m } => self.set(d, self.get(m) & 0xFF),
                Op::UnsignedHalf { d, m } => self.set(d, self.get(m) & 0xFFFF),
                Op::SignedByte { d, m } => self.set(d, self.get(m) as i8 as u32),
                Op::SignedHalf { d, m } => self.set(d, self.get(m) as i16 as u32),
                Op::Extract { d, n, lsb, width } => {
                    self.set(d, self.get(n) >> (lsb & 31) & mask(width));
                }
                Op::Insert { d, n, lsb, width } => {
                    let (mask, lsb) = (mask(width), lsb & 31);
                    let unchanged = self.get(d) & !(mask << lsb);
                    self.set(d, unchanged | (self.get(n) & mask) << lsb);
                }
                Op::CountZeros { d, m } => self.set(d, self.get(m).leading_zeros()),

                Op::Branch { to } => jump!(to),
                Op::BranchEqual { to } => {
                    if self.z == 0 {
                        jump!(to);
                    }
                }
                Op::BranchUnequal { to } => {
                    if self.z != 0 {
                        jump!(to);
                    }
                }
                Op::BranchIf { cond, to } => {
                    if self.passes(cond) {
                        jump!(to);
                    }
                }
                Op::BranchLink { to } => {
                    self.set(14, next | 1);
                    jump!(to);
                }
                Op::BranchTo { m } => {
                    let to = self.get(m);
                    if exchangeable(to).is_err() {
                        leave!();
                    }
                    jump!(to & !1);
                }
                Op::BranchLinkTo { m } => {
                    let to = self.get(m);
                    if exchangeable(to).is_err() {
                        leave!();
                    }
                    self.set(14, next | 1);
                    jump!(to & !1);
                }
                Op::BranchZero { n, to } => {
                    if self.get(n) == 0 {
                        jump!(to);
                    }
                }
                Op::BranchNonzero { n, to } => {
                    if self.get(n) != 0 {
                        jump!(to);
                    }
                }

                Op::Constant { t, at, value } => {
                    self.set(t, value);
                    cycles = cycles.wrapping_add(1 + self.fetch.constant(offset(pc, at)));
                }
                Op::Load { t, n, by } => {
                    let value = load!(self.get(n).wrapping_add_signed(by), Width::U32);
                    self.set(t, value);
                }
                Op::LoadByte { t, n, by } => {
                    let value = load!(self.get(n).wrapping_add_signed(by), Width::U8);
                    self.set(t, value);
                }
                Op::LoadHalf { t, n, by } => {
                    let value = load!(self.get(n).wrapping_add_signed(by), Width::U16);
                    self.set(t, value);
                }
                Op::LoadSignedByte { t, n, by } => {
                    let value = load!(self.get(n).wrapping_add_signed(by), Width::U8);
                    self.set(t, value as i8 as u32);
                }
                Op::LoadSignedHalf { t, n, by } => {
                    let value = load!(self.get(n).wrapping_add_signed(by), Width::U16);
                    self.set(t, value as i16 as u32);
                }
                Op::Store { t, n, by } => {
                    store!(self.get(n).wrapping_add_signed(by), Width::U32, self.get(t));
                }
                Op::StoreByte { t, n, by } => {
                    store!(self.get(n).wrapping_add_signed(by), Width::U8, self.get(t));
                }
                Op::StoreHalf { t, n, by } => {
                    store!(self.get(n).wrapping_add_signed(by), Width::U16, self.get(t));
                }
                Op::LoadAt { t, n, m, lsl } => {
                    let value = load!(self.indexed(n, m, lsl), Width::U32);
                    self.set(t, value);
                }
                Op::LoadByteAt { t, n, m, lsl } => {
                    let value = load!(self.indexed(n, m, lsl), Width::U8);
                    self.set(t, value);
                }
                Op::LoadHalfAt { t, n, m, lsl } => {
                    let value = load!(self.indexed(n, m, lsl), Width::U16);
                    self.set(t, value);
                }
                Op::StoreAt { t, n, m, lsl } => {
                    store!(self.indexed(n, m, lsl), Width::U32, self.get(t));
                }
                Op::StoreByteAt { t, n, m, lsl } => {
                    store!(self.indexed(n, m, lsl), Width::U8, self.get(t));
                }
                Op::StoreHalfAt { t, n, m, lsl } => {
                    store!(self.indexed(n, m, lsl), Width::U16, self.get(t));
                }
                Op::LoadMove { t, n, index, by } => {
                    let (at, moved) = self.moving(n, index, by);
                    let value = load!(at, Width::U32);
                    self.set(n, moved);
                    self.set(t, value);
                }
                Op::LoadByteMove { t, n, index, by } => {
                    let (at, moved) = self.moving(n, index, by);
                    let value = load!(at, Width::U8);
                    self.set(n, moved);
                    self.set(t, value);
                }
                Op::StoreMove { t, n, index, by } => {
                    let (at, moved) = self.moving(n, index, by);
                    store!(at, Width::U32, self.get(t));
                    self.set(n, moved);
                }
                Op::StoreByteMove { t, n, index, by } => {
                    let (at, moved) = self.moving(n, index, by);
                    store!(at, Width::U8, self.get(t));
                    self.set(n, moved);
                }
                Op::LoadTwo { t, t2, n, by } => {
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    match self.two(memory, at, now) {
                        Ok((low, high)) => {
                            self.set(t, low);
                            self.set(t2, high);
                            cycles = cycles.wrapping_add(self.cycles);
                        }
                        Err(Leave) => leave!(),
                    }
                }
                Op::StoreTwo { t, t2, n, by } => {
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    let Some(offset) = Self::in_ram(memory.ram, at, 2) else {
                        leave!();
                    };
                    memory.ram.set_word(offset, self.get(t));
                    memory.ram.set_word(offset + 4, self.get(t2));
                    cycles = cycles.wrapping_add(2);
                }
                Op::Multiple {
                    load,
                    n,
                    wback,
                    before,
                    list,
                } => {
                    (self.cycles, self.now, self.branched) = (0, now, false);
                    if self.multiple(memory, load, n, list, wback, before).is_err() {
                        leave!();
                    }
                    cycles = cycles.wrapping_add(self.cycles);
                    if self.branched {
                        next = self.r[15];
                        if (next ^ pc) & PAGE_OF != 0 {
                            until = 0;
                        }
                    }
                }

                Op::FloatAdd { d, n, m } => {
                    float!();
                    let sum = self.sum(self.fpu.s(n), self.fpu.s(m));
                    self.fpu.set_s(d, sum);
                }
                Op::FloatSub { d, n, m } => {
                    float!();
                    let difference = self.difference(self.fpu.s(n), self.fpu.s(m));
                    self.fpu.set_s(d, difference);
                }
                Op::FloatMul { d, n, m } => {
                    float!();
                    let product = self.product(self.fpu.s(n), self.fpu.s(m));
                    self.fpu.set_s(d, product);
                }
                Op::FloatMulAdd { d, n, m } => {
                    float!();
                    let product = self.product(self.fpu.s(n), self.fpu.s(m));
                    let sum = self.sum(self.fpu.s(d), product);
                    self.fpu.set_s(d, sum);
                    cycles = cycles.wrapping_add(2);
                }
                Op::FloatMulSub { d, n, m } => {
                    float!();
                    let product = self.product(self.fpu.s(n), self.fpu.s(m)) ^ SIGN;
                    let sum = self.sum(self.fpu.s(d), product);
                    self.fpu.set_s(d, sum);
                    cycles = cycles.wrapping_add(2);
                }
                Op::FloatMove { d, m } => {
                    float!();
                    self.fpu.set_s(d, self.fpu.s(m));
                }
                Op::FloatNeg { d, m } => {
                    float!();
                    self.fpu.set_s(d, self.fpu.s(m) ^ SIGN);
                }
                Op::FloatAbs { d, m } => {
                    float!();
                    self.fpu.set_s(d, self.fpu.s(m) & !SIGN);
                }
                Op::FloatSet { d, value } => {
                    float!();
                    self.fpu.set_s(d, value);
                }
                Op::FloatFrom { d, t } => {
                    float!();
                    self.fpu.set_s(d, self.get(t));
                }
                Op::FloatTo { t, m } => {
                    float!();
                    self.set(t, self.fpu.s(m));
                }
                Op::FloatLoad { d, n, by } => {
                    float!();
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    let offset = at.wrapping_sub(RAM_BASE);
                    if let Some(value) = memory.ram.read_aligned(offset, Width::U32) {
                        self.fpu.set_s(d, value);
                        cycles = cycles.wrapping_add(1);
                    } else {
                        (self.cycles, self.now) = (0, now);
                        if self.float_words(memory, true, d, at, 1).is_err() {
                            leave!();
                        }
                        cycles = cycles.wrapping_add(self.cycles);
                    }
                }
                Op::FloatStore { d, n, by } => {
                    float!();
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    let offset = at.wrapping_sub(RAM_BASE);
                    let value = self.fpu.s(d);
                    if memory
                        .ram
                        .write_aligned(offset, Width::U32, value)
                        .is_none()
                    {
                        leave!();
                    }
                    cycles = cycles.wrapping_add(1);
                }
                Op::FloatConstant { d, at, value } => {
                    float!();
                    self.fpu.set_s(d, value);
                    cycles = cycles.wrapping_add(1 + self.fetch.constant(offset(pc, at)));
                }
                Op::FloatCompare { d, m } => {
                    float!();
                    self.compare(self.fpu.s(d), self.fpu.s(m), false);
                }
                Op::FloatCompareZero { d } => {
                    float!();
                    self.compare(self.fpu.s(d), 0, false);
                }
                Op::FloatFlags => {
                    float!();
                    self.set_flags(self.fpu.fpscr);
                }
            }

            let at = pc.wrapping_sub(FLASH_BASE);
            if at.wrapping_sub(line) > line_bytes.wrapping_sub(length) {
                cycles = cycles.wrapping_add(self.fetch.lines(at, length, now));
                line = self.fetch.in_use().1;
            }
            now = now.wrapping_add(cycles);
            pc = next;
            executed = executed.wrapping_add(1);
        };
        (self.r[15], self.now) = (pc, now);
        *instructions += executed;
        result
    }

    /// Writes a register and the flags N and Z.
    #[inline(always)]
    fn set_with_nz(&mut self, d: u8, value: u32) {
        self.set(d, value);
        self.set_nz(value);
    }

    #[inline(always)]
    fn indexed(&self, n: u8, m: u8, lsl: u8) -> u32 {
        self.get(n).wrapping_add(self.get(m) << (lsl & 31))
    }

    /// The address of an access, and what is written back.
    #[inline(always)]
    fn moving(&self, n: u8, index: bool, by: i16) -> (u32, u32) {
        let base = self.get(n);
        let moved = base.wrapping_add_signed(i32::from(by));
        (if index { moved } else { base }, moved)
    }
}

/// The sign of a number.
const SIGN: u32 = 1 << 31;

/// So many ones, 1 to 32.
#[inline(always)]
fn mask(width: u8) -> u32 {
    u32::MAX >> (32_u8.wrapping_sub(width) & 31)
}

/// Offset in the flash of a place in the page of an address.
#[inline(always)]
fn offset(pc: u32, at: u16) -> u32 {
    (pc & PAGE_OF)
        .wrapping_sub(FLASH_BASE)
        .wrapping_add(u32::from(at))
}
