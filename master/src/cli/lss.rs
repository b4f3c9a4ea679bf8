//! `omnibus lss scan|set`: node ids over the bus.

use anyhow::{Context as _, bail};
use canopen::{Identity, NmtCommand, NmtTarget, NodeId, client};
use omnibus::commission::lss;
use omnibus::commission::survey::Survey;
use serde_json::json;

use super::{Target, json, output, print_json, print_line, print_note};

/// For the help of both.
pub const EXAMPLES: &str = "Examples:
  omnibus lss scan --bus socketcan:can0
  omnibus lss set 5 --bus socketcan:can0";
const SCAN_EXAMPLES: &str = "Example:
  omnibus lss scan --bus socketcan:can0";
const SET_EXAMPLES: &str = "Examples:
  omnibus lss set 5 --bus socketcan:can0                     the only robot without a node id
  omnibus lss set 5 --serial 1A2B3C4D --bus socketcan:can0   one of several
  omnibus lss set 5 --now 3 --store --bus socketcan:can0     a robot that has another id

Without --store the id is lost at the next power-off. A robot that already has an id uses the new
one after a communication reset, which --reset sends.";

#[derive(clap::Subcommand)]
pub enum Command {
    /// Lists the robots with and without a node id, by identity.
    #[command(after_help = SCAN_EXAMPLES)]
    Scan {
        #[command(flatten)]
        target: Target,
    },
    /// Gives a robot a node id.
    #[command(after_help = SET_EXAMPLES)]
    Set {
        /// The node id, 2 to 17.
        #[arg(value_parser = super::robot)]
        node: u8,
        /// Serial number of the robot, hexadecimal; needed when several have no node id.
        #[arg(long, conflicts_with = "now", value_parser = hexadecimal)]
        serial: Option<u32>,
        /// The node id that the robot has now.
        #[arg(long, value_parser = super::robot)]
        now: Option<u8>,
        /// Stores the node id in the robot's flash.
        #[arg(long)]
        store: bool,
        /// Resets the robot's communication afterwards, so that the new id takes effect.
        #[arg(long)]
        reset: bool,
        #[command(flatten)]
        target: Target,
    },
}

pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Scan { target } => scan(target),
        Command::Set {
            node,
            serial,
            now,
            store,
            reset,
            target,
        } => set(target, *node, *serial, *now, *store, *reset),
    }
}

fn scan(target: &Target) -> anyhow::Result<()> {
    let mut wire = target.visit()?;
    let survey = Survey::take(&mut wire, None)?;
    let mut rows = Vec::new();
    for robot in &survey.found {
        rows.push((Some(robot.node), lss::identity(&mut wire, robot.node)?));
    }
    rows.extend(
        lss::unconfigured(&mut wire)?
            .into_iter()
            .map(|identity| (None, identity)),
    );
    if json() {
        let robots = rows.iter().map(|(node, id)| {
            json!({"node": node, "vendor": id.vendor, "product": id.product,
                   "revision": id.revision, "serial": id.serial})
        });
        return print_json(&json!({"robots": robots.collect::<Vec<_>>()}));
    }
    let mut table = output::table(["node", "vendor", "product", "revision", "serial"]);
    for (node, id) in &rows {
        let hex = |value: u32| format!("{value:08X}");
        table.add_row([
            node.map_or_else(|| "none".into(), |node| node.to_string()),
            hex(id.vendor),
            hex(id.product),
            hex(id.revision),
            hex(id.serial),
        ]);
    }
    print_line(&table)?;
    if rows.is_empty() {
        print_line("no robot answers")?;
    }
    Ok(())
}

fn set(
    target: &Target,
    node: u8,
    serial: Option<u32>,
    now: Option<u8>,
    store: bool,
    reset: bool,
) -> anyhow::Result<()> {
    let wanted = NodeId::new(node).context("a node id is 1 to 127")?;
    let mut wire = target.exclusive()?;
    let survey = Survey::take(&mut wire, None)?;
    if now != Some(node) && survey.found.iter().any(|robot| robot.node == node) {
        bail!("another robot has node id {node}; change that robot's id first");
    }
    let identity = match now {
        Some(now) => lss::identity(&mut wire, now)?,
        None => pick(&lss::unconfigured(&mut wire)?, serial)?,
    };
    lss::assign(&mut wire, &identity, wanted, store)?;
    if reset && let Some(now) = now.and_then(NodeId::new) {
        wire.send(&client::nmt(
            NmtCommand::ResetCommunication,
            NmtTarget::Node(now),
        ))?;
        // The frame must be out before the bus is closed.
        let until = wire.now() + canopen::Micros(100_000);
        while wire.next(until)?.is_some() {}
    }
    if json() {
        return print_json(&json!({"node": node, "serial": identity.serial, "stored": store}));
    }
    print_line(format_args!(
        "the robot with serial {:08X} is node {node}{}",
        identity.serial,
        if store { ", stored" } else { "" }
    ))?;
    if now.is_some() && !reset {
        print_note("the new id takes effect at the robot's next reset; --reset resets it now");
    }
    Ok(())
}

fn hexadecimal(text: &str) -> Result<u32, String> {
    u32::from_str_radix(text.trim_start_matches("0x"), 16)
        .map_err(|_| "give a hexadecimal number of at most 8 digits".to_owned())
}

/// The robot that is meant.
fn pick(found: &[Identity], serial: Option<u32>) -> anyhow::Result<Identity> {
    if let Some(number) = serial {
        return match found.iter().find(|identity| identity.serial == number) {
            Some(identity) => Ok(*identity),
            None => bail!("--serial: no robot without a node id has serial {number:08X}"),
        };
    }
    match found {
        [only] => Ok(*only),
        [] => bail!("every robot on the bus has a node id; give the one to change with --now NODE"),
        several => bail!(
            "{} robots have no node id; choose one with --serial: {}",
            several.len(),
            several
                .iter()
                .map(|id| format!("{:08X}", id.serial))
                .collect::<Vec<_>>()
                .join(", ")
        ),
    }
}
