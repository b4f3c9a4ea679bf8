//! Identification of the motors, which replaces *follow* from its beginning to standstill.

use identification::{Identification, Step, Stopped};

use super::grant::settled;
use super::motion::Motion;
use super::{Supervision, Tick};
use crate::interface::{Command, Mode, Outputs};
use crate::quantity::{Angle, Rate, Voltage};
use crate::time::TICK_US;
use crate::twist::still;
use crate::wheel_drive::{Wanted, WheelDrive};

impl Supervision {
    /// One tick of an identification, from its beginning to standstill. No loop is closed and no
    /// setpoint is followed: all wheels get one voltage, and none when it is over or has failed.
    #[cold]
    #[inline(never)]
    pub(super) fn identify<D: WheelDrive>(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        turned: [Angle; 4],
        tick: &Tick,
    ) -> Outputs {
        let mode = self.report.mode;
        self.report.limit = None;
        self.report.twist_ref = still();
        self.report.rates_ref = [Rate::ZERO; 4];
        motion.rest(command.update);
        let times = motion.configuration.brake;
        if mode == Mode::Identify && !self.brake.release(tick.now, times) {
            motion.forgive();
            return self.unpowered();
        }
        let voltage = self.identification_voltage(
            motion,
            command,
            turned.map(Angle::to_f32),
            tick.step.dt.to_f32(),
        );
        let ramps = mode == Mode::Ramp && !self.report.standstill;
        let (limiter, rates) = (&motion.limiter, &self.report.rates);
        let stands = ramps && settled(&mut self.settling, limiter, rates, tick.now);
        if mode == Mode::Off || stands && self.brake.engage(tick.now, times) {
            self.identification = None;
            return self.safe(command.mode == Mode::Ramp);
        }
        if stands {
            return self.unpowered();
        }
        let nominal = motion.configuration.supply.nominal;
        let supply = self.report.supply.unwrap_or(nominal).max(nominal.half());
        let [a, b, c, d] = &motion.wheels;
        let wanted = Wanted {
            voltages: [0, 1, 2, 3].map(|wheel| {
                if command.bounds.drives(wheel) {
                    Voltage::new(voltage)
                } else {
                    Voltage::ZERO
                }
            }),
            signs: [a.motor_sign, b.motor_sign, c.motor_sign, d.motor_sign],
            // Not the observer's, which lag in an acceleration that no reference announces.
            rates: turned.map(|turned| Rate::new(turned.to_f32() / tick.step.dt.to_f32())),
            supply,
        };
        Outputs {
            drive: motion.commands::<D>(&wanted),
            drivers_enabled: true,
            brake_released: self.brake.is_released(),
        }
    }

    /// Drivers on without voltage, as long as the brake takes.
    fn unpowered(&self) -> Outputs {
        Outputs {
            drivers_enabled: true,
            brake_released: self.brake.is_released(),
            ..Outputs::SAFE
        }
    }

    /// The voltage on all wheels, V; keeps the result when the identification is over.
    fn identification_voltage(
        &mut self,
        motion: &Motion,
        command: &Command,
        turned: [f32; 4],
        dt: f32,
    ) -> f32 {
        let nominal = motion.configuration.supply.nominal.to_f32();
        let run = self.identification.get_or_insert_with(|| {
            let motors = &motion.configuration.motors;
            Identification::new(command.bounds, nominal, motors.at_rest(), TICK_US)
        });
        if self.report.mode == Mode::Identify {
            return match run.tick(turned, self.report.rates().into(), dt) {
                Step::Voltage(voltage) => voltage,
                Step::Finished(outcome) => {
                    run.end();
                    self.outcome = Some(outcome);
                    0.0
                }
                Step::Ended => 0.0,
            };
        }
        if !run.has_ended() {
            run.end();
            let why = match self.report.fault {
                Some(_) => Stopped::Fault,
                None => Stopped::Asked,
            };
            self.outcome = Some(Err((why, None)));
        }
        0.0
    }
}
