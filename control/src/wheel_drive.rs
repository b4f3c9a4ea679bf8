//! The seam between the loops and what turns the wheels.
//!
//! # Theory of operation
//!
//! A loop works in volts at the motor ([`crate::wheel`]), whatever turns the wheel, so gains,
//! torque bound and supervision mean the same on every robot. The conversion of that voltage
//! depends on the drive:
//!
//! - a bridge ([`Bridge`]) is given a duty, which is the voltage over the supply;
//! - a drive that regulates current ([`CurrentDrive`]) is given the current that this voltage would
//!   cause in the winding, `i = (u - K w) / R`, with the motor's own back EMF constant (or, where
//!   it is not known, the speed feedforward) and resistance. The loop that results has the dynamics
//!   of the one with a bridge. The torque bound `I_max R` beyond the back EMF is then exactly
//!   `I_max`.
//!
//! # Interface
//!
//! | | the loops get ([`Inputs`](crate::interface::Inputs)) | the drives get ([`Outputs`](crate::interface::Outputs)) |
//! |---|---|---|
//! | bridge | counts of an encoder, one fault line | duty, -1 to 1; enable |
//! | current drive | counts that it reports, a named fault ([`crate::smart_drive`]) | current, A; enable |
//!
//! [`ControlSide::tick`](crate::tick::ControlSide::tick) is for bridges and
//! [`ControlSide::tick_current`](crate::tick::ControlSide::tick_current) for current drives. An
//! image uses one of them and the linker drops the other. Both are compiled here, not in their
//! caller, so that both are built for speed.
//!
//! # Limits
//!
//! The regulator in a current drive is assumed to be fast: its time constant is a fraction of a
//! tick. An identification of motors behind current drives finds the `kV` and `R` that this
//! conversion uses, so it measures friction and inertia only.

use crate::quantity::{Conductance, Drive, Rate, RateGain, Sign, Voltage};
use crate::wheel::Gains;

/// What the motors of a robot are, as far as a drive's command depends on it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MotorLimits {
    /// The voltage at a motor at rest at which it takes its largest current, V; no bound where that
    /// is not known.
    at_rest: f32,
    /// One over the resistance of a winding; 0 where it is not known.
    conductance: Conductance,
    /// Largest current of a motor, A; 0 where it is not known.
    current: Drive,
    /// Back EMF and torque constant at the wheel; 0 where it is not known apart from the speed
    /// feedforward, which has the viscous friction in it.
    constant: RateGain,
}

impl MotorLimits {
    /// Motors of this resistance (ohm), largest current (A) and constant at the wheel (V s/rad); 0
    /// for each that is not known.
    #[must_use]
    pub fn new(resistance: f32, current: f32, constant: f32) -> Self {
        let voltage = resistance * current;
        Self {
            at_rest: if voltage > 0.0 { voltage } else { f32::MAX },
            conductance: if resistance > 0.0 {
                Conductance::new(1.0 / resistance)
            } else {
                Conductance::ZERO
            },
            current: Drive::new(current),
            constant: RateGain::new(constant),
        }
    }

    /// The voltage at a motor at rest at which it takes its largest current, V; no bound where that
    /// is not known.
    #[must_use]
    pub const fn at_rest(&self) -> f32 {
        self.at_rest
    }
}

/// One tick of all wheels, as the loops leave it.
#[derive(Clone, Copy)]
pub struct Wanted {
    /// Voltages at the motors, V; positive rolls the base forward.
    pub voltages: [Voltage; 4],
    /// Negative where the motor is reversed.
    pub signs: [Sign; 4],
    /// Measured rates of the wheels, rad/s.
    pub rates: [Rate; 4],
    /// Voltage at full duty, V.
    pub supply: Voltage,
}

/// A kind of wheel drive.
pub trait WheelDrive {
    /// Whether a fault that the drives report may be one that ramps.
    const MAY_RAMP: bool;

    /// What the drives are given, with the sign of each motor.
    fn commands(wanted: &Wanted, gains: [&Gains; 4], motors: &MotorLimits) -> [Drive; 4];
}

/// An H-bridge behind a PWM: its command is a duty, -1 to 1.
pub struct Bridge;

impl WheelDrive for Bridge {
    const MAY_RAMP: bool = false;

    #[inline(always)]
    fn commands(wanted: &Wanted, _: [&Gains; 4], _: &MotorLimits) -> [Drive; 4] {
        let per_volt = wanted.supply.inverse();
        let [a, b, c, d] = wanted.voltages;
        let [e, f, g, h] = wanted.signs;
        [e.times(a), f.times(b), g.times(c), h.times(d)].map(|voltage| voltage.times(per_volt))
    }
}

