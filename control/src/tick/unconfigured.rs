//! Whether the wheels turned before there was a configuration. Only that says how far a wheel turns
//! in a count, so the counts are noted and judged when it comes.

use super::judge::TURNING_RATE;
use crate::configuration::Configuration;
use crate::time::TICK_US;

/// Ticks over which counts are noted: in 100 ms a wheel at the rate that refuses a start turns by
/// 20 mrad, several counts of a coarse encoder.
const TICKS: u8 = 100;
/// The same, s.
const SECONDS: f32 = TICKS as f32 * TICK_US as f32 * 1e-6;
/// An encoder at rest on an edge may count up and down, and its counts say nothing.
const AT_REST: i16 = 1;

/// The counts of the four encoders, wrapping.
#[derive(Clone, Copy)]
pub(super) struct Unconfigured {
    from: [u16; 4],
    ticks: u8,
    /// Counts in the last whole time.
    counts: [i16; 4],
}

impl Unconfigured {
    pub(super) const fn new() -> Self {
        Self {
            from: [0; 4],
            ticks: TICKS,
            counts: [0; 4],
        }
    }

    /// A tick without a configuration; the first begins to count.
    pub(super) fn note(&mut self, counters: [u16; 4], is_first: bool) {
        if self.ticks < TICKS && !is_first {
            self.ticks += 1;
            return;
        }
        let from = core::mem::replace(&mut self.from, counters);
        self.ticks = 1;
        if !is_first {
            for ((counts, to), from) in self.counts.iter_mut().zip(counters).zip(from) {
                *counts = to.wrapping_sub(from).cast_signed();
            }
        }
    }

    /// Whether a wheel turned too fast for a start.
    pub(super) fn turned(&self, configuration: &Configuration) -> bool {
        let mut wheels = self.counts.iter().zip(&configuration.wheels);
        wheels.any(|(counts, wheel)| {
            let angle = f32::from(counts.saturating_abs()) * wheel.step.abs();
            counts.saturating_abs() > AT_REST && angle > TURNING_RATE.to_f32() * SECONDS
        })
    }
}
