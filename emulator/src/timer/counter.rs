//! From time to counts: the counter, its flags, and the times of its next events.
//!
//! The position of the counter is kept as a *phase* that only ever grows within a period and starts
//! again at 0:
//!
//! | mode | phase p | counter | period in ticks | update at phase |
//! |---|---|---|---|---|
//! | up | 0..=ARR | p | ARR + 1 | ARR + 1 |
//! | down | 0..=ARR | ARR - p | ARR + 1 | ARR + 1 |
//! | centre-aligned | 0..2 ARR | p, then 2 ARR - p | 2 ARR | ARR and 2 ARR |
//!
//! [`Timer::sync`] advances the phase from the last call to now, sets the flags whose time lay in
//! between, and loads the preload registers at the update events. Once every preload has been
//! loaded, whole periods only set flags that are already set, and are skipped in one step.

use super::{Timer, bdtr, cr1, flag, reg};

impl Timer {
    fn centre_aligned(&self) -> bool {
        self.cr1 & cr1::CMS != 0
    }

    fn counts_down(&self) -> bool {
        self.cr1 & cr1::DIR != 0
    }

    /// Core clock cycles per tick of the counter.
    pub(super) fn tick(&self) -> u64 {
        self.ratio * (self.psc.active + 1)
    }

    /// Ticks per period.
    pub(super) fn period(&self) -> u64 {
        if self.centre_aligned() {
            2 * self.arr.active
        } else {
            self.arr.active + 1
        }
    }

    /// Whether the counter counts the internal clock. It does not while ARR is 0 (17.4.12) or an
    /// encoder counts.
    fn running(&self) -> bool {
        self.cr1 & cr1::CEN != 0 && self.smcr & 7 == 0 && self.arr.active != 0
    }

    /// Whether the counter is enabled.
    pub(super) fn enabled(&self) -> bool {
        self.cr1 & cr1::CEN != 0
    }

    /// The counter, as of the last [`Timer::sync`].
    pub(super) fn count(&self) -> u64 {
        let arr = self.arr.active;
        if self.smcr & 7 != 0 {
            self.phase
        } else if self.centre_aligned() {
            if self.phase <= arr {
                self.phase
            } else {
                (2 * arr).saturating_sub(self.phase)
            }
        } else if self.counts_down() {
            arr.saturating_sub(self.phase)
        } else {
            self.phase
        }
    }

    /// Puts the counter at a value; in centre-aligned mode on the way up.
    pub(super) fn set_count(&mut self, now: u64, count: u64) {
        if !self.running() {
            self.anchor = now;
        }
        let down = self.counts_down() && !self.centre_aligned() && self.smcr & 7 == 0;
        self.phase = if down {
            self.arr.active.saturating_sub(count)
        } else {
            count
        };
    }

    /// Ticks from a phase to the next overflow or underflow, and the phase after it.
    fn to_turn(&self, phase: u64) -> (u64, u64) {
        let arr = self.arr.active;
        if self.centre_aligned() {
            if phase < arr {
                (arr - phase, arr)
            } else {
                ((2 * arr).saturating_sub(phase).max(1), 0)
            }
        } else if phase > arr {
            // The counter was put beyond ARR: it runs on to its end, and nothing is compared on the
            // way.
            (self.kind.max + 1 - phase, 0)
        } else {
            (arr + 1 - phase, 0)
        }
    }

    fn preload_pending(&self) -> bool {
        self.cr1 & cr1::UDIS == 0
            && (self.psc.pending()
                || self.arr.pending()
                || self.ccr.iter().any(|ccr| ccr.pending())
                || (self.bdtr & (bdtr::AOE | bdtr::MOE) == bdtr::AOE && !self.break_active())
                || self.cr1 & cr1::OPM != 0)
    }

