//! The control side: one tick a millisecond, from encoder counts to duties.
//!
//! It owns the outputs. The bus side's [`Command`] is a wish: without a configuration of the same
//! CRC, after a fault of its own, or when the bus side has gone silent, the wish is not granted. A
//! tick does, in this order: measure the wheels, look for faults, shape the group twist (the same in
//! every member), turn it into wheel references (this member's own), close the four loops.
//!
//! Nothing here allocates, waits or fails; there is no trigonometry beyond the odometry's. Faults are
//! latched until the bus side's next start, and cleared then only if their cause is gone.

use canopen::Micros;
use kinematics::{Odometry, Twist, WheelRates};
use protocol::{Fault, Limit, Reaction};

use crate::configuration::Configuration;
use crate::handover::{Command, Inputs, Mode, Outputs, Report};
use crate::limiter::Limiter;
use crate::observer::Observer;
use crate::setpoint::{Input, Interpolator};
use crate::threshold::{Hysteresis, Lasting};
use crate::watch::Watch;
use crate::wheel::{WheelLoop, WheelReference};

/// Nominal period of the tick, us.
pub const TICK_US: u64 = 1_000;

/// The same in 32 bits.
const TICK: u32 = 1_000;
const _: () = assert!(TICK as u64 == TICK_US);

/// A tick later than this after the last one counts as late, us.
const LATE_US: u32 = 1_500;

/// Later than this, the wheels have been without control for too long, us.
const OVERDUE_US: u32 = 20_000;

/// Longest time between two signs of life of the bus side, us.
const BUS_SILENT_US: u32 = 100_000;

/// How long a low supply or too much slip must last, us.
const LASTING_US: u64 = 100_000;

/// Wheels slower than this stand, rad/s.
const STANDING_RATE: f32 = 0.05;

/// How long after the end of a ramp the wheels may take to stand, us; then the brake is closed anyway.
const SETTLE_US: u64 = 300_000;

/// One wheel's measurement and loop.
#[derive(Clone, Copy)]
struct Wheel {
    step: f32,
    motor_sign: f32,
    observer: Observer,
    drive: WheelLoop,
    watch: Watch,
}

/// What exists once there is a configuration.
#[derive(Clone, Copy)]
struct Motion {
    configuration: Configuration,
    wheels: [Wheel; 4],
    /// What the wheels were asked to accelerate with at the last tick, rad/s^2.
    accelerations: [f32; 4],
    interpolator: Interpolator,
    limiter: Limiter,
    odometry: Odometry,
}

/// The control side of one robot.
pub struct ControlSide {
    motion: Option<Motion>,
    counts: Option<[u16; 4]>,
    last: Option<Micros>,
    /// Since when the ramp's reference stands.
    settling: Option<Micros>,
    supply_low: Lasting,
    slip_limit: Hysteresis,
    slip_fault: Lasting,
    report: Report,
}

impl Default for ControlSide {
    fn default() -> Self {
        Self::new()
    }
}

