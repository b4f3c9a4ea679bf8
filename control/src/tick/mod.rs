//! The control side: one tick a millisecond, from encoder counts to duties.
//!
//! It owns the outputs. The bus side's [`Command`] is a request: the control side refuses it
//! without a configuration of the same CRC, after a fault of its own, or when the bus side has gone
//! silent. A tick has four steps, in this order: *measure* the wheels; *judge*, which checks for
//! faults; *grant*, which decides how much of the request is allowed; and *follow*, which shapes
//! the group twist (the same in every member), converts it into this member's wheel references and
//! closes the four loops. Each is a module of its name.
//!
//! Nothing here allocates, waits or fails; there is no trigonometry beyond the odometry's. Faults
//! are latched until the bus side's next start, and cleared then only if their cause is gone.

mod follow;
mod grant;
mod identify;
mod judge;
mod measure;
mod motion;
mod unconfigured;

use identification::{Identification, Outcome};
use protocol::Fault;

use crate::brake::Brake;
use crate::configuration::Configuration;
use crate::current::Current;
use crate::gyro::Gyro;
use crate::interface::{Command, Inputs, Mode, Outputs, Report};
use crate::limiter::Step;
use crate::quantity::{Angle, Ends, Voltage};
use crate::rollers::{RollerState, Rollers};
use crate::supply::Supply;
use crate::threshold::{Hysteresis, Lasting};
use crate::time::{Micros, TICK_US};
use crate::wheel_drive::{Bridge, CurrentDrive, WheelDrive};
use judge::{live_fault, turns};
use motion::Motion;
use unconfigured::Unconfigured;

/// A tick later than this after the last one counts as late, us.
const LATE_US: u32 = TICK_US + TICK_US / 2;

/// Later than this, the wheels have been without control for too long, us.
const OVERDUE_US: u32 = 20_000;

/// How many ticks a new configuration measures before it drives. The first SYNC after a start is
/// for the others to learn of it, so no start takes longer for these.
const UNPROVEN_TICKS: u8 = 9;

/// Time and supply of one tick.
#[derive(Clone, Copy)]
struct Tick {
    now: Micros,
    /// Time since the last tick, bounded so that the observer stays stable after a long pause.
    step: Step,
    /// The same without the bound, us.
    elapsed_us: u32,
    /// Voltage at full duty, V.
    supply: Voltage,
    /// Voltage at the largest duty, V.
    available: Voltage,
}

/// The control side of one robot.
#[derive(Clone)]
pub struct ControlSide {
    motion: Option<Motion>,
    supervision: Supervision,
}

/// The state besides the motion: causes that have to last, and the report to the bus side.
#[derive(Clone)]
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
    /// Ticks in which the configuration, which is new, still only measures.
    unproven: u8,
    unconfigured: Unconfigured,
    /// Of the voltages in this tick.
    ends: Ends,
    gyro: Gyro,
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
                unproven: 0,
                unconfigured: Unconfigured::new(),
                ends: Ends::NONE,
                gyro: Gyro::new(),
                report: Report::NONE,
            },
        }
    }

    /// Applies a configuration. This switches the outputs off and resets the pose to zero. They
    /// stay off for nine ticks, in which a current that is too large is seen, and so are wheels
    /// that turn or turned before there was a configuration.
    pub fn configure(&mut self, configuration: &Configuration) {
        let side = &mut self.supervision;
        side.safe(false);
        side.identification = None;
        side.unproven = UNPROVEN_TICKS;
        if self.motion.is_some() {
            // With a configuration the wheels are measured.
            side.unconfigured = Unconfigured::new();
        }
        side.report.configuration = configuration.crc;
        side.report.mode = Mode::Off;
        side.report.current = 0.0;
        side.report.roller_states = [RollerState::Constant; 4];
        side.report.roller_sweeps = Report::NONE.roller_sweeps;
        // The angles known from the wheels' indexes stay valid.
        let before = self.motion.as_ref();
        let before = before.and_then(|motion| motion.rollers.as_ref());
        let rolling = configuration.drivetrain.rolling();
        let rollers = rolling.map(|rolling| Rollers::new(rolling, before));
        self.motion = Some(Motion::new(configuration, rollers));
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

    /// One tick with bridges: the outputs are duties.
    // Not inlined: a caller that is built for size would also build this for size.
    #[inline(never)]
    pub fn tick(&mut self, now: Micros, command: &Command, inputs: &Inputs) -> Outputs {
        self.tick_with::<Bridge>(now, command, inputs)
    }

    /// One tick with current drives, of whose motors the hottest has this temperature, degrees
    /// Celsius: the outputs are currents.
    #[inline(never)]
    pub fn tick_current(
        &mut self,
        now: Micros,
        command: &Command,
        inputs: &Inputs,
        temperature: u8,
    ) -> Outputs {
        self.supervision.report.temperature = temperature;
        self.tick_with::<CurrentDrive>(now, command, inputs)
    }

    #[inline(always)]
    fn tick_with<D: WheelDrive>(
        &mut self,
        now: Micros,
        command: &Command,
        inputs: &Inputs,
    ) -> Outputs {
        let side = &mut self.supervision;
        let elapsed_us = side.begin(now);
        let previous = side.counts.replace(inputs.encoder_counts);
        let is_first = previous.is_none();
        let previous = previous.unwrap_or(inputs.encoder_counts);
        if command.start != side.report.start {
            side.acknowledge(command.start, self.motion.as_mut());
        }
        side.report.obstacle = live_fault::<D>(inputs);
        side.report.protective_stop = inputs.protective_stop;
        if cfg!(feature = "gyro")
            && let Some(reading) = inputs.gyro
        {
            side.gyro.update(reading, &inputs.encoder_counts);
            side.report.gyro = side.gyro.report();
        }
        let Some(motion) = &mut self.motion else {
            side.unconfigured.note(inputs.encoder_counts, is_first);
            side.report.mode = Mode::Off;
            return side.safe(command.mode == Mode::Ramp);
        };
        side.run::<D>(motion, command, inputs, &previous, elapsed_us)
    }
}

