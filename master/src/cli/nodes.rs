//! `omnibus scan` and `omnibus status`: who is on the bus, and how they are. Both only read; neither
//! claims to be the master, so a running group is not disturbed.

use std::collections::BTreeMap;

use canopen::{Micros, NmtState, client};
use comfy_table::{Table, presets};
use omnibus::error::MasterError;
use omnibus::link::Link;
use omnibus::wire::Wire;
use protocol::{Address, Code, Kind, MemberState, Value, address};
use serde_json::json;

use super::{Target, say};

/// How long robots are listened for before they are asked, in µs.
const LISTEN_US: u64 = 500_000;

#[derive(clap::Args)]
pub struct Scan {
    #[command(flatten)]
    target: Target,
    /// Prints JSON.
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
pub struct Status {
    #[command(flatten)]
    target: Target,
    /// Prints JSON.
    #[arg(long)]
    json: bool,
}

/// Listens for heartbeats: the NMT state of every node that sent one.
fn listen<L: Link>(wire: &mut Wire<L>) -> Result<BTreeMap<u8, NmtState>, MasterError> {
    let mut heard = BTreeMap::new();
    let until = wire.now() + Micros(LISTEN_US);
    while let Some((_, frame)) = wire.next(until)? {
        if let Some((node, state)) = client::parse_heartbeat(&frame) {
            heard.insert(node.get(), state);
        }
    }
    Ok(heard)
}

/// Reads an object; `None` when the node does not answer.
fn ask<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    at: Address,
    kind: Kind,
) -> Result<Option<Value>, MasterError> {
    match wire.read(node, at, kind) {
        Ok(value) => Ok(Some(value)),
        Err(MasterError::NodeSilent { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

fn state_name(state: Option<&NmtState>) -> String {
    state.map_or_else(|| "silent".into(), |state| format!("{state:?}"))
}

/// `omnibus scan`.
pub fn scan(arguments: &Scan) -> anyhow::Result<()> {
    let group = arguments.target.group()?;
    let mut wire = Wire::visiting(arguments.target.link(&group)?);
    let heard = listen(&mut wire)?;
    let mut found = Vec::new();
    for node in protocol::FIRST_ROBOT..=protocol::LAST_ROBOT {
        let Some(version) = ask(&mut wire, node, address::WIRE_VERSION, Kind::U16)? else {
            continue;
        };
        let serial = wire.read(node, address::SERIAL_NUMBER, Kind::U32)?;
        let firmware = wire.read(node, address::FIRMWARE_VERSION, Kind::U32)?;
        found.push((
            node,
            version.to_bits(),
            serial.to_bits(),
            firmware.to_bits(),
        ));
    }
    let in_group = |node: u8| group.robots.iter().any(|robot| robot.node == node);
    let missing: Vec<u8> = group
        .robots
        .iter()
        .map(|robot| robot.node)
        .filter(|node| !found.iter().any(|(found, ..)| found == node))
        .collect();
    if arguments.json {
        let nodes = found.iter().map(|(node, version, serial, firmware)| {
            json!({"node": node, "state": state_name(heard.get(node)), "serial": serial,
                   "firmware": firmware, "wire_version": version, "in_group": in_group(*node)})
        });
        let nodes: Vec<_> = nodes.collect();
        return super::print_json(&json!({"nodes": nodes, "missing": missing}));
    }
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table.set_header([
        "node",
        "state",
        "serial",
        "firmware",
        "wire version",
        "group",
    ]);
    for (node, version, serial, firmware) in &found {
        table.add_row([
            node.to_string(),
            state_name(heard.get(node)),
            format!("{serial:08X}"),
            format!("{firmware:08X}"),
            version.to_string(),
            if in_group(*node) {
                group.name.clone()
            } else {
                "not in the group file".into()
            },
        ]);
    }
    say(&table)?;
    for node in missing {
        say(format_args!(
            "node {node} of group '{}' does not answer",
            group.name
        ))?;
    }
    Ok(())
}

/// `omnibus status`.
pub fn status(arguments: &Status) -> anyhow::Result<()> {
    let group = arguments.target.group()?;
    let mut wire = Wire::visiting(arguments.target.link(&group)?);
    let heard = listen(&mut wire)?;
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table.set_header(["node", "NMT", "state", "limit or fault", "supply", "stops"]);
    let mut rows = Vec::new();
    for robot in &group.robots {
        let node = robot.node;
        let Some(state) = ask(&mut wire, node, address::STATE, Kind::U8)? else {
            table.add_row([node.to_string(), "silent".into()]);
            rows.push(json!({"node": node, "answers": false}));
            continue;
        };
        let raw = u8::try_from(state.to_bits()).unwrap_or(u8::MAX);
        let state = MemberState::try_from(raw).map_or_else(|e| e.to_string(), |s| format!("{s:?}"));
        let code = wire.read(node, address::STATUS_CODE, Kind::U16)?;
        let raw = u16::try_from(code.to_bits()).unwrap_or(u16::MAX);
        let code = Code::from_code(raw)
            .map_or_else(|| format!("unknown {raw:#06x}"), omnibus::session::describe);
        let supply = wire.read(node, address::SUPPLY, Kind::F32)?;
        let stops = wire.read(node, address::STOPS, Kind::U32)?;
        let (supply, stops) = (omnibus::sdo::show(supply), omnibus::sdo::show(stops));
        let nmt = state_name(heard.get(&node));
        rows.push(
            json!({"node": node, "answers": true, "nmt": nmt, "state": state,
                         "code": raw, "supply_v": supply, "stops": stops}),
        );
        table.add_row([
            node.to_string(),
            nmt,
            state,
            code,
            format!("{supply} V"),
            stops,
        ]);
    }
    if arguments.json {
        return super::print_json(&json!({"group": group.name, "robots": rows}));
    }
    say(&table)?;
    Ok(())
}
