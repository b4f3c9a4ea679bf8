//! Watches one wheel for defects that a loop cannot correct: a dead or inverted encoder, a blocked
//! wheel.
//!
//! # Theory of operation
//!
//! All three begin alike: the motor is driven well beyond its static friction, and the rate
//! estimate stays behind the reference by more than a threshold. From then on the watch adds up
//! what the encoder counts, raw, and decides by it:
//!
//! | counted | means |
//! |---|---|
//! | clearly *against* the voltage and, for a tenth of the time, the reference | encoder or motor reversed: positive feedback, cut |
//! | the same at a crawl or at standstill, and the voltage does not slow it down | the same |
//! | nothing, after the full time | encoder dead (or wheel blocked hard): ramp |
//! | something else, after the full time | wheel blocked or slipping in its drive: ramp |
//!
//! Inversion is the dangerous one, because the loop drives it to full speed; hence its short time.
//!
//! # At a crawl
//!
//! At a crawl no wheel can stay behind by the whole threshold. There, no count at all while staying
//! behind by more than half the reference is suspicious too, but must last five times as long,
//! because a sticky start looks the same. A few counts forward clear the suspicion: a wheel that
//! its load turns slower or faster than commanded is not dead. Counts backward do not clear it, but
//! a wheel that its load turns backward at a crawl is not reversed either, as long as its voltage
//! slows it down as the motor's model predicts.

use crate::time::Micros;
use protocol::Fault;

use crate::configuration::{Configuration, WheelConfiguration};
use crate::quantity::{Rate, Time, Voltage};
use crate::silence::STRAY_COUNTS_PER_SECOND;
use crate::wheel::{Gains, WheelMeasurement};

/// Inversion must last this fraction of the wheel fault time.
const INVERTED_DIVISOR: u64 = 10;

/// How much longer a suspicion must last at crawling speed.
const CRAWL_FACTOR: u64 = 5;

/// The voltage would have slowed a free wheel down by this part of its fastest rate
const SLOWED_PART: f32 = 0.6;
/// and this, rad/s,
const SLOWED: f32 = 0.2;
/// but it still has this part of its fastest rate.
const UNSLOWED: f32 = 0.9;

/// A wheel this close to its reference is healthy, rad/s.
const WELL: Rate = Rate::new(0.02);

#[derive(Clone, Copy, PartialEq, Debug)]
struct Suspicion {
    since: Micros,
    /// Time since which it lags by the whole threshold, not just by half the reference.
    whole: Option<Micros>,
    /// Angle of the encoder since then, rad.
    travel: f32,
    /// Its fastest rate in that time, rad/s.
    fastest: f32,
    /// Rate by which the opposing voltage would have slowed a free wheel down, rad/s.
    slowed: f32,
}

impl Suspicion {
    fn add(&mut self, measured: WheelMeasurement, voltage: f32, gains: &Gains, dt: f32) {
        let rate = measured.rate.to_f32().abs();
        self.travel += measured.turned.to_f32();
        self.fastest = self.fastest.max(rate);
        if gains.acceleration > 0.0 {
            let against = voltage.abs() + gains.static_friction + gains.speed * rate;
            self.slowed += against / gains.acceleration * dt;
        }
    }

    /// Whether the wheel keeps turning although its voltage should have stopped it by now. A pushed
    /// wheel also turns against its voltage, but is slowed down by it.
    fn runs(&self, rate: f32) -> bool {
        self.slowed > SLOWED_PART * self.fastest + SLOWED && rate > UNSLOWED * self.fastest
    }
}

/// Time of a suspicious tick, and whether the wheel lags by the whole threshold.
#[derive(Clone, Copy)]
struct Tick {
    now: Micros,
    /// Since the last tick, s.
    dt: Time,
    whole: bool,
}

