//! The outputs of a timer's channels: PWM, forced and idle levels (RM0390 rev 6, sections 17.3.8 to
//! 17.3.12).

use super::{Timer, bdtr};

/// What a PWM output does.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PwmState {
    /// Fraction of the time the pin is high, 0..=1. A pin that the timer does not drive counts as
    /// low.
    pub duty: f32,
    /// Duration of one PWM period in nanoseconds of the board's own time; 0 while the counter
    /// stands.
    pub period_ns: u64,
    /// Whether the timer drives the pin: channel enabled, outputs not cut (MOE), counter running,
    /// pin switched to the timer.
    pub active: bool,
}

/// What the outputs of a timer follow from.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct OutputState {
    registers: [u32; 7],
    loaded: [u64; 6],
    ratio: u64,
    /// Where a counter stands that does not count.
    count: Option<u64>,
}

impl Timer {
    /// What its outputs follow from, as of the last [`Timer::sync`].
    pub(crate) fn output_state(&self) -> OutputState {
        let [ccr1, ccr2, ccr3, ccr4] = self.ccr.map(|ccr| ccr.active);
        let [ccmr1, ccmr2] = self.ccmr;
        let (cr1, cr2, smcr, ccer, bdtr) = (self.cr1, self.cr2, self.smcr, self.ccer, self.bdtr);
        let runs = self.enabled() && self.arr.active != 0;
        OutputState {
            registers: [cr1, cr2, smcr, ccmr1, ccmr2, ccer, bdtr],
            loaded: [self.arr.active, self.psc.active, ccr1, ccr2, ccr3, ccr4],
            ratio: self.ratio,
            count: (!runs).then(|| self.count()),
        }
    }

    /// Whether the outputs as a whole are enabled: MOE where there is one.
    #[must_use]
    pub fn outputs_enabled(&self) -> bool {
        !self.kind.advanced || self.bdtr & bdtr::MOE != 0
    }

    /// State of a channel's output (from 0), as of the last [`Timer::sync`]; `hz` is the core
    /// clock.
    #[must_use]
    pub fn pwm(&self, channel: usize, hz: u64) -> PwmState {
        if channel >= self.kind.channels {
            return PwmState::default();
        }
        self.pwm_of(channel, 0, hz)
    }

    /// The same of a complementary output without its main one, as in
    /// [`Timer::complementary_level`].
    #[must_use]
    pub fn complementary_pwm(&self, channel: usize, hz: u64) -> PwmState {
        if !self.kind.advanced || channel > 2 || self.ccer >> (4 * channel) & 1 != 0 {
            return PwmState::default();
        }
        self.pwm_of(channel, 1, hz)
    }

    /// State of a channel's main output (0) or its complementary one (1).
    fn pwm_of(&self, channel: usize, output: usize, hz: u64) -> PwmState {
        let bits = self.ccer >> (4 * channel + 2 * output);
        let (enabled, inverted) = (bits & 1 != 0, bits & 2 != 0);
        let running = self.enabled() && self.arr.active != 0;
        let period_ns = if running { self.period_ns(hz) } else { 0 };
        if !self.outputs_enabled() {
            // Table of output control bits (17.4.9): with OSSI the pin is driven to its idle level.
            let is_high = self.cr2 >> (8 + 2 * channel + output) & 1 != 0;
            let idle = is_high && self.bdtr & bdtr::OSSI != 0 && enabled;
            return PwmState {
                duty: if idle { 1.0 } else { 0.0 },
                period_ns,
                active: false,
            };
        }
        if !enabled {
            return PwmState {
                duty: 0.0,
                period_ns,
                active: false,
            };
        }
        let reference = if running {
            self.reference_duty(channel)
        } else {
            f32::from(u8::from(self.reference(channel)))
        };
        PwmState {
            duty: if inverted { 1.0 - reference } else { reference },
            period_ns,
            active: running,
        }
    }

    fn period_ns(&self, hz: u64) -> u64 {
        const NS: u64 = 1_000_000_000;
        let cycles = self.period() * self.tick();
        match cycles.checked_mul(NS) {
            Some(product) => product / hz,
            None => (u128::from(cycles) * u128::from(NS) / u128::from(hz)) as u64,
        }
    }

    fn mode(&self, channel: usize) -> u32 {
        let half = self.ccmr[channel / 2] >> (8 * (channel % 2));
        if half & 3 != 0 { 0 } else { half >> 4 & 7 }
    }

    /// Share of a period for which OCxREF is high.
    fn reference_duty(&self, channel: usize) -> f32 {
        let (ccr, arr) = (self.ccr[channel].active as f64, self.arr.active as f64);
        let high_in_mode_1 = if self.cr1 & super::cr1::CMS != 0 {
            ccr / arr
        } else if self.cr1 & super::cr1::DIR != 0 {
            // Down: low while the counter is above CCR; 0 % is not possible (17.3.9).
            (ccr + 1.0) / (arr + 1.0)
        } else {
            ccr / (arr + 1.0)
        }
        .min(1.0);
        match self.mode(channel) {
            6 => high_in_mode_1 as f32,
            7 => (1.0 - high_in_mode_1) as f32,
            5 => 1.0,
            _ => 0.0,
        }
    }

    /// Level of OCxREF at the last [`Timer::sync`].
    #[must_use]
    pub fn reference(&self, channel: usize) -> bool {
        let (count, ccr) = (self.count(), self.ccr[channel].active);
        let falling = self.cr1 & super::cr1::DIR != 0 && self.cr1 & super::cr1::CMS == 0;
        let in_mode_1 = if falling { count <= ccr } else { count < ccr };
        match self.mode(channel) {
            6 => in_mode_1,
            7 => !in_mode_1,
            5 => true,
            _ => false,
        }
    }

    /// Level of a channel's pin at the last [`Timer::sync`]; `None` when the timer leaves it
    /// floating.
    #[must_use]
    pub fn level(&self, channel: usize) -> Option<bool> {
        // 18.4.7: a channel that CCxS makes an input drives no pin.
        let input = channel < 4 && self.ccmr[channel / 2] >> (8 * (channel % 2)) & 3 != 0;
        if channel >= self.kind.channels || input || self.ccer >> (4 * channel) & 1 == 0 {
            return None;
        }
        if !self.outputs_enabled() {
            return (self.bdtr & bdtr::OSSI != 0).then(|| self.cr2 >> (8 + 2 * channel) & 1 != 0);
        }
        Some(self.reference(channel) ^ (self.ccer >> (4 * channel + 1) & 1 != 0))
    }

    /// Level of a complementary output without its main one (CCxE clear, CCxNE set) at the last
    /// [`Timer::sync`]; `None` when the timer leaves it floating. With both enabled, and dead time
    /// between them, it is not modelled.
    #[must_use]
    pub fn complementary_level(&self, channel: usize) -> Option<bool> {
        if !self.kind.advanced || channel > 2 || self.ccer >> (4 * channel) & 5 != 4 {
            return None;
        }
        let inverted = self.ccer >> (4 * channel + 3) & 1 != 0;
        if !self.outputs_enabled() {
            // Table of output control bits (17.4.9): with OSSI the pin is driven to OISxN.
            return (self.bdtr & bdtr::OSSI != 0).then(|| self.cr2 >> (9 + 2 * channel) & 1 != 0);
        }
        // Same table: alone, it follows the reference, not its complement.
        Some(self.reference(channel) ^ inverted)
    }
}
