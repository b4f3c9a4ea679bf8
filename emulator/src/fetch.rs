//! The time for reading the flash: wait states, prefetch and caches (RM0390 rev 6, sections 3.4.1
//! and 3.4.2).
//!
//! The array is read in lines of 128 bits, and each read takes the wait states that ACR sets, five
//! at 180 MHz. Three mechanisms hide them: the current line is kept; the next one is prefetched
//! while the current one is executed; and a branch to any other line stores that line in an
//! instruction cache of 64 lines, which replaces the least recently used one. Constants that the
//! program reads from flash have a separate cache of 8 lines.
//!
//! An STM32F1 (PM0075 section 3.1) reads lines of 64 bits, at most with two wait states, and has
//! the prefetch alone. Its two buffers are the line in use and the next one.
//!
//! The model is simpler than the chip: instructions and constants do not wait for each other at the
//! array, a useless prefetch does not delay the next read, and the core's own queue of fetched
//! halfwords hides no wait. The caches are always consistent with the flash: the model does not
//! detect a program that fails to clear them after an erase.

use crate::family::Family;

/// Lines in the largest flash of all chips that have the caches: of 128 bits.
const LINES: usize = (crate::chip::LARGEST_FLASH >> 4) as usize;

/// Bytes of a line of a chip's flash as a power of two: the STM32F1 reads 64 bits at a time.
fn line_bits(family: Family) -> u32 {
    match family {
        Family::F1 => 3,
        Family::F4 => 4,
    }
}

/// ACR: wait states, and the three enable bits.
const LATENCY: u32 = 0xF;
const PRFTEN: u32 = 1 << 8;
const ICEN: u32 = 1 << 9;
const DCEN: u32 = 1 << 10;

/// A fully associative cache of `N` lines that gives up the one unused for longest.
#[derive(Debug, Clone)]
struct Cache<const N: usize> {
    enabled: bool,
    /// For each line of the flash its slot plus one, 0 for none.
    slot_of: Box<[u8; LINES]>,
    line_of: [Option<u32>; N],
    /// The slots as a ring in the order of their last use, with predecessor and successor. Slot `N`
    /// is the ring's end: its predecessor is the latest, its successor the oldest.
    before: [u8; SLOTS],
    after: [u8; SLOTS],
}

/// Slots of the larger cache and the ring's end, up to a power of two.
const SLOTS: usize = 128;

impl<const N: usize> Cache<N> {
    fn new() -> Self {
        let mut cache = Self {
            enabled: false,
            slot_of: Box::new([0; LINES]),
            line_of: [None; N],
            before: [0; SLOTS],
            after: [0; SLOTS],
        };
        cache.clear();
        cache
    }

    /// Whether the cache holds a line, which then counts as used. A cache that is switched off is
    /// empty.
    #[inline(always)]
    fn hit(&mut self, line: u32) -> bool {
        let slot = self.slot_of[line as usize % LINES];
        if slot == 0 {
            return false;
        }
        if self.before[N] != slot - 1 {
            self.touch(slot - 1);
        }
        true
    }

    /// Makes a slot the latest.
    #[inline(always)]
    fn touch(&mut self, slot: u8) {
        const MASK: usize = SLOTS - 1;
        let at = usize::from(slot) & MASK;
        let (before, after) = (self.before[at], self.after[at]);
        self.after[usize::from(before) & MASK] = after;
        self.before[usize::from(after) & MASK] = before;
        let latest = std::mem::replace(&mut self.before[N & MASK], slot);
        self.after[usize::from(latest) & MASK] = slot;
        (self.before[at], self.after[at]) = (latest, N as u8);
    }

    #[inline(never)]
    fn insert(&mut self, line: u32) {
        if !self.enabled || line as usize >= LINES {
            return;
        }
        let oldest = self.after[N];
        if let Some(old) = self.line_of[usize::from(oldest)].replace(line) {
            self.slot_of[old as usize] = 0;
        }
        self.slot_of[line as usize] = oldest + 1;
        self.touch(oldest);
    }

