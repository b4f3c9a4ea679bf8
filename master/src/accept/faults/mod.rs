//! Every cause of docs/safety.md, brought about in a group that drives with its wheels free.
//!
//! # Theory of operation
//!
//! [`cases`] says of each row of the page how it is brought about, or why it is not. The master is
//! at fault itself in some ([`Means::Heartbeat`] and its neighbours), a [`Hand`] does the others,
//! a few are wrong parameters, of which some do not let the group begin ([`at_rest`]). The group
//! drives straight ahead, the cause appears, the robots' histories tell when each noticed, and
//! their wheel rates what the wheels did.
//!
//! A cause that the master brings about has a time on its clock. One by hand is only known to lie
//! after the last frame that contradicts it: the last status of a robot whose plug is pulled, the
//! last report in which the wheel of a pulled encoder turned. Then the bound is wider by a SYNC
//! period. Where no frame shows the cause, its time is not tried.
//!
//! # Limits
//!
//! The times of docs/safety.md hold for the default time-outs and SYNC at 100 Hz; with others they
//! are not tried.

use acceptance::Bound;
mod at_rest;
pub mod cases;
mod judge;

use acceptance::causes::{self, Promise};
use acceptance::promise::SAFETY;
use canopen::Micros;
use kinematics::Twist;
use protocol::{Address, Code, Kind, MemberState, Value, address};

use cases::{CASES, Means};

use super::hand::{Hand, Prepared, Task};
use super::{AcceptError, Step, Trial, not_tried};
use crate::bus::link::Link;
use crate::error::MasterError;
use crate::session::STOP_PATIENCE_US;

/// Period of SYNC and age of setpoints that the page's times are promised for, µs.
const PERIOD_US: u32 = 10_000;
const SETPOINT_TIMEOUT_US: u32 = 100_000;
/// Time to reach the speed and settle, µs.
const SETTLE_US: u64 = 800_000;
/// How long a reaction is waited for, µs.
const REACTION_US: u64 = 1_500_000;
/// How long wheels may coast after a reaction, and how long they are looked at afterwards, µs.
const COAST_US: u64 = 5_000_000;
const AFTER_US: u64 = 500_000;
/// A wheel slower than this stands, rad/s: half of the slowest that a robot calls standstill.
const STANDS: f32 = 0.05;
/// Speed at which a reversed encoder is tried, m/s.
const SLOW: f32 = 0.1;
/// The largest supply that is allowed for a moment, over the nominal one: a full battery has more.
const ALMOST: f32 = 1.03;
/// A wheel with a reversed encoder is timed from this rate on, rad/s, as docs/safety.md has it.
const TURNS: f32 = 0.1;
/// A robot's number must have been unheard for a second before it can be started, µs.
const UNHEARD_US: u64 = 1_200_000;

/// What a trial has shown.
struct Seen {
    /// When the group began to drive, on the link's clock.
    began: u64,
    /// When the cause appeared, µs: exactly, or after the last frame that contradicts it.
    cause: Option<Cause>,
    /// Largest wheel rate before, rad/s, and after over that, of wheels that can be believed.
    asked: f32,
    faster: Option<f32>,
    /// Whether a member was ever seen to ramp, or to be in fault without.
    ramped: Vec<bool>,
    faulted: Vec<bool>,
    /// Wheels that turned after all of them had stood; `None` if they never stood.
    again: Option<usize>,
}

#[derive(Clone, Copy)]
struct Cause {
    at_us: f64,
    /// The cause may lie this much later, µs.
    open_us: f64,
}

/// The name of a cause in checks.
pub(super) fn name(number: u8) -> String {
    format!("fault.{number:02}")
}

