//! Identifies the motors: static friction, volts per rate and volts per acceleration of every
//! wheel.
//!
//! # Theory of operation
//!
//! All four wheels get the same voltage, so a robot on its wheels drives straight ahead and back;
//! one on blocks turns them freely. On blocks, [`Bounds::wheels`] may name some of them: the others
//! get no voltage and need not turn. First the voltage rises slowly, by a tenth of the nominal
//! supply a second, until a wheel reaches its bound of rate or travel (*ramp*); then, from
//! standstill, the same voltage is applied backward at once (*step*). The ramp yields `kS` and
//! `kV`, the step `kA` of
//!
//! ```text
//! u = kS sgn(w) + kV w + kA w'
//! ```
//!
//! Nothing is differentiated. The equation is multiplied by a triangle two windows wide, a tenth of
//! a second each, and integrated. It then holds between three numbers that follow exactly from
//! whole counts: the weighted voltage, the difference of the two windows' mean angles over a
//! window's length (the rate), and the difference of the distances covered in them over its square
//! (the acceleration). Only the acceleration is noisy (half a count over a window's length
//! squared), so it appears in sums and in products with the others, never squared: its noise
//! averages out instead of lowering `kA`.
//!
//! # Limits
//!
//! An identification takes at most [`Identification::TIME_LIMIT`] seconds and half of the nominal
//! supply, and stays within the rate and travel in [`Bounds`]. A motor at rest gets no more than
//! what its largest current takes there. A wheel that does not move at that, or at a quarter of the
//! nominal supply, ends it, because its encoder may be dead. Every failure is a [`Stopped`], and
//! every end leaves the motors without voltage.
//!
//! Cost: about 150 instructions a tick, and no more room than four times twenty numbers.

#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

#[cfg(test)]
extern crate std;

use kinematics::Real as _;

/// Length of a window, us.
const WINDOW_US: u32 = 100_000;
/// Share of the nominal supply by which the ramp rises, 1/s.
const RAMP_SHARE: f32 = 0.1;
/// Largest share of the nominal supply.
const VOLTAGE_SHARE: f32 = 0.5;
/// Share of the nominal supply at which every wheel must turn.
const BREAKAWAY_SHARE: f32 = 0.25;
/// Share of the permitted way that ramp and step take; the rest is for coming to rest.
const WAY_SHARE: f32 = 0.6;
/// Factor by which a wheel may exceed the permitted rate before it counts as a runaway.
const OVERSPEED: f32 = 1.5;
/// Angle from which a wheel has turned, rad.
const TURNED: f32 = 0.1;
/// Angle from which a wheel has moved within a window, rad.
const MOVED: f32 = 0.02;
/// Windows of the ramp that a fit needs.
const RAMP_ROWS: u16 = 4;
/// Length of the step, s.
const STEP_TIME: f32 = 0.6;
/// Wheels slower than this are at rest, rad/s; the time for which they must be, s, and the time
/// they have to reach it.
const STANDING_RATE: f32 = 0.05;
const STANDING_TIME: f32 = 0.2;
const COAST_TIME: f32 = 2.0;
/// Largest rms residual of the ramp's line, as a fraction of the ramp's voltage.
const MISFIT: f32 = 0.1;

/// Bounds of rate and travel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Bounds {
    /// rad/s at the end of the ramp. The step repeats its last voltage and lets the wheel catch up
    /// with it: by the ramp's volts a second times `kA/kV^2` more.
    pub rate: f32,
    /// rad from where they stood at the beginning.
    pub travel: f32,
    /// Wheels that get the voltage, bit 0 front left and so on; 0 is all of them.
    pub wheels: u8,
}

impl Bounds {
    /// Whether a wheel gets the voltage.
    #[must_use]
    pub const fn drives(&self, wheel: usize) -> bool {
        self.wheels == 0 || self.wheels >> wheel & 1 == 1
    }
}

/// One wheel's motor.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct WheelModel {
    /// Static friction, V.
    pub static_friction: f32,
    /// V s/rad.
    pub speed: f32,
    /// V s^2/rad.
    pub acceleration: f32,
    /// Rms residual of the ramp's straight line, V.
    pub residual: f32,
}

