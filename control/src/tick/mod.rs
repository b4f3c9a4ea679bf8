//! The control side: one tick a millisecond, from encoder counts to duties.
//!
//! It owns the outputs. The bus side's [`Command`] is a request: the control side refuses it
//! without a configuration of the same CRC, after a fault of its own, or when the bus side has gone
//! silent. A tick has four steps, in this order: *measure* the wheels; *judge*, which checks for
//! faults; *grant*, which decides how much of the request is allowed; and *follow*, which shapes
//! the group twist (the same in every member), converts it into this member's wheel references and
//! closes the four loops.
//!
//! Nothing here allocates, waits or fails; there is no trigonometry beyond the odometry's. Faults
//! are latched until the bus side's next start, and cleared then only if their cause is gone.

use kinematics::{Odometry, Twist, WheelRates};
use protocol::{Fault, Limit, Reaction};

use crate::brake::Brake;
use crate::configuration::Configuration;
use crate::current::Current;
use crate::drivetrain::Factors;
use crate::interface::{Command, Inputs, Mode, Outputs, Report};
use crate::limiter::Limiter;
use crate::observer::Observer;
use crate::rollers::{RollerState, Rollers};
use crate::setpoint::{Input, Interpolator};
use crate::silence::{Silence, Trust};
use crate::supply::Supply;
use crate::threshold::{Hysteresis, Lasting};
use crate::time::{Micros, TICK_US};
use crate::watch::Watch;
use crate::wheel::{Available, Held, WheelLoop, WheelMeasurement, WheelReference};
use identification::{Identification, Outcome, Step, Stopped};

/// A tick later than this after the last one counts as late, us.
const LATE_US: u32 = TICK_US + TICK_US / 2;

/// Later than this, the wheels have been without control for too long, us.
const OVERDUE_US: u32 = 20_000;

/// Longest time between two signs of life of the bus side, us. Well below the shortest time of a
/// watchdog that the bus side fails to feed (34 ms on the reference board): the ramp must have
/// begun by then.
const BUS_SILENT_US: u32 = 25_000;

/// Wheels slower than this are at rest, rad/s.
const STANDING_RATE: f32 = 0.05;

/// The slip residual cannot identify a wheel whose error of 1 rad/s changes it by less than this,
/// rad/s.
const LEAST_RESIDUAL: f32 = 0.1;

/// Factor of the angles for the computation of the slip residual.
const RESIDUAL_SCALE: f32 = if cfg!(feature = "fixed-point") {
    1024.0
} else {
    1.0
};

/// A robot whose wheels turn faster is not started, rad/s: well above the rate that a step of a
/// coarse encoder causes, and slow enough that the loops bring it to rest without full voltage.
const TURNING_RATE: f32 = 0.2;

/// Longest time from the end of a ramp until the wheels are at rest, us; then the brake is engaged
/// anyway.
const SETTLE_US: u64 = 300_000;

/// Time and supply of one tick.
#[derive(Clone, Copy)]
struct Tick {
    now: Micros,
    /// Time since the last tick, s, bounded so that the observer stays stable after a long pause.
    dt: f32,
    /// The same without the bound, us.
    elapsed_us: u32,
    /// Voltage at full duty, V.
    supply: f32,
    /// Voltage at the largest duty, V.
    available: f32,
}

/// Result of the loops of all wheels.
#[derive(Clone, Copy)]
struct Drive {
    duty: [f32; 4],
    /// The limit that applied to any wheel.
    held: Held,
}

/// One wheel's measurement and loop.
#[derive(Clone, Copy)]
struct Wheel {
    step: f32,
    motor_sign: f32,
    /// Its error for a slip residual of 1, if it alone were wrong, over [`RESIDUAL_SCALE`]; 0 for a
    /// wheel that the residual does not identify.
    odd: f32,
    /// Voltage at the last tick, V, where it pauses.
    given: f32,
    observer: Observer,
    wheel_loop: WheelLoop,
    silence: Silence,
    watch: Watch,
}