    fn clear(&mut self) {
        for line in self.line_of.iter_mut().filter_map(Option::take) {
            self.slot_of[line as usize] = 0;
        }
        for slot in 0..=N {
            self.before[slot] = ((slot + N) % (N + 1)) as u8;
            self.after[slot] = ((slot + 1) % (N + 1)) as u8;
        }
    }
}

/// The flash interface's reading side. Addresses are offsets into the flash, times are core cycles.
#[derive(Debug, Clone)]
pub(crate) struct Fetch {
    /// Bytes of a line as a power of two.
    bits: u32,
    acr: u32,
    /// Version of the flash's content that the caches hold.
    version: u64,
    wait_states: u64,
    /// All ones when nothing is prefetched, otherwise zero.
    no_prefetch: u32,
    /// The line that instructions come from.
    line: u32,
    /// The line that is being prefetched, `u32::MAX` for none, and the time at which it arrives.
    prefetched: u32,
    ready: u64,
    code: Cache<64>,
    data: Cache<8>,
    /// Cycles that the core has waited in all.
    waited: u64,
}

impl Fetch {
    /// As after a reset: no wait states, nothing enabled.
    pub(crate) fn new(family: Family) -> Self {
        Self {
            bits: line_bits(family),
            acr: 0,
            version: 0,
            wait_states: 0,
            no_prefetch: u32::MAX,
            line: u32::MAX,
            prefetched: u32::MAX,
            ready: 0,
            code: Cache::new(),
            data: Cache::new(),
            waited: 0,
        }
    }

    /// Cycles that the core has waited so far.
    pub(crate) fn waited(&self) -> u64 {
        self.waited
    }

    /// Applies ACR and drops lines of a former content of the flash.
    pub(crate) fn configure(&mut self, acr: u32, version: u64) {
        if (acr, version) == (self.acr, self.version) {
            return;
        }
        (self.acr, self.version) = (acr, version);
        self.wait_states = u64::from(acr & LATENCY);
        self.no_prefetch = if acr & PRFTEN != 0 { 0 } else { u32::MAX };
        self.code.enabled = acr & ICEN != 0;
        self.data.enabled = acr & DCEN != 0;
        self.code.clear();
        self.data.clear();
        self.line = u32::MAX;
        self.prefetched = u32::MAX;
    }

    /// Bytes of a line, and where that begins which instructions come from: those that lie in it do
    /// not wait.
    #[inline(always)]
    pub(crate) fn in_use(&self) -> (u32, u32) {
        let bits = self.bits & 31;
        (1 << bits, self.line << bits)
    }

    /// Cycles that the core waits for an instruction of `length` bytes.
    #[inline(always)]
    pub(crate) fn instruction(&mut self, offset: u32, length: u32, now: u64) -> u64 {
        let (first, last) = self.lines_of(offset, length);
        if (first ^ self.line) | (last ^ self.line) == 0 {
            0
        } else {
            self.lines(offset, length, now)
        }
    }

    /// The lines that its first and its last byte are in.
    #[inline(always)]
    fn lines_of(&self, offset: u32, length: u32) -> (u32, u32) {
        let bits = self.bits & 31;
        let last = offset.wrapping_add(length).wrapping_sub(1);
        (offset >> bits, last >> bits)
    }

    /// The same for one that is not in the line in use alone.
    #[inline(never)]
    pub(crate) fn lines(&mut self, offset: u32, length: u32, now: u64) -> u64 {
        if self.wait_states == 0 {
            return 0;
        }
        let (first, last) = self.lines_of(offset, length);
        let mut waited = 0;
        if first != self.line {
            waited = self.enter(first, now);
        }
        if last != first {
            waited += self.enter(last, now + waited);
        }
        waited
    }

    /// Goes on with instructions of another line.
    #[inline(always)]
    fn enter(&mut self, line: u32, now: u64) -> u64 {
        self.line = line;
        let waited = if self.code.hit(line) {
            0
        } else if self.prefetched == line {
            self.ready.saturating_sub(now)
        } else {
            self.code.insert(line);
            self.wait_states
        };
        self.waited += waited;
        // Far longer than any run, so nothing overflows.
        let ready = now.wrapping_add(waited).wrapping_add(self.wait_states);
        self.ready = ready.wrapping_add(1);
        self.prefetched = line.wrapping_add(1) | self.no_prefetch;
        waited
    }