/// Why there is no result.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stopped {
    /// The master ended it or left.
    Asked,
    /// A fault occurred.
    Fault,
    /// It took too long.
    TimedOut,
    /// A wheel became faster than permitted.
    TooFast,
    /// A wheel went farther than permitted.
    TooFar,
    /// A wheel did not turn: blocked, motor or encoder not connected.
    DoesNotMove,
    /// A wheel turned backwards: motor or encoder reversed.
    TurnsBackwards,
    /// The data of a wheel do not fit a motor.
    BadFit,
}

/// The result; a failure names the wheel if it concerns one.
pub type Outcome = Result<[WheelModel; 4], (Stopped, Option<u8>)>;

/// Output of a tick.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Step {
    /// This voltage on all wheels.
    Voltage(f32),
    /// It is over.
    Finished(Outcome),
    /// It has been over before.
    Ended,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    Ramp,
    CoastToStep,
    Step,
    CoastToEnd,
    Ended,
}

/// Sums over the rows of one stage: voltage u, rate w, acceleration a.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct Sums {
    rows: u16,
    u: f32,
    w: f32,
    a: f32,
    uu: f32,
    uw: f32,
    ua: f32,
    ww: f32,
    wa: f32,
}

/// One window of a wheel.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct Half {
    /// Travel, rad.
    way: f32,
    /// Mean angle from its beginning, rad.
    mean: f32,
}

#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct Wheel {
    travel: f32,
    /// In this stage.
    stage_travel: f32,
    half: Half,
    last: Half,
    /// Windows in a row in which it moved.
    moving: u16,
    ramp: Sums,
    step: Sums,
}

/// One run.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Identification {
    /// Ticks in a window.
    half_ticks: u16,
    bounds: Bounds,
    nominal: f32,
    stage: Stage,
    elapsed: f32,
    stage_time: f32,
    standing: f32,
    voltage: f32,
    /// Until the ramp is over the largest that it may be.
    step_voltage: f32,
    ticks: u16,
    /// Voltage of this window, weighted upwards and downwards; upwards of the last one.
    rising: f32,
    falling: f32,
    last_rising: f32,
    wheels: [Wheel; 4],
}

impl Identification {
    /// Longest run, s.
    pub const TIME_LIMIT: f32 = 20.0;

    /// Begins with the robot at rest: with this nominal supply, V, at most this voltage at a motor
    /// at rest, V, and a tick of this period, us.
    #[must_use]
    pub fn new(bounds: Bounds, nominal: f32, largest_step: f32, tick_us: u32) -> Self {
        Self {
            half_ticks: u16::try_from(WINDOW_US / tick_us.max(1)).unwrap_or(u16::MAX),
            bounds,
            nominal,
            stage: Stage::Ramp,
            elapsed: 0.0,
            stage_time: 0.0,
            standing: 0.0,
            voltage: 0.0,
            step_voltage: largest_step,
            ticks: 0,
            rising: 0.0,
            falling: 0.0,
            last_rising: 0.0,
            wheels: [Wheel::default(); 4],
        }
    }

    /// One tick: what the wheels have turned since the last one, rad, how fast they are, rad/s, and
    /// how long it was, s.
    #[cold]
    #[inline(never)]
    pub fn tick(&mut self, turned: [f32; 4], rates: [f32; 4], dt: f32) -> Step {
        if self.has_ended() {
            return Step::Ended;
        }
        self.elapsed += dt;
        self.stage_time += dt;
        self.add(turned, dt);
        if let Some((why, wheel)) = self.objection(rates) {
            return Step::Finished(Err((why, wheel)));
        }
        let fastest = largest(rates);
        let way = largest(self.wheels.map(|wheel| wheel.stage_travel));
        match self.stage {
            Stage::Ramp => {
                self.voltage += RAMP_SHARE * self.nominal * dt;
                let high = self.voltage >= VOLTAGE_SHARE * self.nominal;
                if high || fastest >= self.bounds.rate || way >= WAY_SHARE * self.bounds.travel {
                    let few = |(number, wheel): (usize, &Wheel)| {
                        self.bounds.drives(number) && wheel.ramp.rows < RAMP_ROWS
                    };
                    if let Some(wheel) = self.wheels.iter().enumerate().position(few) {
                        return failed(Stopped::DoesNotMove, wheel);
                    }
                    self.step_voltage = self.step_voltage.min(self.voltage);
                    self.enter(Stage::CoastToStep, 0.0);
                }
            }
            Stage::Step => {
                if self.stage_time >= STEP_TIME || way >= WAY_SHARE * self.bounds.travel {
                    self.enter(Stage::CoastToEnd, 0.0);
                }
            }
            Stage::CoastToStep | Stage::CoastToEnd | Stage::Ended => {
                self.standing = if fastest < STANDING_RATE {
                    self.standing + dt
                } else {
                    0.0
                };
                if self.standing >= STANDING_TIME || self.stage_time >= COAST_TIME {
                    if self.stage == Stage::CoastToEnd {
                        return Step::Finished(self.solve());
                    }
                    self.enter(Stage::Step, -self.step_voltage);
                }
            }
        }
        Step::Voltage(self.voltage)
    }

