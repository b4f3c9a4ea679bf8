//! The DC motors of a robot with their gears, bridges and brakes, as seen from the wheels.
//!
//! `L di/dt = V - R i - K w` and `J dw/dt = K i - b w - dry friction`, with `V = duty * supply`
//! while the drivers are enabled and no current at all while they are not. All torques, rates and
//! inertias are the wheel's. The winding is integrated implicitly, because its time constant may be
//! shorter than a step; dry friction brings the wheel to rest within a step instead of chattering
//! around zero. The holding brake is applied by springs: dry friction that begins and ends some
//! time after the command, see [`Brake`]. The four motors are alike and are computed side by side.
//!
//! First order in the step: with steps of 100 us and a mechanical time constant near 0.2 s the rate
//! is within 0.05 % of the closed form (tested). Not modelled: bridge dead time, heating, and the
//! torque ripple of the PWM itself, which at 20 kHz has no effect on a wheel. The supply may be a
//! battery that motors share, see [`crate::battery`]. A driver that trips belongs to the robot,
//! because its motors share it, and play in the gear belongs to the caller, because it lies between
//! the motor and the wheel.

use group::Motor as Parameters;

use crate::four::Four;

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

/// The wheels of a robot with their motors.
#[derive(Debug, Clone, PartialEq)]
pub struct Motors {
    supply: f64,
    constant: f64,
    resistance: f64,
    inductance: f64,
    inertia: f64,
    friction: f64,
    viscous: f64,
    brake: Brake,
    drag: Four,
    push: Four,
    floor: Four,
    /// Whether each brake holds, and for how long the opposite has been commanded, s.
    holds: [bool; 4],
    reported: [f64; 4],
    current: Four,
    rate: Four,
    angle: Four,
}

/// How a step changes the motors.
struct Gains {
    /// Parts of a current and of a rate that are left after it.
    current_left: Four,
    rate_left: f64,
    /// What back-EMF takes for each rad/s, and what each volt of supply adds, A.
    per_rate: Four,
    per_volt: Four,
    /// What each ampere adds, what pushes from outside add, and what dry friction can take, rad/s.
    per_ampere: f64,
    pushed: Four,
    held: Four,
}