impl ControlSide {
    /// A robot that knows nothing about itself: outputs off.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            motion: None,
            counts: None,
            last: None,
            settling: None,
            supply_low: Lasting::new(),
            slip_limit: Hysteresis { active: false },
            slip_fault: Lasting::new(),
            report: Report {
                at: Micros(0),
                start: 0,
                configuration: 0,
                mode: Mode::Off,
                standstill: false,
                fault: None,
                obstacle: None,
                limit: None,
                sequence: 0,
                reference: Twist::ZERO,
                measured: Twist::ZERO,
                slip_residual: 0.0,
                rates_ref: WheelRates::ZERO,
                rates: WheelRates::ZERO,
                pose: kinematics::Pose::ZERO,
                supply: None,
                late_ticks: 0,
            },
        }
    }

    /// Takes over a configuration. The outputs go off with it, and the pose starts at zero.
    pub fn configure(&mut self, configuration: Configuration) {
        let wheels = configuration.wheels.map(|wheel| Wheel {
            step: wheel.step,
            motor_sign: wheel.motor_sign,
            observer: Observer::new(wheel.step.abs(), configuration.observer_bandwidth),
            drive: WheelLoop::new(wheel.gains),
            watch: Watch::new(&configuration, &wheel),
        });
        self.report.configuration = configuration.crc;
        self.report.mode = Mode::Off;
        self.motion = Some(Motion {
            interpolator: Interpolator::new(configuration.times.sync_period_us as f32),
            limiter: Limiter::default(),
            odometry: Odometry::new(),
            accelerations: [0.0; 4],
            wheels,
            configuration,
        });
    }

    /// What it did and saw at the last tick.
    #[must_use]
    pub const fn report(&self) -> Report {
        self.report
    }

    /// One tick.
    pub fn tick(&mut self, now: Micros, command: &Command, inputs: &Inputs) -> Outputs {
        let elapsed = self.last.replace(now).map_or(TICK, |last| span(last, now));
        if elapsed > LATE_US {
            self.report.late_ticks = self.report.late_ticks.wrapping_add(1);
        }
        // Bounds keep the observer's arithmetic sane after a long pause; the fault below stops it.
        let dt = elapsed.clamp(TICK / 4, OVERDUE_US) as f32 * 1e-6;
        let previous = self.counts.replace(inputs.encoder_counts);
        let previous = previous.unwrap_or(inputs.encoder_counts);
        self.report.at = now;
        self.report.supply = inputs.supply;
        self.acknowledge(command.start);

        let live = live_fault(inputs);
        self.report.obstacle = live;
        let Some(motion) = &mut self.motion else {
            self.report.mode = Mode::Off;
            self.report.standstill = command.mode == Mode::Ramp;
            return Outputs::SAFE;
        };

        // Measure.
        let turned = motion.turned(previous, inputs.encoder_counts);
        let expected = motion.accelerations;
        let mut rates = [0.0; 4];
        for (((wheel, turned), acceleration), rate) in motion
            .wheels
            .iter_mut()
            .zip(turned)
            .zip(expected)
            .zip(&mut rates)
        {
            *rate = wheel.observer.update(turned, acceleration, dt);
        }
        let rates = WheelRates::from(rates);
        motion.measure(turned, &rates, &mut self.report);

        // Faults of its own, the first one kept. They count only while it drives.
        if command.mode != Mode::Off && self.report.fault.is_none() {
            self.report.fault = live
                .or_else(|| motion.wheel_fault())
                .or_else(|| late(elapsed, now, command.alive))
                .or_else(|| {
                    let minimum = motion.configuration.thresholds.supply_minimum;
                    let low = inputs.supply.is_some_and(|supply| supply < minimum);
                    self.supply_low
                        .update(low, now, LASTING_US)
                        .then_some(Fault::SupplyLow)
                })
                .or_else(|| {
                    let bound = motion.configuration.thresholds.slip_fault;
                    let slips = bound > 0.0 && self.report.slip_residual.abs() > bound;
                    self.slip_fault
                        .update(slips, now, LASTING_US)
                        .then_some(Fault::SlipExcess)
                });
        }

        // What is granted of the wish.
        let known = command.configuration == motion.configuration.crc;
        let mode = match (command.mode, self.report.fault.map(Fault::reaction)) {
            _ if !known => Mode::Off,
            (_, Some(Reaction::Cut)) => Mode::Off,
            (Mode::Hold | Mode::Follow, Some(Reaction::Ramp)) => Mode::Ramp,
            (mode, None | Some(Reaction::Ramp)) => mode,
        };
        if mode == Mode::Off {
            motion.rest(command.update);
        }
        self.report.mode = mode;
        if mode != Mode::Ramp {
            self.settling = None;
            self.report.standstill = false;
        }

        // Shape.
        let (input, limits) = match mode {
            Mode::Off => {
                self.report.limit = None;
                self.report.standstill = command.mode == Mode::Ramp;
                self.report.reference = Twist::ZERO;
                self.report.rates_ref = WheelRates::ZERO;
                return Outputs::SAFE;
            }
            Mode::Hold | Mode::Ramp => (Input::default(), motion.configuration.ramp),
            Mode::Follow => {
                self.report.sequence = command.sequence;
                let input = motion
                    .interpolator
                    .at(now, command.target, command.update, command.at);
                (input, motion.configuration.follow)
            }
        };
        let limited = motion.limiter.step(input.twist, input.slope, dt, &limits);
        if mode != Mode::Follow {
            // Whatever is followed next begins from here.
            motion
                .interpolator
                .restart(motion.limiter.velocity(), command.update);
            if motion.limiter.stands() {
                motion.limiter.reset();
            }
        }
        self.report.reference = motion.limiter.velocity();

        if mode == Mode::Ramp {
            self.report.standstill = self.report.standstill
                || settled(&mut self.settling, &motion.limiter, &self.report.rates, now);
            if self.report.standstill {
                motion.rest(command.update);
                self.report.limit = None;
                self.report.rates_ref = WheelRates::ZERO;
                return Outputs::SAFE;
            }
        }

        // Drive.
        let supply = inputs
            .supply
            .filter(|supply| *supply > 1.0)
            .unwrap_or(motion.configuration.supply_nominal);
        let (duty, short) = motion.drive(&mut self.report, turned, supply, now, dt);
        let threshold = motion.configuration.thresholds.slip_limit;
        let slip = self.report.slip_residual.abs();
        self.report.limit = if self.slip_limit.update(slip, threshold) {
            Some(Limit::Slip)
        } else if short {
            Some(Limit::Voltage)
        } else if limited && mode == Mode::Follow {
            Some(Limit::Acceleration)
        } else {
            None
        };
        Outputs {
            duty,
            drivers_enabled: true,
            brake_released: true,
        }
    }

    /// A new start clears what is latched; what still holds is latched again in the same tick.
    fn acknowledge(&mut self, start: u16) {
        if start != self.report.start {
            self.report.start = start;
            self.report.fault = None;
            self.supply_low.reset();
            self.slip_fault.reset();
            if let Some(motion) = &mut self.motion {
                for wheel in &mut motion.wheels {
                    wheel.watch.reset();
                }
            }
        }
    }
}

