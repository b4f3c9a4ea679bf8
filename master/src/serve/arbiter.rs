//! Who drives, and how fast, right now: the rules of the dead-man's press, and of a bridge.
//!
//! One client drives at a time: a page that has shown the token, or a program on a bridge, whose
//! velocities carry a time-out of their own ([`Arbiter::permit`]). The press of a page lasts as
//! long as `drive` messages come, each less than [`STALE_MS`] after the one before, each naming a
//! state of the group that is younger than [`OLD_MS`] (so that messages which lay in a queue do
//! nothing). A press that has ended, for whatever reason, never comes back: the page has to release
//! and press again, which has a higher number. A refused message ends the press, too.
//!
//! Times are the server's, in ms since it started; nothing here asks a clock.

use group::Limits;
use kinematics::Twist;

use super::message::ClientMessage;

/// A press without a message for this long is over, in ms.
pub const STALE_MS: u64 = 250;
/// What a driver has last seen of the group must not be older than this, in ms.
pub const OLD_MS: u64 = 500;
/// Robots that have not been moved for this long are switched off, in ms.
pub const IDLE_MS: u64 = 120_000;
/// Rounding of a limit that was sent to the page and came back, as a share of it.
const ROUNDING: f32 = 1e-5;

/// A connection of a page.
pub type Client = u64;

/// What a page is to be told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Nothing: it is done.
    Done,
    /// Its message was refused, for this reason.
    Refused(String),
}

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
}

/// The rules, and what they have come to.
#[derive(Clone, Debug)]
pub struct Arbiter {
    linear_speed: f32,
    yaw_rate: f32,
    /// Whether clients may drive here.
    open: bool,
    driver: Option<Driver>,
    /// Whether the robots shall be started.
    wanted: bool,
    /// Whether they follow setpoints.
    running: bool,
    last_moved: u64,
}

impl Arbiter {
    /// No client drives yet. Where it is not `open`, none ever will.
    #[must_use]
    pub fn new(limits: &Limits, open: bool) -> Self {
        Self {
            linear_speed: limits.linear_speed,
            yaw_rate: limits.yaw_rate,
            open,
            driver: None,
            wanted: false,
            running: false,
            last_moved: 0,
        }
    }