impl<L: Link, H: Hand<L>> Trial<'_, L, H> {
    /// Tries all causes.
    pub(super) fn faults(&mut self) -> Result<(), AcceptError> {
        for (number, means) in CASES {
            let name = name(*number);
            let promise = causes::of(*number)?;
            if let Some(reason) = self.left_out(&name, *means) {
                self.skip_cause(&promise, reason)?;
                continue;
            }
            // Tried, or left out, with its other one.
            if matches!(means, Means::With(_)) {
                continue;
            }
            (self.show)(Step::Begins(&format!("{number}: {}", promise.cause)));
            match self.fault(&promise, *means) {
                Ok(None) => {}
                Ok(Some(reason)) => self.skip_cause(&promise, reason)?,
                Err(AcceptError::Master(error)) if !ends_all(&error) => {
                    self.group.ramp_down(STOP_PATIENCE_US)?;
                    let what = format!("{name}.reaction");
                    self.failed(what, source(&promise), error.to_string());
                }
                Err(error) => return Err(error),
            }
            self.show_found();
        }
        Ok(())
    }

    /// Why a cause is not tried at all.
    fn left_out(&self, name: &str, means: Means) -> Option<String> {
        let members = self.group.members().len();
        let limits = &self.group.config().limits;
        let defaults = self.group.config().sync_period_us == PERIOD_US
            && limits.command_timeout_us == SETPOINT_TIMEOUT_US
            && limits.sync_timeout_us == 0;
        match means {
            Means::Not(reason) => Some(reason.to_owned()),
            _ if self.is_skipped(name) => Some("left out by --skip".to_owned()),
            Means::With(_) if members > 1 => None,
            _ if !defaults => Some(
                "docs/safety.md promises times for SYNC at 100 Hz and the default time-outs".into(),
            ),
            Means::Bus | Means::Plan | Means::With(_) if members < 2 => {
                Some("it needs a second robot".to_owned())
            }
            _ => None,
        }
    }

    /// Leaves out a cause, and those that are tried as part of it.
    fn skip_cause(&mut self, promise: &Promise, reason: String) -> Result<(), AcceptError> {
        let bound = promise.millis.map_or(Bound::Open, Bound::AtMost);
        let check = not_tried(
            name(promise.number),
            bound,
            "ms",
            source(promise),
            reason.clone(),
        );
        self.checks.push(check);
        for (number, means) in CASES {
            let with_it = *means == Means::With(promise.number);
            if with_it && self.left_out(&name(*number), *means).is_none() {
                self.skip_cause(&causes::of(*number)?, reason.clone())?;
            }
        }
        Ok(())
    }

    /// Tries one cause; a reason when it was left out.
    fn fault(&mut self, promise: &Promise, means: Means) -> Result<Option<String>, AcceptError> {
        let node = self.watched;
        let (speed, task) = match means {
            Means::Plan | Means::Inconsistent => {
                return self.at_rest(promise, means).map(|()| None);
            }
            Means::Reversed => (SLOW, None),
            Means::Encoder => (self.speed, Some(Task::UnplugEncoder { node, wheel: 0 })),
            Means::Bus => (self.speed, Some(Task::UnplugBus { node })),
            Means::Driver => (self.speed, Some(Task::DriverFault { node })),
            Means::Stop => (self.speed, Some(Task::PressStop { node })),
            Means::Protective => (self.speed, Some(Task::OpenProtectiveStop { node })),
            Means::Supply => {
                let minimum_v = self.real(address::SUPPLY_MINIMUM)?;
                (self.speed, Some(Task::LowerSupply { node, minimum_v }))
            }
            Means::TooHigh => {
                let maximum_v = self.real(address::SUPPLY_NOMINAL)? * ALMOST;
                (self.speed, Some(Task::RaiseSupply { node, maximum_v }))
            }
            _ => (self.speed, None),
        };
        if let Some(reason) = self.lacks(means)? {
            return Ok(Some(reason));
        }
        if let Some(task) = task
            && let Prepared::Skip(reason) = self.hand.prepare(self.group, task)?
        {
            return Ok(Some(reason));
        }
        let restore = match (means, task) {
            (Means::Reversed, _) => {
                let bits = self.byte(address::ENCODER_REVERSED)?;
                let [right, wrong] = [bits, bits ^ 1].map(Value::U8);
                Some((address::ENCODER_REVERSED, right, wrong))
            }
            (_, Some(Task::RaiseSupply { maximum_v, .. })) => {
                let right = Value::F32(self.real(address::SUPPLY_MAXIMUM)?);
                Some((address::SUPPLY_MAXIMUM, right, Value::F32(maximum_v)))
            }
            _ => None,
        };
        if let Some((at, _, wrong)) = restore {
            self.group.wire().write(node, at, wrong)?;
        }
        let seen = self.drive(speed, means, task);
        // However it ended, the group stands before anything else is done.
        self.group.wire().claim(true);
        self.group.ramp_down(STOP_PATIENCE_US)?;
        if let Some((at, right, _)) = restore {
            self.group.wire().write(node, at, right)?;
        }
        let seen = match (seen, task) {
            (Ok(seen), _) => seen,
            (Err(error), Some(task)) if !ends_all(&error) => {
                self.hand.undo(self.group, task)?;
                return Err(error.into());
            }
            (Err(error), _) => return Err(error.into()),
        };
        if let Some(task) = task {
            self.hand.undo(self.group, task)?;
        }
        if means == Means::Double {
            self.wait(UNHEARD_US)?;
        }
        self.judge(promise, means, &seen)?;
        Ok(None)
    }

    /// What a cause needs that the robot does not have.
    fn lacks(&mut self, means: Means) -> Result<Option<String>, AcceptError> {
        Ok(match means {
            Means::Supply | Means::TooHigh if self.real(address::SUPPLY)? <= 0.0 => {
                Some("the robot does not measure its supply (0x2120:1)".to_owned())
            }
            Means::Supply | Means::TooHigh if self.real(address::SUPPLY_MINIMUM)? <= 0.0 => {
                Some("the robot has no minimum of its supply (0x2025:2)".to_owned())
            }
            Means::Protective if self.byte(address::PROTECTIVE_STOP)? == 0 => {
                Some("the robot has no protective stop (0x2042:2)".to_owned())
            }
            _ => None,
        })
    }

    fn real(&mut self, at: Address) -> Result<f32, MasterError> {
        let value = self.group.wire().read(self.watched, at, Kind::F32)?;
        Ok(f32::from_bits(value.to_bits()))
    }

    fn byte(&mut self, at: Address) -> Result<u8, MasterError> {
        let value = self.group.wire().read(self.watched, at, Kind::U8)?;
        Ok(u8::try_from(value.to_bits()).unwrap_or(0))
    }

    /// Lets the group drive, brings the cause about, and watches until all wheels stand.
    fn drive(&mut self, speed: f32, means: Means, task: Option<Task>) -> Result<Seen, MasterError> {
        let twist = Twist::new(speed, 0.0, 0.0);
        let began = self.group.wire().now().0;
        self.group.start()?;
        let members = self.group.members().len();
        let mut seen = Seen {
            began,
            cause: None,
            asked: 0.0,
            faster: None,
            ramped: vec![false; members],
            faulted: vec![false; members],
            again: None,
        };
        let begun = self.group.recorder().rows().len();
        let settled = self.group.wire().now().0 + SETTLE_US;
        while self.group.wire().now().0 < settled && !seen.all_faulted() {
            self.period(twist, None, &mut seen)?;
        }
        seen.asked = self.fastest(None);
        let mut until = self.group.wire().now().0 + REACTION_US;
        if let Some(task) = task {
            until += self.hand.patience_us();
            let at = self.hand.act(self.group, task);
            seen.cause = at.map(Cause::at);
        }
        let rows = self.group.recorder().rows().len();
        if means == Means::Killed {
            self.without_sync(&mut seen)?;
        } else {
            let broken = task.is_none().then_some(means);
            while self.group.wire().now().0 < until && !seen.all_faulted() {
                self.period(twist, broken, &mut seen)?;
            }
        }
        if seen.cause.is_none() {
            let from = if means == Means::Reversed {
                begun
            } else {
                rows
            };
            seen.cause = self.estimate(means, from, seen.asked);
        }
        self.watch_rest(twist, means, &mut seen)?;
        let faster = self.fastest_since(rows, means == Means::Encoder);
        seen.faster = (seen.asked > 0.0).then(|| faster / seen.asked);
        Ok(seen)
    }

    /// One SYNC period with the master at fault, or not.
    fn period(
        &mut self,
        twist: Twist,
        broken: Option<Means>,
        seen: &mut Seen,
    ) -> Result<(), MasterError> {
        self.group.abort().check()?;
        let first = seen.cause.is_none();
        let now = self.group.wire().now().0;
        let (at, done) = match broken {
            Some(Means::Heartbeat) => {
                if first {
                    // The page's worst case: right after a heartbeat.
                    self.group.wire().claim(true);
                    let soon = self.group.wire().now();
                    self.group.listen(soon)?;
                    self.group.wire().claim(false);
                }
                (now, self.group.cycle(twist))
            }
            // The last setpoint has been latched at the last SYNC.
            Some(Means::Setpoints) => (now, self.group.cycle_without_setpoint()),
            Some(Means::Second) => (now, self.group.cycle_beside_another(twist)),
            Some(Means::NotANumber) => {
                let nothing = Twist::new(f32::NAN, 0.0, 0.0);
                (now, self.group.cycle(nothing))
            }
            Some(Means::Double) => {
                if first {
                    self.group.double(self.watched)?;
                }
                (now, self.group.cycle(twist))
            }
            _ => (now, self.group.cycle(twist)),
        };
        if broken.is_some_and(|means| means != Means::Reversed) && first {
            seen.cause = Some(Cause::at(Micros(at)));
        }
        let faulted = match done {
            Err(error) if ends_all(&error) => return Err(error),
            done => done.is_err(),
        };
        seen.look(self.group.members(), faulted);
        Ok(())
    }

    /// The master sends nothing; without SYNC no robot reports, but by its emergency message.
    fn without_sync(&mut self, seen: &mut Seen) -> Result<(), MasterError> {
        let last = self.group.pause_sync()?;
        self.group.wire().claim(false);
        seen.cause = Some(Cause::at(last));
        self.wait(AFTER_US)?;
        self.group.wire().claim(true);
        self.group.resume_sync();
        Ok(())
    }

    /// Lets time pass without SYNC.
    fn wait(&mut self, us: u64) -> Result<(), MasterError> {
        let until = self.group.wire().now().0 + us;
        while self.group.wire().now().0 < until {
            self.group.abort().check()?;
            let step = Micros(until.min(self.group.wire().now().0 + 50_000));
            self.group.listen(step)?;
        }
        Ok(())
    }

    /// Goes on sending setpoints until all wheels stand, and then looks whether any turns again.
    fn watch_rest(
        &mut self,
        twist: Twist,
        means: Means,
        seen: &mut Seen,
    ) -> Result<(), MasterError> {
        // What the master did wrong is over: setpoints come as ever, and must not move anything.
        let broken = (means == Means::Heartbeat).then_some(means);
        let deadline = self.group.wire().now().0 + COAST_US;
        let mut stood_at = None;
        while self.group.wire().now().0 < stood_at.map_or(deadline, |at: u64| at + AFTER_US) {
            self.period(twist, broken, seen)?;
            let stands = self.fastest(None) < STANDS;
            match stood_at {
                None if stands && seen.any_faulted() => {
                    stood_at = Some(self.group.wire().now().0);
                    seen.again = Some(0);
                }
                Some(_) if !stands => seen.again = Some(seen.again.unwrap_or(0) + 1),
                _ => {}
            }
        }
        Ok(())
    }

    /// Between which frames a cause by hand lies.
    fn estimate(&self, means: Means, from: usize, asked: f32) -> Option<Cause> {
        let place = self.place();
        let period = self.group.period_us() as f64;
        let began = self.group.rows_began().0 as f64;
        let at_us = match means {
            Means::Bus => self.group.members()[place].status_at?.0 as f64,
            Means::Encoder | Means::Reversed => {
                let rows = &self.group.recorder().rows()[from..];
                let rate = |row: &crate::monitor::rows::Row| {
                    let rates = row.members.get(place).and_then(|m| m.wheel_rates);
                    rates.map_or(0.0, |rates| rates.front_left.abs())
                };
                let shows = |row: &&crate::monitor::rows::Row| match means {
                    Means::Encoder => rate(row) <= asked / 2.0,
                    // It turns against its drive from the first motion on.
                    _ => rate(row) > TURNS,
                };
                let first = rows.iter().position(|row| shows(&row))?;
                let last = rows.get(first.checked_sub(1)?)?;
                began + last.t * 1e6
            }
            _ => return None,
        };
        Some(Cause {
            at_us,
            open_us: period,
        })
    }

    /// Largest wheel rate in the last complete row, rad/s.
    fn fastest(&self, without: Option<(usize, usize)>) -> f32 {
        let rows = self.group.recorder().rows();
        let row = rows.len().checked_sub(2).and_then(|place| rows.get(place));
        row.map_or(0.0, |row| fastest_of(row, without))
    }

    /// The same in all rows since one; a pulled encoder's wheel cannot be believed.
    fn fastest_since(&self, row: usize, encoder: bool) -> f32 {
        let without = encoder.then(|| (self.place(), 0));
        let rows = &self.group.recorder().rows()[row..];
        let rates = rows.iter().map(|row| fastest_of(row, without));
        rates.fold(0.0, f32::max)
    }

    /// Place of the watched robot in the group file.
    fn place(&self) -> usize {
        let members = self.group.members().iter();
        let place = members
            .map(|member| member.node)
            .position(|node| node == self.watched);
        place.unwrap_or(0)
    }
}

