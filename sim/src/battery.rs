//! The supply of one robot's motors: a battery with internal resistance, and a supply that cannot
//! sink current.
//!
//! The bridges draw `I = sum(duty i)` and the terminals are at `U = E - R I`. Each motor's current
//! at the end of a step is `a + b U`, see [`Motors::admittances`]; so `U = (E - R sum(duty a)) /
//! (1 + R sum(duty b))`, which is stable for any resistance. Motors that brake charge it. The
//! voltage without load may follow the charge.
//!
//! A bench supply, or a battery whose protection has opened for charging, sources current but does
//! not sink it. The energy that the motors return then stays in the capacitors at the bridges: `C
//! dU = -I dt`, in a step from `U0` to `U = (C U0 - dt sum(duty a)) / (C + dt sum(duty b))`, and
//! never below the voltage of the source. The voltage has no upper limit: bridges and capacitors
//! that fail at some voltage are not modelled.

use group::Battery as Parameters;

use crate::motor::{Bridge, Motors};

const AS_PER_AH: f64 = 3600.0;

/// What feeds the motors of one robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Supply {
    battery: Option<Battery>,
    /// Of the capacitors at the bridges, F, where the source takes no charge.
    capacitance: Option<f64>,
    /// At the bridges, V; until the first step that of the motors.
    volts: Option<f64>,
}

impl Supply {
    /// This battery, or the motors' nominal voltage whatever they draw.
    #[must_use]
    pub fn new(battery: Option<Battery>) -> Self {
        Self {
            battery,
            ..Self::default()
        }
    }

    /// Makes the source sink no current, so that these capacitors, F, are charged instead; `None`
    /// lets it take charge again.
    pub fn block_charge(&mut self, capacitance: Option<f64>) {
        self.capacitance = capacitance;
    }

    /// Voltage at the bridges after the last step; `None` is the nominal one.
    #[must_use]
    pub fn volts(&self) -> Option<f64> {
        self.volts
    }

    /// The battery, if it is one.
    #[must_use]
    pub fn battery(&self) -> Option<&Battery> {
        self.battery.as_ref()
    }

    /// Advances the motors by so many steps of `dt` (s) under constant drive.
    #[inline]
    pub fn run(&mut self, motors: &mut Motors, drives: &[Bridge; 4], steps: u64, dt: f64) {
        if self.battery.is_some() || self.capacitance.is_some() {
            for _ in 0..steps {
                self.step(motors, drives, dt);
            }
            return;
        }
        self.volts = None;
        motors.run(drives, steps, dt);
    }

    fn step(&mut self, motors: &mut Motors, drives: &[Bridge; 4], dt: f64) {
        let (mut still, mut per_volt) = (0.0, 0.0);
        let (at_0_v, more) = motors.admittances(dt, drives);
        for ((a, b), drive) in at_0_v.iter().zip(more).zip(drives) {
            let duty = drive.duty.clamp(-1.0, 1.0);
            still += duty * a;
            per_volt += duty * b;
        }
        let nominal = motors.supply();
        let (open, r) = match &self.battery {
            Some(battery) => (battery.open_volts(nominal), battery.parameters.resistance),
            None => (nominal, 0.0),
        };
        let given = (open - r * still) / (1.0 + r * per_volt);
        let stored = self.capacitance.map(|farad| {
            let before = self.volts.unwrap_or(nominal);
            (farad * before - dt * still) / (farad + dt * per_volt)
        });
        let volts = stored.map_or(given, |stored| stored.max(given));
        self.volts = Some(volts);
        motors.step_on(volts, dt, drives);
        if stored.is_some_and(|stored| stored > given) {
            return;
        }
        if let Some(battery) = &mut self.battery {
            battery.draw((still + per_volt * volts) * dt);
        }
    }
}

