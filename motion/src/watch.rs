//! Watches one wheel for what a loop cannot mend: a dead or inverted encoder, a blocked wheel.
//!
//! All three begin alike: the motor is driven well beyond its static friction, and the rate estimate
//! stays behind the reference by more than a threshold. From then on the watch adds up what the encoder
//! counts, raw, and decides by it:
//!
//! | counted | means |
//! |---|---|
//! | clearly *against* voltage and reference, after a tenth of the time | encoder or motor reversed: positive feedback, cut |
//! | nothing, after the full time | encoder dead (or wheel blocked hard): ramp |
//! | something else, after the full time | wheel blocked or slipping in its drive: ramp |
//!
//! At a crawl nothing can stay behind by the whole threshold. There, no count at all while staying behind by
//! more than half the reference is suspicious too, but must last five times as long, because a sticky start
//! looks the same. One count acquits: a wheel that its load turns slower or faster than asked is not dead.
//!
//! Inversion is the dangerous one, because the loop drives it to full speed; hence its short time.

use canopen::Micros;
use protocol::Fault;

use crate::configuration::{Configuration, WheelConfiguration};
use crate::wheel::WheelMeasurement;

/// Inversion must last this fraction of the wheel fault time.
const INVERTED_DIVISOR: u64 = 10;

/// How much longer a suspicion must last at a crawl.
const CRAWL_FACTOR: u64 = 5;

/// A wheel this close to its reference is well, rad/s.
const WELL: f32 = 0.02;

#[derive(Clone, Copy, PartialEq, Debug)]
struct Suspicion {
    since: Micros,
    /// Behind by the whole threshold, not just by half the reference.
    whole: bool,
    /// What the encoder turned since then, rad.
    travel: f32,
}

/// Watches one wheel.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Watch {
    blocked_rate: f32,
    /// Voltage that turns a free wheel for sure.
    effort: f32,
    /// Two counts, rad: one may come from vibration at an edge.
    nothing: f32,
    /// What a wheel against its drive turns at least in the short time, rad.
    against: f32,
    time_us: u64,
    suspicion: Option<Suspicion>,
    fault: Option<Fault>,
}

impl Watch {
    pub(crate) fn new(configuration: &Configuration, wheel: &WheelConfiguration) -> Self {
        let blocked_rate = configuration.thresholds.blocked_rate;
        let time_us = configuration.times.wheel_fault_us;
        let short_s = (time_us / INVERTED_DIVISOR) as f32 * 1e-6;
        Self {
            blocked_rate,
            effort: 1.5 * wheel.gains.static_friction + 0.25 * wheel.gains.speed * blocked_rate,
            nothing: 2.0 * wheel.step.abs(),
            against: 0.25 * blocked_rate * short_s,
            time_us,
            suspicion: None,
            fault: None,
        }
    }

    /// The fault it is sure of.
    pub(crate) const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    pub(crate) fn reset(&mut self) {
        self.suspicion = None;
        self.fault = None;
    }

    /// Looks at one tick: the rate asked for in rad/s, the voltage given in V.
    #[inline]
    pub(crate) fn update(
        &mut self,
        rate_ref: f32,
        measured: WheelMeasurement,
        voltage: f32,
        now: Micros,
    ) {
        let behind = (rate_ref - measured.rate).abs();
        let whole = behind > self.blocked_rate;
        let suspicious = whole || behind > 0.5 * rate_ref.abs() + WELL;
        if !suspicious || voltage.abs() < self.effort {
            self.suspicion = None;
        } else if self.blocked_rate > 0.0 {
            self.suspect(rate_ref, voltage, (measured.turned, whole), now);
        }
    }

    #[cold]
    fn suspect(&mut self, rate_ref: f32, voltage: f32, (turned, whole): (f32, bool), now: Micros) {
        let fresh = Suspicion {
            since: now,
            whole,
            travel: 0.0,
        };
        // What was weak and is strong now begins anew; what was strong stays so.
        if self.suspicion.is_some_and(|known| whole && !known.whole) {
            self.suspicion = None;
        }
        let suspicion = self.suspicion.get_or_insert(fresh);
        let needed = if suspicion.whole {
            self.time_us
        } else {
            self.time_us * CRAWL_FACTOR
        };
        suspicion.travel += turned;
        let travel = suspicion.travel;
        if !suspicion.whole && travel.abs() > self.nothing {
            self.suspicion = None;
            return;
        }
        let lasted = now.since(suspicion.since).0;
        let against = |direction: f32| {
            direction > 0.0 && travel < -self.against || direction < 0.0 && travel > self.against
        };
        let found =
            if lasted >= self.time_us / INVERTED_DIVISOR && against(voltage) && against(rate_ref) {
                Fault::EncoderInverted
            } else if lasted < needed {
                return;
            } else if travel.abs() <= self.nothing {
                Fault::EncoderDead
            } else {
                Fault::WheelBlocked
            };
        // What cuts replaces what ramps.
        if self.fault.is_none() || found == Fault::EncoderInverted {
            self.fault = Some(found);
        }
    }
}
