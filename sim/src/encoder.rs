//! A wheel's quadrature encoder: whole counts, and their faults.
//!
//! The encoder follows the motor's side of the gear. The noise of a group file is spread evenly
//! over time: if a fraction `p` of the counts is lost, `n p` of `n` counts are, rounded up or down
//! at random so that the mean is right. The random numbers come from the encoder's seed.
//!
//! The encoder normally reports the sum of its counts. With noise on the wires, slow edges or a
//! floating channel it instead reports the edges of its two wires, each at its own time: [`wires`].

pub mod wires;

use std::f64::consts::TAU;

use group::{Encoder as Parameters, EncoderFaultKind, EncoderNoise};

use crate::random::Random;
use wires::{Edge, Source, Wires};

/// The output of an encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EncoderState {
    /// The truth.
    #[default]
    Works,
    /// Nothing: a broken wire.
    Dead,
    /// One count up and one down again: one of its two channels is dead.
    OneChannel,
    /// The opposite: its two channels are swapped.
    Reversed,
    /// Counts by chance: channel B is open and follows A's edges or does not.
    Floats,
}

impl EncoderState {
    /// What drives its two wires.
    fn sources(self) -> [Source; 2] {
        match self {
            Self::Works => [Source::Channel(0), Source::Channel(1)],
            Self::Dead => [Source::Nothing; 2],
            Self::OneChannel => [Source::Channel(0), Source::Nothing],
            Self::Reversed => [Source::Channel(1), Source::Channel(0)],
            Self::Floats => [Source::Channel(0), Source::Neighbour],
        }
    }
}

impl From<EncoderFaultKind> for EncoderState {
    fn from(kind: EncoderFaultKind) -> Self {
        match kind {
            EncoderFaultKind::Dead => Self::Dead,
            EncoderFaultKind::OneChannel => Self::OneChannel,
            EncoderFaultKind::Reversed => Self::Reversed,
        }
    }
}

/// An encoder.
#[derive(Debug, Clone)]
pub struct WheelEncoder {
    counts_per_rad: f64,
    counts: i64,
    /// Where it stands, in counts.
    position: f64,
    noise: EncoderNoise,
    random: Random,
    state: EncoderState,
    /// It counts without errors, and nothing has been done to its wires.
    is_perfect: bool,
    wires: Box<Wires>,
}

impl WheelEncoder {
    /// An encoder that stands at 0 at angle 0.
    #[must_use]
    pub fn new(parameters: &Parameters, noise: EncoderNoise, seed: u64) -> Self {
        Self {
            counts_per_rad: f64::from(parameters.counts_per_revolution * parameters.gear_ratio)
                / TAU,
            counts: 0,
            position: 0.0,
            noise,
            random: Random::new(seed),
            state: EncoderState::Works,
            is_perfect: noise == EncoderNoise::default(),
            // A stream of its own.
            wires: Box::new(Wires::new(Random::new(seed ^ 0x5741_5245_5357_4952))),
        }
    }

    /// Breaks or repairs it.
    pub fn set_state(&mut self, state: EncoderState) {
        self.state = state;
        self.is_perfect = false;
        self.wires.connect(state.sources());
    }

    /// Lets noise strike its wires so many times a second; 0 ends it.
    pub fn set_noise(&mut self, hz: f64) {
        self.is_perfect = false;
        self.wires.set_noise(hz);
    }

    /// Makes the rising edges of its wires slow: R times C, s; 0 ends it.
    pub fn set_slow_edges(&mut self, rc: f64) {
        self.is_perfect = false;
        self.wires.set_slow_edges(rc);
    }

    /// Follows the wheel to an angle (rad, unwrapped) from one time to another, ns; returns the
    /// counts that it reports as a sum, and records the edges that it reports one by one.
    #[inline]
    pub fn follow(&mut self, angle: f64, span_ns: (u64, u64), edges: &mut Vec<Edge>) -> i32 {
        let from = std::mem::replace(&mut self.position, angle * self.counts_per_rad);
        let before = self.counts;
        self.counts = floor(self.position);
        if self.is_perfect {
            return (self.counts - before) as i32;
        }
        self.report((before, from), span_ns, edges)
    }

