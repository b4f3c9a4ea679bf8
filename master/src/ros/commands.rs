//! Requests of ROS 2 to the group: velocities and calls of services, each judged before it reaches
//! the controls.
//!
//! A velocity that cannot be followed moves nothing: it is not finite, asks for an axis that a
//! group on the floor does not have, is in another frame, old, or beyond ten times the limits,
//! where a unit is wrong. One beyond the limits is slowed down in its direction. Each publisher is
//! a client of the controls, so one drives at a time; another succeeds it once the first has been
//! silent for the timeout. A publisher whose velocity came while the robots were not ready has to
//! pause or to send zero before it moves them: nothing moves because something else became ready.
//!
//! What was refused is counted and told in words by [`Commands::report`], for `diagnostics`.

use std::collections::BTreeMap;
use std::sync::Arc;

use group::Limits;
use kinematics::Twist;
use ros::message::{self, Header, Time};
use ros::node::{Call, Incoming, Publishing, Reply};

use crate::abort::Abort;
use crate::controls::Controls;
use crate::controls::arbiter::Client;
use crate::session::slowed;

/// Beyond so many times the limits a velocity is not meant.
const MEANT: f32 = 10.0;
/// A component that a group on the floor does not have may be so large, m/s or rad/s: rounding.
const NOTHING: f64 = 1e-6;
/// Publishers that are kept in mind.
const MOST: usize = 64;

/// Why nothing can be done here.
const FOREIGN: &str = "another master commands the robots";

/// What commands are judged by.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Limits of the group.
    pub limits: Limits,
    /// The frame of velocities.
    pub base: String,
    /// How long a velocity is good for, and how old its stamp may be, in ms.
    pub timeout_ms: u64,
}

/// Someone who publishes velocities.
struct Source {
    client: Client,
    /// When its last velocity came, in ms of the controls.
    at: u64,
    /// Whether that was a motion.
    moves: bool,
    /// Whether it has to pause or to send zero first.
    held: bool,
}

/// Judges what comes in and passes it to the controls.
pub struct Commands {
    controls: Arc<Controls>,
    abort: Abort,
    rules: Rules,
    /// The client of `start`.
    own: Client,
    sources: BTreeMap<Publishing, Source>,
    names: BTreeMap<Publishing, String>,
    others: Vec<(String, String)>,
    latched: bool,
    /// Whether the session moves or may move the robots.
    active: bool,
    /// Whether another master commands the robots.
    foreign: bool,
    tally: Tally,
}

/// What came of velocities since the last report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    /// Taken.
    pub taken: u64,
    /// Refused.
    pub refused: u64,
    /// Slowed down.
    pub slowed: u64,
    /// Why the last one was refused.
    pub why: Option<String>,
    /// What has happened to the node itself.
    pub note: Option<String>,
    /// The smallest factor by which one was slowed down.
    pub factor: Option<f32>,
    /// Who was displaced by whom.
    pub displaced: Option<(String, String)>,
}

impl Commands {
    /// Commands of a group that `controls` drive; `abort` stops it at once.
    #[must_use]
    pub fn new(controls: Arc<Controls>, abort: Abort, rules: Rules) -> Self {
        Self {
            own: controls.client(),
            controls,
            abort,
            rules,
            sources: BTreeMap::new(),
            names: BTreeMap::new(),
            others: Vec::new(),
            latched: false,
            active: false,
            foreign: false,
            tally: Tally::default(),
        }
    }

    /// Takes in what the node received at `now_ns` of the clock on the wall, since 1970.
    pub fn handle(&mut self, incoming: Incoming, now_ns: u64) -> Reply {
        match incoming {
            Incoming::Command {
                from,
                header,
                twist,
            } => {
                self.command(from, header.as_ref(), &twist, now_ns);
                Reply::default()
            }
            Incoming::Unreadable(why) => {
                self.refuse(format!("bytes that are not a message: {why}"));
                Reply::default()
            }
            Incoming::Note(what) => {
                self.tally.note = Some(what);
                Reply::default()
            }
            Incoming::Refused(message) => {
                self.refuse(message.clone());
                Reply {
                    success: false,
                    message,
                }
            }
            Incoming::OtherType(others) => {
                self.others = others;
                Reply::default()
            }
            Incoming::Publishers(names) => {
                self.names = names.into_iter().collect();
                Reply::default()
            }
            Incoming::Call(call) => match self.call(call) {
                Ok(message) => Reply {
                    success: true,
                    message: message.into(),
                },
                Err(message) => Reply {
                    success: false,
                    message,
                },
            },
        }
    }

