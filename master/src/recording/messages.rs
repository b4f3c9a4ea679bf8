//! The messages of a recording: frames and poses in, messages on channels out.
//!
//! A recording and a live view say the same things in the same form, so both get them from here:
//! every frame as it was, and what a listener makes of the frames (the group at every SYNC, each
//! robot, events, transforms), as JSON after the schemas of [`super::schema`]. Nothing is kept but
//! what the listener needs to know.

use canopen::{Frame, Micros};
use group::GroupFile;
use kinematics::{Pose, Twist, WheelRates};
use protocol::Code;
use serde_json::{Map, Value, json};

use super::{
    CAN, EVENTS, FrameRecord, GROUP, PoseRecord, ROBOT, TRANSFORMS, frame_name, schema, to_hex,
};
use crate::monitor::listener::Listener;
use crate::monitor::telemetry::{Event, MemberSample, Snapshot, level};

/// Name and JSON Schema of a channel's messages.
#[derive(Clone, Copy)]
pub struct Schema {
    /// Its name, such as `omnibus.Group`.
    pub name: &'static str,
    /// The JSON Schema.
    pub text: fn() -> Value,
}

/// One message on a channel.
pub struct Message<'a> {
    /// The channel.
    pub topic: &'a str,
    /// What its messages are like.
    pub schema: Schema,
    /// Time in ns, counted from where the header says.
    pub time_ns: u64,
    /// The message.
    pub value: Value,
}

/// Makes messages of what is on a bus.
pub struct Messages {
    epoch_ns: u64,
    group: Option<GroupFile>,
    listener: Listener,
}

impl Messages {
    /// `epoch_ns` is added to every time.
    #[must_use]
    pub fn new(epoch_ns: u64, group: Option<GroupFile>) -> Self {
        let nodes = group.iter().flat_map(|group| &group.robots).map(|r| r.node);
        let listener = Listener::new(nodes.collect::<Vec<_>>());
        Self {
            epoch_ns,
            group,
            listener,
        }
    }

    /// A frame, and everything that follows from it.
    ///
    /// # Errors
    /// What `out` returns.
    pub fn frame<E>(
        &mut self,
        at: Micros,
        frame: &Frame,
        sent: bool,
        out: &mut impl FnMut(&Message) -> Result<(), E>,
    ) -> Result<(), E> {
        let record = FrameRecord {
            id: frame.id(),
            name: frame_name(frame.id()),
            data: to_hex(frame.data()),
            sent,
        };
        let schema = Schema {
            name: "omnibus.CanFrame",
            text: schema::can,
        };
        out(&self.message(CAN, schema, at.0 * 1_000, json!(record)))?;
        if let Some(snapshot) = self.listener.push(at.0 as f64 * 1e-6, frame) {
            self.snapshot(&snapshot, out)?;
        }
        for event in self.listener.take_events() {
            out(&self.event(&event))?;
        }
        Ok(())
    }

