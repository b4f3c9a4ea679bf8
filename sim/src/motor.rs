//! A DC motor with its gear, bridge and brake, as seen from the wheel.
//!
//! `L di/dt = V - R i - K w` and `J dw/dt = K i - b w - dry friction`, with `V = duty * supply`
//! while the drivers are enabled and no current at all while they are not. All torques, rates and
//! inertias are the wheel's. The winding is integrated implicitly, because its time constant may be
//! shorter than a step; dry friction brings the wheel to rest within a step instead of chattering
//! around zero. The holding brake is applied by springs: dry friction that begins and ends some
//! time after the command, see [`Brake`].
//!
//! First order in the step: with steps of 100 us and a mechanical time constant near 0.2 s the rate
//! is within 0.05 % of the closed form (tested). Not modelled: bridge dead time, heating, and the
//! torque ripple of the PWM itself, which at 20 kHz has no effect on a wheel. The supply may be a
//! battery that motors share, see [`crate::battery`]. A driver that trips belongs to the robot,
//! because its motors share it, and play in the gear belongs to the caller, because it lies between
//! the motor and the wheel.

use group::Motor as Parameters;

/// Default torque of the holding brake, N·m at the wheel.
pub const BRAKE_TORQUE: f64 = 60.0;

/// A spring-applied holding brake at a wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brake {
    /// What it holds, N·m at the wheel.
    pub torque: f64,
    /// From the command until it releases, s.
    pub release: f64,
    /// From the word, or the loss of power, until it holds, s.
    pub engage: f64,
}

impl Default for Brake {
    /// One without delays.
    fn default() -> Self {
        Self {
            torque: BRAKE_TORQUE,
            release: 0.0,
            engage: 0.0,
        }
    }
}

/// What the robot's outputs do to one motor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bridge {
    /// Mean bridge voltage over supply voltage, -1..=1; positive rolls the base forward.
    pub duty: f64,
    /// Whether the bridge conducts. If not, the motor turns freely.
    pub enabled: bool,
    /// Whether the holding brake is open.
    pub brake_released: bool,
}

/// One wheel with its motor.
#[derive(Debug, Clone, PartialEq)]
pub struct Motor {
    supply: f64,
    constant: f64,
    resistance: f64,
    inductance: f64,
    inertia: f64,
    friction: f64,
    drag: f64,
    push: f64,
    floor: f64,
    brake: Brake,
    /// Whether it holds, and for how long the opposite has been commanded, s.
    holds: bool,
    reported: f64,
    viscous: f64,
    current: f64,
    rate: f64,
    angle: f64,
}

/// How a step changes a motor: the current that is left of the one before, and what each volt of
/// back-EMF takes and of supply adds, A/V; what each newton metre adds to the rate, rad/s.
struct Gains {
    kept: f64,
    per_emf: f64,
    per_volt: f64,
    per_torque: f64,
}

