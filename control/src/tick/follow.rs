//! *Follow*: from the group's setpoint to the commands of the four wheels' drives.

use protocol::Limit;

use super::grant::settled;
use super::motion::Motion;
use super::{Supervision, Tick};
use crate::interface::{Command, Mode, Outputs, Report};
use crate::limiter::Step;
use crate::quantity::{self, Acceleration, Angle, Rate, Voltage};
use crate::rollers::{self, Rollers};
use crate::setpoint::Input;
use crate::twist::{scaled, to};
use crate::wheel::{Held, WheelMeasurement, WheelReference};
use crate::wheel_drive::{Wanted, WheelDrive};

/// Result of the loops of all wheels.
#[derive(Clone, Copy)]
struct Drive {
    /// What the drives get.
    commands: [quantity::Drive; 4],
    /// The limit that applied to any wheel.
    held: Held,
}

impl Supervision {
    /// Shapes the group's twist and drives the wheels accordingly.
    #[inline]
    pub(super) fn follow<D: WheelDrive>(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        turned: [Angle; 4],
        tick: &Tick,
    ) -> Outputs {
        let times = motion.configuration.brake;
        let free = match self.report.mode {
            // What it engages stays so.
            Mode::Ramp => self.brake.has_let_go(tick.now, times),
            _ => self.brake.release(tick.now, times),
        };
        self.report.brake_is_free = free;
        let mode = match self.report.mode {
            Mode::Follow if !free => Mode::Hold,
            mode => mode,
        };
        if self.report.mode == Mode::Follow {
            self.report.sequence = command.sequence;
        }
        let limited = motion.shape(mode, command, tick);
        self.report.twist_ref = motion.limiter.velocity();
        if mode == Mode::Ramp {
            let (limiter, rates) = (&motion.limiter, &self.report.rates);
            let stands =
                self.report.standstill || settled(&mut self.settling, limiter, rates, tick.now);
            if stands && self.brake.engage(tick.now, times) {
                return self.rest(motion, command, true);
            }
        }
        let drive = motion.drive::<D>(&mut self.report, turned, tick);
        self.ends = drive.held.ends;
        if !free {
            motion.forgive();
        }
        self.report.limit = self.limit(motion, limited && mode == Mode::Follow, drive.held);
        Outputs {
            drive: drive.commands,
            drivers_enabled: true,
            brake_released: self.brake.is_released(),
        }
    }

    /// The most important limit that is active.
    #[inline]
    fn limit(&mut self, motion: &Motion, accelerates: bool, held: Held) -> Option<Limit> {
        let threshold = motion.configuration.thresholds.slip_limit;
        let slip = self.report.slip_residual.abs();
        if self.slip_limit.update(slip, threshold) {
            Some(Limit::Slip)
        } else if held.torque {
            Some(Limit::Torque)
        } else if held.supply {
            Some(Limit::Voltage)
        } else if self.supply.is_short(&motion.configuration.supply) {
            Some(Limit::Supply)
        } else if accelerates {
            Some(Limit::Acceleration)
        } else if motion.rollers.as_ref().is_some_and(Rollers::any_lost) {
            Some(Limit::RollerPhase)
        } else {
            None
        }
    }
}

impl Motion {
    /// The group's twist for this tick, within the limits of the mode; returns whether a limit
    /// applied.
    #[inline]
    fn shape(&mut self, mode: Mode, command: &Command, tick: &Tick) -> bool {
        let (input, limits) = if mode == Mode::Follow {
            let (target, at) = (command.twist_cmd, command.at);
            let input = self.interpolator.at(tick.now, target, command.update, at);
            (input, &self.configuration.follow)
        } else {
            self.limiter.stop_accelerating();
            (Input::default(), &self.configuration.ramp)
        };
        let limited = self
            .limiter
            .step(input.twist, input.slope, tick.step, limits);
        if mode != Mode::Follow {
            // The next setpoint begins from here.
            self.interpolator
                .restart(self.limiter.velocity(), command.update);
            if self.limiter.stands() {
                self.limiter.reset();
            }
        }
        limited
    }

