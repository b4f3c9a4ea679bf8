//! Messages between a bridge and its clients: one JSON object a line, `type` first.

use group::GroupFile;
use kinematics::Twist;
use serde_json::{Value, json};

use crate::controls::fields::{Fields, refuse};
use crate::monitor::telemetry::level;
use crate::monitor::telemetry::{Event, SessionState, Snapshot};
use crate::recording::messages::{of_group, of_robot};

/// Longest line that is taken, in bytes.
pub const LONGEST: usize = 1024;
/// How long a velocity is good for unless its message says, in s.
pub const TIMEOUT: f64 = 0.2;
/// The longest time that a message may name, in s.
pub const LONGEST_TIMEOUT: f64 = 1.0;

/// What a client asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Takes the controls and starts the robots; they stand until a velocity comes.
    Start,
    /// Ramps down and switches the drivers off. Any client may.
    Stop,
    /// Moves with this velocity, for no longer than this without another one.
    Twist {
        /// In the group frame.
        twist: Twist,
        /// In ms.
        timeout_ms: u64,
    },
}

impl Request {
    /// Reads a line.
    ///
    /// # Errors
    /// With the reason when it is no request.
    pub fn parse(line: &[u8]) -> Result<Self, String> {
        if line.len() > LONGEST {
            return Err(refuse(format_args!(
                "the line has more than {LONGEST} bytes"
            )));
        }
        let (kind, mut fields) = Fields::read(line)?;
        let request = match kind.as_str() {
            "start" => Self::Start,
            "stop" => Self::Stop,
            "twist" => Self::twist(&mut fields)?,
            _ => return Err(refuse("`type` is start, stop or twist")),
        };
        fields.end()?;
        Ok(request)
    }

    /// Takes the fields of a `twist`; a velocity that is left out is zero.
    fn twist(fields: &mut Fields) -> Result<Self, String> {
        let mut take = |name, otherwise| Ok::<_, String>(fields.number(name)?.unwrap_or(otherwise));
        let [vx, vy, omega] = [take("vx", 0.0)?, take("vy", 0.0)?, take("omega", 0.0)?];
        let timeout = take("timeout", TIMEOUT)?;
        if !(timeout > 0.0 && timeout <= LONGEST_TIMEOUT) {
            return Err(format!(
                "timeout: {timeout} s is not above 0 and at most {LONGEST_TIMEOUT} s"
            ));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 0 and 1000"
        )]
        let timeout_ms = (timeout * 1e3).ceil() as u64;
        Ok(Self::Twist {
            twist: Twist::new(vx as f32, vy as f32, omega as f32),
            timeout_ms,
        })
    }
}

/// What a client has to know about the group once.
#[must_use]
pub fn welcome(group: &GroupFile, bus: &str) -> Value {
    let robots = group.robots.iter().map(|robot| {
        let mount = robot.mount;
        json!({"node": robot.node, "x": mount.x, "y": mount.y, "heading": mount.heading})
    });
    json!({"type": "welcome", "protocol": 1, "version": env!("CARGO_PKG_VERSION"), "bus": bus,
           "group": group.name, "linear_speed": group.limits.linear_speed,
           "yaw_rate": group.limits.yaw_rate, "period": f64::from(group.sync_period_us) * 1e-6,
           "robots": robots.collect::<Vec<_>>()})
}

/// The group at one SYNC: as in a recording, and every robot beside it.
#[must_use]
pub fn state(now: &Snapshot) -> Value {
    let robots = now.members.iter().map(|member| {
        let mut robot = of_robot(member);
        robot["node"] = json!(member.node);
        robot
    });
    json!({"type": "state", "t": now.t, "running": now.phase == SessionState::Running,
           "group": of_group(now), "robots": robots.collect::<Vec<_>>()})
}

/// Something that happened.
#[must_use]
pub fn event(event: &Event) -> Value {
    json!({"type": "event", "t": event.t, "level": level(&event.what).name(), "node": event.node,
           "text": event.what.to_string()})
}

/// A refusal, for the one who is refused.
#[must_use]
pub fn refused(reason: &str) -> Value {
    json!({"type": "refused", "reason": reason})
}