    /// Ends the voltage permanently.
    pub const fn end(&mut self) {
        self.stage = Stage::Ended;
    }

    /// Whether it is over.
    pub const fn has_ended(&self) -> bool {
        matches!(self.stage, Stage::Ended)
    }

    fn enter(&mut self, stage: Stage, voltage: f32) {
        self.stage = stage;
        self.voltage = voltage;
        self.stage_time = 0.0;
        self.standing = 0.0;
        self.ticks = 0;
        (self.rising, self.falling) = (0.0, 0.0);
        for wheel in &mut self.wheels {
            wheel.stage_travel = 0.0;
            wheel.half = Half::default();
            wheel.moving = 0;
        }
    }

    /// Processes the last tick, which the present voltage has driven.
    fn add(&mut self, turned: [f32; 4], dt: f32) {
        let place = (f32::from(self.ticks) + 0.5) / f32::from(self.half_ticks);
        self.rising += self.voltage * place;
        self.falling += self.voltage * (1.0 - place);
        self.ticks += 1;
        let full = self.ticks == self.half_ticks;
        let length = f32::from(self.half_ticks) * dt;
        let voltage = (self.last_rising + self.falling) / f32::from(self.half_ticks);
        for (wheel, turned) in self.wheels.iter_mut().zip(turned) {
            wheel.travel += turned;
            wheel.stage_travel += turned;
            // The trapezoid of the angle over this tick.
            wheel.half.mean += (wheel.half.way + 0.5 * turned) / f32::from(self.half_ticks);
            wheel.half.way += turned;
            if !full {
                continue;
            }
            // Of the ramp, the window in which the wheel broke loose and the next are left out.
            let (direction, needed) = match self.stage {
                Stage::Ramp => (1.0, 3),
                Stage::Step => (-1.0, 2),
                Stage::CoastToStep | Stage::CoastToEnd | Stage::Ended => (0.0, u16::MAX),
            };
            let (last, half) = (wheel.last, wheel.half);
            let moved = half.way * direction > MOVED;
            wheel.moving = if moved { wheel.moving + 1 } else { 0 };
            if wheel.moving >= needed {
                let w = (half.mean - (last.mean - last.way)) / length;
                let a = (half.way - last.way) / (length * length);
                let sums = if self.stage == Stage::Ramp {
                    &mut wheel.ramp
                } else {
                    &mut wheel.step
                };
                sums.add(voltage * direction, w * direction, a * direction);
            }
            wheel.last = half;
            wheel.half = Half::default();
        }
        if full {
            self.ticks = 0;
            self.last_rising = self.rising;
            (self.rising, self.falling) = (0.0, 0.0);
        }
    }

