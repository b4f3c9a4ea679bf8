//! A battery with internal resistance that the motors of one robot share.
//!
//! The bridges draw `I = sum(duty i)` and the terminals are at `U = E - R I`. Each motor's current at the
//! end of a step is `a + b U`, see [`Motor::admittance`]; so `U = (E - R sum(duty a)) / (1 + R sum(duty b))`,
//! which is stable for any resistance. Motors that brake charge it. The voltage without load may follow
//! the charge.

use group::Battery as Parameters;

use crate::motor::{Drive, Motor};

const AS_PER_AH: f64 = 3600.0;

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub struct Battery {
    parameters: Parameters,
    charge: f64,
}

impl Battery {
    /// A battery at its first charge.
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            charge: parameters.charge,
            parameters: parameters.clone(),
        }
    }

    /// Advances the motors by `dt` (s) under constant drive; returns the voltage at the terminals.
    pub fn step(&mut self, motors: &mut [Motor; 4], drives: &[Drive; 4], dt: f64) -> f64 {
        let r = self.parameters.resistance;
        let (mut still, mut per_volt) = (0.0, 0.0);
        for (motor, drive) in motors.iter().zip(drives) {
            let (a, b) = motor.admittance(dt, *drive);
            let duty = drive.duty.clamp(-1.0, 1.0);
            still += duty * a;
            per_volt += duty * b;
        }
        let open = self.open_volts(motors[0].supply());
        let volts = (open - r * still) / (1.0 + r * per_volt);
        for (motor, drive) in motors.iter_mut().zip(drives) {
            motor.step_on(volts, dt, *drive);
        }
        if let Some(capacity) = self.parameters.capacity_ah {
            let used = (still + per_volt * volts) * dt / (capacity * AS_PER_AH);
            self.charge = (self.charge - used).clamp(0.0, 1.0);
        }
        volts
    }

    /// Charge, 0..=1.
    #[must_use]
    pub fn charge(&self) -> f64 {
        self.charge
    }

    /// Voltage without load: the curve's, held at its ends, or the nominal one where there is none.
    fn open_volts(&self, nominal: f64) -> f64 {
        let curve = &self.parameters.curve;
        let above = curve.partition_point(|(charge, _)| *charge <= self.charge);
        let low = above.checked_sub(1).and_then(|below| curve.get(below));
        match (low, curve.get(above)) {
            (Some(low), Some(high)) => {
                low.1 + (self.charge - low.0) / (high.0 - low.0) * (high.1 - low.1)
            }
            (Some(end), None) | (None, Some(end)) => end.1,
            (None, None) => nominal,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTOR: group::Motor = group::Motor {
        supply: 24.0,
        constant: 0.8,
        resistance: 0.3,
        inductance: 3e-4,
        inertia: 0.4,
        friction: 0.0,
        viscous: 0.02,
    };
    const STEP: f64 = 100e-6;

    fn battery(resistance: f64) -> Battery {
        Battery::new(&Parameters {
            resistance,
            capacity_ah: Some(1.0),
            charge: 0.5,
            curve: vec![(0.0, 20.0), (1.0, 28.0)],
        })
    }

    fn drive(duty: f64, wheels: usize) -> [Drive; 4] {
        std::array::from_fn(|n| Drive {
            duty,
            enabled: n < wheels,
            brake_released: true,
        })
    }

    /// Wheels held by the brake: every motor is `duty U / R`, the battery gives `duty` of it four times, so
    /// `U = E / (1 + 4 duty^2 r / R)`: with 24 V, 0.5, 0.1 ohm and 0.3 ohm 24 / (1 + 1/3) = 18 V. A
    /// hundred ohms would make an explicit step explode.
    #[test]
    fn stalled_motors_pull_the_voltage_down() {
        for (resistance, expected) in [(0.1, 18.0), (100.0, 24.0 / (1.0 + 1000.0 / 3.0))] {
            let mut motors = std::array::from_fn(|_| Motor::new(&MOTOR));
            let held = drive(0.5, 4).map(|d| Drive {
                brake_released: false,
                ..d
            });
            let mut volts = 0.0;
            let mut battery = battery(resistance);
            // The winding settles within a millisecond or so; the charge hardly moves.
            for _ in 0..1_000 {
                volts = battery.step(&mut motors, &held, STEP);
            }
            assert!((volts - expected).abs() < 0.02, "{volts} {expected}");
            assert!(motors.iter().all(|m| m.angle() == 0.0));
        }
    }

    /// One wheel driven to its end draws `b w / k` on top of nothing: with the sag of that the speed is
    /// `U duty / (k + R b / k)`.
    #[test]
    fn a_weak_battery_makes_a_slow_wheel() {
        let mut motors = std::array::from_fn(|_| Motor::new(&MOTOR));
        let mut battery = battery(0.5);
        let mut volts = 0.0;
        for _ in 0..60_000 {
            volts = battery.step(&mut motors, &drive(1.0, 1), STEP);
        }
        let (k, r, b) = (f64::from(0.8f32), f64::from(0.3f32), f64::from(0.02f32));
        let open = 20.0 + 8.0 * battery.charge();
        let rate = open / (k + (r + 0.5) * b / k);
        assert!(
            (motors[0].rate() / rate - 1.0).abs() < 1e-4,
            "{}",
            motors[0].rate()
        );
        assert!(
            (volts - (open - 0.5 * b * rate / k)).abs() < 1e-3,
            "{volts}"
        );
    }

    /// 1 Ah at 0.5 and a current that is known: after 36 s at 20 A (2 % of an hour) 0.2 Ah are gone. Held
    /// wheels draw `duty^2 U / R` each.
    #[test]
    fn charge_runs_down_by_the_current() {
        let mut motors = std::array::from_fn(|_| Motor::new(&MOTOR));
        let held = drive(0.25, 4).map(|d| Drive {
            brake_released: false,
            ..d
        });
        let mut battery = Battery::new(&Parameters {
            resistance: 0.0,
            capacity_ah: Some(1.0),
            charge: 0.5,
            curve: Vec::new(),
        });
        for _ in 0..36_000 {
            battery.step(&mut motors, &held, 1e-3);
        }
        let amps = 4.0 * 0.25 * 0.25 * 24.0 / f64::from(0.3f32);
        let expected = 0.5 - amps * 36.0 / 3600.0;
        assert!(
            (battery.charge() - expected).abs() < 1e-4,
            "{}",
            battery.charge()
        );
    }
}