    /// Cycles that the core waits for a constant.
    #[inline]
    pub(crate) fn constant(&mut self, offset: u32) -> u64 {
        let line = offset >> self.bits;
        if self.wait_states == 0 || self.data.hit(line) {
            return 0;
        }
        self.data.insert(line);
        self.waited += self.wait_states;
        self.wait_states
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WAIT_STATES: u32 = 5;

    fn fetch(enabled: u32) -> Fetch {
        let mut fetch = Fetch::new(Family::F4);
        fetch.configure(WAIT_STATES | enabled, 0);
        fetch
    }

    /// Runs instructions of one cycle each in a row; cycles waited.
    fn straight(fetch: &mut Fetch, from: u32, length: u32, count: u32) -> u64 {
        let (mut now, mut waited) = (1_000, 0);
        for index in 0..count {
            let wait = fetch.instruction(from + index * length, length, now);
            waited += wait;
            now += wait + 1;
        }
        waited
    }

    #[test]
    fn without_prefetch_every_line_costs_its_wait_states() {
        assert_eq!(straight(&mut fetch(0), 0, 2, 80), 10 * 5);
    }

    #[test]
    fn prefetch_hides_the_wait_behind_eight_short_instructions_but_not_behind_four_long_ones() {
        // A read takes 6 cycles. Eight instructions last 8: only the first line is waited for.
        assert_eq!(straight(&mut fetch(PRFTEN), 0, 2, 80), 5);
        // Four last 4: each of the nine further lines is 2 late.
        assert_eq!(straight(&mut fetch(PRFTEN), 0, 4, 40), 5 + 9 * 2);
    }

    #[test]
    fn a_loop_over_jumps_is_read_once() {
        let mut fetch = fetch(PRFTEN | ICEN);
        // 64 lines, none next to another, fit; every one of 65 is gone when it is needed again.
        let mut round = |lines: u32| -> u64 {
            (0..lines)
                .map(|line| fetch.instruction(line * 32, 2, 0))
                .sum()
        };
        assert_eq!(round(64), 64 * 5);
        assert_eq!(round(64), 0);
        assert_eq!(round(65), 5);
        assert_eq!(round(65), 65 * 5);
    }

    #[test]
    fn constants_have_eight_lines() {
        let mut fetch = fetch(DCEN);
        let mut round =
            |lines: u32| -> u64 { (0..lines).map(|line| fetch.constant(line * 16)).sum() };
        assert_eq!((round(8), round(8)), (40, 0));
        assert_eq!((round(9), round(9)), (5, 45));
    }

    #[test]
    fn an_instruction_across_two_lines_needs_both() {
        assert_eq!(fetch(0).instruction(14, 4, 0), 10);
    }

    #[test]
    fn an_stm32f1_reads_64_bits_at_a_time_and_has_no_caches() {
        let mut fetch = Fetch::new(Family::F1);
        fetch.configure(2 | PRFTEN, 0);
        // A read takes 3 cycles, four short instructions 4: only the first line is waited for.
        assert_eq!(straight(&mut fetch, 0, 2, 40), 2);
        // Two long ones take 2: each of the nine further lines is 1 late.
        assert_eq!(straight(&mut fetch, 0x400, 4, 20), 2 + 9);
        assert_eq!([0, 0, 8].map(|at| fetch.constant(at)), [2; 3]);
    }

    #[test]
    fn no_wait_states_cost_nothing() {
        let mut fetch = fetch(0);
        fetch.configure(0, 0);
        assert_eq!((straight(&mut fetch, 0, 4, 40), fetch.constant(0)), (0, 0));
    }

    #[test]
    fn another_content_of_the_flash_empties_the_caches() {
        let mut fetch = fetch(ICEN | DCEN);
        assert_eq!((fetch.instruction(0, 2, 0), fetch.constant(0)), (5, 5));
        assert_eq!((fetch.instruction(64, 2, 0), fetch.constant(0)), (5, 0));
        fetch.configure(WAIT_STATES | ICEN | DCEN, 1);
        assert_eq!((fetch.instruction(0, 2, 0), fetch.constant(0)), (5, 5));
    }
}