impl Wheel {
    /// A wheel at rest. Not inlined: four times in a row it is two kilobytes.
    #[inline(never)]
    fn new(configuration: &Configuration, place: usize) -> Self {
        let [wheel, ..] = configuration.wheels;
        let wheel = configuration.wheels.get(place).copied().unwrap_or(wheel);
        // Turning alone, by 1 rad/s, it makes this residual.
        let alone = [0, 1, 2, 3].map(|other| if other == place { 1.0 } else { 0.0 });
        let residual = configuration.drivetrain.slip_residual(&alone.into());
        let watches = configuration.thresholds.blocked_rate > 0.0;
        let listens = watches && residual.abs() > LEAST_RESIDUAL;
        Self {
            step: wheel.step,
            motor_sign: wheel.motor_sign,
            given: 0.0,
            odd: if listens {
                1.0 / (residual * RESIDUAL_SCALE)
            } else {
                0.0
            },
            observer: Observer::new(wheel.step.abs(), configuration.observer_bandwidth),
            wheel_loop: WheelLoop::new(wheel.gains, wheel.torque),
            silence: Silence::new(wheel.step.abs(), listens),
            watch: Watch::new(configuration, &wheel),
        }
    }

    /// One tick of a wheel: its voltage, V; a limit that applied is added to `held`.
    #[inline(always)]
    fn drive(
        &mut self,
        reference: WheelReference,
        measured: WheelMeasurement,
        residual: f32,
        tick: &Tick,
        held: &mut Held,
    ) -> f32 {
        let (rate, turned) = (measured.rate, measured.turned);
        let implied = turned - residual * self.odd;
        let trust = self
            .silence
            .update(reference.rate, implied, turned, tick.dt);
        let available = Available {
            voltage: tick.available,
            dt: tick.dt,
        };
        let voltage = if trust == Trust::Full {
            self.wheel_loop.command(reference, rate, available, held)
        } else {
            if trust == Trust::None {
                self.watch.latch_dead();
            }
            let (voltage, by) = self.wheel_loop.doubt(reference, rate, trust, available);
            *held = *held | by;
            voltage
        };
        self.watch
            .update(reference.rate, measured, voltage, (tick.now, tick.dt));
        voltage
    }

    /// The same voltage, or none for one tick where its sign changes.
    fn pause(&mut self, voltage: f32) -> f32 {
        let turns = voltage * self.given < 0.0;
        self.given = if turns { 0.0 } else { voltage };
        self.given
    }
}

/// The state that exists once there is a configuration. The fields are ordered so that those of
/// every tick lie within the kilobyte that one instruction reaches.
#[derive(Clone, Copy)]
#[repr(C)]
struct Motion {
    /// The wheels' reference acceleration at the last tick, rad/s^2.
    accelerations: [f32; 4],
    limiter: Limiter,
    factors: Factors,
    interpolator: Interpolator,
    odometry: Odometry,
    wheels: [Wheel; 4],
    configuration: Configuration,
    rollers: Option<Rollers>,
}

/// The control side of one robot.
pub struct ControlSide {
    motion: Option<Motion>,
    supervision: Supervision,
}

/// The state besides the motion: causes that have to last, and the report to the bus side.
struct Supervision {
    counts: Option<[u16; 4]>,
    last: Option<Micros>,
    /// Time since which the ramp's reference is zero.
    settling: Option<Micros>,
    supply: Supply,
    current: Current,
    brake: Brake,
    slip_limit: Hysteresis,
    slip_fault: Lasting,
    identification: Option<Identification>,
    outcome: Option<Outcome>,
    report: Report,
}

impl Default for ControlSide {
    fn default() -> Self {
        Self::new()
    }
}