impl Supervision {
    /// A tick with a configuration. Not inlined: a load within a kilobyte of a pointer takes one
    /// instruction, and one further away takes two, so there is a pointer to each of the two
    /// halves.
    #[inline(never)]
    fn run<D: WheelDrive>(
        &mut self,
        motion: &mut Motion,
        command: &Command,
        inputs: &Inputs,
        previous: &[u16; 4],
        elapsed_us: u32,
    ) -> Outputs {
        let tick = self.powered(motion, inputs, elapsed_us);
        let turn = match self.gyro.rate() {
            Some(rate) if cfg!(feature = "gyro") => Some(Angle::new(rate * tick.step.dt.to_f32())),
            _ => None,
        };
        let turned = motion.measure(previous, inputs, tick.step.dt, turn, &mut self.report);
        if D::MAY_RAMP
            && let Some(fault) = inputs.drive_fault
        {
            motion.on_drive_fault(fault);
        }
        if self.unproven > 0 {
            self.look_before_driving(motion);
        }
        if command.mode != Mode::Off || self.holds(motion) {
            self.judge(motion, command, &tick);
        }
        if command.mode == Mode::Off {
            self.look_at_wheels();
        }
        let mode = self.grant(motion, command);
        let outputs = if mode == Mode::Identify || self.identification.is_some() {
            self.identify::<D>(motion, command, turned, &tick)
        } else if mode == Mode::Off {
            self.rest(motion, command, command.mode == Mode::Ramp)
        } else {
            self.follow::<D>(motion, command, turned, &tick)
        };
        self.count_saturation(motion, turned);
        outputs
    }

    /// A tick of a configuration that is new: what has not been measured before its start is still
    /// in time to refuse that.
    #[cold]
    #[inline(never)]
    fn look_before_driving(&mut self, motion: &Motion) {
        self.unproven -= 1;
        if self.report.obstacle.is_none() && self.unconfigured.turned(&motion.configuration) {
            self.report.obstacle = Some(Fault::WheelsTurn);
        }
        self.look_at_wheels();
    }

    /// Wheels that turn are in the way of a start.
    #[inline]
    fn look_at_wheels(&mut self) {
        if self.report.obstacle.is_none() && turns(&self.report.rates) {
            self.report.obstacle = Some(Fault::WheelsTurn);
        }
    }

    /// Counts this tick if the result of one of its stages was at the end of what it can say.
    #[inline]
    fn count_saturation(&mut self, motion: &Motion, turned: [Angle; 4]) {
        let report = &mut self.report;
        let mut ends = core::mem::replace(&mut self.ends, Ends::NONE);
        turned.into_iter().for_each(|one| ends.note(one));
        report.rates.into_iter().for_each(|one| ends.note(one));
        report.rates_ref.into_iter().for_each(|one| ends.note(one));
        let accelerations = motion.accelerations;
        accelerations.into_iter().for_each(|one| ends.note(one));
        ends.note(report.measured.vx);
        ends.note(report.measured.vy);
        ends.note(report.measured.omega);
        ends.note(report.slip_residual);
        if ends.reached() {
            report.saturated_ticks = report.saturated_ticks.wrapping_add(1);
        }
    }

    /// The time of this tick, and what supply and motors' current say.
    #[inline]
    fn powered(&mut self, motion: &Motion, inputs: &Inputs, elapsed_us: u32) -> Tick {
        let now = self.report.at;
        let bounds = &motion.configuration.supply;
        let supply = self.supply.update(inputs.supply_input, bounds);
        self.report.supply = self.supply.voltage();
        let sensor = motion.configuration.current.as_ref();
        if let (Some(sensor), Some(volts)) = (sensor, inputs.current_inputs) {
            let drives = self.unproven == 0;
            self.report.current = self.current.update(volts, sensor, now, drives);
            if self.current.is_too_much() && self.report.obstacle.is_none() {
                self.report.obstacle = Some(Fault::OverCurrent);
            }
        }
        let bounded_us = elapsed_us.clamp(TICK_US / 4, OVERDUE_US);
        Tick {
            now,
            step: Step::of_micros(bounded_us),
            elapsed_us,
            supply,
            available: supply.times(bounds.duty_max),
        }
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
}

/// Time between two instants in 32 bits: beyond an hour the exact time does not matter.
fn span(from: Micros, to: Micros) -> u32 {
    u32::try_from(to.since(from).0).unwrap_or(u32::MAX)
}