impl Motor {
    /// A motor at rest, angle 0.
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            supply: parameters.supply.into(),
            constant: parameters.constant.into(),
            resistance: parameters.resistance.into(),
            inductance: parameters.inductance.into(),
            inertia: parameters.inertia.into(),
            friction: parameters.friction.into(),
            drag: 0.0,
            push: 0.0,
            floor: 0.0,
            brake: Brake::default(),
            holds: true,
            reported: 0.0,
            viscous: parameters.viscous.into(),
            current: 0.0,
            rate: 0.0,
            angle: 0.0,
        }
    }

    /// Advances by `dt` (s) under constant drive from the nominal supply.
    pub fn step(&mut self, dt: f64, drive: Bridge) {
        self.step_on(self.supply, dt, drive);
    }

    /// Advances four by so many steps each. None has to wait for the others, so the processor
    /// computes them at the same time.
    pub fn run_all(motors: &mut [Self; 4], drives: &[Bridge; 4], steps: u64, dt: f64) {
        let gains: [Gains; 4] = std::array::from_fn(|n| motors[n].gains(dt, drives[n]));
        for _ in 0..steps {
            for ((motor, gains), drive) in motors.iter_mut().zip(&gains).zip(drives) {
                motor.advance(gains, motor.supply, dt, drive.brake_released);
            }
        }
    }

    /// Advances by `dt` (s) under constant drive from a supply of so many volts.
    pub fn step_on(&mut self, supply: f64, dt: f64, drive: Bridge) {
        self.advance(&self.gains(dt, drive), supply, dt, drive.brake_released);
    }

    /// What is the same in every step of this length under this drive.
    fn gains(&self, dt: f64, drive: Bridge) -> Gains {
        let per_torque = dt / self.inertia;
        if !drive.enabled {
            return Gains {
                kept: 0.0,
                per_emf: 0.0,
                per_volt: 0.0,
                per_torque,
            };
        }
        let impedance = self.inductance + dt * self.resistance;
        let per_emf = dt / impedance;
        Gains {
            kept: self.inductance / impedance,
            per_emf,
            per_volt: per_emf * drive.duty.clamp(-1.0, 1.0),
            per_torque,
        }
    }

    #[inline]
    fn advance(&mut self, gains: &Gains, supply: f64, dt: f64, released: bool) {
        self.current = self.current_at_0_v(gains) + gains.per_volt * supply;
        let torque = self.constant * self.current - self.viscous * self.rate;
        let torque = torque + self.push + self.floor;
        let brake = self.brake_torque(dt, released);
        let free = self.rate + gains.per_torque * torque;
        let held = gains.per_torque * (self.friction + self.drag + brake);
        let rate = if free > held {
            free - held
        } else if free < -held {
            free + held
        } else {
            0.0
        };
        self.angle += dt * 0.5 * (self.rate + rate);
        self.rate = rate;
    }

    /// The current at the end of a step without supply, A.
    fn current_at_0_v(&self, gains: &Gains) -> f64 {
        gains.kept * self.current - gains.per_emf * self.constant * self.rate
    }

    /// What the brake holds in this step, N·m.
    fn brake_torque(&mut self, dt: f64, released: bool) -> f64 {
        if self.holds == released {
            let delay = if released {
                self.brake.release
            } else {
                self.brake.engage
            };
            // Half a step of tolerance, for `reported` is a sum of steps.
            if self.reported + 0.5 * dt >= delay {
                self.holds = !released;
            }
            self.reported += dt;
        }
        if self.holds != released {
            self.reported = 0.0;
        }
        if self.holds { self.brake.torque } else { 0.0 }
    }

    /// Changes the voltage of the supply, V.
    pub fn set_supply(&mut self, volts: f64) {
        self.supply = volts;
    }

    /// The current at the end of a step of `dt`: what it is at 0 V of supply, A, and what each volt
    /// of supply adds, A/V.
    #[must_use]
    pub fn admittance(&self, dt: f64, drive: Bridge) -> (f64, f64) {
        let gains = self.gains(dt, drive);
        (self.current_at_0_v(&gains), gains.per_volt)
    }

    /// Nominal supply voltage, V.
    #[must_use]
    pub fn supply(&self) -> f64 {
        self.supply
    }

    /// Sets the dry friction of whatever is caught in the wheel, N·m at the wheel.
    pub fn set_drag(&mut self, torque: f64) {
        self.drag = torque;
    }

    /// Sets what turns the wheel from outside, N·m at the wheel, positive rolls the base forward: a
    /// slope, a hand.
    pub fn set_push(&mut self, torque: f64) {
        self.push = torque;
    }

    /// Sets what the floor does to the wheel, N·m, positive rolls the base forward.
    pub fn set_floor(&mut self, torque: f64) {
        self.floor = torque;
    }

    /// Changes what turns with the wheel, kg m^2.
    pub fn set_inertia(&mut self, inertia: f64) {
        self.inertia = inertia;
    }

    /// Exchanges the holding brake.
    pub fn set_brake(&mut self, brake: Brake) {
        self.brake = brake;
    }

    /// The holding brake.
    #[must_use]
    pub fn brake(&self) -> Brake {
        self.brake
    }

    /// Whether the brake actually holds, regardless of the command.
    #[must_use]
    pub fn brake_holds(&self) -> bool {
        self.holds
    }

    /// Wheel rate, rad/s, positive rolls the base forward.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Wheel angle, rad, unwrapped.
    #[must_use]
    pub fn angle(&self) -> f64 {
        self.angle
    }

    /// What its current does to the wheel, N·m.
    #[must_use]
    pub fn torque(&self) -> f64 {
        self.constant * self.current
    }

    /// Winding current, A.
    #[must_use]
    pub fn current(&self) -> f64 {
        self.current
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTOR: Parameters = Parameters {
        supply: 24.0,
        constant: 0.8,
        resistance: 0.3,
        inductance: 0.0,
        inertia: 0.4,
        friction: 0.0,
        viscous: 0.0,
    };
    const STEP: f64 = 100e-6;

    fn driven(duty: f64) -> Bridge {
        Bridge {
            duty,
            enabled: true,
            brake_released: true,
        }
    }

    fn run(motor: &mut Motor, seconds: f64, drive: Bridge) {
        for _ in 0..(seconds / STEP).round() as u32 {
            motor.step(STEP, drive);
        }
    }

    /// Without friction and inductance: w = V/K (1 - exp(-t K^2 / (J R))).
    #[test]
    fn step_response_is_the_closed_form() {
        let mut motor = Motor::new(&MOTOR);
        run(&mut motor, 0.25, driven(0.5));
        let (k, j, r) = (0.8f32 as f64, 0.4f32 as f64, 0.3f32 as f64);
        let expected = 12.0 / k * (1.0 - (-0.25 * k * k / (j * r)).exp());
        assert!(
            (motor.rate() / expected - 1.0).abs() < 5e-4,
            "{} {expected}",
            motor.rate()
        );
    }

    /// The duty that the group file's feedforward gives for a rate must end at that rate.
    #[test]
    fn feedforward_holds_its_rate() {
        let parameters = Parameters {
            inductance: 3e-4,
            friction: 1.0,
            viscous: 0.02,
            ..MOTOR
        };
        let f = parameters.feedforward();
        for rate in [15.0, -4.0] {
            let mut motor = Motor::new(&parameters);
            let duty = f.duty_static * f32::signum(rate) + f.duty_per_rate * rate;
            run(&mut motor, 4.0, driven(duty.into()));
            assert!(
                (motor.rate() - f64::from(rate)).abs() < 1e-4,
                "{}",
                motor.rate()
            );
        }
    }

    /// Dry friction of 1 N m takes 1 * 0.3 / 0.8 V, 0.0156 of 24 V.
    #[test]
    fn stands_below_the_breakaway_duty() {
        let parameters = Parameters {
            friction: 1.0,
            ..MOTOR
        };
        let mut motor = Motor::new(&parameters);
        run(&mut motor, 1.0, driven(0.0156));
        assert_eq!((motor.rate(), motor.angle()), (0.0, 0.0));
        run(&mut motor, 1.0, driven(0.0157));
        assert!(motor.rate() > 0.0);
    }

    /// Disabled, only friction slows it: 1 N m on 0.4 kg m2 is 2.5 rad/s2.
    #[test]
    fn coasts_when_disabled_and_stops_for_good() {
        let parameters = Parameters {
            friction: 1.0,
            ..MOTOR
        };
        let mut motor = Motor::new(&parameters);
        run(&mut motor, 3.0, driven(0.5));
        let before = motor.rate();
        let off = Bridge {
            duty: 1.0,
            enabled: false,
            brake_released: true,
        };
        run(&mut motor, 1.0, off);
        assert!((before - motor.rate() - 2.5).abs() < 1e-6);
        run(&mut motor, 10.0, off);
        assert_eq!(motor.rate(), 0.0);
    }

    /// The brake holds a wheel that the motor tries to turn at a fifth of its duty:
    /// 4.8 V make 12.8 N m at rest.
    #[test]
    fn the_brake_holds() {
        let mut motor = Motor::new(&MOTOR);
        run(
            &mut motor,
            1.0,
            Bridge {
                duty: 0.2,
                enabled: true,
                brake_released: false,
            },
        );
        assert_eq!(motor.angle(), 0.0);
    }

    /// 1 s free fall of a wheel on a slope (5 N m on 0.4 kg m^2, 12.5 rad/s^2) before a brake that
    /// needs 80 ms to hold, and 80 ms of it after the word; then 15 N m more than the slope brake
    /// it, 37.5 rad/s^2.
    #[test]
    fn a_brake_takes_its_time() {
        let mut motor = Motor::new(&MOTOR);
        motor.set_brake(Brake {
            torque: 20.0,
            release: 0.05,
            engage: 0.08,
        });
        motor.set_push(5.0);
        let off = |released| Bridge {
            duty: 0.0,
            enabled: false,
            brake_released: released,
        };
        // The release, 50 ms later.
        run(&mut motor, 0.0501, off(true));
        assert!(motor.rate() < 0.002, "{}", motor.rate());
        run(&mut motor, 0.9999, off(true));
        assert!((motor.rate() - 12.5).abs() < 0.01, "{}", motor.rate());
        run(&mut motor, 0.08, off(false));
        assert!((motor.rate() - 13.5).abs() < 0.01, "{}", motor.rate());
        run(&mut motor, 0.1, off(false));
        assert!((motor.rate() - 9.75).abs() < 0.02, "{}", motor.rate());
        run(&mut motor, 0.5, off(false));
        assert_eq!(motor.rate(), 0.0);
        // Released for a shorter time than it needs, it keeps holding.
        run(&mut motor, 0.03, off(true));
        run(&mut motor, 0.03, off(false));
        run(&mut motor, 0.03, off(true));
        assert_eq!(motor.rate(), 0.0);
        // More than it holds slips: 30 N m against 20.
        motor.set_push(30.0);
        run(&mut motor, 0.1, off(false));
        assert!((motor.rate() - 2.5).abs() < 0.01, "{}", motor.rate());
    }

    /// Held by its brake with full voltage: (u - kE w) / R = 24 / 0.3 = 80 A.
    #[test]
    fn a_stalled_motor_draws_its_voltage_over_its_resistance() {
        let mut motor = Motor::new(&MOTOR);
        motor.set_brake(Brake {
            torque: 100.0,
            ..Brake::default()
        });
        let held = Bridge {
            brake_released: false,
            ..driven(1.0)
        };
        run(&mut motor, 0.1, held);
        assert!((motor.current() - 80.0).abs() < 1e-4, "{}", motor.current());
        assert_eq!(motor.rate(), 0.0);
    }
}