    /// Closes the four loops.
    #[inline]
    fn drive<D: WheelDrive>(
        &mut self,
        report: &mut Report,
        turned: [Angle; 4],
        tick: &Tick,
    ) -> Drive {
        let references = self.refer(report, tick.step);
        // Unrolled: a fifth fewer instructions than a loop.
        let [a, b, c, d] = &mut self.wheels;
        let signs = [a.motor_sign, b.motor_sign, c.motor_sign, d.motor_sign];
        let [oa, ob, oc, od] = [&a.observer, &b.observer, &c.observer, &d.observer];
        let rates = [oa.rate(), ob.rate(), oc.rate(), od.rate()];
        let [ref_a, ref_b, ref_c, ref_d] = pairs(references, self.accelerations, reference);
        let [seen_a, seen_b, seen_c, seen_d] = pairs(rates, turned, measurement);
        // From the counts, not from the rates: a wheel that stops is detected in the same tick.
        let residual = self.configuration.drivetrain.unexplained(turned);
        let mut held = Held::default();
        let a = a.drive(ref_a, seen_a, residual, tick, &mut held);
        let b = b.drive(ref_b, seen_b, residual, tick, &mut held);
        let c = c.drive(ref_c, seen_c, residual, tick, &mut held);
        let d = d.drive(ref_d, seen_d, residual, tick, &mut held);
        let mut voltages = [a, b, c, d];
        if self.configuration.direction_pause {
            voltages = self.pause(voltages);
        }
        let wanted = Wanted {
            voltages,
            signs,
            rates: report.rates,
            supply: tick.supply,
        };
        Drive {
            commands: self.commands::<D>(&wanted),
            held,
        }
    }

    /// What the drives get.
    #[inline(always)]
    pub(super) fn commands<D: WheelDrive>(&self, wanted: &Wanted) -> [quantity::Drive; 4] {
        let [a, b, c, d] = &self.configuration.wheels;
        let gains = [&a.gains, &b.gains, &c.gains, &d.gains];
        D::commands(wanted, gains, &self.configuration.motors)
    }

    /// No voltage for one tick where its sign changes: for bridges that need it.
    #[cold]
    fn pause(&mut self, mut voltages: [Voltage; 4]) -> [Voltage; 4] {
        for (wheel, voltage) in self.wheels.iter_mut().zip(&mut voltages) {
            *voltage = wheel.pause(*voltage);
        }
        voltages
    }

    /// The wheels' references, from the group's twist and acceleration.
    #[inline]
    fn refer(&mut self, report: &mut Report, step: Step) -> [Rate; 4] {
        let (drivetrain, velocity) = (&self.configuration.drivetrain, self.limiter.velocity());
        let here = drivetrain.here(to(velocity));
        drivetrain.renew(&mut self.factors, here, report.measured);
        if let Some(rollers) = &self.rollers {
            // Rates for the present roller angles, and the acceleration that brings the wheels to
            // the rates for the roller angles and the twist of the next tick.
            let wheels = rollers.kinematics();
            let now = rollers::inverse(wheels, self.factors.asked(here), rollers.secants());
            let ahead = rollers.ahead(now, step.dt);
            let next = velocity + scaled(self.limiter.acceleration(), step.dt);
            let asked = self.factors.asked(drivetrain.here(to(next)));
            let next = rollers::inverse(wheels, asked, &ahead);
            report.rates_ref = now;
            self.accelerations = pairs(now, next, |now, next| (next - now).times(step.per_second));
            now
        } else {
            let rates = drivetrain.wheels(here, &self.factors);
            let acceleration = drivetrain.here(to(self.limiter.acceleration()));
            self.accelerations = drivetrain.wheels(acceleration, &self.factors);
            report.rates_ref = rates;
            rates
        }
    }
}

/// Combines two values of every wheel into one.
#[inline(always)]
fn pairs<A, B, T>(first: [A; 4], second: [B; 4], make: impl Fn(A, B) -> T) -> [T; 4] {
    let [a, b, c, d] = first;
    let [e, f, g, h] = second;
    [make(a, e), make(b, f), make(c, g), make(d, h)]
}

#[inline(always)]
const fn reference(rate: Rate, acceleration: Acceleration) -> WheelReference {
    WheelReference { rate, acceleration }
}

#[inline(always)]
const fn measurement(rate: Rate, turned: Angle) -> WheelMeasurement {
    WheelMeasurement { rate, turned }
}