impl Motion {
    /// How far each wheel turned, rad, a whole number of counts.
    #[inline]
    fn turned(&self, previous: [u16; 4], counts: [u16; 4]) -> [f32; 4] {
        let [a, b, c, d] = &self.wheels;
        let [pa, pb, pc, pd] = previous;
        let [na, nb, nc, nd] = counts;
        let one = |wheel: &Wheel, from: u16, to: u16| {
            f32::from(to.wrapping_sub(from).cast_signed()) * wheel.step
        };
        [
            one(a, pa, na),
            one(b, pb, nb),
            one(c, pc, nc),
            one(d, pd, nd),
        ]
    }

    #[inline]
    fn measure(&mut self, turned: [f32; 4], rates: &WheelRates, report: &mut Report) {
        let kinematics = &self.configuration.kinematics;
        // Whole counts, not filtered rates: nothing is lost however slow it goes.
        let moved = kinematics.displacement(&WheelRates::from(turned));
        self.odometry.update(moved, 1.0);
        report.pose = self.odometry.pose();
        report.measured = kinematics.forward(rates);
        report.slip_residual = kinematics.slip_residual(rates);
        report.rates = *rates;
    }

    fn wheel_fault(&self) -> Option<Fault> {
        self.wheels.iter().find_map(|wheel| wheel.watch.fault())
    }

    #[inline]
    fn drive(
        &mut self,
        report: &mut Report,
        turned: [f32; 4],
        supply: f32,
        now: Micros,
        dt: f32,
    ) -> ([f32; 4], bool) {
        let per_volt = 1.0 / supply;
        let kinematics = &self.configuration.kinematics;
        report.rates_ref = kinematics.inverse(self.limiter.velocity());
        self.accelerations = kinematics.inverse(self.limiter.acceleration()).into();
        let references: [f32; 4] = report.rates_ref.into();
        let accelerations = self.accelerations;
        let rates: [f32; 4] = report.rates.into();
        let mut duty = [0.0; 4];
        let mut any_short = false;
        for (((((wheel, rate_ref), acceleration), rate), turned), duty) in self
            .wheels
            .iter_mut()
            .zip(references)
            .zip(accelerations)
            .zip(rates)
            .zip(turned)
            .zip(&mut duty)
        {
            let reference = WheelReference {
                rate: rate_ref,
                acceleration,
            };
            let (voltage, short) = wheel.drive.update(reference, rate, supply, dt);
            any_short |= short;
            wheel.watch.update((rate_ref, rate), voltage, turned, now);
            *duty = voltage * per_volt * wheel.motor_sign;
        }
        (duty, any_short)
    }

    /// Loops and reference at rest.
    fn rest(&mut self, update: u16) {
        self.limiter.reset();
        self.accelerations = [0.0; 4];
        self.interpolator.restart(Twist::ZERO, update);
        for wheel in &mut self.wheels {
            wheel.drive.reset();
        }
    }
}

/// A fault that is there right now, whatever the robot does.
const fn live_fault(inputs: &Inputs) -> Option<Fault> {
    if inputs.emergency_stop {
        Some(Fault::EmergencyStop)
    } else if inputs.driver_fault {
        Some(Fault::DriverFault)
    } else {
        None
    }
}

/// Time between two instants in 32 bits: what is more than an hour apart is so long ago either way.
fn span(from: Micros, to: Micros) -> u32 {
    u32::try_from(to.since(from).0).unwrap_or(u32::MAX)
}

fn late(elapsed: u32, now: Micros, alive: Micros) -> Option<Fault> {
    if elapsed > OVERDUE_US {
        Some(Fault::ControlLate)
    } else if span(alive, now) > BUS_SILENT_US {
        Some(Fault::BusStarved)
    } else {
        None
    }
}

/// Whether a ramp is over: the reference stands, and the wheels do or had their time to.
fn settled(since: &mut Option<Micros>, limiter: &Limiter, rates: &WheelRates, now: Micros) -> bool {
    if !limiter.stands() {
        *since = None;
        return false;
    }
    let waited = now.since(*since.get_or_insert(now)).0;
    let rates: [f32; 4] = (*rates).into();
    let standing = rates.iter().all(|rate| rate.abs() < STANDING_RATE);
    (standing && waited >= 20_000) || waited >= SETTLE_US
}
