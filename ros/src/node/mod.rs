//! The node: the group on DDS, by `ros2-client`.
//!
//! [`run`] creates the node and serves it in the calling thread until its channel of outgoing
//! messages is closed. Messages to publish come through this channel, as [`Outgoing`]; commands and
//! service calls go to a closure, as [`Incoming`], whose return value is the reply of the service.
//! The closure must not block. Slow readers never delay the node: a message for which there is no
//! room is dropped.
//!
//! Only this module names the library, whose interface changes often.
//!
//! If a thread of the library ends without an error, [`run`] creates the node once more.
//!
//! Limits: the library can panic in many places, also in its own threads. Code that keeps a group
//! safe therefore never runs in the thread of [`run`] or in the library's threads, and a caller
//! must treat their end as the end of the node. One of those threads may also hang: [`run`] ends
//! with an error when the library has had no room for any message for [`HANGS`]. There are no
//! parameter services.

pub mod environment;
#[cfg(target_os = "linux")]
mod filter;
mod graph;
mod peers;
mod ports;
mod services;
mod threads;

use std::pin::Pin;
use std::time::{Duration, Instant};

use futures::channel::mpsc::Receiver;
use futures::stream::{Stream, StreamExt as _, iter, select};
use ros2_client::qos::{Durability, History, QosProfile, WhenFull};
use ros2_client::{
    Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, Subscription,
};
use serde::{Deserialize, Serialize};

use self::environment::Environment;
use self::graph::Graph;
pub use self::services::{Call, Reply};
use self::services::{Called, Servers};
use crate::message::{
    BatteryState, Bool, DiagnosticArray, Header, JointState, Message, Odometry, TFMessage, Twist,
    TwistStamped,
};

/// Messages kept for readers that ask again.
const DEPTH: usize = 10;
/// A library that has had no room for so long does not send any more.
const HANGS: Duration = Duration::from_secs(3);

/// What the node is to be.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The network.
    pub environment: Environment,
    /// `/` or `/a/b`; see [`crate::names::namespace`].
    pub namespace: String,
    /// The node's name.
    pub name: String,
    /// Whether commands have a header.
    pub stamped: bool,
    /// The robot's model.
    pub description: String,
}

/// What the node publishes.
#[derive(Clone, Debug)]
pub enum Outgoing {
    /// `odom`.
    Odometry(Box<Odometry>),
    /// `tf`.
    Transforms(TFMessage),
    /// `joint_states`.
    Joints(JointState),
    /// `diagnostics`.
    Diagnostics(DiagnosticArray),
    /// `battery_state`.
    Battery(Box<BatteryState>),
    /// `e_stop`.
    EmergencyStop(bool),
}

/// Who published something: the 16 bytes by which DDS tells publishers apart.
pub type Publishing = [u8; 16];

/// What comes in.
#[derive(Clone, Debug)]
pub enum Incoming {
    /// A velocity.
    Command {
        /// From whom.
        from: Publishing,
        /// When and in which frame; `None` where commands have no header.
        header: Option<Header>,
        /// The velocity.
        twist: Twist,
    },
    /// Bytes on the topic of commands that are none.
    Unreadable(String),
    /// What has happened to the node itself.
    Note(String),
    /// A call of a service.
    Call(Call),
    /// A call that must not be followed, and why.
    Refused(String),
    /// Publishers of commands of another type, by node and type; sent when they change.
    OtherType(Vec<(String, String)>),
    /// Names of publishers, where they are known; sent when they change.
    Publishers(Vec<(Publishing, String)>),
}

/// A text for late readers.
#[derive(Clone, Debug, Serialize)]
struct Text {
    data: String,
}

/// Why there is no node, or none any more.
#[derive(Debug, thiserror::Error)]
#[error("ROS 2: {0}")]
pub struct NodeError(String);

fn refused(what: &str) -> impl Fn(&dyn std::fmt::Display) -> NodeError + '_ {
    move |error| NodeError(format!("{what}: {error}"))
}

/// Makes the node and serves it until `outgoing` ends.
///
/// # Errors
/// When the node cannot be made, or its streams end.
pub fn run(
    settings: &Settings,
    mut outgoing: Receiver<Outgoing>,
    on: &mut dyn FnMut(Incoming) -> Reply,
) -> Result<(), NodeError> {
    let mut e_stop = None;
    while run_once(settings, &mut outgoing, &mut e_stop, on)? == Ending::Deaf {
        on(Incoming::Note(
            "the DDS library had ended, as when a process is stopped and continued: it was started \
             again"
                .into(),
        ));
    }
    Ok(())
}