/// A battery.
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

    /// Takes out a charge, As.
    fn draw(&mut self, charge: f64) {
        if let Some(capacity) = self.parameters.capacity_ah {
            let used = charge / (capacity * AS_PER_AH);
            self.charge = (self.charge - used).clamp(0.0, 1.0);
        }
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

    fn battery(resistance: f64) -> Supply {
        Supply::new(Some(Battery::new(&Parameters {
            resistance,
            capacity_ah: Some(1.0),
            charge: 0.5,
            curve: vec![(0.0, 20.0), (1.0, 28.0)],
        })))
    }

    fn charge(supply: &Supply) -> f64 {
        supply.battery().unwrap().charge()
    }

    fn drive(duty: f64, wheels: usize) -> [Bridge; 4] {
        std::array::from_fn(|n| Bridge {
            duty,
            enabled: n < wheels,
            brake_released: true,
        })
    }

    /// Wheels held by the brake: every motor is `duty U / R`, the battery gives `duty` of it four
    /// times, so `U = E / (1 + 4 duty^2 r / R)`: with 24 V, 0.5, 0.1 ohm and 0.3 ohm 24 / (1 + 1/3)
    /// = 18 V. A hundred ohms would make an explicit step explode.
    #[test]
    fn stalled_motors_pull_the_voltage_down() {
        for (resistance, expected) in [(0.1, 18.0), (100.0, 24.0 / (1.0 + 1000.0 / 3.0))] {
            let mut motors = Motors::new(&MOTOR);
            let held = drive(0.5, 4).map(|d| Bridge {
                brake_released: false,
                ..d
            });
            let mut volts = 0.0;
            let mut battery = battery(resistance);
            // The winding settles within a millisecond or so; the charge hardly moves.
            for _ in 0..1_000 {
                battery.step(&mut motors, &held, STEP);
                volts = battery.volts().unwrap();
            }
            assert!((volts - expected).abs() < 0.02, "{volts} {expected}");
            assert!(motors.angles() == [0.0; 4]);
        }
    }

    /// One wheel driven to its end draws `b w / k` on top of nothing: with the sag of that the
    /// speed is `U duty / (k + R b / k)`.
    #[test]
    fn a_weak_battery_makes_a_slow_wheel() {
        let mut motors = Motors::new(&MOTOR);
        let mut battery = battery(0.5);
        let mut volts = 0.0;
        for _ in 0..60_000 {
            battery.step(&mut motors, &drive(1.0, 1), STEP);
            volts = battery.volts().unwrap();
        }
        let (k, r, b) = (f64::from(0.8f32), f64::from(0.3f32), f64::from(0.02f32));
        let open = 20.0 + 8.0 * charge(&battery);
        let rate = open / (k + (r + 0.5) * b / k);
        assert!(
            (motors.rates()[0] / rate - 1.0).abs() < 1e-4,
            "{}",
            motors.rates()[0]
        );
        assert!(
            (volts - (open - 0.5 * b * rate / k)).abs() < 1e-3,
            "{volts}"
        );
    }

    /// 1 Ah at 0.5 and a current that is known: after 36 s at 20 A (2 % of an hour) 0.2 Ah are
    /// gone. Held wheels draw `duty^2 U / R` each.
    #[test]
    fn charge_runs_down_by_the_current() {
        let mut motors = Motors::new(&MOTOR);
        let held = drive(0.25, 4).map(|d| Bridge {
            brake_released: false,
            ..d
        });
        let mut battery = Supply::new(Some(Battery::new(&Parameters {
            resistance: 0.0,
            capacity_ah: Some(1.0),
            charge: 0.5,
            curve: Vec::new(),
        })));
        for _ in 0..36_000 {
            battery.step(&mut motors, &held, 1e-3);
        }
        let amps = 4.0 * 0.25 * 0.25 * 24.0 / f64::from(0.3f32);
        let expected = 0.5 - amps * 36.0 / 3600.0;
        assert!(
            (charge(&battery) - expected).abs() < 1e-4,
            "{}",
            charge(&battery)
        );
    }

    /// One wheel that turns with 20 rad/s, a duty of 0.5 that lets its bridge take 12 V of 24, and
    /// 10 mF that nothing else charges. `J dw = K i dt` and `C dU = -d i dt`, so `J w / K + C U /
    /// d` stays; at the end `d U = K w`. And what the wheel has lost is in the capacitor, 1/2 C
    /// (U^2 - U0^2), or was heat, the sum of R i^2 dt.
    #[test]
    fn braking_charges_what_nothing_else_takes() {
        let parameters = group::Motor {
            inductance: 0.0,
            viscous: 0.0,
            ..MOTOR
        };
        let (k, j, r) = (
            f64::from(parameters.constant),
            f64::from(parameters.inertia),
            f64::from(parameters.resistance),
        );
        let (farad, duty) = (0.01, 0.5);
        let mut motors = Motors::new(&parameters);
        // Brought to 20 rad/s by its own supply first.
        let mut bench = Supply::default();
        while motors.rates()[0] < 20.0 {
            bench.step(&mut motors, &drive(1.0, 1), 1e-5);
        }
        let w0 = motors.rates()[0];
        bench.block_charge(Some(farad));
        let mut heat = 0.0;
        for _ in 0..200_000 {
            bench.step(&mut motors, &drive(duty, 1), 1e-5);
            heat += r * motors.currents()[0].powi(2) * 1e-5;
        }
        let (w, volts) = (motors.rates()[0], bench.volts().unwrap());
        let conserved = j * w0 / k + farad * 24.0 / duty;
        let expected = conserved / (j * duty / (k * k) + farad / duty);
        assert!((volts / expected - 1.0).abs() < 1e-3, "{volts} {expected}");
        assert!((duty * volts / (k * w) - 1.0).abs() < 1e-3, "{w}");
        let lost = 0.5 * j * (w0 * w0 - w * w);
        let stored = 0.5 * farad * (volts * volts - 24.0 * 24.0);
        assert!(
            (stored + heat - lost).abs() < 2e-3 * lost,
            "{stored} {heat} {lost}"
        );
        // Driving again, the source does not let it fall below its own voltage.
        for _ in 0..200_000 {
            bench.step(&mut motors, &drive(1.0, 1), 1e-5);
        }
        assert!((bench.volts().unwrap() - 24.0).abs() < 1e-9);
    }
}
