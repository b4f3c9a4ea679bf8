//! The loop around one wheel: feedforward and PI, in volts.
//!
//! The feedforward is the voltage that the motor needs for the reference: `kS` against static
//! friction, `kV` per rate, `kA` per acceleration. The PI part corrects the remaining error.
//! Everything is in physical units, so a gain means the same on every robot and survives a change
//! of battery; the duty is the voltage divided by the present supply.
//!
//! Anti-windup is by back-calculation, with the loop's own time constant `kP / kI`: the voltage
//! that the supply cannot provide is subtracted from the integral, but only as far as the integral
//! itself contributes. Where the feedforward alone exceeds the supply, plain back-calculation would
//! wind the integral up in the other direction; here the integral stays.
//!
//! The *torque bound* keeps the voltage within `I_max R` of the back EMF `kV w`: that is the
//! largest current, without a sensor. It also applies at a kerb, when plugging, and with an encoder
//! that reads wrongly. It is applied before the supply's bound, and the same anti-windup serves
//! both. While the rate estimate lags behind a wheel that is stopped abruptly, for about a tenth of
//! a second, the current may be larger by `kV` times that lag over `R`.
//!
//! Cost: about 45 instructions for one wheel.

use crate::quantity::{
    Acceleration, AccelerationGain, Angle, AngleGain, Ends, Integral, Large, Rate, RateGain, Ratio,
    Time, Voltage,
};
use crate::silence::Trust;

/// Below this rate (rad/s) the static friction term fades out, so that a reference that jitters
/// around zero does not make the motor buzz. A wheel that barely turns, as two of four do in
/// oblique motion, still has to turn: the rate is ten steps of the setpoint (0.1 mm/s at a radius
/// of 0.15 m), not more.
const FRICTION_FADE: Rate = Rate::new(0.01);
/// One over it, s/rad.
const PER_FADE: RateGain = RateGain::new(100.0);

/// Motor and loop of one wheel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Gains {
    /// V.
    pub static_friction: f32,
    /// V s/rad.
    pub speed: f32,
    /// V s^2/rad.
    pub acceleration: f32,
    /// V s/rad.
    pub proportional: f32,
    /// V/rad.
    pub integral: f32,
}

/// Reference of a wheel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelReference {
    /// rad/s.
    pub rate: Rate,
    /// rad/s^2.
    pub acceleration: Acceleration,
}

/// Measurement of a wheel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelMeasurement {
    /// The estimated rate, rad/s.
    pub rate: Rate,
    /// Angle that the encoder counted since the last tick, rad.
    pub turned: Angle,
}

/// Bounds of a loop in a tick.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Available {
    /// Largest voltage, V.
    pub voltage: Voltage,
    /// Time since the last tick, s.
    pub dt: Time,
}

/// The limit of a wheel's voltage that applies.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Held {
    /// The supply.
    pub supply: bool,
    /// The torque bound.
    pub torque: bool,
    /// Whether the voltage that was wanted could be said.
    pub ends: Ends,
}

/// The loop around one wheel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelLoop {
    static_friction: Voltage,
    speed: RateGain,
    acceleration: AccelerationGain,
    proportional: RateGain,
    rising: AngleGain,
    /// Largest voltage beyond the back EMF, V.
    torque: Voltage,
    /// 1/s.
    unwind: Large,
    integral: Integral,
}

impl WheelLoop {
    /// A loop at rest, with at most `torque` V beyond the back EMF.
    #[must_use]
    pub fn new(gains: Gains, torque: f32) -> Self {
        Self {
            static_friction: Voltage::new(gains.static_friction),
            speed: RateGain::new(gains.speed),
            acceleration: AccelerationGain::new(gains.acceleration),
            proportional: RateGain::new(gains.proportional),
            rising: AngleGain::new(gains.integral),
            torque: Voltage::new(torque),
            unwind: if gains.proportional > 0.0 {
                Large::new(gains.integral / gains.proportional)
            } else {
                Large::ZERO
            },
            integral: Integral::ZERO,
        }
    }