/// A drive that regulates the motor's current: its command is in A.
pub struct CurrentDrive;

impl WheelDrive for CurrentDrive {
    const MAY_RAMP: bool = true;

    #[inline]
    fn commands(wanted: &Wanted, gains: [&Gains; 4], motors: &MotorLimits) -> [Drive; 4] {
        let [a, b, c, d] = wanted.voltages;
        let [e, f, g, h] = wanted.signs;
        let [i, j, k, l] = wanted.rates;
        let [m, n, o, p] = gains;
        let one =
            |voltage, sign: Sign, rate, gains| sign.times(current(voltage, rate, gains, motors));
        [
            one(a, e, i, m),
            one(b, f, j, n),
            one(c, g, k, o),
            one(d, h, l, p),
        ]
    }
}

/// The current that a voltage would cause in the winding of a motor that turns, within what it may
/// take, A. No voltage is no current: a wheel that is not driven coasts. What is not a number is
/// none either.
fn current(voltage: Voltage, rate: Rate, gains: &Gains, motors: &MotorLimits) -> Drive {
    if voltage == Voltage::ZERO {
        return Drive::ZERO;
    }
    let constant = if motors.constant > RateGain::ZERO {
        motors.constant
    } else {
        RateGain::new(gains.speed)
    };
    let current: Drive = (voltage - constant.times(rate)).times(motors.conductance);
    // Compared, not clamped: NaN and a motor without data get nothing.
    if current.abs() <= motors.current {
        current
    } else if current > Drive::ZERO {
        motors.current
    } else if current < Drive::ZERO {
        -motors.current
    } else {
        Drive::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: Gains = Gains {
        static_friction: 0.1,
        speed: 0.3,
        acceleration: 0.0,
        proportional: 0.0,
        integral: 0.0,
    };
    fn motors(constant: f32) -> MotorLimits {
        MotorLimits::new(0.2, 10.0, constant)
    }

    fn commands<D: WheelDrive>(voltages: [f32; 4], rates: [f32; 4]) -> [f32; 4] {
        let wanted = Wanted {
            voltages: voltages.map(Voltage::new),
            signs: [1.0, -1.0, 1.0, -1.0].map(Sign::new),
            rates: rates.map(Rate::new),
            supply: Voltage::new(24.0),
        };
        D::commands(&wanted, [&GAINS; 4], &motors(0.0)).map(Drive::to_f32)
    }

    #[test]
    fn a_bridge_gets_the_voltage_over_the_supply() {
        let given = commands::<Bridge>([12.0, 12.0, -6.0, 0.0], [5.0; 4]);
        for (given, expected) in given.into_iter().zip([0.5, -0.5, -0.25, 0.0]) {
            assert!((given - expected).abs() < 1e-6, "{given} {expected}");
        }
    }

    /// (3.5 V - 0.3 V s/rad x 10 rad/s) / 0.2 ohm is 2.5 A; plugging, (-1 - 3) / 0.2 is -20 A, of
    /// which 10 are allowed.
    #[test]
    fn a_current_drive_gets_what_the_voltage_would_cause() {
        let given = commands::<CurrentDrive>([3.5, 3.5, -1.0, 6.0], [10.0; 4]);
        let expected = [2.5, -2.5, -10.0, -10.0];
        for (given, expected) in given.into_iter().zip(expected) {
            assert!((given - expected).abs() < 1e-5, "{given} {expected}");
        }
        // A constant of its own: (3.5 - 0.25 x 10) / 0.2 is 5 A.
        let (voltage, rate) = (Voltage::new(3.5), Rate::new(10.0));
        let known = current(voltage, rate, &GAINS, &motors(0.25));
        assert!((known.to_f32() - 5.0).abs() < 1e-5);
    }

    #[test]
    fn no_voltage_is_no_current_and_nothing_comes_of_nonsense() {
        assert_eq!(commands::<CurrentDrive>([0.0; 4], [10.0; 4]), [0.0; 4]);
        assert_eq!(commands::<CurrentDrive>([f32::NAN; 4], [0.0; 4]), [0.0; 4]);
        let unknown = MotorLimits::new(0.0, 0.0, 0.0);
        let none = current(Voltage::new(1.0), Rate::ZERO, &GAINS, &unknown);
        assert_eq!(none, Drive::ZERO);
    }
}
