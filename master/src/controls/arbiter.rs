//! Who drives, and how fast, right now: the rules of the dead-man's press, and of streams.
//!
//! One client drives at a time, whichever way it comes: a page that has shown the token, a key of
//! the keyboard, or a program that sends velocities. A page holds a *press*: it lasts as long as
//! [`Arbiter::press`] is called, each time less than [`STALE_MS`] after the time before, each
//! naming a state of the group that is younger than [`OLD_MS`] (so that messages which waited in a
//! queue do nothing). A press that has ended, for whatever reason, stays ended: the page has to
//! release and press again, with a higher number. A refused press ends the press, too. A press may
//! ask for a curve instead of a velocity ([`Arbiter::press_curve`]): it follows the same rules, and
//! the whole curve is checked against the group's limits before its first setpoint. Each velocity
//! of a *stream* carries its own duration ([`Arbiter::stream`]).
//!
//! A driver keeps the controls until it leaves. Where several sources share one connection, such as
//! publishers of a topic, another one takes over when the driver has been silent for as long as its
//! last velocity was good for ([`Arbiter::succeed`]); the caller gets the name of the displaced one
//! and tells it.
//!
//! The caller passes the time, in ms; nothing here reads a clock.

use std::ops::RangeInclusive;
use std::sync::Arc;

use clap::ValueEnum as _;
use group::Limits;
use kinematics::Twist;

use crate::error::MasterError;
use crate::path::course::Course;
use crate::path::curve::{Curve, Plan};
use crate::pilot::Order;

/// A press without a message for this long is over, in ms.
pub const STALE_MS: u64 = 250;
/// What a driver has last seen of the group must not be older than this, in ms.
pub const OLD_MS: u64 = 500;
/// Robots that have not been moved for this long are switched off, in ms.
pub const IDLE_MS: u64 = 120_000;
/// Rounding of a limit that was sent to the page and came back, as a share of it.
const ROUNDING: f32 = 1e-5;

/// Someone who may drive: a connection, a keyboard, a publisher.
pub type Client = u64;

/// Sizes of a curve that a press may ask for, as multiples of its own.
const SCALES: RangeInclusive<f64> = 0.05..=10.0;

/// What a press asks for.
#[derive(Clone, Debug)]
enum Motion {
    Twist(Twist),
    Curve(Arc<Plan>),
}

#[derive(Clone, Debug)]
struct Press {
    number: u32,
    at: u64,
    motion: Motion,
}

#[derive(Clone, Debug)]
struct Driver {
    client: Client,
    press: Option<Press>,
    /// The highest number a press has had.
    highest: u32,
    /// Until when the last velocity of its stream is good.
    good_until: u64,
}

impl Driver {
    const fn new(client: Client) -> Self {
        Self {
            client,
            press: None,
            highest: 0,
            good_until: 0,
        }
    }
}

/// The rules, and what they have come to.
#[derive(Clone, Debug)]
pub struct Arbiter {
    limits: Limits,
    driver: Option<Driver>,
    /// Whether the robots shall be started.
    wanted: bool,
    /// Whether they follow setpoints.
    running: bool,
    last_moved: u64,
}

impl Arbiter {
    /// No client drives yet.
    #[must_use]
    pub fn new(limits: &Limits) -> Self {
        Self {
            limits: *limits,
            driver: None,
            wanted: false,
            running: false,
            last_moved: 0,
        }
    }

