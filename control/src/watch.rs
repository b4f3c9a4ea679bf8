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
use crate::quantity::{Angle, Duration, Quantity, Rate, RateGain, Ratio, Time, Voltage};
use crate::silence::STRAY_COUNTS_PER_SECOND;
use crate::wheel::WheelMeasurement;

/// Inversion must last this fraction of the wheel fault time.
const INVERTED_DIVISOR: u64 = 10;

/// How much longer a suspicion must last at crawling speed.
const CRAWL_FACTOR: u64 = 5;

/// The voltage would have slowed a free wheel down by this part of its fastest rate
const SLOWED_PART: Ratio = Ratio::new(0.6);
/// and this, rad/s,
const SLOWED: Rate = Rate::new(0.2);
/// but it still has this part of its fastest rate.
const UNSLOWED: Ratio = Ratio::new(0.9);

/// A wheel this close to its reference is healthy, rad/s.
const WELL: Rate = Rate::new(0.02);

/// So far ahead it is alive, whatever was asked for, rad.
const ALIVE: Angle = Angle::new(4.0);

/// 1/(V s^2/rad).
type PerAcceleration = Quantity<16>;

#[derive(Clone, Copy, PartialEq, Debug)]
struct Suspicion {
    since: Micros,
    /// Time since which it lags by the whole threshold, not just by half the reference.
    whole: Option<Micros>,
    /// Angle of the encoder since then, rad.
    travel: Angle,
    /// Its fastest rate in that time, rad/s.
    fastest: Rate,
    /// Rate by which the opposing voltage would have slowed a free wheel down, rad/s.
    slowed: Rate,
}

impl Suspicion {
    fn add(&mut self, measured: WheelMeasurement, voltage: Voltage, model: &Model, dt: Time) {
        let rate = measured.rate.abs();
        self.travel += measured.turned;
        self.fastest = self.fastest.max(rate);
        let against = voltage.abs() + model.static_friction + model.speed.times(rate);
        // V s.
        let impulse: Angle = against.times(dt);
        self.slowed += impulse.times(model.per_acceleration);
    }

    /// Whether the wheel keeps turning although its voltage should have stopped it by now. A pushed
    /// wheel also turns against its voltage, but is slowed down by it.
    fn runs(&self, rate: Rate) -> bool {
        let (part, fastest): (Rate, Rate) = (
            self.fastest.times(SLOWED_PART),
            self.fastest.times(UNSLOWED),
        );
        self.slowed > part + SLOWED && rate > fastest
    }
}

/// What slows a wheel down.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Model {
    static_friction: Voltage,
    speed: RateGain,
    /// 0 where the acceleration feedforward is not known.
    per_acceleration: PerAcceleration,
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
    model: Model,
    blocked_rate: Rate,
    /// Voltage that certainly turns a free wheel.
    effort: Voltage,
    /// Two counts, rad: one may come from vibration at an edge.
    nothing: Angle,
    /// Rate that an open input may count, rad/s.
    stray: Angle,
    /// Smallest angle by which a wheel turns against its drive in the short time, rad.
    against: Angle,
    time_us: u64,
    suspicion: Option<Suspicion>,
    fault: Option<Fault>,
}

impl Watch {
    pub(crate) fn new(configuration: &Configuration, wheel: &WheelConfiguration) -> Self {
        let blocked_rate = configuration.thresholds.blocked_rate.to_f32();
        let time_us = configuration.times.wheel_fault_us;
        let short_s = (time_us / INVERTED_DIVISOR) as f32 * 1e-6;
        Self {
            model: Model {
                static_friction: Voltage::new(wheel.gains.static_friction),
                speed: RateGain::new(wheel.gains.speed),
                per_acceleration: if wheel.gains.acceleration > 0.0 {
                    PerAcceleration::new(1.0 / wheel.gains.acceleration)
                } else {
                    PerAcceleration::ZERO
                },
            },
            blocked_rate: Rate::new(blocked_rate),
            effort: Voltage::new(
                1.5 * wheel.gains.static_friction + 0.1 * wheel.gains.speed * blocked_rate,
            ),
            nothing: Angle::new(2.0 * wheel.step.abs()),
            stray: Angle::new(STRAY_COUNTS_PER_SECOND * wheel.step.abs()),
            against: Angle::new(0.25 * blocked_rate * short_s),
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
        // A weak suspicion at standstill may have come from the estimate, which still lagged behind
        // a push.
        let weak = |known: Suspicion| known.whole.is_none();
        if stands && tick.whole && self.suspicion.is_some_and(weak) {
            self.suspicion = None;
        }
        let suspicion = self.suspicion.get_or_insert(Suspicion {
            since: tick.now,
            whole: None,
            travel: Angle::ZERO,
            fastest: Rate::ZERO,
            slowed: Rate::ZERO,
        });
        // A strong suspicion stays strong.
        if tick.whole {
            suspicion.whole.get_or_insert(tick.now);
        }
        suspicion.add(measured, voltage, &self.model, tick.dt);
        let suspicion = *suspicion;
        let lasted_us = tick.now.since(suspicion.since).0;
        let whole_us = suspicion.whole.map(|since| tick.now.since(since).0);
        let lasted = Duration::from_micros(lasted_us);
        let travel = suspicion.travel;
        if whole_us.is_none() && !stands && self.acquits(travel, rate_ref.times(lasted)) {
            self.suspicion = None;
            return;
        }
        let short_us = self.time_us / INVERTED_DIVISOR;
        let against = |ahead: bool, back: bool| {
            ahead && travel < -self.against || back && travel > self.against
        };
        let goes_back = whole_us.is_some_and(|us| us >= short_us)
            && against(rate_ref > Rate::ZERO, rate_ref < Rate::ZERO);
        let runs = suspicion.runs(measured.rate.abs());
        let reversed = lasted_us >= short_us
            && against(voltage > Voltage::ZERO, voltage < Voltage::ZERO)
            && (goes_back || runs);
        let found = if reversed {
            Fault::EncoderInverted
        } else if match whole_us {
            Some(us) => us < self.time_us,
            None => stands || lasted_us < self.time_us * CRAWL_FACTOR,
        } {
            return;
        } else if travel.abs() <= self.nothing + self.stray.times(lasted) {
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
    fn acquits(&self, travel: Angle, asked: Angle) -> bool {
        let ahead = if asked < Angle::ZERO { -travel } else { travel };
        ahead > self.nothing && ahead > asked.abs().half().half().min(ALIVE)
    }
}
