//! Who drives, and how fast, right now: the rules of the dead-man's press, and of streams.
//!
//! One client drives at a time, whichever way it comes: a page that has shown the token, a key of
//! the keyboard, or a program that sends velocities. A page holds a *press*: it lasts as long as
//! [`Arbiter::press`] is called, each time less than [`STALE_MS`] after the time before, each
//! naming a state of the group that is younger than [`OLD_MS`] (so that messages which lay in a
//! queue do nothing). A press that has ended, for whatever reason, never comes back: the page has
//! to release and press again, which has a higher number. A refused press ends the press, too. The
//! velocities of a *stream* each say themselves how long they are good for ([`Arbiter::stream`]).
//!
//! A driver keeps the controls until it leaves. Where several sources share one connection, such as
//! publishers of a topic, another one takes over when the driver has been silent for as long as its
//! last velocity was good for ([`Arbiter::succeed`]); the caller gets the name of the displaced one
//! and tells it.
//!
//! Times are the caller's, in ms; nothing here asks a clock.

use group::Limits;
use kinematics::Twist;

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

#[derive(Clone, Copy, Debug, PartialEq)]
struct Press {
    number: u32,
    at: u64,
    twist: Twist,
}

#[derive(Clone, Copy, Debug, PartialEq)]
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
    linear_speed: f32,
    yaw_rate: f32,
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
            linear_speed: limits.linear_speed,
            yaw_rate: limits.yaw_rate,
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
        match self.driver {
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
        let displaced = match self.driver {
            Some(driver) if driver.client == client => return Ok(None),
            Some(driver) if driver.press.is_some() || now < driver.good_until => {
                return Err("another client drives".into());
            }
            driver => driver.map(|driver| driver.client),
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
        self.drive(now, number, twist, clock)
            .inspect_err(|_| self.release(client))
    }

    fn drive(&mut self, now: u64, number: u32, twist: Twist, clock: u64) -> Result<(), String> {
        self.expire(now);
        self.check_limits(twist)?;
        if clock > now || now - clock > OLD_MS {
            return Err(format!("it refers to a state older than {OLD_MS} ms"));
        }
        self.check_ready()?;
        let Some(driver) = &mut self.driver else {
            return Err("take control first".into());
        };
        match driver.press {
            Some(press) if press.number == number => {}
            // A press that is over stays over; what still comes of it is not even worth a word.
            _ if number <= driver.highest => return Ok(()),
            _ => driver.highest = number,
        }
        driver.press = Some(Press {
            number,
            at: now,
            twist,
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

    fn check_limits(&self, twist: Twist) -> Result<(), String> {
        let speed = twist.vx.hypot(twist.vy);
        let (fastest, turning) = (self.linear_speed, self.yaw_rate);
        if speed.is_nan() || speed > fastest * (1.0 + ROUNDING) {
            return Err(format!(
                "{speed} m/s is more than the group's {fastest} m/s"
            ));
        }
        if twist.omega.is_nan() || twist.omega.abs() > turning * (1.0 + ROUNDING) {
            let omega = twist.omega;
            return Err(format!(
                "{omega} rad/s is more than the group's {turning} rad/s"
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
        self.driver.is_some_and(|driver| driver.client == client)
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

    /// The twist that is asked for at this time; zero without a press.
    pub fn twist(&mut self, now: u64) -> Twist {
        self.expire(now);
        let press = self.driver.and_then(|driver| driver.press);
        press.map_or(Twist::ZERO, |press| press.twist)
    }
}

/// `twist`, slowed down in its direction as far as the limits of the group ask, and by which
/// factor. `None` for what is no number.
#[must_use]
pub fn slowed(twist: Twist, limits: &Limits) -> Option<(Twist, f32)> {
    let speed = twist.vx.hypot(twist.vy) / limits.linear_speed;
    let turn = twist.omega.abs() / limits.yaw_rate;
    if !(speed.is_finite() && turn.is_finite()) {
        return None;
    }
    let excess = speed.max(turn);
    // A hair below, so that rounding does not end above.
    let share = if excess > 1.0 { 0.9999 / excess } else { 1.0 };
    let slowed = Twist::new(twist.vx * share, twist.vy * share, twist.omega * share);
    Some((slowed, share))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        linear_speed: 2.0,
        yaw_rate: 1.0,
        linear_acceleration: 1.0,
        yaw_acceleration: 1.0,
        linear_jerk: 1.0,
        yaw_jerk: 1.0,
        command_timeout_us: 100_000,
        sync_timeout_us: 0,
    };

    fn ahead(vx: f32) -> Twist {
        Twist::new(vx, 0.0, 0.0)
    }

    /// Client 1 drives robots that were started at 1000 ms.
    fn started() -> Arbiter {
        let mut arbiter = Arbiter::new(&LIMITS);
        arbiter.take(1).unwrap();
        arbiter.start(1000, 1).unwrap();
        arbiter.set_running(true);
        arbiter
    }

    fn is_refused(reply: Result<(), String>, word: &str) {
        assert!(
            matches!(&reply, Err(reason) if reason.contains(word)),
            "{reply:?}"
        );
    }

    #[test]
    fn a_press_moves_until_its_messages_stop() {
        let mut arbiter = started();
        assert_eq!(arbiter.twist(1000), Twist::ZERO);
        arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
        assert_eq!(arbiter.twist(1010 + STALE_MS).vx, 0.5);
        assert_eq!(arbiter.twist(1011 + STALE_MS), Twist::ZERO);
        // What was pressed then is over, also when its messages come again.
        arbiter.press(1300, 1, 1, ahead(0.5), 1290).unwrap();
        assert_eq!(arbiter.twist(1300), Twist::ZERO);
        arbiter.press(1310, 1, 2, ahead(0.4), 1290).unwrap();
        assert_eq!(arbiter.twist(1310).vx, 0.4);
    }

    #[test]
    fn release_stops_at_once() {
        let mut arbiter = started();
        arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
        arbiter.release(1);
        assert_eq!(arbiter.twist(1020), Twist::ZERO);
        assert!(arbiter.is_wanted(1020), "the robots stay started");
    }

    #[test]
    fn a_driver_that_goes_stops_the_robots() {
        let mut arbiter = started();
        arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
        arbiter.gone(2);
        assert_eq!(arbiter.twist(1010).vx, 0.5);
        arbiter.gone(1);
        assert_eq!(arbiter.twist(1010), Twist::ZERO);
        assert!(!arbiter.is_wanted(1010) && !arbiter.has_driver());
    }

    #[test]
    fn only_the_driver_moves_anything_and_anybody_stops() {
        let mut arbiter = started();
        is_refused(arbiter.take(2), "another");
        is_refused(arbiter.press(1010, 2, 1, ahead(0.5), 1000), "take");
        is_refused(arbiter.stream(1010, 2, ahead(0.5), 200), "start");
        is_refused(arbiter.start(1010, 2), "take");
        assert_eq!(arbiter.twist(1010), Twist::ZERO);
        arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
        // Another's release is not the driver's.
        arbiter.release(2);
        assert_eq!(arbiter.twist(1020).vx, 0.5);
        arbiter.stop();
        assert_eq!(arbiter.twist(1030), Twist::ZERO);
        assert!(!arbiter.is_wanted(1030));
    }

    #[test]
    fn a_driver_that_moves_nothing_can_be_succeeded_and_is_named() {
        let mut arbiter = started();
        arbiter.stream(1010, 1, ahead(0.5), 200).unwrap();
        assert!(arbiter.succeed(1209, 2).is_err(), "the velocity is good");
        assert_eq!(arbiter.succeed(1209, 1), Ok(None));
        assert_eq!(arbiter.succeed(1210, 2), Ok(Some(1)));
        assert!(arbiter.drives(2) && !arbiter.drives(1));
        assert!(arbiter.is_wanted(1210), "the robots stay started");
        // A press holds the controls in the same way.
        arbiter.press(1300, 2, 1, ahead(0.1), 1300).unwrap();
        assert!(arbiter.succeed(1300 + STALE_MS, 3).is_err());
        assert_eq!(arbiter.succeed(1301 + STALE_MS, 3), Ok(Some(2)));
        // After a stop nothing is good any more.
        arbiter.stream(2000, 3, ahead(0.1), 1000).unwrap();
        arbiter.stop();
        assert_eq!(arbiter.succeed(2001, 4), Ok(Some(3)));
    }

    #[test]
    fn a_bad_press_is_refused_and_ends_it() {
        let bad = [
            (ahead(2.1), 1010, "2 m/s"),
            (ahead(f32::NAN), 1010, "m/s"),
            (ahead(f32::INFINITY), 1010, "m/s"),
            (ahead(0.5), 1010 - OLD_MS - 1, "older"),
            // From the future: not one of ours.
            (ahead(0.5), 1021, "older"),
            (Twist::new(0.0, 0.0, -1.1), 1010, "1 rad/s"),
        ];
        for (twist, clock, word) in bad {
            let mut arbiter = started();
            arbiter.press(1010, 1, 1, ahead(0.5), 1000).unwrap();
            is_refused(arbiter.press(1010, 1, 1, twist, clock), word);
            assert_eq!(arbiter.twist(1010), Twist::ZERO, "{twist:?}");
        }
    }

    #[test]
    fn robots_are_started_before_they_are_driven_and_not_left_on() {
        let mut arbiter = Arbiter::new(&LIMITS);
        arbiter.take(1).unwrap();
        is_refused(arbiter.press(0, 1, 1, ahead(0.5), 0), "start");
        arbiter.start(0, 1).unwrap();
        is_refused(arbiter.press(0, 1, 1, ahead(0.5), 0), "not ready");
        assert_eq!(arbiter.twist(0), Twist::ZERO);
        let mut arbiter = started();
        assert!(arbiter.is_wanted(1000 + IDLE_MS));
        assert!(!arbiter.is_wanted(1001 + IDLE_MS));
    }
}
