//! The two wires of an encoder, edge by edge, and their faults.
//!
//! A [`Wires`] takes the encoder's whole counts of one interval of time and computes when each of
//! the wires A and B changes its level. The counts of an interval are assumed to have a constant
//! rate. One count is one edge: A leads B while the count goes up.
//!
//! - *Noise* strikes at random times (a Poisson process), A or B with equal chance. A driven wire
//!   gets a pulse of [`GLITCH_NS`]: two edges, which an input filter can reject. An open wire keeps
//!   the level of the noise: one edge, which no filter can reject.
//! - *Slow edges* are those of an open collector with a pull-up R and the cable's capacitance C.
//!   The wire falls at once and rises as `1 - exp(-t / RC)`: half of the supply is reached `RC ln
//!   2` after the transistor has opened. When that lasts longer than a count, the two channels no
//!   longer overlap and the counter goes one up and one down: the largest rate is `1 / (RC ln 2)`
//!   counts a second.
//! - A wire that *floats* follows its neighbour at random: B changes after half of A's edges.
//!
//! Limits: contact bounce, thresholds with hysteresis, and levels that depend on the supply are not
//! modelled.

use crate::random::Random;

/// Length of a noise pulse on a driven wire, ns: a commutation spike, shorter than the 89 ns that
/// eight samples of a 90 MHz timer clock take.
pub const GLITCH_NS: u64 = 60;
/// How long after A's edge a floating B follows, ns.
const CROSSTALK_NS: u64 = 200;

/// One of the two wires changes its level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// When, ns of the world's time.
    pub at_ns: u64,
    /// 0 is A, 1 is B.
    pub channel: usize,
    /// The level from then on.
    pub level: bool,
}

/// Where the level of a wire comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// From the encoder's channel 0 (A) or 1 (B).
    Channel(usize),
    /// From nowhere: it keeps the level that it has.
    Nothing,
    /// From the other wire, by chance.
    Neighbour,
}

#[derive(Debug, Clone, Default)]
struct Wire {
    /// Level at the plug.
    level: bool,
    /// What the source makes of it, behind the slow edge.
    driven: bool,
    /// When a slow rise is over, ns.
    rises_ns: Option<u64>,
    /// When a noise pulse is over, ns.
    glitch_ns: Option<u64>,
    /// When it follows its neighbour, ns.
    follows_ns: Option<u64>,
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Wires {
    /// Noise strikes so many times a second.
    noise_hz: f64,
    /// RC, ns; 0 is none.
    rc_ns: f64,
    sources: [Source; 2],
    wires: [Wire; 2],
    /// Quarter of the line of the encoder, 0..4.
    quarter: u8,
    /// When noise strikes next, ns.
    strikes_ns: Option<f64>,
    random: Random,
}

impl Wires {
    /// Both wires low, each driven by its channel, no noise.
    pub(super) fn new(random: Random) -> Self {
        Self {
            noise_hz: 0.0,
            rc_ns: 0.0,
            sources: [Source::Channel(0), Source::Channel(1)],
            wires: Default::default(),
            quarter: 0,
            strikes_ns: None,
            random,
        }
    }

    /// Lets noise strike so many times a second on average.
    pub(super) fn set_noise(&mut self, hz: f64) {
        self.noise_hz = hz;
        self.strikes_ns = None;
    }

    /// Sets RC of both wires, s.
    pub(super) fn set_slow_edges(&mut self, rc: f64) {
        self.rc_ns = rc * 1e9;
    }

    /// Connects the wires; the levels change, where they do, with the next interval.
    pub(super) fn connect(&mut self, sources: [Source; 2]) {
        self.sources = sources;
    }

    /// Whether counts say all that there is to say.
    pub(super) fn are_clean(&self) -> bool {
        let quiet = |wire: &Wire| {
            wire.rises_ns.is_none() && wire.glitch_ns.is_none() && wire.follows_ns.is_none()
        };
        self.noise_hz == 0.0
            && self.rc_ns == 0.0
            && !self.sources.contains(&Source::Neighbour)
            && self.wires.iter().all(quiet)
    }

