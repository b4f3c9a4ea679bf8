//! What the page and the server say to each other: one JSON object a message, `type` first.

use clap::ValueEnum as _;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::monitor::telemetry::{Event, MemberSample, Snapshot, level};
use crate::path::curve::Curve;
use group::GroupFile;
use kinematics::{Pose, Twist};
use protocol::Code;

/// Longest message that is taken, in bytes.
pub const LONGEST: usize = 1024;

/// What a page says. A message with an unknown or a missing field is refused.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ClientMessage {
    /// Shows the token.
    Hello {
        /// The token.
        token: String,
    },
    /// Wants to drive.
    Take {},
    /// Does not want to drive any more.
    Leave {},
    /// Starts the robots; they stand until a press.
    Start {},
    /// Ramps down and switches the drivers off. Any client may.
    Stop {},
    /// The dead-man's press, repeated while it lasts.
    Drive {
        /// Number of the press: every new one is higher.
        press: u32,
        /// Forward, m/s.
        vx: f32,
        /// Left, m/s.
        vy: f32,
        /// Counter-clockwise, rad/s.
        omega: f32,
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
    Release {},
}

impl ClientMessage {
    /// Reads a message.
    ///
    /// # Errors
    /// With the reason when it is not one.
    pub fn parse(text: &str) -> Result<Self, String> {
        // Not serde's own `tag`: it loses numbers once any crate asks for serde_json's arbitrary
        // precision.
        let mut fields: Map<String, Value> =
            serde_json::from_str(text).map_err(|error| format!("not understood: {error}"))?;
        let kind = match fields.remove("type") {
            Some(Value::String(kind)) => kind,
            _ => return Err("not understood: the field `type` is missing".to_owned()),
        };
        serde_json::from_value(json!({kind: fields}))
            .map_err(|error| format!("not understood: {error}"))
    }
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
            Ok(ClientMessage::Stop {})
        );
        for bad in [
            "",
            "stop",
            "{}",
            r#"{"type":"jump"}"#,
            r#"{"type":"stop","now":true}"#,
            r#"{"type":"drive","press":1,"vx":0.1,"vy":0,"omega":0}"#,
            r#"{"type":"drive","press":1,"vx":"0.1","vy":0,"omega":0,"clock":5}"#,
            r#"{"type":"drive","press":1,"vx":NaN,"vy":0,"omega":0,"clock":5}"#,
            r#"{"type":"drive","press":1,"vx":null,"vy":0,"omega":0,"clock":5}"#,
            r#"{"type":"drive","press":-1,"vx":0,"vy":0,"omega":0,"clock":5}"#,
            r#"{"type":"hello"}"#,
        ] {
            assert!(ClientMessage::parse(bad).is_err(), "{bad}");
        }
    }
}
