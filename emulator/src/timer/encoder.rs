//! The encoder interface (RM0390 rev 6, sections 17.3.16 and 18.3.12) and the digital filters of
//! its inputs.
//!
//! There are two sources of edges. [`Timer::set_input`] sets the level of TI1 or TI2, and the
//! counts follow from the levels, as in the chip. [`Timer::encoder_add`] turns an encoder by a
//! number of clean edges at once, for a simulated wheel; these edges are assumed to last as long as
//! the slower of the two filters needs, and are delayed by that time.
//!
//! A filter samples its input and passes a new level on after N samples in a row have shown it. The
//! model does no work per sample: when a level changes, the cycle of the N-th sample is known, and
//! a change back before that cycle cancels the edge. Samples are assumed to lie at whole multiples
//! of the sampling time since power-on, which the manual does not specify. A sample takes the level
//! just before it. Without a filter (ICxF = 0) an edge counts at once.

use std::collections::VecDeque;

use super::{Timer, cr1};

/// TI1 and TI2, behind their pins.
#[derive(Debug, Clone, Default)]
pub(super) struct Inputs {
    /// Levels at the pins, and behind the filters.
    raw: [bool; 2],
    pub(super) filtered: [bool; 2],
    /// When the filters will pass on the level at the pins, where that differs.
    due: [Option<u64>; 2],
    /// Clean edges that are in the filters, with the cycle at which they leave them.
    clean: VecDeque<(u64, i32)>,
    /// The first of all these moments.
    pub(super) next: Option<u64>,
    /// The filters let every edge through: a defect.
    pub(super) unfiltered: bool,
    /// Quadrature edges not yet counted in the modes that count on one channel only.
    half_counts: i32,
}

impl Inputs {
    /// What a reset of the timer leaves: the levels outside.
    pub(super) fn after_reset(&self) -> Self {
        Self {
            raw: self.raw,
            filtered: self.raw,
            unfiltered: self.unfiltered,
            ..Self::default()
        }
    }

    fn find_next(&mut self) {
        let clean = self.clean.front().map(|(at, _)| *at);
        let all = [self.due[0], self.due[1], clean];
        self.next = all.into_iter().flatten().min();
    }
}

impl Timer {
    /// Whether encoder mode is set up: SMS 1 to 3, both channels inputs on their own pins
    /// (18.3.12), counter on.
    #[must_use]
    pub fn encoder_ready(&self) -> bool {
        self.kind.full && self.enabled() && self.smcr & 7 != 0 && self.ccmr[0] & 0x303 == 0x101
    }

    /// Lets every edge pass the filters of the inputs: a defect.
    pub fn remove_filters(&mut self) {
        self.encoder.unfiltered = true;
    }

    /// Whether an edge leaves its filter by `now`.
    #[must_use]
    pub fn edge_due(&self, now: u64) -> bool {
        self.encoder.next.is_some_and(|at| at <= now)
    }

    /// Core clock cycles between two samples of an input, and how many have to agree (18.4.7,
    /// IC1F).
    fn filter(&self, input: usize) -> Option<(u64, u64)> {
        if self.encoder.unfiltered || self.ccmr[0] >> (8 * input) & 3 == 0 {
            return None; // an output
        }
        let (of_dts, divider, samples) = match self.ccmr[0] >> (8 * input + 4) & 0xF {
            0 => return None,
            1 => (false, 1, 2),
            2 => (false, 1, 4),
            3 => (false, 1, 8),
            4 => (true, 2, 6),
            5 => (true, 2, 8),
            6 => (true, 4, 6),
            7 => (true, 4, 8),
            8 => (true, 8, 6),
            9 => (true, 8, 8),
            10 => (true, 16, 5),
            11 => (true, 16, 6),
            12 => (true, 16, 8),
            13 => (true, 32, 5),
            14 => (true, 32, 6),
            _ => (true, 32, 8),
        };
        // CKD (18.4.1): tDTS is 1, 2 or 4 times tCK_INT; 3 is reserved.
        let dts = 1 << ((self.cr1 & cr1::CKD) >> 8).min(2);
        let divider = divider * if of_dts { dts } else { 1 };
        Some((self.ratio * divider, samples))
    }

    /// Cycle at which a level that an input takes now leaves its filter.
    fn leaves_filter(&self, now: u64, input: usize) -> Option<u64> {
        let (every, samples) = self.filter(input)?;
        Some((now / every + samples) * every)
    }

    /// Sets the level of TI1 (0) or TI2 (1). Tells whether something was counted at once.
    pub fn set_input(&mut self, now: u64, input: usize, level: bool) -> bool {
        self.sync(now);
        if self.encoder.raw[input] == level {
            return false;
        }
        self.encoder.raw[input] = level;
        self.restart_filter(now, input)
    }