/// Why a node was served to its end.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// The messages to publish have ended.
    Asked,
    /// The library does not receive any more.
    Deaf,
}

/// Makes a node and serves it; `e_stop` is the last that was published of it.
fn run_once(
    settings: &Settings,
    outgoing: &mut Receiver<Outgoing>,
    e_stop: &mut Option<bool>,
    on: &mut dyn FnMut(Incoming) -> Reply,
) -> Result<Ending, NodeError> {
    let context = context(&settings.environment)?;
    #[cfg(target_os = "linux")]
    if let Err(error) = filter::guard(settings.environment.domain) {
        // The node does its work without it.
        on(Incoming::Note(format!(
            "the kernel does not keep damaged datagrams away: {error}"
        )));
    }
    let _relay = peers::Relay::start(&settings.environment, &context)?;
    let name = NodeName::new(&settings.namespace, &settings.name);
    let name = name.map_err(|error| refused("the node's name")(&error))?;
    let options = NodeOptions::new()
        .enable_rosout(false)
        .start_parameter_services(false);
    let node = context.new_node(name, options);
    let mut node = node.map_err(|error| refused("the node")(&error))?;
    let topics = Topics::new(&mut node, &settings.description)?;
    if let Some(data) = *e_stop {
        topics.publish(Outgoing::EmergencyStop(data));
    }
    let servers = Servers::new(&context, &mut node, settings.environment.services)?;
    let served = Served {
        topics,
        servers,
        discovery: graph::subscribe(&context, &mut node)?,
        graph: Graph::new(&context, settings),
        e_stop,
    };
    if settings.stamped {
        let commands = commands::<TwistStamped>(&mut node)?;
        let split = |message: TwistStamped| (Some(message.header), message.twist);
        served.serve(&commands, split, outgoing, on)
    } else {
        let commands = commands::<Twist>(&mut node)?;
        served.serve(&commands, |twist| (None, twist), outgoing, on)
    }
}

fn context(environment: &Environment) -> Result<Context, NodeError> {
    Context::from_domain_participant(ports::participant(environment)?)
        .map_err(|error| refused("the network")(&format_args!("{error:?}")))
}

/// Reliable, so that readers of either kind match; a slow reader delays nothing.
fn volatile() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::Fail)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: DEPTH })
}

/// The last message is kept for readers that come later.
fn latched() -> QosProfile {
    volatile()
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 })
}

/// Best effort is offered by every publisher, so every one of them is heard.
fn newest() -> QosProfile {
    QosProfile::subscription_default()
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 1 })
}

fn type_name(of: &str) -> MessageTypeName {
    let (package, name) = of.split_once("/msg/").unwrap_or(("", of));
    MessageTypeName::new(package, name)
}

/// A name in the node's namespace. Absolute, because the library makes two slashes of a relative
/// one in the namespace `/`.
fn named(node: &Node, name: &str) -> Result<Name, ros2_client::names::NameError> {
    Name::new(node.namespace(), name)
}

fn commands<M: Message + 'static>(node: &mut Node) -> Result<Subscription<M>, NodeError> {
    let refused = refused("cmd_vel");
    let name = named(node, "cmd_vel").map_err(|error| refused(&error))?;
    let topic = node
        .create_topic(&name, type_name(M::TYPE), &newest())
        .map_err(|error| refused(&format_args!("{error:?}")))?;
    node.create_subscription(&topic, Some(newest()))
        .map_err(|error| refused(&format_args!("{error:?}")))
}

fn publisher<M: Serialize>(
    node: &mut Node,
    name: &str,
    of: &str,
    qos: &QosProfile,
) -> Result<Publisher<M>, NodeError> {
    let refused = refused(name);
    let named = named(node, name).map_err(|error| refused(&error))?;
    let topic = node
        .create_topic(&named, type_name(of), qos)
        .map_err(|error| refused(&format_args!("{error:?}")))?;
    node.create_publisher(&topic, Some(qos.clone()))
        .map_err(|error| refused(&format_args!("{error:?}")))
}

struct Topics {
    odometry: Publisher<Odometry>,
    transforms: Publisher<TFMessage>,
    joints: Publisher<JointState>,
    diagnostics: Publisher<DiagnosticArray>,
    battery: Publisher<BatteryState>,
    e_stop: Publisher<Bool>,
    /// Kept for readers that come later.
    _description: Publisher<Text>,
}

