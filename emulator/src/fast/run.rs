//! The loop over micro-operations.
//!
//! The state that passes from one instruction to the next is in local variables: the place in the
//! page, time, instructions counted. An instruction after which the session has to check its state
//! (a peripheral was accessed, interrupts were enabled) sets the time of the loop's end to zero, an
//! IT block the time up to which nothing but the instruction matters, so all others need only one
//! comparison. An arm that leaves the loop has not changed anything.

use rsemu::core::value::Width;

use super::code::Page;
use super::micro::{AND, FLAGS, NOTHING, Op, WITH_C, WITH_ONE, XOR, chosen, mask, offset};
use super::translate::PAGE;
use super::{Core, Done, Leave, Memory, advanced, exchangeable};
use crate::memory_map::{FLASH_BASE, RAM_BASE};

/// Time and instructions are one number, so that both go on in one addition: cycles (enough for 289
/// days at 180 MHz), and below them the instructions of a call, which are fewer than its cycles.
const CYCLE: u64 = 1 << 12;
const INSTRUCTION: u64 = 1;
/// Cycles of a call at most, but for those of its last instruction.
const MOST: u64 = CYCLE - 1;

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
        let base = self.r[15] & PAGE_OF;
        // Places in the page are counted in halfwords, as each waits for the length of the one
        // before and for as little else as possible. One outside of the page ends the loop.
        let place = |address: u32| address.wrapping_sub(base) >> 1;
        let address = |place: u32| base.wrapping_add(place << 1);
        let mut at = place(self.r[15]);
        // The time, and in its lowest bits the number of instructions so far.
        let mut count = self.now * CYCLE;
        // Zero once the loop is to end after the instruction under way.
        let mut stop = limit.min(self.now + MOST) * CYCLE;
        // Up to when instructions follow each other without anything else to look at.
        let mut until = if self.it == 0 { stop } else { 0 };
        // What is read from the flash without a wait.
        let line_length = self.fetch.in_use().0 >> 1;
        let mut line = place(self.fetch.in_use().1.wrapping_add(FLASH_BASE));
        let result = 'run: loop {
            let Some((mut op, length)) = page.op(at) else {
                break Ok(());
            };
            let mut it = 0;
            if count >= until {
                if count >= stop {
                    break Ok(());
                }
                it = self.it;
                op = page.in_it(at);
                if !matches!(op, Op::Other) {
                    if !self.passes(it >> 4) {
                        op = &NOTHING;
                    }
                    self.it = advanced(it);
                    if self.it == 0 {
                        until = stop;
                    }
                }
            }
            let mut spent = CYCLE + INSTRUCTION;
            let mut next = at.wrapping_add(length);

            // Cycles beyond the first.
            macro_rules! spend {
                ($cycles:expr) => {
                    spent = spent.wrapping_add($cycles * CYCLE)
                };
            }
            macro_rules! now {
                () => {
                    count / CYCLE
                };
            }
            macro_rules! end {
                () => {
                    (stop, until) = (0, 0)
                };
            }
            macro_rules! leave {
                () => {{
                    self.it = it;
                    break 'run Err(Leave);
                }};
            }
            macro_rules! jump {
                ($to:expr) => {{
                    next = $to;
                    spend!(2);
                }};
            }
            // What another function does, which counts its cycles.
            macro_rules! done {
                ($done:expr) => {
                    match $done {
                        Ok(value) => {
                            spend!(self.cycles);
                            value
                        }
                        Err(Leave) => leave!(),
                    }
                };
            }
            // The same of an access, which may be to a peripheral.
            macro_rules! accessed {
                ($done:expr) => {{
                    let value = done!($done);
                    if self.io {
                        end!();
                    }
                    value
                }};
            }
            // Accesses other than aligned ones to RAM take the slow path.
            macro_rules! load {
                ($at:expr, $width:expr) => {{
                    let at: u32 = $at;
                    match memory.ram.read_aligned(at.wrapping_sub(RAM_BASE), $width) {
                        Some(value) => {
                            spend!(1);
                            value
                        }
                        None => accessed!(self.read_slowly(memory, at, $width, now!())),
                    }
                }};
            }
            macro_rules! store {
                ($at:expr, $width:expr, $value:expr) => {{
                    let (at, value): (u32, u32) = ($at, $value);
                    let offset = at.wrapping_sub(RAM_BASE);
                    match memory.ram.write_aligned(offset, $width, value) {
                        Some(()) => spend!(1),
                        None => accessed!(self.write_slowly(memory, at, $width, value, now!())),
                    }
                }};
            }
            // The floating-point registers, if the unit is the present code's.
            macro_rules! float_in_use {
                () => {
                    if !self.fp_loaded || !self.fp_usable {
                        if !self.fp_usable {
                            leave!();
                        }
                        self.load_float(memory.cpu);
                    }
                };
            }
            // The same for an instruction that does not fail afterwards, which can claim the unit.
            macro_rules! float {
                () => {
                    if !self.fp_loaded || !self.fp_usable {
                        if self.fp_usable {
                            self.load_float(memory.cpu);
                        } else if let Ok(cycles) = self.claim_float(memory) {
                            spend!(cycles);
                        } else {
                            leave!();
                        }
                    }
                };
            }

            match *op {
                Op::Other => {
                    (self.r[15], self.now) = (address(at), now!());
                    let done = match page.entry(at) {
                        Ok(entry) => self.step(memory, entry),
                        Err(Leave) => Err(Leave),
                    };
                    if done.is_err() {
                        break Err(Leave);
                    }
                    count = self.now * CYCLE + (count + INSTRUCTION) % CYCLE;
                    at = place(self.r[15]);
                    // The program may be anywhere, and the session has to check its state.
                    break Ok(());
                }
                Op::Plain => {
                    self.cycles = 0;
                    let keep_flags = it != 0 && length == 1;
                    let entry = page.entry(at);
                    done!(entry.and_then(|entry| self.execute(memory, &entry.insn, keep_flags)));
                }
                Op::Float => {
                    float_in_use!();
                    (self.cycles, self.now) = (0, now!());
                    let entry = page.entry(at);
                    done!(entry.and_then(|entry| self.execute(memory, &entry.insn, false)));
                }
                Op::It { cond, mask } => {
                    self.it = cond << 4 | mask;
                    until = 0;
                }
                Op::Interrupts { enable } => {
                    self.set_primask(!enable);
                    if self.waiting && self.unmasked {
                        end!();
                    }
                }
                Op::SetPrimask { n } => {
                    self.set_primask(self.get(n) & 1 != 0);
                    if self.waiting && self.unmasked {
                        end!();
                    }
                }
                Op::Primask { d } => self.set(d, u32::from(self.primask)),

                Op::AddImm { d, n, flags, value } => {
                    let sum = self.get(n).wrapping_add(value);
                    self.set(d, sum);
                    self.set_nz_if(flags, sum);
                }
                Op::SetTop { d, value } => {
                    self.set(d, self.get(d) & 0xFFFF | u32::from(value) << 16);
                }
                Op::Sub { d, n, m } => self.set(d, self.get(n).wrapping_sub(self.get(m))),
                Op::Sum { d, n, m, flip } => {
                    let carry = m & WITH_ONE != 0 || m & WITH_C != 0 && self.carry();
                    let sum = self.sum_with_flags(self.get(n), self.get(m) ^ flip, carry);
                    self.set(d, sum);
                }
                Op::RsbImm { d, n, value } => self.set(d, value.wrapping_sub(self.get(n))),
                Op::Logic { d, n, m, flip } => {
                    let (a, b) = (self.get(n), self.get(m) ^ flip);
                    let result = a & b & chosen(m, AND) | (a ^ b) & chosen(m, XOR);
                    self.set(d, result);
                    self.set_nz_if(m & FLAGS != 0, result);
                }
                Op::AddLsl { d, n, m, by } => {
                    self.set(d, self.get(n).wrapping_add(self.get(m) << (by & 31)));
                }
                Op::OrrLsl { d, n, m, by } => self.set(d, self.get(n) | self.get(m) << (by & 31)),
                Op::OrrLsr { d, n, m, by } => self.set(d, self.get(n) | self.get(m) >> (by & 31)),
                Op::EorLsl { d, n, m, by } => self.set(d, self.get(n) ^ self.get(m) << (by & 31)),
                Op::EorLsr { d, n, m, by } => self.set(d, self.get(n) ^ self.get(m) >> (by & 31)),
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
                    spend!(1);
                }
                Op::Umaal { low, high, n, m } => {
                    let product = u64::from(self.get(n)) * u64::from(self.get(m));
                    let sum = product + u64::from(self.get(low)) + u64::from(self.get(high));
                    self.set(low, sum as u32);
                    self.set(high, (sum >> 32) as u32);
                    spend!(1);
                }
                Op::Shift { d, n, up, down } => {
                    self.set(d, self.get(n) << (up & 31) >> (down & 31));
                }
                Op::ShiftSigned { d, n, up, down } => {
                    self.set(d, ((self.get(n) << (up & 31)) as i32 >> (down & 31)) as u32);
                }
                Op::ShiftNzc {
                    d,
                    n,
                    up,
                    down,
                    carry,
                } => {
                    let value = self.get(n);
                    self.set_c(value >> (carry & 31) & 1 != 0);
                    self.set_with_nz(d, value << (up & 31) >> (down & 31));
                }
                Op::Insert { d, n, lsb, width } => {
                    let (mask, lsb) = (mask(width), lsb & 31);
                    let unchanged = self.get(d) & !(mask << lsb);
                    self.set(d, unchanged | (self.get(n) & mask) << lsb);
                }
                Op::CountZeros { d, m } => self.set(d, self.get(m).leading_zeros()),

                Op::BranchIf { cond, to } => {
                    if self.passes(cond) {
                        jump!(to);
                    }
                }
                Op::BranchLink { to } => {
                    self.set(14, address(next) | 1);
                    jump!(to);
                }
                Op::BranchTo { m } => {
                    let to = self.get(m);
                    if exchangeable(to).is_ok() {
                        jump!(place(to));
                    } else {
                        (self.cycles, self.now) = (0, now!());
                        let returns = self.return_by(memory, to, self.r[13]);
                        done!(returns.map(|returns| self.take_frame(memory, returns)));
                        next = place(self.r[15]);
                        end!();
                    }
                }
                Op::BranchLinkTo { m } => {
                    let to = self.get(m);
                    if exchangeable(to).is_err() {
                        leave!();
                    }
                    self.set(14, address(next) | 1);
                    jump!(place(to));
                }
                Op::BranchZero { n, nonzero, to } => {
                    if (self.get(n) == 0) != nonzero {
                        jump!(to);
                    }
                }

                Op::Constant { t, from, value } => {
                    self.set(t, value);
                    spend!(1 + self.fetch.constant(offset(base, from)));
                }
                Op::Load {
                    t,
                    n,
                    m,
                    lsl,
                    width,
                    by,
                } => {
                    let value = load!(self.indexed(n, m, lsl, by), width);
                    self.set(t, value);
                }
                Op::LoadSigned { t, n, width, by } => {
                    let at = self.get(n).wrapping_add_signed(by.into());
                    let above = 32_u32.wrapping_sub(width.bits()) & 31;
                    let value = load!(at, width);
                    self.set(t, ((value << above) as i32 >> above) as u32);
                }
                Op::Store {
                    t,
                    n,
                    m,
                    lsl,
                    width,
                    by,
                } => store!(self.indexed(n, m, lsl, by), width, self.get(t)),
                Op::LoadMove {
                    t,
                    n,
                    width,
                    index,
                    by,
                } => {
                    let (at, moved) = self.moving(n, index, by);
                    let value = load!(at, width);
                    self.set(n, moved);
                    self.set(t, value);
                }
                Op::StoreMove {
                    t,
                    n,
                    width,
                    index,
                    by,
                } => {
                    let (at, moved) = self.moving(n, index, by);
                    store!(at, width, self.get(t));
                    self.set(n, moved);
                }
                Op::LoadTwo { t, t2, n, by } => {
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    let (low, high) = done!(self.two(memory, at, now!()));
                    self.set(t, low);
                    self.set(t2, high);
                }
                Op::StoreTwo { t, t2, n, by } => {
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    let Some(offset) = Self::in_ram(memory.ram, at, 2) else {
                        leave!();
                    };
                    memory.ram.set_word(offset, self.get(t));
                    memory.ram.set_word(offset + 4, self.get(t2));
                    spend!(2);
                }
                Op::Multiple {
                    load,
                    n,
                    wback,
                    before,
                    list,
                } => {
                    (self.cycles, self.now, self.branched) = (0, now!(), false);
                    done!(self.multiple(memory, load, n, list, wback, before));
                    if self.branched {
                        next = place(self.r[15]);
                        if self.io {
                            end!();
                        }
                    }
                }

                Op::FloatAdd { d, n, m, subtracts } => {
                    float!();
                    let sum = self.sum(self.fpu.s(n), self.fpu.s(m), subtracts);
                    self.fpu.set_s(d, sum);
                }
                Op::FloatMul { d, n, m } => {
                    float!();
                    let product = self.product(self.fpu.s(n), self.fpu.s(m));
                    self.fpu.set_s(d, product);
                }
                Op::FloatMulAdd { d, n, m, negates } => {
                    float!();
                    let product = self.product(self.fpu.s(n), self.fpu.s(m));
                    let sum = self.sum(self.fpu.s(d), product ^ u32::from(negates) << 31, false);
                    self.fpu.set_s(d, sum);
                    spend!(2);
                }
                Op::FloatMove {
                    d,
                    m,
                    clears,
                    flips,
                } => {
                    float!();
                    let (clears, flips) = (u32::from(clears) << 31, u32::from(flips) << 31);
                    self.fpu.set_s(d, self.fpu.s(m) & !clears ^ flips);
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
                    float_in_use!();
                    let at = self.get(n).wrapping_add_signed(i32::from(by));
                    let offset = at.wrapping_sub(RAM_BASE);
                    if let Some(value) = memory.ram.read_aligned(offset, Width::U32) {
                        self.fpu.set_s(d, value);
                        spend!(1);
                    } else {
                        (self.cycles, self.now) = (0, now!());
                        done!(self.float_words(memory, true, d, at, 1));
                    }
                }
                Op::FloatStore { d, n, by } => {
                    float_in_use!();
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
                    spend!(1);
                }
                Op::FloatConstant { d, from, value } => {
                    float!();
                    self.fpu.set_s(d, value);
                    spend!(1 + self.fetch.constant(offset(base, from)));
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

            if at.wrapping_sub(line) > line_length.wrapping_sub(length) {
                let from = address(at).wrapping_sub(FLASH_BASE);
                spend!(self.fetch.lines(from, 2 * length, now!()));
                line = place(self.fetch.in_use().1.wrapping_add(FLASH_BASE));
            }
            count = count.wrapping_add(spent);
            at = next;
        };
        (self.r[15], self.now) = (address(at), count / CYCLE);
        *instructions += count % CYCLE;
        result
    }
}