    /// Takes a message of a client; `trusted` when it has shown the token.
    pub fn handle(
        &mut self,
        now: u64,
        client: Client,
        trusted: bool,
        message: &ClientMessage,
    ) -> Reply {
        let refused = |reason: &str| Reply::Refused(reason.into());
        match message {
            ClientMessage::Stop {} => {
                self.stop();
                return Reply::Done;
            }
            ClientMessage::Release {} => {
                self.release(client);
                return Reply::Done;
            }
            ClientMessage::Leave {} => {
                self.gone(client);
                return Reply::Done;
            }
            // Whether the token is right was found out before.
            ClientMessage::Hello { .. } => return Reply::Done,
            _ if !self.open => return refused("this page only watches"),
            _ if !trusted => return refused("driving needs the token"),
            ClientMessage::Take {} => {
                return match self.driver {
                    Some(driver) if driver.client != client => refused("another client drives"),
                    Some(_) => Reply::Done,
                    None => {
                        self.driver = Some(Driver {
                            client,
                            press: None,
                            highest: 0,
                        });
                        Reply::Done
                    }
                };
            }
            ClientMessage::Start {} | ClientMessage::Drive { .. } => {}
        }
        if !self.drives(client) {
            return refused("take control first");
        }
        let done = match *message {
            ClientMessage::Drive {
                press,
                vx,
                vy,
                omega,
                clock,
            } => self.drive(now, press, Twist::new(vx, vy, omega), clock),
            _ => {
                self.wanted = true;
                self.last_moved = now;
                Ok(())
            }
        };
        if let Err(reason) = done {
            self.release(client);
            return Reply::Refused(reason);
        }
        Reply::Done
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

    /// Whether a client may move the group with this velocity of a stream, each of which says
    /// itself how long it is good for.
    ///
    /// # Errors
    /// With the reason why not.
    pub fn permit(&mut self, now: u64, client: Client, twist: Twist) -> Result<(), String> {
        if !self.drives(client) {
            return Err("send `start` first".into());
        }
        self.check_limits(twist)?;
        self.check_ready()?;
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

    fn release(&mut self, client: Client) {
        if let Some(driver) = &mut self.driver
            && driver.client == client
        {
            driver.press = None;
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

    fn drive(press: u32, vx: f32, clock: u64) -> ClientMessage {
        ClientMessage::Drive {
            press,
            vx,
            vy: 0.0,
            omega: 0.0,
            clock,
        }
    }

    /// Client 1 drives robots that were started at 1000 ms.
    fn started() -> Arbiter {
        let mut arbiter = Arbiter::new(&LIMITS, true);
        assert_eq!(
            arbiter.handle(1000, 1, true, &ClientMessage::Take {}),
            Reply::Done
        );
        assert_eq!(
            arbiter.handle(1000, 1, true, &ClientMessage::Start {}),
            Reply::Done
        );
        arbiter.set_running(true);
        arbiter
    }

    fn is_refused(reply: Reply, word: &str) {
        assert!(
            matches!(&reply, Reply::Refused(reason) if reason.contains(word)),
            "{reply:?}"
        );
    }

    #[test]
    fn a_press_moves_until_its_messages_stop() {
        let mut arbiter = started();
        assert_eq!(arbiter.twist(1000), Twist::ZERO);
        assert_eq!(
            arbiter.handle(1010, 1, true, &drive(1, 0.5, 1000)),
            Reply::Done
        );
        assert_eq!(arbiter.twist(1010 + STALE_MS).vx, 0.5);
        assert_eq!(arbiter.twist(1011 + STALE_MS), Twist::ZERO);
        // What was pressed then is over, also when its messages come again.
        assert_eq!(
            arbiter.handle(1300, 1, true, &drive(1, 0.5, 1290)),
            Reply::Done
        );
        assert_eq!(arbiter.twist(1300), Twist::ZERO);
        assert_eq!(
            arbiter.handle(1310, 1, true, &drive(2, 0.4, 1290)),
            Reply::Done
        );
        assert_eq!(arbiter.twist(1310).vx, 0.4);
    }

    #[test]
    fn release_stops_at_once() {
        let mut arbiter = started();
        arbiter.handle(1010, 1, true, &drive(1, 0.5, 1000));
        arbiter.handle(1020, 1, true, &ClientMessage::Release {});
        assert_eq!(arbiter.twist(1020), Twist::ZERO);
        assert!(arbiter.is_wanted(1020), "the robots stay started");
    }

    #[test]
    fn a_driver_that_goes_stops_the_robots() {
        let mut arbiter = started();
        arbiter.handle(1010, 1, true, &drive(1, 0.5, 1000));
        arbiter.gone(2);
        assert_eq!(arbiter.twist(1010).vx, 0.5);
        arbiter.gone(1);
        assert_eq!(arbiter.twist(1010), Twist::ZERO);
        assert!(!arbiter.is_wanted(1010) && !arbiter.has_driver());
    }

    #[test]
    fn only_the_driver_moves_anything_and_anybody_stops() {
        let mut arbiter = started();
        is_refused(
            arbiter.handle(1010, 2, true, &ClientMessage::Take {}),
            "another",
        );
        is_refused(arbiter.handle(1010, 2, true, &drive(1, 0.5, 1000)), "take");
        is_refused(
            arbiter.handle(1010, 2, true, &ClientMessage::Start {}),
            "take",
        );
        assert_eq!(arbiter.twist(1010), Twist::ZERO);
        arbiter.handle(1010, 1, true, &drive(1, 0.5, 1000));
        // Another's release is not the driver's.
        arbiter.handle(1020, 2, false, &ClientMessage::Release {});
        assert_eq!(arbiter.twist(1020).vx, 0.5);
        arbiter.handle(1030, 2, false, &ClientMessage::Stop {});
        assert_eq!(arbiter.twist(1030), Twist::ZERO);
        assert!(!arbiter.is_wanted(1030));
    }

    #[test]
    fn without_the_token_nobody_drives() {
        let mut arbiter = Arbiter::new(&LIMITS, true);
        for message in [
            ClientMessage::Take {},
            ClientMessage::Start {},
            drive(1, 0.1, 0),
        ] {
            is_refused(arbiter.handle(0, 1, false, &message), "token");
        }
        assert!(!arbiter.has_driver() && !arbiter.is_wanted(0));
        let mut closed = Arbiter::new(&LIMITS, false);
        is_refused(
            closed.handle(0, 1, true, &ClientMessage::Take {}),
            "watches",
        );
    }

    #[test]
    fn a_bad_message_is_refused_and_ends_the_press() {
        let bad = [
            (drive(1, 2.1, 1010), "2 m/s"),
            (drive(1, f32::NAN, 1010), "m/s"),
            (drive(1, f32::INFINITY, 1010), "m/s"),
            (drive(1, 0.5, 1010 - OLD_MS - 1), "older"),
            // From the future: not one of ours.
            (drive(1, 0.5, 1021), "older"),
            (
                ClientMessage::Drive {
                    press: 1,
                    vx: 0.0,
                    vy: 0.0,
                    omega: -1.1,
                    clock: 1010,
                },
                "1 rad/s",
            ),
        ];
        for (message, word) in bad {
            let mut arbiter = started();
            arbiter.handle(1010, 1, true, &drive(1, 0.5, 1000));
            is_refused(arbiter.handle(1010, 1, true, &message), word);
            assert_eq!(arbiter.twist(1010), Twist::ZERO, "{message:?}");
        }
    }

    #[test]
    fn robots_are_started_before_they_are_driven_and_not_left_on() {
        let mut arbiter = Arbiter::new(&LIMITS, true);
        arbiter.handle(0, 1, true, &ClientMessage::Take {});
        is_refused(arbiter.handle(0, 1, true, &drive(1, 0.5, 0)), "start");
        arbiter.handle(0, 1, true, &ClientMessage::Start {});
        is_refused(arbiter.handle(0, 1, true, &drive(1, 0.5, 0)), "not ready");
        assert_eq!(arbiter.twist(0), Twist::ZERO);
        let mut arbiter = started();
        assert!(arbiter.is_wanted(1000 + IDLE_MS));
        assert!(!arbiter.is_wanted(1001 + IDLE_MS));
    }
}