impl Motors {
    /// Motors at rest, angle 0.
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            supply: parameters.supply.into(),
            constant: parameters.constant.into(),
            resistance: parameters.resistance.into(),
            inductance: parameters.inductance.into(),
            inertia: parameters.inertia.into(),
            friction: parameters.friction.into(),
            viscous: parameters.viscous.into(),
            brake: Brake::default(),
            drag: Four::ZERO,
            push: Four::ZERO,
            floor: Four::ZERO,
            holds: [true; 4],
            reported: [0.0; 4],
            current: Four::ZERO,
            rate: Four::ZERO,
            angle: Four::ZERO,
        }
    }

    /// Advances by so many steps of `dt` (s) under constant drive from the nominal supply, with
    /// vectors of four where the processor has them; every operation is IEEE 754's, so the results
    /// are the same with and without.
    #[inline]
    pub fn run(&mut self, drives: &[Bridge; 4], steps: u64, dt: f64) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            #[target_feature(enable = "avx2")]
            fn run_avx2(motors: &mut Motors, drives: &[Bridge; 4], steps: u64, dt: f64) {
                motors.run_each(drives, steps, dt);
            }
            #[expect(unsafe_code, reason = "the processor was asked for the feature")]
            // SAFETY: the only requirement is that the processor has AVX2, as asked above.
            unsafe {
                run_avx2(self, drives, steps, dt);
            }
            return;
        }
        self.run_each(drives, steps, dt);
    }

    #[inline(always)]
    fn run_each(&mut self, drives: &[Bridge; 4], steps: u64, dt: f64) {
        let mut left = steps;
        while left > 0 && !self.are_brakes_steady(drives) {
            self.step_on(self.supply, dt, drives);
            left -= 1;
        }
        // From now on the brakes stay as they are.
        if left > 0 {
            self.reported = [0.0; 4];
        }
        let gains = self.gains(dt, drives);
        for _ in 0..left {
            self.advance(&gains, self.supply, dt);
        }
    }

    /// Advances by `dt` (s) under constant drive from a supply of so many volts.
    #[inline(never)]
    pub fn step_on(&mut self, supply: f64, dt: f64, drives: &[Bridge; 4]) {
        self.move_brakes(dt, drives);
        self.advance(&self.gains(dt, drives), supply, dt);
    }

    /// What is the same in every step of this length under these drives.
    #[inline(always)]
    fn gains(&self, dt: f64, drives: &[Bridge; 4]) -> Gains {
        let [a, b, c, d] = drives;
        let conducts = Four([a, b, c, d].map(|drive| f64::from(drive.enabled)));
        let duty = Four([a, b, c, d].map(|drive| drive.duty.clamp(-1.0, 1.0)));
        let holds = Four(self.holds.map(f64::from));
        let brakes = holds.where_positive(Four::all(self.brake.torque), Four::ZERO);
        let per_impedance = 1.0 / (self.inductance + dt * self.resistance);
        let per_volt = dt * per_impedance;
        let per_torque = dt / self.inertia;
        let where_on = |gain: Four| conducts.where_positive(gain, Four::ZERO);
        Gains {
            current_left: where_on(Four::all(self.inductance * per_impedance)),
            rate_left: 1.0 - self.viscous * per_torque,
            per_rate: where_on(Four::all(per_volt * self.constant)),
            per_volt: where_on(duty * per_volt),
            per_ampere: self.constant * per_torque,
            pushed: (self.push + self.floor) * per_torque,
            held: (Four::all(self.friction) + self.drag + brakes) * per_torque,
        }
    }

    /// The sums are in the order in which their parts are known.
    #[inline(always)]
    fn advance(&mut self, gains: &Gains, supply: f64, dt: f64) {
        let driven = gains.current_left * self.current + gains.per_volt * supply;
        self.current = driven - gains.per_rate * self.rate;
        let pushed = self.rate * gains.rate_left + gains.pushed;
        let free = pushed + self.current * gains.per_ampere;
        let rate = free - free.min(gains.held).max(-gains.held);
        self.angle = self.angle + (self.rate + rate) * (dt * 0.5);
        self.rate = rate;
    }

    /// Whether the brakes are as they are commanded to be, as nearly always.
    #[inline(always)]
    fn are_brakes_steady(&self, drives: &[Bridge; 4]) -> bool {
        self.holds == drives.each_ref().map(|drive| !drive.brake_released)
    }

    /// What a step of `dt` does to the brakes.
    fn move_brakes(&mut self, dt: f64, drives: &[Bridge; 4]) {
        let brakes = self.holds.iter_mut().zip(&mut self.reported);
        for ((holds, reported), drive) in brakes.zip(drives) {
            let released = drive.brake_released;
            if *holds == released {
                let delay = if released {
                    self.brake.release
                } else {
                    self.brake.engage
                };
                // Half a step of tolerance, for `reported` is a sum of steps.
                if *reported + 0.5 * dt >= delay {
                    *holds = !released;
                }
                *reported += dt;
            }
            if *holds != released {
                *reported = 0.0;
            }
        }
    }

    /// Changes the voltage of the supply, V.
    pub fn set_supply(&mut self, volts: f64) {
        self.supply = volts;
    }

    /// The currents at the end of a step of `dt`: what they are at 0 V of supply, A, and what each
    /// volt of supply adds, A/V.
    #[must_use]
    pub fn admittances(&self, dt: f64, drives: &[Bridge; 4]) -> ([f64; 4], [f64; 4]) {
        let gains = self.gains(dt, drives);
        let at_0_v = gains.current_left * self.current - gains.per_rate * self.rate;
        (at_0_v.0, gains.per_volt.0)
    }

    /// Nominal supply voltage, V.
    #[must_use]
    pub fn supply(&self) -> f64 {
        self.supply
    }

    /// Sets the dry friction of whatever is caught in a wheel, N·m at the wheel.
    pub fn set_drag(&mut self, wheel: usize, torque: f64) {
        if let Some(drag) = self.drag.0.get_mut(wheel) {
            *drag = torque;
        }
    }

    /// Sets what turns a wheel from outside, N·m at the wheel, positive rolls the base forward: a
    /// slope, a hand.
    pub fn set_push(&mut self, wheel: usize, torque: f64) {
        if let Some(push) = self.push.0.get_mut(wheel) {
            *push = torque;
        }
    }

    /// Sets what the floor does to the wheels, N·m, positive rolls the base forward.
    pub fn set_floor(&mut self, torques: [f64; 4]) {
        self.floor = Four(torques);
    }

    /// Changes what turns with each wheel, kg m^2.
    pub fn set_inertia(&mut self, inertia: f64) {
        self.inertia = inertia;
    }

    /// Exchanges the holding brakes.
    pub fn set_brake(&mut self, brake: Brake) {
        self.brake = brake;
    }

    /// Each of the holding brakes.
    #[must_use]
    pub fn brake(&self) -> Brake {
        self.brake
    }

    /// Whether each brake actually holds, regardless of the command.
    #[must_use]
    pub fn brakes_hold(&self) -> [bool; 4] {
        self.holds
    }

    /// Wheel rates, rad/s, positive rolls the base forward.
    #[must_use]
    pub fn rates(&self) -> [f64; 4] {
        self.rate.0
    }

    /// Wheel angles, rad, unwrapped.
    #[must_use]
    pub fn angles(&self) -> [f64; 4] {
        self.angle.0
    }

    /// What their currents do to the wheels, N·m.
    #[must_use]
    pub fn torques(&self) -> [f64; 4] {
        (self.current * self.constant).0
    }

    /// Winding currents, A.
    #[must_use]
    pub fn currents(&self) -> [f64; 4] {
        self.current.0
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

    fn run(motors: &mut Motors, seconds: f64, drive: Bridge) {
        motors.run(&[drive; 4], (seconds / STEP).round() as u64, STEP);
    }

    /// Without friction and inductance: w = V/K (1 - exp(-t K^2 / (J R))).
    #[test]
    fn step_response_is_the_closed_form() {
        let mut motors = Motors::new(&MOTOR);
        run(&mut motors, 0.25, driven(0.5));
        let (k, j, r) = (0.8f32 as f64, 0.4f32 as f64, 0.3f32 as f64);
        let expected = 12.0 / k * (1.0 - (-0.25 * k * k / (j * r)).exp());
        assert!(
            (motors.rates()[0] / expected - 1.0).abs() < 5e-4,
            "{} {expected}",
            motors.rates()[0]
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
            let mut motors = Motors::new(&parameters);
            let duty = f.duty_static * f32::signum(rate) + f.duty_per_rate * rate;
            run(&mut motors, 4.0, driven(duty.into()));
            assert!(
                (motors.rates()[0] - f64::from(rate)).abs() < 1e-4,
                "{}",
                motors.rates()[0]
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
        let mut motors = Motors::new(&parameters);
        run(&mut motors, 1.0, driven(0.0156));
        assert_eq!((motors.rates()[0], motors.angles()[0]), (0.0, 0.0));
        run(&mut motors, 1.0, driven(0.0157));
        assert!(motors.rates()[0] > 0.0);
    }

    /// Disabled, only friction slows it: 1 N m on 0.4 kg m2 is 2.5 rad/s2.
    #[test]
    fn coasts_when_disabled_and_stops_for_good() {
        let parameters = Parameters {
            friction: 1.0,
            ..MOTOR
        };
        let mut motors = Motors::new(&parameters);
        run(&mut motors, 3.0, driven(0.5));
        let before = motors.rates()[0];
        let off = Bridge {
            duty: 1.0,
            enabled: false,
            brake_released: true,
        };
        run(&mut motors, 1.0, off);
        assert!((before - motors.rates()[0] - 2.5).abs() < 1e-6);
        run(&mut motors, 10.0, off);
        assert_eq!(motors.rates()[0], 0.0);
    }

    /// The brake holds a wheel that the motor tries to turn at a fifth of its duty:
    /// 4.8 V make 12.8 N m at rest.
    #[test]
    fn the_brake_holds() {
        let mut motors = Motors::new(&MOTOR);
        run(
            &mut motors,
            1.0,
            Bridge {
                duty: 0.2,
                enabled: true,
                brake_released: false,
            },
        );
        assert_eq!(motors.angles()[0], 0.0);
    }

    /// 1 s free fall of a wheel on a slope (5 N m on 0.4 kg m^2, 12.5 rad/s^2) before a brake that
    /// needs 80 ms to hold, and 80 ms of it after the word; then 15 N m more than the slope brake
    /// it, 37.5 rad/s^2.
    #[test]
    fn a_brake_takes_its_time() {
        let mut motors = Motors::new(&MOTOR);
        motors.set_brake(Brake {
            torque: 20.0,
            release: 0.05,
            engage: 0.08,
        });
        motors.set_push(0, 5.0);
        let off = |released| Bridge {
            duty: 0.0,
            enabled: false,
            brake_released: released,
        };
        // The release, 50 ms later.
        run(&mut motors, 0.0501, off(true));
        assert!(motors.rates()[0] < 0.002, "{}", motors.rates()[0]);
        run(&mut motors, 0.9999, off(true));
        assert!(
            (motors.rates()[0] - 12.5).abs() < 0.01,
            "{}",
            motors.rates()[0]
        );
        run(&mut motors, 0.08, off(false));
        assert!(
            (motors.rates()[0] - 13.5).abs() < 0.01,
            "{}",
            motors.rates()[0]
        );
        run(&mut motors, 0.1, off(false));
        assert!(
            (motors.rates()[0] - 9.75).abs() < 0.02,
            "{}",
            motors.rates()[0]
        );
        run(&mut motors, 0.5, off(false));
        assert_eq!(motors.rates()[0], 0.0);
        // Released for a shorter time than it needs, it keeps holding.
        run(&mut motors, 0.03, off(true));
        run(&mut motors, 0.03, off(false));
        run(&mut motors, 0.03, off(true));
        assert_eq!(motors.rates()[0], 0.0);
        // More than it holds slips: 30 N m against 20.
        motors.set_push(0, 30.0);
        run(&mut motors, 0.1, off(false));
        assert!(
            (motors.rates()[0] - 2.5).abs() < 0.01,
            "{}",
            motors.rates()[0]
        );
    }

    /// Held by its brake with full voltage: (u - kE w) / R = 24 / 0.3 = 80 A.
    #[test]
    fn a_stalled_motor_draws_its_voltage_over_its_resistance() {
        let mut motors = Motors::new(&MOTOR);
        motors.set_brake(Brake {
            torque: 100.0,
            ..Brake::default()
        });
        let held = Bridge {
            brake_released: false,
            ..driven(1.0)
        };
        run(&mut motors, 0.1, held);
        assert!(
            (motors.currents()[0] - 80.0).abs() < 1e-4,
            "{}",
            motors.currents()[0]
        );
        assert_eq!(motors.rates()[0], 0.0);
    }

    /// Wheels that drive, coast, are held and are stopped by friction, while brakes are released
    /// and engage in the middle: many steps at once, with vectors of four where the processor has
    /// them, are as many single ones without, to the bit.
    #[test]
    fn many_steps_at_once_are_as_many_single_ones() {
        let parameters = Parameters {
            inductance: 3e-4,
            friction: 1.0,
            viscous: 0.02,
            ..MOTOR
        };
        let mut together = Motors::new(&parameters);
        together.set_brake(Brake {
            torque: 20.0,
            release: 0.0101,
            engage: 0.0203,
        });
        together.set_drag(1, 2.0);
        together.set_push(2, -4.0);
        together.set_floor([0.3, 0.0, -0.2, 0.1]);
        let (mut plain, mut single) = (together.clone(), together.clone());
        let mut stood = false;
        for turn in 0..200_u32 {
            let drives = std::array::from_fn(|wheel: usize| Bridge {
                duty: [0.4, -0.3, 0.02, 1.5][wheel] * if turn % 90 < 60 { 1.0 } else { -0.1 },
                enabled: wheel != 2 || turn % 70 < 50,
                // Now and then for less than either takes.
                brake_released: ((turn as usize + 11 * wheel) % 80 < 60) != (turn % 13 == 0),
            });
            let steps = u64::from(turn % 9);
            together.run(&drives, steps, STEP * 10.0);
            plain.run_each(&drives, steps, STEP * 10.0);
            for _ in 0..steps {
                single.step_on(single.supply(), STEP * 10.0, &drives);
            }
            let bits = [&together, &plain, &single].map(|motors| format!("{motors:?}"));
            assert_eq!([&bits[0], &bits[0]], [&bits[1], &bits[2]], "{turn}");
            stood |= turn > 100 && together.rates().contains(&0.0);
        }
        assert!(stood && together.angles().iter().all(|angle| *angle != 0.0));
    }
}
