//! `omnibus reset`: robots restart, as if they had been switched off and on.

use std::collections::BTreeSet;

use canopen::{Micros, NmtCommand, NmtTarget, NodeId, client};
use omnibus::commission::survey::Survey;
use omnibus::error::MasterError;
use protocol::cob;
use serde_json::json;

use super::output::Found;
use super::{Target, json, print_json, print_line};

const EXAMPLES: &str = "Examples:
  omnibus reset --node 3 --bus socketcan:can0
  omnibus reset --all --bus socketcan:can0

Values that were not saved are lost. A robot that moves ramps down with its group first.";

/// How long a robot may take to boot, in us.
const BOOT_US: u64 = 5_000_000;

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = clap::ArgGroup::new("which").args(["node", "all"]).required(true))]
pub struct Arguments {
    /// Node of the robot.
    #[arg(long, value_parser = super::robot)]
    node: Option<u8>,
    /// Every robot on the bus.
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    target: Target,
}

/// `omnibus reset`.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let target = &arguments.target;
    let mut wire = target.exclusive()?;
    let found = Survey::take(&mut wire, None)?.found;
    let mut waited_for: BTreeSet<u8> = found.iter().map(|robot| robot.node).collect();
    waited_for.retain(|node| arguments.node.is_none_or(|only| only == *node));
    if waited_for.is_empty() {
        return Err(match arguments.node {
            Some(node) => MasterError::NodeSilent { node }.into(),
            None => Found(format!("no robot answers on {}", target.bus)).into(),
        });
    }
    let nodes: Vec<u8> = waited_for.iter().copied().collect();
    for node in nodes.iter().filter_map(|node| NodeId::new(*node)) {
        wire.send(&client::nmt(NmtCommand::ResetNode, NmtTarget::Node(node)))?;
    }
    let until = wire.now() + Micros(BOOT_US);
    while !waited_for.is_empty() {
        let Some((_, frame)) = wire.next(until)? else {
            break;
        };
        // The boot-up message is a heartbeat of state 0.
        if frame.data() == [0] {
            waited_for.retain(|node| frame.id() != cob::heartbeat(*node));
        }
    }
    if let Some(node) = waited_for.first() {
        return Err(MasterError::NodeSilent { node: *node }.into());
    }
    if json() {
        return print_json(&json!({"reset": nodes}));
    }
    let have = if nodes.len() == 1 { "has" } else { "have" };
    print_line(format_args!(
        "{} {have} restarted",
        omnibus::report::nodes(&nodes)
    ))
}