    /// Restarts the filters with the levels at the pins, because their sampling has changed.
    pub(super) fn restart_filters(&mut self, now: u64) {
        for input in 0..2 {
            if self.encoder.due[input].is_some() {
                self.restart_filter(now, input);
            }
        }
    }

    fn restart_filter(&mut self, now: u64, input: usize) -> bool {
        let inputs = &self.encoder;
        let differs = inputs.raw[input] != inputs.filtered[input];
        let leaves = self.leaves_filter(now, input).filter(|_| differs);
        self.encoder.due[input] = leaves;
        self.encoder.find_next();
        differs && leaves.is_none() && self.edge(input)
    }

    /// Lets out of the filters what leaves them by `now`, in the order of time.
    pub(super) fn pass_filters(&mut self, now: u64) {
        while let Some(at) = self.encoder.next.filter(|at| *at <= now) {
            for input in 0..2 {
                if self.encoder.due[input] == Some(at) {
                    self.encoder.due[input] = None;
                    self.edge(input);
                }
            }
            while let Some((_, edges)) = self.encoder.clean.pop_front_if(|(due, _)| *due == at) {
                self.turn_encoder(edges);
            }
            self.encoder.find_next();
        }
    }

    /// An input's level comes out of its filter. Table "counting direction versus encoder signals"
    /// (18.3.12): an edge of TI1 counts up when the two levels differ after it, one of TI2 when
    /// they agree.
    fn edge(&mut self, input: usize) -> bool {
        self.encoder.filtered[input] = self.encoder.raw[input];
        self.capture(input);
        // SMS 1 counts on TI2 only, 2 on TI1 only.
        let counted = self.smcr & 7 == 3 || self.smcr & 7 == [2, 1][input];
        if !self.encoder_ready() || !counted {
            return false;
        }
        let [one, two] = self.encoder.filtered;
        let differ = one != two;
        let up = differ == (input == 0);
        self.count_edges(if up != self.reversed() { 1 } else { -1 });
        true
    }

    /// Whether one of the two inputs is inverted, which reverses the direction; inverting both does
    /// not.
    fn reversed(&self) -> bool {
        (self.ccer >> 1 ^ self.ccer >> 5) & 1 != 0
    }

    /// Turns the encoder by a number of clean quadrature edges, positive when channel 1 leads
    /// channel 2. Modes 1 and 2 count every second edge.
    pub fn encoder_add(&mut self, now: u64, edges: i32) {
        self.sync(now);
        match (0..2).filter_map(|i| self.leaves_filter(now, i)).max() {
            None => self.turn_encoder(edges),
            Some(at) => {
                // Never before one that is under way: the filter may have become shorter.
                let at = self
                    .encoder
                    .clean
                    .back()
                    .map_or(at, |(last, _)| at.max(*last));
                self.encoder.clean.push_back((at, edges));
                self.encoder.find_next();
            }
        }
    }

    fn turn_encoder(&mut self, edges: i32) {
        if !self.encoder_ready() {
            return;
        }
        let edges = i64::from(edges) * if self.reversed() { -1 } else { 1 };
        if self.smcr & 7 == 3 {
            self.count_edges(edges);
        } else {
            let all = edges + i64::from(self.encoder.half_counts);
            self.encoder.half_counts = (all % 2) as i32;
            self.count_edges(all / 2);
        }
    }