impl ControlSide {
    /// A robot without a configuration: outputs off.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            motion: None,
            supervision: Supervision {
                counts: None,
                last: None,
                settling: None,
                supply: Supply::new(),
                current: Current::new(),
                brake: Brake::Engaged,
                slip_limit: Hysteresis { active: false },
                slip_fault: Lasting::new(),
                identification: None,
                outcome: None,
                report: Report::NONE,
            },
        }
    }

    /// Applies a configuration. This switches the outputs off and resets the pose to zero.
    pub fn configure(&mut self, configuration: &Configuration) {
        self.supervision.report.configuration = configuration.crc;
        self.supervision.report.mode = Mode::Off;
        self.supervision.report.current = 0.0;
        self.supervision.brake = Brake::Engaged;
        self.supervision.identification = None;
        // The angles known from the wheels' indexes stay valid.
        let before = self
            .motion
            .as_ref()
            .and_then(|motion| motion.rollers.as_ref());
        let rollers = configuration
            .rollers
            .map(|configured| Rollers::new(configured, before));
        self.supervision.report.roller_states = [RollerState::Constant; 4];
        self.supervision.report.roller_sweeps = [0.0; 4];
        // Built in place: it takes two kilobytes, which would come on top of everything else on the
        // stack.
        self.motion = Some(Motion {
            interpolator: Interpolator::new(configuration.times.sync_period_us as f32),
            limiter: Limiter::default(),
            odometry: Odometry::new(),
            accelerations: [0.0; 4],
            wheels: [
                Wheel::new(configuration, 0),
                Wheel::new(configuration, 1),
                Wheel::new(configuration, 2),
                Wheel::new(configuration, 3),
            ],
            factors: configuration.drivetrain.factors(),
            rollers,
            configuration: *configuration,
        });
    }

    /// The report of the last tick.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.supervision.report
    }

    /// The result of an identification, once, when it is over.
    pub const fn take_identification(&mut self) -> Option<Outcome> {
        self.supervision.outcome.take()
    }

    /// One tick.
    // Not inlined: a caller that is built for size would also build this for size.
    #[inline(never)]
    pub fn tick(&mut self, now: Micros, command: &Command, inputs: &Inputs) -> Outputs {
        let side = &mut self.supervision;
        let elapsed_us = side.begin(now);
        let previous = side.counts.replace(inputs.encoder_counts);
        let previous = previous.unwrap_or(inputs.encoder_counts);
        if command.start != side.report.start {
            side.acknowledge(command.start, self.motion.as_mut());
        }
        side.report.obstacle = live_fault(inputs);
        side.report.protective_stop = inputs.protective_stop;
        let Some(motion) = &mut self.motion else {
            side.report.mode = Mode::Off;
            return side.safe(command.mode == Mode::Ramp);
        };
        side.run(motion, command, inputs, &previous, elapsed_us)
    }
}

impl Supervision {
    /// A tick with a configuration. Not inlined: a load within a kilobyte of a pointer takes one
    /// instruction, and one further away takes two, so there is a pointer to each of the two
    /// halves.
    #[inline(never)]
    fn run(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        inputs: &Inputs,
        previous: &[u16; 4],
        elapsed_us: u32,
    ) -> Outputs {
        let side = self;
        let bounds = &motion.configuration.supply;
        let supply = side.supply.update(inputs.supply_input, bounds);
        let tick = Tick {
            now: side.report.at,
            dt: elapsed_us.clamp(TICK_US / 4, OVERDUE_US) as f32 * 1e-6,
            elapsed_us,
            supply,
            available: supply * bounds.duty_max,
        };
        side.report.supply = side.supply.voltage();
        if let (Some(sensor), Some(volts)) = (&motion.configuration.current, inputs.current_inputs)
        {
            let (current, over) = side.current.update(volts, sensor, tick.now);
            side.report.current = current;
            if over && side.report.obstacle.is_none() {
                side.report.obstacle = Some(Fault::OverCurrent);
            }
        }
        let turned = motion.measure(previous, inputs, tick.dt, &mut side.report);
        if command.mode != Mode::Off || side.holds(motion) {
            side.judge(motion, command, &tick);
        }
        if command.mode == Mode::Off && side.report.obstacle.is_none() && turns(&side.report.rates)
        {
            side.report.obstacle = Some(Fault::WheelsTurn);
        }
        let mode = side.grant(motion, command);
        if mode == Mode::Identify || side.identification.is_some() {
            return side.identify(motion, command, turned, &tick);
        }
        if mode == Mode::Off {
            return side.safe(command.mode == Mode::Ramp);
        }
        side.follow(motion, command, turned, &tick)
    }