    /// Brings the timer to cycle `now`.
    pub fn sync(&mut self, now: u64) {
        if self.encoder.next.is_some_and(|at| at <= now) {
            self.pass_filters(now);
        }
        while self.running() {
            let (tick, since) = (self.tick(), now.saturating_sub(self.anchor));
            if since < tick {
                return;
            }
            let ticks = since / tick;
            let (turn, next_phase) = self.to_turn(self.phase);
            if ticks < turn {
                self.flag_matches(self.phase, self.phase + ticks);
                self.phase += ticks;
                self.anchor += ticks * tick;
                return;
            }
            let overrun = self.phase > self.arr.active && !self.centre_aligned();
            if !overrun {
                self.flag_matches(self.phase, self.phase + turn);
            }
            self.anchor += turn * tick;
            self.phase = next_phase;
            if !overrun {
                self.turn();
                self.skip_periods(now);
            }
        }
        self.anchor = self.anchor.max(now);
    }

    /// Jumps over periods that can change nothing but the repetition counter. One full period
    /// before `now` is left to be walked through, and sets every flag there is to set.
    fn skip_periods(&mut self, now: u64) {
        if !self.running() || self.preload_pending() {
            return;
        }
        let length = self.period() * self.tick();
        let periods = now.saturating_sub(self.anchor) / length;
        // With a repetition counter the first update may be many periods away: walk until it has
        // happened.
        if periods < 3 || (self.repetitions != self.rcr && self.sr & flag::UPDATE == 0) {
            return;
        }
        let skipped = periods - 1;
        self.anchor += skipped * length;
        let turns = skipped * if self.centre_aligned() { 2 } else { 1 };
        let cycle = u64::from(self.rcr) + 1;
        let into = (u64::from(self.rcr.saturating_sub(self.repetitions)) + turns) % cycle;
        self.repetitions = (cycle - 1 - into) as u32;
    }

    /// Sets the compare flags whose match lies after phase `from` and not after phase `to`.
    fn flag_matches(&mut self, from: u64, to: u64) {
        for channel in 0..self.kind.channels {
            if self.sr & flag::compare(channel) != 0 {
                continue;
            }
            for at in self.match_phases(channel).into_iter().flatten() {
                if from < at && at <= to {
                    self.sr |= flag::compare(channel);
                }
            }
        }
    }

    /// Phases in 1..=period at which a channel's compare flag is set (17.3.7, 17.3.9, 17.3.10).
    fn match_phases(&self, channel: usize) -> [Option<u64>; 2] {
        let (ccr, arr) = (self.ccr[channel].active, self.arr.active);
        if (self.ccmr[channel / 2] >> (8 * (channel % 2))) & 3 != 0 {
            return [None, None]; // an input
        }
        if self.centre_aligned() {
            let (on_way_down, on_way_up) = match (self.cr1 & cr1::CMS) >> 5 {
                1 => (true, false),
                2 => (false, true),
                _ => (true, true),
            };
            let up = (on_way_up && ccr <= arr && ccr > 0).then_some(ccr);
            let down = (on_way_down && ccr < arr).then_some(2 * arr - ccr);
            [up, down]
        } else if self.counts_down() {
            let at = if ccr == arr {
                Some(arr + 1)
            } else {
                arr.checked_sub(ccr)
            };
            [at, None]
        } else if ccr == 0 || ccr > arr {
            [Some(arr + 1), None] // at the overflow
        } else {
            [Some(ccr), None]
        }
    }

    /// An overflow or underflow.
    pub(super) fn turn(&mut self) {
        if self.cr1 & cr1::UDIS != 0 {
            return;
        }
        if self.kind.advanced && self.repetitions > 0 {
            self.repetitions -= 1;
            return;
        }
        self.load_preloads();
        self.sr |= flag::UPDATE;
        if self.cr1 & cr1::OPM != 0 {
            self.cr1 &= !cr1::CEN;
        }
        if self.bdtr & bdtr::AOE != 0 && !self.break_active() {
            self.bdtr |= bdtr::MOE;
        }
    }

    fn load_preloads(&mut self) {
        self.psc.load();
        self.arr.load();
        for ccr in &mut self.ccr {
            ccr.load();
        }
        self.repetitions = self.rcr;
    }

    /// ARR without preload: in effect at once, the counter stays where it is.
    pub(super) fn set_arr_now(&mut self, value: u64) {
        let count = self.count();
        let upper_half = self.centre_aligned() && self.phase > self.arr.active;
        self.arr.set_now(value);
        self.phase = if upper_half {
            (2 * value).saturating_sub(count)
        } else if self.counts_down() && !self.centre_aligned() {
            value.saturating_sub(count)
        } else {
            count
        };
    }

