//! The state that exists only with a configuration, and its four wheels.

use protocol::{Fault, Reaction};

use super::Tick;
use crate::configuration::Configuration;
use crate::drivetrain::Factors;
use crate::limiter::Limiter;
use crate::observer::Observer;
use crate::odometry::Odometry;
use crate::quantity::{Acceleration, Angle, Count, Rate, Ratio, Sign, Voltage};
use crate::rollers::Rollers;
use crate::setpoint::Interpolator;
use crate::silence::{Silence, Trust};
use crate::twist::still;
use crate::watch::Watch;
use crate::wheel::{Available, Held, WheelLoop, WheelMeasurement, WheelReference};

/// The slip residual cannot identify a wheel whose error of 1 rad/s changes it by less than this,
/// rad/s.
const LEAST_RESIDUAL: f32 = 0.1;

/// One wheel's measurement and loop.
#[derive(Clone, Copy)]
pub(super) struct Wheel {
    pub(super) step: Count,
    pub(super) motor_sign: Sign,
    /// Its error for a slip residual of 1, if it alone were wrong; 0 for a wheel that the residual
    /// does not identify.
    pub(super) odd: Ratio,
    /// Voltage at the last tick, V, where it pauses.
    pub(super) given: Voltage,
    pub(super) observer: Observer,
    pub(super) wheel_loop: WheelLoop,
    pub(super) silence: Silence,
    pub(super) watch: Watch,
}

impl Wheel {
    /// A wheel at rest. Not inlined: four times in a row it is two kilobytes.
    #[inline(never)]
    pub(super) fn new(configuration: &Configuration, place: usize) -> Self {
        let [wheel, ..] = configuration.wheels;
        let wheel = configuration.wheels.get(place).copied().unwrap_or(wheel);
        // Turning alone, by 1 rad/s, it makes this residual.
        let alone = [0, 1, 2, 3].map(|other| if other == place { 1.0 } else { 0.0 });
        let residual = configuration.drivetrain.slip_residual(&alone.into());
        let watches = configuration.thresholds.blocked_rate > Rate::ZERO;
        let listens = watches && residual.abs() > LEAST_RESIDUAL;
        Self {
            step: Count::new(wheel.step),
            motor_sign: Sign::new(wheel.motor_sign),
            given: Voltage::ZERO,
            odd: if listens {
                Ratio::new(1.0 / residual)
            } else {
                Ratio::ZERO
            },
            observer: Observer::new(wheel.step.abs(), configuration.observer_bandwidth),
            wheel_loop: WheelLoop::new(wheel.gains, wheel.torque),
            silence: Silence::new(wheel.step.abs(), listens),
            watch: Watch::new(configuration, &wheel),
        }
    }

    /// One tick of a wheel: its voltage, V; a limit that applied is added to `held`.
    // In fixed point a copy for each wheel takes 4 KB, and calling one 3 % of the tick.
    #[cfg_attr(feature = "fixed-point", inline(never))]
    #[cfg_attr(not(feature = "fixed-point"), inline(always))]
    pub(super) fn drive(
        &mut self,
        reference: WheelReference,
        measured: WheelMeasurement,
        residual: Angle,
        tick: &Tick,
        held: &mut Held,
    ) -> Voltage {
        let (rate, turned) = (measured.rate, measured.turned);
        let implied = turned - residual.times(self.odd);
        let trust = self
            .silence
            .update(reference.rate, implied, turned, tick.step.dt);
        let available = Available {
            voltage: tick.available,
            dt: tick.step.dt,
        };
        let voltage = if trust == Trust::Full {
            self.wheel_loop.update(reference, rate, available, held)
        } else {
            if trust == Trust::None {
                self.watch.latch(Fault::EncoderDead);
            }
            self.wheel_loop
                .doubt(reference, rate, trust, available, held)
        };
        self.watch
            .update(reference.rate, measured, voltage, tick.now, tick.step.dt);
        voltage
    }

    /// The same voltage, or none for one tick where its sign changes.
    pub(super) fn pause(&mut self, voltage: Voltage) -> Voltage {
        let turns = voltage.agrees(-self.given);
        self.given = if turns { Voltage::ZERO } else { voltage };
        self.given
    }
}

/// The state that exists once there is a configuration. The fields are ordered so that those of
/// every tick lie within the kilobyte that one instruction reaches.
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Motion {
    /// The wheels' reference acceleration at the last tick, rad/s^2.
    pub(super) accelerations: [Acceleration; 4],
    pub(super) limiter: Limiter,
    pub(super) factors: Factors,
    pub(super) interpolator: Interpolator,
    pub(super) odometry: Odometry,
    pub(super) wheels: [Wheel; 4],
    pub(super) configuration: Configuration,
    pub(super) rollers: Option<Rollers>,
}
impl Motion {
    /// At rest. Written where it is kept: it takes two kilobytes, which would come on top of
    /// everything else on the stack.
    #[inline(always)]
    pub(super) fn new(configuration: &Configuration, rollers: Option<Rollers>) -> Self {
        Self {
            interpolator: Interpolator::new(configuration.times.sync_period_us),
            limiter: Limiter::default(),
            odometry: Odometry::new(),
            accelerations: [Acceleration::ZERO; 4],
            wheels: [
                Wheel::new(configuration, 0),
                Wheel::new(configuration, 1),
                Wheel::new(configuration, 2),
                Wheel::new(configuration, 3),
            ],
            factors: configuration.drivetrain.factors(),
            rollers,
            configuration: *configuration,
        }
    }

    /// The drives report a fault. One that cuts is live; one that ramps is kept here as a wheel's.
    #[cold]
    pub(super) fn on_drive_fault(&mut self, fault: Fault) {
        let [wheel, ..] = &mut self.wheels;
        if fault.reaction() == Reaction::Ramp {
            wheel.watch.latch(fault);
        }
    }

    /// Drops all suspicions against the wheels.
    #[cold]
    pub(super) fn forgive(&mut self) {
        for wheel in &mut self.wheels {
            wheel.watch.forgive();
            wheel.silence.forgive();
        }
    }

    /// Loops and reference at rest.
    pub(super) fn rest(&mut self, update: u16) {
        self.limiter.reset();
        self.accelerations = [Acceleration::ZERO; 4];
        self.interpolator.restart(still(), update);
        for wheel in &mut self.wheels {
            wheel.wheel_loop.reset();
        }
    }
}