    /// Where the group is to be or was seen.
    #[must_use]
    pub fn pose(&self, topic: &'static str, at: Micros, pose: Pose) -> Message<'static> {
        let schema = Schema {
            name: "omnibus.Pose",
            text: schema::pose_only,
        };
        self.message(topic, schema, at.0 * 1_000, json!(PoseRecord::from(pose)))
    }

    fn message<'a>(&self, topic: &'a str, schema: Schema, at_ns: u64, value: Value) -> Message<'a> {
        Message {
            topic,
            schema,
            time_ns: self.epoch_ns + at_ns,
            value,
        }
    }

    fn snapshot<E>(
        &self,
        snapshot: &Snapshot,
        out: &mut impl FnMut(&Message) -> Result<(), E>,
    ) -> Result<(), E> {
        let at_ns = to_ns(snapshot.t);
        let group = Schema {
            name: "omnibus.Group",
            text: schema::group,
        };
        out(&self.message(GROUP, group, at_ns, of_group(snapshot)))?;
        let schema = Schema {
            name: "omnibus.Robot",
            text: schema::robot,
        };
        for member in &snapshot.members {
            let topic = format!("{ROBOT}{}", member.node);
            out(&self.message(&topic, schema, at_ns, of_robot(member)))?;
        }
        if let Some(pose) = snapshot.pose {
            let schema = Schema {
                name: "foxglove.FrameTransforms",
                text: schema::transforms,
            };
            let value = self.transforms(at_ns, pose);
            out(&self.message(TRANSFORMS, schema, at_ns, value))?;
        }
        Ok(())
    }

    /// The group in the world, and the robots in the group where the group file says.
    fn transforms(&self, at_ns: u64, group: Pose) -> Value {
        let one = |parent: &str, child: String, pose: Pose| {
            let (sin, cos) = (f64::from(pose.heading) / 2.0).sin_cos();
            json!({"timestamp": self.stamp(at_ns), "parent_frame_id": parent, "child_frame_id": child,
                   "translation": {"x": pose.x, "y": pose.y, "z": 0.0},
                   "rotation": {"x": 0.0, "y": 0.0, "z": sin, "w": cos}})
        };
        let robots = self.group.iter().flat_map(|file| &file.robots);
        let robots = robots.map(|robot| one("group", format!("robot_{}", robot.node), robot.mount));
        let all: Vec<_> = std::iter::once(one("world", "group".into(), group))
            .chain(robots)
            .collect();
        json!({"transforms": all})
    }

    fn event(&self, event: &Event) -> Message<'static> {
        let level = level(&event.what) as u8;
        let at_ns = to_ns(event.t);
        let name = event
            .node
            .map_or_else(|| "master".into(), |node| format!("node {node}"));
        let value = json!({"timestamp": self.stamp(at_ns), "level": level, "name": name,
                           "message": format!("{name}: {}", event.what), "file": "", "line": 0});
        let schema = Schema {
            name: "foxglove.Log",
            text: schema::log,
        };
        self.message(EVENTS, schema, at_ns, value)
    }

    fn stamp(&self, at_ns: u64) -> Value {
        let ns = self.epoch_ns + at_ns;
        json!({"sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000})
    }
}

/// The group at one SYNC, as on the channel [`GROUP`].
#[must_use]
pub fn of_group(snapshot: &Snapshot) -> Value {
    filled(&[
        ("sequence", Some(json!(snapshot.sequence))),
        ("phase", Some(json!(snapshot.phase.name()))),
        ("command", Some(twist(snapshot.command))),
        ("measured", snapshot.measured.map(twist)),
        ("pose", snapshot.pose.map(pose)),
        ("target", snapshot.target.map(pose)),
        ("scale", snapshot.scale.map(|v| json!(v))),
        ("strain", snapshot.strain.map(|v| json!(v))),
        ("bus_load", snapshot.bus_load.map(|v| json!(v))),
    ])
}

/// A time on the link's clock, s, in whole microseconds, as ns.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positive, and years fit"
)]
fn to_ns(t: f64) -> u64 {
    (t * 1e6).round().max(0.0) as u64 * 1_000
}

/// The fields that are known.
fn filled(fields: &[(&str, Option<Value>)]) -> Value {
    let known = fields
        .iter()
        .filter_map(|(name, value)| Some(((*name).to_owned(), value.clone()?)));
    Value::Object(known.collect::<Map<_, _>>())
}

fn pose(pose: Pose) -> Value {
    json!(PoseRecord::from(pose))
}

fn twist(twist: Twist) -> Value {
    json!({"vx": twist.vx, "vy": twist.vy, "omega": twist.omega})
}

fn wheels(rates: WheelRates) -> Value {
    json!({"front_left": rates.front_left, "front_right": rates.front_right,
           "rear_left": rates.rear_left, "rear_right": rates.rear_right})
}

/// A robot at one SYNC, as on its channel.
#[must_use]
pub fn of_robot(member: &MemberSample) -> Value {
    let code_name = match member.code {
        Code::None => "none",
        Code::Limit(limit) => limit.name(),
        Code::Fault(fault) => fault.name(),
    };
    filled(&[
        ("nmt", member.nmt.map(|state| json!(format!("{state:?}")))),
        (
            "state",
            member.state.map(|state| json!(format!("{state:?}"))),
        ),
        ("code", Some(json!(member.code.code()))),
        ("code_name", Some(json!(code_name))),
        ("permitted_scale", member.permitted_scale.map(|v| json!(v))),
        ("slip_residual", member.slip_residual.map(|v| json!(v))),
        ("measured", member.measured.map(twist)),
        ("pose", member.pose.map(pose)),
        ("wheel_rates", member.wheel_rates.map(wheels)),
        ("yaw_rate", member.yaw_rate.map(|v| json!(v))),
    ])
}
