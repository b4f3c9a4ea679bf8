//! Messages between the page and the server: one JSON object a message, `type` first.

use clap::ValueEnum as _;
use serde_json::{Value, json};

use crate::controls::fields::{Fields, missing, refuse};
use crate::monitor::telemetry::{Event, MemberSample, Snapshot, level};
use crate::path::curve::Curve;
use group::GroupFile;
use kinematics::{Pose, Twist};
use protocol::Code;

/// Longest message that is taken, in bytes.
pub const LONGEST: usize = 1024;

/// What a page says. A message with an unknown or a missing field is refused.
#[derive(Clone, Debug, PartialEq)]
pub enum ClientMessage {
    /// Shows the token.
    Hello {
        /// The token.
        token: String,
    },
    /// Wants to drive.
    Take,
    /// Does not want to drive any more.
    Leave,
    /// Starts the robots; they stand until a press.
    Start,
    /// Ramps down and switches the drivers off. Any client may.
    Stop,
    /// The dead-man's press, repeated while it lasts.
    Drive {
        /// Number of the press: every new one is higher.
        press: u32,
        /// In the group frame.
        twist: Twist,
        /// `clock` of the newest state that the page has seen.
        clock: u64,
    },
    /// A curve, which lasts no longer than this is repeated, like a press.
    Curve {
        /// Number of the press: every new one is higher.
        press: u32,
        /// Name of the curve, as `omnibus follow` takes it.
        curve: String,
        /// Its size, as a multiple of its own; it takes the same time.
        scale: f64,
        /// `clock` of the newest state that the page has seen.
        clock: u64,
    },
    /// The press is over.
    Release,
}

impl ClientMessage {
    /// Reads a message.
    ///
    /// # Errors
    /// With the reason when it is not one.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (kind, mut fields) = Fields::read(text.as_bytes())?;
        let message = match kind.as_str() {
            "hello" => Self::Hello {
                token: fields.text("token")?,
            },
            "take" => Self::Take,
            "leave" => Self::Leave,
            "start" => Self::Start,
            "stop" => Self::Stop,
            "drive" => Self::Drive {
                press: press(&mut fields)?,
                twist: Twist::new(
                    number(&mut fields, "vx")? as f32,
                    number(&mut fields, "vy")? as f32,
                    number(&mut fields, "omega")? as f32,
                ),
                clock: fields.count("clock", u64::MAX)?,
            },
            "curve" => Self::Curve {
                press: press(&mut fields)?,
                curve: fields.text("curve")?,
                scale: number(&mut fields, "scale")?,
                clock: fields.count("clock", u64::MAX)?,
            },
            "release" => Self::Release,
            _ => {
                return Err(refuse(
                    "`type` is hello, take, leave, start, stop, drive, curve or release",
                ));
            }
        };
        fields.end()?;
        Ok(message)
    }
}

fn number(fields: &mut Fields, name: &str) -> Result<f64, String> {
    fields.number(name)?.ok_or_else(|| missing(name))
}

#[expect(clippy::cast_possible_truncation, reason = "not more than u32::MAX")]
fn press(fields: &mut Fields) -> Result<u32, String> {
    Ok(fields.count("press", u32::MAX.into())? as u32)
}

/// What the page has to know about the group once.
#[must_use]
pub fn welcome(group: &GroupFile, bus: &str, can_drive: bool) -> Value {
    let robots = group.robots.iter().map(|robot| {
        json!({"node": robot.node, "mount": pose(robot.mount),
               "half_track": robot.geometry.half_track(),
               "half_wheelbase": robot.geometry.half_wheelbase(),
               "wheel_radius": robot.geometry.wheel_radius(),
               "max_wheel_rate": robot.max_wheel_rate})
    });
    let curves: Vec<_> = Curve::value_variants()
        .iter()
        .map(|curve| curve.name())
        .collect();
    json!({"type": "welcome", "group": group.name, "bus": bus, "can_drive": can_drive,
           "linear_speed": group.limits.linear_speed, "yaw_rate": group.limits.yaw_rate,
           "curves": curves, "robots": robots.collect::<Vec<_>>()})
}

/// A refusal, for the one who is refused.
#[must_use]
pub fn refused(reason: &str) -> Value {
    json!({"type": "refused", "reason": reason})
}