    /// Notes the edges of the interval from `from_ns` to `to_ns`, in which the encoder turned from
    /// `from` to `to`, both in counts.
    pub(super) fn follow(
        &mut self,
        (from_ns, to_ns): (u64, u64),
        (from, to): (f64, f64),
        out: &mut Vec<Edge>,
    ) {
        let rate = (to - from) / (to_ns - from_ns).max(1) as f64;
        let mut passed = super::floor(from);
        let last = super::floor(to);
        // Something may have been connected since the last interval.
        self.drive(0, from_ns, out);
        self.drive(1, from_ns, out);
        loop {
            let counts_ns = (passed != last).then(|| {
                let edge = passed + i64::from(last > passed);
                let after = (edge as f64 - from) / rate;
                from_ns + (after.max(0.0) as u64).min(to_ns - from_ns)
            });
            let strikes_ns = self.next_strike(from_ns);
            let own_ns = self.wires.iter().flat_map(|wire| {
                let times = [wire.rises_ns, wire.glitch_ns, wire.follows_ns];
                times.into_iter().flatten()
            });
            let own_ns = own_ns.min();
            let all = [counts_ns, strikes_ns, own_ns];
            let Some(now_ns) = all.into_iter().flatten().min().filter(|at| *at <= to_ns) else {
                return;
            };
            if own_ns == Some(now_ns) {
                self.own(now_ns, out);
            } else if counts_ns == Some(now_ns) {
                let up = last > passed;
                passed += if up { 1 } else { -1 };
                self.quarter = self.quarter.wrapping_add(if up { 1 } else { 3 }) % 4;
                self.drive(0, now_ns, out);
                self.drive(1, now_ns, out);
            } else {
                self.strike(now_ns, out);
            }
        }
    }

    /// When noise strikes next.
    fn next_strike(&mut self, from_ns: u64) -> Option<u64> {
        if self.noise_hz <= 0.0 {
            return None;
        }
        if self.strikes_ns.is_none() {
            self.strikes_ns = Some(from_ns as f64 + self.pause_ns());
        }
        self.strikes_ns.map(|at| at as u64)
    }

    /// Time from one strike to the next: exponentially distributed.
    fn pause_ns(&mut self) -> f64 {
        -libm::log(1.0 - self.random.unit()) / self.noise_hz * 1e9
    }

    fn strike(&mut self, now_ns: u64, out: &mut Vec<Edge>) {
        let pause = self.pause_ns();
        self.strikes_ns = self.strikes_ns.map(|at| at + pause);
        let channel = usize::from(self.random.unit() < 0.5);
        let driven = matches!(self.sources[channel], Source::Channel(_));
        let wire = &mut self.wires[channel];
        if driven {
            wire.glitch_ns = Some(now_ns + GLITCH_NS);
        } else {
            wire.driven = !wire.driven;
        }
        self.settle(channel, now_ns, out);
    }

    /// What a wire does by itself.
    fn own(&mut self, now_ns: u64, out: &mut Vec<Edge>) {
        for channel in 0..2 {
            let wire = &mut self.wires[channel];
            if wire.rises_ns.take_if(|at| *at <= now_ns).is_some() {
                wire.driven = true;
            }
            wire.glitch_ns.take_if(|at| *at <= now_ns);
            if wire.follows_ns.take_if(|at| *at <= now_ns).is_some() && self.random.unit() < 0.5 {
                wire.driven = !wire.driven;
            }
            self.settle(channel, now_ns, out);
        }
    }

    /// The source of a wire has the level that it has now.
    fn drive(&mut self, channel: usize, now_ns: u64, out: &mut Vec<Edge>) {
        let Source::Channel(source) = self.sources[channel] else {
            self.wires[channel].rises_ns = None;
            return;
        };
        let level = [self.quarter == 1 || self.quarter == 2, self.quarter >= 2][source];
        let rise_ns = (self.rc_ns * std::f64::consts::LN_2).round() as u64;
        let wire = &mut self.wires[channel];
        if !level {
            wire.driven = false;
            wire.rises_ns = None;
        } else if !wire.driven && rise_ns > 0 {
            wire.rises_ns.get_or_insert(now_ns + rise_ns);
        } else {
            wire.driven = true;
        }
        self.settle(channel, now_ns, out);
    }