    fn count_edges(&mut self, counts: i64) {
        if counts == 0 {
            return;
        }
        let modulus = i128::from(self.arr.active) + 1;
        let sum = i128::from(self.phase) + i128::from(counts);
        let before = self.phase;
        self.phase = sum.rem_euclid(modulus) as u64;
        self.cr1 = (self.cr1 & !cr1::DIR) | if counts < 0 { cr1::DIR } else { 0 };
        if !(0..modulus).contains(&sum) && before <= self.arr.active {
            self.turn();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Kind, reg};
    use super::*;

    /// Encoder mode 3 with these filters and CKD; one core cycle is `ratio` timer clocks.
    fn encoder(filter: [u32; 2], ckd: u32, ratio: u64) -> Timer {
        let mut timer = Timer::new(Kind::GENERAL_16);
        timer.set_ratio(0, ratio);
        for (offset, value) in [
            (reg::CCMR1, 0x0101 | filter[0] << 4 | filter[1] << 12),
            (reg::SMCR, 3),
            (reg::CR1, 1 | ckd << 8),
        ] {
            timer.write(0, offset, value).unwrap();
        }
        timer
    }

    fn count(timer: &mut Timer, now: u64) -> u32 {
        timer.read(now, reg::CNT).unwrap()
    }

    /// Table of IC1F (18.4.7): whether of fDTS, divider, samples.
    const TABLE: [(bool, u64, u64); 15] = [
        (false, 1, 2),
        (false, 1, 4),
        (false, 1, 8),
        (true, 2, 6),
        (true, 2, 8),
        (true, 4, 6),
        (true, 4, 8),
        (true, 8, 6),
        (true, 8, 8),
        (true, 16, 5),
        (true, 16, 6),
        (true, 16, 8),
        (true, 32, 5),
        (true, 32, 6),
        (true, 32, 8),
    ];

    #[test]
    fn only_as_many_samples_as_the_table_says_let_a_level_through() {
        for ratio in [1, 2] {
            for (ckd, of_ck_int) in [(0, 1), (1, 2), (2, 4)] {
                for (filter, (of_dts, divider, samples)) in (1..).zip(TABLE) {
                    let sampling = ratio * divider * if of_dts { of_ck_int } else { 1 };
                    let what = format!("ICxF {filter}, CKD {ckd}, ratio {ratio}");
                    for input in 0..2 {
                        let mut t = encoder([filter, filter], ckd, ratio);
                        // Changed just after a sample: N samples later the level is through, not a
                        // cycle before.
                        let (up, through) = (100 * sampling, (100 + samples) * sampling);
                        t.set_input(up, input, true);
                        assert_eq!(t.next_event(), Some(through), "{what}");
                        assert_eq!(count(&mut t, through - 1), 0, "{what}");
                        assert_ne!(count(&mut t, through), 0, "{what}");

                        // One sample less, and it never was.
                        let mut t = encoder([filter, filter], ckd, ratio);
                        t.set_input(up, input, true);
                        t.set_input(through - 1, input, false);
                        assert_eq!(t.next_event(), None, "{what}");
                        assert_eq!(count(&mut t, 10 * through), 0, "{what}");
                    }
                }
            }
        }
    }

    #[test]
    fn samples_have_to_agree_in_a_row() {
        // fCK_INT, N = 8: seven high, one low, seven high, and then eight.
        let mut t = encoder([3, 3], 0, 1);
        for (at, level) in [(10, true), (17, false), (18, true), (25, false), (30, true)] {
            t.set_input(at, 0, level);
        }
        assert_eq!(count(&mut t, 37), 0);
        assert_eq!(count(&mut t, 38), 1);
    }

    #[test]
    fn levels_count_as_in_the_table_of_directions() {
        // One period with TI1 leading, and back.
        let forward = [(0, true), (1, true), (0, false), (1, false)];
        let back = [(1, true), (0, true), (1, false), (0, false)];
        for (mode, counts) in [(3, [1, 2, 3, 4]), (1, [0, 1, 1, 2]), (2, [1, 1, 2, 2])] {
            let mut t = encoder([0, 0], 0, 1);
            t.write(0, reg::SMCR, mode).unwrap();
            for ((input, level), expected) in forward.into_iter().zip(counts) {
                t.set_input(5, input, level);
                assert_eq!(count(&mut t, 5), expected, "mode {mode}");
            }
            for (input, level) in back {
                t.set_input(6, input, level);
            }
            assert_eq!(count(&mut t, 6), 0, "mode {mode}");
        }
    }

    #[test]
    fn bounce_is_counted_without_a_filter_and_not_with_one() {
        // A contact on TI1 that opens twice before it stays: up and down again without a filter,
        // too.
        for (filter, after_bounce) in [(0, 1), (2, 0)] {
            let mut t = encoder([filter, filter], 0, 1);
            let mut directions = 0;
            for (at, level) in [
                (100, true),
                (101, false),
                (103, true),
                (105, false),
                (107, true),
            ] {
                t.set_input(at, 0, level);
                directions += u32::from(t.read(at, reg::CR1).unwrap() & 0x10 != 0);
            }
            assert_eq!(directions, if filter == 0 { 2 } else { 0 });
            assert_eq!(count(&mut t, 110), after_bounce);
            assert_eq!(count(&mut t, 111), 1);
        }
    }

    #[test]
    fn clean_edges_come_later_by_the_slower_filter() {
        // TI1: fCK_INT, N = 2. TI2: fDTS/32, N = 8, so 256 clocks.
        let mut t = encoder([1, 15], 0, 1);
        t.encoder_add(320, 3);
        t.encoder_add(352, -5);
        assert_eq!(count(&mut t, 575), 0);
        assert_eq!(count(&mut t, 576), 3);
        assert_eq!(count(&mut t, 607), 3);
        assert_eq!(count(&mut t, 608), 0xFFFE);
        assert_eq!(t.next_event(), None);
    }

    #[test]
    fn switching_the_filter_off_lets_the_level_through() {
        let mut t = encoder([15, 15], 0, 1);
        t.set_input(10, 0, true);
        t.write(20, reg::CCMR1, 0x0101).unwrap();
        assert_eq!(count(&mut t, 20), 1);
    }

    #[test]
    fn a_reset_keeps_the_levels_and_forgets_what_was_in_the_filter() {
        let mut t = encoder([15, 15], 0, 1);
        t.set_input(10, 0, true);
        t.encoder_add(10, 7);
        t.reset(20);
        assert_eq!(t.next_event(), None);
        assert!(!t.set_input(30, 0, true), "the level it has");
    }
}