    /// Begins a tick; returns the time since the last one, us.
    #[inline]
    fn begin(&mut self, now: Micros) -> u32 {
        let elapsed = self
            .last
            .replace(now)
            .map_or(TICK_US, |last| span(last, now));
        if elapsed > LATE_US {
            self.report.late_ticks = self.report.late_ticks.wrapping_add(1);
        }
        self.report.at = now;
        elapsed
    }

    /// A new start clears latched faults; a cause that is still present is latched again in the
    /// same tick.
    #[cold]
    fn acknowledge(&mut self, start: u16, motion: Option<&mut Motion>) {
        self.report.start = start;
        self.report.fault = None;
        self.supply.acknowledge();
        self.slip_fault.reset();
        for wheel in motion.into_iter().flat_map(|motion| &mut motion.wheels) {
            wheel.watch.reset();
            wheel.silence.reset();
        }
    }

    /// Looks for faults while the robot drives. The first is kept; only one that cuts replaces one
    /// that ramps, because a robot with a shorted bridge or a reversed encoder cannot ramp down.
    #[inline]
    fn judge(&mut self, motion: &Motion, command: &Command, tick: &Tick) {
        let kept = self.report.fault;
        let wheel = motion.wheel_fault();
        let cut = self
            .report
            .obstacle
            .or_else(|| wheel.filter(|fault| fault.reaction() == Reaction::Cut))
            .or_else(|| self.supply.too_high(&motion.configuration.supply, tick.now));
        self.report.fault = match kept.map(reaction) {
            Some(Reaction::Cut) => kept,
            Some(Reaction::Ramp) => cut.or(kept),
            None => cut
                .or_else(|| {
                    let asked = self.report.protective_stop && motion.configuration.protective_stop;
                    asked.then_some(Fault::ProtectiveStop)
                })
                .or(wheel)
                .or_else(|| late(tick.elapsed_us, tick.now, command.alive))
                .or_else(|| self.lasting_fault(motion, command, tick.now)),
        };
    }

    /// Causes that have to last before they are a fault.
    #[inline]
    fn lasting_fault(&mut self, motion: &Motion, command: &Command, now: Micros) -> Option<Fault> {
        let low = self.supply.too_low(&motion.configuration.supply, now);
        if low.is_some() {
            return low;
        }
        let bound = motion.configuration.thresholds.slip_fault;
        // Wheels that turn one by one are not rolling on a floor.
        let rolls = command.mode != Mode::Identify;
        let slips = rolls && bound > 0.0 && self.report.slip_residual.abs() > bound;
        if !slips {
            self.slip_fault.reset();
            return None;
        }
        let lasting_us = motion.configuration.times.consequence_us();
        let lasts = self.slip_fault.update(slips, now, lasting_us);
        lasts.then_some(Fault::SlipExcess)
    }

    /// The mode that is allowed for the bus side's command.
    #[inline]
    fn grant(&mut self, motion: &mut Motion, command: &Command) -> Mode {
        let known = command.configuration == motion.configuration.crc;
        let mode = match (command.mode, self.report.fault.map(reaction)) {
            _ if !known => Mode::Off,
            (_, Some(Reaction::Cut)) => Mode::Off,
            (Mode::Hold | Mode::Follow | Mode::Identify, Some(Reaction::Ramp)) => Mode::Ramp,
            // The motors carry the load until the brake holds it.
            (Mode::Off, _) if self.holds(motion) => Mode::Ramp,
            (mode, None | Some(Reaction::Ramp)) => mode,
        };
        self.report.mode = mode;
        if mode == Mode::Off {
            motion.rest(command.update);
        }
        if mode != Mode::Ramp {
            self.settling = None;
            self.report.standstill = false;
        }
        mode
    }

    /// Whether the robot is at rest and its drivers hold the load until the brake does.
    fn holds(&self, motion: &Motion) -> bool {
        let waits = motion.configuration.brake.engage_us > 0;
        waits && self.brake.is_held_by_drivers() && motion.limiter.stands()
    }