    /// The voltage for this `reference` when the wheel turns at `rate` rad/s, within what is
    /// available and the torque bound. What held it back is added to `held`, which is left alone
    /// where nothing did.
    #[inline]
    pub fn update(
        &mut self,
        reference: WheelReference,
        rate: Rate,
        tick: Available,
        held: &mut Held,
    ) -> Voltage {
        let error = reference.rate - rate;
        let wanted =
            self.feedforward(reference) + self.proportional.times(error) + self.integral.voltage();
        let effort = wanted - self.speed.times(rate);
        if wanted.abs() <= tick.voltage && effort.abs() <= self.torque {
            self.rise(error, tick.dt);
            return wanted;
        }
        self.hold(wanted, reference.rate, rate, tick, held)
    }

    /// Lets the integral part follow an error.
    #[inline(always)]
    fn rise(&mut self, error: Rate, dt: Time) {
        self.integral.add(self.rising, error.times(dt));
    }

    /// What the motor needs by its model, V.
    #[inline]
    fn feedforward(&self, reference: WheelReference) -> Voltage {
        // Compared, not clamped: `clamp` on this target is two calls.
        let friction = if reference.rate > FRICTION_FADE {
            self.static_friction
        } else if reference.rate < -FRICTION_FADE {
            -self.static_friction
        } else {
            let share: Ratio = reference.rate.times(PER_FADE);
            self.static_friction.times(share)
        };
        friction
            + self.speed.times(reference.rate)
            + self.acceleration.times(reference.acceleration)
    }

    /// More is wanted than the torque bound or the supply allows.
    #[cold]
    fn hold(
        &mut self,
        wanted: Voltage,
        rate_ref: Rate,
        rate: Rate,
        tick: Available,
        held: &mut Held,
    ) -> Voltage {
        let given = self.bound(wanted, rate, tick.voltage, held);
        held.ends.note(wanted);
        let (excess, error) = (wanted - given, rate_ref - rate);
        if !excess.agrees(error) {
            self.rise(error, tick.dt);
        } else if excess.agrees(self.integral.voltage()) {
            self.integral.unwind(excess, self.unwind.times(tick.dt));
        }
        given
    }

    /// The part of a voltage that the torque bound leaves for a wheel at `rate`, and then the
    /// supply.
    fn bound(&self, wanted: Voltage, rate: Rate, available: Voltage, held: &mut Held) -> Voltage {
        let emf: Voltage = self.speed.times(rate);
        let eased = wanted.max(emf - self.torque).min(emf + self.torque);
        let given = eased.max(-available).min(available);
        held.supply |= given != eased;
        held.torque |= eased != wanted;
        given
    }