    fn refuse(&mut self, why: String) {
        self.tally.refused += 1;
        self.tally.why = Some(why);
    }

    fn name(&self, of: Publishing) -> String {
        let short = || format!("a publisher {:02x}{:02x}", of[10], of[11]);
        self.names.get(&of).cloned().unwrap_or_else(short)
    }

    fn command(
        &mut self,
        from: Publishing,
        header: Option<&Header>,
        twist: &message::Twist,
        now_ns: u64,
    ) {
        let now = self.controls.now();
        let timeout = self.rules.timeout_ms;
        self.make_room(now);
        let controls = &self.controls;
        let source = self.sources.entry(from).or_insert_with(|| Source {
            client: controls.client(),
            at: 0,
            moves: false,
            held: false,
        });
        if now.saturating_sub(source.at) >= timeout {
            source.held = false;
        }
        source.at = now;
        let client = source.client;
        let judged = judge(&self.rules, header, twist, now_ns);
        source.moves = judged
            .as_ref()
            .is_ok_and(|(twist, _)| *twist != Twist::ZERO);
        if !source.moves && judged.is_ok() {
            source.held = false;
        }
        let held = source.held;
        match judged.and_then(|judged| self.pass(from, client, held, judged)) {
            Ok(()) => self.tally.taken += 1,
            Err(why) => {
                // Whoever drives and cannot be followed stands.
                self.controls.release(client);
                let why = format!("{}: {why}", self.name(from));
                self.refuse(why);
            }
        }
    }

    fn pass(
        &mut self,
        from: Publishing,
        client: Client,
        held: bool,
        (twist, factor): (Twist, f32),
    ) -> Result<(), String> {
        if self.latched {
            return Err("the emergency stop is latched; call e_stop_reset".into());
        }
        if held {
            return Err("it commanded motion before the robots were ready; send zero first".into());
        }
        match self.controls.succeed(client) {
            Ok(None) => {}
            Ok(Some(before)) => {
                let before = self.sources.iter().find(|(_, one)| one.client == before);
                if let Some(before) = before.map(|(gid, _)| *gid) {
                    self.tally.displaced = Some((self.name(before), self.name(from)));
                }
            }
            Err(_) => {
                let drives = |one: &&Publishing| self.controls.drives(self.sources[*one].client);
                let driver = self.sources.keys().find(drives);
                let driver = driver.map_or_else(|| "another client".into(), |one| self.name(*one));
                return Err(format!(
                    "{driver} drives already; only one publisher may drive at a \
                                    time"
                ));
            }
        }
        let timeout = self.rules.timeout_ms;
        let passed = self.controls.stream(client, twist, timeout);
        if passed.is_err()
            && twist != Twist::ZERO
            && let Some(source) = self.sources.get_mut(&from)
        {
            source.held = true;
        }
        passed.map_err(|why| format!("{why} (service start)"))?;
        if factor < 1.0 {
            self.tally.slowed += 1;
            let before = self.tally.factor.unwrap_or(1.0);
            self.tally.factor = Some(factor.min(before));
        }
        Ok(())
    }

    /// Publishers that come and go do not fill the memory.
    fn make_room(&mut self, now: u64) {
        if self.sources.len() >= MOST {
            let timeout = self.rules.timeout_ms;
            self.sources
                .retain(|_, source| now.saturating_sub(source.at) < timeout);
        }
    }

    /// Who commands motion at this time.
    fn mover(&self) -> Option<String> {
        let now = self.controls.now();
        let live =
            |source: &Source| source.moves && now.saturating_sub(source.at) < self.rules.timeout_ms;
        let mover = self.sources.iter().find(|(_, source)| live(source));
        mover.map(|(gid, _)| self.name(*gid))
    }