    /// The safe state: no torque, drivers off, braked; `standstill` says that a ramp has ended.
    #[inline(never)]
    fn safe(&mut self, standstill: bool) -> Outputs {
        self.brake = Brake::Engaged;
        self.report.standstill = standstill;
        self.report.limit = None;
        self.report.twist_ref = Twist::ZERO;
        self.report.rates_ref = WheelRates::ZERO;
        Outputs::SAFE
    }

    /// Shapes the group's twist and drives the wheels accordingly.
    #[inline]
    fn follow(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        turned: [f32; 4],
        tick: &Tick,
    ) -> Outputs {
        let times = motion.configuration.brake;
        let free = self.brake.release(tick.now, times);
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
                motion.rest(command.update);
                return self.safe(true);
            }
        }
        let drive = motion.drive(&mut self.report, turned, tick);
        if !free {
            motion.forgive();
        }
        self.report.limit = self.limit(motion, limited && mode == Mode::Follow, drive.held);
        Outputs {
            duty: drive.duty,
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

    /// One tick of an identification, from its beginning to standstill. No loop is closed and no
    /// setpoint is followed: all wheels get one voltage, and none when it is over or has failed.
    #[cold]
    #[inline(never)]
    fn identify(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        turned: [f32; 4],
        tick: &Tick,
    ) -> Outputs {
        let mode = self.report.mode;
        self.report.limit = None;
        self.report.twist_ref = Twist::ZERO;
        self.report.rates_ref = WheelRates::ZERO;
        motion.rest(command.update);
        let voltage = self.identification_voltage(motion, command, turned, tick.dt);
        let ramps = mode == Mode::Ramp && !self.report.standstill;
        let (limiter, rates) = (&motion.limiter, &self.report.rates);
        if mode == Mode::Off || ramps && settled(&mut self.settling, limiter, rates, tick.now) {
            self.identification = None;
            return self.safe(command.mode == Mode::Ramp);
        }
        let nominal = motion.configuration.supply.nominal;
        let supply = self.report.supply.unwrap_or(nominal).max(nominal * 0.5);
        let duty = voltage / supply;
        Outputs {
            duty: [0, 1, 2, 3].map(|wheel: usize| {
                let sign = motion.wheels.get(wheel).map_or(0.0, |w| w.motor_sign);
                if command.bounds.drives(wheel) {
                    duty * sign
                } else {
                    0.0
                }
            }),
            drivers_enabled: true,
            brake_released: true,
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
        let nominal = motion.configuration.supply.nominal;
        let run = self
            .identification
            .get_or_insert_with(|| Identification::new(command.bounds, nominal, TICK_US));
        if self.report.mode == Mode::Identify {
            return match run.tick(turned, self.report.rates.into(), dt) {
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

impl Motion {
    /// Angle by which each wheel turned, rad, a whole number of counts.
    #[inline]
    fn turned(&self, previous: &[u16; 4], counts: &[u16; 4]) -> [f32; 4] {
        let [a, b, c, d] = &self.wheels;
        let [pa, pb, pc, pd] = *previous;
        let [na, nb, nc, nd] = *counts;
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

    /// Measures the wheels since the last tick; returns the angle by which each turned, rad.
    #[inline]
    fn measure(
        &mut self,
        previous: &[u16; 4],
        inputs: &Inputs,
        dt: f32,
        report: &mut Report,
    ) -> [f32; 4] {
        let turned = self.turned(previous, &inputs.encoder_counts);
        let mut rates = [0.0; 4];
        for (((wheel, turned), acceleration), rate) in self
            .wheels
            .iter_mut()
            .zip(turned)
            .zip(self.accelerations)
            .zip(&mut rates)
        {
            *rate = wheel.observer.update(turned, acceleration, dt);
        }
        report.rates = WheelRates::from(rates);
        self.locate(previous, inputs, &WheelRates::from(turned), report);
        turned
    }

    /// Twist, slip and pose from the wheels' rates and angles.
    #[inline]
    fn locate(
        &mut self,
        previous: &[u16; 4],
        inputs: &Inputs,
        turned: &WheelRates,
        report: &mut Report,
    ) {
        let (drivetrain, factors) = (&self.configuration.drivetrain, &self.factors);
        let rates = &report.rates;
        // Whole counts, not filtered rates: no motion is lost at any speed.
        let moved = if let Some(rollers) = &mut self.rollers {
            let passed = passed(previous, &inputs.encoder_counts);
            let middle = rollers.update(passed, inputs.encoder_counts, inputs.index.as_ref());
            (report.measured, report.slip_residual) =
                drivetrain.achieved_at(rates, factors, rollers.secants());
            report.roller_states = rollers.states();
            report.roller_sweeps = rollers.sweeps();
            drivetrain.displacement_at(turned, factors, &middle)
        } else {
            report.measured = drivetrain.achieved(rates, factors);
            report.slip_residual = drivetrain.slip_residual(rates);
            drivetrain.displacement(turned, factors)
        };
        self.odometry.update(moved, 1.0);
        report.pose = self.odometry.pose();
    }

    /// The group's twist for this tick, within the limits of the mode; returns whether a limit
    /// applied.
    #[inline]
    fn shape(&mut self, mode: Mode, command: &Command, tick: &Tick) -> bool {
        let (input, limits) = if mode == Mode::Follow {
            let (target, at) = (command.twist_cmd, command.at);
            let input = self.interpolator.at(tick.now, target, command.update, at);
            (input, &self.configuration.follow)
        } else {
            (Input::default(), &self.configuration.ramp)
        };
        let limited = self.limiter.step(input.twist, input.slope, tick.dt, limits);
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

    /// Confirmed faults of the wheels; one that cuts comes first.
    #[inline]
    fn wheel_fault(&self) -> Option<Fault> {
        let [a, b, c, d] = &self.wheels;
        let faults = [a, b, c, d].map(|wheel| wheel.watch.fault());
        if faults.iter().all(Option::is_none) {
            return None;
        }
        let cuts = |fault: &Fault| fault.reaction() == Reaction::Cut;
        let mut found = faults.iter().flatten().copied();
        let cut = found.find(cuts);
        cut.or_else(|| faults.iter().flatten().copied().next())
    }

    /// Closes the four loops.
    #[inline]
    fn drive(&mut self, report: &mut Report, turned: [f32; 4], tick: &Tick) -> Drive {
        self.refer(report, tick.dt);
        // Unrolled: a fifth fewer instructions than a loop.
        let [a, b, c, d] = &mut self.wheels;
        let signs = [a.motor_sign, b.motor_sign, c.motor_sign, d.motor_sign];
        let references: [f32; 4] = report.rates_ref.into();
        let rates: [f32; 4] = report.rates.into();
        let [ref_a, ref_b, ref_c, ref_d] = pairs(references, self.accelerations, reference);
        let [seen_a, seen_b, seen_c, seen_d] = pairs(rates, turned, measurement);
        // From the counts, not from the rates: a wheel that stops is detected in the same tick.
        let residual = self
            .configuration
            .drivetrain
            .slip_residual(&turned.map(scaled).into());
        let mut held = Held::default();
        let a = a.drive(ref_a, seen_a, residual, tick, &mut held);
        let b = b.drive(ref_b, seen_b, residual, tick, &mut held);
        let c = c.drive(ref_c, seen_c, residual, tick, &mut held);
        let d = d.drive(ref_d, seen_d, residual, tick, &mut held);
        let mut voltages = [a, b, c, d];
        if self.configuration.direction_pause {
            voltages = self.pause(voltages);
        }
        let per_volt = 1.0 / tick.supply;
        Drive {
            duty: pairs(voltages, signs, |voltage, sign| voltage * sign)
                .map(|voltage| voltage * per_volt),
            held,
        }
    }

    /// No voltage for one tick where its sign changes: for bridges that need it.
    #[cold]
    fn pause(&mut self, mut voltages: [f32; 4]) -> [f32; 4] {
        for (wheel, voltage) in self.wheels.iter_mut().zip(&mut voltages) {
            *voltage = wheel.pause(*voltage);
        }
        voltages
    }

    /// The wheels' references, from the group's twist and acceleration.
    #[inline]
    fn refer(&mut self, report: &mut Report, dt: f32) {
        let (drivetrain, velocity) = (&self.configuration.drivetrain, self.limiter.velocity());
        drivetrain.renew(&mut self.factors, velocity, report.measured);
        if let Some(rollers) = &self.rollers {
            // Rates for the present roller angles, and the acceleration that brings the wheels to
            // the rates for the roller angles and the twist of the next tick.
            let now = drivetrain.asked_at(velocity, &self.factors, rollers.secants());
            let ahead = rollers.ahead(&now, dt);
            let next = velocity + self.limiter.acceleration() * dt;
            let next = drivetrain.asked_at(next, &self.factors, &ahead);
            report.rates_ref = now;
            self.accelerations = per_second(&now, &next, dt);
        } else {
            report.rates_ref = drivetrain.asked(velocity, &self.factors);
            let acceleration = self.limiter.acceleration();
            self.accelerations = drivetrain.asked(acceleration, &self.factors).into();
        }
    }

    /// Drops all suspicions against the wheels.
    #[cold]
    fn forgive(&mut self) {
        for wheel in &mut self.wheels {
            wheel.watch.forgive();
            wheel.silence.forgive();
        }
    }

    /// Loops and reference at rest.
    fn rest(&mut self, update: u16) {
        self.limiter.reset();
        self.accelerations = [0.0; 4];
        self.interpolator.restart(Twist::ZERO, update);
        for wheel in &mut self.wheels {
            wheel.wheel_loop.reset();
        }
    }
}

/// Counts by which each encoder has advanced.
#[inline]
fn passed(from: &[u16; 4], to: &[u16; 4]) -> [i16; 4] {
    let [a, b, c, d] = *from;
    let [e, f, g, h] = *to;
    let one = |from: u16, to: u16| to.wrapping_sub(from).cast_signed();
    [one(a, e), one(b, f), one(c, g), one(d, h)]
}

/// Combines two values of every wheel into one.
#[inline(always)]
fn pairs<T>(first: [f32; 4], second: [f32; 4], make: fn(f32, f32) -> T) -> [T; 4] {
    let [a, b, c, d] = first;
    let [e, f, g, h] = second;
    [make(a, e), make(b, f), make(c, g), make(d, h)]
}

/// The smallest angle of one tick that fixed point resolves; as a rate it has more digits.
#[inline(always)]
fn scaled(turned: f32) -> f32 {
    turned * RESIDUAL_SCALE
}

#[inline(always)]
const fn reference(rate: f32, acceleration: f32) -> WheelReference {
    WheelReference { rate, acceleration }
}

#[inline(always)]
const fn measurement(rate: f32, turned: f32) -> WheelMeasurement {
    WheelMeasurement { rate, turned }
}

/// Change per second over one step of `dt` s.
#[inline]
fn per_second(from: &WheelRates, to: &WheelRates, dt: f32) -> [f32; 4] {
    let per_second = 1.0 / dt;
    [
        (to.front_left - from.front_left) * per_second,
        (to.front_right - from.front_right) * per_second,
        (to.rear_left - from.rear_left) * per_second,
        (to.rear_right - from.rear_right) * per_second,
    ]
}

/// The reaction to a fault. In most ticks there is none.
#[cold]
#[inline(never)]
fn reaction(fault: Fault) -> Reaction {
    fault.reaction()
}

/// A fault that is present now, in any mode.
const fn live_fault(inputs: &Inputs) -> Option<Fault> {
    if inputs.emergency_stop {
        Some(Fault::EmergencyStop)
    } else if inputs.driver_fault {
        Some(Fault::DriverFault)
    } else {
        None
    }
}

/// Whether any wheel turns too fast for a start.
fn turns(rates: &WheelRates) -> bool {
    let rates: [f32; 4] = (*rates).into();
    rates.iter().any(|rate| rate.abs() > TURNING_RATE)
}

/// Time between two instants in 32 bits: beyond an hour the exact time does not matter.
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

/// Whether a ramp is over: the reference is zero, and the wheels are at rest or their time has
/// expired.
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