    /// A write to CR1. Changing the way of counting keeps the counter where it is.
    pub(super) fn write_cr1(&mut self, now: u64, value: u32) {
        let value = if self.kind.full {
            value
        } else {
            value & !(cr1::DIR | cr1::CMS)
        };
        let count = self.count();
        let way = cr1::DIR | cr1::CMS;
        let turned = (self.cr1 ^ value) & way != 0;
        let started = value & !self.cr1 & cr1::CEN != 0;
        let divided = (self.cr1 ^ value) & cr1::CKD != 0;
        self.cr1 = value;
        if divided {
            self.restart_filters(now);
        }
        if started {
            self.anchor = now;
        }
        if turned {
            self.set_count(now, count);
        }
        if self.cr1 & cr1::ARPE == 0 {
            let written = self.arr.written;
            if self.arr.pending() {
                self.set_arr_now(written);
            }
        }
    }

    /// A write to EGR: events made by software (17.4.6).
    pub(super) fn generate(&mut self, now: u64, value: u32) {
        if value & flag::UPDATE != 0 {
            self.phase = 0;
            self.anchor = now;
            if self.cr1 & cr1::UDIS == 0 {
                self.load_preloads();
                if self.cr1 & cr1::URS == 0 {
                    self.sr |= flag::UPDATE;
                }
            }
        }
        for channel in 0..self.kind.channels {
            self.sr |= value & flag::compare(channel);
        }
        self.sr |= value & (flag::TRIGGER | flag::COM);
        if self.kind.advanced && value & flag::BREAK != 0 {
            self.sr |= flag::BREAK;
            self.bdtr &= !bdtr::MOE;
        }
    }

    /// Whether no interrupt is enabled and no edge is on its way: no line is up, and there is no
    /// next event.
    #[must_use]
    #[inline]
    pub fn is_quiet(&self) -> bool {
        self.dier == 0 && self.encoder.next.is_none()
    }

    /// Cycle of the next interrupt, of a preload that has to be checked before the interrupt is
    /// known, or of an edge that leaves its filter. Valid after [`Timer::sync`].
    #[must_use]
    pub fn next_event(&self) -> Option<u64> {
        let wanted = self.dier & !self.sr;
        if wanted & 0x1F == 0 || !self.running() {
            return self.encoder.next;
        }
        let (turn, _) = self.to_turn(self.phase);
        let mut ticks = u64::MAX;
        let turn_matters = wanted & flag::UPDATE != 0 && self.cr1 & cr1::UDIS == 0;
        if turn_matters || self.preload_pending() {
            ticks = turn;
        }
        for channel in 0..self.kind.channels {
            if wanted & flag::compare(channel) == 0 {
                continue;
            }
            for at in self.match_phases(channel).into_iter().flatten() {
                let ahead = if at > self.phase {
                    at - self.phase
                } else {
                    at + self.period() - self.phase
                };
                ticks = ticks.min(ahead);
            }
        }
        (ticks != u64::MAX).then(|| self.anchor + ticks * self.tick())
    }

    /// Cycle at which preload registers will next be loaded, if one is pending. Valid after
    /// [`Timer::sync`].
    #[must_use]
    pub fn next_load(&self) -> Option<u64> {
        let waits = self.running() && self.preload_pending();
        waits.then(|| self.anchor + self.to_turn(self.phase).0 * self.tick())
    }

    /// Name of the register at an offset.
    #[must_use]
    pub fn register_name(offset: u32) -> &'static str {
        match offset {
            reg::CR1 => "CR1",
            reg::CR2 => "CR2",
            reg::SMCR => "SMCR",
            reg::DIER => "DIER",
            reg::SR => "SR",
            reg::EGR => "EGR",
            reg::CCMR1 => "CCMR1",
            reg::CCMR2 => "CCMR2",
            reg::CCER => "CCER",
            reg::CNT => "CNT",
            reg::PSC => "PSC",
            reg::ARR => "ARR",
            reg::RCR => "RCR",
            reg::CCR1..=reg::CCR4 => "CCR1..4",
            reg::BDTR => "BDTR",
            reg::DCR => "DCR",
            reg::DMAR => "DMAR",
            reg::OR => "OR",
            _ => "?",
        }
    }
}