    fn call(&mut self, call: Call) -> Result<&'static str, String> {
        match call {
            Call::Start => {
                if self.latched {
                    return Err("the emergency stop is latched; call e_stop_reset".into());
                }
                self.start()?;
                Ok("the robots are being started; diagnostics says when they are ready")
            }
            Call::Stop => {
                self.controls.stop();
                Ok("the group ramps down, then its drivers are switched off")
            }
            Call::Trigger => {
                self.latched = true;
                self.controls.stop();
                if self.active {
                    // Twice is at once: the robots leave OPERATIONAL, which cuts their drivers.
                    self.abort.ask();
                    self.abort.ask();
                } else if self.foreign {
                    return Err(format!("{FOREIGN}; stop them there"));
                }
                Ok("the motor drivers are off; e_stop_reset starts the robots again")
            }
            Call::Reset => {
                if !self.latched {
                    return Err("the emergency stop is not latched".into());
                }
                if self.active {
                    return Err("the robots are still stopping; call again".into());
                }
                self.abort.forget();
                self.start()?;
                self.latched = false;
                Ok("the robots are being started; diagnostics says when they are ready")
            }
        }
    }

    fn start(&self) -> Result<(), String> {
        if let Some(mover) = self.mover() {
            return Err(format!(
                "{mover} commands motion; it has to send zero or to pause first"
            ));
        }
        if self.foreign {
            return Err(format!("{FOREIGN}; end that program or its session first"));
        }
        self.controls.succeed(self.own)?;
        self.controls.start(self.own)
    }

    /// Whether the session may move the robots, and whether another master was heard.
    pub fn set_session(&mut self, active: bool, foreign: bool) {
        self.active = active;
        self.foreign = foreign;
    }

    /// Whether `e_stop_trigger` was called and `e_stop_reset` was not.
    #[must_use]
    pub const fn is_latched(&self) -> bool {
        self.latched
    }

    /// Who drives.
    #[must_use]
    pub fn driver(&self) -> Option<String> {
        let drives = |(_, source): &(&Publishing, &Source)| self.controls.drives(source.client);
        self.sources
            .iter()
            .find(drives)
            .map(|(gid, _)| self.name(*gid))
    }

    /// Publishers of commands of another type, by node and type.
    #[must_use]
    pub fn others(&self) -> &[(String, String)] {
        &self.others
    }

    /// What came of velocities since the last report.
    pub fn report(&mut self) -> Tally {
        std::mem::take(&mut self.tally)
    }
}

/// The twist that a message asks for, and by which factor it was slowed down.
///
/// # Errors
/// With the reason why it cannot be followed.
pub fn judge(
    rules: &Rules,
    header: Option<&Header>,
    twist: &message::Twist,
    now_ns: u64,
) -> Result<(Twist, f32), String> {
    let (linear, angular) = (&twist.linear, &twist.angular);
    for (value, name) in [
        (linear.x, "linear.x"),
        (linear.y, "linear.y"),
        (linear.z, "linear.z"),
        (angular.x, "angular.x"),
        (angular.y, "angular.y"),
        (angular.z, "angular.z"),
    ] {
        if !value.is_finite() {
            return Err(format!("{name} is {value}, not a finite number"));
        }
    }
    for (value, name) in [
        (linear.z, "linear.z"),
        (angular.x, "angular.x"),
        (angular.y, "angular.y"),
    ] {
        if value.abs() > NOTHING {
            return Err(format!(
                "{name} is {value}; a group on the floor has no such axis"
            ));
        }
    }
    if let Some(header) = header {
        if !header.frame_id.is_empty() && header.frame_id != rules.base {
            return Err(format!(
                "frame_id is {:?}; velocities are in {:?}",
                header.frame_id, rules.base
            ));
        }
        check_stamp(&header.stamp, now_ns, rules.timeout_ms)?;
    }
    #[expect(clippy::cast_possible_truncation, reason = "the robots' own precision")]
    let asked = Twist::new(linear.x as f32, linear.y as f32, angular.z as f32);
    let far = |speed: f32, limit: f32| speed > MEANT * limit;
    let (linear_limit, yaw_limit) = (rules.limits.linear_speed, rules.limits.yaw_rate);
    let speed = asked.vx.hypot(asked.vy);
    if far(speed, linear_limit) || far(asked.omega.abs(), yaw_limit) {
        return Err(format!(
            "{speed} m/s and {} rad/s are more than {MEANT} times the limits, {linear_limit} m/s \
             and {yaw_limit} rad/s; are the units m/s and rad/s?",
            asked.omega
        ));
    }
    slowed(asked, &rules.limits).ok_or_else(|| "a component is not a finite number".into())
}

fn check_stamp(stamp: &Time, now_ns: u64, timeout_ms: u64) -> Result<(), String> {
    if stamp.is_unset() {
        return Ok(());
    }
    let now_ns = i64::try_from(now_ns).unwrap_or(i64::MAX);
    let age_ms = (now_ns - stamp.ns()) / 1_000_000;
    let timeout_ms = i64::try_from(timeout_ms).unwrap_or(i64::MAX);
    if age_ms > timeout_ms {
        return Err(format!(
            "its stamp is {age_ms} ms old; {timeout_ms} ms are allowed: compare the computers' clocks"
        ));
    }
    if age_ms < -timeout_ms {
        return Err(format!(
            "its stamp is {} ms ahead; {timeout_ms} ms are allowed: compare the computers' clocks",
            -age_ms
        ));
    }
    Ok(())
}