/// Watches one wheel.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Watch {
    gains: Gains,
    blocked_rate: Rate,
    /// Voltage that certainly turns a free wheel.
    effort: Voltage,
    /// Two counts, rad: one may come from vibration at an edge.
    nothing: f32,
    /// Rate that an open input may count, rad/s.
    stray: f32,
    /// Smallest angle by which a wheel turns against its drive in the short time, rad.
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
            gains: wheel.gains,
            blocked_rate: Rate::new(blocked_rate),
            effort: Voltage::new(
                1.5 * wheel.gains.static_friction + 0.1 * wheel.gains.speed * blocked_rate,
            ),
            nothing: 2.0 * wheel.step.abs(),
            stray: STRAY_COUNTS_PER_SECOND * wheel.step.abs(),
            against: 0.25 * blocked_rate * short_s,
            time_us,
            suspicion: None,
            fault: None,
        }
    }

    /// The confirmed fault.
    pub(crate) const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Keeps a fault that was detected elsewhere, unless there is one.
    #[cold]
    pub(crate) fn latch(&mut self, fault: Fault) {
        self.fault.get_or_insert(fault);
    }

    /// Drops a suspicion, but no fault.
    pub(crate) fn forgive(&mut self) {
        self.suspicion = None;
    }

    pub(crate) fn reset(&mut self) {
        self.suspicion = None;
        self.fault = None;
    }

    /// Evaluates one tick: the reference rate in rad/s and the applied voltage in V.
    #[inline]
    pub(crate) fn update(
        &mut self,
        rate_ref: Rate,
        measured: WheelMeasurement,
        voltage: Voltage,
        now: Micros,
        dt: Time,
    ) {
        let behind = (rate_ref - measured.rate).abs();
        let whole = behind > self.blocked_rate;
        let suspicious = whole || behind > rate_ref.abs().half() + WELL;
        if !suspicious || voltage.abs() < self.effort {
            self.suspicion = None;
        } else if self.blocked_rate > Rate::ZERO {
            self.suspect(rate_ref, measured, voltage, Tick { now, dt, whole });
        }
    }

    #[cold]
    fn suspect(
        &mut self,
        rate_ref: Rate,
        measured: WheelMeasurement,
        voltage: Voltage,
        tick: Tick,
    ) {
        let stands = rate_ref.abs() < WELL;
        let (rate_ref, voltage) = (rate_ref.to_f32(), voltage.to_f32());
        let rate = measured.rate.to_f32().abs();
        // A weak suspicion at standstill may have come from the estimate, which still lagged behind
        // a push.
        let weak = |known: Suspicion| known.whole.is_none();
        if stands && tick.whole && self.suspicion.is_some_and(weak) {
            self.suspicion = None;
        }
        let suspicion = self.suspicion.get_or_insert(Suspicion {
            since: tick.now,
            whole: None,
            travel: 0.0,
            fastest: 0.0,
            slowed: 0.0,
        });
        // A strong suspicion stays strong.
        if tick.whole {
            suspicion.whole.get_or_insert(tick.now);
        }
        suspicion.add(measured, voltage, &self.gains, tick.dt.to_f32());
        let suspicion = *suspicion;
        let lasted_us = tick.now.since(suspicion.since).0;
        let whole_us = suspicion.whole.map(|since| tick.now.since(since).0);
        let lasted = lasted_us as f32 * 1e-6;
        let travel = suspicion.travel;
        if whole_us.is_none() && !stands && self.acquits(travel, rate_ref * lasted) {
            self.suspicion = None;
            return;
        }
        let short_us = self.time_us / INVERTED_DIVISOR;
        let against = |direction: f32| {
            direction > 0.0 && travel < -self.against || direction < 0.0 && travel > self.against
        };
        let goes_back = whole_us.is_some_and(|us| us >= short_us) && against(rate_ref);
        let runs = suspicion.runs(rate);
        let reversed = lasted_us >= short_us && against(voltage) && (goes_back || runs);
        let found = if reversed {
            Fault::EncoderInverted
        } else if match whole_us {
            Some(us) => us < self.time_us,
            None => stands || lasted_us < self.time_us * CRAWL_FACTOR,
        } {
            return;
        } else if travel.abs() <= self.nothing + self.stray * lasted {
            Fault::EncoderDead
        } else {
            Fault::WheelBlocked
        };
        // A fault that cuts replaces one that ramps.
        if self.fault.is_none() || found == Fault::EncoderInverted {
            self.fault = Some(found);
        }
    }

    /// Whether this travel, rad, shows that a wheel with this reference is alive. A wheel that its
    /// load turns faster or slower than the reference does; a few stray counts do not, and a wheel
    /// that turns back may be reversed.
    fn acquits(&self, travel: f32, asked: f32) -> bool {
        let ahead = if asked < 0.0 { -travel } else { travel };
        ahead > self.nothing && ahead > 0.25 * asked.abs()
    }
}
