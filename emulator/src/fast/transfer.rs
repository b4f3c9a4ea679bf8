//! Transfers of several words, and accesses other than aligned ones to RAM.

use rsemu::core::value::Width;

use super::{Core, Done, Leave, Memory, exchangeable};
use crate::memory_map::RAM_BASE;
use crate::ram::Ram;

impl Core {
    /// Whether `count` words can be transferred at an address: aligned, in RAM or (for loads)
    /// flash.
    pub(super) fn words(&self, memory: Memory<'_>, at: u32, count: u32, load: bool) -> Done {
        let last = at.wrapping_add(4 * count.max(1) - 4);
        if at & 3 != 0 || (!load && at < 0x2000_0000) {
            return Err(Leave);
        }
        self.read_plain(memory, at, Width::U32)?;
        self.read_plain(memory, last, Width::U32)?;
        Ok(())
    }

    /// Whether `count` words lie in RAM; and if so, the offset of the first.
    #[inline]
    pub(super) fn in_ram(ram: &Ram, at: u32, count: u32) -> Option<u32> {
        let offset = at.wrapping_sub(RAM_BASE);
        (offset & 3 == 0 && offset <= ram.size() - 4 * count).then_some(offset)
    }

    pub(super) fn multiple(
        &mut self,
        memory: Memory<'_>,
        load: bool,
        rn: u8,
        list: u16,
        wback: bool,
        before: bool,
    ) -> Done {
        let (base, count) = (self.get(rn), list.count_ones());
        if count == 0 || rn == 15 || (!load && list & 1 << 15 != 0) {
            return Err(Leave);
        }
        let start = if before {
            base.wrapping_sub(4 * count)
        } else {
            base
        };
        let moved = if before {
            start
        } else {
            base.wrapping_add(4 * count)
        };
        let in_ram = Self::in_ram(memory.ram, start, count);
        if in_ram.is_none() {
            self.words(memory, start, count, load)?;
        }
        let target = if list >> 15 != 0 {
            let target = self.read_plain(memory, start.wrapping_add(4 * count - 4), Width::U32)?;
            Some(target)
        } else {
            None
        };
        let returns = match target {
            Some(target) if exchangeable(target).is_err() => {
                if rn != 13 || !wback || list >> 13 & 1 != 0 {
                    return Err(Leave);
                }
                Some(self.return_by(memory, target, moved)?)
            }
            _ => None,
        };
        if load && wback {
            self.set(rn, moved);
        }
        let mut left = list & 0x7FFF;
        if let Some(mut offset) = in_ram {
            self.cycles += u64::from(count - u32::from(list >> 15));
            while left != 0 {
                let register = left.trailing_zeros() as u8;
                left &= left - 1;
                if load {
                    self.set(register, memory.ram.word(offset));
                } else {
                    memory.ram.set_word(offset, self.get(register));
                }
                offset = offset.wrapping_add(4);
            }
        } else {
            // Loads from flash: words() lets nothing else pass.
            let mut at = start;
            while left != 0 {
                let value = self.read(memory, at, Width::U32)?;
                self.set(left.trailing_zeros() as u8, value);
                left &= left - 1;
                at = at.wrapping_add(4);
            }
        }
        if !load && wback {
            self.set(rn, moved);
        }
        if let Some(target) = target {
            self.cycles += 1;
            match returns {
                Some(returns) => self.take_frame(memory, returns),
                None => self.branch(target),
            }
        }
        Ok(())
    }

    /// The address of a load or a store.
    #[inline(always)]
    pub(super) fn indexed(&self, n: u8, m: u8, lsl: u8, by: i16) -> u32 {
        let base = self.get(n).wrapping_add_signed(by.into());
        base.wrapping_add(self.get(m) << (lsl & 31))
    }

    /// The address of an access, and what is written back.
    #[inline(always)]
    pub(super) fn moving(&self, n: u8, index: bool, by: i16) -> (u32, u32) {
        let base = self.get(n);
        let moved = base.wrapping_add_signed(i32::from(by));
        (if index { moved } else { base }, moved)
    }

    /// Reads anything but aligned RAM, for an instruction that begins at `now`.
    #[inline(never)]
    pub(super) fn read_slowly(
        &mut self,
        memory: Memory<'_>,
        at: u32,
        width: Width,
        now: u64,
    ) -> Result<u32, Leave> {
        (self.cycles, self.now) = (0, now);
        self.read(memory, at, width)
    }

    /// Writes anything but aligned RAM, for an instruction that begins at `now`.
    #[inline(never)]
    pub(super) fn write_slowly(
        &mut self,
        memory: Memory<'_>,
        at: u32,
        width: Width,
        value: u32,
        now: u64,
    ) -> Done {
        (self.cycles, self.now) = (0, now);
        self.write(memory, at, width, value)
    }

    /// Two words of RAM or flash.
    #[inline]
    pub(super) fn two(
        &mut self,
        memory: Memory<'_>,
        at: u32,
        now: u64,
    ) -> Result<(u32, u32), Leave> {
        if let Some(offset) = Self::in_ram(memory.ram, at, 2) {
            self.cycles = 2;
            return Ok((memory.ram.word(offset), memory.ram.word(offset + 4)));
        }
        (self.cycles, self.now) = (0, now);
        self.words(memory, at, 2, true)?;
        let low = self.read(memory, at, Width::U32)?;
        let high = self.read(memory, at.wrapping_add(4), Width::U32)?;
        Ok((low, high))
    }
}