    /// The voltage while the encoder is in doubt. Suspected, error and integral together add no
    /// more than the static friction to the feedforward, so that a sticky wheel still comes loose;
    /// dead, the feedforward is all there is. The torque bound is about the rate asked for, because
    /// no other is known.
    #[cold]
    #[inline(never)]
    pub(crate) fn doubt(
        &mut self,
        reference: WheelReference,
        rate: Rate,
        trust: Trust,
        tick: Available,
        held: &mut Held,
    ) -> Voltage {
        let friction = self.static_friction;
        let correction = match trust {
            Trust::Full | Trust::Suspected => {
                let error = reference.rate - rate;
                let half = friction.half();
                let push: Voltage = self.proportional.times(error);
                let push = push.max(-half).min(half);
                let correction = self.integral.voltage() + push;
                let along = if error < Rate::ZERO {
                    -correction
                } else {
                    correction
                };
                if along < friction {
                    self.rise(error, tick.dt);
                }
                self.integral.voltage() + push
            }
            Trust::None => {
                self.integral = Integral::ZERO;
                Voltage::ZERO
            }
        };
        let wanted = self.feedforward(reference) + correction;
        self.bound(wanted, reference.rate, tick.voltage, held)
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.integral = Integral::ZERO;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 1e-3;
    /// Digits of a sum of a few volts, V; in fixed point half a step of 2^-15 for each term.
    const EXACT: f32 = if cfg!(feature = "fixed-point") {
        0.5 * 4.0 / 32_768.0
    } else {
        1e-6
    };
    const GAINS: Gains = Gains {
        static_friction: 0.6,
        speed: 1.2,
        acceleration: 0.12,
        proportional: 2.0,
        integral: 20.0,
    };

    fn at(voltage: f32) -> Available {
        Available {
            voltage: Voltage::new(voltage),
            dt: Time::new(DT),
        }
    }

    /// Reference at this rate, rad/s, and acceleration, rad/s^2.
    fn reference(rate: f32, acceleration: f32) -> WheelReference {
        WheelReference {
            rate: Rate::new(rate),
            acceleration: Acceleration::new(acceleration),
        }
    }

    /// The loop's voltage at this rate, rad/s, in V.
    fn given(
        wheel: &mut WheelLoop,
        reference: WheelReference,
        rate: f32,
        tick: Available,
        held: &mut Held,
    ) -> f32 {
        wheel
            .update(reference, Rate::new(rate), tick, held)
            .to_f32()
    }

    /// A torque bound that is never met, V.
    const PLENTY: f32 = 1e3;

    /// A motor that fits the gains: u = kS sign + kV w + kA w', times `mismatch`.
    struct Motor {
        rate: f32,
        mismatch: f32,
    }

    impl Motor {
        fn step(&mut self, voltage: f32) {
            let gains = GAINS;
            let drive = voltage - gains.speed * self.mismatch * self.rate;
            let friction = gains.static_friction * self.mismatch;
            let net = if self.rate.abs() < 1e-3 && drive.abs() <= friction {
                self.rate = 0.0;
                0.0
            } else if self.rate > 0.0 || (self.rate == 0.0 && drive > 0.0) {
                drive - friction
            } else {
                drive + friction
            };
            self.rate += net / gains.acceleration * DT;
        }
    }

    fn ramp(t: f32) -> WheelReference {
        // Up to 6 rad/s at 6 rad/s^2.
        if t < 1.0 {
            reference(6.0 * t, 6.0)
        } else {
            reference(6.0, 0.0)
        }
    }

    #[test]
    fn feedforward_alone_tracks_a_ramp() {
        let mut wheel = WheelLoop::new(
            Gains {
                proportional: 0.0,
                integral: 0.0,
                ..GAINS
            },
            PLENTY,
        );
        let mut motor = Motor {
            rate: 0.0,
            mismatch: 1.0,
        };
        let mut worst = 0.0_f32;
        for tick in 0..2000_i16 {
            let reference = ramp(f32::from(tick) * DT);
            let mut held = Held::default();
            let voltage = given(&mut wheel, reference, motor.rate, at(24.0), &mut held);
            assert_eq!(held, Held::default());
            motor.step(voltage);
            worst = worst.max((reference.rate.to_f32() - motor.rate).abs());
        }
        // The fade-in of the friction term, and one tick of delay.
        assert!(worst < 0.06, "error {worst}");
    }

    #[test]
    fn integral_removes_what_the_feedforward_misses() {
        let mut wheel = WheelLoop::new(GAINS, PLENTY);
        let mut motor = Motor {
            rate: 0.0,
            mismatch: 1.3,
        };
        for tick in 0..3000_i16 {
            let voltage = given(
                &mut wheel,
                ramp(f32::from(tick) * DT),
                motor.rate,
                at(24.0),
                &mut Held::default(),
            );
            motor.step(voltage);
        }
        assert!((motor.rate - 6.0).abs() < 1e-3, "rate {}", motor.rate);
    }

    #[test]
    fn integral_does_not_wind_up_while_the_supply_is_short() {
        // Asked for an impossible rate for a while, then for a possible one: how long it was
        // impossible must not show.
        let recover = |ticks: u32| {
            let mut wheel = WheelLoop::new(GAINS, PLENTY);
            let mut motor = Motor {
                rate: 0.0,
                mismatch: 1.0,
            };
            let constant = |rate| reference(rate, 0.0);
            for _ in 0..ticks {
                let mut held = Held::default();
                let voltage = given(&mut wheel, constant(30.0), motor.rate, at(12.0), &mut held);
                assert!(voltage.abs() <= 12.0 && held.supply);
                motor.step(voltage);
            }
            let mut rates = std::vec::Vec::new();
            for _ in 0..1000 {
                let voltage = given(
                    &mut wheel,
                    constant(4.0),
                    motor.rate,
                    at(12.0),
                    &mut Held::default(),
                );
                motor.step(voltage);
                rates.push(motor.rate);
            }
            rates
        };
        let (short, long) = (recover(1_000), recover(20_000));
        for (short, long) in short.iter().zip(&long) {
            assert!((short - long).abs() < 1e-3, "{short} and {long}");
        }
        assert!((long[999] - 4.0).abs() < 0.01, "rate {}", long[999]);
    }

    #[test]
    fn standing_still_needs_no_voltage() {
        let mut wheel = WheelLoop::new(GAINS, PLENTY);
        let mut held = Held::default();
        let voltage = given(
            &mut wheel,
            WheelReference::default(),
            0.0,
            at(24.0),
            &mut held,
        );
        assert_eq!((voltage, held), (0.0, Held::default()));
    }

    #[test]
    fn the_sign_of_every_term_is_forward_positive() {
        let mut wheel = WheelLoop::new(GAINS, PLENTY);
        let forward = reference(2.0, 3.0);
        let voltage = given(&mut wheel, forward, 1.5, at(24.0), &mut Held::default());
        // 0.6 + 1.2*2 + 0.12*3 + 2*0.5.
        assert!((voltage - 4.36).abs() < EXACT);
        let mut wheel = WheelLoop::new(GAINS, PLENTY);
        let backward = reference(-2.0, -3.0);
        let voltage = given(&mut wheel, backward, -1.5, at(24.0), &mut Held::default());
        assert!((voltage + 4.36).abs() < EXACT);
    }

    #[test]
    fn a_stalled_wheel_gets_the_bound_and_no_more_however_long() {
        // 6 V beyond the back EMF: 20 A into 0.3 ohm.
        let mut wheel = WheelLoop::new(GAINS, 6.0);
        let reference = self::reference(4.0, 0.0);
        for _ in 0..2_000 {
            let mut held = Held::default();
            let voltage = given(&mut wheel, reference, 0.0, at(24.0), &mut held);
            assert!(voltage <= 6.0);
            assert!(held.torque == (voltage == 6.0) && !held.supply);
        }
        // It comes free: what it stood must not make it overshoot more than a step response does.
        let mut motor = Motor {
            rate: 0.0,
            mismatch: 1.0,
        };
        let mut fastest = 0.0_f32;
        for _ in 0..1_000 {
            let voltage = given(
                &mut wheel,
                reference,
                motor.rate,
                at(24.0),
                &mut Held::default(),
            );
            motor.step(voltage);
            fastest = fastest.max(motor.rate);
        }
        assert!(fastest < 1.25 * 4.0, "up to {fastest} rad/s");
        assert!((motor.rate - 4.0).abs() < 0.01, "rate {}", motor.rate);
    }

    #[test]
    fn plugging_is_bounded_too() {
        let mut wheel = WheelLoop::new(GAINS, 6.0);
        let mut held = Held::default();
        let voltage = given(
            &mut wheel,
            WheelReference::default(),
            10.0,
            at(24.0),
            &mut held,
        );
        // The back EMF is 12 V; the loop alone would give -20 V, 107 A into 0.3 ohm.
        assert!((voltage - 6.0).abs() < EXACT && held.torque);
    }

    #[test]
    fn an_encoder_in_doubt_adds_no_more_than_the_friction() {
        let mut wheel = WheelLoop::new(GAINS, 6.0);
        let reference = self::reference(2.0, 0.0);
        // 0.6 + 1.2*2 and once more 0.6, and what the integral gains in a tick, 20*2 mV; then the
        // feedforward alone.
        let (mut most, mut held) = (0.0_f32, Held::default());
        for _ in 0..1_000 {
            let voltage = wheel
                .doubt(reference, Rate::ZERO, Trust::Suspected, at(24.0), &mut held)
                .to_f32();
            most = most.max(voltage);
        }
        assert!(most > 3.6 - EXACT && most < 3.64 + EXACT, "{most}");
        let voltage = wheel
            .doubt(reference, Rate::ZERO, Trust::None, at(24.0), &mut held)
            .to_f32();
        assert!((voltage - 3.0).abs() < EXACT);
    }
}
