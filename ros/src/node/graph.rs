//! The other participants: publishers of commands by the name of their node, and those whose
//! messages are of another type.
//!
//! Nodes say which publishers are theirs on the topic `ros_discovery_info`; DDS says which
//! publisher has which topic and type.

use std::collections::BTreeMap;

use ros2_client::qos::{Durability, History, QosProfile, WhenFull};
use ros2_client::{Context, MessageTypeName, Node, Subscription};
use serde::{Deserialize, Serialize};

use super::{Incoming, NodeError, Publishing, Reply, Settings, refused};
use crate::message::{Message as _, Twist, TwistStamped};

/// Participants whose nodes are kept in mind.
const MOST: usize = 256;

/// The nodes of a participant: `rmw_dds_common/msg/ParticipantEntitiesInfo`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Participant {
    gid: Publishing,
    nodes: Vec<NodeInfo>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct NodeInfo {
    namespace: String,
    name: String,
    readers: Vec<Publishing>,
    writers: Vec<Publishing>,
}

/// What is known of the others.
pub(super) struct Graph {
    context: Context,
    /// The topic of commands, as DDS knows it.
    topic: String,
    /// Its type here, as DDS knows it.
    of: String,
    participants: BTreeMap<Publishing, Vec<NodeInfo>>,
    others: Vec<(String, String)>,
    named: Vec<(Publishing, String)>,
}

/// Where participants say which nodes they have.
pub(super) fn subscribe(
    context: &Context,
    node: &mut Node,
) -> Result<Subscription<Participant>, NodeError> {
    let qos = QosProfile::subscription_default()
        .reliability_reliable(WhenFull::Fail)
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 });
    let of = MessageTypeName::new("rmw_dds_common", "ParticipantEntitiesInfo");
    let refused = refused("ros_discovery_info");
    let topic = context
        .create_topic("ros_discovery_info".into(), of, &qos)
        .map_err(|error| refused(&format_args!("{error:?}")))?;
    node.create_subscription(&topic, Some(qos))
        .map_err(|error| refused(&format_args!("{error:?}")))
}

impl Graph {
    pub(super) fn new(context: &Context, settings: &Settings) -> Self {
        let namespace = settings.namespace.trim_end_matches('/');
        let of = if settings.stamped {
            TwistStamped::TYPE
        } else {
            Twist::TYPE
        };
        Self {
            context: context.clone(),
            topic: format!("rt{namespace}/cmd_vel"),
            of: dds_type(of),
            participants: BTreeMap::new(),
            others: Vec::new(),
            named: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, participant: Participant) {
        if self.participants.len() < MOST || self.participants.contains_key(&participant.gid) {
            self.participants.insert(participant.gid, participant.nodes);
        }
    }

    /// Says who publishes commands, where that has changed.
    pub(super) fn look(&mut self, on: &mut dyn FnMut(Incoming) -> Reply) {
        let (mut others, mut named) = (Vec::new(), Vec::new());
        for writer in self.context.domain_participant().discovered_writers() {
            let data = writer.publication_topic_data;
            if data.topic_name != self.topic {
                continue;
            }
            let gid = ros2_client::Gid::from(data.key).to_bytes16();
            let name = self.name(gid).unwrap_or_else(|| short(gid));
            if data.type_name == self.of {
                named.push((gid, name));
            } else {
                others.push((name, ros_type(&data.type_name)));
            }
        }
        named.sort();
        others.sort();
        if named != self.named {
            self.named.clone_from(&named);
            on(Incoming::Publishers(named));
        }
        if others != self.others {
            self.others.clone_from(&others);
            on(Incoming::OtherType(others));
        }
    }

    fn name(&self, writer: Publishing) -> Option<String> {
        let nodes = self.participants.values().flatten();
        let node = nodes
            .into_iter()
            .find(|node| node.writers.contains(&writer))?;
        Some(format!(
            "{}/{}",
            node.namespace.trim_end_matches('/'),
            node.name
        ))
    }
}

/// What a publisher is called whose node has no name.
pub(super) fn short(gid: Publishing) -> String {
    let digits: String = gid.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("publisher {digits}")
}

/// `geometry_msgs/msg/Twist` as DDS has it.
fn dds_type(of: &str) -> String {
    match of.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => of.into(),
    }
}

fn ros_type(of: &str) -> String {
    of.replace("dds_::", "")
        .replace("::", "/")
        .trim_end_matches('_')
        .into()
}