/// The group as it is. `clock` is the server's, in ms.
#[must_use]
pub fn state(snapshot: &Snapshot, clock: u64, running: bool) -> Value {
    let members: Vec<_> = snapshot.members.iter().map(member).collect();
    json!({"type": "state", "clock": clock, "t": snapshot.t, "running": running,
           "phase": snapshot.phase.name(), "foreign": snapshot.foreign_master, "command": twist(snapshot.command),
           "measured": snapshot.measured.map(twist), "pose": snapshot.pose.map(pose),
           "target": snapshot.target.map(pose), "scale": snapshot.scale,
           "curve": snapshot.curve.map(|curve| [curve.t, curve.duration]),
           "strain": snapshot.strain, "bus_load": snapshot.bus_load, "robots": members})
}

fn pose(pose: Pose) -> [f32; 3] {
    [pose.x, pose.y, pose.heading]
}

fn twist(twist: Twist) -> [f32; 3] {
    [twist.vx, twist.vy, twist.omega]
}

fn member(member: &MemberSample) -> Value {
    let (kind, name) = match member.code {
        Code::None => ("none", ""),
        Code::Limit(limit) => ("limit", limit.name()),
        Code::Fault(fault) => ("fault", fault.name()),
    };
    let rates: Option<[f32; 4]> = member.wheel_rates.map(Into::into);
    let state = member.state.map(|state| format!("{state:?}"));
    json!({"node": member.node, "nmt": member.nmt.map(|nmt| format!("{nmt:?}")), "state": state,
           "code": name, "kind": kind, "past": member.past.map(|past| past.to_string()),
           "scale": member.permitted_scale, "slip": member.slip_residual, "wheels": rates,
           "silent": member.silent_syncs})
}

/// A line of the page's log.
#[must_use]
pub fn event(event: &Event) -> Value {
    let who = event
        .node
        .map_or_else(|| "master".into(), |node| format!("node {node}"));
    json!({"type": "event", "t": event.t, "level": level(&event.what).name(), "who": who,
           "text": event.what.to_string()})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_complete_messages_are_messages() {
        let drive = r#"{"type":"drive","press":1,"vx":0.1,"vy":0,"omega":0,"clock":5}"#;
        assert!(matches!(
            ClientMessage::parse(drive),
            Ok(ClientMessage::Drive { press: 1, .. })
        ));
        assert_eq!(
            ClientMessage::parse(r#"{"type":"stop"}"#),
            Ok(ClientMessage::Stop)
        );
        for (bad, why) in [
            ("", "EOF while parsing a value at line 1 column 0"),
            ("stop", "expected value at line 1 column 1"),
            (
                "[1]",
                r#"a message is a JSON object, as in {"type":"stop"}"#,
            ),
            ("{}", "the field `type` is missing"),
            (r#"{"type":7}"#, "type: 7 is not a string"),
            (
                r#"{"type":"jump"}"#,
                "`type` is hello, take, leave, start, stop, drive, curve or release",
            ),
            (r#"{"type":"stop","now":true}"#, "unknown field `now`"),
            (r#"{"type":"hello"}"#, "the field `token` is missing"),
            (r#"{"type":"hello","token":1}"#, "token: 1 is not a string"),
        ] {
            let why = format!("not understood: {why}");
            assert_eq!(ClientMessage::parse(bad), Err(why), "{bad}");
        }
    }

    #[test]
    fn a_velocity_that_is_none_is_refused_by_its_field() {
        for (field, value, why) in [
            ("vx", r#""0.1""#, r#"vx: "0.1" is not a number"#),
            ("vy", "null", "vy: null is not a number"),
            ("omega", "1e300", "omega: the number is too large"),
            (
                "press",
                "-1",
                "press: -1 is not a whole number from 0 to 4294967295",
            ),
            (
                "press",
                "4294967296",
                "press: 4294967296 is not a whole number from 0 to 4294967295",
            ),
            (
                "clock",
                "0.5",
                "clock: 0.5 is not a whole number from 0 to 18446744073709551615",
            ),
        ] {
            let fields = ["press", "vx", "vy", "omega", "clock"].map(|name| {
                let value = if name == field { value } else { "0" };
                format!(r#""{name}":{value}"#)
            });
            let bad = format!(r#"{{"type":"drive",{}}}"#, fields.join(","));
            let why = format!("not understood: {why}");
            assert_eq!(ClientMessage::parse(&bad), Err(why), "{bad}");
            let without = bad.replace(&format!(r#""{field}":{value}"#), r#""type":"drive""#);
            let why = format!("not understood: the field `{field}` is missing");
            assert_eq!(ClientMessage::parse(&without), Err(why), "{without}");
        }
        let nan = r#"{"type":"drive","press":1,"vx":NaN,"vy":0,"omega":0,"clock":5}"#;
        assert!(ClientMessage::parse(nan).is_err());
    }
}