    /// Makes a client the driver, unless another one is.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn take(&mut self, client: Client) -> Result<(), String> {
        match &self.driver {
            Some(driver) if driver.client != client => Err("another client drives".into()),
            Some(_) => Ok(()),
            None => {
                self.driver = Some(Driver::new(client));
                Ok(())
            }
        }
    }

    /// Makes a client the driver, also where another one was but moves nothing at this time.
    /// Returns that one, which is to be told.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn succeed(&mut self, now: u64, client: Client) -> Result<Option<Client>, String> {
        self.expire(now);
        let displaced = match &self.driver {
            Some(driver) if driver.client == client => return Ok(None),
            Some(driver) if driver.press.is_some() || now < driver.good_until => {
                return Err("another client drives".into());
            }
            driver => driver.as_ref().map(|driver| driver.client),
        };
        self.driver = Some(Driver::new(client));
        Ok(displaced)
    }

    /// The driver wants the robots to be started.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn start(&mut self, now: u64, client: Client) -> Result<(), String> {
        if !self.drives(client) {
            return Err("take control first".into());
        }
        self.wanted = true;
        self.last_moved = now;
        Ok(())
    }

    /// Takes a message of the driver's press. A refused one ends the press.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn press(
        &mut self,
        now: u64,
        client: Client,
        number: u32,
        twist: Twist,
        clock: u64,
    ) -> Result<(), String> {
        if !self.drives(client) {
            return Err("take control first".into());
        }
        self.check_limits(twist)
            .and_then(|()| self.ask(now, number, clock, |_| Ok(Motion::Twist(twist))))
            .inspect_err(|_| self.release(client))
    }

    /// Takes a message of the driver's press that asks for a curve by its name, in a size that is a
    /// multiple of its own. The first of a press begins it; the others confirm that it is to go on.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn press_curve(
        &mut self,
        now: u64,
        client: Client,
        number: u32,
        (name, scale): (&str, f64),
        clock: u64,
    ) -> Result<(), String> {
        if !self.drives(client) {
            return Err("take control first".into());
        }
        let limits = self.limits;
        let begin_or_go_on = |before: Option<&Motion>| match before {
            Some(Motion::Curve(plan)) => Ok(Motion::Curve(Arc::clone(plan))),
            _ => Ok(Motion::Curve(Arc::new(plan(name, scale, &limits)?))),
        };
        self.ask(now, number, clock, begin_or_go_on)
            .inspect_err(|_| self.release(client))
    }

    /// Begins a press or goes on with it; `motion` is given what this press has asked for before.
    fn ask(
        &mut self,
        now: u64,
        number: u32,
        clock: u64,
        motion: impl FnOnce(Option<&Motion>) -> Result<Motion, String>,
    ) -> Result<(), String> {
        self.expire(now);
        if clock > now || now - clock > OLD_MS {
            return Err(format!(
                "it refers to a state older than {OLD_MS} ms: the page or the network is too slow"
            ));
        }
        self.check_ready()?;
        let Some(driver) = &mut self.driver else {
            return Err("take control first".into());
        };
        let before = driver.press.as_ref().filter(|press| press.number == number);
        // A press that is over stays over; what still comes of it is not even worth a word.
        if before.is_none() && number <= driver.highest {
            return Ok(());
        }
        let motion = motion(before.map(|press| &press.motion))?;
        driver.highest = number;
        driver.press = Some(Press {
            number,
            at: now,
            motion,
        });
        self.last_moved = now;
        Ok(())
    }

    /// Whether a client may move the group with this velocity of a stream, which is good for so
    /// many ms.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn stream(
        &mut self,
        now: u64,
        client: Client,
        twist: Twist,
        good_ms: u64,
    ) -> Result<(), String> {
        if !self.drives(client) {
            return Err("send `start` first".into());
        }
        self.check_limits(twist)?;
        self.check_ready()?;
        if let Some(driver) = &mut self.driver {
            driver.good_until = now + good_ms;
        }
        self.last_moved = now;
        Ok(())
    }

    /// Whether a client may have the group follow a route, which keeps its own limits. While it is
    /// followed this is called again and again; a route that is not confirmed any more holds the
    /// controls no longer.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn route(&mut self, now: u64, client: Client) -> Result<(), String> {
        self.stream(now, client, Twist::ZERO, STALE_MS)
    }

    fn check_limits(&self, twist: Twist) -> Result<(), String> {
        let speed = twist.vx.hypot(twist.vy);
        let (fastest, turning) = (self.limits.linear_speed, self.limits.yaw_rate);
        if speed.is_nan() || speed > fastest * (1.0 + ROUNDING) {
            return Err(format!(
                "vx and vy ask for {speed} m/s, but limits.linear_speed of the group is {fastest} \
                 m/s"
            ));
        }
        if twist.omega.is_nan() || twist.omega.abs() > turning * (1.0 + ROUNDING) {
            let omega = twist.omega;
            return Err(format!(
                "omega is {omega} rad/s, but limits.yaw_rate of the group is {turning} rad/s"
            ));
        }
        Ok(())
    }

    fn check_ready(&self) -> Result<(), String> {
        if !self.wanted {
            return Err("start the robots first".into());
        }
        if !self.running {
            return Err("the robots are not ready yet".into());
        }
        Ok(())
    }

    /// Ends a press whose messages have stopped.
    fn expire(&mut self, now: u64) {
        if let Some(driver) = &mut self.driver
            && driver
                .press
                .as_ref()
                .is_some_and(|press| now.saturating_sub(press.at) > STALE_MS)
        {
            driver.press = None;
        }
    }

    /// The client's press is over, or its stream.
    pub fn release(&mut self, client: Client) {
        if let Some(driver) = &mut self.driver
            && driver.client == client
        {
            driver.press = None;
            driver.good_until = 0;
        }
    }

    /// A client has gone. When it was the driver, the robots are stopped.
    pub fn gone(&mut self, client: Client) {
        if self.drives(client) {
            self.driver = None;
            self.wanted = false;
        }
    }

    /// The robots are to be stopped, or have been.
    pub fn stop(&mut self) {
        self.wanted = false;
        if let Some(driver) = &mut self.driver {
            driver.press = None;
            driver.good_until = 0;
        }
    }

    /// Says whether the robots follow setpoints. Without that no message of a press is taken: it
    /// would be acted upon when it is unknown whether the key is still held.
    pub fn set_running(&mut self, running: bool) {
        self.running = running;
    }

    /// Whether this client drives.
    #[must_use]
    pub fn drives(&self, client: Client) -> bool {
        let driver = self.driver.as_ref();
        driver.is_some_and(|driver| driver.client == client)
    }

    /// Whether a client drives.
    #[must_use]
    pub fn has_driver(&self) -> bool {
        self.driver.is_some()
    }

    /// Whether the robots shall be in OPERATIONAL at this time.
    pub fn is_wanted(&mut self, now: u64) -> bool {
        if now.saturating_sub(self.last_moved) > IDLE_MS {
            self.wanted = false;
        }
        self.wanted
    }

    /// What the press asks for at this time, good for [`STALE_MS`]; standstill without one.
    pub fn order(&mut self, now: u64) -> Order {
        self.expire(now);
        let press = self
            .driver
            .as_ref()
            .and_then(|driver| driver.press.as_ref());
        let good_us = STALE_MS * 1_000;
        match press.map(|press| &press.motion) {
            Some(Motion::Twist(twist)) => Order::Twist(*twist, good_us),
            Some(Motion::Curve(plan)) => Order::Curve(Arc::clone(plan), good_us),
            None => Order::Twist(Twist::ZERO, good_us),
        }
    }
}

/// A curve in a size, within the limits of the group.
fn plan(name: &str, scale: f64, limits: &Limits) -> Result<Plan, String> {
    let Ok(curve) = Curve::from_str(name, false) else {
        return Err(format!("there is no curve `{name}`"));
    };
    if !SCALES.contains(&scale) {
        let (smallest, largest) = (SCALES.start(), SCALES.end());
        return Err(format!(
            "the scale {scale} is not between {smallest} and {largest}"
        ));
    }
    let course = Course {
        scale,
        ..Course::of(curve)
    };
    let plan = course.plan().map_err(|error| error.to_string())?;
    match plan.check(limits) {
        Ok(()) => Ok(plan),
        Err(MasterError::TooFast {
            asked,
            unit,
            limit_name,
            limit,
            ..
        }) => Err(format!(
            "{name} at scale {scale} needs {asked:.2} {unit}, and {limit_name} is {limit} {unit}; \
             choose a smaller scale or another curve"
        )),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(test)]
mod tests;
