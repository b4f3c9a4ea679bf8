//! Writing a recording: a thread that turns frames into channels and closes a chunk every second.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use canopen::{Frame, Micros};
use group::GroupFile;
use kinematics::{Pose, Twist, WheelRates};
use mcap::records::MessageHeader;
use mcap::{McapResult, WriteOptions};
use protocol::Code;
use serde_json::{Map, Value, json};

use super::{
    CAN, EVENTS, FrameRecord, FrameSink, GROUP, METADATA, PoseRecord, ROBOT, RecordingError,
    TRANSFORMS, frame_name, schema, to_hex,
};
use crate::monitor::listener::Listener;
use crate::monitor::telemetry::{Event, EventKind, MemberSample, Snapshot};

/// Chunks are closed after this much of the bus's time, in ns.
const CHUNK_NS: u64 = 1_000_000_000;
/// Levels of `foxglove.Log`.
const INFO: u8 = 2;
const WARNING: u8 = 3;
const ERROR: u8 = 4;

/// What is known about a recording before it begins.
#[derive(Clone, Debug, Default)]
pub struct Header {
    /// The bus as the user named it.
    pub bus: String,
    /// What was done: `record`, `drive`, or `follow circle`.
    pub activity: String,
    /// The group file's text, when there is one.
    pub group: Option<String>,
    /// Time of the link's zero, in ns since 1970; 0 on a simulated bus, whose recordings are the
    /// same every time.
    pub epoch_ns: u64,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// Frames on the bus.
    pub frames: u64,
    /// Messages on all channels, the frames among them.
    pub messages: u64,
    /// From the first to the last frame, in s.
    pub seconds: f64,
}

enum Item {
    Frame(Micros, Frame, bool),
    Pose(&'static str, Micros, Pose),
    /// The end, though sinks may still be about.
    End,
}

/// A recording in the making. Dropping it finishes the file as well, without a word about errors.
pub struct Recorder {
    path: PathBuf,
    sender: Option<Sender<Item>>,
    thread: Option<JoinHandle<McapResult<Summary>>>,
}

impl Recorder {
    /// Begins a recording; an existing file is replaced.
    ///
    /// # Errors
    /// When the file cannot be written or the group file is not one.
    pub fn create(path: &Path, header: &Header) -> Result<Self, RecordingError> {
        let refuse = |problem: &dyn std::fmt::Display| RecordingError::new(path, problem);
        let group = header
            .group
            .as_ref()
            .map(|text| GroupFile::parse("group file", text));
        let group = group.transpose().map_err(|error| refuse(&error))?;
        let file = File::create(path)
            .map_err(|error| refuse(&format_args!("cannot be written: {error}")))?;
        let writer = Writer::begin(file, header, group).map_err(|error| refuse(&error))?;
        let (sender, items) = channel();
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || writer.run(&items))
            .map_err(|error| refuse(&error))?;
        Ok(Self {
            path: path.into(),
            sender: Some(sender),
            thread: Some(thread),
        })
    }

    /// Where frames go. Once the recording is finished it takes them and drops them.
    #[must_use]
    pub fn sink(&self) -> FrameSink {
        let sender = self.sender.clone();
        Arc::new(move |at, frame, sent| {
            if let Some(sender) = &sender {
                // The writer ends early only when the disk is full; that is reported at the end.
                let _ = sender.send(Item::Frame(at, *frame, sent));
            }
        })
    }

    /// Where the group is to be ([`super::PLAN`]) or was seen ([`super::TRUTH`]) at `at` on the
    /// link's clock.
    pub fn pose(&self, channel: &'static str, at: Micros, pose: Pose) {
        if let Some(sender) = &self.sender {
            let _ = sender.send(Item::Pose(channel, at, pose));
        }
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// The first error since it began; what was written until then is readable.
    pub fn finish(mut self) -> Result<Summary, RecordingError> {
        self.join()
            .unwrap_or(Ok(Summary::default()))
            .map_err(|error| {
                RecordingError::new(&self.path, format_args!("is incomplete: {error}"))
            })
    }

    fn join(&mut self) -> Option<McapResult<Summary>> {
        let _ = self.sender.take()?.send(Item::End);
        let ended = self.thread.take()?.join();
        Some(ended.unwrap_or_else(|_| Err(std::io::Error::other("the recorder failed").into())))
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.join();
    }
}

/// A channel and how many messages it has.
struct Channel {
    id: u16,
    count: u32,
}

struct Writer {
    out: mcap::Writer<BufWriter<File>>,
    epoch_ns: u64,
    group: Option<GroupFile>,
    listener: Listener,
    channels: BTreeMap<String, Channel>,
    schemas: BTreeMap<&'static str, u16>,
    chunk_ends_ns: u64,
    frames: u64,
    messages: u64,
    span_us: Option<(u64, u64)>,
}

impl Writer {
    fn begin(file: File, header: &Header, group: Option<GroupFile>) -> McapResult<Self> {
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(None)
            // A chunk is put together in memory, so that a file cut off ends in whole chunks.
            .disable_seeking(true)
            .profile("omnibus")
            .library(concat!("omnibus ", env!("CARGO_PKG_VERSION")));
        let mut out = options.create(BufWriter::new(file))?;
        let mut metadata = BTreeMap::from([
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("bus".into(), header.bus.clone()),
            ("activity".into(), header.activity.clone()),
            ("epoch_ns".into(), header.epoch_ns.to_string()),
        ]);
        metadata.extend(header.group.clone().map(|text| ("group_file".into(), text)));
        out.write_metadata(&mcap::records::Metadata {
            name: METADATA.into(),
            metadata,
        })?;
        out.flush()?;
        let nodes = group.iter().flat_map(|group| &group.robots).map(|r| r.node);
        let listener = Listener::new(nodes.collect::<Vec<_>>());
        Ok(Self {
            out,
            epoch_ns: header.epoch_ns,
            group,
            listener,
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            chunk_ends_ns: CHUNK_NS,
            frames: 0,
            messages: 0,
            span_us: None,
        })
    }