impl Cause {
    fn at(at: Micros) -> Self {
        Self {
            at_us: at.0 as f64,
            open_us: 0.0,
        }
    }
}

impl Seen {
    fn all_faulted(&self) -> bool {
        self.faulted.iter().all(|faulted| *faulted)
    }

    fn any_faulted(&self) -> bool {
        self.faulted.iter().any(|faulted| *faulted)
    }

    /// Takes in what the members said last.
    fn look(&mut self, members: &[crate::session::Member], failed: bool) {
        for (place, member) in members.iter().enumerate() {
            let Some(status) = member.status else {
                continue;
            };
            let fault = matches!(status.code, Code::Fault(_));
            self.ramped[place] |= fault && status.state == MemberState::Ramping;
            // A robot that has left the bus does not say so.
            self.faulted[place] |= fault || failed && member.silent_syncs > 20;
        }
    }
}

/// Whether an error is not the robots' but the end of the whole.
fn ends_all(error: &MasterError) -> bool {
    matches!(
        error.cause(),
        MasterError::Link(_) | MasterError::Aborted | MasterError::NoAnswer
    )
}

/// Where a cause is promised.
fn source(promise: &Promise) -> String {
    format!(
        "{}: cause {}, {}",
        SAFETY.path, promise.number, promise.cause
    )
}

fn fastest_of(row: &crate::monitor::rows::Row, without: Option<(usize, usize)>) -> f32 {
    let mut fastest: f32 = 0.0;
    for (member, of) in row.members.iter().enumerate() {
        let rates: [f32; 4] = of.wheel_rates.map_or([0.0; 4], Into::into);
        for (wheel, rate) in rates.into_iter().enumerate() {
            if without != Some((member, wheel)) {
                fastest = fastest.max(rate.abs());
            }
        }
    }
    fastest
}