    /// What it reports with its faults when it has come from this count and position.
    fn report(
        &mut self,
        (before, from): (i64, f64),
        (from_ns, to_ns): (u64, u64),
        edges: &mut Vec<Edge>,
    ) -> i32 {
        let passed = (self.counts - before) as i32;
        let counts = match self.state {
            _ if !self.wires.are_clean() => {
                let to = self.position;
                self.wires.follow((from_ns, to_ns), (from, to), edges);
                0
            }
            EncoderState::Works => passed,
            // A floating one is never clean.
            EncoderState::Dead | EncoderState::Floats => 0,
            EncoderState::OneChannel => channel(self.counts) - channel(before),
            EncoderState::Reversed => -passed,
        };
        if self.noise == EncoderNoise::default() {
            return counts;
        }
        let dt = (to_ns - from_ns) as f64 * 1e-9;
        let lost = self.rounded(f64::from(counts.abs()) * self.noise.lost);
        let extra = self.rounded(self.noise.extra_per_s * dt);
        let up = (0..extra).filter(|_| self.random.unit() < 0.5).count() as i32;
        counts - counts.signum() * lost + 2 * up - extra
    }

    /// Counts since angle 0, all of them.
    #[must_use]
    pub fn counts(&self) -> i64 {
        self.counts
    }

    /// A whole number whose mean is `value`.
    fn rounded(&mut self, value: f64) -> i32 {
        let whole = value.floor();
        whole as i32 + i32::from(self.random.unit() < value - whole)
    }
}

/// Floor, not truncation: zero must not be twice as wide as every other count. (`f64::floor` is a
/// call into a library on machines without an instruction for it, and this is done for every wheel
/// in every step.)
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole - i64::from(whole as f64 > value)
}

/// Level of the channel that is left: it changes at every other count.
fn channel(counts: i64) -> i32 {
    ((counts >> 1) & 1) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    const EIGHT: Parameters = Parameters {
        counts_per_revolution: 8.0,
        gear_ratio: 1.0,
    };
    const EIGHTH: f64 = TAU / 8.0;

    fn encoder(noise: EncoderNoise) -> WheelEncoder {
        WheelEncoder::new(&EIGHT, noise, 1)
    }

    /// Follows in a millisecond, by counts alone.
    fn follow(encoder: &mut WheelEncoder, angle: f64) -> i32 {
        let mut edges = Vec::new();
        let counts = encoder.follow(angle, (0, 1_000_000), &mut edges);
        assert_eq!(edges, []);
        counts
    }

    #[test]
    fn counts_are_whole_and_even_about_zero() {
        let mut encoder = encoder(EncoderNoise::default());
        assert_eq!(follow(&mut encoder, 0.9 * EIGHTH), 0);
        assert_eq!(follow(&mut encoder, -0.1 * EIGHTH), -1);
        assert_eq!(follow(&mut encoder, 2.5 * EIGHTH), 3);
        assert_eq!(follow(&mut encoder, -1.5 * EIGHTH), -4);
        assert_eq!(encoder.counts(), -2);
    }

    #[test]
    fn one_channel_goes_nowhere() {
        let mut encoder = encoder(EncoderNoise::default());
        encoder.set_state(EncoderState::OneChannel);
        let counts: Vec<i32> = (1..=8)
            .map(|n| follow(&mut encoder, (f64::from(n) + 0.5) * EIGHTH))
            .collect();
        assert_eq!(counts, [0, 1, 0, -1, 0, 1, 0, -1]);
    }

    /// Of 80 000 counts a tenth is lost: 8000, give or take four standard deviations of the
    /// rounding of 10 000 steps, 4 sqrt(10 000 / 4).
    #[test]
    fn a_share_of_the_counts_is_lost() {
        let noise = EncoderNoise {
            lost: 0.1,
            extra_per_s: 0.0,
        };
        let mut encoder = encoder(noise);
        let counts = (1..=10_000).map(|n| follow(&mut encoder, TAU * f64::from(n) + 0.1));
        let counts: i32 = counts.sum();
        assert!((counts - 72_000).abs() < 200, "{counts}");
    }

    /// 100 a second for 100 s: 10 000 counts of either sign; their number by the mean, their sum
    /// within four standard deviations, 4 sqrt(10 000).
    #[test]
    fn counts_come_from_nowhere() {
        let noise = EncoderNoise {
            lost: 0.0,
            extra_per_s: 100.0,
        };
        let mut encoder = encoder(noise);
        let counts: Vec<i32> = (0..100_000).map(|_| follow(&mut encoder, 0.0)).collect();
        let number: i32 = counts.iter().map(|n| n.abs()).sum();
        assert!((number - 10_000).abs() < 400, "{number}");
        let sum: i32 = counts.iter().sum();
        assert!(number > 0 && sum.abs() < 400, "{sum}");
    }
}