    fn run(mut self, items: &Receiver<Item>) -> McapResult<Summary> {
        for item in items {
            match item {
                Item::Frame(at, frame, sent) => self.frame(at, &frame, sent)?,
                Item::Pose(channel, at, pose) => {
                    let value = json!(PoseRecord::from(pose));
                    self.write(
                        channel,
                        ("omnibus.Pose", schema::pose_only),
                        at.0 * 1_000,
                        &value,
                    )?;
                }
                Item::End => break,
            }
        }
        self.out.finish()?;
        let (first, last) = self.span_us.unwrap_or_default();
        Ok(Summary {
            frames: self.frames,
            messages: self.messages,
            seconds: (last - first) as f64 * 1e-6,
        })
    }

    fn frame(&mut self, at: Micros, frame: &Frame, sent: bool) -> McapResult<()> {
        let at_ns = at.0 * 1_000;
        if at_ns >= self.chunk_ends_ns {
            self.out.flush()?;
            self.chunk_ends_ns = at_ns - at_ns % CHUNK_NS + CHUNK_NS;
        }
        let (first, last) = self.span_us.unwrap_or((at.0, at.0));
        self.span_us = Some((first.min(at.0), last.max(at.0)));
        self.frames += 1;
        let record = FrameRecord {
            id: frame.id(),
            name: frame_name(frame.id()),
            data: to_hex(frame.data()),
            sent,
        };
        self.write(
            CAN,
            ("omnibus.CanFrame", schema::can),
            at_ns,
            &json!(record),
        )?;
        if let Some(snapshot) = self.listener.take(at.0 as f64 * 1e-6, frame) {
            self.snapshot(&snapshot)?;
        }
        for event in self.listener.take_events() {
            self.event(&event)?;
        }
        Ok(())
    }

    fn snapshot(&mut self, snapshot: &Snapshot) -> McapResult<()> {
        let at_ns = to_ns(snapshot.t);
        let group = filled(&[
            ("sequence", Some(json!(snapshot.sequence))),
            ("phase", Some(json!(snapshot.phase.name()))),
            ("command", Some(twist(snapshot.command))),
            ("measured", snapshot.measured.map(twist)),
            ("pose", snapshot.pose.map(pose)),
            ("target", snapshot.target.map(pose)),
            ("scale", snapshot.scale.map(|v| json!(v))),
            ("strain", snapshot.strain.map(|v| json!(v))),
            ("bus_load", snapshot.bus_load.map(|v| json!(v))),
        ]);
        self.write(GROUP, ("omnibus.Group", schema::group), at_ns, &group)?;
        for member in &snapshot.members {
            let topic = format!("{ROBOT}{}", member.node);
            self.write(
                &topic,
                ("omnibus.Robot", schema::robot),
                at_ns,
                &robot(member),
            )?;
        }
        if let Some(pose) = snapshot.pose {
            let value = self.transforms(at_ns, pose);
            let kind = (
                "foxglove.FrameTransforms",
                schema::transforms as fn() -> Value,
            );
            self.write(TRANSFORMS, kind, at_ns, &value)?;
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

    fn event(&mut self, event: &Event) -> McapResult<()> {
        let level = match event.what {
            EventKind::Code(Code::Limit(_)) | EventKind::Late(_) => WARNING,
            EventKind::Code(Code::Fault(_)) | EventKind::Failed(_) => ERROR,
            EventKind::Emergency(code) if code != 0 => ERROR,
            _ => INFO,
        };
        let at_ns = to_ns(event.t);
        let name = event
            .node
            .map_or_else(|| "master".into(), |node| format!("node {node}"));
        let value = json!({"timestamp": self.stamp(at_ns), "level": level, "name": name,
                           "message": format!("{name}: {}", event.what), "file": "", "line": 0});
        self.write(EVENTS, ("foxglove.Log", schema::log), at_ns, &value)
    }

    fn stamp(&self, at_ns: u64) -> Value {
        let ns = self.epoch_ns + at_ns;
        json!({"sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000})
    }

    fn write(
        &mut self,
        topic: &str,
        (name, schema): (&'static str, fn() -> Value),
        at_ns: u64,
        value: &Value,
    ) -> McapResult<()> {
        if !self.channels.contains_key(topic) {
            let id = match self.schemas.get(name) {
                Some(id) => *id,
                None => {
                    let text = schema().to_string();
                    let id = self.out.add_schema(name, "jsonschema", text.as_bytes())?;
                    self.schemas.insert(name, id);
                    id
                }
            };
            let id = self.out.add_channel(id, topic, "json", &BTreeMap::new())?;
            self.channels.insert(topic.into(), Channel { id, count: 0 });
        }
        let Some(channel) = self.channels.get_mut(topic) else {
            return Ok(());
        };
        channel.count = channel.count.wrapping_add(1);
        self.messages += 1;
        let time = self.epoch_ns + at_ns;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.count,
            log_time: time,
            publish_time: time,
        };
        self.out
            .write_to_known_channel(&header, value.to_string().as_bytes())
    }
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

fn robot(member: &MemberSample) -> Value {
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
    ])
}
