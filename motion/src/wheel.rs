//! The loop around one wheel: feedforward and PI, in volts.
//!
//! The feedforward says what the motor needs to do what is asked: `kS` against static friction, `kV`
//! per rate, `kA` per acceleration. The PI part corrects what is left. Everything is in physical
//! units, so a gain means the same on every robot and survives a change of battery; the duty is the
//! voltage over the supply as it is now.
//!
//! Anti-windup is by back-calculation, with the loop's own time constant `kP / kI`: what the supply
//! cannot give is taken out of the integral, but only what the integral itself contributes. Where the
//! feedforward alone asks for too much, plain back-calculation would wind the integral up the other
//! way; here it just waits.
//!
//! Cost: about 40 instructions for one wheel.

/// Below this rate (rad/s) the static friction term fades out, so that a reference that jitters
/// around zero does not make the motor buzz. A wheel that barely turns, as two of four do in oblique motion, has to
/// turn all the same: it is ten steps of the setpoint (0.1 mm/s at a radius of 0.15 m), not more.
const FRICTION_FADE: f32 = 0.01;

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

/// What a wheel is asked for.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelReference {
    /// rad/s.
    pub rate: f32,
    /// rad/s^2.
    pub acceleration: f32,
}

/// What a wheel does.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelMeasurement {
    /// The estimated rate, rad/s.
    pub rate: f32,
    /// What the encoder counted since the last tick, rad.
    pub turned: f32,
}

/// The loop around one wheel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelLoop {
    gains: Gains,
    unwind: f32,
    integral: f32,
}

impl WheelLoop {
    /// A loop at rest.
    #[must_use]
    pub fn new(gains: Gains) -> Self {
        Self {
            gains,
            unwind: if gains.proportional > 0.0 {
                gains.integral / gains.proportional
            } else {
                0.0
            },
            integral: 0.0,
        }
    }

    /// The voltage for this `reference` when the wheel turns at `rate` rad/s, within +-`available` V.
    /// The second value is true when the supply was not enough.
    #[inline]
    pub fn update(
        &mut self,
        reference: WheelReference,
        rate: f32,
        available: f32,
        dt: f32,
    ) -> (f32, bool) {
        let gains = &self.gains;
        let error = reference.rate - rate;
        // Compared, not clamped: `clamp` on this target is two calls.
        let sign = if reference.rate > FRICTION_FADE {
            1.0
        } else if reference.rate < -FRICTION_FADE {
            -1.0
        } else {
            reference.rate * (1.0 / FRICTION_FADE)
        };
        let wanted = gains.static_friction * sign
            + gains.speed * reference.rate
            + gains.acceleration * reference.acceleration
            + gains.proportional * error
            + self.integral;
        if wanted.abs() <= available {
            self.integral += gains.integral * error * dt;
            return (wanted, false);
        }
        self.short(wanted, error, available, dt)
    }

    /// The supply is not enough for what is wanted.
    #[cold]
    fn short(&mut self, wanted: f32, error: f32, available: f32, dt: f32) -> (f32, bool) {
        let given = if wanted > available {
            available
        } else if wanted < -available {
            -available
        } else {
            wanted
        };
        let excess = wanted - given;
        if excess * error <= 0.0 {
            self.integral += self.gains.integral * error * dt;
        } else if excess * self.integral > 0.0 {
            self.integral -= self.unwind * excess * dt;
        }
        (given, excess != 0.0)
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.integral = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 1e-3;
    const GAINS: Gains = Gains {
        static_friction: 0.6,
        speed: 1.2,
        acceleration: 0.12,
        proportional: 2.0,
        integral: 20.0,
    };

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
            WheelReference {
                rate: 6.0 * t,
                acceleration: 6.0,
            }
        } else {
            WheelReference {
                rate: 6.0,
                acceleration: 0.0,
            }
        }
    }

    #[test]
    fn feedforward_alone_tracks_a_ramp() {
        let mut wheel = WheelLoop::new(Gains {
            proportional: 0.0,
            integral: 0.0,
            ..GAINS
        });
        let mut motor = Motor {
            rate: 0.0,
            mismatch: 1.0,
        };
        let mut worst = 0.0_f32;
        for tick in 0..2000_i16 {
            let reference = ramp(f32::from(tick) * DT);
            let (voltage, short) = wheel.update(reference, motor.rate, 24.0, DT);
            assert!(!short);
            motor.step(voltage);
            worst = worst.max((reference.rate - motor.rate).abs());
        }
        // The fade-in of the friction term, and one tick of delay.
        assert!(worst < 0.06, "error {worst}");
    }

    #[test]
    fn integral_removes_what_the_feedforward_misses() {
        let mut wheel = WheelLoop::new(GAINS);
        let mut motor = Motor {
            rate: 0.0,
            mismatch: 1.3,
        };
        for tick in 0..3000_i16 {
            let (voltage, _) = wheel.update(ramp(f32::from(tick) * DT), motor.rate, 24.0, DT);
            motor.step(voltage);
        }
        assert!((motor.rate - 6.0).abs() < 1e-3, "rate {}", motor.rate);
    }

    #[test]
    fn integral_does_not_wind_up_while_the_supply_is_short() {
        // Asked for an impossible rate for a while, then for a possible one: how long it was
        // impossible must not show.
        let recover = |ticks: u32| {
            let mut wheel = WheelLoop::new(GAINS);
            let mut motor = Motor {
                rate: 0.0,
                mismatch: 1.0,
            };
            let constant = |rate| WheelReference {
                rate,
                acceleration: 0.0,
            };
            for _ in 0..ticks {
                let (voltage, short) = wheel.update(constant(30.0), motor.rate, 12.0, DT);
                assert!(voltage.abs() <= 12.0 && short);
                motor.step(voltage);
            }
            let mut rates = std::vec::Vec::new();
            for _ in 0..1000 {
                let (voltage, _) = wheel.update(constant(4.0), motor.rate, 12.0, DT);
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
        let mut wheel = WheelLoop::new(GAINS);
        let (voltage, short) = wheel.update(WheelReference::default(), 0.0, 24.0, DT);
        assert_eq!((voltage, short), (0.0, false));
    }

    #[test]
    fn the_sign_of_every_term_is_forward_positive() {
        let mut wheel = WheelLoop::new(GAINS);
        let reference = WheelReference {
            rate: 2.0,
            acceleration: 3.0,
        };
        let (voltage, _) = wheel.update(reference, 1.5, 24.0, DT);
        // 0.6 + 1.2*2 + 0.12*3 + 2*0.5.
        assert!((voltage - 4.36).abs() < 1e-6);
        let mut wheel = WheelLoop::new(GAINS);
        let backward = WheelReference {
            rate: -2.0,
            acceleration: -3.0,
        };
        let (voltage, _) = wheel.update(backward, -1.5, 24.0, DT);
        assert!((voltage + 4.36).abs() < 1e-6);
    }
}