    /// Puts the level at the plug right and notes the edge, if it is one.
    fn settle(&mut self, channel: usize, now_ns: u64, out: &mut Vec<Edge>) {
        let wire = &mut self.wires[channel];
        let level = wire.driven ^ wire.glitch_ns.is_some();
        if std::mem::replace(&mut wire.level, level) == level {
            return;
        }
        out.push(Edge {
            at_ns: now_ns,
            channel,
            level,
        });
        let other = 1 - channel;
        if self.sources[other] == Source::Neighbour {
            self.wires[other].follows_ns = Some(now_ns + CROSSTALK_NS);
        }
    }
}

/// Counts the edges of two wires as a counter without a filter does.
#[derive(Debug, Clone, Copy, Default)]
pub struct Decoder {
    levels: [bool; 2],
}

impl Decoder {
    /// Counts one edge: 1 or -1. An edge of A counts up when the levels differ after it, one of B
    /// when they agree.
    pub fn count(&mut self, edge: &Edge) -> i32 {
        let before = std::mem::replace(&mut self.levels[edge.channel], edge.level);
        if before == edge.level {
            return 0;
        }
        let differ = self.levels[0] != self.levels[1];
        if differ == (edge.channel == 0) { 1 } else { -1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wires() -> Wires {
        Wires::new(Random::new(1))
    }

    /// Follows a constant rate, in intervals of 100 us; the edges and what a counter makes of them.
    fn follow(wires: &mut Wires, counts_per_s: f64, seconds: f64) -> (Vec<Edge>, i32) {
        const STEP_NS: u64 = 100_000;
        let mut edges = Vec::new();
        let at = |step: u64| counts_per_s * (step * STEP_NS) as f64 * 1e-9 + 0.5;
        for step in 0..(seconds * 1e9) as u64 / STEP_NS {
            let times = (step * STEP_NS, (step + 1) * STEP_NS);
            wires.follow(times, (at(step), at(step + 1)), &mut edges);
        }
        let mut decoder = Decoder::default();
        let count = edges.iter().map(|edge| decoder.count(edge)).sum();
        (edges, count)
    }

    /// 10 000 counts a second: an edge every 100 us, the first after half of that, A before B when
    /// it goes up.
    #[test]
    fn every_count_is_an_edge_at_its_own_time() {
        let (edges, count) = follow(&mut wires(), 10_000.0, 1.0);
        assert_eq!((edges.len(), count), (10_000, 10_000));
        for (n, edge) in (0..).zip(&edges) {
            assert!(edge.at_ns.abs_diff(50_000 + 100_000 * n) <= 1, "{edge:?}");
            assert_eq!(edge.channel as u64, n % 2);
        }
        let (_, count) = follow(&mut wires(), -10_000.0, 1.0);
        assert_eq!(count, -10_000);
    }

    /// 1000 a second for 10 s: 10 000 pulses within four standard deviations (4 sqrt(10 000)), all
    /// of the same length, and not one count.
    #[test]
    fn noise_on_a_driven_wire_is_pulses() {
        let mut wires = wires();
        wires.set_noise(1_000.0);
        let (edges, count) = follow(&mut wires, 0.0, 10.0);
        let pulses = edges.len() / 2;
        assert!(pulses.abs_diff(10_000) < 400, "{pulses}");
        assert_eq!(count, 0);
        let lengths = edges.chunks(2).map(|pulse| pulse[1].at_ns - pulse[0].at_ns);
        // Two that strike at once are one longer one.
        let longer = lengths.filter(|ns| *ns != GLITCH_NS).count();
        assert!(longer < 10, "{longer}");
    }

    /// Each strike on an open wire is one edge, which counts 1 either way: of 10 000 the sum of the
    /// squares is 10 000, so the sum is within 4 sqrt(10 000).
    #[test]
    fn noise_on_an_open_wire_counts() {
        let mut wires = wires();
        wires.connect([Source::Nothing; 2]);
        wires.set_noise(1_000.0);
        let (edges, count) = follow(&mut wires, 5_000.0, 10.0);
        assert!(edges.len().abs_diff(10_000) < 400, "{}", edges.len());
        assert!(count != 0 && count.abs() < 400, "{count}");
    }

    /// B follows half of A's edges. A has half of the 100 000 edges; B 25 000 within 4 sqrt(50 000
    /// / 4). At rest there is nothing to follow.
    #[test]
    fn a_floating_wire_follows_its_neighbour_by_chance() {
        let mut wires = wires();
        wires.connect([Source::Channel(0), Source::Neighbour]);
        let (edges, count) = follow(&mut wires, 10_000.0, 10.0);
        let (one, other): (Vec<&Edge>, Vec<&Edge>) =
            edges.iter().partition(|edge| edge.channel == 0);
        assert_eq!(one.len(), 50_000);
        assert!(other.len().abs_diff(25_000) < 450, "{}", other.len());
        assert!(count.abs() < 2_000, "{count}");
        assert_eq!(follow(&mut wires, 0.0, 1.0).0, []);
    }

    /// RC of 20 us: 1 / (20 us ln 2) is 72 135 counts a second. Just below all are counted, just
    /// above none.
    #[test]
    fn slow_edges_have_a_largest_rate() {
        let largest = 1.0 / (20e-6 * std::f64::consts::LN_2);
        for (part, counted) in [(0.99, 1.0), (1.01, 0.0)] {
            let mut wires = wires();
            wires.set_slow_edges(20e-6);
            let (_, count) = follow(&mut wires, part * largest, 1.0);
            let expected = counted * part * largest;
            assert!((f64::from(count) - expected).abs() < 3.0, "{part}: {count}");
        }
    }

    /// A pulse that lies across an edge of the other wire turns one count down into three up, 4
    /// counts apart (18.3.12's table).
    #[test]
    fn a_glitch_across_an_edge_costs_four_counts() {
        let mut decoder = Decoder::default();
        let edges = [(0, true), (1, true), (0, false)].map(|(channel, level)| Edge {
            at_ns: 0,
            channel,
            level,
        });
        let sum: i32 = edges.iter().map(|edge| decoder.count(edge)).sum();
        assert_eq!(sum, 3);
        assert_eq!(Decoder::default().count(&edges[1]), -1);
    }
}