impl Topics {
    fn new(node: &mut Node, description: &str) -> Result<Self, NodeError> {
        let (volatile, latched) = (volatile(), latched());
        let text = publisher(node, "robot_description", "std_msgs/msg/String", &latched)?;
        let data = description.to_owned();
        text.publish(Text { data })
            .map_err(|error| refused("robot_description")(&format_args!("{error:?}")))?;
        Ok(Self {
            odometry: publisher(node, "odom", Odometry::TYPE, &volatile)?,
            transforms: publisher(node, "tf", TFMessage::TYPE, &volatile)?,
            joints: publisher(node, "joint_states", JointState::TYPE, &volatile)?,
            diagnostics: publisher(node, "diagnostics", DiagnosticArray::TYPE, &volatile)?,
            battery: publisher(node, "battery_state", BatteryState::TYPE, &volatile)?,
            e_stop: publisher(node, "e_stop", Bool::TYPE, &latched)?,
            _description: text,
        })
    }

    /// Whether there was room for it.
    fn publish(&self, message: Outgoing) -> bool {
        match message {
            Outgoing::Odometry(message) => self.odometry.publish(*message).is_ok(),
            Outgoing::Transforms(message) => self.transforms.publish(message).is_ok(),
            Outgoing::Joints(message) => self.joints.publish(message).is_ok(),
            Outgoing::Diagnostics(message) => self.diagnostics.publish(message).is_ok(),
            Outgoing::Battery(message) => self.battery.publish(*message).is_ok(),
            Outgoing::EmergencyStop(data) => self.e_stop.publish(Bool { data }).is_ok(),
        }
    }
}

/// One thing that has happened.
enum Event<'a, M> {
    Publish(Outgoing),
    Command(M, Publishing),
    Unreadable(String),
    Called(Called<'a>),
    Participant(graph::Participant),
    /// The messages to publish have ended.
    End,
    Other,
}

/// The node with all its ends.
struct Served<'a> {
    topics: Topics,
    servers: Servers,
    discovery: Subscription<graph::Participant>,
    graph: Graph,
    e_stop: &'a mut Option<bool>,
}

impl Served<'_> {
    fn serve<M: Message + for<'de> Deserialize<'de> + 'static>(
        self,
        commands: &Subscription<M>,
        split: impl Fn(M) -> (Option<Header>, Twist),
        outgoing: &mut Receiver<Outgoing>,
        on: &mut dyn FnMut(Incoming) -> Reply,
    ) -> Result<Ending, NodeError> {
        let Self {
            topics,
            servers,
            discovery,
            mut graph,
            e_stop,
        } = self;
        let outgoing = outgoing.map(Event::Publish).chain(iter([Event::End]));
        let commands = commands.async_stream().map(|message| match message {
            Ok((message, info)) => Event::Command(message, info.publisher_gid().to_bytes16()),
            Err(error) => Event::Unreadable(format!("{error:?}")),
        });
        let participants = discovery.async_stream().map(|message| match message {
            Ok((participant, _)) => Event::Participant(participant),
            Err(_) => Event::Other,
        });
        let calls = servers.calls().map(Event::Called);
        // The two sides take turns, so nothing waits behind what is published.
        let incoming = select(pin(commands), pin(select(pin(calls), pin(participants))));
        let mut events = select(pin(incoming), pin(outgoing));
        let mut full_since: Option<Instant> = None;
        futures::executor::block_on(async {
            while let Some(event) = events.next().await {
                match event {
                    Event::End => return Ok(Ending::Asked),
                    Event::Publish(message) => {
                        // Once a second suffices for who is there.
                        let looks = matches!(message, Outgoing::Diagnostics(_));
                        if looks && !threads::run() {
                            return Ok(Ending::Deaf);
                        }
                        if let Outgoing::EmergencyStop(data) = message {
                            *e_stop = Some(data);
                        }
                        if topics.publish(message) {
                            full_since = None;
                        } else if full_since.get_or_insert_with(Instant::now).elapsed() > HANGS {
                            return Err(NodeError("the library has stopped sending".into()));
                        }
                        if looks {
                            graph.look(on);
                        }
                    }
                    Event::Unreadable(error) => {
                        on(Incoming::Unreadable(error));
                    }
                    Event::Command(message, from) => {
                        let (header, twist) = split(message);
                        on(Incoming::Command {
                            from,
                            header,
                            twist,
                        });
                    }
                    Event::Called(called) => called.pass(on),
                    Event::Participant(participant) => graph.add(participant),
                    Event::Other => {}
                }
            }
            Err(NodeError("the network has ended".into()))
        })
    }
}

fn pin<'a, T>(stream: impl Stream<Item = T> + 'a) -> Pin<Box<dyn Stream<Item = T> + 'a>> {
    Box::pin(stream)
}
