//! Transfers of several words.

use rsemu::core::value::Width;

use super::{Core, Done, Leave, Memory, exchangeable};

impl Core {
    /// Whether `count` words can be transferred at an address: aligned, in RAM or (for loads) flash.
    pub(super) fn words(&self, memory: Memory<'_>, at: u32, count: u32, load: bool) -> Done {
        let last = at.wrapping_add(4 * count.max(1) - 4);
        if at & 3 != 0 || (!load && at < 0x2000_0000) {
            return Err(Leave);
        }
        self.read_plain(memory, at, Width::U32)?;
        self.read_plain(memory, last, Width::U32)?;
        Ok(())
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
        self.words(memory, start, count, load)?;
        let target = if load && list >> 15 != 0 {
            let target = self.read_plain(memory, start.wrapping_add(4 * count - 4), Width::U32)?;
            exchangeable(target)?;
            Some(target)
        } else {
            None
        };
        if load && wback {
            self.set(rn, moved);
        }
        let mut at = start;
        for register in 0..15 {
            if list >> register & 1 == 0 {
                continue;
            }
            if load {
                let value = self.read(memory, at, Width::U32)?;
                self.set(register, value);
            } else {
                self.write(memory, at, Width::U32, self.get(register))?;
            }
            at = at.wrapping_add(4);
        }
        if !load && wback {
            self.set(rn, moved);
        }
        if let Some(target) = target {
            self.cycles += 1;
            self.branch(target);
        }
        Ok(())
    }
}