    /// The reason to stop, if there is one.
    fn objection(&self, rates: [f32; 4]) -> Option<(Stopped, Option<u8>)> {
        if self.elapsed > Self::TIME_LIMIT {
            return Some((Stopped::TimedOut, None));
        }
        let breaks_away = (BREAKAWAY_SHARE * self.nominal).min(self.step_voltage);
        let must_turn = self.stage == Stage::Ramp && self.voltage > breaks_away;
        for ((number, wheel), rate) in (0_u8..).zip(&self.wheels).zip(rates) {
            let drives = self.bounds.drives(usize::from(number));
            let why = if drives && self.stage == Stage::Ramp && wheel.travel < -TURNED {
                Stopped::TurnsBackwards
            } else if rate.abs() > OVERSPEED * self.bounds.rate {
                Stopped::TooFast
            } else if wheel.travel.abs() > self.bounds.travel {
                Stopped::TooFar
            } else if drives && must_turn && wheel.travel < TURNED {
                Stopped::DoesNotMove
            } else {
                continue;
            };
            return Some((why, Some(number)));
        }
        None
    }

    fn solve(&self) -> Outcome {
        let mut models = [WheelModel::default(); 4];
        for ((number, wheel), model) in (0_u8..).zip(&self.wheels).zip(&mut models) {
            if !self.bounds.drives(usize::from(number)) {
                continue;
            }
            *model = wheel.solve().ok_or((Stopped::BadFit, Some(number)))?;
            if model.residual > MISFIT * self.step_voltage {
                return Err((Stopped::BadFit, Some(number)));
            }
        }
        Ok(models)
    }
}

fn failed(why: Stopped, wheel: usize) -> Step {
    Step::Finished(Err((why, u8::try_from(wheel).ok())))
}

fn largest(values: [f32; 4]) -> f32 {
    values
        .iter()
        .fold(0.0, |most: f32, value| most.max(value.abs()))
}

impl Sums {
    fn add(&mut self, u: f32, w: f32, a: f32) {
        self.rows += 1;
        self.u += u;
        self.w += w;
        self.a += a;
        self.uu += u * u;
        self.uw += u * w;
        self.ua += u * a;
        self.ww += w * w;
        self.wa += w * a;
    }

    /// The line through the voltages after `kA a` has been subtracted.
    fn line(&self, acceleration: f32) -> Line {
        let n = f32::from(self.rows);
        let u = self.u - acceleration * self.a;
        let uw = self.uw - acceleration * self.wa;
        let speed = (n * uw - self.w * u) / (n * self.ww - self.w * self.w);
        Line {
            friction: (u - speed * self.w) / n,
            speed,
        }
    }
}

/// `kS + kV w`.
struct Line {
    friction: f32,
    speed: f32,
}

impl Wheel {
    /// `kS` and `kV` from the ramp need `kA`, `kA` from the step needs them: a few iterations
    /// converge, because the ramp hardly accelerates. `None` when the result does not describe a
    /// motor.
    fn solve(&self) -> Option<WheelModel> {
        const ROUNDS: u8 = 8;
        let (ramp, step) = (&self.ramp, &self.step);
        let mut acceleration = 0.0;
        for _ in 0..ROUNDS {
            let Line { friction, speed } = ramp.line(acceleration);
            // z = u - kS - kV w is what accelerates; the sums of z z and z a.
            let n = f32::from(step.rows);
            let zz = step.uu + speed * speed * step.ww + n * friction * friction
                - 2.0 * (speed * step.uw + friction * step.u - speed * friction * step.w);
            let za = step.ua - speed * step.wa - friction * step.a;
            acceleration = zz / za;
        }
        let Line { friction, speed } = ramp.line(acceleration);
        let plain = ramp.line(0.0);
        let n = f32::from(ramp.rows);
        let left = ramp.uu - plain.friction * ramp.u - plain.speed * ramp.uw;
        let good = |value: f32| value.is_finite() && value > 0.0;
        (good(speed) && good(acceleration) && friction.is_finite()).then_some(WheelModel {
            // A bearing without friction may come out a little below zero.
            static_friction: friction.max(0.0),
            speed,
            acceleration,
            residual: (left / n).max(0.0).root(),
        })
    }
}

impl Stopped {
    /// Its number in object 0x2051:2.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Asked => 3,
            Self::Fault => 4,
            Self::TimedOut => 5,
            Self::TooFast => 6,
            Self::TooFar => 7,
            Self::DoesNotMove => 8,
            Self::TurnsBackwards => 9,
            Self::BadFit => 10,
        }
    }
}

#[cfg(test)]
mod tests;
